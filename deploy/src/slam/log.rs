//! `zenav slam --log`. Map and poses from a log's scans and odometry alone.

use std::path::{Path, PathBuf};

use serde::Serialize;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{Ordered, RelationErrors, Slam, SlamSettings, Spread, in_order, read_relations, relation_errors};

use super::SlamArgs;
use super::graph::Solved;
use super::{session, written};
use crate::batch::thread_time;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::inspect::read_log;
use crate::{files, output};

/// Output of `slam --log`.
#[derive(Debug, Serialize)]
struct Mapped {
    scans: usize,
    /// Scans whose stamps go back in time.
    skipped: usize,
    warnings: Vec<String>,
    /// Scans per second of this thread's processor time, closures, solves and finish included.
    scans_per_s: f64,
    /// Duration of the log over that processor time.
    real_time_factor: f64,
    cpu_ms_per_scan: Times,
    submaps: usize,
    closures: Closures,
    graph: Solved,
    /// Remaining nodes of each session.
    sessions: Vec<usize>,
    /// Nodes trimmed as redundant with newer ones.
    trimmed: usize,
    relations: Option<Relations>,
    map: PathBuf,
}

/// Processor time, ms.
#[derive(Debug, Serialize)]
struct Times {
    /// Mean per scan, the finish included.
    mean: f64,
    /// Median of a step.
    p50: f64,
    /// 99th percentile of a step.
    p99: f64,
    /// Of the finish.
    finish: f64,
}

#[derive(Debug, Serialize)]
struct Closures {
    /// Submaps searched.
    searched: usize,
    /// Searches cut short: the budget was spent before the best match was certain.
    cut: usize,
    found: usize,
}

#[derive(Debug, Serialize)]
struct MeanAndDeviation {
    mean: f64,
    std: f64,
}

#[derive(Debug, Serialize)]
struct Relations {
    count: usize,
    translation_m: MeanAndDeviation,
    rotation_deg: MeanAndDeviation,
    odometry_translation_m: MeanAndDeviation,
    odometry_rotation_deg: MeanAndDeviation,
}

fn scaled(spread: Spread, scale: f64) -> MeanAndDeviation {
    MeanAndDeviation {
        mean: scale * spread.mean,
        std: scale * spread.deviation,
    }
}

/// Maps logs one after another, continuing the session's map if there is one.
pub(super) fn map(args: &SlamArgs) -> Outcome {
    let relations = args.relations.as_deref().map(|path| {
        let text = files::text(path)?;
        read_relations(&text).map_err(Failure::usage_at(path))
    });
    let relations = relations.transpose()?;
    let older = match &args.session {
        Some(path) if path.exists() => session::read(path)?,
        _ => Slam::new(SlamSettings::default()),
    };
    let known_sessions = older.sessions().len();
    let is_continued = !older.nodes().is_empty();
    let mut start = args
        .start
        .as_deref()
        .map(|start| Pose2::new(start[0], start[1], start[2]));
    let (mut slam, mut scans, mut steps, mut finish) = (older, Vec::new(), Vec::new(), 0.0);
    let (mut solved, mut skipped, mut warnings) = (None, 0, Vec::new());
    for path in &args.log {
        let log = in_order(read_log(path)?).map_err(Failure::usage_at(path))?;
        skipped += log.skipped;
        warnings.extend(warning(path, &log));
        let log = log.scans;
        slam = slam.begin_session(start.take());
        for scan in &log {
            let start = thread_time();
            slam.step(scan).map_err(Failure::usage_at(path))?;
            steps.push(thread_time().saturating_sub(start).as_secs_f64());
        }
        if !slam.is_located() {
            return Err(Failure::failed_at(path)(
                "no place of the older map was recognised with certainty: nothing was written",
            ));
        }
        let start = thread_time();
        solved = Some(slam.finish().map_err(Failure::failed)?);
        finish += thread_time().saturating_sub(start).as_secs_f64();
        scans.extend(log);
    }
    // clap already requires a log.
    let solved = solved.ok_or_else(|| Failure::usage("expected --log"))?;

    let all = slam.trajectory();
    let trajectory = &all[all.len().saturating_sub(scans.len())..];
    let graph = Solved::new(slam.graph().poses().len(), &solved, 1e3 * finish);
    let trimmed = slam.trim().map_err(Failure::failed)?;
    let sessions = slam.sessions();
    let known = if is_continued { known_sessions } else { 0 };
    let older_nodes = sessions.iter().take(known).sum();
    let mut placed = session::scans(&slam, 0..older_nodes);
    placed.extend(scans.iter().zip(trajectory).map(|(scan, (_, pose))| Scan {
        odom_from_base: *pose,
        map_from_odom: Pose2::IDENTITY,
        ..scan.clone()
    }));
    let before: Vec<Pose2> = scans.iter().map(|scan| scan.odom_from_base).collect();
    let out = args.out.as_deref().unwrap_or(Path::new("."));
    let map = written::write(out, args.resolution, trajectory, &placed, &before, &slam)?;
    if let Some(path) = &args.session {
        session::write(path, &slam)?;
    }
    let odometry: Vec<(f64, Pose2)> = scans
        .iter()
        .map(|scan| (scan.stamp.as_secs(), scan.odom_from_base))
        .collect();
    let errors = |trajectory: &[_]| relations.as_ref().and_then(|known| relation_errors(trajectory, known));
    let total = steps.iter().sum::<f64>() + finish;
    steps.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * steps[((steps.len() - 1) as f64 * share).round() as usize];
    let duration = trajectory.last().map_or(0.0, |last| last.0) - trajectory.first().map_or(0.0, |first| first.0);
    let counts = slam.counts();
    let mapped = Mapped {
        scans: scans.len(),
        skipped,
        warnings,
        scans_per_s: scans.len() as f64 / total.max(1e-9),
        real_time_factor: duration / total.max(1e-9),
        cpu_ms_per_scan: Times {
            mean: 1e3 * total / scans.len() as f64,
            p50: at(0.5),
            p99: at(0.99),
            finish: 1e3 * finish,
        },
        submaps: slam.submaps(),
        closures: Closures {
            searched: counts.searched,
            cut: counts.cut,
            found: counts.found,
        },
        graph,
        sessions,
        trimmed,
        relations: errors(trajectory).zip(errors(&odometry)).map(told),
        map,
    };
    output::value(args.output, &mapped, |mapped| {
        let relations = mapped.relations.as_ref().map_or_else(String::new, |relations| {
            format!(
                "\nrelations: {:.4} ± {:.4} m, {:.3} ± {:.3} deg over {} (odometry {:.3} m, {:.2} deg)",
                relations.translation_m.mean,
                relations.translation_m.std,
                relations.rotation_deg.mean,
                relations.rotation_deg.std,
                relations.count,
                relations.odometry_translation_m.mean,
                relations.odometry_rotation_deg.mean
            )
        });
        let sessions = if mapped.sessions.len() > 1 {
            let count = mapped.sessions.len();
            format!(
                "\nsessions: {count}, of {} nodes now, {} trimmed",
                mapped.sessions.iter().sum::<usize>(),
                mapped.trimmed
            )
        } else {
            String::new()
        };
        let warnings: String = mapped.warnings.iter().map(|w| format!("\nwarning: {w}")).collect();
        format!(
            "{}: {} scans at {:.2} ms, {:.0} x real time, {} submaps, {} closures found\n{}{sessions}{relations}{warnings}",
            mapped.map.display(),
            mapped.scans,
            mapped.cpu_ms_per_scan.mean,
            mapped.real_time_factor,
            mapped.submaps,
            mapped.closures.found,
            mapped.graph.told()
        )
    })?;
    Ok(exit_code::OK)
}

/// A warning about a log that is mapped nevertheless.
fn warning(path: &Path, log: &Ordered) -> Option<String> {
    let (number, stamp) = log.first_skipped?;
    Some(format!(
        "{}: {} of {} scans go back in time and were skipped, the first of them scan {number} at {stamp:.6} s",
        path.display(),
        log.skipped,
        log.skipped + log.scans.len()
    ))
}

fn told((errors, odometry): (RelationErrors, RelationErrors)) -> Relations {
    let degrees = 1.0_f64.to_degrees();
    Relations {
        count: errors.count,
        translation_m: scaled(errors.translation, 1.0),
        rotation_deg: scaled(errors.rotation, degrees),
        odometry_translation_m: scaled(odometry.translation, 1.0),
        odometry_rotation_deg: scaled(odometry.rotation, degrees),
    }
}

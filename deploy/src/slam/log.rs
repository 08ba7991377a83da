//! `zenav slam --log`. Which map and which poses follow from a log's scans and odometry alone?

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::Point2;
use serde::Serialize;
use zenav_mapping::carmen::LOG_BEAMS;
use zenav_mapping::{InsertMode, build as maps, map_file};
use zenav_pose_graph::{EdgeKind, g2o};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{RelationErrors, Slam, SlamSettings, Spread, read_relations, relation_errors};

use super::SlamArgs;
use super::graph::Solved;
use super::picture;
use crate::batch::thread_time;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::inspect::read_log;
use crate::{files, output};

/// What `slam --log` prints.
#[derive(Debug, Serialize)]
struct Mapped {
    scans: usize,
    /// Scans in a second of this thread's own time, closures, solves and finish included.
    scans_per_s: f64,
    /// Duration of the log over that time.
    real_time_factor: f64,
    cpu_ms_per_scan: Times,
    submaps: usize,
    closures: Closures,
    graph: Solved,
    relations: Option<Relations>,
    map: PathBuf,
}

/// Processor time, ms.
#[derive(Debug, Serialize)]
struct Times {
    /// Of all of it, the finish included, by scan.
    mean: f64,
    /// Of a step.
    p50: f64,
    /// Of a step.
    p99: f64,
    /// Of the finish, in all.
    finish: f64,
}

#[derive(Debug, Serialize)]
struct Closures {
    /// Submaps that were searched.
    searched: usize,
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

/// Maps a log.
pub(super) fn map(path: &Path, args: &SlamArgs) -> Outcome {
    let relations = args.relations.as_deref().map(|path| {
        let text = files::text(path)?;
        read_relations(&text).map_err(Failure::usage_at(path))
    });
    let relations = relations.transpose()?;
    let scans = read_log(path)?;
    let mut slam = Slam::new(SlamSettings::default());
    let mut steps = Vec::with_capacity(scans.len());
    for scan in &scans {
        let start = thread_time();
        slam.step(scan).map_err(Failure::usage_at(path))?;
        steps.push(thread_time().saturating_sub(start).as_secs_f64());
    }
    let start = thread_time();
    let solved = slam.finish().map_err(Failure::failed)?;
    let finish = thread_time().saturating_sub(start).as_secs_f64();

    let trajectory = slam.trajectory();
    let out = args.out.as_deref().unwrap_or(Path::new("."));
    let map = write(out, args.resolution, &scans, &trajectory, &slam)?;
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
            found: counts.found,
        },
        graph: Solved::new(slam.graph().poses().len(), &solved, 1e3 * finish),
        relations: errors(&trajectory).zip(errors(&odometry)).map(told),
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
        format!(
            "{}: {} scans at {:.2} ms, {:.0} x real time, {} submaps, {} closures found\n{}{relations}",
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

/// Writes what was found into a folder; returns the map's file.
fn write(
    out: &Path,
    resolution: f64,
    scans: &[Scan],
    trajectory: &[(f64, Pose2)],
    slam: &Slam,
) -> Result<PathBuf, Failure> {
    std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
    let mut rows = "t,x,y,yaw\n".to_owned();
    for (stamp, Pose2 { x, y, yaw }) in trajectory {
        // Writing to a string does not fail.
        let _ = writeln!(rows, "{stamp},{x},{y},{yaw}");
    }
    files::write(&out.join("trajectory.csv"), rows)?;
    files::write(&out.join("graph.g2o"), g2o::write(slam.graph(), &[]))?;
    let placed = scans.iter().zip(trajectory).map(|(scan, (_, pose))| Scan {
        odom_from_base: *pose,
        map_from_odom: Pose2::IDENTITY,
        ..scan.clone()
    });
    let placed: Vec<Scan> = placed.collect();
    let built = maps::build_map(&placed, resolution, InsertMode::Reference, &LOG_BEAMS).map_err(Failure::failed)?;
    let grid = built.map.to_occupancy();
    let map = map_file::write_map(out, "map", &grid, "SLAM of a log").map_err(Failure::failed)?;
    let edges = slam.graph().edges().iter().zip(slam.weights());
    let joined = |is_true: bool| -> Vec<[Point2<f64>; 2]> {
        let chosen = edges
            .clone()
            .filter(move |(edge, weight)| edge.kind == EdgeKind::Closure && (**weight > 0.0) == is_true);
        let poses = slam.graph().poses();
        chosen
            .map(|(edge, _)| [poses[edge.from].position(), poses[edge.to].position()])
            .collect()
    };
    let before: Vec<_> = scans.iter().map(|scan| scan.odom_from_base).collect();
    let after: Vec<_> = trajectory.iter().map(|(_, pose)| *pose).collect();
    let picture = picture::draw(&grid, &before, &after, &joined(true), &joined(false))?;
    files::write(&out.join("slam.png"), picture.png()?)?;
    Ok(map)
}

//! `zenav slam --log`. Map and poses from a log's scans and odometry alone.

use std::path::{Path, PathBuf};

use serde::Serialize;
use zenav_pose_graph::RobustSolution;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{Ordered, RelationErrors, Slam, SlamSettings, Spread, in_order, read_relations, relation_errors};

use super::SlamArgs;
use super::graph::Solved;
use super::picture::Ways;
use super::session::Stored;
use super::written::Drawn;
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
    /// Duration of all logs together over that processor time.
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
    /// Mean per scan, the finishes included.
    mean: f64,
    /// Median of a step.
    p50: f64,
    /// 99th percentile of a step.
    p99: f64,
    /// Of the finishes of all logs together, solves included.
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

/// Logs mapped one after another.
struct Run {
    slam: Slam,
    scans: Vec<Scan>,
    /// Whether each scan left a direction undetermined.
    degenerate: Vec<bool>,
    /// Processor time of each step, s.
    steps: Vec<f64>,
    /// Processor time of the finishes, and of the solves in the last of them, s.
    finish: f64,
    solving: f64,
    /// Solution of the last finish.
    solved: Option<RobustSolution>,
    /// Sum of the logs' durations, s.
    duration: f64,
    skipped: usize,
    warnings: Vec<String>,
}

impl Run {
    fn new(slam: Slam) -> Self {
        Self {
            slam,
            scans: Vec::new(),
            degenerate: Vec::new(),
            steps: Vec::new(),
            finish: 0.0,
            solving: 0.0,
            solved: None,
            duration: 0.0,
            skipped: 0,
            warnings: Vec::new(),
        }
    }

    /// Maps a log as the next session. `start`: its pose in the map, if given.
    fn with_log(mut self, path: &Path, start: Option<Pose2>) -> Result<Self, Failure> {
        let log = read_in_order(path)?;
        self.skipped += log.skipped;
        self.warnings.extend(skipped_warning(path, &log));
        self.slam = self.slam.begin_session(start);
        let mut is_mistaken = false;
        for scan in &log.scans {
            let begin = seconds();
            let effects = self.slam.step(scan).map_err(Failure::usage_at(path))?;
            self.steps.push(seconds() - begin);
            self.degenerate.push(effects.degenerate.is_some());
            is_mistaken |= start.is_some() && self.slam.is_searched_everywhere();
        }
        if !self.slam.is_located() {
            return Err(Failure::failed_at(path)(
                "no place of the older map was recognised with certainty: nothing was written",
            ));
        }
        let begin = seconds();
        let (solved, solving) = self.slam.finish_timed(&mut seconds).map_err(Failure::failed)?;
        self.finish += seconds() - begin;
        (self.solved, self.solving) = (Some(solved), solving);
        if is_mistaken {
            let found = self.trajectory_of_last(log.scans.len()).first().map(|(_, pose)| *pose);
            self.warnings.extend(found.map(|found| mistaken_start(path, found)));
        }
        if let (Some(first), Some(last)) = (log.scans.first(), log.scans.last()) {
            self.duration += last.stamp.secs_since(first.stamp);
        }
        self.scans.extend(log.scans);
        Ok(self)
    }

    /// Time, s, and pose of the last scans.
    fn trajectory_of_last(&self, scans: usize) -> Vec<(f64, Pose2)> {
        let all = self.slam.trajectory();
        all[all.len().saturating_sub(scans)..].to_vec()
    }
}

/// Processor time of this thread, s.
fn seconds() -> f64 {
    thread_time().as_secs_f64()
}

/// The map to continue: that of the session, or an empty one.
fn older(args: &SlamArgs) -> Result<Stored, Failure> {
    let stored = match &args.session {
        Some(path) if path.exists() => session::read(path)?,
        _ => Stored {
            slam: Slam::new(SlamSettings::default()),
            is_of_robot: false,
        },
    };
    match &args.session {
        Some(path) if args.start.is_some() && stored.slam.nodes().is_empty() => Err(Failure::not_found(format!(
            "{}: no such session: --start is a pose in the map of an existing one",
            path.display()
        ))),
        _ => Ok(stored),
    }
}

/// Maps logs one after another, continuing the session's map if there is one.
pub(super) fn map(args: &SlamArgs) -> Outcome {
    output::value(args.output, &mapped(args)?, Mapped::told)?;
    Ok(exit_code::OK)
}

fn mapped(args: &SlamArgs) -> Result<Mapped, Failure> {
    let relations = args.relations.as_deref().map(|path| {
        let text = files::text(path)?;
        read_relations(&text).map_err(Failure::usage_at(path))
    });
    let relations = relations.transpose()?;
    let Stored { slam, is_of_robot } = older(args)?;
    let known_sessions = if slam.nodes().is_empty() {
        0
    } else {
        slam.sessions().len()
    };
    let mut start = args
        .start
        .as_deref()
        .map(|start| Pose2::new(start[0], start[1], start[2]));
    let mut run = Run::new(slam);
    for path in &args.log {
        run = run.with_log(path, start.take())?;
    }
    let trajectory = run.trajectory_of_last(run.scans.len());
    let Run {
        mut slam,
        scans,
        degenerate,
        mut steps,
        finish,
        solving,
        solved,
        duration,
        skipped,
        mut warnings,
    } = run;
    // clap already requires a log.
    let solved = solved.ok_or_else(|| Failure::usage("expected --log"))?;
    let graph = Solved::new(slam.graph().poses().len(), &solved, 1e3 * solving);
    let trimmed = slam.trim().map_err(Failure::failed)?;
    let sessions = slam.sessions();
    let older_nodes = sessions.iter().take(known_sessions).sum();
    let mut placed = session::scans(&slam, 0..older_nodes);
    let first = placed.len();
    placed.extend(scans.iter().zip(&trajectory).map(|(scan, (_, pose))| Scan {
        odom_from_base: *pose,
        map_from_odom: Pose2::IDENTITY,
        ..scan.clone()
    }));
    let before: Vec<Pose2> = scans.iter().map(|scan| scan.odom_from_base).collect();
    let after: Vec<Pose2> = trajectory.iter().map(|(_, pose)| *pose).collect();
    let drawn = Drawn {
        slam: &slam,
        trajectory: &trajectory,
        placed: &placed,
        ways: Ways {
            before: &before,
            after: &after,
            degenerate: &degenerate,
        },
    };
    let out = args.out.as_deref().unwrap_or(Path::new("."));
    let map = written::write(out, args.resolution, &drawn)?;
    written::write_log(out, &placed[first..], &before)?;
    if let Some(path) = &args.session {
        if is_of_robot {
            let own = out.join("session.slam");
            session::write(&own, &slam)?;
            warnings.push(format!(
                "{}: left as it is, since a robot's mapping service keeps it; the continued session is {}",
                path.display(),
                own.display()
            ));
        } else {
            session::write(path, &slam)?;
        }
    }
    let odometry: Vec<(f64, Pose2)> = scans
        .iter()
        .map(|scan| (scan.stamp.as_secs(), scan.odom_from_base))
        .collect();
    let errors = |trajectory: &[_]| relations.as_ref().and_then(|known| relation_errors(trajectory, known));
    let total = steps.iter().sum::<f64>() + finish;
    steps.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * steps[((steps.len() - 1) as f64 * share).round() as usize];
    let counts = slam.counts();
    Ok(Mapped {
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
        relations: errors(&trajectory).zip(errors(&odometry)).map(told),
        map,
    })
}

impl Mapped {
    /// Summary.
    fn told(&self) -> String {
        let relations = self.relations.as_ref().map_or_else(String::new, |relations| {
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
        let sessions = if self.sessions.len() > 1 {
            let count = self.sessions.len();
            format!(
                "\nsessions: {count}, of {} nodes now, {} trimmed",
                self.sessions.iter().sum::<usize>(),
                self.trimmed
            )
        } else {
            String::new()
        };
        let warnings: String = self.warnings.iter().map(|w| format!("\nwarning: {w}")).collect();
        format!(
            "{}: {} scans at {:.2} ms, {:.0} x real time, {} submaps, {} closures found\n{}{sessions}{relations}{warnings}",
            self.map.display(),
            self.scans,
            self.cpu_ms_per_scan.mean,
            self.real_time_factor,
            self.submaps,
            self.closures.found,
            self.graph.told()
        )
    }
}

/// The scans of a log in time order, without those that go back.
pub(crate) fn read_in_order(path: &Path) -> Result<Ordered, Failure> {
    in_order(read_log(path)?).map_err(Failure::usage_at(path))
}

/// A warning about a log that is used nevertheless.
pub(crate) fn skipped_warning(path: &Path, log: &Ordered) -> Option<String> {
    let (number, stamp) = log.first_skipped?;
    Some(format!(
        "{}: {} of {} scans go back in time and were skipped, the first of them scan {number} at {stamp:.6} s",
        path.display(),
        log.skipped,
        log.skipped + log.scans.len()
    ))
}

/// A warning about a start that the scans do not confirm.
fn mistaken_start(path: &Path, found: Pose2) -> String {
    let Pose2 { x, y, yaw } = found;
    format!(
        "{}: the scans do not confirm --start: the whole map was searched, and the start found at {x:.2} {y:.2} {yaw:.2}",
        path.display()
    )
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use clap::Parser as _;

    use super::super::drive;
    use super::*;

    #[derive(clap::Parser)]
    struct Command {
        #[command(flatten)]
        slam: SlamArgs,
    }

    fn arguments(words: &[&str]) -> Result<SlamArgs, clap::Error> {
        let words = ["slam"].iter().chain(words);
        Command::try_parse_from(words).map(|command| command.slam)
    }

    #[test]
    fn the_log_with_corrected_poses_is_read_back_with_those_of_the_trajectory() {
        let folder = tempfile::tempdir().unwrap();
        let (log, out) = (folder.path().join("drive.log"), folder.path().join("out"));
        let scans = drive::scans(40);
        drive::write(&log, &scans);
        let words = ["--log", log.to_str().unwrap(), "--out", out.to_str().unwrap()];
        assert_eq!(mapped(&arguments(&words).unwrap()).unwrap().scans, 40);
        let written = read_log(&out.join("carmen.log")).unwrap();
        let trajectory = files::text(&out.join("trajectory.csv")).unwrap();
        assert_eq!(written.len(), trajectory.lines().count() - 1);
        for (scan, row) in written.iter().zip(trajectory.lines().skip(1)) {
            let numbers: Vec<f64> = row.split(',').map(|number| number.parse().unwrap()).collect();
            let pose = Pose2::new(numbers[1], numbers[2], numbers[3]);
            assert_eq!(scan.odom_from_base, pose, "at {} s", numbers[0]);
        }
        assert!(
            written
                .iter()
                .zip(&scans)
                .all(|(a, b)| a.ranges == b.ranges && a.stamp == b.stamp)
        );
        let text = files::text(&out.join("carmen.log")).unwrap();
        assert!(text.lines().all(|line| line.starts_with("FLASER 361 ")));
        let moved = written[39].odom_from_base.distance(&scans[39].odom_from_base);
        assert!(moved > 0.01, "odometry is 1 % off, and corrected by {moved} m");
    }

    #[test]
    fn a_robots_session_is_continued_beside_its_file() {
        let folder = tempfile::tempdir().unwrap();
        let [log, file, out] = ["drive.log", "slam.session", "out"].map(|name| folder.path().join(name));
        let scans = drive::scans(60);
        drive::write(&log, &scans);
        let mut slam = Slam::beside_a_robot(SlamSettings::default(), Pose2::IDENTITY);
        for scan in &scans {
            slam.step(scan).unwrap();
        }
        let bytes = [b"{\"frame\":1}\n".as_slice(), &slam.save().unwrap()].concat();
        std::fs::write(&file, &bytes).unwrap();
        let [log, session, to] = [&log, &file, &out].map(|path| path.to_str().unwrap());
        let words = [
            "--log",
            log,
            "--session",
            session,
            "--out",
            to,
            "--start",
            "0",
            "0",
            "0",
        ];
        let mapped = mapped(&arguments(&words).unwrap()).unwrap();
        assert_eq!((mapped.scans, mapped.sessions.len()), (60, 2));
        assert!(mapped.warnings[0].contains("session.slam"), "{:?}", mapped.warnings);
        assert_eq!(std::fs::read(&file).unwrap(), bytes, "the robot's file");
        assert!(!session::read(&out.join("session.slam")).unwrap().is_of_robot);
        let trajectory = files::text(&out.join("trajectory.csv")).unwrap();
        assert_eq!(trajectory.lines().count(), 61, "a pose for every scan");
    }

    #[test]
    fn a_start_is_a_pose_in_the_map_of_an_existing_session() {
        let words = |x| {
            [
                "--log",
                "a.log",
                "--out",
                "o",
                "--session",
                "none.slam",
                "--start",
                x,
                "0",
                "0",
            ]
        };
        assert!(arguments(&words("nan")).is_err());
        let args = arguments(&words("1.5")).unwrap();
        let refused = mapped(&args).unwrap_err();
        assert_eq!(refused.code, exit_code::NOT_FOUND);
        assert!(refused.message.starts_with("none.slam: no such session"), "{refused}");
    }

    #[test]
    fn two_logs_of_the_same_times_last_as_long_as_both_and_the_solve_is_part_of_the_finish() {
        let folder = tempfile::tempdir().unwrap();
        let log = folder.path().join("drive.log");
        drive::write(&log, &drive::scans(40));
        let once = Run::new(Slam::new(SlamSettings::default()))
            .with_log(&log, None)
            .unwrap();
        assert!((once.duration - 3.9).abs() < 1e-6, "{} s", once.duration);
        assert!(once.solving > 0.0 && once.solving < once.finish);
        let twice = once.with_log(&log, Some(Pose2::IDENTITY)).unwrap();
        assert!((twice.duration - 7.8).abs() < 1e-6, "{} s", twice.duration);
        assert_eq!((twice.warnings.len(), twice.degenerate.len()), (0, 80));
    }
}

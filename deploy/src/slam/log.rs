//! `zenav slam --log`. Map and poses from a log's scans and odometry alone.

use std::path::{Path, PathBuf};

use serde::Serialize;
use zenav_pose_graph::RobustSolution;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{
    Mended, Ordered, RelationErrors, Slam, SlamSettings, Spread, in_order, read_relations, relation_errors,
};

use super::SlamArgs;
use super::graph::Solved;
use super::picture::Ways;
use super::session::Stored;
use super::written::Drawn;
use super::{session, written};
use crate::arguments;
use crate::batch::thread_time;
use crate::failure::{Failure, Outcome};
use crate::inspect::read_log;
use crate::{files, output};

/// Output of `slam --log`.
#[derive(Debug, Serialize)]
struct Mapped {
    scans: usize,
    /// Scans that were left out because their stamps go back in time.
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
    /// Relations that do not count: their times lie beyond those of the log.
    outside: usize,
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

/// Odometry that advances by more than this, m and m/s, between two scans began anew in between.
const JUMP: (f64, f64) = (3.0, 10.0);
/// Longest time between two scans, s, over which odometry is taken to advance: over years, which lie between the times before and after a clock
/// was set, any advance would be slow.
const PAUSE: f64 = 10.0;

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
        let (log, warnings) = read_in_order(path)?;
        self.skipped += log.skipped;
        self.warnings.extend(warnings);
        self.slam = self.slam.begin_session(start);
        let mut is_mistaken = false;
        let mut before: Option<&Scan> = None;
        let mut jumps = Vec::new();
        for scan in &log.scans {
            if before.replace(scan).is_some_and(|before| has_jumped(before, scan)) {
                self.slam.interrupt(0);
                jumps.push(scan.stamp.as_secs());
            }
            let begin = seconds();
            let effects = self.slam.step(scan).map_err(Failure::usage_at(path))?;
            self.steps.push(seconds() - begin);
            self.degenerate.push(effects.degenerate.is_some());
            is_mistaken |= start.is_some() && self.slam.is_searched_everywhere();
        }
        self.warnings.extend(jumps.first().map(|first| {
            format!(
                "{}: odometry jumps {} times, first at {first:.6} s: the robot is searched for around its place before",
                path.display(),
                jumps.len()
            )
        }));
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

/// Whether odometry began anew between two scans: no robot drives that fast.
fn has_jumped(before: &Scan, scan: &Scan) -> bool {
    let way = before.odom_from_base.distance(&scan.odom_from_base);
    way > JUMP.0 && way > JUMP.1 * scan.stamp.secs_since(before.stamp).min(PAUSE)
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
    output::value(args.output, &mapped(args)?, Mapped::told)
}

fn mapped(args: &SlamArgs) -> Result<Mapped, Failure> {
    let start = args.start.as_deref().map(|start| arguments::pose("--start", start));
    let mut start = start.transpose()?;
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
    let mut run = Run::new(slam);
    for path in &args.log {
        run = run.with_log(path, start.take())?;
    }
    let trajectory = run.trajectory_of_last(run.scans.len());
    // clap already requires a log.
    let solved = run.solved.as_ref().ok_or_else(|| Failure::usage("expected --log"))?;
    let graph = Solved::new(run.slam.graph().poses().len(), solved, 1e3 * run.solving);
    let trimmed = run.slam.trim().map_err(Failure::failed)?;
    let sessions = run.slam.sessions();
    let older_nodes = sessions.iter().take(known_sessions).sum();
    let mut placed = session::scans(&run.slam, 0..older_nodes);
    let first = placed.len();
    placed.extend(run.scans.iter().zip(&trajectory).map(|(scan, (_, pose))| Scan {
        odom_from_base: *pose,
        map_from_odom: Pose2::IDENTITY,
        ..scan.clone()
    }));
    let before: Vec<Pose2> = run.scans.iter().map(|scan| scan.odom_from_base).collect();
    let after: Vec<Pose2> = trajectory.iter().map(|(_, pose)| *pose).collect();
    let drawn = Drawn {
        slam: &run.slam,
        trajectory: &trajectory,
        placed: &placed,
        ways: Ways {
            before: &before,
            after: &after,
            degenerate: &run.degenerate,
        },
    };
    let out = args.out.as_deref().unwrap_or(Path::new("."));
    let map = written::write(out, args.resolution, &drawn)?;
    written::write_log(out, &placed[first..], &before)?;
    if let Some(path) = &args.session {
        run.warnings.extend(keep(path, is_of_robot, out, &run.slam)?);
    }
    let odometry: Vec<(f64, Pose2)> = run
        .scans
        .iter()
        .map(|scan| (scan.stamp.as_secs(), scan.odom_from_base))
        .collect();
    let errors = |trajectory: &[_]| relations.as_ref().and_then(|known| relation_errors(trajectory, known));
    let measured = errors(&trajectory).zip(errors(&odometry));
    if let Some(known) = &relations {
        let count = measured.map(|(errors, _)| errors.count);
        run.warnings.extend(unmeasured(known.len(), count));
    }
    let (scans, total) = (run.scans.len(), run.steps.iter().sum::<f64>() + run.finish);
    run.steps.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * run.steps[((scans - 1) as f64 * share).round() as usize];
    let counts = run.slam.counts();
    Ok(Mapped {
        scans,
        skipped: run.skipped,
        scans_per_s: scans as f64 / total.max(1e-9),
        real_time_factor: run.duration / total.max(1e-9),
        cpu_ms_per_scan: Times {
            mean: 1e3 * total / scans as f64,
            p50: at(0.5),
            p99: at(0.99),
            finish: 1e3 * run.finish,
        },
        submaps: run.slam.submaps(),
        warnings: run.warnings,
        closures: Closures {
            searched: counts.searched,
            cut: counts.cut,
            found: counts.found,
        },
        graph,
        sessions,
        trimmed,
        relations: measured.map(told),
        map,
    })
}

/// Writes the continued session: to its file, or beside a robot's own. Returns a warning about the latter.
fn keep(path: &Path, is_of_robot: bool, out: &Path, slam: &Slam) -> Result<Option<String>, Failure> {
    if !is_of_robot {
        session::write(path, slam)?;
        return Ok(None);
    }
    let own = out.join("session.slam");
    session::write(&own, slam)?;
    Ok(Some(format!(
        "{}: left as it is, since a robot's mapping service keeps it; the continued session is {}",
        path.display(),
        own.display()
    )))
}

impl Mapped {
    /// Summary.
    fn told(&self) -> String {
        let relations = output::piece(self.relations.as_ref(), |relations| {
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
        let pace = pace(self.real_time_factor);
        format!(
            "{}: {} scans at {:.2} ms, {pace}{} submaps, {} closures found\n{}{sessions}{relations}{warnings}",
            self.map.display(),
            self.scans,
            self.cpu_ms_per_scan.mean,
            self.submaps,
            self.closures.found,
            self.graph.told()
        )
    }
}

/// The real-time factor in words, with the comma after it; nothing for a log without a duration.
fn pace(factor: f64) -> String {
    match factor {
        factor if factor >= 10.0 => format!("{factor:.0} x real time, "),
        factor if factor >= 0.005 => format!("{factor:.2} x real time, "),
        _ => String::new(),
    }
}

/// The scans of a log in the order in which they were driven, and warnings about what is wrong with it.
pub(crate) fn read_in_order(path: &Path) -> Result<(Ordered, Vec<String>), Failure> {
    let (scans, survey) = read_log(path)?;
    let log = in_order(scans).map_err(Failure::usage_at(path))?;
    // Every scan has a line.
    let line = |scan: usize| survey.line(scan).unwrap_or_default();
    let skipped = log.first_skipped.map(|(number, stamp)| {
        format!(
            "{} of {} scans go back in time and were skipped, the first of them scan {number} at {stamp:.6} s in line {}",
            log.skipped,
            log.skipped + log.scans.len(),
            line(number)
        )
    });
    let mended = log.mended.map(|mended| mended_warning(&mended, line(mended.number)));
    let all = survey.remarks().iter().cloned().chain(skipped).chain(mended);
    let warnings = all.map(|warning| format!("{}: {warning}", path.display())).collect();
    Ok((log, warnings))
}

/// A warning about a log whose clock was set back.
fn mended_warning(mended: &Mended, line: u64) -> String {
    let Mended {
        stamps: (before, after),
        times,
        is_sorted,
        ..
    } = mended;
    let done = if *is_sorted {
        "the scans were sorted by their times, in which odometry does not jump"
    } else {
        "no scan was skipped, and the times of later ones were moved ahead to run on from there"
    };
    format!(
        "line {line}: the time goes back from {before:.6} s to {after:.6} s, as it does {times} times in all: {done}"
    )
}

/// A warning about relations that do not count; `count`: of those that do.
fn unmeasured(relations: usize, count: Option<usize>) -> Option<String> {
    match count {
        None => Some("--relations: none of them lies within the times of the log, or these go back".to_owned()),
        Some(count) if count < relations => Some(format!(
            "--relations: {} of {relations} lie beyond the times of the log and do not count",
            relations - count
        )),
        Some(_) => None,
    }
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
        outside: errors.outside,
        translation_m: scaled(errors.translation, 1.0),
        rotation_deg: scaled(errors.rotation, degrees),
        odometry_translation_m: scaled(odometry.translation, 1.0),
        odometry_rotation_deg: scaled(odometry.rotation, degrees),
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::time::Stamp;

    use super::super::drive;
    use super::*;
    use crate::exit_code;

    fn arguments(line: &str) -> Result<SlamArgs, clap::Error> {
        crate::cli::parsed(&line.split(' ').collect::<Vec<_>>())
    }

    #[test]
    fn the_log_with_corrected_poses_is_read_back_with_those_of_the_trajectory() {
        let folder = tempfile::tempdir().unwrap();
        let (log, out) = (folder.path().join("drive.log"), folder.path().join("out"));
        let scans = drive::scans(40);
        drive::write(&log, &scans);
        let args = arguments(&format!("--log {} --out {}", log.display(), out.display()));
        assert_eq!(mapped(&args.unwrap()).unwrap().scans, 40);
        let (written, _) = read_log(&out.join("carmen.log")).unwrap();
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
        let args = arguments(&format!("--log {log} --session {session} --out {to} --start 0 0 0"));
        let mapped = mapped(&args.unwrap()).unwrap();
        assert_eq!((mapped.scans, mapped.sessions.len()), (60, 2));
        assert!(mapped.warnings[0].contains("session.slam"), "{:?}", mapped.warnings);
        assert_eq!(std::fs::read(&file).unwrap(), bytes, "the robot's file");
        assert!(!session::read(&out.join("session.slam")).unwrap().is_of_robot);
        let trajectory = files::text(&out.join("trajectory.csv")).unwrap();
        assert_eq!(trajectory.lines().count(), 61, "a pose for every scan");
    }

    #[test]
    fn a_slow_run_has_a_factor_and_a_log_without_a_duration_has_none() {
        let told = [123.4, 0.25, 0.0].map(pace);
        assert_eq!(told, ["123 x real time, ", "0.25 x real time, ", ""]);
    }

    #[test]
    fn a_start_is_a_pose_in_the_map_of_an_existing_session() {
        let starting = |x| arguments(&format!("--log a.log --out o --session none.slam --start {x} 0 0"));
        assert!(starting("nan").is_err());
        let turned = arguments("--log a.log --out o --session none.slam --start 0 0 90").unwrap();
        let refused = mapped(&turned).unwrap_err();
        assert!(refused.message.starts_with("--start: YAW 90: expected"), "{refused}");
        let refused = mapped(&starting("1.5").unwrap()).unwrap_err();
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

    #[test]
    fn odometry_that_begins_anew_while_the_clock_is_set_years_ahead_has_jumped() {
        let at = |secs: f64, x: f64| Scan {
            stamp: Stamp::from_secs(secs),
            ..zenav_fixtures::scan(0, Pose2::new(x, 0.0, 0.0), vec![1.0])
        };
        let before = at(10.0, 150.0);
        assert!(has_jumped(&before, &at(1.7e9, 0.0)));
        assert!(has_jumped(&before, &at(10.1, 140.0)));
        assert!(!has_jumped(&before, &at(70.0, 90.0)), "a minute without scans");
    }

    #[test]
    fn odometry_that_begins_anew_and_relations_by_another_clock_are_told() {
        let folder = tempfile::tempdir().unwrap();
        let [log, relations, out] = ["drive.log", "drive.relations", "out"].map(|name| folder.path().join(name));
        let mut scans = drive::scans(60);
        let restart = scans[45].odom_from_base;
        for scan in &mut scans[45..] {
            scan.odom_from_base = restart.inverse() * scan.odom_from_base;
        }
        drive::write(&log, &scans);
        std::fs::write(&relations, "1e6 1000001 0 0 0 0 0 0\n").unwrap();
        let [from, known, to] = [&log, &relations, &out].map(|path| path.to_str().unwrap());
        let args = arguments(&format!("--log {from} --relations {known} --out {to}"));
        let mapped = mapped(&args.unwrap()).unwrap();
        let [jump, unmeasured] = &mapped.warnings[..] else {
            panic!("{:?}", mapped.warnings);
        };
        assert!(jump.contains("odometry jumps 1 times, first at 14.5"), "{jump}");
        assert!(unmeasured.starts_with("--relations: none of them") && mapped.relations.is_none());
        let trajectory = files::text(&out.join("trajectory.csv")).unwrap();
        let last: Vec<f64> = trajectory
            .lines()
            .last()
            .unwrap()
            .split(',')
            .map(|x| x.parse().unwrap())
            .collect();
        // 59 steps of 8 cm.
        assert!((last[1] - 4.72).abs() < 0.1 && last[2].abs() < 0.1, "{last:?}");
    }

    #[test]
    fn a_log_whose_laser_stands_still_and_whose_clock_was_set_back_is_mapped_whole() {
        let folder = tempfile::tempdir().unwrap();
        let [log, out] = ["drive.log", "out"].map(|name| folder.path().join(name));
        let scans = drive::scans(60);
        let lines = scans.iter().enumerate().map(|(number, scan)| {
            let ranges: String = scan.ranges.iter().map(|range| format!(" {range}")).collect();
            let (way, secs) = (scan.odom_from_base.x, 10.0 + 0.1 * (number % 30) as f64);
            format!(
                "FLASER {}{ranges} 0 0 0 {way} 0 0 {secs} host {secs}\n",
                scan.ranges.len()
            )
        });
        std::fs::write(&log, lines.collect::<String>()).unwrap();
        let args = arguments(&format!("--log {} --out {}", log.display(), out.display()));
        let mapped = mapped(&args.unwrap()).unwrap();
        assert_eq!((mapped.scans, mapped.skipped), (60, 0));
        // Every other one of 60 scans 8 cm apart.
        assert!(mapped.sessions[0] >= 28, "{:?} nodes", mapped.sessions);
        let [still, back] = &mapped.warnings[..] else {
            panic!("{:?}", mapped.warnings);
        };
        assert!(still.contains("the laser's pose stands still"), "{still}");
        assert!(back.contains("line 31: the time goes back from 12.9"), "{back}");
    }
}

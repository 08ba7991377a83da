//! `zenav localise`. Poses of a recorded robot in a map, with their confidence.

use std::fmt::Write as _;
use std::path::{Path, PathBuf};

use nalgebra::{Point2, Vector2};
use serde::Serialize;
use zenav_localisation::{LocalisationSettings, Localiser, Located};
use zenav_mapping::{MapFileError, read_map};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Health, Scan};
use zenav_slam::Ordered;

use crate::arguments;
use crate::batch::thread_time;
use crate::drawing::canvas::Color;
use crate::drawing::plane::{DEGENERATE, Mark, Plane, ROBOT, UNKNOWN};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::Format;
use crate::slam::{drawn, read_in_order};
use crate::{files, output};

/// Colour of untrusted poses.
const UNSURE: Color = [215, 60, 40];
/// Pixels of the picture's longer side.
const SIZE: u32 = 1400;

/// Localise a recorded robot in a map.
///
/// The log's poses count as raw odometry. Without `--start` the first scan is searched for in the whole map. Times are processor times of
/// the thread, independent of other load on the machine.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav localise --map map/map.yaml --log drive.log.gz --out found\n  zenav localise --map house.slam --log drive.log.gz --start 0 0 0"
)]
pub struct LocaliseArgs {
    /// Map: a `map_server` description or image, or a SLAM session
    #[arg(long, value_name = "FILE")]
    map: PathBuf,
    /// CARMEN log of scans and raw odometry, compressed by gzip or not
    #[arg(long, value_name = "FILE")]
    log: PathBuf,
    /// Search for the robot in the whole map (the default)
    #[arg(long, conflicts_with = "start")]
    global: bool,
    /// Pose at the first scan, to within some decimetres: m, m, rad
    #[arg(long, num_args = 3, value_names = ["X", "Y", "YAW"], value_parser = arguments::finite)]
    start: Option<Vec<f64>>,
    /// Folder for trajectory.csv and localise.png
    #[arg(long, value_name = "DIR")]
    out: Option<PathBuf>,
    /// Side of a cell if the map does not give it, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = arguments::positive)]
    resolution: f64,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// What is printed.
#[derive(Debug, Serialize)]
struct Followed {
    scans: usize,
    /// Scans that were left out: their stamps go back in time, or are those of the scans before them.
    skipped: usize,
    warnings: Vec<String>,
    /// Number of scans by state of the localisation.
    tracking: usize,
    degraded: usize,
    searching: usize,
    lost: usize,
    ambiguous: usize,
    /// Scans at which a search of the whole map found the robot, and the first of them, s after the start of the log.
    found: usize,
    found_after_s: Option<f64>,
    /// Mean share of scan points that agree with the map, while the pose was trusted.
    agreeing: f64,
    /// Processor time per scan, searches included.
    cpu_ms_per_scan: Times,
    /// Last pose.
    last: Pose2,
}

/// Processor time, ms.
#[derive(Debug, Serialize)]
struct Times {
    mean: f64,
    p50: f64,
    p99: f64,
    max: f64,
}

/// One scan: its time, s, and its localisation.
type Step = (f64, Located);

/// Localises the robot of a log.
///
/// # Errors
/// Exit code 3 if a file is missing, 2 if it is bad, 1 if the robot was never found.
pub fn localise(args: &LocaliseArgs) -> Outcome {
    let followed = followed(args)?;
    output::value(args.output, &followed, Followed::told)?;
    Ok(if followed.tracking + followed.degraded == 0 {
        exit_code::FAILED
    } else {
        exit_code::OK
    })
}

/// The map of a file: a `map_server` or Moving AI map by its name, or a session by its content.
fn read(path: &Path, resolution: f64) -> Result<OccupancyGrid, Failure> {
    if !path.is_file() {
        return Err(Failure::not_found(format!("{}: no such map", path.display())));
    }
    match read_map(path, resolution) {
        Err(kind @ MapFileError::Kind { .. }) => {
            drawn(path, resolution)?.ok_or_else(|| Failure::usage(format!("{kind}, or a SLAM session")))
        }
        map => map.map_err(Failure::usage),
    }
}

fn followed(args: &LocaliseArgs) -> Result<Followed, Failure> {
    let start = args.start.as_deref().map(|start| arguments::pose("--start", start));
    let start = start.transpose()?;
    let map = read(&args.map, args.resolution)?;
    let (log, mut warnings) = read_in_order(&args.log)?;
    let (steps, mut times) = follow(&map, &log.scans, start);
    let Some((begun, _)) = steps.first() else {
        return Err(Failure::usage(format!(
            "{}: no scan of it makes sense",
            args.log.display()
        )));
    };
    if let Some(out) = &args.out {
        write(out, &map, &steps)?;
    }
    warnings.extend(repeated_warning(&args.log, &log, steps.len()));
    let count = |is: fn(&Health) -> bool| steps.iter().filter(|(_, located)| is(&located.health)).count();
    let trusted = steps.iter().filter(|(_, located)| located.health.is_trusted());
    let agreeing: Vec<f64> = trusted.map(|(_, located)| located.evidence.agreeing).collect();
    let first = steps.iter().find(|(_, located)| located.is_found_anew);
    times.sort_by(f64::total_cmp);
    let at = |share: f64| 1e3 * times[((times.len() - 1) as f64 * share).round() as usize];
    Ok(Followed {
        scans: steps.len(),
        skipped: log.skipped + log.scans.len() - steps.len(),
        warnings,
        tracking: count(|health| matches!(health, Health::Tracking)),
        degraded: count(|health| matches!(health, Health::Degraded { .. })),
        searching: count(|health| matches!(health, Health::Searching)),
        lost: count(|health| matches!(health, Health::Lost)),
        ambiguous: count(|health| matches!(health, Health::Ambiguous { .. })),
        found: steps.iter().filter(|(_, located)| located.is_found_anew).count(),
        found_after_s: first.map(|(stamp, _)| stamp - begun),
        agreeing: mean(&agreeing),
        cpu_ms_per_scan: Times {
            mean: 1e3 * mean(&times),
            p50: at(0.5),
            p99: at(0.99),
            max: at(1.0),
        },
        last: steps.last().map(|(_, located)| located.pose).unwrap_or_default(),
    })
}

/// A warning about the scans that were left out because of their stamps, though these do not go back.
fn repeated_warning(path: &Path, log: &Ordered, used: usize) -> Option<String> {
    let unused = log.scans.len() - used;
    (unused > 0).then(|| {
        format!(
            "{}: {unused} of {} scans have the stamp of the scan before them and were skipped",
            path.display(),
            log.skipped + log.scans.len()
        )
    })
}

impl Followed {
    /// Summary.
    fn told(&self) -> String {
        let found = output::piece(self.found_after_s, |secs| {
            format!("; found {} times, first after {secs:.1} s", self.found)
        });
        let warnings: String = self.warnings.iter().map(|w| format!("\nwarning: {w}")).collect();
        format!(
            "{} scans: {} tracking, {} degraded, {} searching, {} lost, {} ambiguous{found}\non average {:.0} % of a scan agrees with the map; {:.2} ms a scan, {:.0} ms at most; last at ({:.2}, {:.2}), {:.2} rad{warnings}",
            self.scans,
            self.tracking,
            self.degraded,
            self.searching,
            self.lost,
            self.ambiguous,
            100.0 * self.agreeing,
            self.cpu_ms_per_scan.mean,
            self.cpu_ms_per_scan.max,
            self.last.x,
            self.last.y,
            self.last.yaw
        )
    }
}

/// Localisation of each scan, and its processor time, s. A scan with the stamp of the scan before it is left out.
fn follow(map: &OccupancyGrid, scans: &[Scan], start: Option<Pose2>) -> (Vec<Step>, Vec<f64>) {
    let mut localiser = Localiser::new(LocalisationSettings::default(), map);
    if start.is_none() {
        localiser.lose();
    }
    let (mut steps, mut times) = (Vec::new(), Vec::new());
    for scan in scans {
        let guess = match start {
            Some(start) => start * scan.odom_from_base.inverse(),
            None => scan.map_from_odom,
        };
        let scan = Scan {
            map_from_odom: guess,
            ..scan.clone()
        };
        let begun = thread_time();
        if let Some(located) = localiser.step(&scan) {
            times.push(thread_time().saturating_sub(begun).as_secs_f64());
            steps.push((scan.stamp.as_secs(), located));
        }
    }
    (steps, times)
}

/// Writes the trajectory and its picture into a folder.
fn write(out: &Path, map: &OccupancyGrid, steps: &[Step]) -> Result<(), Failure> {
    std::fs::create_dir_all(out).map_err(Failure::failed_at(out))?;
    let mut rows = "t,x,y,yaw,health\n".to_owned();
    for (stamp, located) in steps {
        let Pose2 { x, y, yaw } = located.pose;
        let health = match located.health {
            Health::Tracking => "tracking",
            Health::Degraded { .. } => "degraded",
            Health::Searching => "searching",
            Health::Lost => "lost",
            Health::Ambiguous { .. } => "ambiguous",
            Health::Unchecked => "unchecked",
            Health::Contradicted => "contradicted",
        };
        // Writing to a string cannot fail.
        let _ = writeln!(rows, "{stamp},{x},{y},{yaw},{health}");
    }
    files::write(&out.join("trajectory.csv"), rows)?;
    let spec = map.spec();
    let margin = Vector2::repeat(0.02 * (spec.upper() - spec.origin).amax());
    let mut plane = Plane::new(
        spec.origin - margin,
        spec.upper() + margin,
        SIZE,
        "Localisation",
        UNKNOWN,
    )?;
    plane.map(map);
    // A stretch ends where the health changes, and where the robot is found at another place.
    let mut stretch: Vec<Point2<f64>> = Vec::new();
    let mut color = ROBOT;
    for (_, located) in steps {
        let now = color_of(&located.health);
        if now != color || located.is_found_anew {
            plane.polyline(&stretch, color, 1.5);
            let end = stretch.last().copied().filter(|_| !located.is_found_anew);
            stretch = end.into_iter().collect();
            color = now;
        }
        stretch.push(located.pose.position());
    }
    plane.polyline(&stretch, color, 1.5);
    plane.map_legend();
    plane.gap();
    plane.legend(Mark::Line, ROBOT, "trajectory");
    plane.legend(Mark::Line, DEGENERATE, "degenerate stretch");
    plane.legend(Mark::Line, UNSURE, "lost or ambiguous");
    files::write(&out.join("localise.png"), plane.finish()?.png()?)
}

/// The mean; zero of nothing.
fn mean(values: &[f64]) -> f64 {
    // The sum of nothing is -0.
    values.iter().sum::<f64>() / values.len().max(1) as f64 + 0.0
}

fn color_of(health: &Health) -> Color {
    match health {
        Health::Tracking => ROBOT,
        Health::Degraded { .. } => DEGENERATE,
        _ => UNSURE,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::slam::drive;

    fn arguments(map: &Path, log: &Path) -> LocaliseArgs {
        let [map, log] = [map, log].map(|path| path.to_str().unwrap());
        crate::cli::parsed(&["--map", map, "--log", log, "--start", "0", "0", "0"]).unwrap()
    }

    #[test]
    fn a_start_in_degrees_is_refused_before_the_files_are_read() {
        let args = crate::cli::parsed(&["--map", "m.yaml", "--log", "a.log", "--start", "0", "0", "90"]).unwrap();
        let refused = followed(&args).unwrap_err();
        assert!(refused.message.starts_with("--start: YAW 90: expected"), "{refused}");
    }

    #[test]
    fn a_mean_of_nothing_is_zero_without_a_sign() {
        assert_eq!((mean(&[]).to_string(), mean(&[1.0, 2.0])), ("0".to_owned(), 1.5));
    }

    #[test]
    fn a_robot_is_localised_in_a_session_and_scans_out_of_order_are_counted() {
        let folder = tempfile::tempdir().unwrap();
        let [session, log, other] = ["room.slam", "drive.log", "notes.txt"].map(|name| folder.path().join(name));
        let mut scans = drive::scans(40);
        std::fs::write(&session, drive::mapped(&scans).save().unwrap()).unwrap();
        drive::write(&log, &scans);
        let found = followed(&arguments(&session, &log)).unwrap();
        assert_eq!((found.scans, found.skipped, found.warnings.len()), (40, 0, 0));
        assert!(found.tracking + found.degraded > 20, "{found:?}");
        // One stamp goes back, and one is repeated.
        scans[10].stamp = scans[3].stamp;
        scans[21].stamp = scans[20].stamp;
        drive::write(&log, &scans);
        let found = followed(&arguments(&session, &log)).unwrap();
        assert_eq!((found.scans, found.skipped), (38, 2));
        let [back, repeated] = &found.warnings[..] else {
            panic!("{found:?}");
        };
        assert!(back.contains("1 of 40 scans go back in time and were skipped, the first of them scan 11 at"));
        assert!(repeated.ends_with("1 of 40 scans have the stamp of the scan before them and were skipped"));
        assert!(
            found
                .told()
                .ends_with(&format!("\nwarning: {back}\nwarning: {repeated}"))
        );
        scans.reverse();
        drive::write(&log, &scans);
        let refused = followed(&arguments(&session, &log)).unwrap_err();
        assert!(refused.message.ends_with("sort the log by its stamps"), "{refused}");
        std::fs::write(&other, "no map").unwrap();
        let refused = followed(&arguments(&other, &log)).unwrap_err();
        assert!(
            refused
                .message
                .ends_with("expected a map: .yaml, .pgm, .png or .map, or a SLAM session"),
            "{refused}"
        );
    }
}

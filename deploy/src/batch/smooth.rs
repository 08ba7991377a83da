//! `zenav smooth`: a batch of queries for one robot, from search to time law. Reports for each the trajectory, the time of each phase, and
//! whether it is free of collisions.

use std::f64::consts::PI;
use std::path::{Path, PathBuf};
use std::time::Instant;

use nalgebra::Point2;
use zenav_planning::{PlanOptions, Planner, Searcher, plan};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{DrivingProfile, PlanOutcome};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::trajectory::TrajectoryPoint;
use zenav_smoothing::{
    Cuts, Outcome as Smoothing, Piece, SmoothQuery, SmoothedPieces, SmoothingSettings, pieces, shortcut, smooth_pieces,
};
use zenav_space::{ConfigurationSpace, UnknownPolicy};

use super::queries::{self, Query};
use super::watchdog::{Watchdog, timed};
use super::{Results, folder, median, planner, progress};
use crate::arguments::positive;
use crate::completion;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;

/// Largest time step between rows of a trajectory, s.
const PERIOD: f64 = 0.01;

/// Offline smoothing.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav smooth --map kitchen.yaml --queries queries.txt --robot tiago\n  zenav smooth --map kitchen.yaml --queries queries.txt --robot tiago --trajectory driven --profile economy\n\nQueries are lines `sx sy gx gy [optimum]` in cells of the map file as it is written (rows from the top), or a Moving AI .scen; the robot starts at rest, heading along its path. \
Results are lines `search_us corridor_us geometry_us timing_us length_m duration_s min_clearance_m status`, status `smoothed`, `fallback:REASON` (the path as stop, turn and go), `no_trajectory:REASON` (not even that is free of collisions) or `no_path`; for the last two, length, duration and clearance are -1. A clearance of `inf` means nothing near."
)]
pub struct SmoothArgs {
    /// Map: .yaml, .pgm, .png, .map
    #[arg(long, value_name = "M")]
    map: PathBuf,
    /// Queries
    #[arg(long, value_name = "Q")]
    queries: PathBuf,
    /// Robot: a file or shipped name
    #[arg(long, value_name = "R", add = completion::models())]
    robot: String,
    /// Results; `-` prints them
    #[arg(long, value_name = "F", default_value = "-")]
    out: PathBuf,
    /// File of keep-out and speed zones, m in the map's frame
    #[arg(long, value_name = "FILE")]
    zones: Option<PathBuf>,
    /// Write each trajectory into a file of this folder (0000.csv, …): `t,x,y,yaw,v,w,a,alpha`, m and s in the map's frame
    #[arg(long, value_name = "DIR")]
    trajectory: Option<PathBuf>,
    /// Planner
    #[arg(long, default_value = "astar", value_parser = planner, add = completion::planners())]
    planner: Planner,
    /// Plan the shortest path, without a preference for clearance from obstacles
    #[arg(long)]
    shortest: bool,
    /// Time limit of a search, ms
    #[arg(long, value_name = "MS", value_parser = positive)]
    time_limit_ms: Option<f64>,
    /// Jerk limit along the path, m/s³ [default: the robot's, or unlimited]
    #[arg(long, value_name = "J", value_parser = positive)]
    jerk_limit: Option<f64>,
    /// Objective of the time law, `fastest` or `economy`
    #[arg(long, default_value = "fastest")]
    profile: DrivingProfile,
    /// Treat unknown cells as free
    #[arg(long)]
    unknown_is_free: bool,
    /// Side of a cell if the map does not give it, m
    #[arg(long, value_name = "M", value_parser = positive)]
    resolution: Option<f64>,
}

/// Smooths all queries of a file.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for missing files, [`exit_code::USAGE`] for bad ones.
pub fn smooth(args: &SmoothArgs) -> Outcome {
    let mut model = files::robot(&args.robot)?;
    model.drive.max_jerk = args.jerk_limit.or(model.drive.max_jerk);
    let grid = files::map_at(&args.map, args.resolution)?;
    let queries = queries::read(&args.queries)?;
    let zones = files::zones(args.zones.as_deref())?;
    let policy = UnknownPolicy::of(args.unknown_is_free);
    let space = ConfigurationSpace::with_zones(&grid, &model.footprint, policy, 0.0, &zones);
    let searcher = Searcher::new(space.free()).map_err(Failure::usage_at(&args.map))?;
    let mut options = if args.shortest {
        PlanOptions::shortest(args.planner)
    } else {
        PlanOptions {
            planner: args.planner,
            ..PlanOptions::default()
        }
    };
    options.any_heading = true;
    let mut pipeline = Pipeline {
        space,
        searcher,
        model,
        options,
        profile: args.profile,
        settings: SmoothingSettings::default(),
        watchdog: args.time_limit_ms.and_then(Watchdog::of_millis),
        start: Instant::now(),
    };
    folder(args.trajectory.as_deref())?;
    let mut results = Results::create(&args.out)?;
    let mut tally = Tally::default();
    let bar = progress(queries.len());
    for (number, query) in queries.iter().enumerate() {
        let (search_us, smoothed) = pipeline.answer(query);
        results.line(format_args!("{}", line(search_us, smoothed.as_ref())))?;
        if let Some(folder) = &args.trajectory {
            write_trajectory(&folder.join(format!("{number:04}.csv")), smoothed.as_ref())?;
        }
        tally.add(smoothed.as_ref());
        bar.inc(1);
    }
    bar.finish_and_clear();
    results.finish()?;
    crate::output::note(format_args!("{}", tally.summary()));
    Ok(exit_code::OK)
}

/// One map, one robot, and the state of search and smoothing.
struct Pipeline {
    space: ConfigurationSpace,
    searcher: Searcher,
    model: RobotModel,
    options: PlanOptions,
    profile: DrivingProfile,
    settings: SmoothingSettings,
    watchdog: Option<Watchdog>,
    start: Instant,
}

impl Pipeline {
    /// Search time, µs, and trajectory; `None` without a path.
    fn answer(&mut self, query: &Query) -> (f64, Option<SmoothedPieces>) {
        let spec = *self.space.spec();
        let Some((from, to)) = query.cells(&spec) else {
            return (0.0, None);
        };
        let pose = |cell| {
            let center = spec.center(cell);
            Pose2::new(center.x, center.y, 0.0)
        };
        let (start, goal) = (pose(from), pose(to));
        let (planned, search_us) = timed(self.watchdog.as_ref(), |budget| {
            plan(&self.space, &mut self.searcher, start, goal, &self.options, budget)
        });
        let PlanOutcome::Found { path, .. } = planned.outcome else {
            return (search_us, None);
        };
        // On the road a robot may leave a place that the map says is too narrow; a query from inside an obstacle makes no sense.
        if self.space.clearance(start.position()) <= self.model.footprint.inscribed_radius() {
            return (search_us, None);
        }
        let driven = self.driven(start.position(), &path, &planned.backwards);
        (search_us, Some(driven))
    }

    /// The trajectory along a path from its start (m), with these legs driven backwards.
    fn driven(&self, start: Point2<f64>, path: &[Point2<f64>], backwards: &[usize]) -> SmoothedPieces {
        let cuts = Cuts { backwards, via: &[] };
        // A query has no heading: the robot starts along its path.
        let first = pieces(path, &cuts).into_iter().next();
        let yaw = first.and_then(|piece| self.first_heading(start, &piece)).unwrap_or(0.0);
        let asked = SmoothQuery {
            path,
            start: Pose2::new(start.x, start.y, yaw),
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
            profile: self.profile,
        };
        let mut clock = || self.start.elapsed().as_secs_f64();
        smooth_pieces(
            &self.space,
            &asked,
            &cuts,
            &self.model,
            &self.settings,
            None,
            &mut clock,
        )
    }

    /// Heading in which the robot drives the first leg of a piece, rad, after the corners due to the grid are removed; `None` if it has no
    /// length.
    fn first_heading(&self, start: Point2<f64>, piece: &Piece) -> Option<f64> {
        let turned = piece.backwards.then(|| self.space.turned());
        let space = turned.as_ref().unwrap_or(&self.space);
        let corners = shortcut(space, &piece.path, self.settings.corridor.clearance, None, None);
        let mut ways = corners.iter().map(|point| point - start);
        let along = ways.find(|along| along.norm() > 0.0)?;
        let yaw = along.y.atan2(along.x);
        Some(if piece.backwards { yaw + PI } else { yaw })
    }
}

fn line(search_us: f64, smoothed: Option<&SmoothedPieces>) -> String {
    let Some(smoothed) = smoothed else {
        return format!("{search_us:.3} 0 0 0 -1 -1 -1 no_path");
    };
    let statistics = &smoothed.statistics;
    let us = |ms: f64| format!("{:.3}", 1e3 * ms);
    let (result, status) = match &smoothed.outcome {
        Smoothing::Unsmoothed(reason) if smoothed.is_empty() => {
            ("-1 -1 -1".to_owned(), format!("no_trajectory:{reason}"))
        }
        outcome => (
            format!(
                "{} {} {}",
                statistics.length,
                statistics.duration,
                statistics.min_clearance.unwrap_or(f64::INFINITY)
            ),
            outcome.to_string(),
        ),
    };
    // A reason of several words would break the columns.
    let status = status.split_whitespace().collect::<Vec<_>>().join("_");
    format!(
        "{search_us:.3} {} {} {} {result} {status}",
        us(statistics.corridor_ms),
        us(statistics.geometry_ms),
        us(statistics.timing_ms),
    )
}

fn write_trajectory(path: &Path, smoothed: Option<&SmoothedPieces>) -> Result<(), Failure> {
    let mut file = Results::create(path)?;
    file.line(format_args!("{},a,alpha", TrajectoryPoint::CSV_HEADER))?;
    for state in smoothed.map(|smoothed| smoothed.states(PERIOD)).unwrap_or_default() {
        file.line(format_args!("{},{},{}", state.point, state.a, state.alpha))?;
    }
    file.finish()
}

/// Results of all queries.
#[derive(Default)]
struct Tally {
    queries: usize,
    found: usize,
    smooth: usize,
    solving: Vec<f64>,
}

impl Tally {
    fn add(&mut self, smoothed: Option<&SmoothedPieces>) {
        self.queries += 1;
        if let Some(smoothed) = smoothed {
            self.found += 1;
            self.smooth += usize::from(smoothed.is_smooth());
            self.solving
                .push(smoothed.statistics.corridor_ms + smoothed.statistics.geometry_ms);
        }
    }

    fn summary(&self) -> String {
        let mut text = format!("{} of {} found, {} smoothed", self.found, self.queries, self.smooth);
        if !self.solving.is_empty() {
            text.push_str(&format!(
                ", corridor and geometry median {:.2} ms",
                median(self.solving.clone())
            ));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use zenav_smoothing::Fallback;

    use super::*;

    #[test]
    fn a_path_that_cannot_be_driven_at_all_has_no_trajectory_and_no_length() {
        let blocked = SmoothedPieces {
            outcome: Smoothing::Unsmoothed(Fallback::Collision),
            ..SmoothedPieces::default()
        };
        assert_eq!(
            line(1.5, Some(&blocked)),
            "1.500 0.000 0.000 0.000 -1 -1 -1 no_trajectory:collision"
        );
        let here = SmoothedPieces::default();
        assert_eq!(line(1.5, Some(&here)), "1.500 0.000 0.000 0.000 0 0 inf smoothed");
    }

    #[test]
    fn a_leg_that_is_planned_backwards_is_driven_backwards() {
        let model = files::robot("tiago").unwrap();
        let grid = zenav_fixtures::free_map(zenav_fixtures::spec(100, 60, 0.05));
        let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Blocked, 0.0);
        let pipeline = Pipeline {
            searcher: Searcher::new(space.free()).unwrap(),
            space,
            model,
            options: PlanOptions::default(),
            profile: DrivingProfile::Fastest,
            settings: SmoothingSettings::default(),
            watchdog: None,
            start: Instant::now(),
        };
        // Two metres along x, and one metre back.
        let path = [1.0, 3.0, 2.0].map(|x| Point2::new(x, 1.5));
        let driven = pipeline.driven(path[0], &path, &[1]);
        let states = driven.states(PERIOD);
        assert!(states.windows(2).all(|pair| pair[0].point.t < pair[1].point.t));
        assert!(
            states.iter().all(|state| state.point.yaw.abs() < 1e-6),
            "it never turns round"
        );
        let least = states.iter().map(|state| state.point.v).fold(0.0, f64::min);
        assert!(least < -0.1 && (states[states.len() - 1].point.x - 2.0).abs() < 1e-6);
        assert!(line(1.0, Some(&driven)).starts_with("1.000 "));
        // Backwards from the start on: the robot looks away from its goal.
        let states = pipeline.driven(path[1], &path[1..], &[0]).states(PERIOD);
        assert!(
            states
                .iter()
                .all(|state| state.point.v <= 0.0 && state.point.yaw.abs() < 1e-6)
        );
    }

    #[test]
    fn each_query_gives_a_line_and_a_trajectory_that_reads_back() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        let rows = vec![".".repeat(80); 60].join("\n");
        std::fs::write(
            path("m.map"),
            format!("type octile\nheight 60\nwidth 80\nmap\n{rows}\n"),
        )
        .unwrap();
        std::fs::write(path("q.txt"), "20 20 60 40\n20 20 20 20\n0 0 200 0\n").unwrap();
        let (map, queries, out, trajectory) = (path("m.map"), path("q.txt"), path("f.txt"), path("t"));
        let line = format!(
            "--map {map} --queries {queries} --robot tiago --resolution 0.05 --out {out} --trajectory {trajectory}"
        );
        let args = crate::cli::parsed(&line.split(' ').collect::<Vec<_>>()).unwrap();
        assert_eq!(smooth(&args).unwrap(), exit_code::OK);
        let lines: Vec<String> = std::fs::read_to_string(path("f.txt"))
            .unwrap()
            .lines()
            .map(str::to_owned)
            .collect();
        assert_eq!(lines.len(), 3);
        assert!(lines.iter().all(|line| line.split(' ').count() == 8), "{lines:?}");
        let ends = |line: usize, status: &str| lines[line].ends_with(status);
        assert!(
            (ends(0, " smoothed") || lines[0].contains(" fallback:")) && ends(2, " no_path"),
            "{lines:?}"
        );
        let text = std::fs::read_to_string(path("t/0000.csv")).unwrap();
        let mut rows = text.lines();
        assert_eq!(rows.next(), Some("t,x,y,yaw,v,w,a,alpha"));
        let rows: Vec<Vec<f64>> = rows
            .map(|row| row.split(',').map(|word| word.parse().unwrap()).collect())
            .collect();
        assert!(rows.windows(2).all(|pair| pair[1][0] - pair[0][0] <= PERIOD + 1e-12));
        // Cell (20, 20) from the top of 60 rows is row 39 from the bottom.
        assert!(
            (rows[0][1] - 1.025).abs() < 1e-9 && (rows[0][2] - 1.975).abs() < 1e-9,
            "{:?}",
            rows[0]
        );
        assert_eq!(std::fs::read_to_string(path("t/0002.csv")).unwrap().lines().count(), 1);
    }
}

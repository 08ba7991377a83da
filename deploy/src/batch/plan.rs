//! `zenav plan`: a batch of planning queries on one map. Reports for each whether a path was found, its length, and the search time.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use nalgebra::Point2;
use zenav_planning::{Budget, NotFound, Planner, Query as Question, Searched, Searcher};
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_space::{BitGrid, ConfigurationSpace, PointLineOfSight, UnknownPolicy, Zones};

use super::queries::{self, Query};
use super::watchdog::{Watchdog, timed};
use super::{Results, folder, median, planner, progress};
use crate::arguments::{self, positive};
use crate::completion;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::listed;

/// Most samples for improving a path within a time limit: about 100 MB.
const MOST_SAMPLES: u64 = 1_000_000;
/// Relative difference within which a path counts as optimal.
const SAME: f64 = 1e-4;
/// Most queries that the summary lists.
const LISTED: usize = 10;

/// Offline planning.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav plan --map kitchen.yaml --queries queries.txt --robot tiago\n  zenav plan --map den312d.map --queries den312d.map.scen --planner jps --out results.txt\n\nQueries are lines `sx sy gx gy [optimum]` in cells of the map file as it is written (rows from the top), or a Moving AI .scen. \
Results are lines `time_us length found expansions` in the same order, lengths in cells, found 0 with length -1: the summary tells searches that ended at their limit from those that have no path. Without --robot the robot is a point: no corner is cut, a diagonal step costs the square root of two."
)]
pub struct PlanArgs {
    /// Map: .yaml, .pgm, .png, .map
    #[arg(long, value_name = "M")]
    map: PathBuf,
    /// Queries
    #[arg(long, value_name = "Q")]
    queries: PathBuf,
    /// Planner
    #[arg(long, default_value = "astar", value_parser = planner, add = completion::planners())]
    planner: Planner,
    /// Results; `-` prints them
    #[arg(long, value_name = "R", default_value = "-")]
    out: PathBuf,
    /// Write each path into a file of this folder (0000.txt, …): lines `x y`, every cell of straight and diagonal legs, the ends of other
    /// legs, which any-angle and sampling planners have; centres of cells are whole numbers
    #[arg(long, value_name = "DIR")]
    paths: Option<PathBuf>,
    /// Inflate the map for this robot: a file or shipped name
    #[arg(long, value_name = "R", add = completion::models())]
    robot: Option<String>,
    /// File of keep-out and speed zones, m in the map's frame
    #[arg(long, value_name = "FILE")]
    zones: Option<PathBuf>,
    /// Time limit of a search, ms. Without one, `rrt_star` improves a path with 20000 more samples, and every sampling-based planner ends
    /// after 1000000
    #[arg(long, value_name = "MS", value_parser = positive)]
    time_limit_ms: Option<f64>,
    /// Seed of sampling-based planners
    #[arg(long, default_value_t = 1, value_parser = arguments::whole::<u64>)]
    seed: u64,
    /// Treat unknown cells as free
    #[arg(long)]
    unknown_is_free: bool,
    /// Side of a cell if the map does not give it, m
    #[arg(long, value_name = "M", value_parser = positive)]
    resolution: Option<f64>,
}

/// Runs all queries of a file.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for missing files, [`exit_code::USAGE`] for bad ones.
pub fn plan(args: &PlanArgs) -> Outcome {
    let grid = files::map_at(&args.map, args.resolution)?;
    let queries = queries::read(&args.queries)?;
    let zones = files::zones(args.zones.as_deref())?;
    let space = PlanningSpace::of(&grid, args.robot.as_deref(), args.unknown_is_free, &zones)?;
    let spec = *grid.spec();
    let ends: Vec<Option<Ends>> = queries.iter().map(|query| ends(query, &grid)).collect();
    drop(grid);
    let mut searcher = Searcher::new(space.free()).map_err(Failure::usage_at(&args.map))?;
    let watchdog = args.time_limit_ms.and_then(Watchdog::of_millis);
    if watchdog.is_some() {
        searcher.sampling.improving = MOST_SAMPLES;
    }
    folder(args.paths.as_deref())?;
    let mut results = Results::create(&args.out)?;
    let mut tally = Tally {
        unknown_is_free: args.unknown_is_free,
        ..Tally::default()
    };
    let bar = progress(queries.len());
    for (number, (query, ends)) in queries.iter().zip(ends).enumerate() {
        let answer = answer(&mut searcher, &space, args, &spec, query, watchdog.as_ref());
        let (length, found) = answer.found.as_ref().map_or((-1.0, 0), |found| (found.length, 1));
        tally.add(number, query, ends, &answer);
        results.line(format_args!(
            "{:.3} {length} {found} {}",
            answer.micros, answer.expansions
        ))?;
        if let Some(folder) = &args.paths {
            write_path(
                &folder.join(format!("{number:04}.txt")),
                &spec,
                answer.found.as_ref().ok(),
            )?;
        }
        bar.inc(1);
    }
    bar.finish_and_clear();
    results.finish()?;
    crate::output::note(format_args!(
        "{} (planner {}, seed {})",
        tally.summary(),
        args.planner,
        args.seed
    ));
    Ok(exit_code::OK)
}

/// Space in which a point, or a robot, is planned.
enum PlanningSpace {
    Point { free: BitGrid, sight: PointLineOfSight },
    Robot(Box<ConfigurationSpace>),
}

impl PlanningSpace {
    fn of(
        grid: &OccupancyGrid,
        robot: Option<&str>,
        unknown_is_free: bool,
        zones: &Arc<Zones>,
    ) -> Result<Self, Failure> {
        if let Some(robot) = robot {
            let model = files::robot(robot)?;
            let policy = UnknownPolicy::of(unknown_is_free);
            let space = ConfigurationSpace::with_zones(grid, &model.footprint, policy, 0.0, zones);
            return Ok(Self::Robot(Box::new(space)));
        }
        let spec = grid.spec();
        let keep_out = zones.keep_out_cells(spec).unwrap_or_default();
        let free = BitGrid::from_fn(spec.width, spec.height, |cell| match Occupancy::of(grid[cell]) {
            _ if keep_out.is_set(cell) => false,
            Occupancy::Free => true,
            Occupancy::Unknown => unknown_is_free,
            Occupancy::Occupied => false,
        });
        Ok(Self::Point {
            sight: PointLineOfSight::new(&free),
            free,
        })
    }

    fn free(&self) -> &BitGrid {
        match self {
            Self::Point { free, .. } => free,
            Self::Robot(space) => space.free(),
        }
    }

    fn search(&self, searcher: &mut Searcher, planner: Planner, question: &Question, budget: Budget<'_>) -> Searched {
        match self {
            Self::Point { sight, .. } => searcher.search(planner, sight, question, budget),
            Self::Robot(space) => searcher.search(planner, &**space, question, budget),
        }
    }
}

/// What the map says of the start and of the goal.
type Ends = [Occupancy; 2];

/// What the map says of the ends of a query; none if one of them is outside.
fn ends(query: &Query, grid: &OccupancyGrid) -> Option<Ends> {
    let (start, goal) = query.cells(grid.spec())?;
    Some([start, goal].map(|cell| Occupancy::of(grid[cell])))
}

/// Result of one query.
struct Answer {
    /// Time of the search alone, µs.
    micros: f64,
    found: Result<zenav_planning::Path, NotFound>,
    expansions: u64,
}

fn answer(
    searcher: &mut Searcher,
    space: &PlanningSpace,
    args: &PlanArgs,
    spec: &GridSpec,
    query: &Query,
    watchdog: Option<&Watchdog>,
) -> Answer {
    let Some((start, goal)) = query.cells(spec) else {
        return Answer {
            micros: 0.0,
            found: Err(NotFound::OutOfMap),
            expansions: 0,
        };
    };
    let center = |cell: Cell| Point2::new(f64::from(cell.x) + 0.5, f64::from(cell.y) + 0.5);
    let question = Question {
        start: center(start),
        goal: center(goal),
        seed: args.seed,
    };
    let (searched, micros) = timed(watchdog, |budget| {
        space.search(searcher, args.planner, &question, budget)
    });
    Answer {
        micros,
        found: searched.result,
        expansions: searched.expansions,
    }
}

/// The path in cells of the map file, rows from the top, integers at cell centres: every cell on a straight or diagonal leg, the ends of
/// any other leg. An empty file if no path was found.
fn write_path(path: &Path, spec: &GridSpec, found: Option<&zenav_planning::Path>) -> Result<(), Failure> {
    let mut file = Results::create(path)?;
    for point in found.map(points).unwrap_or_default() {
        let [x, y] = [point.x - 0.5, f64::from(spec.height) - 0.5 - point.y];
        file.line(format_args!("{x} {y}"))?;
    }
    file.finish()
}

fn points(found: &zenav_planning::Path) -> Vec<Point2<f64>> {
    let mut points: Vec<Point2<f64>> = found.corners.iter().take(1).copied().collect();
    for leg in found.corners.windows(2) {
        let step = leg[1] - leg[0];
        let steps = step.x.abs().max(step.y.abs());
        let along_grid = step.x == 0.0 || step.y == 0.0 || step.x.abs() == step.y.abs();
        if along_grid && steps.fract() == 0.0 {
            // A step is a whole cell, so every point is exact.
            let step = step / steps;
            points.extend((1..=steps as u64).map(|nth| leg[0] + step * nth as f64));
        } else {
            points.push(leg[1]);
        }
    }
    points
}

/// Results of all queries.
#[derive(Default)]
struct Tally {
    queries: usize,
    found: usize,
    outside: usize,
    /// Whether unknown cells count as free.
    unknown_is_free: bool,
    /// Numbers of queries by what is wrong with their start or goal.
    blocked: BTreeMap<String, usize>,
    /// Numbers of the queries whose search ended at its limit.
    limited: Vec<usize>,
    times: Vec<f64>,
    known: usize,
    optimal: usize,
}

impl Tally {
    fn add(&mut self, number: usize, query: &Query, ends: Option<Ends>, answer: &Answer) {
        self.queries += 1;
        match &answer.found {
            Ok(found) => {
                self.found += 1;
                self.times.push(answer.micros);
                if let Some(optimum) = query.optimum {
                    self.known += 1;
                    self.optimal += usize::from(found.length - optimum <= SAME * optimum.max(1.0));
                }
            }
            Err(NotFound::OutOfMap) => self.outside += 1,
            Err(NotFound::TimedOut) => self.limited.push(number),
            Err(NotFound::StartBlocked) => self.add_blocked("start", ends.map(|[start, _]| start)),
            Err(NotFound::GoalBlocked) => self.add_blocked("goal", ends.map(|[_, goal]| goal)),
            Err(NotFound::NoPath | NotFound::TooLong) => {}
        }
    }

    /// Counts a query with a start or a goal that is not free.
    fn add_blocked(&mut self, end: &str, value: Option<Occupancy>) {
        let why = match value {
            Some(Occupancy::Occupied) => "on an occupied cell",
            Some(Occupancy::Unknown) if !self.unknown_is_free => "on an unknown cell",
            _ => "too close to an obstacle or in a keep-out zone",
        };
        *self.blocked.entry(format!("{end} {why}")).or_default() += 1;
    }

    fn summary(&self) -> String {
        let mut text = format!("{} of {} found", self.found, self.queries);
        if !self.times.is_empty() {
            text.push_str(&format!(", median {:.1} us", median(self.times.clone())));
        }
        if self.known > 0 {
            text.push_str(&format!(
                ", {} of {} no longer than the known optimum",
                self.optimal, self.known
            ));
        }
        for (why, count) in &self.blocked {
            text.push_str(&format!("; {count} with the {why}"));
        }
        if self.outside > 0 {
            text.push_str(&format!(
                "; {} reach outside the map and count as not found",
                self.outside
            ));
        }
        if !self.limited.is_empty() {
            let more = if self.limited.len() > LISTED { ", …" } else { "" };
            text.push_str(&format!(
                "; {} ended at the limit, so there may be a path: number {}{more} (the first is 0)",
                self.limited.len(),
                listed(self.limited.iter().take(LISTED))
            ));
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::cli::parsed;

    /// A room of 4 by 4 with a pillar; rows from the top.
    const MAP: &str = "type octile\nheight 4\nwidth 4\nmap\n....\n.@..\n....\n...@\n";

    fn run(map: &str, queries: &str, more: &[&str]) -> (Result<u8, Failure>, Vec<Vec<f64>>, tempfile::TempDir) {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name).display().to_string();
        std::fs::write(path("m.map"), map).unwrap();
        std::fs::write(path("q.txt"), queries).unwrap();
        let (m, q, r, p) = (path("m.map"), path("q.txt"), path("r.txt"), path("paths"));
        let words = ["--map", &m, "--queries", &q, "--out", &r, "--paths", &p];
        let outcome = plan(&parsed(&[&words, more].concat()).unwrap());
        let lines = std::fs::read_to_string(&r).unwrap_or_default();
        let rows = lines
            .lines()
            .map(|line| line.split(' ').map(|word| word.parse().unwrap()).collect())
            .collect();
        (outcome, rows, folder)
    }

    #[test]
    fn every_query_has_its_line_in_order() {
        let (outcome, rows, folder) = run(MAP, "0 0 2 2\n0 0 0 0\n0 0 1 1\n0 0 9 9\n-1 0 0 0\n3 3 0 0\n", &[]);
        assert_eq!(outcome.unwrap(), exit_code::OK);
        // Around the pillar without cutting its corner; start = goal; into the pillar; twice outside; from within a wall.
        let lengths: Vec<f64> = rows.iter().map(|row| row[1]).collect();
        assert_eq!(lengths, [4.0, 0.0, -1.0, -1.0, -1.0, -1.0]);
        assert_eq!(
            rows.iter().map(|row| row[2]).collect::<Vec<_>>(),
            [1.0, 1.0, 0.0, 0.0, 0.0, 0.0]
        );
        let path = std::fs::read_to_string(folder.path().join("paths/0000.txt")).unwrap();
        let cells: Vec<&str> = path.lines().collect();
        assert_eq!((cells[0], cells[cells.len() - 1], cells.len()), ("0 0", "2 2", 5));
        assert_eq!(
            std::fs::read_to_string(folder.path().join("paths/0002.txt")).unwrap(),
            ""
        );
    }

    #[test]
    fn every_cell_of_a_long_path_is_a_whole_number() {
        let rows = vec![".".repeat(611); 3].join("\n");
        let map = format!("type octile\nheight 3\nwidth 611\nmap\n{rows}\n");
        let (outcome, _, folder) = run(&map, "1 0 610 2\n", &[]);
        assert_eq!(outcome.unwrap(), exit_code::OK);
        let path = std::fs::read_to_string(folder.path().join("paths/0000.txt")).unwrap();
        let columns: Vec<u32> = path
            .lines()
            .map(|line| line.split(' ').next().unwrap().parse().unwrap())
            .collect();
        assert_eq!(columns, (1..=610).collect::<Vec<u32>>());
    }

    #[test]
    fn ways_lead_around_closed_zones_and_bad_zones_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let zones = folder.path().join("z.toml").display().to_string();
        // The map's cells are 1 m wide, its origin is below its last row: the zone is in the lower half of the second column.
        std::fs::write(&zones, "[[keep_out]]\npoints = [[1.2, 0.2], [1.8, 0.2], [1.5, 1.8]]\n").unwrap();
        let open = "type octile\nheight 4\nwidth 4\nmap\n....\n....\n....\n....\n";
        let (outcome, rows, _folder) = run(open, "0 3 2 3\n1 3 0 0\n", &["--zones", &zones]);
        assert_eq!(outcome.unwrap(), exit_code::OK);
        assert_eq!((rows[0][1], rows[1][2]), (6.0, 0.0));
        std::fs::write(&zones, "[[keep_out]]\npoints = [[1.2, 0.2]]\n").unwrap();
        let failure = run(open, "0 3 2 3\n", &["--zones", &zones]).0.unwrap_err();
        assert!(
            failure.code == exit_code::USAGE && failure.message.contains("z.toml:2: `keep_out.points`"),
            "{failure}"
        );
        let failure = run(open, "0 3 2 3\n", &["--zones", "nowhere.toml"]).0.unwrap_err();
        assert_eq!(failure.code, exit_code::NOT_FOUND);
    }

    #[test]
    fn without_a_time_limit_a_search_ends_by_its_samples() {
        // A pillar on the straight line: no path is as short as the bound, so only the limit ends the search.
        let map = format!(
            "type octile\nheight 3\nwidth 3\nmap\n{}\n",
            ["...", ".@.", "..."].join("\n")
        );
        let (outcome, rows, _folder) = run(&map, "0 1 2 1\n", &["--planner", "rrt_star"]);
        assert_eq!(outcome.unwrap(), exit_code::OK);
        let expansions = rows[0][3];
        assert!(
            rows[0][2] == 1.0 && expansions > 20_000.0 && expansions < 30_000.0,
            "{expansions}"
        );
        let help = <PlanArgs as clap::Args>::augment_args(clap::Command::new("plan")).render_long_help();
        let limits = zenav_planning::PlanningSettings::default();
        for limit in [limits.sampling.improving, limits.max_samples] {
            assert!(help.to_string().contains(&limit.to_string()), "{help}");
        }
    }

    #[test]
    fn a_search_that_ended_at_its_limit_is_told_from_one_without_a_path() {
        let mut tally = Tally::default();
        let query = Query {
            start: [0, 0],
            goal: [1, 1],
            optimum: None,
        };
        for (number, why) in [NotFound::NoPath, NotFound::TimedOut, NotFound::OutOfMap]
            .into_iter()
            .enumerate()
        {
            let answer = Answer {
                micros: 1.0,
                found: Err(why),
                expansions: 1,
            };
            tally.add(number, &query, None, &answer);
        }
        assert_eq!(
            tally.summary(),
            "0 of 3 found; 1 reach outside the map and count as not found; \
             1 ended at the limit, so there may be a path: number 1 (the first is 0)"
        );
    }

    #[test]
    fn a_start_or_a_goal_that_is_not_free_is_told_with_what_the_map_has_there() {
        use Occupancy::{Free, Occupied, Unknown};
        let query = Query {
            start: [0, 0],
            goal: [1, 1],
            optimum: None,
        };
        let told = |unknown_is_free| {
            let mut tally = Tally {
                unknown_is_free,
                ..Tally::default()
            };
            for (why, ends) in [
                (NotFound::StartBlocked, [Unknown, Free]),
                (NotFound::StartBlocked, [Unknown, Occupied]),
                (NotFound::GoalBlocked, [Free, Occupied]),
                (NotFound::GoalBlocked, [Free, Free]),
            ] {
                let answer = Answer {
                    micros: 1.0,
                    found: Err(why),
                    expansions: 0,
                };
                tally.add(0, &query, Some(ends), &answer);
            }
            tally.summary()
        };
        assert_eq!(
            told(false),
            "0 of 4 found; 1 with the goal on an occupied cell; 1 with the goal too close to an obstacle or in a keep-out zone; \
             2 with the start on an unknown cell"
        );
        let of_unknown = "; 2 with the start too close to an obstacle or in a keep-out zone";
        assert!(told(true).ends_with(of_unknown), "{}", told(true));
        let grid = OccupancyGrid::filled(zenav_fixtures::spec(2, 2, 1.0), Occupancy::UNKNOWN);
        assert_eq!(ends(&query, &grid), Some([Unknown, Unknown]));
    }

    #[test]
    fn a_map_of_one_cell_and_a_time_limit_are_fine() {
        let (outcome, rows, _folder) = run(
            "type octile\nheight 1\nwidth 1\nmap\n.\n",
            "0 0 0 0\n",
            &["--time-limit-ms", "1000", "--robot", "tiago"],
        );
        assert_eq!(outcome.unwrap(), exit_code::OK);
        assert_eq!(rows.len(), 1);
    }

    #[test]
    fn bad_files_are_named() {
        let (outcome, ..) = run("type octile\nheight 3\nwidth 4\nmap\n....\n", "0 0 1 1\n", &[]);
        assert_eq!(outcome.unwrap_err().code, exit_code::USAGE);
        let (outcome, ..) = run(MAP, "0 0 one 1\n", &[]);
        let failure = outcome.unwrap_err();
        assert!(
            failure.code == exit_code::USAGE && failure.message.contains("line 1"),
            "{failure}"
        );
        assert!(
            parsed::<PlanArgs>(&["--map", "m", "--queries", "q", "--planner", "magic"])
                .unwrap_err()
                .to_string()
                .contains("astar")
        );
    }
}

//! Suites. The worlds in which driving is judged: generated from seeds, with the shipped robots unchanged.
//!
//! | file | answers |
//! |---|---|
//! | `barn` | the worlds in a folder of BARN (S1) |
//! | `floor` | how is a world built? |
//! | `people` | moving people (S2, S3, S4) |
//! | `places` | narrow and cluttered places (S5, S6) |
//! | `patience` | obstacles that leave again (S7) |
//! | `whereabouts` | localisation without GPS and compass (S8) |
//! | `broken` | broken sensors (S9) |
//! | `cost` | processor time on long paths (S12) |
//! | `robots` | other robots (S11) |

mod barn;
mod broken;
mod cost;
mod floor;
mod patience;
mod people;
mod places;
mod robots;
mod whereabouts;

use std::ops::Range;
use std::path::Path;

use clap::ValueEnum;
use nalgebra::Point2;
use rand::SeedableRng as _;
use rand_pcg::Pcg64Mcg;
use zenav_cloud::mapping::PoseSource;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_reference_drivers::Method;
use zenav_sim::World;

use crate::failure::Failure;
use crate::files;
pub(super) use barn::score;
use floor::Floor;

/// Robots of a suite without a list of its own.
const ROBOTS: [&str; 4] = ["tiago", "jackal", "turtlebot3_waffle", "neato"];
/// Time limit of a run, s, and per second of the straight path.
const TIME: [f64; 2] = [60.0, 6.0];

/// A suite of the benchmark.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(super) enum Suite {
    /// Worlds of BARN in a folder: `--worlds DIR`
    S1,
    /// Open field among discs on random polylines
    S2,
    /// Blind walkers: crowds, crossing, oncoming, a blind corner
    S3,
    /// People who make way: crossing, oncoming, overtaken, in a door, at a corner, in a group
    S4,
    /// Tight doors, dead ends, goals beside walls
    S5,
    /// Clutter, a trap and an office, unknown and known
    S6,
    /// Obstacles that leave again: a person in a door, a sliding door, an occupied goal, a slow person ahead
    S7,
    /// Without GPS and compass: an office and a hall, known and unknown
    S8,
    /// Broken sensors: lost, late, noisy, dead
    S9,
    /// Processor time on long paths in a known map
    S12,
    /// Several robots: swap places, cross, meet on a circle, meet in a lane
    S11,
}

impl Suite {
    /// Robots of the suite, unless others are named.
    fn robots(self) -> &'static [&'static str] {
        match self {
            Self::S1 | Self::S2 => &["jackal"],
            Self::S8 => &whereabouts::ROBOTS,
            _ => &ROBOTS,
        }
    }

    /// All cases of the suite in order: seeds from `first` on, `count` of them or the suite's usual number, with `robots` or the suite's
    /// own. S1 needs a folder of worlds and a noise of ranges (standard deviation, m); without them it has no cases.
    ///
    /// # Errors
    /// A folder without worlds, an unknown robot; never for generated worlds.
    pub(super) fn cases(
        self,
        robots: &[String],
        first: u64,
        count: Option<u64>,
        barn: Option<(&Path, f64)>,
    ) -> Result<Vec<Case>, Failure> {
        let seeds = |usual: u64| first..first + count.unwrap_or(usual);
        let own: Vec<String> = self.robots().iter().map(|&name| name.to_owned()).collect();
        let robots = if robots.is_empty() { &own } else { robots };
        match self {
            Self::S1 => barn.map_or_else(
                || Ok(Vec::new()),
                |(folder, noise)| barn::barn(folder, noise, robots, seeds(1)),
            ),
            Self::S2 => people::field(robots, seeds(20)),
            Self::S3 => people::encounters(robots, seeds(3)),
            Self::S5 => places::tight(robots, seeds(3)),
            Self::S6 => places::rooms(robots, seeds(3)),
            Self::S4 => people::manners(robots, seeds(4)),
            Self::S7 => patience::patience(robots, seeds(3)),
            Self::S8 => whereabouts::whereabouts(robots, seeds(3)),
            Self::S9 => broken::broken(robots, seeds(2)),
            Self::S12 => cost::cost(robots, seeds(1)),
            Self::S11 => robots::robots(robots, seeds(1)),
        }
    }
}

/// Another robot of the same kind: start and goal, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Other {
    pub start: Pose2,
    pub goal: Point2<f64>,
}

/// One run: a world, a robot, a goal and a seed.
pub(super) struct Case {
    /// Suite and scenario, as in the table.
    pub scenario: String,
    /// Scenario, robot and seed.
    pub name: String,
    /// Text of the world file.
    pub text: String,
    /// The world.
    pub world: World,
    /// Robot by shipped name or file, with its options.
    pub robot: String,
    /// Model of that robot.
    pub model: RobotModel,
    /// Goal, m.
    pub goal: Point2<f64>,
    /// Other robots.
    pub others: Vec<Other>,
    /// Distance that counts as reached, m; `None`: the deployment's.
    pub tolerance: Option<f64>,
    /// Whether the robot starts with the true map.
    pub known_map: bool,
    /// Source of mapping's poses; `None`: the deployment's.
    pub poses: Option<PoseSource>,
    /// Seed of all noise.
    pub seed: u64,
    /// Anchors that drive the case too, in worlds with moving discs.
    pub anchors: &'static [Method],
    /// Name of the run without this one's fault.
    pub faultless: Option<String>,
    /// Time at which the lidar dies, s.
    pub blind_from: Option<f64>,
    /// Time at which the obstacle starts to leave, s.
    pub leaves_at: Option<f64>,
    /// Whether processor time is measured.
    pub is_costed: bool,
    /// Whether the run gets a BARN score.
    pub is_scored: bool,
    /// Length of the optimal path, m, if known.
    pub optimal: Option<f64>,
    /// Time limit, simulated, s.
    pub timeout: f64,
}

impl Case {
    fn new(scenario: &str, robot: &str, seed: u64, floor: Floor, goal: [f64; 2]) -> Result<Self, Failure> {
        let name = Self::name(scenario, robot, seed);
        let text = floor.text(&name);
        let world =
            World::from_toml(&text, &name, &|_| Err("a made world has no map".to_owned())).map_err(Failure::failed)?;
        Self::within(scenario, name, robot, seed, text, world, goal.into())
    }

    /// A run in a world; `text` is the world's file.
    fn within(
        scenario: &str,
        name: String,
        robot: &str,
        seed: u64,
        text: String,
        world: World,
        goal: Point2<f64>,
    ) -> Result<Self, Failure> {
        let model = files::robot(robot)?;
        let straight = (world.start().position() - goal).norm() / model.drive.top_speed();
        // A robot without GPS gets its poses from SLAM.
        let poses = model.gps.is_none().then_some(PoseSource::Slam);
        Ok(Self {
            scenario: scenario.to_owned(),
            name,
            text,
            world,
            robot: robot.to_owned(),
            model,
            goal,
            others: Vec::new(),
            tolerance: None,
            known_map: false,
            poses,
            seed,
            anchors: match scenario.split(' ').next() {
                Some("S2" | "S3") => &Method::ALL,
                Some("S4") => &Method::AMONG_PEOPLE_WHO_REACT,
                _ => &[],
            },
            faultless: None,
            blind_from: None,
            leaves_at: None,
            is_costed: false,
            is_scored: false,
            optimal: None,
            timeout: (TIME[0] + TIME[1] * straight).round(),
        })
    }

    /// The same run with the true map from the start.
    fn knowing_the_map(mut self) -> Self {
        self.known_map = true;
        self.poses = self.poses.map(|_| PoseSource::Localise);
        self
    }

    /// Name of a run: the scenario without its suite, the robot, and the seed.
    fn name(scenario: &str, robot: &str, seed: u64) -> String {
        let label = scenario.split_once(' ').map_or(scenario, |(_, name)| name);
        let words = label
            .split(|character: char| !character.is_ascii_alphanumeric())
            .filter(|word| !word.is_empty());
        // For a robot file only its stem: the run's name is used as a file name too.
        let parts = robot
            .split('+')
            .map(|part| Path::new(part).file_stem().unwrap_or_default().to_string_lossy());
        let robot = parts.collect::<Vec<_>>().join("+");
        format!("{}-{robot}-{seed}", words.collect::<Vec<_>>().join("-"))
    }

    /// The command for this run, beside its world file.
    pub(super) fn command(&self) -> String {
        let Self {
            name,
            robot,
            goal,
            seed,
            timeout,
            ..
        } = self;
        let tolerance = self
            .tolerance
            .map_or_else(String::new, |metres| format!(" --tolerance {metres}"));
        let known = if self.known_map { " --known-map" } else { "" };
        let poses = match self.poses {
            None => "",
            Some(PoseSource::Edge) => " --poses edge",
            Some(PoseSource::Slam) => " --poses slam",
            Some(PoseSource::Localise) => " --poses localise",
        };
        let mut goals = format!("--goal {} {}", goal.x, goal.y);
        if !self.others.is_empty() {
            let start = self.world.start();
            goals = format!("--start {} {} {} {goals}", start.x, start.y, start.yaw);
        }
        for Other { start, goal } in &self.others {
            let other = format!(
                " --start {} {} {} --goal {} {}",
                start.x, start.y, start.yaw, goal.x, goal.y
            );
            goals.push_str(&other);
        }
        format!(
            "zenav run --world {name}.toml --robot {robot} {goals} --seed {seed} --timeout {timeout}{tolerance}{known}{poses}"
        )
    }

    /// The world file, with the command for this run.
    pub(super) fn file(&self) -> String {
        format!("# {}\n{}", self.command(), self.text)
    }
}

/// Generates a scenario's world, and the goal in it, m.
type Make = fn(&mut Pcg64Mcg) -> (Floor, [f64; 2]);

/// One case for every scenario, robot and seed.
fn each(scenarios: &[(&str, Make)], robots: &[String], seeds: &Range<u64>) -> Result<Vec<Case>, Failure> {
    let mut cases = Vec::new();
    for (scenario, make) in scenarios {
        for robot in robots {
            for seed in seeds.clone() {
                let (floor, goal) = make(&mut rng(scenario, seed));
                cases.push(Case::new(scenario, robot, seed, floor, goal)?);
            }
        }
    }
    Ok(cases)
}

/// Random numbers for a scenario's worlds.
fn rng(scenario: &str, seed: u64) -> Pcg64Mcg {
    // FNV-1a: the same on every machine, and independent between scenarios.
    let name = scenario.bytes().fold(0xcbf2_9ce4_8422_2325_u64, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    });
    Pcg64Mcg::seed_from_u64(name ^ seed)
}

/// Extent of a robot ahead of its centre and behind it, m.
fn ends(model: &RobotModel) -> [f64; 2] {
    match &model.footprint {
        Footprint::Radius(radius) => [*radius; 2],
        Footprint::Polygon(corners) => {
            [1.0, -1.0].map(|way| corners.iter().map(|corner| way * corner.x).fold(0.0, f64::max))
        }
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn a_seed_makes_the_same_worlds_where_robot_and_goal_have_room() {
        for suite in Suite::value_variants() {
            let (cases, again) = (
                suite.cases(&[], 0, Some(2), None).unwrap(),
                suite.cases(&[], 0, Some(2), None).unwrap(),
            );
            let mut names: Vec<&str> = cases.iter().map(|case| case.name.as_str()).collect();
            names.sort_unstable();
            names.dedup();
            assert_eq!(names.len(), cases.len(), "{suite:?}: names");
            for (case, again) in cases.iter().zip(&again) {
                assert_eq!(case.file(), again.file());
                let start = case.world.clearance(&case.model.footprint, case.world.start());
                let disc = Footprint::Radius(case.model.footprint.inscribed_radius());
                let room = |goal: Point2<f64>| case.world.clearance(&disc, Pose2::new(goal.x, goal.y, 0.0));
                let goal = room(case.goal);
                assert!(start > 0.01 && goal > 0.01, "{}: {start} {goal}", case.name);
                for other in &case.others {
                    let start = case.world.clearance(&case.model.footprint, other.start);
                    assert!(start > 0.01 && room(other.goal) > 0.01, "{}: {other:?}", case.name);
                }
            }
        }
    }
}

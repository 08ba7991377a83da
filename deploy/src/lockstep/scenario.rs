//! Scenario. Drives one goal in a world, or one per robot, from a seed to the end.

use std::path::{Path, PathBuf};

use nalgebra::Point2;
use zenav_cloud::mapping::{PoseSettings, PoseSource, annotations_of};
use zenav_mission::MissionConfig;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::id::{Id, InvalidId};
use zenav_protocol::messages::{Annotations, DrivingProfile, GoalPhase, GoalRequest, GoalState};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::MissionRequest;
use zenav_sim::{RobotSpec, Simulation, Truth, World};

use super::closed_loop::{ClosedLoop, ClosedLoopConfig, RobotLoop};
use super::command::{RunOutcome, RunReport};
use super::recorder::Recorder;
use super::referee::Referee;
use crate::components::{edge_config, places};
use crate::config::Layers;
use crate::failure::Failure;
use crate::files;
use crate::report::per_metre;

/// Name of the robot in a run; with several robots, followed by a number.
const ROBOT: &str = "robot";
/// Largest side of a known map, cells.
const MAX_CELLS: f64 = 16_384.0;
/// Time for the mission's own steps, s: searches take no simulated time.
const COMPUTING: f64 = 0.1;
/// Time for a robot to come to rest after its mission has ended, s.
const SETTLING: f64 = 5.0;
/// Longest that a record goes on until the missions have ended the goals that their robots have reached, s.
const ENDING: f64 = 10.0;

/// A robot and its goal; `None` means the deployment's value.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Entrant<'a> {
    /// A robot of the deployment by name, a robot file or a shipped name.
    pub robot: Option<&'a str>,
    /// Start pose; `None`: the deployment's, otherwise the world's.
    pub start: Option<Pose2>,
    /// Goal, m in the world.
    pub goal: Point2<f64>,
}

/// A world, the robots in it and their goals; `None` means the deployment's value.
pub(crate) struct Scenario<'a> {
    pub world: &'a World,
    /// One or more robots.
    pub entrants: Vec<Entrant<'a>>,
    /// Seed of all noise and delays.
    pub seed: Option<u64>,
    /// Whether the robots start with the true map.
    pub known_map: bool,
    /// Source of mapping's poses.
    pub poses: Option<PoseSource>,
    pub zones: Option<&'a Path>,
    /// Mean delay from scan to plan, ms.
    pub cloud_delay_ms: f64,
    /// Distance that counts as reached, m.
    pub tolerance: Option<f64>,
    pub profile: Option<DrivingProfile>,
    /// Time limit, simulated, s.
    pub timeout: f64,
}

/// One robot and its progress.
struct Going {
    referee: Referee,
    /// Energy of the full battery, J.
    capacity: f64,
    /// When its mission ended, s.
    mission_ended: Option<f64>,
    report: Option<RunReport>,
}

/// A scenario whose inputs are all read and checked.
pub(crate) struct Prepared<'a> {
    scenario: &'a Scenario<'a>,
    seed: u64,
    names: Vec<Id>,
    /// Places and zones, the same for all robots.
    annotations: Annotations,
    all: Vec<Going>,
    stage: ClosedLoop,
}

impl Prepared<'_> {
    /// Runs until every robot is done, with a record if one is wanted; `see` is called after every tick with each robot's number and ground
    /// truth. Returns one report per robot, in order: its state when it was done, with all contacts to the end of the run.
    pub(crate) fn run(
        self,
        mut recorder: Option<&mut Recorder>,
        mut see: impl FnMut(usize, Stamp, &Truth),
    ) -> Vec<RunReport> {
        let Self {
            scenario,
            seed,
            names,
            annotations,
            mut all,
            mut stage,
        } = self;
        if let Some(recorder) = recorder.as_deref_mut() {
            for name in &names {
                recorder.annotate(name.as_str(), &annotations);
            }
        }
        while all.iter().any(|going| going.report.is_none()) {
            match recorder.as_deref_mut() {
                None => stage.tick(),
                Some(recorder) => recorder.tick(&mut stage, &names),
            }
            let now = stage.now();
            for (index, (going, robot)) in all.iter_mut().zip(&stage.robots).enumerate() {
                let truth = stage.truth(index);
                see(index, now, &truth);
                going.referee.watch(now, &truth);
                if going.report.is_none()
                    && let Some((outcome, reason)) = scenario.end(going, robot, &truth, now.as_secs())
                {
                    going.report = Some(scenario.report(going, robot, &truth, seed, outcome, reason));
                }
            }
        }
        let is_reached = |report: &RunReport| report.outcome == RunOutcome::Reached;
        let reached: Vec<bool> = all
            .iter()
            .map(|going| going.report.as_ref().is_some_and(is_reached))
            .collect();
        let reports = all.into_iter().enumerate().filter_map(|(index, going)| {
            let report = going.report?;
            Some(judged(report, &going.referee, &stage.truth(index)))
        });
        let reports = reports.collect();
        if let Some(recorder) = recorder {
            // A mission learns later than the referee that its robot has reached the goal.
            let until = stage.now().as_secs() + ENDING;
            let is_open = |(robot, reached): (&RobotLoop, &bool)| {
                *reached && !robot.goal().is_some_and(|goal| goal.state.is_end())
            };
            while stage.now().as_secs() < until && stage.robots.iter().zip(&reached).any(is_open) {
                recorder.tick(&mut stage, &names);
            }
        }
        reports
    }
}

impl<'a> Scenario<'a> {
    /// A scenario of the first seed, otherwise with the deployment's values.
    #[cfg(test)]
    pub(super) fn of(world: &'a World, entrants: Vec<Entrant<'a>>, timeout: f64) -> Self {
        Self {
            world,
            entrants,
            seed: Some(1),
            known_map: false,
            poses: None,
            zones: None,
            cloud_delay_ms: 100.0,
            tolerance: None,
            profile: None,
            timeout,
        }
    }

    /// Reads and checks all inputs.
    ///
    /// # Errors
    /// Invalid robots, zones or starts.
    pub(crate) fn prepare(&'a self, layers: &Layers) -> Result<Prepared<'a>, Failure> {
        let indices = 0..self.entrants.len();
        let entrants = indices.zip(&self.entrants);
        let configs: Vec<ClosedLoopConfig> = entrants
            .map(|(index, entrant)| self.closed_loop(layers, index, entrant))
            .collect::<Result<_, _>>()?;
        let mut specs = Vec::new();
        let mut all = Vec::new();
        let mut requests = Vec::new();
        for (config, entrant) in configs.iter().zip(&self.entrants) {
            let (model, tolerance) = (
                &config.edge.model,
                self.tolerance.unwrap_or(config.mission.settings.tolerance),
            );
            specs.push(RobotSpec {
                id: config.edge.robot.clone(),
                model: model.clone(),
                start: config.edge.start,
            });
            all.push(Going {
                referee: Referee::new(entrant.goal, tolerance, model.footprint.circumscribed_radius()),
                capacity: model.battery.capacity,
                mission_ended: None,
                report: None,
            });
            requests.push(MissionRequest::Goal(GoalRequest {
                id: Some("run".to_owned()),
                x: Some(entrant.goal.x),
                y: Some(entrant.goal.y),
                tolerance: Some(tolerance),
                profile: self.profile,
                ..GoalRequest::default()
            }));
        }
        let seed = configs.first().map_or(0, |config| config.seed);
        let simulation = Simulation::new(self.world, specs, seed).map_err(|error| Failure::usage(error.to_string()))?;
        let names = configs.iter().map(|config| config.edge.robot.clone()).collect();
        let mission = configs.first().map(|config| &config.mission);
        let annotations = mission.map(|mission| annotations_of(mission.places.clone(), &mission.zones));
        let mut stage = ClosedLoop::new(simulation, configs);
        for (robot, request) in stage.robots.iter_mut().zip(requests) {
            robot.ask(request);
        }
        Ok(Prepared {
            scenario: self,
            seed,
            names,
            annotations: annotations.unwrap_or_default(),
            all,
            stage,
        })
    }

    /// Whether a robot is done, with outcome and reason.
    fn end(
        &self,
        going: &mut Going,
        robot: &RobotLoop,
        truth: &Truth,
        now: f64,
    ) -> Option<(RunOutcome, Option<String>)> {
        let referee = &going.referee;
        if referee.is_reached() {
            return Some((RunOutcome::Reached, None));
        }
        if let Some(Err(refusal)) = robot.replies().first() {
            return Some((RunOutcome::Rejected, Some(refusal.to_string())));
        }
        // With an empty battery the robot will not move again.
        if truth.drawn_j >= going.capacity && referee.is_at_rest() {
            return Some((RunOutcome::Aborted, Some("the battery is empty".to_owned())));
        }
        if let Some(state) = robot.goal().filter(|state| state.state.is_end()) {
            let since = *going.mission_ended.get_or_insert(now);
            if referee.is_at_rest() || now - since >= SETTLING {
                return Some(ending(state, referee.error()));
            }
        }
        (now >= self.timeout).then(|| {
            let step = robot.goal().map_or("not begun", |goal| goal.feedback.step.as_str());
            let left = referee.error();
            let reason = format!(
                "{left:.2} m from the goal after {} s; the mission: {step}",
                self.timeout
            );
            (RunOutcome::Timeout, Some(reason))
        })
    }

    /// The present state of a robot as a report.
    fn report(
        &self,
        going: &Going,
        robot: &RobotLoop,
        truth: &Truth,
        seed: u64,
        outcome: RunOutcome,
        reason: Option<String>,
    ) -> RunReport {
        let referee = &going.referee;
        let estimate = robot.pilot.map_from_base();
        let feedback = robot.goal().map(|goal| goal.feedback.clone()).unwrap_or_default();
        RunReport {
            outcome,
            reason,
            time_s: robot.now().as_secs(),
            time_entered_s: referee.entered(),
            length_m: truth.length,
            min_clearance_m: truth.min_clearance,
            collisions: truth.collisions,
            contacts: referee.contacts().to_vec(),
            replans: feedback.replans,
            plans: feedback.plans,
            recoveries: feedback.recoveries,
            final_error_m: referee.error(),
            pose_error_m: truth.map_from_base.distance(&estimate),
            pose_error_rad: wrap_angle(truth.map_from_base.yaw - estimate.yaw).abs(),
            energy_j: truth.drawn_j,
            energy_per_m: per_metre(truth.drawn_j, truth.length),
            seed,
            cloud_delay_ms: self.cloud_delay_ms,
            cpu_s: Some(robot.cpu().as_secs_f64()),
        }
    }

    /// Configuration of a robot's part of the run, with the deployment's settings.
    fn closed_loop(&self, layers: &Layers, index: usize, entrant: &Entrant<'_>) -> Result<ClosedLoopConfig, Failure> {
        let deployment = &layers.deployment;
        let failed = |error: InvalidId| Failure::failed(error.to_string());
        let id = match self.entrants.len() {
            1 => ROBOT.to_owned(),
            _ => format!("{ROBOT}{}", index + 1),
        };
        let id = Id::robot(&id).map_err(failed)?;
        let named = entrant.robot.and_then(|robot| deployment.robots.get(robot));
        let mut section = named.or(deployment.robots.values().next()).cloned().unwrap_or_default();
        if let (Some(robot), None) = (entrant.robot, named) {
            robot.clone_into(&mut section.model);
        }
        let start = entrant.start.or(section.start);
        let start = start.map_or_else(|| self.world.start(), |start| Pose2::new(start.x, start.y, start.yaw));
        let mut mission = deployment.mission.settings.clone();
        if !layers.sets("mission.latency_budget") {
            mission.latency_budget = COMPUTING;
        }
        let mut mapping = deployment.mapping.settings.clone();
        let known_map = self
            .known_map
            .then(|| true_map(self.world, mapping.resolution))
            .transpose()?;
        if let Some(map) = &known_map {
            mapping.resolution = map.spec().resolution;
        }
        if self.zones.is_none() {
            layers.check_file("zones.file")?;
        }
        let edge = edge_config(&id, &section, files::robot(&section.model)?, start);
        let suits = edge.settings.check_for(&edge.model, edge.tick);
        suits.map_err(|error| Failure::usage(format!("{}: {}", section.model, error.within("edge"))))?;
        Ok(ClosedLoopConfig {
            edge,
            mission: MissionConfig {
                robot: id,
                holder: "lockstep".to_owned(),
                store: PathBuf::new(),
                places: places(self.world),
                zones: files::zones(self.zones.or(deployment.zones.file.as_deref()))?,
                planner: deployment.planning.run.planner.clone(),
                settings: mission,
            },
            mapping,
            poses: PoseSettings {
                source: self.poses.unwrap_or(deployment.mapping.run.poses),
                ..deployment.poses()
            },
            motion: deployment.motion(),
            known_map,
            cloud_delay: 1e-3 * self.cloud_delay_ms,
            seed: self
                .seed
                .unwrap_or(deployment.simulation.seed)
                .wrapping_add(2 * index as u64),
        })
    }
}

/// The report of a robot after a run: includes contacts until the end, and any contact by the robot's own motion makes it a collision.
fn judged(report: RunReport, referee: &Referee, truth: &Truth) -> RunReport {
    let (outcome, reason) = match referee.own_contact() {
        None => (report.outcome, report.reason),
        Some(contact) => {
            let touched = format!(
                "touched something at {:.3} m/s of its own after {:.2} s",
                contact.own_speed, contact.time_s
            );
            let then = report.reason.unwrap_or_else(|| "reached".to_owned());
            (RunOutcome::Collision, Some(format!("{touched}; then: {then}")))
        }
    };
    RunReport {
        outcome,
        reason,
        min_clearance_m: truth.min_clearance,
        collisions: truth.collisions,
        contacts: referee.contacts().to_vec(),
        ..report
    }
}

/// Outcome and reason if the mission ended without reaching the goal.
fn ending(state: &GoalState, error: f64) -> (RunOutcome, Option<String>) {
    let reason = state.reason.clone().unwrap_or_else(|| match state.state {
        GoalPhase::Succeeded => format!("the mission ended {error:.2} m from the goal, and took that for the goal"),
        phase => format!("the mission ended: {phase:?}").to_lowercase(),
    });
    let outcome = match state.state {
        GoalPhase::Rejected => RunOutcome::Rejected,
        _ if reason.contains("no path") || reason.contains("is occupied") => RunOutcome::NoPath,
        _ => RunOutcome::Aborted,
    };
    (outcome, Some(reason))
}

/// The world as a map: its own, or every cell that a solid touches.
///
/// # Errors
/// A world too large for a map.
pub(crate) fn true_map(world: &World, resolution: f64) -> Result<OccupancyGrid, Failure> {
    if let Some(map) = world.map() {
        return Ok(map.clone());
    }
    let (lower, upper) = world.bounds();
    let cells = |length: f64| (length / resolution).ceil();
    let (width, height) = (cells(upper.x - lower.x), cells(upper.y - lower.y));
    if !(width <= MAX_CELLS && height <= MAX_CELLS) {
        return Err(Failure::usage(format!(
            "--known-map: a world of {width} by {height} cells: expected at most {MAX_CELLS} a side"
        )));
    }
    let spec = GridSpec {
        origin: lower,
        resolution,
        width: width as u32,
        height: height as u32,
    };
    let mut map = Grid::filled(spec, Occupancy::FREE);
    let cell = zenav_protocol::robot::Footprint::Polygon(
        [(-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5)]
            .map(|(x, y)| Point2::new(x * resolution, y * resolution))
            .to_vec(),
    );
    for y in 0..spec.height {
        for x in 0..spec.width {
            let center = spec.center(Cell::new(x, y));
            if world.clearance(&cell, Pose2::new(center.x, center.y, 0.0)) <= 0.0 {
                map[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    Ok(map)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_robots_meet_in_a_corridor_without_contact_and_alike_again() {
        let walls = "[[wall]]\nfrom = [0, 0]\nto = [7, 0]\nthickness = 0.1\n[[wall]]\nfrom = [0, 2]\nto = [7, 2]\nthickness = 0.1\n";
        let text = format!("size = [7, 2]\norigin = [0, 0]\n{walls}");
        let world = World::from_toml(&text, "corridor", &|_| Err(String::new())).unwrap();
        let entrant = |from: f64, yaw: f64| Entrant {
            robot: Some("tiago"),
            start: Some(Pose2::new(from, 1.0, yaw)),
            goal: Point2::new(7.0 - from, 1.0),
        };
        let entrants = vec![entrant(1.0, 0.0), entrant(6.0, std::f64::consts::PI)];
        let scenario = Scenario::of(&world, entrants, 12.0);
        let layers = Layers::load(None).unwrap();
        let run = || -> Vec<(RunOutcome, f64, u32)> {
            let reports = scenario.prepare(&layers).unwrap().run(None, |_, _, _| {});
            let ends = reports
                .iter()
                .map(|report| (report.outcome, report.time_s, report.collisions));
            ends.collect()
        };
        let ends = run();
        assert!(ends.iter().all(|(_, _, contacts)| *contacts == 0), "{ends:?}");
        assert_eq!(ends, run());
    }

    #[test]
    fn a_robot_that_is_not_round_touches_a_pane_of_glass_a_few_times_at_most_and_drives_round_it() {
        let wall = |from: [f64; 2], to: [f64; 2]| format!("[[wall]]\nfrom = {from:?}\nto = {to:?}\nthickness = 0.2\n");
        let walls = [
            wall([-0.1, -0.1], [7.1, -0.1]),
            wall([-0.1, 5.1], [7.1, 5.1]),
            wall([-0.1, -0.1], [-0.1, 5.1]),
            wall([7.1, -0.1], [7.1, 5.1]),
            wall([3.5, 1.9], [3.5, 3.1]) + "glass = true\n",
        ];
        let text = format!("size = [7.4, 5.4]\norigin = [-0.2, -0.2]\n{}", walls.concat());
        let world = World::from_toml(&text, "glass", &|_| Err(String::new())).unwrap();
        let layers = Layers::load(None).unwrap();
        let entrant = Entrant {
            robot: Some("jackal"),
            start: Some(Pose2::new(1.0, 2.5, 0.0)),
            goal: Point2::new(6.0, 2.5),
        };
        let scenario = Scenario {
            tolerance: Some(0.25),
            ..Scenario::of(&world, vec![entrant], 150.0)
        };
        let reports = scenario.prepare(&layers).unwrap().run(None, |_, _, _| {});
        let (touched, reason) = (reports[0].collisions, reports[0].reason.as_deref().unwrap_or_default());
        assert!(
            (1..=3).contains(&touched) && reason.ends_with("then: reached"),
            "{touched}, {reason}"
        );
    }
}

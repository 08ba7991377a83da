//! Scenario. How does one goal go in a world, from a seed, to its end?

use std::path::{Path, PathBuf};

use nalgebra::Point2;
use zenav_mission::MissionConfig;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::id::{Id, InvalidId};
use zenav_protocol::messages::{DrivingProfile, GoalPhase, GoalRequest, GoalState};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::MissionRequest;
use zenav_sim::{RobotSpec, Simulation, Truth, World};

use super::closed_loop::{ClosedLoop, ClosedLoopConfig};
use super::command::{RunOutcome, RunReport};
use super::referee::Referee;
use crate::components::{edge_config, places};
use crate::config::Layers;
use crate::failure::Failure;
use crate::files;
use crate::report::per_metre;

/// The robot's name in a run.
const ROBOT: &str = "robot";
/// Largest side of a known map, cells.
const MAX_CELLS: f64 = 16_384.0;
/// Time for a robot to come to rest when its mission has ended, s.
const SETTLING: f64 = 5.0;

/// A world, a robot and its goal; what is `None` is the deployment's.
pub(crate) struct Scenario<'a> {
    pub world: &'a World,
    /// A robot of the deployment by name, a robot file or a shipped name.
    pub robot: Option<&'a str>,
    /// Of all noise and delays.
    pub seed: Option<u64>,
    /// Whether it starts with the true map.
    pub known_map: bool,
    pub zones: Option<&'a Path>,
    /// Mean delay from scan to plan, ms.
    pub cloud_delay_ms: f64,
    /// m in the world.
    pub goal: Point2<f64>,
    /// Distance that counts as reached, m.
    pub tolerance: Option<f64>,
    pub profile: Option<DrivingProfile>,
    /// Simulated time after which the run has failed, s.
    pub timeout: f64,
}

impl Scenario<'_> {
    /// Runs it to its end; `see` is told the truth after every tick.
    ///
    /// # Errors
    /// Robots, zones or starts that cannot be.
    pub(crate) fn run(&self, layers: &Layers, mut see: impl FnMut(Stamp, &Truth)) -> Result<RunReport, Failure> {
        let config = self.closed_loop(layers)?;
        let (seed, model) = (config.seed, config.edge.model.clone());
        let tolerance = self.tolerance.unwrap_or(config.mission.settings.tolerance);
        let mut referee = Referee::new(self.goal, tolerance, model.footprint.circumscribed_radius());
        let spec = RobotSpec {
            id: config.edge.robot.clone(),
            model,
            start: config.edge.start,
        };
        let simulation =
            Simulation::new(self.world, vec![spec], seed).map_err(|error| Failure::usage(error.to_string()))?;
        let mut stage = ClosedLoop::new(simulation, config);
        stage.ask(MissionRequest::Goal(GoalRequest {
            id: Some("run".to_owned()),
            x: Some(self.goal.x),
            y: Some(self.goal.y),
            tolerance: Some(tolerance),
            profile: self.profile,
            ..GoalRequest::default()
        }));
        let mut ended: Option<f64> = None;
        let (outcome, reason) = loop {
            stage.tick();
            let now = stage.now();
            let truth = stage.truth();
            see(now, &truth);
            referee.watch(now, &truth);
            if referee.is_reached() {
                break (RunOutcome::Reached, None);
            }
            if let Some(Err(refusal)) = stage.replies().first() {
                break (RunOutcome::Rejected, Some(refusal.to_string()));
            }
            if let Some(state) = stage.goal().filter(|state| state.state.is_end()) {
                let since = *ended.get_or_insert(now.as_secs());
                if referee.is_at_rest() || now.as_secs() - since >= SETTLING {
                    break ending(state, referee.error());
                }
            }
            if now.as_secs() >= self.timeout {
                let step = stage.goal().map_or("not begun", |goal| goal.feedback.step.as_str());
                let left = referee.error();
                let reason = format!(
                    "{left:.2} m from the goal after {} s; the mission: {step}",
                    self.timeout
                );
                break (RunOutcome::Timeout, Some(reason));
            }
        };
        let (outcome, reason) = match referee.own_contact() {
            None => (outcome, reason),
            Some(contact) => {
                let touched = format!(
                    "touched something at {:.3} m/s of its own after {:.2} s",
                    contact.own_speed, contact.time_s
                );
                let then = reason.unwrap_or_else(|| "reached".to_owned());
                (RunOutcome::Collision, Some(format!("{touched}; then: {then}")))
            }
        };
        let (truth, estimate) = (stage.truth(), stage.pilot.map_from_base());
        let feedback = stage.goal().map(|goal| goal.feedback.clone()).unwrap_or_default();
        Ok(RunReport {
            outcome,
            reason,
            time_s: stage.now().as_secs(),
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
            cpu_s: Some(stage.cpu().as_secs_f64()),
        })
    }

    /// The parts of a run, with the deployment's settings.
    fn closed_loop(&self, layers: &Layers) -> Result<ClosedLoopConfig, Failure> {
        let deployment = &layers.deployment;
        let failed = |error: InvalidId| Failure::failed(error.to_string());
        let id = Id::robot(ROBOT).map_err(failed)?;
        let named = self.robot.and_then(|robot| deployment.robots.get(robot));
        let mut section = named.or(deployment.robots.values().next()).cloned().unwrap_or_default();
        if let (Some(robot), None) = (self.robot, named) {
            robot.clone_into(&mut section.model);
        }
        let start = section
            .start
            .map_or_else(|| self.world.start(), |start| Pose2::new(start.x, start.y, start.yaw));
        let mut mission = deployment.mission.settings.clone();
        if !layers.sets("mission.latency_budget") {
            mission.latency_budget = (1e-3 * self.cloud_delay_ms * 2.0).max(0.1);
        }
        let mut mapping = deployment.mapping.settings.clone();
        let known_map = self
            .known_map
            .then(|| true_map(self.world, mapping.resolution))
            .transpose()?;
        if let Some(map) = &known_map {
            mapping.resolution = map.spec().resolution;
        }
        Ok(ClosedLoopConfig {
            edge: edge_config(&id, &section, files::robot(&section.model)?, start),
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
            motion: deployment.motion(),
            known_map,
            cloud_delay: 1e-3 * self.cloud_delay_ms,
            seed: self.seed.unwrap_or(deployment.simulation.seed),
        })
    }
}

/// How a mission's end is to be judged where the goal was not reached, and why.
fn ending(state: &GoalState, error: f64) -> (RunOutcome, Option<String>) {
    let reason = state.reason.clone().unwrap_or_else(|| match state.state {
        GoalPhase::Succeeded => format!("the mission ended {error:.2} m from the goal, and took that for the goal"),
        phase => format!("the mission ended: {phase:?}").to_lowercase(),
    });
    let outcome = match state.state {
        GoalPhase::Rejected => RunOutcome::Rejected,
        _ if reason.contains("no path") || reason.contains("the goal is occupied") => RunOutcome::NoPath,
        _ => RunOutcome::Aborted,
    };
    (outcome, Some(reason))
}

/// The world as a map: its own, or every cell that something solid touches.
///
/// # Errors
/// A world that is too large to be a map.
fn true_map(world: &World, resolution: f64) -> Result<OccupancyGrid, Failure> {
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

//! How near to its path does each tracker keep the robot? Random ways through a map, planned and smoothed as missions do, each
//! driven at full speed by every law, in the simulator with its real sensors; the error is the truth's.

use nalgebra::Point2;
use zenav_edge::Inbox;
use zenav_planning::{Budget, PlanOptions, Searcher, plan};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{Correction, DrivingProfile, LeaseRole, PlanOutcome, Trajectory};
use zenav_protocol::robot::{Footprint, RobotModel, TrackerKind};
use zenav_sim::World;
use zenav_smoothing::shortcut::shortcut;
use zenav_smoothing::{SmoothQuery, SmoothSettings, smooth};
use zenav_space::{ConfigurationSpace, UnknownPolicy};

use super::sim_rig::{SimRig, SimRigError};
use super::worlds::Rng;

/// Side of a cell of a world's map, m.
const RESOLUTION: f64 = 0.05;
/// Largest errors of a pose that is measured off board, m and rad.
const MEASURED: (f64, f64) = (0.02, 0.01);
/// Ways are at least this long, m.
const LEAST_LENGTH: f64 = 2.0;

/// Every law, by its name in the robot's file.
pub const LAWS: [(&str, TrackerKind); 5] = [
    ("time_law", TrackerKind::TimeLaw),
    ("pure_pursuit", TrackerKind::PurePursuit),
    ("pid", TrackerKind::Pid),
    ("wheel_law", TrackerKind::WheelLaw),
    ("heading_first", TrackerKind::HeadingFirst),
];

/// A way to be driven.
#[derive(Clone, Debug)]
pub struct Way {
    /// Where the robot stands.
    pub start: Pose2,
    /// Corner points.
    pub corners: Vec<Point2<f64>>,
    /// The smoothed way with its time law.
    pub trajectory: Trajectory,
    /// Energy that it will draw by the robot's model, J.
    pub forecast_j: f64,
}

/// How a way was driven.
#[derive(Clone, Debug)]
pub struct Drive {
    /// Distance of the true base from the path, each tick, m.
    pub errors: Vec<f64>,
    /// Time until the robot rested at the end, s; `None` when it did not within twice the plan's.
    pub secs: Option<f64>,
    /// Way driven, m.
    pub length: f64,
    /// Energy drawn, J.
    pub drawn_j: f64,
    /// Contacts.
    pub contacts: u32,
    /// Times that the guard stepped in.
    pub interventions: usize,
}

/// The true map of a world.
#[must_use]
pub fn true_map(world: &World) -> OccupancyGrid {
    if let Some(map) = world.map() {
        return map.clone();
    }
    let (lower, upper) = world.bounds();
    let cells = |length: f64| (length / RESOLUTION).ceil() as u32;
    let spec = GridSpec {
        origin: lower,
        resolution: RESOLUTION,
        width: cells(upper.x - lower.x),
        height: cells(upper.y - lower.y),
    };
    let half = 0.5 * RESOLUTION;
    let cell = Footprint::Polygon(
        [(-half, -half), (half, -half), (half, half), (-half, half)]
            .map(|(x, y)| Point2::new(x, y))
            .to_vec(),
    );
    let mut map = Grid::filled(spec, Occupancy::FREE);
    for y in 0..spec.height {
        for x in 0..spec.width {
            let center = spec.center(Cell::new(x, y));
            if world.clearance(&cell, Pose2::new(center.x, center.y, 0.0)) <= 0.0 {
                map[Cell::new(x, y)] = Occupancy::OCCUPIED;
            }
        }
    }
    map
}

/// `count` random ways that were smoothed; the same ones for every profile.
#[must_use]
pub fn ways(map: &OccupancyGrid, model: &RobotModel, seed: u64, count: usize, profile: DrivingProfile) -> Vec<Way> {
    let space = ConfigurationSpace::new(map, &model.footprint, UnknownPolicy::default(), 0.0);
    let Ok(mut searcher) = Searcher::new(space.free()) else {
        return Vec::new();
    };
    let mut dice = Rng::new(seed, 2);
    let (low, high) = (space.spec().origin, space.spec().upper());
    let room = model.footprint.circumscribed_radius() + 0.1;
    let options = PlanOptions {
        any_heading: true,
        ..PlanOptions::default()
    };
    let mut found = Vec::new();
    for _ in 0..2000 {
        if found.len() == count {
            break;
        }
        let mut place = || Point2::new(dice.between(low.x, high.x), dice.between(low.y, high.y));
        let (from, to) = (place(), place());
        if space.clearance(from) < room || space.clearance(to) < room || (to - from).norm() < LEAST_LENGTH {
            continue;
        }
        let mut start = Pose2::new(from.x, from.y, 0.0);
        let goal = Pose2::new(to.x, to.y, 0.0);
        let planned = plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED);
        let PlanOutcome::Found { path, .. } = planned.outcome else {
            continue;
        };
        let settings = SmoothSettings {
            profile,
            ..SmoothSettings::default()
        };
        let corners = shortcut(&space, &path, settings.rooms.comfort, None);
        let Some(along) = corners
            .iter()
            .map(|point| point - from)
            .find(|along| along.norm() > 0.0)
        else {
            continue;
        };
        start.yaw = along.y.atan2(along.x);
        let query = SmoothQuery {
            way: &path,
            start,
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
        };
        let smoothed = smooth(&space, &query, model, &settings, &mut || 0.0);
        if smoothed.is_smooth() {
            found.push(Way {
                start,
                corners,
                trajectory: smoothed.trajectory(0.02),
                forecast_j: smoothed.statistics.energy_j,
            });
        }
    }
    found
}

/// What the robot knows of its pose on the way.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Localised {
    /// What its own sensors tell.
    Alone,
    /// And once a second, from off board, where it was.
    OffBoard,
}

/// Drives a way by a law.
///
/// # Errors
/// [`SimRigError`] when the robot cannot stand at the way's start.
pub fn drive(
    world: &World,
    model: &RobotModel,
    law: TrackerKind,
    way: &Way,
    localised: Localised,
    seed: u64,
) -> Result<Drive, SimRigError> {
    let mut model = model.clone();
    model.controller.tracker = law;
    let mut ground = SimRig::new(world, &model, way.start, seed, LeaseRole::Mission)?;
    ground.run(1.0);
    ground.plan = Some(ground.plan(way.corners.clone(), way.trajectory.clone()));
    let (begun, drawn) = (ground.sim.now(), ground.truth().drawn_j);
    let planned = way.trajectory.end_time();
    let mut errors = Vec::new();
    let mut secs = None;
    let (mut dice, mut ticks) = (Rng::new(seed, 3), 0_u64);
    while ground.sim.now().secs_since(begun) < 2.0 * planned + 5.0 {
        let mut inbox = Inbox::default();
        ticks += 1;
        if localised == Localised::OffBoard && ticks.is_multiple_of(50) {
            inbox.corrections.push(correction(&ground, &mut dice));
        }
        ground.tick(inbox, |_| {});
        let position = ground.truth().map_from_base.position();
        errors.push(way.trajectory.nearest_ahead(0.0, position, f64::INFINITY).distance);
        if ground.finished() {
            secs = Some(ground.sim.now().secs_since(begun));
            break;
        }
    }
    let truth = ground.truth();
    Ok(Drive {
        errors,
        secs,
        length: truth.length,
        drawn_j: truth.drawn_j - drawn,
        contacts: truth.collisions,
        interventions: ground.interventions().count(),
    })
}

/// Where the robot is, give or take.
fn correction(ground: &SimRig, dice: &mut Rng) -> Correction {
    let truth = ground.truth().map_from_base;
    let mut about = |value: f64, error: f64| value + dice.between(-error, error);
    let variance = |error: f64| error * error / 3.0;
    let (xy, yaw) = (variance(MEASURED.0), variance(MEASURED.1));
    Correction {
        stamp: ground.sim.now(),
        boot_id: "boot".to_owned(),
        map_from_base: Pose2::new(
            about(truth.x, MEASURED.0),
            about(truth.y, MEASURED.0),
            about(truth.yaw, MEASURED.1),
        ),
        covariance: [xy, 0.0, 0.0, 0.0, xy, 0.0, 0.0, 0.0, yaw],
    }
}

/// The value that a share of all does not exceed.
#[must_use]
pub fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = ((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1));
    values.get(index).copied().unwrap_or(f64::NAN)
}

//! Path error of the trackers, in two comparisons. Each path is driven at full speed by every law with simulated sensors; the error is the
//! distance of the true pose from the law's own reference.
//!
//! [`planned_paths`]: random paths through a map, planned and smoothed as missions do. The wheel laws and the heading-first law follow
//! corner points: their error is the distance from the straight legs between them. The others follow the smoothed trajectory, which is
//! easier.
//!
//! [`corner_way`]: one polyline with right angles, the reference of every law. Laws that follow a trajectory get the unsmoothed one, which
//! stops and turns at each corner and nowhere leaves the legs.

use nalgebra::Point2;
use zenav_edge::Inbox;
use zenav_planning::{Budget, PlanOptions, Searcher, plan};
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{Correction, DrivingProfile, LeaseRole, PlanOutcome, Trajectory};
use zenav_protocol::polygon::Edge;
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_sim::World;
use zenav_smoothing::{SmoothQuery, SmoothingSettings, shortcut, smooth, unsmoothed};
use zenav_space::{ConfigurationSpace, UnknownPolicy};

use super::sim_rig::{SimRig, SimRigError};
use super::worlds::Rng;

/// Side of a cell of a world's map, m.
const RESOLUTION: f64 = 0.05;
/// Largest errors of a correction from the cloud, m and rad.
const CORRECTION: (f64, f64) = (0.02, 0.01);
/// Name of the wheel law without changes.
pub const ORIGINAL: &str = "wheel_law_original";
/// Least distance from start to goal, m.
const LEAST_LENGTH: f64 = 2.0;

/// A path to be driven, and its trajectory.
#[derive(Clone, Debug)]
pub struct PlannedPath {
    /// Start pose.
    pub start: Pose2,
    /// Corner points.
    pub corners: Vec<Point2<f64>>,
    /// The smoothed trajectory.
    pub trajectory: Trajectory,
    /// Energy forecast by the robot's model, J.
    pub forecast_j: f64,
}

/// The result of a drive along a path.
#[derive(Clone, Debug)]
pub struct Drive {
    /// Distance of the true base from the law's own reference, each tick, m.
    pub errors: Vec<f64>,
    /// Time until the robot was at rest at the end, s; `None` if that took more than twice the planned time, with the original wheel law six
    /// times.
    pub secs: Option<f64>,
    /// Distance driven, m.
    pub length: f64,
    /// Energy drawn, J.
    pub drawn_j: f64,
    /// Contacts.
    pub contacts: u32,
    /// Interventions of the collision monitor.
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

/// `count` random paths that were smoothed; the same ones for every profile.
#[must_use]
pub fn planned_paths(
    map: &OccupancyGrid,
    model: &RobotModel,
    seed: u64,
    count: usize,
    profile: DrivingProfile,
) -> Vec<PlannedPath> {
    let space = ConfigurationSpace::new(map, &model.footprint, UnknownPolicy::default(), 0.0);
    let Ok(mut searcher) = Searcher::new(space.free()) else {
        return Vec::new();
    };
    let mut rng = Rng::new(seed, 2);
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
        let mut place = || Point2::new(rng.between(low.x, high.x), rng.between(low.y, high.y));
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
        let settings = SmoothingSettings::default();
        let corners = shortcut(&space, &path, settings.corridor.clearance, None, None);
        let Some(along) = corners
            .iter()
            .map(|point| point - from)
            .find(|along| along.norm() > 0.0)
        else {
            continue;
        };
        start.yaw = along.y.atan2(along.x);
        let query = SmoothQuery {
            path: &path,
            start,
            start_velocity: Twist2::ZERO,
            goal_yaw: None,
            profile,
        };
        let smoothed = smooth(&space, &query, model, &settings, None, &mut || 0.0);
        if smoothed.is_smooth() {
            found.push(PlannedPath {
                start,
                corners,
                trajectory: smoothed.sampled(0.02),
                forecast_j: smoothed.statistics.energy_j,
            });
        }
    }
    found
}

/// Ten metres in legs of two, with right angles to both sides, for open floor.
#[must_use]
pub fn corner_way(model: &RobotModel) -> PlannedPath {
    let start = Pose2::IDENTITY;
    let corners = [(2.0, 0.0), (2.0, 2.0), (4.0, 2.0), (4.0, 0.0), (6.0, 0.0)].map(|(x, y)| Point2::new(x, y));
    let safe = unsmoothed(&corners, start, Twist2::ZERO, None, model);
    PlannedPath {
        start,
        corners: corners.to_vec(),
        trajectory: safe.trajectory.sampled(0.02),
        forecast_j: safe.statistics.energy_j,
    }
}

/// Source of the robot's pose estimate during a drive.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Localised {
    /// Its own sensors.
    OnBoard,
    /// Its own sensors, and a correction from the cloud every second.
    Corrected,
}

/// Drives a path by a law.
///
/// # Errors
/// [`SimRigError`] when the start is occupied.
pub fn drive(
    world: &World,
    model: &RobotModel,
    law: &str,
    planned: &PlannedPath,
    localised: Localised,
    seed: u64,
) -> Result<Drive, SimRigError> {
    let mut model = model.clone();
    law.clone_into(&mut model.controller.tracker);
    let mut rig = SimRig::new(world, &model, planned.start, seed, LeaseRole::Mission)?;
    rig.run(1.0);
    rig.plan = Some(rig.plan(planned.corners.clone(), planned.trajectory.clone()));
    let (begun, drawn) = (rig.sim.now(), rig.truth().drawn_j);
    let secs_planned = planned.trajectory.last().map_or(0.0, |point| point.t);
    // The original wheel law slows down towards every waypoint.
    let patience = if law == ORIGINAL { 6.0 } else { 2.0 };
    let reference = planned.reference(law);
    let mut errors = Vec::new();
    let mut secs = None;
    let (mut rng, mut ticks) = (Rng::new(seed, 3), 0_u64);
    while rig.sim.now().secs_since(begun) < patience * secs_planned + 5.0 {
        let mut inbox = Inbox::default();
        ticks += 1;
        if localised == Localised::Corrected && ticks.is_multiple_of(50) {
            inbox.corrections.push(correction(&rig, &mut rng));
        }
        rig.tick(inbox, |_| {});
        errors.push(off_path(&reference, rig.truth().map_from_base.position()));
        if rig.finished() {
            secs = Some(rig.sim.now().secs_since(begun));
            break;
        }
    }
    let truth = rig.truth();
    Ok(Drive {
        errors,
        secs,
        length: truth.length,
        drawn_j: truth.drawn_j - drawn,
        contacts: truth.collisions,
        interventions: rig.interventions().count(),
    })
}

/// A correction: the true pose with a random error.
fn correction(rig: &SimRig, rng: &mut Rng) -> Correction {
    let truth = rig.truth().map_from_base;
    let mut about = |value: f64, error: f64| value + rng.between(-error, error);
    let variance = |error: f64| error * error / 3.0;
    let (xy, yaw) = (variance(CORRECTION.0), variance(CORRECTION.1));
    Correction {
        stamp: rig.sim.now(),
        boot_id: "boot".to_owned(),
        map_from_base: Pose2::new(
            about(truth.x, CORRECTION.0),
            about(truth.y, CORRECTION.0),
            about(truth.yaw, CORRECTION.1),
        ),
        covariance: [xy, 0.0, 0.0, 0.0, xy, 0.0, 0.0, 0.0, yaw],
        ..Correction::default()
    }
}

impl PlannedPath {
    /// The points of a law's reference, joined by straight legs.
    fn reference(&self, law: &str) -> Vec<Point2<f64>> {
        match law {
            "wheel_law" | ORIGINAL | "heading_first" => std::iter::once(self.start.position())
                .chain(self.corners.iter().copied())
                .collect(),
            _ => self.trajectory.iter().map(|point| point.pose().position()).collect(),
        }
    }
}

/// Distance of a point from a path, m.
pub(super) fn off_path(path: &[Point2<f64>], place: Point2<f64>) -> f64 {
    let legs = path.windows(2).map(|leg| Edge { a: leg[0], b: leg[1] });
    legs.map(|leg| (place - leg.nearest(place)).norm())
        .fold(f64::INFINITY, f64::min)
}

/// The value that a share of all values does not exceed.
#[must_use]
pub fn percentile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let index = ((values.len() as f64 * share) as usize).min(values.len().saturating_sub(1));
    values.get(index).copied().unwrap_or(f64::NAN)
}

#[cfg(test)]
mod tests {
    use zenav_edge::trackers::LAWS;
    use zenav_fixtures::robot;

    use super::*;

    #[test]
    fn on_the_corner_way_every_law_has_the_same_reference() {
        let way = corner_way(&robot("tiago"));
        let legs = way.reference(ORIGINAL);
        for law in LAWS {
            let reference = way.reference(law.name);
            assert!(
                reference.iter().all(|point| off_path(&legs, *point) < 1e-6),
                "{}: leaves the way",
                law.name
            );
            assert!(
                legs.iter().all(|corner| off_path(&reference, *corner) < 1e-6),
                "{}: cuts a corner",
                law.name
            );
        }
    }
}

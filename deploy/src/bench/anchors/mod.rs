//! Anchors. Reference planners in the same worlds: they drive the same simulated body with ground truth of pose, obstacles and people.
//!
//! | file | answers |
//! |---|---|
//! | `field` | how far is it to the goal around static obstacles? |
//! | `orca` | which velocity avoids everybody, if everybody takes half of the avoidance? |
//! | `window` | which reachable twist is best? (dynamic window) |
//! | `space_time` | which path is free at the time when the robot is there? (A* over cells and time) |

mod field;
mod orca;
mod space_time;
mod window;

use nalgebra::{Point2, Vector2};
use serde::Serialize;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::id::Id;
use zenav_protocol::time::Stamp;
use zenav_sim::movers::MoverModel;
use zenav_sim::shape::Shape;
use zenav_sim::{RobotSpec, Simulation, Truth, World};

use super::suites::Case;
use crate::failure::Failure;
use crate::lockstep::Referee;
pub(super) use field::Field;
use orca::Orca;
use space_time::SpaceTime;
use window::Window;

/// Ticks between two decisions: 10 Hz.
const TICKS: u64 = 5;
/// Tracking range, m.
const SIGHT: f64 = 10.0;
/// Horizon of the dynamic windows, s.
const HORIZON: f64 = 2.0;
/// Horizon for following a planned path, s.
const FOLLOWING: f64 = 1.0;
/// Tolerance if a case uses the deployment's, m.
const TOLERANCE: f64 = 0.15;

/// A reference planner that drives instead of zenav.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub(super) enum Anchor {
    /// Dynamic window (Fox, Burgard and Thrun, 1997): people count as stationary.
    Standing,
    /// Dynamic window with people predicted at constant velocity, tracked without error within 10 m.
    ConstantVelocity,
    /// Optimal reciprocal collision avoidance; people's velocities are tracked without error within 10 m.
    Orca,
    /// A* in space and time with everybody's future known.
    AllKnowing,
}

impl Anchor {
    pub(super) const ALL: [Self; 4] = [Self::Standing, Self::ConstantVelocity, Self::Orca, Self::AllKnowing];
    /// Without [`Self::AllKnowing`]: the future of people who react to the robot cannot be known in advance.
    pub(super) const OF_PEOPLE_WHO_REACT: [Self; 3] = [Self::Standing, Self::ConstantVelocity, Self::Orca];
}

/// A moving disc: position, velocity, radius.
#[derive(Clone, Copy, Debug)]
pub(super) struct Walker {
    at: Point2<f64>,
    velocity: Vector2<f64>,
    radius: f64,
}

/// Result of an anchor's run.
pub(super) struct Driven {
    pub referee: Referee,
    pub truth: Truth,
    pub time_s: f64,
}

/// Recorded positions of all movers, in a world without a robot.
pub(super) struct Replay {
    /// Every [`TICKS`] ticks.
    places: Vec<Vec<Point2<f64>>>,
    step: f64,
}

impl Replay {
    fn new(world: &World, seed: u64, secs: f64) -> Result<Self, Failure> {
        let mut simulation = Simulation::new(world, Vec::new(), seed).map_err(Failure::usage)?;
        let step = simulation.tick().as_secs_f64() * TICKS as f64;
        let mut places = vec![simulation.movers().collect()];
        while simulation.now().as_secs() < secs {
            (0..TICKS).for_each(|_| simulation.step());
            places.push(simulation.movers().collect());
        }
        Ok(Self { places, step })
    }

    /// Position of a mover at a time (s); the last one after the end of the record.
    fn at(&self, mover: usize, secs: f64) -> Point2<f64> {
        let place = |index: usize| {
            let row = self.places.get(index).or(self.places.last());
            row.and_then(|row| row.get(mover)).copied().unwrap_or_default()
        };
        let share = (secs / self.step).max(0.0);
        let from = place(share as usize);
        from + (place(share as usize + 1) - from) * share.fract()
    }
}

/// Drives a case to its end; `see` is called with the ground truth after every tick.
///
/// # Errors
/// A robot that cannot start where the world file says.
pub(super) fn drive(
    anchor: Anchor,
    case: &Case,
    field: &Field,
    mut see: impl FnMut(Stamp, &Truth),
) -> Result<Driven, Failure> {
    let model = &case.model;
    let tolerance = case.tolerance.unwrap_or(TOLERANCE);
    let mut referee = Referee::new(case.goal, tolerance, model.footprint.circumscribed_radius());
    let spec = RobotSpec {
        id: Id::robot("robot").map_err(Failure::failed)?,
        model: model.clone(),
        start: case.world.start(),
    };
    let mut simulation = Simulation::new(&case.world, vec![spec], case.seed).map_err(Failure::usage)?;
    let radii: Vec<f64> = case.world.movers().iter().map(radius).collect();
    let mut known = match anchor {
        Anchor::AllKnowing => {
            let replay = Replay::new(&case.world, case.seed, case.timeout + HORIZON)?;
            Some(SpaceTime::new(case, field, replay, &radii))
        }
        _ => None,
    };
    let window = Window::new(model, field);
    let orca = Orca::new(model, field);
    let mut before: Vec<Point2<f64>> = simulation.movers().collect();
    let mut tick = 0;
    loop {
        let truth = simulation.truth(0);
        let now = simulation.now().as_secs();
        if tick % TICKS == 0 {
            let places: Vec<Point2<f64>> = simulation.movers().collect();
            let secs = (simulation.tick().as_secs_f64() * TICKS as f64).min(now.max(1e-9));
            let walkers: Vec<Walker> = places
                .iter()
                .zip(&before)
                .zip(&radii)
                .map(|((at, before), radius)| Walker {
                    at: *at,
                    velocity: match anchor {
                        Anchor::ConstantVelocity | Anchor::Orca => (at - before) / secs,
                        Anchor::Standing | Anchor::AllKnowing => Vector2::zeros(),
                    },
                    radius: *radius,
                })
                .filter(|walker| (walker.at - truth.map_from_base.position()).norm() <= SIGHT)
                .collect();
            before = places;
            let twist = if referee.error() <= 0.7 * tolerance {
                Twist2::ZERO
            } else if let Some(known) = &mut known {
                let reference = known.reference(now, truth.map_from_base.position());
                let predict = |ahead: f64| known.walkers(now + ahead);
                window.choose(&truth, FOLLOWING, predict, |rollout| {
                    window::follow(rollout, |ahead| reference.at(now + ahead))
                })
            } else if anchor == Anchor::Orca {
                orca.choose(&truth, &walkers, secs)
            } else {
                let predict = |ahead: f64| {
                    let on = |walker: &Walker| (walker.at + walker.velocity * ahead, walker.radius);
                    walkers.iter().map(on).collect()
                };
                window.choose(&truth, HORIZON, predict, |rollout| window::approach(rollout, field))
            };
            simulation.drive(0, model.drive.bounded(model.drive.wheels(twist)));
        }
        simulation.step();
        tick += 1;
        let truth = simulation.truth(0);
        see(simulation.now(), &truth);
        referee.watch(simulation.now(), &truth);
        let time_s = simulation.now().as_secs();
        if referee.is_reached() || time_s >= case.timeout {
            return Ok(Driven { referee, truth, time_s });
        }
    }
}

/// Radius of a disc around a mover, m.
fn radius(mover: &MoverModel) -> f64 {
    match &mover.shape {
        Shape::Disc(radius) => *radius,
        Shape::Polygon(corners) => corners.iter().map(|corner| corner.coords.norm()).fold(0.0, f64::max),
    }
}

//! Anchors. Reference planners in the same worlds: they drive the same simulated body, within the same limits, from the same start to the
//! same goal, and the same referee judges them. They know the ground truth of pose, obstacles and people.
//!
//! | file | answers |
//! |---|---|
//! | `cells` | which square of a grid is where? |
//! | `field` | how much room is there, and how long is the shortest path? |
//! | `cost_to_go` | which way leads to the goal, past walls and people who stand? |
//! | `window` | which reachable twist is best? (dynamic window) |
//! | `orca` | which velocity avoids everybody, if everybody takes half of the avoidance? |
//! | `replay` | where will everybody be? |
//! | `space_time` | which path is free at the time when the robot is there? (A* over cells and time) |

mod cells;
mod cost_to_go;
mod field;
mod orca;
mod replay;
mod space_time;
#[cfg(test)]
mod tests;
mod window;

use nalgebra::{Point2, Vector2};
use serde::Serialize;
use zenav_protocol::geometry::Twist2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::Drive;
use zenav_protocol::time::Stamp;
use zenav_sim::{RobotSpec, Simulation, Truth};

use super::suites::Case;
use crate::failure::Failure;
use crate::lockstep::Referee;
use cost_to_go::CostToGo;
pub(super) use field::Field;
use orca::Orca;
use space_time::SpaceTime;
use window::Window;

/// Ticks between two decisions: 25 Hz.
const TICKS: u64 = 2;
/// Time between two looks for the way to the goal, s.
const AGAIN: f64 = 0.5;
/// Tracking range, m.
const SIGHT: f64 = 10.0;
/// Horizon of the dynamic windows, s.
const HORIZON: f64 = 2.0;
/// Horizon for following a planned path, s.
const FOLLOWING: f64 = 1.0;
/// Tolerance if a case uses the deployment's, m.
const TOLERANCE: f64 = 0.15;
/// A robot stops at this share of the tolerance from its goal.
const ARRIVED: f64 = 0.7;
/// Time from a decision until the wheels brake, s.
const LATE: f64 = 0.1;
/// Somebody slower stands: the way leads around, m/s.
const STANDING: f64 = 0.15;
/// A robot that has not moved so far (m) in so long (s) is stuck. It then gets away from where it is, for so long (s).
const PROGRESS: (f64, f64) = (0.5, 4.0);
const RECOVERY: f64 = 2.0;

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

/// Centre and radius, m.
type Disc = (Point2<f64>, f64);

/// When did the robot last get on? As the progress checkers of other stacks.
struct Progress {
    since: f64,
    from: Point2<f64>,
}

impl Progress {
    /// Whether the robot is stuck, and has not tried to get away for long enough.
    fn is_stuck(&mut self, now: f64, at: Point2<f64>) -> bool {
        let (distance, patience) = PROGRESS;
        if (at - self.from).norm() > distance || now - self.since > patience + RECOVERY {
            *self = Self { since: now, from: at };
        }
        now - self.since > patience
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
    let radii: Vec<f64> = case
        .world
        .movers()
        .iter()
        .map(|mover| mover.shape.circumscribed_radius())
        .collect();
    let mut known = match anchor {
        Anchor::AllKnowing => Some(SpaceTime::new(case, field, &simulation, &radii)),
        Anchor::Standing | Anchor::ConstantVelocity | Anchor::Orca => None,
    };
    let mut to_go = CostToGo::new(case, field);
    let window = Window::new(case, field);
    let orca = Orca::new(case, field);
    let mut progress = Progress {
        since: 0.0,
        from: case.world.start().position(),
    };
    let mut before: Vec<Point2<f64>> = simulation.movers().collect();
    let mut next_look = 0.0;
    let mut tick = 0_u64;
    loop {
        if tick.is_multiple_of(TICKS) {
            let truth = simulation.truth(0);
            let (now, at) = (simulation.now().as_secs(), truth.map_from_base.position());
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
                .filter(|walker| (walker.at - at).norm() <= SIGHT)
                .collect();
            before = places;
            if now >= next_look {
                next_look = now + AGAIN;
                if let Some(known) = &mut known {
                    known.plan(&simulation, at);
                } else {
                    let standing = walkers.iter().filter(|walker| walker.velocity.norm() < STANDING);
                    to_go.update(standing.map(|walker| (walker.at, walker.radius)));
                }
            }
            let on = |ahead: f64| -> Vec<Disc> {
                let on = |walker: &Walker| (walker.at + walker.velocity * ahead, walker.radius);
                walkers.iter().map(on).collect()
            };
            let is_stuck = progress.is_stuck(now, at);
            let twist = if referee.error() <= ARRIVED * tolerance {
                Twist2::ZERO
            } else if let Some(known) = &known {
                // Waits of any length are planned.
                let predict = |ahead: f64| known.walkers(now + ahead);
                window.choose(&truth, FOLLOWING, predict, |poses| {
                    window::follow(poses, |ahead| known.reference(now + ahead))
                })
            } else if is_stuck {
                window.choose(&truth, HORIZON, on, |poses| window::escape(poses, at))
            } else if anchor == Anchor::Orca {
                orca.choose(&truth, &walkers, &to_go, secs)
            } else {
                window.choose(&truth, HORIZON, on, |poses| window::approach(poses, &to_go))
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

/// Speed from which a robot comes to rest within a distance (m), m/s.
fn stopping_speed(drive: &Drive, distance: f64) -> f64 {
    let rate = drive.acceleration();
    rate * ((LATE * LATE + 2.0 * distance / rate).sqrt() - LATE).max(0.0)
}

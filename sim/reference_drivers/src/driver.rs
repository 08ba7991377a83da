//! Reference drivers. Which wheel speeds come next, and what is kept from one decision to the next?

use nalgebra::{Point2, Vector2};
use serde::Serialize;
use zenav_protocol::geometry::Twist2;
use zenav_sim::Simulation;

use crate::cost_to_go::CostToGo;
use crate::field::Field;
use crate::orca::Orca;
use crate::space_time::SpaceTime;
use crate::task::DrivingTask;
use crate::window::{self, Window};

/// Steps of the simulation between two decisions: 25 Hz in a simulation of [`zenav_sim::TICK`].
pub const TICKS_PER_DECISION: u64 = 2;
/// Time between two looks for the way to the goal, s.
const AGAIN: f64 = 0.5;
/// Tracking range, m.
const SIGHT: f64 = 10.0;
/// Horizon of the dynamic windows, s.
pub(crate) const HORIZON: f64 = 2.0;
/// Horizon for following a planned path, s.
const FOLLOWING: f64 = 1.0;
/// A robot stops at this share of the tolerance from its goal.
const ARRIVED: f64 = 0.7;
/// Somebody slower stands: the way leads around, m/s.
const STANDING: f64 = 0.15;
/// A robot that has not moved so far (m) in so long (s) is stuck. It then gets away from where it is, for so long (s).
const PROGRESS: (f64, f64) = (0.5, 4.0);
const RECOVERY: f64 = 2.0;

/// How a reference driver decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Method {
    /// Dynamic window (Fox, Burgard and Thrun, 1997): people count as stationary.
    Standing,
    /// Dynamic window with people predicted at constant velocity, tracked without error within 10 m.
    ConstantVelocity,
    /// Optimal reciprocal collision avoidance; people's velocities are tracked without error within 10 m.
    Orca,
    /// A* in space and time with everybody's future known.
    AllKnowing,
}

impl Method {
    /// All methods.
    pub const ALL: [Self; 4] = [Self::Standing, Self::ConstantVelocity, Self::Orca, Self::AllKnowing];
    /// Without [`Self::AllKnowing`]: the future of people who react to the robot cannot be known in advance.
    pub const AMONG_PEOPLE_WHO_REACT: [Self; 3] = [Self::Standing, Self::ConstantVelocity, Self::Orca];
}

/// Centre and radius, m.
pub(crate) type Disc = (Point2<f64>, f64);

/// Somebody who is tracked: position (m), velocity (m/s), radius (m).
#[derive(Clone, Copy, Debug)]
pub(crate) struct Person {
    pub(crate) at: Point2<f64>,
    pub(crate) velocity: Vector2<f64>,
    pub(crate) radius: f64,
}

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

/// Drives the first robot of a simulation by the ground truth of its pose, the walls and the movers; other robots are ignored.
pub struct ReferenceDriver<'a> {
    method: Method,
    task: DrivingTask<'a>,
    window: Window<'a>,
    orca: Orca<'a>,
    to_go: CostToGo,
    /// With everybody's future known.
    known: Option<SpaceTime>,
    /// Radii of the movers, m, and their positions at the last decision.
    radii: Vec<f64>,
    before: Vec<Point2<f64>>,
    progress: Progress,
    /// Time of the next look for the way, s.
    next_look: f64,
}

impl<'a> ReferenceDriver<'a> {
    /// A driver at the start of its task. `field` and `simulation` are of the task's world, and nothing has moved yet.
    #[must_use]
    pub fn new(method: Method, task: DrivingTask<'a>, field: &'a Field, simulation: &Simulation) -> Self {
        let movers = task.world.movers().iter();
        let radii: Vec<f64> = movers.map(|mover| mover.shape.circumscribed_radius()).collect();
        let known = match method {
            Method::AllKnowing => Some(SpaceTime::new(&task, field, simulation, &radii)),
            Method::Standing | Method::ConstantVelocity | Method::Orca => None,
        };
        Self {
            method,
            task,
            window: Window::new(&task, field),
            orca: Orca::new(&task, field),
            to_go: CostToGo::new(&task, field),
            known,
            radii,
            before: simulation.movers().collect(),
            progress: Progress {
                since: 0.0,
                from: task.start.position(),
            },
            next_look: 0.0,
        }
    }

    /// Wheel speeds (left, right) for [`Simulation::drive`], rad/s. Call it at the start, and after every [`TICKS_PER_DECISION`] steps.
    ///
    /// # Panics
    /// Unless the simulation has a robot.
    #[must_use]
    pub fn decide(&mut self, simulation: &Simulation) -> [f64; 2] {
        let twist = self.twist(simulation);
        let drive = &self.task.model.drive;
        drive.bounded(drive.wheels(twist))
    }

    /// The wanted velocity, base frame.
    fn twist(&mut self, simulation: &Simulation) -> Twist2 {
        let truth = simulation.truth(0);
        let (now, at) = (simulation.now().as_secs(), truth.map_from_base.position());
        let secs = (simulation.tick().as_secs_f64() * TICKS_PER_DECISION as f64).min(now.max(1e-9));
        let people = self.track(simulation, at, secs);
        if now >= self.next_look {
            self.next_look = now + AGAIN;
            if let Some(known) = &mut self.known {
                known.plan(simulation, at);
            } else {
                let standing = people.iter().filter(|person| person.velocity.norm() < STANDING);
                self.to_go.update(standing.map(|person| (person.at, person.radius)));
            }
        }
        let is_stuck = self.progress.is_stuck(now, at);
        if (at - self.task.goal).norm() <= ARRIVED * self.task.tolerance {
            return Twist2::ZERO;
        }
        if let Some(known) = &self.known {
            // Waits of any length are planned.
            let predict = |ahead: f64| known.walkers(now + ahead);
            return self.window.choose(&truth, FOLLOWING, predict, |poses| {
                window::follow(poses, |ahead| known.reference(now + ahead))
            });
        }
        let predict = |ahead: f64| -> Vec<Disc> {
            let on = |person: &Person| (person.at + person.velocity * ahead, person.radius);
            people.iter().map(on).collect()
        };
        if is_stuck {
            self.window
                .choose(&truth, HORIZON, predict, |poses| window::escape(poses, at))
        } else if self.method == Method::Orca {
            self.orca.choose(&truth, &people, &self.to_go, secs)
        } else {
            self.window
                .choose(&truth, HORIZON, predict, |poses| window::approach(poses, &self.to_go))
        }
    }

    /// Everybody within range of a place; velocities over the last `secs` seconds.
    fn track(&mut self, simulation: &Simulation, from: Point2<f64>, secs: f64) -> Vec<Person> {
        let places: Vec<Point2<f64>> = simulation.movers().collect();
        let person = |((at, before), radius): ((&Point2<f64>, &Point2<f64>), &f64)| Person {
            at: *at,
            velocity: match self.method {
                Method::ConstantVelocity | Method::Orca => (at - before) / secs,
                Method::Standing | Method::AllKnowing => Vector2::zeros(),
            },
            radius: *radius,
        };
        let people = places
            .iter()
            .zip(&self.before)
            .zip(&self.radii)
            .map(person)
            .filter(|person| (person.at - from).norm() <= SIGHT)
            .collect();
        self.before = places;
        people
    }
}

//! May a motion be trusted? The true footprint's sweep along it, against the map, and the largest use of every limit of the drive, both
//! from the motion itself and not from what any solver said, before it leaves the house.

use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{Certificate, CorridorFigures, LimitUse, SolverFigures};
use zenav_protocol::robot::Drive;

use super::corridor::Room;
use super::shortcut::is_permitted_along;
use super::timing::{JerkFigures, Limits, Motion};
use crate::space::ConfigurationSpace;

/// Largest distance between two checked poses, m, and turn between them, rad.
const STEP: f64 = 0.03;
const TURN: f64 = 0.08;

/// The motion touches an obstacle, or leads where nobody has looked.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("collision")]
pub struct Collision;

/// Least distance (m) of the true footprint to an obstacle along a motion; `None` when there is nothing within the space's reach.
///
/// The first `exempt` metres around the start are no reason to refuse: a robot that stands where it should not has to leave. They
/// count in the clearance that is told.
///
/// # Errors
/// [`Collision`].
pub fn clearance(
    space: &ConfigurationSpace,
    motion: &Motion,
    limits: &Limits,
    exempt: f64,
) -> Result<Option<f64>, Collision> {
    let period = (STEP / limits.speed).min(TURN / limits.yaw_rate);
    // Poses are joined by straight lines; the arc between two of them bulges by no more than this.
    let bulge = limits.lateral_acceleration * period * period / 8.0;
    let all: Vec<Pose2> = motion
        .states(period)
        .into_iter()
        .map(|state| state.point.pose())
        .collect();
    let leaving = all.first().filter(|_| exempt > 0.0).map_or(0, |start| {
        let left = all.iter().position(|pose| pose.distance(start) > exempt);
        left.unwrap_or(all.len())
    });
    let poses = &all[leaving..];
    if poses
        .windows(2)
        .any(|pair| !is_permitted_along(space, pair[0].position(), pair[1].position()))
    {
        return Err(Collision);
    }
    let least = sweep(space, poses);
    if least <= bulge && !poses.is_empty() {
        return Err(Collision);
    }
    let least = if leaving > 0 {
        least.min(sweep(space, &all[..leaving]))
    } else {
        least
    };
    Ok((least < space.reach()).then_some(least))
}

/// Poses that are measured together.
const CHUNK: usize = 16;

/// As [`ConfigurationSpace::sweep_min_clearance`], but the distance field tells first where it is worth looking.
fn sweep(space: &ConfigurationSpace, poses: &[Pose2]) -> f64 {
    let radius = space.footprint().circumscribed_radius();
    let bound = |pose: &Pose2| {
        let Some(cell) = space.spec().cell_at(pose.position()) else {
            return 0.0;
        };
        space.field().distance(cell) - (space.spec().center(cell) - pose.position()).norm() - radius
    };
    // Between two poses that both count, no place is farther from the nearer one than half a step.
    let bounds = (0..poses.len()).step_by(CHUNK).map(|begin| {
        let chunk = &poses[begin..(begin + CHUNK + 1).min(poses.len())];
        (
            chunk.iter().map(bound).fold(f64::INFINITY, f64::min) - 0.5 * STEP - radius * 0.5 * TURN,
            chunk,
        )
    });
    let mut chunks: Vec<_> = bounds.collect();
    chunks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut least = space.reach();
    for (bound, chunk) in chunks {
        if bound >= least {
            break;
        }
        least = least.min(space.sweep_min_clearance(chunk));
    }
    least
}

/// How the parts of a curve came about; one part after the other is added.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    corridor: Option<CorridorFigures>,
    geometry: Option<SolverFigures>,
}

impl Evidence {
    /// Adds a curve through rooms.
    pub fn add(&mut self, rooms: &[Room], solver: SolverFigures) {
        let width = rooms.iter().map(width).fold(f64::INFINITY, f64::min);
        let corridor = self.corridor.get_or_insert(CorridorFigures {
            rooms: 0,
            least_width: f64::INFINITY,
        });
        corridor.rooms += rooms.len();
        corridor.least_width = corridor.least_width.min(width);
        let known = self.geometry.get_or_insert_with(|| SolverFigures {
            status: solver.status.clone(),
            ..SolverFigures::default()
        });
        if known.status == "Solved" {
            known.status = solver.status;
        }
        known.iterations += solver.iterations;
        known.gap = known.gap.max(solver.gap);
    }

    /// The geometry solver's status; empty without a curve.
    #[must_use]
    pub fn status(&self) -> String {
        self.geometry
            .as_ref()
            .map_or(String::new(), |solver| solver.status.clone())
    }
}

/// Width of a room across the middle of its piece, m.
fn width(room: &Room) -> f64 {
    let along = room.to - room.from;
    let across = nalgebra::Vector2::new(-along.y, along.x);
    let Some(across) = across.try_normalize(1e-9) else {
        return f64::INFINITY;
    };
    let middle = nalgebra::center(&room.from, &room.to);
    let reach = |direction: nalgebra::Vector2<f64>| {
        let sides = room
            .sides
            .iter()
            .map(|side| (side.depth(middle), side.normal.dot(&direction)));
        sides
            .filter(|(_, towards)| *towards > 1e-9)
            .map(|(depth, towards)| depth / towards)
            .fold(f64::INFINITY, f64::min)
    };
    reach(across) + reach(-across)
}

/// The certificate of a motion: what its parts told, and what the motion itself shows.
#[must_use]
pub fn certify(motion: &Motion, drive: &Drive, evidence: Evidence, jerk: Option<JerkFigures>) -> Certificate {
    let time_law = match &jerk {
        None => "sweep".to_owned(),
        Some(JerkFigures { failed: None, .. }) => "jerk_limited".to_owned(),
        Some(JerkFigures {
            failed: Some(error), ..
        }) => format!("sweep:{error}"),
    };
    Certificate {
        corridor: evidence.corridor,
        geometry: evidence.geometry,
        time_law,
        timing: jerk.map(|figures| figures.solver),
        largest_use: largest_use(motion, drive),
        lower_bound: motion.lower_bound(),
        over_lower_bound: if motion.lower_bound() > 0.0 {
            motion.duration() / motion.lower_bound()
        } else {
            1.0
        },
    }
}

/// Acceleration that differs by less where two pieces of a motion meet does not jump, m/s².
const SAME_ACCELERATION: f64 = 1e-6;

/// Largest use of each limit along a motion.
#[must_use]
pub fn largest_use(motion: &Motion, drive: &Drive) -> LimitUse {
    let mut most = LimitUse::default();
    let mut jerk = 0.0_f64;
    let half = 0.5 * drive.wheel_separation;
    let mut before: Option<(f64, f64)> = None;
    for rates in motion.rates() {
        let (v, w) = (rates.twist.v, rates.twist.w);
        for wheel in drive.wheels(rates.twist) {
            most.wheel_speed = most.wheel_speed.max(wheel.abs() / drive.max_wheel_speed);
        }
        let accelerations = [rates.a - half * rates.alpha, rates.a + half * rates.alpha];
        for wheel in accelerations {
            most.wheel_acceleration = most.wheel_acceleration.max(wheel.abs() / drive.acceleration());
        }
        most.speed = most.speed.max(v.abs() / drive.top_speed());
        most.lateral_acceleration = most
            .lateral_acceleration
            .max((v * w).abs() / drive.max_lateral_acceleration);
        most.yaw_rate = most.yaw_rate.max(w.abs() / drive.top_yaw_rate());
        // On the spot there is no base that moves: a wheel's.
        let acceleration = if v == 0.0 && rates.a == 0.0 {
            half * rates.alpha
        } else {
            rates.a
        };
        if let Some((t, other)) = before {
            let change = (acceleration - other).abs();
            if rates.t - t > 1e-9 {
                jerk = jerk.max(change / (rates.t - t));
            } else if change > SAME_ACCELERATION {
                jerk = f64::INFINITY;
            }
        }
        before = Some((rates.t, acceleration));
    }
    most.jerk = drive
        .max_jerk
        .map(|limit| jerk / limit)
        .filter(|use_of| use_of.is_finite());
    most
}

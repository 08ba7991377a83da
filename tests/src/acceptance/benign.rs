//! Benign plans. Plans that are clear of all obstacles, so a robot must finish them without an intervention.

use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::{Trajectory, TrajectoryPoint};
use zenav_protocol::robot::{Drive, RobotModel};
use zenav_sim::{Simulation, World};

use super::worlds::{HALF, Rng};

/// Clearance of a benign path from static obstacles, m.
const BENIGN_CLEARANCE: f64 = 0.12;
/// Clearance of a benign path from the paths of movers, m: no mover comes near within the robot's stopping time.
const MOVER_CLEARANCE: f64 = 1.8;

/// A pose with clearance for the robot.
pub(super) fn place(rng: &mut Rng, sim: &Simulation, model: &RobotModel, room: f64) -> Option<Pose2> {
    (0..200).find_map(|_| {
        let pose = Pose2::new(
            rng.between(-HALF, HALF),
            rng.between(-HALF, HALF),
            rng.between(-3.1, 3.1),
        );
        (sim.clearance(&model.footprint, pose) > room).then_some(pose)
    })
}

/// A turn on the spot and a straight path, both clear of all obstacles.
pub(super) fn benign_trajectory(
    rng: &mut Rng,
    world: &World,
    sim: &Simulation,
    model: &RobotModel,
    start: Pose2,
) -> Option<Trajectory> {
    let reach = model.footprint.circumscribed_radius();
    (0..100).find_map(|_| {
        let goal = place(rng, sim, model, BENIGN_CLEARANCE)?;
        let to = goal.position() - start.position();
        let (length, yaw) = (to.norm(), to.y.atan2(to.x));
        let steps = (length / 0.02).ceil().max(1.0) as usize;
        let free = (0..=steps).all(|step| {
            let at = start.position() + to * (step as f64 / steps as f64);
            let pose = Pose2::new(at.x, at.y, yaw);
            let is_clear = world
                .movers()
                .iter()
                .all(|mover| mover.berth(at) > reach + MOVER_CLEARANCE);
            is_clear && sim.clearance(&model.footprint, pose) > BENIGN_CLEARANCE
        });
        (free && length > 0.5).then(|| turn_and_go(&model.drive, start, yaw, length))
    })
}

/// Points 20 ms apart: a turn on the spot, then straight on, each from rest to rest at nine tenths of the limits.
fn turn_and_go(drive: &Drive, start: Pose2, yaw: f64, length: f64) -> Trajectory {
    let turn = wrap_angle(yaw - start.yaw);
    let acceleration = 0.7 * drive.acceleration();
    let spin = Ramp::new(
        turn.abs(),
        0.9 * drive.top_yaw_rate().min(2.0),
        acceleration / drive.wheel_separation,
    );
    let roll = Ramp::new(length, 0.9 * drive.top_speed(), acceleration);
    let mut points = Vec::new();
    let total = spin.duration + roll.duration;
    for step in 0..=(total / 0.02).ceil() as usize {
        let t = (step as f64 * 0.02).min(total);
        if points.last().is_some_and(|last: &TrajectoryPoint| t - last.t < 1e-6) {
            break;
        }
        let (turned, w) = spin.at(t);
        let (distance, v) = roll.at(t - spin.duration);
        let heading = start.yaw + turn.signum() * turned;
        points.push(TrajectoryPoint {
            t,
            x: start.x + distance * yaw.cos(),
            y: start.y + distance * yaw.sin(),
            yaw: wrap_angle(heading),
            v,
            w: turn.signum() * w,
        });
    }
    points.into()
}

/// Trapezoidal speed profile from rest to rest.
struct Ramp {
    length: f64,
    top: f64,
    rise: f64,
    duration: f64,
}

impl Ramp {
    fn new(length: f64, top: f64, acceleration: f64) -> Self {
        let top = top.min((length * acceleration).sqrt());
        let rise = top / acceleration;
        let duration = if top > 0.0 { length / top + rise } else { 0.0 };
        Self {
            length,
            top,
            rise,
            duration,
        }
    }

    /// Distance and speed at a time.
    fn at(&self, t: f64) -> (f64, f64) {
        if t <= 0.0 || self.duration <= 0.0 {
            return (0.0, 0.0);
        }
        if t >= self.duration {
            return (self.length, 0.0);
        }
        let acceleration = self.top / self.rise;
        if t < self.rise {
            return (0.5 * acceleration * t * t, acceleration * t);
        }
        let left = self.duration - t;
        if left < self.rise {
            return (self.length - 0.5 * acceleration * left * left, acceleration * left);
        }
        (self.top * (t - 0.5 * self.rise), self.top)
    }
}

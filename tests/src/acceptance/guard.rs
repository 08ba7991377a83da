//! Collision monitor. Whether the robot ever drives into an obstacle, whatever it is commanded: random worlds, shipped robots with wheel
//! errors, movers no faster than the robot, and commands from benign to adversarial.

use nalgebra::Point2;
use zenav_edge::Inbox;
use zenav_edge::collision_monitor::AT_A_CORNER;
use zenav_fixtures::robot;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{LeaseRole, Teleop, Trajectory};
use zenav_protocol::robot::{Drive, Footprint, RobotModel};
use zenav_protocol::time::Stamp;
use zenav_sim::Simulation;

use super::benign::{benign_trajectory, place};
use super::sight::Sight;
use super::sim_rig::{SimRig, SimRigError};
use super::worlds::{HALF, Rng, random_world};

/// The robot's own speed towards an obstacle at contact from which on it drove into it, m/s.
pub const GENTLE: f64 = 0.01;
/// Length of a run, s.
const DURATION: f64 = 12.0;
/// At power-on no mover in the blind sector is within this time of the robot, s. The robot has never seen that area, and no collision
/// monitor could tell such a world from one in which the same turn is benign. The person who powers the robot on must check it.
const POWER_ON_CLEAR: f64 = 1.5;

/// The command sent to the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Command {
    /// A plan clear of all obstacles, to be finished without an intervention.
    Benign,
    /// Teleop: full speed at the nearest obstacle.
    AtTheNearest,
    /// Teleop: full speed backwards and along arcs.
    Backwards,
    /// Teleop: fast random arcs.
    Wild,
    /// Teleop: full speed, then silence or old stamps.
    Stale,
    /// Teleop: not-a-number and infinite velocities.
    NotANumber,
    /// Teleop: contradictory commands every tick.
    Contradictory,
    /// Teleop: replayed messages.
    Replayed,
    /// A plan through obstacles.
    ThroughWalls,
    /// Teleop: full speed while the lidar is silent or its sweeps are cut short.
    Blind,
}

const COMMANDS: [Command; 10] = [
    Command::Benign,
    Command::AtTheNearest,
    Command::Backwards,
    Command::Wild,
    Command::Stale,
    Command::NotANumber,
    Command::Contradictory,
    Command::Replayed,
    Command::ThroughWalls,
    Command::Blind,
];

/// The result of a run in one world.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Seed of the world.
    pub seed: u64,
    /// The robot.
    pub robot: String,
    /// The command.
    pub command: Command,
    /// Whether the world had movers.
    pub movers: bool,
    /// Contacts, however gentle.
    pub contacts: u32,
    /// The robot's largest own speed towards an obstacle that it touched, m/s, except movers that were never in sight.
    pub hardest: f64,
    /// The same for movers that no lidar had ever in sight, by ground truth: those that stood or came in the blind sector.
    pub hardest_unseen: f64,
    /// Distance driven, m.
    pub length: f64,
    /// Reason of each intervention of the collision monitor.
    pub interventions: Vec<String>,
    /// Whether a benign plan was finished.
    pub finished: bool,
    /// Whether the robot left a plan to make way.
    pub made_way: bool,
}

impl Outcome {
    /// Whether the robot drove into nothing, and finished a benign plan without an intervention but at a blind corner, or left it to make
    /// way for a mover.
    #[must_use]
    pub fn is_good(&self) -> bool {
        let unhindered = self.finished && self.interventions.iter().all(|reason| reason == AT_A_CORNER);
        let made_way = self.movers && self.made_way;
        self.hardest <= GENTLE && (self.command != Command::Benign || unhindered || made_way)
    }
}

/// Whether the collision monitor is between commands and wheels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protection {
    /// As on every robot.
    Monitored,
    /// Teleop commands go straight to the wheels: the negative control, in which a run must fail.
    Unprotected,
}

/// Drives in the world of a seed.
///
/// # Errors
/// [`SimRigError`] when the seed gives no valid world.
pub fn drive(seed: u64, protection: Protection) -> Result<Outcome, SimRigError> {
    drive_watched(seed, protection, |_| {})
}

/// A shipped robot with errors of its drive and a late lidar.
fn random_robot(rng: &mut Rng) -> (&'static str, RobotModel) {
    let names = ["tiago", "jackal", "turtlebot3_waffle", "neato"];
    let name = names.get(rng.below(names.len())).copied().unwrap_or("tiago");
    let mut model = robot(name);
    let mut error = |share: f64| rng.between(-share, share);
    model.drive.errors.wheel_radius = [error(0.01), error(0.01)];
    model.drive.errors.wheel_separation = error(0.01);
    model.drive.errors.slip = 0.002;
    let latency = [0.0, 0.02, 0.05][rng.below(3)];
    for (_, lidar) in model.all_lidars_mut() {
        lidar.latency = latency;
    }
    (name, model)
}

/// Most worlds drawn for a seed until one has a start and, for a benign plan, a free path.
const MOST_DRAWS: u32 = 1000;

/// Drives in the world of a seed; `watch` is called at every tick.
///
/// # Errors
/// [`SimRigError`] when the seed gives no valid world.
pub fn drive_watched(
    seed: u64,
    protection: Protection,
    mut watch: impl FnMut(&SimRig),
) -> Result<Outcome, SimRigError> {
    let mut rng = Rng::new(seed, 1);
    let command = COMMANDS
        .get(rng.below(COMMANDS.len()))
        .copied()
        .unwrap_or(Command::Wild);
    let (name, model) = random_robot(&mut rng);
    let movers = rng.chance(0.5);
    let mover_speed = if movers { 0.95 * model.drive.top_speed() } else { 0.0 };
    for _ in 0..MOST_DRAWS {
        let world = random_world(&mut rng, mover_speed)?;
        let empty = Simulation::new(&world, Vec::new(), seed)?;
        let Some(start) = place(&mut rng, &empty, &model, 0.25) else {
            continue;
        };
        if is_someone_in_blind_sector(&empty, &model, start) {
            continue;
        }
        let role = match command {
            Command::Benign | Command::ThroughWalls => LeaseRole::Mission,
            _ => LeaseRole::Operator,
        };
        let mut rig = SimRig::new(&world, &model, start, seed, role)?;
        rig.run(0.5);
        let duration = match command {
            Command::Benign => {
                // The plan must also be clear while the robot still stands at its start.
                let Some(trajectory) = benign_trajectory(&mut rng, &world, &empty, &model, start) else {
                    continue;
                };
                let secs = trajectory.last().map_or(0.0, |point| point.t);
                rig.plan = Some(rig.plan(Vec::new(), trajectory));
                1.2 * secs + 4.0
            }
            Command::ThroughWalls => {
                let to = |rng: &mut Rng| Point2::new(rng.between(-HALF, HALF), rng.between(-HALF, HALF));
                let waypoints = (0..4).map(|_| to(&mut rng)).collect();
                rig.plan = Some(rig.plan(waypoints, Trajectory::default()));
                DURATION
            }
            _ => DURATION,
        };
        let mut adversary = Adversary::new(command, &model.drive);
        let mut made_way = false;
        let mut sight = Sight::new(&world);
        let (mut hardest, mut hardest_unseen) = (0.0_f64, 0.0_f64);
        for tick in 0..(duration * 50.0) as usize {
            let inbox = adversary.command(&mut rng, &mut rig, tick);
            let sweeps = adversary.sweeps;
            let mut measured = Vec::new();
            rig.tick(inbox, |readings| {
                measured.clone_from(&readings.sweeps);
                match sweeps {
                    0 => {}
                    1 => readings.sweeps.clear(),
                    _ => readings
                        .sweeps
                        .iter_mut()
                        .for_each(|sweep| sweep.ranges.truncate(sweeps)),
                }
            });
            sight.see(&rig, &measured);
            let speed = rig.truth().hardest_contact;
            if speed > hardest.max(hardest_unseen) {
                if sight.is_touched_unseen(&rig) {
                    hardest_unseen = speed;
                } else {
                    hardest = speed;
                }
            }
            if protection == Protection::Unprotected
                && let Some(twist) = adversary.twist()
            {
                rig.sim.drive(0, rig.model.drive.wheels(twist));
            }
            watch(&rig);
            made_way |= rig.pilot.is_making_way();
            if command == Command::Benign && rig.finished() {
                break;
            }
        }
        let truth = rig.truth();
        return Ok(Outcome {
            seed,
            robot: name.to_owned(),
            command,
            movers,
            contacts: truth.collisions,
            hardest,
            hardest_unseen,
            length: truth.length,
            interventions: rig.interventions().map(str::to_owned).collect(),
            finished: rig.finished(),
            made_way,
        });
    }
    Err(SimRigError::NoPath(seed))
}

/// Whether a mover starts nearby in the lidar's blind sector.
fn is_someone_in_blind_sector(sim: &Simulation, model: &RobotModel, start: Pose2) -> bool {
    let views: Vec<_> = model
        .all_lidars()
        .map(|(_, lidar)| ((start * lidar.mount).inverse(), 0.5 * lidar.field_of_view))
        .collect();
    let near = model.footprint.circumscribed_radius() + POWER_ON_CLEAR * model.drive.top_speed();
    sim.movers().any(|mover| {
        views.iter().all(|(laser_from_map, half)| {
            let local = laser_from_map.transform_point(mover);
            let is_seen = local.y.atan2(local.x).abs() <= *half;
            !is_seen && local.coords.norm() < near
        })
    })
}

/// Sends adversarial commands.
struct Adversary {
    command: Command,
    top: Twist2,
    wanted: Twist2,
    until: usize,
    recorded: Vec<Teleop>,
    /// 0: whole sweeps; 1: no sweeps; more: sweeps truncated to that many beams.
    sweeps: usize,
}

impl Adversary {
    fn new(command: Command, drive: &Drive) -> Self {
        Self {
            command,
            top: Twist2::new(drive.top_speed(), drive.top_yaw_rate()),
            wanted: Twist2::ZERO,
            until: 0,
            recorded: Vec::new(),
            sweeps: 0,
        }
    }

    /// The commanded twist, if it is finite; `None` for commands that are plans.
    fn twist(&self) -> Option<Twist2> {
        let is_plan = matches!(self.command, Command::Benign | Command::ThroughWalls);
        let is_number = self.wanted.v.is_finite() && self.wanted.w.is_finite();
        (!is_plan && is_number).then_some(self.wanted)
    }

    /// The messages of this tick.
    fn command(&mut self, rng: &mut Rng, rig: &mut SimRig, tick: usize) -> Inbox {
        let mut inbox = Inbox::default();
        let fresh = tick >= self.until;
        if fresh {
            self.until = tick + 10 + rng.below(90);
        }
        let Twist2 { v, w } = self.top;
        match self.command {
            Command::Benign | Command::ThroughWalls => return inbox,
            Command::AtTheNearest => self.wanted = at_the_nearest(rig, self.top),
            Command::Backwards if fresh => {
                let turn = if rng.chance(0.5) { 0.0 } else { rng.between(-1.0, 1.0) };
                let ahead = if rng.chance(0.8) { -1.0 } else { 1.0 };
                self.wanted = Twist2::new(ahead * v, turn * w);
            }
            Command::Contradictory => {
                self.wanted = Twist2::new(
                    if rng.chance(0.5) { v } else { -v },
                    if rng.chance(0.5) { w } else { -w },
                );
            }
            Command::Stale => self.wanted = at_the_nearest(rig, self.top),
            Command::NotANumber if fresh => {
                let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, v];
                let pick = |rng: &mut Rng| odd[rng.below(odd.len())];
                self.wanted = Twist2::new(pick(rng), pick(rng));
            }
            Command::Blind => {
                self.wanted = at_the_nearest(rig, self.top);
                if fresh {
                    self.sweeps = [0, 0, 1, 1, 2, 300][rng.below(6)];
                }
            }
            Command::Wild | Command::Replayed if fresh => {
                let ahead = if rng.chance(0.75) { 1.0 } else { -1.0 };
                let turn = if rng.chance(0.4) { 0.0 } else { rng.between(-1.0, 1.0) };
                self.wanted = Twist2::new(ahead * v, turn * w);
            }
            _ => {}
        }
        if !tick.is_multiple_of(2) {
            return inbox;
        }
        let Some(mut teleop) = rig.teleop(self.wanted) else {
            return inbox;
        };
        match self.command {
            // By turns: commands for 1.5 s, silence, old stamps.
            Command::Stale => match tick / 75 % 3 {
                0 => {}
                1 => {
                    rig.sends_heartbeats = false;
                    return inbox;
                }
                _ => teleop.echo = Stamp(teleop.echo.0.saturating_sub(1_000_000_000)),
            },
            Command::Replayed => {
                if tick < 100 {
                    self.recorded.push(teleop.clone());
                } else if let Some(old) = self.recorded.get(tick % self.recorded.len().max(1)) {
                    inbox.teleops.push(old.clone());
                }
                if tick > 300 {
                    return inbox;
                }
            }
            Command::Contradictory => {
                let mut foreign = teleop.clone();
                foreign.epoch = rng.below(4) as u64;
                foreign.twist = Twist2::new(-teleop.twist.v, teleop.twist.w);
                inbox.teleops.push(foreign);
            }
            _ => {}
        }
        inbox.teleops.push(teleop);
        inbox
    }
}

/// Full speed at the nearest obstacle, by the true state.
fn at_the_nearest(rig: &SimRig, top: Twist2) -> Twist2 {
    let here = rig.truth().map_from_base;
    let disc = Footprint::Radius(1e-3);
    let reach = rig.model.footprint.circumscribed_radius() + 0.05;
    let probe = |turn: f64| {
        let at = here * Pose2::new(reach * turn.cos(), reach * turn.sin(), 0.0);
        rig.sim.clearance_beside(0, &disc, at)
    };
    let bearing = (0..36)
        .map(|step| wrap_angle(f64::from(step) * 0.1745))
        .min_by(|a, b| probe(*a).total_cmp(&probe(*b)))
        .unwrap_or(0.0);
    if bearing.abs() > 0.6 {
        Twist2::new(0.0, top.w.min(2.0) * bearing.signum())
    } else {
        Twist2::new(top.v, (3.0 * bearing).clamp(-top.w, top.w))
    }
}

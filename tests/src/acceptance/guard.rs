//! Does the robot ever drive into anything, whatever it is told? Random worlds, shipped robots with crooked wheels, movers that
//! are no faster than the robot, and commands from the gentle to the mad.

use nalgebra::Point2;
use zenav_edge::Inbox;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{LeaseRole, Teleop, TrajectoryPoint};
use zenav_protocol::robot::{Drive, Footprint, RobotModel};
use zenav_protocol::time::Stamp;
use zenav_sim::{Simulation, World};

use super::sim_rig::{SimRig, SimRigError, robot};
use super::worlds::{HALF, Rng, random};

/// The robot's own speed towards something at contact that counts as driving into it, m/s.
pub const GENTLE: f64 = 0.01;
/// How long each world is driven in, s.
const DURATION: f64 = 12.0;
/// Whoever switches a robot on sees to it that nobody can come up within this time from where it cannot look, s: it has never
/// seen that place, and no guard could tell such a world from one in which the same turn is benign.
const SWITCHED_ON_CLEAR: f64 = 1.5;
/// Distance that a benign way keeps from what stands, m.
const BENIGN_CLEARANCE: f64 = 0.12;
/// And from where movers go, m: none comes near within the robot's time to stop.
const BENIGN_BERTH: f64 = 1.8;

/// What the robot is told.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Command {
    /// A plan past everything: to be finished without an intervention.
    Benign,
    /// By hand, full speed at the nearest thing.
    AtTheNearest,
    /// By hand, full speed backwards and along arcs.
    Backwards,
    /// By hand, fast arcs at random.
    Wild,
    /// By hand, full speed, then silence or old stamps.
    Stale,
    /// By hand, with numbers that are none among them.
    NotANumber,
    /// By hand, another thing every tick.
    Contradictory,
    /// By hand, and the same messages again.
    Replayed,
    /// A plan through whatever stands there.
    ThroughWalls,
    /// By hand, full speed, while the lidar falls silent or talks nonsense.
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

/// How one world went.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// The world.
    pub seed: u64,
    /// Who drove.
    pub robot: String,
    /// What it was told.
    pub command: Command,
    /// Whether anything moved.
    pub movers: bool,
    /// Contacts, however gentle.
    pub contacts: u32,
    /// The robot's largest own speed towards something that it touched, m/s.
    pub hardest: f64,
    /// Way driven, m.
    pub length: f64,
    /// Why the guard stepped in, each time.
    pub interventions: Vec<String>,
    /// Whether a benign plan was finished.
    pub finished: bool,
}

impl Outcome {
    /// Whether it went as it must.
    #[must_use]
    pub fn is_good(&self) -> bool {
        let benign = self.command != Command::Benign || (self.finished && self.interventions.is_empty());
        self.hardest <= GENTLE && benign
    }
}

/// Drives in the world of a seed.
///
/// # Errors
/// [`SimRigError`] when no world can be made of the seed.
pub fn drive(seed: u64) -> Result<Outcome, SimRigError> {
    drive_watched(seed, |_| {})
}

/// Worlds that are drawn for a seed until one has a start and, for a drive that is to succeed, a way.
const MOST_DRAWS: u32 = 1000;

/// Drives in the world of a seed; `watch` sees every tick.
///
/// # Errors
/// [`SimRigError`] when no world can be made of the seed.
pub fn drive_watched(seed: u64, mut watch: impl FnMut(&SimRig)) -> Result<Outcome, SimRigError> {
    let mut dice = Rng::new(seed, 1);
    let command = COMMANDS
        .get(dice.below(COMMANDS.len()))
        .copied()
        .unwrap_or(Command::Wild);
    let names = ["tiago", "jackal", "turtlebot3_waffle", "neato"];
    let name = names.get(dice.below(names.len())).copied().unwrap_or("tiago");
    let mut model = robot(name)?;
    let mut crooked = |share: f64| dice.between(-share, share);
    model.drive.errors.wheel_radius = [crooked(0.01), crooked(0.01)];
    model.drive.errors.wheel_separation = crooked(0.01);
    model.drive.errors.slip = 0.002;
    let latency = [0.0, 0.02, 0.05][dice.below(3)];
    for (_, lidar) in model.all_lidars_mut() {
        lidar.latency = latency;
    }
    let movers = dice.chance(0.5);
    let mover_speed = if movers { 0.95 * model.drive.top_speed() } else { 0.0 };
    for _ in 0..MOST_DRAWS {
        let world = random(&mut dice, mover_speed)?;
        let empty = Simulation::new(&world, Vec::new(), seed)?;
        let Some(start) = place(&mut dice, &empty, &model, 0.25) else {
            continue;
        };
        if somebody_stands_behind(&empty, &model, start) {
            continue;
        }
        let role = match command {
            Command::Benign | Command::ThroughWalls => LeaseRole::Mission,
            _ => LeaseRole::Operator,
        };
        let mut ground = SimRig::new(&world, &model, start, seed, role)?;
        ground.run(0.5);
        let duration = match command {
            Command::Benign => {
                // Out of the way of everything while the robot still stands there, too.
                let Some(way) = benign_way(&mut dice, &world, &empty, &model, start) else {
                    continue;
                };
                let secs = way.last().map_or(0.0, |point| point.t);
                ground.plan = Some(ground.plan(Vec::new(), way));
                1.2 * secs + 4.0
            }
            Command::ThroughWalls => {
                let to = |dice: &mut Rng| Point2::new(dice.between(-HALF, HALF), dice.between(-HALF, HALF));
                let waypoints = (0..4).map(|_| to(&mut dice)).collect();
                ground.plan = Some(ground.plan(waypoints, Vec::new()));
                DURATION
            }
            _ => DURATION,
        };
        let mut tyrant = Adversary::new(command, &model.drive);
        for tick in 0..(duration * 50.0) as usize {
            let inbox = tyrant.command(&mut dice, &mut ground, tick);
            let spoilt = tyrant.blind;
            ground.tick(inbox, |readings| match spoilt {
                0 => {}
                1 => readings.sweeps.clear(),
                _ => {
                    for sweep in &mut readings.sweeps {
                        sweep.ranges.truncate(spoilt);
                    }
                }
            });
            watch(&ground);
            if command == Command::Benign && ground.finished() {
                break;
            }
        }
        let truth = ground.truth();
        return Ok(Outcome {
            seed,
            robot: name.to_owned(),
            command,
            movers,
            contacts: truth.collisions,
            hardest: truth.hardest_contact,
            length: truth.length,
            interventions: ground.interventions().map(str::to_owned).collect(),
            finished: ground.finished(),
        });
    }
    Err(SimRigError::NoWay(seed))
}

/// A pose where the robot has room.
fn place(dice: &mut Rng, sim: &Simulation, model: &RobotModel, room: f64) -> Option<Pose2> {
    (0..200).find_map(|_| {
        let pose = Pose2::new(
            dice.between(-HALF, HALF),
            dice.between(-HALF, HALF),
            dice.between(-3.1, 3.1),
        );
        (sim.clearance(&model.footprint, pose) > room).then_some(pose)
    })
}

/// Whether anything that moves begins close by in the lidar's blind sector.
fn somebody_stands_behind(sim: &Simulation, model: &RobotModel, start: Pose2) -> bool {
    let views: Vec<_> = model
        .all_lidars()
        .map(|(_, lidar)| ((start * lidar.mount).inverse(), 0.5 * lidar.field_of_view))
        .collect();
    let near = model.footprint.circumscribed_radius() + SWITCHED_ON_CLEAR * model.drive.top_speed();
    sim.movers().any(|mover| {
        views.iter().all(|(laser_from_map, half)| {
            let local = laser_from_map.transform_point(mover);
            let is_seen = local.y.atan2(local.x).abs() <= *half;
            !is_seen && local.coords.norm() < near
        })
    })
}

/// A turn on the spot and a straight way that keeps clear of everything.
fn benign_way(
    dice: &mut Rng,
    world: &World,
    sim: &Simulation,
    model: &RobotModel,
    start: Pose2,
) -> Option<Vec<TrajectoryPoint>> {
    let reach = model.footprint.circumscribed_radius();
    (0..100).find_map(|_| {
        let goal = place(dice, sim, model, BENIGN_CLEARANCE)?;
        let to = goal.position() - start.position();
        let (length, yaw) = (to.norm(), to.y.atan2(to.x));
        let steps = (length / 0.02).ceil().max(1.0) as usize;
        let free = (0..=steps).all(|step| {
            let at = start.position() + to * (step as f64 / steps as f64);
            let pose = Pose2::new(at.x, at.y, yaw);
            let berth = world
                .movers()
                .iter()
                .all(|mover| mover.berth(at) > reach + BENIGN_BERTH);
            berth && sim.clearance(&model.footprint, pose) > BENIGN_CLEARANCE
        });
        (free && length > 0.5).then(|| turn_and_go(&model.drive, start, yaw, length))
    })
}

/// Points 20 ms apart: turn on the spot, then straight on, each from rest to rest with nine tenths of what the robot can.
fn turn_and_go(drive: &Drive, start: Pose2, yaw: f64, length: f64) -> Vec<TrajectoryPoint> {
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
        let (way, v) = roll.at(t - spin.duration);
        let heading = start.yaw + turn.signum() * turned;
        points.push(TrajectoryPoint {
            t,
            x: start.x + way * yaw.cos(),
            y: start.y + way * yaw.sin(),
            yaw: wrap_angle(heading),
            v,
            w: turn.signum() * w,
        });
    }
    points
}

/// From rest to rest over a way: speeds up, holds, slows down.
struct Ramp {
    way: f64,
    top: f64,
    rise: f64,
    duration: f64,
}

impl Ramp {
    fn new(way: f64, top: f64, acceleration: f64) -> Self {
        let top = top.min((way * acceleration).sqrt());
        let rise = top / acceleration;
        let duration = if top > 0.0 { way / top + rise } else { 0.0 };
        Self {
            way,
            top,
            rise,
            duration,
        }
    }

    /// Way and speed at a time.
    fn at(&self, t: f64) -> (f64, f64) {
        if t <= 0.0 || self.duration <= 0.0 {
            return (0.0, 0.0);
        }
        if t >= self.duration {
            return (self.way, 0.0);
        }
        let acceleration = self.top / self.rise;
        if t < self.rise {
            return (0.5 * acceleration * t * t, acceleration * t);
        }
        let left = self.duration - t;
        if left < self.rise {
            return (self.way - 0.5 * acceleration * left * left, acceleration * left);
        }
        (self.top * (t - 0.5 * self.rise), self.top)
    }
}

/// Who commands by hand.
struct Adversary {
    command: Command,
    top: Twist2,
    wanted: Twist2,
    until: usize,
    recorded: Vec<Teleop>,
    /// 0: the lidar is heard; 1: it is silent; more: its sweeps have that many beams.
    blind: usize,
}

impl Adversary {
    fn new(command: Command, drive: &Drive) -> Self {
        Self {
            command,
            top: Twist2::new(drive.top_speed(), drive.top_yaw_rate()),
            wanted: Twist2::ZERO,
            until: 0,
            recorded: Vec::new(),
            blind: 0,
        }
    }

    /// What goes to the robot in this tick.
    fn command(&mut self, dice: &mut Rng, ground: &mut SimRig, tick: usize) -> Inbox {
        let mut inbox = Inbox::default();
        let fresh = tick >= self.until;
        if fresh {
            self.until = tick + 10 + dice.below(90);
        }
        let Twist2 { v, w } = self.top;
        match self.command {
            Command::Benign | Command::ThroughWalls => return inbox,
            Command::AtTheNearest => self.wanted = at_the_nearest(ground, self.top),
            Command::Backwards if fresh => {
                let turn = if dice.chance(0.5) { 0.0 } else { dice.between(-1.0, 1.0) };
                let ahead = if dice.chance(0.8) { -1.0 } else { 1.0 };
                self.wanted = Twist2::new(ahead * v, turn * w);
            }
            Command::Contradictory => {
                self.wanted = Twist2::new(
                    if dice.chance(0.5) { v } else { -v },
                    if dice.chance(0.5) { w } else { -w },
                );
            }
            Command::Stale => self.wanted = at_the_nearest(ground, self.top),
            Command::NotANumber if fresh => {
                let odd = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, -1e300, v];
                let pick = |dice: &mut Rng| odd[dice.below(odd.len())];
                self.wanted = Twist2::new(pick(dice), pick(dice));
            }
            Command::Blind => {
                self.wanted = at_the_nearest(ground, self.top);
                if fresh {
                    self.blind = [0, 0, 1, 1, 2, 300][dice.below(6)];
                }
            }
            Command::Wild | Command::Replayed if fresh => {
                let ahead = if dice.chance(0.75) { 1.0 } else { -1.0 };
                let turn = if dice.chance(0.4) { 0.0 } else { dice.between(-1.0, 1.0) };
                self.wanted = Twist2::new(ahead * v, turn * w);
            }
            _ => {}
        }
        if !tick.is_multiple_of(2) {
            return inbox;
        }
        let Some(mut teleop) = ground.by_hand(self.wanted) else {
            return inbox;
        };
        match self.command {
            // A second and a half of commands, then silence, then stamps that grow old, by turns.
            Command::Stale => match tick / 75 % 3 {
                0 => {}
                1 => {
                    ground.beating = false;
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
                foreign.epoch = dice.below(4) as u64;
                foreign.twist = Twist2::new(-teleop.twist.v, teleop.twist.w);
                inbox.teleops.push(foreign);
            }
            _ => {}
        }
        inbox.teleops.push(teleop);
        inbox
    }
}

/// Full speed at the nearest thing, by the truth.
fn at_the_nearest(ground: &SimRig, top: Twist2) -> Twist2 {
    let here = ground.truth().map_from_base;
    let disc = Footprint::Radius(1e-3);
    let reach = ground.model.footprint.circumscribed_radius() + 0.05;
    let probe = |turn: f64| {
        let at = here * Pose2::new(reach * turn.cos(), reach * turn.sin(), 0.0);
        ground.sim.clearance_beside(0, &disc, at)
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

//! A moving map. Whether a loop closure harms a driving robot.
//!
//! A robot without GPS and compass maps a corridor while driving. On its way to a goal within its map, a closure is injected: the
//! map behind it bends, and the surroundings of robot and goal move by a metre. The drive is compared with the same drive without the
//! closure.

use nalgebra::{Point2, Vector2};
use zenav_cloud::mapping::PoseSource;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::GoalPhase;
use zenav_sim::TICK;

use super::indoors::{self, goal};
use super::tracking::off_path;
use super::worlds::{Rng, outer_walls, wall};

/// The corridor: length and width, m.
const CORRIDOR: (f64, f64) = (24.0, 3.0);
/// Hinge of the bend, m along the corridor: the map bends between the two places, and moves as one rigid body beyond the second.
const HINGE: (f64, f64) = (5.0, 9.0);
/// Displacement of the robot's surroundings, m.
const MOVE: f64 = 1.0;
/// Longest drive, s.
const LONGEST: f64 = 150.0;
/// A robot slower than this is at rest, m/s.
const AT_REST: f64 = 0.03;
/// Distance from the goal within which the robot brakes for it, m.
const BRAKING: f64 = 1.5;

/// The result of a drive.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Closing {
    /// The seed.
    pub seed: u64,
    /// Whether the goal succeeded.
    pub succeeded: bool,
    /// True distance of the robot from the goal's place in the building at the end, m.
    pub error: f64,
    /// The same without the closure: SLAM's own error at the goal, m.
    pub error_without: f64,
    /// Largest distance from the path driven without the closure, m.
    pub beside: f64,
    /// Additional time from the closure to the goal, compared with the drive without it, s.
    pub later: f64,
    /// Additional time at rest between the closure and the goal, compared with the drive without it, s.
    pub stood: f64,
    /// Displacement of the goal's coordinates, m.
    pub moved: f64,
    /// Frames that began.
    pub frames: u64,
    /// Contacts.
    pub collisions: u32,
    /// Plans that replaced another plan.
    pub replans: u64,
}

impl Closing {
    /// Whether the closure did no harm. SLAM's own error at a place that it had not seen when the goal was given does not count.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.succeeded
            && self.error <= f64::max(0.05, self.error_without + 0.01)
            && self.beside <= 0.03
            && self.later <= 0.5
            && self.stood <= 0.1
            && self.collisions == 0
            && self.frames > 0
            && self.moved > 0.5 * MOVE
    }
}

/// One drive.
struct Drive {
    end: Closing,
    /// Positions from the time of the closure on, with the speed and the distance from the goal's place.
    way: Vec<(Point2<f64>, f64, f64)>,
}

/// Drives with and without a closure.
///
/// # Errors
/// When the world or the robot cannot be set up.
pub fn drive(seed: u64) -> Result<Closing, String> {
    let plain = run(seed, false)?;
    let closed = run(seed, true)?;
    let path: Vec<_> = plain.way.iter().map(|(place, ..)| *place).collect();
    let apart = |(place, ..): &(Point2<f64>, f64, f64)| off_path(&path, *place);
    let stood = |drive: &Drive| {
        let at_rest = drive
            .way
            .iter()
            .filter(|(_, speed, left)| *left > BRAKING && speed.abs() < AT_REST);
        TICK.as_secs_f64() * at_rest.count() as f64
    };
    Ok(Closing {
        beside: closed.way.iter().map(apart).fold(0.0, f64::max),
        later: TICK.as_secs_f64() * (closed.way.len() as f64 - plain.way.len() as f64),
        stood: stood(&closed) - stood(&plain),
        error_without: plain.end.error,
        ..closed.end
    })
}

fn run(seed: u64, closes: bool) -> Result<Drive, String> {
    let mut rng = Rng::new(seed, 7);
    let world = indoors::world(&corridor(&mut rng), "corridor")?;
    let cloud_delay = rng.between(0.05, 0.4);
    let mut stage = indoors::stage(&world, PoseSource::Slam, None, cloud_delay, seed)?;
    let turn_to = if rng.chance(0.5) { 1.0 } else { -1.0 };
    let closes_at = rng.between(15.0, 17.5);
    let (first, second) = (
        (13.0, 1.5 + rng.between(-0.3, 0.3)),
        (20.5, 1.5 + rng.between(-0.3, 0.3)),
    );
    stage.robots[0].ask(goal("there", first.0, first.1));
    let mut drive = Drive {
        end: Closing {
            seed,
            ..Closing::default()
        },
        way: Vec::new(),
    };
    let mut spot: Option<Point2<f64>> = None;
    let mut is_bent = false;
    while stage.now().as_secs() < LONGEST {
        stage.tick();
        let truth = stage.truth(0);
        let robot = &mut stage.robots[0];
        let Some(state) = robot.goal().cloned() else { continue };
        let Some(spot) = spot else {
            if state.state == GoalPhase::Succeeded {
                // The goal's place in the building, from the robot's true and estimated pose.
                let building_from_map = truth.map_from_base * robot.pilot.map_from_base().inverse();
                spot = Some(building_from_map.transform_point(Point2::new(second.0, second.1)));
                robot.ask(goal("on", second.0, second.1));
            } else if state.state.is_end() {
                return Err(format!(
                    "seed {seed}: the first goal ended: {:?} {:?}",
                    state.state, state.reason
                ));
            }
            continue;
        };
        let here = truth.map_from_base;
        if here.x >= closes_at {
            if closes && !is_bent {
                robot.mapping.bend(|pose| bent(pose, closes_at, turn_to));
                is_bent = true;
            }
            drive
                .way
                .push((here.position(), truth.twist.v, (here.position() - spot).norm()));
        }
        if state.id == "on" && state.state.is_end() {
            let now = state.resolved.first();
            drive.end = Closing {
                succeeded: state.state == GoalPhase::Succeeded,
                error: (here.position() - spot).norm(),
                moved: now.map_or(0.0, |now| (now.x - second.0).hypot(now.y - second.1)),
                frames: robot.mapping.mapper.map().frame,
                collisions: truth.collisions,
                replans: state.feedback.replans,
                ..drive.end
            };
            break;
        }
    }
    Ok(drive)
}

/// The moved pose of a node: poses before the hinge stay, poses beyond turn about it, such that the displacement at `x` is [`MOVE`].
fn bent(pose: Pose2, x: f64, turn_to: f64) -> Pose2 {
    let (from, to) = HINGE;
    let long = to - from;
    let curvature = turn_to * MOVE / (0.5 * long * long + long * (x - to));
    let within = (pose.x - from).clamp(0.0, long);
    let beyond = (pose.x - to).max(0.0);
    // An arc within the hinge, then a straight line.
    let yaw = curvature * within;
    let along = from.min(pose.x);
    let arc = Vector2::new(within, 0.5 * curvature * within * within);
    let (sin, cos) = yaw.sin_cos();
    let middle = 1.5;
    let across = pose.y - middle;
    Pose2::new(
        along + arc.x + beyond * cos - across * sin,
        middle + arc.y + beyond * sin + across * cos,
        pose.yaw + yaw,
    )
}

/// A corridor with things along its walls.
fn corridor(rng: &mut Rng) -> String {
    let (long, wide) = CORRIDOR;
    let mut text = format!(
        "name = \"corridor\"\nsize = [{long}, {wide}]\norigin = [0.0, 0.0]\n[start]\nx = 1.5\ny = 1.5\nyaw = 0.0\n"
    );
    outer_walls(&mut text, CORRIDOR);
    let mut x = 1.0;
    while x < long - 1.0 {
        let depth = rng.between(0.1, 0.3);
        let y = if rng.chance(0.5) {
            (0.0, depth)
        } else {
            (wide, wide - depth)
        };
        wall(&mut text, (x, y.0), (x, y.1));
        x += rng.between(0.8, 2.2);
    }
    text
}

//! Kidnappings. Whether a robot that is carried away while it drives notices that, and is localised again.
//!
//! In lockstep, in rooms that look different: a robot drives to a goal and at a random moment is moved elsewhere. It has a map of the
//! rooms, or maps by SLAM: then it first visits some places, and is moved to one where it has been.

use std::fmt::Write as _;

use nalgebra::Point2;
use zenav::lockstep::ClosedLoop;
use zenav_cloud::mapping::PoseSource;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::{GoalPhase, Mode};
use zenav_protocol::robot::Footprint;

use super::indoors;
use super::tracking::true_map;
use super::worlds::{Rng, outer_walls, wall};

/// The house, m.
pub(super) const HOUSE: (f64, f64) = (16.0, 10.0);
/// Largest error of a pose that counts as right, m and rad.
const RIGHT: (f64, f64) = (0.1, 0.035);
/// Time after which a robot counts as never found, s.
const LONGEST: f64 = 30.0;
/// Least distance of a kidnapping, m.
const FAR: f64 = 1.5;
/// Places that a robot without a map visits first.
const VISITS: usize = 3;
/// Spacing of the recorded poses where it has been, m.
const BEEN: f64 = 0.5;

/// The result of a kidnapping.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Kidnapping {
    /// The seed.
    pub seed: u64,
    /// Time until the robot no longer trusted its pose, or was right again, s; `None`: never.
    pub noticed_after: Option<f64>,
    /// Distance driven until then, m.
    pub driven: f64,
    /// Time from the kidnapping until its pose was right again, s; `None`: not within half a minute.
    pub found_after: Option<f64>,
    /// Time during which it drove by a plan without trusting its pose, s.
    pub drove_lost: f64,
    /// Whether it ever trusted a wrong pose after it had noticed.
    pub trusted_wrong: bool,
    /// Whether its goal succeeded.
    pub succeeded: bool,
    /// End of the goal, with its reason.
    pub end: String,
    /// Error of the estimated position at the end, m.
    pub off: f64,
    /// True pose at the end.
    pub truth: Pose2,
    /// Contacts.
    pub collisions: u32,
}

impl Kidnapping {
    /// Noticed and localised again in time, no plan driven while lost, no wrong pose trusted, no contact.
    #[must_use]
    pub fn is_good(&self) -> bool {
        self.is_noticed() && self.is_found() && self.drove_lost == 0.0 && !self.trusted_wrong && self.collisions == 0
    }

    /// Whether it was noticed within a second or half a metre.
    #[must_use]
    pub fn is_noticed(&self) -> bool {
        self.noticed_after.is_some_and(|secs| secs <= 1.0 || self.driven <= 0.5)
    }

    /// Whether the robot was localised again within three seconds of noticing.
    #[must_use]
    pub fn is_found(&self) -> bool {
        let both = self.found_after.zip(self.noticed_after);
        both.is_some_and(|(found, noticed)| found - noticed <= 3.0)
    }

    /// Takes note of a tick. `since`: when the robot was carried away, s; `length`: how far it had driven until then, m.
    fn note(&mut self, stage: &ClosedLoop, since: f64, length: f64) {
        let (truth, robot) = (stage.truth(0), &stage.robots[0]);
        let after = stage.now().as_secs() - since;
        let believed = robot.pilot.map_from_base();
        self.off = believed.distance(&truth.map_from_base);
        let is_right = self.off <= RIGHT.0 && wrap_angle(believed.yaw - truth.map_from_base.yaw).abs() <= RIGHT.1;
        let is_trusted = robot.pilot.health().is_trusted();
        if self.noticed_after.is_none() && (!is_trusted || is_right) {
            self.noticed_after = Some(after);
            self.driven = truth.length - length;
        }
        if let Some(noticed) = self.noticed_after {
            if !is_trusted && robot.pilot.mode() == Mode::Follow {
                self.drove_lost += stage.simulation.tick().as_secs_f64();
            }
            if is_right && is_trusted && self.found_after.is_none() {
                self.found_after = Some(after);
            }
            self.trusted_wrong |= is_trusted
                && !is_right
                && self.found_after.is_none()
                && robot.mapping.health().is_trusted()
                && after > noticed + 1.0;
        }
        self.collisions = truth.collisions;
        self.truth = truth.map_from_base;
    }
}

/// Runs the kidnapping of a seed, of a robot that is localised in a known map, or maps by SLAM.
///
/// # Errors
/// When the world or the robot cannot be set up.
pub fn kidnap(seed: u64, source: PoseSource) -> Result<Kidnapping, String> {
    let is_mapping = source == PoseSource::Slam;
    let mut rng = Rng::new(seed, 11);
    let world = indoors::world(&House::drawn(&mut Rng::new(seed, 12)).text(), "house")?;
    let start = world.start();
    let room = Footprint::Radius(indoors::model()?.footprint.circumscribed_radius() + 0.1);
    let mut free = |from: Point2<f64>, far: f64| -> Pose2 {
        loop {
            let pose = Pose2::new(
                rng.between(0.5, HOUSE.0 - 0.5),
                rng.between(0.5, HOUSE.1 - 0.5),
                rng.between(-3.1, 3.1),
            );
            if world.clearance(&room, pose) > 0.0 && (pose.position() - from).norm() >= far {
                return pose;
            }
        }
    };
    let goal = free(start.position(), 4.0);
    let mut to = free(start.position(), FAR);
    let kidnapped_at = free(start.position(), 0.0).x / HOUSE.0;
    let visits: Vec<Pose2> = (0..if is_mapping { VISITS } else { 0 })
        .map(|_| free(goal.position(), 4.0))
        .collect();
    let known_map = (!is_mapping).then(|| true_map(&world));
    let mut stage = indoors::stage(&world, source, known_map, 0.1, seed)?;
    let been = visit(&mut stage, &visits)?;
    let begun = stage.truth(0);
    if is_mapping {
        let far: Vec<&Pose2> = been
            .iter()
            .filter(|place| {
                let is_far = |other: &Pose2| place.distance(other) >= FAR;
                is_far(&begun.map_from_base) && is_far(&goal) && world.clearance(&room, **place) > 0.0
            })
            .collect();
        let nth = (kidnapped_at * far.len() as f64) as usize;
        let place = far
            .get(nth)
            .ok_or_else(|| format!("seed {seed}: it has been nowhere else"))?;
        to = Pose2::new(place.x, place.y, to.yaw);
    }
    let (begun_at, start) = (stage.now().as_secs(), begun.map_from_base);
    stage.robots[0].ask(indoors::goal("g", goal.x, goal.y));
    let way = begun.length + 0.2 + kidnapped_at * (0.8 * (goal.position() - start.position()).norm() - 0.2);
    let mut told = Kidnapping {
        seed,
        ..Kidnapping::default()
    };
    // Time of the kidnapping, and the distance driven until then.
    let mut carried: Option<(f64, f64)> = None;
    while stage.now().as_secs() - begun_at < 120.0 {
        stage.tick();
        let (now, truth) = (stage.now().as_secs(), stage.truth(0));
        let state = stage.robots[0].goal().filter(|state| state.id == "g").cloned();
        let Some((since, length)) = carried else {
            if state.as_ref().is_some_and(|state| state.state.is_end()) {
                return Err(format!("seed {seed}: the goal ended before: {state:?}"));
            }
            let here = truth.map_from_base;
            let is_moving = stage.robots[0].pilot.mode() == Mode::Follow && truth.twist.v > 0.1;
            if truth.length >= way && is_moving && (here.position() - to.position()).norm() >= FAR {
                if stage.simulation.carry(&world, 0, to).is_err() {
                    return Err(format!("seed {seed}: it does not fit where it is to be carried"));
                }
                carried = Some((now, truth.length));
            }
            continue;
        };
        told.note(&stage, since, length);
        if let Some(state) = state.filter(|state| state.state.is_end()) {
            told.succeeded = state.state == GoalPhase::Succeeded;
            told.end = state.reason.unwrap_or_default();
            break;
        }
        if now - since > LONGEST && told.found_after.is_none() {
            break;
        }
    }
    if carried.is_none() {
        return Err(format!("seed {seed}: it did not get to where it was to be kidnapped"));
    }
    Ok(told)
}

/// Drives the robot to places, one after the other, and returns the poses where it has been.
fn visit(stage: &mut ClosedLoop, places: &[Pose2]) -> Result<Vec<Pose2>, String> {
    let mut been: Vec<Pose2> = Vec::new();
    for (nth, place) in places.iter().enumerate() {
        let (id, begun) = (format!("visit-{nth}"), stage.now().as_secs());
        stage.robots[0].ask(indoors::goal(&id, place.x, place.y));
        let has_ended = |stage: &ClosedLoop| {
            let goal = stage.robots[0].goal();
            goal.is_some_and(|goal| goal.id == id && goal.state.is_end())
        };
        while !has_ended(stage) {
            stage.tick();
            if stage.now().as_secs() - begun > 180.0 {
                return Err(format!("{id} did not end: ({:.2}, {:.2})", place.x, place.y));
            }
            let here = stage.truth(0).map_from_base;
            if been.last().is_none_or(|last| last.distance(&here) >= BEEN) {
                been.push(here);
            }
        }
    }
    Ok(been)
}

/// Rooms with doors and furniture.
pub(super) struct House {
    /// The world file without furniture.
    rooms: String,
    /// Low corner of each piece of furniture, its length and its width, m.
    pub(super) boxes: Vec<[f64; 4]>,
}

impl House {
    /// A random house.
    pub(super) fn drawn(rng: &mut Rng) -> Self {
        let (long, wide) = HOUSE;
        let mut rooms = format!(
            "name = \"house\"\nsize = [{}, {}]\norigin = [-0.5, -0.5]\n[start]\nx = 1.5\ny = 1.5\nyaw = 0.5\n",
            long + 1.0,
            wide + 1.0
        );
        outer_walls(&mut rooms, HOUSE);
        // Two walls across, one along, each with doors.
        for (x, door) in [(5.5, rng.between(1.0, 3.0)), (10.5, rng.between(6.0, 8.0))] {
            wall(&mut rooms, (x, 0.0), (x, door));
            wall(&mut rooms, (x, door + 1.2), (x, wide));
        }
        let y = rng.between(4.5, 5.5);
        for (from, to) in [(0.0, 5.5), (5.5, 10.5), (10.5, long)] {
            let door = rng.between(from + 0.5, to - 1.7);
            wall(&mut rooms, (from, y), (door, y));
            wall(&mut rooms, (door + 1.2, y), (to, y));
        }
        let boxes = (0..14).map(|_| {
            let (x, y) = (rng.between(0.3, long - 1.0), rng.between(0.3, wide - 1.0));
            [x, y, rng.between(0.2, 0.8), rng.between(0.2, 0.8)]
        });
        Self {
            // The start stays free.
            boxes: boxes.filter(|[x, y, ..]| *x >= 3.0 || *y >= 3.0).collect(),
            rooms,
        }
    }

    /// The world file.
    pub(super) fn text(&self) -> String {
        let mut text = self.rooms.clone();
        for [x, y, w, h] in &self.boxes {
            // Writing to a string does not fail.
            let _ = write!(
                text,
                "[[polygon]]\npoints = [[{x}, {y}], [{}, {y}], [{}, {}], [{x}, {}]]\n",
                x + w,
                x + w,
                y + h,
                y + h
            );
        }
        text
    }
}

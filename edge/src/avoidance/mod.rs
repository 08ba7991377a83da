//! Predictive control among moving obstacles. Does the plan lead into the predicted path of one, and what does the robot do instead?
//!
//! While no track ([`crate::obstacle_tracks`]) comes near the plan within the horizon, the tracker drives alone. Otherwise two steps choose
//! the twist in every tick:
//!
//! 1. `value_function`: for each place around the robot and each time up to the horizon, the time to the end of the plan among static
//!    obstacles and predicted tracks. It lets the robot wait in a niche, pass behind an obstacle, or back out.
//! 2. `arcs`: a dynamic window (Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE RAM 1997) whose arcs are checked
//!    with the footprint against obstacles (`clearance_grid`) and predicted tracks, and judged at their end by that value function.
//!
//! For a robot that announces its course, that course is the prediction. Of two robots, the one with right of way avoids the other only
//! where no time is left for the other to give way. The other one keeps clear of the whole course and announces its own
//! ([`Avoidance::course`]).
//!
//! A robot in contact first gets away (`touched`): then every motion is allowed that does not lead deeper into the contact.
//!
//! It works in the odometry frame and never leaves floor that a lidar sees free, except along the plan. The collision monitor has the last
//! word.

mod arcs;
pub mod clearance_grid;
mod touched;
mod value_function;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::Bump;
use zenav_protocol::robot::{Drive, Footprint, RobotModel};
use zenav_protocol::time::Stamp;

use crate::collision_monitor::CollisionMonitor;
use crate::course::PredictedPath;
use crate::local_obstacles::LocalObstacles;
use crate::obstacle_tracks::Track;
use crate::settings::AvoidanceSettings;
use arcs::{Situation, WayOut};
use clearance_grid::ClearanceGrid;
use touched::Touched;
use value_function::ValueFunction;

/// The tracker takes over again this near to the plan, m and rad.
const REJOINED: (f64, f64) = (0.15, 0.5);
/// Time without a conflict after which the robot returns to the plan, s.
const CALM: f64 = 0.3;
/// Time after which the tracker takes over wherever the robot is, s: if that is too far off the plan, the plan is discarded.
const LONG_CALM: f64 = 1.5;
/// Least progress of a robot that gives way, m and rad, and the time without it after which the robot is stuck, s: two motions that cost
/// the same can hold it between them.
const GETS_ON: (f64, f64) = (0.1, 0.5);
const STUCK: f64 = 1.5;
/// Most discs that cover a footprint.
const MOST_DISCS: usize = 8;
/// A robot is trapped once its best course meets another robot's in more layers than this for longer than this, s; for how long it is, s.
const TRAPPED: (u32, f64, f64) = (1, 0.5, 10.0);

/// A pose ahead on the plan, odometry frame, and when the robot gets there at the plan's pace, s.
#[derive(Clone, Copy, Debug)]
pub struct Ahead {
    /// From now, s.
    pub secs: f64,
    /// Odometry frame.
    pub pose: Pose2,
}

/// Inputs of predictive control in a tick.
#[derive(Clone, Copy, Debug)]
pub struct AvoidanceInput<'a> {
    /// Since the last tick, s.
    pub dt: f64,
    /// Now, on the clock of the tracks' stamps.
    pub now: Stamp,
    /// Pose of the robot.
    pub odom_from_base: Pose2,
    /// The last twist commanded to the wheels.
    pub command: Twist2,
    /// Largest wheel surface speed, m/s: the robot must be at rest when its plan expires.
    pub speed_cap: f64,
    /// It has the last word: a motion that it would slow down is no way out.
    pub monitor: &'a CollisionMonitor,
    /// What the bumper feels now.
    pub bump: &'a Bump,
    /// The rest of the plan, from where the robot should be now.
    pub ahead: &'a [Ahead],
    /// Obstacles and tracks.
    pub obstacles: &'a LocalObstacles,
}

/// What drives the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Control {
    /// The tracker alone.
    Follow,
    /// The tracker again, from the nearest place on the plan.
    Rejoin,
    /// This twist instead.
    Evade(Twist2),
}

/// Keeps the robot out of the way of moving obstacles.
#[derive(Clone, Debug)]
pub struct Avoidance {
    settings: AvoidanceSettings,
    drive: Drive,
    footprint: Footprint,
    /// Discs that cover the footprint: place on the x axis of the base, and radius, m.
    discs: Vec<(f64, f64)>,
    /// Time before braking begins, and until the motors' lag has faded, s.
    reaction: f64,
    /// Radius of the whole outline, m.
    circumscribed: f64,
    evading: bool,
    calm_for: f64,
    touched: Touched,
    /// The way out that the robot takes in contact, or while it is stuck.
    way_out: Option<WayOut>,
    /// Pose at which the robot, while giving way, last made progress, and the time since, s.
    got_to: Option<Pose2>,
    stuck_for: f64,
    /// Whether the robot gives way to another robot.
    for_robot: bool,
    /// The course on which it gives way.
    course: Vec<Point2<f64>>,
    hit_for: f64,
    trapped_for: f64,
    values: ValueFunction,
    clearances: ClearanceGrid,
    /// Points that are on no track, odometry frame; kept to reuse its memory.
    standing: Vec<Point2<f64>>,
}

impl Avoidance {
    /// Avoidance for a robot of this model, with nothing to avoid yet.
    #[must_use]
    pub fn new(model: &RobotModel, settings: &AvoidanceSettings) -> Self {
        let drive = model.drive.clone();
        Self {
            settings: settings.clone(),
            footprint: model.footprint.clone(),
            discs: covering_discs(&model.footprint),
            circumscribed: model.footprint.circumscribed_radius(),
            reaction: 0.06 + 4.0 * drive.motor_lag,
            evading: false,
            calm_for: 0.0,
            touched: Touched::default(),
            way_out: None,
            got_to: None,
            stuck_for: 0.0,
            for_robot: false,
            course: Vec::new(),
            hit_for: 0.0,
            trapped_for: 0.0,
            values: ValueFunction::new(model, settings),
            clearances: ClearanceGrid::default(),
            standing: Vec::new(),
            drive,
        }
    }

    /// Whether the robot is off its plan to give way.
    #[must_use]
    pub fn is_evading(&self) -> bool {
        self.evading
    }

    /// Whether it gives way to a robot that announces its course.
    #[must_use]
    pub fn is_for_robot(&self) -> bool {
        self.evading && self.for_robot
    }

    /// The course on which it gives way, odometry frame, and the time from point to point, s; `None` while it follows its plan.
    #[must_use]
    pub fn course(&self) -> Option<(&[Point2<f64>], f64)> {
        (self.evading && !self.course.is_empty()).then(|| (&self.course[..], self.values.layer()))
    }

    /// Whether the robot gives way and has made no progress for a while.
    fn is_stuck(&self) -> bool {
        self.stuck_for > STUCK
    }

    /// Whether, of late, no course led clear of the robots that have right of way.
    #[must_use]
    pub fn is_trapped(&self) -> bool {
        self.trapped_for > 0.0
    }

    /// The plan has changed or ended: the tracker drives.
    pub fn reset(&mut self) {
        self.evading = false;
        self.way_out = None;
        self.got_to = None;
        self.stuck_for = 0.0;
        self.calm_for = 0.0;
        self.hit_for = 0.0;
    }

    /// Decides for one tick.
    pub fn step(&mut self, input: &AvoidanceInput<'_>) -> Control {
        self.trapped_for = (self.trapped_for - input.dt).max(0.0);
        let reach = self.settings.horizon * (self.drive.top_speed() + 2.0);
        let here = input.odom_from_base.position();
        let tracks: Vec<&Track> = input
            .obstacles
            .moving()
            .tracks()
            .iter()
            .filter(|track| (track.position - here).norm() < reach)
            .collect();
        if input.ahead.is_empty() || (tracks.is_empty() && !self.evading) {
            self.reset();
            self.touched.reset();
            return Control::Follow;
        }
        self.touched.update(&self.footprint, input);
        let foremost = tracks.iter().find(|track| self.conflicts(input, track));
        let conflict = foremost.is_some() || self.touched.is_so();
        if !conflict && !self.evading {
            return Control::Follow;
        }
        if let Some(track) = foremost {
            self.for_robot = track.is_robot();
        }
        self.calm_for = if conflict { 0.0 } else { self.calm_for + input.dt };
        if self.evading && (self.calm_for >= LONG_CALM || self.calm_for >= CALM && self.is_on_plan(input)) {
            self.reset();
            return Control::Rejoin;
        }
        self.evading = true;
        let stuck = self.is_stuck();
        let got_on = |from: Pose2| {
            let turned = wrap_angle(from.yaw - input.odom_from_base.yaw).abs();
            // A robot that is stuck turns first: that is not progress yet.
            from.distance(&input.odom_from_base) > GETS_ON.0 || turned > GETS_ON.1 && !stuck
        };
        if self.got_to.is_none_or(got_on) {
            (self.got_to, self.stuck_for) = (Some(input.odom_from_base), 0.0);
        }
        self.stuck_for += input.dt;
        self.standing.clear();
        self.standing.extend(input.obstacles.standing());
        let base_from_odom = input.odom_from_base.inverse();
        let leans = |track: &&Track| self.touched.leans(&self.footprint, base_from_odom, track);
        let (leaning, tracks): (Vec<&Track>, Vec<&Track>) = tracks.into_iter().partition(leans);
        self.values.fill(input, &self.standing, &tracks, &leaning);
        let hits = self.values.course(input.odom_from_base.position(), &mut self.course);
        let (most, after, lasts) = TRAPPED;
        self.hit_for = if hits > most { self.hit_for + input.dt } else { 0.0 };
        if self.hit_for > after {
            self.trapped_for = lasts;
        }
        self.clearances.fill(input.odom_from_base.position(), &self.standing);
        let (best, way_out) = self.best_arc(&Situation::new(self, input, &tracks, &leaning));
        self.way_out = way_out;
        Control::Evade(best)
    }

    /// Whether the plan, at its own pace, comes too near to a track's prediction.
    fn conflicts(&self, input: &AvoidanceInput<'_>, track: &Track) -> bool {
        let age = input.now.secs_since(track.stamp);
        let within = input
            .ahead
            .iter()
            .take_while(|ahead| ahead.secs <= self.settings.horizon);
        let comes_near = |secs: f64, discs: &PlacedDiscs| {
            kept(&self.settings, track, secs).is_some_and(|kept| {
                let path = track.path(secs + age, lead(&self.settings, track));
                discs.distance_from_path(&path) - track.radius < kept
            })
        };
        within
            .into_iter()
            .any(|ahead| comes_near(ahead.secs, &self.placed(ahead.pose)))
    }

    /// The covering discs of a robot at a pose.
    fn placed(&self, pose: Pose2) -> PlacedDiscs {
        let heading = pose.heading();
        let mut placed = PlacedDiscs {
            discs: [(Point2::origin(), 0.0); MOST_DISCS],
            count: self.discs.len(),
        };
        for (place, (x, radius)) in placed.discs.iter_mut().zip(&self.discs) {
            *place = (pose.position() + heading * *x, *radius);
        }
        placed
    }

    /// Whether the robot is on its plan and faces along it.
    fn is_on_plan(&self, input: &AvoidanceInput<'_>) -> bool {
        let here = input.odom_from_base;
        let nearest = input
            .ahead
            .iter()
            .min_by(|a, b| a.pose.distance(&here).total_cmp(&b.pose.distance(&here)));
        nearest.is_some_and(|nearest| {
            nearest.pose.distance(&here) < REJOINED.0 && wrap_angle(nearest.pose.yaw - here.yaw).abs() < REJOINED.1
        })
    }
}

/// The covering discs of a robot at some pose: centers, odometry frame, and radii, m.
struct PlacedDiscs {
    discs: [(Point2<f64>, f64); MOST_DISCS],
    count: usize,
}

impl PlacedDiscs {
    /// Their distance from a point, m.
    fn distance(&self, point: Point2<f64>) -> f64 {
        self.least(|center| (center - point).norm())
    }

    /// Their distance from the path that a track's center takes over some moments, m: the robot must be out of it before.
    fn distance_from_path(&self, path: &PredictedPath) -> f64 {
        self.least(|center| path.distance(center))
    }

    /// The least of some measure of their centers, less their radii, m.
    fn least(&self, measure: impl Fn(Point2<f64>) -> f64) -> f64 {
        let off = self.discs[..self.count]
            .iter()
            .map(|(center, radius)| measure(*center) - radius);
        off.fold(f64::INFINITY, f64::min)
    }
}

/// Distance kept from a track's prediction `secs` ahead, m; `None` for a robot that will have given way by then.
fn kept(settings: &AvoidanceSettings, track: &Track, secs: f64) -> Option<f64> {
    match () {
        () if track.makes_way() && secs > settings.robot_minded => None,
        () if track.is_robot() => Some(settings.robot_clearance),
        () => Some(settings.clearance_after(secs)),
    }
}

/// How long before a track arrives the robot leaves the track's path, s.
fn lead(settings: &AvoidanceSettings, track: &Track) -> f64 {
    if track.is_robot() {
        settings.robot_lead
    } else {
        settings.lead
    }
}

/// Discs that cover a footprint, along the x axis of the base: place and radius, m.
fn covering_discs(footprint: &Footprint) -> Vec<(f64, f64)> {
    match footprint {
        Footprint::Radius(radius) => vec![(0.0, *radius)],
        Footprint::Polygon(corners) => {
            let fold = |pick: fn(&Point2<f64>) -> f64| {
                let values = corners.iter().map(pick);
                values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| {
                    (low.min(value), high.max(value))
                })
            };
            let ((back, front), (right, left)) = (fold(|corner| corner.x), fold(|corner| corner.y));
            let half_width = right.abs().max(left.abs()).max(1e-3);
            let count = ((front - back) / (1.5 * half_width))
                .ceil()
                .clamp(1.0, MOST_DISCS as f64);
            let piece = (front - back) / count;
            let radius = half_width.hypot(0.5 * piece);
            (0..count as u32)
                .map(|nth| (back + piece * (f64::from(nth) + 0.5), radius))
                .collect()
        }
    }
}

/// The index of the cell of a square grid with `side` cells a side, of `size` m each, that holds a point.
fn cell_of(point: Point2<f64>, origin: Point2<f64>, size: f64, side: usize) -> Option<usize> {
    let off = (point - origin) / size;
    let inside = |value: f64| (0.0..side as f64).contains(&value);
    (inside(off.x) && inside(off.y)).then(|| off.y as usize * side + off.x as usize)
}

#[cfg(test)]
mod tests;

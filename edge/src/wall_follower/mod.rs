//! Wall follower. What does a robot do when its link is lost and its policy is to follow walls? A state machine on the robot, without a
//! cloud.
//!
//! `wall_search` turns to the nearest wall, `approach` drives up to it, `turn` turns until the path ahead is clear (to the other side if the
//! collision monitor does not let it), `wall_follow` drives along it; `bump`, entered from every state, waits until an operator has driven
//! the robot away.
//!
//! | file | answers |
//! |---|---|
//! | [`filter`] | which returns are walls, and which are noise? |
//! | [`mod@line`] | which straight walls do they show? |
//! | [`beside`] | where is the wall beside the robot, what is in its way, and how is the distance kept? |

pub mod beside;
pub mod filter;
pub mod line;

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{Bump, EventKind, Marker, WallFollowerState as State};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;
use zenav_protocol::wall_following::WallFollowing;

use crate::event_log::EventLog;
use crate::local_obstacles::LocalObstacles;
use crate::settings::WallFollowerSettings;
use beside::{Beside, DistanceController};
use line::Wall;

/// Directions tried on each side.
const DIRECTIONS: u32 = 36;
/// A robot whose total turn towards its wall exceeds this circles an island, rad.
const AROUND: f64 = 2.0 * std::f64::consts::PI + 0.5;

/// Inputs of one tick.
#[derive(Clone, Copy, Debug)]
pub struct WallFollowerInput<'a> {
    /// Time of the tick.
    pub now: Stamp,
    /// Time since the last tick, s.
    pub dt: f64,
    /// The settings in force.
    pub settings: &'a WallFollowing,
    /// Obstacles around the robot.
    pub obstacles: &'a LocalObstacles,
    /// Pose of the robot by odometry.
    pub odom_from_base: Pose2,
    /// What the bumper feels now.
    pub bump: &'a Bump,
    /// Whether the collision monitor stopped the robot at the last tick.
    pub stopped: bool,
}

/// The state machine.
#[derive(Clone, Debug)]
pub struct WallFollower {
    settings: WallFollowerSettings,
    /// Half the width that the robot needs to go straight, m.
    body: f64,
    /// A return farther than this from the chord belongs to another wall, m.
    bend: f64,
    /// Deceleration, m/s².
    braking: f64,
    state: State,
    scan: Option<Stamp>,
    /// Filtered returns, odometry frame.
    points: Vec<Point2<f64>>,
    /// Walls fitted to them, odometry frame.
    walls: Vec<Wall>,
    /// Nearest point of the wall that is searched or approached, odometry frame.
    goal: Option<Point2<f64>>,
    /// +1 with the wall on the left, -1 on the right.
    side: f64,
    /// Remaining turn before the robot gives up, rad.
    patience: f64,
    last_yaw: f64,
    distance_controller: DistanceController,
    /// The distance to keep now, m.
    wanted: f64,
    blocked: f64,
    /// Pose and bearing of the last contact, odometry frame.
    touched: Option<(Pose2, f64)>,
    /// The turn towards the wall since following began, rad, and the bounding box of the path, odometry frame.
    turned: f64,
    way: Option<(Point2<f64>, Point2<f64>)>,
    /// Bounding box of the path around an island: its walls are not approached again.
    island: Option<(Point2<f64>, Point2<f64>)>,
    /// The wall being followed, odometry frame.
    followed: Option<Wall>,
}

impl WallFollower {
    /// In the initial state.
    #[must_use]
    pub fn new(model: &RobotModel, settings: &WallFollowerSettings) -> Self {
        Self {
            settings: settings.clone(),
            body: model.footprint.circumscribed_radius() + settings.side_clearance,
            bend: model
                .all_lidars()
                .map(|(_, lidar)| settings.bend_sigmas * lidar.noise)
                .fold(settings.bend, f64::max),
            braking: 0.5 * model.drive.acceleration(),
            state: State::WallSearch,
            scan: None,
            points: Vec::new(),
            walls: Vec::new(),
            goal: None,
            side: -1.0,
            patience: 0.0,
            last_yaw: 0.0,
            distance_controller: DistanceController::default(),
            wanted: model.wall_following.target_distance,
            blocked: 0.0,
            touched: None,
            turned: 0.0,
            way: None,
            island: None,
            followed: None,
        }
    }

    /// The current state.
    #[must_use]
    pub fn state(&self) -> State {
        self.state
    }

    /// One tick in which another source, or none, commands: the state machine restarts afterwards. Only an operator ends a bump.
    pub fn stand_by(&mut self, now: Stamp, operated: bool, bump: &Bump, odom_from_base: Pose2, events: &mut EventLog) {
        if bump.pressed {
            self.touch(now, bump, odom_from_base, events);
        } else if let Some((place, bearing)) = self.touched {
            let gone = place.inverse() * odom_from_base;
            if operated && gone.x * bearing.cos() + gone.y * bearing.sin() <= -self.settings.bump_clearance {
                self.touched = None;
                self.enter(now, State::WallSearch, "driven away by an operator", events);
            }
        } else if self.state != State::WallSearch {
            self.enter(now, State::WallSearch, "another source commands", events);
        }
    }

    /// One tick in which it moves the robot: the wanted twist.
    pub fn step(&mut self, input: &WallFollowerInput<'_>, events: &mut EventLog) -> Twist2 {
        let WallFollowerInput {
            now, odom_from_base, ..
        } = *input;
        if input.bump.pressed {
            self.touch(now, input.bump, odom_from_base, events);
        }
        if self.state == State::Bump {
            return Twist2::ZERO;
        }
        self.take_scan(input);
        let turn = wrap_angle(odom_from_base.yaw - std::mem::replace(&mut self.last_yaw, odom_from_base.yaw));
        self.blocked = if input.stopped { self.blocked + input.dt } else { 0.0 };
        if self.blocked > self.settings.blocked_timeout {
            self.blocked = 0.0;
            if self.state == State::Turn {
                // A robot with corners may be free to turn to the other side only.
                self.side = -self.side;
                (self.turned, self.way) = (0.0, None);
            } else {
                self.begin_turn(input, None, "blocked by the collision monitor", events);
            }
        }
        match self.state {
            State::WallSearch => self.search(input, events),
            State::Approach => self.approach(input, events),
            State::Turn => {
                self.patience -= turn.abs();
                self.turned += self.side * turn;
                self.turn(input, events)
            }
            State::WallFollow => {
                self.turned += self.side * turn;
                self.follow(input, events)
            }
            State::Bump => Twist2::ZERO,
        }
    }

    /// Wall and target line, map frame.
    #[must_use]
    pub fn markers(&self, now: Stamp, map_from_odom: Pose2, odom_from_base: Pose2) -> Vec<Marker> {
        let Some(wall) = self.followed.filter(|_| self.state == State::WallFollow) else {
            return Vec::new();
        };
        let along = (wall.to - wall.from).normalize();
        let mut aside = nalgebra::Vector2::new(-along.y, along.x) * self.wanted;
        if (odom_from_base.position() - wall.from).dot(&aside) < 0.0 {
            aside = -aside;
        }
        let marker = |name: &str, points: [Point2<f64>; 2]| Marker {
            stamp: now,
            name: name.to_owned(),
            points: points.map(|point| map_from_odom.transform_point(point)).to_vec(),
        };
        vec![
            marker("wall", [wall.from, wall.to]),
            marker("target_line", [wall.from + aside, wall.to + aside]),
        ]
    }

    fn enter(&mut self, now: Stamp, to: State, reason: &str, events: &mut EventLog) {
        if to == self.state {
            return;
        }
        events.record(
            now,
            EventKind::Transition {
                behaviour: "wall_follow".to_owned(),
                from: self.state.name().to_owned(),
                to: to.name().to_owned(),
                reason: reason.to_owned(),
            },
        );
        self.state = to;
        self.goal = None;
        self.followed = None;
    }

    fn touch(&mut self, now: Stamp, bump: &Bump, odom_from_base: Pose2, events: &mut EventLog) {
        // Without a bearing the contact is assumed to lie ahead.
        self.touched = Some((odom_from_base, bump.bearing.unwrap_or(0.0)));
        self.enter(now, State::Bump, "contact", events);
    }

    /// Extracts walls from a new scan.
    fn take_scan(&mut self, input: &WallFollowerInput<'_>) {
        if self.scan == input.obstacles.stamp() {
            return;
        }
        self.scan = input.obstacles.stamp();
        let (least, gap) = (input.settings.wall_min_points, input.settings.wall_gap);
        let scans = input.obstacles.seen_by_lidar();
        let runs: Vec<_> = scans
            .flat_map(|points| filter::runs(points.iter().copied(), least, gap))
            .collect();
        self.walls = runs.iter().flat_map(|run| line::walls(run, self.bend)).collect();
        self.points = runs.concat();
    }

    /// Nearest point of the walls worth approaching, base frame; of the wall chosen before unless another is clearly nearer.
    fn nearest(&mut self, odom_from_base: Pose2) -> Option<Point2<f64>> {
        let here = odom_from_base.position();
        let of = |wall: &Wall| {
            let point = wall.nearest(here);
            ((point - here).norm(), point)
        };
        let by_distance = |a: &(f64, Point2<f64>), b: &(f64, Point2<f64>)| a.0.total_cmp(&b.0);
        let elsewhere = |wall: &&Wall| {
            let on_island = |(low, high): (Point2<f64>, Point2<f64>)| {
                let inside = |at: Point2<f64>| at >= low && at <= high;
                inside(wall.from) && inside(wall.to)
            };
            !self.island.is_some_and(on_island)
        };
        let long = |wall: &&Wall| (wall.to - wall.from).norm() >= self.settings.short_wall;
        let worth: Vec<&Wall> = self.walls.iter().filter(elsewhere).filter(long).collect();
        let worth = if worth.is_empty() {
            self.walls.iter().filter(elsewhere).collect()
        } else {
            worth
        };
        let nearest = worth.iter().map(|wall| of(wall)).min_by(by_distance)?;
        let same = self.goal.and_then(|goal| {
            let near = |wall: &&&Wall| (wall.nearest(goal) - goal).norm() < self.settings.same_wall;
            worth.iter().filter(near).map(|wall| of(wall)).min_by(by_distance)
        });
        let chosen = same
            .filter(|(distance, _)| *distance < nearest.0 + self.settings.nearer_wall)
            .unwrap_or(nearest);
        self.goal = Some(chosen.1);
        Some(odom_from_base.inverse().transform_point(chosen.1))
    }

    fn search(&mut self, input: &WallFollowerInput<'_>, events: &mut EventLog) -> Twist2 {
        let settings = input.settings;
        let Some(wall) = self.nearest(input.odom_from_base) else {
            // No wall in view: drive on to find one.
            return Twist2::new(settings.greatest_speed, 0.0);
        };
        let bearing = wall.y.atan2(wall.x);
        if bearing.abs() <= settings.search_tolerance {
            let goal = self.goal;
            self.enter(input.now, State::Approach, "nearest wall ahead", events);
            self.goal = goal;
            return Twist2::ZERO;
        }
        Twist2::new(0.0, turning(bearing, settings))
    }

    fn approach(&mut self, input: &WallFollowerInput<'_>, events: &mut EventLog) -> Twist2 {
        let settings = input.settings;
        let Some(wall) = self.nearest(input.odom_from_base) else {
            self.enter(input.now, State::WallSearch, "wall lost", events);
            return Twist2::ZERO;
        };
        // Another obstacle may be in the way: the robot then follows that one.
        let distance = self.ahead(input, 0.0).unwrap_or(f64::INFINITY).min(wall.coords.norm());
        let (left, bearing) = (distance - settings.identify_wall_distance, wall.y.atan2(wall.x));
        if left <= 0.0 {
            self.begin_turn(input, None, "wall reached", events);
            return Twist2::ZERO;
        }
        if bearing.abs() > self.settings.astray {
            self.enter(input.now, State::WallSearch, "wall not ahead", events);
            return Twist2::ZERO;
        }
        let v = (settings.approach_gain * left).clamp(settings.least_speed, settings.greatest_speed);
        Twist2::new(v, settings.steering * bearing)
    }

    /// Begins to turn: away from the wall beside, or to the side that is clear after the lesser turn.
    fn begin_turn(&mut self, input: &WallFollowerInput<'_>, wall_on: Option<f64>, reason: &str, events: &mut EventLog) {
        self.side = wall_on.unwrap_or_else(|| {
            let step = std::f64::consts::PI / f64::from(DIRECTIONS);
            let needed = |sign: f64| {
                (1..=DIRECTIONS)
                    .map(|nth| step * f64::from(nth))
                    .find(|angle| {
                        self.ahead(input, sign * angle)
                            .is_none_or(|free| free > self.settings.clear_ahead * input.settings.target_distance)
                    })
                    .unwrap_or(f64::INFINITY)
            };
            // After a turn to the left the wall is on the right.
            if needed(1.0) <= needed(-1.0) { -1.0 } else { 1.0 }
        });
        self.patience = std::f64::consts::TAU;
        if wall_on.is_none() {
            (self.turned, self.way) = (0.0, None);
        }
        self.enter(input.now, State::Turn, reason, events);
    }

    fn turn(&mut self, input: &WallFollowerInput<'_>, events: &mut EventLog) -> Twist2 {
        let settings = input.settings;
        if self
            .ahead(input, 0.0)
            .is_none_or(|free| free > self.settings.clear_ahead * settings.target_distance)
        {
            self.distance_controller = DistanceController::default();
            self.wanted = settings.target_distance;
            self.enter(input.now, State::WallFollow, "path ahead clear", events);
            return Twist2::ZERO;
        }
        if self.patience < 0.0 {
            self.enter(input.now, State::WallSearch, "no clear direction", events);
            return Twist2::ZERO;
        }
        Twist2::new(0.0, -self.side * settings.turn_rate)
    }

    fn follow(&mut self, input: &WallFollowerInput<'_>, events: &mut EventLog) -> Twist2 {
        let settings = input.settings;
        let side = self.side;
        let base_from_odom = input.odom_from_base;
        let mirror = |point: Point2<f64>| Point2::new(point.x, side * point.y);
        let walls = self.walls.iter().map(|wall| {
            let wall = wall.seen_from(base_from_odom);
            Wall {
                from: mirror(wall.from),
                to: mirror(wall.to),
            }
        });
        let farthest = self.settings.lost_factor * settings.widest_distance.max(settings.identify_wall_distance);
        let Some(beside) = Beside::of(walls).filter(|beside| beside.distance < farthest) else {
            self.enter(input.now, State::WallSearch, "wall lost", events);
            return Twist2::ZERO;
        };
        let here = input.odom_from_base.position();
        let (low, high) = self
            .way
            .map_or((here, here), |(low, high)| (low.inf(&here), high.sup(&here)));
        self.way = Some((low, high));
        if self.turned > AROUND {
            self.island = self.way;
            self.enter(input.now, State::WallSearch, "circled an island", events);
            return Twist2::ZERO;
        }
        let odom = |point: Point2<f64>| input.odom_from_base.transform_point(mirror(point));
        self.followed = Some(Wall {
            from: odom(beside.wall.from),
            to: odom(beside.wall.to),
        });
        let ahead = self.ahead(input, 0.0).unwrap_or(f64::INFINITY);
        let inverse = input.odom_from_base.inverse();
        let points = self.points.iter().map(|point| mirror(inverse.transform_point(*point)));
        let wanted = beside.wanted(settings, self.body, points);

        let slow_for_corner = settings.approach_gain * (ahead - settings.target_distance);
        let slow_for_heading = settings.greatest_speed * (1.0 - beside.towards.x.abs());
        let v = slow_for_corner
            .min(slow_for_heading)
            .clamp(settings.least_speed, settings.greatest_speed);
        if ahead <= settings.target_distance + 0.5 * v * v / self.braking {
            self.begin_turn(input, Some(side), "wall ahead", events);
            return Twist2::ZERO;
        }
        let change = self.settings.widening * v * input.dt;
        self.wanted += (wanted - self.wanted).clamp(-change, change);
        let w = self
            .distance_controller
            .steer(&beside, self.wanted, v, settings, input.dt);
        Twist2::new(v, side * w)
    }

    /// How far the robot could go straight after a turn by `angle`, m; `None` where nothing is in the way.
    fn ahead(&self, input: &WallFollowerInput<'_>, angle: f64) -> Option<f64> {
        let heading = input.odom_from_base * Pose2::new(0.0, 0.0, angle);
        let inverse = heading.inverse();
        // A wall that is to be passed at the target distance must not count as in the way.
        let half = self.body.min(0.8 * input.settings.target_distance);
        self.points
            .iter()
            .map(|point| inverse.transform_point(*point))
            .filter(|point| point.x > 0.0 && point.y.abs() < half)
            .map(|point| point.x)
            .reduce(f64::min)
    }
}

/// Yaw rate that turns by `angle`, slower towards the end.
fn turning(angle: f64, settings: &WallFollowing) -> f64 {
    let most = settings.turn_rate;
    (settings.steering * angle).clamp(-most, most)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_robot_that_may_not_turn_to_one_side_turns_to_the_other() {
        let model = zenav_fixtures::robot("tiago");
        let now = Stamp::from_secs(1.0);
        let mut obstacles = LocalObstacles::new(&model);
        let lidar = model.first_lidar().unwrap();
        let sweep = zenav_fixtures::sweep_in_room(lidar, 1.0, Pose2::IDENTITY, (0.6, 3.0), &[]);
        assert!(obstacles.insert(&sweep, Pose2::IDENTITY));
        // The yaw rates that it wants at the wall ahead, while the collision monitor stops it or not.
        let turns = |stopped: bool| -> Vec<f64> {
            let mut follower = WallFollower::new(&model, &WallFollowerSettings::default());
            let mut events = EventLog::new("boot-1".into());
            let bump = Bump::none(now);
            let input = WallFollowerInput {
                now,
                dt: 0.02,
                settings: &model.wall_following,
                obstacles: &obstacles,
                odom_from_base: Pose2::IDENTITY,
                bump: &bump,
                stopped,
            };
            let wanted = (0..80).map(|_| follower.step(&input, &mut events).w);
            wanted.filter(|w| *w != 0.0).collect()
        };
        let (free, blocked) = (turns(false), turns(true));
        assert!(free.len() > 70 && free.iter().all(|w| w * free[0] > 0.0), "{free:?}");
        assert!(blocked[0] * free[0] > 0.0, "{blocked:?}");
        assert!(blocked.last().unwrap() * free[0] < 0.0, "{blocked:?}");
    }
}

//! Predictive control among moving obstacles. Does the plan lead into the predicted way of somebody, and what does the robot do instead?
//!
//! While no track ([`crate::obstacle_tracks`]) comes near the plan within the horizon, the tracker drives alone. Else two steps choose the
//! twist, every tick:
//!
//! 1. A space-time value function: on a small grid around the robot, for each cell and each time layer up to the horizon, the time to the
//!    end of the plan among static obstacles and predicted tracks, by dynamic programming backwards in time (waiting is a move; after
//!    Silver, "Cooperative pathfinding", AIIDE 2005). So the robot waits in a niche, passes behind, or backs out.
//! 2. A dynamic window (Fox, Burgard, Thrun, "The dynamic window approach to collision avoidance", IEEE RAM 1997) whose arcs are checked
//!    with the footprint against obstacles and predicted tracks, and judged at their end by that value function.
//!
//! It works in the odometry frame and never leaves floor that a lidar sees free, except along the plan. The collision monitor keeps the
//! last word.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::{Drive, Footprint, RobotModel};

use crate::blind_spot_grid::Floor;
use crate::field_of_view::rigid;
use crate::local_obstacles::LocalObstacles;
use crate::obstacle_tracks::Track;
use crate::settings::AvoidanceSettings;

/// Cells a side of the value function.
const SIDE: usize = 48;
const CELLS: usize = SIDE * SIDE;
/// Time layers of the value function.
const LAYERS: usize = 24;
/// The value function moves no faster than this, m/s: at higher speeds its cells would be too coarse for a door.
const GRID_SPEED: f64 = 1.0;
/// Cells a side of the distance grid that arcs are checked with, and their size, m.
const FINE_SIDE: usize = 120;
const FINE: f64 = 0.05;
/// Arcs last this long, s, in so many steps.
const ARC_SECS: f64 = 1.2;
const ARC_STEPS: u32 = 12;
/// Speeds and yaw rates of the window.
const SPEEDS: i32 = 8;
const YAW_RATES: i32 = 6;
/// Share of the top speed that is used backwards.
const BACKWARDS: f64 = 0.4;
/// Cost of a place from which the end cannot be reached, s.
const NO_WAY: f32 = 1e4;
/// Cost of a contact at the end of an arc, s; at its beginning twice that.
const CONTACT_COST: f64 = 12.0;
/// Cost of an arc all along the way of a track, s.
const NEARNESS_COST: f64 = 15.0;
/// Cost of an arc that the collision monitor would stop, s.
const SLOWED_COST: f64 = 4.0;
/// Cost of being beside a track, as a share of the time there.
const GRID_NEARNESS: f32 = 6.0;
/// Time that a turn costs beyond the one at the top yaw rate, as a share.
const TURN_COST: f64 = 0.6;
/// Off the plan by this much the tracker takes over again, m and rad.
const REJOINED: (f64, f64) = (0.15, 0.5);
/// Time without a conflict after which the robot returns to the plan, s.
const CALM: f64 = 0.3;
/// And after which the tracker takes over wherever the robot is: too far off its plan it asks for a new one.
const LONG_CALM: f64 = 1.5;
/// Floor this near to the plan is driven on even where no lidar sees it, m.
const ALONG_PLAN: f64 = 0.3;

/// What is ahead of the robot by its plan: pose in the odometry frame, and when it gets there at the plan's pace, s.
#[derive(Clone, Copy, Debug)]
pub struct Ahead {
    /// From now, s.
    pub secs: f64,
    /// Odometry frame.
    pub pose: Pose2,
}

/// What predictive control sees in a tick.
#[derive(Clone, Copy, Debug)]
pub struct AvoidanceInput<'a> {
    /// Since the last tick, s.
    pub dt: f64,
    /// Time since the tracks' stamp, s.
    pub age: f64,
    /// Where the robot is.
    pub odom_from_base: Pose2,
    /// The twist that the wheels were told last.
    pub command: Twist2,
    /// Largest wheel surface speed, m/s: the robot must be at rest when its plan expires.
    pub speed_cap: f64,
    /// Largest speed into the blind spot, m/s.
    pub blind_speed: f64,
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
    /// The tracker again, from the place on the plan that is nearest.
    Rejoin,
    /// This twist instead.
    Evade(Twist2),
}

/// Keeps the robot out of the way of moving obstacles.
#[derive(Clone, Debug)]
pub struct Avoidance {
    settings: AvoidanceSettings,
    drive: Drive,
    /// Discs that cover the footprint: place on the x axis of the base, and radius, m.
    discs: Vec<(f64, f64)>,
    /// Time before braking begins, and until the motors' lag has faded, s.
    reaction: f64,
    /// Radius that the value function keeps free, and that of the whole outline, m.
    inscribed: f64,
    circumscribed: f64,
    evading: bool,
    calm_for: f64,
    grid: Grid,
    fine: DistanceGrid,
}

impl Avoidance {
    /// For a robot.
    #[must_use]
    pub fn new(model: &RobotModel, settings: &AvoidanceSettings) -> Self {
        let drive = model.drive.clone();
        Self {
            settings: settings.clone(),
            discs: covering_discs(&model.footprint),
            inscribed: model.footprint.inscribed_radius(),
            circumscribed: model.footprint.circumscribed_radius(),
            reaction: 0.06 + 4.0 * drive.motor_lag,
            evading: false,
            calm_for: 0.0,
            grid: Grid::new(drive.top_speed().min(GRID_SPEED)),
            fine: DistanceGrid::default(),
            drive,
        }
    }

    /// Whether the robot is off its plan to make way.
    #[must_use]
    pub fn is_evading(&self) -> bool {
        self.evading
    }

    /// The plan has changed or ended: the tracker drives.
    pub fn reset(&mut self) {
        self.evading = false;
        self.calm_for = 0.0;
    }

    /// Decides for one tick.
    pub fn step(&mut self, input: &AvoidanceInput<'_>) -> Control {
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
            return Control::Follow;
        }
        let conflict = self.conflicts(input, &tracks);
        if !conflict && !self.evading {
            return Control::Follow;
        }
        self.calm_for = if conflict { 0.0 } else { self.calm_for + input.dt };
        if self.evading && (self.calm_for >= LONG_CALM || self.calm_for >= CALM && self.is_on_plan(input)) {
            self.reset();
            return Control::Rejoin;
        }
        self.evading = true;
        self.grid.fill(input, &tracks, &self.settings, self.inscribed);
        self.fine.fill(input);
        Control::Evade(self.best_arc(input, &tracks))
    }

    /// Clearance kept from a track this far ahead, m.
    fn clearance(&self, secs: f64) -> f64 {
        let grown = self.settings.clearance + self.settings.clearance_per_second * secs;
        grown.min(self.settings.clearance_most)
    }

    /// Whether the plan, at its own pace, comes too near to where a track is predicted.
    fn conflicts(&self, input: &AvoidanceInput<'_>, tracks: &[&Track]) -> bool {
        let within = input
            .ahead
            .iter()
            .take_while(|ahead| ahead.secs <= self.settings.horizon);
        within.into_iter().any(|ahead| {
            tracks.iter().any(|track| {
                self.distance_from_way(ahead.pose, track, ahead.secs + input.age) < self.clearance(ahead.secs)
            })
        })
    }

    /// Distance of the footprint at a pose from a point, m.
    fn distance(&self, pose: Pose2, point: Point2<f64>) -> f64 {
        let heading = pose.heading();
        let off = self
            .discs
            .iter()
            .map(|(x, radius)| (pose.position() + heading * *x - point).norm() - radius);
        off.fold(f64::INFINITY, f64::min)
    }

    /// Distance of the footprint at a pose from the way that a track takes in the moments after a time: the robot is to be out of it before.
    fn distance_from_way(&self, pose: Pose2, track: &Track, secs: f64) -> f64 {
        let (at, way) = (track.at(secs), track.velocity * self.settings.lead);
        let share = ((pose.position() - at).dot(&way) / way.norm_squared().max(1e-9)).clamp(0.0, 1.0);
        self.distance(pose, at + way * share) - track.radius
    }

    /// Whether the robot is where its plan leads, and looks along it.
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

    /// The twist whose arc costs least.
    fn best_arc(&self, input: &AvoidanceInput<'_>, tracks: &[&Track]) -> Twist2 {
        let (top, turn) = (self.drive.top_speed(), self.drive.top_yaw_rate().min(3.0));
        let backwards = if input.obstacles.blind_spots().leads_into_blind_spot(-1.0) {
            0.9 * input.blind_speed.min(BACKWARDS * top)
        } else {
            BACKWARDS * top
        };
        let mut best = (f64::INFINITY, Twist2::ZERO);
        for nth in -3..=SPEEDS {
            let v = if nth < 0 {
                backwards * f64::from(nth) / 3.0
            } else {
                top * f64::from(nth) / f64::from(SPEEDS)
            };
            for side in -YAW_RATES..=YAW_RATES {
                // Denser around straight on.
                let share = f64::from(side) / f64::from(YAW_RATES);
                let wanted = Twist2::new(v, turn * share * share.abs());
                if self.drive.surface_speed(wanted) > input.speed_cap + 1e-9 {
                    continue;
                }
                let cost = self.arc_cost(input, tracks, wanted, best.0);
                if cost < best.0 {
                    best = (cost, wanted);
                }
            }
        }
        best.1
    }

    /// Cost of going over to a twist and keeping it, s; given up beyond `limit`.
    fn arc_cost(&self, input: &AvoidanceInput<'_>, tracks: &[&Track], wanted: Twist2, limit: f64) -> f64 {
        let step = ARC_SECS / f64::from(ARC_STEPS);
        let target = self.drive.wheels(wanted);
        let mut wheels = self.drive.wheels(input.command);
        let (mut pose, mut cost) = (input.odom_from_base, 0.0);
        cost += 0.1 * (wanted.v - input.command.v).abs() / self.drive.top_speed()
            + 0.1 * (wanted.w - input.command.w).abs() / self.drive.top_yaw_rate();
        let change = self.drive.max_wheel_acceleration * step;
        for nth in 1..=ARC_STEPS {
            for (wheel, target) in wheels.iter_mut().zip(target) {
                *wheel += (target - *wheel).clamp(-change, change);
            }
            let twist = self.drive.twist(wheels);
            pose = pose.advance(twist, step);
            let secs = step * f64::from(nth);
            let left = 1.0 - secs / ARC_SECS;
            let moving = self.drive.surface_speed(twist) > 0.02;
            let still = self
                .discs
                .iter()
                .map(|(x, radius)| self.fine.distance(pose.position() + pose.heading() * *x) - radius);
            let clear = still.fold(f64::INFINITY, f64::min);
            if moving && clear < 0.02 {
                return 60.0 + 60.0 * left;
            }
            cost += 0.6 * (1.0 - clear / 0.1).max(0.0) / f64::from(ARC_STEPS);
            if moving && self.leaves_known_floor(input, pose, twist) {
                return 50.0 + 50.0 * left;
            }
            let (mut nearest, mut slowed) = (f64::INFINITY, 0.0_f64);
            let speed = self.drive.surface_speed(twist);
            let reach = self.circumscribed + self.settings.clearance_most;
            for track in tracks {
                let at = track.at(secs + input.age);
                let far = reach + track.radius + track.velocity.norm() * self.settings.lead;
                if (at - pose.position()).norm_squared() > far * far {
                    continue;
                }
                let distance = self.distance(pose, at) - track.radius;
                nearest = nearest.min(self.distance_from_way(pose, track, secs + input.age) - self.clearance(secs));
                // Nearer than this the collision monitor slows the robot down.
                let kept = track.velocity.norm() * (self.reaction + speed / self.drive.hard_braking);
                if distance < kept && (at - pose.position()).dot(&pose.heading()) * twist.v > 0.0 {
                    slowed = slowed.max((1.0 - distance / kept) * speed / self.drive.top_speed());
                }
                if distance < 0.03 {
                    // Sooner is worse, and so is the robot's own part in it.
                    cost += CONTACT_COST * (1.0 + left) + 0.5 * speed;
                    return cost;
                }
            }
            cost += SLOWED_COST * slowed / f64::from(ARC_STEPS);
            if nearest < 0.0 {
                cost += NEARNESS_COST * (-nearest / self.settings.clearance_most.max(0.1)) / f64::from(ARC_STEPS);
            }
            if cost >= limit {
                return cost;
            }
        }
        cost + self.grid.value(pose, ARC_SECS, self.drive.top_yaw_rate())
    }

    /// Whether the footprint at a pose is over floor that was never seen, ahead of its motion.
    fn leaves_known_floor(&self, input: &AvoidanceInput<'_>, pose: Pose2, twist: Twist2) -> bool {
        let grid = input.obstacles.blind_spots();
        if !grid.has_blind_spot() || twist.v >= 0.0 {
            return false;
        }
        let odom_from_base = rigid(input.odom_from_base);
        let rear = self.discs.iter().map(|(x, radius)| x - radius).fold(0.0, f64::min);
        let there = pose.position() + pose.heading() * rear;
        let place = odom_from_base.inverse() * there;
        matches!(grid.floor(&odom_from_base, place), Floor::Unknown | Floor::Occupied)
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
            let count = ((front - back) / (1.5 * half_width)).ceil().clamp(1.0, 8.0);
            let piece = (front - back) / count;
            let radius = half_width.hypot(0.5 * piece);
            (0..count as u32)
                .map(|nth| (back + piece * (f64::from(nth) + 0.5), radius))
                .collect()
        }
    }
}

/// The space-time value function around the robot.
#[derive(Clone, Debug)]
struct Grid {
    /// Side of a cell, m, and time of a layer, s.
    cell: f64,
    layer: f64,
    /// Lower-left corner, odometry frame.
    origin: Point2<f64>,
    /// Cells that the robot cannot be in.
    blocked: Vec<bool>,
    /// Time to the end of the plan from each cell of each layer, s.
    values: Vec<f32>,
}

/// The moves of a layer: to a neighbour, or none.
const MOVES: [(isize, f32); 9] = [
    (0, 0.0),
    (1, 1.0),
    (-1, 1.0),
    (SIDE as isize, 1.0),
    (-(SIDE as isize), 1.0),
    (SIDE as isize + 1, std::f32::consts::SQRT_2),
    (SIDE as isize - 1, std::f32::consts::SQRT_2),
    (1 - SIDE as isize, std::f32::consts::SQRT_2),
    (-1 - SIDE as isize, std::f32::consts::SQRT_2),
];

impl Grid {
    fn new(speed: f64) -> Self {
        let layer = 0.2;
        Self {
            cell: (layer * speed).max(0.02),
            layer,
            origin: Point2::origin(),
            blocked: vec![false; CELLS],
            values: vec![NO_WAY; CELLS * (LAYERS + 1)],
        }
    }

    fn center(&self, index: usize) -> Point2<f64> {
        let (column, row) = ((index % SIDE) as f64 + 0.5, (index / SIDE) as f64 + 0.5);
        self.origin + Vector2::new(column, row) * self.cell
    }

    /// The cells whose centers lie in a disc.
    fn disc(&self, center: Point2<f64>, radius: f64) -> impl Iterator<Item = usize> + use<> {
        let (origin, cell) = (self.origin, self.cell);
        let low = (center - origin) / cell - Vector2::repeat(radius / cell + 0.5);
        let high = (center - origin) / cell + Vector2::repeat(radius / cell - 0.5);
        let range = |low: f64, high: f64| {
            let last = SIDE as f64;
            (low.ceil().clamp(0.0, last) as usize)..((high.floor() + 1.0).clamp(0.0, last) as usize)
        };
        let (columns, rows) = (range(low.x, high.x), range(low.y, high.y));
        rows.flat_map(move |row| columns.clone().map(move |column| (column, row)))
            .filter(move |(column, row)| {
                let at = origin + Vector2::new(*column as f64 + 0.5, *row as f64 + 0.5) * cell;
                (at - center).norm_squared() <= radius * radius
            })
            .map(|(column, row)| row * SIDE + column)
    }

    /// Computes all values.
    fn fill(&mut self, input: &AvoidanceInput<'_>, tracks: &[&Track], settings: &AvoidanceSettings, inscribed: f64) {
        let here = input.odom_from_base.position();
        self.origin = here - Vector2::repeat(0.5 * SIDE as f64 * self.cell);
        self.block(input, inscribed);
        self.static_values(input);
        // Backwards in time.
        for nth in (0..LAYERS).rev() {
            let (before, after) = self.values.split_at_mut((nth + 1) * CELLS);
            let (now, next) = (&mut before[nth * CELLS..], &after[..CELLS]);
            let last = &after[(LAYERS - nth - 1) * CELLS..];
            let step = self.layer as f32;
            for row in 0..SIDE {
                for column in 0..SIDE {
                    let index = row * SIDE + column;
                    if self.blocked[index] {
                        now[index] = NO_WAY;
                        continue;
                    }
                    // Who is at the end does not wait for anything.
                    let wait = if last[index] < step { 0.0 } else { step };
                    let mut least = next[index] + wait;
                    if (1..SIDE - 1).contains(&row) && (1..SIDE - 1).contains(&column) {
                        for (shift, steps) in &MOVES[1..] {
                            let there = next[(index as isize + shift) as usize];
                            least = least.min(there + step * steps);
                        }
                    }
                    now[index] = least.min(NO_WAY);
                }
            }
            let secs = self.layer * nth as f64;
            for track in tracks {
                let clearance =
                    (settings.clearance + settings.clearance_per_second * secs).min(settings.clearance_most);
                let at = track.at(secs + input.age);
                let (near, far) = (track.radius + inscribed + 0.03, track.radius + inscribed + clearance);
                let way = track.velocity * settings.lead;
                for index in self.disc(at + way * 0.5, far + 0.5 * way.norm()) {
                    let center = self.center(index);
                    let share = ((center - at).dot(&way) / way.norm_squared().max(1e-9)).clamp(0.0, 1.0);
                    let distance = (center - (at + way * share)).norm();
                    if distance > far {
                        continue;
                    }
                    let value = &mut self.values[nth * CELLS + index];
                    if distance <= near {
                        *value = NO_WAY;
                    } else {
                        let depth = (far - distance) / (far - near).max(1e-6);
                        *value = (*value + GRID_NEARNESS * self.layer as f32 * depth as f32).min(NO_WAY);
                    }
                }
            }
        }
    }

    /// Marks the cells that the robot cannot be in: too near to what stands, or never seen free.
    fn block(&mut self, input: &AvoidanceInput<'_>, inscribed: f64) {
        let odom_from_base = rigid(input.odom_from_base);
        let base_from_odom = odom_from_base.inverse();
        let grid = input.obstacles.blind_spots();
        for index in 0..CELLS {
            let at = self.center(index);
            let place = base_from_odom * at;
            self.blocked[index] = if grid.in_blind_spot(place) {
                !matches!(grid.floor(&odom_from_base, place), Floor::Free)
            } else {
                !input.obstacles.is_seen_free(at)
            };
        }
        let along: Vec<usize> = input
            .ahead
            .iter()
            .flat_map(|ahead| self.disc(ahead.pose.position(), ALONG_PLAN))
            .collect();
        for index in along {
            self.blocked[index] = false;
        }
        let around: Vec<usize> = self.disc(input.odom_from_base.position(), 1.5 * inscribed).collect();
        for index in around {
            self.blocked[index] = false;
        }
        let tracks = input.obstacles.moving().tracks();
        let standing = input.obstacles.in_odom().filter(|point| tracks.at(*point).is_none());
        let standing: Vec<usize> = standing.flat_map(|point| self.disc(point, inscribed + 0.03)).collect();
        for index in standing {
            self.blocked[index] = true;
        }
    }

    /// The time to the end of the plan among what stands, into the last layer: Dijkstra from the plan.
    fn static_values(&mut self, input: &AvoidanceInput<'_>) {
        let last = LAYERS * CELLS;
        let end = input.ahead.last().map_or(0.0, |ahead| ahead.secs);
        let values = &mut self.values[last..];
        values.fill(NO_WAY);
        let mut open = std::collections::BinaryHeap::new();
        // Times as integers, ms: the heap needs a total order.
        let millis = |secs: f64| (1e3 * secs) as u32;
        let (origin, cell) = (self.origin, self.cell);
        let inside = |point: Point2<f64>| {
            let off = (point - origin) / cell;
            let inside = |value: f64| (0.0..SIDE as f64).contains(&value);
            (inside(off.x) && inside(off.y)).then(|| off.y as usize * SIDE + off.x as usize)
        };
        for ahead in input.ahead {
            if let Some(index) = inside(ahead.pose.position()).filter(|index| !self.blocked[*index]) {
                open.push((std::cmp::Reverse(millis(end - ahead.secs)), index));
            }
        }
        while let Some((std::cmp::Reverse(time), index)) = open.pop() {
            let secs = 1e-3 * time as f32;
            if secs >= values[index] {
                continue;
            }
            values[index] = secs;
            let (row, column) = (index / SIDE, index % SIDE);
            if !(1..SIDE - 1).contains(&row) || !(1..SIDE - 1).contains(&column) {
                continue;
            }
            for (shift, steps) in &MOVES[1..] {
                let there = (index as isize + shift) as usize;
                let then = secs + 1.2 * self.layer as f32 * steps;
                if !self.blocked[there] && then < values[there] {
                    open.push((std::cmp::Reverse((1e3 * then) as u32), there));
                }
            }
        }
    }

    /// Time to the end from a pose `secs` from now, s: the value between the cells around it, and the turn towards the best neighbour.
    fn value(&self, pose: Pose2, secs: f64, yaw_rate: f64) -> f64 {
        let nth = ((secs / self.layer).round() as usize).min(LAYERS);
        let layer = &self.values[nth * CELLS..(nth + 1) * CELLS];
        let off = (pose.position() - self.origin) / self.cell - Vector2::repeat(0.5);
        let (column, row) = (off.x.floor(), off.y.floor());
        if !(0.0..SIDE as f64 - 1.0).contains(&column) || !(0.0..SIDE as f64 - 1.0).contains(&row) {
            return f64::from(NO_WAY);
        }
        let (share_x, share_y) = (off.x - column, off.y - row);
        let corner = row as usize * SIDE + column as usize;
        let corners = [
            (corner, (1.0 - share_x) * (1.0 - share_y)),
            (corner + 1, share_x * (1.0 - share_y)),
            (corner + SIDE, (1.0 - share_x) * share_y),
            (corner + SIDE + 1, share_x * share_y),
        ];
        // A cell without a way out counts, but does not drown the others.
        let ways = corners
            .iter()
            .map(|(index, share)| (f64::from(layer[*index]), share))
            .filter(|(value, _)| *value < f64::from(NO_WAY));
        let (sum, weight) = ways.fold((0.0, 0.0), |(sum, weight), (value, share)| {
            (sum + value * share, weight + share)
        });
        if weight < 1e-3 {
            return f64::from(NO_WAY);
        }
        let value = sum / weight + 2.0 * (1.0 - weight);
        let nearest = (off.y.round() as usize).clamp(1, SIDE - 2) * SIDE + (off.x.round() as usize).clamp(1, SIDE - 2);
        let next = &self.values[(nth + 1).min(LAYERS) * CELLS..][..CELLS];
        let best = MOVES.iter().min_by(|a, b| {
            let value =
                |shift: isize, steps: f32| next[(nearest as isize + shift) as usize] + self.layer as f32 * steps;
            value(a.0, a.1.max(1.0)).total_cmp(&value(b.0, b.1.max(1.0)))
        });
        let turn = best.filter(|(shift, _)| *shift != 0).map_or(0.0, |(shift, _)| {
            let there = (nearest as isize + shift) as usize;
            let toward = self.center(there) - self.center(nearest);
            let turn = wrap_angle(toward.y.atan2(toward.x) - pose.yaw).abs();
            turn.min(std::f64::consts::PI - turn + 0.8)
        });
        value + TURN_COST * turn / yaw_rate.max(0.1)
    }
}

/// Distances to what stands around the robot.
#[derive(Clone, Debug, Default)]
struct DistanceGrid {
    origin: Point2<f64>,
    /// In cells.
    distances: Vec<f32>,
}

impl DistanceGrid {
    /// Chamfer distances (3-4 weights; Borgefors, "Distance transformations in digital images", CVGIP 1986) to all points that are not on
    /// a track.
    fn fill(&mut self, input: &AvoidanceInput<'_>) {
        let tracks = input.obstacles.moving().tracks();
        self.origin = input.odom_from_base.position() - Vector2::repeat(0.5 * FINE_SIDE as f64 * FINE);
        self.distances.clear();
        self.distances.resize(FINE_SIDE * FINE_SIDE, 1e3);
        for point in input.obstacles.in_odom().filter(|point| tracks.at(*point).is_none()) {
            if let Some(index) = self.index(point) {
                self.distances[index] = 0.0;
            }
        }
        let side = FINE_SIDE as isize;
        let (straight, diagonal) = (0.955, 1.369);
        let mut pass = |order: &mut dyn Iterator<Item = isize>, shifts: [(isize, f32); 4]| {
            for index in order {
                let (row, column) = (index / side, index % side);
                if row == 0 || row == side - 1 || column == 0 || column == side - 1 {
                    continue;
                }
                let mut least = self.distances[index as usize];
                for (shift, step) in shifts {
                    least = least.min(self.distances[(index + shift) as usize] + step);
                }
                self.distances[index as usize] = least;
            }
        };
        let before = [
            (-1, straight),
            (-side, straight),
            (-side - 1, diagonal),
            (1 - side, diagonal),
        ];
        pass(&mut (0..side * side), before);
        let after = before.map(|(shift, step)| (-shift, step));
        pass(&mut (0..side * side).rev(), after);
    }

    fn index(&self, point: Point2<f64>) -> Option<usize> {
        let off = (point - self.origin) / FINE;
        let inside = |value: f64| (0.0..FINE_SIDE as f64).contains(&value);
        (inside(off.x) && inside(off.y)).then(|| off.y as usize * FINE_SIDE + off.x as usize)
    }

    /// Distance of a point from what stands, m, to within a cell.
    fn distance(&self, point: Point2<f64>) -> f64 {
        let cells = self.index(point).and_then(|index| self.distances.get(index));
        cells.map_or(1.0, |cells| f64::from(*cells) * FINE)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use zenav_protocol::readings::Sweep;
    use zenav_protocol::time::Stamp;

    const RATE: f64 = 20.0;

    /// A hall with walls at y = ±`half`, in which walkers and a robot move; true poses, perfect odometry, no monitor.
    struct Hall {
        model: RobotModel,
        avoidance: Avoidance,
        obstacles: LocalObstacles,
        pose: Pose2,
        twist: Twist2,
        half: f64,
        least: f64,
    }

    impl Hall {
        fn new(robot: &str, half: f64) -> Self {
            let model = zenav_fixtures::robot(robot);
            Self {
                avoidance: Avoidance::new(&model, &AvoidanceSettings::default()),
                obstacles: LocalObstacles::new(&model),
                pose: Pose2::IDENTITY,
                twist: Twist2::ZERO,
                half,
                least: f64::INFINITY,
                model,
            }
        }

        fn scan(&mut self, now: f64, walkers: &[Point2<f64>]) {
            let lidar = self.model.first_lidar().unwrap().clone();
            let laser = self.pose * lidar.mount;
            let range = |beam: usize| {
                let angle = laser.yaw + lidar.angle_min() + beam as f64 * lidar.angle_increment();
                let ray = Vector2::new(angle.cos(), angle.sin());
                let wall = (self.half - laser.y * ray.y.signum()) / ray.y.abs().max(1e-9);
                let discs = walkers.iter().map(|walker| {
                    let off = walker - laser.position();
                    let (along, aside) = (off.dot(&ray), off.perp(&ray).abs());
                    if along <= 0.0 || aside >= 0.25 {
                        return f64::INFINITY;
                    }
                    along - (0.0625 - aside * aside).sqrt()
                });
                let range = discs.fold(wall, f64::min);
                if range > lidar.range_max {
                    f32::INFINITY
                } else {
                    range as f32
                }
            };
            let sweep = Sweep::new(Stamp::from_secs(now), (0..lidar.beams).map(range).collect());
            self.obstacles.insert(&sweep, self.pose);
        }

        /// Drives along y = 0 to x = 12 at `pace`; the time it takes, s.
        fn drive(&mut self, pace: f64, walkers: impl Fn(f64) -> Vec<Point2<f64>>) -> Option<f64> {
            for step in 0..(60.0 * RATE) as u32 {
                let now = f64::from(step) / RATE;
                let walkers = walkers(now);
                self.scan(now, &walkers);
                let ahead: Vec<Ahead> = (0..=120)
                    .map(|nth| 0.1 * f64::from(nth))
                    .map(|secs| Ahead {
                        secs,
                        pose: Pose2::new((self.pose.x + pace * secs).min(12.0), 0.0, 0.0),
                    })
                    .collect();
                let control = self.avoidance.step(&AvoidanceInput {
                    dt: 1.0 / RATE,
                    age: 0.0,
                    odom_from_base: self.pose,
                    command: self.twist,
                    speed_cap: f64::INFINITY,
                    blind_speed: 0.1,
                    ahead: &ahead,
                    obstacles: &self.obstacles,
                });
                let wanted = match control {
                    Control::Evade(twist) => twist,
                    _ => Twist2::new(pace, -2.0 * self.pose.y - 2.0 * self.pose.yaw),
                };
                let change = self.model.drive.acceleration() / RATE;
                let v = self.twist.v + (wanted.v - self.twist.v).clamp(-change, change);
                self.twist = Twist2::new(v, wanted.w);
                self.pose = self.pose.advance(self.twist, 1.0 / RATE);
                for walker in &walkers {
                    let off = self.pose.inverse().transform_point(*walker);
                    self.least = self.least.min(self.model.footprint.distance(off) - 0.25);
                }
                if self.pose.x > 11.5 {
                    return Some(now);
                }
            }
            None
        }
    }

    #[test]
    fn with_nobody_near_the_tracker_drives() {
        let mut hall = Hall::new("tiago", 2.0);
        let secs = hall.drive(0.6, |_| Vec::new()).unwrap();
        assert!(
            !hall.avoidance.is_evading() && (secs - 11.5 / 0.6).abs() < 1.5,
            "{secs}"
        );
    }

    #[test]
    fn it_steps_aside_for_somebody_who_comes_along_the_middle() {
        for robot in ["tiago", "jackal"] {
            let mut hall = Hall::new(robot, 1.6);
            let secs = hall.drive(0.6, |now| vec![Point2::new(11.0 - 1.0 * now, 0.0)]).unwrap();
            assert!(hall.least > 0.05, "{robot}: {}", hall.least);
            assert!(secs < 32.0, "{robot}: {secs} s");
        }
    }

    #[test]
    fn it_lets_somebody_cross() {
        for robot in ["tiago", "jackal"] {
            // Would meet it at x = 5.
            let mut hall = Hall::new(robot, 6.0);
            let secs = hall.drive(0.6, |now| vec![Point2::new(5.0, -5.0 + 0.6 * now)]).unwrap();
            assert!(hall.least > 0.1, "{robot}: {}", hall.least);
            assert!(secs < 27.0, "{robot}: {secs} s");
        }
    }

    #[test]
    fn the_discs_cover_the_footprint() {
        for robot in ["tiago", "jackal", "turtlebot3_waffle"] {
            let footprint = zenav_fixtures::robot(robot).footprint;
            let discs = covering_discs(&footprint);
            let corners = match &footprint {
                Footprint::Radius(radius) => vec![Point2::new(*radius, 0.0)],
                Footprint::Polygon(corners) => corners.clone(),
            };
            for corner in corners {
                let covered = discs
                    .iter()
                    .any(|(x, radius)| (corner - Point2::new(*x, 0.0)).norm() <= radius + 1e-9);
                assert!(covered, "{robot}: {corner}");
            }
        }
    }
}

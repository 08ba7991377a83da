//! Arcs. Which twist costs least if it is driven for a moment as fast as the collision monitor allows?
//!
//! Each twist is kept along an arc, at the speed that the monitor allows now. The arc is checked against static obstacles and predicted
//! tracks; its end is judged by the value function.

use std::f64::consts::TAU;

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::robot::Drive;

use super::{Avoidance, AvoidanceInput, PlacedDiscs, kept, lead};
use crate::blind_spot_grid::Floor;
use crate::field_of_view::rigid;
use crate::limiter::within_speed;
use crate::obstacle_tracks::Track;
use crate::passive_safety::{GENTLE, Mover};
use crate::trackers::capped;

/// Duration of an arc, s; in contact, where the robot only creeps, s; number of steps of either.
const ARC_SECS: f64 = 1.2;
const TOUCHED_ARC_SECS: f64 = 4.8;
const ARC_STEPS: u32 = 12;
/// Number of forward speeds in the window, and of yaw rates to either side.
const SPEEDS: i32 = 8;
const YAW_RATES: i32 = 6;
/// Ways out of a contact: number of directions, share of the top speed, and largest heading error while driving, rad.
const WAYS_OUT: u32 = 24;
const AWAY: f64 = 0.4;
const ALIGNED: f64 = 0.15;
/// A turn slows down once this little time is left of it, s.
const TURN_SLOWS: f64 = 0.12;
/// Another way out is taken only if it costs less by this, s: otherwise the robot dithers between two equally good ones.
const KEPT_GAIN: f64 = 2.0;
/// Share of the top speed used backwards.
const BACKWARDS: f64 = 0.4;
/// A smaller distance from a static obstacle, or from a track, is a contact, m.
const LEAST_CLEARANCE: f64 = 0.02;
const LEAST_DISTANCE: f64 = 0.03;
/// Cost of a contact at the end of an arc, s; at its beginning twice that.
const CONTACT_COST: f64 = 12.0;
/// Cost of a contact straight ahead for a robot that does not see behind itself, s: it can only creep away.
const HEAD_ON_COST: f64 = 8.0;
/// Largest time to the end of the plan that is counted, s: also that of an end that cannot be reached.
const MOST_VALUE: f64 = 60.0;
/// A robot slower than this is assumed to stay where it is, whatever course it announces, m/s.
const STANDS: f64 = 0.05;
/// Largest cost of the end of an arc from which no way leads on, s.
const DOOMED_COST: f64 = 10.0;
/// Additional cost for each rad that its end faces away from the end of the plan, s.
const LOOK_COST: f64 = 0.5;
/// Cost of an arc that stays in the path of a track, s.
const NEARNESS_COST: f64 = 15.0;
/// Cost of an arc that the collision monitor would stop, s.
const SLOWED_COST: f64 = 4.0;
/// Cost of a twist that the collision monitor stops entirely, s.
const HELD_COST: f64 = 1.5;
/// Cost of each second in contact, s; none beyond this distance, m.
const TOUCHED_COST: (f64, f64) = (2.0, 0.15);
/// Resolution of the clearance grid together with the covering discs, m.
const COARSE: f64 = 0.08;

/// The situation in which an arc begins.
pub(super) struct Situation<'a> {
    input: &'a AvoidanceInput<'a>,
    /// Tracks, and their distances from the covering discs, m.
    tracks: Vec<(&'a Track, f64)>,
    /// Tracks that lean on the robot.
    leaning: &'a [&'a Track],
    /// Time to the end of the plan, s.
    value: f64,
    /// Distance of the covering discs from static obstacles, m.
    clear: f64,
}

impl<'a> Situation<'a> {
    /// The present situation.
    pub(super) fn new(
        avoidance: &Avoidance,
        input: &'a AvoidanceInput<'a>,
        tracks: &[&'a Track],
        leaning: &'a [&'a Track],
    ) -> Self {
        let here = input.odom_from_base;
        let discs = avoidance.placed(here);
        let distance = |track: &Track| {
            let at = track.at(input.now.secs_since(track.stamp));
            discs.distance(at) - track.radius
        };
        let value = avoidance.values.at(here, 0.0, avoidance.drive.top_yaw_rate());
        Self {
            input,
            tracks: tracks.iter().map(|track| (*track, distance(track))).collect(),
            leaning,
            value: value.min(MOST_VALUE),
            clear: avoidance.clear(&discs),
        }
    }
}

/// One step of an arc.
struct Step {
    /// Where it ends, odometry frame, the direction of its heading, and the covering discs there.
    pose: Pose2,
    heading: Vector2<f64>,
    discs: PlacedDiscs,
    /// How the robot gets there.
    twist: Twist2,
    /// When it ends, s from now, and the share of the arc that is left then.
    secs: f64,
    left: f64,
}

/// A direction in the odometry frame that leads out of a contact: the robot turns on the spot until it faces it, then drives.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct WayOut(u32);

impl WayOut {
    /// The twist for a heading, rad, kept for `kept` s at least.
    fn twist(self, drive: &Drive, yaw: f64, kept: f64) -> Twist2 {
        let off = wrap_angle(TAU * f64::from(self.0) / f64::from(WAYS_OUT) - yaw);
        let turn = fastest_turn(drive);
        let v = if off.abs() < ALIGNED {
            AWAY * drive.top_speed()
        } else {
            0.0
        };
        Twist2::new(v, (off / kept.max(TURN_SLOWS)).clamp(-turn, turn))
    }
}

/// The highest yaw rate tried, rad/s.
fn fastest_turn(drive: &Drive) -> f64 {
    drive.top_yaw_rate().min(3.0)
}

impl Avoidance {
    /// The twist whose arc costs least, and the way out of a contact that it begins.
    pub(super) fn best_arc(&self, situation: &Situation<'_>) -> (Twist2, Option<WayOut>) {
        let input = situation.input;
        let (top, turn) = (self.drive.top_speed(), fastest_turn(&self.drive));
        let backwards = if input.obstacles.blind_spots().leads_into_blind_spot(-1.0) {
            let allowed = input
                .monitor
                .speed_into_blind_spot(input.now, input.obstacles, input.odom_from_base)
                .max(GENTLE);
            0.9 * allowed.min(BACKWARDS * top)
        } else {
            BACKWARDS * top
        };
        let base_from_odom = rigid(input.odom_from_base).inverse();
        let mover = |track: &Track| {
            let at = base_from_odom * track.at(input.now.secs_since(track.stamp));
            // The monitor handles the outlines of robots that announce their course.
            let turns_at_will = !track.is_robot();
            turns_at_will.then(|| Mover::at_will(at, track.radius, track.most_speed()))
        };
        let tracks = situation.tracks.iter().map(|(track, _)| *track);
        let movers: Vec<Mover> = tracks
            .chain(situation.leaning.iter().copied())
            .filter_map(mover)
            .collect();
        let people = input
            .monitor
            .people_behind_corners(input.obstacles, input.odom_from_base);
        let bump = self.touched.is_so().then_some(input.bump);
        let felt = (self.touched.is_so() || input.bump.pressed).then_some(input.bump);
        let share_of = |wanted: Twist2| {
            let (obstacles, here) = (input.obstacles, input.odom_from_base);
            let among = input
                .monitor
                .share_among(input.now, wanted, &movers, obstacles, here, felt);
            among.min(input.monitor.share_past_corners(input.now, wanted, &people, obstacles))
        };
        // In contact the robot creeps away, however slowly.
        let held_cost = if bump.is_some() { 0.0 } else { HELD_COST };
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
                let wanted = capped(&self.drive, within_speed(&self.drive, wanted), input.speed_cap);
                let share = share_of(wanted);
                if bump.is_some() && share <= 0.0 && wanted != Twist2::ZERO {
                    continue;
                }
                let driven = Twist2::new(share * wanted.v, share * wanted.w);
                let cost = self.arc_cost(situation, driven, None, best.0) + held_cost * (1.0 - share);
                if cost < best.0 {
                    best = (cost, wanted);
                }
            }
        }
        let mut chosen = None;
        if bump.is_some() || self.is_stuck() {
            // Often no single arc leads away from a contact, but a turn followed by a straight drive does.
            for way_out in (0..WAYS_OUT).map(WayOut) {
                let twist = way_out.twist(&self.drive, input.odom_from_base.yaw, input.dt);
                let wanted = capped(&self.drive, within_speed(&self.drive, twist), input.speed_cap);
                let share = share_of(wanted);
                if share <= 0.0 {
                    continue;
                }
                let first = Twist2::new(share * wanted.v, share * wanted.w);
                let kept = if self.way_out == Some(way_out) { KEPT_GAIN } else { 0.0 };
                let cost = self.arc_cost(situation, first, Some((way_out, share)), best.0 + kept) - kept;
                if cost < best.0 {
                    best = (cost, wanted);
                    chosen = Some(way_out);
                }
            }
        }
        (best.1, chosen)
    }

    /// Cost of changing to a twist and keeping it, or of a way out with a share of its turn, s; evaluation ends beyond `limit`.
    fn arc_cost(&self, situation: &Situation<'_>, wanted: Twist2, way_out: Option<(WayOut, f64)>, limit: f64) -> f64 {
        let (input, from_here) = (situation.input, situation.value);
        let touched = self.touched.is_so();
        let lasts = if touched || way_out.is_some() {
            TOUCHED_ARC_SECS
        } else {
            ARC_SECS
        };
        let step = lasts / f64::from(ARC_STEPS);
        let base_from_odom = rigid(input.odom_from_base).inverse();
        let mut wheels = self.drive.wheels(input.command);
        // An arc is judged by the time to go at its end, so a longer arc first costs its extra time.
        let (mut pose, mut cost) = (input.odom_from_base, if touched { 0.0 } else { lasts - ARC_SECS });
        cost += 0.1 * (wanted.v - input.command.v).abs() / self.drive.top_speed()
            + 0.1 * (wanted.w - input.command.w).abs() / self.drive.top_yaw_rate();
        let mut target = self.drive.wheels(wanted);
        let change = self.drive.max_wheel_acceleration * step;
        for nth in 1..=ARC_STEPS {
            if let Some((way_out, share)) = way_out {
                let twist = way_out.twist(&self.drive, pose.yaw, step);
                let share = if twist.v > 0.0 { 1.0 } else { share };
                target = self.drive.wheels(Twist2::new(twist.v, share * twist.w));
            }
            // As the limiter does: both wheels in proportion.
            let off = [target[0] - wheels[0], target[1] - wheels[1]];
            let share = (change / off[0].abs().max(off[1].abs()).max(1e-9)).min(1.0);
            wheels = [wheels[0] + share * off[0], wheels[1] + share * off[1]];
            let twist = self.drive.twist(wheels);
            pose = pose.advance(twist, step);
            let secs = step * f64::from(nth);
            let left = 1.0 - secs / lasts;
            let moving = self.drive.surface_speed(twist) > 0.02;
            let (heading, discs) = (pose.heading(), self.placed(pose));
            let clear = self.clear(&discs);
            // A robot that is too near already may leave; in contact the grid is too coarse to decide.
            if moving && clear < LEAST_CLEARANCE.min(situation.clear - if touched { COARSE } else { LEAST_CLEARANCE }) {
                return from_here + 60.0 + 60.0 * left;
            }
            if touched {
                let base_from_there = input.odom_from_base.inverse() * pose;
                match self.touched.distance(&self.footprint, base_from_there) {
                    Some(distance) => {
                        cost += TOUCHED_COST.0 * step * (1.0 - distance / TOUCHED_COST.1).max(0.0);
                    }
                    None if moving => return from_here + 60.0 + 60.0 * left,
                    None => cost += TOUCHED_COST.0 * step,
                }
            }
            cost += 0.6 * (1.0 - clear / 0.1).max(0.0) / f64::from(ARC_STEPS);
            if moving && self.leaves_known_floor(input, base_from_odom, pose.position(), heading, twist) {
                return from_here + 50.0 + 50.0 * left;
            }
            let there = Step {
                pose,
                heading,
                discs,
                twist,
                secs,
                left,
            };
            if let Some(contact) = self.meet_tracks(situation, &there, &mut cost) {
                return contact;
            }
            if cost >= limit {
                return cost;
            }
        }
        let value = self.values.at(pose, lasts, self.drive.top_yaw_rate());
        if value < from_here + DOOMED_COST {
            return cost + value;
        }
        // Without a way out there will be a contact, but a later one; by then an obstacle last seen there may have left.
        let looks_away = input.ahead.last().map_or(0.0, |end| {
            let toward = end.pose.position() - pose.position();
            wrap_angle(toward.y.atan2(toward.x) - pose.yaw).abs()
        });
        cost + from_here + DOOMED_COST + LOOK_COST * looks_away
    }

    /// Adds what the tracks cost at a step of an arc, s. Returns the cost of the whole arc if it meets one there.
    fn meet_tracks(&self, situation: &Situation<'_>, step: &Step, cost: &mut f64) -> Option<f64> {
        let (input, from_here) = (situation.input, situation.value);
        let Step {
            pose,
            heading,
            discs,
            twist,
            secs,
            left,
        } = step;
        let speed = self.drive.surface_speed(*twist);
        let (mut nearest, mut slowed) = (f64::INFINITY, 0.0_f64);
        let reach = self.circumscribed + self.settings.clearance_most;
        for (track, before) in &situation.tracks {
            let after = secs + input.now.secs_since(track.stamp);
            let (at, lead) = (track.at(after), lead(&self.settings, track));
            let far = reach + track.radius + track.velocity.norm() * lead;
            if (at - pose.position()).norm_squared() > far * far {
                continue;
            }
            let distance = discs.distance(at) - track.radius;
            if let Some(kept) = kept(&self.settings, track, *secs) {
                let path = track.path(after, lead);
                nearest = nearest.min(discs.distance_from_path(&path) - track.radius - kept);
            }
            let least = LEAST_DISTANCE.min(before - LEAST_CLEARANCE);
            let mut touches = distance < least;
            if track.is_robot() {
                // The other robot does not follow its course while this one blocks it: an arc that leads out of its path is better than
                // none.
                *cost += f64::from(u8::from(touches)) * CONTACT_COST * (1.0 + left) / f64::from(ARC_STEPS);
                touches = track.velocity.norm() < STANDS && discs.distance(track.position) - track.radius < least;
            }
            // Nearer than this the collision monitor slows the robot down.
            let fast = if track.is_robot() { 0.0 } else { track.velocity.norm() };
            let kept = fast * (self.reaction + speed / self.drive.hard_braking);
            if kept > 0.0 && distance < kept && (at - pose.position()).dot(heading) * twist.v > 0.0 {
                slowed = slowed.max((1.0 - distance / kept) * speed / self.drive.top_speed());
            }
            if touches {
                // A contact costs more the sooner it comes, the faster the robot drives, and, if it backs up slowly, the more straight
                // ahead it is.
                let ahead = (at - pose.position()).dot(heading) / (at - pose.position()).norm().max(1e-9);
                let held = if input.obstacles.blind_spots().leads_into_blind_spot(-1.0) {
                    HEAD_ON_COST * ahead.max(0.0)
                } else {
                    0.0
                };
                return Some(*cost + from_here + CONTACT_COST * (1.0 + left) + 0.5 * speed + held);
            }
        }
        *cost += SLOWED_COST * slowed / f64::from(ARC_STEPS);
        if nearest < 0.0 {
            *cost += NEARNESS_COST * (-nearest / self.settings.clearance_most.max(0.1)) / f64::from(ARC_STEPS);
        }
        None
    }

    /// Distance of the covering discs from static obstacles, m, to within a cell.
    fn clear(&self, discs: &PlacedDiscs) -> f64 {
        discs.least(|place| self.clearances.distance(place))
    }

    /// Whether the rear of a robot that backs up is over floor not known to be free.
    fn leaves_known_floor(
        &self,
        input: &AvoidanceInput<'_>,
        base_from_odom: Isometry2<f64>,
        place: Point2<f64>,
        heading: Vector2<f64>,
        twist: Twist2,
    ) -> bool {
        let grid = input.obstacles.blind_spots();
        if !grid.has_blind_spot() || twist.v >= 0.0 {
            return false;
        }
        let rear = self.discs.iter().map(|(x, radius)| x - radius).fold(0.0, f64::min);
        let place = base_from_odom * (place + heading * rear);
        matches!(
            grid.floor(&rigid(input.odom_from_base), place),
            Floor::Unknown | Floor::Occupied
        )
    }
}

//! Right of way. Where does a robot wait for others that go first, before their ways meet?
//!
//! Predictive control ([`crate::avoidance`]) sees some seconds ahead. That is too late for a lane where two cannot pass, and it makes a detour
//! of what a short wait at the crossing settles. So the whole told course of each robot that goes first is held against the whole plan: over
//! which stretch of the plan do the two come too near to one another, and has one of them left it before the other one comes? Where neither
//! has, this robot waits before the stretch (after Kant and Zucker, "Toward efficient trajectory planning: the path-velocity decomposition",
//! IJRR 1986).
//!
//! Waiting helps only off the other one's way. A robot that stands on it goes on as far as there is room to pass, and waits before the next
//! narrow stretch. All else is predictive control's.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::time::Stamp;

use crate::active_plan::ActivePlan;
use crate::avoidance::Ahead;
use crate::local_obstacles::LocalObstacles;
use crate::obstacle_tracks::Track;

/// Two outlines' discs that come nearer than this meet, m.
const CLEARANCE: f64 = 0.3;
/// A robot whose disc is nearer than this to the course of another one's stands on its way, m. Less than the clearance, or who waits just beside
/// that way would be on it by an error of its pose.
const ON_ITS_WAY: f64 = 0.1;
/// Who goes first through a stretch has left each place of it so long before the other one gets there, s: this robot, which may get on more
/// slowly than its plan; one that waits, which has to set out first; the other one.
const LEAD: f64 = 1.5;
const LEAD_FROM_REST: f64 = 2.5;
const OTHERS_LEAD: f64 = 0.5;
/// Two pass where there is so much room beside both discs, m.
const PASSING_ROOM: f64 = 0.2;
/// What stands so far before or behind a place of the plan counts for the room there, and room is looked for so far to each side, m.
const BAND: f64 = 0.25;
const SIDE: f64 = 2.0;

/// The plan is looked at so far ahead, s, at places so far apart, s, and so often, s.
const PLAN_SECS: f64 = 30.0;
const APART: f64 = 0.25;
const PERIOD: f64 = 0.1;

/// Where a robot waits on its plan.
#[derive(Clone, Debug, Default)]
pub struct RightOfWay {
    looked: Option<Stamp>,
    /// When the trajectory that was looked at has the robot where it waits: its number, and plan time, s.
    waits_at: Option<(u64, f64)>,
    plan: Vec<Ahead>,
    standing: Vec<Point2<f64>>,
}

impl RightOfWay {
    /// The time of the plan in force, s from now, at which the robot is to wait; `None` if it may go on. `radius`: of the disc around its outline, m.
    pub fn update(
        &mut self,
        now: Stamp,
        active: &ActivePlan,
        odom_from_map: Pose2,
        radius: f64,
        obstacles: &LocalObstacles,
    ) -> Option<f64> {
        let robots = obstacles.moving().tracks().robots();
        if robots.iter().all(Track::makes_way) {
            self.waits_at = None;
            return None;
        }
        let id = active.plan().trajectory_id;
        let plan_time = active.plan_time()?;
        let is_due = self.looked.is_none_or(|looked| now.secs_since(looked) >= PERIOD);
        if is_due || self.waits_at.is_some_and(|(known, _)| known != id) {
            active.ahead(odom_from_map, PLAN_SECS, APART, &mut self.plan);
            self.standing.clear();
            self.standing.extend(obstacles.standing());
            let waits = wait_before(&self.plan, radius, robots, &self.standing, self.is_waiting());
            self.waits_at = waits.map(|secs| (id, plan_time + secs));
            self.looked = Some(now);
        }
        self.waits_at.map(|(_, time)| (time - plan_time).max(0.0))
    }

    /// Whether it will wait for another robot on its plan, or does.
    #[must_use]
    pub fn is_waiting(&self) -> bool {
        self.waits_at.is_some()
    }

    /// There is no plan to wait on.
    pub fn reset(&mut self) {
        self.waits_at = None;
    }
}

/// The time of the plan, s from now, at which the robot is to wait; `None` if it may go on. `plan`: the rest of the plan from where the robot is;
/// `radius`: of the disc around the outline, m; `standing`: what does not move. All in the odometry frame, now.
#[must_use]
pub fn wait_before(
    plan: &[Ahead],
    radius: f64,
    robots: &[Track],
    standing: &[Point2<f64>],
    waits: bool,
) -> Option<f64> {
    let lead = if waits { LEAD_FROM_REST } else { LEAD };
    let first = robots.iter().filter(|robot| !robot.makes_way());
    let waits = first.filter_map(|robot| wait_for(plan, radius, robot, standing, lead));
    waits.min_by(f64::total_cmp)
}

fn wait_for(plan: &[Ahead], radius: f64, robot: &Track, standing: &[Point2<f64>], lead: f64) -> Option<f64> {
    let course = robot.told_course();
    let discs = radius + robot.radius;
    let here = plan.first()?.pose.position();
    let reach = plan.iter().map(|ahead| (ahead.pose.position() - here).norm());
    let reach = reach.fold(0.0, f64::max) + discs + CLEARANCE;
    if course.iter().all(|(_, place)| (place - here).norm() > reach) {
        return None;
    }
    let meetings: Vec<Option<Meeting>> = plan
        .iter()
        .map(|ahead| Meeting::at(ahead.pose.position(), discs + CLEARANCE, &course))
        .collect();
    // Up to there it is on the other one's way from the start.
    let leaves = match Meeting::at(here, discs + ON_ITS_WAY, &course) {
        Some(_) => meetings.iter().position(Option::is_none).unwrap_or(plan.len()),
        None => 0,
    };
    let room = 2.0 * discs + PASSING_ROOM;
    let counts = |nth: usize| meetings[nth].is_some() && (nth >= leaves || room_at(&plan[nth], standing) < room);
    let mut from = 0;
    while let Some(begin) = (from..plan.len()).find(|nth| counts(*nth)) {
        let end = (begin..plan.len()).find(|nth| !counts(*nth)).unwrap_or(plan.len());
        let stretch = || plan[begin..end].iter().zip(&meetings[begin..end]);
        let goes_first = stretch().all(|(own, met)| met.is_none_or(|met| own.secs + lead < met.begins));
        let follows = stretch().all(|(own, met)| met.is_none_or(|met| met.ends + OTHERS_LEAD < own.secs));
        from = end;
        if goes_first || follows {
            continue;
        }
        if begin >= leaves {
            return Some(plan[begin.saturating_sub(1)].secs);
        }
        if begin == 0 {
            // It is in there.
            return None;
        }
        // At the mouth it would be in the way of who comes out.
        let mouth = plan[begin].pose.position();
        let before = plan[..begin]
            .iter()
            .rev()
            .find(|ahead| (ahead.pose.position() - mouth).norm() > discs + CLEARANCE);
        return Some(before.map_or(0.0, |ahead| ahead.secs));
    }
    None
}

/// When the disc of another robot is too near to a place, s from now.
#[derive(Clone, Copy, Debug)]
struct Meeting {
    begins: f64,
    ends: f64,
}

impl Meeting {
    fn at(place: Point2<f64>, near: f64, course: &[(f64, Point2<f64>)]) -> Option<Self> {
        let mut met: Option<Self> = None;
        for leg in course.windows(2) {
            let ((begins, from), (ends, to)) = (leg[0], leg[1]);
            let along = to - from;
            let share = (place - from).dot(&along) / along.norm_squared().max(1e-9);
            if (place - (from + along * share.clamp(0.0, 1.0))).norm() < near {
                let begins = met.map_or(begins, |met| met.begins);
                met = Some(Self { begins, ends });
            }
        }
        met
    }
}

/// Width of the room across the plan at a place, m: at most twice [`SIDE`].
fn room_at(ahead: &Ahead, standing: &[Point2<f64>]) -> f64 {
    let heading = ahead.pose.heading();
    let (mut left, mut right) = (SIDE, SIDE);
    for point in standing {
        let off = point - ahead.pose.position();
        if off.dot(&heading).abs() < BAND {
            let aside = heading.perp(&off);
            if aside >= 0.0 {
                left = left.min(aside);
            } else {
                right = right.min(-aside);
            }
        }
    }
    left + right
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::course::Course;
    use nalgebra::Vector2;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::time::Stamp;

    const RADIUS: f64 = 0.3;

    /// A plan along x at 0.5 m/s, from 0 to 10 m.
    fn plan() -> Vec<Ahead> {
        let secs = (0..=80).map(|nth| 0.25 * f64::from(nth));
        secs.map(|secs| Ahead {
            secs,
            pose: Pose2::new(0.5 * secs, 0.0, 0.0),
        })
        .collect()
    }

    /// A robot that has right of way, or not, and goes at a velocity from a place on.
    fn robot(from: [f64; 2], velocity: [f64; 2], makes_way: bool) -> Track {
        let place = |nth: u32| Point2::from(from) + Vector2::from(velocity) * (0.4 * f64::from(nth));
        let course = Course {
            places: (0..16).map(place).collect(),
            step: 0.4,
            later: (1..=12).map(|nth| place(15 + 5 * nth)).collect(),
            later_step: 2.0,
            begun: 0.0,
            makes_way,
        };
        Track::of_robot(1, RADIUS, Vector2::from(velocity), Stamp::ZERO, course)
    }

    fn waits(robot: Track, standing: &[Point2<f64>]) -> Option<f64> {
        wait_before(&plan(), RADIUS, &[robot], standing, false)
    }

    #[test]
    fn it_waits_before_a_crossing_unless_one_of_the_two_is_gone_by_then() {
        // Both would be at x = 5 after 10 s.
        let secs = waits(robot([5.0, -5.0], [0.0, 0.5], false), &[]).unwrap();
        assert!((0.5 * secs - (5.0 - 2.0 * RADIUS - CLEARANCE)).abs() < 0.2, "{secs}");
        assert_eq!(waits(robot([5.0, -5.0], [0.0, 0.5], true), &[]), None, "it goes first");
        assert_eq!(
            waits(robot([5.0, -1.0], [0.0, 0.5], false), &[]),
            None,
            "that one is gone"
        );
        assert_eq!(
            waits(robot([1.5, -7.0], [0.0, 0.5], false), &[]),
            None,
            "this one is gone"
        );
    }

    #[test]
    fn it_follows_who_drives_ahead() {
        assert_eq!(waits(robot([2.5, 0.0], [0.5, 0.0], false), &[]), None);
        assert!(
            waits(robot([2.5, 0.0], [0.2, 0.0], false), &[]).is_some(),
            "but not who is slow"
        );
    }

    #[test]
    fn on_the_way_of_another_it_waits_before_what_is_narrow() {
        let oncoming = || robot([10.0, 0.0], [-0.5, 0.0], false);
        assert_eq!(waits(oncoming(), &[]), None, "they pass one another");
        let wall = |x: f64| [Point2::new(x, 0.45), Point2::new(x, -0.45)];
        let lane: Vec<Point2<f64>> = (0..40).flat_map(|nth| wall(3.0 + 0.1 * f64::from(nth))).collect();
        let secs = waits(oncoming(), &lane).unwrap();
        assert!((1.5..2.1).contains(&(0.5 * secs)), "{secs}");
        let inside: Vec<Point2<f64>> = (0..40).flat_map(|nth| wall(-1.0 + 0.1 * f64::from(nth))).collect();
        assert_eq!(waits(oncoming(), &inside), None, "it cannot wait in there");
    }
}

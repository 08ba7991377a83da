//! Right of way. Where does a robot wait for others that go first, before their ways meet?
//!
//! Predictive control ([`crate::avoidance`]) sees some seconds ahead. That is too late for a lane where two cannot pass, and it makes a detour
//! of what a short wait at the crossing settles. So the whole told course of each robot that goes first is held against the whole plan: over
//! which stretch of the plan do the two come too near to one another, and has one of them left it before the other one comes? Where neither
//! has, this robot waits before the stretch (after Kant and Zucker, "Toward efficient trajectory planning: the path-velocity decomposition",
//! IJRR 1986).
//!
//! Waiting helps only off the other one's way. A robot that stands on it goes on as far as there is room to pass, and waits before the next
//! narrow stretch. All else is predictive control's. Where another one's course ends it counts as gone: who parks is an obstacle of the map.

use std::cell::LazyCell;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::time::Stamp;

use crate::active_plan::ActivePlan;
use crate::avoidance::Ahead;
use crate::local_obstacles::LocalObstacles;
use crate::obstacle_tracks::Track;
use crate::settings::RightOfWaySettings;

/// A robot whose disc is nearer than this to the course of another one's stands on its way, m. Less than the clearance, or who waits just beside
/// that way would be on it by an error of its pose.
const ON_ITS_WAY: f64 = 0.1;
/// A waiting robot needs this much more lead, s: it has to set out.
const SETTING_OUT: f64 = 1.0;
/// Two go the same way whose directions differ by less than this, as a cosine: then the one ahead needs no lead.
const SAME_WAY: f64 = 0.7;
/// A robot waits as soon as it is so near to where it will, s.
const NEARLY_THERE: f64 = 1.0;
/// What stands so far before or behind a place of the plan counts for the room there, and room is looked for so far to each side, m.
const BAND: f64 = 0.25;
const SIDE: f64 = 2.0;

/// The plan is looked at so far ahead, s, at places so far apart, s, and so often, s.
const PLAN_SECS: f64 = 30.0;
const APART: f64 = 0.25;
const PERIOD: f64 = 0.1;

/// Waits before about the same place end with the last of them: places this near to one another on the plan, s.
const SAME_PLACE: f64 = 1.0;

/// Where on its plan a robot is to wait, and until when.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wait {
    /// Time of the plan, s from now at its own pace.
    pub at: f64,
    /// When all others are through, by their courses, s from now.
    pub until: f64,
}

/// Whether and where the robot waits on its plan.
#[derive(Clone, Debug)]
pub struct RightOfWay {
    settings: RightOfWaySettings,
    looked: Option<Stamp>,
    /// The trajectory on which it waits, by its number; the plan time at which it does, s; until when.
    waits: Option<(u64, f64, Stamp)>,
    plan: Vec<Ahead>,
    standing: Vec<Point2<f64>>,
}

impl RightOfWay {
    /// Waits for nobody yet.
    #[must_use]
    pub fn new(settings: &RightOfWaySettings) -> Self {
        Self {
            settings: *settings,
            looked: None,
            waits: None,
            plan: Vec::new(),
            standing: Vec::new(),
        }
    }

    /// Looks at the plan in force, and at what other robots have told. `radius`: of the disc around the robot's outline, m.
    pub fn update(
        &mut self,
        now: Stamp,
        active: &ActivePlan,
        odom_from_map: Pose2,
        radius: f64,
        obstacles: &LocalObstacles,
    ) {
        let robots = obstacles.moving().tracks().robots();
        let plan_time = active.plan_time().filter(|_| robots.iter().any(Track::goes_first));
        let Some(plan_time) = plan_time else {
            self.waits = None;
            return;
        };
        let id = active.plan().trajectory_id;
        let is_due = self.looked.is_none_or(|looked| now.secs_since(looked) >= PERIOD);
        if is_due || self.waits.is_some_and(|(known, ..)| known != id) {
            active.ahead(odom_from_map, PLAN_SECS, APART, &mut self.plan);
            self.standing.clear();
            self.standing.extend(obstacles.standing());
            let waits = self.waits.is_some();
            let wait = wait_before(&self.plan, radius, robots, &self.standing, waits, &self.settings);
            self.waits = wait.map(|wait| (id, plan_time + wait.at, now.plus_secs(wait.until)));
            self.looked = Some(now);
        }
    }

    /// Where and until when it waits on the plan in force.
    #[must_use]
    pub fn wait(&self, now: Stamp, active: &ActivePlan) -> Option<Wait> {
        let (_, time, until) = self.waits.filter(|(id, ..)| *id == active.plan().trajectory_id)?;
        let at = (time - active.plan_time()?).max(0.0);
        let until = until.secs_since(now).max(at);
        Some(Wait { at, until })
    }

    /// Whether it waits on the plan in force, or is about to.
    #[must_use]
    pub fn is_waiting(&self, now: Stamp, active: &ActivePlan) -> bool {
        self.wait(now, active).is_some_and(|wait| wait.at < NEARLY_THERE)
    }

    /// There is no plan to wait on.
    pub fn reset(&mut self) {
        self.waits = None;
    }
}

impl Wait {
    /// How far on the plan the robot will be in some time, s at the plan's own pace; at that pace all the way without a wait.
    #[must_use]
    pub fn plan_secs(wait: Option<Self>, secs: f64) -> f64 {
        match wait {
            Some(wait) if secs > wait.at => wait.at.max(secs - (wait.until - wait.at)),
            _ => secs,
        }
    }
}

/// Where a robot is to wait; `None` if it may go on. `plan`: the rest of the plan from where the robot is; `radius`: of the disc around the
/// outline, m; `standing`: what does not move; `waits`: whether it waits already. All in the odometry frame, now.
#[must_use]
pub fn wait_before(
    plan: &[Ahead],
    radius: f64,
    robots: &[Track],
    standing: &[Point2<f64>],
    waits: bool,
    settings: &RightOfWaySettings,
) -> Option<Wait> {
    let lead = settings.lead + if waits { SETTING_OUT } else { 0.0 };
    let rooms = LazyCell::new(|| plan.iter().map(|ahead| room_at(ahead, standing)).collect());
    let first = robots.iter().filter(|robot| robot.goes_first());
    let waits = first.filter_map(|robot| wait_for(plan, radius, robot, &rooms, lead, settings));
    waits.reduce(|one, other| {
        let (sooner, later) = if one.at <= other.at { (one, other) } else { (other, one) };
        let is_same = later.at - sooner.at <= SAME_PLACE;
        Wait {
            until: if is_same {
                sooner.until.max(later.until)
            } else {
                sooner.until
            },
            ..sooner
        }
    })
}

/// The room across the plan at each of its places, m, once it is asked for.
type Rooms<F> = LazyCell<Vec<f64>, F>;

fn wait_for<F: FnOnce() -> Vec<f64>>(
    plan: &[Ahead],
    radius: f64,
    robot: &Track,
    rooms: &Rooms<F>,
    lead: f64,
    settings: &RightOfWaySettings,
) -> Option<Wait> {
    let RightOfWaySettings {
        clearance,
        others_lead,
        passing_room,
        ..
    } = *settings;
    let course = robot.told_course();
    let discs = radius + robot.radius;
    let here = *plan.first()?;
    let reach = plan
        .iter()
        .map(|ahead| (ahead.pose.position() - here.pose.position()).norm());
    let reach = reach.fold(0.0, f64::max) + discs + clearance;
    Meeting::at(&here, reach, &course)?;
    let meetings: Vec<Option<Meeting>> = plan
        .iter()
        .map(|ahead| Meeting::at(ahead, discs + clearance, &course))
        .collect();
    // Up to there it is on the other one's way from the start.
    let leaves = match Meeting::at(&here, discs + ON_ITS_WAY, &course) {
        Some(_) => meetings.iter().position(Option::is_none).unwrap_or(plan.len()),
        None => 0,
    };
    let room = 2.0 * discs + passing_room;
    let counts = |nth: usize| meetings[nth].is_some() && (nth >= leaves || rooms[nth] < room);
    let mut from = 0;
    while let Some(begin) = (from..plan.len()).find(|nth| counts(*nth)) {
        let end = (begin..plan.len()).find(|nth| !counts(*nth)).unwrap_or(plan.len());
        from = end;
        let stretch = || plan[begin..end].iter().zip(meetings[begin..end].iter().flatten());
        let goes_first = stretch().all(|(own, met)| own.secs + if met.same_way { 0.0 } else { lead } < met.begins);
        let follows = stretch().all(|(own, met)| met.ends + others_lead < own.secs);
        if goes_first || follows {
            continue;
        }
        // Who follows waits for no more than the lead that is missing.
        let late = stretch().map(|(own, met)| met.ends + others_lead - (own.secs - plan[begin].secs));
        let until = late.fold(0.0, f64::max);
        if begin >= leaves {
            let at = plan[begin.saturating_sub(1)].secs;
            return Some(Wait { at, until });
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
            .find(|ahead| (ahead.pose.position() - mouth).norm() > discs + clearance);
        let at = before.map_or(0.0, |ahead| ahead.secs);
        return Some(Wait { at, until });
    }
    None
}

/// When the disc of another robot is too near to a place of the plan, s from now.
#[derive(Clone, Copy, Debug)]
struct Meeting {
    begins: f64,
    ends: f64,
    /// Whether it goes the same way there.
    same_way: bool,
}

impl Meeting {
    fn at(ahead: &Ahead, near: f64, course: &[(f64, Point2<f64>)]) -> Option<Self> {
        let mut met: Option<Self> = None;
        for leg in course.windows(2) {
            let ((from_secs, from), (to_secs, to)) = (leg[0], leg[1]);
            let (along, off) = (to - from, ahead.pose.position() - from);
            let length = along.norm();
            let stands = length < 1e-6;
            let direction = along / length.max(1e-6);
            // Of who stands the place alone counts.
            let (middle, aside) = if stands {
                (0.0, off.norm())
            } else {
                (off.dot(&direction), off.perp(&direction))
            };
            let squared = near * near - aside * aside;
            let half = squared.max(0.0).sqrt();
            let (enters, leaves) = ((middle - half).max(0.0), (middle + half).min(length));
            if squared <= 0.0 || enters > leaves {
                continue;
            }
            let secs = |way: f64| from_secs + (to_secs - from_secs) * way / length;
            let (begins, ends) = if stands {
                (from_secs, to_secs)
            } else {
                (secs(enters), secs(leaves))
            };
            let same_way = direction.dot(&ahead.pose.heading()) > SAME_WAY;
            met = Some(Self {
                begins: met.map_or(begins, |met| met.begins),
                ends,
                same_way: same_way && met.is_none_or(|met| met.same_way),
            });
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
            planned: true,
            makes_way,
        };
        Track::of_robot(1, RADIUS, Vector2::from(velocity), Stamp::ZERO, course)
    }

    fn wait(robot: Track, standing: &[Point2<f64>]) -> Option<Wait> {
        wait_before(
            &plan(),
            RADIUS,
            &[robot],
            standing,
            false,
            &RightOfWaySettings::default(),
        )
    }

    /// The same with one setting changed.
    fn waits_with(robot: Track, standing: &[Point2<f64>], change: impl FnOnce(&mut RightOfWaySettings)) -> Option<f64> {
        let mut settings = RightOfWaySettings::default();
        change(&mut settings);
        wait_before(&plan(), RADIUS, &[robot], standing, false, &settings).map(|wait| wait.at)
    }

    fn waits(robot: Track, standing: &[Point2<f64>]) -> Option<f64> {
        wait(robot, standing).map(|wait| wait.at)
    }

    #[test]
    fn it_waits_before_a_crossing_unless_one_of_the_two_is_gone_by_then() {
        // Both would be at x = 5 after 10 s.
        let secs = waits(robot([5.0, -5.0], [0.0, 0.5], false), &[]).unwrap();
        assert!((0.5 * secs - (5.0 - 2.0 * RADIUS - 0.3)).abs() < 0.2, "{secs}");
        let until = wait(robot([5.0, -5.0], [0.0, 0.5], false), &[]).unwrap().until;
        assert!((11.5..14.5).contains(&until), "{until}: through at 11.8 s");
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
    fn leads_clearance_and_passing_room_are_settings() {
        let crossing = || robot([5.0, -5.0], [0.0, 0.5], false);
        let secs = waits_with(crossing(), &[], |settings| settings.clearance = 0.8).unwrap();
        assert!((0.5 * secs - (5.0 - 2.0 * RADIUS - 0.8)).abs() < 0.2, "{secs}");
        // With the defaults, one of the two is gone in time.
        let (early, late) = ([5.0, -1.0], [1.5, -7.0]);
        let long = waits_with(robot(early, [0.0, 0.5], false), &[], |settings| {
            settings.others_lead = 10.0
        });
        assert!(long.is_some());
        let long = waits_with(robot(late, [0.0, 0.5], false), &[], |settings| settings.lead = 15.0);
        assert!(long.is_some());
        // A lane 1.6 m wide, for two discs of 0.6 m.
        let wall = |x: f64| [Point2::new(x, 0.8), Point2::new(x, -0.8)];
        let lane: Vec<Point2<f64>> = (0..40).flat_map(|nth| wall(3.0 + 0.1 * f64::from(nth))).collect();
        let oncoming = || robot([10.0, 0.0], [-0.5, 0.0], false);
        assert_eq!(waits(oncoming(), &lane), None, "they pass one another");
        assert!(waits_with(oncoming(), &lane, |settings| settings.passing_room = 0.5).is_some());
    }

    #[test]
    fn who_waits_far_off_is_met_nowhere() {
        let mut course = vec![(0.0, Point2::new(5.0, -3.0)); 3];
        let place = |x: f64| Ahead {
            secs: 0.0,
            pose: Pose2::new(x, 0.0, 0.0),
        };
        course[1].0 = 2.0;
        course[2].0 = 4.0;
        assert!(Meeting::at(&place(5.0), 0.9, &course).is_none());
        let met = Meeting::at(&place(5.0), 3.1, &course).unwrap();
        assert!((met.begins, met.ends) == (0.0, 4.0), "{met:?}");
    }

    #[test]
    fn what_it_tells_of_its_plan_holds_its_wait() {
        let wait = Some(Wait { at: 3.0, until: 8.0 });
        let told = [0.0, 3.0, 5.0, 8.0, 10.0].map(|secs| Wait::plan_secs(wait, secs));
        assert_eq!(told, [0.0, 3.0, 3.0, 3.0, 5.0]);
        assert!((Wait::plan_secs(None, 10.0) - 10.0).abs() < 1e-9);
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
        assert_eq!(
            waits(robot([-1.5, 0.0], [0.5, 0.0], false), &lane),
            None,
            "that one comes behind"
        );
        let inside: Vec<Point2<f64>> = (0..40).flat_map(|nth| wall(-1.0 + 0.1 * f64::from(nth))).collect();
        assert_eq!(waits(oncoming(), &inside), None, "it cannot wait in there");
    }
}

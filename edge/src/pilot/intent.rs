//! Intent. What does the robot announce of its course to others? Where it will be by its plan, or while it gives way, and what decides who
//! goes first.

use zenav_protocol::messages::{CoursePlace, Intent, KnownCourse, Mode, Yield};
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::control_io::Publication;
use crate::obstacle_tracks::Track;
use crate::right_of_way::Wait;

/// Time between two announced positions, s, and their number.
const STEP: f64 = 0.4;
const PLACES: u32 = 16;
/// The same for positions later on the plan.
const LATER_STEP: f64 = 2.0;
const LATER: u32 = 12;
/// A robot that has been at rest on its plan for longer than this, and does not wait for another one, is held, s.
const HELD: f64 = 3.0;
/// A robot that moves without a plan is assumed to keep its velocity for this long, s.
const UNPLANNED: f64 = 1.0;
/// A shorter wait is not reported to the mission, s; time between two reports, s.
const LEAST_WAIT: f64 = 2.0;
const YIELD_PERIOD: f64 = 0.4;
/// A slower robot is at rest, m/s and rad/s.
const STANDS: f64 = 0.02;

impl Pilot {
    /// Announces where this robot will be, until it has been at rest for a while with nothing to drive to.
    pub(super) fn tell_intent(&mut self, now: Stamp, out: &mut Vec<Publication>) {
        let velocity = self.estimator.velocity();
        let driving = self.mode == Mode::Follow && self.active_plan.is_some();
        let stands = velocity.v.abs() < STANDS && velocity.w.abs() < STANDS;
        self.parked_since = match driving || !stands {
            true => None,
            false => self.parked_since.or(Some(now)),
        };
        let parked = self.config.settings.telemetry.intent_parked;
        if self.parked_since.is_some_and(|since| now.secs_since(since) > parked) || !self.telemetry.intent_due(now) {
            return;
        }
        let pose = self.estimator.map_from_base();
        if let Some(active) = self.active_plan.as_ref().filter(|_| driving) {
            let goal = &active.plan().goal_id;
            if self.way_goal.as_ref() != Some(goal) {
                self.way_goal = Some(goal.clone());
                self.intent.way_secs = active.progress(now, &pose).time_left;
            }
        }
        let mut places = std::mem::take(&mut self.intent.places);
        places.clear();
        let map_from_odom = self.estimator.map_from_odom();
        let course = self.avoidance.course().filter(|_| driving);
        // A held robot announces that it is stationary; otherwise other robots would wait for it.
        self.held_since = match driving && stands && !self.waits_for_robot(now) {
            true => self.held_since.or(Some(now)),
            false => None,
        };
        let is_held = self.held_since.is_some_and(|since| now.secs_since(since) > HELD);
        let plan = self.active_plan.as_ref().filter(|_| driving && !is_held);
        let wait = plan.and_then(|active| self.right_of_way.wait(now, active));
        let by_plan = |plan_secs: f64| plan.and_then(|active| active.place_in(plan_secs));
        // In the next seconds the robot stays where it waits: robots with right of way need not consider what comes after.
        let soon = |secs: f64| by_plan(wait.map_or(secs, |wait| wait.at.min(secs)));
        places.extend((0..PLACES).map(|nth| {
            let secs = STEP * f64::from(nth);
            match course {
                Some((course, layer)) => {
                    let place = course.get((secs / layer).round() as usize).or(course.last());
                    place.map_or(pose.position(), |place| map_from_odom.transform_point(*place))
                }
                None => soon(secs).unwrap_or_else(|| pose.advance(velocity, secs.min(UNPLANNED)).position()),
            }
        }));
        let mut later = std::mem::take(&mut self.intent.later);
        later.clear();
        let told = STEP * f64::from(PLACES - 1);
        let later_on = |nth| Wait::plan_secs(wait, told + LATER_STEP * f64::from(nth));
        later.extend((1..=LATER).map_while(|nth| by_plan(later_on(nth))));
        self.intent = Intent {
            stamp: now,
            map_from_base: pose,
            velocity,
            step: STEP,
            places,
            later,
            later_step: LATER_STEP,
            driving,
            trapped: self.avoidance.is_trapped(),
            ..std::mem::take(&mut self.intent)
        };
        out.push(Publication::Intent(self.intent.clone()));
    }

    /// Reports to the mission which robots this one gives way to on its plan, so that the mission can look for a path past them.
    pub(super) fn tell_yield(&mut self, now: Stamp, out: &mut Vec<Publication>) {
        let Some(active) = self.active_plan.as_ref().filter(|_| self.mode == Mode::Follow) else {
            return;
        };
        let Some(wait) = self.right_of_way.wait(now, active) else {
            return;
        };
        let wait_secs = wait.until - wait.at;
        if wait_secs < LEAST_WAIT || self.yield_told.is_some_and(|told| now.secs_since(told) < YIELD_PERIOD) {
            return;
        }
        let map_from_odom = self.estimator.map_from_odom();
        let course = |track: &Track| KnownCourse {
            radius: track.radius,
            places: track
                .told_course()
                .into_iter()
                .map(|(secs, place)| {
                    let place = map_from_odom.transform_point(place);
                    CoursePlace {
                        secs,
                        x: place.x,
                        y: place.y,
                    }
                })
                .collect(),
        };
        let here = self.estimator.odom_from_base().position();
        let robots = self.obstacles.moving().tracks().robots().iter();
        let mut first: Vec<&Track> = robots.filter(|track| track.goes_first()).collect();
        first.sort_by(|a, b| (a.position - here).norm().total_cmp(&(b.position - here).norm()));
        let courses = first.into_iter().take(KnownCourse::MOST);
        out.push(Publication::Yield(Yield {
            stamp: now,
            trajectory_id: active.plan().trajectory_id,
            frame: self.frame.number(),
            wait_secs,
            courses: courses.map(course).collect(),
        }));
        self.yield_told = Some(now);
    }

    /// Whether the robot waits on its plan for one with right of way.
    pub(super) fn waits_for_robot(&self, now: Stamp) -> bool {
        let plan = self.active_plan.as_ref().filter(|_| self.mode == Mode::Follow);
        plan.is_some_and(|active| self.right_of_way.is_waiting(now, active))
    }
}

//! Robot view. What is known about the robot? Its newest state with its time of arrival, and its model.

use std::collections::VecDeque;

use nalgebra::Point2;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{
    BasedOn, EdgeState, Event, EventKind, Health, InfoReply, InfoRequest, KnownCourse, Localisation, PoseEstimate,
    Yield,
};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use super::asks::Asks;
use super::frames::MapFrames;
use super::io::{Answer, Ask, Ticket};

/// Age beyond which the newest state makes the robot silent, s.
const SILENCE: f64 = 1.0;
/// Age beyond which reported courses of other robots are ignored, s.
const TOLD_LATELY: f64 = 1.5;
/// Time between two requests for the model, s.
const RETRY: f64 = 1.0;
/// Share of the beams through walls of the map above which the scans of a robot that localises itself deny that it has arrived. People about
/// the robot hide walls, but no beam passes through one. Walls or furniture that were removed let a smaller share pass.
const THROUGH_WALLS: f64 = 0.25;
/// Standard deviations within which a robot is taken to be, and how much farther than the goal's tolerance, m, they may reach: a correction
/// that moves an estimate by more means on the edge, too, that the robot is somewhere else.
const SIGMAS: f64 = 3.0;
const BEYOND_TOLERANCE: f64 = 0.3;
/// A report this old, s, says nothing any more: one comes every second.
const SAID_LATELY: f64 = 10.0;
/// What comes onto the map within this distance of a robot that touched something while driving, m, and within this time of that, s, is what
/// it touched and what is assumed to go on beside it.
const FELT_WITHIN: f64 = 2.0;
const FELT: std::ops::RangeInclusive<f64> = -0.5..=3.0;
/// Most contacts that are remembered.
const MOST_CONTACTS: usize = 32;
/// Speeds below which the robot is at rest: m/s and rad/s.
const AT_REST: (f64, f64) = (0.02, 0.04);

/// The robot as the mission knows it.
#[derive(Clone, Debug, Default)]
pub struct RobotView {
    state: Option<(Stamp, EdgeState)>,
    pose: Option<(Stamp, PoseEstimate)>,
    /// Transform from the frame of its pose to the mission's; `None` if unknown.
    here_from_told: Option<Pose2>,
    model: Option<RobotModel>,
    model_boot: Option<String>,
    asking: Option<Ticket>,
    next_ask: Stamp,
    bumped: Option<Stamp>,
    /// Where it was when it touched something while driving, and when: its beams had shown nothing there.
    contacts: VecDeque<(Point2<f64>, Stamp)>,
    /// Whether its pose can be trusted, and when that was reported.
    localisation: Option<(Stamp, Localisation)>,
    /// The robots that it gives way to, and when that was reported.
    yields: Option<(Stamp, Yield)>,
    /// Description of the last reply with another schema version.
    mismatch: Option<String>,
}

impl RobotView {
    /// Observes the robot's events.
    pub(crate) fn hear(&mut self, now: Stamp, events: &[Event]) {
        if !events.iter().any(|event| matches!(event.kind, EventKind::Bumped)) {
            return;
        }
        self.bumped = Some(now);
        if let (false, Some(pose)) = (self.is_at_rest(), self.pose()) {
            self.contacts.push_back((pose.position(), now));
            if self.contacts.len() > MOST_CONTACTS {
                self.contacts.pop_front();
            }
        }
    }

    /// Whether what has been at a place since then was felt by the driving robot and not seen, as glass is: no beam would see it leave.
    #[must_use]
    pub fn has_felt(&self, place: Point2<f64>, since: Stamp) -> bool {
        let is_there = |(here, at): &(Point2<f64>, Stamp)| {
            FELT.contains(&since.secs_since(*at)) && (place - here).norm() <= FELT_WITHIN
        };
        self.contacts.iter().any(is_there)
    }

    /// Observes a report on its localisation.
    pub(crate) fn observe_localisation(&mut self, now: Stamp, said: Localisation) {
        self.localisation = Some((now, said));
    }

    /// Takes a report of the robots that it gives way to. Invalid courses are dropped.
    pub(crate) fn observe_yield(&mut self, now: Stamp, mut told: Yield) {
        told.courses.retain(KnownCourse::is_sound);
        told.courses.truncate(KnownCourse::MOST);
        if told.wait_secs.is_finite() && !told.courses.is_empty() {
            self.yields = Some((now, told));
        }
    }

    /// The newest report of the robots that it gives way to on this trajectory, with times relative to now. `None` if it is too old.
    #[must_use]
    pub fn yields(&self, now: Stamp, trajectory_id: u64, frame: u64) -> Option<Yield> {
        let (came, told) = self.yields.as_ref()?;
        let age = now.secs_since(*came);
        if told.trajectory_id != trajectory_id || told.frame != frame || age > TOLD_LATELY {
            return None;
        }
        let mut told = told.clone();
        told.wait_secs -= age;
        for place in told.courses.iter_mut().flat_map(|course| &mut course.places) {
            place.secs -= age;
        }
        Some(told)
    }

    /// Why its pose cannot be trusted, if so.
    #[must_use]
    pub fn lost(&self) -> Option<String> {
        let said = self.localisation().filter(|said| !said.health.is_trusted())?;
        Some(format!("Lost: nobody knows where the robot is ({})", said.health))
    }

    /// Why it cannot be said to have arrived anywhere, if so: it drives by its own estimate, and its scans contradict that.
    #[must_use]
    pub fn has_not_arrived(&self, now: Stamp) -> Option<String> {
        let (came, _) = self.localisation.as_ref()?;
        let is_contradicted = |said: &&Localisation| said.health == Health::Contradicted;
        let said = self.localisation().filter(is_contradicted)?;
        if now.secs_since(*came) > SAID_LATELY {
            return None;
        }
        (said.through_walls > THROUGH_WALLS).then(|| {
            let share = 100.0 * said.through_walls;
            format!(
                "arrived by the robot's own estimate alone: {share:.0} % of its beams pass through walls of the map; \
                 `zenav doctor` says what to do"
            )
        })
    }

    /// Why it may be farther than a tolerance, m, from where it estimates to be, if so: its scans leave its position open along one direction,
    /// and its own estimate is too uncertain. In any other health it is not the covariance that counts: scans determine the position, or
    /// nobody compares them.
    #[must_use]
    pub fn is_unsure_within(&self, tolerance: f64, now: Stamp) -> Option<String> {
        let (came, _) = self.localisation.as_ref()?;
        let said = self.localisation()?;
        if !matches!(said.health, Health::Degraded { .. }) || now.secs_since(*came) > SAID_LATELY {
            return None;
        }
        let (_, pose) = self.pose.as_ref()?;
        let within = SIGMAS * position_std(&pose.covariance);
        (within > tolerance + BEYOND_TOLERANCE).then(|| {
            format!(
                "cannot localise: {SIGMAS} sigma is {within:.1} m, the goal asks for {tolerance} m, and the scans leave the \
                 position open"
            )
        })
    }

    /// The newest report on its localisation, unless it is of another boot.
    fn localisation(&self) -> Option<&Localisation> {
        let (_, said) = self.localisation.as_ref()?;
        self.state()
            .is_none_or(|state| state.boot_id == said.boot_id)
            .then_some(said)
    }

    /// Whether its pose can be trusted, according to a report after a time.
    #[must_use]
    pub fn is_localised_since(&self, time: Stamp) -> bool {
        let newer = |(came, _): &&(Stamp, Localisation)| *came > time;
        self.localisation.as_ref().filter(newer).is_some() && self.lost().is_none()
    }

    /// Whether its bumper was hit within the last `secs`.
    #[must_use]
    pub fn was_bumped_within(&self, now: Stamp, secs: f64) -> bool {
        self.bumped.is_some_and(|bumped| now.secs_since(bumped) <= secs)
    }

    /// Observes the robot's newest state and pose. Values that are not finite are dropped.
    pub(crate) fn observe(&mut self, now: Stamp, state: Option<EdgeState>, pose: Option<PoseEstimate>) {
        if let Some(state) = state.filter(|state| state.velocity.is_finite()) {
            self.state = Some((now, state));
        }
        if let Some(pose) = pose.filter(|pose| pose.map_from_base.is_finite() && pose.velocity.is_finite()) {
            self.pose = Some((now, pose));
        }
    }

    /// Requests the model until there is one of the robot's present boot. A reply with another schema version is ignored, because it may be
    /// from anybody, and the request is repeated.
    pub(crate) fn step(&mut self, now: Stamp, asks: &mut Asks) {
        if let Some(answer) = self.asking.and_then(|ticket| asks.take(ticket)) {
            self.asking = None;
            self.next_ask = now.plus_secs(RETRY);
            if let Ok(Answer::EdgeInfo(info)) = answer {
                self.take(*info);
            }
        }
        let boot = self.state.as_ref().map(|(_, state)| &state.boot_id);
        let known =
            self.model.is_some() && (boot.is_none() || self.model_boot.is_none() || boot == self.model_boot.as_ref());
        if !known && self.asking.is_none() && now >= self.next_ask {
            self.asking = Some(asks.ask(Ask::EdgeInfo(InfoRequest {})));
        }
    }

    fn take(&mut self, info: InfoReply) {
        let mismatch = (info.schema != SCHEMA_VERSION).then(|| {
            format!(
                "the robot's edge ({}) speaks schema {}, this mission ({}) schema {SCHEMA_VERSION}: expected the same",
                info.version,
                info.schema,
                env!("CARGO_PKG_VERSION")
            )
        });
        if mismatch != self.mismatch
            && let Some(why) = &mismatch
        {
            tracing::error!(why, "the robot is not driven");
        }
        self.mismatch = mismatch;
        if self.mismatch.is_some() {
            return;
        }
        match info.model.map(|model| model.checked("the robot's model")) {
            Some(Ok(model)) => {
                self.model = Some(model);
                self.model_boot = info.boot.map(|boot| boot.boot_id);
            }
            Some(Err(error)) => tracing::warn!(%error, "the robot's model is invalid"),
            None => tracing::warn!("the robot's edge has sent no model"),
        }
    }

    /// Why its replies are ignored: the newest one had another schema version.
    #[must_use]
    pub fn mismatch(&self) -> Option<&str> {
        self.mismatch.as_deref().filter(|_| self.model.is_none())
    }

    /// Whether its state is recent.
    #[must_use]
    pub fn is_heard(&self, now: Stamp) -> bool {
        self.state
            .as_ref()
            .is_some_and(|(came, _)| now.secs_since(*came) < SILENCE)
    }

    /// Its newest state.
    #[must_use]
    pub fn state(&self) -> Option<&EdgeState> {
        self.state.as_ref().map(|(_, state)| state)
    }

    /// Its own time, as far as known here: stamp of its newest state, plus the time since that arrived.
    #[must_use]
    pub fn time(&self, now: Stamp) -> Option<Stamp> {
        let (came, state) = self.state.as_ref()?;
        Some(state.stamp + now.since(*came))
    }

    /// Time since its newest state arrived, s.
    #[must_use]
    pub fn state_age(&self, now: Stamp) -> f64 {
        self.state
            .as_ref()
            .map_or(f64::INFINITY, |(came, _)| now.secs_since(*came))
    }

    /// Switches to the present frame of the map.
    pub(crate) fn settle(&mut self, frames: &MapFrames) {
        self.here_from_told = self.pose.as_ref().and_then(|(_, pose)| frames.robot(pose.frame));
    }

    /// Frame of the map that its newest state is in; zero before it was heard.
    #[must_use]
    pub fn frame(&self) -> u64 {
        self.state().map_or(0, |state| state.frame)
    }

    /// Its pose, in the mission's frame of the map.
    #[must_use]
    pub fn pose(&self) -> Option<Pose2> {
        let (_, pose) = self.pose.as_ref()?;
        Some(self.here_from_told? * pose.map_from_base)
    }

    /// Its velocity by its newest state; at rest before it was heard.
    #[must_use]
    pub fn velocity(&self) -> Twist2 {
        self.state().map_or(Twist2::ZERO, |state| state.velocity)
    }

    /// Whether it is at rest.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        is_rest(self.velocity())
    }

    /// Its model, once the robot has told it.
    #[must_use]
    pub fn model(&self) -> Option<&RobotModel> {
        self.model.as_ref()
    }

    /// The edge pose that a plan made now is based on.
    #[must_use]
    pub fn based_on(&self) -> Option<BasedOn> {
        let (_, state) = self.state.as_ref()?;
        let (_, pose) = self.pose.as_ref()?;
        // A pose from before a restart has a stamp of another clock.
        let stamp = if pose.stamp > state.stamp.plus_secs(1.0) {
            state.stamp
        } else {
            pose.stamp.max(state.stamp)
        };
        Some(BasedOn {
            stamp,
            boot_id: state.boot_id.clone(),
        })
    }
}

/// Standard deviation of the position along its most uncertain direction, m, by the row-major covariance of (x, y, yaw).
fn position_std(covariance: &[f64; 9]) -> f64 {
    let [xx, xy, yy] = [covariance[0], covariance[1], covariance[4]];
    (0.5 * (xx + yy) + (0.5 * (xx - yy)).hypot(xy)).max(0.0).sqrt()
}

/// Whether a robot with this measured velocity is at rest.
pub(super) fn is_rest(twist: Twist2) -> bool {
    twist.v.abs() < AT_REST.0 && twist.w.abs() < AT_REST.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::messages::InfoReply;

    fn info(schema: u32) -> Answer {
        Answer::EdgeInfo(Box::new(InfoReply {
            component: "edge".to_owned(),
            version: "0.0.9".to_owned(),
            schema,
            model: Some(zenav_fixtures::robot("tiago")),
            ..InfoReply::default()
        }))
    }

    #[test]
    fn what_came_onto_the_map_where_a_driving_robot_touched_something_was_felt() {
        let at = Stamp::from_secs;
        let bump = Event {
            stamp: Stamp(1),
            boot_id: String::new(),
            sequence: 1,
            kind: EventKind::Bumped,
        };
        let told = |v: f64| EdgeState {
            velocity: Twist2::new(v, 0.0),
            ..EdgeState::default()
        };
        let pose = PoseEstimate {
            stamp: Stamp(1),
            map_from_base: Pose2::new(4.0, 1.0, 0.0),
            covariance: [0.0; 9],
            velocity: Twist2::ZERO,
            frame: 0,
        };
        let pane = Point2::new(4.3, 1.4);
        for (speed, is_felt) in [(0.4, true), (0.0, false)] {
            let mut robot = RobotView::default();
            robot.observe(at(9.9), Some(told(speed)), Some(pose.clone()));
            robot.settle(&MapFrames::default());
            robot.hear(at(10.0), std::slice::from_ref(&bump));
            assert!(robot.was_bumped_within(at(11.0), 2.0));
            // Who bumps into a robot at rest was seen to come.
            assert_eq!(robot.has_felt(pane, at(10.4)), is_felt, "{speed} m/s");
            for (place, since) in [(pane, 8.0), (pane, 20.0), (Point2::new(7.0, 1.0), 10.4)] {
                assert!(!robot.has_felt(place, at(since)), "{place} {since}");
            }
        }
    }

    #[test]
    fn beams_through_walls_deny_that_the_robot_has_arrived_and_people_about_it_do_not() {
        let said = |health, through_walls| Localisation {
            stamp: Stamp::ZERO,
            boot_id: "boot".to_owned(),
            health,
            map_from_base: Pose2::IDENTITY,
            agreeing: 0.2,
            through_walls,
        };
        let mut robot = RobotView::default();
        assert_eq!(
            robot.has_not_arrived(Stamp::ZERO),
            None,
            "nobody has compared its scans"
        );
        for (health, through_walls, has_arrived) in [
            (Health::Contradicted, 0.05, true),
            (Health::Contradicted, f64::NAN, true),
            (Health::Unchecked, 0.4, true),
            (Health::Tracking, 0.4, true),
            (Health::Contradicted, 0.4, false),
        ] {
            let said = said(health, through_walls);
            robot.observe_localisation(Stamp::ZERO, said.clone());
            assert_eq!(
                robot.has_not_arrived(Stamp::from_secs(2.0)).is_none(),
                has_arrived,
                "{said:?}"
            );
            assert_eq!(robot.lost(), None, "it drives");
        }
        assert_eq!(
            robot.has_not_arrived(Stamp::from_secs(11.0)),
            None,
            "nobody has said so lately"
        );
        let restarted = EdgeState {
            boot_id: "another boot".to_owned(),
            ..EdgeState::default()
        };
        robot.observe(Stamp::ZERO, Some(restarted), None);
        assert_eq!(
            robot.has_not_arrived(Stamp::ZERO),
            None,
            "the report is of another boot"
        );
    }

    #[test]
    fn where_its_scans_leave_the_position_open_its_covariance_says_whether_it_is_within_a_tolerance() {
        // 0.3 m along the diagonal, and 0.01 m beside it.
        let diagonal = [0.04505, 0.04495, 0.0, 0.04495, 0.04505, 0.0, 0.0, 0.0, 1.0];
        let along_x = |std: f64| [std * std, 0.0, 0.0, 0.0, 1e-4, 0.0, 0.0, 0.0, 1.0];
        assert!((position_std(&diagonal) - 0.3).abs() < 1e-6);
        let open = Health::Degraded { direction: 0.0 };
        for (health, covariance, tolerance, is_unsure) in [
            (&open, along_x(0.28), 0.05, true),
            (&open, diagonal, 0.15, true),
            (&open, along_x(0.07), 0.05, false),
            // It may be off by less than the goal allows.
            (&open, along_x(0.28), 1.0, false),
            // The scans or its own sensors determine its position.
            (&Health::Tracking, along_x(0.28), 0.05, false),
            (&Health::Unchecked, along_x(0.28), 0.05, false),
        ] {
            let mut robot = RobotView::default();
            let pose = PoseEstimate {
                stamp: Stamp(1),
                map_from_base: Pose2::IDENTITY,
                covariance,
                velocity: Twist2::ZERO,
                frame: 0,
            };
            robot.observe(Stamp::ZERO, None, Some(pose));
            assert_eq!(robot.is_unsure_within(tolerance, Stamp::ZERO), None, "nobody said so");
            let said = Localisation {
                stamp: Stamp::ZERO,
                boot_id: "boot".to_owned(),
                health: health.clone(),
                map_from_base: Pose2::IDENTITY,
                agreeing: 0.9,
                through_walls: 0.0,
            };
            robot.observe_localisation(Stamp::ZERO, said);
            let why = robot.is_unsure_within(tolerance, Stamp::from_secs(2.0));
            assert_eq!(why.is_some(), is_unsure, "{health} {covariance:?}: {why:?}");
            assert_eq!(
                robot.is_unsure_within(tolerance, Stamp::from_secs(11.0)),
                None,
                "nobody has said so lately"
            );
        }
    }

    #[test]
    fn a_reply_of_another_schema_version_is_not_believed_with_both_versions_named_and_the_next_is() {
        let (mut robot, mut asks) = (RobotView::default(), Asks::new(1));
        robot.step(Stamp::from_secs(1.0), &mut asks);
        let (ticket, _) = asks.take_new().pop().unwrap();
        asks.answer(ticket, Ok(info(SCHEMA_VERSION - 1)));
        robot.step(Stamp::from_secs(1.1), &mut asks);
        let refusal = robot.mismatch().unwrap();
        for words in [
            format!("schema {}", SCHEMA_VERSION - 1),
            format!("schema {SCHEMA_VERSION}"),
        ] {
            assert!(refusal.contains(&words), "{refusal}");
        }
        assert_eq!(robot.model(), None);
        robot.step(Stamp::from_secs(2.2), &mut asks);
        let (ticket, _) = asks.take_new().pop().unwrap();
        asks.answer(ticket, Ok(info(SCHEMA_VERSION)));
        robot.step(Stamp::from_secs(2.3), &mut asks);
        assert!(robot.model().is_some() && robot.mismatch().is_none());
    }
}

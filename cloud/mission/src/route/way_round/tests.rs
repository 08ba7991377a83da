//! Waiting and the way round, weighed by a robot in front of whom somebody has come.

use zenav_protocol::messages::{BasedOn, Event, EventKind, MotionReply};
use zenav_protocol::time::Stamp;

use super::*;
use crate::motion::PlanDraft;
use crate::rig::{GOAL, Rig, straight};
use crate::route::RouteRequest;

/// Duration of the way round, s: 38 s more than the rest of the plan.
const ROUND: f64 = 60.0;
/// Where it leads.
const BESIDE: [(f64, f64); 2] = [(1.0, 5.0), (12.0, 5.0)];

/// A robot 1 m after the start of its plan, and its search for another one. It stays there all the time: the tests go by what it decides,
/// not by how it drives.
struct Drive {
    rig: Rig,
    search: Search,
}

impl Drive {
    fn new() -> Self {
        let mut rig = Rig::new();
        let draft = PlanDraft {
            trajectory: straight(),
            ..PlanDraft::default()
        };
        let based_on = BasedOn {
            stamp: Stamp(1),
            boot_id: "b".to_owned(),
        };
        rig.ctx.motion.begin(draft, "g", 7, based_on, 5.0, rig.ctx.now);
        rig.follows(1.0);
        rig.ctx.goal.feedback.time_left = Some(22.0);
        Self {
            search: Self::search(&rig.ctx),
            rig,
        }
    }

    fn search(ctx: &Context) -> Search {
        Search::new(ctx, RouteRequest::to(GOAL), None, ctx.now).replacing()
    }

    /// Somebody has come into its way at 10 s.
    fn towards_somebody() -> Self {
        let mut drive = Self::new();
        drive.rig.at(10.0);
        drive.rig.show(Some(6.2));
        drive
    }

    /// At this time it asks for a route, and is told this.
    fn told(&mut self, secs: f64, reply: impl Fn(&Rig) -> MotionReply) -> Searching {
        self.rig.at(secs);
        let _ = self.search.step(&mut self.rig.ctx);
        self.answered(reply)
    }

    fn answered(&mut self, reply: impl Fn(&Rig) -> MotionReply) -> Searching {
        let reply = reply(&self.rig);
        self.rig.answer(reply);
        self.search.step(&mut self.rig.ctx)
    }
}

/// The way round.
fn round(rig: &Rig) -> MotionReply {
    rig.route(&BESIDE, ROUND)
}

fn is_waiting(state: &Searching) -> bool {
    matches!(state, Searching::Blocked(_))
}

fn goes(state: &Searching) -> bool {
    matches!(state, Searching::Found(_))
}

#[test]
fn a_driving_robot_waits_as_long_as_the_way_round_costs_and_not_anew_for_who_steps_aside() {
    let mut drive = Drive::towards_somebody();
    for secs in (12..=46).step_by(2) {
        if secs == 30 {
            drive.rig.show(Some(6.7));
        }
        let state = drive.told(f64::from(secs), round);
        assert!(is_waiting(&state) && drive.search.keeps_off(), "{secs} s: {state:?}");
        assert_eq!(drive.rig.waits_since(), Some(10.0), "{secs} s");
    }
    let state = drive.told(52.0, round);
    assert!(goes(&state), "{state:?}");
    // If the robot refuses that plan, the next search does not wait again.
    drive.search = Drive::search(&drive.rig.ctx);
    let state = drive.told(54.0, round);
    assert!(goes(&state), "{state:?}");
}

#[test]
fn the_way_round_is_taken_sooner_where_it_is_in_time_only_now() {
    for (left, waits) in [(200.0, true), (1.1 * ROUND, false), (0.5 * ROUND, true)] {
        let mut drive = Drive::towards_somebody();
        drive.rig.ctx.goal.deadline = Some(Stamp::from_secs(12.0 + left));
        let state = drive.told(12.0, round);
        assert_eq!((is_waiting(&state), goes(&state)), (waits, !waits), "{left} s left");
    }
}

#[test]
fn where_the_way_round_closes_meanwhile_the_wait_goes_on_until_the_short_way_is_free() {
    let mut drive = Drive::towards_somebody();
    assert!(is_waiting(&drive.told(12.0, round)));
    assert!(
        is_waiting(&drive.told(13.0, Rig::no_route)),
        "it asks what bars the way"
    );
    let state = drive.answered(|rig| MotionReply::Plan(rig.found(&[])));
    // The robot stops where its plan is blocked: there is nothing to turn round for.
    assert!(is_waiting(&state) && !drive.search.keeps_off(), "{state:?}");
    assert_eq!(drive.rig.waits_since(), Some(10.0), "the same obstacle");
    drive.rig.at(13.5);
    drive.rig.show(None);
    let state = drive.told(14.0, |rig| rig.route(&[], 21.0));
    assert!(
        matches!(&state, Searching::Found(route) if route.plan.trajectory.duration() < 22.0),
        "{state:?}"
    );
    assert_eq!(drive.rig.waits_since(), None);
}

#[test]
fn who_walks_on_when_the_robot_has_turned_round_opens_the_short_way_once() {
    let mut drive = Drive::towards_somebody();
    assert!(goes(&drive.told(52.0, round)), "it has stood there for long");
    assert!(!short_way_opens(&drive.rig.ctx));
    // The person stops farther along the short way, which has been searched in vain by then.
    drive.rig.at(53.0);
    drive.rig.show(Some(7.2));
    assert!(short_way_opens(&drive.rig.ctx));
    drive.search.watch_short_way(&mut drive.rig.ctx);
    assert!(!short_way_opens(&drive.rig.ctx), "it is barred there, too");
    let there = drive.rig.ctx.goal.avoided.as_ref().unwrap().blockage;
    assert!(
        (there.x - 7.2).abs() < 0.1 && there.since == Stamp::from_secs(53.0),
        "{there:?}"
    );
    // The person leaves.
    drive.rig.at(60.0);
    drive.rig.show(None);
    assert!(short_way_opens(&drive.rig.ctx));
    drive.search.watch_short_way(&mut drive.rig.ctx);
    assert_eq!(drive.rig.ctx.goal.avoided, None);
}

#[test]
fn what_the_robot_touched_while_driving_is_driven_round_at_once() {
    for is_felt in [false, true] {
        let mut drive = Drive::new();
        drive.rig.follows(5.6);
        drive.rig.at(9.9);
        if is_felt {
            let bump = Event {
                stamp: Stamp(1),
                boot_id: "b".to_owned(),
                sequence: 1,
                kind: EventKind::Bumped,
            };
            let now = drive.rig.ctx.now;
            drive.rig.ctx.robot.hear(now, std::slice::from_ref(&bump));
        }
        // It stands, and what it touched comes onto the map.
        drive.rig.speed = 0.0;
        drive.rig.ctx.motion.clear();
        drive.rig.at(10.4);
        drive.rig.show(Some(6.2));
        let state = drive.told(11.0, round);
        assert_eq!(goes(&state), is_felt, "{state:?}");
    }
}

/// Time lost over a free short way, s: by waiting for an obstacle that leaves after some time, and by the way round if that is taken.
fn lost(cost: f64, leaves: f64) -> f64 {
    let waits = |secs: &f64| is_worth_waiting(cost, *secs, 5.0) && *secs < leaves;
    let waited = (0..).map(|tick| 0.1 * f64::from(tick)).find(|secs| !waits(secs));
    let waited = waited.unwrap_or(f64::INFINITY);
    if waited < leaves { waited + cost } else { waited }
}

#[test]
fn waiting_and_driving_round_lose_at_most_twice_as_much_as_the_better_of_the_two() {
    for cost in [6.0, 10.0, 40.0, 110.0] {
        for leaves in [1.0, 4.0, 9.9, 10.1, 35.0, 60.0, 300.0] {
            let best = f64::min(cost, leaves);
            assert!(
                lost(cost, leaves) <= 2.0 * best + 0.2,
                "{cost} {leaves}: {}",
                lost(cost, leaves)
            );
        }
    }
}

#[test]
fn a_short_way_round_is_taken_at_once() {
    assert!(!is_worth_waiting(4.9, 0.0, 5.0));
    assert!(is_worth_waiting(5.1, 0.0, 5.0) && is_worth_waiting(30.0, 29.0, 5.0));
    assert!(!is_worth_waiting(30.0, 31.0, 5.0), "what has stood for long stays");
    for (least, waits) in [(5.0, true), (60.0, false)] {
        let mut drive = Drive::towards_somebody();
        std::sync::Arc::make_mut(&mut drive.rig.ctx.config).settings.least_wait = least;
        let state = drive.told(12.0, round);
        assert_eq!((is_waiting(&state), goes(&state)), (waits, !waits), "{least} s");
    }
}

#[test]
fn the_way_round_is_taken_while_it_is_in_time_and_not_when_it_would_be_late_anyway() {
    assert!(!is_last_chance(50.0, 61.0, 0.5));
    assert!(is_last_chance(50.0, 55.0, 0.5));
    assert!(is_last_chance(5.0, 8.0, 3.0), "the next attempt would come too late");
    assert!(!is_last_chance(50.0, 49.0, 0.5));
}

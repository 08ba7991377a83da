//! Observer. Every state and event of a robot in order, as any client receives them, awaited with a deadline.

#![allow(clippy::expect_used, reason = "a test cannot go on without its rig")]

use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use zenav_protocol::bus::{Bus, Latest, Subscription};
use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EdgeState, Event, EventKind, Plan, PoseEstimate};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

/// Slower than this is rest, m/s; encoder noise is below it.
const REST_V: f64 = 0.01;
/// Slower than this is rest, rad/s.
const REST_W: f64 = 0.05;

/// Whether a robot that measures this velocity is at rest.
#[must_use]
pub fn is_rest(velocity: Twist2) -> bool {
    velocity.v.abs() < REST_V && velocity.w.abs() < REST_W
}

/// Observes the messages of one robot.
#[derive(Debug)]
pub struct Observer {
    states: Subscription<EdgeState>,
    events: Subscription<Event>,
    plans: Subscription<Plan>,
    poses: Latest<PoseEstimate>,
    told: Vec<EventKind>,
    written: Vec<Plan>,
}

impl Observer {
    /// Watches a robot on a bus from now on.
    ///
    /// # Panics
    /// When the bus is closed.
    #[must_use]
    pub fn new(bus: &Bus, robot: &str) -> Self {
        let robot = &[robot];
        Self {
            states: bus.subscribe(&topics::STATE, robot, 4096).expect("states"),
            events: bus.subscribe(&topics::EVENT, robot, 4096).expect("events"),
            plans: bus.subscribe(&topics::PLAN, robot, 4096).expect("plans"),
            poses: bus.latest(&topics::POSE, robot).expect("poses"),
            told: Vec::new(),
            written: Vec::new(),
        }
    }

    /// The next state.
    ///
    /// # Panics
    /// When none comes within `limit` (wall time).
    pub async fn next(&mut self, limit: Duration) -> EdgeState {
        let next = tokio::time::timeout(limit, self.states.next()).await;
        next.expect("the robot publishes its state")
            .expect("the bus is open")
            .message
    }

    /// The first state from now on for which `fits` holds.
    ///
    /// # Panics
    /// When there is none within `limit` (wall time).
    pub async fn until(&mut self, what: &str, limit: Duration, mut fits: impl FnMut(&EdgeState) -> bool) -> EdgeState {
        let deadline = Instant::now() + limit;
        let mut last = None;
        loop {
            let Ok(next) = timeout_at(deadline, self.states.next()).await else {
                panic!(
                    "not within {limit:?}: {what}; last: {last:#?}; events: {:#?}",
                    self.events()
                );
            };
            let state = next.expect("the bus is open").message;
            if fits(&state) {
                return state;
            }
            last = Some(state);
        }
    }

    /// Every state of the next `secs` by the robot's clock.
    ///
    /// # Panics
    /// When the robot falls silent.
    pub async fn during(&mut self, secs: f64) -> Vec<EdgeState> {
        let first = self.next(Duration::from_secs(10)).await;
        let end = first.stamp.plus_secs(secs);
        self.up_to(end, vec![first]).await
    }

    /// `states`, followed by every state up to a stamp of the robot's clock.
    ///
    /// # Panics
    /// When the robot falls silent.
    pub async fn up_to(&mut self, end: Stamp, mut states: Vec<EdgeState>) -> Vec<EdgeState> {
        while states.last().is_none_or(|state| state.stamp < end) {
            states.push(self.next(Duration::from_secs(10)).await);
        }
        states
    }

    /// All events so far.
    pub fn events(&mut self) -> &[EventKind] {
        while let Some(event) = self.events.try_next() {
            self.told.push(event.message.kind);
        }
        &self.told
    }

    /// All plans published so far, by any client.
    pub fn plans(&mut self) -> &[Plan] {
        while let Some(plan) = self.plans.try_next() {
            self.written.push(plan.message);
        }
        &self.written
    }

    /// The estimated pose.
    ///
    /// # Panics
    /// When none was published.
    pub fn pose(&mut self) -> PoseEstimate {
        self.poses.borrow().expect("a pose").clone()
    }

    /// Asserts that the robot has touched nothing so far.
    ///
    /// # Panics
    /// When it has.
    pub fn assert_untouched(&mut self) {
        assert!(
            !self.events().contains(&EventKind::Bumped),
            "the robot touched something"
        );
    }
}

/// Asserts that the robot is at rest in all these states.
///
/// # Panics
/// When it moves in one.
pub fn assert_rests(states: &[EdgeState], why: &str) {
    assert!(!states.is_empty(), "{why}: nothing was seen");
    for state in states {
        assert!(is_rest(state.velocity), "{why}, but it moves: {state:#?}");
    }
}

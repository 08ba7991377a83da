//! Records. What survives a crash? Plain data; the store decides how it is kept on disk.

use std::cmp::Reverse;

use serde::{Deserialize, Serialize};
use zenav_protocol::messages::{GoalFeedback, GoalPhase, GoalReply, GoalRequest, GoalState, Plan};
use zenav_protocol::time::Stamp;

use super::frames::GoalAnchors;
use zenav_behaviour_tree::TreeSnapshot;

/// A goal's position in the order of the queue: preempting goals first, then by priority, then by number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct QueueOrder {
    /// Whether the goal preempts.
    pub urgent: bool,
    /// Priority, highest first.
    pub priority: i32,
    /// Order number, lowest first; unique.
    pub number: u64,
}

impl QueueOrder {
    /// Sort key of the queue.
    ///
    /// ```
    /// use zenav_mission::QueueOrder;
    ///
    /// let turn = |urgent, priority, number| QueueOrder { urgent, priority, number };
    /// let mut queue = [turn(false, 0, 1), turn(false, 5, 2), turn(true, 0, 3)];
    /// queue.sort_by_key(QueueOrder::key);
    /// assert_eq!(queue.map(|turn| turn.number), [3, 2, 1], "a preempting goal, then the higher priority");
    /// ```
    #[must_use]
    pub const fn key(&self) -> (bool, Reverse<i32>, u64) {
        (!self.urgent, Reverse(self.priority), self.number)
    }

    /// Whether the order of two goals depends on their numbers only.
    #[must_use]
    pub const fn is_beside(&self, other: &Self) -> bool {
        self.urgent == other.urgent && self.priority == other.priority
    }
}

/// A goal as stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredGoal {
    /// Order of acceptance.
    pub sequence: u64,
    /// It preempted another goal: first in the queue.
    #[serde(default)]
    pub urgent: bool,
    /// Its position since it was moved in the queue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<QueueOrder>,
    /// Time spent paused, s.
    #[serde(default)]
    pub paused_secs: f64,
    /// Start of the present pause.
    #[serde(default)]
    pub paused_since: Option<Stamp>,
    /// Anchors of its places in the map, if the map may move.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchors: Option<GoalAnchors>,
    /// What clients see of the goal: its request, phase and progress.
    pub state: GoalState,
}

impl StoredGoal {
    /// A goal that has just been accepted.
    pub(crate) fn accepted(
        sequence: u64,
        robot: &str,
        id: String,
        request: GoalRequest,
        urgent: bool,
        now: Stamp,
    ) -> Self {
        let state = GoalState {
            id,
            robot: robot.to_owned(),
            state: GoalPhase::Accepted,
            reason: None,
            queue: None,
            accepted: now,
            started: None,
            ended: None,
            feedback: GoalFeedback::default(),
            legs: Vec::new(),
            request,
            resolved: Vec::new(),
        };
        Self {
            sequence,
            urgent,
            moved: None,
            paused_secs: 0.0,
            paused_since: None,
            anchors: None,
            state,
        }
    }

    /// Its position in the queue: in order of arrival, unless it was moved.
    #[must_use]
    pub fn turn(&self) -> QueueOrder {
        self.moved.unwrap_or(QueueOrder {
            urgent: self.urgent,
            priority: self.state.request.priority,
            number: self.sequence,
        })
    }
}

/// A tree between two ticks, with the goal that runs it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunningTree {
    /// The goal that it serves.
    pub goal_id: String,
    /// Its nodes and blackboard.
    pub snapshot: TreeSnapshot,
}

/// One change of the store.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A goal, new or changed.
    Goal(Box<StoredGoal>),
    /// Drops an old goal.
    ForgetGoal(String),
    /// The running tree, if any.
    Tree(Option<Box<RunningTree>>),
    /// The plan in force, if any; renewals are not stored.
    Motion(Option<Box<Plan>>),
    /// The first answer to a request.
    Answer(String, GoalReply),
    /// Drops an old answer.
    ForgetAnswer(String),
    /// The mission's time of the write, to which all other stamps relate.
    Now(Stamp),
}

/// How a mission's store relates to those of other missions for the same robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leadership {
    /// Epoch of the newest grant that it led or followed; zero before the robot had a leader.
    pub epoch: u64,
    /// Whether another store may hold newer goals than this one: then it leads only after the robot confirms it.
    pub shared: bool,
}

/// Initial state of a mission.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Restored {
    /// Name of the store; `None` if nothing is kept.
    pub store: Option<String>,
    /// Relation to the stores of other missions.
    pub leadership: Leadership,
    /// Number of this run, higher than that of every earlier run.
    pub incarnation: u64,
    /// Goals that wait, run or have ended, as last stored.
    pub goals: Vec<StoredGoal>,
    /// The tree that was running.
    pub tree: Option<RunningTree>,
    /// The plan that was in force.
    pub motion: Option<Plan>,
    /// First answers to requests.
    pub answers: Vec<(String, GoalReply)>,
    /// The mission's time of the last write: no later run's time is earlier.
    pub now: Stamp,
    /// Lead of the leader's time over this clock when it was last heard, ns, for a standby that takes over.
    pub ahead: Option<i64>,
}

impl Restored {
    /// The first run, without earlier state.
    ///
    /// ```
    /// use zenav_mission::Restored;
    ///
    /// let first = Restored::fresh();
    /// assert_eq!((first.incarnation, first.goals.len(), first.store), (1, 0, None));
    /// ```
    #[must_use]
    pub fn fresh() -> Self {
        Self {
            incarnation: 1,
            ..Self::default()
        }
    }
}

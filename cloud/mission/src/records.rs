//! Records. What survives a crash? Plain data; how it is kept on disk is the store's business.

use std::cmp::Reverse;

use serde::{Deserialize, Serialize};
use zenav_protocol::messages::{GoalReply, GoalState, Plan};
use zenav_protocol::time::Stamp;

use super::frames::Anchors;
use zenav_behaviour_tree::TreeSnapshot;

/// A goal's turn: preempting goals first, then by priority, then by number.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Turn {
    /// It preempts.
    pub urgent: bool,
    /// Its priority, highest first.
    pub priority: i32,
    /// Its number, lowest first; no two goals have the same.
    pub number: u64,
}

impl Turn {
    /// What the queue is sorted by.
    #[must_use]
    pub const fn key(&self) -> (bool, Reverse<i32>, u64) {
        (!self.urgent, Reverse(self.priority), self.number)
    }

    /// Whether only the numbers of two goals say which is first.
    #[must_use]
    pub const fn is_beside(&self, other: &Self) -> bool {
        self.urgent == other.urgent && self.priority == other.priority
    }
}

/// A goal as it is stored.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StoredGoal {
    /// Order of acceptance.
    pub sequence: u64,
    /// It preempted another goal: first in the queue.
    #[serde(default)]
    pub urgent: bool,
    /// Its turn since somebody moved it in the queue.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub moved: Option<Turn>,
    /// Time spent paused, s.
    #[serde(default)]
    pub paused_secs: f64,
    /// Since when it has been paused.
    #[serde(default)]
    pub paused_since: Option<Stamp>,
    /// What its places are tied to, where the map may move.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchors: Option<Anchors>,
    /// The goal.
    pub state: GoalState,
}

impl StoredGoal {
    /// Its turn in the queue: as it came, unless somebody moved it.
    #[must_use]
    pub fn turn(&self) -> Turn {
        self.moved.unwrap_or(Turn {
            urgent: self.urgent,
            priority: self.state.request.priority,
            number: self.sequence,
        })
    }
}

/// The tree that runs.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RunningTree {
    /// The goal that it serves.
    pub goal_id: String,
    /// Its nodes and blackboard.
    pub snapshot: TreeSnapshot,
}

/// One change of what is stored.
#[derive(Clone, Debug, PartialEq)]
pub enum Record {
    /// A goal, new or changed.
    Goal(Box<StoredGoal>),
    /// An old goal is dropped.
    ForgetGoal(String),
    /// The tree that runs, if one does.
    Tree(Option<Box<RunningTree>>),
    /// The plan in force, if there is one; renewals are not stored.
    Motion(Option<Box<Plan>>),
    /// The first answer to a request.
    Answer(String, GoalReply),
    /// An old answer is dropped.
    ForgetAnswer(String),
    /// The mission's time of the write, by which all other stamps are read.
    Now(Stamp),
}

/// How a mission's store relates to those of other missions for the same robot.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Leadership {
    /// Epoch of the newest grant that it led or followed; zero before any mission of the robot led.
    pub epoch: u64,
    /// Whether another store may hold newer goals than this one: then it leads only once the robot confirms it.
    pub shared: bool,
}

/// What a mission begins with.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Restored {
    /// Name of the store; none where nothing is kept.
    pub store: Option<String>,
    /// How it stands to other missions' stores.
    pub leadership: Leadership,
    /// Number of this life, greater than that of every life before.
    pub incarnation: u64,
    /// All goals.
    pub goals: Vec<StoredGoal>,
    /// The tree that ran.
    pub tree: Option<RunningTree>,
    /// The plan that was in force.
    pub motion: Option<Plan>,
    /// First answers to requests.
    pub answers: Vec<(String, GoalReply)>,
    /// The mission's time when something was written last: no later life's time is before it.
    pub now: Stamp,
    /// How far the leader's time was ahead of this clock when it was heard last, ns, for a standby that takes over.
    pub ahead: Option<i64>,
}

impl Restored {
    /// The first life, with nothing before it.
    #[must_use]
    pub fn fresh() -> Self {
        Self {
            incarnation: 1,
            ..Self::default()
        }
    }
}

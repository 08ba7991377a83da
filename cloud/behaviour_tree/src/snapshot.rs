//! Snapshot. How does a running tree survive the end of its process? As plain data: the state of every node, the blackboard, and the
//! leaves' memories.
//!
//! Time in a snapshot is the time passed to the ticks; after a restore, ticks must continue with the same epoch.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};

use super::blackboard::Blackboard;
use super::node::{Memory, NodeState};
use super::status::Status;
use super::tree::Tree;

/// Layout version of [`TreeSnapshot`]; any other is refused.
const VERSION: u32 = 1;

/// A tree between two ticks.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct TreeSnapshot {
    version: u32,
    /// Id of the tree.
    pub tree: String,
    shape: u64,
    states: Vec<NodeState>,
    blackboard: Blackboard,
    /// Memories of leaves, by uid.
    memories: BTreeMap<u16, Kept>,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
struct Kept {
    feedback: String,
    kept: serde_json::Value,
}

/// Why a snapshot does not match.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum RestoreError {
    /// Written by another version of the engine.
    #[error("snapshot has layout {0}, expected {VERSION}")]
    Version(u32),
    /// Taken from another tree, or from another version of its file.
    #[error("snapshot is of another tree (`{0}`)")]
    OtherTree(String),
    /// Its parts contradict one another.
    #[error("snapshot is damaged: {0}")]
    Damaged(&'static str),
}

impl<C> Tree<C> {
    /// The tree as data. Must be taken between ticks: during a tick, a leaf may not have finished remembering.
    ///
    /// ```
    /// use std::time::Duration;
    /// use zenav_behaviour_tree::{Registry, Status, build};
    ///
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sleep msec="500"/></BehaviorTree></root>"#;
    /// let make = || build("wait.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()));
    /// let mut tree = make()?;
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// let stored = serde_json::to_string(&tree.snapshot())?;
    ///
    /// let mut restarted = make()?;
    /// restarted.restore(serde_json::from_str(&stored)?)?;
    /// assert_eq!(restarted.tick(Duration::from_millis(499), &mut ())?, Status::Running);
    /// assert_eq!(restarted.tick(Duration::from_millis(500), &mut ())?, Status::Success);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn snapshot(&self) -> TreeSnapshot {
        let memories = (1_u16..)
            .zip(&self.memories)
            .filter(|(_, memory)| !memory.kept.is_null() || !memory.feedback.is_empty())
            .map(|(uid, memory)| {
                let kept = Kept {
                    feedback: memory.feedback.clone(),
                    kept: memory.kept.clone(),
                };
                (uid, kept)
            })
            .collect();
        TreeSnapshot {
            version: VERSION,
            tree: self.id.clone(),
            shape: self.shape,
            states: self.states.clone(),
            blackboard: self.board.clone(),
            memories,
        }
    }

    /// Continues where the snapshot was taken. In the next tick, leaves that were `Running` are [resumed](super::Leaf::resume) instead of
    /// started.
    ///
    /// # Errors
    /// [`RestoreError`]; the tree is then unchanged.
    ///
    /// ```
    /// use zenav_behaviour_tree::{Registry, RestoreError, build};
    ///
    /// let tree = |ms: u32| {
    ///     let text = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"Main\"><Sleep msec=\"{ms}\"/></BehaviorTree></root>");
    ///     build("wait.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()))
    /// };
    /// // The file has changed since the snapshot was taken.
    /// assert_eq!(tree(400)?.restore(tree(500)?.snapshot()), Err(RestoreError::OtherTree("Main".into())));
    /// assert_eq!(tree(500)?.restore(tree(500)?.snapshot()), Ok(()));
    /// # Ok::<(), zenav_behaviour_tree::TreeErrors>(())
    /// ```
    pub fn restore(&mut self, snapshot: TreeSnapshot) -> Result<(), RestoreError> {
        if snapshot.version != VERSION {
            return Err(RestoreError::Version(snapshot.version));
        }
        if snapshot.shape != self.shape || snapshot.tree != self.id {
            return Err(RestoreError::OtherTree(snapshot.tree));
        }
        if snapshot.states.len() != self.nodes.len() {
            return Err(RestoreError::Damaged("not one state a node"));
        }
        if !self.board.is_extended_by(&snapshot.blackboard) {
            return Err(RestoreError::Damaged("entries do not fit the tree"));
        }
        let mut memories = vec![Memory::default(); self.nodes.len()];
        for (uid, kept) in snapshot.memories {
            let memory = usize::from(uid)
                .checked_sub(1)
                .and_then(|index| memories.get_mut(index));
            let Some(memory) = memory else {
                return Err(RestoreError::Damaged("memory of a node that is not there"));
            };
            memory.feedback = kept.feedback;
            memory.kept = kept.kept;
        }
        for (memory, state) in memories.iter_mut().zip(&snapshot.states) {
            memory.resuming = state.status == Status::Running;
        }
        self.states = snapshot.states;
        self.board.restore(snapshot.blackboard);
        self.memories = memories;
        self.changes += 1;
        Ok(())
    }
}

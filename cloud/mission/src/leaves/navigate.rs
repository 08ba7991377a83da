//! NavigateToPose, NavigateThroughPoses: a whole tree as one action, with its own blackboard.
//!
//! `behavior_tree` is the name of a shipped tree, or XML; without it, the default tree for a goal of that kind. The inner tree is stored
//! with the outer one and continues after a restart.

use serde::{Deserialize, Serialize};

use super::ports::{goal_on, goal_text, goals_on, goals_value};
use super::{fail, no_error};
use crate::context::Context;
use crate::trees;
use zenav_behaviour_tree::{Leaf, LeafIo, Status, Tree, TreeSnapshot, Value};

/// Greatest nesting depth: a tree that contains itself would never end.
const MAX_NESTED: u32 = 4;

/// Most nodes of all inner trees of a goal that run at the same time.
const MAX_NODES: usize = 20_000;

/// Nav2's error codes for one pose, and their offset for several poses.
mod error_code {
    pub const UNKNOWN: i64 = 9000;
    pub const FAILED_TO_LOAD_BEHAVIOR_TREE: i64 = 9001;
    pub const THROUGH_POSES: i64 = 100;
}

/// Runs a tree to its end.
#[derive(Default)]
pub struct Navigate {
    tree: Option<Tree<Context>>,
    stored: u64,
}

/// State that must survive a restart.
#[derive(Serialize, Deserialize)]
struct Memory {
    tree: String,
    snapshot: TreeSnapshot,
}

fn code(io: &LeafIo<'_>, code: i64) -> Option<i64> {
    let through = io.id() == "NavigateThroughPoses";
    Some(if through {
        code + error_code::THROUGH_POSES
    } else {
        code
    })
}

impl Navigate {
    fn begin(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<String, (i64, String)> {
        let unknown = |why: String| (error_code::UNKNOWN, why);
        self.forget(ctx);
        if ctx.nested >= MAX_NESTED {
            let why = format!("{MAX_NESTED} nested trees: expected fewer");
            return Err((error_code::FAILED_TO_LOAD_BEHAVIOR_TREE, why));
        }
        let (key, goal, usual) = if io.id() == "NavigateThroughPoses" {
            let goals = goals_on(io, ctx, "goals").and_then(|goals| goals_value(&goals));
            ("goals", goals.map_err(unknown)?, trees::NAVIGATE_THROUGH)
        } else {
            let goal = goal_on(io, ctx, "goal").map_err(unknown)?;
            ("goal", Value::text(goal_text(&goal)), trees::NAVIGATE)
        };
        let name: Option<String> = io.get_optional("behavior_tree").ok().flatten();
        let name = name.filter(|name| !name.is_empty()).unwrap_or_else(|| usual.to_owned());
        let refused = |why: String| (error_code::FAILED_TO_LOAD_BEHAVIOR_TREE, why);
        let many = || {
            refused(format!(
                "the goal's inner trees have more than {MAX_NODES} nodes: expected fewer"
            ))
        };
        if ctx.nested_nodes >= MAX_NODES {
            return Err(many());
        }
        let mut tree = trees::build(&name).map_err(|error| refused(error.to_string()))?;
        if ctx.nested_nodes + tree.len() > MAX_NODES {
            return Err(many());
        }
        let set = tree.blackboard_mut().set(key, goal);
        set.map_err(|error| unknown(error.to_string()))?;
        self.take(tree, ctx);
        Ok(name)
    }

    fn take(&mut self, tree: Tree<Context>, ctx: &mut Context) {
        ctx.nested_nodes += tree.len();
        self.tree = Some(tree);
    }

    fn forget(&mut self, ctx: &mut Context) {
        if let Some(tree) = self.tree.take() {
            ctx.nested_nodes = ctx.nested_nodes.saturating_sub(tree.len());
        }
    }

    /// Stores the inner tree with the outer one, if it has changed.
    fn keep(&mut self, io: &mut LeafIo<'_>, name: String) -> Result<(), String> {
        let Some(tree) = &self.tree else { return Ok(()) };
        self.stored = tree.revision();
        let memory = Memory {
            tree: name,
            snapshot: tree.snapshot(),
        };
        io.remember(&memory).map_err(|error| error.to_string())
    }
}

impl Leaf<Context> for Navigate {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let begun = self
            .begin(io, ctx)
            .and_then(|name| self.keep(io, name).map_err(|why| (error_code::UNKNOWN, why)));
        if let Err((number, why)) = begun {
            self.forget(ctx);
            let code = code(io, number);
            return fail(io, ctx, code, why);
        }
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let Some(tree) = &mut self.tree else {
            return self.resume(io, ctx);
        };
        ctx.nested += 1;
        let ticked = tree.tick(io.now(), ctx);
        ctx.nested -= 1;
        if self.stored != tree.revision()
            && let Some(memory) = io.recall::<Memory>()
            && let Err(why) = self.keep(io, memory.tree)
        {
            tracing::warn!(why, "an inner tree cannot be serialised");
        }
        if !matches!(ticked, Ok(Status::Running | Status::Idle)) {
            self.forget(ctx);
        }
        match ticked {
            Ok(Status::Success) => {
                no_error(io);
                Status::Success
            }
            Ok(Status::Running | Status::Idle) => {
                let said = ctx.goal.feedback.step.clone();
                io.say(said);
                Status::Running
            }
            Ok(Status::Failure | Status::Skipped) => {
                // The inner leaf has reported the reason; it is repeated here with the code.
                let why = ctx.goal.failure.clone().unwrap_or_else(|| "its tree failed".to_owned());
                let code = code(io, error_code::UNKNOWN);
                fail(io, ctx, code, why)
            }
            Err(error) => {
                let code = code(io, error_code::UNKNOWN);
                fail(io, ctx, code, error.to_string())
            }
        }
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let restored = io.recall::<Memory>().and_then(|memory| {
            let mut tree = trees::build(&memory.tree).ok()?;
            tree.restore(memory.snapshot).ok()?;
            Some(tree)
        });
        match restored {
            Some(tree) => {
                self.stored = tree.revision();
                self.take(tree, ctx);
                self.tick(io, ctx)
            }
            None => self.start(io, ctx),
        }
    }

    fn halt(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) {
        if let Some(tree) = &mut self.tree
            && let Err(error) = tree.halt(io.now(), ctx)
        {
            tracing::warn!(%error, "an inner tree was halted with an error");
        }
        self.forget(ctx);
    }
}

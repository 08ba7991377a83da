//! Spots. Where is a goal after the map has moved? It keeps its spot in the building, so its coordinates change.

use zenav_behaviour_tree::Value;
use zenav_protocol::messages::{GoalPoint, Refusal};

use super::goal_validation::{self, Target};
use super::leaves::{goal_text, goals_value, parse_goal, parse_goals};
use super::orchestrator::Mission;
use super::records::StoredGoal;

impl Target {
    /// Places of the target.
    fn places(&self) -> &[GoalPoint] {
        match self {
            Self::Pose(place) => std::slice::from_ref(place),
            Self::Waypoints(places) => places,
            Self::Tree => &[],
        }
    }
}

impl Mission {
    /// The target of a goal, in present coordinates.
    pub(super) fn target(&self, goal: &StoredGoal) -> Result<Target, Refusal> {
        let target = match (
            goal_validation::target(&goal.state.request, &self.ctx),
            &*goal.state.resolved,
        ) {
            // A place that was found once keeps its spot, even if its name is removed later.
            (Err(Refusal::NotFound { .. } | Refusal::Busy { .. }), [place]) if goal.state.request.place.is_some() => {
                Target::Pose(*place)
            }
            (target, _) => target?,
        };
        Ok(match (target, goal.state.resolved.as_slice()) {
            (Target::Pose(_), [place]) => Target::Pose(*place),
            (Target::Waypoints(given), places) if given.len() == places.len() => Target::Waypoints(places.to_vec()),
            (target, _) => target,
        })
    }

    /// Anchors new goals to the parts of the map they belong to, and updates the places of anchored goals. `moved_from` is the previous
    /// frame if the map has just moved.
    pub(super) fn keep_spots(&mut self, moved_from: Option<u64>) {
        let at = self.ctx.frames.at();
        let is_running = |id: &str| self.running.as_ref().is_some_and(|running| running.goal_id == id);
        let mut changes = Vec::new();
        // Without map parts from mapping there is nothing to anchor a goal to.
        let ties = self.ctx.frames.is_known(moved_from.unwrap_or(at));
        for goal in self.goals.open() {
            // A named place is looked up when its goal begins; until then the goal keeps only the name.
            let is_tied = goal.anchors.is_some();
            if is_tied && moved_from.is_none()
                || !is_tied && !ties
                || goal.state.request.place.is_some() && !is_tied && !is_running(&goal.state.id)
            {
                continue;
            }
            let Ok(target) = self.target(goal) else { continue };
            let anchors = match &goal.anchors {
                Some(anchors) => Some(anchors.clone()),
                None => self.ctx.frames.anchors(moved_from.unwrap_or(at), target.places()),
            };
            let Some(anchors) = anchors else { continue };
            let resolved = moved_from.and_then(|_| self.ctx.frames.resolved(&anchors));
            changes.push((goal.state.id.clone(), anchors, target, resolved));
        }
        for (id, anchors, target, resolved) in changes {
            if let Some(resolved) = &resolved
                && let Some(running) = self.running.as_mut().filter(|running| running.goal_id == id)
            {
                rewrite(running.tree.blackboard_mut(), &target, resolved);
            }
            self.goals.change(&id, |goal| {
                goal.anchors = Some(anchors);
                if let Some(resolved) = resolved {
                    goal.state.resolved = resolved;
                }
            });
        }
    }
}

/// Replaces the goal's places on the tree's blackboard by their present coordinates, unless the tree has written other values.
fn rewrite(board: &mut zenav_behaviour_tree::Blackboard, target: &Target, resolved: &[GoalPoint]) {
    let nowhere = super::leaves::Places::new();
    let now = |place: GoalPoint| {
        let mut moved = target.places().iter().zip(resolved);
        moved.find(|(old, _)| **old == place).map_or(place, |(_, new)| *new)
    };
    let place = board.get("goal").and_then(|value| parse_goal(value, &nowhere).ok());
    let places = board.get("goals").and_then(|value| parse_goals(value, &nowhere).ok());
    let written = [
        ("goal", place.map(|place| Value::text(goal_text(&now(place))))),
        (
            "goals",
            places.and_then(|places| goals_value(&places.into_iter().map(now).collect::<Vec<_>>()).ok()),
        ),
    ];
    for (key, value) in written {
        if let Some(value) = value
            && let Err(error) = board.set(key, value)
        {
            tracing::warn!(key, %error, "a goal that has moved cannot be put on the blackboard");
        }
    }
}

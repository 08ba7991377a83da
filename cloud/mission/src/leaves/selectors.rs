//! Which planner, controller, checker, smoother? Selectors put a choice on the blackboard, the nodes that use it look what
//! it means here.
//!
//! Nav2's selectors listen to a topic and keep the last name it carried; here that is the entry of the topic's name on the
//! root blackboard, which a goal may bring along. Names of Nav2's own default configuration mean what this stack has.

use super::SyncLeaf;
use super::ports::write;
use crate::context::Context;
use zenav_behaviour_tree::{LeafIo, Status};
use zenav_planning::Planner;

/// What is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// How a path is looked for.
    Planner,
    /// How it is followed.
    Controller,
    /// How it is made smooth.
    Smoother,
    /// When the goal counts as reached.
    GoalChecker,
    /// When the robot counts as stuck.
    ProgressChecker,
    /// Which part of a path is looked at.
    PathHandler,
}

impl Choice {
    /// Nav2's selector of that registration id.
    #[must_use]
    pub fn of_selector(id: &str) -> Option<Self> {
        Some(match id {
            "PlannerSelector" => Self::Planner,
            "ControllerSelector" => Self::Controller,
            "SmootherSelector" => Self::Smoother,
            "GoalCheckerSelector" => Self::GoalChecker,
            "ProgressCheckerSelector" => Self::ProgressChecker,
            "PathHandlerSelector" => Self::PathHandler,
            _ => return None,
        })
    }

    /// As it stands in ports and topics.
    const fn name(self) -> &'static str {
        match self {
            Self::Planner => "planner",
            Self::Controller => "controller",
            Self::Smoother => "smoother",
            Self::GoalChecker => "goal_checker",
            Self::ProgressChecker => "progress_checker",
            Self::PathHandler => "path_handler",
        }
    }

    /// Names that mean what the stack does by itself.
    const fn own(self) -> &'static [&'static str] {
        match self {
            Self::Planner => &["GridBased"],
            Self::Controller => &["FollowPath"],
            Self::Smoother => &["simple_smoother", "route_smoother", "corridor"],
            Self::GoalChecker => &["general_goal_checker", "goal_checker"],
            Self::ProgressChecker => &["progress_checker"],
            Self::PathHandler => &["PathHandler", "path_handler"],
        }
    }

    /// What a chosen name means: `None` is what the stack does by itself, `Some` a planner.
    ///
    /// # Errors
    /// The names that there are.
    pub fn check(self, name: Option<String>) -> Result<Option<String>, String> {
        let Some(name) = name.filter(|name| !name.is_empty() && !self.own().contains(&name.as_str())) else {
            return Ok(None);
        };
        if self == Self::Planner && name.parse::<Planner>().is_ok() {
            return Ok(Some(name));
        }
        let mut known = self.own().to_vec();
        if self == Self::Planner {
            known.extend(Planner::ALL.iter().map(|(name, _)| *name));
        }
        let shown: String = name.chars().take(60).collect();
        let what = self.name().replace('_', " ");
        Err(format!("no {what} `{shown}`: expected one of {}", known.join(", ")))
    }
}

/// Puts the entry that `topic_name` names, else the default, on the output; FAILURE without either.
pub struct Selector(pub Choice);

impl SyncLeaf for Selector {
    fn answer(&mut self, io: &mut LeafIo<'_>, _: &mut Context) -> Result<Status, String> {
        let what = self.0.name();
        let topic: Option<String> = io.get_optional("topic_name").ok().flatten();
        let heard = topic.and_then(|topic| io.entry(&format!("@{}", topic.trim_start_matches('/'))).cloned());
        let chosen = heard.or_else(|| io.value(&format!("default_{what}")).ok().cloned());
        let chosen = chosen.ok_or_else(|| "nothing is selected, and there is no default".to_owned());
        write(io, &format!("selected_{what}"), chosen)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nav2s_names_mean_what_the_stack_does_and_strangers_are_told_the_names() {
        let check = |choice: Choice, name: &str| choice.check(Some(name.to_owned()));
        assert_eq!(check(Choice::Planner, "GridBased"), Ok(None));
        assert_eq!(check(Choice::Planner, "theta"), Ok(Some("theta".to_owned())));
        assert!(check(Choice::Planner, "Smac").is_err_and(|why| why.contains("astar")));
        assert_eq!(Choice::Controller.check(None), Ok(None));
        assert!(check(Choice::Controller, "MPPI").is_err_and(|why| why.contains("FollowPath")));
    }
}

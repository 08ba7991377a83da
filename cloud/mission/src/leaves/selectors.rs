//! Selectors. Which planner, controller, checker or smoother is used? Selectors write a choice to the blackboard; the nodes that use it
//! look up its meaning here.
//!
//! Nav2's selectors listen to a topic and keep its last name; here that is the entry with the topic's name on the root blackboard, which a
//! goal may set. Names from Nav2's default configuration mean this stack's own components.

use super::SyncLeaf;
use super::ports::write;
use crate::context::Context;
use zenav_behaviour_tree::{LeafIo, Status};
use zenav_planning::Planner;

/// The component to choose.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// Searches a path.
    Planner,
    /// Follows a path.
    Controller,
    /// Smooths a path.
    Smoother,
    /// Decides when the goal is reached.
    GoalChecker,
    /// Decides when the robot is stuck.
    ProgressChecker,
    /// Selects the relevant part of a path.
    PathHandler,
}

impl Choice {
    /// The choice made by Nav2's selector with this registration id.
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

    /// Name in ports and topics.
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

    /// Names that mean the stack's own component.
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

    /// The meaning of a chosen name: `None` is the stack's own component, `Some` a planner.
    ///
    /// # Errors
    /// The known names.
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

/// Writes the entry named by `topic_name`, or else the default, to the output; FAILURE without either.
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

//! Goal list. Which goals are there, and how is one paused or cancelled?

use zenav_protocol::messages::{
    CancelRequest, GoalPhase, GoalReply, GoalRequest, GoalState, GoalsRequest, PauseRequest,
};
use zenav_protocol::topics;

use super::Report;
use crate::connect::{self, RobotArgs, fresh_id};
use crate::exit_code;
use crate::failure::Outcome;
use crate::output::{self, Format};

/// Filters of the list.
#[derive(Debug, clap::Args)]
pub(super) struct ListArgs {
    /// Only goals in this state (accepted, active, paused, succeeded, aborted, canceled, rejected); may be repeated
    #[arg(long, value_name = "STATE", value_delimiter = ',', value_parser = phase)]
    state: Vec<GoalPhase>,
    /// At most so many, newest first
    #[arg(long, value_name = "N")]
    limit: Option<usize>,
}

fn phase(text: &str) -> Result<GoalPhase, String> {
    use GoalPhase::{Aborted, Accepted, Active, Canceled, Paused, Rejected, Succeeded};
    let all = [Accepted, Active, Paused, Succeeded, Aborted, Canceled, Rejected];
    all.into_iter()
        .find(|phase| format!("{phase:?}").eq_ignore_ascii_case(text))
        .ok_or_else(|| format!("expected one of {all:?}"))
}

pub(super) fn run(robot: &RobotArgs, format: Format, args: &ListArgs) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let request = GoalsRequest {
            id: None,
            states: args.state.clone(),
            limit: args.limit,
        };
        let reply = bus.ask(&topics::GOALS, &[&robot], &request, patience).await?;
        output::values(format, &reply.goals, table)?;
        Ok(exit_code::OK)
    })
}

fn table(goals: &[GoalState]) -> String {
    let number = |value: Option<f64>| value.map(|value| format!("{value:.2}")).unwrap_or_default();
    let rows: Vec<Vec<String>> = goals
        .iter()
        .map(|goal| {
            let took = goal
                .started
                .and_then(|started| goal.ended.map(|ended| ended.secs_since(started)));
            let remark = goal.reason.clone().unwrap_or_else(|| goal.feedback.step.clone());
            vec![
                goal.id.clone(),
                format!("{:?}", goal.state),
                target(&goal.request),
                number(goal.feedback.distance_left),
                number(took),
                remark,
            ]
        })
        .collect();
    output::table(&["ID", "STATE", "TARGET", "LEFT m", "TOOK s", "REMARK"], &rows)
}

fn target(request: &GoalRequest) -> String {
    if let Some(place) = &request.place {
        return place.clone();
    }
    if let Some(tree) = &request.tree {
        // The text of a tree is too long for a table.
        return if tree.trim_start().starts_with('<') {
            "tree".to_owned()
        } else {
            format!("tree {tree}")
        };
    }
    match (request.x, request.y) {
        (Some(x), Some(y)) => format!("{x:.2}, {y:.2}"),
        _ => format!("{} waypoints", request.waypoints.len()),
    }
}

pub(super) fn cancel(robot: &RobotArgs, format: Format, id: Option<String>) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let request = CancelRequest {
            id,
            request_id: Some(fresh_id("cancel")),
        };
        let reply = bus.ask(&topics::CANCEL, &[&robot], &request, patience).await?;
        print(format, &robot, reply)
    })
}

pub(super) fn pause(robot: &RobotArgs, format: Format, id: Option<String>, resume: bool) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let request = PauseRequest {
            id,
            resume,
            request_id: Some(fresh_id("pause")),
        };
        let reply = bus.ask(&topics::PAUSE, &[&robot], &request, patience).await?;
        print(format, &robot, reply)
    })
}

fn print(format: Format, robot: &str, reply: GoalReply) -> Outcome {
    output::value(
        format,
        &Report::new(robot, &reply.id, reply.state, reply.reason),
        Report::line,
    )?;
    // The command did what it was to do, whatever became of the goal.
    Ok(exit_code::OK)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn states_are_named_in_any_case() {
        assert_eq!(phase("succeeded"), Ok(GoalPhase::Succeeded));
        assert!(phase("done").unwrap_err().contains("Succeeded"));
    }

    #[test]
    fn an_empty_list_is_a_header() {
        assert!(table(&[]).starts_with("ID"));
    }
}

//! Goal list. Lists goals; pauses, resumes and cancels one.

use serde::Serialize;
use zenav_protocol::bus::AskError;
use zenav_protocol::messages::{
    CancelRequest, GoalPhase, GoalReply, GoalRequest, GoalState, GoalsRequest, PauseRequest, Refusal,
};
use zenav_protocol::topics;

use super::Report;
use crate::arguments::whole;
use crate::connect::{self, RobotArgs, fresh_id};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::leadership;
use crate::output::{self, Format};

/// Filters of the list.
#[derive(Debug, clap::Args)]
pub(super) struct ListArgs {
    /// Only goals in this state (accepted, active, paused, succeeded, aborted, canceled, rejected); may be repeated
    #[arg(long, value_name = "STATE", value_delimiter = ',', value_parser = phase)]
    state: Vec<GoalPhase>,
    /// Show at most this many, newest first
    #[arg(long, value_name = "N", value_parser = whole::<usize>)]
    limit: Option<usize>,
}

fn phase(text: &str) -> Result<GoalPhase, String> {
    use GoalPhase::{Aborted, Accepted, Active, Canceled, Paused, Rejected, Succeeded};
    let all = [Accepted, Active, Paused, Succeeded, Aborted, Canceled, Rejected];
    all.into_iter()
        .find(|phase| format!("{phase:?}").eq_ignore_ascii_case(text))
        .ok_or_else(|| format!("expected one of {all:?}"))
}

/// A listed goal: the mission's state and its age.
#[derive(Debug, Serialize)]
struct Listed {
    #[serde(flatten)]
    goal: GoalState,
    /// Time since it was accepted, on the mission's clock, s; `None` if the mission does not report its time.
    age_s: Option<f64>,
}

/// Lists the goals of one robot, or of all robots with a mission.
pub(super) fn run(robot: &RobotArgs, format: Format, args: &ListArgs) -> Outcome {
    let patience = robot.link.patience();
    let request = GoalsRequest {
        id: None,
        states: args.state.clone(),
        limit: args.limit,
    };
    connect::on_bus(&robot.link, async |bus| {
        let robots = match &robot.robot {
            Some(_) => vec![connect::find(&bus, robot.robot.as_deref()).await?],
            None => connect::with_component(&bus, "mission").await?,
        };
        let mut listed = Vec::new();
        let mut failure = None;
        for robot in &robots {
            match leadership::ask(&bus, &topics::GOALS, robot, &request, patience).await {
                Ok(reply) => listed.extend(reply.goals.into_iter().map(|goal| Listed {
                    age_s: reply.now.map(|now| now.secs_since(goal.accepted)),
                    goal,
                })),
                Err(error) => failure = Some(Failure::from(error).about(robot)),
            }
        }
        // Answers are printed even if some robots do not answer.
        if failure.is_none() || !listed.is_empty() {
            output::values(format, &listed, |listed| table(listed, robots.len() > 1))?;
        }
        failure.map_or(Ok(exit_code::OK), Err)
    })
}

fn table(goals: &[Listed], several_robots: bool) -> String {
    let number = |value: Option<f64>| value.map(|value| format!("{value:.2}")).unwrap_or_default();
    let rows = goals.iter().map(|Listed { goal, age_s }| {
        let took = goal
            .started
            .zip(goal.ended)
            .map(|(started, ended)| ended.secs_since(started));
        let left = goal.feedback.distance_left.filter(|_| !goal.state.is_end());
        let mut row = vec![
            goal.id.clone(),
            format!("{:?}", goal.state),
            target(&goal.request),
            age_s.map(age).unwrap_or_default(),
            number(left),
            number(took),
            remark(goal),
        ];
        if several_robots {
            row.insert(1, goal.robot.clone());
        }
        row
    });
    let mut header = vec!["ID", "STATE", "TARGET", "AGE", "LEFT m", "TOOK s", "REMARK"];
    if several_robots {
        header.insert(1, "ROBOT");
    }
    output::table(&header, rows)
}

/// How a goal ended, or its current activity.
fn remark(goal: &GoalState) -> String {
    if let Some(reason) = &goal.reason {
        return reason.clone();
    }
    match goal.state {
        GoalPhase::Succeeded => {
            let error = goal
                .feedback
                .final_error
                .map(|error| format!("{:.1} cm off", 100.0 * error));
            let length: f64 = goal.legs.iter().map(|leg| leg.planned_length).sum();
            let length = (length > 0.0).then(|| format!("{length:.1} m planned"));
            let plans = goal.feedback.plans;
            let plans = (plans > 0).then(|| output::counted(plans, "plan"));
            output::listed([error, length, plans].into_iter().flatten())
        }
        GoalPhase::Active => goal.feedback.step.clone(),
        GoalPhase::Accepted => "waits for its turn".to_owned(),
        _ => String::new(),
    }
}

/// A human-readable time: seconds, minutes, hours, days.
fn age(secs: f64) -> String {
    let whole = secs.max(0.0);
    match whole {
        secs if secs < 60.0 => format!("{secs:.0} s"),
        secs if secs < 3600.0 => format!("{:.0} min", (secs / 60.0).floor()),
        secs if secs < 86_400.0 => format!("{:.0} h", (secs / 3600.0).floor()),
        secs => format!("{:.0} d", (secs / 86_400.0).floor()),
    }
}

/// What a goal is for, in short: its place, its coordinates, its waypoints, or its tree.
pub(crate) fn target(request: &GoalRequest) -> String {
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
        _ => output::counted(request.waypoints.len(), "waypoint"),
    }
}

pub(super) fn cancel(robot: &RobotArgs, format: Format, id: Option<String>) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let request = CancelRequest {
            id,
            request_id: Some(fresh_id("cancel")),
        };
        let reply = leadership::ask(&bus, &topics::CANCEL, &robot, &request, patience).await;
        let reply = reply.map_err(|error| not_there(&robot, request.id.as_deref(), error))?;
        if reply.state.is_end() && reply.state != GoalPhase::Canceled {
            return Err(Failure::rejected(format!(
                "goal {} is {:?}: only a goal that has not ended can be cancelled",
                reply.id, reply.state
            )));
        }
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
        let reply = leadership::ask(&bus, &topics::PAUSE, &robot, &request, patience).await;
        let reply = reply.map_err(|error| not_there(&robot, request.id.as_deref(), error))?;
        print(format, &robot, reply)
    })
}

/// Reason for the refusal: usually, the robot has no such goal.
fn not_there(robot: &str, id: Option<&str>, error: AskError) -> Failure {
    match (error, id) {
        (AskError::Refused(Refusal::NotFound { .. }), Some(id)) => super::no_goal(robot, id),
        (AskError::Refused(Refusal::NotFound { .. }), None) => {
            Failure::not_found(format!("robot {robot} has no active goal"))
        }
        (error, _) => error.into(),
    }
}

fn print(format: Format, robot: &str, reply: GoalReply) -> Outcome {
    output::value(
        format,
        &Report::new(robot, &reply.id, reply.state, reply.reason),
        Report::line,
    )?;
    // The command succeeded, whatever the goal's state is.
    Ok(exit_code::OK)
}

#[cfg(test)]
mod tests {
    use zenav_protocol::messages::GoalPoint;

    use super::*;

    #[test]
    fn states_are_named_in_any_case() {
        assert_eq!(phase("succeeded"), Ok(GoalPhase::Succeeded));
        assert!(phase("done").unwrap_err().contains("Succeeded"));
    }

    #[test]
    fn an_empty_list_is_a_header() {
        assert!(table(&[], false).starts_with("ID  STATE"));
        assert!(table(&[], true).starts_with("ID  ROBOT"));
    }

    #[test]
    fn a_goal_that_was_reached_tells_how_well_and_not_what_it_did_last() {
        let goal: GoalState = serde_json::from_value(serde_json::json!({
            "id": "g", "robot": "r", "state": "Succeeded", "accepted": 0, "started": 0, "ended": 1,
            "feedback": { "step": "drives", "distance_left": 0.1, "time_left": null, "plans": 1, "final_error": 0.004 },
            "request": { "x": 1.0, "y": 2.0 }
        }))
        .unwrap();
        assert_eq!(remark(&goal), "0.4 cm off, 1 plan");
        let paused = GoalState {
            state: GoalPhase::Paused,
            ..goal
        };
        assert_eq!(remark(&paused), "");
    }

    #[test]
    fn one_waypoint_is_not_several() {
        let of = |waypoints: &[GoalPoint]| {
            target(&GoalRequest {
                waypoints: waypoints.to_vec(),
                ..GoalRequest::default()
            })
        };
        let at = GoalPoint {
            x: 1.0,
            y: 2.0,
            yaw: None,
        };
        assert_eq!((of(&[at]), of(&[at, at])), ("1 waypoint".into(), "2 waypoints".into()));
    }

    #[test]
    fn an_age_is_short() {
        assert_eq!(
            [12.4, 61.0, 7300.0, 200_000.0].map(age),
            ["12 s", "1 min", "2 h", "2 d"]
        );
    }
}

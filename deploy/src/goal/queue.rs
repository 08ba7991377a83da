//! Goal queue. Lists the queued goals in order, and moves one to another place.

use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{GoalPhase, GoalState, GoalsRequest, MoveGoalRequest};
use zenav_protocol::topics;

use super::list::target;
use crate::completion;
use crate::connect::{self, RobotArgs, fresh_id};
use crate::failure::{Failure, Outcome};
use crate::leadership;
use crate::output::{self, Format};

/// The goal, and its new place.
#[derive(Debug, clap::Args)]
#[command(group(clap::ArgGroup::new("place").required(true).args(["before", "first", "last"])))]
pub(super) struct MoveArgs {
    /// Goal to move
    #[arg(add = completion::goals())]
    id: String,
    /// Put it before this goal, with that goal's priority
    #[arg(long, value_name = "ID", add = completion::goals())]
    before: Option<String>,
    /// Put it first: it runs next
    #[arg(long)]
    first: bool,
    /// Put it last
    #[arg(long)]
    last: bool,
}

/// A queued goal.
#[derive(Debug, PartialEq, Serialize)]
struct Waiting {
    /// 1 is next.
    place: u64,
    #[serde(flatten)]
    goal: GoalState,
}

/// Moves a goal, then prints the new queue.
pub(super) fn run(robot: &RobotArgs, format: Format, args: &MoveArgs) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let before = if args.first {
            let first = queue(&bus, &robot, patience).await?.into_iter().next();
            first.map(|waiting| waiting.goal.id)
        } else {
            args.before.clone()
        };
        let request = MoveGoalRequest {
            id: args.id.clone(),
            before,
            request_id: Some(fresh_id("move")),
        };
        leadership::ask(&bus, &topics::MOVE_GOAL, &robot, &request, patience).await?;
        output::values(format, &queue(&bus, &robot, patience).await?, table)
    })
}

/// The queued goals, next first.
async fn queue(bus: &Bus, robot: &str, patience: std::time::Duration) -> Result<Vec<Waiting>, Failure> {
    let request = GoalsRequest {
        states: vec![GoalPhase::Accepted],
        ..GoalsRequest::default()
    };
    let reply = leadership::ask(bus, &topics::GOALS, robot, &request, patience).await?;
    Ok(in_order(reply.goals))
}

fn in_order(goals: Vec<GoalState>) -> Vec<Waiting> {
    let mut waiting: Vec<Waiting> = goals
        .into_iter()
        .filter_map(|goal| goal.queue.map(|place| Waiting { place, goal }))
        .collect();
    waiting.sort_by_key(|waiting| waiting.place);
    waiting
}

fn table(waiting: &[Waiting]) -> String {
    let row = |Waiting { place, goal }: &Waiting| [place.to_string(), goal.id.clone(), target(&goal.request)];
    output::table(&["PLACE", "ID", "TARGET"], waiting.iter().map(row))
}

#[cfg(test)]
mod tests {
    use super::super::tests::parse;
    use super::*;

    fn goal(id: &str, queue: Option<u64>) -> GoalState {
        serde_json::from_value(serde_json::json!({
            "id": id, "robot": "r", "state": "Accepted", "accepted": 0, "queue": queue,
            "feedback": { "step": "", "distance_left": null, "time_left": null, "plans": 0 },
            "request": { "place": "sink" }
        }))
        .unwrap()
    }

    #[test]
    fn the_next_goal_comes_first_and_one_that_does_not_wait_is_left_out() {
        let waiting = in_order(vec![goal("c", Some(2)), goal("b", None), goal("a", Some(1))]);
        let table = table(&waiting);
        let lines: Vec<Vec<&str>> = table.lines().map(|line| line.split_whitespace().collect()).collect();
        assert_eq!(
            lines,
            [["PLACE", "ID", "TARGET"], ["1", "a", "sink"], ["2", "c", "sink"]]
        );
    }

    #[test]
    fn exactly_one_place_is_named() {
        for places in [&["--before", "b"][..], &["--first"], &["--last"]] {
            assert!(parse(&[&["move", "a"], places].concat()).is_ok(), "{places:?}");
        }
        assert!(parse(&["move", "a"]).is_err());
        assert!(parse(&["move", "a", "--first", "--last"]).is_err());
        assert!(parse(&["move", "a", "--first", "--before", "b"]).is_err());
    }
}

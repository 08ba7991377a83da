//! Unreachable goals. Submits them while the robot drives, like any client, and checks that they are refused and with which reasons.

use std::time::Duration;

use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{CancelRequest, GoalRequest, Refusal};
use zenav_protocol::topics;

use crate::report::RefusedGoal;

/// Longest wait for the first drive to start, and for an answer, wall time.
const PATIENCE: Duration = Duration::from_secs(20);

/// A place where no robot can be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Impossible {
    pub name: &'static str,
    /// Map frame, m.
    pub x: f64,
    /// Map frame, m.
    pub y: f64,
}

/// Submits each goal once the mission has started to drive: by then it knows the robot, and some of the map.
///
/// # Errors
/// In words: a goal was accepted, or there was no answer.
pub(super) async fn ask(
    bus: Bus,
    robot: Id,
    mission: String,
    goals: &'static [Impossible],
) -> Result<Vec<RefusedGoal>, String> {
    if goals.is_empty() {
        return Ok(Vec::new());
    }
    let mut states = bus
        .subscribe(&topics::GOAL_STATE, &[robot.as_str(), &mission], 64)
        .map_err(|error| error.to_string())?;
    let begun = async {
        while let Some(state) = states.next().await {
            if !state.message.legs.is_empty() || state.message.state.is_end() {
                break;
            }
        }
    };
    // On timeout the goals are submitted anyway: a late result is enough for a report.
    let _ = tokio::time::timeout(PATIENCE, begun).await;
    let mut refused = Vec::new();
    for goal in goals {
        let request = GoalRequest {
            id: Some(format!("impossible-{}", refused.len() + 1)),
            x: Some(goal.x),
            y: Some(goal.y),
            ..GoalRequest::default()
        };
        match bus.ask(&topics::GOAL, &[robot.as_str()], &request, PATIENCE).await {
            Err(AskError::Refused(Refusal::Rejected { reason, nearest_free })) => refused.push(RefusedGoal {
                name: goal.name.to_owned(),
                x: goal.x,
                y: goal.y,
                reason,
                nearest_free,
            }),
            Err(error) => return Err(format!("goal {}: {error}", goal.name)),
            Ok(reply) => {
                let cancel = CancelRequest {
                    id: Some(reply.id),
                    request_id: None,
                };
                let _ = bus.ask(&topics::CANCEL, &[robot.as_str()], &cancel, PATIENCE).await;
                return Err(format!("a goal {} was accepted", goal.name));
            }
        }
    }
    Ok(refused)
}

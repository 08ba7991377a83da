//! `zenav goal`. Submits, watches, reorders and cancels goals from anywhere.
//!
//! | file | answers |
//! |---|---|
//! | `submit` | how is the command line turned into a request and sent? |
//! | `follow` | how does a goal proceed, until it ends or the watcher detaches? |
//! | `list` | which goals are there? cancel, pause, resume |
//! | `queue` | which goals wait, in which order, and how is one moved? |

mod follow;
mod list;
mod queue;
mod submit;

use serde::Serialize;
use zenav_protocol::messages::{GoalPhase, GoalPoint, GoalState};

use crate::completion;
use crate::connect::RobotArgs;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{Format, piece};

pub(crate) use list::target;

/// Goals: submit, list, watch, move, cancel.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav goal submit 0.88 0.09 --wait\n  zenav goal submit --place sink --on-busy preempt\n  zenav goal submit --tree patrol.xml --wait\n  zenav goal list --state active,accepted\n  zenav goal move patrol --before delivery\n\nExit codes of a goal that is waited for: 0 reached, 1 aborted, 6 cancelled, 7 rejected, 130 detached by Ctrl-C."
)]
pub struct GoalArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: GoalCommand,
}

#[derive(Debug, clap::Subcommand)]
enum GoalCommand {
    /// Submit a goal: X Y [YAW] in the map, a named place, or a behaviour tree
    Submit(submit::SubmitArgs),
    /// List goals, newest first; in a simulation AGE and TOOK count simulated time
    List(list::ListArgs),
    /// Watch a goal until it ends; Ctrl-C only stops watching
    Watch {
        /// Goal to watch
        #[arg(add = completion::goals())]
        id: String,
    },
    /// Move a queued goal to another place in the queue and show the new order
    Move(queue::MoveArgs),
    /// Cancel a goal; without an id, the running one
    Cancel {
        /// Goal to cancel
        #[arg(add = completion::goals())]
        id: Option<String>,
    },
    /// Pause a goal; without an id, the running one
    Pause {
        /// Goal to pause
        #[arg(add = completion::goals())]
        id: Option<String>,
    },
    /// Resume a paused goal
    Resume {
        /// Goal to resume
        #[arg(add = completion::goals())]
        id: Option<String>,
    },
}

/// Does what the command line says.
///
/// # Errors
/// A failure with its exit code.
pub fn run(args: &GoalArgs) -> Outcome {
    match &args.command {
        GoalCommand::Submit(submit) => submit::run(&args.robot, args.output, submit),
        GoalCommand::List(list) => list::run(&args.robot, args.output, list),
        GoalCommand::Watch { id } => follow::watch(&args.robot, args.output, id),
        GoalCommand::Move(place) => queue::run(&args.robot, args.output, place),
        GoalCommand::Cancel { id } => list::cancel(&args.robot, args.output, id.clone()),
        GoalCommand::Pause { id } => list::pause(&args.robot, args.output, id.clone(), false),
        GoalCommand::Resume { id } => list::pause(&args.robot, args.output, id.clone(), true),
    }
}

/// Failure: the robot has no such goal.
fn no_goal(robot: &str, id: &str) -> Failure {
    Failure::not_found(format!("robot {robot} has no goal `{id}`"))
}

/// Exit code for a goal's state.
const fn phase_code(phase: GoalPhase) -> u8 {
    match phase {
        GoalPhase::Accepted | GoalPhase::Active | GoalPhase::Paused | GoalPhase::Succeeded => exit_code::OK,
        GoalPhase::Aborted => exit_code::FAILED,
        GoalPhase::Canceled => exit_code::CANCELED,
        GoalPhase::Rejected => exit_code::REJECTED,
    }
}

/// Printed report of a goal: `id`, `state`, `reason`.
#[derive(Debug, Serialize)]
struct Report {
    id: String,
    robot: String,
    state: GoalPhase,
    reason: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    nearest_free: Option<GoalPoint>,
    #[serde(skip_serializing_if = "Option::is_none")]
    plans: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    replans: Option<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    time_s: Option<f64>,
}

impl Report {
    fn new(robot: &str, id: &str, state: GoalPhase, reason: Option<String>) -> Self {
        Self {
            id: id.to_owned(),
            robot: robot.to_owned(),
            state,
            reason,
            nearest_free: None,
            plans: None,
            replans: None,
            time_s: None,
        }
    }

    fn of(state: &GoalState) -> Self {
        Self {
            plans: Some(state.feedback.plans),
            replans: Some(state.feedback.replans),
            time_s: state
                .ended
                .map(|ended| ended.secs_since(state.started.unwrap_or(state.accepted))),
            ..Self::new(&state.robot, &state.id, state.state, state.reason.clone())
        }
    }

    fn line(&self) -> String {
        let reason = piece(self.reason.as_ref(), |reason| format!(": {reason}"));
        let near = |place: GoalPoint| format!(" (nearest free place: {:.2}, {:.2})", place.x, place.y);
        let near = piece(self.nearest_free, near);
        let time = piece(self.time_s, |secs| format!(" ({secs:.1} s)"));
        format!("{} {:?}{reason}{near}{time}", self.id, self.state)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn parse(words: &[&str]) -> Result<GoalArgs, clap::Error> {
        crate::cli::parsed(words)
    }

    #[test]
    fn each_end_has_its_exit_code() {
        let codes = [
            GoalPhase::Succeeded,
            GoalPhase::Aborted,
            GoalPhase::Canceled,
            GoalPhase::Rejected,
        ]
        .map(phase_code);
        assert_eq!(codes, [0, 1, 6, 7]);
    }

    #[test]
    fn the_robot_may_be_named_before_or_after_the_command() {
        for words in [["--robot", "r", "list"], ["list", "--robot", "r"]] {
            assert_eq!(parse(&words).unwrap().robot.robot.as_deref(), Some("r"));
        }
        assert!(
            parse(&["--robot", "a/b", "list"]).is_err(),
            "a name must not widen a key"
        );
    }

    #[test]
    fn a_report_names_id_state_and_reason_also_without_one() {
        let text = serde_json::to_string(&Report::new("r", "g", GoalPhase::Succeeded, None)).unwrap();
        assert_eq!(text, r#"{"id":"g","robot":"r","state":"Succeeded","reason":null}"#);
    }
}

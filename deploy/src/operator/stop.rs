//! How is a robot stopped, and let go again? By asking the robot itself: no lease, no cloud, and on its own endpoint no router either.

use std::collections::BTreeMap;

use serde::Serialize;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{ResumeRequest, StopReply, StopRequest, exit_code};
use zenav_protocol::topics;

use super::holder;
use crate::connect::{self, RobotArgs};
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Stop or resume.
#[derive(Debug, clap::Args)]
pub struct StopArgs {
    /// Which robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Every robot that shows
    #[arg(long, conflicts_with = "robot")]
    all: bool,
    /// Form of what is printed
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

#[derive(Debug, Serialize)]
struct Stopped {
    robot: String,
    stopped: bool,
}

/// Stops a robot: it brakes, discards its plan, and stays stopped (across a restart too) until resumed.
///
/// # Errors
/// When it does not answer, or was not found.
pub fn stop(args: &StopArgs) -> Outcome {
    act(args, true)
}

/// Allows a stopped robot to take a new plan from where it stands.
///
/// # Errors
/// When it does not answer, or was not found.
pub fn resume(args: &StopArgs) -> Outcome {
    act(args, false)
}

fn act(args: &StopArgs, stop: bool) -> Outcome {
    let patience = args.robot.link.patience();
    let ask = async |bus: &Bus, robot: &str| -> Result<StopReply, AskError> {
        let by = Some(holder());
        if stop {
            bus.ask(&topics::STOP, &[robot], &StopRequest { by }, patience).await
        } else {
            bus.ask(&topics::RESUME, &[robot], &ResumeRequest { by }, patience)
                .await
        }
    };
    let mut link = args.robot.link.clone();
    if link.connect == [connect::DEFAULT_ENDPOINT] {
        // Nobody named another: without the router, the robot of this machine itself.
        link.connect.push(connect::ROBOT_ENDPOINT.to_owned());
    }
    let answers = connect::on_bus(&link, async |bus| {
        if args.all {
            let mut answers = BTreeMap::new();
            for robot in connect::robots(&bus).await?.into_keys() {
                let answer = ask(&bus, &robot).await;
                answers.insert(robot, answer);
            }
            if answers.is_empty() {
                return Err(Failure::not_found("no robot shows here"));
            }
            return Ok(answers);
        }
        let robot = match &args.robot.robot {
            // A named robot is asked at once; whether there is such a robot is found out meanwhile.
            Some(robot) => {
                tokio::select! {
                    biased;
                    answer = ask(&bus, robot) => return Ok(BTreeMap::from([(robot.clone(), answer)])),
                    found = connect::find(&bus, Some(robot)) => found?,
                }
            }
            None => connect::find(&bus, None).await?,
        };
        let answer = ask(&bus, &robot).await;
        Ok(BTreeMap::from([(robot, answer)]))
    })?;
    let mut rows = Vec::new();
    let mut failure = None;
    for (robot, answer) in answers {
        match answer {
            Ok(reply) => rows.push(Stopped {
                robot,
                stopped: reply.stopped,
            }),
            Err(error) => {
                let error = Failure::from(error);
                failure = Some(Failure::new(error.code, format!("{robot}: {error}")));
            }
        }
    }
    let line = |row: &Stopped| format!("{} {}", row.robot, if row.stopped { "stopped" } else { "may go" });
    match rows.as_slice() {
        [] => {}
        [one] if !args.all => output::value(args.output, one, line)?,
        several => output::values(args.output, several, |rows| {
            rows.iter().map(line).collect::<Vec<_>>().join("\n")
        })?,
    }
    match failure {
        Some(failure) => Err(failure),
        // Asked to stop and not stopped, or the other way round, is no success.
        None if rows.iter().any(|row| row.stopped != stop) => Ok(exit_code::FAILED),
        None => Ok(exit_code::OK),
    }
}

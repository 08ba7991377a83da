//! `zenav do`. Runs one maneuver of the robot itself (spin, drive, back up, wait), under its collision monitor, with an id that makes the
//! request idempotent. The operator's lease is held until the maneuver ends.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use indicatif::ProgressBar;
use serde::Serialize;
use tokio::time::{Instant, sleep};
use zenav_cloud::operator::Authority;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{BehaviourAction, BehaviourReport, BehaviourRequest, BehaviourState};
use zenav_protocol::topics;

use super::ended;
use super::holder;
use crate::arguments::{finite, positive};
use crate::connect::{self, RobotArgs, fresh_id};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Pause between polls of the progress.
const ASK_EVERY: Duration = Duration::from_millis(100);
/// Longest wait for one poll's answer: the next poll may get through.
const ANSWER_WITHIN: Duration = Duration::from_millis(1000);

/// One maneuver.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav do spin 1.57          a quarter turn to the left\n  zenav do backup 0.3         30 cm backwards\n  zenav do drive 0.5 --speed 0.2\n  zenav do wait 5             keep the mission away for 5 s\n\nThe operator's lease is taken and given back; a mission waits meanwhile. Ctrl-C ends the maneuver: the robot brakes.\nExit codes: 0 done, 1 it failed (something stands in the way), 6 somebody ended it, 7 refused, 130 Ctrl-C."
)]
pub struct DoArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    /// Id of the maneuver: repeating an id starts nothing new [default: generated]
    #[arg(long, global = true, value_name = "ID")]
    id: Option<String>,
    #[command(subcommand)]
    maneuver: Maneuver,
}

#[derive(Clone, Copy, Debug, clap::Subcommand)]
enum Maneuver {
    /// Turn on the spot
    Spin {
        /// Angle, rad; positive is to the left
        #[arg(default_value_t = FRAC_PI_2, value_parser = finite)]
        angle: f64,
    },
    /// Drive straight
    Drive {
        /// Distance, m; negative is backwards
        #[arg(value_parser = finite)]
        distance: f64,
        /// Speed, m/s
        #[arg(long, value_name = "M/S", default_value_t = 0.2, value_parser = positive)]
        speed: f64,
    },
    /// Drive straight backwards
    Backup {
        /// Distance, m
        #[arg(default_value_t = 0.3, value_parser = positive)]
        distance: f64,
        /// Speed, m/s
        #[arg(long, value_name = "M/S", default_value_t = 0.1, value_parser = positive)]
        speed: f64,
    },
    /// Drive to the free place that is reached soonest: one turn, one straight drive
    Free {
        /// Clearance of the footprint at that place, m
        #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = positive)]
        clearance: f64,
        /// Search radius, m
        #[arg(long, value_name = "M", default_value_t = 1.0, value_parser = positive)]
        within: f64,
    },
    /// Stand still
    Wait {
        /// Duration, s
        #[arg(value_parser = positive)]
        secs: f64,
    },
}

impl Maneuver {
    const fn action(self) -> BehaviourAction {
        match self {
            Self::Spin { angle } => BehaviourAction::Spin { angle },
            Self::Drive { distance, speed } => BehaviourAction::Drive { distance, speed },
            Self::Backup { distance, speed } => BehaviourAction::Drive {
                distance: -distance,
                speed,
            },
            Self::Free { clearance, within } => BehaviourAction::ToFree { clearance, within },
            Self::Wait { secs } => BehaviourAction::Wait { secs },
        }
    }
}

/// How a maneuver ended.
#[derive(Debug, Serialize)]
struct Ended {
    id: String,
    robot: String,
    state: BehaviourState,
    reason: Option<String>,
    /// Wall time, s.
    time_s: f64,
}

/// Runs one maneuver on a robot and waits for its end.
///
/// # Errors
/// [`exit_code::REJECTED`] if somebody else operates the robot or it is stopped, [`exit_code::USAGE`] for numbers beyond its limits.
pub fn maneuver(args: &DoArgs) -> Outcome {
    let patience = args.robot.link.patience();
    let id = args.id.clone().unwrap_or_else(|| fresh_id("do"));
    connect::on_robot(&args.robot, async |bus, robot| {
        let authority = Authority::acquire(&bus, &robot, &holder(), patience).await?;
        if authority.epoch.is_none() {
            return Err(Failure::timeout(format!(
                "{robot} does not say how it is: its edge is away"
            )));
        }
        let execution = Execution {
            bus: &bus,
            robot: &robot,
            id: &id,
            epoch: authority.epoch,
        };
        let began = Instant::now();
        let done = execution.run(args.maneuver.action(), patience).await;
        authority.release().await;
        let (report, interrupted) = done?;
        let ended = Ended {
            id: report.id,
            robot: robot.clone(),
            state: report.state,
            reason: report.reason,
            time_s: began.elapsed().as_secs_f64(),
        };
        output::value(args.output, &ended, line)?;
        Ok(match ended.state {
            _ if interrupted => exit_code::INTERRUPTED,
            BehaviourState::Succeeded => exit_code::OK,
            BehaviourState::Canceled => exit_code::CANCELED,
            BehaviourState::Running | BehaviourState::Failed => exit_code::FAILED,
        })
    })
}

fn line(ended: &Ended) -> String {
    let reason = output::piece(ended.reason.as_ref(), |reason| format!(": {reason}"));
    format!("{} {:?}{reason} ({:.1} s)", ended.id, ended.state, ended.time_s)
}

/// One execution of a maneuver.
struct Execution<'a> {
    bus: &'a Bus,
    robot: &'a str,
    id: &'a str,
    epoch: Option<u64>,
}

impl Execution<'_> {
    async fn ask(&self, action: BehaviourAction, within: Duration) -> Result<Option<BehaviourReport>, AskError> {
        let request = BehaviourRequest {
            id: self.id.to_owned(),
            action,
            epoch: self.epoch,
        };
        let reply = self
            .bus
            .ask(&topics::BEHAVIOUR, &[self.robot], &request, within)
            .await?;
        Ok(reply.report)
    }

    /// Starts it and waits for its end; also returns whether the user cancelled it.
    async fn run(&self, action: BehaviourAction, patience: Duration) -> Result<(BehaviourReport, bool), Failure> {
        let interrupted = ended();
        tokio::pin!(interrupted);
        let started = tokio::select! {
            started = self.ask(action, patience) => started,
            // The maneuver may have started, so the robot is asked to cancel it anyway.
            () = &mut interrupted => return self.cancel(patience).await,
        };
        let mut report = started?;
        let display = output::spinner();
        let mut heard = Instant::now();
        loop {
            match &report {
                Some(report) if report.state != BehaviourState::Running => return Ok((report.clone(), false)),
                Some(_) => {}
                None => {
                    return Err(Failure::failed(format!(
                        "{} has forgotten the maneuver: it restarted",
                        self.robot
                    )));
                }
            }
            show(display.as_ref(), self.id);
            tokio::select! {
                () = sleep(ASK_EVERY) => {}
                () = &mut interrupted => return self.cancel(patience).await,
            }
            match self.ask(BehaviourAction::Report, ANSWER_WITHIN).await {
                Ok(newer) => (report, heard) = (newer, Instant::now()),
                Err(AskError::Timeout { .. }) if heard.elapsed() < patience => {}
                Err(error) => {
                    return Err(Failure::new(
                        exit_code::of_ask(&error),
                        format!("{error}; without the operator's heartbeat the lease lapses and the robot brakes"),
                    ));
                }
            }
        }
    }

    async fn cancel(&self, patience: Duration) -> Result<(BehaviourReport, bool), Failure> {
        let report = self.ask(BehaviourAction::Cancel, patience).await.map_err(|error| {
            let robot = self.robot;
            Failure::new(
                exit_code::of_ask(&error),
                format!(
                    "{robot} did not confirm the end of the maneuver ({error}); `zenav stop --robot {robot}` stops it"
                ),
            )
        })?;
        let report = report.unwrap_or_else(|| BehaviourReport {
            id: self.id.to_owned(),
            state: BehaviourState::Canceled,
            reason: Some("it had not begun".to_owned()),
        });
        Ok((report, true))
    }
}

fn show(display: Option<&ProgressBar>, id: &str) {
    if let Some(display) = display {
        display.set_message(format!("{id} runs; Ctrl-C ends it"));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parsed(words: &[&str]) -> Option<BehaviourAction> {
        let args: DoArgs = crate::cli::parsed(words).ok()?;
        Some(args.maneuver.action())
    }

    #[test]
    fn backing_up_is_driving_backwards_and_a_spin_may_go_to_the_right() {
        let drive = |distance, speed| Some(BehaviourAction::Drive { distance, speed });
        assert_eq!(parsed(&["backup", "0.5"]), drive(-0.5, 0.1));
        assert_eq!(parsed(&["drive", "-0.5", "--speed", "0.3"]), drive(-0.5, 0.3));
        assert_eq!(parsed(&["spin", "-1.5"]), Some(BehaviourAction::Spin { angle: -1.5 }));
        for bad in [
            &["backup", "-1"][..],
            &["wait", "0"],
            &["spin", "NaN"],
            &["drive"],
            &["jump"],
        ] {
            assert_eq!(parsed(bad), None, "{bad:?}");
        }
    }
}

//! `zenav lease`. Who may command a robot: shown from the robot's own state, acquired and released as an operator.

use std::time::Duration;

use serde::Serialize;
use zenav_cloud::operator::{LeaseSession, ask_lease};
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{EdgeState, LeaseAction, LeaseState, Link};
use zenav_protocol::topics;

use super::{holder, status};
use crate::arguments::{self, positive};
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// The lease.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav lease\n  zenav lease acquire --for 60    nobody else drives for a minute\n  zenav lease forget              after the disk of the only orchestrator was lost"
)]
pub struct LeaseArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    /// Name to command under [default: operator-USER]
    #[arg(long, global = true, value_name = "NAME", value_parser = arguments::name)]
    holder: Option<String>,
    #[command(subcommand)]
    command: Option<LeaseCommand>,
}

#[derive(Debug, clap::Subcommand)]
enum LeaseCommand {
    /// Show who may command the robot (the default)
    Show,
    /// Take the operator's lease and keep it until Ctrl-C: no mission drives meanwhile
    Acquire {
        /// Release it after this time, s
        #[arg(long = "for", value_name = "SECS", value_parser = positive)]
        secs: Option<f64>,
    },
    /// Release the lease
    Release,
    /// Give up the goals of orchestrators that are lost for good (a lost disk), so that another one may lead
    Forget,
}

#[derive(Debug, Serialize)]
struct Shown {
    robot: String,
    #[serde(flatten)]
    lease: LeaseState,
    link: Link,
}

#[derive(Debug, Serialize)]
struct Granted {
    robot: String,
    holder: String,
    epoch: u64,
    ttl_secs: f64,
}

/// Shows, acquires or releases the lease.
///
/// # Errors
/// [`exit_code::REJECTED`] if another operator holds it, otherwise as every ask.
pub fn lease(args: &LeaseArgs) -> Outcome {
    let patience = args.robot.link.patience();
    let name = args.holder.clone().unwrap_or_else(holder);
    connect::on_robot(&args.robot, async |bus, robot| match &args.command {
        None | Some(LeaseCommand::Show) => {
            let state = state(&bus, &robot, patience).await?;
            output::value(
                args.output,
                &Shown {
                    robot,
                    lease: state.lease,
                    link: state.link,
                },
                show,
            )
        }
        Some(LeaseCommand::Acquire { secs }) => {
            let held = LeaseSession::acquire(&bus, &robot, &name, patience).await?;
            let grant = Granted {
                robot,
                holder: name,
                epoch: held.grant.epoch,
                ttl_secs: held.grant.ttl_secs,
            };
            output::value(args.output, &grant, |grant| {
                format!("{} may command {} (epoch {})", grant.holder, grant.robot, grant.epoch)
            })?;
            keep(&bus, held, &grant, *secs).await
        }
        Some(LeaseCommand::Release) => {
            let before = state(&bus, &robot, patience).await?;
            let held = before.lease.holder.as_deref() == Some(&name);
            ask_lease(&bus, &robot, &name, LeaseAction::Release, patience).await?;
            if !held {
                return Err(Failure::not_found(format!(
                    "{name} did not hold the lease of {robot}; {}",
                    words(&before.lease)
                )));
            }
            output::value(
                args.output,
                &serde_json::json!({ "robot": robot, "released": name }),
                |_| format!("{name} gave back {robot}"),
            )
        }
        Some(LeaseCommand::Forget) => {
            let before = state(&bus, &robot, patience).await?;
            let Some(leader) = before.lease.leader else {
                return Err(Failure::not_found(format!("no orchestrator keeps goals of {robot}")));
            };
            ask_lease(&bus, &robot, &name, LeaseAction::Forget, patience).await?;
            output::value(
                args.output,
                &serde_json::json!({ "robot": robot, "forgotten": leader }),
                |_| {
                    format!(
                        "any orchestrator may lead {robot}; given up are goals known only to {}",
                        leader.caught_up.join(", ")
                    )
                },
            )
        }
    })
}

/// Keeps a lease for so many seconds, or until Ctrl-C, and releases it.
async fn keep(bus: &Bus, held: LeaseSession, grant: &Granted, secs: Option<f64>) -> Outcome {
    let mut states = bus.latest(&topics::STATE, &[&grant.robot])?;
    let lost = async {
        while let Some(state) = states.next().await {
            if let Some(why) = status::lost(&held.grant, &grant.holder, &state.message) {
                return why;
            }
        }
        "the bus was closed".to_owned()
    };
    let time = secs.and_then(|secs| Duration::try_from_secs_f64(secs).ok());
    if time.is_none() {
        crate::output::note(format_args!("kept until Ctrl-C"));
    }
    let code = tokio::select! {
        () = tokio::time::sleep(time.unwrap_or(Duration::MAX)) => exit_code::OK,
        _ = tokio::signal::ctrl_c() => if time.is_some() { exit_code::INTERRUPTED } else { exit_code::OK },
        why = lost => return Err(Failure::rejected(why)),
    };
    held.release().await?;
    Ok(code)
}

/// The next state that the robot publishes.
pub(super) async fn state(bus: &Bus, robot: &str, within: Duration) -> Result<EdgeState, Failure> {
    let mut states = bus.latest(&topics::STATE, &[robot])?;
    match tokio::time::timeout(within, states.next()).await {
        Ok(Some(received)) => Ok(received.message),
        _ => Err(Failure::timeout(format!(
            "no state from {} in time",
            topics::STATE.key(&[robot])
        ))),
    }
}

fn show(shown: &Shown) -> String {
    let mut text = format!("{}: {}, link {:?}", shown.robot, words(&shown.lease), shown.link);
    if let Some(leader) = &shown.lease.leader {
        let may = leader.caught_up.join(" or ");
        text.push_str(&format!(
            "\ngoals are kept by {} (epoch {}); only {may} may lead next",
            leader.store, leader.epoch
        ));
    }
    text
}

fn words(lease: &LeaseState) -> String {
    match (&lease.holder, lease.role) {
        (Some(holder), Some(role)) => format!(
            "{holder} ({role:?}) holds epoch {}{}",
            lease.epoch,
            if lease.live { "" } else { ", lapsed" }
        ),
        _ => format!("nobody holds the lease (last epoch {})", lease.epoch),
    }
}

//! `zenav pose`. Shows a robot's pose, sets it, or searches for it in the whole map.

use std::time::Duration;

use clap::{Args, Subcommand};
use serde::Serialize;
use zenav_cloud::operator;
use zenav_protocol::bus::Bus;
use zenav_protocol::config_text::Expected;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::{Health, LocaliseAction, LocaliseRequest, PoseEstimate};
use zenav_protocol::topics;

use super::holder;
use crate::arguments;
use crate::connect::{self, RobotArgs};
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// A pose within this of the one set counts as accepted, m and rad: localisation refines it by some decimetres.
const TAKEN: (f64, f64) = (1.0, 0.6);

/// Show or set a robot's pose.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav pose show\n  zenav pose set -1.0 -0.5 0     m, m, rad\n  zenav pose search              without a guess"
)]
pub struct PoseArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: PoseCommand,
}

#[derive(Debug, Subcommand)]
enum PoseCommand {
    /// Show the robot's pose estimate, and whether it can be trusted
    Show,
    /// Set the robot's pose, to within some decimetres; the robot drops its plan and continues from there
    Set {
        /// Pose in the map: m, m, rad
        #[arg(num_args = 3, value_names = ["X", "Y", "YAW"], required = true, value_parser = arguments::finite)]
        pose: Vec<f64>,
    },
    /// Search for the robot in the whole map (with `mapping.poses = "localise"` or `"slam"`)
    Search,
}

#[derive(Debug, Serialize)]
struct Shown {
    robot: String,
    /// `None` if the robot has not published one yet.
    pose: Option<Pose2>,
    health: Health,
}

/// `zenav pose`.
///
/// # Errors
/// A pose that is not finite, a robot that is not found, a refusal by mapping.
pub fn pose(args: &PoseArgs) -> Outcome {
    match &args.command {
        PoseCommand::Show => act(args, LocaliseAction::Report, None),
        PoseCommand::Search => act(args, LocaliseAction::Global, None),
        PoseCommand::Set { pose } => {
            let [x, y, yaw] = pose[..] else {
                return Err(Failure::usage("expected X Y YAW"));
            };
            let pose = Pose2::new(x, y, yaw);
            if !pose.is_finite() {
                return Err(Failure::usage(format!("{x} {y} {yaw}: expected finite numbers")));
            }
            Expected::Angle
                .check(yaw)
                .map_err(|why| Failure::usage(format!("YAW {why}")))?;
            act(args, LocaliseAction::At, Some(pose))
        }
    }
}

fn act(args: &PoseArgs, action: LocaliseAction, pose: Option<Pose2>) -> Outcome {
    let patience = args.robot.link.patience();
    let shown = connect::on_bus(&args.robot.link.with_robot(), async |bus| {
        let robot = connect::find(&bus, args.robot.robot.as_deref()).await?;
        let (bus, robot) = (&bus, robot.as_str());
        let ask = async |epoch| {
            let request = LocaliseRequest { action, pose, epoch };
            bus.ask(&topics::LOCALISE, &[robot], &request, patience).await
        };
        let reply = match action {
            LocaliseAction::Report => ask(None).await?,
            // A robot whose pose is being reset must not drive meanwhile.
            LocaliseAction::At | LocaliseAction::Global => {
                operator::at_rest(bus, robot, &holder(), patience, ask).await?
            }
        };
        let newest = told(bus, robot, pose, patience).await?;
        if let (Some(pose), Some(newest)) = (pose, newest)
            && !is_about(pose, newest)
        {
            return Err(Failure::failed(format!(
                "{robot} was told, and did not take it: it takes itself to be at {} after {:.0} s; `zenav doctor` tells why",
                place(newest),
                patience.as_secs_f64()
            )));
        }
        Ok(Shown {
            robot: robot.to_owned(),
            pose: newest,
            health: reply.health,
        })
    })?;
    output::value(args.output, &shown, |shown| {
        let place = shown.pose.map_or_else(|| "no pose yet".to_owned(), place);
        format!("{}: {place}; {}", shown.robot, shown.health)
    })
}

/// The robot's pose estimate: as soon as it is near the pose that was set, at the latest after `within`.
async fn told(bus: &Bus, robot: &str, pose: Option<Pose2>, within: Duration) -> Result<Option<Pose2>, Failure> {
    let mut poses = bus.latest(&topics::POSE, &[robot])?;
    let mut newest = None;
    let until_there = async {
        while let Some(sample) = poses.next().await {
            let estimate: PoseEstimate = sample.message;
            newest = Some(estimate.map_from_base);
            if pose.is_none_or(|pose| is_about(pose, estimate.map_from_base)) {
                break;
            }
        }
    };
    // On timeout the newest estimate is returned as it is.
    let _ = tokio::time::timeout(within, until_there).await;
    Ok(newest)
}

fn is_about(told: Pose2, pose: Pose2) -> bool {
    told.distance(&pose) < TAKEN.0 && wrap_angle(told.yaw - pose.yaw).abs() < TAKEN.1
}

fn place(pose: Pose2) -> String {
    format!("x {:.3} m, y {:.3} m, yaw {:.3} rad", pose.x, pose.y, pose.yaw)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_connection_may_be_named_before_the_subcommand_and_after_it() {
        let link = ["--connect", "tcp/127.0.0.1:7450"];
        for words in [[&link[..], &["show"]], [&["show"], &link[..]]] {
            let parsed = crate::cli::parsed::<PoseArgs>(&words.concat());
            assert!(
                parsed.is_ok_and(|args| args.robot.link.endpoints() == [link[1]]),
                "{words:?}"
            );
        }
    }
}

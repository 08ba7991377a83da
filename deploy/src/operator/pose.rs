//! `zenav pose`. Where is the robot, where does a person say that it is, and is it to be looked for?

use clap::{Args, Subcommand};
use serde::Serialize;
use zenav_protocol::config_text::Expected;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{Health, LocaliseAction, LocaliseRequest, PoseEstimate};
use zenav_protocol::topics;

use super::change;
use crate::connect::{self, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Show or set a robot's pose.
#[derive(Debug, Args)]
#[command(
    after_help = "Examples:\n  zenav pose show\n  zenav pose set -1.0 -0.5 0     m, m, rad\n  zenav pose search              without a guess, in a known map"
)]
pub struct PoseArgs {
    #[command(subcommand)]
    command: PoseCommand,
}

#[derive(Debug, Subcommand)]
enum PoseCommand {
    /// Show where the robot takes itself to be, and whether that can be trusted
    Show(ShowArgs),
    /// Tell the robot where it is, to within some decimetres: it goes on from there, and drops its plan
    Set(SetArgs),
    /// Have the robot looked for in the whole map (with `mapping.poses = "localise"`)
    Search(ShowArgs),
}

#[derive(Debug, Args)]
struct ShowArgs {
    /// Connection and robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

#[derive(Debug, Args)]
struct SetArgs {
    /// Pose in the map: m, m, rad
    #[arg(num_args = 3, value_names = ["X", "Y", "YAW"], required = true, value_parser = connect::finite)]
    pose: Vec<f64>,
    #[command(flatten)]
    show: ShowArgs,
}

#[derive(Debug, Serialize)]
struct Shown {
    robot: String,
    /// Without one, the robot has not published it yet.
    pose: Option<Pose2>,
    health: Health,
}

/// `zenav pose`.
///
/// # Errors
/// A pose that is not finite, a robot that is not there, and what mapping refuses.
pub fn pose(args: &PoseArgs) -> Outcome {
    match &args.command {
        PoseCommand::Show(args) => act(args, LocaliseAction::Report, None),
        PoseCommand::Search(args) => act(args, LocaliseAction::Global, None),
        PoseCommand::Set(args) => {
            let [x, y, yaw] = args.pose[..] else {
                return Err(Failure::usage("expected X Y YAW"));
            };
            let pose = Pose2::new(x, y, yaw);
            if !pose.is_finite() {
                return Err(Failure::usage(format!("{x} {y} {yaw}: expected finite numbers")));
            }
            Expected::Angle
                .check(yaw)
                .map_err(|why| Failure::usage(format!("YAW {why}")))?;
            act(&args.show, LocaliseAction::At, Some(pose))
        }
    }
}

fn act(args: &ShowArgs, action: LocaliseAction, pose: Option<Pose2>) -> Outcome {
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
            // A robot that is told to be somewhere else must not drive meanwhile.
            LocaliseAction::At | LocaliseAction::Global => change::at_rest(bus, robot, patience, ask).await?,
        };
        let mut poses = bus.latest(&topics::POSE, &[robot])?;
        let newest = tokio::time::timeout(patience, poses.next()).await.ok().flatten();
        Ok(Shown {
            robot: robot.to_owned(),
            pose: newest.map(|sample| {
                let estimate: PoseEstimate = sample.message;
                estimate.map_from_base
            }),
            health: reply.health,
        })
    })?;
    output::value(args.output, &shown, |shown| {
        let place = shown.pose.map_or_else(
            || "no pose yet".to_owned(),
            |pose| format!("x {:.3} m, y {:.3} m, yaw {:.3} rad", pose.x, pose.y, pose.yaw),
        );
        format!("{}: {place}; {}", shown.robot, shown.health)
    })?;
    Ok(exit_code::OK)
}

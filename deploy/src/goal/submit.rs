//! Submitting a goal. Builds the request from the command line; its id is made before it is first sent.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use clap::ValueEnum;
use zenav_behaviour_tree::inline;
use zenav_mission::trees::{self, NoTree};
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::config_text::Expected;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{DrivingProfile, GoalPhase, GoalPoint, GoalReply, GoalRequest, OnBusy, Refusal};
use zenav_protocol::topics;

use super::{Report, follow, phase_code};
use crate::arguments::{finite, heading, name, positive, whole};
use crate::completion;
use crate::connect::{self, RobotArgs, fresh_id};
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::inspect::bt::includer;
use crate::leadership;
use crate::live_map::LiveMap;
use crate::output::{self, Format};

/// A goal on the command line.
#[derive(Debug, clap::Args)]
pub(super) struct SubmitArgs {
    /// Map x, m
    #[arg(value_parser = finite, requires = "y", required_unless_present_any = ["place", "tree", "waypoint"], conflicts_with_all = ["place", "waypoint"])]
    x: Option<f64>,
    /// Map y, m
    #[arg(value_parser = finite, required_unless_present_any = ["place", "tree", "waypoint"])]
    y: Option<f64>,
    /// Final heading, rad
    #[arg(value_parser = heading)]
    yaw: Option<f64>,
    /// Named place of the world
    #[arg(long, conflicts_with = "waypoint", add = completion::places())]
    place: Option<String>,
    /// Behaviour tree to run: an XML file or the name of a shipped tree; a place or waypoints become its goal
    #[arg(long, value_name = "FILE", add = completion::behaviour_trees())]
    tree: Option<String>,
    /// Waypoint to pass through; may be repeated, in order
    #[arg(long, value_name = "X,Y[,YAW]", allow_hyphen_values = true, value_parser = waypoint)]
    waypoint: Vec<GoalPoint>,
    /// Blackboard entry for the tree: JSON or plain text
    #[arg(long, value_name = "NAME=VALUE", requires = "tree", value_parser = entry)]
    blackboard: Vec<(String, serde_json::Value)>,
    /// Id of the goal; sending the same id again is idempotent [default: generated]
    #[arg(long, value_parser = name)]
    id: Option<String>,
    /// What to do while another goal is running
    #[arg(long, value_enum, default_value_t)]
    on_busy: OnBusyArg,
    /// Queue priority, highest first
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = whole::<i32>)]
    priority: i32,
    /// Group of robots instead of one: the nearest free robot takes the goal
    #[arg(long, value_name = "NAME", conflicts_with = "robot", value_parser = name)]
    group: Option<String>,
    /// Abort the goal after this time, s
    #[arg(long, value_name = "SECS", value_parser = positive)]
    deadline: Option<f64>,
    /// Distance that counts as reached, m
    #[arg(long, value_name = "M", value_parser = positive)]
    tolerance: Option<f64>,
    /// Driving profile, `fastest` or `economy` [default: the deployment's choice]
    #[arg(long)]
    profile: Option<DrivingProfile>,
    /// Wait for the end; Ctrl-C detaches (exit 130) and the robot drives on, `goal cancel` ends the goal
    #[arg(long)]
    wait: bool,
}

/// What to do while another goal is running.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum OnBusyArg {
    /// Wait in the queue
    #[default]
    Queue,
    /// Cancel the running goal
    Preempt,
    /// Refuse the new goal
    Reject,
}

fn waypoint(text: &str) -> Result<GoalPoint, String> {
    let numbers = text
        .split(',')
        .map(|part| finite(part.trim()))
        .collect::<Result<Vec<f64>, String>>()?;
    match numbers.as_slice() {
        [x, y] => Ok(GoalPoint {
            x: *x,
            y: *y,
            yaw: None,
        }),
        [x, y, yaw] => Expected::Angle.check(*yaw).map(|yaw| GoalPoint {
            x: *x,
            y: *y,
            yaw: Some(yaw),
        }),
        _ => Err("expected X,Y or X,Y,YAW".to_owned()),
    }
}

fn entry(text: &str) -> Result<(String, serde_json::Value), String> {
    let (name, value) = text.split_once('=').ok_or("expected NAME=VALUE")?;
    let value = serde_json::from_str(value).unwrap_or_else(|_| serde_json::Value::from(value));
    Ok((name.to_owned(), value))
}

impl SubmitArgs {
    fn request(&self) -> Result<GoalRequest, Failure> {
        Ok(GoalRequest {
            id: Some(self.id.clone().unwrap_or_else(|| fresh_id("goal"))),
            x: self.x,
            y: self.y,
            yaw: self.yaw,
            place: self.place.clone(),
            waypoints: self.waypoint.clone(),
            tree: self.tree.as_deref().map(tree).transpose()?,
            blackboard: self.blackboard.iter().cloned().collect::<BTreeMap<_, _>>(),
            on_busy: match self.on_busy {
                OnBusyArg::Queue => OnBusy::Queue,
                OnBusyArg::Preempt => OnBusy::Preempt,
                OnBusyArg::Reject => OnBusy::Reject,
            },
            priority: self.priority,
            deadline_secs: self.deadline,
            tolerance: self.tolerance,
            profile: self.profile,
        })
    }
}

/// The text of a tree file with its includes, or a name that the mission resolves.
fn tree(text: &str) -> Result<String, Failure> {
    let path = Path::new(text);
    if path.is_file() {
        let most = topics::GOAL.max_bytes;
        let whole =
            inline(text, &files::text_within(path, most as u64)?, &mut includer(text)).map_err(Failure::usage)?;
        if whole.len() > most {
            return Err(Failure::usage(format!(
                "{text}: {} bytes with what it includes, a goal may carry at most {most}",
                whole.len()
            )));
        }
        Ok(whole)
    } else if Id::new(text).is_ok() {
        Ok(text.to_owned())
    } else {
        Err(Failure::not_found(format!("no tree file {text}")))
    }
}

/// A mission's error message for a tree sent as text, with the file name before line and column. Line numbers match the file itself;
/// included trees follow it.
fn in_file(file: &str, sent: &str, reason: &str) -> String {
    let is_whole = std::fs::read_to_string(file).is_ok_and(|text| text == sent);
    let name = if is_whole {
        file.to_owned()
    } else {
        format!("{file} with what it includes")
    };
    let lines = reason.lines().map(|line| match line.strip_prefix("tree:") {
        Some(place) => format!("{name}:{place}"),
        None => line.to_owned(),
    });
    lines.collect::<Vec<_>>().join("\n")
}

pub(super) fn run(robot: &RobotArgs, format: Format, args: &SubmitArgs) -> Outcome {
    let request = args.request()?;
    let patience = robot.link.patience();
    match &args.group {
        Some(group) => connect::on_bus(&robot.link, async |bus| {
            connect::find_group(&bus, group).await?;
            submit(&bus, group, &request, patience, args, format).await
        }),
        None => connect::on_robot(robot, async |bus, robot| {
            submit(&bus, &robot, &request, patience, args, format).await
        }),
    }
}

/// Sends a goal to a robot or a group.
async fn submit(
    bus: &Bus,
    to: &str,
    request: &GoalRequest,
    patience: Duration,
    args: &SubmitArgs,
    format: Format,
) -> Outcome {
    let id = request.id.clone().unwrap_or_default();
    let report = match leadership::ask(bus, &topics::GOAL, to, request, patience).await {
        Ok(reply) => {
            let robot = reply.robot.as_deref().unwrap_or(to);
            if args.group.is_some() {
                crate::output::note(format_args!("zenav: {robot} takes goal {}", reply.id));
            }
            if args.wait && !reply.state.is_end() {
                // The mission keeps the last state for late subscribers: no end is missed.
                return finish(bus, robot, &reply, format).await;
            }
            Report::new(robot, &reply.id, reply.state, reply.reason)
        }
        Err(AskError::Refused(Refusal::Rejected { reason, nearest_free })) => Report {
            nearest_free,
            ..Report::new(to, &id, GoalPhase::Rejected, Some(reason))
        },
        Err(AskError::Refused(Refusal::BadRequest { reason })) => {
            let unknown = request.tree.as_deref().map(trees::build);
            if let Some(Err(NoTree::Unknown(_))) = unknown {
                return Err(Failure::not_found(reason));
            }
            let reason = match (&args.tree, &request.tree) {
                (Some(file), Some(sent)) => in_file(file, sent, &reason),
                _ => reason,
            };
            return Err(AskError::Refused(Refusal::BadRequest { reason }).into());
        }
        Err(error) => return Err(error.into()),
    };
    output::value(format, &report, Report::line)?;
    Ok(phase_code(report.state))
}

async fn finish(bus: &Bus, robot: &str, reply: &GoalReply, format: Format) -> Outcome {
    let watch = follow::Watch::new(bus, robot, &reply.id)?;
    let mut progress = follow::Progress::new();
    progress.draw(LiveMap::new(bus, robot)?);
    progress.say(&format!(
        "{} {:?}; Ctrl-C detaches, the robot keeps driving",
        reply.id, reply.state
    ));
    watch.until_end(format, |state| progress.show(state)).await
}

#[cfg(test)]
mod tests {
    use super::super::tests::parse;
    use super::super::{GoalArgs, GoalCommand};
    use super::*;

    fn request(words: &[&str]) -> Result<GoalRequest, String> {
        let words: Vec<&str> = std::iter::once("submit").chain(words.iter().copied()).collect();
        let GoalArgs {
            command: GoalCommand::Submit(args),
            ..
        } = parse(&words).map_err(|error| error.to_string())?
        else {
            return Err("another command".into());
        };
        args.request().map_err(|failure| failure.to_string())
    }

    #[test]
    fn a_tree_may_run_for_a_place_to_go_to() {
        let goal = request(&["1", "2", "--tree", "navigate"]).unwrap();
        assert_eq!((goal.x, goal.tree.as_deref()), (Some(1.0), Some("navigate")));
        let goal = request(&["--place", "sink", "--tree", "navigate"]).unwrap();
        assert_eq!(
            (goal.place.as_deref(), goal.tree.as_deref()),
            (Some("sink"), Some("navigate"))
        );
        assert!(request(&["1", "2", "--place", "sink", "--tree", "navigate"]).is_err());
    }

    #[test]
    fn negative_numbers_are_places_not_options() {
        let goal = request(&["-1.46", "-3.12", "-1.57", "--tolerance", "0.2"]).unwrap();
        assert_eq!(
            (goal.x, goal.y, goal.yaw, goal.tolerance),
            (Some(-1.46), Some(-3.12), Some(-1.57), Some(0.2))
        );
        assert!(goal.id.unwrap().starts_with("goal-"));
    }

    #[test]
    fn exactly_one_target_is_taken() {
        assert_eq!(
            request(&["--place", "sink", "--on-busy", "preempt"]).unwrap().on_busy,
            OnBusy::Preempt
        );
        assert_eq!(
            request(&["--waypoint", "-1,2", "--waypoint", "3,4,0.5"])
                .unwrap()
                .waypoints[0],
            GoalPoint {
                x: -1.0,
                y: 2.0,
                yaw: None
            }
        );
        let driven = request(&["--place", "sink", "--tree", "kitchen"]).unwrap();
        assert!(
            driven.place.is_some() && driven.tree.is_some(),
            "a tree may drive to a goal"
        );
        for bad in [
            &["1"][..],
            &[],
            &["1", "2", "--place", "sink"],
            &["NaN", "0"],
            &["1", "inf"],
            &["1", "2", "--deadline", "-1"],
            &["1", "2", "--id", "a/b"],
            &["1", "2", "90"],
            &["--waypoint", "1,2,90"],
        ] {
            assert!(request(bad).is_err(), "{bad:?}");
        }
    }

    #[test]
    fn what_a_tree_includes_goes_with_it() {
        let folder = tempfile::tempdir().unwrap();
        let file = |name: &str, inside: &str| {
            let path = folder.path().join(name);
            std::fs::write(&path, format!("<root BTCPP_format=\"4\">{inside}</root>")).unwrap();
            path.to_str().unwrap().to_owned()
        };
        file("part.xml", "<BehaviorTree ID=\"P\"><AlwaysSuccess/></BehaviorTree>");
        let main = "<include path=\"part.xml\"/><BehaviorTree ID=\"M\"><SubTree ID=\"P\"/></BehaviorTree>";
        let tree = request(&["--tree", &file("main.xml", main)]).unwrap().tree.unwrap();
        assert!(zenav_mission::trees::build(&tree).is_ok(), "{tree}");
        let error = request(&["--tree", &file("lost.xml", "<include path=\"none.xml\"/>")]).unwrap_err();
        assert!(error.contains("none.xml") && error.contains("lost.xml"), "{error}");
        let error = request(&["--tree", &file("device.xml", "<include path=\"/dev/zero\"/>")]).unwrap_err();
        assert!(error.contains("expected a file"), "{error}");
    }

    #[test]
    fn a_leaf_that_the_mission_does_not_know_is_told_with_the_file_and_the_nearest_name() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("patrol.xml");
        let (include, tree) = (
            "<include path=\"kitchen.xml\"/>",
            "<BehaviorTree ID=\"M\"><Spinn/></BehaviorTree>",
        );
        for (more, name) in [("", "patrol.xml"), (include, "patrol.xml with what it includes")] {
            std::fs::write(&file, format!("<root BTCPP_format=\"4\">{more}\n{tree}</root>")).unwrap();
            let file = file.to_str().unwrap();
            let sent = request(&["--tree", file]).unwrap().tree.unwrap();
            let refused = zenav_mission::trees::build(&sent).unwrap_err().to_string();
            let told = in_file(file, &sent, &refused);
            let expected = format!("{name}:2:22: unknown node `Spinn`: expected a registered node, perhaps `Spin`");
            assert!(told.contains(&expected), "{told}");
        }
    }

    #[test]
    fn a_tree_is_a_file_or_a_name() {
        assert_eq!(
            request(&["--tree", "kitchen", "--blackboard", "n=3", "--blackboard", "s=a b"])
                .unwrap()
                .blackboard["s"],
            serde_json::json!("a b")
        );
        assert!(request(&["--tree", "no/such.xml"]).unwrap_err().contains("no/such.xml"));
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), "<root/>").unwrap();
        assert_eq!(
            request(&["--tree", file.path().to_str().unwrap()])
                .unwrap()
                .tree
                .as_deref(),
            Some("<root/>")
        );
    }
}

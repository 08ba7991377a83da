//! `zenav stop` and `zenav resume`. Stops and releases a robot by asking the robot itself: needs no lease and no cloud, and on the robot's
//! own endpoint no router.

use std::collections::BTreeMap;
use std::time::Duration;

use serde::Serialize;
use tokio::task::JoinSet;
use tokio::time::Instant;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{ResumeRequest, StopReply, StopRequest};
use zenav_protocol::topics;

use super::holder;
use crate::connect::{self, LinkArgs, RobotArgs};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};
use crate::tasks::boxed;

/// A robot publishes its state within this time.
const STATE_WITHIN: Duration = Duration::from_millis(400);

/// Stop or resume.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav stop\n  zenav stop --all\n  zenav stop --connect tcp/127.0.0.1:7450    on the robot's own endpoint: router and cloud may be gone\n  zenav resume"
)]
pub struct StopArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Every robot that is found
    #[arg(long, conflicts_with = "robot")]
    all: bool,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

#[derive(Debug, Serialize)]
struct Stopped {
    robot: String,
    stopped: bool,
}

/// Stops a robot: it brakes, discards its plan, and stays stopped (also across a restart) until resumed.
///
/// # Errors
/// If the robot does not answer, or is not found.
pub fn stop(args: &StopArgs) -> Outcome {
    act(args, true)
}

/// Releases a stopped robot: it may take a new plan from its present pose.
///
/// # Errors
/// If the robot does not answer, or is not found.
pub fn resume(args: &StopArgs) -> Outcome {
    act(args, false)
}

fn act(args: &StopArgs, stop: bool) -> Outcome {
    let patience = args.robot.link.patience();
    let ask = |bus: &Bus, robot: &str| ask(bus.clone(), robot.to_owned(), stop, patience);
    let answers = connect::on_bus(&args.robot.link.with_robot(), async |bus| {
        if args.all {
            // All in parallel: a silent robot does not delay the others.
            connect::sees_all(&bus)?;
            let mut asked = JoinSet::new();
            for robot in connect::robots(&bus).await?.into_keys() {
                let answer = ask(&bus, &robot);
                asked.spawn(async move { (robot, answer.await) });
            }
            let mut answers = BTreeMap::new();
            while let Some(answer) = asked.join_next().await {
                let (robot, answer) = answer.map_err(Failure::failed)?;
                answers.insert(robot, answer);
            }
            if answers.is_empty() {
                return Err(connect::none_shows(&bus));
            }
            return Ok(answers);
        }
        let (robot, answer) = match &args.robot.robot {
            // A named robot is asked at once, in parallel with looking it up.
            Some(robot) => {
                let mut answer = std::pin::pin!(ask(&bus, robot));
                let answer = tokio::select! {
                    biased;
                    answer = &mut answer => answer,
                    // The same request goes on: a second one would count as another stop, or lift a later one.
                    found = connect::find(&bus, Some(robot)) => {
                        found?;
                        answer.await
                    }
                };
                (robot.clone(), answer)
            }
            None => {
                let robot = connect::find_or(&bus, None, |robots| both_ways(robots, stop)).await?;
                let answer = ask(&bus, &robot).await;
                (robot, answer)
            }
        };
        if answer.is_ok() {
            warn_if_not_stored(&bus, &robot).await;
        }
        Ok(BTreeMap::from([(robot, answer)]))
    });
    let answers = answers.map_err(|failure| at_its_endpoint(failure, stop, &args.robot.link))?;
    let mut rows = Vec::new();
    let mut failure = None;
    for (robot, answer) in answers {
        match answer {
            Ok(reply) => rows.push(Stopped {
                robot,
                stopped: reply.stopped,
            }),
            Err(error) => {
                let error = Failure::from(error).about(&robot);
                failure = Some(at_its_endpoint(error, stop, &args.robot.link));
            }
        }
    }
    let line = |row: &Stopped| format!("{} {}", row.robot, if row.stopped { "stopped" } else { "may go" });
    let lines = |rows: &[Stopped]| rows.iter().map(line).collect::<Vec<_>>().join("\n");
    match rows.as_slice() {
        [] => Ok(exit_code::OK),
        [one] if !args.all => output::value(args.output, one, line),
        several => output::values(args.output, several, lines),
    }?;
    match failure {
        Some(failure) => Err(failure),
        // A robot in the wrong state after the request is a failure.
        None if rows.iter().any(|row| row.stopped != stop) => Ok(exit_code::FAILED),
        None => Ok(exit_code::OK),
    }
}

/// Adds the way that needs no router, if the robot was not reached.
fn at_its_endpoint(failure: Failure, stop: bool, link: &LinkArgs) -> Failure {
    if ![exit_code::TIMEOUT, exit_code::NOT_FOUND].contains(&failure.code) {
        return failure;
    }
    let verb = if stop { "stop" } else { "resume" };
    let protocol = link.identity.identity.as_ref().map_or("tcp", |_| "quic");
    let cure = format!("`zenav {verb} --connect {protocol}/HOST:7450`");
    Failure {
        message: format!("{}; the robot's own endpoint needs no router: {cure}", failure.message),
        ..failure
    }
}

/// The commands for all robots and for one.
fn both_ways(robots: &[&str], stop: bool) -> String {
    let verb = if stop { "stop" } else { "resume" };
    let first = robots.first().copied().unwrap_or_default();
    format!("`zenav {verb} --all` for all, `zenav {verb} --robot {first}` for one")
}

/// Asks a robot to stop, or to resume.
async fn ask(bus: Bus, robot: String, stop: bool, patience: Duration) -> Result<StopReply, AskError> {
    if stop {
        let request = StopRequest::new(holder());
        bus.ask(&topics::STOP, &[&robot], &request, patience).await
    } else {
        release(&bus, &robot, holder(), patience).await
    }
}

/// Asks a robot to resume, up to the newest stop that its next state shows: a later stop stays in force, however late the request arrives.
pub(super) async fn release(bus: &Bus, robot: &str, by: String, patience: Duration) -> Result<StopReply, AskError> {
    let began = Instant::now();
    let key = topics::STATE.key(&[robot]);
    let mut states = bus
        .latest(&topics::STATE, &[robot])
        .map_err(|error| AskError::Unaskable {
            key: key.clone(),
            reason: error.to_string(),
        })?;
    let Ok(state) = tokio::time::timeout(patience, states.next()).await else {
        return Err(AskError::Timeout { key });
    };
    let state = state.ok_or(AskError::Closed)?.message;
    let request = ResumeRequest::new(by, state.boot_id, state.stops);
    let left = patience.saturating_sub(began.elapsed()).max(STATE_WITHIN);
    bus.ask(&topics::RESUME, &[robot], &request, left).await
}

/// Warns if the robot obeyed but cannot store the stop, as its next state reports.
async fn warn_if_not_stored(bus: &Bus, robot: &str) {
    let Ok(mut states) = bus.latest(&topics::STATE, &[robot]) else {
        return;
    };
    if let Ok(Some(state)) = tokio::time::timeout(STATE_WITHIN, states.next()).await
        && let Some(why) = state.message.faults.storage
    {
        crate::output::note(format_args!(
            "warning: {robot} has obeyed, but it is not stored: {why}; a restart of its edge would forget it"
        ));
    }
}

/// Stops a robot over all links at once: over `bus`, and over a separate link to each endpoint.
///
/// # Errors
/// If no link brought a confirmation within the link's patience.
pub(super) async fn everywhere(bus: &Bus, link: &LinkArgs, robot: &str) -> Result<(), Failure> {
    let patience = link.patience();
    let mut links = JoinSet::new();
    let request = StopRequest::new(holder());
    links.spawn(boxed(confirmed(
        bus.clone(),
        robot.to_owned(),
        request.clone(),
        patience,
    )));
    for endpoint in link.endpoints() {
        let (robot, request, mut link) = (robot.to_owned(), request.clone(), link.clone());
        link.connect = vec![endpoint];
        links.spawn(boxed(async move {
            confirmed(connect::open(&link).await?, robot, request, patience).await
        }));
    }
    let mut failure = None;
    let end = Instant::now() + patience;
    while let Ok(Some(link)) = tokio::time::timeout_at(end, links.join_next()).await {
        match link {
            Ok(Ok(())) => return Ok(()),
            Ok(Err(error)) => failure = Some(error),
            Err(error) => failure = Some(Failure::failed(error.to_string())),
        }
    }
    let silent = || Failure::timeout("no answer in time");
    Err(failure.filter(|_| links.is_empty()).unwrap_or_else(silent))
}

/// The same request over every link counts as one stop.
async fn confirmed(bus: Bus, robot: String, request: StopRequest, within: Duration) -> Result<(), Failure> {
    match bus.ask(&topics::STOP, &[&robot], &request, within).await?.stopped {
        true => Ok(()),
        false => Err(Failure::failed("it says that it is not stopped")),
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::bus::BusConfig;

    use super::*;
    use crate::config::IdentityArgs;

    #[test]
    fn several_robots_are_refused_with_the_commands_for_all_and_for_one() {
        assert_eq!(
            both_ways(&["anna", "bert"], true),
            "`zenav stop --all` for all, `zenav stop --robot anna` for one"
        );
        assert!(both_ways(&["anna", "bert"], false).starts_with("`zenav resume --all` "));
    }

    #[test]
    fn a_robot_that_is_not_reached_is_told_with_its_own_endpoint() {
        let mut link = crate::cli::parsed::<LinkArgs>(&[]).unwrap();
        let told = |code, stop, link: &LinkArgs| at_its_endpoint(Failure::new(code, "no answer"), stop, link).message;
        let cure = "no answer; the robot's own endpoint needs no router: `zenav stop --connect tcp/HOST:7450`";
        assert_eq!(told(exit_code::TIMEOUT, true, &link), cure);
        assert_eq!(told(exit_code::REJECTED, true, &link), "no answer");
        link.identity.identity = Some("operator.anna".into());
        let secured = told(exit_code::NOT_FOUND, false, &link);
        assert!(
            secured.ends_with("`zenav resume --connect quic/HOST:7450`"),
            "{secured}"
        );
    }

    async fn endpoint() -> (Bus, String) {
        let config = BusConfig {
            connect: Vec::new(),
            listen: vec!["tcp/127.0.0.1:0".to_owned()],
            ..BusConfig::default()
        };
        let bus = Bus::open(config).await.unwrap();
        let own = bus.endpoints().await.into_iter().next().unwrap();
        (bus, own)
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn a_robot_that_the_open_link_does_not_reach_is_stopped_over_its_own_endpoint() {
        let (nobody, dead_end) = endpoint().await;
        let (robot, own) = endpoint().await;
        let mut server = robot.serve(&topics::STOP, &["neo"]).unwrap();
        let serving = tokio::spawn(async move { server.next().await.unwrap().reply(&StopReply { stopped: true }) });
        let link = |connect| LinkArgs {
            connect,
            timeout: 30.0,
            identity: IdentityArgs::default(),
            namespace: String::new(),
        };
        let open = connect::open(&link(vec![dead_end.clone()])).await.unwrap();
        everywhere(&open, &link(vec![dead_end, own]), "neo").await.unwrap();
        serving.await.unwrap();
        for bus in [open, robot, nobody] {
            bus.close().await;
        }
    }
}

//! `zenav doctor`. Checks whether a deployment is complete and healthy: listens for two seconds, asks every component for its info, and
//! gives advice on what is wrong.

use std::io::IsTerminal as _;
use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use tokio::time::{Instant, timeout_at};
use zenav_protocol::bus::{Bus, Latest, RawSubscription, Subscription};
use zenav_protocol::messages::{Event, EventKind, InfoRequest};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::check::{Check, Verdict};
use super::diagnosis::{self, ClockSeen, Heard, Robot, hosts};
use super::parts::{NOT_ADMITTED, check_admitted, only_robots_answer, parts};
use crate::connect::{self, LinkArgs, RobotArgs};
use crate::drawing::terminal;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Listening time.
const LISTEN: Duration = Duration::from_secs(2);
/// Most events of a robot that wait to be read.
const EVENTS: usize = 1024;
/// Longest wait for a component's info.
const ANSWER_WITHIN: Duration = Duration::from_millis(1500);

/// Check a running deployment.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav doctor\n  zenav doctor -o json                        for scripts; exit code 1 where something failed\n  zenav doctor --connect tcp/127.0.0.1:7450   at the robot itself"
)]
pub struct DoctorArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

#[derive(Serialize)]
struct Report {
    healthy: bool,
    checks: Vec<Check>,
}

/// Checks a deployment: exit 0 if nothing fails (warnings do not count), 1 if something does, 4 without a router.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for a named robot that is not found.
pub fn doctor(args: &DoctorArgs) -> Outcome {
    let examined = connect::on_bus(&args.robot.link, async |bus| {
        examine(&bus, &args.robot.link, args.robot.robot.as_deref()).await
    });
    let (checks, code) = match examined {
        Ok(checks) => {
            let failed = checks.iter().any(|check| check.verdict == Verdict::Fail);
            (checks, if failed { exit_code::FAILED } else { exit_code::OK })
        }
        Err(failure) if failure.code == exit_code::CANNOT_CONNECT => (
            vec![Check::fail(
                "router",
                "link",
                failure.to_string(),
                "start one, or name its endpoint with --connect",
            )],
            exit_code::CANNOT_CONNECT,
        ),
        Err(failure) => return Err(failure),
    };
    let report = Report {
        healthy: code == exit_code::OK,
        checks,
    };
    output::value(args.output, &report, text)?;
    Ok(code)
}

async fn examine(bus: &Bus, link: &LinkArgs, wanted: Option<&str>) -> Result<Vec<Check>, Failure> {
    if wanted.is_some()
        && let Err(failure) = connect::find(bus, wanted).await
    {
        check_admitted(link, parts(bus).await?.iter().any(|part| part.answers))?;
        return Err(failure);
    }
    let mut names: Vec<String> = connect::robots(bus).await?.into_keys().collect();
    names.retain(|name| wanted.is_none_or(|wanted| wanted == name));
    match wanted {
        // Known only by its state: this connection is the robot's own endpoint.
        Some(wanted) if names.is_empty() => names.push(wanted.to_owned()),
        None if names.is_empty() => names.extend(connect::find(bus, None).await.ok()),
        _ => {}
    }
    let is_robot_missing = names.is_empty();
    let end = Instant::now() + LISTEN;
    let clock = async { clock(bus, end).await };
    let robots = async {
        let mut tasks = tokio::task::JoinSet::new();
        for name in names {
            let bus = bus.clone();
            tasks.spawn(async move { look(&bus, name, end).await });
        }
        let mut found = Vec::new();
        while let Some(robot) = tasks.join_next().await {
            found.push(robot.map_err(Failure::failed)??);
        }
        found.sort_by(|a: &Robot, b: &Robot| a.name.cmp(&b.name));
        Ok::<_, Failure>(found)
    };
    let (clock, robots) = tokio::join!(clock, robots);
    let parts = parts(bus).await?;
    if check_admitted(link, parts.iter().any(|part| part.answers)).is_err() {
        let seen = "nobody answers this identity, not even the router";
        return Ok(vec![Check::fail("router", "identity", seen, NOT_ADMITTED)]);
    }
    let is_at_robot = only_robots_answer(&parts);
    let mut checks = vec![diagnosis::link(is_at_robot)];
    if is_robot_missing {
        checks.push(Check::fail(
            "robots",
            "robots",
            "none shows",
            "start one: `zenav edge`, or a whole deployment: `zenav up`",
        ));
    }
    for robot in robots? {
        checks.extend(diagnosis::judge(&robot, LISTEN));
    }
    // Workers do not show on a robot's own endpoint.
    if !is_at_robot {
        let workers = topics::alive_key(topics::ALIVE_WORKER, &["motion", "*"]);
        let workers = bus.list_alive(workers, Duration::from_millis(500)).await?;
        checks.push(diagnosis::workers("motion", workers.len()));
    }
    checks.extend(hosts::judge(&parts));
    checks.push(diagnosis::clock(&clock?));
    Ok(checks)
}

async fn look(bus: &Bus, name: String, end: Instant) -> Result<Robot, Failure> {
    let chunks = [name.as_str()];
    let mut states = bus.latest(&topics::STATE, &chunks)?;
    let mut poses = bus.latest(&topics::POSE, &chunks)?;
    let mut scans = bus.raw_subscribe(&topics::SCAN.key(&chunks), 16)?;
    let mut heartbeats = bus.raw_subscribe(&topics::HEARTBEAT.key(&chunks), 16)?;
    let mut maps = bus.latest(&topics::MAP_INFO, &chunks)?;
    let mut missions = bus.latest(&topics::MISSION, &chunks)?;
    let mut localisations = bus.latest(&topics::LOCALISATION, &chunks)?;
    let mut events = bus.subscribe(&topics::EVENT, &chunks, EVENTS)?;
    let (state, pose, scan, heartbeat, guard_reason, edge, cloud) = tokio::join!(
        heard(&mut states, end),
        heard(&mut poses, end),
        heard(&mut scans, end),
        heard(&mut heartbeats, end),
        guard_reason(&mut events, end),
        bus.ask_all(&topics::EDGE_INFO, &chunks, &InfoRequest {}, ANSWER_WITHIN),
        bus.ask_all(&topics::CLOUD_INFO, &chunks, &InfoRequest {}, ANSWER_WITHIN),
    );
    let answers = edge.into_iter().chain(cloud).flatten();
    let infos = answers.filter_map(|answer| answer.result.ok()).collect();
    let alive = connect::robots(bus).await?.remove(&name).unwrap_or_default();
    Ok(Robot {
        alive,
        state,
        pose,
        scan,
        heartbeat,
        guard_reason,
        mission: missions.take(),
        map: maps.take(),
        localisation: localisations.take(),
        infos,
        name,
    })
}

/// A source of messages to listen to.
trait Arrivals {
    type Item;
    fn next(&mut self) -> impl Future<Output = Option<Self::Item>> + Send;
}

impl<T: DeserializeOwned + Send> Arrivals for Latest<T> {
    type Item = T;
    async fn next(&mut self) -> Option<T> {
        self.next().await.map(|received| received.message)
    }
}

/// Scans are large: only their arrival matters here.
impl Arrivals for RawSubscription {
    type Item = ();
    async fn next(&mut self) -> Option<()> {
        self.next().await.map(drop)
    }
}

/// Counts arrivals until `end`.
async fn heard<A: Arrivals>(topic: &mut A, end: Instant) -> Heard<A::Item> {
    let mut heard = Heard::default();
    let mut newest = None;
    while let Ok(Some(value)) = timeout_at(end, topic.next()).await {
        if let Some(earlier) = heard.last.replace(value)
            && heard.first.is_none()
        {
            heard.first = Some(earlier);
        }
        heard.count += 1;
        newest = Some(Instant::now());
    }
    heard.age = newest.map(|at| at.elapsed());
    heard
}

/// What the collision monitor's last verdict was based on, by the events that the robot keeps and those until `end`.
async fn guard_reason(events: &mut Subscription<Event>, end: Instant) -> Option<String> {
    let mut last = None;
    while let Ok(Some(event)) = timeout_at(end, events.next()).await {
        if let EventKind::Guard { reason, .. } = event.message.kind {
            last = Some(reason);
        }
    }
    last
}

async fn clock(bus: &Bus, end: Instant) -> Result<ClockSeen, Failure> {
    let mut clocks = bus.latest(&topics::SIM_CLOCK, &[])?;
    let mut first: Option<(Instant, Stamp)> = None;
    let mut last: Option<Stamp> = None;
    let mut steps_back = 0;
    while let Ok(Some(value)) = timeout_at(end, clocks.next()).await {
        let stamp = value.message.stamp;
        first.get_or_insert((Instant::now(), stamp));
        steps_back += u32::from(last.is_some_and(|last| last.secs_since(stamp) > 1.0));
        last = Some(stamp);
    }
    let rate = first
        .zip(last)
        .map(|((start, from), to)| to.secs_since(from) / end.duration_since(start).as_secs_f64().max(1e-3));
    Ok(ClockSeen {
        simulated_rate: rate,
        steps_back,
    })
}

fn text(report: &Report) -> String {
    let colors = std::io::stdout().is_terminal() && terminal::has_colors();
    let width = report
        .checks
        .iter()
        .map(|check| check.about.chars().count())
        .max()
        .unwrap_or(0);
    let mut lines = Vec::new();
    for check in &report.checks {
        let (word, color) = match check.verdict {
            Verdict::Ok => ("ok  ", 32),
            Verdict::Warn => ("warn", 33),
            Verdict::Fail => ("FAIL", 31),
        };
        let word = if colors {
            format!("\x1b[{color}m{word}\x1b[0m")
        } else {
            word.to_owned()
        };
        lines.push(format!(
            "{word}  {:<width$}  {:<12}  {}",
            check.about, check.check, check.seen
        ));
        if let Some(advice) = &check.advice {
            lines.push(format!("      {:<width$}  {:<12}  -> {advice}", "", ""));
        }
    }
    let count = |verdict| report.checks.iter().filter(|check| check.verdict == verdict).count();
    lines.push(format!(
        "{} ok, {}, {} failed",
        count(Verdict::Ok),
        output::counted(count(Verdict::Warn), "warning"),
        count(Verdict::Fail)
    ));
    lines.join("\n")
}

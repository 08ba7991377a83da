//! Connection of a command. Connects to the router, and determines which robot the command is for.
//!
//! A command is a Zenoh client that fails at once if there is no router. The robot's name is optional if there is only one robot: it is
//! found by the liveliness tokens of its components, or by the state that it publishes (on a robot's own endpoint).

use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Display;
use std::net::ToSocketAddrs as _;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::Duration;

use tokio::time::Instant;
use zenav_protocol::bus::{Act, Bus, BusConfig, BusError, link_protocol};
use zenav_protocol::config_text::Expected;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::member::Member;
use zenav_protocol::topics;

use crate::completion;
use crate::config::IdentityArgs;
use crate::exit_code;
use crate::failure::{Failure, in_words};
use crate::tasks;

pub use zenav_protocol::bus::{DEFAULT_ENDPOINT, ROBOT_ENDPOINT};

/// How long to look for a robot that is not found at once: it may still be starting.
const LOOK_FOR: Duration = Duration::from_millis(2000);
/// Time limit of one query for tokens.
const GLANCE: Duration = Duration::from_millis(500);
/// Pause between two queries.
const PAUSE: Duration = Duration::from_millis(100);
/// A robot without tokens is found by its state, published ten times a second: states of other robots arrive within this time.
const STATE_ROUND: Duration = Duration::from_millis(300);

/// Connection, and longest wait for answers.
#[derive(Clone, Debug, clap::Args)]
pub struct LinkArgs {
    /// Router to connect to, or a robot's own endpoint; or several separated by commas, of which one must be reachable [default:
    /// tcp/127.0.0.1:7447]
    #[arg(long, global = true, value_name = "ENDPOINT", value_delimiter = ',', env = "ZENAV_BUS__CONNECT", hide_env_values = true, value_parser = endpoint)]
    pub connect: Vec<String>,
    /// Namespace of the deployment, if its file sets one
    #[arg(
        long,
        global = true,
        value_name = "NAME",
        default_value = "",
        env = "ZENAV_BUS__NAMESPACE",
        hide_env_values = true,
        hide_default_value = true
    )]
    pub namespace: String,
    /// Longest wait for a connection or an answer, s
    #[arg(long, global = true, value_name = "SECS", default_value_t = 10.0, value_parser = positive)]
    pub timeout: f64,
    /// Identity of this process.
    #[command(flatten)]
    pub identity: IdentityArgs,
}

impl LinkArgs {
    /// Longest wait for an answer.
    #[must_use]
    pub fn patience(&self) -> Duration {
        Duration::try_from_secs_f64(self.timeout).unwrap_or(Duration::MAX)
    }

    /// The given endpoints; without any, that of this machine's router.
    #[must_use]
    pub fn endpoints(&self) -> Vec<String> {
        if self.connect.is_empty() {
            vec![DEFAULT_ENDPOINT.to_owned()]
        } else {
            self.connect.clone()
        }
    }

    /// For requests that must reach a robot without a router: if no endpoint was given, also tries the endpoint of this machine's own
    /// robot.
    #[must_use]
    pub fn with_robot(&self) -> Self {
        let mut link = self.clone();
        if link.connect.is_empty() {
            link.connect = [DEFAULT_ENDPOINT, ROBOT_ENDPOINT].map(str::to_owned).to_vec();
        }
        link
    }
}

/// Connection and robot.
#[derive(Clone, Debug, clap::Args)]
pub struct RobotArgs {
    /// Connection.
    #[command(flatten)]
    pub link: LinkArgs,
    /// Name of the robot; optional if there is only one
    #[arg(long, global = true, value_name = "NAME", value_parser = robot_name, add = completion::robots())]
    pub robot: Option<String>,
}

fn robot_name(text: &str) -> Result<String, String> {
    Id::robot(text).map(String::from).map_err(|error| error.to_string())
}

/// A name on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn name(text: &str) -> Result<String, String> {
    Id::new(text).map(String::from).map_err(|error| error.to_string())
}

/// The namespace in the environment, read as for a deployment.
pub(crate) fn namespace() -> String {
    std::env::var("ZENAV_BUS__NAMESPACE").unwrap_or_default()
}

/// An endpoint on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub(crate) fn endpoint(text: &str) -> Result<String, String> {
    // May be quoted, like a deployment's values in the environment.
    let text = text.trim_matches('"');
    let form = || {
        format!("expected an endpoint, such as {DEFAULT_ENDPOINT}: links are over tcp, or over quic with an identity")
    };
    link_protocol(text).map(|_| text.to_owned()).ok_or_else(form)
}

/// Endpoints on the command line, separated by commas.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub(crate) fn endpoints(text: &str) -> Result<String, String> {
    let checked: Result<Vec<String>, String> = text.split(',').map(|one| endpoint(one.trim())).collect();
    checked.map(|endpoints| endpoints.join(","))
}

/// A finite number on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn finite(text: &str) -> Result<f64, String> {
    number(text, Expected::Finite)
}

/// A heading on the command line, rad.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn heading(text: &str) -> Result<f64, String> {
    number(text, Expected::Angle)
}

/// A pose given as X and Y, m, and YAW, rad, by an option such as `--start`.
///
/// # Errors
/// Exit code 2, with the option: another number of numbers, or a heading that is probably in degrees.
pub(crate) fn pose(option: &str, numbers: &[f64]) -> Result<Pose2, Failure> {
    let [x, y, yaw] = *numbers else {
        return Err(Failure::usage(format!("{option}: expected X Y YAW")));
    };
    let checked = Expected::Angle.check(yaw);
    let yaw = checked.map_err(|why| Failure::usage(format!("{option}: YAW {why}")))?;
    Ok(Pose2::new(x, y, yaw))
}

/// A time of so many seconds; at most 2^30 (34 years), which any clock can add.
#[must_use]
pub fn seconds(secs: f64) -> Duration {
    let most = Duration::from_secs(1 << 30);
    Duration::try_from_secs_f64(secs.max(0.0)).map_or(most, |time| time.min(most))
}

/// A positive, finite number on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn positive(text: &str) -> Result<f64, String> {
    number(text, Expected::Positive)
}

/// Zero, or a positive, finite number, on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn not_negative(text: &str) -> Result<f64, String> {
    number(text, Expected::NotNegative)
}

fn number(text: &str, expected: Expected) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| expected.holds(*number));
    number.ok_or_else(|| format!("expected {expected}"))
}

/// A whole number on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn whole<N: FromStr>(text: &str) -> Result<N, String> {
    let expected = || in_words(&format!("expected {}", std::any::type_name::<N>()));
    text.parse().map_err(|_| expected())
}

/// A whole number on the command line, within bounds.
pub fn whole_in<N>(bounds: RangeInclusive<N>) -> impl Fn(&str) -> Result<N, String> + Clone
where
    N: FromStr + PartialOrd + Display + Clone,
{
    move |text| {
        let number = text.parse::<N>().ok().filter(|number| bounds.contains(number));
        number.ok_or_else(|| format!("expected a whole number from {} to {}", bounds.start(), bounds.end()))
    }
}

/// A listening address on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn address(text: &str) -> Result<String, String> {
    match text.rsplit_once(':') {
        Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => Ok(text.to_owned()),
        _ => Err("expected ADDRESS:PORT, such as 127.0.0.1:7480".to_owned()),
    }
}

/// Cell side of a map on the command line, m; the bounds are those of a deployment.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn resolution(text: &str) -> Result<f64, String> {
    number(text, Expected::Range(0.005, 10.0, "0.005 to 10 m"))
}

/// Speed of simulated time on the command line.
///
/// # Errors
/// Invalid text; the message says what was expected.
pub fn speed(text: &str) -> Result<f64, String> {
    number(text, Expected::Range(0.001, 1000.0, "a number from 0.001 to 1000"))
}

/// Runs a command's work in its own Tokio runtime (multi-threaded: Zenoh requires it).
///
/// # Errors
/// That of the work, or the system gives no threads.
pub fn block_on<T>(work: impl Future<Output = Result<T, Failure>>) -> Result<T, Failure> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(2)
        .enable_all()
        .build()?;
    let result = tasks::block_on(&runtime, work);
    // A thread blocked on the keyboard must not delay the exit.
    runtime.shutdown_background();
    result
}

/// Connects, does the work, and disconnects.
///
/// # Errors
/// [`exit_code::CANNOT_CONNECT`] without a router, or that of the work.
pub fn on_bus<T>(link: &LinkArgs, work: impl AsyncFnOnce(Bus) -> Result<T, Failure>) -> Result<T, Failure> {
    block_on(async {
        let bus = open(link).await?;
        let result = work(bus.clone()).await;
        bus.close().await;
        result
    })
}

/// As [`on_bus`], for work on one robot, which is looked up first.
///
/// # Errors
/// As [`on_bus`] and [`find`].
pub fn on_robot<T>(args: &RobotArgs, work: impl AsyncFnOnce(Bus, String) -> Result<T, Failure>) -> Result<T, Failure> {
    on_bus(&args.link, async |bus| {
        let robot = find(&bus, args.robot.as_deref()).await?;
        work(bus, robot).await
    })
}

/// The host of an endpoint, if it cannot be resolved.
fn unknown_host(endpoint: &str) -> Option<&str> {
    let (_, address) = endpoint.split_once('/')?;
    let (host, _) = address.rsplit_once(':')?;
    address.to_socket_addrs().is_err().then_some(host)
}

/// Connects.
///
/// # Errors
/// [`exit_code::CANNOT_CONNECT`] without a router, [`exit_code::USAGE`] for an invalid endpoint.
pub async fn open(link: &LinkArgs) -> Result<Bus, Failure> {
    let endpoints = link.endpoints();
    let config = BusConfig {
        connect: endpoints.clone(),
        name: "zenav-cli".to_owned(),
        retry: false,
        security: link.identity.security()?,
        namespace: link.namespace.clone(),
        ..BusConfig::default()
    };
    let nobody = || {
        let or_refused = match config.security.identity() {
            Some(identity) => format!(", or who answers is not of the fleet of {}", identity.member()),
            None => String::new(),
        };
        let why = match endpoints.iter().find_map(|endpoint| unknown_host(endpoint)) {
            Some(host) => format!("no host `{host}` is known here"),
            None => format!("nobody answers there{or_refused}"),
        };
        Failure::new(
            exit_code::CANNOT_CONNECT,
            format!(
                "cannot connect to {}: {why} (`zenav up` starts a deployment, `zenav router` a router; --connect names another endpoint)",
                endpoints.join(", ")
            ),
        )
    };
    match tokio::time::timeout(link.patience(), Bus::open(config.clone())).await {
        Ok(Ok(bus)) => Ok(bus),
        Ok(Err(BusError::CannotConnect { .. })) | Err(_) => Err(nobody()),
        Ok(Err(error)) => Err(error.into()),
    }
}

/// The robots found now, each with its components (`edge`, `mapping`, `mission`).
///
/// # Errors
/// The bus was closed.
pub async fn robots(bus: &Bus) -> Result<BTreeMap<String, BTreeSet<String>>, Failure> {
    let mut robots = BTreeMap::<String, BTreeSet<String>>::new();
    for key in bus
        .list_alive(topics::alive_key(topics::ALIVE_COMPONENT, &["*", "*"]), GLANCE)
        .await?
    {
        if let Some([robot, component]) = topics::alive_chunks(topics::ALIVE_COMPONENT, &key).as_deref() {
            robots
                .entry((*robot).to_owned())
                .or_default()
                .insert((*component).to_owned());
        }
    }
    Ok(robots)
}

/// Notes that a robot was not found; the caller keeps listening for it.
pub async fn tell_absence(bus: &Bus, robot: Option<&str>) {
    if let Some(robot) = robot
        && find(bus, Some(robot)).await.is_err()
    {
        crate::output::note(format_args!(
            "zenav: robot `{robot}` does not show; waiting for it (Ctrl-C ends)"
        ));
    }
}

/// The robots with this component, sorted.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] if none is found within a while; an identity that may not see all robots.
pub async fn with_component(bus: &Bus, component: &str) -> Result<Vec<String>, Failure> {
    sees_all(bus)?;
    let start = Instant::now();
    loop {
        let alive = robots(bus).await?;
        let found: Vec<String> = alive
            .iter()
            .filter(|(_, components)| components.contains(component))
            .map(|(robot, _)| robot.clone())
            .collect();
        if !found.is_empty() {
            return Ok(found);
        }
        if start.elapsed() > LOOK_FOR {
            let known: BTreeSet<String> = alive.into_keys().collect();
            let there = unknown(None, &known, bus.member());
            return Err(Failure::not_found(format!("no {component} runs here: {there}")));
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// Checks that this process's identity may see all robots; a robot's sees its own alone.
///
/// # Errors
/// [`exit_code::REJECTED`].
pub fn sees_all(bus: &Bus) -> Result<(), Failure> {
    let tokens = topics::alive_key(topics::ALIVE_COMPONENT, &["*", "*"]);
    Ok(bus.check(Act::Hear, &tokens)?)
}

/// Waits until a dispatcher takes goals for a group.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] if none does within a while; lists the existing groups. As [`with_component`].
pub async fn find_group(bus: &Bus, group: &str) -> Result<(), Failure> {
    sees_all(bus)?;
    let start = Instant::now();
    loop {
        let alive = bus
            .list_alive(topics::alive_key(topics::ALIVE_WORKER, &["*", "*"]), GLANCE)
            .await?;
        let groups: BTreeSet<String> = alive
            .iter()
            .filter_map(|key| {
                topics::alive_chunks(topics::ALIVE_WORKER, key)?
                    .first()?
                    .strip_prefix("group-")
            })
            .map(str::to_owned)
            .collect();
        if groups.contains(group) {
            return Ok(());
        }
        if start.elapsed() > LOOK_FOR {
            let there = match groups.is_empty() {
                true => "the deployment has no groups (`[groups]` in its file names them)".to_owned(),
                false => format!("there is {}", groups.into_iter().collect::<Vec<_>>().join(", ")),
            };
            return Err(Failure::not_found(format!("no group `{group}`: {there}")));
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// The robot of a command: the named one, if it exists, otherwise the only one.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for none or an unknown one, [`exit_code::USAGE`] if there are several; both list the robots found.
/// [`exit_code::REJECTED`] for a robot that this process's identity may not see.
pub async fn find(bus: &Bus, wanted: Option<&str>) -> Result<String, Failure> {
    find_or(bus, wanted, |_| "name one with --robot".to_owned()).await
}

/// As [`find`]. `cure` words what to do where there are several robots and none was named, from their names, sorted.
///
/// # Errors
/// As [`find`].
pub async fn find_or(bus: &Bus, wanted: Option<&str>, cure: impl Fn(&[&str]) -> String) -> Result<String, Failure> {
    bus.check(Act::Hear, &topics::STATE.key(&[wanted.unwrap_or("*")]))?;
    let mut states = bus.latest(&topics::STATE, &[wanted.unwrap_or("*")])?;
    let start = Instant::now();
    let mut seen = BTreeSet::new();
    let mut first_state = None;
    loop {
        let alive = robots(bus).await?;
        while let Some(state) = states.take_received() {
            seen.extend(state.chunks.into_iter().next());
            first_state.get_or_insert_with(Instant::now);
        }
        // A robot with a running edge takes precedence over one that has only cloud services waiting for it.
        let with_edge: BTreeSet<String> = alive
            .iter()
            .filter(|(_, components)| components.contains("edge"))
            .map(|(robot, _)| robot.clone())
            .collect();
        let known = if with_edge.is_empty() && seen.is_empty() {
            alive.keys().cloned().collect()
        } else {
            &with_edge | &seen
        };
        let complete = !with_edge.is_empty()
            || first_state.is_some_and(|first| first.elapsed() > STATE_ROUND)
            || (seen.is_empty() && !known.is_empty());
        match wanted {
            Some(name) if seen.contains(name) || alive.contains_key(name) => return Ok(name.to_owned()),
            None if complete => return choose(&known, cure),
            _ => {}
        }
        if start.elapsed() > LOOK_FOR {
            let known: BTreeSet<String> = alive.into_keys().chain(known).collect();
            return Err(unknown(wanted, &known, bus.member()));
        }
        tokio::time::sleep(PAUSE).await;
    }
}

fn choose(known: &BTreeSet<String>, cure: impl Fn(&[&str]) -> String) -> Result<String, Failure> {
    let names: Vec<&str> = known.iter().map(String::as_str).collect();
    match names.as_slice() {
        [one] => Ok((*one).to_owned()),
        several => Err(Failure::usage(format!(
            "there are several robots ({}): {}",
            several.join(", "),
            cure(several)
        ))),
    }
}

/// That no robot at all shows.
pub(crate) fn none_shows(bus: &Bus) -> Failure {
    unknown(None, &BTreeSet::new(), bus.member())
}

fn unknown(wanted: Option<&str>, known: &BTreeSet<String>, member: Option<&Member>) -> Failure {
    let names: Vec<&str> = known.iter().map(String::as_str).collect();
    let found = match (names.is_empty(), member) {
        (false, _) => format!("there is {}", names.join(", ")),
        // Whoever is not admitted finds nothing, as if nothing ran.
        (true, Some(member)) => {
            format!("no robot shows here; `zenav doctor` says whether the router admits {member}")
        }
        (true, None) => "no robot shows here".to_owned(),
    };
    Failure::not_found(match wanted {
        Some(name) => format!("no robot `{name}`: {found}"),
        None => format!("{found} (`zenav up` or `zenav edge` starts one)"),
    })
}

/// A unique id for a goal, request or holder.
#[must_use]
pub fn fresh_id(prefix: &str) -> String {
    format!("{prefix}-{}", Id::unique())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use super::*;

    fn names(list: &[&str]) -> BTreeSet<String> {
        list.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn the_only_robot_need_not_be_named_and_one_of_several_must() {
        let first = |names: &[&str]| format!("such as {}", names[0]);
        assert_eq!(choose(&names(&["a"]), first).unwrap(), "a");
        let failure = choose(&names(&["a", "b"]), first).unwrap_err();
        assert_eq!(failure.code, exit_code::USAGE);
        assert_eq!(failure.message, "there are several robots (a, b): such as a");
    }

    #[test]
    fn an_unknown_robot_is_answered_with_the_known_ones() {
        let failure = unknown(Some("x"), &names(&["a", "b"]), None);
        assert_eq!(failure.code, exit_code::NOT_FOUND);
        assert!(
            failure.message.contains('x') && failure.message.contains("a, b"),
            "{failure}"
        );
    }

    #[test]
    fn an_identity_that_sees_no_robot_is_told_how_to_find_out_whether_it_is_admitted() {
        let anna: Member = "operator.anna".parse().unwrap();
        for wanted in [None, Some("x")] {
            let told = |member| unknown(wanted, &BTreeSet::new(), member).message;
            let with = told(Some(&anna));
            assert!(
                with.contains("`zenav doctor`") && with.contains("operator.anna"),
                "{with}"
            );
            assert!(!told(None).contains("doctor"), "{}", told(None));
        }
    }

    #[test]
    fn a_given_endpoint_is_told_from_none_even_if_it_is_the_default_one() {
        let link = |words: &[&str]| crate::cli::parsed::<LinkArgs>(words).unwrap();
        let none = link(&[]);
        assert_eq!(none.endpoints(), [DEFAULT_ENDPOINT]);
        assert_eq!(none.with_robot().endpoints(), [DEFAULT_ENDPOINT, ROBOT_ENDPOINT]);
        let given = link(&["--connect", DEFAULT_ENDPOINT]);
        assert_eq!(given.with_robot().endpoints(), [DEFAULT_ENDPOINT]);
    }

    #[test]
    fn ids_are_valid_and_differ() {
        let (a, b) = (fresh_id("goal"), fresh_id("goal"));
        assert!(Id::new(a.clone()).is_ok());
        assert_ne!(a, b);
    }

    #[test]
    fn an_endpoint_that_nobody_can_dial_is_told_at_once() {
        assert!(endpoint("tcp/robot.local:7447").is_ok() && endpoint("tcp/[::1]:7447").is_ok());
        for bad in [
            "http://localhost:7447",
            "ws/localhost:7447",
            "localhost:7447",
            "tcp/localhost",
        ] {
            assert!(endpoint(bad).unwrap_err().contains("tcp/127.0.0.1:7447"), "{bad}");
        }
    }

    #[test]
    fn any_number_of_seconds_is_a_time_that_a_clock_can_add() {
        assert_eq!(seconds(10.0 / 2.0), Duration::from_secs(5));
        for none in [-1.0, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(seconds(none), Duration::ZERO, "{none}");
        }
        for most in [1e300, f64::INFINITY] {
            assert_eq!(seconds(most), Duration::from_secs(1 << 30), "{most}");
        }
    }

    #[test]
    fn a_pose_with_a_heading_in_degrees_is_refused_with_its_option() {
        assert_eq!(pose("--start", &[1.0, -2.0, 3.0]).unwrap(), Pose2::new(1.0, -2.0, 3.0));
        let refused = pose("--start", &[0.0, 0.0, 90.0]).unwrap_err();
        assert_eq!(refused.code, exit_code::USAGE);
        assert!(refused.message.starts_with("--start: YAW 90: expected"), "{refused}");
        assert!(pose("--start", &[0.0, 0.0]).is_err());
    }

    #[test]
    fn numbers_on_the_command_line_are_finite() {
        assert_eq!(finite("-1.5"), Ok(-1.5));
        assert!(finite("NaN").is_err() && finite("inf").is_err() && finite("x").is_err());
        assert!(positive("0").is_err());
        assert_eq!(whole("-3"), Ok(-3));
        assert_eq!(
            whole::<u64>("-1").unwrap_err(),
            "expected a whole number that is not negative"
        );
        assert_eq!(whole::<i32>("high").unwrap_err(), "expected a whole number");
        assert_eq!(whole_in(1..=9_u32)("9"), Ok(9));
        assert_eq!(
            whole_in(1..=9_u32)("0").unwrap_err(),
            "expected a whole number from 1 to 9"
        );
    }

    #[test]
    fn an_address_has_a_port() {
        assert!(address("127.0.0.1:0").is_ok() && address("[::1]:7480").is_ok() && address("localhost:7480").is_ok());
        for bad in ["7480", ":7480", "127.0.0.1", "127.0.0.1:99999", "foo"] {
            assert!(address(bad).unwrap_err().contains("127.0.0.1:7480"), "{bad}");
        }
    }
}

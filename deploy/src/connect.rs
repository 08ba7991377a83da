//! Connection of a command. Connects to the router, and determines which robot the command is for.
//!
//! A command is a Zenoh client that fails at once if there is no router. The robot's name is optional if there is only one robot: it is
//! found by the liveliness tokens of its components, or by the state that it publishes (on a robot's own endpoint).

use std::collections::{BTreeMap, BTreeSet};
use std::net::ToSocketAddrs as _;
use std::time::Duration;

use tokio::time::Instant;
use zenav_protocol::bus::{Act, Bus, BusConfig, BusError};
use zenav_protocol::id::Id;
use zenav_protocol::member::Member;
use zenav_protocol::topics;

use crate::arguments::{endpoint, positive, robot_name};
use crate::completion;
use crate::config::IdentityArgs;
use crate::failure::Failure;
use crate::output::{self, listed};
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

/// The namespace in the environment, read as for a deployment.
pub(crate) fn namespace() -> String {
    std::env::var("ZENAV_BUS__NAMESPACE").unwrap_or_default()
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
/// [`crate::exit_code::CANNOT_CONNECT`] without a router, or that of the work.
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
/// [`crate::exit_code::CANNOT_CONNECT`] without a router, [`crate::exit_code::USAGE`] for an invalid endpoint.
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
        Failure::cannot_connect(format!(
            "cannot connect to {}: {why} (`zenav up` starts a deployment, `zenav router` a router; --connect names another endpoint)",
            endpoints.join(", ")
        ))
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
    alive(bus, topics::ALIVE_COMPONENT, GLANCE).await
}

/// What shows by liveliness tokens of a pattern with two named chunks: for each first chunk the second ones.
///
/// # Errors
/// The bus was closed.
pub(crate) async fn alive(
    bus: &Bus,
    pattern: &str,
    within: Duration,
) -> Result<BTreeMap<String, BTreeSet<String>>, Failure> {
    let mut found = BTreeMap::<String, BTreeSet<String>>::new();
    for key in bus.list_alive(topics::alive_key(pattern, &["*", "*"]), within).await? {
        if let Some([first, second]) = topics::alive_chunks(pattern, &key).as_deref() {
            found
                .entry((*first).to_owned())
                .or_default()
                .insert((*second).to_owned());
        }
    }
    Ok(found)
}

/// Notes that a robot was not found; the caller keeps listening for it.
pub async fn tell_absence(bus: &Bus, robot: Option<&str>) {
    if let Some(robot) = robot
        && find(bus, Some(robot)).await.is_err()
    {
        output::note(format_args!(
            "zenav: robot `{robot}` does not show; waiting for it (Ctrl-C ends)"
        ));
    }
}

/// The robots with this component, sorted.
///
/// # Errors
/// [`crate::exit_code::NOT_FOUND`] if none is found within a while; an identity that may not see all robots.
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
/// [`crate::exit_code::REJECTED`].
pub fn sees_all(bus: &Bus) -> Result<(), Failure> {
    let tokens = topics::alive_key(topics::ALIVE_COMPONENT, &["*", "*"]);
    Ok(bus.check(Act::Hear, &tokens)?)
}

/// Waits until a dispatcher takes goals for a group.
///
/// # Errors
/// [`crate::exit_code::NOT_FOUND`] if none does within a while; lists the existing groups. As [`with_component`].
pub async fn find_group(bus: &Bus, group: &str) -> Result<(), Failure> {
    sees_all(bus)?;
    let start = Instant::now();
    loop {
        let services = alive(bus, topics::ALIVE_WORKER, GLANCE).await?;
        let groups: Vec<&str> = services
            .keys()
            .filter_map(|service| service.strip_prefix("group-"))
            .collect();
        if groups.contains(&group) {
            return Ok(());
        }
        if start.elapsed() > LOOK_FOR {
            let there = match groups.is_empty() {
                true => "the deployment has no groups (`[groups]` in its file names them)".to_owned(),
                false => format!("there is {}", listed(groups)),
            };
            return Err(Failure::not_found(format!("no group `{group}`: {there}")));
        }
        tokio::time::sleep(PAUSE).await;
    }
}

/// The robot of a command: the named one, if it exists, otherwise the only one.
///
/// # Errors
/// [`crate::exit_code::NOT_FOUND`] for none or an unknown one, [`crate::exit_code::USAGE`] if there are several; both list the robots found.
/// [`crate::exit_code::REJECTED`] for a robot that this process's identity may not see.
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
    let found = match (known.is_empty(), member) {
        (false, _) => format!("there is {}", listed(known)),
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
mod tests {
    use super::*;
    use crate::exit_code;

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
}

//! Completion. Names that a shell offers while a user types: shipped files, keys and messages, and the robots, places, zones, goals,
//! parameters and stored maps on the bus.

use std::ffi::OsStr;
use std::io::Write;
use std::time::Duration;

use clap::ValueEnum as _;
use clap_complete::Shell;
use clap_complete::engine::{
    ArgValueCandidates, ArgValueCompleter, CompletionCandidate, PathCompleter, ValueCompleter as _,
};
use clap_complete::env::{CompleteEnv, Shells};
use zenav_mission::trees;
use zenav_planning::Planner;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{GoalsRequest, MapAction, MapRequest, ParamRequest};
use zenav_protocol::topics::Row;
use zenav_protocol::{robot, topics};
use zenav_sim::world;

use crate::config::IdentityArgs;
use crate::connect::{self, LinkArgs};
use crate::failure::{Failure, Outcome};
use crate::files::Shipped;
use crate::inspect::message_names;
use crate::{annotations, exit_code, files, output};

/// The variable by which a shell requests completions; clap's own default.
const ASKED_BY: &str = "COMPLETE";
/// Longest wait for an answer: completion must feel instant.
const WITHIN: Duration = Duration::from_millis(700);

/// Shell completions.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  eval \"$(zenav completions bash)\"\n  zenav completions fish > ~/.config/fish/completions/zenav.fish"
)]
pub struct CompletionsArgs {
    /// Shell to complete for
    shell: Shell,
}

/// Prints the script that a shell runs at startup.
///
/// # Errors
/// A shell without support for completion requests.
pub fn completions(args: &CompletionsArgs) -> Outcome {
    // Written to memory first: a closed pipe must not cause a panic.
    let mut script = Vec::new();
    register(args.shell, &mut script)?;
    output::line(String::from_utf8_lossy(&script).trim_end());
    Ok(exit_code::OK)
}

/// Answers a shell's completion request and ends the process; otherwise does nothing.
pub(crate) fn answer(command: impl Fn() -> clap::Command) {
    CompleteEnv::with_factory(command).var(ASKED_BY).complete();
}

/// Writes the script that a shell runs at startup.
///
/// # Errors
/// A shell without support for completion requests, or `out` cannot be written.
fn register(shell: Shell, out: &mut dyn Write) -> Result<(), Failure> {
    let name = shell.to_possible_value().map(|value| value.get_name().to_owned());
    let shells = Shells::builtins();
    let completer = name
        .as_deref()
        .and_then(|name| shells.completer(name))
        .ok_or_else(|| Failure::usage(format!("no completions for {shell}")))?;
    completer.write_registration(ASKED_BY, "zenav", "zenav", "zenav", out)?;
    Ok(())
}

/// Shipped worlds, and files.
pub fn worlds() -> ArgValueCompleter {
    shipped_or_file(world::SHIPPED)
}

/// Shipped robots, and files.
pub fn models() -> ArgValueCompleter {
    shipped_or_file(robot::SHIPPED)
}

/// Shipped behaviour trees, and files.
pub fn behaviour_trees() -> ArgValueCompleter {
    shipped_or_file(trees::SHIPPED)
}

/// Planners.
pub fn planners() -> ArgValueCandidates {
    any_of(|| Planner::ALL.iter().map(|(name, _)| (*name).to_owned()).collect())
}

fn shipped_or_file(shipped: Shipped) -> ArgValueCompleter {
    names_or_file(move || files::names(shipped).map(str::to_owned).collect())
}

fn names_or_file(names: impl Fn() -> Vec<String> + Send + Sync + 'static) -> ArgValueCompleter {
    ArgValueCompleter::new(move |typed: &OsStr| {
        let start = typed.to_string_lossy();
        let mut found = candidates(names());
        found.retain(|name| name.get_value().to_string_lossy().starts_with(start.as_ref()));
        found.extend(PathCompleter::file().complete(typed));
        found
    })
}

/// Robots on the bus.
pub fn robots() -> ArgValueCandidates {
    any_of(|| on_bus(async |bus, _| Ok(connect::robots(&bus).await?.into_keys().collect())))
}

/// Places of the robot's map.
pub fn places() -> ArgValueCandidates {
    of_robot(async |bus, robot| {
        let known = annotations::read(&bus, &robot, WITHIN).await?;
        Ok(known.places.into_keys().collect())
    })
}

/// Zones of the robot's map.
pub fn zones() -> ArgValueCandidates {
    of_robot(async |bus, robot| {
        let known = annotations::read(&bus, &robot, WITHIN).await?;
        Ok(known.zones.into_iter().map(|zone| zone.name).collect())
    })
}

/// Goals of the robot that have not ended.
pub fn goals() -> ArgValueCandidates {
    of_robot(async |bus, robot| {
        let request = GoalsRequest::default();
        let known = bus.ask(&topics::GOALS, &[&robot], &request, WITHIN).await?.goals;
        let open = known.into_iter().filter(|goal| !goal.state.is_end());
        Ok(open.map(|goal| goal.id).collect())
    })
}

/// Parameters of the robot.
pub fn params() -> ArgValueCandidates {
    of_robot(async |bus, robot| {
        let request = ParamRequest::default();
        let known = bus.ask(&topics::PARAM, &[&robot], &request, WITHIN).await?.params;
        Ok(known.into_keys().collect())
    })
}

/// Names of the robot's stored maps.
pub fn stored_maps() -> ArgValueCandidates {
    any_of(map_names)
}

/// Names of the robot's stored maps, and files.
pub fn stored_maps_and_files() -> ArgValueCompleter {
    names_or_file(map_names)
}

fn map_names() -> Vec<String> {
    on_robot(async |bus, robot| {
        let request = MapRequest {
            action: MapAction::List,
            ..MapRequest::default()
        };
        let stored = bus.ask(&topics::MAP, &[&robot], &request, WITHIN).await?.stored;
        Ok(stored.into_iter().map(|map| map.name).collect())
    })
}

/// Keys of topics and asks, in the form that commands accept.
pub fn keys() -> ArgValueCandidates {
    any_of(|| fixed_keys(|_| true))
}

/// Keys of topics, in the form that commands accept.
pub fn topic_keys() -> ArgValueCandidates {
    any_of(|| fixed_keys(|row| row.qos.is_some()))
}

/// Keys of asks, in the form that commands accept.
pub fn ask_keys() -> ArgValueCandidates {
    any_of(|| fixed_keys(|row| row.qos.is_none()))
}

/// Names of messages.
pub fn messages() -> ArgValueCandidates {
    any_of(message_names)
}

/// Keys of the table that contain no name but the robot's, which is left out.
fn fixed_keys(is_wanted: impl Fn(&Row) -> bool) -> Vec<String> {
    let wanted = topics::TABLE.iter().filter(|row| is_wanted(row));
    let of_a_robot = wanted.filter_map(|row| row.pattern.strip_prefix("zenav/{robot}/"));
    of_a_robot.filter(|key| !key.contains('{')).map(str::to_owned).collect()
}

fn candidates(names: Vec<String>) -> Vec<CompletionCandidate> {
    names.into_iter().map(CompletionCandidate::new).collect()
}

/// Offers all of some names.
fn any_of(names: impl Fn() -> Vec<String> + Send + Sync + 'static) -> ArgValueCandidates {
    ArgValueCandidates::new(move || candidates(names()))
}

/// Offers what is found on the bus for the robot that the typed words select.
fn of_robot(
    look: impl AsyncFn(Bus, String) -> Result<Vec<String>, Failure> + Send + Sync + 'static,
) -> ArgValueCandidates {
    any_of(move || on_robot(async |bus, robot| look(bus, robot).await))
}

/// Looks up names on the bus that the typed words select; empty if there is no quick answer.
fn on_bus(look: impl AsyncFnOnce(Bus, Option<String>) -> Result<Vec<String>, Failure>) -> Vec<String> {
    let words: Vec<String> = std::env::args().collect();
    let link = LinkArgs {
        connect: option(&words, "--connect")
            .or_else(|| std::env::var("ZENAV_BUS__CONNECT").ok())
            .iter()
            .flat_map(|endpoints| endpoints.split(','))
            .map(str::to_owned)
            .collect(),
        namespace: option(&words, "--namespace").unwrap_or_else(connect::namespace),
        timeout: WITHIN.as_secs_f64(),
        identity: IdentityArgs {
            identity: option(&words, "--identity")
                .map(Into::into)
                .or_else(|| std::env::var_os("ZENAV_IDENTITY").map(Into::into)),
        },
    };
    let robot = option(&words, "--robot");
    let found = connect::on_bus(&link, async |bus| {
        tokio::time::timeout(WITHIN, look(bus, robot))
            .await
            .unwrap_or_else(|_| Ok(Vec::new()))
    });
    found.unwrap_or_default()
}

fn on_robot(look: impl AsyncFnOnce(Bus, String) -> Result<Vec<String>, Failure>) -> Vec<String> {
    on_bus(async |bus, robot| {
        let robot = connect::find(&bus, robot.as_deref()).await?;
        look(bus, robot).await
    })
}

/// The value of an option in a command line, after a space or `=`.
fn option(words: &[String], name: &str) -> Option<String> {
    let at = words.iter().position(|word| {
        word.strip_prefix(name)
            .is_some_and(|rest| rest.is_empty() || rest.starts_with('='))
    })?;
    let word = words.get(at)?;
    match word.split_once('=') {
        Some((_, value)) => Some(value.to_owned()),
        None => words.get(at + 1).cloned(),
    }
    .filter(|value| !value.is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn options_are_found_among_the_words_typed_so_far() {
        let words: Vec<String> = [
            "zenav",
            "goal",
            "--robot=neato",
            "--connect",
            "tcp/127.0.0.1:1",
            "--robots",
            "x",
        ]
        .map(str::to_owned)
        .into();
        assert_eq!(option(&words, "--robot").as_deref(), Some("neato"));
        assert_eq!(option(&words, "--connect").as_deref(), Some("tcp/127.0.0.1:1"));
        assert_eq!(option(&words, "--place"), None);
        assert_eq!(option(&words[..4], "--connect"), None);
    }

    #[test]
    fn every_shell_is_told_how_to_ask() {
        for shell in Shell::value_variants() {
            let mut script = Vec::new();
            register(*shell, &mut script).unwrap();
            assert!(String::from_utf8(script).unwrap().contains("zenav"), "{shell}");
        }
    }

    #[test]
    fn keys_are_offered_where_they_are_taken() {
        let values = |candidates: ArgValueCandidates| -> Vec<String> {
            let found = candidates.candidates();
            found
                .iter()
                .map(|one| one.get_value().to_string_lossy().into_owned())
                .collect()
        };
        let has = |names: &[String], name: &str| names.iter().any(|known| known == name);
        let (topics, asks, all) = (values(topic_keys()), values(ask_keys()), values(keys()));
        assert!(
            has(&topics, "edge/pose") && !has(&topics, "ask/edge/info"),
            "{topics:?}"
        );
        assert!(has(&asks, "ask/edge/info") && !has(&asks, "edge/pose"), "{asks:?}");
        assert_eq!(all.len(), topics.len() + asks.len());
        assert!(all.iter().all(|key| !key.contains('{')));
        assert!(has(&values(messages()), "GoalRequest"));
    }

    #[test]
    fn shipped_names_come_before_files() {
        let found = worlds().complete(OsStr::new("ki"));
        assert_eq!(found.first().unwrap().get_value(), "kitchen");
    }
}

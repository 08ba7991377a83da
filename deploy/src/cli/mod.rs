//! Command line. One table lists the commands; each command's arguments and work live in its own module.

#[cfg(test)]
mod reference;

use std::process::ExitCode;

use clap::{CommandFactory as _, FromArgMatches as _, Parser, Subcommand};
use zenav_observability::logging;

use crate::failure::Outcome;
use crate::{
    annotations, batch, bench, completion, config, demo, gateway, goal, hosts, inspect, keys, launch, localise,
    lockstep, netem, operator, output, record, slam, wall_following,
};

/// What is logged unless `RUST_LOG` says otherwise, by default, with `--verbose` and with `--quiet`; logs go to stderr.
const LOGGED: &str = "info,zenoh=off,zenoh_link=off,zenoh_transport=off";
const LOGGED_VERBOSE: &str = "info,zenav=debug,zenoh=off,zenoh_link=off,zenoh_transport=off";
const LOGGED_QUIET: &str = "warn,zenoh=off,zenoh_link=off,zenoh_transport=off";

/// Footer of `--help`.
const FOOTER: &str = "\
Examples:
  zenav up                                   a simulated robot and its cloud on this machine
  zenav up --map kitchen.yaml --pose -1 -0.5 0
  zenav goal submit --place sink --wait
  zenav zone add wet --keep-out 0 -1 0.6 -1 0.6 -0.4 0 -0.4
  zenav doctor                               what is wrong, and what to do

Exit codes:
  0 ok  1 failed  2 usage  3 not found  4 cannot connect  5 timeout  6 cancelled  7 rejected  130 interrupted

Environment:
  RUST_LOG              what is logged, such as info or zenav_cloud=debug; overrides -v and -q
  NO_COLOR              no colours
  ZENAV_IDENTITY        folder of this process's identity (`zenav keys`)
  ZENAV_LOG_FORMAT      log lines as text or json
  ZENAV_TRACE           where one writes its spans: a file
  ZENAV_METRICS         where a long-running command serves its health: ADDRESS:PORT
  ZENAV_SECTION__KEY    a value of a deployment (`zenav config show --origin`)
  USER                  the name under which this user commands";

/// Mobile-robot navigation, split between robot and cloud, over Zenoh.
#[derive(Debug, Parser)]
#[command(
    name = "zenav",
    version,
    about = "Mobile-robot navigation, split between robot and cloud, over Zenoh",
    propagate_version = true,
    help_template = "{about}\n\n{usage-heading} {usage}{after-help}\n\nOptions:\n{options}",
    after_help = overview()
)]
struct Cli {
    /// Log lines as text or json
    #[arg(
        long,
        global = true,
        value_name = "FORMAT",
        default_value = "text",
        env = "ZENAV_LOG_FORMAT",
        hide_env_values = true
    )]
    log_format: logging::Format,
    /// Log more: debug lines of every part
    #[arg(short, long, global = true, conflicts_with = "quiet")]
    verbose: bool,
    /// Log less: warnings and errors
    #[arg(short, long, global = true)]
    quiet: bool,
    #[command(subcommand)]
    command: Command,
}

impl Cli {
    /// What is logged unless `RUST_LOG` says otherwise.
    const fn logged(&self) -> &'static str {
        match (self.verbose, self.quiet) {
            (true, _) => LOGGED_VERBOSE,
            (false, true) => LOGGED_QUIET,
            (false, false) => LOGGED,
        }
    }
}

/// The commands in their groups, then the footer.
fn overview() -> String {
    let all = Command::augment_subcommands(clap::Command::new("zenav"));
    let about = |name: &str| {
        let command = all.get_subcommands().find(|command| command.get_name() == name)?;
        command.get_about().map(ToString::to_string)
    };
    let mut text = String::new();
    for (group, names) in GROUPS {
        text.push_str(&format!("{group}:\n"));
        for name in names.iter().map(|name| name.to_lowercase()) {
            text.push_str(&format!("  {name:<12} {}\n", about(&name).unwrap_or_default()));
        }
        text.push('\n');
    }
    text + "`zenav COMMAND --help` tells more.\n\n" + FOOTER
}

/// Declares the commands: in the groups and the order of `--help`, each with its help, its arguments, and the function of the same module
/// that runs it.
macro_rules! commands {
    ($($group:literal { $($(#[doc = $doc:literal])+ $name:ident($module:ident::$args:ident) => $run:ident;)+ })+) => {
        /// The names of the commands in their groups: clap groups options only.
        const GROUPS: &[(&str, &[&str])] = &[$(($group, &[$(stringify!($name)),+])),+];

        #[derive(Debug, Subcommand)]
        enum Command {
            $($($(#[doc = $doc])+ $name($module::$args),)+)+
        }

        fn run(command: Command) -> Outcome {
            match command {
                $($(Command::$name(args) => $module::$run(&args),)+)+
            }
        }
    };
}

commands! {
    "Run everything here" {
        /// Run a demo scenario on this machine over real Zenoh sessions and print a report
        Demo(demo::DemoArgs) => run;
        /// Run a deployment on this machine until Ctrl-C
        Up(launch::UpArgs) => up;
        /// Simulate one goal in lockstep without a network; bit-for-bit repeatable from a seed
        Run(lockstep::RunArgs) => run;
    }
    "Drive" {
        /// Submit, list, watch and cancel goals
        Goal(goal::GoalArgs) => run;
        /// Stop a robot; the stop latches until `zenav resume`
        Stop(operator::StopArgs) => stop;
        /// Release a stop; the robot waits for a new plan
        Resume(operator::StopArgs) => resume;
        /// Drive a robot from the keyboard
        Teleop(operator::TeleopArgs) => teleop;
        /// Make a robot spin, drive straight, back up or wait
        Do(operator::DoArgs) => maneuver;
        /// Show a robot's pose, set it, or search for it in the map
        Pose(operator::PoseArgs) => pose;
        /// Show, acquire or release the command lease of a robot
        Lease(operator::LeaseArgs) => lease;
        /// List, read and set the parameters of a running robot
        Param(operator::ParamArgs) => param;
    }
    "Map" {
        /// Show, save, load, store, convert and build maps
        Map(inspect::MapArgs) => map;
        /// List, add and remove named places of a robot's map
        Place(annotations::PlaceArgs) => place;
        /// List, add and remove keep-out and speed zones of a robot's map
        Zone(annotations::ZoneArgs) => zone;
    }
    "Look" {
        /// Serve the mission-control page: live map, goals, stop and teleop in a browser
        Gateway(gateway::GatewayArgs) => gateway;
        /// Serve live bus traffic to Foxglove
        View(record::ViewArgs) => view;
        /// List the parts of a running deployment: hosts, versions, roles, load, clocks
        Ps(inspect::PsArgs) => ps;
        /// Show the latest log lines of a running deployment's parts
        Logs(inspect::LogsArgs) => logs;
        /// List, print, measure and publish topics
        Topic(inspect::TopicArgs) => topic;
        /// Send a request by hand and print the answer
        Ask(inspect::AskArgs) => ask;
        /// Print the JSON Schema of a message
        Schema(inspect::SchemaArgs) => schema;
        /// Validate, show, watch and simulate behaviour trees; list their nodes
        Bt(inspect::BtArgs) => bt;
        /// Check a running deployment: what is wrong, and what to do
        Doctor(inspect::DoctorArgs) => doctor;
        /// Print the configuration of a deployment
        Config(config::ConfigArgs) => run;
    }
    "Run parts on several machines" {
        /// Render the units, containers and manifests of a deployment of many hosts, and check it
        Deploy(hosts::DeployArgs) => deploy;
        /// Make, issue, list and revoke the certificates of a fleet
        Keys(keys::KeysArgs) => run;
        /// Run a router
        Router(launch::RouterArgs) => router;
        /// Run the robot side of a deployment
        Edge(launch::EdgeArgs) => edge;
        /// Run off-board services: mapping, motion, mission, or all
        Cloud(launch::CloudArgs) => cloud;
        /// Draw a world, serve one to robots on several machines, measure the simulator
        Sim(batch::SimArgs) => sim;
        /// Proxy TCP or UDP over a bad link: delay, jitter, rate, loss, stalls, cuts
        Netem(netem::NetemArgs) => run;
    }
    "Record" {
        /// Record bus traffic into an MCAP file, which Foxglove opens
        Record(record::RecordArgs) => record;
        /// Replay a record on a bus, or recompute its map and compare
        Replay(record::ReplayArgs) => replay;
        /// Compare two records: goals, path, time, clearance, latencies, keys
        Diff(record::DiffArgs) => diff;
        /// Report on a record in one page: map, path, speed, clearance, latencies, tree, events
        Report(record::ReportArgs) => report;
        /// Render a film of a record
        Film(record::FilmArgs) => film;
    }
    "Offline" {
        /// Plan a batch of queries offline
        Plan(batch::PlanArgs) => plan;
        /// Plan and smooth a batch of queries offline
        Smooth(batch::SmoothArgs) => smooth;
        /// Map a log of scans and odometry, or solve and certify a pose graph, offline
        Slam(slam::SlamArgs) => slam;
        /// Localise a recorded robot in a map, offline; globally where no initial pose is given
        Localise(localise::LocaliseArgs) => localise;
        /// Tune gains in simulation; writes a robot file
        Tune(wall_following::TuneArgs) => tune;
        /// Measure the bus on this machine, or how well robots drive
        Bench(bench::BenchArgs) => bench;
        /// Print shell completions
        Completions(completion::CompletionsArgs) => completions;
    }
}

fn command() -> clap::Command {
    signed(Cli::command())
}

/// Arguments with a value accept negative numbers, so that the value's own check refuses them, not the parser.
fn signed(command: clap::Command) -> clap::Command {
    command
        .mut_args(|arg| match arg.get_action().takes_values() {
            true => arg.allow_negative_numbers(true),
            false => arg,
        })
        .mut_subcommands(signed)
}

/// Parses the arguments of one command the way the whole command line does.
///
/// # Errors
/// Wrong usage.
#[cfg(test)]
pub(crate) fn parsed<A: clap::Args>(words: &[&str]) -> Result<A, clap::Error> {
    let command = A::augment_args(clap::Command::new("zenav").no_binary_name(true));
    A::from_arg_matches(&signed(command).try_get_matches_from(words)?)
}

/// Runs the command line of this process.
pub(crate) fn main() -> ExitCode {
    completion::answer(command);
    // clap itself exits: with 2 on wrong usage, with 0 on help.
    let cli = Cli::from_arg_matches(&command().get_matches()).unwrap_or_else(|error| error.exit());
    // A second initialisation (tests in one process) changes nothing.
    logging::init(cli.log_format, cli.logged(), || output::LogWriter);
    if hosts_parts(&cli.command) {
        zenav_protocol::bus::threads::ensure_enough();
    }
    match run(cli.command) {
        Ok(code) => ExitCode::from(code),
        Err(failure) => {
            crate::output::note(format_args!("zenav: {failure}"));
            ExitCode::from(failure.code)
        }
    }
}

/// Whether the command's process may host parts: their sessions need more Zenoh threads than the default.
const fn hosts_parts(command: &Command) -> bool {
    matches!(
        command,
        Command::Demo(_)
            | Command::Up(_)
            | Command::Router(_)
            | Command::Edge(_)
            | Command::Cloud(_)
            | Command::Gateway(_)
            | Command::Sim(_)
    )
}

#[cfg(test)]
mod tests {
    use clap_complete::engine::{ArgValueCandidates, ArgValueCompleter};

    use super::*;

    #[test]
    fn the_help_of_every_command_has_two_examples() {
        for command in command().get_subcommands_mut() {
            let help = command.render_help().to_string();
            let examples = help.matches("\n  zenav ").count() + help.matches("$(zenav ").count();
            assert!(examples >= 2, "{}: {examples}", command.get_name());
        }
    }

    #[test]
    fn the_surface_is_frozen_in_the_reference() {
        let path = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/commands.md");
        let page = reference::page(command());
        if std::env::var_os("WRITE_DOCS").is_some() {
            std::fs::write(path, &page).expect("docs can be written");
        }
        let frozen = std::fs::read_to_string(path).unwrap_or_default();
        assert!(
            frozen == page,
            "docs/commands.md is not what is declared; WRITE_DOCS=1 writes it"
        );
    }

    #[test]
    fn the_command_line_is_sound_and_its_help_tells_codes_and_environment() {
        command().debug_assert();
        let help = command().render_help().to_string();
        for part in [
            "Drive:",
            "  goal ",
            "Exit codes:",
            "NO_COLOR",
            "ZENAV_SECTION__KEY",
            "Usage: zenav",
        ] {
            assert!(help.contains(part), "{part}: {help}");
        }
        assert!(help.lines().all(|line| line.chars().count() <= 120), "{help}");
    }

    #[test]
    fn more_is_logged_or_less_but_not_both() {
        let logged = |words: &[&str]| -> Result<&'static str, clap::Error> {
            let matches = command().try_get_matches_from([&["zenav"], words].concat())?;
            Ok(Cli::from_arg_matches(&matches)?.logged())
        };
        for (words, filter) in [
            (&["up"][..], LOGGED),
            (&["up", "-v"], LOGGED_VERBOSE),
            (&["--quiet", "goal", "list"], LOGGED_QUIET),
        ] {
            assert_eq!(logged(words).expect("is accepted"), filter, "{words:?}");
        }
        assert!(logged(&["up", "-v", "-q"]).is_err());
    }

    #[test]
    fn shipped_names_and_robots_are_completed_wherever_they_are_taken() {
        fn check(command: &clap::Command) {
            for arg in command.get_arguments() {
                let help = arg.get_help().map(ToString::to_string).unwrap_or_default();
                let named = [
                    "or shipped name",
                    "or name of a shipped",
                    "a shipped name",
                    "a shipped one",
                    "Name of the robot",
                ];
                let completes = arg.get::<ArgValueCompleter>().is_some() || arg.get::<ArgValueCandidates>().is_some();
                assert!(
                    completes || !named.iter().any(|name| help.contains(name)),
                    "{} {}: {help}",
                    command.get_name(),
                    arg.get_id()
                );
            }
            command.get_subcommands().for_each(check);
        }
        check(&command());
    }

    #[test]
    fn a_negative_number_is_refused_by_what_the_option_expects() {
        let refused = |words: &[&str]| {
            let parsed = command().try_get_matches_from([&["zenav"], words].concat());
            parsed.map(drop).expect_err("is refused").to_string()
        };
        let deadline = refused(&["goal", "submit", "1", "2", "--deadline", "-1"]);
        assert!(deadline.contains("invalid value '-1' for '--deadline"), "{deadline}");
        let speed = refused(&["demo", "--speed", "-1"]);
        assert!(speed.contains("expected a number from 0.001 to 1000"), "{speed}");
        let goal = refused(&["goal", "submit"]);
        assert!(goal.contains("<X>") && goal.contains("<Y>"), "{goal}");
    }
}

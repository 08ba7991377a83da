//! The composition root: the `zenav` command, every part as a subcommand.
//!
//! | module | answers |
//! |---|---|
//! | `cli` | which commands there are, and their exit codes |
//! | `config` | what a deployment is made of, and where each value came from |
//! | `launch` | what `up`, `router`, `edge` and `cloud` run |
//! | `greeting`, `farewell` | what `up` says when it is ready, and at its end |
//! | `components` | how the parts that share a process start and stop |
//! | `hosts` | a deployment of many hosts as units, containers and manifests, and checks of its state |
//! | `rest` | values of keys over HTTP, read-only |
//! | `gateway` | how operators see and command robots in a browser |
//! | `world_server` | how robots on several machines share one world |
//! | `demo`, `report` | one scenario on this machine over real Zenoh sessions |
//! | `lockstep` | the same cores without a network, bit-for-bit repeatable |
//! | `connect` | how a command reaches the router and its robot |
//! | `arguments` | numbers, names and addresses on the command line |
//! | `leadership` | whether any orchestrator that runs will keep a robot's goals |
//! | `live_map`, `freshness` | a robot's current state, drawn in a terminal; how old it is |
//! | `goal`, `operator` | goals and hand control from anywhere |
//! | `annotations` | places and zones of a running robot's map |
//! | `keys` | the members of a fleet, and their certificates |
//! | `inspect` | topics, maps, trees, health |
//! | `record` | runs as files: recorded, replayed, recomputed, compared, reported |
//! | `batch` | planning, smoothing and mapping offline |
//! | `localise` | a recorded robot's poses in a map |
//! | `slam` | maps and poses from logs; pose graphs, certified |
//! | `bench` | how fast the bus is, and how well robots drive |
//! | `wall_following` | how well a robot follows walls, and which gains are best |
//! | `files` | worlds, robots and maps by file or shipped name |
//! | `drawing` | pictures: maps, worlds, films, trees |
//! | `completion` | names that a shell offers: shipped ones, and those on the bus |
//! | `parallel`, `tasks` | independent jobs on several threads; futures for Tokio |
//! | `output`, `failure` | tables and JSON; errors with their exit codes |

pub mod annotations;
mod arguments;
pub mod batch;
pub mod bench;
pub mod cli;
pub mod completion;
pub mod components;
pub mod config;
pub mod connect;
pub mod demo;
pub mod drawing;
pub mod failure;
mod farewell;
pub mod files;
mod freshness;
pub mod gateway;
pub mod goal;
mod greeting;
mod health;
pub mod hosts;
pub mod inspect;
pub mod keys;
pub mod launch;
mod leadership;
pub mod live_map;
pub mod localise;
pub mod lockstep;
pub mod netem;
pub mod operator;
pub mod output;
pub mod parallel;
pub mod record;
pub mod report;
mod rest;
pub mod slam;
mod tasks;
pub mod wall_following;
pub mod world_server;

pub use zenav_edge::exit_code;

/// Runs the command line of this process; [`exit_code`] lists the exit codes.
#[must_use]
pub fn main() -> std::process::ExitCode {
    cli::main()
}

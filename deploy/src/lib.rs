//! The composition root: the `zenav` command, every part as a subcommand.
//!
//! | module | answers |
//! |---|---|
//! | `cli` | which commands there are, and their exit codes |
//! | `config` | what a deployment is made of, and where each value came from |
//! | `launch` | what `up`, `router`, `edge` and `cloud` run |
//! | `components` | how the parts start and end that share a process |
//! | `hosts` | a deployment of many hosts as units, containers and manifests, and whether it runs |
//! | `rest` | values of keys over HTTP, read-only |
//! | `gateway` | how people see and command robots in a browser |
//! | `world_server` | how robots on several machines share one world |
//! | `demo`, `report` | one scenario on this machine over real Zenoh sessions |
//! | `lockstep` | the same cores without a network, bit for bit repeatable |
//! | `connect` | how a command reaches the router and its robot |
//! | `live_map` | what a robot does now, drawn in a terminal |
//! | `goal`, `operator` | goals and hand control from anywhere |
//! | `annotations` | places and zones of a running robot's map |
//! | `keys` | who belongs to a fleet, and how its members prove it |
//! | `inspect` | topics, maps, trees, health |
//! | `record` | runs as files: recorded, replayed, computed again, compared, told |
//! | `batch` | planning, smoothing and mapping offline |
//! | `localise` | the robot that made a log, in a map |
//! | `slam` | maps and poses from logs; pose graphs, certified |
//! | `bench` | how fast is the bus, how well do robots drive |
//! | `wall_following` | how well a robot follows walls by itself, and with which gains best |
//! | `files` | worlds, robots and maps by file or shipped name |
//! | `drawing` | pictures: maps, worlds, films, trees |
//! | `completion` | which names a shell may offer: shipped ones, and those on the bus |
//! | `output`, `failure` | tables and JSON; errors with their exit codes |

pub mod annotations;
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
pub mod files;
pub mod gateway;
pub mod goal;
mod greeting;
mod health;
pub mod hosts;
pub mod inspect;
pub mod keys;
pub mod launch;
pub mod live_map;
pub mod localise;
pub mod lockstep;
pub mod netem;
pub mod operator;
pub mod output;
pub mod record;
pub mod report;
mod rest;
pub mod slam;
pub mod wall_following;
pub mod world_server;

pub use zenav_edge::exit_code;

/// Runs the command line of this process; the exit codes stand in [`exit_code`].
#[must_use]
pub fn main() -> std::process::ExitCode {
    cli::main()
}

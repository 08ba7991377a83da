//! Goals that cannot be lost: one robot's orchestrator on behaviour trees.
//!
//! A goal is acknowledged only once it is on disk, survives a restart of any process, and ends in exactly one of `Succeeded`,
//! `Aborted`, `Canceled`, `Rejected`. The mission holds the robot's lease, and it alone publishes the plan that moves the robot; it rechecks
//! that plan against the newest map and renews it before it expires. [`Mission::step`] is pure: time and messages in, [`Effect`]s out, the
//! first of which is what to persist before anything else is done. A thin service carries the effects out (`zenav-cloud`), or a test
//! does (`examples/by_hand.rs`).
//!
//! Requests are idempotent by id within a window: see [`goals`].
//!
//! | file | answers |
//! |---|---|
//! | [`config`] | what can be set? |
//! | [`io`] | what goes into a step, and what comes out? |
//! | [`orchestrator`], `publishing` | what happens in a step, and what does it store and publish? |
//! | `requests`, [`goal_validation`], [`goals`] | what are clients told, which goals are taken, which are there? |
//! | [`records`], [`store`] | what outlives a crash, and where is it kept? |
//! | [`lease`] | does this mission command the robot? |
//! | [`membership`], [`standby`] | which standbys hold everything, and when may one lead? |
//! | [`robot`], [`map`] | what is known of the robot and its map? |
//! | [`frames`], `spots` | where do goals and plans lie when the map has moved? |
//! | [`transient`] | what of the map may leave again, and since when has it stood there? |
//! | [`motion`] | which plan is in force, and is it still good? |
//! | [`route`] | how does a goal become a motion? plan, then smooth |
//! | [`context`], [`leaves`], [`trees`] | what do the trees' leaves act on, which are there, which trees are shipped? |
//!
//! # A leaf of one's own
//!
//! A behaviour tree's actions and conditions are [`zenav_behaviour_tree::Leaf`]s. One that acts on a robot gets the mission's
//! [`context::Context`]; it is added by name, with its ports, before the first mission begins:
//!
//! ```
//! use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Status};
//! use zenav_mission::context::Context;
//! use zenav_mission::trees;
//!
//! /// SUCCESS while the robot is north of a line.
//! struct IsNorthOf;
//!
//! impl Leaf<Context> for IsNorthOf {
//!     fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
//!         let line: f64 = match io.get("y") {
//!             Ok(line) => line,
//!             Err(wrong) => return io.fail(wrong.to_string()),
//!         };
//!         match ctx.robot.pose() {
//!             Some(pose) if pose.y > line => Status::Success,
//!             _ => Status::Failure,
//!         }
//!     }
//! }
//!
//! trees::add_leaves(|registry| {
//!     let spec = NodeSpec::condition("IsNorthOf", "SUCCESS north of a line.");
//!     registry.leaf(spec.input("y", PortType::Double, "the line, m, map frame"), |_| Box::new(IsNorthOf))
//! })?;
//! let tree = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><IsNorthOf y="2.5"/></BehaviorTree></root>"#;
//! assert!(trees::build(tree).is_ok());
//! # Ok::<(), trees::CannotAdd>(())
//! ```
//!
//! A leaf that takes its time answers `Running` and is ticked again; one with an effect outside remembers what it is about to do
//! ([`zenav_behaviour_tree::LeafIo::remember`]) and does it in the next tick, when that is stored. A program in another language
//! does an action by [`leaves::remote`].

pub mod config;
pub mod context;
pub mod frames;
pub mod goal_validation;
pub mod goals;
pub mod io;
pub mod lease;
pub mod leaves;
pub mod map;
pub mod membership;
pub mod motion;
pub mod orchestrator;
mod publishing;
pub mod records;
mod requests;
pub mod robot;
pub mod route;
mod settings;
mod spots;
pub mod standby;
pub mod store;
pub mod transient;
pub mod trees;

pub use config::MissionConfig;
pub use io::{Answer, Ask, Client, Effect, Inputs, NoAnswer, Ticket};
pub use orchestrator::Mission;
pub use records::{Record, Restored};
pub use settings::{MissionSettings, ObstacleSettings, ProgressSettings, RetrySettings};

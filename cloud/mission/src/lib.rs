//! Goals that cannot be lost: one robot's orchestrator on behaviour trees.
//!
//! A goal is acknowledged only once it is on disk, survives a restart of any process, and ends in exactly one of `Succeeded`, `Aborted`,
//! `Canceled`, `Rejected`. The mission holds the robot's lease, and only the mission publishes the plan that moves the robot; it rechecks
//! that plan against the newest map and renews it before it expires. [`Mission::step`] is pure: time and messages in, [`Effect`]s out, the
//! first of which must be persisted before the others. A thin service carries out the effects (`zenav-cloud`), or a test does
//! (`examples/by_hand.rs`).
//!
//! Requests are idempotent by id within a window: see [`GoalTable`].
//!
//! # Where to begin
//!
//! | question | entry point |
//! |---|---|
//! | How is a mission run? | [`Mission`], from a [`MissionConfig`] and what was [`Restored`] |
//! | What goes in and out of a step? | [`Inputs`] and [`Effect`]; an [`Ask`] of the mission goes out under a [`Ticket`], and comes back as an [`Answer`] or [`NoAnswer`] |
//! | What can be tuned? | [`MissionSettings`] |
//! | Where is kept what survives a crash? | [`MissionStore`]; each [`Record`] is one change of it |
//! | Which goals are there, and how does each end? | [`GoalTable`] |
//! | Which mission commands the robot, and which may lead next? | [`LeaseClient`], [`Membership`], [`judge_entry`], [`may_lead`] |
//! | Which trees are there, and how is one built? | [`trees`] |
//! | What do a tree's leaves act on, and what do they read and write? | [`Context`], [`leaves`] |
//!
//! # A leaf of one's own
//!
//! A behaviour tree's actions and conditions are [`zenav_behaviour_tree::Leaf`]s. A leaf that acts on a robot gets the mission's
//! [`Context`]; it is added by name, with its ports, before the first mission starts:
//!
//! ```
//! use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Status};
//! use zenav_mission::{Context, trees};
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
//! A leaf that takes time returns `Running` and is ticked again; one with an external effect first remembers what it is about to do
//! ([`zenav_behaviour_tree::LeafIo::remember`]) and does it in the next tick, once that is stored. A program in another language can
//! execute an action through the leaf RemoteAction ([`zenav_protocol::messages::RemoteRequest`]).
//!
//! # Files
//!
//! | file | answers |
//! |---|---|
//! | `config`, `settings` | what can be set? |
//! | `io`, `asks` | what are the inputs and outputs of a step, and what has been asked of others? |
//! | `orchestrator`, `publishing` | what happens in a step, and what does it store and publish? |
//! | `requests`, `goal_validation`, `goals` | how are clients answered, which goals are accepted, which are there? |
//! | `records`, `store` | what survives a crash, and where is it kept? |
//! | `lease` | does this mission command the robot? |
//! | `membership`, `standby` | which standbys hold everything, and when may one lead? |
//! | `robot`, `map` | what is known about the robot and its map? |
//! | `frames`, `spots` | where are goals and plans after the map has moved? |
//! | `transient` | which obstacles on the map may leave again, and how long have they been there? |
//! | `motion` | which plan is in force, and is it still free? |
//! | `route` | how does a goal become a motion? plan, then smooth |
//! | `context`, [`leaves`], [`trees`] | what do the trees' leaves act on, which are there, which trees are shipped? |

mod asks;
mod config;
mod context;
mod frames;
mod goal_validation;
mod goals;
mod io;
mod lease;
pub mod leaves;
mod map;
mod membership;
mod motion;
mod orchestrator;
mod publishing;
mod records;
mod requests;
#[cfg(test)]
mod rig;
mod robot;
mod route;
mod settings;
mod spots;
mod standby;
mod store;
mod transient;
pub mod trees;

// A mission and its steps.
pub use config::MissionConfig;
pub use io::{Answer, Ask, Client, Effect, Inputs, NoAnswer, Ticket};
pub use orchestrator::Mission;
pub use settings::{MissionSettings, ObstacleSettings, ProgressSettings, RetrySettings};

// Goals, and what is stored of them.
pub use goal_validation::GOAL_TOLERANCE;
pub use goals::{GoalTable, goal_reply};
pub use records::{Leadership, QueueOrder, Record, Restored, RunningTree, StoredGoal};
pub use store::{MissionStore, StoreError};

// Several missions for one robot.
pub use lease::LeaseClient;
pub use membership::Membership;
pub use standby::{JournalPosition, JournalVerdict, judge_entry, may_lead};

// What leaves act on.
pub use asks::Asks;
pub use context::{ActiveGoal, Context};
pub use frames::{GoalAnchors, MapFrames};
pub use map::RobotMap;
pub use motion::{MotionKeeper, PlanDraft, PlanStatus};
pub use robot::RobotView;
pub use route::{Route, RouteData};

//! The off-board side of zenav: what a robot's readings and goals become.
//!
//! | module | answers |
//! |---|---|
//! | [`space`] | where may the robot be? configuration space, distances, exact checks |
//! | [`planning`] | is there a way? searches |
//! | [`smoothing`] | how does it drive a way, in time? |
//! | [`behaviour_tree`] | what comes next? an engine that knows no robot |
//! | [`worker_host`] | how does a worker that answers questions live on the network? |
//! | [`mission`] | which goal is driven, and how is none lost? |
//! | [`dispatch`] | which robot of a group does a goal? |
//!
//! # A leaf of one's own
//!
//! A behaviour tree's actions and conditions are [`behaviour_tree::Leaf`]s. One that acts on a robot gets the mission's
//! [`mission::context::Context`]; it is added by name, with its ports, before the first mission begins:
//!
//! ```
//! use zenav_cloud::behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Status};
//! use zenav_cloud::mission::context::Context;
//! use zenav_cloud::mission::trees;
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
//! ([`behaviour_tree::LeafIo::remember`]) and does it in the next tick, when that is stored. A program in another language
//! does an action by [`mission::leaves::remote`].

pub mod behaviour_tree;
pub mod dispatch;
pub mod mapping;
pub mod mission;
pub mod planning;
pub mod smoothing;
pub mod space;
pub mod worker_host;

//! A behaviour-tree engine independent of any robot.
//!
//! A behaviour tree is a program of nodes that are *ticked*: from the root downwards, many times a second, each node answers `Running`,
//! `Success`, `Failure` or `Skipped`, and control nodes decide by these answers which child is ticked next. Trees are BehaviorTree.CPP v4
//! XML, as written by Groot2; the semantics of every node are those of BehaviorTree.CPP 4.10 and, with the feature `nav2` (on by default),
//! Nav2 1.5, except where a node's documentation says otherwise.
//!
//! The engine has no clock and does no I/O: [`Tree::tick`] is given the time and a context `C` that only the leaves interpret. A running
//! tree can be stored between two ticks ([`Tree::snapshot`]) and resumed later ([`Tree::restore`]), also in another process.
//!
//! ```
//! use std::time::Duration;
//! use zenav_behaviour_tree::{NodeSpec, Registry, Status, build};
//!
//! // The context is the battery's charge; a leaf is a function of it.
//! let mut registry: Registry<f64> = Registry::new();
//! registry.function(NodeSpec::condition("Charged", "SUCCESS above 20 %."), |_, charge: &mut f64| {
//!     if *charge > 0.2 { Status::Success } else { Status::Failure }
//! })?;
//! registry.function(NodeSpec::action("Charge", "Charges by 10 %."), |_, charge: &mut f64| {
//!     *charge += 0.1;
//!     Status::Running
//! })?;
//! let file = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
//!     <ReactiveFallback><Charged/><Charge/></ReactiveFallback>
//! </BehaviorTree></root>"#;
//! let mut tree = build("main.xml", file.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into()))?;
//! let mut charge = 0.15;
//! assert_eq!(tree.tick(Duration::ZERO, &mut charge)?, Status::Running);
//! assert_eq!(tree.tick(Duration::from_millis(10), &mut charge)?, Status::Success);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! | module | answers |
//! |---|---|
//! | `status`, `value`, `ports`, `blackboard` | what nodes exchange |
//! | `registry`, `leaf` | how external code becomes a node |
//! | `node`, `nodes` | what a node is; the built-in ones, one row each |
//! | `tree`, `tick`, `snapshot`, `report` | how a tree runs, is stored, is displayed |
//! | `script` | the scripting language in attributes |
//! | `xml` | how a file becomes a tree, or a list of errors |
//! | [`nav2`] | Nav2's nodes |
//! | [`simulate`] | a tree against scripted leaves in simulated time |

mod blackboard;
mod leaf;
#[cfg(feature = "nav2")]
pub mod nav2;
mod node;
mod nodes;
mod ports;
mod registry;
mod report;
mod script;
pub mod simulate;
mod snapshot;
mod status;
#[cfg(test)]
mod tests;
mod tick;
mod tree;
mod value;
mod xml;

pub use blackboard::{Blackboard, TypeError};
pub use leaf::{Decorator, Enter, Leaf, LeafIo};
pub use ports::{Direction, LiteralRules, PortError, PortSpec, PortType};
pub use registry::{Category, DuplicateNode, LeafSite, NodeSpec, Registry};
pub use report::NodeReport;
pub use snapshot::{RestoreError, TreeSnapshot};
pub use status::Status;
pub use tree::{TickError, Tree};
pub use value::{FromValue, MOST_NESTED, Value, ValueType, is_nested_within};
pub use xml::{Include, Limits, Summary, TreeError, TreeErrors, build, build_within, check, inline};

//! A behaviour-tree engine that knows no robot.
//!
//! Trees are BehaviorTree.CPP v4 XML, as Groot2 writes it; the semantics of every node are those
//! of BehaviorTree.CPP 4.10 and Nav2 1.5, except where a node's documentation says otherwise.
//!
//! | file | answers |
//! |---|---|
//! | `status`, `value`, `ports`, `literals`, `blackboard` | what nodes exchange |
//! | `registry`, `leaf` | how code outside becomes a node |
//! | `node`, `builtins` | what a node is, and which ones exist |
//! | `tree`, `tick`, `snapshot`, `report` | how a tree runs, is stored, is shown |
//! | `controls`, `reactive`, `parallel`, `branches`, `decorators`, `timing`, `updates`, `loops`, `leaves`, `nav2`, `nav2_pause` | what each node does |
//! | `nav2_conditions`, `nav2_gates` | Nav2's conditions and decorators that the blackboard, or where a robot is, decides |
//! | `script` | the language inside attributes |
//! | `xml` | how a file becomes a tree, or a list of errors |
//! | `nav2_nodes` | Nav2's nodes and their ports, as data |
//! | `simulate` | a tree against scripted leaves in simulated time |
//! | `samples` | trees to measure the engine with |
//!
//! The engine has no clock and does no I/O: [`Tree::tick`] is given the time and a context `C`
//! that only the leaves understand. What runs can be stored between two ticks
//! ([`Tree::snapshot`]) and taken up again later ([`Tree::restore`]).

mod blackboard;
mod branches;
mod builtins;
mod controls;
mod decorators;
mod leaf;
mod leaves;
mod literals;
mod loops;
mod nav2;
mod nav2_conditions;
mod nav2_gates;
mod nav2_nodes;
mod nav2_pause;
mod node;
mod parallel;
mod ports;
mod reactive;
mod registry;
mod report;
pub mod samples;
mod script;
pub mod simulate;
mod snapshot;
mod status;
#[cfg(test)]
mod tests;
mod tick;
mod timing;
mod tree;
mod updates;
mod value;
mod xml;

pub use blackboard::{Blackboard, TypeError};
pub use leaf::{Gate, Leaf, LeafIo, Pass};
pub use literals::{Pose, nav2_list, pose, pose_of_json};
pub use nav2_conditions::beside_path;
pub use nav2_conditions::nav2_condition;
pub use nav2_gates::{Measure, Travel, nav2_decorator};
pub use nav2_nodes::nav2_nodes;
pub use ports::{Direction, PortError, PortSpec, PortType};
pub use registry::{Category, DuplicateNode, LeafSite, NodeSpec, Registry};
pub use report::NodeReport;
pub use snapshot::{RestoreError, TreeSnapshot};
pub use status::Status;
pub use tree::{TickError, Tree};
pub use value::{FromValue, Value, ValueType};
pub use xml::{Include, Limits, Summary, TreeError, TreeErrors, build, build_within, check, inline};

//! Messages. What crosses the wire between robot, cloud and operator?
//!
//! Plain structs with serde, one file for each stage of the data path. Conventions for all of them:
//!
//! * SI units; angles in radians, yaw counter-clockwise in (-π, π]; coordinates in the map frame unless the field says otherwise.
//! * A message carries the stamp of its writer's own clock; clocks of two machines are never compared.
//! * A receiver ignores unknown fields, and a missing optional field takes its default.
//! * A request that changes something carries the lease's `epoch`, and an id under which a repeated request gets the first answer.
//!
//! ```
//! use zenav_protocol::messages::{GoalRequest, OnBusy};
//!
//! // As typed into any Zenoh client: everything but the place is optional.
//! let tea: GoalRequest = serde_json::from_str(r#"{"id": "tea-1", "place": "stove", "deadline_secs": 300}"#)?;
//! assert_eq!((tea.place.as_deref(), tea.on_busy), (Some("stove"), OnBusy::Queue));
//! let at_once = GoalRequest { x: Some(2.0), y: Some(1.5), on_busy: OnBusy::Preempt, ..GoalRequest::default() };
//! assert_eq!(serde_json::to_string(&at_once)?, r#"{"x":2.0,"y":1.5,"on_busy":"preempt","priority":0}"#);
//! # Ok::<(), serde_json::Error>(())
//! ```
//!
//! | file | subject |
//! |---|---|
//! | [`sensors`](crate::sensors) | sensor readings as the robot publishes them |
//! | `localise` | asks how well the robot is localised, gives its pose, or starts a search for it |
//! | `estimate` | the robot's pose estimate, and corrections to it |
//! | `frame` | how loop closures moved the map |
//! | `graph` | SLAM's pose graph, for pictures |
//! | `state`, `event` | what the robot is doing, and what happened on it |
//! | `obstacles` | moving obstacles tracked by the robot |
//! | `intent` | a robot's announced motion, for other robots |
//! | `lease` | who may command the robot |
//! | `control` | stop, teleop, modes, parameters |
//! | `behaviour` | maneuvers that the robot executes by itself |
//! | `map` | the occupancy grid map and its patches |
//! | `annotations` | places and zones of the map |
//! | `plan`, `motion` | plans, and requests to planners and smoothers |
//! | `goal`, `mission` | goals, their states, and the running behaviour tree |
//! | `journal` | replication of a mission's store to its standbys |
//! | `remote` | actions of a behaviour tree that other programs execute |
//! | `body` | a robot body in another process |
//! | `log` | the newest lines of a process's log |
//! | `schema` | the JSON Schema of a message |
//! | `refusal` | why a request was refused |

mod annotations;
mod behaviour;
mod body;
mod control;
mod estimate;
mod event;
mod frame;
mod goal;
mod graph;
mod intent;
mod journal;
mod lease;
mod localise;
mod log;
mod map;
mod mission;
mod motion;
mod obstacles;
mod plan;
mod refusal;
mod remote;
mod schema;
mod state;

pub use annotations::*;
pub use behaviour::*;
pub use body::*;
pub use control::*;
pub use estimate::*;
pub use event::*;
pub use frame::*;
pub use goal::*;
pub use graph::*;
pub use intent::*;
pub use journal::*;
pub use lease::*;
pub use localise::*;
pub use log::*;
pub use map::*;
pub use mission::*;
pub use motion::*;
pub use obstacles::*;
pub use plan::*;
pub use refusal::*;
pub use remote::*;
pub use schema::*;
pub use state::*;

pub use crate::sensors::{Battery, Bump, Gps, Imu, Scan};

//! The contract of robot and cloud, as a model that is checked exhaustively within stated bounds.
//!
//! Each part of the contract is a small system: a few processes, a network that delays, reorders, repeats and loses, and clocks that count in
//! ticks. Its transitions are the functions that the robot and the missions themselves run ([`zenav_protocol::lease`],
//! [`zenav_edge::authority`], [`zenav_edge::acceptance`], [`zenav_edge::active_plan`], [`zenav_mission::goals`],
//! [`zenav_mission::lease`], [`zenav_mission::membership`], [`zenav_mission::standby`]); what the model adds is the order in which things may
//! happen. All orders are tried, breadth first, so a violation comes with a shortest trace.
//!
//! A rule that is taken out is taken out by what the function is given or by what becomes of its answer; the functions stay as they are.
//! What must happen at all for a part to show anything is a claim as well: an example of it is sought, and must be found.
//!
//! | file | part of the contract |
//! |---|---|
//! | [`lease`] | who may command: grants, epochs, heartbeats, an operator, a restart of the robot |
//! | [`plan`] | how long a plan moves the robot: validity, revisions, boots, stops |
//! | [`goals`] | what becomes of a goal: stored, told, ended, over crashes |
//! | [`handover`] | two orchestrators: join, catch up, take over; a paused leader that wakes |
//! | [`check`] | the run of a checker, and what it found |
//! | [`network`], [`text`] | messages under way; states that are compared by what they show |
//!
//! `docs/model.md` states the bounds, the sizes and the shortest trace without each rule.

pub mod check;
pub mod goals;
pub mod handover;
pub mod lease;
pub mod network;
pub mod plan;
pub mod text;

pub use check::{Outcome, Part, Size};

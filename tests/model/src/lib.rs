//! The contract of robot and cloud, as a model that is checked exhaustively within stated bounds.
//!
//! Each part of the contract is a small system: a few processes, a network that delays, reorders, duplicates and loses messages, and clocks
//! that count in ticks. Its transitions call the functions that the robot and the missions run ([`zenav_protocol::lease`],
//! [`zenav_edge::authority`], [`zenav_edge::acceptance`], [`zenav_edge::active_plan`], [`zenav_mission::GoalTable`],
//! [`zenav_mission::LeaseClient`], [`zenav_mission::Membership`], [`zenav_mission::judge_entry`]); the model adds only the order of events. All orders are explored, breadth
//! first, so a violation comes with a shortest trace.
//!
//! A rule is disabled by altering the inputs or the answers of these functions; the functions themselves are unchanged. Events that must be
//! possible for a part to be meaningful are claims as well: the checker must find an example.
//!
//! | file | part of the contract |
//! |---|---|
//! | [`lease`] | who may command: grants, epochs, heartbeats, round trips, an operator, a restart of the robot |
//! | [`plan`] | how long a plan moves the robot: validity, revisions, boots, stops |
//! | [`stop`] | a stop holds until a resume of the newest stop: copies, late requests, restarts of the robot |
//! | [`goals`] | the life of a goal: stored, told, ended, across crashes |
//! | [`handover`] | two orchestrators: join, catch up, take over; a paused leader that wakes |
//! | [`check`] | a run of the checker, and its outcome |
//! | [`network`], [`text`] | messages in transit; states that are compared by their `Debug` text |
//!
//! `docs/model.md` states the bounds, the sizes and the shortest trace without each rule.

pub mod check;
pub mod goals;
pub mod handover;
pub mod lease;
pub mod network;
pub mod plan;
pub mod stop;
pub mod text;

pub use check::{ContractModel, Outcome, Size};

//! The robot's side of zenav: it senses, drives and keeps itself safe, with or without a cloud.
//!
//! [`Pilot`] is the whole of it, pure: readings and mail in, wheel speeds and messages out. [`service::run`] feeds it
//! from the bus and a [`Body`] on its own thread. In the order of the data way:
//!
//! | module | answers |
//! |---|---|
//! | [`body`] | what must a robot be able to do to be driven? |
//! | [`estimator`], [`history`] | where is the robot, and where was it? |
//! | [`surroundings`], [`intruders`], [`traces`], [`trodden`] | what stands around it, what of it moves, and what was never seen? |
//! | [`authority`], [`link`] | who may command it, and what may move it? |
//! | [`acceptance`] | may this plan move it? |
//! | [`course`], [`trackers`] | how is an accepted plan driven, renewed and ended? |
//! | [`behaviours`], [`recoveries`], [`mod@nearest_free`], [`teleop`], [`wall_follower`], [`homing`] | what moves it without a plan? |
//! | [`limiter`], [`guard`], [`stopping`], [`contact`] | may it move as it wants to? |
//! | [`motors`] | how do both wheels slow down together? |
//! | [`desk`], [`params`], [`journal`], [`telemetry`] | what does it answer, tell and publish? |
//! | [`pilot`], [`mailbox`], [`config`] | what does it do in one tick? |
//! | [`control`], [`punctuality`], [`exchange`] | when does the pilot step, how late, and how does it meet the network? |
//! | [`service`], [`state_file`] | how is it fed from the bus, and what outlives a restart? |
//! | [`remote_body`], `sim_body` (feature `sim`) | how is a robot in another process a body, how a simulated one in this process? |

pub mod acceptance;
mod aim;
pub mod authority;
pub mod behaviours;
pub mod body;
pub mod config;
pub mod contact;
pub mod control;
pub mod course;
pub mod desk;
pub mod estimator;
pub mod exchange;
pub mod guard;
pub mod history;
pub mod homing;
pub mod intruders;
pub mod journal;
pub mod limiter;
pub mod link;
pub mod mailbox;
pub mod motors;
pub mod nearest_free;
pub mod params;
pub mod pilot;
pub mod punctuality;
pub mod recoveries;
pub mod remote_body;
pub mod service;
#[cfg(feature = "sim")]
pub mod sim_body;
pub mod state_file;
pub mod stopping;
pub mod surroundings;
pub mod telemetry;
pub mod teleop;
pub mod traces;
pub mod trackers;
pub mod trodden;
mod view;
pub mod wall_follower;

pub use body::{Body, BodyError};
pub use config::EdgeConfig;
pub use mailbox::{Answer, Inbox, Outbox, Persisted, Publication, Question, Ticket};
pub use pilot::Pilot;
pub use remote_body::{AttachError, Attached, RemoteBody};
pub use service::{EdgeError, ServiceConfig, run};
#[cfg(feature = "sim")]
pub use sim_body::{Referee, SimBody};

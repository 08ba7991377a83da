//! The robot's side of zenav: it senses, drives and keeps itself safe, with or without a cloud.
//!
//! [`Pilot`] is the whole of it, pure: readings and messages in, wheel speeds and messages out. [`service::run`] connects it to the bus
//! and to a [`Body`], on a thread of its own. In the order of the data flow:
//!
//! | module | answers |
//! |---|---|
//! | [`body`] | what must hardware offer to be driven? |
//! | `encoder_watch` | what have the wheels turned when their encoders say nothing new? |
//! | [`estimator`], [`history`] | where is the robot, and where was it? |
//! | `gyro_settling` | is the gyro's bias known well enough where nothing else tells the heading? |
//! | `lost_beams` | which beams met nothing, and which did the lidar lose? |
//! | [`local_obstacles`], [`moving_obstacles`], [`obstacle_tracks`], `slow_movers`, [`recent_places`], [`blind_spot_grid`] | which obstacles are around it, which of them move, and what was never seen? |
//! | [`authority`], [`link`] | who may command it, and how old is the last word of who does? |
//! | [`acceptance`] | may this plan move it? |
//! | [`active_plan`], [`trackers`] | how is an accepted plan driven, renewed and ended? |
//! | [`arbitration`] | which source moves it: plan, teleop, maneuver, wall follower, return to home, or nothing? |
//! | [`maneuvers`], [`teleop`], [`wall_follower`], [`return_home`] | what moves it without a plan? |
//! | [`right_of_way`] | where does it wait for other robots that go first? |
//! | [`avoidance`] | does the plan lead into the way of somebody, and what does the robot do instead? |
//! | [`limiter`], [`collision_monitor`], [`passive_safety`], [`time_to_contact`] | may it move as it wants to? |
//! | [`wheel_coordination`] | how do both wheels slow down together? |
//! | [`requests`], [`params`], [`event_log`], [`telemetry`], [`uplink`] | what does it answer, record and publish, and how much of it? |
//! | [`pilot`], [`control_io`] | what does it do in one tick? |
//! | [`config`], [`settings`] | what can be set and tuned? |
//! | `control`, [`loop_timing`], [`handoff`] | when does the pilot step, how late, and how does it exchange messages with the network? |
//! | [`exit_code`] | what does a command end with? |
//! | [`service`], [`state_file`] | how is it connected to the bus, and what outlives a restart? |
//! | [`remote_body`], `sim_body` (feature `sim`) | how is a robot in another process a body, how a simulated one in this process? |

pub mod acceptance;
pub mod active_plan;
pub mod arbitration;
pub mod authority;
pub mod avoidance;
pub mod blind_spot_grid;
pub mod body;
pub mod body_clock;
pub mod collision_monitor;
pub mod config;
mod control;
pub mod control_io;
pub mod course;
mod deskewing;
mod encoder_watch;
pub mod estimator;
pub mod event_log;
pub mod exit_code;
mod field_of_view;
mod gyro_settling;
pub mod handoff;
pub mod history;
pub mod limiter;
pub mod link;
pub mod local_obstacles;
pub mod loop_timing;
mod lost_beams;
pub mod maneuvers;
mod metrics;
pub mod moving_obstacles;
pub mod obstacle_tracks;
pub mod other_robots;
pub mod params;
pub mod passive_safety;
pub mod pilot;
mod range_filter;
mod range_noise;
pub mod recent_places;
pub mod remote_body;
pub mod requests;
pub mod return_home;
pub mod right_of_way;
mod scan_reprojection;
pub mod service;
pub mod settings;
#[cfg(feature = "sim")]
pub mod sim_body;
mod slow_movers;
pub mod state_file;
pub mod telemetry;
pub mod teleop;
pub mod time_to_contact;
mod trace;
pub mod trackers;
pub mod uplink;
pub mod wall_follower;
pub mod wheel_coordination;

pub use body::{Body, BodyError};
pub use config::EdgeConfig;
pub use control_io::{Inbox, Outbox, Persisted, Publication, Ticket};
pub use pilot::Pilot;
pub use remote_body::{AttachError, Attached, RemoteBody};
pub use service::{EdgeError, ServiceConfig, run};
pub use settings::EdgeSettings;
#[cfg(feature = "sim")]
pub use sim_body::{Referee, SimBody};

//! The robot's side of zenav: it senses, drives and keeps itself safe, with or without a cloud.
//!
//! [`Pilot`] is the whole control logic, pure: readings and messages in, wheel speeds and messages out. [`service::run`] connects it to the
//! bus and to a [`Body`], on its own thread. In the order of the data flow:
//!
//! | module | answers |
//! |---|---|
//! | [`body`] | what must a robot's hardware provide? |
//! | `encoder_watch` | how far have the wheels turned while their encoders are silent? |
//! | [`estimator`], [`history`] | where is the robot, and where was it? |
//! | `fixes` | which measurements by GPS and compass go out with a scan? |
//! | `gyro_settling` | is the gyro's bias known well enough where nothing else gives the heading? |
//! | `mount_watch` | does a lidar look where its file says? |
//! | `lost_beams` | which beams without a return hit nothing, and which did the lidar lose? |
//! | [`local_obstacles`], [`moving_obstacles`], [`obstacle_tracks`], `slow_movers`, [`recent_places`], [`blind_spot_grid`] | which obstacles are near, which move, which floor is unseen? |
//! | `contact_memory` | what has the robot touched that no beam shows? |
//! | `blind_corners` | where could somebody stand behind a corner, unseen, and come out? |
//! | [`authority`], [`link`] | who may command the robot, and how long ago was the lease renewed? |
//! | [`acceptance`] | may this plan move the robot? |
//! | [`active_plan`], [`trackers`] | how is an accepted plan driven, renewed and ended? |
//! | [`arbitration`] | which source moves the robot: plan, teleop, maneuver, wall follower, return to home, or none? |
//! | [`maneuvers`], [`teleop`], [`wall_follower`], [`return_home`] | what moves the robot without a plan? |
//! | [`right_of_way`] | where does the robot wait for robots that have right of way? |
//! | [`avoidance`] | does the plan lead into the path of a moving obstacle, and what does the robot do instead? |
//! | [`limiter`], [`collision_monitor`], [`passive_safety`], [`time_to_contact`] | how much of the wanted motion is safe? |
//! | [`wheel_coordination`] | how do both wheels slow down together? |
//! | [`requests`], [`params`], [`event_log`], [`telemetry`], [`uplink`] | what does the robot answer, record and publish, and how much of it? |
//! | [`pilot`], [`control_io`] | what does the robot do in one tick? |
//! | [`config`], [`settings`] | what can be set and tuned? |
//! | `control`, [`loop_timing`], [`handoff`] | when does the pilot step, how late is it, and how does it exchange messages with the network? |
//! | [`exit_code`] | which exit code does a command return? |
//! | [`service`], [`state_file`] | how is the edge connected to the bus, and what survives a restart? |
//! | [`remote_body`], `sim_body` (feature `sim`) | how does a robot in another process become a body, and how does a simulated one in this process? |

pub mod acceptance;
pub mod active_plan;
pub mod arbitration;
pub mod authority;
pub mod avoidance;
mod blind_corners;
pub mod blind_spot_grid;
pub mod body;
pub mod body_clock;
pub mod collision_monitor;
pub mod config;
mod contact_memory;
mod control;
pub mod control_io;
pub mod course;
mod deskewing;
mod encoder_watch;
pub mod estimator;
pub mod event_log;
pub mod exit_code;
mod field_of_view;
mod fixes;
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
mod mount_watch;
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

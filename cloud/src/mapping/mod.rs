//! Mapping service. Scans in; map description, patches and answers out.
//!
//! Thin: [`MappingCore`] decides what the map is. Of several services for one robot, one leads and the others follow.
//!
//! | file | subject |
//! |---|---|
//! | `config` | what a mapping service is given, and why it does not run |
//! | `service` | joining the bus; leading and following in turn |
//! | `succession` | which of several services writes the map |
//! | `follow` | what a copy keeps while another service leads |
//! | `lead` | one leadership, from its first beat to its end: scans, requests, publications |
//! | `annotations` | places and zones of the map |
//! | `core` | poses from which scans are drawn, and corrections for the robot |
//! | `slam_redraw` | SLAM's map drawn anew beside the scans that arrive |
//! | `slam_search` | search of SLAM's whole map for the robot |
//! | `own_poses`, `slam_poses`, `localised_poses` | poses by the robot itself, by SLAM, by localisation in a known map |
//! | `slam_session` | the SLAM state that outlives the process |
//! | `storage` | the robot's folder: its lock, its last term, the map at the start |
//! | `metrics` | ages, durations and sizes; which copy leads, and how well the others follow |

mod annotations;
mod config;
mod core;
mod follow;
mod lead;
mod localised_poses;
mod metrics;
mod own_poses;
mod service;
mod slam_poses;
mod slam_redraw;
mod slam_search;
mod slam_session;
mod storage;
mod succession;
#[cfg(test)]
mod tests;

pub use annotations::annotations_of;
pub use config::{KnownMap, MappingConfig, MappingError};
pub use core::{Mapped, MappingCore, PoseSettings, PoseSource};
pub use service::run;

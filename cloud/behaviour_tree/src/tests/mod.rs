//! Tests of the engine as a whole: one test per row of the semantics table, whole trees, invalid files, snapshots.

mod bad_files;
mod branches;
mod controls;
mod decorators;
mod errors;
mod extensions;
mod guards;
#[cfg(feature = "nav2")]
mod nav2;
#[cfg(feature = "nav2")]
mod nav2_robot;
#[cfg(feature = "nav2")]
mod navigation;
mod properties;
mod rig;
mod snapshots;
mod subtrees;

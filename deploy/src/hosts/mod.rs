//! `zenav deploy`: renders a deployment of many hosts, and checks whether it runs as intended.
//!
//! | file | answers |
//! |---|---|
//! | `part` | what can run on a host? |
//! | `layout` | which part runs where, where does it listen, and what does it dial? |
//! | `problems` | what is wrong with the hosts of a deployment? |
//! | `command_line` | with which arguments is `zenav` started for a part? |
//! | `systemd`, `compose`, `kubernetes`, `readme` | units, containers, manifests, instructions |
//! | `zenoh_settings` | how does a program of another kind link to its host's routers or robot? |
//! | `files` | which files are rendered? |
//! | `named_files` | which files does a deployment name, that its hosts need too? |
//! | `running` | which parts of a deployment run, as seen on the bus? |
//! | `health` | is a part on this machine ready? |
//!
//! Everything is pure except `command`, `named_files` and `health`.

mod command;
mod command_line;
mod compose;
pub mod files;
mod health;
mod kubernetes;
pub mod layout;
mod named_files;
pub mod part;
mod problems;
mod readme;
pub mod running;
mod systemd;
#[cfg(test)]
mod tests;
mod zenoh_settings;

pub use command::{DeployArgs, deploy};
pub(crate) use named_files::images;

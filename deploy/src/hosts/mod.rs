//! `zenav deploy`: how does a deployment of many hosts get onto them, and does it run as it was meant?
//!
//! | file | answers |
//! |---|---|
//! | `part` | what can run on a host? |
//! | `layout` | which part runs where, listens where, dials whom? |
//! | `problems` | what is wrong with the hosts of a deployment? |
//! | `command_line` | what is `zenav` started with for a part? |
//! | `systemd`, `compose`, `kubernetes`, `readme` | units, containers, manifests, instructions |
//! | `files` | which files are rendered? |
//! | `named_files` | which files does a deployment name, which its hosts need too? |
//! | `running` | what of a deployment runs, by what is seen on the bus? |
//! | `health` | is a part of this machine ready? |
//!
//! All is pure but `command`, `named_files` and `health`.

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

pub use command::{DeployArgs, deploy};
pub(crate) use named_files::images;

//! Zenoh's threads. How many does a process need in which sessions live?
//!
//! All sessions of a process share Zenoh's runtimes, two threads that receive and one for the network by default. Both can be kept waiting for
//! room on a link, for up to five seconds, until Zenoh cuts the link:
//!
//! - A router's receiving thread waits while the next hop has not taken a large message, and so does every other one that has something for
//!   the same hop. With both waiting the router serves nobody; and if the hop is a session of the same process it is never read.
//! - The heartbeats of advanced publishers run on the network's thread. One that waits for a queue which somebody else holds keeps waiting all
//!   that runs there, and that is, after a link came back, the QUIC connection itself: it sends nothing, and the queue never gets room.
//!
//! There must be more threads than links of a router, and about as many as a process's sessions have publishers. Zenoh takes their numbers from
//! the environment alone, and a process may not safely change its own: it starts itself anew, as the same process, with the variable set.

use std::ffi::OsStr;

use tokio::runtime::{Handle, RuntimeFlavor};

/// What Zenoh reads, once, when the first session opens.
const VARIABLE: &str = "ZENOH_RUNTIME";
/// More than the router of one machine has links, and eight robots publishers. All of them idle cost 1.6 MB (`VmRSS` of a motion worker).
const ENOUGH: &str = "(rx: (worker_threads: 64), net: (worker_threads: 64))";

/// Sends what may wait for room on a link; the other tasks of this thread go on elsewhere meanwhile.
pub(super) fn waiting_for_room<R>(send: impl FnOnce() -> R) -> R {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => tokio::task::block_in_place(send),
        _ => send(),
    }
}

/// Returns at once when this process has enough threads of Zenoh's, or its user has chosen their number; else starts it anew. To be called
/// before the process has done anything else.
pub fn ensure_enough() {
    if std::env::var_os(VARIABLE).is_none() {
        restart_with(ENOUGH.as_ref());
    }
}

#[cfg(unix)]
fn restart_with(value: &OsStr) {
    // Returns only when it fails; the default does for small messages over TCP.
    let error = anew(Some(value));
    tracing::warn!(%error, "cannot restart with more threads for Zenoh");
}

/// Starts this process anew, as the same process with the same arguments.
///
/// # Errors
/// Returns only when that fails.
#[cfg(unix)]
#[must_use]
pub fn restart() -> std::io::Error {
    anew(None)
}

#[cfg(unix)]
fn anew(value: Option<&OsStr>) -> std::io::Error {
    use std::os::unix::process::CommandExt as _;
    let program = match std::env::current_exe() {
        Ok(program) => program,
        Err(error) => return error,
    };
    let mut command = std::process::Command::new(program);
    command.args(std::env::args_os().skip(1));
    command.envs(value.map(|value| (VARIABLE, value)));
    command.exec()
}

#[cfg(not(unix))]
fn restart_with(value: &OsStr) {
    tracing::warn!("large messages may stall: set {VARIABLE}={}", value.display());
}

/// Starts this process anew: not on this system.
#[cfg(not(unix))]
#[must_use]
pub fn restart() -> std::io::Error {
    std::io::ErrorKind::Unsupported.into()
}

//! Zenoh's threads. How many does a process with sessions need?
//!
//! All sessions of a process share Zenoh's runtimes, by default two receiving threads and one network thread. Both kinds can block until a
//! link has room, for up to five seconds, until Zenoh cuts the link:
//!
//! - A router's receiving thread blocks while the next hop has not taken a large message, and so does every other one with a message for
//!   the same hop. When both are blocked, the router serves nothing; and if the hop is a session of the same process, its messages are
//!   never read.
//! - The heartbeats of advanced publishers run on the network thread. A heartbeat that waits for a queue held by another thread blocks all
//!   tasks of that thread, which include, after a link came back, the QUIC connection itself: it sends nothing, and the queue never gets
//!   room.
//!
//! There must be more receiving threads than a router has links, and about as many network threads as a process's sessions have publishers.
//! Zenoh reads the numbers from the environment only, and a process cannot safely change its own environment: it re-executes itself, as the
//! same process, with the variable set.

use std::ffi::OsStr;

use tokio::runtime::{Handle, RuntimeFlavor};

/// Variable that Zenoh reads, once, when the first session opens.
const VARIABLE: &str = "ZENOH_RUNTIME";
/// More than a single machine's router has links, and than eight robots have publishers. All of them idle cost 1.6 MB (`VmRSS` of a motion
/// worker).
const ENOUGH: &str = "(rx: (worker_threads: 64), net: (worker_threads: 64))";

/// Sends a message that may block until a link has room; the thread's other tasks move to another thread meanwhile.
pub(super) fn waiting_for_room<R>(send: impl FnOnce() -> R) -> R {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => tokio::task::block_in_place(send),
        _ => send(),
    }
}

/// Returns at once if this process has enough Zenoh threads, or its user has set their number; otherwise re-executes it. Call this before
/// the process does anything else.
pub fn ensure_enough() {
    if std::env::var_os(VARIABLE).is_none() {
        restart_with(ENOUGH.as_ref());
    }
}

#[cfg(unix)]
fn restart_with(value: &OsStr) {
    // Returns only on failure; the default is enough for small messages over TCP.
    let error = anew(Some(value));
    tracing::warn!(%error, "cannot restart with more threads for Zenoh");
}

/// Re-executes this process with the same arguments.
///
/// # Errors
/// Returns only on failure.
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
    let mut command = std::process::Command::new(&program);
    // An update has replaced or removed the file: Linux still has what this process runs.
    if cfg!(target_os = "linux") && !program.exists() {
        command = std::process::Command::new("/proc/self/exe");
        command.arg0(std::env::args_os().next().unwrap_or_default());
    }
    command.args(std::env::args_os().skip(1));
    command.envs(value.map(|value| (VARIABLE, value)));
    command.exec()
}

#[cfg(not(unix))]
fn restart_with(value: &OsStr) {
    tracing::warn!("large messages may stall: set {VARIABLE}={}", value.display());
}

/// Re-executes this process: not supported on this system.
#[cfg(not(unix))]
#[must_use]
pub fn restart() -> std::io::Error {
    std::io::ErrorKind::Unsupported.into()
}

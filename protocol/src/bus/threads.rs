//! Receiver threads. How many does Zenoh need in a process with a router?
//!
//! All sessions of a process share Zenoh's receiving threads, two by default. A router's receiving thread waits while the next hop
//! has not taken a large message, and so does every other one that has something for the same hop. With both waiting the router
//! serves nobody; and if the hop is a session of the same process it is never read, until Zenoh cuts its link five seconds later.
//! There must be more threads than links of the router. Zenoh takes their number from the environment alone, and a process may not
//! safely change its own: it starts itself anew, as the same process, with the variable set.

use std::ffi::OsStr;

/// What Zenoh reads, once, when the first session opens.
const VARIABLE: &str = "ZENOH_RUNTIME";
/// More than the router of one machine has links; idle ones cost next to nothing.
const ENOUGH: &str = "(rx: (worker_threads: 64))";

/// Returns at once when this process has enough receiving threads, or its user has chosen their number; else starts it anew.
pub fn ensure_enough() {
    if std::env::var_os(VARIABLE).is_none() {
        restart_with(ENOUGH.as_ref());
    }
}

#[cfg(unix)]
fn restart_with(value: &OsStr) {
    // Returns only when it fails; two threads do for small messages.
    let error = anew(Some(value));
    tracing::warn!(%error, "cannot restart with more receiving threads");
}

/// Starts this process anew, as the same process with the same arguments; returns only when that fails.
#[cfg(unix)]
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
pub fn restart() -> std::io::Error {
    std::io::ErrorKind::Unsupported.into()
}

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
//! same process, with the variable set, and with those of its allocator (`memory`).

use tokio::runtime::{Handle, RuntimeFlavor};

use super::memory;

/// Variable that Zenoh reads, once, when the first session opens.
const VARIABLE: &str = "ZENOH_RUNTIME";
/// More than a single machine's router has links, and than eight robots have publishers. All of them idle cost 1.6 MB (`VmRSS` of a motion
/// worker).
pub(super) const WORKERS: usize = 64;
/// Further threads that are started once so many wait, and end after ten idle seconds: links that are lost at once wait at once
/// ([`settle`](super::link)). With Zenoh's 50, a thousand would wait one after the other for over a second, while nobody reads the rest.
pub(super) const WAITING: usize = 1024;
/// Set with the variables above. A process that has it does not look at them again: a program with file capabilities never sees the
/// allocator's, which the loader removes, and would re-execute itself for ever.
const SET: &str = "ZENAV_RUNTIME_SET";
/// Set in a process that has re-executed itself by [`restart`].
const ANEW: &str = "ZENAV_STARTED_ANEW";

/// Sends a message that may block until a link has room; the thread's other tasks move to another thread meanwhile.
pub(super) fn waiting_for_room<R>(send: impl FnOnce() -> R) -> R {
    match Handle::try_current().map(|runtime| runtime.runtime_flavor()) {
        Ok(RuntimeFlavor::MultiThread) => tokio::task::block_in_place(send),
        _ => send(),
    }
}

/// Returns at once if this process has enough Zenoh threads and the settings of its allocator, or its user has set them; otherwise
/// re-executes it. Call this before the process does anything else.
pub fn ensure_enough() {
    let threads = enough();
    let unset = unset(&threads, |name| std::env::var_os(name).is_some());
    if !unset.is_empty() {
        restart_with(&unset);
    }
}

/// The variables that this process needs and its user has not set, with [`SET`]; none in a process that has re-executed itself for them.
fn unset(threads: &str, is_set: impl Fn(&str) -> bool) -> Vec<(&str, &str)> {
    if is_set(SET) {
        return Vec::new();
    }
    let needed = [(VARIABLE, threads)]
        .into_iter()
        .chain(memory::SETTINGS.iter().copied());
    let mut unset: Vec<_> = needed.filter(|(name, _)| !is_set(name)).collect();
    if !unset.is_empty() {
        unset.push((SET, "1"));
    }
    unset
}

fn enough() -> String {
    let threads = format!("(worker_threads: {WORKERS}, max_blocking_threads: {WAITING})");
    format!("(rx: {threads}, net: {threads})")
}

#[cfg(unix)]
fn restart_with(variables: &[(&str, &str)]) {
    // Returns only on failure; the default is enough for small messages over TCP.
    let error = anew(variables);
    tracing::warn!(%error, "cannot restart with more threads for Zenoh and the settings of the allocator");
}

/// Re-executes this process with the same arguments.
///
/// # Errors
/// Returns only on failure.
#[cfg(unix)]
#[must_use]
pub fn restart() -> std::io::Error {
    anew(&[(ANEW, "1")])
}

/// Whether this process has re-executed itself by [`restart`].
pub(super) fn was_restarted() -> bool {
    std::env::var_os(ANEW).is_some()
}

#[cfg(unix)]
fn anew(variables: &[(&str, &str)]) -> std::io::Error {
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
    command.envs(variables.iter().copied());
    command.exec()
}

#[cfg(not(unix))]
fn restart_with(variables: &[(&str, &str)]) {
    for (name, value) in variables {
        tracing::warn!("large messages may stall: set {name}={value}");
    }
}

/// Re-executes this process: not supported on this system.
#[cfg(not(unix))]
#[must_use]
pub fn restart() -> std::io::Error {
    std::io::ErrorKind::Unsupported.into()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_process_sets_what_its_user_has_not_set() {
        let all = unset("threads", |_| false);
        assert_eq!(all[0], (VARIABLE, "threads"));
        assert_eq!(all[1..=memory::SETTINGS.len()], *memory::SETTINGS);
        assert_eq!(all.last(), Some(&(SET, "1")));
        let own = unset("threads", |name| name == VARIABLE);
        assert!(own.iter().all(|(name, _)| *name != VARIABLE));
        assert_eq!(unset("threads", |name| name != SET), []);
    }

    #[test]
    fn a_process_does_not_start_again_for_variables_that_the_loader_removes() {
        assert_eq!(unset("threads", |name| name == SET), []);
    }
}

//! Process. Uptime, memory, processor time, files and threads of this process, from `/proc` of Linux; empty on other systems.

use std::hash::{BuildHasher as _, RandomState};
use std::sync::LazyLock;
use std::time::{SystemTime, UNIX_EPOCH};

/// Random per process: the standard library seeds each process's hashing differently.
static INSTANCE: LazyLock<u32> = LazyLock::new(|| RandomState::new().hash_one(()) as u32);

/// Ticks of the kernel's counters per second: `USER_HZ`, 100 on every Linux.
const TICKS_PER_SECOND: f64 = 100.0;

/// Facts of this process; `None` for those that the system does not provide.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Facts {
    /// Id of this process.
    pub pid: u32,
    /// Drawn at the start: distinguishes processes with the same id on one machine, as in containers.
    pub instance: u32,
    /// Name of the machine.
    pub host: Option<String>,
    /// Resident memory, bytes.
    pub memory_bytes: Option<u64>,
    /// Processor time since the start, s.
    pub cpu_secs: Option<f64>,
    /// Time since the start, s.
    pub uptime_secs: Option<f64>,
    /// Start, s of UNIX time.
    pub started_unix_secs: Option<f64>,
    /// Open file descriptors.
    pub open_files: Option<u64>,
    /// Threads of this process.
    pub threads: Option<u64>,
}

/// Reads the facts of this process.
#[must_use]
pub fn facts() -> Facts {
    let read = |path: &str| std::fs::read_to_string(path).ok();
    let stat = read("/proc/self/stat");
    let fields = stat.as_deref().map(after_name);
    let field = |number: usize| fields.as_ref()?.get(number)?.parse::<f64>().ok();
    let status = read("/proc/self/status");
    // From the kernel instead of /proc/uptime, which a hardened systemd unit does not see.
    let boot = rustix::time::clock_gettime(rustix::time::ClockId::Boottime);
    let boot_uptime = Some(boot.tv_sec as f64 + 1e-9 * boot.tv_nsec as f64);
    let uptime_secs = boot_uptime
        .zip(field(START))
        .map(|(up, start)| (up - start / TICKS_PER_SECOND).max(0.0));
    Facts {
        pid: std::process::id(),
        instance: *INSTANCE,
        // A hardened unit sees only its own processes in /proc.
        host: read("/proc/sys/kernel/hostname")
            .or_else(|| read("/etc/hostname"))
            .map(|name| name.trim().to_owned()),
        memory_bytes: status.as_deref().and_then(resident),
        cpu_secs: field(USER)
            .zip(field(SYSTEM))
            .map(|(user, system)| (user + system) / TICKS_PER_SECOND),
        started_unix_secs: uptime_secs.map(|uptime| unix_secs() - uptime),
        uptime_secs,
        open_files: std::fs::read_dir("/proc/self/fd")
            .ok()
            .map(|files| files.count() as u64),
        threads: field(THREADS).map(|threads| threads as u64),
    }
}

/// The wall clock, s of UNIX time.
#[must_use]
pub fn unix_secs() -> f64 {
    SystemTime::now()
        .duration_since(UNIX_EPOCH)
        .unwrap_or_default()
        .as_secs_f64()
}

/// Indices of the fields of `/proc/self/stat` after the name: their numbers in proc(5) minus three.
const USER: usize = 11;
const SYSTEM: usize = 12;
const THREADS: usize = 17;
const START: usize = 19;

/// The fields after the program's name, which may contain any character.
fn after_name(stat: &str) -> Vec<&str> {
    stat.rsplit_once(')')
        .map(|(_, rest)| rest.split_whitespace().collect())
        .unwrap_or_default()
}

/// `VmRSS:     1234 kB`.
fn resident(status: &str) -> Option<u64> {
    let line = status.lines().find_map(|line| line.strip_prefix("VmRSS:"))?;
    Some(line.split_whitespace().next()?.parse::<u64>().ok()? * 1024)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_blanks_and_brackets_does_not_shift_the_fields() {
        let stat = "7 (a) b (c)) S 1 7 7 0 -1 4194560 100 0 0 0 250 50 0 0 20 0 5 0 4000 0 0";
        let fields = after_name(stat);
        assert_eq!(
            [fields[USER], fields[SYSTEM], fields[THREADS], fields[START]],
            ["250", "50", "5", "4000"]
        );
        assert_eq!(resident("Name:\tx\nVmRSS:\t    2048 kB\n"), Some(2048 * 1024));
    }

    #[cfg(target_os = "linux")]
    #[test]
    fn this_process_has_an_age_memory_and_files() {
        let facts = facts();
        assert!(facts.memory_bytes.unwrap() > 100_000 && facts.open_files.unwrap() > 0 && facts.threads.unwrap() > 0);
        assert!(facts.uptime_secs.unwrap() < 86_400.0 && facts.cpu_secs.is_some() && facts.host.is_some());
        assert!((facts.started_unix_secs.unwrap() + facts.uptime_secs.unwrap() - unix_secs()).abs() < 5.0);
    }
}

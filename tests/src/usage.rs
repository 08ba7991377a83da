//! Resource usage. Processor time, memory, handles and threads of processes, from Linux's `/proc`.

use thiserror::Error;

/// Clock ticks a second in `/proc` (`USER_HZ`, the same on every Linux architecture in use).
const CLOCK_TICKS: f64 = 100.0;

/// A file of `/proc` that cannot be read.
#[derive(Debug, Error)]
#[error("{0}: no resource usage in it")]
pub struct Unknown(String);

fn read(path: &str) -> Result<String, Unknown> {
    std::fs::read_to_string(path).map_err(|error| Unknown(format!("{path}: {error}")))
}

/// Processor time of a process in user and system mode, s.
///
/// # Errors
/// Without such a process, or without `/proc`.
pub fn cpu_secs(process: u32) -> Result<f64, Unknown> {
    let path = format!("/proc/{process}/stat");
    let stat = read(&path)?;
    // The name in brackets may contain any character; user and system time are the 12th and 13th field after it.
    let fields = stat.rsplit(')').next().unwrap_or_default().split_whitespace();
    let ticks: Option<u64> = fields.skip(11).take(2).map(|field| field.parse::<u64>().ok()).sum();
    ticks.map(|ticks| ticks as f64 / CLOCK_TICKS).ok_or(Unknown(path))
}

/// Time that all processors were busy since the machine's start, s.
///
/// # Errors
/// Without `/proc`.
pub fn busy_secs() -> Result<f64, Unknown> {
    let stat = read("/proc/stat")?;
    // user, nice, system, idle, iowait, irq, softirq
    let line = stat.lines().next().unwrap_or_default().split_whitespace();
    let fields: Vec<u64> = line.skip(1).take(7).map_while(|field| field.parse().ok()).collect();
    match fields.as_slice() {
        [user, nice, system, _, _, irq, soft] => Ok((user + nice + system + irq + soft) as f64 / CLOCK_TICKS),
        _ => Err(Unknown("/proc/stat".to_owned())),
    }
}

/// Resident memory, bytes.
///
/// # Errors
/// Without such a process, or without `/proc`.
pub fn memory(process: u32) -> Result<u64, Unknown> {
    status(process, "VmRSS:")
}

/// Peak resident memory, bytes.
///
/// # Errors
/// Without such a process, or without `/proc`.
pub fn peak_memory(process: u32) -> Result<u64, Unknown> {
    status(process, "VmHWM:")
}

fn status(process: u32, field: &str) -> Result<u64, Unknown> {
    number_in_status(process, field).map(|kib| kib * 1024)
}

fn number_in_status(process: u32, field: &str) -> Result<u64, Unknown> {
    let path = format!("/proc/{process}/status");
    let status = read(&path)?;
    status
        .lines()
        .find_map(|line| line.strip_prefix(field))
        .and_then(|rest| rest.split_whitespace().next()?.parse().ok())
        .ok_or(Unknown(path))
}

/// Resources of a process.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    /// Resident memory, bytes.
    pub memory: u64,
    /// Open files and sockets.
    pub handles: u64,
    /// Threads.
    pub threads: u64,
    /// Processor time since its start, s.
    pub cpu_secs: f64,
}

/// The current resources of a process.
///
/// # Errors
/// Without such a process, or without `/proc`.
pub fn held(process: u32) -> Result<Held, Unknown> {
    let folder = format!("/proc/{process}/fd");
    let handles = std::fs::read_dir(&folder).map_err(|error| Unknown(format!("{folder}: {error}")))?;
    Ok(Held {
        memory: memory(process)?,
        handles: handles.count() as u64,
        threads: number_in_status(process, "Threads:")?,
        cpu_secs: cpu_secs(process)?,
    })
}

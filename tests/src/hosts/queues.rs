//! Queues. Messages and requests that wait in a part to be read, from its own metrics.

use std::path::Path;

use super::checked;

/// Metric of what waits, by part and topic.
const WAITING: &str = "zenav_bus_messages_waiting{";

/// Number of messages and requests that wait in the part of a process, whichever network the part is in.
///
/// # Errors
/// When the part does not serve its metrics.
pub fn waiting(process: u32) -> Result<u64, String> {
    let path = format!("/proc/{process}/cmdline");
    let line = std::fs::read_to_string(&path).map_err(|error| format!("{path}: {error}"))?;
    let address = line.split('\0').skip_while(|word| *word != "--metrics").nth(1);
    let port = address.and_then(|address| address.rsplit(':').next());
    let url = format!(
        "http://127.0.0.1:{}/metrics",
        port.ok_or(format!("{path}: no --metrics"))?
    );
    let (process, get) = (process.to_string(), ["curl", "-sS", "--max-time", "5", &url]);
    let metrics = checked("nsenter", &[&["-t", &process, "-n"], &get[..]].concat(), Path::new("/"))?;
    Ok(sum(&metrics))
}

fn sum(metrics: &str) -> u64 {
    let values = metrics.lines().filter(|line| line.starts_with(WAITING));
    let values = values.filter_map(|line| line.rsplit(' ').next()?.parse::<u64>().ok());
    values.sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_waits_is_added_up_over_all_topics() {
        let metrics = "# TYPE zenav_bus_messages_waiting gauge\n\
                       zenav_bus_messages_waiting{part=\"motion\",topic=\"zenav/{robot}/cloud/map\"} 3\n\
                       zenav_bus_messages_waiting{part=\"motion\",topic=\"zenav/{robot}/edge/state\"} 4\n\
                       zenav_world_robots 9\n";
        assert_eq!(sum(metrics), 7);
    }
}

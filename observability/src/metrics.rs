//! Metrics. Everything that zenav counts and measures is declared in this table; `docs/observability.md` shows it, and a test compares the
//! two.
//!
//! Durations are wall time by a monotonic clock, except the age of a scan, which is in the robot's own (possibly simulated) time. Labels:
//! `robot` (its id), `part` (the kind of a session: `edge`, `mapping`, …, or the session's whole name where the help says so), `topic` (a
//! pattern of the key table), and outcomes of a fixed list.

use std::sync::{Mutex, PoisonError};

use prometheus::{CounterVec, Encoder as _, GaugeVec, HistogramVec, IntCounterVec, IntGaugeVec, TextEncoder};

use crate::declare::{REGISTRY, metrics};
use crate::{process, readiness};

metrics! {
    "control loop" {
        CONTROL_LATENESS: HistogramVec = "zenav_control_tick_lateness_seconds" ["robot"], "How late a control tick began.";
        CONTROL_TICK: HistogramVec = "zenav_control_tick_seconds" ["robot"], "One control tick: readings and messages in, wheel speeds out.";
        COLLISION_MONITOR: HistogramVec = "zenav_collision_monitor_seconds" ["robot"], "The collision monitor's decision of one tick.";
        CONTROL_MISSED: IntCounterVec = "zenav_control_ticks_missed_total" ["robot"], "Control ticks that were skipped because they came too late.";
    }
    "robot" {
        LINK_STATE: GaugeVec = "zenav_link_state" ["robot", "state"], "1 for the state of the robot's link to the holder of its lease: connected, stale, lost.";
        LEASE_HELD: GaugeVec = "zenav_lease_held" ["robot", "role"], "1 for the role that holds the robot's lease: mission, operator, none.";
        LEASE_CHANGES: IntCounterVec = "zenav_lease_changes_total" ["robot"], "Times that the lease changed hands, lapsed or was given back.";
        LINK_LOST: IntCounterVec = "zenav_link_lost_total" ["robot"], "Times that the robot lost the holder of its lease.";
        ROUND_TRIP: GaugeVec = "zenav_round_trip_seconds" ["robot"], "Round trip between the robot and the holder of its lease: the longest of late.";
        GUARD_ZONE: GaugeVec = "zenav_collision_monitor_zone" ["robot", "zone"], "1 for the collision monitor's verdict: clear, slow, stop.";
        BATTERY: GaugeVec = "zenav_battery_charge_ratio" ["robot"], "Charge left, 0 to 1.";
        PLANS: IntCounterVec = "zenav_plans_total" ["robot", "verdict"], "Plans that the robot judged: accepted, renewed, or why it was rejected.";
        STATE_UNSAVED: IntCounterVec = "zenav_robot_state_unsaved_total" ["robot"], "Times that an epoch or a stop was obeyed but could not be stored.";
    }
    "a scan, from beam to cell" {
        SCAN_AGE: HistogramVec = "zenav_scan_age_seconds" ["robot"], "Age of a scan when mapping takes it, by the robot's time.";
        SCAN_INSERTION: HistogramVec = "zenav_scan_insertion_seconds" ["robot"], "One scan: its pose found, and drawn into the map.";
        MAP_PUBLISH: HistogramVec = "zenav_map_publish_seconds" ["robot"], "A patch of the map: made, encoded and handed to the bus.";
        SCANS: IntCounterVec = "zenav_scans_total" ["robot", "outcome"], "Scans that mapping took: inserted, held (the map is not to change), left_out.";
        MAP_CELLS: GaugeVec = "zenav_map_cells" ["robot", "state"], "Cells of the map: free, occupied, unknown.";
        MAP_REVISION: GaugeVec = "zenav_map_revision" ["robot"], "Revision of the map.";
        MAPPING_LEADS: GaugeVec = "zenav_mapping_leads" ["robot"], "1 where this mapping service leads, 0 where it follows.";
        MAP_COPY_AGE: GaugeVec = "zenav_map_copy_age_seconds" ["robot"], "Time since a mapping service that follows last held the newest map that the leader named; 0 where it leads.";
        MAPPING_TAKEOVERS: IntCounterVec = "zenav_mapping_takeovers_total" ["robot"], "Times that this mapping service took over: from another one, or again after it had stepped back.";
    }
    "a goal, to the wheels" {
        GOAL_ACCEPTANCE: HistogramVec = "zenav_goal_acceptance_seconds" ["robot"], "A goal: from its request to the answer, stored here and with every standby.";
        GOALS: GaugeVec = "zenav_goals" ["robot", "state"], "Goals that have not ended: accepted (they wait), active, paused.";
        GOALS_ENDED: IntCounterVec = "zenav_goals_ended_total" ["robot", "state"], "Goals that ended: succeeded, aborted, canceled, rejected.";
        MISSION_LEADS: GaugeVec = "zenav_mission_leads" ["robot"], "1 where this mission leads, 0 where it stands by.";
        TREE_TICK: HistogramVec = "zenav_tree_tick_seconds" ["robot"], "One step of the mission: its inputs taken, its behaviour tree ticked.";
        STORE_WRITE: HistogramVec = "zenav_store_write_seconds" ["robot"], "One batch of records: stored here and with every standby.";
        MOTION_ROUND_TRIP: HistogramVec = "zenav_motion_request_seconds" ["robot", "outcome"], "A motion request of a mission, there and back, workers that failed included: answered, refused, silent.";
        PLAN_ACCEPTANCE: HistogramVec = "zenav_plan_acceptance_seconds" ["robot"], "A new plan: from its publication to the robot's word that it follows it.";
        MOTION_REQUESTS: IntCounterVec = "zenav_motion_requests_total" ["outcome"], "Requests that a motion worker answered: found, no_path, timed_out, refused.";
        PATH_SEARCH: HistogramVec = "zenav_path_search_seconds" [], "The search for a path, of one motion request.";
        SMOOTHING: HistogramVec = "zenav_smoothing_seconds" [], "The smoothing of a path into a trajectory, of one motion request.";
        WORKERS: GaugeVec = "zenav_motion_workers" ["robot"], "Motion workers that a mission knows of.";
    }
    "bus" {
        ROUTER_LINKED: GaugeVec = "zenav_router_linked" ["part"], "1 while a session (its whole name) is linked to a router.";
        ROUTER_RECONNECTS: IntCounterVec = "zenav_router_reconnects_total" ["part"], "Times that a session (its whole name) got its lost router back.";
        ROUTER_LINKS: GaugeVec = "zenav_router_links" ["kind"], "Sessions linked to this router: client, router, peer.";
        BUS_RECEIVED: IntCounterVec = "zenav_bus_messages_received_total" ["part", "topic"], "Messages that arrived on a topic.";
        BUS_RECEIVED_BYTES: IntCounterVec = "zenav_bus_received_bytes_total" ["part", "topic"], "Bytes of the messages that arrived on a topic.";
        BUS_PUBLISHED: IntCounterVec = "zenav_bus_messages_published_total" ["part", "topic"], "Messages published on a topic.";
        BUS_PUBLISHED_BYTES: IntCounterVec = "zenav_bus_published_bytes_total" ["part", "topic"], "Bytes of the messages published on a topic.";
        BUS_DISCARDED: IntCounterVec = "zenav_bus_messages_discarded_total" ["part", "topic", "reason"], "Messages and requests that were not read: dropped (the reader was too slow), rate (far faster than the key's), too_large, undecodable, unpublished.";
        BUS_WAITING: IntGaugeVec = "zenav_bus_messages_waiting" ["part", "topic"], "Messages and requests that wait to be read.";
    }
    "world" {
        WORLD_ROBOTS: GaugeVec = "zenav_world_robots" [], "Robots that stand in the served world.";
        WORLD_TIME: GaugeVec = "zenav_world_time_seconds" [], "Simulated time of the served world since its start.";
    }
    "process" {
        PART_READY: GaugeVec = "zenav_part_ready" ["part"], "1 while a part (its whole name) is ready; `/readyz` says what it waits for.";
        BUILD: GaugeVec = "zenav_build_info" ["version"], "1, with the version of the program.";
        MEMORY: GaugeVec = "process_resident_memory_bytes" [], "Memory of this process that is resident.";
        CPU: CounterVec = "process_cpu_seconds_total" [], "Processor time of this process.";
        OPEN_FILES: GaugeVec = "process_open_fds" [], "Open file descriptors of this process.";
        THREADS: GaugeVec = "process_threads" [], "Threads of this process.";
        SPANS_DROPPED: IntCounterVec = "zenav_trace_spans_dropped_total" [], "Spans that the trace file could not take in time.";
        START_TIME: GaugeVec = "process_start_time_seconds" [], "Start of this process, in seconds of UNIX time.";
    }
}

static READER: Mutex<()> = Mutex::new(());

/// Everything that was counted so far, in Prometheus' text format 0.0.4; a metric shows once its stage has begun.
#[must_use]
pub fn text() -> String {
    // One reader at a time: gauges are brought up to date first.
    let _alone = READER.lock().unwrap_or_else(PoisonError::into_inner);
    observe_process();
    readiness::observe();
    let mut bytes = Vec::new();
    let encoded = TextEncoder::new().encode(&REGISTRY.gather(), &mut bytes);
    if let Err(error) = encoded {
        tracing::error!(%error, "the metrics cannot be written");
    }
    String::from_utf8(bytes).unwrap_or_default()
}

fn observe_process() {
    let facts = process::facts();
    let set = |metric: &GaugeVec, value: Option<f64>| {
        if let Some(value) = value {
            metric.with_label_values::<&str>(&[]).set(value);
        }
    };
    set(&MEMORY, facts.memory_bytes.map(|bytes| bytes as f64));
    set(&OPEN_FILES, facts.open_files.map(|files| files as f64));
    set(&THREADS, facts.threads.map(|threads| threads as f64));
    set(&START_TIME, facts.started_unix_secs);
    if let Some(seconds) = facts.cpu_secs {
        let cpu = CPU.with_label_values::<&str>(&[]);
        cpu.inc_by((seconds - cpu.get()).max(0.0));
    }
    // Creates the series, so that it shows from the start.
    let _ = SPANS_DROPPED.with_label_values::<&str>(&[]);
    BUILD.with_label_values(&[env!("CARGO_PKG_VERSION")]).set(1.0);
}

/// The table as Markdown, as it stands in `docs/observability.md`.
#[must_use]
pub fn table_markdown() -> String {
    let mut text = String::from("| metric | kind | labels | says |\n|---|---|---|---|\n");
    let mut stage = "";
    for row in TABLE {
        if row.stage != stage {
            stage = row.stage;
            text.push_str(&format!("| **{stage}** | | | |\n"));
        }
        let labels: Vec<String> = row.labels.iter().map(|label| format!("`{label}`")).collect();
        text.push_str(&format!(
            "| `{}` | {} | {} | {} |\n",
            row.name,
            row.kind.name(),
            labels.join(", "),
            row.help
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Kind;

    #[test]
    fn every_declared_metric_can_be_made_and_its_name_follows_prometheus() {
        make_all();
        for row in TABLE {
            assert!(row.help.ends_with('.'), "{}: {}", row.name, row.help);
            assert_eq!(row.kind == Kind::Counter, row.name.ends_with("_total"), "{}", row.name);
            assert!(
                row.kind != Kind::Histogram || row.name.ends_with("_seconds"),
                "{}",
                row.name
            );
            let is_own = row.name.starts_with("zenav_") || row.stage == "process";
            assert!(is_own, "{}", row.name);
            for label in row.labels {
                assert!(
                    [
                        "robot", "part", "topic", "state", "role", "zone", "verdict", "outcome", "reason", "kind",
                        "version"
                    ]
                    .contains(label),
                    "{}: `{label}` is no label whose values are few",
                    row.name
                );
            }
        }
    }

    #[test]
    fn a_scrape_tells_what_was_counted_and_how_the_process_is() {
        PATH_SEARCH.with_label_values::<&str>(&[]).observe(0.003);
        MOTION_REQUESTS.with_label_values(&["found"]).inc();
        let text = text();
        for line in [
            "# TYPE zenav_path_search_seconds histogram",
            "zenav_path_search_seconds_bucket{le=\"0.005\"} 1",
            "zenav_path_search_seconds_bucket{le=\"0.0025\"} 0",
            "zenav_motion_requests_total{outcome=\"found\"} 1",
            "# TYPE process_cpu_seconds_total counter",
        ] {
            assert!(text.contains(line), "{line}: {text}");
        }
        #[cfg(target_os = "linux")]
        assert!(!text.contains("process_resident_memory_bytes 0\n") && text.contains("process_open_fds "));
    }
}

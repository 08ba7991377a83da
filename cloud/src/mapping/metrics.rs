//! Mapping metrics. Age of scans on arrival, time to draw them, and size of the map; which of several services leads, and how well the others
//! follow.

use std::time::{Duration, Instant};

use zenav_mapping::Insertion;
use zenav_observability::metrics::{
    MAP_CELLS, MAP_COPY_AGE, MAP_PUBLISH, MAP_REVISION, MAPPING_LEADS, MAPPING_TAKEOVERS, SCAN_AGE, SCAN_INSERTION,
    SCANS,
};
use zenav_observability::{Gauge, Histogram, IntCounter};
use zenav_protocol::messages::MapInfo;
use zenav_protocol::time::Stamp;

/// States of cells.
const CELLS: [&str; 3] = ["free", "occupied", "unknown"];

/// Counts of one robot's mapping.
#[derive(Debug)]
pub(super) struct MappingMetrics {
    age: Histogram,
    insertion: Histogram,
    publish: Histogram,
    inserted: IntCounter,
    held: IntCounter,
    left_out: IntCounter,
    free: Gauge,
    occupied: Gauge,
    unknown: Gauge,
    revision: Gauge,
}

impl MappingMetrics {
    pub(super) fn new(robot: &str) -> Self {
        let scans = |outcome| SCANS.with_label_values(&[robot, outcome]);
        let [free, occupied, unknown] = CELLS.map(|state| MAP_CELLS.with_label_values(&[robot, state]));
        Self {
            age: SCAN_AGE.with_label_values(&[robot]),
            insertion: SCAN_INSERTION.with_label_values(&[robot]),
            publish: MAP_PUBLISH.with_label_values(&[robot]),
            inserted: scans("inserted"),
            held: scans("held"),
            left_out: scans("left_out"),
            free,
            occupied,
            unknown,
            revision: MAP_REVISION.with_label_values(&[robot]),
        }
    }

    /// A scan of this stamp was received at `now`. The clock follows the robot's, at most a message behind; while it does not run, no age
    /// is recorded.
    pub(super) fn took(&self, stamp: Stamp, now: Stamp) {
        if now != Stamp::ZERO {
            self.age.observe(now.secs_since(stamp).max(0.0));
        }
    }

    /// Handling of the scan that began then is complete.
    pub(super) fn drew(&self, began: Instant, insertion: Insertion) {
        self.insertion.observe(began.elapsed().as_secs_f64());
        match insertion {
            Insertion::Inserted => self.inserted.inc(),
            Insertion::Held => self.held.inc(),
            _ => self.left_out.inc(),
        }
    }

    /// The patch begun then was published.
    pub(super) fn published(&self, began: Instant) {
        self.publish.observe(began.elapsed().as_secs_f64());
    }

    /// Records the size of the map.
    pub(super) fn map(&self, info: &MapInfo) {
        self.free.set(info.free as f64);
        self.occupied.set(info.occupied as f64);
        self.unknown.set(info.unknown as f64);
        self.revision.set(info.map.revision as f64);
    }
}

/// What one of several mapping services of a robot is to it.
#[derive(Debug)]
pub(super) struct CopyMetrics {
    robot: String,
    leads: Gauge,
    age: Gauge,
    takeovers: IntCounter,
}

impl CopyMetrics {
    pub(super) fn new(robot: &str) -> Self {
        Self {
            robot: robot.to_owned(),
            leads: MAPPING_LEADS.with_label_values(&[robot]),
            age: MAP_COPY_AGE.with_label_values(&[robot]),
            takeovers: MAPPING_TAKEOVERS.with_label_values(&[robot]),
        }
    }

    /// Whether this service leads. What a leader has is the map itself; a copy tells no size of one.
    pub(super) fn leads(&self, leads: bool) {
        self.leads.set(f64::from(u8::from(leads)));
        if leads {
            self.age.set(0.0);
            return;
        }
        // Removing a label that was never set fails, which does not matter.
        let _ = MAP_REVISION.remove_label_values(&[self.robot.as_str()]);
        for state in CELLS {
            let _ = MAP_CELLS.remove_label_values(&[self.robot.as_str(), state]);
        }
    }

    /// Time since this copy last held everything that it had heard of the leader's map.
    pub(super) fn follows(&self, age: Duration) {
        self.age.set(age.as_secs_f64());
    }

    /// This service has taken over.
    pub(super) fn took_over(&self) {
        self.takeovers.inc();
    }
}

//! Sensing. What do the readings of a tick change? The estimate, the obstacles around the robot, and the events about bumper and battery.

use zenav_protocol::messages::{Correction, EventKind};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::control_io::Publication;
use crate::passive_safety::contact_point;
use crate::telemetry;

/// Hysteresis of the low-battery event, as a share of the charge.
const CHARGED: f64 = 0.05;

impl Pilot {
    /// Takes in the readings, and the pose corrections made off board for this boot.
    pub(super) fn sense(
        &mut self,
        now: Stamp,
        readings: &Readings,
        corrections: &[Correction],
        out: &mut Vec<Publication>,
    ) {
        let boot_id = self.events.boot_id();
        let of_this_boot = corrections.iter().filter(|correction| correction.boot_id == boot_id);
        self.estimator.step(readings, of_this_boot);
        if let Some(kind) = self.telemetry.dropped(now, self.estimator.tally()) {
            self.events.record(now, kind);
        }
        self.telemetry.sensors(readings, &self.estimator, out);
        for sweep in &readings.sweeps {
            if let Some(odom_from_base) = self.estimator.odom_from_base_at(sweep.stamp)
                && self.obstacles.insert(sweep, odom_from_base)
                && let Some(scan) = telemetry::scan(sweep, &self.config.model, &self.estimator)
            {
                out.push(Publication::Scan(sweep.lidar.clone(), scan));
            }
        }
        if readings.bump.pressed {
            let place = contact_point(&self.config.model.footprint, &readings.bump);
            self.obstacles.touch(now, place, self.estimator.odom_from_base());
        }
        if readings.bump.pressed && !self.pressed {
            self.events.record(now, EventKind::Bumped);
        }
        self.pressed = readings.bump.pressed;
        let charge = readings.battery.charge;
        let low = self.config.model.battery.low;
        if charge < low && !self.battery_is_low {
            self.events.record(now, EventKind::BatteryLow { charge });
        }
        // One event until it has been charged.
        self.battery_is_low = charge < low + if self.battery_is_low { CHARGED } else { 0.0 };
    }
}

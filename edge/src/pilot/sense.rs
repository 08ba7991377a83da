//! Sensing. What do the readings of a tick change? The estimate, the obstacles around the robot, and the events about bumper and battery.

use zenav_protocol::messages::{Correction, EventKind, Obstacle, Obstacles};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;

use super::Pilot;
use crate::control_io::Publication;
use crate::deskewing::deskewed;
use crate::telemetry;

/// A sweep may be stamped this far ahead, s: clocks of one body are read one after the other.
const AHEAD: f64 = 0.1;
/// Hysteresis of the low-battery event, as a share of the charge.
const CHARGED: f64 = 0.05;

impl Pilot {
    /// Takes in the readings, and the pose corrections made off board for this boot, in the present frame of the map.
    pub(super) fn sense(
        &mut self,
        now: Stamp,
        readings: &Readings,
        corrections: &[Correction],
        out: &mut Vec<Publication>,
    ) {
        self.estimator.step(readings, corrections);
        if self.is_elsewhere(corrections) {
            self.obstacles.forget_touched();
        }
        self.fixes.take_in(readings, &self.config.model, &self.estimator);
        if let Some(kind) = self.telemetry.dropped(now, self.estimator.tally()) {
            self.events.record(now, kind);
        }
        self.telemetry
            .sensors(readings, &self.estimator, self.frame.number(), out);
        for sweep in &readings.sweeps {
            let lidar = self.config.model.all_lidars().find(|(name, _)| *name == sweep.lidar);
            // A sweep from the future would make all sweeps until then stale.
            let Some((_, lidar)) = lidar.filter(|_| sweep.stamp.secs_since(now) <= AHEAD) else {
                continue;
            };
            self.encoder_watch.see(sweep);
            let sweep = &*self.lost_beams.mend(sweep, lidar);
            let sweep = &*deskewed(sweep, lidar, |stamp| self.estimator.odom_from_base_at(stamp));
            let Some(odom_from_base) = self.estimator.odom_from_base_at(sweep.stamp) else {
                continue;
            };
            if !self.obstacles.insert(sweep, odom_from_base) {
                continue;
            }
            let (ranges, moving) = (
                self.obstacles.ranges(&sweep.lidar),
                self.obstacles.moving_beams(&sweep.lidar),
            );
            self.mount_watch
                .insert(&sweep.lidar, lidar, ranges, &moving, odom_from_base);
            if self.telemetry.scan_due(&sweep.lidar) {
                let is_main = self.config.model.is_main_lidar(&sweep.lidar);
                let (boot_id, model) = (self.events.boot_id(), &self.config.model);
                let scan = telemetry::scan(sweep, &self.obstacles, boot_id, model, &self.estimator);
                out.extend(scan.map(|mut scan| {
                    if is_main {
                        scan.fixes = self.fixes.take();
                    }
                    Publication::Scan((!is_main).then(|| sweep.lidar.clone()), scan)
                }));
            }
        }
        let tracked = self.obstacles.moving().tracks().iter().any(|track| !track.is_robot());
        if !readings.sweeps.is_empty() && (tracked || self.tracked) {
            // An empty list after the last track has ended is always sent.
            if self.telemetry.obstacles_due() || !tracked {
                out.push(Publication::Obstacles(self.tracked_obstacles()));
            }
            self.tracked = tracked;
        }
        let bump = &readings.bump;
        let place = self.collision_monitor.feel(now, bump);
        self.obstacles
            .touch(now, place, bump.bearing.is_some(), self.estimator.odom_from_base());
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

    /// The tracks of moving obstacles as a message, in the map frame.
    fn tracked_obstacles(&self) -> Obstacles {
        let map_from_odom = self.estimator.map_from_odom();
        let tracks = self.obstacles.moving().tracks().iter();
        let stamp = self.obstacles.stamp().unwrap_or_default();
        Obstacles {
            stamp,
            obstacles: tracks
                .filter(|track| !track.is_robot())
                .map(|track| {
                    let place = map_from_odom.transform_point(track.at(stamp.secs_since(track.stamp)));
                    let (sin, cos) = map_from_odom.yaw.sin_cos();
                    Obstacle {
                        id: track.id,
                        x: place.x,
                        y: place.y,
                        vx: cos * track.velocity.x - sin * track.velocity.y,
                        vy: sin * track.velocity.x + cos * track.velocity.y,
                        radius: track.radius,
                        variance: track.variance,
                        unseen_for: stamp.secs_since(track.seen).max(0.0),
                    }
                })
                .collect(),
        }
    }
}

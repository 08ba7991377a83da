//! Telemetry. What does the robot publish, and how often?
//!
//! Over a narrow link the robot sends fewer scans, obstacles, poses and readings ([`Uplink`]). State, events, intent and markers keep their
//! rates: they are few, and driving the robot needs them.

use std::collections::BTreeMap;
use std::mem::{Discriminant, discriminant};
use std::time::Duration;

use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EventKind, Odometry, PoseEstimate, Scan};
use zenav_protocol::readings::{KindReading, Readings, Sweep};
use zenav_protocol::robot::RobotModel;
use zenav_protocol::time::Stamp;

use crate::control_io::Publication;
use crate::estimator::{Estimator, Tally};
use crate::local_obstacles::LocalObstacles;
use crate::settings::{TelemetrySettings, UplinkSettings};
use crate::uplink::{Sieve, Uplink};

/// Least time between two events about dropped inputs, s.
const DROPPED: f64 = 10.0;

/// When each message is due.
#[derive(Clone, Debug)]
pub struct Telemetry {
    settings: TelemetrySettings,
    uplink: Uplink,
    poses: Sieve,
    imu: Sieve,
    /// One sieve per kind of sensor: a shared one would pass rare kinds only by chance.
    kinds: Vec<(Discriminant<KindReading>, Sieve)>,
    /// By name of the lidar.
    scans: BTreeMap<String, Sieve>,
    obstacles: Sieve,
    state: Due,
    marker: Due,
    intent: Due,
    slow: Due,
    dropped: Due,
    told: (u64, u64),
    pressed: bool,
}

#[derive(Clone, Copy, Debug, Default)]
struct Due(Stamp);

impl Due {
    /// Whether a message is due; the next one is due a period later, or later still after a pause.
    fn now(&mut self, now: Stamp, period: f64) -> bool {
        let due = now >= self.0;
        if due {
            let next = self.0.plus_secs(period);
            self.0 = if next > now { next } else { now.plus_secs(period) };
        }
        due
    }
}

impl Telemetry {
    /// Everything is due at once.
    #[must_use]
    pub fn new(settings: &TelemetrySettings, uplink: &UplinkSettings) -> Self {
        Self {
            settings: settings.clone(),
            uplink: Uplink::new(uplink),
            poses: Sieve::default(),
            imu: Sieve::default(),
            kinds: Vec::new(),
            scans: BTreeMap::new(),
            obstacles: Sieve::default(),
            state: Due::default(),
            marker: Due::default(),
            intent: Due::default(),
            slow: Due::default(),
            dropped: Due::default(),
            told: (0, 0),
            pressed: false,
        }
    }

    /// A round trip to the holder of the lease was measured.
    pub fn measured(&mut self, now: Stamp, round_trip: Duration, holder: &str) {
        self.uplink.measured(now, round_trip, holder);
    }

    /// Share of its sensors' messages that the link carries, above 0 to 1.
    #[must_use]
    pub fn share(&self) -> f64 {
        self.uplink.share()
    }

    /// Whether the next scan of this lidar is sent.
    pub fn scan_due(&mut self, lidar: &str) -> bool {
        let share = self.share();
        match self.scans.get_mut(lidar) {
            Some(sieve) => sieve.lets_through(share),
            None => self.scans.entry(lidar.to_owned()).or_default().lets_through(share),
        }
    }

    /// Whether the next message about moving obstacles is sent.
    pub fn obstacles_due(&mut self) -> bool {
        self.obstacles.lets_through(self.share())
    }

    /// The messages of sensors and estimator of one tick, the pose in a `frame` of the map.
    pub fn sensors(&mut self, readings: &Readings, estimator: &Estimator, frame: u64, out: &mut Vec<Publication>) {
        let now = readings.stamp;
        let velocity: Twist2 = estimator.velocity();
        self.uplink.elapse(now);
        let share = self.share();
        if self.poses.lets_through(share) {
            out.push(Publication::Odometry(Odometry {
                stamp: now,
                odom_from_base: estimator.odom_from_base(),
                velocity,
                wheels: readings.wheels,
            }));
            out.push(Publication::Pose(PoseEstimate {
                stamp: now,
                map_from_base: estimator.map_from_base(),
                covariance: estimator.covariance(),
                velocity,
                frame,
            }));
        }
        if let Some(imu) = &readings.imu
            && self.imu.lets_through(share)
        {
            out.push(Publication::Imu(imu.clone()));
        }
        for reading in readings.of_kinds() {
            if self.kind_due(discriminant(&reading), share) {
                out.push(Publication::Sensor(reading));
            }
        }
        // Slowly changing readings: bumper and battery.
        let slow = self.slow.now(now, self.settings.slow_period);
        if slow || readings.bump.pressed != self.pressed {
            self.pressed = readings.bump.pressed;
            out.push(Publication::Bump(readings.bump.clone()));
        }
        if slow {
            out.push(Publication::Battery(readings.battery.clone()));
        }
    }

    /// Whether the next reading of a kind is sent.
    fn kind_due(&mut self, kind: Discriminant<KindReading>, share: f64) -> bool {
        if let Some((_, sieve)) = self.kinds.iter_mut().find(|(known, _)| *known == kind) {
            return sieve.lets_through(share);
        }
        let mut sieve = Sieve::default();
        let passes = sieve.lets_through(share);
        self.kinds.push((kind, sieve));
        passes
    }

    /// An event if more inputs were dropped since the last one, at most one per period.
    pub fn dropped(&mut self, now: Stamp, tally: Tally) -> Option<EventKind> {
        let Tally { too_late, broken, .. } = tally;
        if self.told == (too_late, broken) || !self.dropped.now(now, DROPPED) {
            return None;
        }
        self.told = (too_late, broken);
        Some(EventKind::InputsDropped { too_late, broken })
    }

    /// Whether the state is due.
    pub fn state_due(&mut self, now: Stamp) -> bool {
        self.state.now(now, self.settings.state_period)
    }

    /// Makes the intent due at once.
    pub fn hasten_intent(&mut self) {
        self.intent = Due::default();
    }

    /// Whether the intent is due.
    pub fn intent_due(&mut self, now: Stamp) -> bool {
        self.intent.now(now, self.settings.intent_period)
    }

    /// Whether markers are due.
    pub fn marker_due(&mut self, now: Stamp) -> bool {
        self.marker.now(now, self.settings.marker_period)
    }
}

/// A scan as a message, with what the local obstacles know of it, and the poses at its own stamp; `None` if the stamp is too old for the
/// poses to be known, or the lidar is unknown.
#[must_use]
pub fn scan(
    sweep: &Sweep,
    obstacles: &LocalObstacles,
    boot_id: &str,
    model: &RobotModel,
    estimator: &Estimator,
) -> Option<Scan> {
    let (_, lidar) = model.all_lidars().find(|(name, _)| *name == sweep.lidar)?;
    let odom_from_base = estimator.odom_from_base_at(sweep.stamp)?;
    Some(Scan {
        stamp: sweep.stamp,
        angle_min: lidar.angle_min(),
        angle_increment: lidar.angle_increment(),
        range_min: lidar.range_min,
        range_max: lidar.range_max,
        ranges: obstacles.ranges(&sweep.lidar).to_vec(),
        boot_id: boot_id.to_owned(),
        moving: obstacles.moving_beams(&sweep.lidar),
        touched: obstacles.touched_lines(sweep.stamp, odom_from_base),
        fixes: Vec::new(),
        base_from_laser: lidar.mount,
        map_from_odom: estimator.map_from_odom(),
        odom_from_base,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dropped_inputs_are_reported_at_once_and_then_only_when_there_are_more_and_some_time_has_passed() {
        let mut telemetry = Telemetry::new(&TelemetrySettings::default(), &UplinkSettings::default());
        let mut told = Vec::new();
        for second in 1..40 {
            let tally = Tally {
                too_late: second.min(20),
                ..Tally::default()
            };
            told.extend(telemetry.dropped(Stamp::from_secs(second as f64), tally));
        }
        let event = |too_late| EventKind::InputsDropped { too_late, broken: 0 };
        assert_eq!(told, [event(1), event(10), event(20)]);
    }

    #[test]
    fn ten_hertz_stay_ten_hertz_on_a_fifty_hertz_loop() {
        let mut due = Due::default();
        let count = (0..500_u32)
            .filter(|tick| due.now(Stamp(u64::from(*tick) * 20_000_000), 0.1))
            .count();
        assert_eq!(count, 100);
    }
}

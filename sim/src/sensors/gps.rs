//! GPS or beacons. The reported position.

use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Readings;
use zenav_protocol::sensors::{Gps, GpsModel};
use zenav_protocol::time::Stamp;

use super::random::gauss;
use super::timing::{Delay, Schedule, is_lost};
use super::{Moment, Sensor, Simulate, stepped};
use crate::faults::Fault;

/// GPS or beacons.
#[derive(Clone, Debug)]
pub struct GpsReceiver {
    model: GpsModel,
    rng: Pcg64Mcg,
    schedule: Schedule,
    delay: Delay<Gps>,
}

impl GpsReceiver {
    /// Before its first reading.
    #[must_use]
    pub fn new(model: GpsModel, rng: Pcg64Mcg) -> Self {
        Self {
            rng,
            schedule: Schedule::new(model.rate_hz),
            delay: Delay::new(model.latency),
            model,
        }
    }

    /// A reading, if one arrives.
    pub fn read(&mut self, now: Stamp, truth: Pose2, fault: &Fault) -> Option<Gps> {
        let measured = self.measure(now, truth, fault);
        self.delay.pass(now, measured, fault.late)
    }

    fn measure(&mut self, now: Stamp, truth: Pose2, fault: &Fault) -> Option<Gps> {
        if !self.schedule.due(now) || is_lost(&mut self.rng, self.model.dropout, fault) {
            return None;
        }
        let [bias_x, bias_y] = self.model.bias;
        let noise = fault.noise(self.model.noise);
        let x = truth.x + bias_x + gauss(&mut self.rng, noise);
        let y = truth.y + bias_y + gauss(&mut self.rng, noise);
        Some(Gps {
            stamp: now,
            x: stepped(x, self.model.resolution),
            y: stepped(y, self.model.resolution),
            std_dev: self.model.noise,
        })
    }
}

impl Simulate for GpsModel {
    fn simulate(&self, rng: Pcg64Mcg) -> Box<dyn Sensor> {
        Box::new(GpsReceiver::new(self.clone(), rng))
    }
}

impl Sensor for GpsReceiver {
    fn sense(&mut self, moment: &Moment<'_>, readings: &mut Readings) {
        readings.gps = self.read(moment.now, moment.map_from_base(), &moment.fault);
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::super::random::{Stream, stream};
    use super::*;
    use zenav_protocol::id::Id;

    fn rng() -> Pcg64Mcg {
        stream(1, &Id::new("tiago").unwrap(), Stream::Imu)
    }

    #[test]
    fn late_readings_keep_the_stamp_of_their_measurement_and_lost_ones_never_come() {
        let mut gps = GpsReceiver::new(
            GpsModel {
                rate_hz: 10.0,
                noise: 0.0,
                bias: [1.0, -2.0],
                resolution: 0.5,
                dropout: 0.3,
                latency: 0.15,
            },
            rng(),
        );
        let mut readings = Vec::new();
        for tick in 0..10_000 {
            let now = Stamp(tick * 20_000_000);
            readings.extend(
                gps.read(now, Pose2::new(0.3, 0.1, 0.0), &Fault::default())
                    .map(|gps| (now, gps)),
            );
        }
        // Ten a second for 200 s, three of ten lost; 0.15 s are eight steps of 20 ms.
        assert!((1300..1500).contains(&readings.len()), "{}", readings.len());
        assert!(
            readings
                .iter()
                .all(|(now, gps)| (now.secs_since(gps.stamp) - 0.16).abs() < 1e-9 && (gps.x, gps.y) == (1.5, -2.0))
        );
    }
}

//! Sensor faults. Which sensor is broken, how, and when: defined by the world file, in windows of simulated time.

use std::ops::Range;

use zenav_protocol::id::Id;
use zenav_protocol::time::Stamp;

/// A fault as the world file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct FaultModel {
    /// File and line of its definition.
    pub at: String,
    /// The robot's name; `None`: every robot that has the sensor.
    pub robot: Option<Id>,
    /// `encoders`, `imu`, another kind of sensor as the robot file names it (`gps`), or a lidar by name.
    pub sensor: String,
    /// What is wrong with the sensor.
    pub kind: FaultKind,
    /// Time window, s.
    pub window: Range<f64>,
}

/// Kind of fault of a sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum FaultKind {
    /// It measures nothing; encoders keep reporting their last angles.
    Dead,
    /// This share of its readings is lost, 0 to 1; for a lidar, of its beams.
    Lost(f64),
    /// Readings arrive this much later, s, with the stamp of their measurement.
    Late(f64),
    /// Additional noise of this standard deviation, in the unit of the sensor's own.
    Noisy(f64),
}

/// Total fault of one sensor at a moment; several faults add up.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Fault {
    /// Whether it measures nothing.
    pub is_dead: bool,
    /// Share of readings lost, 0 to 1.
    pub lost: f64,
    /// Delay of readings, s.
    pub late: f64,
    /// Standard deviation of the noise.
    pub noise: f64,
}

impl Fault {
    /// All faults of one sensor that are active at a moment, added up.
    ///
    /// ```
    /// use zenav_protocol::time::Stamp;
    /// use zenav_sim::faults::{Fault, FaultKind, FaultModel};
    ///
    /// let late = FaultModel {
    ///     at: "my.toml:3".into(),
    ///     robot: None,
    ///     sensor: "gps".into(),
    ///     kind: FaultKind::Late(0.5),
    ///     window: 10.0..20.0,
    /// };
    /// assert_eq!(Fault::at(&[late.clone()], Stamp::from_secs(10.0)).late, 0.5);
    /// assert_eq!(Fault::at(&[late], Stamp::from_secs(20.0)), Fault::default());
    /// ```
    #[must_use]
    pub fn at(faults: &[FaultModel], now: Stamp) -> Self {
        let holding = faults.iter().filter(|fault| fault.window.contains(&now.as_secs()));
        holding.fold(Self::default(), |sum, fault| match fault.kind {
            FaultKind::Dead => Self { is_dead: true, ..sum },
            FaultKind::Lost(share) => Self {
                lost: sum.dropout(share),
                ..sum
            },
            FaultKind::Late(secs) => Self {
                late: sum.late + secs,
                ..sum
            },
            FaultKind::Noisy(std_dev) => Self {
                noise: sum.noise(std_dev),
                ..sum
            },
        })
    }

    /// Share of readings lost by a sensor that loses `dropout` of them without the fault.
    #[must_use]
    pub fn dropout(&self, dropout: f64) -> f64 {
        dropout + self.lost * (1.0 - dropout)
    }

    /// Standard deviation of the noise of a sensor that has `std_dev` without the fault.
    #[must_use]
    pub fn noise(&self, std_dev: f64) -> f64 {
        std_dev.hypot(self.noise)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faults_hold_in_their_windows_and_add_up() {
        let fault = |kind, window| FaultModel {
            at: "w.toml:1".to_owned(),
            robot: None,
            sensor: "imu".to_owned(),
            kind,
            window,
        };
        let faults = [
            fault(FaultKind::Lost(0.5), 0.0..2.0),
            fault(FaultKind::Lost(0.5), 1.0..2.0),
            fault(FaultKind::Noisy(0.3), 1.0..2.0),
            fault(FaultKind::Late(0.2), 1.0..f64::INFINITY),
            fault(FaultKind::Dead, 2.0..3.0),
        ];
        let at = |secs| Fault::at(&faults, Stamp::from_secs(secs));
        assert_eq!((at(0.5).lost, at(0.5).late), (0.5, 0.0));
        let both = at(1.0);
        assert_eq!((both.lost, both.late, both.is_dead), (0.75, 0.2, false));
        assert!((both.noise(0.4) - 0.5).abs() < 1e-12 && (both.dropout(0.2) - 0.8).abs() < 1e-12);
        assert!(at(2.0).is_dead && at(2.0).lost == 0.0);
        assert_eq!(
            at(9.0),
            Fault {
                late: 0.2,
                ..Fault::default()
            }
        );
    }
}

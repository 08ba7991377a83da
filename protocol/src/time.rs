//! Stamps. How is a point in time represented on the wire?
//!
//! As nanoseconds of the writer's own clock. Clocks of two machines are never compared.

use std::ops::{Add, Sub};
use std::time::Duration;

use serde::{Deserialize, Serialize};

/// A point in time, ns since the clock's own epoch: UNIX time for a real robot, the start for a simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct Stamp(pub u64);

impl Stamp {
    /// The clock's epoch.
    pub const ZERO: Self = Self(0);

    /// A stamp from seconds; negative numbers and NaN become zero.
    ///
    /// ```
    /// use zenav_protocol::time::Stamp;
    ///
    /// assert_eq!(Stamp::from_secs(1.5), Stamp(1_500_000_000));
    /// assert_eq!(Stamp::from_secs(2.0).secs_since(Stamp::from_secs(2.5)), -0.5);
    /// ```
    #[must_use]
    pub fn from_secs(secs: f64) -> Self {
        // A float to integer cast saturates, and NaN becomes zero.
        Self((secs * 1e9).round() as u64)
    }

    /// Seconds since the clock's epoch.
    #[must_use]
    pub fn as_secs(self) -> f64 {
        self.0 as f64 * 1e-9
    }

    /// Time since an earlier stamp of the same clock; zero when `earlier` is later.
    #[must_use]
    pub fn since(self, earlier: Self) -> Duration {
        Duration::from_nanos(self.0.saturating_sub(earlier.0))
    }

    /// Seconds since an earlier stamp, negative when `earlier` is later.
    #[must_use]
    pub fn secs_since(self, earlier: Self) -> f64 {
        if self >= earlier {
            (self.0 - earlier.0) as f64 * 1e-9
        } else {
            -((earlier.0 - self.0) as f64 * 1e-9)
        }
    }

    /// This stamp shifted by seconds, forwards or backwards; saturates.
    #[must_use]
    pub fn plus_secs(self, secs: f64) -> Self {
        if secs >= 0.0 {
            self + Duration::from_nanos((secs * 1e9).round() as u64)
        } else {
            self - Duration::from_nanos((-secs * 1e9).round() as u64)
        }
    }
}

impl Add<Duration> for Stamp {
    type Output = Self;
    fn add(self, later: Duration) -> Self {
        Self(
            self.0
                .saturating_add(u64::try_from(later.as_nanos()).unwrap_or(u64::MAX)),
        )
    }
}

impl Sub<Duration> for Stamp {
    type Output = Self;
    fn sub(self, earlier: Duration) -> Self {
        Self(
            self.0
                .saturating_sub(u64::try_from(earlier.as_nanos()).unwrap_or(u64::MAX)),
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arithmetic_saturates_at_both_ends() {
        assert_eq!(Stamp(5) - Duration::from_secs(1), Stamp::ZERO);
        assert_eq!(Stamp(u64::MAX) + Duration::from_secs(1), Stamp(u64::MAX));
        assert_eq!(Stamp::from_secs(f64::NAN), Stamp::ZERO);
        assert_eq!(Stamp(1).since(Stamp(2)), Duration::ZERO);
        assert!((Stamp(0).secs_since(Stamp(1_000_000_000)) + 1.0).abs() < 1e-12);
        assert_eq!(Stamp::from_secs(2.0).plus_secs(-0.5), Stamp::from_secs(1.5));
    }
}

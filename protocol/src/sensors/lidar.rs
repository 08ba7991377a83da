//! Planar lidar. What is its field of view, what does a sweep contain, and what is published?
//!
//! A robot has any number of lidars, each with a name and a mount. A robot file's `[lidar]` is the one named
//! [`DEFAULT_LIDAR`]; others are `[lidars.NAME]`. Which one is the main lidar: `RobotModel::is_main_lidar`.

use std::f64::consts::{PI, TAU};

use nalgebra::Point2;
use serde::{Deserialize, Serialize};

use super::{Fix, LATENCY};
use crate::config_text::{Expected, OutOfBounds, check_all};
use crate::geometry::Pose2;
use crate::time::Stamp;

/// Name of the lidar that a robot file describes as `[lidar]`.
pub const DEFAULT_LIDAR: &str = "lidar";

/// Largest gap between the last beam and the first that does not count as a blind sector, rad.
const LEAST_GAP: f64 = 0.1;
/// Most beams of one sweep.
const MAX_BEAMS: usize = 100_000;
/// Most touched obstacles in a scan, and how far they reach from the robot along each axis, m.
const MAX_TOUCHED: (usize, f64) = (64, 40.0);
/// Most fixes of a scan.
const MAX_FIXES: usize = 16;

/// A planar lidar.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct LidarModel {
    /// Mounting pose on the base (`base_from_laser`).
    #[serde(default)]
    pub mount: Pose2,
    /// Sweeps per second.
    pub rate_hz: f64,
    /// Shorter ranges are invalid, m.
    pub range_min: f64,
    /// Longer ranges are invalid, m.
    pub range_max: f64,
    /// Beams per sweep.
    pub beams: usize,
    /// Angle from the first beam to the last, rad; 2 pi is a full circle without a repeated beam.
    pub field_of_view: f64,
    /// Standard deviation of a range, m.
    #[serde(default)]
    pub noise: f64,
    /// Constant error of a range, m.
    #[serde(default)]
    pub bias: f64,
    /// Share of lost beams, 0 to 1.
    #[serde(default)]
    pub dropout: f64,
    /// Smallest step of a range, m.
    #[serde(default = "millimetre")]
    pub resolution: f64,
    /// Time from the first beam to the last, s: negative if the last one is measured first, as with lidars that turn clockwise. 0: all
    /// beams are simultaneous, or the driver undistorts them.
    #[serde(default)]
    pub sweep_time: f64,
    /// Time from a sweep to its delivery, s.
    #[serde(default)]
    pub latency: f64,
}

fn millimetre() -> f64 {
    0.001
}

impl LidarModel {
    /// Direction of the first beam, rad.
    #[must_use]
    pub fn angle_min(&self) -> f64 {
        if self.is_full_circle() {
            -PI
        } else {
            -0.5 * self.field_of_view
        }
    }

    /// Angle between beams, rad.
    #[must_use]
    pub fn angle_increment(&self) -> f64 {
        if self.is_full_circle() {
            TAU / self.beams.max(1) as f64
        } else {
            self.field_of_view / (self.beams.max(2) - 1) as f64
        }
    }

    /// Blind angle from the last beam to the first, rad; zero for a full circle, and for a gap of at most 0.1 rad.
    ///
    /// ```
    /// use zenav_protocol::robot::{RobotModel, shipped};
    ///
    /// let lidar_of = |name| RobotModel::from_toml(shipped(name).unwrap_or_default(), name).ok()?.lidar;
    /// let tiago = lidar_of("tiago").unwrap();
    /// // A field of view of 4.19 rad, symmetric about the x axis: the robot is blind to the rear.
    /// assert!((tiago.angle_min() + 2.095).abs() < 1e-9);
    /// assert!((tiago.gap() - (std::f64::consts::TAU - 4.19)).abs() < 1e-9);
    /// assert_eq!(lidar_of("neato").unwrap().gap(), 0.0, "a full circle");
    /// ```
    #[must_use]
    pub fn gap(&self) -> f64 {
        if self.is_full_circle() {
            return 0.0;
        }
        let gap = TAU - self.angle_increment() * (self.beams.max(1) - 1) as f64;
        if gap > LEAST_GAP { gap } else { 0.0 }
    }

    /// Time from a beam to the end of its sweep, s.
    #[must_use]
    pub fn before_end(&self, beam: f64) -> f64 {
        if self.beams < 2 {
            return 0.0;
        }
        let share = beam / (self.beams - 1) as f64;
        self.sweep_time.abs() * if self.sweep_time < 0.0 { share } else { 1.0 - share }
    }

    fn is_full_circle(&self) -> bool {
        self.field_of_view > TAU - 1e-3
    }

    /// Checks all values; the first one out of bounds.
    pub(crate) fn check(&self) -> Result<(), OutOfBounds> {
        const MOUNT: Expected = Expected::Range(-10.0, 10.0, "metres, -10 to 10");
        const RANGE: Expected = Expected::Range(f64::MIN_POSITIVE, 1000.0, "a positive number of metres, at most 1000");
        check_all(&[
            ("rate_hz", self.rate_hz, Expected::Positive),
            ("range_max", self.range_max, RANGE),
            ("field_of_view", self.field_of_view, Expected::Positive),
            ("range_min", self.range_min, Expected::NotNegative),
            ("noise", self.noise, Expected::NotNegative),
            ("resolution", self.resolution, Expected::NotNegative),
            ("dropout", self.dropout, Expected::Share),
            ("latency", self.latency, LATENCY),
            ("bias", self.bias, Expected::Finite),
            ("sweep_time", self.sweep_time, Expected::Finite),
            ("mount.x", self.mount.x, MOUNT),
            ("mount.y", self.mount.y, MOUNT),
            ("mount.yaw", self.mount.yaw, Expected::Angle),
        ])?;
        if !(1..=MAX_BEAMS).contains(&self.beams) {
            return Err(OutOfBounds::unlike(
                "beams",
                self.beams as f64,
                format_args!("1 to {MAX_BEAMS}"),
            ));
        }
        if self.field_of_view > TAU + 1e-6 {
            return Err(OutOfBounds::unlike(
                "field_of_view",
                self.field_of_view,
                "at most 2 pi rad",
            ));
        }
        if self.sweep_time.abs() * self.rate_hz > 1.0 + 1e-6 {
            return Err(OutOfBounds::unlike(
                "sweep_time",
                self.sweep_time,
                format_args!("at most the time between two sweeps, {:.3} s", 1.0 / self.rate_hz),
            ));
        }
        if self.sweep_time != 0.0 && self.range_min <= 0.0 {
            let expected = "more than 0 where `sweep_time` is set: a range of zero means that nobody looked there";
            return Err(OutOfBounds::unlike("range_min", self.range_min, expected));
        }
        if self.range_min >= self.range_max {
            return Err(OutOfBounds::unlike("range_min", self.range_min, "less than range_max"));
        }
        Ok(())
    }
}

/// Reading: the ranges of one sweep; the directions of the beams are given by the robot's model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Sweep {
    /// Name of the lidar; omitted on the wire for [`DEFAULT_LIDAR`].
    #[serde(default = "default_name", skip_serializing_if = "is_default_name")]
    pub lidar: String,
    /// Time at which its last beam was measured: at or before the tick.
    pub stamp: Stamp,
    /// Range per beam, m; no return is infinity in memory and `null` on the wire.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<Option<f32>>"))]
    #[serde(with = "no_return_as_null")]
    pub ranges: Vec<f32>,
}

impl Sweep {
    /// A sweep of the lidar named [`DEFAULT_LIDAR`].
    #[must_use]
    pub fn new(stamp: Stamp, ranges: Vec<f32>) -> Self {
        Self {
            lidar: default_name(),
            stamp,
            ranges,
        }
    }
}

fn default_name() -> String {
    DEFAULT_LIDAR.to_owned()
}

fn is_default_name(name: &str) -> bool {
    name == DEFAULT_LIDAR
}

/// Message: one sweep of a planar lidar, with the robot's pose at the sweep's own stamp, so that receivers need not pair poses with scans.
/// The robot's motion during the sweep is compensated: the ranges are those of a lidar that measures all beams at the stamp. The default has
/// no beams, and identities as poses.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Scan {
    /// Time of the sweep.
    pub stamp: Stamp,
    /// The robot's boot, as in its state: the odometry of another boot has another origin. Empty if it is not known.
    #[serde(default, skip_serializing_if = "String::is_empty")]
    pub boot_id: String,
    /// Direction of the first beam in the laser frame, rad.
    pub angle_min: f64,
    /// Angle from one beam to the next, rad, counter-clockwise.
    pub angle_increment: f64,
    /// Shorter ranges are invalid, m.
    pub range_min: f64,
    /// Range up to which a beam without a return met nothing, m.
    pub range_max: f64,
    /// Range per beam, m; no return is infinity in memory and `null` on the wire.
    #[cfg_attr(feature = "schema", schemars(with = "Vec<Option<f32>>"))]
    #[serde(with = "no_return_as_null")]
    pub ranges: Vec<f32>,
    /// Runs of beams that hit a moving obstacle: the first beam, and the one after the last. Mapping leaves them out.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub moving: Vec<[u32; 2]>,
    /// Obstacles that the robot touched lately and that no beam shows (glass, an overhanging edge), as two straight lines each: what is known
    /// of it, and how far it is assumed to go; x and y of either end, base frame, m. Mapping marks their cells as occupied; beams do not clear
    /// what is known, and clear what is assumed after a while.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub touched: Vec<[[f64; 4]; 2]>,
    /// The newest measurements by GPS and compass since the last scan of the main lidar, which carries them: at most one of each. SLAM uses
    /// them.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub fixes: Vec<Fix>,
    /// Mounting pose of the lidar on the robot.
    pub base_from_laser: Pose2,
    /// Correction of the odometry at the stamp.
    pub map_from_odom: Pose2,
    /// Odometry at the stamp.
    pub odom_from_base: Pose2,
}

impl Scan {
    /// The laser's pose in the map at the stamp.
    #[must_use]
    pub fn map_from_laser(&self) -> Pose2 {
        self.map_from_odom * self.odom_from_base * self.base_from_laser
    }

    /// Direction of a beam in the laser frame, rad.
    #[must_use]
    pub fn angle(&self, beam: usize) -> f64 {
        self.angle_min + beam as f64 * self.angle_increment
    }

    /// Whether a range is a valid return.
    #[must_use]
    pub fn is_return(&self, range: f32) -> bool {
        let range = f64::from(range);
        range >= self.range_min && range <= self.range_max
    }

    /// End points of all valid returns, in the laser frame, m.
    ///
    /// ```
    /// # use std::f64::consts::FRAC_PI_2;
    /// # use zenav_protocol::messages::Scan;
    /// // To the right, ahead, and to the left.
    /// let scan = Scan {
    ///     angle_min: -FRAC_PI_2,
    ///     angle_increment: FRAC_PI_2,
    ///     range_min: 0.05,
    ///     range_max: 5.0,
    ///     ranges: vec![1.0, f32::INFINITY, 2.0],
    ///     ..Scan::default()
    /// };
    /// let lateral: Vec<f64> = scan.returns().map(|point| point.y).collect();
    /// assert_eq!(lateral, [-1.0, 2.0], "the beam ahead met nothing");
    /// ```
    pub fn returns(&self) -> impl Iterator<Item = Point2<f64>> + '_ {
        self.ranges
            .iter()
            .enumerate()
            .filter(|(_, range)| self.is_return(**range))
            .map(|(beam, range)| {
                let (sin, cos) = self.angle(beam).sin_cos();
                Point2::new(f64::from(*range) * cos, f64::from(*range) * sin)
            })
    }

    /// Whether the scan is plausible: finite numbers, at most a full circle and 100,000 beams; at most 64 touched obstacles within 40 m;
    /// at most 16 fixes.
    #[must_use]
    pub fn is_sane(&self) -> bool {
        let spread = self.angle_increment * self.ranges.len().saturating_sub(1) as f64;
        self.angle_min.is_finite()
            && self.angle_increment > 0.0
            && spread <= TAU + 1e-6
            && self.range_min >= 0.0
            && self.range_max > self.range_min
            && self.range_max.is_finite()
            && self.ranges.len() <= MAX_BEAMS
            && self.touched.len() <= MAX_TOUCHED.0
            && self
                .touched
                .iter()
                .flatten()
                .flatten()
                .all(|at| at.abs() <= MAX_TOUCHED.1)
            && self.fixes.len() <= MAX_FIXES
            && self.map_from_laser().is_finite()
    }
}

/// JSON has no infinity: a beam without a return is `null`.
mod no_return_as_null {
    use serde::ser::SerializeSeq;
    use serde::{Deserialize, Deserializer, Serializer};

    pub fn serialize<S: Serializer>(ranges: &[f32], serializer: S) -> Result<S::Ok, S::Error> {
        let mut seq = serializer.serialize_seq(Some(ranges.len()))?;
        for range in ranges {
            seq.serialize_element(&range.is_finite().then_some(*range))?;
        }
        seq.end()
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<f32>, D::Error> {
        let ranges: Vec<Option<f32>> = Vec::deserialize(deserializer)?;
        Ok(ranges.into_iter().map(|range| range.unwrap_or(f32::INFINITY)).collect())
    }
}

/// The sweeps of one tick on the wire: `null` for none, one sweep as itself, several as a list.
pub(crate) mod none_one_or_many {
    use std::fmt;

    use serde::de::value::{MapAccessDeserializer, SeqAccessDeserializer};
    use serde::de::{MapAccess, SeqAccess, Visitor};
    use serde::{Deserialize, Deserializer, Serialize, Serializer};

    use super::Sweep;

    pub fn serialize<S: Serializer>(sweeps: &[Sweep], serializer: S) -> Result<S::Ok, S::Error> {
        match sweeps {
            [] => serializer.serialize_none(),
            [one] => one.serialize(serializer),
            many => many.serialize(serializer),
        }
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<Vec<Sweep>, D::Error> {
        deserializer.deserialize_any(Sweeps)
    }

    #[cfg(feature = "schema")]
    pub fn schema(generator: &mut schemars::SchemaGenerator) -> schemars::Schema {
        let one = generator.subschema_for::<Sweep>();
        let many = generator.subschema_for::<Vec<Sweep>>();
        schemars::json_schema!({ "anyOf": [{ "type": "null" }, one, many] })
    }

    /// Deserialises straight into the sweeps, so that no range is held twice.
    struct Sweeps;

    impl<'de> Visitor<'de> for Sweeps {
        type Value = Vec<Sweep>;

        fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
            f.write_str("a sweep, a list of sweeps, or null")
        }

        fn visit_unit<E>(self) -> Result<Vec<Sweep>, E> {
            Ok(Vec::new())
        }

        fn visit_none<E>(self) -> Result<Vec<Sweep>, E> {
            Ok(Vec::new())
        }

        fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Vec<Sweep>, A::Error> {
            Sweep::deserialize(MapAccessDeserializer::new(map)).map(|sweep| vec![sweep])
        }

        fn visit_seq<A: SeqAccess<'de>>(self, seq: A) -> Result<Vec<Sweep>, A::Error> {
            Vec::deserialize(SeqAccessDeserializer::new(seq))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_beam_without_a_return_is_null_on_the_wire() {
        let scan = Scan {
            stamp: Stamp(7),
            angle_min: -1.0,
            angle_increment: 0.5,
            range_min: 0.02,
            range_max: 5.6,
            ranges: vec![1.5, f32::INFINITY, 0.25],
            base_from_laser: Pose2::new(0.2, 0.0, 0.0),
            odom_from_base: Pose2::new(1.0, 2.0, 0.5),
            ..Scan::default()
        };
        let text = serde_json::to_string(&scan).unwrap();
        assert!(text.contains("\"ranges\":[1.5,null,0.25]"), "{text}");
        assert_eq!(serde_json::from_str::<Scan>(&text).unwrap(), scan);
        assert_eq!(scan.returns().count(), 2);
        assert!(scan.is_sane());
    }
}

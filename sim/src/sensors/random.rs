//! Random streams. The random numbers of each sensor.
//!
//! A stream belongs to a robot's name and a sensor: another robot in the world, or another sensor on the robot, does not change the
//! noise.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::id::Id;

/// Owner of a random stream.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stream<'a> {
    /// The robot's first lidar.
    Lidar,
    /// Wheel encoders.
    Encoders,
    /// Inertial unit.
    Imu,
    /// The floor: slip of the wheels.
    Slip,
    /// A kind of sensor of which a robot has at most one.
    Kind(&'a str),
    /// A further lidar, by name.
    Named(&'a str),
}

/// The random stream of a robot's sensor.
#[must_use]
pub fn stream(seed: u64, robot: &Id, source: Stream<'_>) -> Pcg64Mcg {
    let name = fnv(0xcbf2_9ce4_8422_2325, robot.as_str());
    let name = match source {
        Stream::Lidar => name,
        Stream::Encoders => name.wrapping_add(1),
        Stream::Imu => name.wrapping_add(2),
        Stream::Kind("gps") => name.wrapping_add(3),
        Stream::Slip => name.wrapping_add(4),
        // Names contain no slash.
        Stream::Kind(kind) => fnv(fnv(name, "//"), kind),
        Stream::Named(sensor) => fnv(fnv(name, "/"), sensor),
    };
    generator(seed, name)
}

/// The hash FNV-1a, continued.
fn fnv(hash: u64, text: &str) -> u64 {
    text.bytes().fold(hash, |hash, byte| {
        (hash ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3)
    })
}

/// The random stream of a mover, by its index in the world's file.
#[must_use]
pub fn mover_stream(seed: u64, index: usize) -> Pcg64Mcg {
    generator(seed, MOVERS.wrapping_add(index as u64))
}

/// Keeps the movers' streams apart from the robots'.
const MOVERS: u64 = 0x5_7A1B_E125;

/// A separate generator for each name; the finaliser of SplitMix64 (Steele et al. 2014) spreads every bit.
fn generator(seed: u64, name: u64) -> Pcg64Mcg {
    let mix = |value: u64| {
        let value = (value ^ (value >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let value = (value ^ (value >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        value ^ (value >> 31)
    };
    let low = mix(mix(seed).wrapping_add(name));
    Pcg64Mcg::new((u128::from(mix(low.wrapping_add(0x9e37_79b9_7f4a_7c15))) << 64) | u128::from(low))
}

pub(crate) fn gauss(rng: &mut Pcg64Mcg, std_dev: f64) -> f64 {
    let unit: f64 = StandardNormal.sample(rng);
    unit * std_dev
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    #[test]
    fn streams_of_robots_and_sensors_differ() {
        let id = |name: &str| Id::new(name).unwrap();
        let first = |robot: &str, sensor, seed| gauss(&mut stream(seed, &id(robot), sensor), 1.0);
        assert_eq!(first("a", Stream::Kind("gps"), 1), first("a", Stream::Kind("gps"), 1));
        assert_ne!(first("a", Stream::Kind("gps"), 1), first("b", Stream::Kind("gps"), 1));
        assert_ne!(first("a", Stream::Kind("gps"), 1), first("a", Stream::Imu, 1));
        assert_ne!(first("a", Stream::Kind("gps"), 1), first("a", Stream::Kind("gps"), 2));
        assert_ne!(
            first("a", Stream::Named("rear"), 1),
            first("a", Stream::Named("front"), 1)
        );
        assert_ne!(first("a", Stream::Named("rear"), 1), first("a", Stream::Lidar, 1));
        assert_ne!(
            first("a", Stream::Named("rear"), 1),
            first("a", Stream::Kind("rear"), 1)
        );
    }
}

//! Arguments. Reads and checks the values of a command's options; a message about a bad one says what was expected.

use std::fmt::Display;
use std::ops::RangeInclusive;
use std::str::FromStr;
use std::time::Duration;

use zenav_protocol::bus::{DEFAULT_ENDPOINT, link_protocol};
use zenav_protocol::config_text::Expected;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;

use crate::failure::{Failure, in_words};

/// A name.
pub(crate) fn name(text: &str) -> Result<String, String> {
    Id::new(text).map(String::from).map_err(|error| error.to_string())
}

/// A robot's name.
pub(crate) fn robot_name(text: &str) -> Result<String, String> {
    Id::robot(text).map(String::from).map_err(|error| error.to_string())
}

/// An endpoint.
pub(crate) fn endpoint(text: &str) -> Result<String, String> {
    // May be quoted, like a deployment's values in the environment.
    let text = text.trim_matches('"');
    let form = || {
        format!("expected an endpoint, such as {DEFAULT_ENDPOINT}: links are over tcp, or over quic with an identity")
    };
    link_protocol(text).map(|_| text.to_owned()).ok_or_else(form)
}

/// Endpoints, separated by commas.
pub(crate) fn endpoints(text: &str) -> Result<String, String> {
    let checked: Result<Vec<String>, String> = text.split(',').map(|one| endpoint(one.trim())).collect();
    checked.map(|endpoints| endpoints.join(","))
}

/// A listening address.
pub(crate) fn address(text: &str) -> Result<String, String> {
    match text.rsplit_once(':') {
        Some((host, port)) if !host.is_empty() && port.parse::<u16>().is_ok() => Ok(text.to_owned()),
        _ => Err("expected ADDRESS:PORT, such as 127.0.0.1:7480".to_owned()),
    }
}

/// A finite number.
pub(crate) fn finite(text: &str) -> Result<f64, String> {
    number(text, Expected::Finite)
}

/// A positive, finite number.
pub(crate) fn positive(text: &str) -> Result<f64, String> {
    number(text, Expected::Positive)
}

/// Zero, or a positive, finite number.
pub(crate) fn not_negative(text: &str) -> Result<f64, String> {
    number(text, Expected::NotNegative)
}

/// A heading, rad.
pub(crate) fn heading(text: &str) -> Result<f64, String> {
    number(text, Expected::Angle)
}

/// Cell side of a map, m; the bounds are those of a deployment.
pub(crate) fn resolution(text: &str) -> Result<f64, String> {
    number(text, Expected::Range(0.005, 10.0, "0.005 to 10 m"))
}

/// Speed of simulated time.
pub(crate) fn speed(text: &str) -> Result<f64, String> {
    number(text, Expected::Range(0.001, 1000.0, "a number from 0.001 to 1000"))
}

fn number(text: &str, expected: Expected) -> Result<f64, String> {
    let number = text.parse().ok().filter(|number| expected.holds(*number));
    number.ok_or_else(|| format!("expected {expected}"))
}

/// A whole number.
pub(crate) fn whole<N: FromStr>(text: &str) -> Result<N, String> {
    let expected = || in_words(&format!("expected {}", std::any::type_name::<N>()));
    text.parse().map_err(|_| expected())
}

/// A whole number within bounds.
pub(crate) fn whole_in<N>(bounds: RangeInclusive<N>) -> impl Fn(&str) -> Result<N, String> + Clone
where
    N: FromStr + PartialOrd + Display + Clone,
{
    move |text| {
        let number = text.parse::<N>().ok().filter(|number| bounds.contains(number));
        number.ok_or_else(|| format!("expected a whole number from {} to {}", bounds.start(), bounds.end()))
    }
}

/// A pose given as X and Y, m, and YAW, rad, by an option such as `--start`.
///
/// # Errors
/// Exit code 2, with the option: another number of numbers, or a heading that is probably in degrees.
pub(crate) fn pose(option: &str, numbers: &[f64]) -> Result<Pose2, Failure> {
    let [x, y, yaw] = *numbers else {
        return Err(Failure::usage(format!("{option}: expected X Y YAW")));
    };
    let checked = Expected::Angle.check(yaw);
    let yaw = checked.map_err(|why| Failure::usage(format!("{option}: YAW {why}")))?;
    Ok(Pose2::new(x, y, yaw))
}

/// A time of so many seconds; at most 2^30 (34 years), which any clock can add.
pub(crate) fn seconds(secs: f64) -> Duration {
    let most = Duration::from_secs(1 << 30);
    Duration::try_from_secs_f64(secs.max(0.0)).map_or(most, |time| time.min(most))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::exit_code;

    #[test]
    fn an_endpoint_that_nobody_can_dial_is_told_at_once() {
        assert!(endpoint("tcp/robot.local:7447").is_ok() && endpoint("tcp/[::1]:7447").is_ok());
        for bad in [
            "http://localhost:7447",
            "ws/localhost:7447",
            "localhost:7447",
            "tcp/localhost",
        ] {
            assert!(endpoint(bad).unwrap_err().contains("tcp/127.0.0.1:7447"), "{bad}");
        }
    }

    #[test]
    fn any_number_of_seconds_is_a_time_that_a_clock_can_add() {
        assert_eq!(seconds(10.0 / 2.0), Duration::from_secs(5));
        for none in [-1.0, f64::NEG_INFINITY, f64::NAN] {
            assert_eq!(seconds(none), Duration::ZERO, "{none}");
        }
        for most in [1e300, f64::INFINITY] {
            assert_eq!(seconds(most), Duration::from_secs(1 << 30), "{most}");
        }
    }

    #[test]
    fn a_pose_with_a_heading_in_degrees_is_refused_with_its_option() {
        assert_eq!(pose("--start", &[1.0, -2.0, 3.0]).unwrap(), Pose2::new(1.0, -2.0, 3.0));
        let refused = pose("--start", &[0.0, 0.0, 90.0]).unwrap_err();
        assert_eq!(refused.code, exit_code::USAGE);
        assert!(refused.message.starts_with("--start: YAW 90: expected"), "{refused}");
        assert!(pose("--start", &[0.0, 0.0]).is_err());
    }

    #[test]
    fn numbers_on_the_command_line_are_finite() {
        assert_eq!(finite("-1.5"), Ok(-1.5));
        assert!(finite("NaN").is_err() && finite("inf").is_err() && finite("x").is_err());
        assert!(positive("0").is_err());
        assert_eq!(whole("-3"), Ok(-3));
        assert_eq!(
            whole::<u64>("-1").unwrap_err(),
            "expected a whole number that is not negative"
        );
        assert_eq!(whole::<i32>("high").unwrap_err(), "expected a whole number");
        assert_eq!(whole_in(1..=9_u32)("9"), Ok(9));
        assert_eq!(
            whole_in(1..=9_u32)("0").unwrap_err(),
            "expected a whole number from 1 to 9"
        );
    }

    #[test]
    fn an_address_has_a_port() {
        assert!(address("127.0.0.1:0").is_ok() && address("[::1]:7480").is_ok() && address("localhost:7480").is_ok());
        for bad in ["7480", ":7480", "127.0.0.1", "127.0.0.1:99999", "foo"] {
            assert!(address(bad).unwrap_err().contains("127.0.0.1:7480"), "{bad}");
        }
    }
}

//! Parameters. Which gains can be changed while the robot runs? All gains of its file, within the same bounds.

use std::collections::BTreeMap;

use zenav_protocol::messages::{ParamReply, Refusal};
use zenav_protocol::robot::ControllerGains;
use zenav_protocol::settings::Settings as _;
use zenav_protocol::wall_following::WallFollowing;

/// One gain, or all of them without a name; those of the wall follower included.
///
/// # Errors
/// [`Refusal::NotFound`] for an unknown name.
pub fn read(gains: &ControllerGains, wall: &WallFollowing, name: Option<&str>) -> Result<ParamReply, Refusal> {
    let trackers = ControllerGains::numbers()
        .into_iter()
        .filter_map(|key| Some((gains.number(&key)?, key)));
    let walls = WallFollowing::numbers()
        .into_iter()
        .filter_map(|key| Some((wall.number(&key)?, key)));
    let params: BTreeMap<_, _> = trackers
        .chain(walls)
        .filter(|(_, key)| name.is_none_or(|name| name == *key))
        .map(|(value, key)| (key, value))
        .collect();
    if params.is_empty() {
        Err(unknown(name.unwrap_or_default()))
    } else {
        Ok(ParamReply { params })
    }
}

/// Sets one gain, for a robot with circumscribed radius `reach`, m.
///
/// ```
/// use zenav_edge::params::write;
/// use zenav_protocol::{robot::ControllerGains, wall_following::WallFollowing};
///
/// let (mut gains, mut wall) = (ControllerGains::default(), WallFollowing::default());
/// write(&mut gains, &mut wall, 0.265, "guard_margin", 0.1)?;
/// assert_eq!(gains.guard_margin, 0.1);
/// let refused = write(&mut gains, &mut wall, 0.265, "guard_margin", 0.0).unwrap_err();
/// assert_eq!(refused.to_string(), "rejected: `guard_margin` is 0: expected 0.01 to 0.5 m");
/// # Ok::<(), zenav_protocol::messages::Refusal>(())
/// ```
///
/// # Errors
/// [`Refusal::NotFound`] for an unknown name, [`Refusal::Rejected`] for a value out of bounds or one that does not fit the others.
pub fn write(
    gains: &mut ControllerGains,
    wall: &mut WallFollowing,
    reach: f64,
    name: &str,
    value: f64,
) -> Result<(), Refusal> {
    if let Some(changed) = wall.with_number(name, value) {
        let fits = |changed: WallFollowing| changed.check_for(reach).map(|()| changed);
        *wall = changed.and_then(fits).map_err(Refusal::rejected)?;
    } else if let Some(changed) = gains.with_number(name, value) {
        *gains = changed.map_err(Refusal::rejected)?;
    } else {
        return Err(unknown(name));
    }
    Ok(())
}

fn unknown(name: &str) -> Refusal {
    let name: String = name.chars().take(64).collect();
    let known = [ControllerGains::numbers(), WallFollowing::numbers()].concat();
    Refusal::NotFound {
        what: format!("parameter `{name}`; there are {}", known.join(", ")),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_value_out_of_bounds_changes_nothing() {
        let (mut gains, mut wall) = (ControllerGains::default(), WallFollowing::default());
        let mut set = |name: &str, value| write(&mut gains, &mut wall, 0.3, name, value);
        assert!(set("heading_gain", f64::NAN).is_err());
        assert!(set("guard_margin", 0.0).is_err());
        assert!(set("target_distance", 0.2).is_err());
        assert!(matches!(set("gain", 1.0), Err(Refusal::NotFound { .. })));
        assert_eq!(
            (&gains, &wall),
            (&ControllerGains::default(), &WallFollowing::default())
        );
    }

    #[test]
    fn a_value_that_was_set_is_read_back() {
        let (mut gains, mut wall) = (ControllerGains::default(), WallFollowing::default());
        write(&mut gains, &mut wall, 0.3, "heading_gain", 3.0).unwrap();
        write(&mut gains, &mut wall, 0.3, "wall_min_points", 7.0).unwrap();
        let read = |name| read(&gains, &wall, name).unwrap().params;
        assert_eq!(read(Some("heading_gain"))["heading_gain"], 3.0);
        assert_eq!(read(Some("wall_min_points"))["wall_min_points"], 7.0);
        assert_eq!(
            read(None).len(),
            ControllerGains::numbers().len() + WallFollowing::numbers().len()
        );
    }
}

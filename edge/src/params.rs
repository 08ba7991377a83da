//! Which gains can be changed while the robot runs, and within which bounds?

use std::collections::BTreeMap;

use zenav_protocol::messages::{ParamReply, Refusal};
use zenav_protocol::robot::ControllerGains;
use zenav_protocol::wall_following::WallFollowing;

/// A gain's name, bounds and place.
type Param = (&'static str, f64, f64, fn(&mut ControllerGains) -> &mut f64);

const PARAMS: [Param; 14] = [
    ("heading_gain", 0.0, 20.0, |gains| &mut gains.heading_gain),
    ("distance_gain", 0.0, 20.0, |gains| &mut gains.distance_gain),
    ("waypoint_threshold", 0.05, 2.0, |gains| &mut gains.waypoint_threshold),
    ("along_gain", 0.0, 5.0, |gains| &mut gains.along_gain),
    ("cross_gain", 0.0, 50.0, |gains| &mut gains.cross_gain),
    ("yaw_gain", 0.0, 20.0, |gains| &mut gains.yaw_gain),
    ("go_gain", 0.0, 10.0, |gains| &mut gains.go_gain),
    ("turn_gain", 0.0, 10.0, |gains| &mut gains.turn_gain),
    ("pid_p", 0.0, 100.0, |gains| &mut gains.pid_p),
    ("pid_i", 0.0, 100.0, |gains| &mut gains.pid_i),
    ("pid_d", 0.0, 100.0, |gains| &mut gains.pid_d),
    ("lookahead_secs", 0.1, 5.0, |gains| &mut gains.lookahead_secs),
    ("guard_margin", 0.01, 0.5, |gains| &mut gains.guard_margin),
    ("blind_speed", 0.0, 5.0, |gains| &mut gains.blind_speed),
];

/// One gain, or all of them without a name; those of the wall follower too.
///
/// # Errors
/// [`Refusal::NotFound`] for an unknown name.
pub fn read(gains: &ControllerGains, wall: &WallFollowing, name: Option<&str>) -> Result<ParamReply, Refusal> {
    let mut gains = gains.clone();
    let trackers = PARAMS.iter().map(|(known, _, _, place)| (*known, *place(&mut gains)));
    let walls = WallFollowing::names().filter_map(|known| Some((known, wall.get(known)?)));
    let params: BTreeMap<_, _> = trackers
        .chain(walls)
        .filter(|(known, _)| name.is_none_or(|name| name == *known))
        .map(|(known, value)| (known.to_owned(), value))
        .collect();
    if params.is_empty() {
        Err(unknown(name.unwrap_or_default()))
    } else {
        Ok(ParamReply { params })
    }
}

/// Sets one gain, for a robot whose outline reaches `reach` m from its origin.
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
    if let Some(changed) = wall.with(name, value, reach) {
        *wall = changed.map_err(Refusal::rejected)?;
        return Ok(());
    }
    let Some((_, least, most, place)) = PARAMS.iter().find(|(known, ..)| *known == name) else {
        return Err(unknown(name));
    };
    if !(*least..=*most).contains(&value) {
        return Err(Refusal::rejected(format!(
            "`{name}` must lie between {least} and {most}"
        )));
    }
    *place(gains) = value;
    Ok(())
}

fn unknown(name: &str) -> Refusal {
    let name: String = name.chars().take(64).collect();
    let known = PARAMS.iter().map(|(known, ..)| *known).chain(WallFollowing::names());
    Refusal::NotFound {
        what: format!("parameter `{name}`; there are {}", known.collect::<Vec<_>>().join(", ")),
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
    fn what_was_set_is_read_again() {
        let (mut gains, mut wall) = (ControllerGains::default(), WallFollowing::default());
        write(&mut gains, &mut wall, 0.3, "heading_gain", 3.0).unwrap();
        write(&mut gains, &mut wall, 0.3, "wall_min_points", 7.0).unwrap();
        let read = |name| read(&gains, &wall, name).unwrap().params;
        assert_eq!(read(Some("heading_gain"))["heading_gain"], 3.0);
        assert_eq!(read(Some("wall_min_points"))["wall_min_points"], 7.0);
        assert_eq!(read(None).len(), PARAMS.len() + WallFollowing::names().count());
    }
}

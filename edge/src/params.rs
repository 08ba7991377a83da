//! Which gains can be changed while the robot runs, and within which bounds?

use std::collections::BTreeMap;

use zenav_protocol::messages::{ParamReply, Refusal};
use zenav_protocol::robot::ControllerGains;

/// A gain's name, bounds and place.
type Param = (&'static str, f64, f64, fn(&mut ControllerGains) -> &mut f64);

const PARAMS: [Param; 7] = [
    ("heading_gain", 0.0, 20.0, |gains| &mut gains.heading_gain),
    ("distance_gain", 0.0, 20.0, |gains| &mut gains.distance_gain),
    ("waypoint_threshold", 0.05, 2.0, |gains| &mut gains.waypoint_threshold),
    ("along_gain", 0.0, 5.0, |gains| &mut gains.along_gain),
    ("cross_gain", 0.0, 50.0, |gains| &mut gains.cross_gain),
    ("yaw_gain", 0.0, 20.0, |gains| &mut gains.yaw_gain),
    ("guard_margin", 0.01, 0.5, |gains| &mut gains.guard_margin),
];

/// One gain, or all of them without a name.
///
/// # Errors
/// [`Refusal::NotFound`] for an unknown name.
pub fn read(gains: &ControllerGains, name: Option<&str>) -> Result<ParamReply, Refusal> {
    let mut gains = gains.clone();
    let chosen = PARAMS
        .iter()
        .filter(|(known, ..)| name.is_none_or(|name| name == *known));
    let params: BTreeMap<_, _> = chosen
        .map(|(known, _, _, place)| ((*known).to_owned(), *place(&mut gains)))
        .collect();
    if params.is_empty() {
        Err(unknown(name.unwrap_or_default()))
    } else {
        Ok(ParamReply { params })
    }
}

/// Sets one gain.
///
/// # Errors
/// [`Refusal::NotFound`] for an unknown name, [`Refusal::Rejected`] for a value out of bounds.
pub fn write(gains: &mut ControllerGains, name: &str, value: f64) -> Result<(), Refusal> {
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
    Refusal::NotFound {
        what: format!(
            "parameter `{name}`; there are {}",
            PARAMS.map(|(known, ..)| known).join(", ")
        ),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn a_value_out_of_bounds_changes_nothing() {
        let mut gains = ControllerGains::default();
        assert!(write(&mut gains, "heading_gain", f64::NAN).is_err());
        assert!(write(&mut gains, "guard_margin", 0.0).is_err());
        assert!(matches!(write(&mut gains, "gain", 1.0), Err(Refusal::NotFound { .. })));
        assert_eq!(gains, ControllerGains::default());
        write(&mut gains, "heading_gain", 3.0).unwrap();
        assert_eq!(read(&gains, Some("heading_gain")).unwrap().params["heading_gain"], 3.0);
        assert_eq!(read(&gains, None).unwrap().params.len(), PARAMS.len());
    }
}

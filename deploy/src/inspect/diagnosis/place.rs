//! Place. Does the robot know its place in the map, and is there a map?

use zenav_protocol::messages::{Health, Localisation, PoseEstimate};

use super::Robot;
use crate::inspect::check::Check;
use crate::output::listed;

/// Whether the robot knows its place in the map, as the source of poses judges by its scans.
pub(super) fn localisation(name: &str, told: &Localisation, has_stored_map: bool) -> Check {
    let at = told.map_from_base;
    let check = "localisation";
    match &told.health {
        Health::Tracking => Check::ok(name, check, "its scans agree with the map"),
        Health::Degraded { direction } => Check::ok(
            name,
            check,
            format!("its scans do not contradict the map, and leave the pose open along {direction:.2} rad"),
        ),
        Health::Unchecked => Check::ok(
            name,
            check,
            match has_stored_map {
                true => {
                    "the robot's own estimate; its scans were not compared with a known map: the map is unknown around the robot, the pose \
                     was just set, or mapping began without a map"
                }
                false => "the robot's own estimate; its scans were not compared with a known map: there is none",
            },
        ),
        Health::Contradicted => Check::fail(
            name,
            check,
            format!(
                "its scans do not agree with the map at its own estimate, ({:.2}, {:.2}, {:.2} rad): {:.0} % of the last one",
                at.x,
                at.y,
                at.yaw,
                100.0 * told.agreeing
            ),
            "it drives all the same. Is it the right map? `zenav pose set X Y YAW` tells it where it is; with `mapping.poses = \"localise\"` \
             it is corrected, and `zenav pose search` finds it. If the building has changed, map it anew: `zenav map reset`",
        ),
        Health::Ambiguous { hypotheses } => {
            let places = hypotheses
                .iter()
                .map(|at| format!("({:.2}, {:.2}, {:.2} rad)", at.x, at.y, at.yaw));
            Check::fail(
                name,
                check,
                format!("its scan fits {} places: {}", hypotheses.len(), listed(places)),
                "tell it which one is right: `zenav pose set X Y YAW`; it does not drive meanwhile",
            )
        }
        untrusted => Check::fail(
            name,
            check,
            format!("{untrusted}, last at ({:.2}, {:.2}, {:.2} rad)", at.x, at.y, at.yaw),
            "is it the right map? tell it where it is: `zenav pose set X Y YAW`; it does not drive meanwhile",
        ),
    }
}

pub(super) fn estimate(name: &str, pose: &PoseEstimate) -> Check {
    let (at, check) = (pose.map_from_base, "estimate");
    let spread = pose.covariance[0].max(pose.covariance[4]).max(0.0).sqrt();
    if !at.is_finite() || !spread.is_finite() {
        Check::fail(name, check, "not a number", "restart the edge, and report this")
    } else if spread > 0.5 {
        let seen = format!("uncertain by {spread:.2} m");
        let advice = "the robot may not know where it is: check its sensors and start pose";
        Check::warn(name, check, seen, advice)
    } else {
        let seen = format!("({:.2}, {:.2}), standard deviation {spread:.3} m", at.x, at.y);
        Check::ok(name, check, seen)
    }
}

pub(super) fn map(robot: &Robot) -> Check {
    let name = robot.name.as_str();
    let Some(info) = &robot.map else {
        return Check::warn(
            name,
            "map",
            "none yet",
            "is mapping running? A map begins with the first scan",
        );
    };
    let spec = &info.spec;
    let seen = format!(
        "{} revision {}, {:.1} m by {:.1} m at {} m, {} scans{}",
        info.map.id,
        info.map.revision,
        f64::from(spec.width) * spec.resolution,
        f64::from(spec.height) * spec.resolution,
        spec.resolution,
        info.scans,
        if info.stored { ", stored" } else { "" }
    );
    if info.free == 0 {
        Check::warn(
            name,
            "map",
            format!("{seen}, no free cell"),
            "let the robot see its surroundings: drive a mapping tour",
        )
    } else {
        Check::ok(name, "map", seen)
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::time::Stamp;

    use super::super::judge;
    use super::super::testing::{TIME, well};
    use super::*;
    use crate::inspect::check::Verdict;

    #[test]
    fn each_health_has_its_verdict_and_an_advice_if_it_fails() {
        let two = vec![Pose2::new(1.0, 2.0, 0.0), Pose2::new(7.0, 2.0, 3.1)];
        let mut robot = well();
        for (health, seen, advice) in [
            (Health::Tracking, "its scans agree with the map", None),
            (
                Health::Degraded { direction: 1.57 },
                "its scans do not contradict the map, and leave the pose open along 1.57 rad",
                None,
            ),
            (Health::Unchecked, "not compared with a known map: there is none", None),
            (
                Health::Contradicted,
                "do not agree with the map at its own estimate, (1.50, -0.50, 0.10 rad): 10 % of the last one",
                Some("it drives all the same"),
            ),
            (
                Health::Searching,
                "searching, last at (1.50, -0.50, 0.10 rad)",
                Some("it does not drive meanwhile"),
            ),
            (
                Health::Lost,
                "lost, last at (1.50, -0.50, 0.10 rad)",
                Some("it does not drive meanwhile"),
            ),
            (
                Health::Ambiguous { hypotheses: two },
                "its scan fits 2 places: (1.00, 2.00, 0.00 rad), (7.00, 2.00, 3.10 rad)",
                Some("tell it which one is right: `zenav pose set X Y YAW`"),
            ),
        ] {
            robot.localisation = Some(Localisation {
                stamp: Stamp(1),
                boot_id: "b".into(),
                health,
                map_from_base: Pose2::new(1.5, -0.5, 0.1),
                agreeing: 0.1,
                through_walls: 0.3,
            });
            let checks = judge(&robot, TIME);
            let found = checks.iter().find(|check| check.check == "localisation").unwrap();
            assert_eq!(found.verdict == Verdict::Fail, advice.is_some(), "{found:?}");
            assert_eq!(found.verdict == Verdict::Ok, found.advice.is_none(), "{found:?}");
            assert!(found.seen.contains(seen), "{}", found.seen);
            let told = found.advice.as_deref().unwrap_or_default();
            assert!(told.contains(advice.unwrap_or_default()), "{told}");
        }
    }

    #[test]
    fn beside_a_stored_map_it_is_said_why_scans_are_not_compared() {
        let mut robot = well();
        robot.localisation = Some(Localisation {
            stamp: Stamp(1),
            boot_id: "b".into(),
            health: Health::Unchecked,
            map_from_base: Pose2::IDENTITY,
            agreeing: 0.0,
            through_walls: 0.0,
        });
        robot.map = serde_json::from_value(serde_json::json!({
            "stamp": 1, "map": { "id": "m", "revision": 1 },
            "spec": { "origin": [0.0, 0.0], "resolution": 0.05, "width": 10, "height": 10 },
            "free": 60, "occupied": 40, "unknown": 0, "scans": 0, "stored": true
        }))
        .unwrap();
        let checks = judge(&robot, TIME);
        let found = checks.iter().find(|check| check.check == "localisation").unwrap();
        assert!(
            found.seen.contains("the map is unknown around the robot"),
            "{}",
            found.seen
        );
    }
}

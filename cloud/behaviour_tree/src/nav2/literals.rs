//! Literals. How are poses, lists of poses and paths written in a tree? As `x;y` or `x;y;yaw`, several separated by `|`; in the format of
//! Nav2 1.5, `stamp;frame;x;y;z;qx;qy;qz;qw` (`nav2_behavior_tree/bt_utils.hpp`); or as JSON. A pose can also be given by the name of a
//! place.

use std::f64::consts::TAU;

use serde::Deserialize;
use serde_json::Value as Json;

use crate::ports::LiteralRules;
use crate::value::Value;

/// A pose in a tree: m, rad.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
pub struct Pose {
    /// Position, m.
    pub x: f64,
    /// Position, m.
    pub y: f64,
    /// Heading, rad, if given.
    pub yaw: Option<f64>,
}

/// Literal formats on ports of Nav2's types.
pub(super) const RULES: LiteralRules = LiteralRules {
    fits,
    form,
    name: named,
    doubt,
};

/// Number of fields of a pose in Nav2's format.
const FIELDS: usize = 9;

/// The JSON of a literal: after `json:`, or starting with a bracket.
fn json_of(text: &str) -> Option<&str> {
    let text = text.trim_start();
    text.strip_prefix("json:")
        .or_else(|| text.starts_with(['{', '[']).then_some(text))
}

/// A finite number.
fn number(text: &str) -> Option<f64> {
    text.trim().parse().ok().filter(|number: &f64| number.is_finite())
}

/// Finite numbers separated by `;`.
fn numbers(text: &str) -> Option<Vec<f64>> {
    text.split(';').map(number).collect()
}

/// Whether a pose is plausible: finite, with a heading in radians within a full turn.
fn is_meant(pose: &Pose) -> bool {
    pose.x.is_finite() && pose.y.is_finite() && pose.yaw.is_none_or(|yaw| yaw.abs() <= TAU)
}

/// Parses a pose given by coordinates; `None` for a name and for invalid text.
///
/// ```
/// use zenav_behaviour_tree::nav2::{Pose, pose};
///
/// assert_eq!(pose("1.5;2"), Some(Pose { x: 1.5, y: 2.0, yaw: None }));
/// assert_eq!(pose("0;map;1.5;2;0;0;0;0;1"), Some(Pose { x: 1.5, y: 2.0, yaw: Some(0.0) }));
/// assert_eq!(pose("1.5;2;90"), None, "a heading is in radians");
/// ```
pub fn pose(text: &str) -> Option<Pose> {
    if let Some(json) = json_of(text) {
        return pose_of_json(&serde_json::from_str(json).ok()?);
    }
    let fields: Vec<&str> = text.split(';').collect();
    match fields.len() {
        2 | 3 => match *numbers(text)?.as_slice() {
            [x, y] => Some(Pose { x, y, yaw: None }),
            [x, y, yaw] => Some(Pose { x, y, yaw: Some(yaw) }).filter(is_meant),
            _ => None,
        },
        FIELDS => nav2_pose(&fields),
        _ => None,
    }
}

/// A pose on the blackboard.
pub(super) fn pose_of(value: &Value) -> Option<Pose> {
    match value {
        Value::Text(text) => pose(text),
        Value::Data(data) => pose_of_json(data),
        _ => None,
    }
}

/// `{"x": .., "y": .., "yaw": ..}`, or Nav2's form, with `position` and `orientation` under `pose`.
pub fn pose_of_json(json: &Json) -> Option<Pose> {
    let pose = json.get("pose").unwrap_or(json);
    let found = match pose.get("position") {
        Some(position) => {
            let of = |part: &Json, axis: &str| part.get(axis).and_then(Json::as_f64);
            let turn = pose.get("orientation");
            let turn = ["x", "y", "z", "w"].map(|axis| turn.and_then(|turn| of(turn, axis)));
            let yaw = match turn {
                [Some(x), Some(y), Some(z), Some(w)] => Some(heading([x, y, z, w])),
                _ => None,
            };
            Pose {
                x: of(position, "x")?,
                y: of(position, "y")?,
                yaw,
            }
        }
        None => serde_json::from_value(pose.clone()).ok()?,
    };
    is_meant(&found).then_some(found)
}

/// Yaw of a quaternion.
fn heading([x, y, z, w]: [f64; 4]) -> f64 {
    (2.0 * (w * z + x * y)).atan2(1.0 - 2.0 * (y * y + z * z))
}

fn nav2_pose(fields: &[&str]) -> Option<Pose> {
    let [stamp, _, numbers @ ..] = fields else { return None };
    stamp.trim().parse::<i64>().ok()?;
    let numbers: Option<Vec<f64>> = numbers.iter().copied().map(number).collect();
    match *numbers?.as_slice() {
        [x, y, _, qx, qy, qz, qw] => Some(Pose {
            x,
            y,
            yaw: Some(heading([qx, qy, qz, qw])),
        }),
        _ => None,
    }
}

/// A list in Nav2's format: poses in sequence, optionally preceded by a stamp and a frame.
pub fn nav2_list(text: &str) -> Option<Vec<Pose>> {
    let fields: Vec<&str> = text.split(';').collect();
    let poses = match fields.as_slice() {
        [stamp, _, poses @ ..] if poses.len() >= FIELDS && poses.len() % FIELDS == 0 => {
            stamp.trim().parse::<i64>().ok()?;
            poses
        }
        poses if poses.len() % FIELDS == 0 => poses,
        _ => return None,
    };
    poses.chunks(FIELDS).map(nav2_pose).collect()
}

/// Whether a text can be the name of a place: it contains a letter, is not a number, and does not look like a list.
fn is_name(text: &str) -> bool {
    let text = text.trim();
    text.chars().any(char::is_alphabetic)
        && text.parse::<f64>().is_err()
        && !text.contains([';', ',', '{', '}', '[', ']'])
}

/// Each goal of a textual list.
fn goals(text: &str) -> impl Iterator<Item = &str> {
    text.split('|').map(str::trim).filter(|goal| !goal.is_empty())
}

fn is_list(text: &str, fits: impl Fn(&Json) -> bool) -> Option<bool> {
    let json: Json = serde_json::from_str(json_of(text)?).unwrap_or_default();
    Some(json.as_array().is_some_and(|items| items.iter().all(fits)))
}

/// Whether a literal can be a value of the named type. Types other than Nav2's are not checked.
fn fits(kind: &str, text: &str) -> bool {
    match kind {
        "PoseStamped" => pose(text).is_some() || is_name(text),
        "Goals" | "vector<PoseStamped>" => {
            let goal = |json: &Json| match json.as_str() {
                Some(goal) => pose(goal).is_some() || is_name(goal),
                None => pose_of_json(json).is_some(),
            };
            is_list(text, goal).unwrap_or_else(|| {
                nav2_list(text).is_some() || goals(text).all(|goal| pose(goal).is_some() || is_name(goal))
            })
        }
        // Points, or a route written by ComputePathToPose.
        "Path" => match json_of(text) {
            Some(json) => serde_json::from_str(json).is_ok_and(|json: Json| json.is_array() || json.is_object()),
            None => nav2_list(text).is_some(),
        },
        "Point" | "Quaternion" if json_of(text).is_none() => {
            numbers(text).is_some_and(|numbers| numbers.len() == if kind == "Point" { 3 } else { 4 })
        }
        "vector<double>" | "vector<float>" => {
            is_list(text, Json::is_number).unwrap_or_else(|| text.trim().is_empty() || numbers(text).is_some())
        }
        _ => text
            .strip_prefix("json:")
            .is_none_or(|json| serde_json::from_str::<serde::de::IgnoredAny>(json).is_ok()),
    }
}

/// Format of literals of the named type.
fn form(kind: &str) -> Option<&'static str> {
    Some(match kind {
        "PoseStamped" => "`x;y`, `x;y;yaw` (radians within a full turn), the name of a place, or JSON",
        "Goals" | "vector<PoseStamped>" => {
            "poses `x;y` or `x;y;yaw` (radians within a full turn) separated by |, or JSON"
        }
        "Path" => "JSON `[[x, y], …]`",
        "Point" => "`x;y;z`",
        "Quaternion" => "`x;y;z;w`",
        "vector<double>" | "vector<float>" => "numbers separated by ;",
        _ => return None,
    })
}

/// Why a number on one of Nav2's ports is probably a mistake.
fn doubt(port: &str, number: f64) -> Option<&'static str> {
    match port {
        "spin_dist" if number.abs() > TAU => Some("more than a full turn; 90 degrees are 1.571 rad"),
        "wait_duration" | "time_allowance" if number < 0.0 => Some("expected seconds, not negative"),
        _ => None,
    }
}

/// The first place name in a literal of the named type.
fn named<'t>(kind: &str, text: &'t str) -> Option<&'t str> {
    match kind {
        "PoseStamped" => Some(text.trim()).filter(|name| is_name(name) && pose(name).is_none()),
        "Goals" | "vector<PoseStamped>" if json_of(text).is_none() && nav2_list(text).is_none() => {
            goals(text).find(|goal| is_name(goal))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pose_is_read_in_every_form() {
        let half = std::f64::consts::FRAC_1_SQRT_2;
        for text in [
            "1;2;1.5707963267948966".to_owned(),
            format!("0;map;1;2;0;0;0;{half};{half}"),
            "json:{\"x\": 1, \"y\": 2, \"yaw\": 1.5707963267948966}".to_owned(),
            format!(
                "{{\"header\": {{}}, \"pose\": {{\"position\": {{\"x\": 1, \"y\": 2, \"z\": 0}}, \"orientation\": {{\"x\": 0, \"y\": 0, \"z\": {half}, \"w\": {half}}}}}}}"
            ),
        ] {
            let pose = pose(&text).unwrap();
            assert_eq!((pose.x, pose.y), (1.0, 2.0), "{text}");
            assert!(
                (pose.yaw.unwrap() - std::f64::consts::FRAC_PI_2).abs() < 1e-12,
                "{text}"
            );
        }
        for text in [
            "",
            "1",
            "1;x",
            "1;2;3;4",
            "1;2;90",
            "NaN;1",
            "x;map;1;2;0;0;0;0;1",
            "{}",
            "{",
        ] {
            assert_eq!(pose(text), None, "{text}");
        }
    }

    #[test]
    fn literals_of_structured_types_are_told_from_slips() {
        let pose = "0;map;1;2;0;0;0;0;1";
        for (kind, good, bad) in [
            (
                "PoseStamped",
                vec!["1;2", "sink", "room 2", pose],
                vec![
                    "",
                    "1",
                    "1;x",
                    "1,2",
                    "{\"x\": 1}",
                    "1;2;90",
                    "{\"x\": 1, \"y\": 2, \"yaw\": -90}",
                ],
            ),
            (
                "Goals",
                vec!["", "1;2|sink", "json:[{\"x\":1,\"y\":2},\"1;2\"]", pose],
                vec!["1;2|3", "json:[1]", "{}", "1;2;3;4"],
            ),
            (
                "Path",
                vec!["[[0,0],[1,1]]", "json:[]"],
                vec!["", "home", "1;2", "json:["],
            ),
            ("Point", vec!["1;2;3"], vec!["1;2", "1;x;3"]),
            ("Quaternion", vec!["0;0;0;1"], vec!["0;0;1"]),
            (
                "vector<double>",
                vec!["1;2.5", "json:[1, 2]", ""],
                vec!["1;x", "json:[\"x\"]"],
            ),
            ("Anything", vec!["what;ever"], vec!["json:{"]),
        ] {
            for text in good {
                assert!(fits(kind, text), "{kind} {text}");
            }
            for text in bad {
                assert!(!fits(kind, text), "{kind} {text}");
            }
        }
        let header = format!("0;map;{pose};{pose}");
        assert_eq!(nav2_list(&header).map(|poses| poses.len()), Some(2));
        assert!(fits("Goals", &header) && fits("Path", &header));
        assert_eq!(named("Goals", "1;2|sink"), Some("sink"));
        assert_eq!(named("PoseStamped", "1;2"), None);
    }
}

//! Ports. How are goals, lists of goals and paths written in a tree? Goals are `x;y` or `x;y;yaw`, the name of a place, JSON, or Nav2's
//! format; lists are separated by `|`, or JSON; a path is what ComputePathToPose writes to the blackboard, or a JSON list of points.

use std::collections::BTreeMap;
use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{GoalPoint, check_backwards};
use zenav_protocol::robot::RobotModel;

use super::path::{self, DrivenPath};
use crate::context::Context;
use crate::route::RouteData;
use zenav_behaviour_tree::nav2::{Pose, nav2_list, pose, pose_of_json};
use zenav_behaviour_tree::{LeafIo, Status, Value};
use zenav_space::ConfigurationSpace;

/// Named goals.
pub type Places = BTreeMap<String, GoalPoint>;

/// Most places in a list.
const MAX_POINTS: usize = 10_000;
/// Why a path cannot be used.
pub const OLD_FRAME: &str = "the path is of a frame of the map that is too long ago";

/// Parses a goal from a port's value.
///
/// # Errors
/// What was expected.
pub fn parse_goal(value: &Value, places: &Places) -> Result<GoalPoint, String> {
    let goal = match value {
        Value::Text(text) => match text
            .trim_start()
            .strip_prefix("json:")
            .or_else(|| text.trim_start().starts_with('{').then_some(text))
        {
            Some(json) => {
                let json = serde_json::from_str(json).map_err(|error| format!("goal `{json}`: {error}"))?;
                parse_json(&json)?
            }
            None if !text.contains(';') => named(text.trim(), places)?,
            None => parse_numbers(text)?,
        },
        Value::Data(data) => parse_json(data)?,
        other => return Err(format!("goal `{other}`: expected `x;y` or `x;y;yaw`")),
    };
    let finite = goal.x.is_finite() && goal.y.is_finite() && goal.yaw.is_none_or(f64::is_finite);
    if finite {
        Ok(goal)
    } else {
        Err("goal: expected finite numbers".to_owned())
    }
}

fn named(name: &str, places: &Places) -> Result<GoalPoint, String> {
    if let Some(place) = places.get(name) {
        return Ok(*place);
    }
    let names: Vec<&str> = places.keys().map(String::as_str).take(20).collect();
    let known = if names.is_empty() {
        "there are none".to_owned()
    } else {
        names.join(", ")
    };
    let name: String = name.chars().take(60).collect();
    Err(format!(
        "goal `{name}`: expected `x;y`, `x;y;yaw` or the name of a place ({known})"
    ))
}

fn goal_of(Pose { x, y, yaw }: Pose) -> GoalPoint {
    GoalPoint { x, y, yaw }
}

fn parse_numbers(text: &str) -> Result<GoalPoint, String> {
    pose(text).map(goal_of).ok_or_else(|| {
        let text: String = text.chars().take(60).collect();
        format!("goal `{text}`: expected `x;y` or `x;y;yaw`")
    })
}

fn parse_json(json: &serde_json::Value) -> Result<GoalPoint, String> {
    pose_of_json(json).map(goal_of).ok_or_else(|| {
        let text: String = json.to_string().chars().take(60).collect();
        format!("goal `{text}`: expected x, y and perhaps yaw")
    })
}

/// A goal as written in a tree.
#[must_use]
pub fn goal_text(goal: &GoalPoint) -> String {
    match goal.yaw {
        Some(yaw) => format!("{};{};{yaw}", goal.x, goal.y),
        None => format!("{};{}", goal.x, goal.y),
    }
}

/// The goal on a port.
///
/// # Errors
/// What was expected.
pub fn goal_on(io: &LeafIo<'_>, ctx: &Context, port: &str) -> Result<GoalPoint, String> {
    parse_goal(io.value(port)?, &ctx.config.places)
}

/// Parses goals from a port's value: a JSON list of goals or of their texts, or places separated by `|`.
///
/// # Errors
/// What was expected.
pub fn parse_goals(value: &Value, places: &Places) -> Result<Vec<GoalPoint>, String> {
    let goals: Vec<GoalPoint> = match value {
        Value::Data(data) => {
            let items = data.as_array().ok_or("goals: expected a list")?;
            items
                .iter()
                .take(MAX_POINTS + 1)
                .map(|item| {
                    let goal = Value::from_json(item).ok_or("goals: expected no null")?;
                    parse_goal(&goal, places)
                })
                .collect::<Result<_, String>>()?
        }
        other => {
            let text = other.to_string();
            let json = text.trim_start().strip_prefix("json:").unwrap_or(text.trim_start());
            if json.starts_with('[') {
                let list: serde_json::Value = serde_json::from_str(json).map_err(|error| format!("goals: {error}"))?;
                return parse_goals(&Value::from(list), places);
            }
            if let Some(goals) = nav2_list(&text).filter(|goals| goals.len() <= MAX_POINTS) {
                return Ok(goals.into_iter().map(goal_of).collect());
            }
            let goals = text.split('|').map(str::trim).filter(|goal| !goal.is_empty());
            goals
                .take(MAX_POINTS + 1)
                .map(|goal| parse_goal(&Value::text(goal), places))
                .collect::<Result<_, _>>()?
        }
    };
    if goals.len() > MAX_POINTS {
        return Err(format!("more than {MAX_POINTS} goals: expected fewer"));
    }
    Ok(goals)
}

/// The goals on a port.
///
/// # Errors
/// What was expected.
pub fn goals_on(io: &LeafIo<'_>, ctx: &Context, port: &str) -> Result<Vec<GoalPoint>, String> {
    parse_goals(io.value(port)?, &ctx.config.places)
}

/// Goals as stored on the blackboard: a list of texts, which `LoopString` can iterate over.
///
/// # Errors
/// None in practice: texts have a stored form.
pub fn goals_value(goals: &[GoalPoint]) -> Result<Value, String> {
    let texts: Vec<String> = goals.iter().map(goal_text).collect();
    Value::data(&texts).map_err(|error| error.to_string())
}

/// Parses a path from a port's value: a route's data, or a list of points, `[[x, y], …]`.
///
/// # Errors
/// What was expected.
pub fn parse_path(value: &Value) -> Result<RouteData, String> {
    let data = value.to_json();
    let data = match &data {
        serde_json::Value::String(text) => {
            if let Some(poses) = nav2_list(text).filter(|poses| poses.len() <= MAX_POINTS) {
                let points = poses.iter().map(|pose| Point2::new(pose.x, pose.y)).collect();
                let yaw = poses.last().and_then(|pose| pose.yaw);
                return Ok(RouteData::of(DrivenPath::forwards(points), yaw));
            }
            serde_json::from_str(text.trim_start().strip_prefix("json:").unwrap_or(text))
                .map_err(|error| format!("path: {error}"))?
        }
        _ => data,
    };
    let route = if data.is_array() {
        let points: Vec<Point2<f64>> = serde_json::from_value(data).map_err(|error| format!("path: {error}"))?;
        RouteData::of(DrivenPath::forwards(points), None)
    } else {
        serde_json::from_value(data).map_err(|error| format!("path: {error}"))?
    };
    let finite = |point: &Point2<f64>| point.x.is_finite() && point.y.is_finite();
    if route.points.len() > MAX_POINTS || !route.points.iter().all(finite) {
        return Err(format!("path: expected at most {MAX_POINTS} points, all finite"));
    }
    check_backwards(&route.backwards, route.points.len()).map_err(|error| format!("path: {error}"))?;
    Ok(route)
}

/// The path on a port.
///
/// # Errors
/// What was expected.
pub fn path_on(io: &LeafIo<'_>, port: &str) -> Result<RouteData, String> {
    parse_path(io.value(port)?)
}

/// The same in the present frame of the map.
///
/// # Errors
/// What was expected.
pub fn settled_path(io: &LeafIo<'_>, ctx: &Context, port: &str) -> Result<RouteData, String> {
    path_on(io, port)?
        .settled(&ctx.frames)
        .ok_or_else(|| OLD_FRAME.to_owned())
}

impl RouteData {
    /// A path that does not come from a route, to its last point. `yaw` is the heading there.
    #[must_use]
    pub fn of(path: DrivenPath, yaw: Option<f64>) -> Self {
        let DrivenPath { points, backwards } = path;
        let end = points.last().copied().unwrap_or_else(Point2::origin);
        Self {
            route: 0,
            goal: GoalPoint {
                yaw,
                ..GoalPoint::at(end.x, end.y)
            },
            length: path::length(&points),
            points,
            backwards,
            via: Vec::new(),
            place: None,
            frame: None,
            driven: 0.0,
        }
    }

    /// Its points, and which of its legs are driven backwards.
    #[must_use]
    pub fn driven(&self) -> DrivenPath {
        DrivenPath {
            points: self.points.clone(),
            backwards: self.backwards.clone(),
        }
    }

    /// The path as stored on the blackboard.
    ///
    /// # Errors
    /// None in practice: numbers have a stored form.
    pub fn value(&self) -> Result<Value, String> {
        Value::data(self).map_err(|error| error.to_string())
    }
}

/// The flag on a port, or `otherwise` if it has none.
pub fn flag(io: &LeafIo<'_>, port: &str, otherwise: bool) -> bool {
    io.get_optional(port).ok().flatten().unwrap_or(otherwise)
}

/// Writes a value to a port: SUCCESS.
///
/// # Errors
/// What the entry behind the port expects.
pub fn write(io: &mut LeafIo<'_>, port: &str, value: Result<Value, String>) -> Result<Status, String> {
    io.set(port, value?)?;
    Ok(Status::Success)
}

/// The robot's pose.
///
/// # Errors
/// The pose is unknown.
pub fn robot_pose(ctx: &Context) -> Result<Pose2, String> {
    ctx.robot
        .pose()
        .ok_or_else(|| "nobody knows where the robot is".to_owned())
}

/// The robot's model and its configuration space; `None` if either is unknown.
pub fn ground(ctx: &mut Context) -> Option<(RobotModel, Arc<ConfigurationSpace>)> {
    let model = ctx.robot.model().cloned()?;
    let space = ctx.map.space(&model.footprint)?;
    Some((model, space))
}

/// Parses waypoints from a port's value, repeated `laps` times.
///
/// # Errors
/// What was expected.
pub fn parse_points(value: &Value, laps: u64, places: &Places) -> Result<Vec<Point2<f64>>, String> {
    let goals = parse_goals(value, places)?;
    if goals.is_empty() || goals.len().saturating_mul(usize::try_from(laps).unwrap_or(usize::MAX)) > MAX_POINTS {
        return Err(format!(
            "{} waypoints {laps} times: expected 1 to {MAX_POINTS} in all",
            goals.len()
        ));
    }
    let points: Vec<Point2<f64>> = goals.iter().map(GoalPoint::position).collect();
    if !points.iter().all(|point| point.x.is_finite() && point.y.is_finite()) {
        return Err("waypoints: expected finite numbers".to_owned());
    }
    Ok((0..laps).flat_map(|_| points.iter().copied()).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn goals_are_read_in_every_form() {
        let here = GoalPoint::at(0.88, 0.09);
        assert_eq!(parse_goal(&Value::text(" 0.88; 0.09"), &Places::new()).unwrap(), here);
        assert_eq!(
            parse_goal(&Value::text(r#"{"x": 0.88, "y": 0.09}"#), &Places::new()).unwrap(),
            here
        );
        assert_eq!(parse_goal(&Value::data(&here).unwrap(), &Places::new()).unwrap(), here);
        assert_eq!(
            parse_goal(&Value::text(goal_text(&here)), &Places::new()).unwrap(),
            here
        );
        assert_eq!(
            parse_goal(&Value::text("1;2;0.5"), &Places::new()).unwrap().yaw,
            Some(0.5)
        );
        for bad in ["", "1", "1;2;3;4", "a;b", "NaN;1", "1;inf"] {
            assert!(parse_goal(&Value::text(bad), &Places::new()).is_err(), "{bad}");
        }
    }

    #[test]
    fn places_are_found_by_name_and_a_stranger_is_told_the_names() {
        let sink = GoalPoint::at(0.88, 0.09);
        let places: Places = [("sink".to_owned(), sink)].into();
        assert_eq!(parse_goal(&Value::text(" sink "), &places), Ok(sink));
        assert_eq!(parse_goals(&Value::text("sink|1;2|sink"), &places).unwrap().len(), 3);
        assert!(parse_goal(&Value::text("table"), &places).is_err_and(|why| why.contains("(sink)")));
    }

    #[test]
    fn goals_and_paths_come_back_as_they_were_written() {
        let goals = vec![GoalPoint::at(1.0, -2.5), Pose2::new(0.1, 0.2, -1.5).into()];
        assert_eq!(
            parse_goals(&goals_value(&goals).unwrap(), &Places::new()).unwrap(),
            goals
        );
        assert_eq!(
            parse_goals(&Value::text("1;-2.5|0.1;0.2;-1.5"), &Places::new()).unwrap(),
            goals
        );
        assert_eq!(
            parse_goals(&Value::text(r#"[{"x":1,"y":-2.5},"0.1;0.2;-1.5"]"#), &Places::new()).unwrap(),
            goals
        );
        let pose = |x: f64| format!("0;map;{x};0;0;0;0;0;1");
        let nav2 = Value::text(format!("0;map;{};{}", pose(1.0), pose(2.0)));
        let goals = parse_goals(&nav2, &Places::new()).unwrap();
        assert_eq!(
            goals.iter().map(|goal| (goal.x, goal.yaw)).collect::<Vec<_>>(),
            [(1.0, Some(0.0)), (2.0, Some(0.0))]
        );
        assert_eq!(parse_path(&nav2).unwrap().length, 1.0);
        let path = parse_path(&Value::text("json:[[0,0],[3,4]]")).unwrap();
        assert_eq!((path.length, path.goal.x, path.route), (5.0, 3.0, 0));
        assert_eq!(parse_path(&path.value().unwrap()).unwrap(), path);
        for bad in ["", "[[0]]", "{}", "[[0,1e999]]"] {
            assert!(parse_path(&Value::text(bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn a_path_is_stored_with_the_legs_that_are_driven_backwards_if_it_has_any() {
        let points = [0.0, 2.0, 1.0].map(|x| Point2::new(x, 0.0)).to_vec();
        let mut path = RouteData::of(DrivenPath::forwards(points), None);
        let stored = r#"{"route":0,"goal":{"x":1.0,"y":0.0},"points":[[0.0,0.0],[2.0,0.0],[1.0,0.0]],"length":3.0}"#;
        assert_eq!(serde_json::to_string(&path).unwrap(), stored);
        assert_eq!(parse_path(&Value::text(stored)).unwrap(), path);
        (path.backwards, path.driven) = (vec![1], 2.5);
        assert_eq!(parse_path(&path.value().unwrap()).unwrap(), path);
        for bad in [vec![2], vec![1, 0], vec![1, 1], vec![usize::MAX]] {
            path.backwards = bad;
            let why = parse_path(&path.value().unwrap()).unwrap_err();
            assert!(why.contains("`backwards`") && why.contains("2 legs"), "{why}");
        }
    }

    #[test]
    fn laps_repeat_the_list_within_bounds() {
        assert_eq!(
            parse_points(&Value::text("1;2|3;4|"), 2, &Places::new()).unwrap().len(),
            4
        );
        assert!(parse_points(&Value::text(""), 1, &Places::new()).is_err());
        assert!(parse_points(&Value::text("1;2"), 0, &Places::new()).is_ok_and(|points| points.is_empty()));
        assert!(parse_points(&Value::text("1;2"), u64::MAX, &Places::new()).is_err());
    }
}

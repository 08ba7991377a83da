//! How are goals and waypoints written in a tree? `x;y` or `x;y;yaw`, places separated by `|`, or JSON.

use nalgebra::Point2;
use zenav_protocol::messages::GoalPoint;

use crate::behaviour_tree::Value;

/// Places in one list.
const MAX_POINTS: usize = 10_000;

/// A goal from a port's value.
///
/// # Errors
/// What was expected.
pub fn parse_goal(value: &Value) -> Result<GoalPoint, String> {
    let goal = match value {
        Value::Text(text) => match text
            .trim_start()
            .strip_prefix("json:")
            .or_else(|| text.trim_start().starts_with('{').then_some(text))
        {
            Some(json) => serde_json::from_str(json).map_err(|error| format!("goal `{json}`: {error}"))?,
            None => parse_numbers(text)?,
        },
        Value::Data(data) => {
            serde_json::from_value((**data).clone()).map_err(|error| format!("goal {data}: {error}"))?
        }
        other => return Err(format!("goal `{other}`: expected `x;y` or `x;y;yaw`")),
    };
    let finite = goal.x.is_finite() && goal.y.is_finite() && goal.yaw.is_none_or(f64::is_finite);
    if finite {
        Ok(goal)
    } else {
        Err("goal: expected finite numbers".to_owned())
    }
}

fn parse_numbers(text: &str) -> Result<GoalPoint, String> {
    let wrong = || {
        format!(
            "goal `{}`: expected `x;y` or `x;y;yaw`",
            text.chars().take(60).collect::<String>()
        )
    };
    let numbers: Vec<f64> = text
        .split(';')
        .map(|part| part.trim().parse())
        .collect::<Result<_, _>>()
        .map_err(|_| wrong())?;
    match *numbers.as_slice() {
        [x, y] => Ok(GoalPoint { x, y, yaw: None }),
        [x, y, yaw] => Ok(GoalPoint { x, y, yaw: Some(yaw) }),
        _ => Err(wrong()),
    }
}

/// A goal as it stands in a tree.
#[must_use]
pub fn goal_text(goal: &GoalPoint) -> String {
    match goal.yaw {
        Some(yaw) => format!("{};{};{yaw}", goal.x, goal.y),
        None => format!("{};{}", goal.x, goal.y),
    }
}

/// Waypoints from a port's value, `laps` times.
///
/// # Errors
/// What was expected.
pub fn parse_points(value: &Value, laps: u64) -> Result<Vec<Point2<f64>>, String> {
    let goals: Vec<GoalPoint> = match value {
        Value::Data(data) => serde_json::from_value((**data).clone()).map_err(|error| format!("waypoints: {error}"))?,
        other => {
            let text = other.to_string();
            let places = text.split('|').map(str::trim).filter(|place| !place.is_empty());
            places
                .take(MAX_POINTS + 1)
                .map(|place| parse_goal(&Value::text(place)))
                .collect::<Result<_, _>>()?
        }
    };
    if goals.is_empty() || goals.len().saturating_mul(usize::try_from(laps).unwrap_or(usize::MAX)) > MAX_POINTS {
        return Err(format!(
            "{} waypoints {laps} times: expected 1 to {MAX_POINTS} in all",
            goals.len()
        ));
    }
    let points: Vec<Point2<f64>> = goals.iter().map(|goal| Point2::new(goal.x, goal.y)).collect();
    if !points.iter().all(|point| point.x.is_finite() && point.y.is_finite()) {
        return Err("waypoints: expected finite numbers".to_owned());
    }
    Ok((0..laps).flat_map(|_| points.iter().copied()).collect())
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn goals_are_read_in_every_form() {
        let here = GoalPoint {
            x: 0.88,
            y: 0.09,
            yaw: None,
        };
        assert_eq!(parse_goal(&Value::text(" 0.88; 0.09")).unwrap(), here);
        assert_eq!(parse_goal(&Value::text(r#"{"x": 0.88, "y": 0.09}"#)).unwrap(), here);
        assert_eq!(parse_goal(&Value::data(&here).unwrap()).unwrap(), here);
        assert_eq!(parse_goal(&Value::text(goal_text(&here))).unwrap(), here);
        assert_eq!(parse_goal(&Value::text("1;2;0.5")).unwrap().yaw, Some(0.5));
        for bad in ["", "1", "1;2;3;4", "a;b", "NaN;1", "1;inf"] {
            assert!(parse_goal(&Value::text(bad)).is_err(), "{bad}");
        }
    }

    #[test]
    fn laps_repeat_the_list_within_bounds() {
        assert_eq!(parse_points(&Value::text("1;2|3;4|"), 2).unwrap().len(), 4);
        assert!(parse_points(&Value::text(""), 1).is_err());
        assert!(parse_points(&Value::text("1;2"), 0).is_ok_and(|points| points.is_empty()));
        assert!(parse_points(&Value::text("1;2"), u64::MAX).is_err());
    }
}

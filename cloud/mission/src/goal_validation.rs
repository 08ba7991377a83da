//! Goal validation. Is this a valid goal, and can it be reached? Checked on submission; a rejection has a reason and the nearest free
//! place.

use nalgebra::Point2;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalPoint, GoalRequest, Refusal};

use super::context::Context;
use super::route::NEARBY;
use super::trees;
use zenav_behaviour_tree::{MOST_NESTED, is_nested_within};
use zenav_protocol::padding::Extent;
use zenav_space::{BitGrid, ConfigurationSpace, reach};

/// Largest map on which the connection of goal and robot is checked before acceptance, cells: about 50 ms.
const MAX_FLOODED: usize = 4_000_000;
/// Most blackboard entries of a goal.
const MAX_ENTRIES: usize = 256;
/// Longest name of a blackboard entry, bytes.
const MAX_NAME: usize = 256;
/// Bounds of a goal's tolerance, m.
pub const GOAL_TOLERANCE: std::ops::RangeInclusive<f64> = 0.02..=10.0;
/// Longest deadline, s.
const LONGEST_DEADLINE: f64 = 1e7;

/// Target of a goal.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Target {
    /// Reach a pose.
    Pose(GoalPoint),
    /// Pass through waypoints in order.
    Waypoints(Vec<GoalPoint>),
    /// Run the request's tree.
    Tree,
}

/// The target of a well-formed request.
///
/// # Errors
/// [`Refusal::BadRequest`] with what was expected, [`Refusal::NotFound`] for an unknown place, [`Refusal::Busy`] for one that may still be
/// announced.
pub(crate) fn target(request: &GoalRequest, ctx: &Context) -> Result<Target, Refusal> {
    check_fields(request)?;
    let point = request.x.is_some() || request.y.is_some();
    let kinds = [point, request.place.is_some(), !request.waypoints.is_empty()];
    let kinds = kinds.iter().filter(|kind| **kind).count();
    if kinds > 1 || (kinds == 0 && request.tree.is_none()) {
        return bad("expected exactly one of `x` and `y`, `place`, `waypoints`, or a `tree`, alone or for one of them");
    }
    if request.yaw.is_some() && !point && request.place.is_none() {
        return bad("`yaw` goes with `x` and `y` or with `place`");
    }
    if let Some(tree) = &request.tree {
        trees::build(tree).or_else(|errors| bad(errors.to_string()))?;
        if kinds == 0 {
            return Ok(Target::Tree);
        }
    }
    if let Some(name) = &request.place {
        let place = place(name, ctx)?;
        let yaw = request.yaw.or(place.yaw);
        return checked_point(GoalPoint { yaw, ..place }, "place").map(Target::Pose);
    }
    if !request.waypoints.is_empty() {
        for (index, waypoint) in request.waypoints.iter().enumerate() {
            checked_point(*waypoint, &format!("waypoints[{index}]"))?;
        }
        return Ok(Target::Waypoints(request.waypoints.clone()));
    }
    match (request.x, request.y) {
        (Some(x), Some(y)) => checked_point(GoalPoint { x, y, yaw: request.yaw }, "goal").map(Target::Pose),
        _ => bad("`x` and `y` go together"),
    }
}

fn bad<T>(reason: impl Into<String>) -> Result<T, Refusal> {
    Err(Refusal::BadRequest { reason: reason.into() })
}

/// Checks each field by itself.
fn check_fields(request: &GoalRequest) -> Result<(), Refusal> {
    if let Some(id) = &request.id
        && let Err(error) = Id::new(id.clone())
    {
        return bad(format!("`id`: {error}"));
    }
    if let Some(tolerance) = request
        .tolerance
        .filter(|tolerance| !GOAL_TOLERANCE.contains(tolerance))
    {
        return bad(format!(
            "`tolerance` is {tolerance}: expected {} to {} m",
            GOAL_TOLERANCE.start(),
            GOAL_TOLERANCE.end()
        ));
    }
    let is_deadline = |secs: &f64| *secs > 0.0 && *secs <= LONGEST_DEADLINE;
    if let Some(secs) = request.deadline_secs.filter(|secs| !is_deadline(secs)) {
        return bad(format!(
            "`deadline_secs` is {secs}: expected more than 0 and at most {LONGEST_DEADLINE} s"
        ));
    }
    let is_name = |name: &String| !name.is_empty() && name.len() <= MAX_NAME;
    if request.blackboard.len() > MAX_ENTRIES || !request.blackboard.keys().all(is_name) {
        return bad(format!(
            "`blackboard`: expected at most {MAX_ENTRIES} entries with names of 1 to {MAX_NAME} bytes"
        ));
    }
    let is_flat = |value: &serde_json::Value| is_nested_within(value, MOST_NESTED);
    if let Some((name, _)) = request.blackboard.iter().find(|(_, value)| !is_flat(value)) {
        return bad(format!(
            "`blackboard.{name}`: expected arrays and objects at most {MOST_NESTED} deep inside one another"
        ));
    }
    let (given, most) = (request.waypoints.len(), GoalRequest::MAX_WAYPOINTS);
    if given > most {
        return bad(format!("`waypoints`: {given} given, expected at most {most}"));
    }
    Ok(())
}

/// A named place of the map.
fn place(name: &str, ctx: &Context) -> Result<GoalPoint, Refusal> {
    let places = &ctx.config.places;
    if let Some(place) = places.get(name) {
        return Ok(*place);
    }
    if ctx.may_learn_places() {
        return Err(Refusal::Busy {
            reason: "the places of the map have not come yet".to_owned(),
        });
    }
    let name: String = name.chars().take(80).collect();
    let known: Vec<&str> = places.keys().take(20).map(String::as_str).collect();
    Err(Refusal::NotFound {
        what: match known.is_empty() {
            true => format!("place `{name}`; the map has no named places"),
            false => format!("place `{name}`; there are {}", known.join(", ")),
        },
    })
}

fn checked_point(point: GoalPoint, name: &str) -> Result<GoalPoint, Refusal> {
    point.checked().or_else(|why| bad(format!("{name}: {why}")))
}

/// Whether the robot can reach the target on the known map, or a place within the tolerance (m) of the pose; unknown space and space taken
/// by transient obstacles count as reachable.
///
/// # Errors
/// [`Refusal::Rejected`] for a goal outside the map, in an obstacle or unreachable, with the nearest reachable place.
pub(crate) fn reachable(target: &Target, tolerance: f64, ctx: &mut Context) -> Result<(), Refusal> {
    let (points, enough) = match target {
        Target::Pose(point) => (vec![*point], NEARBY * tolerance),
        Target::Waypoints(points) => (points.clone(), 0.0),
        Target::Tree => (Vec::new(), 0.0),
    };
    let Some(model) = ctx.robot.model().cloned() else {
        return Ok(());
    };
    let Some(spec) = ctx.map.spec() else { return Ok(()) };
    let explore = ctx.config.settings.explore;
    let growing = ctx.config.settings.unknown_is_free && ctx.map.info().is_some_and(|info| !info.stored);
    let position = ctx.robot.pose().map(|pose| pose.position());
    let near = |point: &Point2<f64>| growing && spec.distance(*point) <= explore;
    let places: Vec<Point2<f64>> = points.iter().map(GoalPoint::position).collect();
    let extent = if ctx.config.settings.unknown_is_free {
        Extent::of(&model.footprint, places.iter().copied().filter(near).collect())
    } else {
        Extent::default()
    };
    let Some((space, known)) = ctx.map.space_reaching(&model.footprint, &extent) else {
        return Ok(());
    };
    let small = space.spec().len() <= MAX_FLOODED;
    let from = position.filter(|_| small);
    let reached = from.and_then(|position| reach::flood(&space, position));
    // Whether the robot fits there, and whether it can get there.
    let admits = |space: &ConfigurationSpace, reached: &Option<BitGrid>, point: Point2<f64>| {
        let is_connected = |reached: &BitGrid| reach::is_reached(space, reached, point);
        let fits = space.clearance(point) > space.radius();
        (fits, reached.as_ref().is_none_or(is_connected))
    };
    // The map without its transient obstacles, computed on demand.
    let mut later: Option<(ConfigurationSpace, Option<BitGrid>)> = None;
    for goal in points {
        let point = goal.position();
        let outside = spec.cell_at(point).is_none() && !near(&point);
        let (fits, connected) = admits(&space, &reached, point);
        if !outside && fits && connected {
            continue;
        }
        let zone = ctx.config.zones.keep_out(point);
        if !outside && zone.is_none() && small && ctx.config.settings.patience > 0.0 {
            let (space, reached) = later.get_or_insert_with(|| {
                let near: Vec<Point2<f64>> = position.into_iter().chain(places.iter().copied()).collect();
                let cells = ctx.map.transient(&near).into_iter().map(|cell| cell.center);
                let space = ctx
                    .map
                    .space_without(&known, &model.footprint, &cells.collect::<Vec<_>>());
                let reached = from.and_then(|position| reach::flood(&space, position));
                (space, reached)
            });
            if admits(space, reached, point) == (true, true) {
                continue;
            }
        }
        let seen_free = |cell| {
            known
                .grid()
                .get(cell)
                .is_some_and(|value| Occupancy::of(*value) == Occupancy::Free)
        };
        let nearest = match &reached {
            Some(reached) => reach::nearest(&space, reached, point, seen_free),
            None => space.nearest_free(point),
        };
        if nearest.is_some_and(|free| (free - point).norm() <= enough) {
            continue;
        }
        let what = if let Some(zone) = zone {
            &format!("is in a keep-out zone: {zone}")
        } else if outside {
            "is outside the map"
        } else if fits {
            "cannot be reached: obstacles on the map separate it from the robot"
        } else {
            "is occupied: the footprint does not fit"
        };
        // If the robot itself does not fit where it stands, its reachable space is unknown.
        let told = nearest.filter(|_| reached.is_some() || from.is_none());
        return Err(rejected(goal, what, told));
    }
    Ok(())
}

/// The rejection of a goal, with the nearest place that can be reached, map frame, if it is known.
fn rejected(goal: GoalPoint, what: &str, nearest: Option<Point2<f64>>) -> Refusal {
    Refusal::Rejected {
        reason: format!("({:.2}, {:.2}) {what}", goal.x, goal.y),
        nearest_free: nearest.map(|free| GoalPoint {
            yaw: goal.yaw,
            ..GoalPoint::at(free.x, free.y)
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::MissionConfig;
    use crate::records::Restored;
    use zenav_protocol::geometry::Pose2;

    #[test]
    fn a_goal_is_a_place_or_a_point_but_not_both() {
        let mut config = MissionConfig::new(Id::robot("tiago").unwrap(), "mission-1", "unused.redb".into());
        let sink = GoalPoint::from(Pose2::new(2.0, 1.5, 0.0));
        config.places.insert("sink".into(), sink);
        let ctx = Context::new(config, &Restored::fresh());
        let to_sink = GoalRequest {
            place: Some("sink".into()),
            ..GoalRequest::default()
        };
        assert_eq!(target(&to_sink, &ctx).unwrap(), Target::Pose(sink));
        let both = GoalRequest {
            x: Some(1.0),
            y: Some(1.0),
            ..to_sink
        };
        assert!(matches!(target(&both, &ctx), Err(Refusal::BadRequest { .. })));
    }
}

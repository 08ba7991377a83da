//! ValidatePath, IsGoalNearby, TruncatePath, TruncatePathLocal, GetPoseFromPath, ConcatenatePaths, IsWithinPathTrackingBounds: queries
//! about a path, and operations on it.

use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::GoalPoint;

use super::path::{self, DrivenPath, Nearest};
use super::ports::{OLD_FRAME, flag, goal_on, goal_text, ground, path_on, robot_pose, settled_path, write};
use super::{SyncLeaf, fail, step};
use crate::context::Context;
use crate::motion::{Recheck, recheck};
use crate::route::RouteData;
use zenav_behaviour_tree::nav2::off_path;
use zenav_behaviour_tree::{LeafIo, Status, Value};

/// Spacing of the points checked along a path, m.
const SPACING: f64 = 0.05;
/// Most points checked.
const MOST: usize = 20_000;
/// Most collisions reported.
const TOLD: usize = 100;

/// Position of the robot on a path. With a bound, the search continues from the last position found, so that it does not jump where a path
/// passes near itself. Without one, that position only tells apart the stretches between changes of direction.
#[derive(Default)]
struct Pursuit {
    sequence: Option<u64>,
    along: f64,
}

impl Pursuit {
    fn find(&mut self, sequence: u64, data: &RouteData, here: Pose2, reach: f64) -> Option<Nearest> {
        // Also after a restart the previous position is unknown.
        let known = self.sequence.replace(sequence);
        let driven = if known == Some(sequence) {
            self.along
        } else {
            data.driven
        };
        let is_bounded = known.is_some() && reach.is_finite() && reach > 0.0;
        let (from, to) = if is_bounded {
            (driven, driven + reach)
        } else {
            (0.0, f64::INFINITY)
        };
        let found = data.driven().nearest(here.position(), from, to, driven);
        self.along = found.map_or(0.0, |near| near.along);
        found
    }
}

/// SUCCESS if the rest of `path` is shorter than `proximity_threshold`.
#[derive(Default)]
pub struct IsGoalNearby(Pursuit);

impl SyncLeaf for IsGoalNearby {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let data = settled_path(io, ctx, "path")?;
        let (threshold, reach) = (
            io.number_or("proximity_threshold", 1.0)?,
            io.number_or("max_robot_pose_search_dist", -1.0)?,
        );
        let found = self.0.find(io.sequence("path"), &data, robot_pose(ctx)?, reach);
        let is_near = |near: Nearest| path::length(&data.points) - near.along < threshold;
        Ok(Status::from_truth(found.is_some_and(is_near)))
    }
}

/// Cuts `input_path` to these lengths before and behind the robot; -1 keeps all.
#[derive(Default)]
pub struct TruncatePathLocal(Pursuit);

impl SyncLeaf for TruncatePathLocal {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let data = settled_path(io, ctx, "input_path")?;
        if data.points.is_empty() {
            return write(io, "output_path", data.value());
        }
        let (forward, backward) = (
            io.number_or("distance_forward", 8.0)?,
            io.number_or("distance_backward", 4.0)?,
        );
        let reach = io.number_or("max_robot_pose_search_dist", f64::INFINITY)?;
        let here = match io.value("pose").is_ok() {
            true => goal_on(io, ctx, "pose")?.pose(),
            false => robot_pose(ctx)?,
        };
        let near = self
            .0
            .find(io.sequence("input_path"), &data, here, reach)
            .ok_or("the robot is far from the path")?;
        let whole = path::length(&data.points);
        let from = if backward < 0.0 { 0.0 } else { near.along - backward };
        let to = if forward < 0.0 { whole } else { near.along + forward };
        let part = data.driven().part(from, to);
        let driven = near.along - from.max(0.0);
        // A path to the same goal is still the same route.
        let cut = if to >= whole {
            RouteData {
                length: path::length(&part.points),
                points: part.points,
                backwards: part.backwards,
                driven,
                ..data
            }
        } else {
            RouteData {
                frame: data.frame,
                driven,
                ..RouteData::of(part, None)
            }
        };
        write(io, "output_path", cut.value())
    }
}

/// Cuts `distance` off the end of `input_path`; at least its first point remains.
pub struct TruncatePath;

impl SyncLeaf for TruncatePath {
    fn answer(&mut self, io: &mut LeafIo<'_>, _: &mut Context) -> Result<Status, String> {
        let data = path_on(io, "input_path")?;
        let distance = io.number_or("distance", 1.0)?;
        let cut = if distance > 0.0 {
            let whole = path::length(&data.points);
            RouteData {
                frame: data.frame,
                driven: data.driven,
                ..RouteData::of(data.driven().part(0.0, whole - distance), None)
            }
        } else {
            data
        };
        write(io, "output_path", cut.value())
    }
}

/// The robot's pose at a corner of `path`, in the present frame of the map; a negative `index` counts from the end.
pub struct GetPoseFromPath;

impl SyncLeaf for GetPoseFromPath {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let data = settled_path(io, ctx, "path")?;
        let index: i64 = io.get_optional("index")?.unwrap_or(0);
        let count = data.points.len() as i64;
        let at = if index < 0 { count.saturating_add(index) } else { index };
        let place = usize::try_from(at)
            .ok()
            .and_then(|at| data.points.get(at).map(|point| (at, *point)));
        let (at, point) = place.ok_or_else(|| format!("no point {index} on a path of {count}"))?;
        let towards = data.points.get(at + 1).map(|next| (at, next - point));
        let from = at
            .checked_sub(1)
            .and_then(|leg| data.points.get(leg).map(|before| (leg, point - before)));
        let last = at + 1 == data.points.len();
        let heading = towards.or(from).map(|(leg, step)| {
            let ahead = if data.backwards.contains(&leg) { -step } else { step };
            ahead.y.atan2(ahead.x)
        });
        let pose = GoalPoint {
            yaw: if last { data.goal.yaw } else { heading },
            ..GoalPoint::at(point.x, point.y)
        };
        write(io, "pose", Ok(Value::text(goal_text(&pose))))
    }
}

/// Joins two paths, in the present frame of the map.
pub struct ConcatenatePaths;

impl SyncLeaf for ConcatenatePaths {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let (first, second) = (path_on(io, "input_path1"), path_on(io, "input_path2"));
        let parts: Option<Vec<RouteData>> = [first, second]
            .into_iter()
            .flatten()
            .filter(|part| !part.points.is_empty())
            .map(|part| part.settled(&ctx.frames))
            .collect();
        let parts = parts.ok_or(OLD_FRAME)?;
        let frame = parts.iter().find_map(|part| part.frame);
        let behind = parts.first().map_or(0.0, |part| part.driven);
        let yaw = parts.last().ok_or("both paths are empty")?.goal.yaw;
        let mut path = DrivenPath::default();
        let mut via = Vec::new();
        for part in parts {
            let driven = part.driven();
            for (point, is_backwards) in driven.corners() {
                if path.points.last() != Some(&point) {
                    path.push(point, is_backwards);
                }
            }
            via.extend(part.via);
            via.push(part.goal);
        }
        via.pop();
        let joined = RouteData {
            via,
            frame,
            driven: behind,
            ..RouteData::of(path, yaw)
        };
        write(io, "output_path", joined.value())
    }
}

/// SUCCESS if the robot can still drive `path`: checked along its motion if it has one, otherwise with the disc inscribed in the footprint.
pub struct ValidatePath;

impl SyncLeaf for ValidatePath {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let data = settled_path(io, ctx, "path")?;
        let pose = robot_pose(ctx)?;
        let Some((model, space)) = ground(ctx) else {
            return Ok(step(io, ctx, "waiting for the robot and its map"));
        };
        if data.points.is_empty() {
            return Err("the path is empty".to_owned());
        }
        let ahead = io.number_or("max_lookahead_distance", -1.0)?;
        let unknown_too = flag(io, "consider_unknown_as_obstacle", false);
        let all = !flag(io, "stop_at_first_collision", true);
        let points = match path::nearest(&data.points, pose.position(), 0.0, f64::INFINITY) {
            Some(near) if ahead > 0.0 => path::part(&data.points, near.along, near.along + ahead),
            _ => data.points,
        };
        let route = ctx
            .route(data.route)
            .filter(|route| !route.plan.trajectory.is_empty() && ahead <= 0.0);
        let radius = model.footprint.inscribed_radius() - 0.5 * space.spec().resolution;
        let mut collisions: Vec<[f64; 2]> = Vec::new();
        for pair in path::spaced(&points, SPACING, MOST).windows(2) {
            let [(a, _), (b, _)] = pair else { continue };
            let hits = route.is_none() && !space.segment_is_free(*a, *b, radius);
            if hits || (unknown_too && ctx.map.occupancy(*b) == Some(Occupancy::Unknown)) {
                collisions.push([b.x, b.y]);
                if !all || collisions.len() == TOLD {
                    break;
                }
            }
        }
        if let Some(route) = route {
            let trajectory = &route.plan.trajectory;
            let from = trajectory.nearest_ahead(0.0, pose.position(), f64::INFINITY).t;
            if let Recheck::Blocked(ahead) = recheck(trajectory, &space, from, ctx.config.settings.escape) {
                let at = trajectory.sample(from + ahead);
                collisions.push([at.x, at.y]);
            }
        }
        let told = Value::data(&collisions).map_err(|error| error.to_string());
        write(io, "collision_poses", told)?;
        match collisions.first() {
            None => Ok(Status::Success),
            Some([x, y]) => {
                io.say(format!("blocked at ({x:.2}, {y:.2})"));
                Ok(Status::Failure)
            }
        }
    }
}

/// SUCCESS while FollowPath's tracking feedback is within bounds, or missing.
pub struct IsWithinPathTrackingBounds;

impl SyncLeaf for IsWithinPathTrackingBounds {
    fn answer(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Result<Status, String> {
        let Some(error) = off_path(io)? else {
            return Ok(Status::Success);
        };
        Ok(fail(io, ctx, None, format!("{error:.2} m beside the path")))
    }
}

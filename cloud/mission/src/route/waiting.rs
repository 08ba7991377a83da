//! Waiting. Which transient obstacle blocks the way, how long has it stood there, and what does the robot do meanwhile?

use nalgebra::Point2;
use zenav_protocol::geometry::wrap_angle;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::{BehaviourAction, BehaviourRequest, Blockage};
use zenav_protocol::time::Stamp;

use crate::context::Context;
use crate::frames::moved_points;
use crate::leaves::path;
use crate::transient::TransientCell;

/// Margin inside the edge of its view within which a lidar sees the obstacle, rad; least time between turns of the robot towards it, s.
const VIEW: (f64, f64) = (0.3, 10.0);
/// An obstacle that bumped the robot within this time, s, and has leaned on it for this long, s, is made room for: with this clearance, m,
/// found within this radius, m.
const BUMPED: f64 = 60.0;
const LEANS: f64 = 6.0;
const ROOM: (f64, f64) = (0.3, 2.0);
/// Distance beyond the circumscribed disc at which an obstacle may touch a robot, m: a few cells.
const BESIDE: f64 = 0.08;
/// Distance within which cells that block the way belong to one obstacle, m.
pub(super) const ONE_THING: f64 = 0.8;
/// A blockage this near to the previous one is the same, m …
pub(super) const SAME_PLACE: f64 = 1.0;
/// … unless the wait for it ended more than this long ago, s.
const FORGOTTEN: f64 = 10.0;

/// The obstacle that a search waits for, or drives round.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Waiting {
    pub(super) blockage: Blockage,
    /// Its cells, map frame, m.
    pub(super) cells: Vec<Point2<f64>>,
    /// The path that it blocks.
    pub(super) way: Vec<Point2<f64>>,
    /// Distance beyond which it cannot be identified, m.
    pub(super) told_within: f64,
    /// Whether a moving robot chose to wait although there is a way round: it stops at a distance.
    pub(super) keeps_off: bool,
    /// How many of its cells were occupied at the last path request.
    occupied: usize,
}

/// Time for which the robot has had an obstacle in sight that was out of sight before: only that counts as waiting for it. It goes on
/// counting after the obstacle was out of sight again, also in another search.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct InSight {
    blockage: Blockage,
    pub(super) secs: f64,
    /// Up to when it is counted.
    at: Stamp,
}

impl InSight {
    /// The time by now of an obstacle that is hidden, or in sight; `None` if it was never hidden.
    pub(super) fn of(blockage: Blockage, before: Option<Self>, is_hidden: bool, now: Stamp) -> Option<Self> {
        // What came after that is another obstacle.
        let goes_on = |before: &Self| is_same(before.blockage, blockage) && blockage.since <= before.at;
        let before = before.filter(goes_on);
        if before.is_none() && !is_hidden {
            return None;
        }
        let counted = before.map_or(0.0, |before| before.secs);
        let more = before
            .filter(|_| !is_hidden)
            .map_or(0.0, |before| now.secs_since(before.at));
        Some(Self {
            blockage,
            secs: counted + more,
            at: now,
        })
    }
}

/// Whether two blockages are so near to each other that they are one.
fn is_same(one: Blockage, other: Blockage) -> bool {
    (one.position() - other.position()).norm() <= SAME_PLACE
}

impl Waiting {
    /// The first obstacle on a path that exists only without these cells, for a robot that touches everything nearer to its centre than
    /// `radius`, m.
    pub(super) fn on(path: &[Point2<f64>], cells: &[TransientCell], radius: f64, now: Stamp) -> Option<Self> {
        let touched = cells.iter().filter_map(|cell| {
            let near = path::nearest(path, cell.center, 0.0, f64::INFINITY)?;
            (near.distance <= radius).then_some((near.along, cell))
        });
        let touched: Vec<(f64, &TransientCell)> = touched.collect();
        let (_, first) = touched.iter().min_by(|a, b| a.0.total_cmp(&b.0))?;
        let thing = touched
            .iter()
            .filter(|(_, cell)| (cell.center - first.center).norm() <= ONE_THING);
        let thing: Vec<&TransientCell> = thing.map(|(_, cell)| *cell).collect();
        let sum = thing
            .iter()
            .fold([0.0; 2], |[x, y], cell| [x + cell.center.x, y + cell.center.y]);
        let [x, y] = sum.map(|sum| sum / thing.len() as f64);
        // Its cells become occupied one after the other: the median gives the time.
        let mut since: Vec<Stamp> = thing.iter().filter_map(|cell| cell.since).collect();
        since.sort_unstable();
        let since = since.get(since.len() / 2).copied().unwrap_or(now);
        Some(Self {
            blockage: Blockage { x, y, since },
            cells: thing.iter().map(|cell| cell.center).collect(),
            way: path.to_vec(),
            told_within: f64::INFINITY,
            keeps_off: false,
            occupied: thing.len(),
        })
    }

    /// Records that the robot waits for this obstacle. If it was waited for or driven round before, it keeps its first time.
    pub(super) fn note(&mut self, ctx: &mut Context) {
        self.blockage.since = ctx.map.notice(&self.cells, self.blockage.since);
        let waited = ctx
            .goal
            .waited
            .filter(|(_, last)| ctx.now.secs_since(*last) <= FORGOTTEN);
        let avoided = ctx.goal.avoided.as_ref().filter(|avoided| avoided.count(ctx) > 0);
        let before = [
            waited.map(|(before, _)| before),
            avoided.map(|avoided| avoided.blockage),
        ];
        for before in before.into_iter().flatten() {
            self.keep_first_time(before);
        }
        ctx.goal.waited = Some((self.blockage, ctx.now));
    }

    fn keep_first_time(&mut self, before: Blockage) {
        if is_same(before, self.blockage) {
            self.blockage.since = self.blockage.since.min(before.since);
        }
    }

    /// What bars the same path now; the part of the obstacle that is left keeps its first time.
    pub(super) fn now(&self, ctx: &Context) -> Option<Self> {
        let cells = ctx.map.transient(&[self.blockage.position()]);
        let mut now = Self::on(&self.way, &cells, reach(ctx), ctx.now)?;
        if self.count(ctx) > 0 {
            now.keep_first_time(self.blockage);
        }
        Some(now)
    }

    /// The same in the present frame of the map: it moves with the robot's surroundings. `None` if its frame is too old.
    pub(crate) fn settle(self, from: u64, ctx: &Context) -> Option<Self> {
        let moved = ctx.frames.robot(from)?;
        let place = moved.transform_point(self.blockage.position());
        let mut settled = Self {
            blockage: Blockage {
                x: place.x,
                y: place.y,
                ..self.blockage
            },
            cells: moved_points(&self.cells, moved),
            way: moved_points(&self.way, moved),
            ..self
        };
        settled.asked(ctx);
        Some(settled)
    }

    /// How long the obstacle has been there, s.
    pub(super) fn stood(&self, now: Stamp) -> f64 {
        now.secs_since(self.blockage.since).max(0.0)
    }

    /// Whether part of it has left since the last path request.
    pub(super) fn gives_way(&self, ctx: &Context) -> bool {
        self.count(ctx) < self.occupied
    }

    /// Records the cells occupied at a path request.
    pub(super) fn asked(&mut self, ctx: &Context) {
        self.occupied = self.count(ctx);
    }

    fn count(&self, ctx: &Context) -> usize {
        self.standing(ctx).count()
    }

    /// Its cells that are still occupied.
    pub(super) fn standing(&self, ctx: &Context) -> impl Iterator<Item = &Point2<f64>> {
        let stands = |cell: &&Point2<f64>| ctx.map.occupancy(**cell) == Some(Occupancy::Occupied);
        self.cells.iter().filter(stands)
    }

    /// Moves the robot aside if it is in contact with another robot that has leaned on it for a while: that robot waits for this one, too.
    /// Returns whether it did.
    pub(super) fn make_room(&self, ctx: &mut Context) -> bool {
        let (Some(pose), Some(model)) = (ctx.robot.pose(), ctx.robot.model()) else {
            return false;
        };
        let base_from_map = pose.inverse();
        let leans = |cell: &Point2<f64>| model.footprint.distance(base_from_map.transform_point(*cell)) <= BESIDE;
        if !ctx.robot.was_bumped_within(ctx.now, BUMPED) || !self.cells.iter().any(leans) {
            ctx.goal.leaned_on = None;
            return false;
        }
        let since = *ctx.goal.leaned_on.get_or_insert(ctx.now);
        let (clearance, within) = ROOM;
        let drives =
            ctx.now.secs_since(since) >= LEANS && ask_behaviour(ctx, BehaviourAction::ToFree { clearance, within });
        if drives {
            ctx.goal.leaned_on = Some(ctx.now);
        }
        drives
    }

    /// Description of the wait.
    pub(super) fn said(&self, now: Stamp) -> String {
        let Blockage { x, y, .. } = self.blockage;
        format!(
            "waits for what has stood at ({x:.2}, {y:.2}) for {:.0} s and may leave",
            self.stood(now).floor()
        )
    }

    /// Why the wait was given up.
    pub(super) fn given_up(&self, now: Stamp) -> String {
        let Blockage { x, y, .. } = self.blockage;
        format!(
            "something that may leave has stood at ({x:.2}, {y:.2}) for {:.0} s",
            self.stood(now)
        )
    }
}

/// Distance from the robot's centre within which an obstacle may touch it, m.
pub(super) fn reach(ctx: &Context) -> f64 {
    let model = ctx.robot.model();
    model.map_or(0.0, |model| model.footprint.circumscribed_radius()) + BESIDE
}

/// Turns a robot at rest towards a place outside the view of all its lidars: an obstacle that leaves there would stay in the map.
pub(crate) fn look_at(ctx: &mut Context, place: Point2<f64>) {
    let looked = ctx.goal.looked.is_some_and(|at| ctx.now.secs_since(at) < VIEW.1);
    let (Some(pose), Some(model)) = (ctx.robot.pose(), ctx.robot.model()) else {
        return;
    };
    let bearing = wrap_angle((place.y - pose.y).atan2(place.x - pose.x) - pose.yaw);
    let is_seen = model
        .all_lidars()
        .any(|(_, lidar)| wrap_angle(bearing - lidar.mount.yaw).abs() <= 0.5 * lidar.field_of_view - VIEW.0);
    if !looked && !is_seen && ask_behaviour(ctx, BehaviourAction::Spin { angle: bearing }) {
        ctx.goal.looked = Some(ctx.now);
    }
}

/// Requests a maneuver of a robot at rest, if allowed. Its completion shows in the robot's pose.
fn ask_behaviour(ctx: &mut Context, action: BehaviourAction) -> bool {
    let Some(epoch) = ctx.lease.epoch() else {
        return false;
    };
    if !ctx.robot.is_at_rest() || ctx.obstacle_to_driving().is_some() {
        return false;
    }
    let request = BehaviourRequest {
        id: ctx.execution_id(),
        action,
        epoch: Some(epoch),
    };
    let ticket = ctx.ask_maneuver(request);
    ctx.asks.forget(ticket);
    true
}

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::id::Id;
    use zenav_protocol::messages::{MapFrame, MapPatch, MapRef, TILE, Tile};

    use super::*;
    use crate::{MissionConfig, Restored};

    #[test]
    fn what_the_robot_drives_round_moves_with_the_map() {
        let config = MissionConfig::new(Id::robot("tiago").unwrap(), "m", "unused".into());
        let mut ctx = Context::new(config, &Restored::fresh());
        let map = |frame| MapRef {
            id: "m".into(),
            revision: frame + 1,
            frame,
        };
        let settle = |ctx: &mut Context, frame: u64, moves: Vec<Pose2>| {
            let patch = MapPatch {
                stamp: Stamp(frame + 1),
                map: map(frame),
                base_revision: frame,
                spec: zenav_fixtures::spec(TILE, TILE, 0.05),
                tiles: vec![Tile {
                    x: 0,
                    y: 0,
                    values: vec![Occupancy::OCCUPIED; (TILE * TILE) as usize],
                }],
            };
            ctx.map.observe(Stamp(frame + 1), None, &[patch]);
            ctx.frames.observe(MapFrame {
                map: map(frame),
                moves,
                ..MapFrame::default()
            });
            ctx.settle();
        };
        settle(&mut ctx, 0, Vec::new());
        let cell = TransientCell {
            center: Point2::new(1.0, 0.5),
            since: Some(Stamp(1)),
        };
        let way = [(0.0, 0.5), (2.0, 0.5)].map(|(x, y)| Point2::new(x, y));
        ctx.goal.avoided = Waiting::on(&way, &[cell], 0.3, Stamp(1));
        settle(&mut ctx, 1, vec![Pose2::new(0.0, 1.0, 0.0)]);
        let avoided = ctx.goal.avoided.as_ref().unwrap();
        let Blockage { x, y, since } = avoided.blockage;
        assert!((x - 1.0).hypot(y - 1.5) < 1e-9 && since == Stamp(1), "{avoided:?}");
        assert!(!avoided.gives_way(&ctx) && (avoided.way[1].y - 1.5).abs() < 1e-9);
    }

    #[test]
    fn the_wait_for_an_obstacle_that_was_lost_from_sight_goes_on_where_it_was() {
        let wall = |x: f64| Blockage {
            x,
            y: 2.0,
            since: Stamp::ZERO,
        };
        let at = Stamp::from_secs;
        assert_eq!(InSight::of(wall(6.5), None, false, at(5.0)), None, "always in sight");
        // Driven to from 5 s to 10 s, seen until 90 s, out of sight until 100 s, and seen again.
        let mut seen = None;
        let looks = [
            (5.0, true, 0.0),
            (10.0, true, 0.0),
            (90.0, false, 80.0),
            (100.0, true, 80.0),
            (140.0, false, 120.0),
        ];
        for (secs, is_hidden, counted) in looks {
            seen = InSight::of(wall(6.5 + 0.001 * secs), seen, is_hidden, at(secs));
            assert!((seen.unwrap().secs - counted).abs() < 1e-6, "{seen:?} at {secs} s");
        }
        let came_later = Blockage {
            since: at(145.0),
            ..wall(6.5)
        };
        for other in [wall(0.0), came_later] {
            let other = InSight::of(other, seen, true, at(150.0)).unwrap();
            assert!(other.secs.abs() < 1e-9, "another obstacle begins anew: {other:?}");
        }
    }
}

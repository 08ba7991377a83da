//! Wall distance control. Where is the wall beside the robot, which obstacle is in the way, and how is the distance kept?
//!
//! In the base frame, mirrored if needed so that the wall lies on the left: only one side has to be handled. The distance is that to the
//! nearest point of the walls within 60 degrees of abeam. On a straight wall that is its foot; past an outer corner it is the corner
//! itself, and keeping the distance leads around it on an arc.

use nalgebra::{Point2, Vector2};
use zenav_protocol::wall_following::WallFollowing;

use super::line::Wall;

/// Walls this far fore or aft of abeam are not beside: the tangent of 60 degrees.
const FORE_AND_AFT: f64 = 1.732;
/// A wall that is left behind or lies ahead counts as this many times farther.
const PASSING: f64 = 1.5;

/// The nearest point of the wall.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beside {
    /// The wall that it belongs to.
    pub wall: Wall,
    /// Distance to it, m.
    pub distance: f64,
    /// Direction to it.
    pub towards: Vector2<f64>,
    /// Whether the wall ends there: an outer corner.
    pub ends: bool,
    /// Whether the wall comes nearer still fore or aft of abeam: it is left behind or lies ahead.
    pub passes: bool,
}

impl Beside {
    /// The nearest wall on the left; a wall that comes nearer still fore or aft ranks behind one that is not much farther.
    #[must_use]
    pub fn of(walls: impl Iterator<Item = Wall>) -> Option<Self> {
        walls.filter_map(Self::on).min_by(|a, b| a.rank().total_cmp(&b.rank()))
    }

    fn rank(&self) -> f64 {
        self.distance * if self.passes { PASSING } else { 1.0 }
    }

    fn on(wall: Wall) -> Option<Self> {
        let along = wall.to - wall.from;
        // The part of the wall with |x| <= tan(60°) y, as shares of its length.
        let (mut low, mut high) = (0.0_f64, 1.0_f64);
        for sign in [1.0, -1.0] {
            let off = |point: Vector2<f64>| sign * point.x - FORE_AND_AFT * point.y;
            let (at, slope) = (off(wall.from.coords), off(along));
            if slope > 0.0 {
                high = high.min(-at / slope);
            } else if slope < 0.0 {
                low = low.max(-at / slope);
            } else if at > 0.0 {
                return None;
            }
        }
        if low > high {
            return None;
        }
        let foot = -wall.from.coords.dot(&along) / along.norm_squared();
        let share = foot.clamp(low, high);
        let point = wall.from + along * share;
        let distance = point.coords.norm();
        Some(Self {
            wall,
            distance,
            towards: point.coords.try_normalize(1e-6)?,
            ends: (share <= 0.0 || share >= 1.0) && foot != share,
            passes: foot.clamp(0.0, 1.0) != share,
        })
    }

    /// The distance to keep so that the robot also clears obstacles that stand out of the wall in the cone ahead; `body` is half the
    /// robot's width.
    #[must_use]
    pub fn wanted(&self, settings: &WallFollowing, body: f64, points: impl Iterator<Item = Point2<f64>>) -> f64 {
        let target = settings.target_distance;
        // An obstacle so far from the wall that the robot fits between is not in the way.
        let passable = target + body;
        let height = points
            .filter(|point| {
                let range = point.coords.norm();
                range <= settings.cone_reach && point.y.abs() <= range * settings.cone_angle.sin() && point.x > 0.0
            })
            .map(|point| self.distance - point.coords.dot(&self.towards))
            .filter(|height| *height > settings.wall_roughness && *height < passable)
            .fold(0.0, f64::max);
        if target + height <= settings.widest_distance {
            target + height
        } else {
            target
        }
    }
}

/// PID on the distance from the offset line: P and I on the distance, D on its rate, which follows from speed and heading.
#[derive(Clone, Debug, Default)]
pub struct DistanceController {
    sum: f64,
}

impl DistanceController {
    /// The yaw rate (left is positive) that keeps `wanted` m from a wall on the left at speed `v`.
    pub fn steer(&mut self, beside: &Beside, wanted: f64, v: f64, settings: &WallFollowing, dt: f64) -> f64 {
        let error = beside.distance - wanted;
        let rate = -v * beside.towards.x;
        if error.abs() < settings.wall_i_within && !beside.ends {
            self.sum += error * dt;
        }
        if settings.wall_i > 0.0 {
            let most = settings.wall_i_most / settings.wall_i;
            self.sum = self.sum.clamp(-most, most);
        }
        // Bounds the heading: a large error must not turn the robot steeply towards or away from the wall.
        let bound = settings.wall_d * v * settings.wall_steepest;
        let proportional = (settings.wall_p * error).clamp(-bound, bound);
        let around = if beside.ends { v / beside.distance.max(0.1) } else { 0.0 };
        around + proportional + settings.wall_i * self.sum + settings.wall_d * rate
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    fn wall(from: (f64, f64), to: (f64, f64)) -> Wall {
        Wall {
            from: Point2::new(from.0, from.1),
            to: Point2::new(to.0, to.1),
        }
    }

    #[test]
    fn the_nearest_point_is_the_foot_and_past_the_end_the_corner() {
        let along = Beside::of([wall((2.0, 0.5), (-2.0, 0.5))].into_iter()).unwrap();
        assert_eq!((along.distance, along.ends), (0.5, false));
        let past = Beside::of([wall((-0.2, 0.5), (-2.0, 0.5))].into_iter()).unwrap();
        assert!(past.ends && (past.distance - 0.2_f64.hypot(0.5)).abs() < 1e-12);
        assert_eq!(
            Beside::of([wall((2.0, -0.5), (-2.0, -0.5))].into_iter()),
            None,
            "the right"
        );
        assert_eq!(Beside::of([wall((1.0, 0.2), (1.0, -2.0))].into_iter()), None, "ahead");
    }

    #[test]
    fn past_an_inner_corner_the_new_wall_counts_though_the_old_one_is_as_near() {
        let old = wall((-0.3, 0.5), (-0.3, -2.0));
        let new = wall((2.0, 0.5), (-0.3, 0.5));
        let beside = Beside::of([old, new].into_iter()).unwrap();
        assert_eq!((beside.wall, beside.distance, beside.passes), (new, 0.5, false));
        assert!(Beside::of([old].into_iter()).unwrap().passes);
    }

    #[test]
    fn an_obstacle_in_the_cone_widens_the_distance_and_one_that_is_too_large_does_not() {
        let settings = WallFollowing {
            target_distance: 0.4,
            widest_distance: 0.7,
            cone_reach: 1.0,
            ..WallFollowing::default()
        };
        let beside = Beside::of([wall((2.0, 0.4), (-2.0, 0.4))].into_iter()).unwrap();
        let wanted =
            |points: &[(f64, f64)]| beside.wanted(&settings, 0.2, points.iter().map(|(x, y)| Point2::new(*x, *y)));
        assert_eq!(wanted(&[(0.8, 0.4), (0.9, 0.38)]), 0.4, "the wall itself");
        assert!(
            (wanted(&[(0.8, 0.4), (0.8, 0.2)]) - 0.6).abs() < 1e-12,
            "0.2 m stand out"
        );
        assert_eq!(wanted(&[(1.2, 0.2)]), 0.4, "out of reach");
        assert_eq!(wanted(&[(0.8, 0.4), (0.8, 0.1), (0.8, -0.1)]), 0.4, "a corner");
    }

    #[test]
    fn too_far_turns_towards_the_wall_and_too_near_away_but_never_steeply() {
        let settings = WallFollowing::default();
        let steer = |distance: f64| {
            let beside = Beside::of([wall((2.0, distance), (-2.0, distance))].into_iter()).unwrap();
            DistanceController::default().steer(&beside, 0.5, 0.2, &settings, 0.02)
        };
        assert!(steer(0.6) > 0.1 && steer(0.4) < -0.1);
        assert!(steer(3.0) <= settings.wall_d * 0.2 * settings.wall_steepest + 1e-9);
    }
}

//! Score. The distance error of a robot: its true distance from the nearest solid, minus the target.

use nalgebra::{Point2, Vector2};
use serde::Serialize;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;
use zenav_sim::World;

/// A wall counts as straight if it is straight for this far to both sides of the robot, m.
const STRAIGHT: f64 = 0.6;
/// Places checked on each side for that.
const LOOKS: u32 = 4;
/// Largest deviation of a straight wall's distance from its parallel, m.
const EVEN: f64 = 2e-3;
/// Evaluation starts once the distance error is below this, m.
const SETTLED: f64 = 0.05;
/// Step of the numerical gradient of the distance, m.
const STEP: f64 = 1e-4;

/// Distance from a point to the nearest static solid, m.
#[must_use]
pub fn distance(world: &World, at: Point2<f64>) -> f64 {
    world.clearance(&Footprint::Radius(0.0), Pose2::new(at.x, at.y, 0.0))
}

/// Whether the nearest wall is straight around a point: its parallel at the target distance keeps exactly that distance from everything,
/// for 0.6 m to both sides.
#[must_use]
pub fn is_beside_straight_wall(world: &World, at: Point2<f64>, target: f64) -> bool {
    let here = distance(world, at);
    let slope = |off: Vector2<f64>| distance(world, at + off) - distance(world, at - off);
    let away = Vector2::new(slope(Vector2::x() * STEP), slope(Vector2::y() * STEP));
    let Some(away) = away.try_normalize(1e-9) else {
        return false;
    };
    let abeam = at + away * (target - here);
    let along = Vector2::new(-away.y, away.x);
    (1..=LOOKS)
        .flat_map(|look| [1.0, -1.0].map(|sign| sign * f64::from(look)))
        .all(|look| {
            let place = abeam + along * (look * STRAIGHT / f64::from(LOOKS));
            (distance(world, place) - target).abs() < EVEN
        })
}

/// Distance errors of a run, from the first time near the target distance on: before that the robot is still approaching the wall.
#[derive(Clone, Debug, Default)]
pub struct Errors {
    settled: bool,
    straight: Vec<f64>,
    all: Vec<f64>,
}

/// How well a robot kept its distance.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Kept {
    /// 95th percentile of the absolute error on straight walls, m.
    pub straight_p95_m: f64,
    /// Largest error on straight walls, m.
    pub straight_max_m: f64,
    /// Mean error on straight walls, outwards positive, m.
    pub straight_mean_m: f64,
    /// Samples on straight walls.
    pub straight_samples: usize,
    /// Root mean square of the error along all walls and corners, m.
    pub rms_m: f64,
    /// Samples along all walls and corners.
    pub samples: usize,
}

impl Errors {
    /// Adds a true position at which the robot followed a wall.
    pub fn sample(&mut self, world: &World, at: Point2<f64>, target: f64) {
        let error = distance(world, at) - target;
        self.settled |= error.abs() < SETTLED;
        if !self.settled {
            return;
        }
        self.all.push(error);
        if is_beside_straight_wall(world, at, target) {
            self.straight.push(error);
        }
    }

    /// The figures.
    #[must_use]
    pub fn kept(&self) -> Kept {
        let mut sizes: Vec<f64> = self.straight.iter().map(|error| error.abs()).collect();
        sizes.sort_by(f64::total_cmp);
        let rank = (0.95 * sizes.len() as f64).ceil() as usize;
        let mean = |sum: f64, count: usize| if count == 0 { 0.0 } else { sum / count as f64 };
        Kept {
            straight_p95_m: sizes.get(rank.saturating_sub(1)).copied().unwrap_or(0.0),
            straight_max_m: sizes.last().copied().unwrap_or(0.0),
            straight_mean_m: mean(self.straight.iter().sum(), self.straight.len()),
            straight_samples: self.straight.len(),
            rms_m: mean(self.all.iter().map(|error| error * error).sum(), self.all.len()).sqrt(),
            samples: self.all.len(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn room() -> World {
        let text = "size = [10, 10]\norigin = [-5, -5]\n[[wall]]\nfrom = [-4, 0]\nto = [4, 0]\nthickness = 0.2\n\
                    [[circle]]\nx = 0\ny = 3\nradius = 1\n";
        World::from_toml(text, "room.toml", &|_| Err(String::new())).unwrap()
    }

    #[test]
    fn a_wall_is_straight_away_from_its_ends_and_a_pillar_nowhere() {
        let room = room();
        let straight = |x: f64, y: f64| is_beside_straight_wall(&room, Point2::new(x, y), 0.4);
        assert!(straight(-2.0, -0.45) && straight(2.0, 0.6));
        assert!(!straight(3.8, -0.5), "near the end");
        assert!(!straight(1.4, 3.0), "beside the pillar");
    }

    #[test]
    fn errors_are_told_with_their_sign_and_straight_ones_apart() {
        let room = room();
        let mut errors = Errors::default();
        for (x, y) in [(-2.0, -0.6), (-2.0, -0.5), (-2.0, -0.52), (4.4, 0.0)] {
            errors.sample(&room, Point2::new(x, y), 0.4);
        }
        let kept = errors.kept();
        assert_eq!((kept.samples, kept.straight_samples), (3, 2));
        assert!((kept.straight_mean_m - 0.01).abs() < 1e-9 && (kept.straight_p95_m - 0.02).abs() < 1e-9);
    }
}

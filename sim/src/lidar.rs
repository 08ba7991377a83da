//! What does a planar lidar measure? A whole sweep at once by an angular z-buffer.
//!
//! Instead of casting a ray a beam, each edge is drawn over the beams that it covers, and a buffer keeps the nearest:
//! the cost is what is seen, not beams times solids. The buffer holds *inverse* ranges, because along an edge the
//! inverse range is linear in the beam's direction: one beam costs two products, a sum and a maximum, no division.
//! An approximate arc tangent finds the first and last beam of an edge, and exact cross products then decide, so that
//! two edges which share a corner leave no gap. Edges seen from inside the solid are skipped (back faces).
//!
//! Source of the idea: z-buffering, Catmull 1974, on the circle of directions. Equal to parry's ray cast beam by beam.

use std::f64::consts::{FRAC_PI_2, PI, TAU};

use nalgebra::{Point2, Vector2};
use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::LidarModel;

use crate::crowd::Crowd;
use crate::scene::Scene;
use crate::sensors::stepped;
use crate::shape::{Disc, Edge, cross};

/// Largest error of [`turn`], rad (Abramowitz and Stegun 4.4.49 promises 1e-5).
const TURN_ERROR: f64 = 2e-5;

/// The nearest solid in every beam of one lidar; reused from sweep to sweep.
#[derive(Clone, Debug)]
pub struct AngularBuffer {
    angle_min: f64,
    increment: f64,
    range_max: f64,
    /// Directions of the beams in the laser frame.
    laser_cos: Vec<f64>,
    laser_sin: Vec<f64>,
    /// The same in the world frame, for this sweep.
    cos: Vec<f64>,
    sin: Vec<f64>,
    /// One over the range to the nearest solid so far; zero is none.
    inverse: Vec<f64>,
    origin: Point2<f64>,
    yaw: f64,
}

impl AngularBuffer {
    /// A buffer for a lidar.
    #[must_use]
    pub fn new(model: &LidarModel) -> Self {
        let (laser_sin, laser_cos): (Vec<f64>, Vec<f64>) = (0..model.beams)
            .map(|beam| (model.angle_min() + beam as f64 * model.angle_increment()).sin_cos())
            .unzip();
        Self {
            angle_min: model.angle_min(),
            increment: model.angle_increment(),
            range_max: model.range_max,
            cos: laser_cos.clone(),
            sin: laser_sin.clone(),
            inverse: vec![0.0; model.beams],
            laser_cos,
            laser_sin,
            origin: Point2::origin(),
            yaw: 0.0,
        }
    }

    /// Begins a sweep: nothing seen yet.
    pub fn begin(&mut self, map_from_laser: Pose2) {
        self.origin = map_from_laser.position();
        self.yaw = map_from_laser.yaw;
        let (sin, cos) = self.yaw.sin_cos();
        let world = self.cos.iter_mut().zip(&mut self.sin);
        for ((c, s), (laser_c, laser_s)) in world.zip(self.laser_cos.iter().zip(&self.laser_sin)) {
            *c = cos * laser_c - sin * laser_s;
            *s = sin * laser_c + cos * laser_s;
        }
        self.inverse.fill(0.0);
    }

    /// Draws what never moves, as far as the lidar sees.
    pub fn scene(&mut self, scene: &Scene) {
        scene.near(self.origin, self.range_max, |edges, discs| {
            for edge in edges {
                self.edge(edge);
            }
            for disc in discs {
                self.disc(disc);
            }
        });
    }

    /// Draws what moves, but for the robot that carries the lidar.
    pub fn crowd(&mut self, crowd: &Crowd, own: usize) {
        crowd.near(self.origin, self.range_max, |index, solid| {
            if index == own {
                return;
            }
            match solid.disc() {
                Some(disc) => self.disc(&disc),
                None => solid.edges().iter().for_each(|edge| self.edge(edge)),
            }
        });
    }

    /// Draws an edge, where the lidar is on its open side.
    pub fn edge(&mut self, edge: &Edge) {
        let (a, b) = (edge.a - self.origin, edge.b - self.origin);
        let facing = cross(b, a);
        // Not greater than zero: seen from inside the solid, or edge-on (then its neighbours stand before it).
        if facing <= 0.0 {
            return;
        }
        let start = turn(b);
        let mut span = turn(a) - start;
        if span < -PI {
            span += TAU;
        }
        let along = edge.b - edge.a;
        let (x, y) = (-along.y / facing, along.x / facing);
        // The beam lies between the corners: left of `b` and right of `a`, both included.
        let covers = |direction: Vector2<f64>| cross(b, direction) >= 0.0 && cross(direction, a) >= 0.0;
        self.draw(start, span.max(0.0), covers, |cos, sin| x * cos + y * sin);
    }

    /// Draws a disc, where the lidar is outside of it.
    pub fn disc(&mut self, disc: &Disc) {
        let center = disc.center - self.origin;
        let power = center.norm_squared() - disc.radius * disc.radius;
        if power <= 0.0 {
            return;
        }
        let half = turn(Vector2::new(power.sqrt(), disc.radius));
        let squared = disc.radius * disc.radius;
        let covers =
            |direction: Vector2<f64>| cross(direction, center).abs() <= disc.radius && direction.dot(&center) > 0.0;
        // The nearer root of |t d - c| = r is power / (c.d + sqrt(r² - (d x c)²)): its inverse needs no division.
        let over_power = 1.0 / power;
        self.draw(turn(center) - half, 2.0 * half, covers, |cos, sin| {
            let direction = Vector2::new(cos, sin);
            let aside = cross(direction, center);
            (direction.dot(&center) + (squared - aside * aside).max(0.0).sqrt()) * over_power
        });
    }

    /// Brings `inverse(cos, sin)` into every beam from direction `start` (rad, world) over `span` that `covers` admits.
    fn draw(
        &mut self,
        start: f64,
        span: f64,
        covers: impl Fn(Vector2<f64>) -> bool,
        inverse: impl Fn(f64, f64) -> f64,
    ) {
        let mut first = start - self.yaw - self.angle_min;
        first -= (first / TAU).floor() * TAU;
        let count = self.inverse.len();
        // What begins in this turn of the circle, and what reaches into it from the turn before.
        for first in [first, first - TAU] {
            let last = (first + span + TURN_ERROR) / self.increment;
            if last < 0.0 {
                continue;
            }
            // Float to integer casts saturate: the first beam is at least zero.
            let mut low = ((first - TURN_ERROR) / self.increment) as usize;
            let mut high = (last as usize + 2).min(count);
            while low < high && !covers(Vector2::new(self.cos[low], self.sin[low])) {
                low += 1;
            }
            while low < high && !covers(Vector2::new(self.cos[high - 1], self.sin[high - 1])) {
                high -= 1;
            }
            if low >= high {
                continue;
            }
            let directions = self.cos[low..high].iter().zip(&self.sin[low..high]);
            for (nearest, (cos, sin)) in self.inverse[low..high].iter_mut().zip(directions) {
                let candidate = inverse(*cos, *sin);
                *nearest = if candidate > *nearest { candidate } else { *nearest };
            }
        }
    }

    /// True range a beam, m; infinity where nothing stands.
    pub fn ranges(&self) -> impl Iterator<Item = f64> + '_ {
        self.inverse.iter().map(|inverse| 1.0 / inverse)
    }
}

/// What the lidar reports of true ranges: bias and noise added, rounded to its steps; outside its limits there is no return, and none
/// of beams that are lost.
pub fn measure(model: &LidarModel, truth: impl Iterator<Item = f64>, rng: &mut impl rand::Rng, ranges: &mut Vec<f32>) {
    ranges.clear();
    ranges.extend(truth.map(|range| {
        // Far beyond the limit no noise brings it back.
        if range > model.range_max + 8.0 * model.noise + model.bias.abs() {
            return f32::INFINITY;
        }
        let noise: f64 = if model.noise > 0.0 {
            StandardNormal.sample(rng)
        } else {
            0.0
        };
        if model.dropout > 0.0 && rng.random::<f64>() < model.dropout {
            return f32::INFINITY;
        }
        let range = stepped(range + model.bias + noise * model.noise, model.resolution) as f32;
        if (model.range_min..=model.range_max).contains(&f64::from(range)) {
            range
        } else {
            f32::INFINITY
        }
    }));
}

/// Direction of a vector, rad in (-pi, pi], within [`TURN_ERROR`]. Source: Abramowitz and Stegun 1964, 4.4.49.
fn turn(v: Vector2<f64>) -> f64 {
    let (x, y) = (v.x.abs(), v.y.abs());
    let (low, high) = if x < y { (x, y) } else { (y, x) };
    let t = low / high;
    let s = t * t;
    let mut angle = t * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    if x < y {
        angle = FRAC_PI_2 - angle;
    }
    if v.x < 0.0 {
        angle = PI - angle;
    }
    if v.y < 0.0 { -angle } else { angle }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;
    use crate::bridge;
    use crate::outline::outline;
    use crate::shape::edges;
    use parry2d_f64::math::Pose;
    use parry2d_f64::query::Ray;
    use parry2d_f64::shape::{Ball, Cuboid, Polyline, Shape};
    use proptest::prelude::*;
    use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};

    fn model(beams: usize, field_of_view: f64) -> LidarModel {
        LidarModel {
            mount: Pose2::IDENTITY,
            rate_hz: 10.0,
            range_min: 0.0,
            range_max: 30.0,
            beams,
            field_of_view,
            noise: 0.0,
            bias: 0.0,
            dropout: 0.0,
            resolution: 0.001,
            latency: 0.0,
        }
    }

    fn lidar() -> impl Strategy<Value = LidarModel> {
        (1..700_usize, prop_oneof![Just(TAU), 0.1..TAU]).prop_map(|(beams, view)| model(beams, view))
    }

    fn pose() -> impl Strategy<Value = Pose2> {
        (-5.0..5.0, -5.0..5.0, -PI..PI).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    /// A star-shaped, usually concave polygon, counter-clockwise.
    fn star() -> impl Strategy<Value = Vec<Point2<f64>>> {
        (-5.0..5.0, -5.0..5.0, prop::collection::vec(0.05..1.5, 3..9)).prop_map(
            |(x, y, radii): (f64, f64, Vec<f64>)| {
                let step = TAU / radii.len() as f64;
                radii
                    .iter()
                    .enumerate()
                    .map(|(i, r)| Point2::new(x + r * (i as f64 * step).cos(), y + r * (i as f64 * step).sin()))
                    .collect()
            },
        )
    }

    /// Every beam equals the nearest of parry's ray casts against these shapes.
    fn agree(
        model: &LidarModel,
        laser: Pose2,
        scene: &Scene,
        shapes: &[(Pose, Box<dyn Shape>)],
    ) -> Result<(), TestCaseError> {
        let mut buffer = AngularBuffer::new(model);
        buffer.begin(laser);
        buffer.scene(scene);
        for (beam, range) in buffer.ranges().enumerate() {
            let direction = laser.yaw + model.angle_min() + beam as f64 * model.angle_increment();
            let ray = Ray::new(
                bridge::vector(laser.position()),
                bridge::vector(Point2::new(direction.cos(), direction.sin())),
            );
            let cast = shapes
                .iter()
                .filter_map(|(pose, shape)| shape.cast_ray(pose, &ray, model.range_max, false))
                .fold(f64::INFINITY, f64::min);
            let range = if range <= model.range_max { range } else { f64::INFINITY };
            prop_assert!(
                range == cast || (range - cast).abs() < 1e-6,
                "beam {beam}: {range} instead of {cast}"
            );
        }
        Ok(())
    }

    proptest! {
        #[test]
        fn every_beam_equals_parrys_ray_cast_among_polygons_and_discs(model in lidar(), laser in pose(), stars in prop::collection::vec(star(), 0..12), discs in prop::collection::vec((-5.0..5.0, -5.0..5.0, 0.05..1.0), 0..8)) {
            let discs: Vec<Disc> = discs.into_iter().map(|(x, y, radius)| Disc { center: Point2::new(x, y), radius }).collect();
            prop_assume!(!stars.iter().any(|star| crate::shape::contains(star, laser.position())));
            prop_assume!(!discs.iter().any(|disc| (disc.center - laser.position()).norm() < disc.radius));
            let mut shapes: Vec<(Pose, Box<dyn Shape>)> = Vec::new();
            for star in &stars {
                let corners: Vec<_> = star.iter().chain(star.first()).map(|p| bridge::vector(*p)).collect();
                shapes.push((Pose::identity(), Box::new(Polyline::new(corners, None))));
            }
            for disc in &discs {
                shapes.push((Pose::new(bridge::vector(disc.center), 0.0), Box::new(Ball::new(disc.radius))));
            }
            let scene = Scene::new(stars.iter().flat_map(|star| edges(star)).collect(), discs);
            agree(&model, laser, &scene, &shapes)?;
        }

        #[test]
        fn every_beam_equals_parrys_ray_cast_among_the_cells_of_a_map(model in lidar(), laser in pose(), seed in prop::collection::vec(0..100_u8, 20 * 20)) {
            let spec = GridSpec { origin: Point2::new(-5.0, -5.0), resolution: 0.5, width: 20, height: 20 };
            let map = OccupancyGrid::from_values(spec, seed.iter().map(|value| if *value < 15 { Occupancy::OCCUPIED } else { Occupancy::FREE }).collect()).unwrap();
            prop_assume!(map.at(laser.position()) != Some(&Occupancy::OCCUPIED));
            let cells: Vec<Cell> = (0..spec.len()).map(|i| spec.cell(i)).filter(|cell| map[*cell] == Occupancy::OCCUPIED).collect();
            let shapes: Vec<(Pose, Box<dyn Shape>)> = cells.iter().map(|cell| {
                let shape: Box<dyn Shape> = Box::new(Cuboid::new(bridge::vector(Point2::new(0.25, 0.25))));
                (Pose::new(bridge::vector(spec.center(*cell)), 0.0), shape)
            }).collect();
            agree(&model, laser, &Scene::new(outline(&map), Vec::new()), &shapes)?;
        }

        #[test]
        fn the_approximate_angle_is_within_its_promise(angle in -PI..PI, length in 1e-3..1e3) {
            prop_assert!((turn(Vector2::new(angle.cos(), angle.sin()) * length) - angle).abs() < TURN_ERROR);
        }

        #[test]
        fn no_beam_slips_between_two_edges_that_share_a_corner(laser in pose(), corners in 3..40_usize, turned in 0.0..TAU) {
            // A ring around the lidar, with a corner exactly in the direction of beams wherever counts divide.
            let step = TAU / corners as f64;
            let ring: Vec<_> = (0..corners).rev().map(|i| (turned + i as f64 * step).sin_cos()).map(|(s, c)| laser.position() + Vector2::new(c, s) * 20.0).collect();
            let mut buffer = AngularBuffer::new(&model(360, TAU));
            buffer.begin(laser);
            edges(&ring).for_each(|edge| buffer.edge(&edge));
            prop_assert!(buffer.ranges().all(|range| range < 20.1), "{:?}", buffer.ranges().collect::<Vec<_>>());
        }
    }

    #[test]
    fn a_reading_is_rounded_to_millimetres_and_bounded_by_the_limits() {
        let model = LidarModel {
            range_min: 0.1,
            range_max: 5.0,
            ..model(1, 1.0)
        };
        let mut ranges = Vec::new();
        let mut rng = rand_pcg::Pcg64Mcg::new(1);
        measure(
            &model,
            [1.234_56, 0.05, 5.01, f64::INFINITY].into_iter(),
            &mut rng,
            &mut ranges,
        );
        assert_eq!(ranges, [1.235, f32::INFINITY, f32::INFINITY, f32::INFINITY]);
    }
}

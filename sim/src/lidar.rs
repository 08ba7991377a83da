//! What does a planar lidar measure? A whole sweep at once by an angular z-buffer.
//!
//! Instead of casting a ray a beam, each edge is drawn over the beams that it covers, and a buffer keeps the nearest:
//! the cost is what is seen, not beams times solids. The buffer holds *inverse* ranges, because along an edge the
//! inverse range is linear in the beam's direction: one beam costs two products, a sum and a maximum, no division.
//! An approximate arc tangent finds the first and last beam of an edge, and exact cross products then decide, so that
//! two edges which share a corner leave no gap. Edges seen from inside the solid are skipped (back faces).
//!
//! Edges come front to back from a tree of boxes. A box is left out when every beam that may meet it has already met something nearer:
//! the farthest range of each block of beams is kept for that, so that rooms behind a wall cost nothing.
//!
//! Sources of the ideas: z-buffering, Catmull 1974, and its hierarchical form, Greene, Kass and Miller 1993, on the circle of directions.
//! Equal to parry's ray cast beam by beam.

use std::f64::consts::{PI, TAU};

use nalgebra::{Point2, Vector2};
use rand::RngExt as _;
use rand_distr::{Distribution, StandardNormal};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::robot::LidarModel;

use crate::boxes::{Bounded, BoxTree, Met};
use crate::crowd::Crowd;
use crate::scene::Scene;
use crate::sensors::stepped;
use crate::shape::{Disc, Edge, cross};

/// Largest error of [`turn`], rad (Abramowitz and Stegun 4.4.49 promises 1e-5).
const TURN_ERROR: f64 = 2e-5;

/// Edges whose directions are found together.
const LANES: usize = 8;

/// Beams whose farthest range is kept together.
const BLOCK: usize = 16;

/// The nearest solid in every beam of one lidar; reused from sweep to sweep.
#[derive(Clone, Debug)]
pub struct AngularBuffer {
    angle_min: f64,
    /// Beams a radian.
    per_radian: f64,
    range_max: f64,
    /// Directions of the beams in the laser frame.
    laser_cos: Vec<f64>,
    laser_sin: Vec<f64>,
    /// The same in the world frame, for this sweep.
    cos: Vec<f64>,
    sin: Vec<f64>,
    /// One over the range to the nearest solid so far; zero is none.
    inverse: Vec<f64>,
    /// The least of `inverse` in each block of beams, where it is not stale.
    farthest: Vec<f64>,
    stale: Vec<bool>,
    origin: Point2<f64>,
    /// Direction of the first beam in the world, rad in (-pi, pi].
    first: f64,
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
            per_radian: 1.0 / model.angle_increment(),
            range_max: model.range_max,
            cos: laser_cos.clone(),
            sin: laser_sin.clone(),
            inverse: vec![0.0; model.beams],
            farthest: vec![0.0; model.beams.div_ceil(BLOCK)],
            stale: vec![false; model.beams.div_ceil(BLOCK)],
            laser_cos,
            laser_sin,
            origin: Point2::origin(),
            first: model.angle_min(),
        }
    }

    /// Begins a sweep: nothing seen yet.
    pub fn begin(&mut self, map_from_laser: Pose2) {
        self.origin = map_from_laser.position();
        self.first = wrap_angle(map_from_laser.yaw + self.angle_min);
        let (sin, cos) = map_from_laser.yaw.sin_cos();
        let world = self.cos.iter_mut().zip(&mut self.sin);
        for ((c, s), (laser_c, laser_s)) in world.zip(self.laser_cos.iter().zip(&self.laser_sin)) {
            *c = cos * laser_c - sin * laser_s;
            *s = sin * laser_c + cos * laser_s;
        }
        self.inverse.fill(0.0);
        self.farthest.fill(0.0);
        self.stale.fill(false);
    }

    /// Draws what never moves, as far as the lidar sees.
    pub fn scene(&mut self, scene: &Scene) {
        self.tree(scene.edges(), Self::edges);
        self.tree(scene.discs(), |buffer, discs| {
            discs.iter().for_each(|disc| buffer.disc(disc))
        });
    }

    fn tree<T: Bounded>(&mut self, tree: &BoxTree<T>, draw: impl Fn(&mut Self, &[T])) {
        let limit = self.range_max * self.range_max;
        tree.walk(self.origin, |met| match met {
            // To find a leaf hidden costs about as much as to draw it.
            Met::Box {
                squared, leaf: true, ..
            } => squared <= limit,
            Met::Box { low, high, squared, .. } => squared <= limit && !self.hides(low, high, squared),
            Met::Things(things) => {
                draw(self, things);
                false
            }
        });
    }

    /// Whether nothing in a box can be seen: it lies behind what was drawn, or outside the field of view.
    fn hides(&mut self, low: Point2<f64>, high: Point2<f64>, squared: f64) -> bool {
        if squared <= 0.0 {
            return false;
        }
        let (low, high) = (low - self.origin, high - self.origin);
        // The two corners that bound the box as seen from here, clockwise one first.
        let (right, left) = match (low.x > 0.0, high.x < 0.0, low.y > 0.0, high.y < 0.0) {
            (true, _, true, _) => ([high.x, low.y], [low.x, high.y]),
            (true, _, _, true) => ([low.x, low.y], [high.x, high.y]),
            (true, _, _, _) => ([low.x, low.y], [low.x, high.y]),
            (_, true, true, _) => ([high.x, high.y], [low.x, low.y]),
            (_, true, _, true) => ([low.x, high.y], [high.x, low.y]),
            (_, true, _, _) => ([high.x, high.y], [high.x, low.y]),
            (_, _, true, _) => ([high.x, low.y], [low.x, low.y]),
            _ => ([low.x, high.y], [high.x, high.y]),
        };
        let start = direction(right.into());
        let mut span = direction(left.into()) - start;
        if span < 0.0 {
            span += TAU;
        }
        // What begins in this turn of the circle, and what reaches into it from the turn before.
        let from = self.turned(start);
        self.all_nearer(from, span, squared) && self.all_nearer(from - TAU, span, squared)
    }

    /// Whether every beam in a range has met something nearer than a squared distance, m².
    fn all_nearer(&mut self, from: f64, span: f64, squared: f64) -> bool {
        let (low, high) = self.beams(from, span);
        let mut block = low / BLOCK;
        while block * BLOCK < high {
            if self.stale[block] {
                let end = ((block + 1) * BLOCK).min(self.inverse.len());
                let mut least = f64::INFINITY;
                for inverse in &self.inverse[block * BLOCK..end] {
                    least = if *inverse < least { *inverse } else { least };
                }
                (self.farthest[block], self.stale[block]) = (least, false);
            }
            if self.farthest[block] * self.farthest[block] * squared < 1.0 {
                return false;
            }
            block += 1;
        }
        true
    }

    /// Angle from the first beam to a direction (rad in [-pi, pi], world), rad in [0, 2 pi).
    #[inline]
    fn turned(&self, start: f64) -> f64 {
        let turned = start - self.first;
        if turned < 0.0 {
            turned + TAU
        } else if turned >= TAU {
            turned - TAU
        } else {
            turned
        }
    }

    /// Beams from an angle after the first one (rad) over `span`, and a few more: the first, and the one after the last.
    #[inline]
    fn beams(&self, from: f64, span: f64) -> (usize, usize) {
        let last = (from + span + TURN_ERROR) * self.per_radian;
        if last < 0.0 {
            return (0, 0);
        }
        // Float to integer casts saturate: the first beam is at least zero.
        let low = ((from - TURN_ERROR) * self.per_radian) as usize;
        (low, (last as usize + 2).min(self.inverse.len()))
    }

    /// Draws what moves, but for the robot that carries the lidar.
    pub fn crowd(&mut self, crowd: &Crowd, own: usize) {
        crowd.near(self.origin, self.range_max, |index, solid| {
            if index == own {
                return;
            }
            match solid.disc() {
                Some(disc) => self.disc(&disc),
                None => self.edges(solid.edges()),
            }
        });
    }

    /// Draws edges, where the lidar is on their open side.
    pub fn edges(&mut self, edges: &[Edge]) {
        let mut facing = Facing::default();
        for edge in edges {
            let (a, b) = (edge.a - self.origin, edge.b - self.origin);
            // Not greater than zero: seen from inside the solid, or edge-on (then its neighbours stand before it).
            if cross(b, a) > 0.0 {
                facing.push(a, b);
                if facing.count == LANES {
                    self.draw_edges(&mut facing);
                }
            }
        }
        self.draw_edges(&mut facing);
    }

    fn draw_edges(&mut self, facing: &mut Facing) {
        // Directions of a few edges in one go: loops without branches become vector instructions.
        let (ends, starts) = (turns(&facing.ax, &facing.ay), turns(&facing.bx, &facing.by));
        let count = std::mem::take(&mut facing.count);
        for (((a, b), start), end) in facing.corners.iter().zip(starts).zip(ends).take(count) {
            self.edge(*a, *b, f64::from(start), f64::from(end));
        }
    }

    /// Draws an edge between corners in directions `end` and `start`, rad.
    fn edge(&mut self, a: Vector2<f64>, b: Vector2<f64>, start: f64, end: f64) {
        let mut span = end - start;
        if span < -PI {
            span += TAU;
        }
        let over = 1.0 / cross(b, a);
        let (x, y) = ((a.y - b.y) * over, (b.x - a.x) * over);
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
        let half = direction(Vector2::new(power.sqrt(), disc.radius));
        let squared = disc.radius * disc.radius;
        let covers =
            |direction: Vector2<f64>| cross(direction, center).abs() <= disc.radius && direction.dot(&center) > 0.0;
        // The nearer root of |t d - c| = r is power / (c.d + sqrt(r² - (d x c)²)): its inverse needs no division.
        let over_power = 1.0 / power;
        let mut start = direction(center) - half;
        if start < -PI {
            start += TAU;
        }
        self.draw(start, 2.0 * half, covers, |cos, sin| {
            let direction = Vector2::new(cos, sin);
            let aside = cross(direction, center);
            (direction.dot(&center) + (squared - aside * aside).max(0.0).sqrt()) * over_power
        });
    }

    /// Brings `inverse(cos, sin)` into every beam from direction `start` (rad in [-pi, pi], world) over `span` that `covers` admits.
    fn draw(
        &mut self,
        start: f64,
        span: f64,
        covers: impl Fn(Vector2<f64>) -> bool,
        inverse: impl Fn(f64, f64) -> f64,
    ) {
        // What begins in this turn of the circle, and what reaches into it from the turn before.
        let from = self.turned(start);
        self.draw_beams(from, span, &covers, &inverse);
        if from + span + TURN_ERROR >= TAU {
            self.draw_beams(from - TAU, span, &covers, &inverse);
        }
    }

    #[inline]
    fn draw_beams(
        &mut self,
        from: f64,
        span: f64,
        covers: &impl Fn(Vector2<f64>) -> bool,
        inverse: &impl Fn(f64, f64) -> f64,
    ) {
        let (mut low, mut high) = self.beams(from, span);
        while low < high && !covers(Vector2::new(self.cos[low], self.sin[low])) {
            low += 1;
        }
        while low < high && !covers(Vector2::new(self.cos[high - 1], self.sin[high - 1])) {
            high -= 1;
        }
        if low >= high {
            return;
        }
        let directions = self.cos[low..high].iter().zip(&self.sin[low..high]);
        for (nearest, (cos, sin)) in self.inverse[low..high].iter_mut().zip(directions) {
            let candidate = inverse(*cos, *sin);
            *nearest = if candidate > *nearest { candidate } else { *nearest };
        }
        for stale in &mut self.stale[low / BLOCK..=(high - 1) / BLOCK] {
            *stale = true;
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

/// Edges that face the lidar, their corners as seen from it.
#[derive(Default)]
struct Facing {
    corners: [(Vector2<f64>, Vector2<f64>); LANES],
    ax: [f32; LANES],
    ay: [f32; LANES],
    bx: [f32; LANES],
    by: [f32; LANES],
    count: usize,
}

impl Facing {
    fn push(&mut self, a: Vector2<f64>, b: Vector2<f64>) {
        let lane = self.count;
        self.corners[lane] = (a, b);
        (self.ax[lane], self.ay[lane]) = (a.x as f32, a.y as f32);
        (self.bx[lane], self.by[lane]) = (b.x as f32, b.y as f32);
        self.count += 1;
    }
}

/// Direction of a vector, rad in (-pi, pi], within [`TURN_ERROR`].
fn direction(v: Vector2<f64>) -> f64 {
    f64::from(turn(v.x as f32, v.y as f32))
}

/// Directions of several vectors.
fn turns(x: &[f32; LANES], y: &[f32; LANES]) -> [f32; LANES] {
    let mut angles = [0.0; LANES];
    for ((angle, x), y) in angles.iter_mut().zip(x).zip(y) {
        *angle = turn(*x, *y);
    }
    angles
}

/// Direction of a vector, rad in (-pi, pi], within [`TURN_ERROR`]. Source: Abramowitz and Stegun 1964, 4.4.49.
///
/// Selections instead of branches, so that several are computed at once.
#[allow(clippy::inline_always, reason = "inside a loop it becomes vector instructions")]
#[inline(always)]
fn turn(x: f32, y: f32) -> f32 {
    use std::f32::consts::{FRAC_PI_2, PI};
    let (across, up) = (x.abs(), y.abs());
    let (low, high) = if across < up { (across, up) } else { (up, across) };
    let t = low / high;
    let s = t * t;
    let angle = t * (0.999_866 + s * (-0.330_299_5 + s * (0.180_141 + s * (-0.085_133 + s * 0.020_835_1))));
    let angle = if across < up { FRAC_PI_2 - angle } else { angle };
    let angle = if x < 0.0 { PI - angle } else { angle };
    angle.copysign(y)
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
            prop_assert!((direction(Vector2::new(angle.cos(), angle.sin()) * length) - angle).abs() < TURN_ERROR);
        }

        #[test]
        fn no_beam_slips_between_two_edges_that_share_a_corner(laser in pose(), corners in 3..40_usize, turned in 0.0..TAU) {
            // A ring around the lidar, with a corner exactly in the direction of beams wherever counts divide.
            let step = TAU / corners as f64;
            let ring: Vec<_> = (0..corners).rev().map(|i| (turned + i as f64 * step).sin_cos()).map(|(s, c)| laser.position() + Vector2::new(c, s) * 20.0).collect();
            let mut buffer = AngularBuffer::new(&model(360, TAU));
            buffer.begin(laser);
            buffer.edges(&edges(&ring).collect::<Vec<_>>());
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

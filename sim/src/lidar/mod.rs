//! Angular z-buffer. The range to the nearest solid in each beam of a lidar, for a whole sweep at once.
//!
//! Instead of casting a ray per beam, each edge is drawn over the beams that it covers, and a buffer keeps the nearest: the cost depends
//! on what is seen, not on beams times solids. The buffer holds *inverse* ranges, because along an edge the inverse range is linear in
//! the beam's direction: one beam costs two products, a sum and a maximum, no division. An approximate arc tangent finds the first and
//! last beam of an edge, and exact cross products then decide, so that two edges which share a corner leave no gap. Edges seen from
//! inside the solid are skipped (back faces).
//!
//! Edges come front to back from a tree of boxes. A box is skipped if every beam that may meet it has already met something nearer
//! (`hidden`), so that rooms behind a wall cost nothing.
//!
//! Sources of the ideas: z-buffering, Catmull 1974, and its hierarchical form, Greene, Kass and Miller 1993, on the circle of directions.
//! Equal to parry's ray cast beam by beam, and 7 to 26 times as fast (`cargo bench -p zenav-sim --bench lidar`).

mod angle;
mod hidden;
#[cfg(test)]
mod tests;

use std::f64::consts::{PI, TAU};
use std::ops::Range;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::sensors::LidarModel;

use crate::crowd::Crowd;
use crate::scene::Scene;
use crate::shape::{Disc, Edge, cross};
use angle::{TURN_ERROR, direction, turns};

/// Number of edges whose directions are computed together.
const LANES: usize = 8;

/// The nearest solid in every beam of one lidar; reused from sweep to sweep.
///
/// ```
/// # let lidar = zenav_fixtures::robot("tiago").lidar.unwrap();
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::Pose2;
/// use zenav_sim::{lidar::AngularBuffer, shape::Disc};
///
/// let mut buffer = AngularBuffer::new(&lidar);
/// buffer.begin(Pose2::new(1.0, 0.0, 0.0));
/// buffer.disc(&Disc { center: Point2::new(3.0, 0.0), radius: 0.5 });
/// let ranges: Vec<f64> = buffer.ranges().collect();
/// assert!((ranges[lidar.beams / 2] - 1.5).abs() < 1e-6);
/// assert_eq!(ranges[0], f64::INFINITY, "the first beam meets nothing");
/// ```
#[derive(Clone, Debug)]
pub struct AngularBuffer {
    angle_min: f64,
    /// Beams per radian.
    per_radian: f64,
    range_max: f64,
    /// Directions of the beams in the laser frame.
    laser_cos: Vec<f64>,
    laser_sin: Vec<f64>,
    /// The same in the world frame, for this sweep.
    cos: Vec<f64>,
    sin: Vec<f64>,
    /// Inverse of the range to the nearest solid so far; zero means none.
    inverse: Vec<f64>,
    origin: Point2<f64>,
    /// Direction of the first beam in the world, rad in (-pi, pi].
    first: f64,
    facing: Facing,
}

impl AngularBuffer {
    /// A buffer for a lidar.
    #[must_use]
    pub fn new(model: &LidarModel) -> Self {
        Self::of_beams(model, 0..model.beams)
    }

    /// A buffer for some of a lidar's beams.
    #[must_use]
    pub fn of_beams(model: &LidarModel, beams: Range<usize>) -> Self {
        let angle = |beam: usize| model.angle_min() + beam as f64 * model.angle_increment();
        let angle_min = angle(beams.start);
        let (laser_sin, laser_cos): (Vec<f64>, Vec<f64>) = beams.map(|beam| angle(beam).sin_cos()).unzip();
        Self {
            angle_min,
            per_radian: 1.0 / model.angle_increment(),
            range_max: model.range_max,
            cos: laser_cos.clone(),
            sin: laser_sin.clone(),
            inverse: vec![0.0; laser_cos.len()],
            laser_cos,
            laser_sin,
            origin: Point2::origin(),
            first: angle_min,
            facing: Facing::NONE,
        }
    }

    /// Begins a sweep: all beams are empty.
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
    }

    /// Draws the static scene, as far as the lidar sees.
    pub fn scene(&mut self, scene: &Scene) {
        scene.edges().walk(self.origin, self);
        self.draw_gathered();
        scene.discs().walk(self.origin, self);
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

    /// Range of beams over `span` from an angle after the first one (rad), including those that may be just outside: the first, and the
    /// one after the last.
    #[inline]
    fn beams(&self, from: f64, span: f64) -> (usize, usize) {
        let last = (from + span + TURN_ERROR) * self.per_radian;
        if last < 0.0 {
            return (0, 0);
        }
        let first = (from - TURN_ERROR) * self.per_radian;
        // Casts from float to integer saturate: the first beam is at least zero.
        let whole = first as usize;
        let low = whole + usize::from((whole as f64) < first);
        (low, (last as usize + 1).min(self.inverse.len()))
    }

    /// Draws everything that moves, except the robot that carries the lidar.
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

    /// Draws edges that turn their open side to the lidar.
    pub fn edges(&mut self, edges: &[Edge]) {
        self.gather(edges);
        self.draw_gathered();
    }

    /// Collects the edges that face the lidar; draws them once there are enough.
    fn gather(&mut self, edges: &[Edge]) {
        for edge in edges {
            let (a, b) = (edge.a - self.origin, edge.b - self.origin);
            // Not positive: seen from inside the solid, or edge-on (then its neighbours are in front of it).
            self.facing.push(a, b, cross(b, a) > 0.0);
            if self.facing.count == LANES {
                self.draw_gathered();
            }
        }
    }

    fn draw_gathered(&mut self) {
        // Directions of several edges at once: loops without branches become vector instructions.
        let facing = &mut self.facing;
        let (ends, starts) = (turns(&facing.ax, &facing.ay), turns(&facing.bx, &facing.by));
        let (corners, count) = (facing.corners, std::mem::take(&mut facing.count));
        for (((a, b), start), end) in corners.iter().zip(starts).zip(ends).take(count) {
            self.edge(*a, *b, f64::from(start), f64::from(end));
        }
    }

    /// Draws an edge between corners in directions `end` and `start`, rad.
    #[inline]
    fn edge(&mut self, a: Vector2<f64>, b: Vector2<f64>, start: f64, end: f64) {
        let mut span = end - start;
        if span < -PI {
            span += TAU;
        }
        // The beam lies between the corners: left of `b` and right of `a`, both included.
        let covers = |direction: Vector2<f64>| cross(b, direction) >= 0.0 && cross(direction, a) >= 0.0;
        self.draw(start, span.max(0.0), covers, || {
            let over = 1.0 / cross(b, a);
            let (x, y) = ((a.y - b.y) * over, (b.x - a.x) * over);
            move |cos, sin| x * cos + y * sin
        });
    }

    /// Draws a disc, if the lidar is outside it.
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
        self.draw(start, 2.0 * half, covers, || {
            move |cos, sin| {
                let direction = Vector2::new(cos, sin);
                let aside = cross(direction, center);
                (direction.dot(&center) + (squared - aside * aside).max(0.0).sqrt()) * over_power
            }
        });
    }

    /// Draws the inverse range by direction (cosine, sine) into every beam from direction `start` (rad in [-pi, pi], world) over `span`
    /// that `covers` admits; `prepare` is called only if there is such a beam.
    #[inline]
    fn draw<I: Fn(f64, f64) -> f64>(
        &mut self,
        start: f64,
        span: f64,
        covers: impl Fn(Vector2<f64>) -> bool,
        prepare: impl Fn() -> I,
    ) {
        // The part that begins in this turn of the circle, and the part that reaches into it from the turn before.
        let from = self.turned(start);
        self.draw_beams(from, span, &covers, &prepare);
        if from + span + TURN_ERROR >= TAU {
            self.draw_beams(from - TAU, span, &covers, &prepare);
        }
    }

    #[inline]
    fn draw_beams<I: Fn(f64, f64) -> f64>(
        &mut self,
        from: f64,
        span: f64,
        covers: &impl Fn(Vector2<f64>) -> bool,
        prepare: &impl Fn() -> I,
    ) {
        let (mut low, mut high) = self.beams(from, span);
        // Only beams that are too close to an end for the approximate angle are tested exactly.
        let (surely, surely_not) = (
            (from + TURN_ERROR) * self.per_radian,
            (from + span - TURN_ERROR) * self.per_radian,
        );
        while low < high && (low as f64) < surely && !covers(Vector2::new(self.cos[low], self.sin[low])) {
            low += 1;
        }
        while low < high
            && (high as f64 - 1.0) > surely_not
            && !covers(Vector2::new(self.cos[high - 1], self.sin[high - 1]))
        {
            high -= 1;
        }
        if low >= high {
            return;
        }
        let inverse = prepare();
        let directions = self.cos[low..high].iter().zip(&self.sin[low..high]);
        for (nearest, (cos, sin)) in self.inverse[low..high].iter_mut().zip(directions) {
            let candidate = inverse(*cos, *sin);
            *nearest = if candidate > *nearest { candidate } else { *nearest };
        }
    }

    /// True range per beam, m; infinite if nothing is hit.
    pub fn ranges(&self) -> impl Iterator<Item = f64> + '_ {
        self.inverse.iter().map(|inverse| 1.0 / inverse)
    }
}

/// Edges that face the lidar, their corners as seen from it.
#[derive(Clone, Debug)]
struct Facing {
    corners: [(Vector2<f64>, Vector2<f64>); LANES],
    ax: [f32; LANES],
    ay: [f32; LANES],
    bx: [f32; LANES],
    by: [f32; LANES],
    count: usize,
}

impl Facing {
    const NONE: Self = Self {
        corners: [(Vector2::new(0.0, 0.0), Vector2::new(0.0, 0.0)); LANES],
        ax: [1.0; LANES],
        ay: [0.0; LANES],
        bx: [1.0; LANES],
        by: [0.0; LANES],
        count: 0,
    };

    /// Adds an edge; one that is not `kept` is overwritten by the next, which avoids an unpredictable branch.
    fn push(&mut self, a: Vector2<f64>, b: Vector2<f64>, kept: bool) {
        let lane = self.count;
        self.corners[lane] = (a, b);
        (self.ax[lane], self.ay[lane]) = (a.x as f32, a.y as f32);
        (self.bx[lane], self.by[lane]) = (b.x as f32, b.y as f32);
        self.count += usize::from(kept);
    }
}

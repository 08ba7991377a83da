//! Where are the moving obstacles? They walk their route at constant speed, and wait where a robot stands in their way.
//! A walker with [`Manners`] leaves the straight line to make way for robots and other movers, and goes on to its next place from there.
//!
//! A mover keeps its orientation. A path leads from its last point back to the first: two points make it go to and fro; it may rest at
//! each. A walker goes straight to one place after another, drawn at random from its area, wherever nothing that stands is in between.
//! A door is a path of two places: shut, and slid aside.

use nalgebra::{Point2, Vector2};
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;

use crate::clearance::Placed;
use crate::manners::{self, Manners, Neighbour, Walker};
use crate::scene::Scene;
use crate::shape::{Shape, Solid};

/// A moving obstacle as the world file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct MoverModel {
    /// Its form around its place.
    pub shape: Shape,
    /// Where it goes.
    pub route: Route,
    /// m/s.
    pub speed: f64,
    /// Whether it makes way; a disc only.
    pub manners: Manners,
}

impl MoverModel {
    /// Distance from a place to the nearest that it may ever touch, m; never more than that, unless it makes way.
    #[must_use]
    pub fn berth(&self, place: Point2<f64>) -> f64 {
        let to_route = match &self.route {
            Route::Path(corners) => {
                let legs = corners.iter().zip(corners.iter().cycle().skip(1));
                legs.map(|((from, _), (to, _))| {
                    let (along, off) = (to - from, place - from);
                    let share = (off.dot(&along) / along.norm_squared().max(1e-12)).clamp(0.0, 1.0);
                    (off - along * share).norm()
                })
                .fold(f64::INFINITY, f64::min)
            }
            Route::Walk { start, low, high } => {
                let nearest = Point2::new(
                    place.x.clamp(low.x.min(start.x), high.x.max(start.x)),
                    place.y.clamp(low.y.min(start.y), high.y.max(start.y)),
                );
                (place - nearest).norm()
            }
        };
        to_route - Solid::new(self.shape.clone(), Pose2::IDENTITY).reach()
    }
}

/// Where a mover goes.
#[derive(Clone, Debug, PartialEq)]
pub enum Route {
    /// A closed path: its corners, m, and how long it rests at each, s. It starts at the first.
    Path(Vec<(Point2<f64>, f64)>),
    /// Anywhere in a box.
    Walk {
        /// Where it starts, m.
        start: Point2<f64>,
        /// Lower-left corner, m.
        low: Point2<f64>,
        /// Upper-right corner, m.
        high: Point2<f64>,
    },
}

/// A moving obstacle at work.
#[derive(Clone, Debug)]
pub struct Mover {
    route: Route,
    speed: f64,
    manners: Manners,
    velocity: Vector2<f64>,
    /// What it draws its places from.
    rng: Pcg64Mcg,
    /// The corner that it comes from, on a path.
    corner: usize,
    from: Point2<f64>,
    to: Point2<f64>,
    along: f64,
    rest: f64,
    /// How long something has been in its way, s.
    held: f64,
}

/// A mover goes in steps of at most this length, so that it cannot jump through a robot, m.
const STRIDE: f64 = 0.01;
/// Most steps a tick: what moves faster takes longer strides.
const MAX_STRIDES: f64 = 1000.0;
/// A blocked step is halved this often to find how far it goes.
const HALVINGS: u32 = 16;
/// Places that a walker looks at before it rests.
const LOOKS: u32 = 20;
/// A walker that finds no way rests this long, s.
const REST: f64 = 1.0;
/// A walker that is held this long turns elsewhere, s.
const PATIENCE: f64 = 2.0;
/// A walker that makes way has come to a place from this near, m, sees walls this near, m, and is held below this share of its speed.
const ARRIVED: f64 = 0.15;
const WALLS: f64 = 1.5;
const HELD: f64 = 0.1;
/// Of more places of walls the nearest count.
const MOST_WALLS: usize = 24;
/// A walker sets out only where its way stays this far from what stands, m.
const MARGIN: f64 = 0.05;
/// Samples on a walker's way: a longer one is not looked at so finely.
const MAX_SAMPLES: f64 = 10_000.0;

impl Mover {
    /// At the start of its route.
    #[must_use]
    pub fn new(model: &MoverModel, rng: Pcg64Mcg) -> (Self, Solid) {
        let start = match &model.route {
            Route::Path(corners) => corners.first().map_or_else(Point2::origin, |(at, _)| *at),
            Route::Walk { start, .. } => *start,
        };
        let mut mover = Self {
            route: model.route.clone(),
            speed: model.speed,
            manners: model.manners,
            velocity: Vector2::zeros(),
            rng,
            corner: 0,
            from: start,
            to: start,
            along: 0.0,
            rest: 0.0,
            held: 0.0,
        };
        if let Route::Path(corners) = &mover.route {
            mover.rest = corners.first().map_or(0.0, |(_, rest)| *rest);
            mover.to = corners.get(1).map_or(start, |(at, _)| *at);
        }
        let solid = Solid::new(model.shape.clone(), Pose2::new(start.x, start.y, 0.0));
        (mover, solid)
    }

    fn length(&self) -> f64 {
        (self.to - self.from).norm()
    }

    fn at(&self, along: f64) -> Pose2 {
        let length = self.length();
        let share = if length > 0.0 { (along / length).min(1.0) } else { 0.0 };
        let at = self.from + (self.to - self.from) * share;
        Pose2::new(at.x, at.y, 0.0)
    }

    /// Sets out for the next place, from where it has come to.
    fn turn(&mut self, scene: &Scene, reach: f64) {
        self.along = 0.0;
        self.held = 0.0;
        match &self.route {
            Route::Path(corners) => {
                self.corner = if self.corner + 1 < corners.len() {
                    self.corner + 1
                } else {
                    0
                };
                let following = corners.get(self.corner + 1).or(corners.first());
                if let (Some((from, rest)), Some((to, _))) = (corners.get(self.corner), following) {
                    (self.from, self.to, self.rest) = (*from, *to, *rest);
                }
            }
            Route::Walk { low, high, .. } => {
                let (low, size) = (*low, *high - *low);
                self.from = self.to;
                for _ in 0..LOOKS {
                    let share = Vector2::new(self.rng.random::<f64>(), self.rng.random::<f64>());
                    let place = low + size.component_mul(&share);
                    if is_open(scene, self.from, place, reach) {
                        self.to = place;
                        return;
                    }
                }
                self.rest = REST;
            }
        }
    }

    /// How far it goes in a time at most, m.
    #[must_use]
    pub fn stride(&self, secs: f64) -> f64 {
        self.manners.top_speed(self.speed) * secs
    }

    /// Whether it makes way for others: then it moves by [`Self::make_way`].
    #[must_use]
    pub fn makes_way(&self) -> bool {
        self.manners != Manners::Blind
    }

    /// Moves on for a time among others and places `solid`; it stops where `blocked` says that the next place would touch a robot.
    pub fn make_way(
        &mut self,
        secs: f64,
        scene: &Scene,
        solid: &mut Solid,
        others: &[Neighbour],
        blocked: impl Fn(&Solid) -> bool,
    ) {
        // No step is longer than its radius: it does not step over anything.
        let steps = (self.speed * secs / solid.reach().max(STRIDE))
            .ceil()
            .clamp(0.0, MAX_STRIDES);
        for _ in 0..steps as u32 {
            self.step_aside(secs / steps, scene, solid, others, &blocked);
        }
    }

    fn step_aside(
        &mut self,
        secs: f64,
        scene: &Scene,
        solid: &mut Solid,
        others: &[Neighbour],
        blocked: &impl Fn(&Solid) -> bool,
    ) {
        let (at, radius) = (solid.center(), solid.reach());
        self.rest = (self.rest - secs).max(0.0);
        if self.rest <= 0.0 && (self.to - at).norm() <= ARRIVED {
            if let Route::Walk { .. } = self.route {
                self.to = at;
            }
            self.turn(scene, radius);
        }
        let to_place = if self.rest > 0.0 { self.from } else { self.to } - at;
        let walker = Walker {
            velocity: self.velocity,
            wanted: manners::wanted(to_place, self.speed),
            radius,
            speed: self.speed,
        };
        let mut walls = Vec::new();
        scene.near(at, WALLS, |nearest| walls.push(nearest - at));
        if walls.len() > MOST_WALLS {
            walls.sort_by(|a: &Vector2<f64>, b| a.norm_squared().total_cmp(&b.norm_squared()));
            walls.truncate(MOST_WALLS);
        }
        let wanted = self.manners.velocity(&walker, others, &walls, secs);
        let next = slid(scene, radius, at, wanted * secs);
        solid.place(Pose2::new(next.x, next.y, 0.0));
        if blocked(solid) {
            let (mut free, mut taken) = (0.0, 1.0);
            for _ in 0..HALVINGS {
                let middle = 0.5 * (free + taken);
                let place = at + (next - at) * middle;
                solid.place(Pose2::new(place.x, place.y, 0.0));
                (free, taken) = if blocked(solid) {
                    (free, middle)
                } else {
                    (middle, taken)
                };
            }
            let place = at + (next - at) * free;
            solid.place(Pose2::new(place.x, place.y, 0.0));
        }
        self.velocity = (solid.center() - at) / secs;
        let waits = self.rest <= 0.0 && self.velocity.norm() < HELD * self.speed;
        self.held = if waits { self.held + secs } else { 0.0 };
        if self.held > PATIENCE && matches!(self.route, Route::Walk { .. }) {
            self.to = solid.center();
            self.turn(scene, radius);
        }
    }

    /// Moves on for a time and places `solid`; it stops where `blocked` says that the next place would touch a robot.
    pub fn step(&mut self, secs: f64, scene: &Scene, solid: &mut Solid, blocked: impl Fn(&Solid) -> bool) {
        if self.speed <= 0.0 {
            return;
        }
        let strides = (self.stride(secs) / STRIDE).ceil().clamp(1.0, MAX_STRIDES);
        let piece = secs / strides;
        for _ in 0..strides as u32 {
            if !self.advance(piece, scene, solid, &blocked) {
                self.held += secs;
                if self.held > PATIENCE && matches!(self.route, Route::Walk { .. }) {
                    self.to = self.at(self.along).position();
                    self.turn(scene, solid.reach());
                }
                return;
            }
        }
        self.held = 0.0;
    }

    /// Goes on for a short time; `false` when a robot is in the way.
    fn advance(&mut self, secs: f64, scene: &Scene, solid: &mut Solid, blocked: &impl Fn(&Solid) -> bool) -> bool {
        let mut left = secs;
        // Rests and corners are passed within the time, but none forever.
        for _ in 0..8 {
            let rested = self.rest.min(left);
            (self.rest, left) = (self.rest - rested, left - rested);
            if left <= 0.0 {
                break;
            }
            let next = (self.along + self.speed * left).min(self.length());
            solid.place(self.at(next));
            if blocked(solid) {
                let (mut free, mut taken) = (self.along, next);
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (free + taken);
                    solid.place(self.at(middle));
                    if blocked(solid) {
                        taken = middle;
                    } else {
                        free = middle;
                    }
                }
                self.along = free;
                solid.place(self.at(free));
                return false;
            }
            left -= (next - self.along) / self.speed;
            self.along = next;
            if self.along >= self.length() {
                self.turn(scene, solid.reach());
            }
        }
        true
    }
}

/// Where a disc comes to by a step: along what stands in its way, never into it.
fn slid(scene: &Scene, radius: f64, at: Point2<f64>, step: Vector2<f64>) -> Point2<f64> {
    let disc = Placed::footprint(&Footprint::Radius(radius), Pose2::IDENTITY);
    let placed = |at: Point2<f64>| disc.at(Pose2::new(at.x, at.y, 0.0));
    if !scene.touches(&placed(at + step)) {
        return at + step;
    }
    let Some(contact) = scene.contact(&placed(at), radius) else {
        return at;
    };
    let into = Vector2::new(contact.normal1.x, contact.normal1.y);
    let along = step - into * step.dot(&into).max(0.0);
    if scene.touches(&placed(at + along)) {
        at
    } else {
        at + along
    }
}

/// Whether a disc goes straight between two places and stays off what stands.
fn is_open(scene: &Scene, from: Point2<f64>, to: Point2<f64>, reach: f64) -> bool {
    let disc = Placed::footprint(&Footprint::Radius(reach + MARGIN), Pose2::IDENTITY);
    // Samples two margins apart: in between the disc is at most a margin nearer to anything than at one of them.
    let steps = ((to - from).norm() / (2.0 * MARGIN)).ceil().clamp(1.0, MAX_SAMPLES);
    (0..=steps as u32).all(|step| {
        let at = from + (to - from) * (f64::from(step) / steps);
        !scene.touches(&disc.at(Pose2::new(at.x, at.y, 0.0)))
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rng() -> Pcg64Mcg {
        Pcg64Mcg::new(1)
    }

    fn open() -> Scene {
        Scene::new(Vec::new(), Vec::new())
    }

    fn square() -> MoverModel {
        MoverModel {
            shape: Shape::Disc(0.2),
            route: Route::Path(
                [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
                    .map(|[x, y]| (Point2::new(x, y), 0.0))
                    .to_vec(),
            ),
            speed: 0.5,
            manners: Manners::Blind,
        }
    }

    #[test]
    fn a_mover_is_back_after_one_turn_of_its_path() {
        let (mut mover, mut solid) = Mover::new(&square(), rng());
        for tick in 1..=400 {
            mover.step(0.02, &open(), &mut solid, |_| false);
            if tick == 100 {
                assert!((solid.center() - Point2::new(1.0, 0.0)).norm() < 1e-9);
            }
        }
        assert!((solid.center() - Point2::new(0.0, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn a_mover_waits_in_front_of_what_blocks_it() {
        let (mut mover, mut solid) = Mover::new(&square(), rng());
        for _ in 0..400 {
            mover.step(0.02, &open(), &mut solid, |solid| solid.center().x > 0.5);
        }
        assert!((solid.center() - Point2::new(0.5, 0.0)).norm() < 1e-4);
    }

    #[test]
    fn a_path_without_length_stands_still() {
        let (mut mover, mut solid) = Mover::new(
            &MoverModel {
                route: Route::Path(vec![(Point2::new(1.0, 1.0), 0.0); 3]),
                ..square()
            },
            rng(),
        );
        mover.step(0.02, &open(), &mut solid, |_| false);
        assert_eq!(solid.center(), Point2::new(1.0, 1.0));
    }

    #[test]
    fn a_mover_rests_at_the_corners_that_say_so() {
        let model = MoverModel {
            route: Route::Path(vec![(Point2::origin(), 1.0), (Point2::new(1.0, 0.0), 3.0)]),
            ..square()
        };
        let (mut mover, mut solid) = Mover::new(&model, rng());
        let mut at = |secs: f64| {
            let steps = (secs / 0.02).round() as u32;
            (0..steps).for_each(|_| mover.step(0.02, &open(), &mut solid, |_| false));
            solid.center().x
        };
        // One second of rest, two there, three of rest, two back.
        assert!(at(1.0).abs() < 1e-9);
        assert!((at(1.0) - 0.5).abs() < 1e-9);
        assert!((at(1.0) - 1.0).abs() < 1e-9);
        assert!((at(2.98) - 1.0).abs() < 1e-9);
        assert!((at(1.02) - 0.5).abs() < 1e-9);
    }

    #[test]
    fn a_walker_stays_in_its_area_off_what_stands_and_goes_the_same_way_for_a_seed() {
        let wall = [[-0.1, -3.0], [0.1, -3.0], [0.1, 1.0], [-0.1, 1.0]].map(|[x, y]| Point2::new(x, y));
        let scene = Scene::new(crate::shape::edges(&wall).collect(), Vec::new());
        let model = MoverModel {
            route: Route::Walk {
                start: Point2::new(-1.0, 0.0),
                low: Point2::new(-3.0, -3.0),
                high: Point2::new(3.0, 3.0),
            },
            ..square()
        };
        let walk = || {
            let (mut mover, mut solid) = Mover::new(&model, rng());
            let mut places = Vec::new();
            for _ in 0..20_000 {
                mover.step(0.02, &scene, &mut solid, |_| false);
                places.push(solid.center());
            }
            places
        };
        let places = walk();
        assert_eq!(places, walk());
        let disc = Footprint::Radius(0.2);
        for at in &places {
            assert!(at.x.abs() <= 3.0 && at.y.abs() <= 3.0);
            let placed = Placed::footprint(&disc, Pose2::new(at.x, at.y, 0.0));
            assert!(scene.distance(&placed) > 0.0, "{at}");
        }
        assert!(places.iter().any(|at| at.x > 1.0) && places.iter().any(|at| at.x < -1.0));
    }
}

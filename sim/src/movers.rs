//! Movers. The moving obstacles walk their route at constant speed, and wait where a robot stands in their way. A walker with [`Manners`]
//! leaves the straight line to make way for robots and other movers, and goes on to its next place from there.
//!
//! A mover keeps its orientation. A path leads from its last point back to the first, so a path of two points is walked to and fro; the
//! mover may rest at each point. A walker goes straight to one random place of its area after another, wherever nothing static is in
//! between. A door is a path of two places: shut, and slid aside.

use nalgebra::{Point2, Vector2};
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;

use crate::clearance::{Placed, halved};
use crate::manners::{self, Manners, Neighbour, Walker};
use crate::scene::Scene;
use crate::shape::{Edge, Solid};

/// A moving obstacle as the world file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct MoverModel {
    /// Its form around its position; as a polygon it may be concave.
    pub shape: Footprint,
    /// Where it goes.
    pub route: Route,
    /// Speed, m/s.
    pub speed: f64,
    /// Whether it makes way; only for a disc.
    pub manners: Manners,
}

impl MoverModel {
    /// Distance from a place to the nearest point that it may ever touch, m; a lower bound, unless it makes way.
    #[must_use]
    pub fn berth(&self, place: Point2<f64>) -> f64 {
        let to_route = match &self.route {
            Route::Path(corners) => {
                let legs = corners.iter().zip(corners.iter().cycle().skip(1));
                legs.map(|((from, _), (to, _))| (place - Edge { a: *from, b: *to }.nearest(place)).norm())
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
        to_route - self.shape.circumscribed_radius()
    }
}

/// Route of a mover.
#[derive(Clone, Debug, PartialEq)]
pub enum Route {
    /// A closed path: its corners, m, and the rest at each, s. It starts at the first.
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

/// A moving obstacle in a simulation.
#[derive(Clone, Debug)]
pub struct Mover {
    route: Route,
    speed: f64,
    manners: Manners,
    velocity: Vector2<f64>,
    /// Random generator of its places.
    rng: Pcg64Mcg,
    /// Index of the corner that it comes from, on a path.
    corner: usize,
    from: Point2<f64>,
    to: Point2<f64>,
    along: f64,
    rest: f64,
    /// Time for which something has been in its way, s.
    held: f64,
}

/// Longest step of a mover, so that it cannot jump through a robot, m.
const STRIDE: f64 = 0.01;
/// Largest number of steps per tick: faster movers take longer steps.
const MAX_STRIDES: f64 = 1000.0;
/// Number of halvings of a blocked step to find how far it goes.
const HALVINGS: u32 = 16;
/// Number of places that a walker tries before it rests.
const LOOKS: u32 = 20;
/// Rest of a walker that finds no free way, s.
const REST: f64 = 1.0;
/// A walker that is blocked this long turns elsewhere, s.
const PATIENCE: f64 = 2.0;
/// For a walker that makes way: distance at which a place is reached, m, range within which walls count, m, and share of its speed below
/// which it is blocked.
const ARRIVED: f64 = 0.15;
const WALLS: f64 = 1.5;
const HELD: f64 = 0.1;
/// Largest number of wall points that count, the nearest first.
const MOST_WALLS: usize = 24;
/// Distance from static obstacles that a walker's way must keep, m.
const MARGIN: f64 = 0.05;
/// Largest number of samples on a walker's way: a longer way is sampled more coarsely.
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

    /// Chooses the next place, from the present one.
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

    /// Upper bound of the distance covered in a time, m.
    #[must_use]
    pub fn stride(&self, secs: f64) -> f64 {
        self.manners.top_speed(self.speed) * secs
    }

    /// Whether it makes way for others: it then moves by [`Self::make_way`].
    #[must_use]
    pub fn makes_way(&self) -> bool {
        self.manners != Manners::Blind
    }

    /// Moves on for a time among others and places `solid`; it stops where `blocked` reports that the next place would touch a robot.
    pub fn make_way(
        &mut self,
        secs: f64,
        scene: &Scene,
        solid: &mut Solid,
        others: &[Neighbour],
        blocked: impl Fn(&Solid) -> bool,
    ) {
        // At its preferred speed no step is longer than the radius, so that nothing is stepped over.
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
            let place = |solid: &mut Solid, share: f64| {
                let at = at + (next - at) * share;
                solid.place(Pose2::new(at.x, at.y, 0.0));
            };
            let free = halved(0.0, 1.0, HALVINGS, |share| {
                place(solid, share);
                !blocked(solid)
            });
            place(solid, free);
        }
        self.velocity = (solid.center() - at) / secs;
        let waits = self.rest <= 0.0 && self.velocity.norm() < HELD * self.speed;
        self.held = if waits { self.held + secs } else { 0.0 };
        if self.held > PATIENCE && matches!(self.route, Route::Walk { .. }) {
            self.to = solid.center();
            self.turn(scene, radius);
        }
    }

    /// Moves on for a time and places `solid`; it stops where `blocked` reports that the next place would touch a robot.
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

    /// Moves on for a short time; `false` if a robot is in the way.
    fn advance(&mut self, secs: f64, scene: &Scene, solid: &mut Solid, blocked: &impl Fn(&Solid) -> bool) -> bool {
        let mut left = secs;
        // A few rests and corners may be passed within the time, but not endlessly many.
        for _ in 0..8 {
            let rested = self.rest.min(left);
            (self.rest, left) = (self.rest - rested, left - rested);
            if left <= 0.0 {
                break;
            }
            let next = (self.along + self.speed * left).min(self.length());
            solid.place(self.at(next));
            if blocked(solid) {
                self.along = halved(self.along, next, HALVINGS, |along| {
                    solid.place(self.at(along));
                    !blocked(solid)
                });
                solid.place(self.at(self.along));
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

/// Position of a disc after a step: it slides along static obstacles, never into them.
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

/// Whether a disc can go straight between two places with a margin from static obstacles.
fn is_open(scene: &Scene, from: Point2<f64>, to: Point2<f64>, reach: f64) -> bool {
    let disc = Placed::footprint(&Footprint::Radius(reach + MARGIN), Pose2::IDENTITY);
    // Samples are two margins apart: in between the disc is at most a margin nearer to anything than at one of them.
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
            shape: Footprint::Radius(0.2),
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

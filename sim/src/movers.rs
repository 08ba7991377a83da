//! Where are the moving obstacles? On closed paths at constant speed; they wait where a robot stands in their way.
//!
//! A mover keeps its orientation. Its path leads from the last point back to the first: two points make it go to and fro.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;

use crate::shape::{Shape, Solid};

/// A moving obstacle as the world file describes it.
#[derive(Clone, Debug, PartialEq)]
pub struct MoverModel {
    /// Its form around its place on the path.
    pub shape: Shape,
    /// Corners of the closed path, m; it starts at the first.
    pub path: Vec<Point2<f64>>,
    /// m/s.
    pub speed: f64,
}

/// A moving obstacle at work.
#[derive(Clone, Debug)]
pub struct Mover {
    path: Vec<Point2<f64>>,
    speed: f64,
    leg: usize,
    along: f64,
}

/// A mover goes in steps of at most this length, so that it cannot jump through a robot, m.
const STRIDE: f64 = 0.01;
/// Most steps a tick: what moves faster takes longer strides.
const MAX_STRIDES: f64 = 1000.0;
/// A blocked step is halved this often to find how far it goes.
const HALVINGS: u32 = 16;

impl Mover {
    /// At the start of its path.
    #[must_use]
    pub fn new(model: &MoverModel) -> (Self, Solid) {
        let mover = Self {
            path: model.path.clone(),
            speed: model.speed,
            leg: 0,
            along: 0.0,
        };
        let solid = Solid::new(model.shape.clone(), mover.pose());
        (mover, solid)
    }

    fn leg(&self) -> (Point2<f64>, Point2<f64>) {
        let from = self.path.get(self.leg).copied().unwrap_or_else(Point2::origin);
        let to = self
            .path
            .get(self.leg + 1)
            .or(self.path.first())
            .copied()
            .unwrap_or(from);
        (from, to)
    }

    fn pose(&self) -> Pose2 {
        let (from, to) = self.leg();
        let length = (to - from).norm();
        let at = if length > 0.0 {
            from + (to - from) * (self.along / length)
        } else {
            from
        };
        Pose2::new(at.x, at.y, 0.0)
    }

    /// The mover this much farther on its path, m.
    fn ahead(&self, distance: f64) -> Self {
        let mut next = self.clone();
        next.along += distance;
        // A whole turn of the path at most: a longer way is not walked leg by leg for ever.
        for _ in 0..=next.path.len() {
            let (from, to) = next.leg();
            let length = (to - from).norm();
            if next.along < length {
                return next;
            }
            next.along -= length;
            next.leg = if next.leg + 1 < next.path.len() {
                next.leg + 1
            } else {
                0
            };
        }
        next.along = 0.0;
        next
    }

    /// How far it goes in a time when nothing is in its way, m.
    #[must_use]
    pub fn stride(&self, secs: f64) -> f64 {
        self.speed * secs
    }

    /// Moves on for a time and places `solid`; it stops where `blocked` says that the next place would touch a robot.
    pub fn step(&mut self, secs: f64, solid: &mut Solid, blocked: impl Fn(&Solid) -> bool) {
        let way = self.stride(secs);
        if way <= 0.0 {
            return;
        }
        let strides = (way / STRIDE).ceil().clamp(1.0, MAX_STRIDES);
        let stride = way / strides;
        for _ in 0..strides as u32 {
            let next = self.ahead(stride);
            solid.place(next.pose());
            if blocked(solid) {
                let (mut free, mut taken) = (0.0, stride);
                for _ in 0..HALVINGS {
                    let middle = 0.5 * (free + taken);
                    solid.place(self.ahead(middle).pose());
                    if blocked(solid) {
                        taken = middle;
                    } else {
                        free = middle;
                    }
                }
                *self = self.ahead(free);
                solid.place(self.pose());
                return;
            }
            *self = next;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn square() -> MoverModel {
        MoverModel {
            shape: Shape::Disc(0.2),
            path: [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
                .map(|[x, y]| Point2::new(x, y))
                .to_vec(),
            speed: 0.5,
        }
    }

    #[test]
    fn a_mover_is_back_after_one_turn_of_its_path() {
        let (mut mover, mut solid) = Mover::new(&square());
        for tick in 1..=400 {
            mover.step(0.02, &mut solid, |_| false);
            if tick == 100 {
                assert!((solid.center() - Point2::new(1.0, 0.0)).norm() < 1e-9);
            }
        }
        assert!((solid.center() - Point2::new(0.0, 0.0)).norm() < 1e-9);
    }

    #[test]
    fn a_mover_waits_in_front_of_what_blocks_it() {
        let (mut mover, mut solid) = Mover::new(&square());
        for _ in 0..400 {
            mover.step(0.02, &mut solid, |solid| solid.center().x > 0.5);
        }
        assert!((solid.center() - Point2::new(0.5, 0.0)).norm() < 1e-4);
    }

    #[test]
    fn a_path_without_length_stands_still() {
        let (mut mover, mut solid) = Mover::new(&MoverModel {
            path: vec![Point2::new(1.0, 1.0); 3],
            ..square()
        });
        mover.step(0.02, &mut solid, |_| false);
        assert_eq!(solid.center(), Point2::new(1.0, 1.0));
    }
}

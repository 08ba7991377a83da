//! Visibility. A box that lies behind what was drawn, beyond the lidar's range or outside its field of view is skipped.
//!
//! A box covers the beams between two of its corners; these beams are found once, for two boxes at a time. Whether all of them have met
//! something nearer is tested when the walk reaches the box, after everything nearer has been drawn.

use std::f64::consts::TAU;

use super::AngularBuffer;
use super::angle::turns;
use crate::boxes::{Apart, Visitor};
use crate::shape::{Disc, Edge};

/// The beams that may meet a box.
#[derive(Clone, Copy, Debug)]
pub struct View {
    /// The first, and the one after the last.
    beams: [u32; 2],
    /// End of the beams that reach over from the turn of the circle before.
    wrapped: u32,
    /// Inverse of the box's distance, 1/m.
    inverse: f64,
}

/// Two boxes with their distances.
type Pair<'a> = [&'a Apart; 2];

impl AngularBuffer {
    fn view(&self, pair: Pair<'_>) -> [View; 2] {
        // For each box the two corners that bound it as seen from here: the clockwise first ones, then the others.
        let (mut x, mut y) = ([0.0_f32; 4], [0.0_f32; 4]);
        for (i, apart) in pair.iter().enumerate() {
            let [low, high] = [apart.low - self.origin, apart.high - self.origin];
            let (lx, ly, hx, hy) = (low.x as f32, low.y as f32, high.x as f32, high.y as f32);
            let beside = if low.x > 0.0 { [lx, lx] } else { [hx, hx] };
            let level = if low.y > 0.0 { [ly, ly] } else { [hy, hy] };
            let [right_x, left_x] = if low.y > 0.0 {
                [hx, lx]
            } else if high.y < 0.0 {
                [lx, hx]
            } else {
                beside
            };
            let [right_y, left_y] = if low.x > 0.0 {
                [ly, hy]
            } else if high.x < 0.0 {
                [hy, ly]
            } else {
                level
            };
            (x[i], y[i], x[i + 2], y[i + 2]) = (right_x, right_y, left_x, left_y);
        }
        let angles = turns(&x, &y);
        [0, 1].map(|i: usize| self.spanned(f64::from(angles[i]), f64::from(angles[i + 2]), pair[i].squared))
    }

    fn spanned(&self, start: f64, end: f64, squared: f64) -> View {
        if squared <= 0.0 {
            return View {
                beams: [0, self.inverse.len() as u32],
                wrapped: 0,
                inverse: f64::INFINITY,
            };
        }
        if squared > self.range_max * self.range_max {
            return View {
                beams: [0; 2],
                wrapped: 0,
                inverse: 0.0,
            };
        }
        let mut span = end - start;
        if span < 0.0 {
            span += TAU;
        }
        let from = self.turned(start);
        let (low, high) = self.beams(from, span);
        View {
            beams: [low as u32, high as u32],
            wrapped: self.beams(from - TAU, span).1 as u32,
            inverse: 1.0 / squared.sqrt(),
        }
    }

    /// Whether some beam has met nothing nearer than a box.
    fn sees(&self, view: &View) -> bool {
        let any = |low: u32, high: u32| {
            let beams = self.inverse.get(low as usize..high as usize).unwrap_or_default();
            beams.chunks(CHUNK).any(|chunk| {
                let least = chunk.iter().fold(
                    f64::INFINITY,
                    |least, inverse| if *inverse < least { *inverse } else { least },
                );
                least < view.inverse
            })
        };
        any(view.beams[0], view.beams[1]) || any(0, view.wrapped)
    }
}

/// Beams that are tested at once: a loop without branches becomes vector instructions.
const CHUNK: usize = 16;

impl Visitor<Edge> for AngularBuffer {
    type View = View;

    fn look(&self, pair: Pair<'_>) -> [View; 2] {
        self.view(pair)
    }

    fn enters(&self, view: &View) -> bool {
        self.sees(view)
    }

    fn meet(&mut self, edges: &[Edge]) {
        self.gather(edges);
    }
}

impl Visitor<Disc> for AngularBuffer {
    type View = View;

    fn look(&self, pair: Pair<'_>) -> [View; 2] {
        self.view(pair)
    }

    fn enters(&self, view: &View) -> bool {
        self.sees(view)
    }

    fn meet(&mut self, discs: &[Disc]) {
        discs.iter().for_each(|disc| self.disc(disc));
    }
}

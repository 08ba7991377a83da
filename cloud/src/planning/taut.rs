//! Which corners of a way are needed? None that one sees past.

use nalgebra::Point2;

use crate::space::Sight;

/// Takes corners out as long as those before and after them see each other; the ends stay. Never longer than before.
pub fn tighten(sight: &impl Sight, corners: &mut Vec<Point2<f64>>) {
    let mut at = 0;
    while at + 2 < corners.len() {
        // The farthest that is seen from here.
        let next = (at + 2..corners.len())
            .rev()
            .find(|next| sight.sees(corners[at], corners[*next]));
        if let Some(next) = next {
            corners.drain(at + 1..next);
        }
        at += 1;
    }
}

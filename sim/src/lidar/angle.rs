//! Approximate angles. The direction of a vector, fast and nearly exact, with selections instead of branches, so that several are
//! computed at once.

use nalgebra::Vector2;

/// Largest error of these functions, rad (Abramowitz and Stegun 4.4.49 gives 1e-5).
pub(super) const TURN_ERROR: f64 = 2e-5;

/// Direction of a vector, rad in (-pi, pi], within [`TURN_ERROR`].
pub(super) fn direction(v: Vector2<f64>) -> f64 {
    f64::from(turn(v.x as f32, v.y as f32))
}

/// Directions of several vectors.
pub(super) fn turns<const N: usize>(x: &[f32; N], y: &[f32; N]) -> [f32; N] {
    let mut angles = [0.0; N];
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

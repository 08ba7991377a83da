//! Trajectory smoothing. Turns a path into a collision-free trajectory within the limits of a differential drive.
//!
//! # The problem
//!
//! Given corner points `q₀ … qₙ` in a configuration space, a pose and velocity at the start, and the limits of a drive with half the
//! wheel separation `h`, find a curve `p(s)` with curvature `k(s)` and a time law `s(t)` that ends at rest at `qₙ`. The problem is solved
//! in three phases, timed under these names:
//!
//! 1. **corridor**: needless corners are cut; each remaining piece `i` gets a convex polygon `Aᵢ x ≤ bᵢ` that is free for the robot's
//!    centre ([`corridor()`]).
//! 2. **geometry**: quintic Bezier curves, C² where they meet, with control points `c`:
//!
//!    ```text
//!    minimise   ∫ |p'|² + l² |p''|² + l⁴ |p'''|²      over p, p', p'' at the joints
//!    subject to Aᵢ c ≤ bᵢ for each control point of piece i;   p, p' (and k) as given at both ends
//!    ```
//!
//!    a sparse convex quadratic programme ([`fit()`]). A curve lies in the convex hull of its control points, so it does not leave the
//!    corridor. A long robot's footprint is swept along the curve; where it collides, the polygon is tightened for the headings there.
//! 3. **timing**: with `b = v²` the limits are linear in `b` and `a = b'/2`:
//!
//!    ```text
//!    minimise   ∫ b^(-1/2) ds
//!    subject to v (1 ± k h) ≤ v_wheel,   |a (1 ± k h) ± h k' b| ≤ a_wheel,   |k| b ≤ a_lateral,   |k| v ≤ w_max
//!    ```
//!
//!    two sweeps are exact for the samples ([`fastest()`]); with a jerk limit `|a'| √b ≤ J` a few quadratic programmes follow
//!    ([`jerk_limited()`]); for the least energy there is a search over two limits (`timing/economy`).
//!
//! The result is checked independently (`certificate`): the footprint is swept along the trajectory, and the largest use of each limit is
//! computed. If a phase fails, the path itself is sent as stop, turn and go ([`stop_turn_go()`]); [`Outcome`] says why.
//!
//! # Use
//!
//! [`smooth()`] runs all phases; [`smooth_pieces()`] does so for a path with stops and with legs driven backwards; [`unsmoothed()`] is only
//! the fallback. `cargo run -p zenav-smoothing --example around_a_corner` prints a trajectory and its certificate.
//!
//! | file | answers |
//! |---|---|
//! | `smoother` | which trajectory does a path become? |
//! | `pieces` | how is a path with stops, or with legs driven backwards, smoothed? |
//! | `shortcut` | which corners of a path are needed? |
//! | `corridor` | how much room is there around a path? |
//! | `fit`, `cost` | which curve through that room bends least, and what does a curve cost? |
//! | `csc` | how does the solver take a sparse matrix? |
//! | `curve` | how is a curve represented and sampled? |
//! | `segment` | which curve leads from one stop to the next, for the true footprint? |
//! | `trajectory_builder` | where does the robot brake, stop and turn, and which curves connect these places? |
//! | `timing` | when is the robot where? |
//! | `certificate` | is the trajectory free, and within the limits? |
//! | `unsmoothed` | what is sent without smoothing? |
//! | `settings`, `outcome`, `phases` | what can be tuned, what was the result, how long did it take? |

mod certificate;
mod corridor;
mod cost;
mod csc;
mod curve;
mod fit;
mod outcome;
mod phases;
mod pieces;
mod segment;
mod settings;
mod shortcut;
mod smoother;
mod timing;
mod trajectory_builder;
mod unsmoothed;

#[cfg(test)]
mod tests;

pub use corridor::{FreePolygon, HalfPlane, corridor};
pub use curve::{Curve, CurveError, Sampled};
pub use fit::{EndTangent, Ends, fit};
pub use outcome::{Fallback, Outcome};
pub use pieces::{Cuts, Piece, SmoothedPiece, SmoothedPieces, pieces, smooth_pieces};
pub use settings::{CorridorSettings, SmoothingSettings, StopSettings};
pub use shortcut::shortcut;
pub use smoother::{SAMPLE_PERIOD, SmoothQuery, Smoothed, smooth};
pub use timing::jerk::{JerkError, JerkLimited, limited as jerk_limited};
pub use timing::stop_turn_go::stop_turn_go;
pub use timing::sweep::{SweepError, ceilings, fastest};
pub use timing::{
    GeometricPath, JerkFigures, Limits, PathPoint, PiecewiseTrajectory, Rates, SpeedLimit, State, TimeLaw, UNRESTRICTED,
};
pub use unsmoothed::unsmoothed;

//! Outcome. The result of smoothing, and why it is not a smooth trajectory.

use std::fmt;

use super::curve::CurveError;

/// Result of smoothing.
///
/// ```
/// use zenav_smoothing::{Fallback, Outcome};
///
/// assert_eq!(Outcome::Smoothed.to_string(), "smoothed");
/// assert_eq!(Outcome::Unsmoothed(Fallback::Slower).to_string(), "fallback:slower");
/// ```
#[derive(Clone, Debug, Default, PartialEq)]
pub enum Outcome {
    /// A trajectory along a smooth curve.
    #[default]
    Smoothed,
    /// The path itself as stop, turn and go; nothing at all if even that is not free.
    Unsmoothed(Fallback),
}

impl fmt::Display for Outcome {
    /// `smoothed`, or `fallback:REASON`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Smoothed => f.write_str("smoothed"),
            Self::Unsmoothed(reason) => write!(f, "fallback:{reason}"),
        }
    }
}

/// Why the smooth curve is not driven.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fallback {
    /// Smoothing was not tried: the caller asked for the path itself.
    #[error("not_tried")]
    NotTried,
    /// The start has numbers that are not finite.
    #[error("start_not_finite")]
    StartNotFinite,
    /// The path itself is not free; nothing is driven.
    #[error("path_blocked")]
    PathBlocked,
    /// The footprint collides along every curve found.
    #[error("collision")]
    Collision,
    /// No curve was found.
    #[error("{0}")]
    Curve(CurveError),
    /// No time law keeps the limits from the start's speed on.
    #[error("too_fast")]
    TooFast,
    /// Stop, turn and go is faster.
    #[error("slower")]
    Slower,
    /// Time was up.
    #[error("timed_out")]
    TimedOut,
}

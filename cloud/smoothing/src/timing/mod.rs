//! Timing. Time laws along a given path, for a differential drive.
//!
//! | file | answers |
//! |---|---|
//! | [`limits`] | how fast may the robot be, at which curvature? |
//! | [`path`] | where does the path run, by arc length? |
//! | [`sweep`] | what is the fastest law along it? |
//! | [`jerk`] | what is the fastest law whose jerk is limited? |
//! | `linear_rows` | what are the rows of its programmes? |
//! | [`economy`] | which law costs the least energy? |
//! | [`law`] | how do speed and time run between samples? |
//! | [`profile`] | how does a robot turn, or come to rest? |
//! | [`trajectory`] | where is the robot at a time? |
//! | [`stop_turn_go`] | which trajectory is always safe? Stop, turn, go straight |

pub mod economy;
pub mod jerk;
pub mod law;
pub mod limits;
mod linear_rows;
pub mod path;
pub mod profile;
pub mod stop_turn_go;
pub mod sweep;
pub mod trajectory;

#[cfg(test)]
mod tests;

pub use law::TimeLaw;
pub use limits::Limits;
pub use path::{GeometricPath, PathPoint, SpeedLimit, UNRESTRICTED};
pub use trajectory::{JerkFigures, PiecewiseTrajectory, Rates, State};

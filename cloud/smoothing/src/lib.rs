//! What does the robot really drive? A smooth curve through the free space around a way, with a time law.
//!
//! | file | answers |
//! |---|---|
//! | [`shortcut`] | which corners of a way are needed? |
//! | [`corridor`] | how much room is there around it? |
//! | [`fit`] | which curve through that room bends least? |
//! | `cost` | what does a curve cost? |
//! | [`curve`] | where does a curve run? |
//! | `segment` | which curve leads from one stop to the next, for the true footprint? |
//! | `trajectory_builder` | where does the robot brake, stop and turn, and on which curves does it go between? |
//! | [`certificate`] | is the motion free? |
//! | [`smoother`] | which trajectory does a way become? |
//! | [`mod@unsmoothed`] | what goes out where nobody smooths? |
//! | [`timing`] | when is the robot where? |

pub mod certificate;
pub mod corridor;
mod cost;
pub mod curve;
pub mod fit;
mod segment;
pub mod shortcut;
pub mod smoother;
pub mod timing;
mod trajectory_builder;
pub mod unsmoothed;

#[cfg(test)]
mod tests;

pub use smoother::{PERIOD, SmoothQuery, SmoothSettings, Smoothed, smooth};
pub use unsmoothed::unsmoothed;

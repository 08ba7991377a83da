//! Wall following, judged and tuned. How well a robot follows walls on its own, and which gains are best.
//!
//! | file | answers |
//! |---|---|
//! | `score` | the distance error, by ground truth |
//! | `lockstep` | one run of a robot without a cloud, in lockstep |
//! | `rooms` | rooms to drive in, generated from a seed |
//! | `evolution` | which gains have the least cost? (CMA-ES) |
//! | `tune`, `chart` | `zenav tune wall_follow`, and its chart |

mod chart;
pub mod evolution;
pub mod lockstep;
pub mod rooms;
pub mod score;
mod tune;

pub use tune::{TuneArgs, tune};

//! Wall following, judged and tuned. How well does a robot follow walls by itself, and with which gains best?
//!
//! | file | answers |
//! |---|---|
//! | `score` | how far was it from where it should be, by the truth? |
//! | `lockstep` | one run of a robot without a cloud, in lockstep |
//! | `rooms` | rooms to try it in, drawn from a seed |
//! | `evolution` | which gains cost least? (CMA-ES) |
//! | `tune`, `chart` | `zenav tune wall_follow`, and how it is drawn |

mod chart;
pub mod evolution;
pub mod lockstep;
pub mod rooms;
pub mod score;
mod tune;

pub use tune::{TuneArgs, tune};

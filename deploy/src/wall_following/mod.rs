//! How well does a robot follow walls by itself, and with which gains does it best?
//!
//! | file | answers |
//! |---|---|
//! | `score` | how far was it from where it should be, by the truth? |
//! | `alone` | one run of a robot without a cloud, in lockstep |

pub mod alone;
pub mod score;

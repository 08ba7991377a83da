//! Operator commands. How does a person take control of a robot? Stop and resume need no lease and no cloud; driving by hand needs the
//! operator's lease.
//!
//! | file | answers |
//! |---|---|
//! | `stop` | stop, resume |
//! | `lease` | who may command: show, acquire, release |
//! | `lease_session` | keeping the operator's lease while it is needed |
//! | `keyboard` | which key means which motion, and for how long (pure) |
//! | `status` | who commands now, and what is shown of it (pure) |
//! | `pose` | where the robot is, told or looked for |
//! | `teleop` | driving in the terminal |

mod keyboard;
mod lease;
mod lease_session;
mod pose;
mod status;
mod stop;
mod teleop;

pub use lease::{LeaseArgs, lease};
pub use pose::{PoseArgs, pose};
pub use stop::{StopArgs, resume, stop};
pub use teleop::{TeleopArgs, teleop};

/// The name under which this user commands: the same for every command of the user, so that one can release what another took.
fn holder() -> String {
    let user = std::env::var("USER")
        .or_else(|_| std::env::var("USERNAME"))
        .unwrap_or_else(|_| "unknown".to_owned());
    format!("operator-{user}")
}

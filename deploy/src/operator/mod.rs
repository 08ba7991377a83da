//! Operator commands. How an operator takes control of a robot: stop and resume need no lease and no cloud; driving by hand needs the
//! operator's lease.
//!
//! | file | answers |
//! |---|---|
//! | `stop` | stop, resume |
//! | `lease` | who may command? show, acquire, release |
//! | `param` | parameters of a running robot |
//! | `maneuver` | spin, drive straight, back up, wait |
//! | `keyboard` | which key commands which motion, and for how long? (pure) |
//! | `status` | who commands the robot now, and how is that displayed? (pure) |
//! | `pose` | the robot's pose: show, set, search |
//! | `teleop` | driving in the terminal |

mod keyboard;
mod lease;
mod maneuver;
mod param;
mod pose;
mod status;
mod stop;
mod teleop;

pub use lease::{LeaseArgs, lease};
pub use maneuver::{DoArgs, maneuver};
pub use param::{ParamArgs, param};
pub use pose::{PoseArgs, pose};
pub use stop::{StopArgs, resume, stop};
pub use teleop::{TeleopArgs, teleop};

/// This user's name as a lease holder: the same for all of the user's commands, so that one can release what another took.
pub(crate) fn holder() -> String {
    let user = std::env::var("USER").or_else(|_| std::env::var("USERNAME"));
    holder_of(&user.unwrap_or_else(|_| user_number()))
}

/// A valid [`Id`](zenav_protocol::id::Id): `_` replaces invalid characters.
fn holder_of(user: &str) -> String {
    let valid = |letter: char| {
        if letter.is_ascii_alphanumeric() || letter == '-' {
            letter
        } else {
            '_'
        }
    };
    format!("operator-{}", user.chars().take(50).map(valid).collect::<String>())
}

/// Fallback name if the environment has no user name.
fn user_number() -> String {
    #[cfg(unix)]
    {
        format!("uid-{}", rustix::process::getuid().as_raw())
    }
    #[cfg(not(unix))]
    {
        "unknown".to_owned()
    }
}

/// Waits for a signal to end: Ctrl-C, a closed terminal, or `kill`.
async fn ended() {
    #[cfg(unix)]
    {
        use tokio::signal::unix::{SignalKind, signal};
        let (Ok(mut hangup), Ok(mut terminate)) = (signal(SignalKind::hangup()), signal(SignalKind::terminate()))
        else {
            let _ = tokio::signal::ctrl_c().await;
            return;
        };
        tokio::select! {
            _ = tokio::signal::ctrl_c() => {}
            _ = hangup.recv() => {}
            _ = terminate.recv() => {}
        }
    }
    #[cfg(not(unix))]
    {
        let _ = tokio::signal::ctrl_c().await;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_user_commands_under_a_name_that_can_be_given_to_holder() {
        assert_eq!(holder_of("anna.m"), "operator-anna_m");
        for user in ["", "DOMAIN\\jürgen", &"x".repeat(100)] {
            assert!(crate::arguments::name(&holder_of(user)).is_ok(), "{user}");
        }
    }
}

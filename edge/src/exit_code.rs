//! Exit codes. Which exit code does a command return, `zenav` or `zenav-edge`?

use zenav_protocol::bus::{AskError, BusError};
use zenav_protocol::messages::Refusal;

use crate::remote_body::AttachError;

/// The command succeeded.
pub const OK: u8 = 0;
/// The command failed.
pub const FAILED: u8 = 1;
/// The command line or its input was wrong.
pub const USAGE: u8 = 2;
/// There is no such robot, goal or file.
pub const NOT_FOUND: u8 = 3;
/// Neither router nor robot could be reached.
pub const CANNOT_CONNECT: u8 = 4;
/// No answer came in time.
pub const TIMEOUT: u8 = 5;
/// The goal was cancelled.
pub const CANCELED: u8 = 6;
/// The goal was rejected, the request was refused, or this identity may not make it.
pub const REJECTED: u8 = 7;
/// The user pressed Ctrl-C.
pub const INTERRUPTED: u8 = 130;

/// Exit code of a command whose request was refused.
///
/// ```
/// use zenav_edge::exit_code::{NOT_FOUND, REJECTED, of_refusal};
/// use zenav_protocol::messages::Refusal;
///
/// assert_eq!(of_refusal(&Refusal::rejected("the goal is in a wall")), REJECTED);
/// assert_eq!(of_refusal(&Refusal::NotFound { what: "goal tea-1".into() }), NOT_FOUND);
/// ```
#[must_use]
pub const fn of_refusal(refusal: &Refusal) -> u8 {
    match refusal {
        Refusal::Internal { .. } | Refusal::NotLeader => FAILED,
        Refusal::BadRequest { .. } | Refusal::TooLarge { .. } => USAGE,
        Refusal::NotFound { .. } => NOT_FOUND,
        Refusal::Busy { .. } => TIMEOUT,
        Refusal::Rejected { .. } | Refusal::Held { .. } | Refusal::NotCaughtUp { .. } | Refusal::WrongEpoch { .. } => {
            REJECTED
        }
    }
}

/// Exit code of a command that got no answer.
#[must_use]
pub const fn of_ask(error: &AskError) -> u8 {
    match error {
        AskError::Timeout { .. } => TIMEOUT,
        AskError::Refused(refusal) => of_refusal(refusal),
        AskError::Denied(_) => REJECTED,
        AskError::Malformed { .. } => FAILED,
        AskError::Unaskable { .. } => USAGE,
        AskError::Closed => CANNOT_CONNECT,
    }
}

/// Exit code of a command without a session.
#[must_use]
pub const fn of_bus(error: &BusError) -> u8 {
    match error {
        BusError::CannotConnect { .. } | BusError::Closed => CANNOT_CONNECT,
        BusError::CannotListen { .. } => FAILED,
        BusError::Denied(_) => REJECTED,
        BusError::Config { .. } | BusError::Exposed { .. } | BusError::Key { .. } => USAGE,
    }
}

/// Exit code of an edge without a body.
#[must_use]
pub const fn of_attach(error: &AttachError) -> u8 {
    match error {
        AttachError::Ask(error) => of_ask(error),
        AttachError::Bus(error) => of_bus(error),
        AttachError::Pace(..) => FAILED,
    }
}

//! Failures. How does a command fail? With one message on stderr and an exit code.

use std::fmt::Display;
use std::path::Path;

use miette::Diagnostic;
use thiserror::Error;
use zenav_protocol::bus::{AskError, BusError, IdentityError};
use zenav_protocol::messages::Refusal;

use crate::exit_code;

/// A command's failure: what to tell, and the exit code.
#[derive(Debug, Error, Diagnostic)]
#[error("{message}")]
pub struct Failure {
    /// Exit code, one of [`exit_code`].
    pub code: u8,
    /// What went wrong, and what was expected.
    pub message: String,
}

impl Failure {
    /// A failure with a code of its own.
    #[must_use]
    pub fn new(code: u8, message: impl Display) -> Self {
        Self {
            code,
            message: message.to_string(),
        }
    }

    /// The command's input was wrong.
    #[must_use]
    pub fn usage(message: impl Display) -> Self {
        Self::new(exit_code::USAGE, message)
    }

    /// No such robot, goal, file.
    #[must_use]
    pub fn not_found(message: impl Display) -> Self {
        Self::new(exit_code::NOT_FOUND, message)
    }

    /// It was tried, and failed.
    #[must_use]
    pub fn failed(message: impl Display) -> Self {
        Self::new(exit_code::FAILED, message)
    }

    /// [`Self::usage`] for what is wrong in a file, which it names; for `map_err`.
    pub fn usage_at<E: Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |error| Self::usage(format_args!("{}: {error}", path.display()))
    }

    /// [`Self::failed`] for what cannot be done with a file, which it names; for `map_err`.
    pub fn failed_at<E: Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |error| Self::failed(format_args!("{}: {error}", path.display()))
    }
}

impl From<BusError> for Failure {
    fn from(error: BusError) -> Self {
        let code = exit_code::of_bus(&error);
        // Zenoh's own words name lines of its source.
        if let BusError::CannotListen { endpoint, reason } = &error
            && reason.contains("in use")
        {
            return Self::new(
                code,
                format!(
                    "cannot listen on {endpoint}: in use, perhaps by another `zenav up` or `zenav router` (--listen names another endpoint)"
                ),
            );
        }
        Self::new(code, error.to_string())
    }
}

impl From<IdentityError> for Failure {
    fn from(error: IdentityError) -> Self {
        Self::usage(error)
    }
}

impl From<AskError> for Failure {
    fn from(error: AskError) -> Self {
        let cure = match &error {
            AskError::Refused(Refusal::NotLeader) => {
                ": no orchestrator that runs may lead this robot (`zenav doctor` says which may; `zenav lease forget` if it will not come back)"
            }
            AskError::Timeout { .. } => " (`zenav doctor` says what runs)",
            _ => "",
        };
        Self::new(exit_code::of_ask(&error), format!("{error}{cure}"))
    }
}

impl From<std::io::Error> for Failure {
    fn from(error: std::io::Error) -> Self {
        let code = if error.kind() == std::io::ErrorKind::NotFound {
            exit_code::NOT_FOUND
        } else {
            exit_code::FAILED
        };
        Self::new(code, error.to_string())
    }
}

/// What every command returns: its exit code.
pub type Outcome = Result<u8, Failure>;

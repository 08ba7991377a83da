//! Failures. A command fails with one message on stderr and an exit code.

use std::fmt::Display;
use std::path::Path;

use thiserror::Error;
use zenav_protocol::bus::{AskError, BusError, IdentityError};
use zenav_protocol::messages::Refusal;

use crate::exit_code;
use crate::leadership;

/// A command's failure: message and exit code.
#[derive(Debug, Error)]
#[error("{message}")]
pub struct Failure {
    /// Exit code, one of [`exit_code`].
    pub code: u8,
    /// What went wrong, and what was expected.
    pub message: String,
}

impl Failure {
    /// A failure with the given exit code.
    #[must_use]
    pub fn new(code: u8, message: impl Display) -> Self {
        Self {
            code,
            message: in_words(&message.to_string()),
        }
    }

    /// Wrong input.
    #[must_use]
    pub fn usage(message: impl Display) -> Self {
        Self::new(exit_code::USAGE, message)
    }

    /// No router.
    #[must_use]
    pub fn cannot_connect(message: impl Display) -> Self {
        Self::new(exit_code::CANNOT_CONNECT, message)
    }

    /// The bus ended while it was listened to.
    #[must_use]
    pub fn closed() -> Self {
        Self::cannot_connect("the bus was closed")
    }

    /// Nothing came in time.
    #[must_use]
    pub fn timeout(message: impl Display) -> Self {
        Self::new(exit_code::TIMEOUT, message)
    }

    /// The robot, its mission or this command refuses the request.
    #[must_use]
    pub fn rejected(message: impl Display) -> Self {
        Self::new(exit_code::REJECTED, message)
    }

    /// Ctrl-C ended the work.
    #[must_use]
    pub fn interrupted() -> Self {
        Self::new(exit_code::INTERRUPTED, "interrupted")
    }

    /// A robot, goal or file that does not exist.
    #[must_use]
    pub fn not_found(message: impl Display) -> Self {
        Self::new(exit_code::NOT_FOUND, message)
    }

    /// The work was attempted and failed.
    #[must_use]
    pub fn failed(message: impl Display) -> Self {
        Self::new(exit_code::FAILED, message)
    }

    /// The same failure with what it is about before its message.
    #[must_use]
    pub fn about(self, what: &str) -> Self {
        Self {
            message: format!("{what}: {}", self.message),
            ..self
        }
    }

    /// [`Self::usage`] for bad contents of a file, with its name; for `map_err`.
    pub fn usage_at<E: Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |error| Self::usage(format_args!("{}: {error}", path.display()))
    }

    /// [`Self::failed`] for a failed operation on a file, with its name; for `map_err`.
    pub fn failed_at<E: Display>(path: &Path) -> impl FnOnce(E) -> Self {
        move |error| Self::failed(format_args!("{}: {error}", path.display()))
    }
}

/// A parser's error message, with expected Rust types replaced by words.
pub(crate) fn in_words(message: &str) -> String {
    const EXPECTED: &str = "expected ";
    let mut parts = message.split(EXPECTED);
    let mut told = parts.next().unwrap_or_default().to_owned();
    for part in parts {
        let end = part
            .find(|letter: char| !letter.is_ascii_alphanumeric())
            .unwrap_or(part.len());
        let (word, rest) = part.split_at(end);
        let words = match word {
            "f32" | "f64" => "a number",
            "u8" => "a whole number from 0 to 255",
            "u16" => "a whole number from 0 to 65535",
            "u32" | "u64" | "usize" => "a whole number that is not negative",
            "i8" | "i16" | "i32" | "i64" | "isize" => "a whole number",
            "bool" => "true or false",
            other => other,
        };
        told.extend([EXPECTED, words, rest]);
    }
    told.replace("expected a boolean", "expected true or false")
}

impl From<BusError> for Failure {
    fn from(error: BusError) -> Self {
        let code = exit_code::of_bus(&error);
        // Zenoh's own message refers to lines of its source.
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
                format!(": no orchestrator that runs may lead this robot ({})", leadership::CURE)
            }
            AskError::Timeout { .. } => " (`zenav doctor` says what runs)".to_owned(),
            _ => String::new(),
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

/// Result of every command: its exit code.
pub type Outcome = Result<u8, Failure>;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_without_a_leader_is_told_with_the_cure_wherever_it_shows() {
        let failure = Failure::from(AskError::Refused(Refusal::NotLeader)).about("tiago");
        assert_eq!(failure.code, exit_code::of_ask(&AskError::Refused(Refusal::NotLeader)));
        assert!(
            failure.message.starts_with("tiago: not the leader: ") && failure.message.contains("`zenav lease forget`"),
            "{failure}"
        );
    }

    #[test]
    fn what_a_parser_expected_is_told_in_words() {
        let told = |message: &str| Failure::usage(message).message;
        assert_eq!(
            told("invalid type: string \"a\", expected usize at line 3"),
            "invalid type: string \"a\", expected a whole number that is not negative at line 3"
        );
        assert_eq!(
            told("expected f64, or expected a boolean"),
            "expected a number, or expected true or false"
        );
        assert_eq!(
            told("expected f64s and expected 2 numbers"),
            "expected f64s and expected 2 numbers"
        );
    }
}

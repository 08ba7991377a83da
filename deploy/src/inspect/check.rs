//! A check of the doctor. Verdict, observation, and advice.

use serde::Serialize;

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Verdict {
    /// Works as expected.
    Ok,
    /// Works, but needs a look.
    Warn,
    /// Does not work.
    Fail,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Check {
    /// What it is about: `router`, a robot's name, `clock`.
    pub(super) about: String,
    /// Name of the check.
    pub(super) check: &'static str,
    /// Result.
    pub(super) verdict: Verdict,
    /// Observation.
    pub(super) seen: String,
    /// Advice, unless the check passed.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) advice: Option<String>,
}

impl Check {
    pub(super) fn ok(about: &str, check: &'static str, seen: impl Into<String>) -> Self {
        Self {
            about: about.to_owned(),
            check,
            verdict: Verdict::Ok,
            seen: seen.into(),
            advice: None,
        }
    }

    pub(super) fn warn(about: &str, check: &'static str, seen: impl Into<String>, advice: &str) -> Self {
        Self {
            verdict: Verdict::Warn,
            advice: Some(advice.to_owned()),
            ..Self::ok(about, check, seen)
        }
    }

    pub(super) fn fail(about: &str, check: &'static str, seen: impl Into<String>, advice: &str) -> Self {
        Self {
            verdict: Verdict::Fail,
            ..Self::warn(about, check, seen, advice)
        }
    }
}

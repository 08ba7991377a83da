//! A check of the doctor. How is it reported? Verdict, observation, and what to do.

use serde::Serialize;

/// How a check came out.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub(super) enum Verdict {
    /// As it should be.
    Ok,
    /// Works, but look at it.
    Warn,
    /// Does not work.
    Fail,
}

/// One check.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Check {
    /// What it is about: `router`, a robot's name, `clock`.
    pub(super) about: String,
    /// What was checked.
    pub(super) check: &'static str,
    /// How it came out.
    pub(super) verdict: Verdict,
    /// What was seen.
    pub(super) seen: String,
    /// What to do, unless all is well.
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

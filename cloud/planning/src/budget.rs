//! Search budget. How long may a search take? Expansions, samples, and a flag that somebody else may set: a search knows no clock.

use std::sync::atomic::{AtomicBool, Ordering};

/// Expansions between two looks at the flag.
const PERIOD: u64 = 512;

/// What a search may use.
///
/// ```
/// use std::sync::atomic::AtomicBool;
/// use zenav_planning::Budget;
///
/// let cancel = AtomicBool::new(true);
/// let budget = Budget { cancel: Some(&cancel), ..Budget::UNLIMITED };
/// assert!(budget.is_cancelled());
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Budget<'a> {
    /// Nodes that may be expanded.
    pub max_expansions: u64,
    /// Samples that may be drawn.
    pub max_samples: u64,
    /// Ends the search soon after it is set.
    pub cancel: Option<&'a AtomicBool>,
}

impl Budget<'_> {
    /// As long as it takes.
    pub const UNLIMITED: Budget<'static> = Budget {
        max_expansions: u64::MAX,
        max_samples: u64::MAX,
        cancel: None,
    };

    /// Whether somebody has set the flag.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// Whether the search must end after this many expansions.
    #[must_use]
    pub fn is_spent(&self, expansions: u64) -> bool {
        expansions >= self.max_expansions || (expansions.is_multiple_of(PERIOD) && self.is_cancelled())
    }
}

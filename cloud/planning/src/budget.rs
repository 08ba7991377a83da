//! Search budget. Limits on expansions and samples, and a cancel flag that the caller may set: a search reads no clock.

use std::sync::atomic::{AtomicBool, Ordering};

/// Expansions between two checks of the cancel flag.
const PERIOD: u64 = 512;

/// Limits of one search.
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
    /// Cancels the search soon after it is set.
    pub cancel: Option<&'a AtomicBool>,
}

impl Budget<'_> {
    /// No limits.
    pub const UNLIMITED: Budget<'static> = Budget {
        max_expansions: u64::MAX,
        max_samples: u64::MAX,
        cancel: None,
    };

    /// Whether the cancel flag is set.
    #[must_use]
    pub fn is_cancelled(&self) -> bool {
        self.cancel.is_some_and(|flag| flag.load(Ordering::Relaxed))
    }

    /// Whether the search must end after this many expansions.
    ///
    /// ```
    /// use std::sync::atomic::{AtomicBool, Ordering};
    /// use zenav_planning::Budget;
    ///
    /// let cancel = AtomicBool::new(false);
    /// let budget = Budget { max_expansions: 10_000, cancel: Some(&cancel), ..Budget::UNLIMITED };
    /// assert!(!budget.is_spent(512) && budget.is_spent(10_000));
    /// cancel.store(true, Ordering::Relaxed);
    /// assert!(budget.is_spent(512) && !budget.is_spent(513), "the flag is read every 512 expansions");
    /// ```
    #[must_use]
    pub fn is_spent(&self, expansions: u64) -> bool {
        expansions >= self.max_expansions || (expansions.is_multiple_of(PERIOD) && self.is_cancelled())
    }
}

//! Phases. Times of corridor, geometry and time law, and the cancel flag.

use std::sync::atomic::{AtomicBool, Ordering};

/// Times of the phases, s, by the caller's clock, under the names that the statistics and the command line use.
pub(crate) struct Phases<'a> {
    clock: &'a mut dyn FnMut() -> f64,
    cancel: Option<&'a AtomicBool>,
    /// Shortcut and corridor.
    pub(crate) corridor: f64,
    /// Quadratic programme and the checks of its curve.
    pub(crate) geometry: f64,
    /// Time laws.
    pub(crate) timing: f64,
}

impl<'a> Phases<'a> {
    pub(crate) fn new(clock: &'a mut dyn FnMut() -> f64, cancel: Option<&'a AtomicBool>) -> Self {
        Self {
            clock,
            cancel,
            corridor: 0.0,
            geometry: 0.0,
            timing: 0.0,
        }
    }

    /// Whether the caller has cancelled smoothing.
    pub(crate) fn is_over(&self) -> bool {
        self.cancel.is_some_and(|cancel| cancel.load(Ordering::Relaxed))
    }

    /// The cancel flag.
    pub(crate) fn cancel(&self) -> Option<&'a AtomicBool> {
        self.cancel
    }

    /// Runs a phase's work and adds up its time.
    pub(crate) fn measure<T>(&mut self, phase: fn(&mut Self) -> &mut f64, work: impl FnOnce() -> T) -> T {
        let begin = (self.clock)();
        let result = work();
        let end = (self.clock)();
        *phase(self) += end - begin;
        result
    }
}

//! Measurement buffer. What would the estimate be if every input had arrived in the order of its stamp? Inputs of the last seconds, each
//! with the filter after it; a late input is put in its place, and everything after it is applied again.
//!
//! So the estimate is a function of the set of inputs, in whatever order they arrive (re-application of history: Bar-Shalom 2002 calls it
//! the optimal answer to out-of-sequence measurements, at the cost of the memory). Between two of their readings the wheels are assumed to
//! turn evenly, and they give the turn until a gyro reading covers the time. Bounded in time and in number.

use std::collections::VecDeque;

use zenav_protocol::geometry::Pose2;
use zenav_protocol::time::Stamp;

use super::ekf::{Compared, Ekf, Input, Known, OdometryInterval};

/// An input older than this is dropped, s.
pub(super) const WINDOW: f64 = 2.0;
/// Most inputs kept; with more, less than the window is covered.
const CAPACITY: usize = 1024;
/// An input may be this far ahead of the wheels' newest reading, s; it waits for them.
const AHEAD: f64 = 1.0;
/// A gyro reading covers at most this time since the one before, s.
const LONGEST_SPAN: f64 = 0.5;

/// What became of an input.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Admission {
    /// Inserted.
    Taken,
    /// An input of its kind with this stamp is known already.
    Repeated,
    /// Older than the window.
    TooLate,
    /// Too far in the future.
    Ahead,
}

#[derive(Clone, Debug)]
struct Entry {
    stamp: Stamp,
    input: Input,
    /// Not applied yet.
    fresh: bool,
    after: Ekf,
}

impl Entry {
    fn order(&self) -> (Stamp, u8) {
        (self.stamp, self.input.rank())
    }

    fn wheels(&self) -> Option<[f64; 2]> {
        match self.input {
            Input::Wheels(angles) => Some(angles),
            _ => None,
        }
    }

    fn gyro(&self) -> Option<f64> {
        match self.input {
            Input::Gyro(rate) => Some(rate),
            _ => None,
        }
    }
}

/// Inputs in the order of their stamps.
#[derive(Clone, Debug)]
pub(super) struct MeasurementBuffer {
    /// The filter before the first entry.
    before: Ekf,
    entries: VecDeque<Entry>,
    /// Number of entries whose `after` is valid.
    applied: usize,
    /// Stamp of the wheels' newest reading.
    newest: Stamp,
}

impl MeasurementBuffer {
    /// Begins with a reading of the wheels.
    pub(super) fn new(mut before: Ekf, stamp: Stamp, wheels: [f64; 2]) -> Self {
        before.begin(stamp, wheels);
        Self {
            before,
            entries: VecDeque::new(),
            applied: 0,
            newest: stamp,
        }
    }

    /// The estimate at the wheels' newest reading, once [`Self::replay`] has been called.
    pub(super) fn ekf(&self) -> &Ekf {
        match self.applied.checked_sub(1).and_then(|last| self.entries.get(last)) {
            Some(entry) => &entry.after,
            None => &self.before,
        }
    }

    /// Carries everything over to another map frame.
    pub(super) fn moved(&mut self, new_from_old: Pose2) {
        self.before.moved(new_from_old);
        for entry in &mut self.entries {
            entry.input.moved(new_from_old);
            entry.after.moved(new_from_old);
        }
    }

    /// Stamp of the wheels' newest reading.
    pub(super) fn newest(&self) -> Stamp {
        self.newest
    }

    /// Inputs kept.
    #[cfg(test)]
    pub(super) fn len(&self) -> usize {
        self.entries.len()
    }

    /// Puts an input in its place; it counts from the next [`Self::replay`] on.
    pub(super) fn insert(&mut self, stamp: Stamp, input: Input) -> Admission {
        let is_wheels = matches!(input, Input::Wheels(_));
        if stamp < self.before.time() || self.newest.secs_since(stamp) > WINDOW {
            return Admission::TooLate;
        }
        if !is_wheels && stamp.secs_since(self.newest) > AHEAD {
            return Admission::Ahead;
        }
        let order = (stamp, input.rank());
        let place = self.entries.partition_point(|entry| entry.order() < order);
        if self.entries.get(place).is_some_and(|entry| entry.order() == order)
            || is_wheels && stamp == self.before.wheels_at()
        {
            return Admission::Repeated;
        }
        if self.entries.len() >= CAPACITY {
            // There is no room while every entry still waits for wheels.
            if place == 0 || !self.forget_first() {
                return Admission::TooLate;
            }
            return self.insert(stamp, input);
        }
        // Wheel and gyro readings cover the time since their previous one: everything after that is applied again.
        let told_since = match input {
            Input::Wheels(_) => self.since(place, |entry| entry.wheels().is_some()),
            Input::Gyro(_) => self.since(place, |entry| entry.gyro().is_some()),
            _ => place,
        };
        if is_wheels {
            self.newest = self.newest.max(stamp);
        }
        self.applied = self.applied.min(told_since);
        self.entries.insert(
            place,
            Entry {
                stamp,
                input,
                fresh: true,
                after: self.before.clone(),
            },
        );
        Admission::Taken
    }

    /// The first entry before `place` that is later than the last one of a kind.
    fn since(&self, place: usize, kind: impl Fn(&Entry) -> bool) -> usize {
        let last = self.entries.range(..place).rev().find(|entry| kind(entry));
        last.map_or(0, |last| {
            self.entries.partition_point(|entry| entry.stamp <= last.stamp)
        })
        .min(place)
    }

    /// Drops the oldest entry for good, if it has been applied.
    fn forget_first(&mut self) -> bool {
        if self.applied == 0 {
            return false;
        }
        if let Some(first) = self.entries.pop_front() {
            self.applied -= 1;
            self.before = first.after;
        }
        true
    }

    /// Applies all entries not applied yet, in the order of stamps; `report` gets each measurement that is compared for the first time.
    pub(super) fn replay(&mut self, known: Known<'_>, mut report: impl FnMut(Compared)) {
        let (mut wheels_ahead, mut gyro_ahead) = (self.applied, self.applied);
        while let Some(entry) = self
            .entries
            .get(self.applied)
            .filter(|entry| entry.stamp <= self.newest)
        {
            let index = self.applied;
            let mut ekf = self.ekf().clone();
            let wheels = self.next(&mut wheels_ahead, index, Entry::wheels);
            let gyro = self.next(&mut gyro_ahead, index, Entry::gyro);
            let motion = OdometryInterval {
                // No wheels are ahead only at the stamp of their newest reading itself, where no time is left to move.
                wheels: wheels.unwrap_or((entry.stamp, [0.0; 2])),
                gyro: gyro.filter(|(until, _)| {
                    ekf.gyro_at()
                        .is_some_and(|since| until.secs_since(since) < LONGEST_SPAN)
                }),
            };
            let compared = ekf.take(known, entry.stamp, &motion, &entry.input);
            if entry.fresh
                && let Some(compared) = compared
            {
                report(compared);
            }
            if let Some(entry) = self.entries.get_mut(index) {
                entry.after = ekf;
                entry.fresh = false;
            }
            self.applied += 1;
        }
        while self
            .entries
            .front()
            .is_some_and(|first| self.newest.secs_since(first.stamp) > WINDOW + LONGEST_SPAN)
            && self.forget_first()
        {}
    }

    /// The first entry of a kind from `index` on; `ahead` remembers where it was.
    fn next<T>(&self, ahead: &mut usize, index: usize, kind: impl Fn(&Entry) -> Option<T>) -> Option<(Stamp, T)> {
        *ahead = (*ahead).max(index);
        loop {
            let entry = self.entries.get(*ahead)?;
            if let Some(value) = kind(entry) {
                return Some((entry.stamp, value));
            }
            *ahead += 1;
        }
    }
}

//! Readiness. Whether a part can work now, and if not, which conditions are missing.
//!
//! A part is ready when it has started and all its conditions are met. It logs `ready` once, and `not ready` when a condition is lost
//! later. The link to the router is a condition with its own log lines: `router lost`, `router back`.

use std::sync::{Arc, LazyLock, Mutex, MutexGuard, PoisonError, Weak};

use crate::metrics::PART_READY;

/// The condition that every part has: its services and subscriptions are declared.
const STARTED: &str = "it has started";

/// Every part of this process.
static PARTS: LazyLock<Mutex<Vec<Weak<PartConditions>>>> = LazyLock::new(Mutex::default);

fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A part of this process, and the conditions that it waits for. Clones share the part; it is removed when the last clone is dropped.
#[derive(Clone, Debug)]
pub struct Readiness(Arc<PartConditions>);

#[derive(Debug)]
struct PartConditions {
    name: String,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    conditions: Vec<(String, bool)>,
    /// Whether `ready` was logged last.
    said_ready: bool,
}

impl State {
    fn is_ready(&self) -> bool {
        self.conditions.iter().all(|(_, met)| *met)
    }
}

/// A condition that a part waits for.
#[derive(Clone, Debug)]
pub struct Condition {
    part: Arc<PartConditions>,
    index: usize,
    /// Its loss is logged by the code that watches it.
    silent: bool,
}

impl Readiness {
    /// A part that has not started.
    #[must_use]
    pub fn new(name: &str) -> Self {
        let part = Self::unlisted(name);
        let mut parts = lock(&PARTS);
        parts.retain(|part| part.strong_count() > 0);
        parts.push(Arc::downgrade(&part.0));
        drop(parts);
        part
    }

    /// A session that is no part of this process, such as a command's client. It is not in the report and not in the metrics.
    #[must_use]
    pub fn unlisted(name: &str) -> Self {
        let part = Arc::new(PartConditions {
            name: name.to_owned(),
            state: Mutex::new(State {
                conditions: vec![(STARTED.to_owned(), false)],
                said_ready: false,
            }),
        });
        Self(part)
    }

    /// The part's name.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.0.name
    }

    /// Adds a condition, unmet at first. `what` is a statement such as `its map is loaded`.
    #[must_use]
    pub fn expects(&self, what: &str) -> Condition {
        self.condition(what, false)
    }

    /// Like [`Self::expects`], but the caller logs its loss.
    #[must_use]
    pub fn expects_silently(&self, what: &str) -> Condition {
        self.condition(what, true)
    }

    fn condition(&self, what: &str, silent: bool) -> Condition {
        let mut state = lock(&self.0.state);
        let conditions = &mut state.conditions;
        // A part that restarts reuses its condition.
        let index = conditions.iter().position(|(known, _)| known == what);
        let index = index.unwrap_or_else(|| {
            conditions.push((what.to_owned(), false));
            conditions.len() - 1
        });
        let condition = Condition {
            part: Arc::clone(&self.0),
            index,
            silent,
        };
        drop(state);
        condition.unmet();
        condition
    }

    /// The part has declared its services, subscriptions and conditions.
    pub fn started(&self) {
        let started = Condition {
            part: Arc::clone(&self.0),
            index: 0,
            silent: false,
        };
        started.met();
    }

    /// Whether the part is ready.
    #[must_use]
    pub fn is_ready(&self) -> bool {
        lock(&self.0.state).is_ready()
    }
}

impl Condition {
    /// The condition holds.
    pub fn met(&self) {
        self.set(true);
    }

    /// The condition no longer holds.
    pub fn unmet(&self) {
        self.set(false);
    }

    fn set(&self, met: bool) {
        let mut state = lock(&self.part.state);
        let Some((what, known)) = state.conditions.get_mut(self.index) else {
            return;
        };
        if std::mem::replace(known, met) == met {
            return;
        }
        let what = what.clone();
        let ready = state.is_ready();
        if ready && !state.said_ready {
            state.said_ready = true;
            tracing::info!(part = self.part.name, "ready");
        } else if !met && state.said_ready && !self.silent {
            state.said_ready = false;
            tracing::warn!(part = self.part.name, missing = what, "not ready");
        }
    }
}

/// Whether all conditions of this process are met, and a line for each, unmet ones first. A process without parts is not ready.
#[must_use]
pub fn report() -> (bool, String) {
    let parts: Vec<Arc<PartConditions>> = lock(&PARTS).iter().filter_map(Weak::upgrade).collect();
    let mut lines = Vec::new();
    for part in &parts {
        for (what, met) in &lock(&part.state).conditions {
            let word = if *met { "ok     " } else { "missing" };
            lines.push((*met, format!("{word} {}: {what}", part.name)));
        }
    }
    lines.sort();
    let ready = !lines.is_empty() && lines.iter().all(|(met, _)| *met);
    let text: Vec<String> = lines.into_iter().map(|(_, line)| line + "\n").collect();
    (ready, text.concat())
}

/// Updates the readiness gauges.
pub(crate) fn observe() {
    PART_READY.reset();
    let parts: Vec<Arc<PartConditions>> = lock(&PARTS).iter().filter_map(Weak::upgrade).collect();
    for part in parts {
        let ready = lock(&part.state).is_ready();
        PART_READY
            .with_label_values(&[&part.name])
            .set(f64::from(u8::from(ready)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_ready_when_it_has_started_and_all_it_named_is_met() {
        let part = Readiness::new("mapping-readiness");
        let (map, link) = (
            part.expects("its map is loaded"),
            part.expects_silently("a router is linked"),
        );
        part.started();
        map.met();
        assert!(!part.is_ready());
        assert!(report().1.contains("missing mapping-readiness: a router is linked\n"));
        link.met();
        assert!(part.is_ready());
        assert!(report().1.contains("ok      mapping-readiness: its map is loaded\n"));
        link.unmet();
        assert!(!part.is_ready(), "what is met may be lost again");
    }

    #[test]
    fn a_part_that_has_ended_is_forgotten() {
        let part = Readiness::new("gateway-readiness");
        assert!(report().1.contains("gateway-readiness"));
        drop(part);
        // A concurrent report, such as the other test's, may hold the part for a moment longer.
        let is_forgotten = (0..1000).any(|_| {
            std::thread::sleep(std::time::Duration::from_millis(1));
            !report().1.contains("gateway-readiness")
        });
        assert!(is_forgotten);
    }
}

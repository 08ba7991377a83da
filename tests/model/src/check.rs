//! Check. What does the checker find? All states within the bounds, or a shortest trace to a violation.

use std::fmt::Debug;
use std::hash::Hash;
use std::time::{Duration, Instant};

use stateright::{Checker as _, Expectation, HasDiscoveries, Model};

/// Transitions after which a search is given up: some gigabytes of states wait then.
const MOST_TRANSITIONS: usize = 20_000_000;

/// How far the bounds reach.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Size {
    /// All parts within a minute.
    Small,
    /// Minutes.
    Large,
}

/// A part of the contract: its rules, and the model with one of them taken out.
pub trait Part {
    /// The rules by which it holds.
    type Rule: Copy + Debug + PartialEq + Send + Sync + 'static;
    /// The system that is checked.
    type System: Model<State: Clone + Debug + Hash + PartialEq + Send + Sync, Action: Clone + Debug + PartialEq + Send + Sync>
        + Send
        + Sync
        + 'static;
    /// Its name.
    const NAME: &'static str;
    /// Every rule, with what it says.
    const RULES: &'static [(Self::Rule, &'static str)];

    /// The bounds, in words, one for each [`system`](Self::system).
    fn bounds(size: Size) -> Vec<String>;

    /// One of the systems that are checked, each within bounds of its own.
    fn system(size: Size, which: usize) -> Self::System;

    /// One of the small systems, in which the contract breaks without this rule.
    fn without(rule: Self::Rule) -> Self::System;
}

/// What a run of the checker found.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Different states.
    pub states: usize,
    /// Transitions.
    pub transitions: usize,
    /// Actions from the beginning to the state farthest away.
    pub depth: usize,
    /// Whether everything within the bounds was seen, if nothing is broken.
    pub is_complete: bool,
    /// Wall time.
    pub took: Duration,
    /// The claims that were checked.
    pub claims: Vec<&'static str>,
    /// The claim that does not hold, and the actions that lead there.
    pub violation: Option<(&'static str, Vec<String>)>,
    /// What must be possible and was not found.
    pub missing: Vec<&'static str>,
}

impl Outcome {
    /// Whether nothing is broken in all states within the bounds.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.violation.is_none() && self.is_complete
    }
}

/// Checks systems until everything was seen or a violation is found; `system` makes one.
///
/// The checker tells of the last violation that it came upon before it stopped. So it runs again, less deep each time, until there is none:
/// the trace is a shortest one.
pub fn check<M>(system: impl Fn() -> M) -> Outcome
where
    M: Model<State: Clone + Debug + Hash + PartialEq + Send + Sync, Action: Clone + Debug + PartialEq + Send + Sync>
        + Send
        + Sync
        + 'static,
{
    let mut outcome = search(system(), None);
    while let Some((_, trace)) = &outcome.violation {
        let shorter = search(system(), Some(trace.len()));
        match shorter.violation {
            Some(violation) => outcome.violation = Some(violation),
            None => break,
        }
    }
    outcome
}

/// Searches all states that fewer than `depth` actions lead to.
fn search<M>(system: M, depth: Option<usize>) -> Outcome
where
    M: Model<State: Clone + Debug + Hash + PartialEq + Send + Sync, Action: Clone + Debug + PartialEq + Send + Sync>
        + Send
        + Sync
        + 'static,
{
    let begun = Instant::now();
    let properties: Vec<(Expectation, &'static str)> = system
        .properties()
        .into_iter()
        .map(|property| (property.expectation, property.name))
        .collect();
    // One thread: then the search is breadth first.
    let builder = system.checker().finish_when(HasDiscoveries::AnyFailures);
    let mut builder = builder.target_state_count(MOST_TRANSITIONS);
    if let Some(depth) = depth {
        builder = builder.target_max_depth(depth + 1);
    }
    let checker = builder.spawn_bfs().join();
    let found = checker.discoveries();
    let fails = |(expectation, name): &(Expectation, &'static str)| {
        let path = found.get(name).filter(|_| expectation.discovery_is_failure())?;
        let actions = path.clone().into_actions().into_iter();
        Some((*name, actions.map(|action| format!("{action:?}")).collect::<Vec<_>>()))
    };
    let violation = properties.iter().filter_map(fails).min_by_key(|(_, trace)| trace.len());
    let is_missing = |(expectation, name): &&(Expectation, &'static str)| {
        violation.is_none() && *expectation == Expectation::Sometimes && !found.contains_key(name)
    };
    Outcome {
        states: checker.unique_state_count(),
        transitions: checker.state_count(),
        depth: checker.max_depth().saturating_sub(1),
        is_complete: checker.state_count() < MOST_TRANSITIONS,
        took: begun.elapsed(),
        claims: properties.iter().map(|(_, name)| *name).collect(),
        missing: properties.iter().filter(is_missing).map(|(_, name)| *name).collect(),
        violation,
    }
}

//! Check. Searches all states within the bounds, or finds a shortest trace to a violation.

use std::fmt::Debug;
use std::hash::Hash;
use std::time::{Duration, Instant};

use stateright::{Checker as _, Expectation, HasDiscoveries, Model};

/// Transitions after which a search is given up: by then some gigabytes of states are queued.
const MOST_TRANSITIONS: usize = 20_000_000;

/// Size of the bounds.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Size {
    /// For every test run: seconds.
    Small,
    /// The small searches, and further ones: minutes.
    Large,
}

/// Two rules that cover for one another: both, in words, and bounds in which the contract breaks without both, but not without either.
pub type Pair<R, B> = ([R; 2], &'static str, B);

/// A part of the contract: its rules, and its model with and without some of them.
pub trait ContractModel {
    /// The rules of the part.
    type Rule: Copy + Debug + PartialEq + Send + Sync + 'static;
    /// Bounds on the number of events.
    type Bounds: Copy + 'static;
    /// The checked system.
    type System: Model<State: Clone + Debug + Hash + PartialEq + Send + Sync, Action: Clone + Debug + PartialEq + Send + Sync>
        + Send
        + Sync
        + 'static;
    /// Name of the part.
    const NAME: &'static str;
    /// Every rule, in words.
    const RULES: &'static [(Self::Rule, &'static str)];
    /// Rules that cover for one another.
    const PAIRS: &'static [Pair<Self::Rule, Self::Bounds>] = &[];

    /// The bounds that are searched.
    fn scenarios(size: Size) -> Vec<Self::Bounds>;

    /// Bounds in which the contract breaks without this rule.
    fn breaks_in(rule: Self::Rule) -> Self::Bounds;

    /// The events that may happen within the bounds, and how often at most.
    fn events(bounds: &Self::Bounds) -> Vec<(u8, &'static str)>;

    /// The system, optionally without some rules.
    fn system(bounds: Self::Bounds, without: &'static [Self::Rule]) -> Self::System;

    /// The bounds in words.
    #[must_use]
    fn in_words(bounds: &Self::Bounds) -> String {
        let events = Self::events(bounds).into_iter().filter(|(count, _)| *count > 0);
        let events: Vec<String> = events.map(|(count, what)| format!("{count} {what}")).collect();
        events.join(", ")
    }
}

/// The outcome of a run of the checker.
#[derive(Clone, Debug)]
pub struct Outcome {
    /// Distinct states.
    pub states: usize,
    /// Transitions.
    pub transitions: usize,
    /// Actions from the initial state to the farthest state.
    pub depth: usize,
    /// Whether everything within the bounds was searched, if there is no violation.
    pub is_complete: bool,
    /// Wall time.
    pub took: Duration,
    /// The checked claims.
    pub claims: Vec<&'static str>,
    /// The violated claim, and the actions that lead there.
    pub violation: Option<(&'static str, Vec<String>)>,
    /// Claims that something is possible for which no example was found.
    pub missing: Vec<&'static str>,
}

impl Outcome {
    /// Whether all claims hold in all states within the bounds.
    #[must_use]
    pub fn holds(&self) -> bool {
        self.violation.is_none() && self.is_complete
    }
}

/// Checks a system, created by `system`, until everything is searched or a violation is found.
///
/// The checker reports the last violation found before it stopped. So it is run again, less deep each time, until there is none: the trace
/// is then a shortest one.
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

/// Searches all states that are reached by fewer than `depth` actions.
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
    // With one thread the search is breadth first.
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

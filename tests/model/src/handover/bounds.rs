//! Bounds. The bounds of each search, and the bounds in which the contract breaks without a rule.

use super::{Rule, System, TICK};
use crate::check::{Part, Size};

/// Bounds on the number of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bounds {
    pub(super) ticks: u8,
    pub(super) goals: u8,
    pub(super) ends: u8,
    pub(super) joins: u8,
    pub(super) reports: u8,
    pub(super) losses: u8,
    pub(super) copies: u8,
    pub(super) crashes: u8,
    pub(super) restarts: u8,
    pub(super) operators: u8,
}

/// This part of the contract.
#[derive(Debug)]
pub struct Handover;

impl Part for Handover {
    type Rule = Rule;
    type System = System;
    const NAME: &'static str = "handover";
    const RULES: &'static [(Rule, &'static str)] = &[
        (
            Rule::Wait,
            "the leader waits for every standby on the robot's list before it tells",
        ),
        (
            Rule::OffList,
            "a late standby is off the robot's list before anything is told without it",
        ),
        (
            Rule::OffListAnew,
            "a standby is off the robot's list before it is handed everything anew",
        ),
        (
            Rule::CaughtUp,
            "only a standby that holds everything gets onto the list",
        ),
        (Rule::Listed, "the robot lets only a mission on its list lead"),
        (Rule::ListOnDisk, "the list is on the robot's disk"),
        (Rule::Numbered, "reports are numbered, and a late one changes nothing"),
        (
            Rule::ReportEpoch,
            "a report counts for the leader and the epoch that it names",
        ),
        (Rule::StoredOnce, "writes under a number that is stored are refused"),
        (
            Rule::SharedOnDisk,
            "that others may hold newer goals is on the leader's disk before the robot lists them",
        ),
        (
            Rule::HeldUp,
            "a leader with standbys that was held up for over a second says nothing more",
        ),
    ];

    fn bounds(size: Size) -> Vec<String> {
        scenarios(size).iter().map(Bounds::in_words).collect()
    }

    fn system(size: Size, which: usize) -> System {
        System::new(scenarios(size).get(which).copied().unwrap_or(TAKEOVER), None)
    }

    fn without(rule: Rule) -> System {
        System::new(breaks_in(rule), Some(rule))
    }
}

impl Bounds {
    fn in_words(&self) -> String {
        let counts = [
            (self.goals, "goal(s)"),
            (self.ends, "end(s)"),
            (self.joins, "join(s), each in two pieces"),
            (self.reports, "report(s)"),
            (self.losses, "lost heartbeat(s)"),
            (self.copies, "cop(ies)"),
            (self.crashes, "crash(es) of a mission"),
            (self.restarts, "restart(s) of the robot"),
            (self.operators, "operator(s)"),
        ];
        let some = counts.iter().filter(|(count, _)| *count > 0);
        let some: Vec<String> = some.map(|(count, what)| format!("{count} {what}")).collect();
        format!("{}; {} ticks of {TICK} s", some.join(", "), self.ticks)
    }
}

/// A standby joins, and is listed; the leader dies or sleeps, and the standby takes over.
const TAKEOVER: Bounds = Bounds {
    ticks: 2,
    goals: 1,
    ends: 0,
    joins: 1,
    reports: 2,
    losses: 0,
    copies: 0,
    crashes: 1,
    restarts: 0,
    operators: 0,
};

/// Further faults, each within its own bounds.
const ENDS: Bounds = Bounds {
    ends: 1,
    crashes: 0,
    ..TAKEOVER
};
const REJOINS: Bounds = Bounds {
    joins: 2,
    crashes: 0,
    ticks: 0,
    ..TAKEOVER
};
const RESTARTS: Bounds = Bounds {
    restarts: 1,
    crashes: 0,
    ..TAKEOVER
};
const COPIES: Bounds = Bounds {
    copies: 1,
    crashes: 0,
    ticks: 0,
    ..TAKEOVER
};
const LOSES: Bounds = Bounds {
    losses: 1,
    crashes: 0,
    ..TAKEOVER
};
const OPERATED: Bounds = Bounds {
    operators: 1,
    crashes: 0,
    reports: 1,
    ticks: 3,
    ..TAKEOVER
};

fn scenarios(size: Size) -> Vec<Bounds> {
    let small = [TAKEOVER, ENDS, REJOINS, RESTARTS, COPIES, LOSES, OPERATED];
    match size {
        Size::Small => small.into(),
        Size::Large => {
            let more = |bounds: Bounds| Bounds {
                ticks: bounds.ticks + 1,
                reports: 3,
                crashes: 1,
                ..bounds
            };
            small.map(more).into()
        }
    }
}

/// The bounds in which the contract breaks without a rule.
const fn breaks_in(rule: Rule) -> Bounds {
    match rule {
        Rule::ListOnDisk => RESTARTS,
        Rule::StoredOnce => COPIES,
        Rule::OffListAnew => REJOINS,
        Rule::HeldUp => ENDS,
        _ => TAKEOVER,
    }
}

//! Bounds. The bounds of each search, and the bounds in which the contract breaks without a rule.

use super::{Rule, System};
use crate::check::{ContractModel, Pair, Size};

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

impl ContractModel for Handover {
    type Rule = Rule;
    type Bounds = Bounds;
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
        (
            Rule::StandbyShared,
            "a standby stores with each entry that others may hold newer goals",
        ),
    ];
    const PAIRS: &'static [Pair<Rule, Bounds>] = &[
        (
            [Rule::Session, Rule::StoredOnce],
            "an entry of an older session is refused, and so are writes under a number that is stored",
            REJOINS,
        ),
        (
            [Rule::Alone, Rule::StandbyShared],
            "a grant makes the new leader the only one on the list, and a standby stores with each entry that others may hold newer goals",
            TAKEOVER_WITHOUT_CRASH,
        ),
    ];

    fn scenarios(size: Size) -> Vec<Bounds> {
        let mut scenarios = vec![CRASHES, ENDS, REJOINS, RESTARTS_AT_ONCE, COPIES, LOSES];
        if size == Size::Large {
            scenarios.extend([TAKEOVER, RESTARTS, OPERATED]);
        }
        scenarios
    }

    fn breaks_in(rule: Rule) -> Bounds {
        match rule {
            Rule::ListOnDisk => RESTARTS_AT_ONCE,
            Rule::StoredOnce => COPIES,
            Rule::OffListAnew => REJOINS,
            Rule::HeldUp => ENDS,
            Rule::Listed | Rule::SharedOnDisk | Rule::StandbyShared => CRASHES,
            _ => TAKEOVER_WITHOUT_CRASH,
        }
    }

    fn events(bounds: &Bounds) -> Vec<(u8, &'static str)> {
        vec![
            (bounds.goals, "goal(s)"),
            (bounds.ends, "end(s)"),
            (bounds.joins, "join(s), each in two pieces"),
            (bounds.reports, "report(s)"),
            (bounds.losses, "lost heartbeat(s)"),
            (bounds.copies, "cop(ies)"),
            (bounds.crashes, "crash(es) of a mission"),
            (bounds.restarts, "restart(s) of the robot"),
            (bounds.operators, "operator(s)"),
            (bounds.ticks, "tick(s)"),
        ]
    }

    fn system(bounds: Bounds, without: &'static [Rule]) -> System {
        System::new(bounds, without)
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

const TAKEOVER_WITHOUT_CRASH: Bounds = Bounds { crashes: 0, ..TAKEOVER };

/// Further faults, each within its own bounds.
const CRASHES: Bounds = Bounds { reports: 1, ..TAKEOVER };
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
const RESTARTS_AT_ONCE: Bounds = Bounds { ticks: 0, ..RESTARTS };
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

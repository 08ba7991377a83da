//! Lease. Two missions and an operator compete for the lease of the robot's own [`Authority`]; the robot may restart.
//!
//! The network is implicit: any message that a client could have sent by now may arrive now, late, out of order or repeated. A request may
//! arrive at any time; a heartbeat or a command may arrive under any past grant. So all delays, orders, losses and copies are explored,
//! including clients that pause, die or never learn of their grant.

use std::collections::BTreeSet;

use stateright::{Model, Property};
use zenav_edge::authority::Authority;
use zenav_edge::config::EdgeConfig;
use zenav_edge::control_io::Persisted;
use zenav_edge::event_log::EventLog;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Heartbeat, LeaseAction, LeaseRequest, LeaseRole};
use zenav_protocol::time::Stamp;

use crate::check::{Part, Size};
use crate::text::Text;

/// Length of a tick, s: the lease (1 s) survives one tick and lapses with the second.
pub const TICK: f64 = 0.6;
/// Ticks that a lease survives without a heartbeat.
const LIVES: u8 = 1;

/// Rules that keep two holders from commanding at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Commands and heartbeats carry the epoch of their grant.
    Epoch,
    /// After a lapse even the same holder gets a new epoch.
    EpochAfterLapse,
    /// The epoch is on disk before the grant is sent.
    PersistBeforeReply,
    /// Nothing is granted while another holder of the same rank has a live lease.
    OneHolder,
    /// An operator outranks a mission.
    Rank,
    /// A lease lapses without heartbeats, by the robot's clock.
    Lapse,
    /// Heartbeats are numbered.
    Counter,
    /// A repeated request gets the first answer.
    FirstAnswer,
}

/// A client of the lease.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Who {
    /// A mission.
    MissionA,
    /// Another mission.
    MissionB,
    /// A person.
    Operator,
}

const ALL: [Who; 3] = [Who::MissionA, Who::MissionB, Who::Operator];

impl Who {
    const fn name(self) -> &'static str {
        match self {
            Self::MissionA => "mission-a",
            Self::MissionB => "mission-b",
            Self::Operator => "operator",
        }
    }

    const fn role(self) -> LeaseRole {
        match self {
            Self::Operator => LeaseRole::Operator,
            Self::MissionA | Self::MissionB => LeaseRole::Mission,
        }
    }
}

/// An action of the system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// A request for the lease arrives.
    Ask(Who),
    /// A request that was answered arrives again.
    AskAgain(Who, u8),
    /// A client gives the lease back.
    GiveBack(Who),
    /// A heartbeat arrives, sent under the grant of this number.
    Beat {
        /// The grant.
        grant: u8,
        /// The heartbeat's number.
        counter: u8,
    },
    /// Time passes on the robot.
    Tick,
    /// The robot's disk is written, if that does not happen before the reply.
    Write,
    /// The robot restarts.
    Restart,
}

/// A past grant: its holder, and the epoch in the reply.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Given {
    who: Who,
    epoch: u64,
}

/// The grant in force by the specification.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Grant {
    number: u8,
    who: Who,
    renewed: u8,
    counter: u8,
    given_back: bool,
}

/// The violated claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Broken {
    Taken,
    Refused,
    ActsTwice,
}

/// Bounds on the number of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bounds {
    ticks: u8,
    asks: u8,
    returns: u8,
    beats: u8,
    copies: u8,
    restarts: u8,
}

/// The robot, and everything that its clients can have sent.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct State {
    robot: Text<Authority>,
    disk: Text<Persisted>,
    now: u8,
    given: Vec<Given>,
    left: Bounds,
    numbers: u8,
    grant: Option<Grant>,
    answered: BTreeSet<(Who, u8)>,
    broken: Option<Broken>,
}

/// The system, optionally without one rule.
#[derive(Debug)]
pub struct System {
    bounds: Bounds,
    without: Option<Rule>,
    config: EdgeConfig,
}

impl System {
    fn has(&self, rule: Rule) -> bool {
        self.without != Some(rule)
    }
}

/// The robot of every part.
///
/// # Panics
/// Never: the name is valid.
#[must_use]
#[expect(clippy::expect_used, reason = "a constant name")]
pub fn config() -> EdgeConfig {
    let robot = Id::robot("r").expect("a proper name");
    EdgeConfig::new(robot, zenav_fixtures::robot("tiago"), Pose2::default())
}

/// The robot's clock after a number of ticks.
#[must_use]
pub fn clock(ticks: u8) -> Stamp {
    Stamp::from_secs(10.0 + TICK * f64::from(ticks))
}

/// An event log whose content is ignored.
#[must_use]
pub fn log() -> EventLog {
    EventLog::new("boot".to_owned())
}

impl State {
    /// Whether the grant in force is live by the specification.
    fn is_live(&self) -> bool {
        let lives = |grant: &Grant| !grant.given_back && self.now - grant.renewed <= LIVES;
        self.grant.as_ref().is_some_and(lives)
    }

    fn time(&self, system: &System) -> Stamp {
        if system.has(Rule::Lapse) {
            clock(self.now)
        } else {
            clock(self.grant.as_ref().map_or(self.now, |grant| grant.renewed))
        }
    }

    /// A heartbeat arrives that was sent under a grant.
    fn beat(&mut self, system: &System, grant: u8, counter: u8) -> Option<()> {
        let given = *self.given.get(usize::from(grant))?;
        let now = self.time(system);
        let carries = system.has(Rule::Epoch);
        let numbered = system.has(Rule::Counter);
        let beat = Heartbeat {
            holder: given.who.name().to_owned(),
            epoch: if carries { given.epoch } else { self.robot.epoch() },
            counter: if numbered {
                counter.into()
            } else {
                100 + u64::from(self.numbers)
            },
            echo: None,
        };
        self.numbers += u8::from(!numbered);
        self.robot.heartbeat(now, &beat);
        let (live, now) = (self.is_live(), self.now);
        let renews = |known: &&mut Grant| known.number == grant && counter > known.counter && live;
        if let Some(known) = self.grant.as_mut().filter(renews) {
            (known.renewed, known.counter) = (now, counter);
        }
        Some(())
    }

    /// Whether a command acts if it was sent under a grant and arrives now.
    fn is_admitted(&self, system: &System, given: &Given) -> bool {
        let is_holder = self.grant.as_ref().is_some_and(|known| known.who == given.who);
        let replaces = !system.has(Rule::Epoch) || !system.has(Rule::EpochAfterLapse) && is_holder;
        let epoch = if replaces { self.robot.epoch() } else { given.epoch };
        self.robot.admit(self.time(system), Some(epoch)).is_ok()
    }

    /// Whether commands act only if they were sent under the newest grant, and only while it is live.
    fn only_the_newest_commands(&self, system: &System) -> bool {
        let newest = self.grant.as_ref().filter(|_| self.is_live()).map(|grant| grant.number);
        let mut given = (0..).zip(&self.given);
        given.all(|(number, given)| newest == Some(number) || !self.is_admitted(system, given))
    }

    fn asked(&mut self, system: &System, who: Who, id: u8) {
        let now = self.time(system);
        let holder = self.grant.clone().filter(|_| self.is_live());
        if let Some(grant) = holder
            .as_ref()
            .filter(|grant| !system.has(Rule::OneHolder) && grant.who != who)
        {
            let (name, role) = (grant.who.name(), grant.who.role());
            let request = LeaseRequest::new(name, role, LeaseAction::Release, format!("taken{}", self.numbers));
            self.robot.lease(now, &request, &mut log());
            self.numbers += 1;
        }
        let role = if system.has(Rule::Rank) {
            who.role()
        } else {
            LeaseRole::Mission
        };
        let mut request = LeaseRequest::new(who.name(), role, LeaseAction::Acquire, format!("{who:?}{id}"));
        if !system.has(Rule::FirstAnswer) {
            request.request_id = format!("anew{}", self.numbers);
            self.numbers += 1;
        }
        let before = (self.robot.epoch(), self.robot.lease_state(now).live);
        let decision = self.robot.lease(now, &request, &mut log());
        self.persist(system);
        if !self.answered.insert((who, id)) {
            if before != (self.robot.epoch(), self.robot.lease_state(now).live) {
                self.broken.get_or_insert(Broken::ActsTwice);
            }
            return;
        }
        let outranks = |live: &Grant| who == Who::Operator && live.who != Who::Operator;
        match decision.answer {
            Ok(_) if holder.as_ref().is_some_and(|live| live.who == who) => {
                let now = self.now;
                if let Some(grant) = &mut self.grant {
                    grant.renewed = now;
                }
            }
            Ok(reply) => {
                if holder.as_ref().is_some_and(|live| !outranks(live)) {
                    self.broken.get_or_insert(Broken::Taken);
                }
                self.grant = Some(Grant {
                    number: self.given.len() as u8,
                    who,
                    renewed: self.now,
                    counter: 0,
                    given_back: false,
                });
                self.given.push(Given {
                    who,
                    epoch: reply.epoch,
                });
            }
            Err(_) => {
                if holder.as_ref().is_none_or(outranks) {
                    self.broken.get_or_insert(Broken::Refused);
                }
            }
        }
    }

    fn give_back(&mut self, system: &System, who: Who) {
        let id = format!("back{}", self.left.returns);
        let request = LeaseRequest::new(who.name(), who.role(), LeaseAction::Release, id);
        let now = self.time(system);
        let decision = self.robot.lease(now, &request, &mut log());
        self.persist(system);
        if let Some(grant) = self.grant.as_mut().filter(|grant| grant.who == who) {
            grant.given_back |= decision.answer.is_ok();
        }
    }

    fn persist(&mut self, system: &System) {
        if system.has(Rule::PersistBeforeReply)
            && let Some(written) = self.robot.unpersisted()
        {
            *self.disk = written;
        }
    }
}

impl Model for System {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        vec![State {
            robot: Text(Authority::new(&self.config, Persisted::default())),
            disk: Text::default(),
            now: 0,
            given: Vec::new(),
            left: self.bounds,
            numbers: 0,
            grant: None,
            answered: BTreeSet::new(),
            broken: None,
        }]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let left = &state.left;
        for who in ALL {
            actions.extend((left.asks > 0).then_some(Action::Ask(who)));
            let was_granted = state.given.iter().any(|given| given.who == who);
            actions.extend((was_granted && left.returns > 0).then_some(Action::GiveBack(who)));
        }
        if left.copies > 0 {
            actions.extend(state.answered.iter().map(|(who, id)| Action::AskAgain(*who, *id)));
        }
        if left.beats > 0 {
            for grant in (0..).take(state.given.len()) {
                // Counters in any order, and repeated.
                actions.extend((1..=self.bounds.beats).map(|counter| Action::Beat { grant, counter }));
            }
        }
        actions.extend((left.ticks > 0).then_some(Action::Tick));
        actions.extend((left.restarts > 0).then_some(Action::Restart));
        if !self.has(Rule::PersistBeforeReply) && state.robot.epoch() != state.disk.epoch {
            actions.push(Action::Write);
        }
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        match action {
            Action::Ask(who) => {
                state.left.asks -= 1;
                let id = state.left.asks;
                state.asked(self, who, id);
            }
            Action::AskAgain(who, id) => {
                state.left.copies -= 1;
                state.asked(self, who, id);
            }
            Action::GiveBack(who) => {
                state.left.returns -= 1;
                state.give_back(self, who);
            }
            Action::Beat { grant, counter } => {
                state.left.beats -= 1;
                state.beat(self, grant, counter)?;
            }
            Action::Tick => {
                state.left.ticks -= 1;
                state.now += 1;
            }
            Action::Write => {
                *state.disk = Persisted {
                    epoch: state.robot.epoch(),
                    ..Persisted::default()
                };
            }
            Action::Restart => {
                state.left.restarts -= 1;
                *state.robot = Authority::new(&self.config, state.disk.clone().0);
                state.grant = None;
                // A restarted robot has lost its answers, so a repeated request is a new one.
                state.answered.clear();
            }
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(
                "only the holder of the newest grant commands, while it lives",
                |system: &Self, state: &State| state.only_the_newest_commands(system),
            ),
            Property::always(
                "a lease lives no longer than its holder's own heartbeats keep it",
                |system: &Self, state: &State| !state.robot.lease_state(state.time(system)).live || state.is_live(),
            ),
            Property::always(
                "a live lease is taken by an operator from a mission, and by nobody else",
                |_, state: &State| state.broken != Some(Broken::Taken),
            ),
            Property::always(
                "an operator is refused by another operator alone, and a free lease is refused to nobody",
                |_, state: &State| state.broken != Some(Broken::Refused),
            ),
            Property::always("a request acts once, however often it arrives", |_, state: &State| {
                state.broken != Some(Broken::ActsTwice)
            }),
            Property::sometimes("a command acts", |system: &Self, state: &State| {
                state.given.iter().any(|given| state.is_admitted(system, given))
            }),
            Property::sometimes("the lease changes hands twice", |_, state: &State| {
                state.given.len() > 2
            }),
        ]
    }
}

/// This part of the contract.
#[derive(Debug)]
pub struct Lease;

impl Part for Lease {
    type Rule = Rule;
    type System = System;
    const NAME: &'static str = "lease";
    const RULES: &'static [(Rule, &'static str)] = &[
        (
            Rule::Epoch,
            "every grant has an epoch of its own, and what is sent under it carries it",
        ),
        (
            Rule::EpochAfterLapse,
            "after a lapse the same holder gets a new epoch as well",
        ),
        (
            Rule::PersistBeforeReply,
            "the epoch is on the robot's disk before the grant is told",
        ),
        (
            Rule::OneHolder,
            "nothing is granted while somebody of the same rank holds the lease",
        ),
        (Rule::Rank, "an operator outranks a mission"),
        (Rule::Lapse, "a lease lapses without heartbeats, by the robot's clock"),
        (Rule::Counter, "heartbeats are numbered, and a number renews once"),
        (Rule::FirstAnswer, "a repeated request gets the first answer"),
    ];

    fn bounds(size: Size) -> Vec<String> {
        let Bounds {
            ticks,
            asks,
            returns,
            beats,
            copies,
            restarts,
        } = bounds(size);
        vec![format!(
            "two missions and an operator; {asks} requests, {copies} of them again, {returns} returns, {beats} heartbeats and any number of \
             commands under any grant, {restarts} restarts of the robot, {ticks} ticks of {TICK} s"
        )]
    }

    fn system(size: Size, _which: usize) -> System {
        system(size, None)
    }

    fn without(rule: Rule) -> System {
        system(Size::Small, Some(rule))
    }
}

fn system(size: Size, without: Option<Rule>) -> System {
    System {
        bounds: bounds(size),
        without,
        config: config(),
    }
}

const fn bounds(size: Size) -> Bounds {
    match size {
        Size::Small => Bounds {
            ticks: 3,
            asks: 3,
            returns: 1,
            beats: 2,
            copies: 1,
            restarts: 1,
        },
        Size::Large => Bounds {
            ticks: 5,
            asks: 4,
            returns: 2,
            beats: 2,
            copies: 1,
            restarts: 1,
        },
    }
}

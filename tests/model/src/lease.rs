//! Lease. Two missions and an operator compete for the lease of the robot's own [`Authority`], over links of any delay; the robot may restart.
//!
//! The network is implicit: any message that a client could have sent by now may arrive now, late, out of order or repeated. A request may
//! arrive at any time; a heartbeat or a command may arrive under any past grant. So all delays, orders, losses and copies are explored,
//! including clients that pause, die or never learn of their grant.
//!
//! A request or a heartbeat may echo any past time of the robot: the later the message, and the later the state that its sender knew, the
//! older the echo. The robot measures the round trip from it, by which a grant lives longer until its first heartbeat. An echo may also be a
//! stamp of another clock, from before a restart of the robot.

use std::collections::BTreeSet;

use stateright::{Model, Property};
use zenav_edge::authority::Authority;
use zenav_edge::config::EdgeConfig;
use zenav_edge::control_io::Persisted;
use zenav_edge::event_log::EventLog;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::lease::LONGEST_ROUND_TRIP;
use zenav_protocol::messages::{Heartbeat, LeaseAction, LeaseRequest, LeaseRole};
use zenav_protocol::time::Stamp;

use crate::check::{ContractModel, Size};
use crate::text::Text;

/// Length of a tick, s: the lease survives one tick without a heartbeat and lapses with the second.
pub const TICK: f64 = 0.6;
/// Time to live of the lease, s.
const TTL: f64 = 1.0;
/// A long wait, ticks: a lease with the longest extension (10 s) survives it, and lapses one tick later.
const WAIT: u8 = 18;
/// Age of an echo that is older than the longest round trip, ticks.
const ANCIENT: u8 = 200;

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
    /// Until its first heartbeat a grant lives longer by the round trip of its request.
    RoundTrip,
    /// The first heartbeat ends this extension.
    UntilHeartbeat,
    /// The extension is capped at the longest round trip.
    Longest,
    /// An echo of the future is no round trip.
    Future,
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

/// The robot's time as a client knows it, sent back to the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Echo {
    /// The time of a past tick.
    At(u8),
    /// A stamp of another clock, long before this one.
    Ancient,
    /// A stamp of another clock, in the future of this one.
    Future,
}

impl Echo {
    fn stamp(self) -> Stamp {
        match self {
            Self::At(tick) => clock(tick),
            Self::Ancient => Stamp::ZERO,
            Self::Future => clock(u8::MAX),
        }
    }

    /// The round trip that it shows, ticks.
    const fn age(self, now: u8) -> u8 {
        match self {
            Self::At(tick) => now - tick,
            Self::Ancient => ANCIENT,
            Self::Future => 0,
        }
    }
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
    Ask(Who, Option<Echo>),
    /// A request that was answered arrives again.
    AskAgain(Request),
    /// A client gives the lease back.
    GiveBack(Who),
    /// A heartbeat arrives, sent under the grant of this number.
    Beat {
        /// The grant.
        grant: u8,
        /// The heartbeat's number.
        counter: u8,
        /// Its echo.
        echo: Option<Echo>,
    },
    /// Time passes on the robot.
    Tick,
    /// Much time passes on the robot, and nothing arrives.
    Wait,
    /// The robot's disk is written, if that does not happen before the reply.
    Write,
    /// The robot restarts.
    Restart,
}

/// A request for the lease: its sender, its number and its echo.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Request {
    who: Who,
    id: u8,
    echo: Option<Echo>,
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
    /// Round trip of its request until its first heartbeat, ticks.
    extra: u8,
    /// The newest and the longest round trip of the heartbeats that renewed it, ticks.
    round_trips: Option<(u8, u8)>,
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
    waits: u8,
    asks: u8,
    returns: u8,
    beats: u8,
    copies: u8,
    restarts: u8,
    /// Messages with an echo of the robot's clock.
    echoes: u8,
    /// Messages with an echo of another clock.
    foreign: u8,
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
    answered: BTreeSet<Request>,
    /// Whether a first heartbeat renewed a grant that would have lapsed without its extension.
    is_slow: bool,
    broken: Option<Broken>,
}

/// The system, optionally without some rules.
#[derive(Debug)]
pub struct System {
    bounds: Bounds,
    without: &'static [Rule],
    config: EdgeConfig,
}

impl System {
    fn has(&self, rule: Rule) -> bool {
        !self.without.contains(&rule)
    }

    /// The echo of a request as the robot receives it.
    fn echoed(&self, echo: Option<Echo>) -> Option<Stamp> {
        let echo = echo.filter(|_| self.has(Rule::RoundTrip))?;
        Some(match echo {
            Echo::Future if !self.has(Rule::Future) => Echo::Ancient.stamp(),
            echo => echo.stamp(),
        })
    }

    /// The echoes that a message may carry.
    fn echoes(state: &State) -> Vec<Option<Echo>> {
        let mut echoes = vec![None];
        if state.left.echoes > 0 {
            echoes.extend((0..=state.now).map(|tick| Some(Echo::At(tick))));
        }
        if state.left.foreign > 0 {
            echoes.extend([Some(Echo::Ancient), Some(Echo::Future)]);
        }
        echoes
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

/// Whether a lease still lives at this age (ticks since its grant or last heartbeat), with this extension (ticks).
#[must_use]
pub fn lives(age: u8, extra: u8) -> bool {
    TICK * f64::from(age) <= TTL + round_trip(extra)
}

/// The round trip that the robot measures, s.
fn round_trip(ticks: u8) -> f64 {
    (TICK * f64::from(ticks)).min(LONGEST_ROUND_TRIP.as_secs_f64())
}

/// Id of a start of the robot.
#[must_use]
pub fn boot_id(boot: usize) -> String {
    format!("boot{boot}")
}

/// An event log of this start, whose content is ignored.
#[must_use]
pub fn log(boot: usize) -> EventLog {
    EventLog::new(boot_id(boot))
}

impl State {
    /// Whether the grant in force is live by the specification.
    fn is_live(&self) -> bool {
        let is_live = |grant: &Grant| !grant.given_back && lives(self.now - grant.renewed, grant.extra);
        self.grant.as_ref().is_some_and(is_live)
    }

    fn time(&self, system: &System) -> Stamp {
        let now = clock(self.now);
        match &self.grant {
            Some(grant) if !system.has(Rule::Lapse) => clock(grant.renewed),
            // The robot's clock stops for as long as the cap shortens the extension.
            Some(grant) if !system.has(Rule::Longest) => {
                let excess = TICK * f64::from(grant.extra) - round_trip(grant.extra);
                now.plus_secs(-excess).max(clock(grant.renewed))
            }
            _ => now,
        }
    }

    fn spend(&mut self, echo: Option<Echo>) {
        match echo {
            Some(Echo::At(_)) => self.left.echoes -= 1,
            Some(Echo::Ancient | Echo::Future) => self.left.foreign -= 1,
            None => {}
        }
    }

    /// A heartbeat arrives that was sent under a grant.
    fn beat(&mut self, system: &System, grant: u8, counter: u8, echo: Option<Echo>) -> Option<()> {
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
            echo: echo.map(Echo::stamp),
        };
        self.numbers += u8::from(!numbered);
        let live = self.is_live();
        let renews = |known: &&mut Grant| known.number == grant && counter > known.counter && live;
        let renewed = self.grant.as_mut().filter(renews);
        if renewed.is_some() && echo.is_none() && !system.has(Rule::UntilHeartbeat) {
            // Renews as a command does, which leaves the extension.
            self.robot.renew_as_operator(now);
        } else {
            self.robot.heartbeat(now, &beat, &mut log(0));
        }
        self.robot.take_measured();
        if let Some(known) = renewed {
            self.is_slow |= known.counter == 0 && !lives(self.now - known.renewed, 0);
            (known.renewed, known.counter, known.extra) = (self.now, counter, 0);
            if let Some(newest) = echo.map(|echo| echo.age(self.now)) {
                let longest = known.round_trips.map_or(newest, |(_, longest)| longest.max(newest));
                known.round_trips = Some((newest, longest));
            }
        }
        Some(())
    }

    /// Whether the round trip that the robot tells is one of the heartbeats that renewed the lease.
    fn is_measured(&self) -> bool {
        let known = self.grant.as_ref().and_then(|grant| grant.round_trips);
        match (self.robot.round_trip_secs(), known) {
            (None, None) => true,
            (Some(told), Some((newest, longest))) => {
                (round_trip(newest) - 1e-6..=round_trip(longest) + 1e-6).contains(&told)
            }
            _ => false,
        }
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

    fn asked(&mut self, system: &System, asked: Request) {
        let Request { who, id, echo } = asked;
        let now = self.time(system);
        let holder = self.grant.clone().filter(|_| self.is_live());
        if let Some(grant) = holder
            .as_ref()
            .filter(|grant| !system.has(Rule::OneHolder) && grant.who != who)
        {
            let (name, role) = (grant.who.name(), grant.who.role());
            let request = LeaseRequest::new(name, role, LeaseAction::Release, format!("taken{}", self.numbers));
            self.robot.lease(now, &request, true, &mut log(0));
            self.numbers += 1;
        }
        let role = if system.has(Rule::Rank) {
            who.role()
        } else {
            LeaseRole::Mission
        };
        let mut request = LeaseRequest {
            echo: system.echoed(echo),
            ..LeaseRequest::new(who.name(), role, LeaseAction::Acquire, format!("{who:?}{id}"))
        };
        if !system.has(Rule::FirstAnswer) {
            request.request_id = format!("anew{}", self.numbers);
            self.numbers += 1;
        }
        let before = (self.robot.epoch(), self.robot.lease_state(now).live);
        let decision = self.robot.lease(now, &request, true, &mut log(0));
        self.robot.take_measured();
        self.persist(system);
        if !self.answered.insert(asked) {
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
                    extra: echo.map_or(0, |echo| echo.age(self.now)),
                    round_trips: None,
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
        let decision = self.robot.lease(now, &request, true, &mut log(0));
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
            is_slow: false,
            broken: None,
        }]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let left = &state.left;
        let echoes = Self::echoes(state);
        for who in ALL {
            if left.asks > 0 {
                actions.extend(echoes.iter().map(|echo| Action::Ask(who, *echo)));
            }
            let was_granted = state.given.iter().any(|given| given.who == who);
            actions.extend((was_granted && left.returns > 0).then_some(Action::GiveBack(who)));
        }
        if left.copies > 0 {
            actions.extend(state.answered.iter().map(|request| Action::AskAgain(*request)));
        }
        if left.beats > 0 {
            for grant in (0..).take(state.given.len()) {
                // Counters in any order, and repeated.
                for counter in 1..=self.bounds.beats {
                    actions.extend(echoes.iter().map(|&echo| Action::Beat { grant, counter, echo }));
                }
            }
        }
        actions.extend((left.ticks > 0).then_some(Action::Tick));
        actions.extend((left.waits > 0).then_some(Action::Wait));
        actions.extend((left.restarts > 0).then_some(Action::Restart));
        if !self.has(Rule::PersistBeforeReply) && state.robot.epoch() != state.disk.epoch {
            actions.push(Action::Write);
        }
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        match action {
            Action::Ask(who, echo) => {
                state.left.asks -= 1;
                state.spend(echo);
                let id = state.left.asks;
                state.asked(self, Request { who, id, echo });
            }
            Action::AskAgain(request) => {
                state.left.copies -= 1;
                state.asked(self, request);
            }
            Action::GiveBack(who) => {
                state.left.returns -= 1;
                state.give_back(self, who);
            }
            Action::Beat { grant, counter, echo } => {
                state.left.beats -= 1;
                state.spend(echo);
                state.beat(self, grant, counter, echo)?;
            }
            Action::Tick => {
                state.left.ticks -= 1;
                state.now += 1;
            }
            Action::Wait => {
                state.left.waits -= 1;
                state.now += WAIT;
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
            Property::always(
                "a lease lives no longer than its heartbeats, or its request's round trip before the first, allow",
                |system: &Self, state: &State| !state.robot.lease_state(state.time(system)).live || state.is_live(),
            ),
            Property::always(
                "a lease lives as long as that: over a slow link it waits for its first heartbeat",
                |system: &Self, state: &State| state.robot.lease_state(state.time(system)).live || !state.is_live(),
            ),
            Property::always(
                "only the holder of the newest grant commands, while it lives",
                |system: &Self, state: &State| state.only_the_newest_commands(system),
            ),
            Property::always(
                "the round trip that the robot tells is one of the heartbeats that renewed the lease",
                |_, state: &State| state.is_measured(),
            ),
            Property::sometimes("a command acts", |system: &Self, state: &State| {
                state.given.iter().any(|given| state.is_admitted(system, given))
            }),
            Property::sometimes("the lease changes hands twice", |_, state: &State| {
                state.given.len() > 2
            }),
            Property::sometimes(
                "a first heartbeat comes after the time to live, and renews",
                |_, state: &State| state.is_slow,
            ),
        ]
    }
}

/// This part of the contract.
#[derive(Debug)]
pub struct Lease;

impl ContractModel for Lease {
    type Rule = Rule;
    type Bounds = Bounds;
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
        (
            Rule::RoundTrip,
            "until its first heartbeat a grant lives longer by the round trip of its request",
        ),
        (Rule::UntilHeartbeat, "the first heartbeat ends this extension"),
        (Rule::Longest, "the extension is at most the longest round trip, 10 s"),
        (Rule::Future, "an echo of the future is no round trip"),
    ];

    fn scenarios(size: Size) -> Vec<Bounds> {
        let mut scenarios = vec![COMPETE, RETURNS, BEATS, COPIES, SLOW, MEASURED, FOREIGN];
        if size == Size::Large {
            scenarios.extend([
                Bounds {
                    beats: 2,
                    ticks: 4,
                    ..COMPETE
                },
                Bounds {
                    asks: 3,
                    returns: 1,
                    ..COPIES
                },
                Bounds {
                    beats: 2,
                    echoes: 2,
                    ticks: 4,
                    ..SLOW
                },
                Bounds {
                    restarts: 1,
                    beats: 2,
                    ..FOREIGN
                },
            ]);
        }
        scenarios
    }

    fn breaks_in(rule: Rule) -> Bounds {
        match rule {
            Rule::Epoch | Rule::EpochAfterLapse | Rule::OneHolder | Rule::Rank | Rule::Lapse => COMPETE,
            Rule::Counter => BEATS,
            Rule::PersistBeforeReply | Rule::FirstAnswer => COPIES,
            Rule::RoundTrip | Rule::UntilHeartbeat => SLOW,
            Rule::Longest | Rule::Future => FOREIGN,
        }
    }

    fn events(bounds: &Bounds) -> Vec<(u8, &'static str)> {
        vec![
            (bounds.asks, "request(s)"),
            (bounds.returns, "return(s)"),
            (bounds.beats, "heartbeat(s)"),
            (bounds.echoes, "echo(es)"),
            (bounds.foreign, "echo(es) of another clock"),
            (bounds.copies, "request(s) again"),
            (bounds.restarts, "restart(s) of the robot"),
            (bounds.ticks, "tick(s)"),
            (bounds.waits, "wait(s) of 18 ticks"),
        ]
    }

    fn system(bounds: Bounds, without: &'static [Rule]) -> System {
        System {
            bounds,
            without,
            config: config(),
        }
    }
}

const NONE: Bounds = Bounds {
    ticks: 0,
    waits: 0,
    asks: 0,
    returns: 0,
    beats: 0,
    copies: 0,
    restarts: 0,
    echoes: 0,
    foreign: 0,
};

/// Three requests, and commands under every grant.
const COMPETE: Bounds = Bounds {
    asks: 3,
    beats: 1,
    ticks: 3,
    ..NONE
};
/// Further events, each within its own bounds.
const RETURNS: Bounds = Bounds {
    returns: 1,
    ticks: 1,
    ..COMPETE
};
const BEATS: Bounds = Bounds {
    asks: 2,
    beats: 2,
    ticks: 3,
    ..NONE
};
const COPIES: Bounds = Bounds {
    asks: 2,
    copies: 1,
    restarts: 1,
    ticks: 2,
    ..NONE
};
const SLOW: Bounds = Bounds {
    asks: 2,
    beats: 1,
    echoes: 1,
    ticks: 3,
    ..NONE
};
const MEASURED: Bounds = Bounds {
    asks: 1,
    beats: 2,
    echoes: 2,
    ticks: 2,
    ..NONE
};
const FOREIGN: Bounds = Bounds {
    asks: 2,
    beats: 1,
    foreign: 1,
    ticks: 1,
    waits: 1,
    ..NONE
};

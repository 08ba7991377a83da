//! Goals. A goal whose mission may crash: a client submits goals, pauses, resumes and cancels them, and repeats each request until it is
//! answered; the mission keeps them in its [`GoalTable`], and may crash between any two effects.
//!
//! A step of the mission ends in effects: records that are stored in one transaction, and messages to the client and to subscribers. A
//! crash loses the table and the pending effects; the disk stays. A message that was sent cannot be taken back.

use std::collections::{BTreeMap, BTreeSet};

use stateright::{Model, Property};
use zenav_mission::{GoalTable, Record, StoredGoal, goal_reply};
use zenav_protocol::messages::{GoalPhase, GoalReply, GoalRequest};
use zenav_protocol::time::Stamp;

use crate::check::{ContractModel, Size};
use crate::network::Network;
use crate::text::Text;

/// Rules that keep a goal from being lost, repeated or ended twice.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Records are stored before anything is told.
    PersistFirst,
    /// A step's records are stored all or none.
    Transaction,
    /// A goal sent again under its id is the same goal.
    SameId,
    /// An ended goal keeps its end.
    EndOnce,
    /// A repeated request gets its first answer.
    FirstAnswer,
    /// After a start, ends that may not have been told are told again.
    TellAgain,
}

/// A client's request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Request {
    /// Submit the goal.
    Submit,
    /// Pause the goal; the number identifies the request.
    Pause(u8),
    /// Resume it.
    Resume(u8),
    /// Cancel it.
    Cancel(u8),
}

/// A message that was sent and cannot be taken back.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Told {
    /// The goal was accepted.
    Accepted,
    /// A request was answered.
    Answered(Request),
    /// The goal's phase, to subscribers.
    Phase(Phase),
}

/// A goal's phase, sortable.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Phase {
    /// Queued.
    Accepted,
    /// Being driven.
    Active,
    /// Paused.
    Paused,
    /// Ended successfully.
    Succeeded,
    /// Cancelled by a client.
    Canceled,
}

/// An action of the system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// A client sends a request, perhaps again.
    Send(Request),
    /// A request arrives.
    Arrives(Request),
    /// The mission begins to drive the goal.
    Drive,
    /// The robot has arrived.
    Succeed,
    /// The first pending effect of a step is carried out.
    CarryOut,
    /// The mission crashes.
    Crash,
    /// The mission restarts.
    Start,
}

/// Bounds on the number of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bounds {
    submits: u8,
    repeats: u8,
    pauses: u8,
    cancels: u8,
    crashes: u8,
}

/// An effect of a step.
#[derive(Clone, Debug, PartialEq)]
enum Effect {
    /// Records to store, and the request that acts once they are stored.
    Store(Vec<Record>, Option<Request>),
    Tell(Told),
}

/// Contents of the disk.
#[derive(Clone, Debug, Default)]
struct Disk {
    goals: BTreeMap<String, StoredGoal>,
    answers: Vec<(String, GoalReply)>,
}

/// The mission, its disk, its clients.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct State {
    table: Text<Option<GoalTable>>,
    effects: Text<Vec<Effect>>,
    disk: Text<Disk>,
    network: Network<Request>,
    left: Bounds,
    /// Requests that were sent so far.
    sent: BTreeSet<Request>,
    told: BTreeSet<Told>,
    /// Whether another phase was told after an end.
    told_after_end: bool,
    /// Number of times that each request has acted, on disk.
    acted: BTreeMap<Request, u8>,
}

/// The system, optionally without some rules.
#[derive(Debug)]
pub struct System {
    bounds: Bounds,
    without: &'static [Rule],
}

const GOAL: &str = "g";

fn goal() -> GoalRequest {
    GoalRequest {
        id: Some(GOAL.to_owned()),
        x: Some(1.0),
        y: Some(1.0),
        ..GoalRequest::default()
    }
}

const fn phase(phase: GoalPhase) -> Phase {
    match phase {
        GoalPhase::Accepted => Phase::Accepted,
        GoalPhase::Active => Phase::Active,
        GoalPhase::Paused => Phase::Paused,
        GoalPhase::Canceled => Phase::Canceled,
        _ => Phase::Succeeded,
    }
}

impl System {
    fn has(&self, rule: Rule) -> bool {
        !self.without.contains(&rule)
    }

    /// Ends a step: queues its effects in order.
    fn end(&self, state: &mut State, table: &mut GoalTable, served: Served) {
        let records = table.take_records();
        let phases = table.take_changed();
        let told = phases
            .iter()
            .filter(|goal| goal.id == GOAL)
            .map(|goal| Told::Phase(phase(goal.state)));
        let told = told.chain(served.ends_again.then_some(Told::Phase(Phase::Canceled)));
        let mut effects: Vec<Effect> = told.chain(served.answer).map(Effect::Tell).collect();
        if !records.is_empty() {
            let place = if self.has(Rule::PersistFirst) { 0 } else { effects.len() };
            let batches = if self.has(Rule::Transaction) {
                vec![Effect::Store(records, served.acts)]
            } else {
                let acts = |record: &Record| served.acts.filter(|_| matches!(record, Record::Goal(_)));
                records
                    .into_iter()
                    .map(|record| Effect::Store(vec![record.clone()], acts(&record)))
                    .collect()
            };
            effects.splice(place..place, batches);
        }
        state.effects.0 = effects;
    }

    fn serve(&self, table: &mut GoalTable, request: Request) -> Option<Served> {
        if request == Request::Submit {
            // Refusals are not modelled: the client asks again.
            let known = table.resubmitted(&goal()).filter(|_| self.has(Rule::SameId));
            let acts = known.is_none().then_some(request);
            match known {
                Some(known) => drop(known.ok()?),
                None => table.accept("r", GOAL.to_owned(), goal(), false, Stamp(1)),
            }
            return Some(Served::answered(Told::Accepted, acts));
        }
        let (id, answer) = (format!("{request:?}"), Told::Answered(request));
        if self.has(Rule::FirstAnswer) && table.answered(&id).is_some() {
            return Some(Served::answered(answer, None));
        }
        let mut served = Served::answered(answer, Some(request));
        match (request, table.get(GOAL)?.state.state) {
            (Request::Pause(_), GoalPhase::Active) => table.change(GOAL, |goal| goal.state.state = GoalPhase::Paused),
            (Request::Resume(_), GoalPhase::Paused) => table.change(GOAL, |goal| goal.state.state = GoalPhase::Active),
            (Request::Cancel(_), _) => {
                if !table.end(GOAL, GoalPhase::Canceled, None, Stamp(2)) {
                    served.acts = None;
                    served.ends_again = !self.has(Rule::EndOnce);
                }
            }
            // Refused: the client may send a new request.
            _ => return None,
        }
        table.keep_answer(id, goal_reply(&table.get(GOAL)?.state));
        Some(served)
    }
}

/// The result of serving a request.
#[derive(Clone, Copy, Debug, Default)]
struct Served {
    answer: Option<Told>,
    /// The request, if it changes something.
    acts: Option<Request>,
    ends_again: bool,
}

impl Served {
    const fn answered(answer: Told, acts: Option<Request>) -> Self {
        Self {
            answer: Some(answer),
            acts,
            ends_again: false,
        }
    }
}

impl State {
    fn tell(&mut self, told: Told) {
        if let Told::Phase(phase) = told {
            let ended = [Phase::Succeeded, Phase::Canceled].map(|end| (end, self.told.contains(&Told::Phase(end))));
            self.told_after_end |= ended.iter().any(|(end, was_told)| *was_told && *end != phase);
        }
        self.told.insert(told);
    }

    fn store(&mut self, records: &[Record]) {
        let disk = &mut self.disk.0;
        for record in records {
            match record {
                Record::Goal(goal) => {
                    disk.goals.insert(goal.state.id.clone(), (**goal).clone());
                }
                Record::Answer(id, reply) => disk.answers.push((id.clone(), reply.clone())),
                _ => {}
            }
        }
    }

    fn on_disk(&self) -> Option<GoalPhase> {
        self.disk.goals.get(GOAL).map(|goal| goal.state.state)
    }

    fn in_table(&self) -> Option<GoalPhase> {
        Some(self.table.0.as_ref()?.get(GOAL)?.state.state)
    }

    fn is_quiet(&self) -> bool {
        self.table.is_some() && self.effects.is_empty()
    }
}

impl Model for System {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        vec![State {
            table: Text(Some(GoalTable::default())),
            effects: Text(Vec::new()),
            disk: Text(Disk::default()),
            network: Network::default(),
            left: self.bounds,
            sent: BTreeSet::new(),
            told: BTreeSet::new(),
            told_after_end: false,
            acted: BTreeMap::new(),
        }]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let left = &state.left;
        actions.extend((left.submits > 0).then_some(Action::Send(Request::Submit)));
        if state.sent.contains(&Request::Submit) {
            actions.extend((left.pauses > 0).then_some(Action::Send(Request::Pause(left.pauses))));
            actions.extend((left.pauses > 0).then_some(Action::Send(Request::Resume(left.pauses))));
            actions.extend((left.cancels > 0).then_some(Action::Send(Request::Cancel(left.cancels))));
        }
        if left.repeats > 0 {
            actions.extend(state.sent.iter().map(|request| Action::Send(*request)));
        }
        if state.is_quiet() {
            actions.extend(state.network.under_way().map(|request| Action::Arrives(*request)));
            actions.extend((state.in_table() == Some(GoalPhase::Accepted)).then_some(Action::Drive));
            actions.extend((state.in_table() == Some(GoalPhase::Active)).then_some(Action::Succeed));
        }
        match &state.table.0 {
            Some(_) => {
                actions.extend((!state.effects.is_empty()).then_some(Action::CarryOut));
                actions.extend((left.crashes > 0).then_some(Action::Crash));
            }
            None => actions.push(Action::Start),
        }
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        match action {
            Action::Send(request) => {
                if state.sent.insert(request) {
                    match request {
                        Request::Submit => state.left.submits -= 1,
                        Request::Pause(_) | Request::Resume(_) => state.left.pauses -= 1,
                        Request::Cancel(_) => state.left.cancels -= 1,
                    }
                } else {
                    state.left.repeats -= 1;
                }
                state.network.send(request);
            }
            Action::Arrives(request) => {
                state.network.arrives(&request);
                let mut table = state.table.0.take()?;
                let served = self.serve(&mut table, request).unwrap_or_default();
                self.end(&mut state, &mut table, served);
                state.table.0 = Some(table);
            }
            Action::Drive => {
                let mut table = state.table.0.take()?;
                table.change(GOAL, |goal| goal.state.state = GoalPhase::Active);
                self.end(&mut state, &mut table, Served::default());
                state.table.0 = Some(table);
            }
            Action::Succeed => {
                let mut table = state.table.0.take()?;
                table.end(GOAL, GoalPhase::Succeeded, None, Stamp(2));
                self.end(&mut state, &mut table, Served::default());
                state.table.0 = Some(table);
            }
            Action::CarryOut => match state.effects.remove(0) {
                Effect::Store(records, acts) => {
                    state.store(&records);
                    if let Some(request) = acts {
                        *state.acted.entry(request).or_default() += 1;
                    }
                }
                Effect::Tell(told) => state.tell(told),
            },
            Action::Crash => {
                state.left.crashes -= 1;
                state.table.0 = None;
                // Effects that are not carried out are lost.
                state.effects.0.clear();
            }
            Action::Start => {
                let Disk { goals, answers } = state.disk.0.clone();
                let mut table = GoalTable::new(goals.into_values().collect(), answers);
                if !self.has(Rule::TellAgain) {
                    table.take_changed();
                }
                self.end(&mut state, &mut table, Served::default());
                state.table.0 = Some(table);
            }
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always("an acknowledged goal is never lost", |_, state: &State| {
                !state.told.contains(&Told::Accepted) || state.on_disk().is_some()
            }),
            Property::always(
                "a goal ends once: after an end nothing else is told",
                |_, state: &State| !state.told_after_end,
            ),
            Property::always("an end that was told is on disk", |_, state: &State| {
                let told = |end| state.told.contains(&Told::Phase(end));
                !(told(Phase::Succeeded) || told(Phase::Canceled))
                    || state.on_disk().is_some_and(|phase| phase.is_end())
            }),
            Property::always(
                "a request acts once, however often it is sent; a goal is one goal",
                |_, state: &State| state.acted.values().all(|times| *times <= 1),
            ),
            Property::always(
                "an end on disk is told, at the latest after the next start",
                |_, state: &State| {
                    let end = state.on_disk().filter(|phase| phase.is_end());
                    end.is_none_or(|end| !state.is_quiet() || state.told.contains(&Told::Phase(phase(end))))
                },
            ),
            Property::sometimes("a goal succeeds after a crash", |system: &Self, state: &State| {
                state.left.crashes < system.bounds.crashes && state.told.contains(&Told::Phase(Phase::Succeeded))
            }),
            Property::sometimes("a goal is paused, resumed and cancelled", |_, state: &State| {
                let told = |phase| state.told.contains(&Told::Phase(phase));
                told(Phase::Paused)
                    && told(Phase::Canceled)
                    && state.acted.keys().any(|request| matches!(request, Request::Resume(_)))
            }),
        ]
    }
}

/// This part of the contract.
#[derive(Debug)]
pub struct Goals;

impl ContractModel for Goals {
    type Rule = Rule;
    type Bounds = Bounds;
    type System = System;
    const NAME: &'static str = "goals";
    const RULES: &'static [(Rule, &'static str)] = &[
        (Rule::PersistFirst, "what is told was stored before"),
        (Rule::Transaction, "a step's records are stored all or none"),
        (Rule::SameId, "a goal sent again under its id is the same goal"),
        (Rule::EndOnce, "a goal that has ended stays as it ended"),
        (Rule::FirstAnswer, "a request sent again gets its first answer"),
        (
            Rule::TellAgain,
            "ends that may not have been told are told again at the start",
        ),
    ];

    fn scenarios(size: Size) -> Vec<Bounds> {
        let mut scenarios = vec![CRASHES];
        if size == Size::Large {
            scenarios.extend([
                Bounds { repeats: 2, ..CRASHES },
                Bounds {
                    pauses: 3,
                    crashes: 2,
                    ..CRASHES
                },
            ]);
        }
        scenarios
    }

    fn breaks_in(_: Rule) -> Bounds {
        CRASHES
    }

    fn events(bounds: &Bounds) -> Vec<(u8, &'static str)> {
        vec![
            (bounds.submits, "goal(s)"),
            (bounds.pauses, "request(s) to pause or resume it"),
            (bounds.cancels, "to cancel it"),
            (bounds.repeats, "request(s) sent again"),
            (bounds.crashes, "crash(es)"),
        ]
    }

    fn system(bounds: Bounds, without: &'static [Rule]) -> System {
        System { bounds, without }
    }
}

/// A goal, and a crash between any two effects.
const CRASHES: Bounds = Bounds {
    submits: 1,
    repeats: 1,
    pauses: 2,
    cancels: 1,
    crashes: 1,
};

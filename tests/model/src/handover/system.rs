//! System. What may happen to two missions and their robot, and what must hold?

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use stateright::{Model, Property};
use zenav_mission::io::{Answer, Ask, NoAnswer, Ticket};
use zenav_mission::standby::may_lead;
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::{EdgeState, Leader, LeaseAction, LeaseReply, LeaseRequest, LeaseRole, Refusal};

use super::mission::{Disk, Following, Leading, Life, Mission, Replica, Tell, Writes};
use super::{List, Rule, TICK, clock, elapsed, store};
use crate::check::{Part, Size};
use crate::network::Network;
use crate::text::Text;

/// A message between the two missions, or between one and the robot.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Message {
    /// A mission asks for the lease.
    Acquire {
        /// Which mission.
        by: u8,
        /// Its name for the question.
        ticket: u64,
    },
    /// The robot's answer: an epoch; or who leads, if anybody does.
    Granted {
        /// The mission.
        to: u8,
        /// Its name for the question.
        ticket: u64,
        /// The answer.
        answer: Result<u64, Option<Option<List>>>,
    },
    /// A leader reports who has caught up.
    Report(List),
    /// A standby joins its leader.
    Join {
        /// The standby.
        by: u8,
        /// Its new session.
        session: u8,
    },
    /// An entry of the leader's journal.
    Entry {
        /// The leader.
        from: u8,
        /// Its epoch.
        epoch: u64,
        /// The standby's session.
        session: u8,
        /// Which replication asks.
        feed: u8,
        /// Number in the session.
        position: u64,
        /// What is to be written.
        writes: Writes,
    },
}

/// What may happen.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// A leading mission steps, and its heartbeat arrives.
    Step(u8),
    /// A leading mission steps, and its heartbeat is lost.
    StepUnheard(u8),
    /// A mission hears the robot's state.
    Hear(u8),
    /// A client submits a goal to a mission.
    Submit(u8),
    /// A mission ends its goal.
    End(u8),
    /// A mission tells what it has written.
    Tell(u8),
    /// A leader drops its standby, which is late or gone.
    Drop(u8),
    /// A leader waits for a standby from now on.
    Admit(u8),
    /// A leader reports to the robot.
    SendReport(u8),
    /// A leader's report is not answered in time.
    ReportUnanswered(u8),
    /// A standby joins.
    SendJoin(u8),
    /// A message arrives.
    Arrives(Message),
    /// A message arrives, and a copy of it is still under way.
    ArrivesAndStays(Message),
    /// A mission dies.
    Crash(u8),
    /// It starts again.
    Start(u8),
    /// The robot restarts.
    RobotRestarts,
    /// An operator takes the lease, and holds it.
    OperatorTakes,
    /// The operator gives it back.
    OperatorLeaves,
    /// Time passes, for everybody.
    Tick,
}

/// How much happens at most.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bounds {
    ticks: u8,
    goals: u8,
    ends: u8,
    joins: u8,
    reports: u8,
    losses: u8,
    copies: u8,
    crashes: u8,
    restarts: u8,
    operators: u8,
}

/// The missions, the robot and the network; and what was told.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct State {
    robot: Text<LeaseArbiter>,
    boot: u8,
    now: u8,
    operator: bool,
    missions: [Mission; 2],
    network: Network<Message>,
    left: Bounds,
    acknowledged: BTreeSet<u8>,
    ended: BTreeMap<u8, u8>,
    ended_twice: bool,
    /// The newest epoch under which something was told.
    told: u64,
    told_late: bool,
    /// Whether the robot restarted, or an operator took the lease: then it does not live for its time.
    cut_short: bool,
    taken_over: bool,
}

/// The system, without a rule if told so.
#[derive(Debug)]
pub struct System {
    bounds: Bounds,
    without: Option<Rule>,
    edge: EdgeState,
}

const TTL: Duration = Duration::from_secs(1);
const OPERATOR: &str = "operator";

fn other(mission: u8) -> u8 {
    1 - mission
}

fn operator(action: LeaseAction) -> LeaseRequest {
    LeaseRequest::new(OPERATOR, LeaseRole::Operator, action, "o")
}

fn acquire(by: u8) -> LeaseRequest {
    LeaseRequest {
        store: Some(store(by)),
        ..LeaseRequest::new(store(by), LeaseRole::Mission, LeaseAction::Acquire, "r")
    }
}

fn caught_up(leads: Leader) -> LeaseRequest {
    LeaseRequest {
        leads: Some(leads),
        ..LeaseRequest::new("leader", LeaseRole::Mission, LeaseAction::CaughtUp, "c")
    }
}

impl State {
    fn mission(&mut self, of: u8) -> Option<&mut Mission> {
        self.missions.get_mut(usize::from(of))
    }

    fn leading(&mut self, of: u8) -> Option<(&mut Disk, &mut Leading)> {
        let mission = self.mission(of)?;
        match &mut mission.life {
            Life::Leading(leading) => Some((&mut mission.disk, leading)),
            _ => None,
        }
    }

    fn follow(&mut self, who: u8) {
        if let Some(mission) = self.mission(who) {
            mission.life = Life::Following(Following::default());
        }
    }

    /// What the replica of a mission has to send goes out.
    fn replicate(&mut self, from: u8) {
        let Some((_, leading)) = self.leading(from) else { return };
        let Some(epoch) = leading.membership.term() else { return };
        if let Some(message) = leading.replica.as_mut().and_then(|replica| replica.next(from, epoch)) {
            self.network.send(message);
        }
    }

    /// A step of the mission's lease client, at the time of a tick or when an answer has come.
    fn step(&mut self, system: &System, who: u8, heard: bool) -> Option<()> {
        let now = self.now;
        let (disk, leading) = self.leading(who)?;
        if system.has(Rule::HeldUp) && leading.membership.is_held_up(elapsed(leading.stepped, now)) {
            self.follow(who);
            return Some(());
        }
        if !system.has(Rule::HeldUp) {
            leading.client.was_kept_alive(clock(now));
        }
        leading.stepped = now;
        let beat = leading.client.0.step(clock(now), Some(clock(now)), &mut leading.asks.0);
        let term = leading.client.term();
        if leading.membership.lead(term) {
            let shared = leading.membership.is_shared();
            let leadership = leading.membership.share(shared);
            disk.record(leadership);
        }
        let asks = leading.asks.take_new();
        let deposed = leading.client.is_deposed() && !leading.client.leads();
        for (ticket, ask) in asks {
            if let Ask::Lease(_) = ask {
                // Of a mission's requests only the newest is under way: one that it asks again was lost.
                let is_older = |message: &Message| matches!(message, Message::Acquire { by, .. } if *by == who);
                self.network.keep(|message| !is_older(message));
                self.network.send(Message::Acquire {
                    by: who,
                    ticket: ticket.0,
                });
            }
        }
        if let Some(beat) = beat
            && heard
            && self.robot.renew(clock(now), &beat)
        {
            self.leading(who)?.1.renewed = Some(now);
        }
        if deposed {
            self.follow(who);
        }
        Some(())
    }

    /// The robot's answer to a report arrives. One that comes late, or never, is a report that arrives once its leader waits no more.
    fn reported(&mut self, list: &List, taken: bool) -> Option<()> {
        let (disk, leading) = self.leading(list.store)?;
        leading.reporting.take_if(|reporting| *reporting == list.revision)?;
        if !taken {
            self.follow(list.store);
            return Some(());
        }
        leading.membership.settle();
        if leading.membership.members().is_empty() {
            let leadership = leading.membership.share(false);
            disk.record(leadership);
        }
        Some(())
    }

    /// A standby's answer to an entry arrives: what it has, or that it refuses. One that comes late, or never, is an entry that arrives once
    /// its leader has dropped the standby.
    fn answered(&mut self, leader: u8, feed: u8, position: Option<u64>) -> Option<()> {
        let (_, leading) = self.leading(leader)?;
        let replica = leading.replica.as_mut().filter(|replica| replica.feed == feed)?;
        match position {
            Some(position) => {
                replica.stored(position);
                self.replicate(leader);
            }
            None => leading.replica = None,
        }
        Some(())
    }

    fn tell(&mut self, system: &System, who: u8) -> Option<()> {
        let now = self.now;
        let (_, leading) = self.leading(who)?;
        let (begun, tell) = leading.write.take()?;
        let kept = leading.renewed == Some(begun);
        let term = leading.membership.term().unwrap_or(0);
        if system.has(Rule::HeldUp) && leading.membership.is_held_up(elapsed(begun, now)) {
            self.follow(who);
            return Some(());
        }
        match tell {
            Tell::Accepted(goal) => {
                self.acknowledged.insert(goal);
            }
            Tell::Ended(goal, by) => self.ended_twice |= self.ended.insert(goal, by).is_some_and(|known| known != by),
        }
        self.told_late |= term < self.told && kept && !self.cut_short;
        self.taken_over |= self.told > 0 && term > self.told;
        self.told = self.told.max(term);
        Some(())
    }

    fn arrives(&mut self, system: &System, message: &Message) -> Option<()> {
        let (tick, now) = (self.now, clock(self.now));
        match message {
            Message::Acquire { by, ticket } => {
                if let Some(leader) = self.robot.leader().cloned().filter(|_| !system.has(Rule::Listed)) {
                    let leads = Leader {
                        caught_up: vec![store(0), store(1)],
                        revision: leader.revision + 1,
                        ..leader
                    };
                    let _ = self.robot.request(now, &caught_up(leads));
                }
                let answer = match self.robot.request(now, &acquire(*by)) {
                    Ok(granted) => Ok(granted.epoch),
                    Err(Refusal::Held { leader, .. }) => Err(Some(leader.as_ref().map(List::of))),
                    Err(_) => Err(None),
                };
                self.operator &= self.robot.role() == Some(LeaseRole::Operator);
                self.network.send(Message::Granted {
                    to: *by,
                    ticket: *ticket,
                    answer,
                });
            }
            Message::Granted { to, ticket, answer } => {
                let reply = match answer {
                    Ok(epoch) => Ok(Answer::Lease(LeaseReply {
                        epoch: *epoch,
                        ttl_secs: TTL.as_secs_f64(),
                        boot_id: self.boot.to_string(),
                        round_trip_secs: None,
                    })),
                    Err(Some(leader)) => Err(NoAnswer::Refused(Refusal::Held {
                        holder: OPERATOR.to_owned(),
                        role: LeaseRole::Operator,
                        epoch: 0,
                        leader: leader.as_ref().map(List::leader),
                    })),
                    Err(None) => Err(NoAnswer::Refused(Refusal::NotCaughtUp { caught_up: Vec::new() })),
                };
                let (_, leading) = self.leading(*to)?;
                leading.asks.answer(Ticket(*ticket), reply);
                if leading.is_idle() {
                    self.step(system, *to, true)?;
                }
            }
            Message::Report(list) => {
                let known = self.robot.leader().cloned()?;
                let mut leads = list.leader();
                if !system.has(Rule::Numbered) {
                    leads.revision = known.revision + 1;
                }
                if !system.has(Rule::ReportEpoch) {
                    (leads.store, leads.epoch) = (known.store, known.epoch);
                }
                let taken = self.robot.request(now, &caught_up(leads)).is_ok();
                self.reported(list, taken);
            }
            Message::Join { by, session } => {
                let leader = other(*by);
                let (disk, leading) = self.leading(leader)?;
                if leading
                    .replica
                    .as_ref()
                    .is_some_and(|replica| replica.session == *session)
                {
                    return Some(());
                }
                if leading.membership.members().contains(&store(*by)) && system.has(Rule::OffListAnew) {
                    // It begins anew, once the robot does not list it any more.
                    leading.replica = None;
                    leading.membership.drop(&store(*by), elapsed(0, tick));
                    self.network.send(message.clone());
                    return Some(());
                }
                leading.feeds += 1;
                let replica = Replica::new(*session, leading.feeds, &disk.goals, leading.membership.batch());
                leading.replica = Some(replica);
                self.replicate(leader);
            }
            Message::Entry { from, feed, .. } => {
                let by = other(*from);
                let mission = self.mission(by)?;
                let position = match &mut mission.life {
                    Life::Following(following) => following.take(&mut mission.disk, message, system.without)?,
                    Life::Leading(_) => None,
                    Life::Down => return Some(()),
                };
                self.answered(*from, *feed, position);
            }
        }
        Some(())
    }
}

impl System {
    fn has(&self, rule: Rule) -> bool {
        self.without != Some(rule)
    }

    /// Whether a mission may act on a message now; one that waits acts later.
    fn may_arrive(&self, state: &State, message: &Message) -> bool {
        match message {
            Message::Join { by, .. } => {
                let leader = state.missions.get(usize::from(other(*by)));
                leader.is_some_and(|mission| match &mission.life {
                    Life::Leading(leading) => {
                        leading.is_idle()
                            && leading.membership.term().is_some()
                            && (leading.membership.may_begin(&store(*by))
                                || leading.membership.members().contains(&store(*by))
                                || !self.has(Rule::OffListAnew))
                    }
                    _ => false,
                })
            }
            _ => true,
        }
    }

    fn may_tell(&self, leading: &Leading) -> bool {
        let stored = |_: &str| {
            let newest = Some(leading.membership.batch());
            let stored = leading.replica.as_ref().and_then(|replica| replica.stored);
            if self.has(Rule::Wait) { stored } else { newest }
        };
        let mut membership = leading.membership.clone();
        if !self.has(Rule::OffList) {
            membership.settle();
        }
        leading.reporting.is_none() && leading.write.is_some() && membership.may_tell(stored)
    }

    fn leads(&self, state: &State, who: u8, leading: &Leading, actions: &mut Vec<Action>) {
        let left = &state.left;
        let standby = store(other(who));
        let is_member = leading.membership.members().contains(&standby);
        if leading.is_idle() && leading.stepped != state.now {
            actions.push(Action::Step(who));
            actions.extend((left.losses > 0 && leading.client.epoch().is_some()).then_some(Action::StepUnheard(who)));
        }
        if leading.is_idle() {
            actions.push(Action::Hear(who));
        }
        let serves =
            leading.is_idle() && leading.stepped == state.now && leading.client.leads() && !leading.client.stands_by();
        if serves {
            actions.extend((left.goals > 0).then_some(Action::Submit(who)));
            let goals = state.missions.get(usize::from(who)).map(|mission| &mission.disk.goals);
            let is_open = goals.is_some_and(|goals| goals.values().any(|end| *end == 0));
            actions.extend((is_open && left.ends > 0).then_some(Action::End(who)));
        }
        actions.extend(self.may_tell(leading).then_some(Action::Tell(who)));
        if leading.reporting.is_some() {
            actions.push(Action::ReportUnanswered(who));
            return;
        }
        let is_late = match &leading.replica {
            Some(replica) => replica.is_waiting() && (is_member || leading.write.is_none()),
            None => is_member,
        };
        actions.extend(is_late.then_some(Action::Drop(who)));
        let stored = match &leading.replica {
            Some(_) if !self.has(Rule::CaughtUp) => Some(leading.membership.batch()),
            Some(replica) => replica.stored,
            None => None,
        };
        let now = elapsed(0, state.now);
        if leading.is_idle() && leading.membership.is_ready(&standby, stored, now) {
            actions.push(Action::Admit(who));
        }
        let reports = !leading.membership.is_settled() && leading.membership.term().is_some();
        // A leader that waits for its standby reports later: it may have to drop it.
        let newest = Some(leading.membership.batch());
        let waits = leading.write.is_some()
            && is_member
            && leading.replica.as_ref().is_none_or(|replica| replica.stored < newest);
        actions.extend((reports && left.reports > 0 && !waits).then_some(Action::SendReport(who)));
    }
}

impl Model for System {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        let mut disk = Disk::default();
        let leading = Leading::begin(0, &mut disk, 0);
        let standby = Life::Following(Following::default());
        let mut state = State {
            robot: Text(LeaseArbiter::new(TTL, 0, None)),
            boot: 0,
            now: 0,
            operator: false,
            missions: [
                Mission {
                    disk,
                    life: Life::Leading(Box::new(leading)),
                },
                Mission {
                    disk: Disk::default(),
                    life: standby,
                },
            ],
            network: Network::default(),
            left: self.bounds,
            acknowledged: BTreeSet::new(),
            ended: BTreeMap::new(),
            ended_twice: false,
            told: 0,
            told_late: false,
            cut_short: false,
            taken_over: false,
        };
        // The first is granted the lease before the second has joined.
        state.step(self, 0, true);
        for _ in 0..2 {
            let messages: Vec<Message> = state.network.under_way().cloned().collect();
            for message in messages {
                state.network.arrives(&message);
                state.arrives(self, &message);
            }
        }
        vec![state]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let left = &state.left;
        for (who, mission) in [0, 1].into_iter().zip(&state.missions) {
            match &mission.life {
                Life::Down => actions.push(Action::Start(who)),
                Life::Following(_) => {
                    actions.push(Action::Hear(who));
                    actions.extend((left.joins > 0).then_some(Action::SendJoin(who)));
                }
                Life::Leading(leading) => self.leads(state, who, leading, actions),
            }
            if left.crashes > 0 && !matches!(mission.life, Life::Down) {
                actions.push(Action::Crash(who));
            }
        }
        for message in state
            .network
            .under_way()
            .filter(|message| self.may_arrive(state, message))
        {
            actions.push(Action::Arrives(message.clone()));
            let matters = !matches!(message, Message::Granted { .. });
            actions.extend((matters && left.copies > 0).then(|| Action::ArrivesAndStays(message.clone())));
        }
        actions.extend((left.restarts > 0).then_some(Action::RobotRestarts));
        actions.extend((left.operators > 0).then_some(Action::OperatorTakes));
        actions.extend(state.operator.then_some(Action::OperatorLeaves));
        actions.extend((left.ticks > 0).then_some(Action::Tick));
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        let (tick, now) = (state.now, clock(state.now));
        match action {
            Action::Step(who) => state.step(self, who, true)?,
            Action::StepUnheard(who) => {
                state.left.losses -= 1;
                state.step(self, who, false)?;
            }
            Action::Hear(who) => {
                let lease = state.robot.state(now);
                let boot_id = state.boot.to_string();
                let mission = state.mission(who)?;
                match &mut mission.life {
                    Life::Down => return None,
                    Life::Following(following) => {
                        following.word = lease.leader.as_ref().map(List::of);
                        if may_lead(&lease, &store(who)) {
                            mission.life = Life::Leading(Box::new(Leading::begin(who, &mut mission.disk, tick)));
                            state.step(self, who, true)?;
                        }
                    }
                    Life::Leading(leading) => {
                        let heard = EdgeState {
                            stamp: now,
                            boot_id,
                            lease,
                            ..self.edge.clone()
                        };
                        leading.client.observe(now, &heard);
                        if leading.client.is_deposed() {
                            state.follow(who);
                        }
                    }
                }
            }
            Action::Submit(who) => {
                state.left.goals -= 1;
                let goal = state.left.goals;
                let (disk, leading) = state.leading(who)?;
                leading.write(disk, goal, 0, Tell::Accepted(goal));
                state.replicate(who);
            }
            Action::End(who) => {
                state.left.ends -= 1;
                let (disk, leading) = state.leading(who)?;
                let goal = *disk.goals.iter().find(|(_, end)| **end == 0)?.0;
                let by = 1 + who + 2 * disk.incarnation;
                leading.write(disk, goal, by, Tell::Ended(goal, by));
                state.replicate(who);
            }
            Action::Tell(who) => state.tell(self, who)?,
            Action::Drop(who) => {
                let (_, leading) = state.leading(who)?;
                leading.replica = None;
                let standby = store(other(who));
                if leading.membership.members().contains(&standby) {
                    leading.membership.drop(&standby, elapsed(0, tick));
                }
            }
            Action::Admit(who) => {
                let (disk, leading) = state.leading(who)?;
                if !leading.membership.is_shared() {
                    let leadership = leading.membership.share(true);
                    if self.has(Rule::SharedOnDisk) {
                        disk.record(leadership);
                    }
                }
                leading.membership.admit([store(other(who))]);
            }
            Action::SendReport(who) => {
                state.left.reports -= 1;
                let (_, leading) = state.leading(who)?;
                let list = List::of(&leading.membership.report()?);
                leading.reporting = Some(list.revision);
                state.network.send(Message::Report(list));
            }
            Action::ReportUnanswered(who) => state.leading(who)?.1.reporting = None,
            Action::SendJoin(who) => {
                state.left.joins -= 1;
                let session = state.left.joins;
                let Life::Following(following) = &mut state.mission(who)?.life else {
                    return None;
                };
                (following.session, following.position) = (Some(session), 0);
                state.network.send(Message::Join { by: who, session });
            }
            Action::Arrives(message) => {
                state.network.arrives(&message);
                // A message that nobody waits for is gone, and changes nothing else.
                let mut after = state.clone();
                if after.arrives(self, &message).is_some() {
                    state = after;
                }
            }
            Action::ArrivesAndStays(message) => {
                state.left.copies -= 1;
                state.arrives(self, &message)?;
            }
            Action::Crash(who) => {
                state.left.crashes -= 1;
                state.mission(who)?.life = Life::Down;
                // Answers to it are lost.
                let is_answer = |message: &Message| matches!(message, Message::Granted { to, .. } if *to == who);
                state.network.keep(|message| !is_answer(message));
            }
            Action::Start(who) => {
                let mission = state.mission(who)?;
                // A store that never led yields to the mission that leads.
                if mission.disk.epoch == 0 {
                    state.follow(who);
                } else {
                    mission.life = Life::Leading(Box::new(Leading::begin(who, &mut mission.disk, tick)));
                    state.step(self, who, true)?;
                }
            }
            Action::RobotRestarts => {
                state.left.restarts -= 1;
                state.boot += 1;
                let leader = state.robot.leader().cloned().filter(|_| self.has(Rule::ListOnDisk));
                *state.robot = LeaseArbiter::new(TTL, state.robot.epoch(), leader);
                state.operator = false;
                state.cut_short = true;
            }
            Action::OperatorTakes => {
                state.left.operators -= 1;
                state.operator = state.robot.request(now, &operator(LeaseAction::Acquire)).is_ok();
                state.cut_short = true;
            }
            Action::OperatorLeaves => {
                let _ = state.robot.request(now, &operator(LeaseAction::Release));
                state.operator = false;
            }
            Action::Tick => {
                state.left.ticks -= 1;
                state.now += 1;
                if state.operator {
                    state.robot.heard(clock(state.now));
                }
            }
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(
                "whoever the robot lets lead holds every goal that was acknowledged",
                |_, state: &State| {
                    let holds = |store: u8| {
                        let goals = state
                            .missions
                            .get(usize::from(store))
                            .map(|mission| &mission.disk.goals);
                        goals.is_some_and(|goals| state.acknowledged.iter().all(|goal| goals.contains_key(goal)))
                    };
                    state
                        .robot
                        .leader()
                        .is_none_or(|leader| List::of(leader).caught_up.into_iter().all(holds))
                },
            ),
            Property::always(
                "whoever the robot lets lead knows every end that was told",
                |_, state: &State| {
                    let knows = |store: u8| {
                        let goals = state
                            .missions
                            .get(usize::from(store))
                            .map(|mission| &mission.disk.goals);
                        goals.is_some_and(|goals| state.ended.iter().all(|(goal, end)| goals.get(goal) == Some(end)))
                    };
                    state
                        .robot
                        .leader()
                        .is_none_or(|leader| List::of(leader).caught_up.into_iter().all(knows))
                },
            ),
            Property::always("a goal ends once", |_, state: &State| !state.ended_twice),
            Property::always(
                "a leader that held the lease when it wrote says nothing once another has spoken",
                |_, state: &State| !state.told_late,
            ),
            Property::sometimes("a standby takes over and tells", |_, state: &State| state.taken_over),
            Property::sometimes(
                "a goal is acknowledged with a standby on the list",
                |_, state: &State| {
                    let listed = state.robot.leader().map_or(0, |leader| leader.caught_up.len());
                    listed > 1 && !state.acknowledged.is_empty()
                },
            ),
        ]
    }
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

impl System {
    #[expect(clippy::expect_used, reason = "a constant text")]
    fn new(bounds: Bounds, without: Option<Rule>) -> Self {
        let edge = serde_json::json!({
            "stamp": 0, "boot_id": "", "mode": "idle", "link": "Connected",
            "lease": {"holder": null, "role": null, "epoch": 0, "live": false},
            "plan": null, "velocity": {"v": 0.0, "w": 0.0}, "guard": "clear", "battery": 1.0, "behaviour": null, "wall_follower": null
        });
        Self {
            bounds,
            without,
            edge: serde_json::from_value(edge).expect("a state of the robot"),
        }
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

/// Further ways in which things go wrong, each within bounds of its own.
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

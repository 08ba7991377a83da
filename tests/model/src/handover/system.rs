//! System. The actions of two missions and their robot, and the claims.

use std::collections::{BTreeMap, BTreeSet};

use stateright::{Model, Property};
use zenav_mission::may_lead;
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::{EdgeState, LeaseAction};

use super::bounds::Bounds;
use super::mission::{Disk, Following, Leading, Life, Mission, Tell};
use super::state::{Message, State, TTL, operator, other};
use super::{List, Rule, clock, elapsed, store};
use crate::network::Network;
use crate::text::Text;

/// An action of the system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// A leading mission steps, and its heartbeat arrives.
    Step(u8),
    /// A leading mission steps, and its heartbeat is lost.
    StepUnheard(u8),
    /// A mission receives the robot's state.
    Hear(u8),
    /// A client submits a goal to a mission.
    Submit(u8),
    /// A mission ends its goal.
    End(u8),
    /// A mission announces its write.
    Tell(u8),
    /// A leader drops its late or dead standby.
    Drop(u8),
    /// A leader admits a standby and waits for it from then on.
    Admit(u8),
    /// A leader reports to the robot.
    SendReport(u8),
    /// A leader's report is not answered in time.
    ReportUnanswered(u8),
    /// A standby joins.
    SendJoin(u8),
    /// A message arrives.
    Arrives(Message),
    /// A message arrives, and a copy of it stays in transit.
    ArrivesAndStays(Message),
    /// A mission crashes.
    Crash(u8),
    /// A mission restarts.
    Start(u8),
    /// The robot restarts.
    RobotRestarts,
    /// An operator takes the lease, and holds it.
    OperatorTakes,
    /// The operator gives it back.
    OperatorLeaves,
    /// Time passes, for all.
    Tick,
}

/// The system, optionally without some rules.
#[derive(Debug)]
pub struct System {
    pub(super) bounds: Bounds,
    pub(super) without: &'static [Rule],
    pub(super) edge: EdgeState,
}

impl System {
    #[expect(clippy::expect_used, reason = "a constant text")]
    pub(super) fn new(bounds: Bounds, without: &'static [Rule]) -> Self {
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

impl System {
    pub(super) fn has(&self, rule: Rule) -> bool {
        !self.without.contains(&rule)
    }

    /// Whether a message may be processed now; a waiting mission processes it later.
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
        // A leader that waits for its standby reports later, because it may have to drop the standby.
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
        // The first mission is granted the lease before the second joins.
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
                // A message that no process waits for is dropped without further effect.
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
                // Answers to the crashed mission are lost.
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

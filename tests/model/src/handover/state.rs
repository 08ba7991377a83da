//! State. The state of two missions, their robot and their messages, and the effect of each step.

use std::collections::{BTreeMap, BTreeSet};
use std::time::Duration;

use zenav_mission::{Answer, Ask, NoAnswer, Ticket};
use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::{Leader, LeaseAction, LeaseReply, LeaseRequest, LeaseRole, Refusal};
use zenav_protocol::time::Stamp;

use super::bounds::Bounds;
use super::mission::{Disk, Following, Leading, Life, Mission, Replica, Tell, Writes};
use super::{List, Rule, System, clock, elapsed, store};
use crate::network::Network;
use crate::text::Text;

/// A message between the two missions, or between one and the robot.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Message {
    /// A mission asks for the lease.
    Acquire {
        /// The mission.
        by: u8,
        /// Its id of the request.
        ticket: u64,
        /// The robot's time when it was sent.
        echo: Option<Stamp>,
    },
    /// The robot's answer: an epoch; or its record of who leads, if there is one.
    Granted {
        /// The mission.
        to: u8,
        /// Its id of the request.
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
        /// The replication.
        feed: u8,
        /// Number in the session.
        position: u64,
        /// The writes.
        writes: Writes,
    },
}

/// The missions, the robot and the network; and everything that was told.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct State {
    pub(super) robot: Text<LeaseArbiter>,
    pub(super) boot: u8,
    pub(super) now: u8,
    pub(super) operator: bool,
    pub(super) missions: [Mission; 2],
    pub(super) network: Network<Message>,
    pub(super) left: Bounds,
    pub(super) acknowledged: BTreeSet<u8>,
    pub(super) ended: BTreeMap<u8, u8>,
    pub(super) ended_twice: bool,
    /// The newest epoch under which something was told.
    pub(super) told: u64,
    pub(super) told_late: bool,
    /// Whether the robot restarted, or an operator took the lease: then a lease may end early.
    pub(super) cut_short: bool,
    pub(super) taken_over: bool,
}

pub(super) const TTL: Duration = Duration::from_secs(1);
pub(super) const OPERATOR: &str = "operator";

pub(super) fn other(mission: u8) -> u8 {
    1 - mission
}

pub(super) fn operator(action: LeaseAction) -> LeaseRequest {
    LeaseRequest::new(OPERATOR, LeaseRole::Operator, action, "o")
}

fn acquire(by: u8, echo: Option<Stamp>) -> LeaseRequest {
    LeaseRequest {
        store: Some(store(by)),
        echo,
        ..LeaseRequest::new(store(by), LeaseRole::Mission, LeaseAction::Acquire, "r")
    }
}

pub(super) fn caught_up(leads: Leader) -> LeaseRequest {
    LeaseRequest {
        leads: Some(leads),
        ..LeaseRequest::new("leader", LeaseRole::Mission, LeaseAction::CaughtUp, "c")
    }
}

impl State {
    pub(super) fn mission(&mut self, of: u8) -> Option<&mut Mission> {
        self.missions.get_mut(usize::from(of))
    }

    pub(super) fn leading(&mut self, of: u8) -> Option<(&mut Disk, &mut Leading)> {
        let mission = self.mission(of)?;
        match &mut mission.life {
            Life::Leading(leading) => Some((&mut mission.disk, leading)),
            _ => None,
        }
    }

    pub(super) fn follow(&mut self, who: u8) {
        if let Some(mission) = self.mission(who) {
            mission.life = Life::Following(Following::default());
        }
    }

    /// Sends the next entry of a mission's replica, if there is one.
    pub(super) fn replicate(&mut self, from: u8) {
        let Some((_, leading)) = self.leading(from) else { return };
        let Some(epoch) = leading.membership.term() else { return };
        if let Some(message) = leading.replica.as_mut().and_then(|replica| replica.next(from, epoch)) {
            self.network.send(message);
        }
    }

    /// A step of the mission's lease client, at the time of a tick or when an answer has come.
    pub(super) fn step(&mut self, system: &System, who: u8, heard: bool) -> Option<()> {
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
            if let Ask::Lease(request) = ask {
                // Only the newest request of a mission is in transit: a repeated request means that the earlier one was lost.
                let is_older = |message: &Message| matches!(message, Message::Acquire { by, .. } if *by == who);
                self.network.keep(|message| !is_older(message));
                self.network.send(Message::Acquire {
                    by: who,
                    ticket: ticket.0,
                    echo: request.echo,
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

    /// The robot's answer to a report arrives. A late or lost answer is modelled by a report that arrives when its leader no longer waits.
    pub(super) fn reported(&mut self, list: &List, taken: bool) -> Option<()> {
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

    /// A standby's answer to an entry arrives: its position, or a refusal. A late or lost answer is modelled by an entry that arrives when
    /// its leader has dropped the standby.
    pub(super) fn answered(&mut self, leader: u8, feed: u8, position: Option<u64>) -> Option<()> {
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

    pub(super) fn tell(&mut self, system: &System, who: u8) -> Option<()> {
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

    pub(super) fn arrives(&mut self, system: &System, message: &Message) -> Option<()> {
        let (tick, now) = (self.now, clock(self.now));
        match message {
            Message::Acquire { by, ticket, echo } => {
                if let Some(leader) = self.robot.leader().cloned().filter(|_| !system.has(Rule::Listed)) {
                    let leads = Leader {
                        caught_up: vec![store(0), store(1)],
                        revision: leader.revision + 1,
                        ..leader
                    };
                    let _ = self.robot.request(now, &caught_up(leads));
                }
                let before = self.robot.leader().cloned().filter(|_| !system.has(Rule::Alone));
                let answer = match self.robot.request(now, &acquire(*by, *echo)) {
                    Ok(granted) => {
                        if let Some(leader) = before {
                            let kept = leader.caught_up.into_iter().filter(|known| *known != store(*by));
                            let leads = Leader {
                                store: store(*by),
                                epoch: granted.epoch,
                                caught_up: std::iter::once(store(*by)).chain(kept).collect(),
                                revision: 1,
                            };
                            let _ = self.robot.request(now, &caught_up(leads));
                        }
                        Ok(granted.epoch)
                    }
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
                    // The standby joins again once the robot no longer lists it.
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
                    Life::Following(following) => following.take(&mut mission.disk, message, system)?,
                    Life::Leading(_) => None,
                    Life::Down => return Some(()),
                };
                self.answered(*from, *feed, position);
            }
        }
        Some(())
    }
}

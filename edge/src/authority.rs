//! Command authority. Who may command the robot, and may it move at all? The lease, the latched stop, the policy and the link.
//!
//! A stop needs no lease, latches across restarts and discards the plan. Every change of the lease holder discards the plan too.

use std::collections::VecDeque;
use std::time::Duration;

use zenav_protocol::lease::{self, LeaseArbiter};
use zenav_protocol::messages::{
    EventKind, Heartbeat, LeaseAction, LeaseReply, LeaseRequest, LeaseRole, LeaseState, Link, LostPolicy, ModeRequest,
    Refusal, ResumeRequest, Revision, StopReply, StopRequest,
};
use zenav_protocol::time::Stamp;

use crate::acceptance::Grant;
use crate::arbitration::{self, MotionSource};
use crate::config::EdgeConfig;
use crate::control_io::Persisted;
use crate::event_log::EventLog;
use crate::link;
use crate::settings::{AcceptanceSettings, LeaseSettings};
use crate::teleop::Dropped;

/// Longest name of a holder or request, bytes.
const LONGEST_NAME: usize = 128;
/// Most stores listed as caught up with the leader, its own included.
const MOST_STANDBYS: usize = 8;
/// Most first answers kept for repeated requests.
const MEMORY: usize = 64;

/// Lease, stop latch, policy and link.
#[derive(Clone, Debug)]
pub struct Authority {
    arbiter: LeaseArbiter,
    stopped: bool,
    /// Stops since this start.
    stops: u64,
    /// Ids of the latest stops and resumes.
    obeyed: VecDeque<String>,
    resumed: Option<Stamp>,
    policy: LostPolicy,
    link: Link,
    live: bool,
    settings: LeaseSettings,
    first_answers: VecDeque<(LeaseRequest, Result<LeaseReply, Refusal>)>,
    /// The last measured round trip, until it is taken.
    measured: Option<Duration>,
    /// The present grant, if nothing could be stored when it was made: its holder is refused then. Told once that holder is heard.
    untold: Option<EventKind>,
    stored: Persisted,
}

/// The answer to a request, and its effect on the plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision<R> {
    /// To be sent after [`Authority::unpersisted`] has been persisted.
    pub answer: Result<R, Refusal>,
    /// Why the plan and any maneuver are to be discarded, if they are.
    pub discard_reason: Option<&'static str>,
    /// Whether another holder has the lease now.
    pub holder_changed: bool,
}

impl<R> Decision<R> {
    fn without_effect(answer: Result<R, Refusal>) -> Self {
        Self {
            answer,
            discard_reason: None,
            holder_changed: false,
        }
    }
}

impl Authority {
    /// Starts from what the last boot persisted.
    #[must_use]
    pub fn new(config: &EdgeConfig, stored: Persisted) -> Self {
        Self {
            arbiter: LeaseArbiter::new(
                Duration::from_secs_f64(config.settings.lease.ttl),
                stored.epoch,
                stored.leader.clone(),
            ),
            stopped: stored.stopped,
            stops: 0,
            obeyed: VecDeque::new(),
            resumed: None,
            policy: config.on_lost,
            link: Link::Lost,
            live: false,
            settings: config.settings.lease.clone(),
            first_answers: VecDeque::new(),
            measured: None,
            untold: None,
            stored,
        }
    }

    /// Answers a request for the lease; a repeated request gets the first answer. `can_store`: whether the last state was stored; while none
    /// can be, the answer to a grant is replaced by a refusal, so the grant is not recorded.
    pub fn lease(
        &mut self,
        now: Stamp,
        request: &LeaseRequest,
        can_store: bool,
        events: &mut EventLog,
    ) -> Decision<LeaseReply> {
        if let Err(why) = well_formed(request) {
            return Decision::without_effect(Err(Refusal::bad_request(why)));
        }
        if let Some((_, first)) = self.first_answers.iter().find(|(known, _)| known == request) {
            return Decision::without_effect(first.clone());
        }
        let before = self.arbiter.epoch();
        let granted = self.arbiter.request(now, request);
        let holder_changed = granted.as_ref().is_ok_and(|granted| granted.holder_changed);
        if holder_changed || self.arbiter.epoch() != before {
            let reason = if request.action == LeaseAction::Acquire {
                "granted"
            } else {
                "released"
            };
            let event = EventKind::Lease {
                holder: self.arbiter.state(now).holder,
                epoch: self.arbiter.epoch(),
                reason: reason.to_owned(),
            };
            self.untold = None;
            if can_store || request.action != LeaseAction::Acquire {
                events.record(now, event);
            } else {
                self.untold = Some(event);
            }
        }
        self.live = self.arbiter.is_live(now);
        self.measured = granted
            .as_ref()
            .ok()
            .and_then(|granted| granted.round_trip)
            .or(self.measured);
        let answer = granted.map(|granted| LeaseReply {
            epoch: granted.epoch,
            ttl_secs: self.arbiter.ttl().as_secs_f64(),
            boot_id: events.boot_id().to_owned(),
            round_trip_secs: granted.round_trip.map(|round_trip| round_trip.as_secs_f64()),
        });
        if self.first_answers.len() == MEMORY {
            self.first_answers.pop_front();
        }
        self.first_answers.push_back((request.clone(), answer.clone()));
        Decision {
            answer,
            discard_reason: holder_changed.then_some("the lease changed hands"),
            holder_changed,
        }
    }

    /// Renews the lease by a heartbeat.
    pub fn heartbeat(&mut self, now: Stamp, heartbeat: &Heartbeat, events: &mut EventLog) {
        if self.arbiter.renew(now, heartbeat) {
            if let Some(grant) = self.untold.take() {
                events.record(now, grant);
            }
            self.measured = lease::measured(now, heartbeat.echo).or(self.measured);
        }
    }

    /// Takes the last measured round trip.
    pub fn take_measured(&mut self) -> Option<Duration> {
        self.measured.take()
    }

    /// Whether teleop twists under this epoch may act now.
    ///
    /// # Errors
    /// [`Dropped`] unless the epoch is current and an operator holds it with a live lease.
    pub fn admit_teleop(&self, now: Stamp, epoch: u64) -> Result<(), Dropped> {
        let current = self.arbiter.epoch();
        if epoch != current {
            return Err(Dropped::WrongEpoch { got: epoch, current });
        }
        if self.is_live_as(now, LeaseRole::Operator) {
            Ok(())
        } else {
            Err(Dropped::NoOperator)
        }
    }

    /// An admitted teleop command renews the lease like a heartbeat.
    pub fn renew_as_operator(&mut self, now: Stamp) {
        self.arbiter.heard(now);
    }

    /// Stops the robot and latches. A copy of an earlier request stops it, too, but is not counted while it is stopped.
    pub fn stop(&mut self, now: Stamp, request: &StopRequest, events: &mut EventLog) -> Decision<StopReply> {
        let first = !self.stopped;
        self.stopped = true;
        let is_copy = self.is_copy(request.request_id.as_deref());
        self.stops += u64::from(first || !is_copy);
        if first {
            events.record(
                now,
                EventKind::Stopped {
                    by: name(request.by.as_deref()),
                },
            );
        }
        Decision {
            answer: Ok(StopReply { stopped: true }),
            discard_reason: Some("stopped by an operator"),
            holder_changed: false,
        }
    }

    /// Releases the stop: allows a new plan, and nothing else. A request made before the newest stop or before a restart is refused, and a
    /// copy of an earlier request has no effect.
    pub fn resume(&mut self, now: Stamp, request: &ResumeRequest, events: &mut EventLog) -> Decision<StopReply> {
        if request.stop.is_some() && request.boot_id.is_none() {
            return Decision::without_effect(Err(Refusal::bad_request(
                "`stop`: expected with the `boot_id` of the state that counted it",
            )));
        }
        let is_of_other_boot = request.boot_id.as_deref().is_some_and(|id| id != events.boot_id());
        if self.stopped && (is_of_other_boot || request.stop.is_some_and(|stop| stop != self.stops)) {
            let since = if is_of_other_boot { "restarted" } else { "stopped again" };
            return Decision::without_effect(Err(Refusal::rejected(format!(
                "the robot was {since} since: look at it, and resume it again"
            ))));
        }
        if self.is_copy(request.request_id.as_deref()) {
            return Decision::without_effect(Ok(StopReply { stopped: self.stopped }));
        }
        if self.stopped {
            self.stopped = false;
            self.resumed = Some(now);
            events.record(
                now,
                EventKind::Resumed {
                    by: name(request.by.as_deref()),
                },
            );
        }
        Decision::without_effect(Ok(StopReply { stopped: false }))
    }

    /// Whether a stop or a resume of this id came before; it is remembered.
    fn is_copy(&mut self, id: Option<&str>) -> bool {
        let Some(id) = id.filter(|id| id.len() <= LONGEST_NAME) else {
            return false;
        };
        if self.obeyed.iter().any(|known| known == id) {
            return true;
        }
        if self.obeyed.len() == MEMORY {
            self.obeyed.pop_front();
        }
        self.obeyed.push_back(id.to_owned());
        false
    }

    /// Sets the lost-link policy, if the request has one.
    ///
    /// # Errors
    /// [`Refusal`] if a policy is to be set without the current epoch.
    pub fn set_policy(&mut self, now: Stamp, request: &ModeRequest) -> Result<LostPolicy, Refusal> {
        if let Some(policy) = request.on_lost {
            self.admit(now, request.epoch)?;
            self.policy = policy;
        }
        Ok(self.policy)
    }

    /// Whether a change under this epoch is admitted now.
    ///
    /// # Errors
    /// [`Refusal`] without an epoch, or with one that is not current and live.
    pub fn admit(&self, now: Stamp, epoch: Option<u64>) -> Result<(), Refusal> {
        let Some(epoch) = epoch else {
            return Err(Refusal::bad_request("a change needs the `epoch` of the lease"));
        };
        if epoch != self.arbiter.epoch() {
            return Err(Refusal::WrongEpoch {
                got: epoch,
                current: self.arbiter.epoch(),
            });
        }
        if self.arbiter.is_live(now) {
            Ok(())
        } else {
            Err(Refusal::rejected("the lease has expired"))
        }
    }

    /// Updates the link; records an expired lease and a changed link.
    pub fn update_link(&mut self, now: Stamp, events: &mut EventLog) {
        let live = self.arbiter.is_live(now);
        if self.live && !live && self.arbiter.role().is_some() && self.untold.is_none() {
            events.record(
                now,
                EventKind::Lease {
                    holder: self.arbiter.state(now).holder,
                    epoch: self.arbiter.epoch(),
                    reason: "expired".to_owned(),
                },
            );
        }
        self.live = live;
        let link = link::link(
            self.arbiter.age(now),
            Duration::from_secs_f64(self.settings.stale_after),
            Duration::from_secs_f64(self.settings.lost_after),
        );
        if link != self.link {
            self.link = link;
            events.record(now, EventKind::LinkChanged { link });
        }
    }

    /// State to persist before any reply goes out, if it has changed since the last call.
    pub fn unpersisted(&mut self) -> Option<Persisted> {
        let wanted = Persisted {
            epoch: self.arbiter.epoch(),
            stopped: self.stopped,
            leader: self.arbiter.leader().cloned(),
        };
        (wanted != self.stored).then(|| {
            self.stored.clone_from(&wanted);
            wanted
        })
    }

    /// Which source may move the robot.
    #[must_use]
    pub fn motion_source(&self, now: Stamp, plan_valid: bool) -> MotionSource {
        if self.stopped {
            MotionSource::Brake
        } else {
            arbitration::motion_source(
                self.arbiter.is_live(now),
                self.arbiter.role(),
                plan_valid,
                self.policy,
                self.link,
            )
        }
    }

    /// Against what a plan's header is checked. `newest`: the newest accepted plan, by epoch and revision.
    #[must_use]
    pub fn grant<'a>(
        &self,
        now: Stamp,
        boot_id: &'a str,
        newest: Option<(u64, Revision)>,
        settings: &AcceptanceSettings,
    ) -> Grant<'a> {
        let epoch = self.epoch();
        Grant {
            now,
            boot_id,
            epoch,
            mission_live: self.is_live_as(now, LeaseRole::Mission),
            stopped: self.stopped,
            resumed: self.resumed,
            newest: newest.filter(|(of, _)| *of == epoch).map(|(_, revision)| revision),
            max_validity: settings.max_validity,
            longest_step: settings.longest_step,
        }
    }

    /// Whether the stop is latched.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// Number of stops since this start.
    #[must_use]
    pub fn stops(&self) -> u64 {
        self.stops
    }

    /// Whether a holder with this role has a live lease.
    #[must_use]
    pub fn is_live_as(&self, now: Stamp, role: LeaseRole) -> bool {
        self.arbiter.is_live(now) && self.arbiter.role() == Some(role)
    }

    /// The current epoch.
    #[must_use]
    pub fn epoch(&self) -> u64 {
        self.arbiter.epoch()
    }

    /// The lost-link policy in force.
    #[must_use]
    pub fn policy(&self) -> LostPolicy {
        self.policy
    }

    /// The link as of the last update.
    #[must_use]
    pub fn link(&self) -> Link {
        self.link
    }

    /// Round trip to the holder of the lease and back, s.
    #[must_use]
    pub fn round_trip_secs(&self) -> Option<f64> {
        self.arbiter.round_trip().map(|round_trip| round_trip.as_secs_f64())
    }

    /// The lease as the state shows it.
    #[must_use]
    pub fn lease_state(&self, now: Stamp) -> LeaseState {
        self.arbiter.state(now)
    }
}

/// Checks the names in a request.
fn well_formed(request: &LeaseRequest) -> Result<(), String> {
    let leads = request.leads.as_ref();
    let named = [("holder", &request.holder), ("request_id", &request.request_id)];
    let stores = request.store.iter().chain(leads.map(|word| &word.store));
    let stores = stores.chain(leads.iter().flat_map(|word| &word.caught_up));
    let all = named.into_iter().chain(stores.map(|store| ("store", store)));
    for (field, name) in all {
        if name.is_empty() || name.len() > LONGEST_NAME {
            return Err(format!("`{field}`: expected 1 to {LONGEST_NAME} bytes"));
        }
    }
    if leads.is_some_and(|word| word.caught_up.len() > MOST_STANDBYS) {
        return Err(format!("`caught_up`: expected at most {MOST_STANDBYS} stores"));
    }
    if request.action == LeaseAction::CaughtUp && !leads.is_some_and(|word| word.caught_up.contains(&word.store)) {
        return Err("`leads`: expected who leads, with its own store among those that have caught up".to_owned());
    }
    Ok(())
}

fn name(by: Option<&str>) -> String {
    by.unwrap_or("unknown").chars().take(LONGEST_NAME).collect()
}

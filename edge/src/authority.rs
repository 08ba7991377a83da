//! Who may command the robot, and may it move at all? The lease, the latched stop, and the link's age.
//!
//! A stop needs no lease, latches across restarts, and voids the plan; so does every change of the lease's holder.

use zenav_protocol::lease::LeaseArbiter;
use zenav_protocol::messages::*;
use zenav_protocol::time::Stamp;

use crate::config::EdgeConfig;
use crate::control_io::Persisted;
use crate::event_log::EventLog;
use crate::link;
use crate::teleop::Dropped;

/// Longest name of a holder or request.
const LONGEST_NAME: usize = 128;
/// Stores that may have caught up with the leader, its own among them.
const MOST_STANDBYS: usize = 8;
/// First answers kept for repeated requests.
const MEMORY: usize = 64;

/// Lease, stop latch, policy and link.
#[derive(Clone, Debug)]
pub struct Authority {
    book: LeaseArbiter,
    stopped: bool,
    resumed: Option<Stamp>,
    policy: LostPolicy,
    link: Link,
    live: bool,
    config: EdgeConfig,
    first_answers: std::collections::VecDeque<(LeaseRequest, Result<LeaseReply, Refusal>)>,
    stored: Persisted,
}

/// An answer, and what it did to the plan.
#[derive(Clone, Debug, PartialEq)]
pub struct Decision<R> {
    /// To be sent once [`Authority::unstored`] has been stored.
    pub answer: Result<R, Refusal>,
    /// Why whatever the robot was doing is void now, if it is.
    pub void: Option<&'static str>,
    /// Whether another holder commands now.
    pub holder_changed: bool,
}

impl<R> Decision<R> {
    fn harmless(answer: Result<R, Refusal>) -> Self {
        Self {
            answer,
            void: None,
            holder_changed: false,
        }
    }
}

impl Authority {
    /// As it was stored.
    #[must_use]
    pub fn new(config: &EdgeConfig, stored: Persisted) -> Self {
        Self {
            book: LeaseArbiter::new(config.lease_ttl, stored.epoch, stored.leader.clone()),
            stopped: stored.stopped,
            resumed: None,
            policy: config.on_lost,
            link: Link::Lost,
            live: false,
            config: config.clone(),
            first_answers: std::collections::VecDeque::new(),
            stored,
        }
    }

    /// Answers a request for the lease; a repeated request gets the first answer.
    pub fn lease(&mut self, now: Stamp, request: &LeaseRequest, journal: &mut EventLog) -> Decision<LeaseReply> {
        if let Err(why) = well_formed(request) {
            return Decision::harmless(Err(Refusal::bad_request(why)));
        }
        if let Some((_, first)) = self.first_answers.iter().find(|(known, _)| known == request) {
            return Decision::harmless(first.clone());
        }
        let before = self.book.epoch();
        let granted = self.book.request(now, request);
        let holder_changed = granted.as_ref().is_ok_and(|granted| granted.holder_changed);
        if holder_changed || self.book.epoch() != before {
            let reason = if request.action == LeaseAction::Acquire {
                "granted"
            } else {
                "released"
            };
            let holder = self.book.state(now).holder;
            journal.tell(
                now,
                EventKind::Lease {
                    holder,
                    epoch: self.book.epoch(),
                    reason: reason.to_owned(),
                },
            );
        }
        self.live = self.book.is_live(now);
        let answer = granted.map(|granted| LeaseReply {
            epoch: granted.epoch,
            ttl_secs: self.book.ttl().as_secs_f64(),
            boot_id: journal.boot_id().to_owned(),
        });
        if self.first_answers.len() == MEMORY {
            self.first_answers.pop_front();
        }
        self.first_answers.push_back((request.clone(), answer.clone()));
        Decision {
            answer,
            void: holder_changed.then_some("another holder may command"),
            holder_changed,
        }
    }

    /// Takes a heartbeat.
    pub fn heartbeat(&mut self, now: Stamp, heartbeat: &Heartbeat) {
        self.book
            .renew(now, &heartbeat.holder, heartbeat.epoch, heartbeat.counter);
    }

    /// Whether twists by hand under this epoch may act now.
    ///
    /// # Errors
    /// [`Dropped`] unless it is the current one, and an operator's with a live lease.
    pub fn admit_teleop(&self, now: Stamp, epoch: u64) -> Result<(), Dropped> {
        let current = self.book.epoch();
        if epoch != current {
            return Err(Dropped::WrongEpoch { got: epoch, current });
        }
        if self.is_live_as(now, LeaseRole::Operator) {
            Ok(())
        } else {
            Err(Dropped::NoOperator)
        }
    }

    /// The operator has sent a command that counts: as good as a heartbeat.
    pub fn operator_commands(&mut self, now: Stamp) {
        self.book.heard(now);
    }

    /// Stops and latches.
    pub fn stop(&mut self, now: Stamp, request: &StopRequest, journal: &mut EventLog) -> Decision<StopReply> {
        let first = !self.stopped;
        self.stopped = true;
        if first {
            journal.tell(
                now,
                EventKind::Stopped {
                    by: name(request.by.as_deref()),
                },
            );
        }
        Decision {
            answer: Ok(StopReply { stopped: true }),
            void: Some("stopped by hand"),
            holder_changed: false,
        }
    }

    /// Allows a new plan, and nothing else.
    pub fn resume(&mut self, now: Stamp, request: &ResumeRequest, journal: &mut EventLog) -> Decision<StopReply> {
        if self.stopped {
            self.stopped = false;
            self.resumed = Some(now);
            journal.tell(
                now,
                EventKind::Resumed {
                    by: name(request.by.as_deref()),
                },
            );
        }
        Decision::harmless(Ok(StopReply { stopped: false }))
    }

    /// Sets the policy, if asked to.
    ///
    /// # Errors
    /// [`Refusal`] without the current epoch.
    pub fn set_policy(&mut self, now: Stamp, request: &ModeRequest) -> Result<LostPolicy, Refusal> {
        if let Some(policy) = request.on_lost {
            self.admit(now, request.epoch)?;
            self.policy = policy;
        }
        Ok(self.policy)
    }

    /// Whether a change under this epoch may be made now.
    ///
    /// # Errors
    /// [`Refusal`] without an epoch, or with another one than the current live one.
    pub fn admit(&self, now: Stamp, epoch: Option<u64>) -> Result<(), Refusal> {
        let Some(epoch) = epoch else {
            return Err(Refusal::bad_request("a change needs the `epoch` of the lease"));
        };
        if epoch != self.book.epoch() {
            return Err(Refusal::WrongEpoch {
                got: epoch,
                current: self.book.epoch(),
            });
        }
        if self.book.is_live(now) {
            Ok(())
        } else {
            Err(Refusal::rejected("the lease has expired"))
        }
    }

    /// Tells of a lapsed lease and a changed link.
    pub fn watch(&mut self, now: Stamp, journal: &mut EventLog) {
        let live = self.book.is_live(now);
        if self.live && !live && self.book.role().is_some() {
            journal.tell(
                now,
                EventKind::Lease {
                    holder: self.book.state(now).holder,
                    epoch: self.book.epoch(),
                    reason: "expired".to_owned(),
                },
            );
        }
        self.live = live;
        let link = link::link(self.book.age(now), self.config.stale_after, self.config.lost_after);
        if link != self.link {
            self.link = link;
            journal.tell(now, EventKind::LinkChanged { link });
        }
    }

    /// What must be stored before any answer goes out, if it has changed since the last call.
    pub fn unstored(&mut self) -> Option<Persisted> {
        let wanted = Persisted {
            epoch: self.book.epoch(),
            stopped: self.stopped,
            leader: self.book.leader().cloned(),
        };
        (wanted != self.stored).then(|| {
            self.stored.clone_from(&wanted);
            wanted
        })
    }

    /// What may move the robot.
    #[must_use]
    pub fn motive(&self, now: Stamp, plan_valid: bool) -> link::MotionSource {
        if self.stopped {
            link::MotionSource::Brake
        } else {
            link::motive(
                self.book.is_live(now),
                self.book.role(),
                plan_valid,
                self.policy,
                self.link,
            )
        }
    }

    /// Whether the stop is latched.
    #[must_use]
    pub fn is_stopped(&self) -> bool {
        self.stopped
    }

    /// When the robot was resumed last.
    #[must_use]
    pub fn resumed(&self) -> Option<Stamp> {
        self.resumed
    }

    /// Whether somebody of this role holds a live lease.
    #[must_use]
    pub fn is_live_as(&self, now: Stamp, role: LeaseRole) -> bool {
        self.book.is_live(now) && self.book.role() == Some(role)
    }

    /// The current epoch.
    #[must_use]
    pub fn epoch(&self) -> u64 {
        self.book.epoch()
    }

    /// The policy in force.
    #[must_use]
    pub fn policy(&self) -> LostPolicy {
        self.policy
    }

    /// The link as last watched.
    #[must_use]
    pub fn link(&self) -> Link {
        self.link
    }

    /// The lease as the state shows it.
    #[must_use]
    pub fn lease_state(&self, now: Stamp) -> LeaseState {
        self.book.state(now)
    }
}

/// Why the names in a request are none, if so.
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

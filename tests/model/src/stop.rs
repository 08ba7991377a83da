//! Stop. A stop latches until a resume of the newest stop lifts it. Operators stop and resume a robot whose requests arrive late, out of order,
//! twice or never, and which may lose power between any two effects.
//!
//! The robot is an [`Authority`]: what it persists is on disk before its answer goes out. Its state tells the number of stops since its start
//! at once, before anything is on disk. An operator's resume names this number and its start, however old the state is. A stop counts as new
//! if its request arrives for the first time since the robot started, or if the robot is not stopped.

use std::collections::BTreeSet;

use stateright::{Model, Property};
use zenav_edge::arbitration::MotionSource;
use zenav_edge::authority::{Authority, Decision};
use zenav_edge::config::EdgeConfig;
use zenav_edge::control_io::Persisted;
use zenav_protocol::messages::{ResumeRequest, StopReply, StopRequest};
use zenav_protocol::time::Stamp;

use crate::check::{ContractModel, Size};
use crate::lease::{boot_id, clock, config, log};
use crate::text::Text;

/// Rules that keep a stopped robot at rest until somebody who knows of the stop lifts it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// A stop latches.
    Latch,
    /// The latch is on disk.
    LatchOnDisk,
    /// The robot's state is on disk before its answer goes out.
    PersistBeforeReply,
    /// A resume names the newest stop that its sender knows of.
    Named,
    /// Every stop has an id of its own, so it counts while an earlier one holds.
    OwnId,
    /// A resume names the robot's start whose number it names.
    OfBoot,
    /// A copy of a stop is not counted.
    StopOnce,
    /// A copy of a resume lifts nothing.
    ResumeOnce,
}

/// An action of the system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// A request to stop arrives, or a copy of it.
    Stop(u8),
    /// An operator who knows this state of the robot sends a request to resume.
    SendResume(Told),
    /// A request to resume arrives, or a copy of it.
    Resume(u8),
    /// The first pending effect is carried out: the disk is written, or an answer goes out.
    CarryOut,
    /// The robot loses power and starts again.
    Restart,
}

/// Bounds on the number of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bounds {
    stops: u8,
    resumes: u8,
    /// Whether a resume names the newest stop known to its sender.
    named: bool,
    copies: u8,
    restarts: u8,
}

/// The stop by the specification.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash)]
struct Latch {
    /// Number of the newest stop.
    newest: u8,
    is_stopped: bool,
}

/// An effect of a request.
#[derive(Clone, Debug, PartialEq, Hash)]
enum Effect {
    /// The disk is written; the latch by the specification.
    Store(Text<Persisted>, bool),
    /// The answer says whether the robot is stopped.
    Answer(bool),
}

/// What a state of the robot tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Told {
    /// The start of the robot.
    boot: usize,
    /// Number of stops since this start.
    stops: u64,
    /// The newest stop by the specification.
    newest: u8,
}

/// A request to resume.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Resume {
    /// The state that its sender knew.
    told: Told,
    has_arrived: bool,
}

/// The violated claim.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
enum Broken {
    LiftsNewer,
    CopyLifts,
    Refused,
}

/// The robot, and everything that operators have sent.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct State {
    robot: Text<Authority>,
    disk: Text<Persisted>,
    /// Restarts so far.
    boot: usize,
    effects: Vec<Effect>,
    left: Bounds,
    /// Requests to stop that have arrived, and those of them since the robot started.
    stops: u8,
    known: BTreeSet<u8>,
    resumes: Vec<Resume>,
    /// Requests to resume that were taken since the robot started.
    taken: BTreeSet<u8>,
    latch: Latch,
    /// Whether the latch is on disk by the specification.
    stored: bool,
    told: BTreeSet<Told>,
    /// Whether the robot is stopped according to its newest answer; `None` once that has changed.
    answered: Option<bool>,
    lifted: bool,
    refused: bool,
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
}

/// Time does not matter here.
fn now() -> Stamp {
    clock(0)
}

impl State {
    /// Queues the effects of a request.
    fn answer(&mut self, system: &System, decision: Decision<StopReply>) {
        let store = self.robot.unpersisted();
        let store = store.map(|state| Effect::Store(Text(state), self.latch.is_stopped));
        let answer = decision.answer.ok().map(|reply| Effect::Answer(reply.stopped));
        if system.has(Rule::PersistBeforeReply) {
            self.effects.extend(store.into_iter().chain(answer));
        } else {
            self.effects.extend(answer.into_iter().chain(store));
        }
    }

    /// Publishes the state.
    fn tell(&mut self) {
        self.told.insert(Told {
            boot: self.boot,
            stops: self.robot.stops(),
            newest: self.latch.newest,
        });
    }

    fn set_stopped(&mut self, is_stopped: bool) {
        if self.latch.is_stopped != is_stopped {
            // Earlier answers say no more what holds.
            self.answered = None;
            self.effects.retain(|effect| !matches!(effect, Effect::Answer(_)));
        }
        self.latch.is_stopped = is_stopped;
    }

    fn stop(&mut self, system: &System, request: u8) {
        let is_new = self.known.insert(request);
        self.latch.newest += u8::from(is_new || !self.latch.is_stopped);
        self.set_stopped(true);
        let id = if system.has(Rule::OwnId) { request } else { 0 };
        let request = StopRequest {
            by: None,
            request_id: system.has(Rule::StopOnce).then(|| format!("stop{id}")),
        };
        let mut log = log(self.boot);
        let decision = self.robot.stop(now(), &request, &mut log);
        if !system.has(Rule::Latch) {
            self.robot.resume(now(), &ResumeRequest::default(), &mut log);
        }
        self.tell();
        self.answer(system, decision);
    }

    fn resume(&mut self, system: &System, number: u8) -> Option<()> {
        let resume = self.resumes.get_mut(usize::from(number))?;
        resume.has_arrived = true;
        let told = resume.told;
        let named = system.bounds.named;
        let boot = if system.has(Rule::OfBoot) { told.boot } else { self.boot };
        let request = ResumeRequest {
            by: None,
            stop: (named && system.has(Rule::Named)).then_some(told.stops),
            boot_id: named.then(|| boot_id(boot)),
            request_id: system.has(Rule::ResumeOnce).then(|| format!("resume{number}")),
        };
        let was_stopped = self.robot.is_stopped();
        let decision = self.robot.resume(now(), &request, &mut log(self.boot));
        let is_copy = !self.taken.insert(number);
        let lifts = was_stopped && !self.robot.is_stopped();
        let is_of_newest = told.newest == self.latch.newest;
        // After a restart the operator looks at the robot again.
        let must_lift = was_stopped
            && if named {
                is_of_newest && told.boot == self.boot
            } else {
                !is_copy
            };
        if lifts && named && !is_of_newest {
            self.broken = Some(Broken::LiftsNewer);
        } else if lifts && !named && is_copy {
            self.broken = Some(Broken::CopyLifts);
        } else if must_lift && !lifts {
            self.broken = Some(Broken::Refused);
        }
        self.refused |= decision.answer.is_err();
        if lifts {
            self.set_stopped(false);
            self.lifted = true;
        }
        self.answer(system, decision);
        Some(())
    }
}

impl Model for System {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        let mut state = State {
            robot: Text(Authority::new(&self.config, Persisted::default())),
            disk: Text::default(),
            boot: 0,
            effects: Vec::new(),
            left: self.bounds,
            stops: 0,
            known: BTreeSet::new(),
            resumes: Vec::new(),
            taken: BTreeSet::new(),
            latch: Latch::default(),
            stored: false,
            told: BTreeSet::new(),
            answered: None,
            lifted: false,
            refused: false,
            broken: None,
        };
        state.tell();
        vec![state]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let left = &state.left;
        actions.extend((left.stops > 0).then_some(Action::Stop(state.stops)));
        if left.resumes > 0 {
            actions.extend(state.told.iter().map(|told| Action::SendResume(*told)));
        }
        for (number, resume) in (0..).zip(&state.resumes) {
            actions.extend((!resume.has_arrived || left.copies > 0).then_some(Action::Resume(number)));
        }
        if left.copies > 0 {
            actions.extend((0..state.stops).map(Action::Stop));
        }
        actions.extend((!state.effects.is_empty()).then_some(Action::CarryOut));
        actions.extend((left.restarts > 0).then_some(Action::Restart));
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        match action {
            Action::Stop(request) => {
                if request == state.stops {
                    (state.stops, state.left.stops) = (state.stops + 1, state.left.stops - 1);
                } else {
                    state.left.copies -= 1;
                }
                state.stop(self, request);
            }
            Action::SendResume(told) => {
                state.left.resumes -= 1;
                state.resumes.push(Resume {
                    told,
                    has_arrived: false,
                });
            }
            Action::Resume(number) => {
                let has_arrived = state.resumes.get(usize::from(number))?.has_arrived;
                state.left.copies -= u8::from(has_arrived);
                state.resume(self, number)?;
            }
            Action::CarryOut => match state.effects.remove(0) {
                Effect::Store(written, is_stopped) => (state.disk, state.stored) = (written, is_stopped),
                Effect::Answer(stopped) => state.answered = Some(stopped),
            },
            Action::Restart => {
                state.left.restarts -= 1;
                state.boot += 1;
                let mut disk = state.disk.0.clone();
                disk.stopped &= self.has(Rule::LatchOnDisk);
                *state.robot = Authority::new(&self.config, disk);
                state.latch.is_stopped = state.stored;
                state.effects.clear();
                state.known.clear();
                state.taken.clear();
                state.tell();
            }
        }
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always(
                "an answered stop holds until a resume lifts it, a resume until the next stop, also over restarts",
                |_, state: &State| {
                    let brakes = state.robot.motion_source(now(), true) == MotionSource::Brake;
                    state.answered.is_none_or(|stopped| stopped == brakes)
                },
            ),
            Property::always(
                "a resume lifts no stop that is newer than the state that its sender knew",
                |_, state: &State| state.broken != Some(Broken::LiftsNewer),
            ),
            Property::always(
                "a copy of a resume lifts nothing, even if the resume names no stop",
                |_, state: &State| state.broken != Some(Broken::CopyLifts),
            ),
            Property::always(
                "a resume of the newest stop since the robot's start lifts it, whatever copies arrive",
                |_, state: &State| state.broken != Some(Broken::Refused),
            ),
            Property::sometimes("a resume lifts a stop", |_, state: &State| {
                state.lifted && state.answered == Some(false)
            }),
            Property::sometimes("a robot that was resumed is stopped again", |_, state: &State| {
                state.lifted && state.answered == Some(true)
            }),
            Property::sometimes("a resume of an older stop is refused", |_, state: &State| state.refused),
        ]
    }
}

/// This part of the contract.
#[derive(Debug)]
pub struct Stop;

impl ContractModel for Stop {
    type Rule = Rule;
    type Bounds = Bounds;
    type System = System;
    const NAME: &'static str = "stop";
    const RULES: &'static [(Rule, &'static str)] = &[
        (Rule::Latch, "a stop latches until it is resumed"),
        (Rule::LatchOnDisk, "the latch is on disk: a restart does not release it"),
        (
            Rule::PersistBeforeReply,
            "a stop or a resume is on disk before it is answered",
        ),
        (Rule::Named, "a resume names the newest stop that its sender knows of"),
        (
            Rule::OwnId,
            "every stop has an id of its own: a second one counts while the first holds",
        ),
        (Rule::OfBoot, "a resume names the robot's start whose number it names"),
        (Rule::StopOnce, "a copy of a stop is not counted"),
        (Rule::ResumeOnce, "a copy of a resume is recognised by its id"),
    ];

    fn scenarios(size: Size) -> Vec<Bounds> {
        let mut scenarios = vec![NAMED, UNNAMED];
        if size == Size::Large {
            scenarios.extend([
                Bounds { resumes: 2, ..NAMED },
                Bounds { copies: 2, ..NAMED },
                Bounds { restarts: 2, ..NAMED },
            ]);
        }
        scenarios
    }

    fn breaks_in(rule: Rule) -> Bounds {
        if rule == Rule::ResumeOnce { UNNAMED } else { NAMED }
    }

    fn events(bounds: &Bounds) -> Vec<(u8, &'static str)> {
        let resumes = if bounds.named {
            "resume(s)"
        } else {
            "resume(s) that name no stop"
        };
        vec![
            (bounds.stops, "stop(s)"),
            (bounds.resumes, resumes),
            (bounds.copies, "cop(ies)"),
            (bounds.restarts, "restart(s) of the robot"),
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

/// Resumes name the newest stop that their sender knows of.
const NAMED: Bounds = Bounds {
    stops: 2,
    resumes: 1,
    named: true,
    copies: 1,
    restarts: 1,
};
/// Resumes lift any stop; a restart would forget their ids.
const UNNAMED: Bounds = Bounds {
    named: false,
    copies: 2,
    restarts: 0,
    ..NAMED
};

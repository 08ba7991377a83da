//! Plan validity. The time for which a plan moves the robot. Two missions publish plans, one after the other; the robot judges them by its
//! own clock, may be stopped and resumed, and may restart with a new clock.
//!
//! The header is judged by [`judge_head`] against [`Authority::grant`], an accepted plan is an [`ActivePlan`], the source of motion is
//! [`Authority::motion_source`]. The robot moves if a plan is its source of motion and allows a speed above zero.
//!
//! The network is implicit: any plan that could have been sent by now may arrive now. It may be written under any past grant, based on
//! any past state, however old, with any number, for the current trajectory or a new one. Missions have no clock, and may be
//! wrong about validity and stamps. A request for the lease may echo any past time of the robot, so that the grant lives longer.

use std::hash::{Hash, Hasher};

use nalgebra::Point2;
use stateright::{Model, Property};
use zenav_edge::acceptance::{Grant, judge_head};
use zenav_edge::active_plan::{ActivePlan, Scene};
use zenav_edge::arbitration::MotionSource;
use zenav_edge::authority::Authority;
use zenav_edge::config::EdgeConfig;
use zenav_edge::control_io::Persisted;
use zenav_edge::local_obstacles::LocalObstacles;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{
    BasedOn, Heartbeat, LeaseAction, LeaseRequest, LeaseRole, LostPolicy, MapRef, Plan, PlanStatistics, ResumeRequest,
    Revision, StopRequest,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::trajectory::Trajectory;

use crate::check::{ContractModel, Size};
use crate::lease::{TICK, boot_id, clock, config, lives, log};
use crate::text::Text;

/// Validity of an honest plan, ticks.
const VALID: u8 = 2;
/// Longest validity that the robot accepts, ticks.
const LONGEST: u8 = 3;

/// Rules that bound the motion by a plan.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Rule {
    /// Validity counts from the state that the plan is based on.
    FromState,
    /// An expired plan does not move the robot.
    Expiry,
    /// Validity is capped at the longest validity.
    Longest,
    /// A plan based on the future is refused.
    Future,
    /// A plan based on another boot is refused.
    Boot,
    /// A plan that is not newer than the newest is refused.
    Newer,
    /// A plan of another epoch is refused.
    Epoch,
    /// A plan is refused while no mission holds a live lease.
    Live,
    /// A grant to another holder discards the plan.
    HandoverDiscards,
    /// A stop latches.
    Latch,
    /// The latch is on disk.
    LatchOnDisk,
    /// A stop discards the plan.
    StopDiscards,
    /// A plan from before the resume is refused.
    Resume,
    /// Under the policy `stop` a robot without a live lease brakes.
    Policy,
}

/// A plan in transit.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Letter {
    /// The grant that it was written under.
    grant: u8,
    /// Its number among the plans of its writer.
    revision: u8,
    /// Time of the state that it is based on, ticks of true time.
    born: u8,
    /// Whether it renews the current trajectory.
    renews: bool,
    mistake: Option<Mistake>,
}

/// A mistake of a mission.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Mistake {
    /// The plan has endless validity.
    Endless,
    /// The plan is based on a state two ticks in the future.
    Ahead,
}

/// An action of the system.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Action {
    /// A mission asks for the lease, perhaps with an echo of the robot at a past time, and gets an answer.
    Acquire(u8, Option<u8>),
    /// The holder's heartbeat arrives.
    Beat,
    /// A plan arrives.
    Plan(Letter),
    /// Time passes.
    Tick,
    /// The robot is stopped.
    Stop,
    /// The stop is released.
    Resume,
    /// The robot restarts with a new clock.
    Restart,
}

/// Bounds on the number of events.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Bounds {
    missions: u8,
    grants: u8,
    echoes: u8,
    beats: u8,
    plans: u8,
    mistakes: u8,
    stops: u8,
    restarts: u8,
    ticks: u8,
}

/// A past grant: its mission and epoch.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
struct Given {
    mission: u8,
    epoch: u64,
}

/// The plan that is followed by the specification.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
struct Followed {
    writer: u8,
    /// True time of the state that it claims to be based on, and its validity from then on.
    born: u8,
    valid: u8,
    /// True time when it was accepted, and whether a lease was live then.
    accepted: u8,
    with_lease: bool,
}

/// The plan in force. Its tracker never steps here, so the plan is determined by its origin and its expiry.
#[derive(Clone, Debug)]
struct InForce(Option<ActivePlan>);

impl InForce {
    fn key(&self) -> Option<(u64, u64, Revision, u64)> {
        let active = self.0.as_ref()?;
        let expiry = active.progress(Stamp::ZERO, &Pose2::default()).valid_for;
        let plan = active.plan();
        Some((plan.trajectory_id, plan.epoch, plan.revision, expiry.to_bits()))
    }
}

impl PartialEq for InForce {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Hash for InForce {
    fn hash<H: Hasher>(&self, state: &mut H) {
        self.key().hash(state);
    }
}

/// The robot, and everything that missions can have sent.
#[derive(Clone, Debug, PartialEq, Hash)]
pub struct State {
    /// Whether the policy for a lost lease is to brake at once, instead of finishing the plan's horizon.
    brakes: bool,
    robot: Text<Authority>,
    plan: InForce,
    newest: Option<(u64, Revision)>,
    disk: Text<Persisted>,
    /// True times at which the robot started with a new clock.
    boots: Vec<u8>,
    time: u8,
    given: Vec<Given>,
    beats: u8,
    trajectories: u8,
    left: Bounds,
    followed: Option<Followed>,
    /// The holder according to the robot's grants.
    granted: Option<u8>,
    /// True time of the last heartbeat or grant.
    renewed: u8,
    /// Round trip of the grant's request until its first heartbeat, ticks.
    extra: u8,
    taken: Option<(u64, u8)>,
    older_taken: bool,
    stopped: bool,
    resumed: Option<u8>,
    moved: bool,
}

/// The system, optionally without some rules.
#[derive(Debug)]
pub struct System {
    bounds: Bounds,
    without: &'static [Rule],
    config: EdgeConfig,
    obstacles: LocalObstacles,
}

fn secs(ticks: u8) -> f64 {
    TICK * f64::from(ticks)
}

const fn name(mission: u8) -> &'static str {
    if mission == 0 { "mission-a" } else { "mission-b" }
}

impl System {
    fn has(&self, rule: Rule) -> bool {
        !self.without.contains(&rule)
    }

    fn robot(&self, brakes: bool, persisted: Persisted) -> Authority {
        let on_lost = if brakes {
            LostPolicy::Stop
        } else {
            LostPolicy::FinishHorizon
        };
        let config = EdgeConfig {
            on_lost,
            ..self.config.clone()
        };
        Authority::new(&config, persisted)
    }

    fn is_moving(&self, state: &State) -> bool {
        let now = state.clock();
        let Some(plan) = &state.plan.0 else { return false };
        let source = state.robot.motion_source(now, plan.is_valid(now));
        let rolls = source == MotionSource::Brake && !self.has(Rule::Policy);
        (source == MotionSource::Plan || rolls) && plan.speed_cap(now, self.config.tick, &self.config.model.drive) > 0.0
    }

    fn judge(&self, state: &mut State, letter: Letter) -> Option<()> {
        let now = state.clock();
        let epoch = state.robot.epoch();
        let given = *state.given.get(usize::from(letter.grant))?;
        let ahead = if letter.mistake == Some(Mistake::Ahead) { 2 } else { 0 };
        let valid = if letter.mistake == Some(Mistake::Endless) {
            100
        } else {
            VALID
        };
        let (boot, ticks) = state.at(letter.born);
        let boot = if self.has(Rule::Boot) { boot } else { state.boots.len() };
        let stamp = if self.has(Rule::FromState) {
            clock(ticks + ahead)
        } else {
            now
        };
        state.trajectories += u8::from(!letter.renews);
        let trajectory = state.trajectories;
        let plan = Plan {
            goal_id: "g".to_owned(),
            epoch: if self.has(Rule::Epoch) { given.epoch } else { epoch },
            revision: Revision {
                incarnation: given.mission.into(),
                counter: letter.revision.into(),
            },
            trajectory_id: trajectory.into(),
            map: MapRef::default(),
            frame: "map".to_owned(),
            based_on: BasedOn {
                stamp,
                boot_id: boot_id(boot),
            },
            valid_for: secs(valid),
            waypoints: vec![Point2::new(5.0, f64::from(trajectory))],
            trajectory: Trajectory::default(),
            splice: None,
            statistics: PlanStatistics::default(),
        };
        let live = state.robot.is_live_as(now, LeaseRole::Mission);
        let boot = boot_id(state.boots.len());
        let newest = state.newest.filter(|_| self.has(Rule::Newer));
        let grant = state.robot.grant(now, &boot, newest, &self.config.settings.acceptance);
        let grant = Grant {
            now: if self.has(Rule::Future) { now } else { now.max(stamp) },
            mission_live: grant.mission_live || !self.has(Rule::Live),
            resumed: grant.resumed.filter(|_| self.has(Rule::Resume)),
            max_validity: if self.has(Rule::Longest) { secs(LONGEST) } else { 1e6 },
            ..grant
        };
        let expiry = judge_head(&plan, &grant).ok()?;
        let expiry = if self.has(Rule::Expiry) {
            expiry
        } else {
            expiry.plus_secs(1e6)
        };
        let revision = plan.revision;
        let scene = Scene {
            model: &self.config.model,
            map_from_base: Pose2::default(),
            map_from_odom: Pose2::default(),
            velocity: Twist2::ZERO,
            obstacles: &self.obstacles,
            settings: &self.config.settings,
        };
        ActivePlan::take(&mut state.plan.0, plan, Pose2::IDENTITY, expiry, &scene).ok()?;
        state.newest = Some((epoch, revision));
        let rank = (epoch, letter.revision);
        state.older_taken |= state.taken.is_some_and(|taken| taken >= rank);
        state.taken = Some(rank);
        state.followed = Some(Followed {
            writer: given.mission,
            born: letter.born + ahead,
            valid: valid.min(LONGEST),
            accepted: state.time,
            with_lease: live,
        });
        Some(())
    }

    fn discard(state: &mut State, reason: Option<&str>) {
        if reason.is_some() {
            state.plan.0 = None;
        }
    }
}

impl State {
    /// The boot at a true time, and the ticks of the robot's clock then.
    fn at(&self, time: u8) -> (usize, u8) {
        let boot = self.boots.iter().filter(|began| **began <= time).count();
        let began = boot.checked_sub(1).and_then(|last| self.boots.get(last));
        (boot, time - began.copied().unwrap_or_default())
    }

    fn clock(&self) -> Stamp {
        clock(self.at(self.time).1)
    }

    fn is_past(&self, born: u8, ticks: u8) -> bool {
        self.time >= born + ticks
    }
}

impl Model for System {
    type State = State;
    type Action = Action;

    fn init_states(&self) -> Vec<State> {
        let begins = |brakes| State {
            brakes,
            robot: Text(self.robot(brakes, Persisted::default())),
            plan: InForce(None),
            newest: None,
            disk: Text::default(),
            boots: vec![0],
            time: 0,
            given: Vec::new(),
            beats: 0,
            trajectories: 0,
            left: self.bounds,
            followed: None,
            granted: None,
            renewed: 0,
            extra: 0,
            taken: None,
            older_taken: false,
            stopped: false,
            resumed: None,
            moved: false,
        };
        vec![begins(false), begins(true)]
    }

    fn actions(&self, state: &State, actions: &mut Vec<Action>) {
        let left = &state.left;
        if left.grants > 0 {
            for mission in 0..self.bounds.missions {
                actions.push(Action::Acquire(mission, None));
                if left.echoes > 0 {
                    actions.extend((0..=state.time).map(|time| Action::Acquire(mission, Some(time))));
                }
            }
        }
        actions.extend((!state.given.is_empty() && left.beats > 0).then_some(Action::Beat));
        if left.plans > 0 {
            let mistakes = [None, Some(Mistake::Endless), Some(Mistake::Ahead)];
            let mistakes = mistakes
                .get(..if left.mistakes > 0 { 3 } else { 1 })
                .unwrap_or_default();
            for grant in (0..).take(state.given.len()) {
                for (revision, born, mistake) in (1..=self.bounds.plans)
                    .flat_map(|revision| (0..=state.time).map(move |born| (revision, born)))
                    .flat_map(|(revision, born)| mistakes.iter().map(move |mistake| (revision, born, *mistake)))
                {
                    let letter = |renews| Letter {
                        grant,
                        revision,
                        born,
                        renews,
                        mistake,
                    };
                    actions.push(Action::Plan(letter(false)));
                    actions.extend((state.trajectories > 0).then(|| Action::Plan(letter(true))));
                }
            }
        }
        actions.extend((left.ticks > 0).then_some(Action::Tick));
        actions.extend((left.stops > 0 && !state.stopped).then_some(Action::Stop));
        actions.extend(state.stopped.then_some(Action::Resume));
        actions.extend((left.restarts > 0).then_some(Action::Restart));
    }

    fn next_state(&self, last: &State, action: Action) -> Option<State> {
        let mut state = last.clone();
        let now = state.clock();
        let mut log = log(last.boots.len());
        match action {
            Action::Acquire(mission, echo) => {
                state.left.grants -= 1;
                state.left.echoes -= u8::from(echo.is_some());
                let request_id = format!("r{}", state.left.grants);
                let request = LeaseRequest {
                    echo: echo.map(|time| clock(state.at(time).1)),
                    ..LeaseRequest::new(name(mission), LeaseRole::Mission, LeaseAction::Acquire, request_id)
                };
                let decision = state.robot.lease(now, &request, true, &mut log);
                *state.disk = state.robot.unpersisted().unwrap_or(state.disk.0.clone());
                let reply = decision.answer.ok()?;
                if self.has(Rule::HandoverDiscards) {
                    Self::discard(&mut state, decision.discard_reason);
                }
                state.granted = Some(mission);
                state.renewed = state.time;
                if state.given.last().is_none_or(|last| last.epoch != reply.epoch) {
                    // The echo of a time before a restart is a stamp of another clock.
                    let age = |time| state.at(state.time).1.saturating_sub(state.at(time).1);
                    (state.extra, state.beats) = (echo.map_or(0, age), 0);
                }
                state.robot.take_measured();
                state.given.push(Given {
                    mission,
                    epoch: reply.epoch,
                });
            }
            Action::Beat => {
                state.left.beats -= 1;
                state.beats += 1;
                let given = state.given.last()?;
                let beat = Heartbeat {
                    holder: name(given.mission).to_owned(),
                    epoch: given.epoch,
                    counter: state.beats.into(),
                    echo: None,
                };
                let live = state.robot.is_live_as(now, LeaseRole::Mission);
                state.robot.heartbeat(now, &beat, &mut log);
                if live {
                    (state.renewed, state.extra) = (state.time, 0);
                }
            }
            Action::Plan(letter) => {
                state.left.plans -= 1;
                state.left.mistakes -= u8::from(letter.mistake.is_some());
                self.judge(&mut state, letter)?;
            }
            Action::Tick => {
                state.left.ticks -= 1;
                state.time += 1;
            }
            Action::Stop => {
                state.left.stops -= 1;
                let decision = state.robot.stop(now, &StopRequest::default(), &mut log);
                *state.disk = state.robot.unpersisted().unwrap_or(state.disk.0.clone());
                if self.has(Rule::StopDiscards) {
                    Self::discard(&mut state, decision.discard_reason);
                }
                if !self.has(Rule::Latch) {
                    // The plan is discarded, but the stop does not latch.
                    state.robot.resume(Stamp::ZERO, &ResumeRequest::default(), &mut log);
                }
                state.stopped = true;
            }
            Action::Resume => {
                state.robot.resume(now, &ResumeRequest::default(), &mut log);
                *state.disk = state.robot.unpersisted().unwrap_or(state.disk.0.clone());
                state.stopped = false;
                state.resumed = Some(state.time);
            }
            Action::Restart => {
                state.left.restarts -= 1;
                let mut disk = state.disk.0.clone();
                disk.stopped &= self.has(Rule::LatchOnDisk);
                *state.robot = self.robot(state.brakes, disk);
                state.boots.push(state.time);
                (state.plan.0, state.newest, state.followed, state.granted) = (None, None, None, None);
            }
        }
        state.moved |= self.is_moving(&state);
        Some(state)
    }

    fn properties(&self) -> Vec<Property<Self>> {
        vec![
            Property::always("no motion past a plan's validity", |system: &Self, state: &State| {
                let is_past = |followed: &Followed| state.is_past(followed.born, followed.valid);
                !system.is_moving(state) || !state.followed.as_ref().is_none_or(is_past)
            }),
            Property::always(
                "no plan moves the robot for longer than the longest validity",
                |system: &Self, state: &State| {
                    let is_past = |followed: &Followed| state.is_past(followed.accepted, LONGEST);
                    !system.is_moving(state) || !state.followed.as_ref().is_none_or(is_past)
                },
            ),
            Property::always("a plan is not replaced by an older one", |_, state: &State| {
                !state.older_taken
            }),
            Property::always(
                "no motion on a plan of somebody who holds the lease no more",
                |system: &Self, state: &State| {
                    !system.is_moving(state) || state.followed.as_ref().map(|followed| followed.writer) == state.granted
                },
            ),
            Property::always("no plan is accepted without a live lease", |_, state: &State| {
                state.followed.as_ref().is_none_or(|followed| followed.with_lease)
            }),
            Property::always("no motion while stopped", |system: &Self, state: &State| {
                !(state.stopped && system.is_moving(state))
            }),
            Property::always(
                "after a stop, no motion but on a plan made after the resume",
                |system: &Self, state: &State| {
                    !system.is_moving(state)
                        || state
                            .followed
                            .as_ref()
                            .is_none_or(|followed| state.resumed.is_none_or(|resumed| followed.born >= resumed))
                },
            ),
            Property::always(
                "by the policy `stop`, no motion without a live lease",
                |system: &Self, state: &State| {
                    !state.brakes || !system.is_moving(state) || lives(state.time - state.renewed, state.extra)
                },
            ),
            Property::sometimes("a plan moves the robot", |_, state: &State| state.moved),
            Property::sometimes("a robot that was resumed moves", |system: &Self, state: &State| {
                state.resumed.is_some() && system.is_moving(state)
            }),
            Property::sometimes(
                "a lease outlives the plan of its silent holder, whose robot rests",
                |system: &Self, state: &State| {
                    let is_past = |followed: &Followed| state.is_past(followed.born, followed.valid);
                    state.extra > 0
                        && state.robot.is_live_as(state.clock(), LeaseRole::Mission)
                        && state.followed.as_ref().is_some_and(is_past)
                        && !system.is_moving(state)
                },
            ),
        ]
    }
}

/// This part of the contract.
#[derive(Debug)]
pub struct PlanValidity;

impl ContractModel for PlanValidity {
    type Rule = Rule;
    type Bounds = Bounds;
    type System = System;
    const NAME: &'static str = "plan";
    const RULES: &'static [(Rule, &'static str)] = &[
        (
            Rule::FromState,
            "a plan's validity counts from the state that it was made from, not from its arrival",
        ),
        (Rule::Expiry, "an expired plan moves nothing"),
        (
            Rule::Longest,
            "no plan is believed for longer than the longest validity",
        ),
        (Rule::Future, "a plan based on a state of the future is refused"),
        (
            Rule::Boot,
            "a plan based on a state of another boot is refused: its stamps are another clock's",
        ),
        (
            Rule::Newer,
            "a plan that is not newer than the newest of its epoch is refused",
        ),
        (Rule::Epoch, "a plan of another epoch is refused"),
        (Rule::Live, "a plan is refused while no mission holds a live lease"),
        (
            Rule::HandoverDiscards,
            "a lease that goes to somebody else discards the plan",
        ),
        (Rule::Latch, "a stop latches until it is resumed"),
        (Rule::LatchOnDisk, "the latch is on disk: a restart does not release it"),
        (Rule::StopDiscards, "a stop discards the plan"),
        (Rule::Resume, "a plan made before the resume is refused"),
        (
            Rule::Policy,
            "by the policy `stop`, a robot whose lease lapses brakes at once",
        ),
    ];

    fn scenarios(size: Size) -> Vec<Bounds> {
        let mut scenarios = vec![FOLLOW, MISTAKEN, SUCCEEDED, STOPPED, RESTARTED, SLOW];
        if size == Size::Large {
            scenarios.extend([
                Bounds {
                    beats: 1,
                    mistakes: 1,
                    ticks: 4,
                    ..SUCCEEDED
                },
                Bounds {
                    plans: 2,
                    ticks: 3,
                    ..RESTARTED
                },
                Bounds {
                    missions: 2,
                    grants: 2,
                    echoes: 2,
                    ticks: 5,
                    ..SLOW
                },
            ]);
        }
        scenarios
    }

    fn breaks_in(rule: Rule) -> Bounds {
        match rule {
            Rule::FromState | Rule::Expiry | Rule::Newer | Rule::Live | Rule::Policy => FOLLOW,
            Rule::Longest | Rule::Future => MISTAKEN,
            Rule::Epoch | Rule::HandoverDiscards => SUCCEEDED,
            Rule::Latch | Rule::StopDiscards | Rule::Resume => STOPPED,
            Rule::Boot | Rule::LatchOnDisk => RESTARTED,
        }
    }

    fn events(bounds: &Bounds) -> Vec<(u8, &'static str)> {
        vec![
            (bounds.missions, "mission(s)"),
            (bounds.grants, "request(s) for the lease"),
            (bounds.echoes, "echo(es)"),
            (bounds.beats, "heartbeat(s)"),
            (bounds.plans, "plan(s)"),
            (bounds.mistakes, "wrong stamp or validity"),
            (bounds.stops, "stop(s)"),
            (bounds.restarts, "restart(s) of the robot"),
            (bounds.ticks, "tick(s)"),
        ]
    }

    fn system(bounds: Bounds, without: &'static [Rule]) -> System {
        let config = config();
        System {
            bounds,
            without,
            obstacles: LocalObstacles::new(&config.model),
            config,
        }
    }
}

/// One mission publishes plans, in any order and however late.
const FOLLOW: Bounds = Bounds {
    missions: 1,
    grants: 1,
    echoes: 0,
    beats: 1,
    plans: 2,
    mistakes: 0,
    stops: 0,
    restarts: 0,
    ticks: 3,
};
/// Further events, each within its own bounds.
const MISTAKEN: Bounds = Bounds {
    plans: 1,
    mistakes: 1,
    ticks: 4,
    ..FOLLOW
};
const SUCCEEDED: Bounds = Bounds {
    missions: 2,
    grants: 2,
    beats: 0,
    ..FOLLOW
};
const STOPPED: Bounds = Bounds {
    beats: 0,
    stops: 1,
    ticks: 2,
    ..FOLLOW
};
const RESTARTED: Bounds = Bounds {
    grants: 2,
    beats: 0,
    plans: 1,
    stops: 1,
    restarts: 1,
    ticks: 2,
    ..FOLLOW
};
const SLOW: Bounds = Bounds {
    echoes: 1,
    plans: 1,
    ticks: 4,
    ..FOLLOW
};

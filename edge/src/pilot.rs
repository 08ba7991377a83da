//! What does the robot do in one control tick? Readings and mail in; wheel speeds, messages and answers out.
//!
//! The phases of a tick, in order: estimate, look around, answer asks, hear the lease, take plans, choose what moves
//! the robot, limit, guard, report. Pure: no clock, no I/O, no randomness; the same inputs give the same outputs.

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::*;
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;

use crate::acceptance::{Grant, Rejection, judge_head};
use crate::active_plan::{ActivePlan, Scene, Taken};
use crate::authority::Authority;
use crate::behaviours::Maneuvers;
use crate::collision_monitor::CollisionMonitor;
use crate::config::EdgeConfig;
use crate::control_io::{Inbox, Outbox, Persisted, Publication};
use crate::estimator::Estimator;
use crate::event_log::EventLog;
use crate::limiter::{Braking, Limiter};
use crate::link::MotionSource;
use crate::local_obstacles::LocalObstacles;
use crate::loop_timing::LoopTiming;
use crate::passive_safety::touched;
use crate::return_home::ReturnHome;
use crate::telemetry::{self, Telemetry};
use crate::teleop::DeadMan;
use crate::trackers::TrackerInput;
use crate::wall_follower::{Sight, WallFollower};
use crate::wheel_coordination::WheelCoordination;

/// A tick longer than this is not integrated by controllers and limiters, s.
const LONGEST_TICK: f64 = 0.1;
/// After so many ticks without one the wheels may have come to rest.
const SILENT_TICKS: f64 = 5.0;
/// A recovery may back up at this speed over floor that was seen before, m/s: its way was checked when it began.
const RECOVERY_BLIND_SPEED: f64 = 0.15;
/// A low battery counts as charged again once it has so much more, as a share.
const CHARGED: f64 = 0.05;
/// Discarded motions remembered.
const DISCARDED: usize = 32;
/// Refused plans remembered.
const REFUSED: usize = 256;

/// The robot's side, whole and pure.
#[derive(Clone, Debug)]
pub struct Pilot {
    pub(crate) config: EdgeConfig,
    pub(crate) gains: zenav_protocol::robot::ControllerGains,
    pub(crate) authority: Authority,
    pub(crate) behaviours: Maneuvers,
    pub(crate) journal: EventLog,
    pub(crate) estimator: Estimator,
    pub(crate) around: LocalObstacles,
    pub(crate) guard: CollisionMonitor,
    pub(crate) course: Option<ActivePlan>,
    pub(crate) wall_following: zenav_protocol::wall_following::WallFollowing,
    follower: WallFollower,
    homing: ReturnHome,
    limiter: Limiter,
    motors: WheelCoordination,
    stick: DeadMan,
    telemetry: Telemetry,
    newest: Option<(u64, Revision)>,
    /// Plans refused under the current grant: none comes back later, when it would fit by chance.
    refused: std::collections::VecDeque<(u64, Revision)>,
    discarded: std::collections::VecDeque<u64>,
    last: Option<Stamp>,
    pressed: bool,
    battery_is_low: bool,
    mode: Mode,
    missed_ticks: u64,
    pub(crate) punctuality: LoopTiming,
}

impl Pilot {
    /// A robot at rest. `boot_id` must be new at every start; `stored` is what the last life stored.
    #[must_use]
    pub fn new(config: EdgeConfig, boot_id: String, stored: Persisted) -> Self {
        let model = &config.model;
        Self {
            gains: model.controller.clone(),
            authority: Authority::new(&config, stored),
            behaviours: Maneuvers::default(),
            journal: EventLog::new(boot_id),
            estimator: Estimator::new(model, config.start, config.start_std, config.start_yaw_std),
            around: LocalObstacles::new(model),
            guard: CollisionMonitor::new(model, config.tick, config.scan_timeout),
            course: None,
            wall_following: model.wall_following.clone(),
            follower: WallFollower::new(model),
            homing: ReturnHome::default(),
            limiter: Limiter::new(&model.drive),
            motors: WheelCoordination::new(&model.drive),
            stick: DeadMan::new(config.dead_man),
            telemetry: Telemetry::default(),
            newest: None,
            refused: std::collections::VecDeque::new(),
            discarded: std::collections::VecDeque::new(),
            last: None,
            pressed: false,
            battery_is_low: false,
            mode: Mode::Idle,
            missed_ticks: 0,
            punctuality: LoopTiming::default(),
            config,
        }
    }

    /// One control tick at `now` (the stamp of the readings, on the edge's own clock).
    pub fn step(&mut self, now: Stamp, readings: &Readings, inbox: Inbox) -> Outbox {
        let mut out = Outbox::default();
        let last = self.last.replace(now);
        if last.is_none() {
            self.journal.tell(now, EventKind::Started);
        }
        let gap = last.map_or(0.0, |last| now.secs_since(last));
        let dt = gap.clamp(0.0, LONGEST_TICK);
        // A body that hears nothing for some ticks stops its wheels, as contact does.
        if readings.bump.pressed || gap >= SILENT_TICKS * self.config.tick {
            self.motors.may_rest();
        }
        self.missed_ticks = inbox.missed_ticks;
        if let Some(late) = inbox.late {
            self.punctuality.note(late);
        }
        self.sense(now, readings, &inbox.corrections, &mut out.publications);
        for (ticket, question) in inbox.questions {
            let answer = self.answer(now, question);
            out.answers.push((ticket, answer));
        }
        for heartbeat in &inbox.heartbeats {
            self.authority.heartbeat(now, heartbeat);
        }
        self.stick
            .hear(now, &inbox.teleops, &mut self.authority, &mut self.journal);
        self.authority.watch(now, &mut self.journal);
        self.take_plans(now, inbox.plans);

        let (wanted, braking) = if inbox.halt {
            (Twist2::ZERO, Braking::Hard)
        } else {
            self.choose(now, dt, &readings.bump)
        };
        if self.mode != Mode::WallFollow && self.authority.policy() == LostPolicy::WallFollow {
            self.follower.stand_by(
                now,
                self.mode == Mode::Teleop,
                &readings.bump,
                self.estimator.odom_from_base(),
                &mut self.journal,
            );
        }
        out.wheels = self.command(now, dt, wanted, braking, readings);
        self.notice(now);
        self.report(now, readings, &mut out.publications);
        out.persist = self.authority.unstored();
        out
    }

    /// Where the robot believes to be.
    #[must_use]
    pub fn map_from_base(&self) -> Pose2 {
        self.estimator.map_from_base()
    }

    /// Measured velocity, base frame.
    #[must_use]
    pub fn velocity(&self) -> Twist2 {
        self.estimator.velocity()
    }

    /// What decides the motion.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Where the wall follower stands.
    #[must_use]
    pub fn wall_follower(&self) -> WallFollowerState {
        self.follower.state()
    }

    fn sense(&mut self, now: Stamp, readings: &Readings, corrections: &[Correction], out: &mut Vec<Publication>) {
        let boot_id = self.journal.boot_id();
        let of_this_boot = corrections.iter().filter(|correction| correction.boot_id == boot_id);
        self.estimator.step(readings, of_this_boot);
        if let Some(kind) = self.telemetry.dropped(now, self.estimator.tally()) {
            self.journal.tell(now, kind);
        }
        self.telemetry.sensors(readings, &self.estimator, out);
        for sweep in &readings.sweeps {
            if let Some(odom_from_base) = self.estimator.odom_from_base_at(sweep.stamp)
                && self.around.insert(sweep, odom_from_base)
                && let Some(scan) = telemetry::scan(sweep, &self.config.model, &self.estimator)
            {
                out.push(Publication::Scan(sweep.lidar.clone(), scan));
            }
        }
        if readings.bump.pressed {
            let place = touched(&self.config.model.footprint, &readings.bump);
            self.around.touch(now, place, self.estimator.odom_from_base());
        }
        if readings.bump.pressed && !self.pressed {
            self.journal.tell(now, EventKind::Bumped);
        }
        self.pressed = readings.bump.pressed;
        let charge = readings.battery.charge;
        let low = self.config.model.battery.low;
        if charge < low && !self.battery_is_low {
            self.journal.tell(now, EventKind::BatteryLow { charge });
        }
        // Told once, until it has been charged.
        self.battery_is_low = charge < low + if self.battery_is_low { CHARGED } else { 0.0 };
    }

    /// Of a burst, only the newest plan of the current grant counts.
    fn take_plans(&mut self, now: Stamp, plans: Vec<Plan>) {
        let epoch = self.authority.epoch();
        let Some(plan) = plans
            .into_iter()
            .max_by_key(|plan| (plan.epoch == epoch, plan.epoch, plan.revision))
        else {
            return;
        };
        let newest = self.newest.filter(|(of, _)| *of == epoch).map(|(_, revision)| revision);
        let of_epoch = plan.epoch == epoch;
        let again = newest == Some(plan.revision) || self.refused.contains(&(epoch, plan.revision));
        if again && of_epoch {
            // The bus brings a kept sample again after every reconnection: nothing to tell.
            return;
        }
        let (goal_id, revision, trajectory_id) = (
            plan.goal_id.chars().take(128).collect::<String>(),
            plan.revision,
            plan.trajectory_id,
        );
        let taken = self.take_plan(now, plan, newest);
        // What a refused plan overtook is stale all the same; but a stranger's number must not lock the holder out.
        let of_the_writer =
            newest.is_some_and(|newest| newest.incarnation == revision.incarnation && revision > newest);
        if taken.is_ok() || (of_the_writer && of_epoch) {
            self.newest = Some((epoch, revision));
        }
        if taken.is_err() && of_epoch {
            self.refused.push_back((epoch, revision));
            if self.refused.len() > REFUSED {
                self.refused.pop_front();
            }
        }
        match taken {
            Ok(Taken::Renewed) => {}
            Ok(Taken::Begun) => self.journal.tell(
                now,
                EventKind::PlanAccepted {
                    goal_id,
                    revision,
                    trajectory_id,
                },
            ),
            Err(rejection) => self.journal.tell(
                now,
                EventKind::PlanRejected {
                    goal_id,
                    revision,
                    trajectory_id,
                    reason: rejection.to_string(),
                },
            ),
        }
    }

    fn take_plan(&mut self, now: Stamp, plan: Plan, newest: Option<Revision>) -> Result<Taken, Rejection> {
        let grant = Grant {
            now,
            boot_id: self.journal.boot_id(),
            epoch: self.authority.epoch(),
            mission_live: self.authority.is_live_as(now, LeaseRole::Mission),
            stopped: self.authority.is_stopped(),
            resumed: self.authority.resumed(),
            newest,
            max_validity: self.config.max_validity,
        };
        let expiry = judge_head(&plan, &grant)?;
        if self.discarded.contains(&plan.trajectory_id) {
            return Err(Rejection::Discarded(plan.trajectory_id));
        }
        if let Some(id) = self.behaviours.running() {
            return Err(Rejection::Busy(id.to_owned()));
        }
        let scene = Scene {
            model: &self.config.model,
            map_from_base: self.estimator.map_from_base(),
            map_from_odom: self.estimator.map_from_odom(),
            velocity: self.estimator.velocity(),
            around: &self.around,
        };
        ActivePlan::take(&mut self.course, plan, expiry, &scene)
    }

    /// Throws the plan and the behaviour away.
    pub(crate) fn discard(&mut self, now: Stamp, reason: &str) {
        self.behaviours.cancel(now, reason, &mut self.journal);
        self.discard_plan(now, reason);
        self.stick.release();
    }

    /// Throws the plan away: its motion never comes back.
    pub(crate) fn discard_plan(&mut self, now: Stamp, reason: &str) {
        let Some(course) = self.course.take() else {
            return;
        };
        if self.discarded.len() == DISCARDED {
            self.discarded.pop_front();
        }
        self.discarded.push_back(course.plan().trajectory_id);
        if !course.is_finished() {
            self.journal.tell(
                now,
                EventKind::PlanDiscarded {
                    goal_id: course.plan().goal_id.clone(),
                    reason: reason.to_owned(),
                },
            );
        }
    }

    /// Another holder numbers its motions anew.
    pub(crate) fn forget_discarded(&mut self) {
        self.discarded.clear();
    }

    /// What moves the robot, and how it brakes.
    fn choose(&mut self, now: Stamp, dt: f64, bump: &Bump) -> (Twist2, Braking) {
        let plan_valid = self.course.as_ref().is_some_and(|course| course.is_valid(now));
        let motive = self.authority.motive(now, plan_valid);
        if motive != MotionSource::ReturnHome {
            self.homing.note(self.estimator.map_from_base().position());
        }
        if self.behaviours.running().is_some() {
            // A behaviour moves under a live lease only; whose it is was checked when it began.
            let live = self.authority.lease_state(now).live;
            if live && motive != MotionSource::Brake {
                self.mode = Mode::Behaviour;
                let stopped = self.guard.zone() == GuardZone::Stop;
                let wanted = self.behaviours.step(
                    now,
                    dt,
                    self.estimator.odom_from_base(),
                    self.estimator.velocity(),
                    stopped,
                    &mut self.journal,
                );
                return (wanted, Braking::Normal);
            }
            self.behaviours.cancel(now, "the lease has expired", &mut self.journal);
        }
        match motive {
            MotionSource::Brake => {
                self.mode = if self.authority.is_stopped() {
                    Mode::Stopped
                } else {
                    Mode::Idle
                };
                (Twist2::ZERO, Braking::Hard)
            }
            MotionSource::Rest => {
                self.mode = Mode::Idle;
                (Twist2::ZERO, Braking::Normal)
            }
            MotionSource::WallFollow => {
                self.mode = Mode::WallFollow;
                let sight = Sight {
                    now,
                    dt,
                    settings: &self.wall_following,
                    around: &self.around,
                    odom_from_base: self.estimator.odom_from_base(),
                    bump,
                    stopped: self.guard.zone() == GuardZone::Stop,
                };
                (self.follower.step(&sight, &mut self.journal), Braking::Normal)
            }
            MotionSource::ReturnHome => {
                let map_from_base = self.estimator.map_from_base();
                if self.homing.is_home(&map_from_base) {
                    self.mode = Mode::Idle;
                    return (Twist2::ZERO, Braking::Normal);
                }
                self.mode = Mode::ReturnHome;
                let view = TrackerInput {
                    dt,
                    map_from_base,
                    velocity: self.estimator.velocity(),
                    speed_cap: f64::INFINITY,
                };
                (self.homing.step(&view, &self.config.model), Braking::Normal)
            }
            MotionSource::Teleop => {
                self.mode = Mode::Teleop;
                if self.stick.has_run_out(now) {
                    let reason = "no command follows".to_owned();
                    let zone = GuardZone::Stop;
                    self.journal.tell(now, EventKind::Guard { zone, reason });
                }
                (self.stick.twist(now), Braking::Normal)
            }
            MotionSource::Plan => match &mut self.course {
                Some(course) => {
                    let wanted = course.step(
                        now,
                        dt,
                        self.estimator.map_from_base(),
                        self.estimator.velocity(),
                        &self.config.model.drive,
                        &self.gains,
                    );
                    self.mode = if course.is_finished() { Mode::Idle } else { Mode::Follow };
                    (wanted, Braking::Normal)
                }
                None => (Twist2::ZERO, Braking::Normal),
            },
        }
    }

    /// Limits, then the guard's last word.
    fn command(&mut self, now: Stamp, dt: f64, wanted: Twist2, braking: Braking, readings: &Readings) -> [f64; 2] {
        let drive = &self.config.model.drive;
        let limited = drive.twist(self.limiter.limit(wanted, dt, braking));
        self.guard.blind_speed = match self.mode {
            Mode::Behaviour => self.gains.blind_speed.max(RECOVERY_BLIND_SPEED),
            _ => self.gains.blind_speed,
        };
        let verdict = self.guard.judge(
            now,
            limited,
            &self.around,
            self.estimator.odom_from_base(),
            &readings.bump,
        );
        if let Some(reason) = verdict.change {
            self.journal.tell(
                now,
                EventKind::Guard {
                    zone: self.guard.zone(),
                    reason,
                },
            );
        }
        let wheels = drive.wheels(verdict.twist);
        self.limiter.set(wheels, dt);
        self.motors.lead(wheels, dt)
    }

    /// Ends of the plan: reached, expired, lost.
    fn notice(&mut self, now: Stamp) {
        let pose = self.estimator.map_from_base();
        let Some(course) = &mut self.course else {
            return;
        };
        if course.ends(&pose) {
            let plan = course.plan();
            self.journal.tell(
                now,
                EventKind::PlanFinished {
                    goal_id: plan.goal_id.clone(),
                    trajectory_id: plan.trajectory_id,
                },
            );
        } else if course.expires(now) {
            self.journal.tell(
                now,
                EventKind::PlanExpired {
                    goal_id: course.plan().goal_id.clone(),
                },
            );
        } else if let Some(reason) = course.lost() {
            self.discard_plan(now, reason);
        }
    }

    fn report(&mut self, now: Stamp, readings: &Readings, out: &mut Vec<Publication>) {
        let events = self.journal.take();
        out.extend(events.into_iter().map(Publication::Event));
        if self.telemetry.marker_due(now) {
            let markers = match self.mode {
                Mode::Follow => self
                    .course
                    .as_ref()
                    .and_then(|course| course.marker(now))
                    .into_iter()
                    .collect(),
                Mode::WallFollow => {
                    let (map_from_odom, odom_from_base) =
                        (self.estimator.map_from_odom(), self.estimator.odom_from_base());
                    self.follower.markers(now, map_from_odom, odom_from_base)
                }
                _ => Vec::new(),
            };
            out.extend(markers.into_iter().map(Publication::Marker));
        }
        if self.telemetry.state_due(now) {
            out.push(Publication::State(Box::new(self.state(now, readings))));
        }
    }

    fn state(&self, now: Stamp, readings: &Readings) -> EdgeState {
        let pose = self.estimator.map_from_base();
        EdgeState {
            stamp: now,
            boot_id: self.journal.boot_id().to_owned(),
            mode: self.mode,
            link: self.authority.link(),
            lease: self.authority.lease_state(now),
            plan: self.course.as_ref().map(|course| course.progress(now, &pose)),
            velocity: self.estimator.velocity(),
            guard: self.guard.zone(),
            battery: readings.battery.charge,
            behaviour: self.behaviours.last().cloned(),
            wall_follower: (self.authority.policy() == LostPolicy::WallFollow).then(|| self.follower.state()),
            missed_ticks: self.missed_ticks,
        }
    }
}

#[cfg(test)]
mod rig;
#[cfg(test)]
mod tests;
#[cfg(test)]
mod wall_tests;

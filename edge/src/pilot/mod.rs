//! Pilot. What does the robot do in one control tick? Readings and messages in; wheel speeds, messages and replies out.
//!
//! The phases of a tick, in order: sense, answer requests, renew the lease, receive plans, arbitrate what moves the robot, limit, monitor
//! for collisions, report. Pure: no clock, no I/O, no randomness; the same inputs give the same outputs.
//!
//! | file | answers |
//! |---|---|
//! | `sense` | what do the readings of a tick change? |
//! | `plans` | which plan drives the robot? |
//! | `arbitrate` | which twist does the source that may move the robot want? |
//! | `frame` | which map frame is in force, and what is carried over when the map moves? |
//! | `localised` | does the robot know where it is, and what does it do if not? |
//! | `faults` | which faults does the robot itself have, and how does it continue? |
//! | `report` | what is published at the end of a tick? |
//! | `intent` | what does the robot announce of its course to other robots? |

mod arbitrate;
mod faults;
mod frame;
mod intent;
mod localised;
mod plans;
mod report;
mod sense;

pub(crate) use plans::{ACCEPTED, RENEWED};

use std::collections::VecDeque;
use std::time::Duration;

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{EventKind, Faults, Health, Intent, LostPolicy, Mode, Revision, WallFollowerState};
use zenav_protocol::readings::Readings;
use zenav_protocol::robot::ControllerGains;
use zenav_protocol::time::Stamp;
use zenav_protocol::wall_following::WallFollowing;

use crate::active_plan::ActivePlan;
use crate::authority::Authority;
use crate::avoidance::{Ahead, Avoidance};
use crate::collision_monitor::CollisionMonitor;
use crate::config::EdgeConfig;
use crate::control_io::{Inbox, Outbox, Persisted};
use crate::encoder_watch::EncoderWatch;
use crate::estimator::Estimator;
use crate::event_log::EventLog;
use crate::fixes::Fixes;
use crate::gyro_settling::GyroSettling;
use crate::limiter::{Braking, Limiter};
use crate::local_obstacles::LocalObstacles;
use crate::loop_timing::LoopTiming;
use crate::lost_beams::LostBeams;
use crate::maneuvers::Maneuvers;
use crate::mount_watch::MountWatch;
use crate::other_robots::OtherRobots;
use crate::return_home::ReturnHome;
use crate::right_of_way::RightOfWay;
use crate::telemetry::Telemetry;
use crate::teleop::DeadMan;
use crate::wall_follower::WallFollower;
use crate::wheel_coordination::WheelCoordination;
use frame::Frame;

/// Longest time step that controllers and limiters integrate, s.
const LONGEST_TICK: f64 = 0.1;
/// After this many ticks without a command the wheels may have come to rest.
const SILENT_TICKS: f64 = 5.0;

/// The robot's control logic, pure.
#[derive(Clone, Debug)]
pub struct Pilot {
    pub(crate) config: EdgeConfig,
    pub(crate) gains: ControllerGains,
    pub(crate) authority: Authority,
    pub(crate) maneuvers: Maneuvers,
    pub(crate) events: EventLog,
    pub(crate) estimator: Estimator,
    pub(crate) obstacles: LocalObstacles,
    pub(crate) collision_monitor: CollisionMonitor,
    pub(crate) active_plan: Option<ActivePlan>,
    avoidance: Avoidance,
    /// The rest of the plan, as of the last tick that followed one.
    ahead: Vec<Ahead>,
    other_robots: OtherRobots,
    right_of_way: RightOfWay,
    /// The intent last announced to other robots.
    intent: Intent,
    /// Time of the last report of the robots that this one gives way to.
    yield_told: Option<Stamp>,
    /// The goal for which the announced time to go was measured.
    way_goal: Option<String>,
    /// Since when the robot has been at rest with nothing to drive to.
    parked_since: Option<Stamp>,
    /// Since when the robot has been at rest on its plan without waiting for another robot.
    held_since: Option<Stamp>,
    pub(crate) wall_following: WallFollowing,
    wall_follower: WallFollower,
    return_home: ReturnHome,
    limiter: Limiter,
    wheel_coordination: WheelCoordination,
    encoder_watch: EncoderWatch,
    lost_beams: LostBeams,
    mount_watch: MountWatch,
    fixes: Fixes,
    gyro_settling: GyroSettling,
    dead_man: DeadMan,
    telemetry: Telemetry,
    newest: Option<(u64, Revision)>,
    /// Plans rejected under the current epoch: none is accepted later when it happens to fit.
    refused: VecDeque<(u64, Revision)>,
    discarded: VecDeque<u64>,
    last: Option<Stamp>,
    pressed: bool,
    /// Whether the last published list of obstacles had any.
    tracked: bool,
    battery_is_low: bool,
    /// Charge of the battery by the last readings, 0 to 1.
    charge: f64,
    pub(crate) faults: Faults,
    mode: Mode,
    /// The last report on whether the robot's pose in the map can be trusted.
    health: Health,
    /// The map frame of pose and plan.
    frame: Frame,
    missed_ticks: u64,
    pub(crate) loop_timing: LoopTiming,
}

impl Pilot {
    /// A robot at rest. `boot_id` must be new at every start; `stored` is what the last boot persisted.
    ///
    /// ```
    /// # use zenav_protocol::{geometry::Pose2, id::Id, messages::EventKind, readings::Readings, time::Stamp};
    /// # let config = zenav_edge::EdgeConfig::new(Id::robot("tiago")?, zenav_fixtures::robot("tiago"), Pose2::new(1.0, 2.0, 0.0));
    /// use zenav_edge::{Inbox, Persisted, Pilot, Publication};
    ///
    /// let mut pilot = Pilot::new(config, "boot-1".into(), Persisted::default());
    /// let now = Stamp::from_secs(0.02);
    /// let out = pilot.step(now, &Readings::new(now), Inbox::default());
    /// assert_eq!(out.wheels, [0.0, 0.0], "nobody commands it");
    /// let is_start = |published: &Publication| matches!(published, Publication::Event(event) if event.kind == EventKind::Started);
    /// assert!(out.publications.iter().any(is_start));
    /// assert!(pilot.map_from_base().distance(&Pose2::new(1.0, 2.0, 0.0)) < 1e-9);
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
    #[must_use]
    pub fn new(config: EdgeConfig, boot_id: String, stored: Persisted) -> Self {
        let (model, settings) = (&config.model, &config.settings);
        Self {
            gains: model.controller.clone(),
            authority: Authority::new(&config, stored),
            maneuvers: Maneuvers::default(),
            events: EventLog::new(boot_id),
            estimator: Estimator::new(model, config.start, &settings.estimator),
            obstacles: LocalObstacles::with_settings(model, settings),
            collision_monitor: CollisionMonitor::new(model, config.tick).with_settings(settings),
            active_plan: None,
            avoidance: Avoidance::new(model, &settings.avoidance),
            ahead: Vec::new(),
            other_robots: OtherRobots::new(config.robot.as_str()),
            right_of_way: RightOfWay::new(&settings.right_of_way),
            intent: Intent {
                robot: config.robot.to_string(),
                radius: model.footprint.circumscribed_radius(),
                ..Intent::default()
            },
            yield_told: None,
            way_goal: None,
            parked_since: None,
            held_since: None,
            wall_following: model.wall_following.clone(),
            wall_follower: WallFollower::new(model, &settings.wall_follower),
            return_home: ReturnHome::new(&settings.return_home),
            limiter: Limiter::new(&model.drive),
            wheel_coordination: WheelCoordination::new(&model.drive),
            encoder_watch: EncoderWatch::new(model),
            lost_beams: LostBeams::default(),
            mount_watch: MountWatch::default(),
            fixes: Fixes::default(),
            gyro_settling: GyroSettling::default(),
            dead_man: DeadMan::new(settings.teleop.dead_man),
            telemetry: Telemetry::new(&settings.telemetry, &settings.uplink),
            newest: None,
            refused: VecDeque::new(),
            discarded: VecDeque::new(),
            last: None,
            pressed: false,
            tracked: false,
            battery_is_low: false,
            charge: 1.0,
            faults: Faults::default(),
            mode: Mode::Idle,
            health: Health::default(),
            frame: Frame::default(),
            missed_ticks: 0,
            loop_timing: LoopTiming::default(),
            config,
        }
    }

    /// One control tick at `now` (the stamp of the readings, on the edge's own clock).
    ///
    /// ```
    /// # use zenav_edge::{EdgeConfig, Inbox, Persisted, Pilot, Ticket};
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_protocol::id::Id;
    /// # use zenav_protocol::messages::{LeaseAction, LeaseRequest, LeaseRole};
    /// # use zenav_protocol::readings::Readings;
    /// # use zenav_protocol::time::Stamp;
    /// # use zenav_protocol::topics::{EdgeReply, EdgeRequest};
    /// # let config = EdgeConfig::new(Id::robot("tiago")?, zenav_fixtures::robot("tiago"), Pose2::IDENTITY);
    /// let mut pilot = Pilot::new(config, "boot-1".into(), Persisted { epoch: 6, ..Persisted::default() });
    /// let request = LeaseRequest::new("mission-a", LeaseRole::Mission, LeaseAction::Acquire, "r1");
    /// let inbox = Inbox { requests: vec![(Ticket(1), EdgeRequest::Lease(request))], ..Inbox::default() };
    /// let now = Stamp::from_secs(0.02);
    /// let out = pilot.step(now, &Readings::new(now), inbox);
    /// let [(Ticket(1), Ok(EdgeReply::Lease(granted)))] = &out.replies[..] else { panic!("{out:?}") };
    /// assert_eq!(granted.epoch, 7, "higher than before the restart");
    /// assert_eq!(out.persist.map(|persisted| persisted.epoch), Some(7), "to be stored before the reply is sent");
    /// # Ok::<(), zenav_protocol::id::InvalidId>(())
    /// ```
    pub fn step(&mut self, now: Stamp, readings: &Readings, inbox: Inbox) -> Outbox {
        self.timed_step(now, readings, inbox, &mut || Duration::ZERO)
    }

    /// As [`Self::step`]; `clock` measures how long a phase takes, and nothing else depends on it.
    pub fn timed_step(
        &mut self,
        now: Stamp,
        readings: &Readings,
        inbox: Inbox,
        clock: &mut dyn FnMut() -> Duration,
    ) -> Outbox {
        let mut out = Outbox::default();
        let is_hit = readings.bump.pressed && !self.pressed;
        let dt = self.elapse(now, is_hit);
        let wheels = self.encoder_watch.angles(readings, self.wheel_coordination.speed(), dt);
        let guessed = (wheels != readings.wheels).then(|| Readings {
            wheels,
            ..readings.clone()
        });
        let readings = guessed.as_ref().unwrap_or(readings);
        self.missed_ticks = inbox.missed_ticks;
        self.charge = readings.battery.charge;
        self.note_faults(
            now,
            Faults {
                body: None,
                storage: inbox.not_stored,
                lidar: self.crooked_lidar(),
            },
        );
        if let Some(late) = inbox.late {
            self.loop_timing.record(late);
        }
        let corrections = self.in_present_frame(inbox.corrections);
        let here = self.estimator.map_from_base().position();
        self.other_robots.receive(now, here, inbox.intents);
        let odom_from_map = self.estimator.map_from_odom().inverse();
        self.obstacles
            .set_robots(self.other_robots.tracks(now, &self.intent, odom_from_map));
        self.sense(now, readings, &corrections, &mut out.publications);
        self.receive_health(now, inbox.localisations, &corrections);
        for (ticket, request) in inbox.requests {
            let reply = self.answer(now, request);
            out.replies.push((ticket, reply));
        }
        for heartbeat in &inbox.heartbeats {
            self.authority.heartbeat(now, heartbeat, &mut self.events);
        }
        if let Some(round_trip) = self.authority.take_measured() {
            let holder = self.authority.lease_state(now).holder.unwrap_or_default();
            self.telemetry.measured(now, round_trip, &holder);
        }
        self.dead_man
            .receive(now, &inbox.teleops, &mut self.authority, &mut self.events);
        self.authority.update_link(now, &mut self.events);
        out.verdict = self.receive_plans(now, inbox.plans);

        let (wanted, braking) = if inbox.halt {
            (Twist2::ZERO, Braking::Hard)
        } else {
            self.arbitrate(now, dt, &readings.bump)
        };
        if self.mode != Mode::WallFollow && self.authority.policy() == LostPolicy::WallFollow {
            self.wall_follower.stand_by(
                now,
                self.mode == Mode::Teleop,
                &readings.bump,
                self.estimator.odom_from_base(),
                &mut self.events,
            );
        }
        let began = clock();
        out.wheels = self.command(now, dt, wanted, braking, readings);
        out.monitor = clock().saturating_sub(began);
        self.end_plan(now);
        self.report(now, &mut out.publications);
        out.persist = self.authority.unpersisted();
        out
    }

    /// Stamp of the last readings, which is the robot's clock; zero before the first.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.last.unwrap_or_default()
    }

    /// Estimated pose in the map.
    #[must_use]
    pub fn map_from_base(&self) -> Pose2 {
        self.estimator.map_from_base()
    }

    /// The last report on whether the robot's pose in the map can be trusted.
    #[must_use]
    pub fn health(&self) -> &Health {
        &self.health
    }

    /// Measured velocity, base frame.
    #[must_use]
    pub fn velocity(&self) -> Twist2 {
        self.estimator.velocity()
    }

    /// Which source decides the motion.
    #[must_use]
    pub fn mode(&self) -> Mode {
        self.mode
    }

    /// Whether the robot leaves its plan to give way to a moving obstacle.
    #[must_use]
    pub fn is_making_way(&self) -> bool {
        self.avoidance.is_evading()
    }

    /// State of the wall follower.
    #[must_use]
    pub fn wall_follower(&self) -> WallFollowerState {
        self.wall_follower.state()
    }

    /// Begins a tick; `is_hit`: the bumper has just been pressed. Returns the time since the last one that controllers integrate, s.
    fn elapse(&mut self, now: Stamp, is_hit: bool) -> f64 {
        let last = self.last.replace(now);
        if last.is_none() {
            self.events.record(now, EventKind::Started);
        }
        let gap = last.map_or(0.0, |last| now.secs_since(last));
        // A body stops its wheels after some ticks without commands; so does a collision.
        if is_hit || gap >= SILENT_TICKS * self.config.tick {
            self.wheel_coordination.reset();
        }
        let drive = &self.config.model.drive;
        if gap >= SILENT_TICKS * self.config.tick + drive.top_speed() / drive.hard_braking {
            self.limiter.set([0.0; 2], gap);
            self.collision_monitor.rest();
        }
        gap.clamp(0.0, LONGEST_TICK)
    }

    /// Limits the wanted twist; the collision monitor then has the last word.
    fn command(&mut self, now: Stamp, dt: f64, wanted: Twist2, braking: Braking, readings: &Readings) -> [f64; 2] {
        let drive = &self.config.model.drive;
        let limited = drive.twist(self.limiter.limit(wanted, dt, braking));
        self.collision_monitor.blind_speed = match self.mode {
            Mode::Follow if !self.avoidance.is_evading() => self.gains.blind_speed,
            Mode::Behaviour | Mode::Follow => self.gains.blind_speed.max(self.config.settings.maneuvers.blind_speed),
            _ => self.gains.blind_speed,
        };
        self.collision_monitor.unseen_speed = 0.0;
        if matches!(self.mode, Mode::Follow | Mode::Behaviour) && self.obstacles.moving().is_quiet(now) {
            let feeling = self.config.settings.collision_monitor.feeling_speed;
            self.collision_monitor.blind_speed = self.collision_monitor.blind_speed.max(feeling);
            self.collision_monitor.unseen_speed = feeling;
        }
        self.collision_monitor.encoders_silent =
            self.encoder_watch.silence() > self.config.settings.estimator.encoder_timeout;
        self.collision_monitor.lidar_crooked = self.faults.lidar.is_some();
        let verdict = self.collision_monitor.judge(
            now,
            limited,
            &self.obstacles,
            self.estimator.odom_from_base(),
            &readings.bump,
        );
        if let Some(reason) = verdict.change {
            self.events.record(
                now,
                EventKind::Guard {
                    zone: self.collision_monitor.zone(),
                    reason,
                },
            );
        }
        let wheels = drive.wheels(verdict.twist);
        self.limiter.set(wheels, dt);
        self.wheel_coordination.command(wheels, dt)
    }
}

#[cfg(test)]
mod tests;

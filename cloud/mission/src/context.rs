//! Leaf context. What do the leaves of a tree act on? One robot, its map, its lease, the plan in force, the active goal.

use std::collections::{BTreeMap, VecDeque};
use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::lease::LONGEST_ROUND_TRIP;
use zenav_protocol::messages::{
    Annotations, BehaviourAction, BehaviourRequest, Blockage, DrivingProfile, GoalFeedback, GoalPhase, GoalPoint, Leg,
    Mode, Plan, PlanProgress, Yield,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::trajectory::Trajectory;

use super::asks::Asks;
use super::config::MissionConfig;
use super::frames::MapFrames;
use super::io::{Ask, Ticket};
use super::lease::{LeaseClient, newer};
use super::map::RobotMap;
use super::motion::{MotionKeeper, PlanDraft, Recheck, recheck};
use super::records::Restored;
use super::robot::RobotView;
use super::route::{InSight, Route, Tries, Waiting};
use zenav_space::{ConfigurationSpace, Zones};

/// Routes kept for the leaves that follow them.
const MAX_ROUTES: usize = 16;
/// Drives kept per goal.
const MAX_LEGS: usize = 64;
/// Time after its start during which a mission assumes that an unknown place may still be announced, s.
const PLACES_WITHIN: f64 = 5.0;

/// The active goal, with the state that its leaves write.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ActiveGoal {
    /// Id of the goal, as clients know it.
    pub id: String,
    /// Distance at which the goal counts as reached, m.
    pub tolerance: f64,
    /// The driving profile of its motions.
    pub profile: DrivingProfile,
    /// Progress that is published with the goal.
    pub feedback: GoalFeedback,
    /// The latest drives, oldest first.
    pub legs: Vec<Leg>,
    /// Number of changes of the drives.
    pub leg_changes: u64,
    /// Why a leaf failed last; the goal ends with this reason.
    pub failure: Option<String>,
    /// Time at which it began.
    pub started: Stamp,
    /// Time by which it must have ended.
    pub deadline: Option<Stamp>,
    /// The last obstacle waited for, and the end of the wait.
    pub waited: Option<(Blockage, Stamp)>,
    /// The obstacle that bars a shorter way than the driven one.
    pub(crate) avoided: Option<Waiting>,
    /// Last time at which the robot was turned towards the obstacle.
    pub looked: Option<Stamp>,
    /// How long the obstacle that was out of sight has been in sight since.
    pub(crate) in_sight: Option<InSight>,
    /// Number of approaches made, and time from which the next may begin.
    pub(crate) tries: Tries,
    /// The obstacle that covers the goal: its position, since when the robot has waited for it, and when it was last seen there.
    pub covered: Option<(Point2<f64>, Stamp, Stamp)>,
    /// Since when an obstacle has leaned on the robot, or when the robot last moved aside for it.
    pub leaned_on: Option<Stamp>,
}

/// What the leaves of one robot's trees act on.
#[derive(Debug)]
pub struct Context {
    /// Settings.
    pub config: Arc<MissionConfig>,
    /// The mission's time.
    pub now: Stamp,
    /// What the mission has heard of the robot.
    pub robot: RobotView,
    /// Replica of the map, with zones and configuration spaces.
    pub map: RobotMap,
    /// The frames of its map.
    pub frames: MapFrames,
    /// The robot's lease.
    pub lease: LeaseClient,
    /// The plan in force.
    pub motion: MotionKeeper,
    /// Requests to other components.
    pub asks: Asks,
    /// The active goal; empty between goals.
    pub goal: ActiveGoal,
    /// Plans to publish, in order.
    pub plans: Vec<Plan>,
    /// Nesting depth of the tree of the ticked leaf; 0 in the goal's own.
    pub nested: u32,
    /// Number of nodes of the goal's running inner trees.
    pub nested_nodes: usize,
    /// The maneuver that the robot was last asked for, unless it was called off.
    maneuver: Option<String>,
    /// The maneuver that a pause last called off.
    held_up: Option<String>,
    /// Time of the first step.
    begun: Option<Stamp>,
    /// Whether the annotations of the map have arrived.
    annotated: bool,
    /// The places of the annotations, and their frame.
    places: (u64, BTreeMap<String, GoalPoint>),
    /// How often a tree has asked to cancel the leaves of a registration id.
    cancels: BTreeMap<&'static str, u64>,
    routes: VecDeque<Arc<Route>>,
    route_count: u64,
    incarnation: u64,
    /// Name of the store, if there is one.
    store: Option<String>,
}

impl Context {
    /// Asks every running leaf of a registration id to end.
    pub fn cancel(&mut self, id: &'static str) {
        *self.cancels.entry(id).or_default() += 1;
    }

    /// Requests a maneuver of the robot.
    pub(crate) fn ask_maneuver(&mut self, request: BehaviourRequest) -> Ticket {
        self.maneuver = Some(request.id.clone());
        self.asks.ask(Ask::Behaviour(request))
    }

    /// Calls off the maneuver that the robot was last asked for, unless that was done before.
    pub(crate) fn call_off_last(&mut self) {
        if let Some(id) = self.maneuver.clone() {
            self.call_off(id);
        }
    }

    /// The same for a pause: the leaf completes the rest of its maneuver when it resumes.
    pub(crate) fn hold_up_last(&mut self) {
        if self.maneuver.is_some() {
            self.held_up.clone_from(&self.maneuver);
        }
        self.call_off_last();
    }

    /// Whether a pause called this maneuver off.
    pub(crate) fn is_held_up(&self, id: &str) -> bool {
        self.held_up.as_deref() == Some(id)
    }

    /// Calls off a maneuver in any state; one that has ended stays as it is.
    pub(crate) fn call_off(&mut self, id: String) {
        self.maneuver.take_if(|last| *last == id);
        if let Some(epoch) = self.lease.epoch() {
            let ticket = self.asks.ask(Ask::Behaviour(BehaviourRequest {
                id,
                action: BehaviourAction::Cancel,
                epoch: Some(epoch),
            }));
            self.asks.forget(ticket);
        }
    }

    /// Number of cancel requests for leaves of a registration id: a change since a leaf's start asks that leaf to end.
    #[must_use]
    pub fn cancels(&self, id: &str) -> u64 {
        self.cancels.get(id).copied().unwrap_or(0)
    }

    /// A context before the first observation.
    #[must_use]
    pub fn new(config: MissionConfig, restored: &Restored) -> Self {
        let incarnation = restored.incarnation;
        let map = RobotMap::new(Arc::clone(&config.zones));
        Self {
            lease: LeaseClient::new(&config.holder, incarnation, restored.store.clone(), restored.leadership),
            motion: MotionKeeper::new(incarnation),
            asks: Asks::new(incarnation),
            config: Arc::new(config),
            now: Stamp::ZERO,
            robot: RobotView::default(),
            map,
            frames: MapFrames::default(),
            places: (0, BTreeMap::new()),
            goal: ActiveGoal::default(),
            plans: Vec::new(),
            nested: 0,
            nested_nodes: 0,
            maneuver: None,
            held_up: None,
            begun: None,
            annotated: false,
            cancels: BTreeMap::new(),
            routes: VecDeque::new(),
            route_count: 0,
            incarnation,
            store: restored.store.clone(),
        }
    }

    /// Takes the time of a step, and new places and zones of the map.
    pub(super) fn observe(&mut self, now: Stamp, annotations: Option<Annotations>) {
        self.now = now;
        self.begun.get_or_insert(now);
        let Some(annotations) = annotations else { return };
        let zones = match Zones::new(&annotations.zones) {
            Ok(zones) => zones,
            Err(error) => {
                // The known zones stay in force: a keep-out zone must not vanish.
                tracing::error!(robot = %self.config.robot, %error, "the annotations of the map are refused");
                return;
            }
        };
        self.annotated = true;
        self.places = (annotations.frame, annotations.places);
        self.carry_places();
        let config = Arc::make_mut(&mut self.config);
        if *config.zones != zones {
            tracing::info!(robot = %config.robot, zones = annotations.zones.len(), "the zones of the map have changed");
            config.zones = Arc::new(zones);
            self.map.set_zones(Arc::clone(&config.zones));
        }
    }

    /// Converts the places to the present frame of the map.
    fn carry_places(&mut self) {
        let (from, places) = &self.places;
        let here = places.iter();
        let here = here.map(|(name, place)| (name.clone(), self.frames.place(*from, *place)));
        Arc::make_mut(&mut self.config).places = here.collect();
    }

    /// Switches to the frame of the newest map, with the plan in force and the places. Returns the previous frame if it changed.
    pub(super) fn settle(&mut self) -> Option<u64> {
        let before = self.frames.settle(self.map.newest().as_ref());
        if let Some(before) = before {
            let avoided = self.goal.avoided.take();
            self.goal.avoided = avoided.and_then(|avoided| avoided.settle(before, self));
            self.motion.settle(&self.frames);
            if self.annotated {
                self.carry_places();
            }
            tracing::info!(robot = %self.config.robot, frame = self.frames.at(), "the map has moved");
        }
        self.robot.settle(&self.frames);
        before
    }

    /// Whether the places added at run time have arrived.
    pub(super) fn knows_places(&self) -> bool {
        self.annotated
    }

    /// Whether unknown places may still be announced.
    pub(super) fn may_learn_places(&self) -> bool {
        let early = |begun| self.now.secs_since(begun) < PLACES_WITHIN;
        !self.annotated && self.begun.is_none_or(early)
    }

    /// An execution id that is unique over robots, stores and restarts.
    pub fn execution_id(&mut self) -> String {
        self.route_count += 1;
        let (robot, store) = (&self.config.robot, self.store.as_deref().unwrap_or("unstored"));
        format!("{robot}-{store}-{}-{}", self.incarnation, self.route_count)
    }

    /// Keeps a route for the leaf that follows it; returns its id.
    pub fn keep_route(&mut self, mut route: Route) -> u64 {
        self.route_count += 1;
        route.id = newer(self.incarnation, self.route_count);
        let id = route.id;
        if self.routes.len() == MAX_ROUTES {
            self.routes.pop_front();
        }
        self.routes.push_back(Arc::new(route));
        id
    }

    /// A route by its id; routes do not survive a restart.
    #[must_use]
    pub fn route(&self, id: u64) -> Option<Arc<Route>> {
        self.routes.iter().find(|route| route.id == id).cloned()
    }

    /// Why the robot cannot be driven now, if it cannot.
    #[must_use]
    pub fn obstacle_to_driving(&self) -> Option<String> {
        if self.lease.epoch().is_none() {
            return Some(format!("waiting for the lease: {}", self.lease.why_not()));
        }
        if self.round_trip() >= LONGEST_ROUND_TRIP.as_secs_f64() {
            return Some("waiting for a faster link: over a round trip of 10 s no lease lasts".to_owned());
        }
        if !self.robot.is_heard(self.now) || self.robot.pose().is_none() {
            return Some("waiting for the robot".to_owned());
        }
        if let Some(why) = self.robot.mismatch() {
            return Some(why.to_owned());
        }
        if let Some(why) = self.robot.state().and_then(|state| state.faults.body.as_ref()) {
            return Some(format!("waiting for the robot's body: {why}"));
        }
        match self.robot.state().map(|state| state.mode) {
            Some(Mode::Stopped) => Some("the robot is stopped".to_owned()),
            Some(Mode::Teleop) => Some("the robot is in teleoperation".to_owned()),
            Some(Mode::Behaviour) => Some("the robot runs a maneuver".to_owned()),
            _ => None,
        }
    }

    /// The configuration space of the present map, or why it is unknown.
    pub(crate) fn space_now(&mut self) -> Result<Arc<ConfigurationSpace>, String> {
        let Some(model) = self.robot.model().cloned() else {
            return Err("the robot has not described itself".to_owned());
        };
        if let Some(why) = self.map.unusable(self.now, self.config.settings.map_timeout) {
            return Err(why);
        }
        if !self.frames.is_settled() {
            return Err("the map is about to move".to_owned());
        }
        let space = self.map.space(&model.footprint);
        space.ok_or_else(|| "no map has come yet".to_owned())
    }

    /// Round trip to the robot and back, s, as measured by the robot: recent maximum.
    #[must_use]
    pub fn round_trip(&self) -> f64 {
        let told = self.robot.state().and_then(|state| state.round_trip_secs);
        let told = told.filter(|secs| secs.is_finite());
        told.unwrap_or_else(|| self.lease.round_trip())
            .clamp(0.0, LONGEST_ROUND_TRIP.as_secs_f64())
    }

    /// Time from the robot's newest state until a plan made from it is in force, s.
    #[must_use]
    pub fn latency_budget(&self) -> f64 {
        self.config.settings.latency_budget + self.round_trip()
    }

    /// The newest report of the robots that the robot gives way to on the motion in force, with times relative to now.
    #[must_use]
    pub fn yields(&self) -> Option<Yield> {
        self.robot.yields(self.now, self.motion.id()?, self.frames.at())
    }

    /// What the robot reports of the plan in force.
    pub(crate) fn progress(&self) -> Option<&PlanProgress> {
        let plan = self.robot.state()?.plan.as_ref();
        plan.filter(|plan| Some(plan.trajectory_id) == self.motion.id())
    }

    /// Plan time that the robot has reached on the plan in force, s; `None` unless it drives that plan.
    pub(crate) fn plan_time(&self) -> Option<f64> {
        self.motion.time(self.robot.state()?, 0.0, 0.0)
    }

    /// Rechecks the plan in force on the newest map, from a plan time on, s; or why it cannot be checked.
    pub(crate) fn recheck_from(&mut self, time: f64) -> Result<Recheck, String> {
        let (space, escape) = (self.space_now()?, self.config.settings.escape);
        let trajectory = self.motion.trajectory();
        Ok(trajectory.map_or(Recheck::Free, |trajectory| recheck(trajectory, &space, time, escape)))
    }

    /// The same from the robot's position on.
    pub(crate) fn recheck_rest(&mut self) -> Result<Recheck, String> {
        self.recheck_from(self.plan_time().unwrap_or(0.0))
    }

    /// The same for a trajectory that is to come into force.
    pub(crate) fn recheck_new(&mut self, trajectory: &Trajectory) -> Result<Recheck, String> {
        let (space, escape) = (self.space_now()?, self.config.settings.escape);
        Ok(recheck(trajectory, &space, 0.0, escape))
    }

    /// Time in which the robot can be brought to rest from now on, s: braking, the latency budget, and a lead. `None` without its model.
    pub(crate) fn stopping_time(&self) -> Option<f64> {
        let braking = zenav_smoothing::Limits::of(self.robot.model()?).braking_time(self.robot.velocity());
        Some(braking + self.latency_budget() + self.config.settings.obstacle.brake_early)
    }

    /// How long a plan is valid from the state that it was made from, s. The plan has used up one round trip of that when it arrives; the
    /// setting covers an ordinary link, and the excess is added.
    pub(crate) fn plan_valid(&self) -> f64 {
        let settings = &self.config.settings;
        settings.plan_valid + (self.round_trip() - settings.latency_budget).max(0.0)
    }

    /// Publishes a new plan for the active goal.
    pub fn drive(&mut self, mut draft: PlanDraft) {
        if draft.map.id.is_empty() {
            // A plan that needed no map is also in the present frame.
            draft.map.frame = self.frames.at();
        }
        let (Some(epoch), Some(based_on)) = (self.lease.epoch(), self.robot.based_on()) else {
            return;
        };
        let replaces = self.motion.was_begun_for_leg;
        let valid = self.plan_valid();
        let plan = self
            .motion
            .begin(draft, &self.goal.id, epoch, based_on, valid, self.now);
        self.goal.feedback.plans += 1;
        self.goal.feedback.replans += u64::from(replaces);
        if let Some(leg) = self.goal.legs.last_mut() {
            leg.plans += 1;
            leg.replans += u64::from(replaces);
            self.goal.leg_changes += 1;
        }
        self.plans.push(plan);
    }

    /// Renews the plan in force.
    pub fn renew(&mut self) {
        let valid = self.plan_valid();
        if let (Some(epoch), Some(based_on)) = (self.lease.epoch(), self.robot.based_on())
            && let Some(plan) = self.motion.renew(epoch, based_on, valid, self.now)
        {
            self.plans.push(plan);
        }
    }

    /// Shortens the plan in force to the braking time: the robot comes to rest on the checked path.
    pub fn hold(&mut self) {
        self.hold_within(f64::INFINITY);
    }

    /// The same; if possible, the robot is at rest `secs` after its newest state.
    pub fn hold_within(&mut self, secs: f64) {
        if let (Some(epoch), Some(based_on), Some(model)) =
            (self.lease.epoch(), self.robot.based_on(), self.robot.model())
        {
            let twist = self.robot.velocity();
            let limits = zenav_smoothing::Limits::of(model);
            let (braking, late) = (limits.braking_time(twist), self.round_trip());
            let valid_for = secs.clamp(0.1 + 1.05 * braking + late, 0.5 + 1.4 * braking + late);
            let valid_for = valid_for.min(self.plan_valid());
            if let Some(plan) = self.motion.hold(epoch, based_on, valid_for, self.now) {
                self.plans.push(plan);
            }
        }
    }

    /// Whether a drive is under way.
    #[must_use]
    pub fn is_driving(&self) -> bool {
        self.goal.legs.last().is_some_and(|leg| leg.state == GoalPhase::Active)
    }

    /// Begins a drive, or resumes the last one if it failed.
    pub fn begin_leg(&mut self, name: &str, goal: Option<GoalPoint>, planned_length: f64) {
        if let Some(leg) = self
            .goal
            .legs
            .last_mut()
            .filter(|leg| leg.name == name && leg.goal == goal && leg.state == GoalPhase::Aborted)
        {
            // The same drive, tried again.
            (leg.state, leg.reason, leg.ended) = (GoalPhase::Active, None, None);
            self.goal.leg_changes += 1;
            self.goal.feedback.recoveries += 1;
            return;
        }
        self.motion.was_begun_for_leg = false;
        if self.goal.legs.len() == MAX_LEGS {
            self.goal.legs.remove(0);
        }
        self.goal.legs.push(Leg {
            name: name.to_owned(),
            goal,
            state: GoalPhase::Active,
            reason: None,
            started: self.now,
            ended: None,
            plans: 0,
            replans: 0,
            planned_length,
        });
        self.goal.leg_changes += 1;
    }

    /// Ends the drive: no plan stays in force.
    pub fn end_leg(&mut self, state: GoalPhase, reason: Option<String>) {
        if state != GoalPhase::Succeeded {
            self.hold();
        }
        self.motion.clear();
        if let Some(leg) = self.goal.legs.last_mut().filter(|leg| leg.ended.is_none()) {
            leg.state = state;
            leg.reason = reason;
            leg.ended = Some(self.now);
            self.goal.leg_changes += 1;
        }
        self.goal.feedback.distance_left = None;
        self.goal.feedback.time_left = None;
        self.goal.avoided = None;
    }
}

//! Observer of a run. Combines what any client sees with the simulator's ground truth into the report.

use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use nalgebra::Point2;
use zenav_edge::Referee;
use zenav_protocol::bus::{Bus, Latest, Subscription};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{
    EdgeState, GoalPhase, GoalPoint, GoalState, Leg, MapInfo, MapRef, Plan, PoseEstimate, Scan,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;
use zenav_sim::{Truth, World};

use super::DemoArgs;
use super::album::Album;
use super::script::{Carried, Script};
use crate::drawing::plane::points_of;
use crate::failure::Failure;
use crate::output::piece;
use crate::report::{DemoReport, GoalReport, Latency, Percentiles, REACHED, per_metre};

/// Sampling period of the truth, wall time.
const SAMPLE: Duration = Duration::from_millis(10);
/// Period of progress lines in a plain log, wall time.
const LOG_EVERY: Duration = Duration::from_secs(5);
/// Faster than this counts as motion, m/s or rad/s.
const MOVING: f64 = 0.02;
/// From this speed on, wall-clock effects are visible.
const FAST: f64 = 4.0;
/// A goal within this distance of a place gets its name, m.
const SAME_PLACE: f64 = 0.01;

/// Ground truth at a moment.
#[derive(Clone, Copy)]
struct Sample {
    now: Stamp,
    truth: Truth,
}

/// What the demo sees as a client, and the referee's ground truth.
pub(super) struct Watch {
    referee: Referee,
    places: Vec<(String, Point2<f64>)>,
    scans: Latest<Scan>,
    poses: Latest<PoseEstimate>,
    states: Latest<EdgeState>,
    map: Latest<MapInfo>,
    plans: Subscription<Plan>,
    goals: Subscription<GoalState>,
    samples: Vec<Sample>,
    /// Arrival of recent scans and poses, by their stamp.
    arrivals: Vec<(Stamp, Instant)>,
    /// Newest scan in each recent map revision.
    revisions: Vec<(MapRef, Stamp)>,
    scan_to_plan: Vec<f64>,
    goal_to_motion: Vec<f64>,
    waiting_for_motion: Option<Instant>,
    seen_motion: Option<u64>,
    plans_seen: u64,
    goal: Option<GoalState>,
    state: Option<EdgeState>,
    told: String,
    last_log: Instant,
    /// Number of drives that have ended.
    ended: usize,
    /// The plan in force.
    planned: Vec<Point2<f64>>,
    /// Kidnapping still to come, and its world.
    pub carried: Option<(Carried, World)>,
    /// Live display, if there is one.
    pub bar: Option<ProgressBar>,
    /// Album of pictures, if wanted.
    pub album: Option<Album>,
}

impl Watch {
    /// # Errors
    /// A topic cannot be subscribed to.
    pub fn new(bus: &Bus, id: &Id, referee: Referee, world: &World) -> Result<Self, Failure> {
        let robot = &[id.as_str()];
        Ok(Self {
            referee,
            places: super::album::places(world),
            scans: bus.latest(&topics::SCAN, robot)?,
            poses: bus.latest(&topics::POSE, robot)?,
            states: bus.latest(&topics::STATE, robot)?,
            map: bus.latest(&topics::MAP_INFO, robot)?,
            plans: bus.subscribe(&topics::PLAN, robot, 64)?,
            goals: bus.subscribe(&topics::GOAL_STATE, &[id.as_str(), "*"], 64)?,
            samples: Vec::new(),
            arrivals: Vec::new(),
            revisions: Vec::new(),
            scan_to_plan: Vec::new(),
            goal_to_motion: Vec::new(),
            waiting_for_motion: None,
            seen_motion: None,
            plans_seen: 0,
            goal: None,
            state: None,
            told: String::new(),
            last_log: Instant::now(),
            ended: 0,
            planned: Vec::new(),
            carried: None,
            bar: None,
            album: None,
        })
    }

    /// Watches until the goal ends; `None` if the limit of simulated time passes first.
    pub async fn until_end(&mut self, goal_id: &str, limit_secs: f64) -> Option<GoalState> {
        let mut sampling = tokio::time::interval(SAMPLE);
        sampling.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
        loop {
            tokio::select! {
                biased;
                plan = self.plans.next() => self.see_plan(&plan?.message),
                goal = self.goals.next() => {
                    let goal = goal?.message;
                    if goal.id == goal_id {
                        self.see_goal(&goal);
                        self.see_ends(&goal);
                        if goal.state.is_end() {
                            self.sample();
                            return Some(goal);
                        }
                    }
                }
                open = self.scans.changed() => { open.then_some(())?; if let Some(scan) = self.scans.take() { self.arrived(scan.stamp); } }
                open = self.poses.changed() => { open.then_some(())?; if let Some(pose) = self.poses.take() { self.arrived(pose.stamp); } }
                open = self.states.changed() => { open.then_some(())?; self.see_state(); }
                open = self.map.changed() => {
                    open.then_some(())?;
                    if let Some(info) = self.map.take() {
                        self.revisions.push((info.map, info.stamp));
                        let excess = self.revisions.len().saturating_sub(64);
                        self.revisions.drain(..excess);
                    }
                }
                open = trees(&mut self.album) => { open.then_some(())?; if let Some(album) = &mut self.album { album.see(); } }
                _ = sampling.tick() => {
                    self.sample();
                    if self.referee.now().as_secs() > limit_secs {
                        return None;
                    }
                    self.tell();
                }
            }
        }
    }

    fn sample(&mut self) {
        let sample = Sample {
            now: self.referee.now(),
            truth: self.referee.truth(),
        };
        let is_due = |(carried, _): &mut (Carried, World)| sample.truth.length >= carried.after;
        if let Some((carried, world)) = self.carried.take_if(is_due) {
            match self.referee.carry(&world, carried.to) {
                Ok(()) => self.narrate("somebody carries the robot away"),
                Err(error) => tracing::warn!(%error, "the robot is not carried away"),
            }
        }
        if self.samples.last().is_none_or(|last| last.now < sample.now) {
            self.samples.push(sample);
        }
    }

    fn arrived(&mut self, stamp: Stamp) {
        self.arrivals.push((stamp, Instant::now()));
        let excess = self.arrivals.len().saturating_sub(512);
        self.arrivals.drain(..excess);
    }

    /// Takes in a new plan, and measures the time since the arrival of the scan or pose that it is based on.
    fn see_plan(&mut self, plan: &Plan) {
        let points = points_of(plan);
        if points.is_empty() || self.seen_motion.replace(plan.trajectory_id) == Some(plan.trajectory_id) {
            return;
        }
        self.plans_seen += 1;
        self.planned = points;
        // The newest scan in the map revision that the plan was checked on; if the map is not growing, the pose that the plan starts from.
        let scan = self
            .revisions
            .iter()
            .rev()
            .find(|(map, _)| *map == plan.map)
            .map(|(_, stamp)| *stamp);
        let basis = scan
            .filter(|stamp| plan.based_on.stamp.secs_since(*stamp).abs() < 1.0)
            .unwrap_or(plan.based_on.stamp);
        if let Some((_, arrival)) = self.arrivals.iter().rev().find(|(stamp, _)| *stamp <= basis) {
            self.scan_to_plan.push(arrival.elapsed().as_secs_f64() * 1e3);
        }
    }

    fn see_goal(&mut self, goal: &GoalState) {
        let begun = |goal: &GoalState| (goal.feedback.step.clone(), goal.legs.len());
        let at_rest = self
            .state
            .as_ref()
            .is_none_or(|state| state.velocity.v.abs() < MOVING && state.velocity.w.abs() < MOVING);
        if self.goal.as_ref().map(begun) != Some(begun(goal)) && at_rest {
            self.waiting_for_motion = Some(Instant::now());
        }
        self.goal = Some(goal.clone());
    }

    /// Draws a picture for each drive that has ended.
    fn see_ends(&mut self, goal: &GoalState) {
        let ended = goal.legs.iter().filter(|leg| leg.ended.is_some()).count();
        let more = ended > self.ended;
        self.ended = ended;
        if more
            && let Some(album) = &mut self.album
            && let Some(leg) = goal.legs.iter().rfind(|leg| leg.ended.is_some())
        {
            let driven = self.samples.iter().map(|sample| sample.truth.map_from_base.position());
            album.page(
                &name_of(leg, &self.places),
                leg.goal,
                self.planned.clone(),
                driven.collect(),
            );
        }
    }

    fn see_state(&mut self) {
        let Some(state) = self.states.take() else { return };
        let moving = state.velocity.v.abs() >= MOVING || state.velocity.w.abs() >= MOVING;
        if moving && let Some(since) = self.waiting_for_motion.take() {
            self.goal_to_motion.push(since.elapsed().as_secs_f64() * 1e3);
        }
        self.state = Some(state);
    }

    /// Shows the progress: a live line, or log lines at every new step and periodically.
    fn tell(&mut self) {
        let Some(goal) = &self.goal else { return };
        let step = goal.feedback.step.clone();
        let line = format!(
            "t {:5.1} s  {}  {}{}",
            self.referee.now().as_secs(),
            if step.is_empty() { "starting" } else { &step },
            piece(goal.feedback.distance_left, |left| format!("{left:.1} m left  ")),
            piece(self.state.as_ref(), |state| {
                format!("{:.2} m/s  {:?}  {:?}", state.velocity.v, state.mode, state.link)
            })
        );
        if let Some(bar) = &self.bar {
            bar.set_message(line);
        } else if step != self.told || self.last_log.elapsed() > LOG_EVERY {
            tracing::info!("{line}");
            self.told = step;
            self.last_log = Instant::now();
        }
    }

    pub fn narrate(&self, text: &str) {
        match &self.bar {
            Some(bar) => bar.set_message(text.to_owned()),
            None => tracing::info!("{text}"),
        }
    }

    /// The report: `end` is the final state of the mission's goal, `None` if it did not end in time.
    pub fn report(&self, script: &Script, args: &DemoArgs, end: Option<GoalState>) -> DemoReport {
        let truth = self.referee.truth();
        let goal = end.clone().or_else(|| self.goal.clone());
        let legs = goal.as_ref().map(|goal| goal.legs.clone()).unwrap_or_default();
        let goals: Vec<GoalReport> = legs.iter().map(|leg| self.leg_report(leg)).collect();
        let reason = match &end {
            None => Some("it did not come to an end in time".to_owned()),
            Some(goal) if goal.state != GoalPhase::Succeeded => {
                Some(format!("{:?}: {}", goal.state, goal.reason.clone().unwrap_or_default()))
            }
            Some(_) if truth.collisions > 0 => Some("the robot touched something".to_owned()),
            Some(_) => None,
        };
        let feedback = goal.map(|goal| goal.feedback).unwrap_or_default();
        let mut notes = Vec::new();
        if args.speed >= FAST {
            notes.push("at speed 4 and above a delay on the wall clock counts as so many times more simulated time: a plan that comes later than its lead is refused and made anew".to_owned());
        }
        let sim_time_s = self.referee.now().as_secs();
        DemoReport {
            goals,
            plans: self.plans_seen,
            replans: feedback.replans,
            latency: Latency {
                scan_to_plan_ms: Percentiles::of(&self.scan_to_plan),
                goal_to_motion_ms: Percentiles::of(&self.goal_to_motion),
            },
            notes,
            ..DemoReport::new(script.name, args.seed, args.speed, &truth, sim_time_s, reason)
        }
    }

    fn leg_report(&self, leg: &Leg) -> GoalReport {
        let end = leg.ended.unwrap_or(Stamp(u64::MAX));
        let during: Vec<&Sample> = self
            .samples
            .iter()
            .filter(|sample| sample.now >= leg.started && sample.now <= end)
            .collect();
        let (length, energy) = match (during.first(), during.last()) {
            (Some(first), Some(last)) => (
                last.truth.length - first.truth.length,
                last.truth.drawn_j - first.truth.drawn_j,
            ),
            _ => (0.0, 0.0),
        };
        let last = during.last().map(|sample| sample.truth.map_from_base);
        let error = leg
            .goal
            .zip(last)
            .map(|(goal, pose)| (goal.x - pose.x).hypot(goal.y - pose.y));
        GoalReport {
            name: name_of(leg, &self.places),
            outcome: if leg.state == GoalPhase::Succeeded {
                REACHED.to_owned()
            } else {
                leg.reason.clone().unwrap_or_else(|| format!("{:?}", leg.state))
            },
            time_s: leg.ended.map_or_else(
                || self.referee.now().secs_since(leg.started),
                |ended| ended.secs_since(leg.started),
            ),
            length_m: length,
            min_clearance_m: during
                .iter()
                .map(|sample| sample.truth.clearance)
                .fold(f64::INFINITY, f64::min),
            final_error_m: error,
            energy_j: energy,
            energy_per_m: per_metre(energy, length),
        }
    }
}

/// A drive's name: that of its node, or if the node has none of its own, the place it went to.
fn name_of(leg: &Leg, places: &[(String, Point2<f64>)]) -> String {
    let goal = leg.goal.filter(|_| leg.name == "FollowPath");
    let there = |goal: GoalPoint| {
        let near = |(_, place): &&(String, Point2<f64>)| (place - Point2::new(goal.x, goal.y)).norm() < SAME_PLACE;
        places.iter().find(near).map(|(name, _)| name.clone())
    };
    goal.and_then(there).unwrap_or_else(|| leg.name.clone())
}

/// Waits for a search tree; for ever without an album.
async fn trees(album: &mut Option<Album>) -> bool {
    match album {
        Some(album) => album.trees.changed().await,
        None => std::future::pending().await,
    }
}

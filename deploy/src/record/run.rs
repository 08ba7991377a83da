//! Run. A record in numbers: each robot's path, speed, clearance, goals, plans, stages and tree.
//!
//! Time is the robot's own, from its first pose on: in simulation that is simulated time. If its clock restarts, time continues. Data from
//! the cloud get the time of the newest pose received before them. Latencies are wall time at the recorder.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{
    EdgeState, Event, EventKind, GoalPhase, GoalState, MapPatch, MissionStatus, NodeStatus, Plan, PoseEstimate, Scan,
};
use zenav_protocol::robot::{Footprint, RobotModel};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

use super::format::{Kind, Sample, TITLE_ENTRY};
use super::maps::Maps;
use super::reader::RecordReader;
use super::run_clock::RunClock;
use super::words;
use crate::drawing::plane::points_of;
use crate::failure::Failure;

/// Interval between two points of a series, s.
const STEP: f64 = 0.05;
/// Below this the robot counts as stationary, m/s or rad/s.
const MOVING: f64 = 0.02;
/// Most scans and map revisions kept for latencies.
const REMEMBERED: usize = 512;
/// Most events and node spans kept.
const MOST: usize = 20_000;
/// Longest interval between poses that counts as driven, s.
const LONGEST_STEP: f64 = 1.0;
/// An event this long before the first pose belongs to an earlier run, s: the recorder also receives retained events.
const HISTORY: f64 = 2.0;

/// A run.
#[derive(Debug, Default)]
pub struct Run {
    /// Title of the recording.
    pub title: String,
    /// Arrival of the first sample, ns since the UNIX epoch.
    pub began: u64,
    /// Wall time from the first sample to the last, s.
    pub wall_secs: f64,
    /// Samples and payload bytes of each key.
    pub keys: BTreeMap<String, KeyCount>,
    /// Robots by name.
    pub robots: BTreeMap<String, RobotRun>,
    /// Whether the record was cut off.
    pub cut_off: bool,
    /// Damaged chunks of the record, which are left out.
    pub damaged_chunks: usize,
}

/// Traffic on a key.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct KeyCount {
    /// Samples.
    pub messages: u64,
    /// Bytes of their payloads.
    pub bytes: u64,
}

/// Run of one robot.
#[derive(Debug, Default)]
pub struct RobotRun {
    /// The robot's model, if its edge reported it.
    pub model: Option<RobotModel>,
    /// Poses, map frame, over time, s.
    pub poses: Vec<(f64, Pose2)>,
    /// Forward speed, m/s, over time, s.
    pub speed: Vec<(f64, f64)>,
    /// Distance from the outline to the nearest return of a lidar, m, over time, s.
    pub clearance: Vec<(f64, f64)>,
    /// Path driven, m.
    pub length: f64,
    /// Time from the first pose to the last, s.
    pub secs: f64,
    /// Events: time, s, whether it is a warning, and in words.
    pub events: Vec<(f64, bool, String)>,
    /// Goals, in their last state.
    pub goals: BTreeMap<String, GoalRun>,
    /// Trajectories published.
    pub plans: u64,
    /// Plans that the robot refused.
    pub rejected: u64,
    /// Latencies of stages, ms.
    pub stages: BTreeMap<&'static str, Vec<f64>>,
    /// When each tree node ran.
    pub nodes: Vec<NodeSpan>,
    /// The last plan in force.
    pub plan: Vec<Point2<f64>>,
    /// The map at the end.
    pub map: Option<OccupancyGrid>,
    /// Contacts reported by the bumper.
    pub bumps: u64,
    /// State while the record is read.
    pub(super) trace: Trace,
}

/// A goal, with the times when it was first and last reported, s.
#[derive(Debug)]
pub struct GoalRun {
    /// Its last state.
    pub state: GoalState,
    /// First report, s.
    pub from: f64,
    /// Last report, s.
    pub to: f64,
    /// Driven in between, m.
    pub length: f64,
    length_before: f64,
}

/// A span in which a node ran.
#[derive(Clone, Debug, PartialEq)]
pub struct NodeSpan {
    /// Goal, and number of the node.
    pub node: (String, u32),
    /// Depth in the tree.
    pub depth: usize,
    /// Its name.
    pub name: String,
    /// Start, s.
    pub from: f64,
    /// End, s.
    pub to: f64,
    /// `RUNNING` while it runs, then its result; `IDLE` if it has none, or none that is in the record.
    pub status: String,
}

/// A node's status; of a node that its parent has reset, its last result.
#[must_use]
pub fn node_status(node: &NodeStatus) -> &str {
    match (node.status.as_str(), node.last.as_str()) {
        ("IDLE", "SUCCESS" | "FAILURE" | "SKIPPED") => &node.last,
        (status, _) => status,
    }
}

/// The status in which a goal's end leaves the nodes that ran until then.
#[must_use]
pub const fn status_at_end(end: GoalPhase) -> &'static str {
    match end {
        GoalPhase::Succeeded => "SUCCESS",
        GoalPhase::Aborted => "FAILURE",
        _ => "IDLE",
    }
}

/// The nodes of a tree in document order, in which a parent comes before its children, each with its depth.
pub fn with_depths(nodes: &[NodeStatus]) -> impl Iterator<Item = (&NodeStatus, usize)> {
    let mut depths = BTreeMap::new();
    nodes.iter().map(move |node| {
        let parent = node.parent.and_then(|parent| depths.get(&parent));
        let depth = parent.map_or(0, |depth: &usize| depth + 1);
        depths.insert(node.uid, depth);
        (node, depth)
    })
}

/// State while a record is read.
#[derive(Debug, Default)]
pub struct Trace {
    clock: RunClock,
    /// Boot of the newest state.
    boot_id: String,
    at: Option<Pose2>,
    /// Arrivals of scans, ns.
    scans: Vec<(Stamp, u64)>,
    /// Newest scan of each map revision.
    revisions: Vec<(u64, Stamp)>,
    /// Events before the first pose, with their time since the start of the record, s: retained history, and early events.
    early: Vec<(Event, f64)>,
    trajectory: Option<u64>,
    moving: bool,
    plan_since: Option<u64>,
    open: BTreeMap<(String, u32), usize>,
}

impl Run {
    /// Reads a record.
    ///
    /// # Errors
    /// A bad record, or one with another message version.
    pub fn read(path: &Path) -> Result<Self, Failure> {
        let mut reader = RecordReader::open(path)?;
        reader.check_messages()?;
        let stem = || path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        let mut run = Self {
            title: reader.about().get(TITLE_ENTRY).cloned().unwrap_or_else(stem),
            ..Self::default()
        };
        let mut maps = Maps::default();
        let (mut first, mut last) = (None, 0);
        // The model arrives only after the recorder asked for it; clearance starts with the first scan.
        let mut scans = Vec::new();
        while let Some(sample) = reader.next_sample()? {
            run.began = *first.get_or_insert(sample.logged);
            last = last.max(sample.logged);
            maps.see(&sample);
            run.see(&sample, &mut scans);
        }
        run.wall_secs = last.saturating_sub(run.began) as f64 * 1e-9;
        run.cut_off = reader.is_cut_off();
        run.damaged_chunks = reader.damaged_chunks();
        reader.warn_of_losses();
        for (name, robot) in &mut run.robots {
            robot.map = maps.grid(name).cloned();
            robot.end();
        }
        run.robots
            .retain(|_, robot| !(robot.poses.is_empty() && robot.goals.is_empty() && robot.events.is_empty()));
        Ok(run)
    }

    fn see(&mut self, sample: &Sample, early: &mut Vec<(String, f64, Scan)>) {
        if let Some((name, info)) = sample.reply(&topics::EDGE_INFO) {
            let robot = self.robots.entry(name.clone()).or_default();
            robot.model = info.model;
            let footprint = robot.model.as_ref().map(|model| &model.footprint);
            if let Some(footprint) = footprint {
                for (_, time, scan) in early.iter().filter(|(of, _, _)| *of == name) {
                    robot
                        .clearance
                        .extend(clearance(scan, footprint).map(|least| (*time, least)));
                }
            }
            early.retain(|(of, _, _)| *of != name);
            return;
        }
        if sample.kind == Kind::Reply {
            return;
        }
        let count = self.keys.entry(sample.key.clone()).or_default();
        count.messages += 1;
        count.bytes += sample.bytes.len() as u64;
        let since = sample.logged.saturating_sub(self.began) as f64 * 1e-9;
        if let Some((name, pose)) = sample.message(&topics::POSE) {
            self.robot(name).pose(&pose);
        } else if let Some((name, scan)) = sample.message(&topics::SCAN) {
            let robot = self.robot(name.clone());
            robot.scan(&scan, sample.logged);
            if robot.model.is_none() && early.len() < REMEMBERED {
                early.push((name, robot.trace.clock.now, scan));
            }
        } else if let Some((name, state)) = sample.message(&topics::STATE) {
            self.robot(name).state(&state, sample.logged);
        } else if let Some((name, event)) = sample.message(&topics::EVENT) {
            self.robot(name).hear(event, since);
        } else if let Some((name, patch)) = sample.message(&topics::MAP_PATCH) {
            self.robot(name).patch(&patch, sample.logged);
        } else if let Some((name, plan)) = sample.message(&topics::PLAN) {
            self.robot(name).plan(&plan, sample.logged);
        } else if let Some((name, goal)) = sample.message(&topics::GOAL_STATE) {
            self.robot(name).goal(goal, since);
        } else if let Some((name, status)) = sample.message(&topics::MISSION) {
            self.robot(name).mission(&status);
        }
    }

    fn robot(&mut self, name: String) -> &mut RobotRun {
        self.robots.entry(name).or_default()
    }
}

impl RobotRun {
    /// Smallest clearance, m.
    #[must_use]
    pub fn least_clearance(&self) -> Option<f64> {
        let least = self.clearance.iter().map(|(_, clearance)| *clearance).reduce(f64::min);
        least.filter(|least| least.is_finite())
    }

    /// Mean speed, m/s; `None` for a run without a duration.
    #[must_use]
    pub fn mean_speed(&self) -> Option<f64> {
        (self.secs > 0.0).then(|| self.length / self.secs)
    }

    /// Largest speed, m/s.
    #[must_use]
    pub fn top_speed(&self) -> f64 {
        self.speed.iter().map(|(_, speed)| speed.abs()).fold(0.0, f64::max)
    }

    fn stage(&mut self, name: &'static str, ms: f64) {
        if ms.is_finite() && ms >= 0.0 {
            self.stages.entry(name).or_default().push(ms);
        }
    }

    fn pose(&mut self, pose: &PoseEstimate) {
        if !pose.map_from_base.is_finite() {
            return;
        }
        let (before, is_first) = (self.trace.clock.now, self.trace.clock.at(pose.stamp).is_none());
        let now = self.trace.clock.advance(pose.stamp);
        if is_first {
            for (event, _) in std::mem::take(&mut self.trace.early) {
                let time = self.trace.clock.at(event.stamp).unwrap_or_default();
                if time >= -HISTORY {
                    self.event(time, &event);
                }
            }
        }
        // Integrated from the velocity: the pose estimate jumps when it is corrected.
        if self.trace.at.is_some() {
            self.length += pose.velocity.v.abs() * (now - before).clamp(0.0, LONGEST_STEP);
        }
        self.trace.at = Some(pose.map_from_base);
        self.secs = now;
        if self.poses.last().is_none_or(|(time, _)| now >= time + STEP) {
            self.poses.push((now, pose.map_from_base));
            self.speed.push((now, pose.velocity.v));
        }
    }

    fn scan(&mut self, scan: &Scan, logged: u64) {
        self.trace.scans.push((scan.stamp, logged));
        let excess = self.trace.scans.len().saturating_sub(REMEMBERED);
        self.trace.scans.drain(..excess);
        if let Some(model) = &self.model {
            let least = clearance(scan, &model.footprint);
            self.clearance.extend(least.map(|least| (self.trace.clock.now, least)));
        }
    }

    /// Arrival of the scan with this stamp, ns.
    fn arrival(&self, stamp: Stamp) -> Option<u64> {
        let mut scans = self.trace.scans.iter().rev();
        scans.find(|(of, _)| *of == stamp).map(|(_, arrival)| *arrival)
    }

    fn state(&mut self, state: &EdgeState, logged: u64) {
        self.trace.boot_id.clone_from(&state.boot_id);
        if let Some(round_trip) = state.round_trip_secs {
            self.stage("heartbeat round trip", 1e3 * round_trip);
        }
        let is_moving = state.velocity.v.abs() >= MOVING || state.velocity.w.abs() >= MOVING;
        self.trace.moving = is_moving;
        if is_moving && let Some(since) = self.trace.plan_since.take() {
            self.stage("plan to motion", millis(since, logged));
        }
    }

    /// Takes in an event, `since` s after the start of the record.
    fn hear(&mut self, event: Event, since: f64) {
        match self.trace.clock.at(event.stamp) {
            // Far older than the record: history if it is of the current boot; otherwise of a new boot with a restarted clock, whose first
            // pose is still to come.
            Some(time) if time < -HISTORY && event.boot_id == self.trace.boot_id => {}
            Some(time) if time < -HISTORY => self.event(self.trace.clock.now, &event),
            Some(time) => self.event(time, &event),
            None if self.trace.early.len() < MOST => self.trace.early.push((event, since)),
            None => {}
        }
    }

    fn event(&mut self, time: f64, event: &Event) {
        match event.kind {
            EventKind::Bumped => self.bumps += 1,
            EventKind::PlanRejected { .. } => self.rejected += 1,
            _ => {}
        }
        // The newest events matter most: how the run ended.
        if self.events.len() >= 2 * MOST {
            self.events.drain(..MOST);
        }
        self.events
            .push((time, words::is_warning(&event.kind), words::event(&event.kind)));
    }

    fn patch(&mut self, patch: &MapPatch, logged: u64) {
        if let Some(arrival) = self.arrival(patch.stamp) {
            self.stage("scan to map", millis(arrival, logged));
        }
        self.trace.revisions.push((patch.map.revision, patch.stamp));
        let excess = self.trace.revisions.len().saturating_sub(REMEMBERED);
        self.trace.revisions.drain(..excess);
    }

    fn plan(&mut self, plan: &Plan, logged: u64) {
        let points = points_of(plan);
        if points.is_empty() || self.trace.trajectory.replace(plan.trajectory_id) == Some(plan.trajectory_id) {
            return;
        }
        self.plans += 1;
        self.plan = points;
        let statistics = &plan.statistics;
        self.stage("search", statistics.search_ms);
        self.stage("corridor", statistics.corridor_ms);
        self.stage("geometry", statistics.geometry_ms);
        self.stage("time law", statistics.timing_ms);
        // If the map does not change, the plan is based on a pose instead of a scan.
        let mut revisions = self.trace.revisions.iter().rev();
        let scan = revisions.find(|(revision, _)| *revision == plan.map.revision);
        let near = |stamp: Stamp| plan.based_on.stamp.secs_since(stamp).abs() < 1.0;
        if let Some((_, stamp)) = scan.filter(|(_, stamp)| near(*stamp))
            && let Some(arrival) = self.arrival(*stamp)
        {
            self.stage("scan to plan", millis(arrival, logged));
        }
        if !self.trace.moving {
            self.trace.plan_since = Some(logged);
        }
    }

    fn goal(&mut self, goal: GoalState, since: f64) {
        let (now, length) = (self.trace.clock.now, self.length);
        let is_history = goal.state.is_end() && !self.has_ended_here(&goal, since);
        match self.goals.get_mut(&goal.id) {
            Some(known) => {
                if !known.state.state.is_end() {
                    known.to = now;
                    known.length = length - known.length_before;
                }
                known.state = goal;
            }
            // Ended before the record started: a late joiner still receives it.
            None if is_history => {}
            None => {
                let new = GoalRun {
                    from: now,
                    to: now,
                    length: 0.0,
                    length_before: length,
                    state: goal,
                };
                self.goals.insert(new.state.id.clone(), new);
            }
        }
    }

    /// Whether a goal first reported now ended during the record, which started `since` s ago: a starting mission publishes the last goals
    /// of its store again.
    fn has_ended_here(&self, goal: &GoalState, since: f64) -> bool {
        let ended = goal.ended.and_then(|ended| self.trace.clock.at(ended));
        ended.map_or(since >= HISTORY, |ended| {
            (-HISTORY..=self.trace.clock.now + HISTORY).contains(&ended)
        })
    }

    fn mission(&mut self, status: &MissionStatus) {
        let now = self.trace.clock.now;
        let goal = status.goal_id.clone().unwrap_or_default();
        for (node, depth) in with_depths(&status.nodes) {
            let place = (goal.clone(), node.uid);
            let running = node.status == "RUNNING";
            match self.trace.open.get(&place).copied() {
                Some(open) => {
                    if let Some(span) = self.nodes.get_mut(open) {
                        span.to = now;
                        node_status(node).clone_into(&mut span.status);
                    }
                    if !running {
                        self.trace.open.remove(&place);
                    }
                }
                None if running && self.nodes.len() < MOST => {
                    self.trace.open.insert(place.clone(), self.nodes.len());
                    self.nodes.push(NodeSpan {
                        node: place,
                        depth,
                        name: if node.name.is_empty() {
                            node.id.clone()
                        } else {
                            node.name.clone()
                        },
                        from: now,
                        to: now,
                        status: node.status.clone(),
                    });
                }
                None => {}
            }
        }
        // Nodes of an earlier goal no longer run.
        self.trace.open.retain(|(of, _), _| *of == goal);
    }

    /// Ends the spans whose node was still running when its tree vanished: with the goal, and with its result.
    fn close_spans(&mut self) {
        let open: BTreeSet<usize> = self.trace.open.values().copied().collect();
        let running = self.nodes.iter_mut().enumerate();
        for (at, span) in running.filter(|(_, span)| span.status == "RUNNING") {
            match self.goals.get(&span.node.0) {
                Some(goal) if goal.state.state.is_end() => {
                    span.to = goal.to.max(span.from);
                    status_at_end(goal.state.state).clone_into(&mut span.status);
                }
                _ if open.contains(&at) => span.to = self.secs.max(span.from),
                _ => "IDLE".clone_into(&mut span.status),
            }
        }
    }

    fn end(&mut self) {
        // Without a pose, time starts at the first event.
        for (event, since) in std::mem::take(&mut self.trace.early) {
            if since >= HISTORY {
                self.trace.clock.advance(event.stamp);
                self.event(self.trace.clock.now, &event);
            }
        }
        self.clearance.sort_by(|a, b| a.0.total_cmp(&b.0));
        self.events.sort_by(|a, b| a.0.total_cmp(&b.0));
        for goal in self.goals.values_mut().filter(|goal| !goal.state.state.is_end()) {
            goal.to = self.secs;
            goal.length = self.length - goal.length_before;
        }
        self.close_spans();
    }
}

fn millis(from: u64, to: u64) -> f64 {
    to.saturating_sub(from) as f64 * 1e-6
}

/// Distance from the outline to the nearest return of the scan, m; zero if a return is inside. `None` without a return.
fn clearance(scan: &Scan, footprint: &Footprint) -> Option<f64> {
    let points = scan.returns().map(|point| scan.base_from_laser.transform_point(point));
    points.map(|point| footprint.distance(point)).reduce(f64::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_scan_without_a_return_has_no_clearance() {
        let scan = Scan {
            ranges: vec![f32::INFINITY; 5],
            ..zenav_fixtures::scan(1, Pose2::IDENTITY, vec![])
        };
        assert_eq!(clearance(&scan, &Footprint::Radius(0.3)), None);
    }

    fn at(secs: f64) -> PoseEstimate {
        PoseEstimate {
            stamp: Stamp::ZERO.plus_secs(secs),
            map_from_base: Pose2::IDENTITY,
            covariance: [0.0; 9],
            velocity: zenav_protocol::geometry::Twist2::ZERO,
            frame: 0,
        }
    }

    fn goal(id: &str, state: GoalPhase) -> GoalState {
        GoalState {
            queue: None,
            id: id.to_owned(),
            robot: "r".to_owned(),
            state,
            reason: None,
            accepted: Stamp::ZERO,
            started: None,
            ended: None,
            feedback: Default::default(),
            legs: Vec::new(),
            request: Default::default(),
            resolved: Vec::new(),
        }
    }

    /// A mission that runs nodes for a goal: name, status and last result of each.
    fn mission(goal: Option<&str>, nodes: &[(&str, &str, &str)]) -> MissionStatus {
        let node = |(uid, (name, status, last)): (u32, &(&str, &str, &str))| NodeStatus {
            uid,
            parent: None,
            name: (*name).to_owned(),
            id: (*name).to_owned(),
            status: (*status).to_owned(),
            feedback: String::new(),
            last: (*last).to_owned(),
            ports: BTreeMap::new(),
        };
        MissionStatus {
            stamp: Stamp::ZERO,
            holder: "m".to_owned(),
            leads: true,
            epoch: 1,
            goal_id: goal.map(str::to_owned),
            tree: goal.map(|_| "navigate".to_owned()),
            nodes: (1..).zip(nodes).map(node).collect(),
            feedback: Default::default(),
            queued: 0,
            standbys: Vec::new(),
        }
    }

    #[test]
    fn a_node_that_ran_when_its_tree_vanished_ends_with_the_goal_and_its_result() {
        let running = [("Drive", "RUNNING", "RUNNING"), ("Look", "RUNNING", "RUNNING")];
        let mut run = RobotRun::default();
        run.pose(&at(1.0));
        run.goal(goal("a", GoalPhase::Active), 9.0);
        run.mission(&mission(Some("a"), &running));
        run.pose(&at(3.0));
        // Reset by its parent in the tick in which it succeeded.
        run.mission(&mission(Some("a"), &[running[0], ("Look", "IDLE", "SUCCESS")]));
        run.pose(&at(4.0));
        // The tree vanishes before its goal's end is heard.
        run.mission(&mission(Some("b"), &running[..1]));
        run.goal(goal("a", GoalPhase::Aborted), 9.0);
        run.pose(&at(6.0));
        // Nothing is heard of the end of `b`.
        run.mission(&mission(None, &[]));
        run.goal(goal("c", GoalPhase::Active), 9.0);
        run.mission(&mission(Some("c"), &running[..1]));
        run.pose(&at(9.0));
        run.end();
        let spans: Vec<(&str, &str, f64, f64, &str)> = run
            .nodes
            .iter()
            .map(|span| {
                (
                    span.node.0.as_str(),
                    span.name.as_str(),
                    span.from,
                    span.to,
                    span.status.as_str(),
                )
            })
            .collect();
        assert_eq!(
            spans,
            [
                ("a", "Drive", 0.0, 3.0, "FAILURE"),
                ("a", "Look", 0.0, 2.0, "SUCCESS"),
                ("b", "Drive", 3.0, 3.0, "IDLE"),
                ("c", "Drive", 5.0, 8.0, "RUNNING"),
            ]
        );
    }
}

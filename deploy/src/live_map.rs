//! Live map. A robot's current state in a terminal: its map with plan, scan, goal, places and other robots, five times a second.

use std::collections::BTreeMap;
use std::time::Duration;

use indicatif::ProgressBar;
use nalgebra::Point2;
use tokio::task::AbortHandle;
use zenav_cloud::map_subscriber::MapSubscriber;
use zenav_protocol::bus::{Bus, Latest};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{Annotations, EdgeState, GoalState, MapRef, Plan, PoseEstimate, Scan};
use zenav_protocol::topics;

use crate::drawing::terminal::{self, Mark, Screen};
use crate::failure::Failure;

/// Period of pictures.
const PERIOD: Duration = Duration::from_millis(200);
/// Longest wait for a map; then the last one is drawn again.
const MAP_WITHIN: Duration = Duration::from_millis(500);
/// Most other robots drawn.
const MOST_ROBOTS: usize = 64;

/// Data to draw, the newest of each.
#[derive(Default)]
struct Seen {
    pose: Option<Pose2>,
    state: Option<EdgeState>,
    scan: Vec<Point2<f64>>,
    plan: Vec<Point2<f64>>,
    goal: Option<GoalState>,
    annotations: Annotations,
    others: BTreeMap<String, Pose2>,
}

/// Follows a robot and draws it.
pub struct LiveMap {
    robot: String,
    maps: MapSubscriber,
    poses: Latest<PoseEstimate>,
    states: Latest<EdgeState>,
    scans: Latest<Scan>,
    plans: Latest<Plan>,
    goals: Latest<GoalState>,
    annotations: Latest<Annotations>,
    seen: Seen,
}

/// A live map on a terminal; dropping it stops the updates.
pub struct Drawing {
    task: AbortHandle,
}

impl Drop for Drawing {
    fn drop(&mut self) {
        self.task.abort();
    }
}

impl LiveMap {
    /// # Errors
    /// A topic cannot be subscribed to.
    pub fn new(bus: &Bus, robot: &str) -> Result<Self, Failure> {
        Ok(Self {
            robot: robot.to_owned(),
            maps: MapSubscriber::new(bus)?,
            poses: bus.latest(&topics::POSE, &["*"])?,
            states: bus.latest(&topics::STATE, &[robot])?,
            scans: bus.latest(&topics::SCAN, &[robot])?,
            plans: bus.latest(&topics::PLAN, &[robot])?,
            goals: bus.latest(&topics::GOAL_STATE, &[robot, "*"])?,
            annotations: bus.latest(&topics::ANNOTATIONS, &[robot])?,
            seen: Seen::default(),
        })
    }

    /// The current picture; without a map, a line about what it waits for.
    pub async fn frame(&mut self, screen: Screen) -> String {
        self.take();
        let Some(replica) = self.maps.map(&self.robot, &MapRef::default(), MAP_WITHIN).await else {
            return format!("waiting for a map of {}", self.robot);
        };
        let state = self.seen.state.as_ref().map(status).unwrap_or_default();
        let picture = terminal::map(replica.grid(), &self.seen.marks(), screen);
        format!("{picture}\n{}{state}", self.robot)
    }

    fn take(&mut self) {
        let Self { robot, seen, .. } = self;
        while let Some(received) = self.poses.take_received() {
            let pose = received.message.map_from_base;
            match received.chunks.into_iter().next() {
                Some(name) if name == *robot => seen.pose = Some(pose),
                Some(name) if seen.others.len() < MOST_ROBOTS || seen.others.contains_key(&name) => {
                    seen.others.insert(name, pose);
                }
                _ => {}
            }
        }
        if let Some(scan) = self.scans.take() {
            let laser = scan.map_from_laser();
            seen.scan = scan.returns().map(|point| laser.transform_point(point)).collect();
        }
        if let Some(plan) = self.plans.take() {
            let points = plan.trajectory.iter().map(|point| Point2::new(point.x, point.y));
            let points: Vec<Point2<f64>> = points.collect();
            // A plan without a time law has only waypoints.
            seen.plan = if points.is_empty() { plan.waypoints } else { points };
        }
        while let Some(goal) = self.goals.take() {
            seen.goal = (!goal.state.is_end()).then_some(goal);
        }
        if let Some(state) = self.states.take() {
            seen.state = Some(state);
        }
        if let Some(annotations) = self.annotations.take() {
            seen.annotations = annotations;
        }
    }

    /// Draws above a progress bar made by [`crate::output::spinner`], in as many rows as the terminal has.
    pub fn above(mut self, bar: &ProgressBar) -> Drawing {
        let bar = bar.downgrade();
        let task = tokio::spawn(async move {
            let mut pace = tokio::time::interval(PERIOD);
            pace.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
            loop {
                pace.tick().await;
                // The bar's own line and one more stay free.
                let Some(screen) = Screen::of_terminal(5) else { return };
                let frame = self.frame(screen).await;
                let Some(bar) = bar.upgrade() else { return };
                bar.set_prefix(frame + "\n");
            }
        });
        Drawing {
            task: task.abort_handle(),
        }
    }
}

impl Seen {
    fn marks(&self) -> Vec<Mark<'_>> {
        let places = self.annotations.places.iter();
        let mut marks: Vec<Mark<'_>> = places
            .map(|(name, at)| Mark::Place(name, Point2::new(at.x, at.y)))
            .collect();
        marks.push(Mark::Scan(&self.scan));
        // A plan that is not being driven is outdated.
        if self
            .state
            .as_ref()
            .is_some_and(|state| state.plan.as_ref().is_some_and(|plan| !plan.finished))
        {
            marks.push(Mark::Path(&self.plan));
        }
        let leg = self.goal.as_ref().and_then(|goal| goal.legs.last()?.goal);
        marks.extend(leg.map(|goal| Mark::Goal(Point2::new(goal.x, goal.y))));
        marks.extend(self.others.iter().map(|(name, pose)| Mark::OtherRobot(name, *pose)));
        marks.extend(self.pose.map(Mark::Robot));
        marks
    }
}

/// The status line.
fn status(state: &EdgeState) -> String {
    let link = state.round_trip_secs.map(|secs| format!(" {:.0} ms", 1e3 * secs));
    format!(
        "  {:.2} m/s  {:?}  guard {:?}  link {:?}{}  battery {:.0} %",
        state.velocity.v,
        state.mode,
        state.guard,
        state.link,
        link.unwrap_or_default(),
        100.0 * state.battery
    )
}

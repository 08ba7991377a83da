//! Live map. A robot's current state in a terminal: its map with plan, scan, goal, places and other robots, five times a second.

use std::collections::BTreeMap;
use std::time::{Duration, Instant};

use indicatif::ProgressBar;
use nalgebra::Point2;
use tokio::task::AbortHandle;
use zenav_cloud::map_subscriber::MapSubscriber;
use zenav_protocol::bus::{Bus, Latest};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    Annotations, EdgeState, GoalPhase, GoalState, MapRef, MissionStatus, Plan, PoseEstimate, Scan,
};
use zenav_protocol::topics;

use crate::drawing::plane::{points_of, returns_of};
use crate::drawing::terminal::{self, Mark, Screen};
use crate::failure::Failure;
use crate::freshness::{Ages, Heard, RouterLink, dimmed};
use crate::output::{hundredths, piece};
use crate::tasks;

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
    heard: Heard,
}

/// Follows a robot and draws it.
pub struct LiveMap {
    robot: String,
    link: RouterLink,
    maps: MapSubscriber,
    poses: Latest<PoseEstimate>,
    states: Latest<EdgeState>,
    scans: Latest<Scan>,
    plans: Latest<Plan>,
    goals: Latest<GoalState>,
    missions: Latest<MissionStatus>,
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
            link: RouterLink::new(bus),
            maps: MapSubscriber::new(bus)?,
            poses: bus.latest(&topics::POSE, &["*"])?,
            states: bus.latest(&topics::STATE, &[robot])?,
            scans: bus.latest(&topics::SCAN, &[robot])?,
            plans: bus.latest(&topics::PLAN, &[robot])?,
            goals: bus.latest(&topics::GOAL_STATE, &[robot, "*"])?,
            missions: bus.latest(&topics::MISSION, &[robot])?,
            annotations: bus.latest(&topics::ANNOTATIONS, &[robot])?,
            seen: Seen::default(),
        })
    }

    /// Tells once that the router was lost, and once that it is back.
    pub async fn news(&mut self) -> Option<&'static str> {
        self.link.news().await
    }

    /// The current picture above a status line; without a map, a line about what it waits for instead.
    pub async fn frame(&mut self, screen: Screen) -> String {
        self.take();
        let map = self.maps.map(&self.robot, &MapRef::default(), MAP_WITHIN).await;
        let picture = match map {
            Some(replica) => fitted(&terminal::map(replica.grid(), &self.seen.marks(), screen), screen),
            None => format!("waiting for a map of {}", self.robot),
        };
        let status = status(&self.robot, self.seen.heard.ages(), self.seen.state.as_ref(), screen);
        format!("{picture}\n{status}")
    }

    fn take(&mut self) {
        let Self { robot, seen, .. } = self;
        while let Some(received) = self.poses.take_received() {
            let pose = received.message.map_from_base;
            match received.chunks.into_iter().next() {
                Some(name) if name == *robot => {
                    seen.pose = Some(pose);
                    seen.heard.pose = Some(Instant::now());
                }
                Some(name) if seen.others.len() < MOST_ROBOTS || seen.others.contains_key(&name) => {
                    seen.others.insert(name, pose);
                }
                _ => {}
            }
        }
        if let Some(scan) = self.scans.take() {
            seen.scan = returns_of(&scan);
        }
        if let Some(plan) = self.plans.take() {
            seen.plan = points_of(&plan);
        }
        while let Some(goal) = self.goals.take() {
            seen.hear(goal);
        }
        if let Some(state) = self.states.take() {
            seen.state = Some(state);
        }
        if self.missions.take().is_some() {
            seen.heard.mission = Some(Instant::now());
        }
        if let Some(annotations) = self.annotations.take() {
            seen.annotations = annotations;
        }
    }

    /// Draws above a progress bar made by [`crate::output::spinner`], in as many rows as the terminal has.
    pub fn above(mut self, bar: &ProgressBar) -> Drawing {
        let bar = bar.downgrade();
        let task = tasks::spawn(async move {
            let mut pace = tokio::time::interval(PERIOD);
            pace.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Delay);
            loop {
                pace.tick().await;
                // The bar's own line and one more stay free.
                let Some(screen) = Screen::of_terminal(5) else { return };
                let (news, frame) = (self.news().await, self.frame(screen).await);
                let Some(bar) = bar.upgrade() else { return };
                if let Some(news) = news {
                    bar.println(news);
                }
                bar.set_prefix(frame + "\n");
            }
        });
        Drawing {
            task: task.abort_handle(),
        }
    }
}

impl Seen {
    /// Takes in the state of any goal, and keeps the one that runs: others wait, or end, meanwhile.
    fn hear(&mut self, goal: GoalState) {
        if matches!(goal.state, GoalPhase::Active | GoalPhase::Paused) {
            self.goal = Some(goal);
        } else if self.goal.as_ref().is_some_and(|known| known.id == goal.id) {
            self.goal = None;
        }
    }

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

/// A picture whose lines of text fit the screen: a line that wraps pushes the picture's top out of it. Rows with colours are drawn to fit.
fn fitted(picture: &str, screen: Screen) -> String {
    let fit = |line: &str| -> String {
        let most = if line.contains('\x1b') {
            usize::MAX
        } else {
            screen.width
        };
        line.chars().take(most).collect()
    };
    picture.lines().map(fit).collect::<Vec<_>>().join("\n")
}

/// The status line, cut to the screen: first the ages of what is shown, then the robot's state. Faint once one of the two is old.
fn status(robot: &str, ages: Ages, state: Option<&EdgeState>, screen: Screen) -> String {
    let state = state.map(state_text).unwrap_or_default();
    let line: String = format!("{robot}  {}{state}", ages.text())
        .chars()
        .take(screen.width)
        .collect();
    dimmed(&line, screen.colors && ages.is_old())
}

fn state_text(state: &EdgeState) -> String {
    let link = piece(state.round_trip_secs, |secs| format!(" {:.0} ms", 1e3 * secs));
    format!(
        "  {:.2} m/s  {:?}  monitor {:?}  link {:?}{}  battery {:.0} %",
        hundredths(state.velocity.v),
        state.mode,
        state.guard,
        state.link,
        link,
        100.0 * state.battery
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_goal_that_shows_is_the_one_that_runs() {
        let goal = |id: &str, state: &str| -> GoalState {
            let told = serde_json::json!({
                "id": id, "robot": "r", "state": state, "reason": null, "accepted": 0, "request": { "place": "sink" }
            });
            serde_json::from_value(told).unwrap()
        };
        let mut seen = Seen::default();
        for (id, state, shown) in [
            ("a", "Active", Some("a")),
            ("b", "Accepted", Some("a")),
            ("b", "Canceled", Some("a")),
            ("a", "Paused", Some("a")),
            ("a", "Succeeded", None),
            ("c", "Accepted", None),
        ] {
            seen.hear(goal(id, state));
            assert_eq!(seen.goal.as_ref().map(|goal| goal.id.as_str()), shown, "{id} {state}");
        }
    }

    #[test]
    fn the_lines_below_the_map_do_not_wrap() {
        let screen = Screen {
            width: 4,
            height: 10,
            colors: true,
        };
        let picture = "\x1b[38;5;16m▀▀\x1b[0m\nx 0.00 to 2.00 m\nrobot at (1, 1)";
        assert_eq!(fitted(picture, screen), "\x1b[38;5;16m▀▀\x1b[0m\nx 0.\nrobo");
    }

    #[test]
    fn the_status_line_tells_the_ages_and_is_faint_once_they_are_old() {
        let screen = Screen {
            width: 40,
            height: 10,
            colors: true,
        };
        let fresh = Ages {
            pose: Some(Duration::from_millis(100)),
            mission: Some(Duration::from_millis(400)),
        };
        let line = status("tiago", fresh, None, screen);
        assert_eq!(line, "tiago  pose 0.1 s old, mission 0.4 s old");
        let old = Ages {
            pose: Some(Duration::from_secs(61)),
            ..fresh
        };
        let line = status("tiago", old, None, screen);
        assert_eq!(line, "\x1b[2mtiago  pose 61 s old, mission 0.4 s old\x1b[0m");
        let plain = Screen {
            width: 12,
            colors: false,
            ..screen
        };
        assert_eq!(status("tiago", old, None, plain), "tiago  pose ");
    }
}

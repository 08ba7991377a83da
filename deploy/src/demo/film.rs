//! Film of a scenario. The growing map, and what the robot saw, planned and drove; recorded during the run as any client sees it, with the
//! robot's true pose, and drawn afterwards.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

use nalgebra::{Point2, Vector2};
use tokio::task::JoinHandle;
use zenav_edge::Referee;
use zenav_protocol::bus::{Bus, Shutdown};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalPhase, MapRequest};
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics;
use zenav_sim::World;

use super::Script;
use crate::drawing::film::encode;
use crate::drawing::plane::PANEL;
use crate::drawing::scene::Scene;
use crate::failure::Failure;
use crate::files;

/// Width and largest height of a film, px.
const WIDTH: u32 = 640;
const HEIGHT: f64 = 560.0;
/// Most pictures, and how long each is shown, hundredths of a second: twenty seconds in total.
const MOST: usize = 160;
const SHOWN: u16 = 12;
/// Simulated time between two recorded moments, s.
const PERIOD: f64 = 0.2;
/// Longest wait for a map, wall time.
const MAP_WITHIN: Duration = Duration::from_secs(1);
/// Margin around the world, m.
const MARGIN: f64 = 0.15;

/// A world's places.
pub(super) fn places(world: &World) -> Vec<(String, Point2<f64>)> {
    let place = |place: &zenav_sim::Place| (place.name.to_string(), Point2::new(place.x, place.y));
    world.places().iter().map(place).collect()
}

/// A film not yet recorded.
pub(super) struct Film {
    file: PathBuf,
    title: String,
    area: (Point2<f64>, Point2<f64>),
    places: Vec<(String, Point2<f64>)>,
    robot: &'static str,
    referee: Referee,
}

/// Contents of one picture.
#[derive(Clone)]
struct Moment {
    secs: f64,
    pose: Pose2,
    map: Arc<OccupancyGrid>,
    scan: Vec<Point2<f64>>,
    plan: Arc<Vec<Point2<f64>>>,
    goal: Option<Point2<f64>>,
    step: String,
}

/// A film being recorded.
pub(super) struct Recording {
    film: Film,
    shutdown: Shutdown,
    moments: JoinHandle<Result<Vec<Moment>, Failure>>,
}

impl Film {
    pub(super) fn new(file: &Path, script: &Script, world: &World, referee: Referee) -> Self {
        let (low, high) = world.bounds();
        let margin = Vector2::repeat(MARGIN);
        Self {
            file: file.to_owned(),
            title: script.name.to_owned(),
            area: (low - margin, high + margin),
            places: places(world),
            robot: script.robot.1,
            referee,
        }
    }

    /// Starts recording.
    ///
    /// # Errors
    /// A topic cannot be subscribed to.
    pub(super) fn start(self, bus: &Bus, id: &Id, speed: f64) -> Result<Recording, Failure> {
        let robot = [id.as_str()];
        let mut scans = bus.latest(&topics::SCAN, &robot)?;
        let mut plans = bus.latest(&topics::PLAN, &robot)?;
        let mut goals = bus.latest(&topics::GOAL_STATE, &[id.as_str(), "*"])?;
        let (bus, id, referee) = (bus.clone(), id.clone(), self.referee.clone());
        let shutdown = Shutdown::new();
        let ended = shutdown.clone();
        let moments = tokio::spawn(async move {
            let mut pace = tokio::time::interval(Duration::from_secs_f64((PERIOD / speed).max(0.01)));
            pace.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
            let mut moments: Vec<Moment> = Vec::new();
            loop {
                tokio::select! {
                    () = ended.wait() => return Ok(moments),
                    _ = pace.tick() => {}
                }
                let asked = bus
                    .ask(&topics::MAP, &[id.as_str()], &MapRequest::default(), MAP_WITHIN)
                    .await;
                let map = asked.ok().and_then(|reply| reply.grid().ok()).map(Arc::new);
                let last = moments.last();
                let Some(map) = map.or_else(|| last.map(|last| Arc::clone(&last.map))) else {
                    continue;
                };
                let mut moment = Moment {
                    secs: referee.now().as_secs(),
                    pose: referee.truth().map_from_base,
                    map,
                    scan: last.map(|last| last.scan.clone()).unwrap_or_default(),
                    plan: last.map(|last| Arc::clone(&last.plan)).unwrap_or_default(),
                    goal: last.and_then(|last| last.goal),
                    step: last.map(|last| last.step.clone()).unwrap_or_default(),
                };
                if let Some(scan) = scans.take() {
                    let laser = scan.map_from_laser();
                    moment.scan = scan.returns().map(|point| laser.transform_point(point)).collect();
                }
                if let Some(plan) = plans.take() {
                    let points = plan.trajectory.iter().map(|point| Point2::new(point.x, point.y));
                    let points: Vec<Point2<f64>> = points.collect();
                    // A plan without a time law has only waypoints.
                    moment.plan = Arc::new(if points.is_empty() { plan.waypoints } else { points });
                }
                while let Some(goal) = goals.take() {
                    if goal.state == GoalPhase::Rejected {
                        continue;
                    }
                    let there = goal.legs.last().and_then(|leg| leg.goal);
                    moment.goal = there.map(|goal| Point2::new(goal.x, goal.y));
                    moment.step = goal.feedback.step;
                }
                moments.push(moment);
            }
        });
        Ok(Recording {
            film: self,
            shutdown,
            moments,
        })
    }
}

impl Recording {
    /// Ends the recording and writes the film; returns its file.
    ///
    /// # Errors
    /// Nothing was recorded, or the file cannot be written.
    pub(super) async fn finish(self) -> Result<PathBuf, Failure> {
        self.shutdown.trigger();
        let broke_off = |error: tokio::task::JoinError| Failure::failed(format!("the film broke off: {error}"));
        let moments = self.moments.await.map_err(broke_off)??;
        let film = self.film;
        tokio::task::spawn_blocking(move || film.develop(&moments))
            .await
            .map_err(broke_off)?
    }
}

impl Film {
    /// Draws the moments; of more than [`MOST`], an even selection.
    fn develop(self, moments: &[Moment]) -> Result<PathBuf, Failure> {
        let footprint = files::robot(self.robot)?.footprint;
        let count = moments.len().min(MOST);
        let bytes = encode(count, SHOWN, |index| {
            let last = if count > 1 {
                index * (moments.len() - 1) / (count - 1)
            } else {
                0
            };
            self.picture(moments.get(..=last).unwrap_or_default(), &footprint)
        })?;
        files::write(&self.file, bytes)?;
        Ok(self.file)
    }

    /// Draws the last of the moments, with the trail of all.
    fn picture(&self, moments: &[Moment], footprint: &Footprint) -> Result<crate::drawing::canvas::Canvas, Failure> {
        let Some(now) = moments.last() else {
            return Err(Failure::failed("nothing was recorded"));
        };
        let trail: Vec<Point2<f64>> = moments.iter().map(|moment| moment.pose.position()).collect();
        let extent = self.area.1 - self.area.0;
        let scale = (f64::from(WIDTH - PANEL) / extent.x).min(HEIGHT / extent.y);
        let scene = Scene {
            notes: vec![format!("t = {:.1} s", now.secs), now.step.clone()],
            area: Some(self.area),
            places: &self.places,
            scan: Some(&now.scan),
            plan: Some(&now.plan),
            trail: Some(&trail),
            goal: now.goal,
            robot: Some((now.pose, footprint)),
            ..Scene::new(&format!("zenav {}", self.title), &now.map)
        };
        scene.draw((scale * extent.amax()) as u32)
    }
}

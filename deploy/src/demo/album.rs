//! Album. One picture for every drive of a scenario: what the robot knew, planned and drove.

use std::path::{Path, PathBuf};
use std::time::Duration;

use nalgebra::Point2;
use tokio::task::JoinSet;
use zenav_protocol::bus::{Bus, Latest};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalPoint, MapRequest, SearchTree};
use zenav_protocol::topics;
use zenav_sim::World;

use crate::drawing::scene::Scene;
use crate::failure::Failure;
use crate::files;

/// Longest wait for the map, wall time.
const MAP_DEADLINE: Duration = Duration::from_secs(5);

/// A world's places.
pub(super) fn places(world: &World) -> Vec<(String, Point2<f64>)> {
    let place = |place: &zenav_sim::Place| (place.name.to_string(), Point2::new(place.x, place.y));
    world.places().iter().map(place).collect()
}

/// Pictures of a run.
pub(super) struct Album {
    bus: Bus,
    robot: Id,
    folder: PathBuf,
    /// Search trees published by the planner.
    pub trees: Latest<SearchTree>,
    /// First search tree of the present drive.
    tree: Option<SearchTree>,
    places: Vec<(String, Point2<f64>)>,
    pages: JoinSet<Result<PathBuf, Failure>>,
    count: usize,
}

/// Approximate length of a picture's longer side, px.
const SIZE: u32 = 1200;

impl Album {
    /// # Errors
    /// The planner's trees cannot be subscribed to.
    pub fn new(bus: &Bus, robot: &Id, folder: &Path, places: Vec<(String, Point2<f64>)>) -> Result<Self, Failure> {
        Ok(Self {
            bus: bus.clone(),
            robot: robot.clone(),
            folder: folder.to_path_buf(),
            trees: bus.latest(&topics::TREE, &[robot.as_str()])?,
            tree: None,
            places,
            pages: JoinSet::new(),
            count: 0,
        })
    }

    /// Takes in the planner's newest tree: for each drive the first one with a path is kept.
    pub fn see(&mut self) {
        let tree = self.trees.take().filter(|tree| !tree.path.is_empty());
        self.tree = self.tree.take().or(tree);
    }

    /// Draws the end of a drive: `plan` is its last plan, `trail` the true path since the start.
    pub fn page(&mut self, name: &str, goal: Option<GoalPoint>, plan: Vec<Point2<f64>>, trail: Vec<Point2<f64>>) {
        self.see();
        self.count += 1;
        let plain = |c: char| if c.is_alphanumeric() { c } else { '_' };
        let title = format!("{} {name}", self.count);
        let name: String = name.chars().map(plain).collect();
        let file = self.folder.join(format!("{}-{name}.png", self.count));
        let tree = self.tree.take();
        let (bus, robot, places) = (self.bus.clone(), self.robot.clone(), self.places.clone());
        self.pages.spawn(async move {
            let map = bus
                .ask(&topics::MAP, &[robot.as_str()], &MapRequest::default(), MAP_DEADLINE)
                .await?;
            let map = map.grid().map_err(Failure::failed)?;
            let scene = Scene {
                tree: tree.as_ref(),
                plan: Some(&plan),
                trail: Some(&trail),
                goal: goal.map(|goal| Point2::new(goal.x, goal.y)),
                places: &places,
                ..Scene::new(&title, &map)
            };
            files::write(&file, scene.draw(SIZE)?.png()?)?;
            Ok(file)
        });
    }

    /// Waits for all pages; returns the files.
    ///
    /// # Errors
    /// A picture that could not be drawn or written.
    pub async fn finish(self) -> Result<Vec<PathBuf>, Failure> {
        let pages: Result<Vec<PathBuf>, Failure> = self.pages.join_all().await.into_iter().collect();
        let mut files = pages?;
        files.sort();
        Ok(files)
    }
}

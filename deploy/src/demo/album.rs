//! What did the robot know, look for and drive? A picture for every drive of a scenario, drawn beside the run.

use std::path::{Path, PathBuf};
use std::time::Duration;

use nalgebra::Point2;
use tokio::task::JoinSet;
use zenav_protocol::bus::{Bus, Latest};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GoalPoint, MapRequest, SearchTree};
use zenav_protocol::topics;

use super::picture::{Scene, draw};
use crate::failure::Failure;

/// Longest wait for the map, wall.
const MAP_DEADLINE: Duration = Duration::from_secs(5);

/// Pictures of a run.
pub(super) struct Album {
    bus: Bus,
    robot: Id,
    folder: PathBuf,
    /// What the planner shows.
    pub trees: Latest<SearchTree>,
    /// What the planner has shown first of the present drive.
    tree: Option<SearchTree>,
    pages: JoinSet<Result<(), Failure>>,
    count: usize,
}

impl Album {
    /// # Errors
    /// When the planner's trees cannot be subscribed to.
    pub fn new(bus: &Bus, robot: &Id, folder: &Path) -> Result<Self, Failure> {
        Ok(Self {
            bus: bus.clone(),
            robot: robot.clone(),
            folder: folder.to_path_buf(),
            trees: bus.latest(&topics::TREE, &[robot.as_str()])?,
            tree: None,
            pages: JoinSet::new(),
            count: 0,
        })
    }

    /// Takes in what the planner shows: of each drive its first way, the one that it set out on.
    pub fn see(&mut self) {
        let tree = self.trees.take().filter(|tree| !tree.path.is_empty());
        self.tree = self.tree.take().or(tree);
    }

    /// Draws the end of a drive: `planned` is the motion it ended with, `driven` the true way since the start.
    pub fn page(&mut self, name: &str, goal: Option<GoalPoint>, planned: Vec<Point2<f64>>, driven: Vec<Point2<f64>>) {
        self.see();
        self.count += 1;
        let plain = |c: char| if c.is_alphanumeric() { c } else { '_' };
        let name: String = name.chars().map(plain).collect();
        let file = self.folder.join(format!("{}-{name}.png", self.count));
        let tree = self.tree.take();
        let (bus, robot) = (self.bus.clone(), self.robot.clone());
        self.pages.spawn(async move {
            let map = bus
                .ask(&topics::MAP, &[robot.as_str()], &MapRequest::default(), MAP_DEADLINE)
                .await?;
            let map = map.grid().map_err(|error| Failure::failed(error.to_string()))?;
            let scene = Scene {
                map: &map,
                tree: tree.as_ref(),
                planned: &planned,
                driven: &driven,
                goal: goal.map(|goal| Point2::new(goal.x, goal.y)),
            };
            let bytes = draw(&scene)?;
            std::fs::write(&file, bytes).map_err(|error| Failure::failed(format!("{}: {error}", file.display())))
        });
    }

    /// Waits for the last page.
    ///
    /// # Errors
    /// A picture that could not be drawn or written.
    pub async fn finish(mut self) -> Result<(), Failure> {
        while let Some(page) = self.pages.join_next().await {
            page.map_err(|error| Failure::failed(error.to_string()))??;
        }
        Ok(())
    }
}

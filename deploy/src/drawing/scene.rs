//! Scene. What a robot knew, planned and drove: map, places, search tree, scan, plan, trail and footprint in one picture, with a legend.

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::SearchTree;
use zenav_protocol::robot::Footprint;

use super::canvas::{Canvas, Color};
use super::plane::{Mark, PLACE, Plane, ROBOT, UNKNOWN};
use crate::failure::Failure;

/// The search tree.
pub const TREE: Color = [150, 190, 235];
/// The plan in force.
pub const PLAN: Color = [30, 160, 80];
const TRAIL: Color = [215, 60, 40];
const SCAN: Color = [200, 40, 150];
/// The goal.
pub const GOAL: Color = [240, 150, 0];
const START: Color = [120, 60, 170];

/// What to draw; a field that is `None` is left out, also from the legend.
#[derive(Clone, Debug)]
pub struct Scene<'a> {
    /// Title above the legend.
    pub title: String,
    /// Lines below the title.
    pub notes: Vec<String>,
    /// The map.
    pub map: &'a OccupancyGrid,
    /// The part of the plane; `None`: that of the map.
    pub area: Option<(Point2<f64>, Point2<f64>)>,
    /// Named places.
    pub places: &'a [(String, Point2<f64>)],
    /// The planner's search tree, and its path.
    pub tree: Option<&'a SearchTree>,
    /// The returns of the newest scan.
    pub scan: Option<&'a [Point2<f64>]>,
    /// The plan in force.
    pub plan: Option<&'a [Point2<f64>]>,
    /// The true path driven so far.
    pub trail: Option<&'a [Point2<f64>]>,
    /// The goal.
    pub goal: Option<Point2<f64>>,
    /// The robot's pose and footprint.
    pub robot: Option<(Pose2, &'a Footprint)>,
}

impl<'a> Scene<'a> {
    /// A scene of a map only.
    #[must_use]
    pub fn new(title: &str, map: &'a OccupancyGrid) -> Self {
        Self {
            title: title.to_owned(),
            notes: Vec::new(),
            map,
            area: None,
            places: &[],
            tree: None,
            scan: None,
            plan: None,
            trail: None,
            goal: None,
            robot: None,
        }
    }

    /// Draws the scene, with about `size` pixels on the longer side.
    ///
    /// # Errors
    /// A map without cells.
    pub fn draw(&self, size: u32) -> Result<Canvas, Failure> {
        let spec = self.map.spec();
        let (low, high) = self.area.unwrap_or((spec.origin, spec.upper()));
        let longer = spec.width.max(spec.height).max(1);
        // All cells of a map get the same size.
        let size = match self.area {
            None => (size / longer).clamp(1, 8) * longer,
            Some(_) => size,
        };
        let mut plane = Plane::new(low, high, size, &self.title, UNKNOWN)?;
        for note in &self.notes {
            plane.note(note);
        }
        plane.gap();
        plane.map(self.map);
        plane.map_legend();
        if let Some(tree) = self.tree {
            for edge in &tree.edges {
                plane.polyline(edge, TREE, 1.0);
            }
            plane.polyline(&tree.path, ROBOT, 2.5);
            plane.legend(Mark::Line, TREE, "search tree");
            plane.legend(Mark::Line, ROBOT, "path found");
        }
        for at in self.scan.into_iter().flatten() {
            plane.dot(*at, SCAN, 1.5);
        }
        // The trail covers the part of the plan that was driven.
        for (points, color, name) in [(self.plan, PLAN, "plan"), (self.trail, TRAIL, "driven")] {
            if let Some(points) = points {
                plane.polyline(points, color, 2.5);
                plane.legend(Mark::Line, color, name);
            }
        }
        if self.scan.is_some() {
            plane.legend(Mark::Dot, SCAN, "laser scan");
        }
        if let Some((pose, footprint)) = self.robot {
            plane.robot(pose, footprint);
            plane.legend(Mark::Area, ROBOT, "robot");
        }
        // A robot at a place does not cover its name.
        for (name, at) in self.places {
            plane.place(name, *at);
        }
        if !self.places.is_empty() {
            plane.legend(Mark::Dot, PLACE, "named place");
        }
        let start = self.trail.and_then(<[_]>::first);
        if let Some(start) = start.filter(|_| self.robot.is_none()) {
            plane.dot(*start, START, 5.0);
            plane.legend(Mark::Dot, START, "start");
        }
        if let Some(goal) = self.goal {
            plane.dot(goal, GOAL, 6.0);
            plane.legend(Mark::Dot, GOAL, "goal");
        }
        plane.finish()
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::grid::GridSpec;

    use super::*;

    fn map() -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::new(-1.0, -1.0),
            ..zenav_fixtures::spec(40, 40, 0.1)
        };
        zenav_fixtures::map_with_occupied(spec, &[(39, 0)])
    }

    #[test]
    fn a_drive_lies_where_it_was_driven() {
        let map = map();
        let trail = [Point2::new(-0.95, -0.95), Point2::new(2.5, -0.95)];
        let scene = Scene {
            trail: Some(&trail),
            ..Scene::new("a drive", &map)
        };
        let canvas = scene.draw(320).unwrap();
        assert_eq!(
            (canvas.width(), canvas.height()),
            (320 + super::super::plane::PANEL, 320)
        );
        let pixels = canvas.rgb();
        let at = |x: u32, y: u32| &pixels[((y * canvas.width() + x) * 3) as usize..][..3];
        assert_eq!(at(100, 316), TRAIL, "the drive runs along the lowest row");
        assert_eq!(at(100, 4), [255; 3]);
        assert!(at(318, 318)[0] < 60, "the obstacle stands at the lower right");
    }

    #[test]
    fn the_trail_covers_the_plan_that_was_driven() {
        let map = map();
        let way = [Point2::new(-0.95, -0.95), Point2::new(2.5, -0.95)];
        let scene = Scene {
            plan: Some(&way),
            trail: Some(&way),
            ..Scene::new("a drive", &map)
        };
        let canvas = scene.draw(320).unwrap();
        let at = ((316 * canvas.width() + 100) * 3) as usize;
        assert_eq!(&canvas.rgb()[at..at + 3], TRAIL);
    }

    #[test]
    fn a_robot_at_a_place_does_not_cover_its_name() {
        let map = map();
        let (places, footprint) = ([("sink".to_owned(), Point2::new(0.5, 0.5))], Footprint::Radius(0.5));
        let scene = Scene {
            places: &places,
            robot: Some((Pose2::new(0.7, 0.5, 0.0), &footprint)),
            ..Scene::new("", &map)
        };
        let canvas = scene.draw(320).unwrap();
        // To the right of the place's dot: the robot is blue, letters are green.
        let row = |y: u32| canvas.rgb()[((y * canvas.width() + 128) * 3) as usize..][..60].to_vec();
        let beside: Vec<u8> = (192..208).flat_map(row).collect();
        assert!(
            beside.chunks(3).any(|pixel| pixel[1] > pixel[2].saturating_add(20)),
            "{beside:?}"
        );
    }

    #[test]
    fn what_lies_beyond_the_map_or_nowhere_does_no_harm() {
        let far = [
            Point2::new(1e300, -1e300),
            Point2::new(f64::NAN, 0.0),
            Point2::new(0.0, 1e9),
        ];
        let tree = SearchTree {
            stamp: zenav_protocol::time::Stamp::ZERO,
            edges: vec![[far[0], far[1]], [far[2], Point2::origin()]],
            path: far.to_vec(),
        };
        let map = map();
        let footprint = Footprint::Radius(0.2);
        let scene = Scene {
            tree: Some(&tree),
            plan: Some(&far),
            trail: Some(&far),
            scan: Some(&far),
            goal: Some(far[0]),
            robot: Some((Pose2::new(1e300, 0.0, 0.0), &footprint)),
            ..Scene::new("", &map)
        };
        assert!(scene.draw(100).is_ok());
    }
}

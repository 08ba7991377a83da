//! May the robot be at a pose, and may it follow a path? The state validity checker that a planner is handed: set a map, then ask.
//!
//! It stands on the exact checks of this folder. A path is checked exactly between its poses, so that one occupied cell is never missed, or
//! at poses a step apart, as is usual (Kavraki et al., "Probabilistic Roadmaps", 1996; OMPL's discrete motion validator).

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{GridSpec, OccupancyGrid};
use zenav_protocol::robot::Footprint;

use super::bits::BitGrid;
use super::configuration::{ConfigurationSpace, UnknownPolicy};
use super::sweep::Banded;
use super::update::Marks;

/// What must be free around a pose.
#[derive(Clone, Debug, PartialEq)]
pub enum Body {
    /// A square around the pose's position, its sides along the map's axes whatever the heading: side in m. Every cell that it touches
    /// must be free; unless unknown cells count as free, it must lie on the map and on no unknown cell.
    Window(f64),
    /// The robot's own outline, turned to its heading. Unless unknown cells count as free, its centre stays off them and on the map, as for
    /// the planners ([`UnknownPolicy::Blocked`]).
    Footprint(Footprint),
}

/// Where a path is checked between its poses.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Between {
    /// Everywhere: nothing on the way is missed.
    Exactly,
    /// At poses at most so many metres apart: what lies between them may be missed.
    Every(f64),
}

/// How poses and paths are checked.
#[derive(Clone, Debug, PartialEq)]
pub struct CheckerSettings {
    /// What must be free around a pose.
    pub body: Body,
    /// Where a path is checked between its poses.
    pub between: Between,
    /// Cells that nobody has seen, and everything outside the map, may be driven through.
    pub unknown_is_free: bool,
}

impl Default for CheckerSettings {
    /// A window of 0.2 m, checked exactly, through unknown cells.
    fn default() -> Self {
        Self {
            body: Body::Window(0.2),
            between: Between::Exactly,
            unknown_is_free: true,
        }
    }
}

/// What a path was found to be.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum PathCheck {
    /// The robot may follow it.
    Valid,
    /// It may not.
    Invalid {
        /// The first of the path's places that is not reached: 0 when the path begins where the robot may not be.
        index: usize,
        /// Where on the way there it first may not be, to a millimetre or to a step.
        pose: Pose2,
    },
    /// No map was set.
    NoMap,
}

/// Says whether poses and paths are free on the map that was set last.
#[derive(Clone, Debug)]
pub struct StateValidityChecker {
    settings: CheckerSettings,
    ground: Option<Ground>,
}

#[derive(Clone, Debug)]
enum Ground {
    Window {
        spec: GridSpec,
        blocked: Banded,
        /// Half the window's side, m.
        half: f64,
    },
    Robot(Box<ConfigurationSpace>),
}

/// Poses checked between two of a path, at most: no numbers from outside keep it busy.
const MOST_STEPS: f64 = 100_000.0;
/// How close the place of a first contact is told, m.
const PLACE: f64 = 1e-3;

impl StateValidityChecker {
    /// A checker without a map.
    #[must_use]
    pub fn new(settings: CheckerSettings) -> Self {
        Self { settings, ground: None }
    }

    /// Takes over a map. Linear in its cells.
    pub fn set(&mut self, grid: &OccupancyGrid) {
        self.ground = Some(match &self.settings.body {
            Body::Window(side) => {
                let unknown = if self.settings.unknown_is_free {
                    UnknownPolicy::Free
                } else {
                    UnknownPolicy::Obstacle
                };
                let spec = *grid.spec();
                let mut blocked = BitGrid::new(spec.width, spec.height);
                for y in 0..spec.height {
                    for (word, bits) in blocked.row_mut(y).iter_mut().enumerate() {
                        *bits = Marks::read(grid, unknown, None, y, word).obstacles;
                    }
                }
                Ground::Window {
                    spec,
                    blocked: Banded::new(blocked),
                    half: 0.5 * side.max(0.0),
                }
            }
            Body::Footprint(footprint) => {
                let unknown = if self.settings.unknown_is_free {
                    UnknownPolicy::Free
                } else {
                    UnknownPolicy::Blocked
                };
                Ground::Robot(Box::new(ConfigurationSpace::new(grid, footprint, unknown, 0.0)))
            }
        });
    }

    /// Whether the robot may be at a pose; never without a map, nor at one that is not finite.
    #[must_use]
    pub fn is_valid(&self, pose: Pose2) -> bool {
        match &self.ground {
            None => false,
            Some(Ground::Window { .. }) => self.is_free(pose, pose),
            Some(Ground::Robot(space)) => space.is_valid(pose),
        }
    }

    /// Checks the way through poses; between two of them position and heading (the shorter way round) change evenly. A path without poses
    /// is valid.
    #[must_use]
    pub fn check_path(&self, path: &[Pose2]) -> PathCheck {
        if self.ground.is_none() {
            return PathCheck::NoMap;
        }
        match path.first() {
            Some(first) if !self.is_valid(*first) => {
                return PathCheck::Invalid { index: 0, pose: *first };
            }
            _ => {}
        }
        let legs = path.windows(2).enumerate();
        let mut bad = legs.filter_map(|(i, leg)| Some((i + 1, self.first_invalid(leg[0], leg[1])?)));
        match bad.next() {
            Some((index, pose)) => PathCheck::Invalid { index, pose },
            None => PathCheck::Valid,
        }
    }

    /// Checks the way through points, the robot heading along each leg and turning where it changes direction.
    #[must_use]
    pub fn check_way(&self, way: &[Point2<f64>]) -> PathCheck {
        let mut poses: Vec<Pose2> = Vec::with_capacity(2 * way.len());
        for leg in way.windows(2) {
            let d = leg[1] - leg[0];
            // A leg without length leaves the heading as it is.
            let yaw = if d.x == 0.0 && d.y == 0.0 {
                poses.last().map_or(0.0, |pose| pose.yaw)
            } else {
                d.y.atan2(d.x)
            };
            poses.extend(leg.iter().map(|p| Pose2::new(p.x, p.y, yaw)));
        }
        if let [only] = way {
            poses.push(Pose2::new(only.x, only.y, 0.0));
        }
        match self.check_path(&poses) {
            PathCheck::Invalid { index, pose } => PathCheck::Invalid {
                index: index.div_ceil(2),
                pose,
            },
            other => other,
        }
    }

    /// Where the robot first may not be on the way from a pose where it may be.
    fn first_invalid(&self, a: Pose2, b: Pose2) -> Option<Pose2> {
        let turn = wrap_angle(b.yaw - a.yaw);
        let at = |t: f64| Pose2::new(a.x + (b.x - a.x) * t, a.y + (b.y - a.y) * t, a.yaw + turn * t);
        if let Between::Every(step) = self.settings.between
            && step > 0.0
        {
            let steps = (a.distance(&b) / step).ceil().clamp(1.0, MOST_STEPS) as u32;
            let poses = (1..=steps).map(|i| {
                if i == steps {
                    b
                } else {
                    at(f64::from(i) / f64::from(steps))
                }
            });
            return poses.into_iter().find(|pose| !self.is_valid(*pose));
        }
        if self.is_free(a, b) {
            return None;
        }
        let (mut free, mut blocked) = (0.0, 1.0);
        let motion = a.distance(&b) + turn.abs();
        // Written so that a motion that is not a number ends here as well.
        while (blocked - free) * motion > PLACE && motion < MOST_STEPS {
            let middle = 0.5 * (free + blocked);
            if self.is_free(a, at(middle)) {
                free = middle;
            } else {
                blocked = middle;
            }
        }
        Some(if blocked < 1.0 { at(blocked) } else { b })
    }

    /// Whether nothing is touched all the way.
    fn is_free(&self, a: Pose2, b: Pose2) -> bool {
        let [from, to] = [a.position(), b.position()];
        match &self.ground {
            None => false,
            Some(Ground::Window { spec, blocked, half }) => {
                let on_the_map = |p: Point2<f64>| {
                    let [low, high] = [[p.x - half, p.y - half], [p.x + half, p.y + half]].map(Point2::from);
                    spec.cell_at(low).is_some() && spec.cell_at(high).is_some()
                };
                (self.settings.unknown_is_free || (on_the_map(from) && on_the_map(to)))
                    && !blocked.is_touched_by_window(spec.to_cells(from), spec.to_cells(to), half / spec.resolution)
            }
            Some(Ground::Robot(space)) => {
                let footprint = space.footprint();
                space.is_permitted_between(from, to)
                    && space.segment_is_free(from, to, footprint.inscribed_radius())
                    && (matches!(footprint, Footprint::Radius(_))
                        || space.segment_is_free(from, to, footprint.circumscribed_radius())
                        || space.sweep_min_clearance(&[a, b]) > 0.0)
            }
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::grid::{Cell, Occupancy};

    use super::*;

    const SPEC: GridSpec = GridSpec {
        origin: Point2::new(-1.0, 2.0),
        resolution: 0.05,
        width: 120,
        height: 100,
    };

    fn map(marks: &[(u32, u32, i8)]) -> OccupancyGrid {
        zenav_fixtures::map_with(SPEC, marks)
    }

    fn checker(grid: &OccupancyGrid, settings: CheckerSettings) -> StateValidityChecker {
        let mut checker = StateValidityChecker::new(settings);
        checker.set(grid);
        checker
    }

    fn oblong() -> Footprint {
        Footprint::Polygon(vec![
            Point2::new(-0.3, -0.12),
            Point2::new(0.3, -0.12),
            Point2::new(0.3, 0.12),
            Point2::new(-0.3, 0.12),
        ])
    }

    fn bodies() -> impl Strategy<Value = Body> {
        prop_oneof![
            (0.0..0.6).prop_map(Body::Window),
            (0.01..0.3).prop_map(|radius| Body::Footprint(Footprint::Radius(radius))),
            Just(Body::Footprint(oblong())),
        ]
    }

    fn marks() -> impl Strategy<Value = Vec<(u32, u32, i8)>> {
        prop::collection::vec(
            (0_u32..120, 0_u32..100, prop::sample::select(vec![-1_i8, 100, 100])),
            0..25,
        )
    }

    fn pose() -> impl Strategy<Value = Pose2> {
        (-0.9..4.9, 2.1..6.9, -3.1..3.1).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn a_window_is_free_where_all_cells_that_it_touches_are(marks in marks(), pose in pose(), side in 0.0..0.6, unknown_is_free in any::<bool>()) {
            let grid = map(&marks);
            let checker = checker(&grid, CheckerSettings { body: Body::Window(side), unknown_is_free, ..CheckerSettings::default() });
            let (p, half) = (SPEC.to_cells(pose.position()), 0.5 * side / SPEC.resolution);
            let bad = |x: i64, y: i64| match SPEC.contains(x, y).then(|| Occupancy::of(grid[Cell::new(x as u32, y as u32)])) {
                Some(Occupancy::Occupied) => true,
                Some(Occupancy::Free) => false,
                Some(Occupancy::Unknown) | None => !unknown_is_free,
            };
            let range = |at: f64| (at - half).floor() as i64..=(at + half).floor() as i64;
            let expected = !range(p.y).any(|y| range(p.x).any(|x| bad(x, y)));
            prop_assert_eq!(checker.is_valid(pose), expected);
        }

        #[test]
        fn one_occupied_cell_on_the_way_is_never_missed(body in bodies(), cell in (2_u32..118, 2_u32..98), inside in (0.01..0.99, 0.01..0.99), angle in 0.0..6.3, before in 0.01_f64..3.0, after in 0.01_f64..3.0) {
            let checker = checker(&map(&[(cell.0, cell.1, 100)]), CheckerSettings { body, ..CheckerSettings::default() });
            let through = SPEC.from_cells(Point2::new(f64::from(cell.0) + inside.0, f64::from(cell.1) + inside.1));
            let at = |s: f64| Pose2::new(through.x + s * f64::cos(angle), through.y + s * f64::sin(angle), angle);
            let checked = checker.check_path(&[at(-before), at(after)]);
            let PathCheck::Invalid { index, pose } = checked else {
                return Err(TestCaseError::fail(format!("{checked:?}")));
            };
            prop_assert!(index <= 1 && pose.distance(&at(-before)) <= before + PLACE);
        }

        #[test]
        fn what_is_valid_exactly_is_valid_at_every_step_and_otherwise_steps_find_nothing_earlier(body in bodies(), marks in marks(), path in prop::collection::vec(pose(), 1..5), unknown_is_free in any::<bool>(), step in 0.01..0.5) {
            let grid = map(&marks);
            let settings = CheckerSettings { body, unknown_is_free, between: Between::Exactly };
            let exact = checker(&grid, settings.clone()).check_path(&path);
            let stepwise = checker(&grid, CheckerSettings { between: Between::Every(step), ..settings }).check_path(&path);
            let at = |checked: PathCheck| match checked {
                PathCheck::Invalid { index, pose } if index > 0 => index as f64 - 1.0 + path[index - 1].distance(&pose) / path[index - 1].distance(&path[index]),
                PathCheck::Invalid { .. } => -1.0,
                PathCheck::Valid | PathCheck::NoMap => f64::INFINITY,
            };
            let least = path.windows(2).map(|leg| leg[0].distance(&leg[1])).fold(f64::INFINITY, f64::min);
            prop_assert!(at(exact) <= at(stepwise) + 2.0 * PLACE / least, "{exact:?} {stepwise:?}");
        }

        #[test]
        fn steps_find_what_a_body_smaller_by_a_step_touches(marks in marks(), path in prop::collection::vec(pose(), 1..5), is_window in any::<bool>(), size in 0.0..0.5, step in 0.002..0.2) {
            let body = |half: f64| if is_window { Body::Window(2.0 * half) } else { Body::Footprint(Footprint::Radius(half)) };
            let checked = |body, between| checker(&map(&marks), CheckerSettings { body, between, unknown_is_free: true }).check_path(&path);
            if checked(body(size), Between::Exactly) != PathCheck::Valid {
                prop_assert_ne!(checked(body(size + step), Between::Every(step)), PathCheck::Valid);
            }
        }

        #[test]
        fn no_numbers_from_outside_do_harm(x in any::<f64>(), y in any::<f64>(), yaw in any::<f64>(), number in any::<f64>(), body in bodies()) {
            for between in [Between::Exactly, Between::Every(number)] {
                for body in [body.clone(), Body::Window(number)] {
                    let checker = checker(&map(&[(3, 4, 100)]), CheckerSettings { body, between, unknown_is_free: false });
                    let (wild, tame) = (Pose2 { x, y, yaw }, Pose2::new(1.0, 4.0, 0.0));
                    prop_assert!(wild.is_finite() || !checker.is_valid(wild));
                    prop_assert!(wild.is_finite() || checker.check_path(&[tame, wild]) != PathCheck::Valid);
                    let _ = (checker.check_path(&[tame, wild, tame]), checker.check_way(&[tame.position(), wild.position()]));
                }
            }
        }
    }

    #[test]
    fn the_first_place_is_told_where_the_robot_may_not_be() {
        // A wall at x = 2.0 to 2.05.
        let wall: Vec<_> = (0..100).map(|y| (60, y, 100)).collect();
        let checker = checker(&map(&wall), CheckerSettings::default());
        let path = [(0.0, 4.0), (1.0, 4.0), (3.0, 4.0), (4.0, 4.0)].map(|(x, y)| Pose2::new(x, y, 0.0));
        assert_eq!(checker.check_path(&path[..2]), PathCheck::Valid);
        let PathCheck::Invalid { index: 2, pose } = checker.check_path(&path) else {
            panic!("{:?}", checker.check_path(&path))
        };
        assert!((pose.x - 1.9).abs() <= PLACE && pose.y == 4.0, "{pose:?}");
        let inside = Pose2::new(2.02, 4.0, 0.0);
        assert_eq!(
            checker.check_path(&[inside, path[0]]),
            PathCheck::Invalid { index: 0, pose: inside }
        );
        let way = path.map(|pose| pose.position());
        assert_eq!(checker.check_way(&way), checker.check_path(&path));
    }

    #[test]
    fn a_long_robot_fits_through_a_gap_only_along_it() {
        // Walls at x = 2.0 and x = 2.3, half a metre high, with a gap of 0.25 m between them.
        let walls: Vec<_> = (0..50).flat_map(|y| [(60, y, 100), (66, y, 100)]).collect();
        let settings = CheckerSettings {
            body: Body::Footprint(oblong()),
            ..CheckerSettings::default()
        };
        let checker = checker(&map(&walls), settings);
        let through = [Point2::new(2.175, 6.0), Point2::new(2.175, 3.0)];
        assert_eq!(checker.check_way(&through), PathCheck::Valid);
        let upright = -std::f64::consts::FRAC_PI_2;
        assert!(checker.is_valid(Pose2::new(2.175, 3.0, upright)) && !checker.is_valid(Pose2::new(2.175, 3.0, 0.0)));
        // It cannot turn in there, nor go sideways.
        let aside = [through[0], through[1], Point2::new(2.2, 3.0)];
        assert!(matches!(checker.check_way(&aside), PathCheck::Invalid { index: 1, .. }));
    }

    #[test]
    fn unknown_cells_and_the_outside_are_what_the_switch_says() {
        let grid = map(&[(60, 50, -1)]);
        let (unknown, outside) = (Pose2::new(2.02, 4.52, 0.0), Pose2::new(-3.0, 0.0, 0.0));
        for body in [Body::Window(0.2), Body::Footprint(oblong())] {
            let with = |unknown_is_free| {
                checker(
                    &grid,
                    CheckerSettings {
                        body: body.clone(),
                        unknown_is_free,
                        ..CheckerSettings::default()
                    },
                )
            };
            assert!(with(true).is_valid(unknown) && with(true).is_valid(outside));
            assert!(!with(false).is_valid(unknown) && !with(false).is_valid(outside));
            let over = [Pose2::new(1.5, 4.52, 0.0), Pose2::new(2.5, 4.52, 0.0)];
            assert_eq!(with(true).check_path(&over), PathCheck::Valid);
            assert!(matches!(
                with(false).check_path(&over),
                PathCheck::Invalid { index: 1, .. }
            ));
        }
    }

    #[test]
    fn without_a_map_nothing_is_valid_and_a_new_map_replaces_the_old_one() {
        let mut checker = StateValidityChecker::new(CheckerSettings::default());
        let pose = Pose2::new(2.02, 4.52, 0.0);
        assert!(!checker.is_valid(pose) && checker.check_path(&[]) == PathCheck::NoMap);
        checker.set(&map(&[(60, 50, 100)]));
        assert!(!checker.is_valid(pose));
        checker.set(&map(&[]));
        assert!(checker.is_valid(pose) && checker.check_path(&[]) == PathCheck::Valid);
    }
}

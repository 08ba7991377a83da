//! Random placement. Poses at which many robots can stand at the same time.

use std::collections::HashMap;

use nalgebra::Point2;
use rand::{Rng, SeedableRng};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::RobotModel;

use crate::world::World;

/// Number of rejected poses in a row after which the world is full.
const TRIES: usize = 10_000;

/// Places `count` robots at random in the free part of a world, at least `margin` m apart from everything; fewer if there is no room
/// left. Robots are only compared with those in the cells around them.
///
/// ```
/// # let tiago = zenav_fixtures::robot("tiago");
/// use zenav_sim::{World, scatter::scatter};
///
/// let world = World::shipped("empty")?;
/// let poses = scatter(&world, &tiago, 20, 0.5, 7);
/// assert_eq!(poses.len(), 20);
/// assert_eq!(poses, scatter(&world, &tiago, 20, 0.5, 7), "the same seed gives the same poses");
/// # Ok::<(), zenav_sim::WorldError>(())
/// ```
#[must_use]
pub fn scatter(world: &World, model: &RobotModel, count: usize, margin: f64, seed: u64) -> Vec<Pose2> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (low, high) = world.bounds();
    let apart = 2.0 * model.footprint.circumscribed_radius() + margin;
    let mut poses: Vec<Pose2> = Vec::new();
    let mut cells: HashMap<(i64, i64), Vec<usize>> = HashMap::new();
    let cell = |value: f64| (value / apart.max(1e-3)).floor() as i64;
    let mut failures = 0;
    while poses.len() < count && failures < TRIES {
        let mut unit = || rng.next_u64() as f64 / u64::MAX as f64;
        let at = Point2::new(low.x + unit() * (high.x - low.x), low.y + unit() * (high.y - low.y));
        let pose = Pose2::new(at.x, at.y, (unit() - 0.5) * std::f64::consts::TAU);
        let (x, y) = (cell(at.x), cell(at.y));
        let mut around = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| (x, y)));
        let taken = around.any(|cell| {
            let near = cells.get(&cell).into_iter().flatten();
            near.filter_map(|index| poses.get(*index))
                .any(|other| other.distance(&pose) <= apart)
        });
        if taken || world.clearance(&model.footprint, pose) <= margin {
            failures += 1;
            continue;
        }
        failures = 0;
        cells.entry((x, y)).or_default().push(poses.len());
        poses.push(pose);
    }
    poses
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;
    use crate::made_worlds::floor;
    use zenav_protocol::robot::shipped;

    #[test]
    fn scattered_robots_stand_apart_and_a_full_world_takes_no_more() {
        let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
        let world = World::shipped("empty").unwrap();
        let poses = scatter(&world, &model, 50, 0.5, 1);
        assert_eq!(poses.len(), 50);
        for (i, pose) in poses.iter().enumerate() {
            assert!(
                poses
                    .iter()
                    .skip(i + 1)
                    .all(|other| pose.distance(other) > 2.0 * 0.265 + 0.5)
            );
        }
        assert!((20..=100).contains(&scatter(&world, &model, 1000, 2.0, 1).len()));
    }

    #[test]
    fn a_floor_has_room_for_all_robots_that_it_was_made_for() {
        for (name, count) in [("tiago", 1000), ("neato", 300), ("jackal", 1)] {
            let model = RobotModel::from_toml(shipped(name).unwrap(), name).unwrap();
            let world = floor(&model, count).unwrap();
            let placed = scatter(&world, &model, count, model.drive.wheel_separation, 1);
            assert_eq!(placed.len(), count, "{name}");
        }
    }
}

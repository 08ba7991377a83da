//! Wall following in lockstep. Runs a robot that follows walls on its own: body and pilot in turn, without a network, repeatable from a
//! seed.

use zenav_edge::{EdgeConfig, Inbox, Persisted, Pilot, Publication};
use zenav_protocol::id::Id;
use zenav_protocol::messages::{Event, EventKind, LostPolicy, WallFollowerState};
use zenav_protocol::robot::RobotModel;
use zenav_sim::{RobotSpec, Simulation, Truth, World};

use super::score::{Errors, Kept};
use crate::failure::Failure;

/// Control ticks between two samples of the distance.
const SAMPLE: u64 = 5;

/// Result of a run.
#[derive(Clone, Debug)]
pub struct Alone {
    /// Accuracy of the distance.
    pub kept: Kept,
    /// Ground truth at the end.
    pub truth: Truth,
    /// Share of the time spent following a wall.
    pub following: f64,
    /// All events, in order.
    pub events: Vec<Event>,
}

impl Alone {
    /// The follower's transitions, as pairs of names from and to.
    pub fn transitions(&self) -> impl Iterator<Item = (&str, &str)> {
        self.events.iter().filter_map(|event| match &event.kind {
            EventKind::Transition { from, to, .. } => Some((from.as_str(), to.as_str())),
            _ => None,
        })
    }
}

/// Runs for `secs` simulated seconds.
///
/// # Errors
/// A robot that cannot start where the world file says.
pub fn run(world: &World, model: &RobotModel, seed: u64, secs: f64) -> Result<Alone, Failure> {
    watch(world, model, seed, secs, |_, _| {})
}

/// As [`run`]; `see` is called with ground truth and state at every tick.
///
/// # Errors
/// A robot that cannot start where the world file says.
pub fn watch(
    world: &World,
    model: &RobotModel,
    seed: u64,
    secs: f64,
    mut see: impl FnMut(&Truth, WallFollowerState),
) -> Result<Alone, Failure> {
    let id = Id::robot("robot").map_err(Failure::failed)?;
    let start = world.start();
    let spec = RobotSpec {
        id: id.clone(),
        model: model.clone(),
        start,
    };
    let mut simulation = Simulation::new(world, vec![spec], seed).map_err(Failure::usage)?;
    let mut config = EdgeConfig::new(id, model.clone(), start);
    config.on_lost = LostPolicy::WallFollow;
    let tick = config.tick;
    let mut pilot = Pilot::new(config, "lockstep".to_owned(), Persisted::default());
    let target = model.wall_following.target_distance;
    let mut errors = Errors::default();
    let mut events = Vec::new();
    let ticks = (secs / tick).round() as u64;
    let mut following = 0_u64;
    for count in 0..ticks {
        simulation.step();
        let readings = simulation.readings(0);
        let outbox = pilot.step(readings.stamp, &readings, Inbox::default());
        simulation.drive(0, outbox.wheels);
        events.extend(
            outbox
                .publications
                .into_iter()
                .filter_map(|publication| match publication {
                    Publication::Event(event) => Some(event),
                    _ => None,
                }),
        );
        let truth = simulation.truth(0);
        let state = pilot.wall_follower();
        see(&truth, state);
        if state == WallFollowerState::WallFollow {
            following += 1;
            if count.is_multiple_of(SAMPLE) {
                errors.sample(world, truth.map_from_base.position(), target);
            }
        }
    }
    Ok(Alone {
        kept: errors.kept(),
        truth: simulation.truth(0),
        following: following as f64 / ticks.max(1) as f64,
        events,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files;

    #[test]
    fn a_seed_gives_the_same_run_again() {
        let (world, model) = (files::world("wall_follow").unwrap(), files::robot("neato").unwrap());
        let end = |seed| run(&world, &model, seed, 20.0).unwrap().truth;
        assert_eq!(end(3), end(3));
        assert_ne!(end(3), end(4));
    }

    #[test]
    fn a_neato_follows_the_walls_of_a_room_within_three_centimetres_and_touches_nothing() {
        let (world, model) = (files::world("wall_follow").unwrap(), files::robot("neato").unwrap());
        let run = run(&world, &model, 1, 200.0).unwrap();
        assert_eq!(run.truth.collisions, 0);
        assert!(run.kept.straight_p95_m < 0.03, "{:?}", run.kept);
        assert!(run.kept.straight_samples > 300 && run.truth.length > 25.0);
        let mut at = "wall_search";
        for (from, to) in run.transitions() {
            assert_eq!(from, at);
            at = to;
        }
        for step in [
            ("wall_search", "approach"),
            ("approach", "turn"),
            ("turn", "wall_follow"),
            ("wall_follow", "turn"),
        ] {
            assert!(run.transitions().any(|found| found == step), "{step:?}");
        }
    }

    #[test]
    fn an_island_is_left_for_the_walls_of_the_room_and_a_pillar_is_no_wall() {
        let walls = "[[wall]]\nfrom = [0, 0]\nto = [8, 0]\nthickness = 0.1\n[[wall]]\nfrom = [8, 0]\nto = [8, 8]\nthickness = 0.1\n\
                     [[wall]]\nfrom = [8, 8]\nto = [0, 8]\nthickness = 0.1\n[[wall]]\nfrom = [0, 8]\nto = [0, 0]\nthickness = 0.1\n";
        let model = files::robot("neato").unwrap();
        for (thing, leaves) in [
            (
                "[[polygon]]\npoints = [[3.8, 3.4], [5, 3.4], [5, 4.6], [3.8, 4.6]]\n",
                true,
            ),
            ("[[circle]]\nx = 4.1\ny = 4.3\nradius = 0.3\n", false),
        ] {
            let text = format!("size = [8, 8]\n[start]\nx = 3\ny = 4\n{walls}{thing}");
            let world = World::from_toml(&text, "island.toml", &|_| Err(String::new())).unwrap();
            let run = run(&world, &model, 1, 100.0).unwrap();
            let at = run.truth.map_from_base;
            let off = (at.x.min(8.0 - at.x)).min(at.y.min(8.0 - at.y));
            assert!(off < 0.6 && run.truth.collisions == 0, "{thing}: {at:?}");
            assert_eq!(
                run.transitions().any(|found| found == ("wall_follow", "wall_search")),
                leaves,
                "{thing}"
            );
        }
    }

    #[test]
    fn it_goes_around_what_stands_beside_its_wall() {
        let walls = "[[wall]]\nfrom = [0, 0]\nto = [6, 0]\nthickness = 0.1\n[[wall]]\nfrom = [6, 0]\nto = [6, 4]\nthickness = 0.1\n\
                     [[wall]]\nfrom = [6, 4]\nto = [0, 4]\nthickness = 0.1\n[[wall]]\nfrom = [0, 4]\nto = [0, 0]\nthickness = 0.1\n";
        let model = files::robot("neato").unwrap();
        // An obstacle that can be passed at a larger distance needs no turn before it.
        for (what, thing, turns_for_it) in [
            (
                "a low box",
                "[[polygon]]\npoints = [[3, 0], [3.4, 0], [3.4, 0.2], [3, 0.2]]\n",
                false,
            ),
            (
                "a pillar with a gap too narrow to drive through",
                "[[circle]]\nx = 3\ny = 0.6\nradius = 0.15\n",
                true,
            ),
            (
                "a stub",
                "[[wall]]\nfrom = [3, 0]\nto = [3, 1.2]\nthickness = 0.05\n",
                true,
            ),
        ] {
            let text = format!("size = [6, 4]\n[start]\nx = 1\ny = 1\nyaw = -1.5\n{walls}{thing}");
            let world = World::from_toml(&text, "room.toml", &|_| Err(String::new())).unwrap();
            let (mut farthest, mut turns) = (0.0_f64, false);
            let run = watch(&world, &model, 2, 60.0, |truth, state| {
                let at = truth.map_from_base;
                farthest = farthest.max(at.x);
                turns |= state == WallFollowerState::Turn && (2.0..3.2).contains(&at.x) && at.y < 2.0;
            })
            .unwrap();
            assert_eq!(run.truth.collisions, 0, "{what}");
            assert!(farthest > 5.4, "{what} was not passed: {farthest}");
            assert!(run.truth.min_clearance > 0.08, "{what}: {}", run.truth.min_clearance);
            assert_eq!(turns, turns_for_it, "{what}");
        }
    }
}

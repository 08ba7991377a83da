//! Patience. The only way is blocked for a while.

use std::ops::Range;

use rand::RngExt as _;
use zenav_sim::movers::Route;

use super::floor::{FOR_GOOD, Floor, PERSON};
use super::{Case, Make, each};
use crate::failure::Failure;

/// Two rooms with a door of 0.9 m between them.
pub(super) fn two_rooms() -> Floor {
    Floor::new([8.0, 5.0], [1.0, 2.5, 0.0])
        .block([3.95, 0.0], [4.05, 2.05])
        .block([3.95, 2.95], [4.05, 5.0])
}

/// S7: a person in a door for 20 s, a cycling door, a goal occupied for 22 s, a slow person ahead.
pub(super) fn patience(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let scenarios: [(&str, Make); 4] = [
        ("S7 stander in a door, 20 s", |rng| {
            let aside = [5.0 + rng.random_range(0.0..1.0), 0.6];
            let floor = two_rooms().mover(PERSON, 0.8, &[([4.0, 2.5], 20.0), ([5.0, 2.5], 0.0), (aside, FOR_GOOD)]);
            (floor, [7.0, 2.5])
        }),
        ("S7 cycling door", |rng| {
            let shut = rng.random_range(6.0..10.0);
            (two_rooms().door([4.0, 2.05], [4.0, 2.95], shut, 10.0), [7.0, 2.5])
        }),
        ("S7 goal taken, 22 s", |rng| {
            let aside = [rng.random_range(5.0..7.0), 0.6];
            let floor = Floor::new([8.0, 5.0], [1.0, 2.5, 0.0]);
            (
                floor.mover(PERSON, 0.8, &[([6.5, 2.5], 22.0), (aside, FOR_GOOD)]),
                [6.5, 2.5],
            )
        }),
        ("S7 slow one ahead", |rng| {
            let speed = rng.random_range(0.2..0.4);
            let floor = Floor::new([16.0, 5.0], [1.0, 0.6, 0.0]).block([0.0, 1.2], [12.0, 5.0]);
            let path = [([2.5, 0.6], 0.0), ([12.8, 0.6], 0.0), ([14.0, 4.0], FOR_GOOD)];
            (floor.mover(PERSON, speed, &path), [14.5, 0.6])
        }),
    ];
    let mut cases = each(&scenarios, robots, &seeds)?;
    for case in &mut cases {
        case.leaves_at = case.world.movers().first().and_then(|mover| match &mover.route {
            Route::Path(path) => path.first().map(|(_, rest)| *rest).filter(|rest| *rest > 0.0),
            Route::Walk { .. } => None,
        });
    }
    Ok(cases)
}

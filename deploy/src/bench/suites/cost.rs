//! Cost. Processor time on long paths in a known map, without people.

use std::ops::Range;

use super::Case;
use super::floor::Floor;
use crate::failure::Failure;

/// S12: a corridor of 45 m, and five lanes of 200 m in total.
pub(super) fn cost(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let mut cases = Vec::new();
    for (scenario, metres) in [("S12 corridor 45 m", 45.0), ("S12 lanes 200 m", 200.0)] {
        for robot in robots {
            for seed in seeds.clone() {
                let (floor, goal) = if metres < 100.0 { corridor() } else { lanes() };
                let mut case = Case::new(scenario, robot, seed, floor, goal)?.knowing_the_map();
                case.is_costed = true;
                case.timeout = (60.0 + 3.0 * metres / case.model.drive.top_speed()).round();
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

fn corridor() -> (Floor, [f64; 2]) {
    (Floor::new([48.0, 3.0], [1.5, 1.5, 0.0]), [46.5, 1.5])
}

/// Lanes 2.4 m wide and 40 m long, back and forth.
fn lanes() -> (Floor, [f64; 2]) {
    let mut floor = Floor::new([41.0, 12.4], [1.2, 1.2, 0.0]);
    for wall in 0..4_u8 {
        let y = 2.4 + 2.5 * f64::from(wall);
        let [left, right] = if wall % 2 == 0 { [0.0, 38.6] } else { [2.4, 41.0] };
        floor = floor.block([left, y], [right, y + 0.1]);
    }
    (floor, [39.8, 11.2])
}

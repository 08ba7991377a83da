//! Places. Narrow and cluttered places, in which only the robot moves.

use std::ops::Range;

use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;

use super::floor::Floor;
use super::{Case, Make, ends, rng};
use crate::failure::Failure;
use crate::files;

/// S5: doors little wider than the robot, a lane to back out of, a goal beside a wall.
pub(super) fn tight(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let mut cases = Vec::new();
    for robot in robots {
        let model = files::robot(robot)?;
        let (half, [ahead, behind]) = (model.footprint.half_width(), ends(&model));
        for seed in seeds.clone() {
            for (scenario, spare) in [("S5 door +5 cm", 0.05), ("S5 door +10 cm", 0.10)] {
                let mut rng = rng(scenario, seed);
                let (y, from, to) = (
                    rng.random_range(1.5..3.5),
                    rng.random_range(1.0..4.0),
                    rng.random_range(1.0..4.0),
                );
                let gap = half + 0.5 * spare;
                let floor = Floor::new([8.0, 5.0], [1.0, from, 0.0])
                    .block([3.95, 0.0], [4.05, y - gap])
                    .block([3.95, y + gap], [4.05, 5.0]);
                cases.push(Case::new(scenario, robot, seed, floor, [7.0, to])?);
            }
            let scenario = "S5 dead end";
            let mut rng = rng(scenario, seed);
            let (gap, depth) = (half + 0.075, rng.random_range(0.8..1.6));
            // The robot starts in the lane, 10 cm from its end.
            let start = 6.0 - ahead - 0.1;
            let lane = start - behind - depth;
            let floor = Floor::new([6.0, 4.0], [start, 2.0, 0.0])
                .block([lane, 2.0 - gap - 0.1], [6.0, 2.0 - gap])
                .block([lane, 2.0 + gap], [6.0, 2.0 + gap + 0.1]);
            cases.push(Case::new(scenario, robot, seed, floor, [1.0, 2.0])?);
            let scenario = "S5 goal 2 cm from a wall";
            let mut rng = self::rng(scenario, seed);
            let floor = Floor::new([6.0, 4.0], [1.0, rng.random_range(1.0..3.0), 0.0]);
            let mut case = Case::new(scenario, robot, seed, floor, [rng.random_range(3.0..4.5), half + 0.02])?;
            case.tolerance = Some(0.05);
            cases.push(case);
        }
    }
    Ok(cases)
}

/// S6: pillars, a trap, an office, a warehouse; each with an unknown and a known map.
pub(super) fn rooms(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let mut cases = Vec::new();
    let scenarios: [(&str, Make); 4] = [
        ("S6 clutter", clutter),
        ("S6 trap", trap),
        ("S6 office", office),
        ("S6 warehouse", warehouse),
    ];
    for (scenario, make) in scenarios {
        for (how, known_map) in [("unknown", false), ("known", true)] {
            for robot in robots {
                for seed in seeds.clone() {
                    let (floor, goal) = make(&mut rng(scenario, seed));
                    let case = Case::new(&format!("{scenario} {how}"), robot, seed, floor, goal)?;
                    cases.push(if known_map { case.knowing_the_map() } else { case });
                }
            }
        }
    }
    Ok(cases)
}

/// Pillars with gaps of 0.9 m and more.
pub(super) fn clutter(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let mut floor = Floor::new([12.0, 8.0], [1.0, 4.0, 0.0]);
    let mut discs: Vec<([f64; 2], f64)> = vec![([1.0, 4.0], 0.3), ([11.0, 4.0], 0.3)];
    for _ in 0..400 {
        let (at, radius) = (
            [rng.random_range(1.0..11.0), rng.random_range(0.5..7.5)],
            rng.random_range(0.1..0.35),
        );
        if discs
            .iter()
            .all(|(other, size)| (at[0] - other[0]).hypot(at[1] - other[1]) > radius + size + 0.9)
        {
            floor = floor.disc(at, radius);
            discs.push((at, radius));
        }
    }
    (floor, [11.0, 4.0])
}

/// A pocket open towards the robot, across the straight path.
fn trap(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let (deep, shift) = (rng.random_range(2.0..4.0), rng.random_range(-0.5..0.5));
    let (low, high) = (2.5 + shift, 5.5 + shift);
    let floor = Floor::new([12.0, 8.0], [1.5, 4.0, 0.0])
        .block([8.0 - deep, low - 0.1], [8.0, low])
        .block([8.0 - deep, high], [8.0, high + 0.1])
        .block([8.0, low - 0.1], [8.1, high + 0.1]);
    (floor, [11.0, 4.0])
}

/// Two rows of rooms with a desk in each, and doors of 0.9 m to a corridor of 2 m.
pub(super) fn office(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let mut floor = Floor::new([20.0, 12.0], [1.0, 1.5, 0.0]);
    for (wall, desk) in [(4.95, 2.8), (6.95, 8.7)] {
        for room in 0..4 {
            let left = 5.0 * f64::from(room);
            let door = left + rng.random_range(0.8..3.2);
            floor = floor
                .block([left, wall], [door, wall + 0.1])
                .block([door + 0.9, wall], [left + 5.0, wall + 0.1]);
            let x = left + rng.random_range(1.5..2.3);
            floor = floor.block([x, desk], [x + 1.4, desk + 0.7]);
        }
    }
    for left in [5.0, 10.0, 15.0] {
        floor = floor
            .block([left - 0.05, 0.0], [left + 0.05, 5.0])
            .block([left - 0.05, 7.0], [left + 0.05, 12.0]);
    }
    (floor, [19.0, 11.0])
}

/// Racks of 1.2 m by 6 m with aisles of 2 m, cross aisles at their ends, and pallets that narrow the aisles to 1.2 m or block them.
fn warehouse(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let mut floor = Floor::new([26.0, 18.0], [1.0, 1.0, 0.0]);
    for row in 0..5 {
        for column in 0..3 {
            let (left, low) = (3.0 + 7.5 * f64::from(column), 2.0 + 3.2 * f64::from(row));
            floor = floor.block([left, low], [left + 6.0, low + 1.2]);
            // A pallet in the aisle above the rack.
            let (x, deep) = (
                left + rng.random_range(0.5..4.7),
                if rng.random_bool(0.15) { 2.0 } else { 0.8 },
            );
            if rng.random_bool(0.5) {
                floor = floor.block([x, low + 1.2], [x + 0.8, low + 1.2 + deep]);
            }
        }
    }
    (floor, [25.0, 17.0])
}

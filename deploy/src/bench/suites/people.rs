//! People. Moving people: in S2 and S3 they ignore the robot, in S4 they make way as much as it does.

use std::f64::consts::FRAC_PI_2;
use std::ops::Range;

use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;

use super::floor::{FOR_GOOD, Floor, PERSON};
use super::{Case, Make, each, rng};
use crate::failure::Failure;

/// Radius of a disc in the open field, m.
const DISC: f64 = 0.3;
/// Smallest initial distance from the robot, m.
const BERTH: f64 = 2.5;

/// A random place in a box, away from the start.
fn place(rng: &mut Pcg64Mcg, [w, h]: [f64; 2], start: [f64; 2]) -> [f64; 2] {
    loop {
        let at = [rng.random_range(0.5..w - 0.5), rng.random_range(0.5..h - 0.5)].map(centimetres);
        if (at[0] - start[0]).hypot(at[1] - start[1]) > BERTH {
            return at;
        }
    }
}

/// Rounded to centimetres, to keep world files short.
fn centimetres(metres: f64) -> f64 {
    (100.0 * metres).round() / 100.0
}

/// S2, after DynaBARN (Nair et al., "DynaBARN: Benchmarking Metric Ground Navigation in Dynamic Environments", 2022): an open field of 10
/// m by 20 m, a Jackal by default, discs on random polylines; levels differ in number and speed.
pub(super) fn field(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let (size, start) = ([10.0, 20.0], [5.0, 1.0]);
    let mut cases = Vec::new();
    for (level, discs, speeds) in [("easy", 6, 0.4..0.8), ("medium", 10, 0.6..1.2), ("hard", 14, 0.8..1.6)] {
        let scenario = format!("S2 field {level}");
        for seed in seeds.clone() {
            let mut rng = rng(&scenario, seed);
            let mut floor = Floor::new(size, [start[0], start[1], FRAC_PI_2]);
            for _ in 0..discs {
                let corners: Vec<([f64; 2], f64)> = (0..6).map(|_| (place(&mut rng, size, start), 0.0)).collect();
                floor = floor.mover(DISC, centimetres(rng.random_range(speeds.clone())), &corners);
            }
            for robot in robots {
                cases.push(Case::new(&scenario, robot, seed, floor.clone(), [5.0, 19.0])?);
            }
        }
    }
    Ok(cases)
}

/// S3: crowds of blind walkers in a hall, and people who cross, come towards the robot, or come around a corner.
pub(super) fn encounters(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let scenarios: [(&str, Make); 7] = [
        ("S3 crowd 5", |rng| crowd(rng, 5)),
        ("S3 crowd 10", |rng| crowd(rng, 10)),
        ("S3 crowd 20", |rng| crowd(rng, 20)),
        ("S3 crossing 1", |rng| crossing(rng, 1)),
        ("S3 crossing 3", |rng| crossing(rng, 3)),
        ("S3 oncoming 3 m", oncoming),
        ("S3 blind corner", blind_corner),
    ];
    each(&scenarios, robots, &seeds)
}

/// A hall of 14 m by 8 m, walkers of 0.5 to 1.5 m/s.
fn crowd(rng: &mut Pcg64Mcg, walkers: u32) -> (Floor, [f64; 2]) {
    let (size, start) = ([14.0, 8.0], [1.0, 4.0]);
    let mut floor = Floor::new(size, [start[0], start[1], 0.0]);
    for _ in 0..walkers {
        let speed = centimetres(rng.random_range(0.5..1.5));
        floor = floor.walker(speed, place(rng, size, start));
    }
    (floor, [13.0, 4.0])
}

/// People who walk back and forth across the robot's path.
fn crossing(rng: &mut Pcg64Mcg, people: u32) -> (Floor, [f64; 2]) {
    let mut floor = Floor::new([12.0, 8.0], [1.0, 4.0, 0.0]);
    for person in 0..people {
        let x = centimetres(4.0 + 2.0 * f64::from(person) + rng.random_range(-0.4..0.4));
        let (speed, rest) = (rng.random_range(0.8..1.3), rng.random_range(0.0..3.0));
        let mut path = [([x, 0.7], centimetres(rest)), ([x, 7.3], 0.5)];
        if rng.random() {
            path.reverse();
        }
        floor = floor.mover(PERSON, centimetres(speed), &path);
    }
    (floor, [10.0, 4.0])
}

/// A person comes along the middle of a corridor 3 m wide, and stays at its end.
fn oncoming(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let y = centimetres(rng.random_range(1.3..1.7));
    let speed = centimetres(rng.random_range(0.7..1.3));
    let floor =
        Floor::new([16.0, 3.0], [1.5, 1.5, 0.0]).mover(PERSON, speed, &[([15.5, y], 0.0), ([0.4, y], FOR_GOOD)]);
    (floor, [13.5, 1.5])
}

/// A corridor 1.5 m wide with a niche before its corner; a person comes around the corner.
fn blind_corner(rng: &mut Pcg64Mcg) -> (Floor, [f64; 2]) {
    let speed = centimetres(rng.random_range(0.6..1.0));
    let wait = centimetres(rng.random_range(0.0..3.0));
    let floor = Floor::new([9.0, 9.0], [1.3, 0.75, 0.0])
        .block([0.0, 1.5], [3.6, 9.0])
        .block([3.6, 2.7], [4.9, 9.0])
        .block([4.9, 1.5], [7.5, 9.0])
        .mover(
            PERSON,
            speed,
            &[([8.25, 8.6], wait), ([8.25, 0.75], 0.0), ([0.4, 0.75], FOR_GOOD)],
        );
    (floor, [8.25, 7.0])
}

/// S4: people who make way by ORCA or by social force, chosen by the seed, in the situations of SEAN 2.0 (Tsoi et al., 2022).
pub(super) fn manners(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let scenarios: [(&str, Make); 6] = [
        ("S4 crossing", |rng| {
            let mut floor = Floor::new([12.0, 8.0], [1.0, 4.0, 0.0]);
            for x in [4.5, 7.0] {
                let (manners, speed, rest) = (drawn(rng), walk(rng), centimetres(rng.random_range(0.0..3.0)));
                floor = floor.person(manners, speed, &[([x, 0.7], rest), ([x, 7.3], 0.5)]);
            }
            (floor, [10.0, 4.0])
        }),
        ("S4 oncoming", |rng| {
            let (manners, speed, y) = (drawn(rng), walk(rng), centimetres(rng.random_range(1.0..1.4)));
            let path = [([15.5, y], 0.0), ([0.6, y], FOR_GOOD)];
            let floor = Floor::new([16.0, 2.4], [1.5, 1.2, 0.0]).person(manners, speed, &path);
            (floor, [13.5, 1.2])
        }),
        ("S4 overtaking", |rng| {
            let (manners, speed) = (drawn(rng), centimetres(rng.random_range(0.1..0.2)));
            let path = [([3.5, 1.2], 0.0), ([15.5, 1.2], FOR_GOOD)];
            let floor = Floor::new([16.0, 2.4], [1.5, 1.2, 0.0]).person(manners, speed, &path);
            (floor, [13.5, 1.2])
        }),
        ("S4 door", |rng| {
            let (manners, speed, wait) = (drawn(rng), walk(rng), centimetres(rng.random_range(0.0..6.0)));
            let path = [
                ([7.0, 1.0], wait),
                ([5.0, 2.5], 0.0),
                ([3.0, 2.5], 0.0),
                ([1.0, 4.2], FOR_GOOD),
            ];
            (super::patience::two_rooms().person(manners, speed, &path), [7.0, 2.5])
        }),
        ("S4 corner", |rng| {
            let (manners, speed, wait) = (drawn(rng), walk(rng), centimetres(rng.random_range(0.0..3.0)));
            let path = [([8.0, 8.4], wait), ([8.0, 1.0], 0.0), ([0.6, 1.0], FOR_GOOD)];
            let floor = Floor::new([9.0, 9.0], [1.3, 1.0, 0.0]).block([0.0, 2.0], [7.0, 9.0]);
            (floor.person(manners, speed, &path), [8.0, 7.0])
        }),
        ("S4 group", |rng| {
            let manners = drawn(rng);
            let (x, y) = (
                centimetres(rng.random_range(5.0..6.0)),
                centimetres(rng.random_range(3.6..4.4)),
            );
            let mut floor = Floor::new([12.0, 8.0], [1.0, 4.0, 0.0]);
            for [dx, dy] in [[0.0, 0.6], [0.52, -0.3], [-0.52, -0.3]] {
                floor = floor.person(manners, 0.8, &[([centimetres(x + dx), centimetres(y + dy)], FOR_GOOD)]);
            }
            let joins = [([9.5, 6.5], 2.0), ([centimetres(x + 1.1), y], FOR_GOOD)];
            (floor.person(manners, walk(rng), &joins), [10.5, 4.0])
        }),
    ];
    each(&scenarios, robots, &seeds)
}

/// How a person makes way.
fn drawn(rng: &mut Pcg64Mcg) -> &'static str {
    if rng.random() { "orca" } else { "social_force" }
}

/// Walking speed, m/s.
fn walk(rng: &mut Pcg64Mcg) -> f64 {
    centimetres(rng.random_range(0.8..1.3))
}

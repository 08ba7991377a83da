//! Broken sensors. How does it drive when what it senses is late, lost or crooked? Each run beside the same one without the fault.

use std::ops::Range;

use super::places::{clutter, office};
use super::{Case, rng};
use crate::failure::Failure;

/// A sensor that dies is dead from here, s, for this long, s.
const DEAD: [f64; 2] = [6.0, 10.0];

/// What is broken: the scenario, and the fault as its world file has it.
const FAULTS: [(&str, &str); 11] = [
    ("no fault", ""),
    ("beams lost 30 %", "sensor = \"lidar\"\nkind = \"lost\"\namount = 0.3"),
    ("beams lost 80 %", "sensor = \"lidar\"\nkind = \"lost\"\namount = 0.8"),
    ("scans late 0.2 s", "sensor = \"lidar\"\nkind = \"late\"\namount = 0.2"),
    ("scans late 0.5 s", "sensor = \"lidar\"\nkind = \"late\"\namount = 0.5"),
    (
        "ranges noisy 3 cm",
        "sensor = \"lidar\"\nkind = \"noisy\"\namount = 0.03",
    ),
    (
        "ranges noisy 5 cm",
        "sensor = \"lidar\"\nkind = \"noisy\"\namount = 0.05",
    ),
    (
        "encoders lost 30 %",
        "sensor = \"encoders\"\nkind = \"lost\"\namount = 0.3",
    ),
    ("lidar dead 10 s", "sensor = \"lidar\"\nkind = \"dead\""),
    ("encoders dead 10 s", "sensor = \"encoders\"\nkind = \"dead\""),
    ("gyro dead 10 s", "sensor = \"imu\"\nkind = \"dead\""),
];

/// S9: pillars and an office by turns, one fault each.
pub(super) fn broken(robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let mut cases = Vec::new();
    for (label, fault) in FAULTS {
        let scenario = format!("S9 {label}");
        for robot in robots {
            for seed in seeds.clone() {
                let mut rng = rng("S9", seed);
                let (mut floor, goal) = if seed % 2 == 0 {
                    clutter(&mut rng)
                } else {
                    office(&mut rng)
                };
                let dies = fault.contains("dead");
                if dies {
                    let [from, secs] = DEAD;
                    floor = floor.fault(&format!("{fault}\nfrom = {from}\nuntil = {}", from + secs));
                } else if !fault.is_empty() {
                    floor = floor.fault(fault);
                }
                let mut case = Case::new(&scenario, robot, seed, floor, goal)?;
                case.faultless = Some(Case::name("S9 no fault", robot, seed));
                case.blind_from = (dies && fault.contains("lidar")).then_some(DEAD[0]);
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

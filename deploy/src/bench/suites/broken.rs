//! Broken sensors. Driving with late, lost or distorted sensor data; each run is compared with the same one without the fault.

use std::ops::Range;

use super::places::{clutter, office};
use super::{Case, rng};
use crate::failure::Failure;

/// Start and duration of a sensor failure, s.
const DEAD: [f64; 2] = [6.0, 10.0];

/// Faults: the scenario's label, and the table in the world file.
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

/// S9: pillars and an office alternately, one fault each.
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

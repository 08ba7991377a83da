//! Drives. Path error of each tracker, and energy of a drive.

use std::path::Path;

use zenav_edge::trackers::LAWS;
use zenav_fixtures::{Row, robot};
use zenav_mapping::read_map;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::DrivingProfile;
use zenav_protocol::robot::RobotModel;
use zenav_sim::World;
use zenav_tests::acceptance::sim_rig::SimRigError;
use zenav_tests::acceptance::tracking::{self, Localised, PlannedPath, percentile};

use crate::Verdict;

/// Paths on each map.
const PATHS: usize = 12;

/// Shipped worlds and maps to drive in.
fn worlds(shipped: &[&str], maps: &[String]) -> Result<Vec<World>, Box<dyn std::error::Error>> {
    let mut worlds = Vec::new();
    for name in shipped {
        worlds.push(World::shipped(name)?);
    }
    for name in maps {
        let map = read_map(Path::new(name), 0.05)?;
        worlds.push(World::from_map(name, map, Pose2::IDENTITY));
    }
    Ok(worlds)
}

/// Drives the same paths at full speed and with the least energy, and prints the energy drawn. The cloud corrects the pose: by wheel
/// odometry alone a Neato is 4 cm off after 40 m, and stops at obstacles that its plan passes.
pub fn economy(maps: &[String]) -> Verdict {
    let mut good = true;
    println!(
        "{:30} {:18} {:8} {:>8} {:>8} {:>9} {:>11} {:>8} {:>8}",
        "map", "robot", "profile", "path, m", "time, s", "energy, J", "forecast, J", "J/m", "reached"
    );
    for world in &worlds(&["kitchen", "house"], maps)? {
        let map = tracking::true_map(world);
        for name in ["tiago", "jackal", "turtlebot3_waffle", "neato"] {
            let model = robot(name);
            let mut sums = Vec::new();
            for (profile, label) in [
                (DrivingProfile::Fastest, "fastest"),
                (DrivingProfile::Economy, "economy"),
            ] {
                let paths = tracking::planned_paths(&map, &model, 1, PATHS, profile);
                let (mut metres, mut secs, mut joules, mut forecast, mut reached) = (0.0, 0.0, 0.0, 0.0, 0);
                for (seed, path) in paths.iter().enumerate() {
                    let drive =
                        tracking::drive(world, &model, "time_law", path, Localised::Corrected, seed as u64 + 1)?;
                    reached += usize::from(drive.secs.is_some() && drive.contacts == 0);
                    metres += drive.length;
                    secs += drive.secs.unwrap_or(f64::NAN);
                    joules += drive.drawn_j;
                    forecast += path.forecast_j;
                }
                good &= reached == paths.len() && !paths.is_empty();
                println!(
                    "{:30} {name:18} {label:8} {metres:8.1} {secs:8.1} {joules:9.0} {forecast:11.0} {:8.2} {:>8}",
                    world.name(),
                    joules / metres,
                    format!("{reached}/{}", paths.len()),
                );
                sums.push((secs, joules));
            }
            if let [(secs, joules), (longer, fewer)] = sums[..] {
                println!(
                    "{:30} {name:18} {:8} {:>8} {:+7.1}% {:+8.1}%",
                    world.name(),
                    "",
                    "",
                    100.0 * (longer / secs - 1.0),
                    100.0 * (fewer / joules - 1.0)
                );
                let more = 100.0 * (longer / secs - 1.0);
                Row::new(
                    format!("{} {name}: time, economy over fastest", world.name()),
                    more,
                    "%",
                )
                .print();
                let saved = 100.0 * (1.0 - fewer / joules);
                Row::new(format!("{} {name}: energy saved", world.name()), saved, "%").print();
                // In a small slow robot the electronics draw the most, so the fastest drive is also the most economical one.
                good &= (fewer < joules && longer > secs) || (fewer == joules && longer == secs);
            }
        }
    }
    Ok(good)
}

/// Drives the same paths by every tracker, in the kitchen and in maps, each law compared with its own reference, and then one way with
/// corners, which is the reference of all. Prints a table. The time law must be the best on the paths, which are made for it; on the
/// corners it need only arrive.
pub fn track(maps: &[String]) -> Verdict {
    let model = robot("tiago");
    let mut good = true;
    println!(
        "{:30} {:18} {:>8} {:>8} {:>8} {:>9} {:>9} {:>8} {:>8}",
        "map", "tracker", "p50, cm", "p95, cm", "max, cm", "reached", "time, s", "J/m", "stopped"
    );
    for world in &worlds(&["kitchen"], maps)? {
        let paths = tracking::planned_paths(&tracking::true_map(world), &model, 1, PATHS, DrivingProfile::Fastest);
        let mut least = f64::INFINITY;
        for law in LAWS.iter().map(|law| law.name) {
            let Tracked { p95, reached } = tracked(world.name(), world, &model, law, &paths)?;
            if law == "time_law" {
                least = p95;
                good &= p95 < 3.0 && reached == paths.len() && paths.len() == PATHS;
            } else {
                good &= least < p95;
            }
        }
    }
    let way = vec![tracking::corner_way(&model); PATHS];
    for law in LAWS.iter().map(|law| law.name) {
        let Tracked { reached, .. } = tracked("corner way", &World::shipped("empty")?, &model, law, &way)?;
        good &= law != "time_law" || reached == PATHS;
    }
    Ok(good)
}

/// The result of a law on all paths.
struct Tracked {
    /// Path error, cm.
    p95: f64,
    /// Number of paths driven to the end without a contact.
    reached: usize,
}

/// Drives all paths by a law, each with a seed of its own, and prints its row.
fn tracked(
    name: &str,
    world: &World,
    model: &RobotModel,
    law: &str,
    paths: &[PlannedPath],
) -> Result<Tracked, SimRigError> {
    let mut errors = Vec::new();
    let (mut reached, mut secs, mut joules, mut metres, mut interventions) = (0, 0.0, 0.0, 0.0, 0);
    for (seed, path) in paths.iter().enumerate() {
        let drive = tracking::drive(world, model, law, path, Localised::OnBoard, seed as u64 + 1)?;
        errors.extend(drive.errors);
        reached += usize::from(drive.secs.is_some() && drive.contacts == 0);
        secs += drive.secs.unwrap_or(f64::NAN);
        joules += drive.drawn_j;
        metres += drive.length;
        interventions += drive.interventions;
    }
    let mut cm = |share| 100.0 * percentile(&mut errors, share);
    let (p50, p95, most) = (cm(0.5), cm(0.95), cm(1.0));
    println!(
        "{name:30} {law:18} {p50:8.2} {p95:8.2} {most:8.2} {:>9} {secs:9.1} {:8.1} {interventions:8}",
        format!("{reached}/{}", paths.len()),
        joules / metres,
    );
    Row::new(format!("{name} {law}: path error, p95"), p95, "cm").print();
    Ok(Tracked { p95, reached })
}

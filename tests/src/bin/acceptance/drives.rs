//! How near to its way does each tracker keep the robot, and what does a drive cost?

use std::path::Path;

use zenav_mapping::map_file::read_map;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::DrivingProfile;
use zenav_protocol::robot::TrackerKind;
use zenav_sim::World;
use zenav_tests::acceptance::sim_rig::robot;
use zenav_tests::acceptance::tracking::{self, Localised, percentile};

use crate::Verdict;

/// Ways a map that every tracker drives.
const WAYS: usize = 12;

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

/// Drives the same ways as fast as the robot may and with the least energy, and prints what the battery gave for it. Off board somebody
/// measures where it is: by its wheels alone a Neato is 4 cm off after 40 m, and stands before what its plan passes.
pub fn economy(maps: &[String]) -> Verdict {
    let mut good = true;
    println!(
        "{:30} {:18} {:8} {:>8} {:>8} {:>9} {:>11} {:>8} {:>8}",
        "map", "robot", "profile", "way, m", "time, s", "energy, J", "forecast, J", "J/m", "reached"
    );
    for world in &worlds(&["kitchen", "house"], maps)? {
        let map = tracking::true_map(world);
        for name in ["tiago", "jackal", "turtlebot3_waffle", "neato"] {
            let model = robot(name)?;
            let mut sums = Vec::new();
            for (profile, label) in [
                (DrivingProfile::Fastest, "fastest"),
                (DrivingProfile::Economy, "economy"),
            ] {
                let ways = tracking::ways(&map, &model, 1, WAYS, profile);
                let (mut metres, mut secs, mut joules, mut forecast, mut reached) = (0.0, 0.0, 0.0, 0.0, 0);
                for (seed, way) in ways.iter().enumerate() {
                    let drive = tracking::drive(
                        world,
                        &model,
                        TrackerKind::TimeLaw,
                        way,
                        Localised::OffBoard,
                        seed as u64 + 1,
                    )?;
                    reached += usize::from(drive.secs.is_some() && drive.contacts == 0);
                    metres += drive.length;
                    secs += drive.secs.unwrap_or(f64::NAN);
                    joules += drive.drawn_j;
                    forecast += way.forecast_j;
                }
                good &= reached == ways.len() && !ways.is_empty();
                println!(
                    "{:30} {name:18} {label:8} {metres:8.1} {secs:8.1} {joules:9.0} {forecast:11.0} {:8.2} {:>8}",
                    world.name(),
                    joules / metres,
                    format!("{reached}/{}", ways.len()),
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
                // Where the electronics take the most, as in a small slow robot, the fastest is the cheapest, and both are one.
                good &= (fewer < joules && longer > secs) || (fewer == joules && longer == secs);
            }
        }
    }
    Ok(good)
}

/// Drives the same ways by every tracker, in the kitchen and in maps, and prints a table.
pub fn track(maps: &[String]) -> Verdict {
    let model = robot("tiago")?;
    let worlds = worlds(&["kitchen"], maps)?;
    let mut good = true;
    println!(
        "{:30} {:14} {:>8} {:>8} {:>8} {:>9} {:>9} {:>8} {:>8}",
        "map", "tracker", "p50, cm", "p95, cm", "max, cm", "reached", "time, s", "J/m", "guarded"
    );
    for world in &worlds {
        let ways = tracking::ways(&tracking::true_map(world), &model, 1, WAYS, DrivingProfile::Fastest);
        let mut least = f64::INFINITY;
        for (name, law) in tracking::LAWS {
            let mut errors = Vec::new();
            let (mut reached, mut secs, mut joules, mut metres, mut guarded) = (0, 0.0, 0.0, 0.0, 0);
            for (seed, way) in ways.iter().enumerate() {
                let drive = tracking::drive(world, &model, law, way, Localised::Alone, seed as u64 + 1)?;
                errors.extend(drive.errors);
                reached += usize::from(drive.secs.is_some() && drive.contacts == 0);
                secs += drive.secs.unwrap_or(f64::NAN);
                joules += drive.drawn_j;
                metres += drive.length;
                guarded += drive.interventions;
            }
            let mut cm = |share| 100.0 * percentile(&mut errors, share);
            let (p50, p95, most) = (cm(0.5), cm(0.95), cm(1.0));
            println!(
                "{:30} {name:14} {p50:8.2} {p95:8.2} {most:8.2} {:>9} {secs:9.1} {:8.1} {guarded:8}",
                world.name(),
                format!("{reached}/{}", ways.len()),
                joules / metres,
            );
            if law == TrackerKind::TimeLaw {
                least = p95;
                good &= p95 < 3.0 && reached == ways.len() && ways.len() == WAYS;
            } else {
                good &= least < p95;
            }
        }
    }
    Ok(good)
}

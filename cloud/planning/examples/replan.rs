//! A door closes and opens again while a robot drives: what of an answer is kept?
//!
//! `cargo run -p zenav-planning --example replan`

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use nalgebra::Point2;
use zenav_planning::{Budget, PlanOptions, Replanner};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
use zenav_protocol::messages::PlanOutcome;
use zenav_protocol::robot::Footprint;
use zenav_space::{ConfigurationSpace, UnknownPolicy};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // 20 m by 10 m, and a wall with two doors.
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.1,
        width: 200,
        height: 100,
    };
    let mut map = Grid::filled(spec, Occupancy::FREE);
    let near_door = 30..45;
    for y in (0..100).filter(|y| !near_door.contains(y) && !(80..95).contains(y)) {
        map[Cell::new(100, y)] = Occupancy::OCCUPIED;
    }
    let footprint = Footprint::Radius(0.3);
    let space = |map: &_| ConfigurationSpace::new(map, &footprint, UnknownPolicy::Blocked, 0.0);
    let mut replanner = Replanner::new(&space(&map))?;
    let goal = Pose2::new(18.0, 3.0, 0.0);
    for (what, x, obstacle, is_open) in [
        ("at first", 2.0, None, true),
        ("2 m on", 4.0, None, true),
        ("an obstacle elsewhere", 4.0, Some(Cell::new(150, 90)), true),
        ("an obstacle on the path", 4.0, Some(Cell::new(140, 30)), true),
        ("the door is closed", 4.0, None, false),
        ("and open again", 4.0, None, true),
    ] {
        if let Some(cell) = obstacle {
            map[cell] = Occupancy::OCCUPIED;
        }
        for y in near_door.clone() {
            map[Cell::new(100, y)] = if is_open { Occupancy::FREE } else { Occupancy::OCCUPIED };
        }
        let start = Pose2::new(x, 3.0, 0.0);
        let options = PlanOptions::default();
        let planned = replanner.plan(&space(&map), start, goal, &options, Budget::UNLIMITED)?;
        let length = match planned.outcome {
            PlanOutcome::Found { length, .. } => format!("{length:5.2} m"),
            other => format!("{other:?}"),
        };
        println!(
            "{what:24} {length}   {:?}, {} expansions",
            planned.origin, planned.expansions
        );
    }
    Ok(())
}

//! Replanning while a door closes and opens again and the robot drives: prints what is reused of each answer.
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
    let mut start = Pose2::new(2.0, 3.0, 0.0);
    let mut known: Vec<Point2<f64>> = Vec::new();
    for what in [
        "at first",
        "2 m on",
        "an obstacle elsewhere",
        "one on the path",
        "the door is closed",
        "it is open again",
    ] {
        match what {
            "2 m on" => start = Pose2::new(along(&known, 2.0).x, along(&known, 2.0).y, 0.0),
            "an obstacle elsewhere" => map[Cell::new(150, 90)] = Occupancy::OCCUPIED,
            "one on the path" => {
                if let Some(cell) = spec.cell_at(along(&known, 11.0)) {
                    map[cell] = Occupancy::OCCUPIED;
                }
            }
            _ => {}
        }
        for y in near_door.clone() {
            let is_closed = what == "the door is closed";
            map[Cell::new(100, y)] = if is_closed {
                Occupancy::OCCUPIED
            } else {
                Occupancy::FREE
            };
        }
        let options = PlanOptions::default();
        let planned = replanner.plan(&space(&map), start, goal, &options, Budget::UNLIMITED)?;
        let PlanOutcome::Found { path, length } = planned.outcome else {
            println!("{what:24} {:?}", planned.outcome);
            continue;
        };
        println!(
            "{what:24} {length:5.2} m   {:?}, {} expansions",
            planned.origin, planned.expansions
        );
        known = path;
    }
    Ok(())
}

/// The centre of the cell that a path reaches after some metres.
fn along(path: &[Point2<f64>], metres: f64) -> Point2<f64> {
    let mut left = metres;
    for leg in path.windows(2) {
        let length = (leg[1] - leg[0]).norm();
        if left < length {
            let p = leg[0] + (leg[1] - leg[0]) * (left / length);
            return Point2::new((p.x * 10.0).floor() / 10.0 + 0.05, (p.y * 10.0).floor() / 10.0 + 0.05);
        }
        left -= length;
    }
    path.last().copied().unwrap_or_default()
}

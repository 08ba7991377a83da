//! Plans on a small map for a robot that is longer than wide, and draws the path.
//!
//! `cargo run -p zenav-planning --example plan_on_a_map [-- PLANNER]`

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use nalgebra::Point2;
use zenav_planning::{Budget, PlanOptions, Planner, Searcher, plan};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::PlanOutcome;
use zenav_protocol::robot::Footprint;
use zenav_space::{ConfigurationSpace, UnknownPolicy};

/// One character is 10 cm wide and 20 cm high: the map's rows are drawn in pairs.
const PICTURE: [&str; 16] = [
    "############################################################",
    "#                  #                                       #",
    "#                  #                                       #",
    "#                  #            #############              #",
    "#        ####      #            #           #              #",
    "#        ####      #            #           #              #",
    "#                  #                        #              #",
    "#                  #                        #              #",
    "#                                           #              #",
    "#                               #           #              #",
    "#                               #############              #",
    "#                  #                                       #",
    "#                  #                                       #",
    "#        ####      #       ####                            #",
    "#        ####      #       ####                            #",
    "############################################################",
];

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let planner: Planner = std::env::args().nth(1).as_deref().unwrap_or("astar").parse()?;
    let map = map();
    // 0.9 m by 0.4 m: it fits through the gaps lengthways, and has room to turn elsewhere.
    let corners = [(-0.45, -0.2), (0.45, -0.2), (0.45, 0.2), (-0.45, 0.2)];
    let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
    let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Blocked, 0.0);
    let mut searcher = Searcher::new(space.free())?;
    let (start, goal) = (Pose2::new(0.75, 0.9, 1.57), Pose2::new(3.95, 1.9, 0.0));
    let options = PlanOptions::new(planner);
    let planned = plan(&space, &mut searcher, start, goal, &options, Budget::UNLIMITED);
    let PlanOutcome::Found { path, length } = &planned.outcome else {
        println!("{planner}: {:?}", planned.outcome);
        return Ok(());
    };
    draw(&map, path);
    println!(
        "{planner}: {length:.2} m with {} corners, found by {:?} after {} expansions",
        path.len() - 2,
        planned.found_by,
        planned.expansions
    );
    Ok(())
}

fn map() -> OccupancyGrid {
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.1,
        width: PICTURE[0].len() as u32,
        height: 2 * PICTURE.len() as u32,
    };
    let mut map = Grid::filled(spec, Occupancy::FREE);
    for (y, row) in PICTURE.iter().rev().enumerate() {
        let walls = row.bytes().enumerate().filter(|(_, character)| *character == b'#');
        for (x, _) in walls {
            for half in 0..2 {
                map[Cell::new(x as u32, 2 * y as u32 + half)] = Occupancy::OCCUPIED;
            }
        }
    }
    map
}

/// The map, with dots along the path and letters at its corners.
fn draw(map: &OccupancyGrid, path: &[Point2<f64>]) {
    let mut picture: Vec<Vec<u8>> = PICTURE.iter().map(|row| row.bytes().collect()).collect();
    let mut put = |point: Point2<f64>, character: u8| {
        let place = map.spec().cell_at(point);
        let row = place.and_then(|cell| picture.iter_mut().rev().nth(cell.y as usize / 2));
        if let (Some(cell), Some(row)) = (place, row) {
            row[cell.x as usize] = character;
        }
    };
    for leg in path.windows(2) {
        let steps = ((leg[1] - leg[0]).norm() / 0.1).ceil() as u32;
        (0..steps).for_each(|i| put(leg[0] + (leg[1] - leg[0]) * (f64::from(i) / f64::from(steps)), b'.'));
    }
    path.iter().for_each(|corner| put(*corner, b'o'));
    if let [start, .., goal] = path {
        put(*start, b'S');
        put(*goal, b'G');
    }
    picture
        .iter()
        .for_each(|row| println!("{}", String::from_utf8_lossy(row)));
}

//! Where a robot that is longer than wide fits: a map of poses, and some exact clearances.
//!
//! `cargo run -p zenav-space --example clearance`

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
use zenav_protocol::robot::Footprint;
use zenav_space::{ConfigurationSpace, UnknownPolicy};

fn main() {
    // A room of 6 m by 3 m, walls around it, and a wall with a gap of 0.6 m.
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.1,
        width: 60,
        height: 30,
    };
    let mut map = Grid::filled(spec, Occupancy::FREE);
    for cell in (0..spec.len()).map(|index| spec.cell(index)) {
        let is_border = cell.x == 0 || cell.y == 0 || cell.x == 59 || cell.y == 29;
        if is_border || (cell.x == 30 && !(12..18).contains(&cell.y)) {
            map[cell] = Occupancy::OCCUPIED;
        }
    }
    let corners = [(-0.4, -0.2), (0.4, -0.2), (0.4, 0.2), (-0.4, 0.2)];
    let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
    let space = ConfigurationSpace::new(&map, &footprint, UnknownPolicy::Blocked, 0.0);

    // Where the footprint fits: `-` with heading 0, `|` upright, `+` with both, a blank with neither.
    for y in (0..spec.height).rev().step_by(2) {
        let character = |x| {
            let at = spec.center(Cell::new(x, y));
            let fits = |yaw| space.is_valid(Pose2::new(at.x, at.y, yaw));
            match (map[Cell::new(x, y)], fits(0.0), fits(std::f64::consts::FRAC_PI_2)) {
                (Occupancy::OCCUPIED, ..) => '#',
                (_, true, true) => '+',
                (_, true, false) => '-',
                (_, false, true) => '|',
                _ => ' ',
            }
        };
        println!("{}", (0..spec.width).map(character).collect::<String>());
    }
    let [left, right] = [Point2::new(1.5, 1.5), Point2::new(4.5, 1.5)];
    println!(
        "clearance of the centre in the gap: {:.3} m",
        space.clearance(Point2::new(3.05, 1.5))
    );
    println!(
        "clearance while it drives through:  {:.3} m",
        space.leg_clearance(left, right, 1.0)
    );
    println!(
        "may it turn in the gap?             {}",
        space.turn_is_free(Point2::new(3.05, 1.5), 0.0, 1.57)
    );
    let narrow = Point2::new(0.1, 0.1);
    if let Some(free) = space.nearest_free(narrow) {
        println!("nearest place to the corner:        ({:.2}, {:.2})", free.x, free.y);
    }
}

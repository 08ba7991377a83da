//! Smooths a path around a corner; prints the trajectory and its certificate. `cargo run -p zenav-smoothing --example around_a_corner`
#![allow(clippy::print_stdout, reason = "an example prints")]

use std::time::Instant;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
use zenav_protocol::robot::{RobotModel, shipped};
use zenav_protocol::trajectory::TrajectoryPoint;
use zenav_smoothing::{SmoothQuery, SmoothingSettings, smooth};
use zenav_space::{ConfigurationSpace, UnknownPolicy};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Two halls, 1.2 m wide, that meet at a right angle.
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution: 0.05,
        width: 100,
        height: 100,
    };
    let mut grid = Grid::filled(spec, Occupancy::OCCUPIED);
    for y in 0..spec.height {
        for x in 0..spec.width {
            let center = spec.center(Cell::new(x, y));
            let east = (0.4..1.6).contains(&center.y) && (0.2..4.2).contains(&center.x);
            let north = (3.0..4.2).contains(&center.x) && (0.4..4.8).contains(&center.y);
            if east || north {
                grid[Cell::new(x, y)] = Occupancy::FREE;
            }
        }
    }
    let model = RobotModel::from_toml(shipped("tiago").unwrap_or_default(), "tiago")?;
    let space = ConfigurationSpace::new(&grid, &model.footprint, UnknownPolicy::Blocked, 0.0);
    let path = [Point2::new(3.6, 1.0), Point2::new(3.6, 4.2)];
    let query = SmoothQuery::new(&path, Pose2::new(0.8, 1.0, 0.0));
    let begin = Instant::now();
    let mut clock = || begin.elapsed().as_secs_f64();
    let smoothed = smooth(&space, &query, &model, &SmoothingSettings::default(), None, &mut clock);

    println!("{}", TrajectoryPoint::CSV_HEADER);
    for point in smoothed.sampled(0.5).iter() {
        println!("{point}");
    }
    let found = &smoothed.statistics;
    println!("\noutcome          {}", smoothed.outcome);
    println!("length           {:.3} m in {:.3} s", found.length, found.duration);
    println!("least clearance  {:.3} m", found.min_clearance.unwrap_or(f64::INFINITY));
    println!(
        "corridor         {:.2} ms, geometry {:.2} ms, timing {:.2} ms",
        found.corridor_ms, found.geometry_ms, found.timing_ms
    );
    let certificate = &found.certificate;
    if let (Some(corridor), Some(geometry)) = (&certificate.corridor, &certificate.geometry) {
        println!(
            "free polygons    {}, at least {:.2} m wide",
            corridor.polygons, corridor.least_width
        );
        println!(
            "solver           {}, {} iterations, gap {:.1e}",
            geometry.status, geometry.iterations, geometry.gap
        );
    }
    println!(
        "time law         {}, {:.4} times the lower bound",
        certificate.time_law, certificate.over_lower_bound
    );
    println!(
        "largest use      wheel speed {:.0} %, wheel acceleration {:.0} %, lateral acceleration {:.0} %",
        100.0 * certificate.largest_use.wheel_speed,
        100.0 * certificate.largest_use.wheel_acceleration,
        100.0 * certificate.largest_use.lateral_acceleration
    );
    Ok(())
}

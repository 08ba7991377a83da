//! Builds a map from synthetic scans of a room and prints it as text.
//!
//! `cargo run -p zenav-mapping --example map_from_scans`

#![allow(clippy::print_stdout, reason = "an example prints")]

use std::f64::consts::TAU;

use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Occupancy};
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;

/// Half the width and the height of the room, m.
const ROOM: [f64; 2] = [3.05, 1.65];
/// Centre and radius of a pillar, m.
const PILLAR: [f64; 3] = [0.4, 0.3, 0.25];
const BEAMS: usize = 720;

/// Distance from a point to the walls or the pillar, along a direction.
fn range(x: f64, y: f64, angle: f64) -> f64 {
    let (dy, dx) = angle.sin_cos();
    let wall = |at: f64, along: f64, half: f64| (half * along.signum() - at) / along;
    let (to_x, to_y) = (PILLAR[0] - x, PILLAR[1] - y);
    let (nearest, aside) = (to_x * dx + to_y * dy, to_x * dy - to_y * dx);
    let half_chord = PILLAR[2] * PILLAR[2] - aside * aside;
    let pillar = if nearest > 0.0 && half_chord > 0.0 {
        nearest - half_chord.sqrt()
    } else {
        f64::INFINITY
    };
    wall(x, dx, ROOM[0]).min(wall(y, dy, ROOM[1])).min(pillar)
}

fn main() {
    let settings = MappingSettings {
        resolution: 0.1,
        ..MappingSettings::default()
    };
    let mut mapper = Mapper::new(settings, "room");
    for step in 0..40 {
        // A drive along the room, through 4 s.
        let pose = Pose2::new(-2.0 + 0.1 * f64::from(step), -0.8, 0.02 * f64::from(step));
        let angle_increment = TAU / BEAMS as f64;
        let scan = Scan {
            stamp: Stamp::from_secs(0.1 * f64::from(step)),
            angle_min: 0.0,
            angle_increment,
            range_min: 0.02,
            range_max: 5.0,
            ranges: (0..BEAMS)
                .map(|beam| range(pose.x, pose.y, pose.yaw + beam as f64 * angle_increment) as f32)
                .collect(),
            odom_from_base: pose,
            ..Scan::default()
        };
        mapper.insert(&scan);
    }
    let (info, map) = (mapper.info(), mapper.grid());
    let is_known = |x: u32, y: u32| map[Cell::new(x, y)] >= 0;
    let (columns, rows) = (0..info.spec.width, 0..info.spec.height);
    // Only the known part of the grid, which grows by whole tiles.
    let left = columns.clone().find(|x| rows.clone().any(|y| is_known(*x, y)));
    for y in rows.rev().filter(|y| columns.clone().any(|x| is_known(x, *y))) {
        let row: String = (left.unwrap_or_default()..columns.end)
            .map(|x| match Occupancy::of(map[Cell::new(x, y)]) {
                Occupancy::Occupied => '#',
                Occupancy::Free => '.',
                Occupancy::Unknown => ' ',
            })
            .collect();
        println!("{}", row.trim_end());
    }
    println!(
        "{} scans: {} cells free, {} occupied, {} unknown",
        info.scans, info.free, info.occupied, info.unknown
    );
}

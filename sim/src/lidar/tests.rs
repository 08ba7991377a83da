#![allow(clippy::unwrap_used, reason = "tests")]
use super::*;
use crate::bridge;
use crate::outline::outline;
use crate::shape::edges;
use parry2d_f64::math::Pose;
use parry2d_f64::query::Ray;
use parry2d_f64::shape::{Ball, Cuboid, Polyline, Shape};
use proptest::prelude::*;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};

fn model(beams: usize, field_of_view: f64) -> LidarModel {
    LidarModel {
        mount: Pose2::IDENTITY,
        rate_hz: 10.0,
        range_min: 0.0,
        range_max: 30.0,
        beams,
        field_of_view,
        noise: 0.0,
        bias: 0.0,
        dropout: 0.0,
        resolution: 0.001,
        sweep_time: 0.0,
        latency: 0.0,
    }
}

fn lidar() -> impl Strategy<Value = LidarModel> {
    (1..700_usize, prop_oneof![Just(TAU), 0.1..TAU]).prop_map(|(beams, view)| model(beams, view))
}

fn pose() -> impl Strategy<Value = Pose2> {
    (-5.0..5.0, -5.0..5.0, -PI..PI).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

/// A star-shaped, usually concave polygon, counter-clockwise.
fn star() -> impl Strategy<Value = Vec<Point2<f64>>> {
    (-5.0..5.0, -5.0..5.0, prop::collection::vec(0.05..1.5, 3..9)).prop_map(|(x, y, radii): (f64, f64, Vec<f64>)| {
        let step = TAU / radii.len() as f64;
        radii
            .iter()
            .enumerate()
            .map(|(i, r)| Point2::new(x + r * (i as f64 * step).cos(), y + r * (i as f64 * step).sin()))
            .collect()
    })
}

/// Checks that every beam equals the nearest of parry's ray casts against these shapes.
fn agree(
    model: &LidarModel,
    laser: Pose2,
    scene: &Scene,
    shapes: &[(Pose, Box<dyn Shape>)],
) -> Result<(), TestCaseError> {
    let mut buffer = AngularBuffer::new(model);
    buffer.begin(laser);
    buffer.scene(scene);
    for (beam, range) in buffer.ranges().enumerate() {
        let direction = laser.yaw + model.angle_min() + beam as f64 * model.angle_increment();
        let ray = Ray::new(
            bridge::vector(laser.position()),
            bridge::vector(Point2::new(direction.cos(), direction.sin())),
        );
        let cast = shapes
            .iter()
            .filter_map(|(pose, shape)| shape.cast_ray(pose, &ray, model.range_max, false))
            .fold(f64::INFINITY, f64::min);
        let range = if range <= model.range_max { range } else { f64::INFINITY };
        prop_assert!(
            range == cast || (range - cast).abs() < 1e-6,
            "beam {beam}: {range} instead of {cast}"
        );
    }
    Ok(())
}

proptest! {
    #[test]
    fn every_beam_equals_parrys_ray_cast_among_polygons_and_discs(model in lidar(), laser in pose(), stars in prop::collection::vec(star(), 0..12), discs in prop::collection::vec((-5.0..5.0, -5.0..5.0, 0.05..1.0), 0..8)) {
        let discs: Vec<Disc> = discs.into_iter().map(|(x, y, radius)| Disc { center: Point2::new(x, y), radius }).collect();
        prop_assume!(!stars.iter().any(|star| crate::shape::contains(star, laser.position())));
        prop_assume!(!discs.iter().any(|disc| (disc.center - laser.position()).norm() < disc.radius));
        let mut shapes: Vec<(Pose, Box<dyn Shape>)> = Vec::new();
        for star in &stars {
            let corners: Vec<_> = star.iter().chain(star.first()).map(|p| bridge::vector(*p)).collect();
            shapes.push((Pose::identity(), Box::new(Polyline::new(corners, None))));
        }
        for disc in &discs {
            shapes.push((Pose::new(bridge::vector(disc.center), 0.0), Box::new(Ball::new(disc.radius))));
        }
        let scene = Scene::new(stars.iter().flat_map(|star| edges(star)).collect(), discs);
        agree(&model, laser, &scene, &shapes)?;
    }

    #[test]
    fn every_beam_equals_parrys_ray_cast_among_the_cells_of_a_map(model in lidar(), laser in pose(), seed in prop::collection::vec(0..100_u8, 20 * 20)) {
        let spec = GridSpec { origin: Point2::new(-5.0, -5.0), resolution: 0.5, width: 20, height: 20 };
        let map = OccupancyGrid::from_values(spec, seed.iter().map(|value| if *value < 15 { Occupancy::OCCUPIED } else { Occupancy::FREE }).collect()).unwrap();
        prop_assume!(map.at(laser.position()) != Some(&Occupancy::OCCUPIED));
        let cells: Vec<Cell> = (0..spec.len()).map(|i| spec.cell(i)).filter(|cell| map[*cell] == Occupancy::OCCUPIED).collect();
        let shapes: Vec<(Pose, Box<dyn Shape>)> = cells.iter().map(|cell| {
            let shape: Box<dyn Shape> = Box::new(Cuboid::new(bridge::vector(Point2::new(0.25, 0.25))));
            (Pose::new(bridge::vector(spec.center(*cell)), 0.0), shape)
        }).collect();
        agree(&model, laser, &Scene::new(outline(&map), Vec::new()), &shapes)?;
    }

    #[test]
    fn the_approximate_angle_is_within_its_promise(angle in -PI..PI, length in 1e-3..1e3) {
        prop_assert!((direction(Vector2::new(angle.cos(), angle.sin()) * length) - angle).abs() < TURN_ERROR);
    }

    #[test]
    fn no_beam_slips_between_two_edges_that_share_a_corner(laser in pose(), corners in 3..40_usize, turned in 0.0..TAU) {
        // A ring around the lidar, with a corner exactly in the direction of beams wherever counts divide.
        let step = TAU / corners as f64;
        let ring: Vec<_> = (0..corners).rev().map(|i| (turned + i as f64 * step).sin_cos()).map(|(s, c)| laser.position() + Vector2::new(c, s) * 20.0).collect();
        let mut buffer = AngularBuffer::new(&model(360, TAU));
        buffer.begin(laser);
        buffer.edges(&edges(&ring).collect::<Vec<_>>());
        prop_assert!(buffer.ranges().all(|range| range < 20.1), "{:?}", buffer.ranges().collect::<Vec<_>>());
    }
}

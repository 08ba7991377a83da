//! Random rooms. Rooms for testing a wall follower, generated from a seed: four walls at odd angles, buttresses and pillars, with gaps
//! wide enough to drive through.

use std::fmt::Write as _;

use nalgebra::{Point2, Vector2};
use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_sim::World;

use super::score::distance;
use crate::failure::Failure;

/// Thickness of the walls, m.
const THICKNESS: f64 = 0.1;
/// Largest offset of the room's corners from a rectangle, m.
const ODD: f64 = 0.5;
/// Attempts at placing a piece of furniture.
const ATTEMPTS: u32 = 50;

/// A room with gaps of at least `gap` m, and a start with that much space around it.
///
/// # Errors
/// Never for a gap that fits into a room; the room's own text is parsed like that of any world.
pub fn room(seed: u64, gap: f64) -> Result<World, Failure> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let size = Vector2::new(rng.random_range(5.0..9.0) + gap, rng.random_range(4.0..7.0) + gap);
    let mut odd = |x: f64, y: f64| {
        let off = Vector2::new(rng.random_range(0.0..ODD), rng.random_range(0.0..ODD));
        // Inwards: the room never exceeds its rectangle.
        Point2::new(
            x + off.x * (1.0 - 2.0 * x / size.x),
            y + off.y * (1.0 - 2.0 * y / size.y),
        )
    };
    let corners = [odd(0.0, 0.0), odd(size.x, 0.0), odd(size.x, size.y), odd(0.0, size.y)];
    let mut text = format!(
        "name = \"room-{seed}\"\nsize = [{}, {}]\norigin = [{m}, {m}]\n",
        size.x + 2.0 * THICKNESS,
        size.y + 2.0 * THICKNESS,
        m = -THICKNESS
    );
    let sides = corners.iter().zip(corners.iter().cycle().skip(1));
    for (from, to) in sides.clone() {
        // Writing to a String cannot fail.
        let _ = writeln!(
            text,
            "[[wall]]\nfrom = [{}, {}]\nto = [{}, {}]\nthickness = {THICKNESS}",
            from.x, from.y, to.x, to.y
        );
    }
    let inside = |point: Point2<f64>| sides.clone().all(|(from, to)| (to - from).perp(&(point - from)) > 0.0);

    for (from, to) in sides.clone() {
        if !rng.random_bool(0.6) {
            continue;
        }
        let along = (to - from).normalize();
        let inwards = Vector2::new(-along.y, along.x);
        let (width, depth) = (rng.random_range(0.4..1.5), rng.random_range(0.3..1.5));
        let rest = (to - from).norm() - width - 2.0 * (gap + ODD);
        if rest <= 0.0 {
            continue;
        }
        let start = from + along * (gap + ODD + rest * rng.random::<f64>());
        let outline = [
            start,
            start + along * width,
            start + along * width + inwards * depth,
            start + inwards * depth,
        ];
        let beside = [start - along * (0.5 * gap), start + along * (width + 0.5 * gap)]
            .map(|foot| foot + inwards * (0.5 * gap + THICKNESS));
        let before = [0.0, 0.5, 1.0].map(|share| start + along * (share * width) + inwards * (depth + 0.5 * gap));
        let around: Vec<(Point2<f64>, f64)> = beside.into_iter().chain(before).map(|at| (at, 0.49 * gap)).collect();
        place(&mut text, &outline, &around, &inside)?;
    }
    for _ in 0..rng.random_range(0..3_u32) {
        let center = Point2::new(rng.random_range(0.0..size.x), rng.random_range(0.0..size.y));
        let (radius, turn) = (rng.random_range(0.2..0.5), rng.random_range(0.0..1.5));
        let outline: Vec<Point2<f64>> = (0..16)
            .map(|corner| {
                Pose2::new(
                    center.x,
                    center.y,
                    turn + std::f64::consts::TAU * f64::from(corner) / 16.0,
                )
            })
            .map(|pose| pose.position() + pose.heading() * radius)
            .collect();
        place(&mut text, &outline, &[(center, radius + gap)], &inside)?;
    }
    for _ in 0..ATTEMPTS {
        let (x, y, yaw) = (
            rng.random_range(0.0..size.x),
            rng.random_range(0.0..size.y),
            rng.random_range(-3.0..3.0),
        );
        let at = Point2::new(x, y);
        if inside(at) && distance(&read(&text)?, at) > 0.5 * gap {
            let _ = writeln!(text, "[start]\nx = {x}\ny = {y}\nyaw = {yaw}");
            break;
        }
    }
    read(&text)
}

fn read(text: &str) -> Result<World, Failure> {
    World::from_toml(text, "room", &|_| Err("a room has no map".to_owned())).map_err(Failure::failed)
}

/// Adds a solid, if all the discs `around` it are inside the room and free.
fn place(
    text: &mut String,
    outline: &[Point2<f64>],
    around: &[(Point2<f64>, f64)],
    inside: &impl Fn(Point2<f64>) -> bool,
) -> Result<(), Failure> {
    let world = read(text)?;
    if around
        .iter()
        .all(|(at, radius)| inside(*at) && distance(&world, *at) >= *radius)
    {
        let points: Vec<[f64; 2]> = outline.iter().map(|point| [point.x, point.y]).collect();
        let _ = writeln!(text, "[[polygon]]\npoints = {points:?}");
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files;
    use crate::wall_following::lockstep;

    #[test]
    fn a_seed_gives_the_same_room_again_and_another_seed_another() {
        let outlines = |seed| room(seed, 1.2).unwrap().polygons().to_vec();
        assert_eq!(outlines(5), outlines(5));
        assert_ne!(outlines(5), outlines(6));
    }

    #[test]
    fn a_neato_finds_its_way_along_the_walls_of_any_room_and_touches_nothing() {
        let model = files::robot("neato").unwrap();
        for seed in 0..4 {
            let run = lockstep::run(&room(seed, 1.2).unwrap(), &model, seed, 60.0).unwrap();
            assert_eq!(run.truth.collisions, 0, "room {seed}");
            assert!(run.following > 0.6 && run.truth.length > 8.0, "room {seed}: {run:?}");
        }
    }
}

//! `zenav sim show`: a picture of a world: solids, movers with their paths, places, and what the robots see.

use std::path::PathBuf;

use nalgebra::{Point2, Vector2};
use serde::Serialize;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::id::Id;
use zenav_protocol::robot::{Footprint, LidarModel};
use zenav_sim::movers::{MoverModel, Route};
use zenav_sim::scatter::scatter;
use zenav_sim::{RobotSpec, Simulation, World};

use crate::arguments;
use crate::completion;
use crate::drawing::canvas::{Canvas, Color};
use crate::drawing::plane::{FREE, Mark, OCCUPIED, PLACE, Plane, ROBOT, outline};
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format, counted};

const OUTSIDE: Color = [236, 238, 241];
const GRID: Color = [228, 231, 235];
const MOVER: Color = [240, 150, 0];
const PATH: Color = [250, 214, 150];
const SEEN: Color = [215, 60, 40];

/// Margin around the world's bounds, as a share of its longer side.
const MARGIN: f64 = 0.03;
/// Spacing of grid lines, m.
const METRE: f64 = 1.0;
/// With more lines than this, the grid is left out: it would hide the world.
const MOST_LINES: f64 = 100.0;

/// Draw a world.
#[derive(Debug, clap::Args)]
pub(super) struct ShowArgs {
    /// World: a file, a ROS map (`.yaml`) or a shipped name
    #[arg(value_name = "WORLD", add = completion::worlds())]
    world: String,
    /// Picture to write [default: the world's name, `.png`]
    #[arg(long, visible_alias = "png", short = 'f', value_name = "FILE")]
    out: Option<PathBuf>,
    /// Robot: a file or shipped name
    #[arg(long, value_name = "R", default_value = "tiago", add = completion::models())]
    robot: String,
    /// Number of robots: the first at the world's start, the others at random free places
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = arguments::whole::<usize>)]
    robots: usize,
    /// Simulated time at which movers and doors are shown, s
    #[arg(long, value_name = "SECS", default_value_t = 0.0, value_parser = arguments::finite)]
    time: f64,
    /// Seed of walkers and of the other robots' poses
    #[arg(long, default_value_t = 1, value_parser = arguments::whole::<u64>)]
    seed: u64,
    /// Length of the picture's longer side, px
    #[arg(long, value_name = "PX", default_value_t = 1200, value_parser = arguments::whole_in(64..=8192_u32))]
    size: u32,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Summary of what was drawn.
#[derive(Debug, Serialize)]
struct Shown {
    world: String,
    picture: PathBuf,
    low: [f64; 2],
    high: [f64; 2],
    polygons: usize,
    discs: usize,
    map_cells: usize,
    movers: usize,
    places: Vec<String>,
    robots: Vec<Pose2>,
    time_s: f64,
}

/// Draws a world.
///
/// # Errors
/// [`crate::exit_code::USAGE`] for an invalid world, robot or time; a file that cannot be written.
pub(super) fn show(args: &ShowArgs) -> Outcome {
    if !(0.0..=86_400.0).contains(&args.time) {
        return Err(Failure::usage(format!("--time {}: expected 0 to 86400 s", args.time)));
    }
    let world = files::world(&args.world)?;
    let simulation = simulation(args, &world)?;
    let bytes = draw(&world, &simulation, args.size)?.png()?;
    let name: String = world
        .name()
        .chars()
        .map(|c| if c.is_alphanumeric() { c } else { '_' })
        .collect();
    let picture = args.out.clone().unwrap_or_else(|| PathBuf::from(format!("{name}.png")));
    if files::ending(&picture) != "png" {
        return Err(files::unknown_ending(&picture, ".png"));
    }
    files::write(&picture, bytes)?;
    let (low, high) = world.bounds();
    let shown = Shown {
        world: world.name().to_owned(),
        picture,
        low: low.into(),
        high: high.into(),
        polygons: world.polygons().len(),
        discs: world.discs().len(),
        map_cells: world.map().map_or(0, |map| map.values().len()),
        movers: world.movers().len(),
        places: world.places().iter().map(|place| place.name.to_string()).collect(),
        robots: (0..simulation.robots())
            .map(|robot| simulation.truth(robot).map_from_base)
            .collect(),
        time_s: simulation.now().as_secs(),
    };
    output::value(args.output, &shown, |shown| {
        let Shown { low, high, .. } = shown;
        format!(
            "{}: {:.2} x {:.2} m from ({:.2}, {:.2}); {}, {}, {} of a map, {}, {}, {}, at {:.1} s\n{}",
            shown.world,
            high[0] - low[0],
            high[1] - low[1],
            low[0],
            low[1],
            counted(shown.polygons, "polygon"),
            counted(shown.discs, "disc"),
            counted(shown.map_cells, "cell"),
            counted(shown.movers, "mover"),
            counted(shown.robots.len(), "robot"),
            counted(shown.places.len(), "place"),
            shown.time_s,
            shown.picture.display()
        )
    })
}

/// The world with its robots, at the requested time.
fn simulation(args: &ShowArgs, world: &World) -> Result<Simulation, Failure> {
    let model = files::robot(&args.robot)?;
    // The six extra candidates replace those too close to the start.
    let others = scatter(world, &model, args.robots.saturating_add(6), 0.1, args.seed);
    let apart = |pose: &Pose2| pose.distance(&world.start()) > 2.0 * model.footprint.circumscribed_radius();
    let others = others.into_iter().filter(apart);
    let starts = [world.start()].into_iter().chain(others).take(args.robots);
    let specs = starts
        .enumerate()
        .map(|(index, start)| {
            let id = Id::robot(format!("robot_{index}")).map_err(Failure::failed)?;
            let model = model.clone();
            Ok(RobotSpec { id, model, start })
        })
        .collect::<Result<Vec<_>, Failure>>()?;
    let mut simulation = match Simulation::new(world, specs, args.seed) {
        Ok(simulation) => simulation,
        Err(error) => {
            // A picture is most useful when something is wrong with the start.
            tracing::warn!("drawn without robots: {error}");
            Simulation::new(world, Vec::new(), args.seed).map_err(Failure::usage)?
        }
    };
    if (1..args.robots).contains(&simulation.robots()) {
        let (room, name) = (simulation.robots(), world.name());
        tracing::warn!("there is room for {room} of {} robots in {name}", args.robots);
    }
    while simulation.now().as_secs() < args.time {
        simulation.step();
    }
    Ok(simulation)
}

fn draw(world: &World, simulation: &Simulation, size: u32) -> Result<Canvas, Failure> {
    let mut plane = backdrop(world, size)?;
    for (mover, at) in world.movers().iter().zip(simulation.movers()) {
        plane.polygon(&placed(&mover.shape, at), MOVER);
    }
    for robot in 0..simulation.robots() {
        self::robot(&mut plane, simulation, robot);
    }
    if simulation.robots() > 0 {
        plane.legend(Mark::Area, ROBOT, "robot");
        plane.legend(Mark::Dot, SEEN, "laser scan");
    }
    plane.note(&format!("at {:.1} s", simulation.now().as_secs()));
    plane.finish()
}

/// The static parts of a world, and the paths of its movers, `size` pixels on the longer side.
///
/// # Errors
/// A world without extent.
pub(crate) fn backdrop(world: &World, size: u32) -> Result<Plane, Failure> {
    let (low, high) = world.bounds();
    let margin = Vector2::repeat(MARGIN * (high - low).amax());
    let mut plane = Plane::new(low - margin, high + margin, size, world.name(), OUTSIDE)?;
    let corners = [low, Point2::new(high.x, low.y), high, Point2::new(low.x, high.y)];
    plane.polygon(&corners, FREE);
    if let Some(map) = world.map() {
        plane.map(map);
    }
    if (high - low).amax() < MOST_LINES * METRE {
        grid(&mut plane, low, high);
        plane.note("grid of 1 m");
    }
    for mover in world.movers() {
        path(&mut plane, mover);
    }
    for polygon in world.polygons() {
        plane.polygon(polygon, OCCUPIED);
    }
    for disc in world.discs() {
        plane.disc(disc.center, disc.radius, OCCUPIED);
    }
    plane.gap();
    plane.legend(Mark::Area, OCCUPIED, "solid");
    if !world.movers().is_empty() {
        plane.legend(Mark::Area, MOVER, "moves, or a door");
        plane.legend(Mark::Line, PATH, "its path");
    }
    for place in world.places() {
        let at = Point2::new(place.x, place.y);
        plane.place(place.name.as_ref(), at);
        if let Some(yaw) = place.yaw {
            let front = at + Pose2::new(0.0, 0.0, yaw).heading() * 0.3;
            plane.polyline(&[at, front], PLACE, 2.0);
        }
    }
    if !world.places().is_empty() {
        plane.legend(Mark::Dot, PLACE, "named place");
    }
    Ok(plane)
}

fn grid(plane: &mut Plane, low: Point2<f64>, high: Point2<f64>) {
    let lines = |from: f64, to: f64| {
        let first = (from / METRE).ceil() as i64;
        (first..=(to / METRE).floor() as i64).map(|line| line as f64 * METRE)
    };
    for x in lines(low.x, high.x) {
        plane.polyline(&[Point2::new(x, low.y), Point2::new(x, high.y)], GRID, 1.0);
    }
    for y in lines(low.y, high.y) {
        plane.polyline(&[Point2::new(low.x, y), Point2::new(high.x, y)], GRID, 1.0);
    }
}

/// The outline of a shape at a place.
fn placed(shape: &Footprint, at: Point2<f64>) -> Vec<Point2<f64>> {
    outline(shape).into_iter().map(|corner| at + corner.coords).collect()
}

/// The path of a mover: its corners with its outline there, or the box that it walks in; for a door, its closed and open positions.
fn path(plane: &mut Plane, mover: &MoverModel) {
    match &mover.route {
        Route::Path(corners) => {
            let points: Vec<Point2<f64>> = corners.iter().map(|(at, _)| *at).collect();
            plane.outline(&points, PATH, 2.0);
            for at in points {
                plane.outline(&placed(&mover.shape, at), PATH, 1.0);
            }
        }
        Route::Walk { low, high, .. } => {
            let corners = [*low, Point2::new(high.x, low.y), *high, Point2::new(low.x, high.y)];
            plane.outline(&corners, PATH, 2.0);
        }
    }
}

/// A robot, and the returns of its lidar.
fn robot(plane: &mut Plane, simulation: &Simulation, robot: usize) {
    let model = simulation.model(robot);
    let pose = simulation.truth(robot).map_from_base;
    plane.robot(pose, &model.footprint);
    for sweep in simulation.readings(robot).sweeps {
        let Some((_, lidar)) = model.all_lidars().find(|(name, _)| *name == sweep.lidar) else {
            continue;
        };
        for (beam, range) in sweep.ranges.iter().enumerate() {
            if let Some(hit) = hit(lidar, pose * lidar.mount, beam, f64::from(*range)) {
                plane.dot(hit, SEEN, 1.5);
            }
        }
    }
}

fn hit(lidar: &LidarModel, laser: Pose2, beam: usize, range: f64) -> Option<Point2<f64>> {
    let angle = lidar.angle_min() + beam as f64 * lidar.angle_increment();
    let there = || laser.transform_point(Point2::new(range * angle.cos(), range * angle.sin()));
    (range >= lidar.range_min && range <= lidar.range_max).then(there)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn gray(world: &World, at: &[(f64, f64)]) -> Vec<u8> {
        let simulation = Simulation::new(world, Vec::new(), 1).unwrap();
        let picture = draw(world, &simulation, 200).unwrap();
        let pixels = picture.rgb();
        let (low, high) = world.bounds();
        let margin = MARGIN * (high - low).amax();
        let scale = 200.0 / ((high - low).amax() + 2.0 * margin);
        at.iter()
            .map(|(x, y)| {
                let column = ((x - low.x + margin) * scale) as u32;
                let row = ((high.y + margin - y) * scale) as u32;
                let pixel = &pixels[(row * picture.width() + column) as usize * 3..][..3];
                (pixel.iter().map(|part| u32::from(*part)).sum::<u32>() / 3) as u8
            })
            .collect()
    }

    #[test]
    fn what_is_solid_is_dark_and_a_shut_door_is_drawn_where_it_is() {
        let text = "size = [10, 5]\norigin = [-2, 0]\n[[polygon]]\npoints = [[0, 0], [2, 0], [2, 2], [0, 2]]\n\
                    [[circle]]\nx = 5\ny = 3\nradius = 0.5\n\
                    [[door]]\nfrom = [6, 1]\nto = [7, 1]\nthickness = 0.4\nclosed_secs = 5\nopen_secs = 5\n";
        let world = World::from_toml(text, "w.toml", &|_| Err(String::new())).unwrap();
        let shades = gray(&world, &[(1.0, 1.0), (5.0, 3.0), (6.5, 1.0), (3.4, 3.6)]);
        assert!(shades[0] < 60 && shades[1] < 60, "{shades:?}");
        assert!((100..220).contains(&shades[2]) && shades[3] == 255, "{shades:?}");
    }

    #[test]
    fn every_shipped_world_can_be_drawn() {
        for (name, _) in zenav_sim::world::SHIPPED {
            let world = World::shipped(name).unwrap();
            let simulation = Simulation::new(&world, Vec::new(), 1).unwrap();
            assert!(draw(&world, &simulation, 100).is_ok(), "{name}");
        }
    }
}

//! BARN. The worlds in a folder of the Benchmark for Autonomous Robot Navigation (Perille, Truong, Xiao and Stone, "Benchmarking Metric
//! Ground Navigation", 2020). The data are not shipped with zenav: Gazebo's `world_N.world`, or the same as world files.
//!
//! The challenge's rules: a Jackal starts at (-2.25, 3), 10 m before its goal, and has 100 s to come within a metre of it. A run without
//! contact scores `OT / clip(AT, 2 OT, 8 OT)`: OT is the time of the optimal path at top speed, AT the actual time.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::ops::Range;
use std::path::Path;

use roxmltree::{Document, Node};
use zenav_protocol::geometry::Pose2;
use zenav_sim::World;

use super::Case;
use crate::failure::Failure;
use crate::files;

/// Start of the challenge's robot (x, y, yaw), distance of its goal ahead, m, tolerance, m, and time limit, s.
const START: [f64; 3] = [-2.25, 3.0, 1.57];
const AHEAD: f64 = 10.0;
const TOLERANCE: f64 = 1.0;
const TIMEOUT: f64 = 100.0;
/// Origin and size of a world in Gazebo's form, m.
const BOUNDS: [[f64; 2]; 2] = [[-6.75, -1.0], [9.0, 16.0]];

/// S1: the worlds of a folder, with this noise of the ranges (standard deviation, m). The file `optimal.csv` beside them (world, metres)
/// gives the lengths of the optimal paths; without it, the shortest path of the robot's inscribed disc counts.
pub(super) fn barn(folder: &Path, noise: f64, robots: &[String], seeds: Range<u64>) -> Result<Vec<Case>, Failure> {
    let mut worlds = BTreeMap::new();
    for entry in std::fs::read_dir(folder).map_err(Failure::failed_at(folder))? {
        let path = entry.map_err(Failure::failed_at(folder))?.path();
        let stem = path.file_stem().and_then(|stem| stem.to_str()).unwrap_or_default();
        let is_world = path
            .extension()
            .is_some_and(|ending| ending == "world" || ending == "toml");
        let number = stem
            .strip_prefix("world_")
            .and_then(|number| number.parse::<u32>().ok());
        if let Some(number) = number.filter(|_| is_world) {
            worlds.insert(number, path);
        }
    }
    if worlds.is_empty() {
        let folder = folder.display();
        return Err(Failure::not_found(format!(
            "--worlds {folder}: expected files `world_N.world` of BARN, or `world_N.toml`"
        )));
    }
    let optimal = optimal(&folder.join("optimal.csv"))?;
    let mut cases = Vec::new();
    for robot in robots {
        let own = files::robot(robot)?.first_lidar().map_or(0.0, |lidar| lidar.noise);
        let added = (noise * noise - own * own).max(0.0).sqrt();
        let scenario = format!("S1 BARN, noise {} cm", (1000.0 * noise.max(own)).round() / 10.0);
        for (number, path) in &worlds {
            let (text, world) = read(*number, path, added)?;
            let goal = world.start() * Pose2::new(AHEAD, 0.0, 0.0);
            for seed in seeds.clone() {
                let name = Case::name(&format!("S1 barn {number:03}"), robot, seed);
                let (text, world) = (text.clone(), world.clone());
                let mut case = Case::within(&scenario, name, robot, seed, text, world, goal.position())?;
                (case.tolerance, case.timeout) = (Some(TOLERANCE), TIMEOUT);
                case.is_scored = true;
                case.optimal = optimal.get(number).copied();
                cases.push(case);
            }
        }
    }
    Ok(cases)
}

/// The text of a world file with added noise of the ranges (standard deviation, m), and the world.
fn read(number: u32, path: &Path, added: f64) -> Result<(String, World), Failure> {
    let file = path.display().to_string();
    let mut text = files::text(path)?;
    if path.extension().is_some_and(|ending| ending == "world") {
        text = from_gazebo(number, &text).map_err(|problem| Failure::usage(format!("{file}: {problem}")))?;
    }
    if added > 0.0 {
        let _ = write!(
            text,
            "\n[[fault]]\nsensor = \"lidar\"\nkind = \"noisy\"\namount = {added}\n"
        );
    }
    let world = World::from_toml(&text, &file, &|_| Err("a world of BARN has no map".to_owned()));
    world
        .map(|world| (text, world))
        .map_err(|error| Failure::usage(error.to_string()))
}

/// Score of a run without contact, from the times of the optimal path and of the run, s.
pub(in crate::bench) fn score(optimal_s: f64, taken_s: f64) -> f64 {
    optimal_s / taken_s.clamp(2.0 * optimal_s, 8.0 * optimal_s)
}

/// Lengths of optimal paths by world, m.
fn optimal(file: &Path) -> Result<BTreeMap<u32, f64>, Failure> {
    if !file.exists() {
        return Ok(BTreeMap::new());
    }
    let text = files::text(file)?;
    let row = |(index, line): (usize, &str)| {
        let read = line
            .split_once(',')
            .and_then(|(world, metres)| Some((world.trim().parse().ok()?, metres.trim().parse::<f64>().ok()?)));
        read.filter(|(_, metres)| metres.is_finite() && *metres > 0.0)
            .ok_or_else(|| {
                let file = file.display();
                Failure::usage(format!(
                    "{file}:{}: expected a world's number and its optimal length in metres",
                    index + 1
                ))
            })
    };
    let lines = text
        .lines()
        .enumerate()
        .skip(1)
        .filter(|(_, line)| !line.trim().is_empty());
    lines.map(row).collect()
}

/// A world in Gazebo's format (SDF) as a world file: cylinders and boxes of its models, from above.
fn from_gazebo(number: u32, text: &str) -> Result<String, String> {
    let document = Document::parse(text).map_err(|error| error.to_string())?;
    let world = document
        .descendants()
        .find(|node| node.has_tag_name("world"))
        .ok_or("expected an element `world`")?;
    let [[left, below], size] = BOUNDS;
    let [x, y, yaw] = START;
    let mut things = format!(
        "name = \"barn_{number:03}\"\nsize = {size:?}\norigin = [{left:?}, {below:?}]\n[start]\nx = {x}\ny = {y}\nyaw = {yaw}\n"
    );
    for model in children(world, "model") {
        for link in children(model, "link") {
            for collision in children(link, "collision") {
                let at = pose(model)? * pose(link)? * pose(collision)?;
                let shape = |name| collision.descendants().find(move |node| node.has_tag_name(name));
                let wrong = |what| {
                    format!(
                        "model `{}`: expected {what}",
                        model.attribute("name").unwrap_or_default()
                    )
                };
                if let Some(cylinder) = shape("cylinder") {
                    let radius = numbers(children(cylinder, "radius").next());
                    let radius = radius
                        .and_then(|all| all.first().copied())
                        .ok_or_else(|| wrong("a radius"))?;
                    let _ = writeln!(things, "[[circle]]\nx = {}\ny = {}\nradius = {radius}", at.x, at.y);
                } else if let Some(sides) = shape("box").map(|cuboid| numbers(children(cuboid, "size").next())) {
                    let Some([w, h, ..]) = sides.as_deref() else {
                        return Err(wrong("three numbers as the size of a box"));
                    };
                    let corners = [[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]].map(|[right, up]| {
                        let corner = at * Pose2::new(right * w, up * h, 0.0);
                        [corner.x, corner.y]
                    });
                    let _ = writeln!(things, "[[polygon]]\npoints = {corners:?}");
                }
            }
        }
    }
    Ok(things)
}

fn children<'a>(node: Node<'a, 'a>, name: &'a str) -> impl Iterator<Item = Node<'a, 'a>> {
    node.children().filter(move |child| child.has_tag_name(name))
}

/// The numbers in an element's text; `None` without an element, or if one is not a number.
fn numbers(node: Option<Node<'_, '_>>) -> Option<Vec<f64>> {
    let words = node?.text().unwrap_or_default().split_whitespace();
    words.map(|word| word.parse().ok()).collect()
}

/// An element's `pose` from above: x, y and yaw of its six numbers.
fn pose(node: Node<'_, '_>) -> Result<Pose2, String> {
    let Some(pose) = children(node, "pose").next() else {
        return Ok(Pose2::IDENTITY);
    };
    match numbers(Some(pose)).as_deref() {
        Some([x, y, _, _, _, yaw]) => Ok(Pose2::new(*x, *y, *yaw)),
        _ => Err(format!(
            "a `pose` of `{}`: expected six numbers",
            node.attribute("name").unwrap_or_default()
        )),
    }
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used, reason = "tests")]
    use super::*;

    const GAZEBO: &str = "<?xml version='1.0'?><sdf version='1.6'><world name='default'>
        <model name='ground_plane'><link name='link'><collision name='c'><geometry><plane><size>100 100</size></plane></geometry></collision></link></model>
        <model name='unit_cylinder_0'><pose frame=''>-0.5 7 0.5 0 -0 0</pose><link name='link'><collision name='c'><geometry>
            <cylinder><radius>0.075</radius><length>1</length></cylinder></geometry></collision></link></model>
        <model name='box'><pose>1 2 0 0 0 1.5707963</pose><link name='link'><pose>1 0 0 0 0 0</pose><collision name='c'><geometry>
            <box><size>2 1 1</size></box></geometry></collision></link></model>
        <state world_name='default'><model name='unit_cylinder_0'><pose>9 9 0 0 0 0</pose></model></state></world></sdf>";

    #[test]
    fn a_folder_of_barn_is_driven_from_its_start_to_ten_metres_ahead() {
        let folder = tempfile::tempdir().unwrap();
        let write = |name: &str, text: &str| std::fs::write(folder.path().join(name), text).unwrap();
        let robots = ["jackal".to_owned()];
        assert!(barn(folder.path(), 0.01, &robots, 0..1).is_err());
        write("world_7.world", GAZEBO);
        write("optimal.csv", "world,optimal_length_m\n7,12.5\n");
        let cases = barn(folder.path(), 0.03, &robots, 0..1).unwrap();
        let case = cases.first().unwrap();
        assert_eq!(
            (cases.len(), case.optimal, case.world.faults().len()),
            (1, Some(12.5), 1)
        );
        assert_eq!((case.world.discs().len(), case.world.polygons().len()), (1, 1));
        assert!((case.goal - nalgebra::Point2::new(-2.25, 13.0)).norm() < 0.01);
        // Turned by a quarter, a metre along its own x: two high, one wide, around (1, 3).
        assert!(
            case.world.is_solid(nalgebra::Point2::new(1.4, 3.9))
                && !case.world.is_solid(nalgebra::Point2::new(1.6, 3.0))
        );
        write(
            "world_8.world",
            "<sdf><world><model name='m'><pose>1 2</pose><link><collision/></link></model></world></sdf>",
        );
        let error = barn(folder.path(), 0.01, &robots, 0..1).err().unwrap().to_string();
        assert!(
            error.contains("world_8.world") && error.contains("six numbers"),
            "{error}"
        );
    }

    #[test]
    fn half_a_point_is_the_most_and_an_eighth_the_least() {
        assert_eq!(
            (score(5.0, 6.0), score(5.0, 20.0), score(5.0, 99.0)),
            (0.5, 0.25, 0.125)
        );
    }
}

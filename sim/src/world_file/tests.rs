#![allow(clippy::unwrap_used, reason = "tests")]
use super::*;
use crate::shape;
use crate::world::World;
use proptest::prelude::*;
use zenav_protocol::grid::{GridSpec, Occupancy};

const HEAD: &str = "name = \"w\"\nsize = [5, 6.0]\norigin = [-1.0, 0]\n";

fn error(body: &str) -> String {
    World::from_toml(&format!("{HEAD}{body}"), "w.toml", &|path| {
        Err(format!("no file {path}"))
    })
    .err()
    .unwrap()
    .to_string()
}

#[test]
fn everything_a_world_may_hold_is_read() {
    let text = format!(
        "{HEAD}[start]\nx = 1\ny = 2\n[[polygon]]\npoints = [[0,0],[0,1],[1,0]]\n[[circle]]\nx = 3\ny = 3\nradius = 0.5\n[[wall]]\nfrom = [0,5]\nto = [4,5]\nthickness = 0.1\n\
         [[mover]]\nradius = 0.25\npath = [[0,3],[1,3]]\nspeed = 0.5\n[[mover]]\npolygon = [[0,0],[0.3,0],[0,0.3]]\npath = [[0,3]]\nspeed = 0\n\
         [[mover]]\nradius = 0.2\nwalk = [[0,0],[1,1]]\nspeed = 1\n[[door]]\nfrom = [0,4]\nto = [1,4]\nthickness = 0.05\nclosed_secs = 5\nopen_secs = 3\n[[place]]\nname = \"sink\"\nx = 0.88\ny = 0.09\nyaw = 1\n"
    );
    let world = World::from_toml(&text, "w.toml", &|_| Err(String::new())).unwrap();
    assert_eq!(world.bounds(), (Point2::new(-1.0, 0.0), Point2::new(4.0, 6.0)));
    assert_eq!(
        (world.polygons().len(), world.discs().len(), world.movers().len()),
        (2, 1, 4)
    );
    assert!(
        world
            .polygons()
            .iter()
            .all(|polygon| shape::doubled_area(polygon) > 0.0)
    );
    assert_eq!(world.place("sink").unwrap().yaw, Some(1.0));
}

#[test]
fn a_start_outside_of_the_world_is_told_its_bounds_without_rounding_errors() {
    let text = "size = [0.8, 1.0]\norigin = [-0.7, 0.0]\n[start]\nx = 5\ny = 0.5\n";
    let refused = World::from_toml(text, "w.toml", &|_| Err(String::new())).err().unwrap();
    let told = "w.toml:3: `start`: (5, 0.5) lies outside of the world: expected -0.7 to 0.1 by 0 to 1";
    assert_eq!(refused.to_string(), told);
}

#[test]
fn a_wrong_key_or_value_is_named_with_file_line_and_key() {
    for (body, expected) in [
        ("colour = 1\n", ["w.toml:4:", "colour"]),
        ("[start]\nx = 1\ny = 2\nz = 3\n", ["w.toml:7:", "`z`"]),
        (
            "[[circle]]\nx = 1\ny = 2\nradius = -1\n",
            ["w.toml:7:", "circle.radius"],
        ),
        ("[[circle]]\nx = nan\ny = 2\nradius = 1\n", ["w.toml:4:", "circle"]),
        ("[[polygon]]\npoints = [[0,0],[1,1]]\n", ["w.toml:5:", "polygon.points"]),
        (
            "[[polygon]]\npoints = [[0,0],[1,1],[1,0],[0,1]]\n",
            ["w.toml:5:", "meets itself"],
        ),
        (
            "[[polygon]]\npoints = [[0,0],[1,0],[2,0]]\n",
            ["w.toml:5:", "polygon.points"],
        ),
        (
            "[[polygon]]\npoints = [[0,0],[1,0],[1,0],[0,1]]\n",
            ["w.toml:5:", "twice in a row"],
        ),
        (
            "[[wall]]\nfrom = [0,0]\nto = [0,0]\nthickness = 1\n",
            ["w.toml:6:", "wall.to"],
        ),
        (
            "[[mover]]\npath = [[0,0]]\nspeed = 1\n",
            ["w.toml:4:", "either `radius` or `polygon`"],
        ),
        (
            "[[mover]]\nradius = 1\nspeed = 1\n",
            ["w.toml:4:", "either `path` or `walk`"],
        ),
        (
            "[[mover]]\nradius = 1\nspeed = 1\nwalk = [[1, 0], [0, 1]]\n",
            ["w.toml:7:", "mover.walk"],
        ),
        (
            "[[mover]]\nradius = 1\nspeed = 1\npath = [[1, 0], [0, 1]]\nrest_secs = [1]\n",
            ["w.toml:8:", "mover.rest_secs"],
        ),
        (
            "[[door]]\nfrom = [0, 0]\nto = [1, 0]\nthickness = 0.1\nclosed_secs = -1\nopen_secs = 1\n",
            ["w.toml:8:", "door.closed_secs"],
        ),
        (
            "[[door]]\nfrom = [0, 0]\nto = [0, 0]\nthickness = 0.1\nclosed_secs = 1\nopen_secs = 1\n",
            ["w.toml:6:", "door.to"],
        ),
        (
            "[[mover]]\nradius = 1\npath = []\nspeed = 1\n",
            ["w.toml:6:", "mover.path"],
        ),
        (
            "[[mover]]\nradius = 1\npath = [[0,0]]\nspeed = inf\n",
            ["w.toml:7:", "mover.speed"],
        ),
        ("[[place]]\nname = \"a/b\"\nx = 0\ny = 0\n", ["w.toml:5:", "place.name"]),
        (
            "[[place]]\nname = \"a\"\nx = 0\ny = 0\n[[place]]\nname = \"a\"\nx = 0\ny = 0\n",
            ["w.toml:9:", "taken"],
        ),
        ("[map]\nyaml = \"m.yaml\"\n", ["w.toml:5:", "m.yaml: no file m.yaml"]),
        ("size = 3\n", ["w.toml:4:", "size"]),
        (
            "[[mover]]\nradius = 1\nspeed = 1\nwalk = [[0, 0], [1, 1]]\nrest_secs = [3]\n",
            ["w.toml:8:", "mover.rest_secs"],
        ),
        (
            "[[mover]]\nradius = 1\nspeed = 1\nwalk = [[0, 0], [1, 1], [2, 2]]\n",
            ["w.toml:7:", "mover.walk"],
        ),
        ("[start]\nx = 9\ny = 0\n", ["w.toml:4:", "expected -1 to 4 by 0 to 6"]),
        (
            "[start]\nx = 1\ny = 2\nyaw = 90\n",
            ["start.yaw", "expected radians within a full turn"],
        ),
        (
            "[[place]]\nname = \"sink\"\nx = 1\ny = 2\nyaw = -180\n",
            ["place.yaw", "90 degrees are 1.571"],
        ),
        ("[[circle]]\nx = 1\ny = 1e300\nradius = 1\n", ["w.toml:4:", "1e300"]),
    ] {
        let error = error(body);
        assert!(expected.iter().all(|part| error.contains(part)), "{body}: {error}");
    }
    // A third coordinate would not be what the writer meant.
    for (body, line) in [
        ("[[wall]]\nfrom = [0,0,1]\nto = [1,0]\nthickness = 1\n", "w.toml:5:"),
        ("[[wall]]\nfrom = [0,0]\nto = [1,0,4]\nthickness = 1\n", "w.toml:6:"),
        ("[[polygon]]\npoints = [[0,0],\n[0,1,5],\n[1,0]]\n", "w.toml:5:"),
        ("[[mover]]\nradius = 1\nspeed = 1\npath = [[0,0,0]]\n", "w.toml:7:"),
    ] {
        let error = error(body);
        assert!(
            error.contains(line) && error.contains("expected 2 numbers, found 3"),
            "{body}: {error}"
        );
    }
    for text in ["size = [5, 5, 9]\n", "size = [5, 5]\norigin = [0]\n"] {
        let error = World::from_toml(text, "w.toml", &|_| Err(String::new()))
            .err()
            .unwrap()
            .to_string();
        assert!(error.contains("expected 2"), "{text}: {error}");
    }
    let bare = World::from_toml("", "w.toml", &|_| Err(String::new()))
        .err()
        .unwrap()
        .to_string();
    assert!(bare.contains("`size`"), "{bare}");
}

#[test]
fn a_map_world_takes_its_bounds_from_the_map() {
    let spec = GridSpec {
        origin: Point2::new(-3.0, 1.0),
        resolution: 0.5,
        width: 4,
        height: 6,
    };
    let world = World::from_toml("[map]\nyaml = \"m.yaml\"\n", "dir/block.toml", &|path| {
        assert_eq!(path, "m.yaml");
        Ok(OccupancyGrid::filled(spec, Occupancy::OCCUPIED))
    });
    let world = world.unwrap();
    assert_eq!(world.name(), "block");
    assert_eq!(world.bounds(), (Point2::new(-3.0, 1.0), Point2::new(-1.0, 4.0)));
    assert!(world.is_solid(Point2::new(-2.0, 2.0)));
}

proptest! {
    #[test]
    fn no_text_panics_the_reader(body in "[a-z\\[\\]= 0-9.,\"\n]{0,120}") {
        let _ = World::from_toml(&format!("{HEAD}{body}"), "w.toml", &|_| Err(String::new()));
    }

    #[test]
    fn no_polygon_panics_the_reader(points in prop::collection::vec((-1.0..1.0, -1.0..1.0), 0..8)) {
        let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
        let _ = World::from_toml(&format!("{HEAD}[[polygon]]\npoints = {points:?}\n"), "w.toml", &|_| Err(String::new()));
    }
}

#[test]
fn a_place_or_start_where_nobody_can_stand_is_told_of() {
    let text = format!(
        "{HEAD}[start]\nx = 0\ny = 1\n[[circle]]\nx = 3\ny = 3\nradius = 0.5\n\
         [[place]]\nname = \"table\"\nx = 3.1\ny = 3\n[[place]]\nname = \"moon\"\nx = 3\ny = 99\n[[place]]\nname = \"sink\"\nx = 1\ny = 1\n"
    );
    let doubts = World::from_toml(&text, "w.toml", &|_| Err(String::new()))
        .unwrap()
        .doubts();
    assert!(
        matches!(&doubts[..], [table, moon] if table.contains("`table` at (3.1, 3)") && table.contains("solid")
            && moon.contains("`moon`") && moon.contains("outside")),
        "{doubts:?}"
    );
    let inside = text.replace("x = 0\ny = 1", "x = 3\ny = 3");
    let doubts = World::from_toml(&inside, "w.toml", &|_| Err(String::new()))
        .unwrap()
        .doubts();
    assert!(doubts.len() == 3 && doubts[0].contains("start"), "{doubts:?}");
}

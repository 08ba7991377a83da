//! Map files. The same bytes as an image, as a description with its image, and as a Moving AI map or its scenarios.

#![allow(
    clippy::expect_used,
    reason = "a map that was read and cannot be written is a finding"
)]

use nalgebra::Point2;
use zenav_fixtures::drawn_map;
use zenav_mapping::map_image::{MapMode, MapYaml, decode, to_grid, to_pgm, to_png, to_yaml};
use zenav_mapping::{parse_moving_ai_map, parse_moving_ai_scenarios};
use zenav_protocol::grid::OccupancyGrid;

/// Between a description and its image in one input.
pub(super) const BETWEEN: &[u8] = b"\n%%\n";
/// Larger maps are not written again, cells: that takes long and finds nothing new.
const MOST_CELLS: usize = 1 << 16;

/// A small map in every format.
///
/// # Panics
/// When it cannot be written.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let map = drawn_map(0.05, &["######", "#..?.#", "#.#..#", "######"]);
    let (pgm, png) = (to_pgm(&map), to_png(&map).expect("a PNG"));
    let described = |mode, image: &[u8]| {
        let text = to_yaml(&map, mode, "map.pgm").to_text(&["a comment".to_owned()]);
        [text.as_bytes(), BETWEEN, image].concat()
    };
    vec![
        described(MapMode::Trinary, &pgm),
        described(MapMode::Scale, &png),
        described(MapMode::Raw, &pgm),
        pgm,
        png,
        b"P2\n# a comment\n3 2\n255\n0 127 255\n255 0 127\n".to_vec(),
        b"type octile\nheight 2\nwidth 3\nmap\n.@.\n...\n".to_vec(),
        b"version 1\n0\tmaps/fuzz.map\t3\t2\t0\t0\t2\t1\t2.41421356\n".to_vec(),
    ]
}

/// Reads the bytes as every kind of file, and writes what was read.
///
/// # Panics
/// When a map that was read cannot be written and read again.
pub fn exercise(bytes: &[u8]) -> usize {
    let as_image = decode(bytes.to_vec())
        .ok()
        .and_then(|image| to_grid(image, &MapYaml::new("", 0.05, Point2::origin())).ok());
    let as_moving_ai = parse_moving_ai_map(bytes, 1.0).ok();
    let maps = [as_image, as_moving_ai, described(bytes)];
    let scenarios = parse_moving_ai_scenarios(bytes).is_ok_and(|scenarios| !scenarios.is_empty());
    let taken = maps.iter().flatten().count() + usize::from(scenarios);
    maps.iter().flatten().for_each(write_again);
    taken
}

/// A description and its image.
fn described(bytes: &[u8]) -> Option<OccupancyGrid> {
    let at = bytes.windows(BETWEEN.len()).position(|window| window == BETWEEN)?;
    let yaml = MapYaml::parse(std::str::from_utf8(&bytes[..at]).ok()?).ok()?;
    let again = MapYaml::parse(&yaml.to_text(&[])).expect("a description that was written");
    assert_eq!(again, yaml);
    let image = decode(bytes[at + BETWEEN.len()..].to_vec()).ok()?;
    to_grid(image, &yaml).ok()
}

fn write_again(map: &OccupancyGrid) {
    if map.values().len() > MOST_CELLS || map.values().is_empty() {
        return;
    }
    let size = |bytes: Vec<u8>| {
        let image = decode(bytes).expect("an image that was written");
        (image.width, image.height)
    };
    let spec = map.spec();
    assert_eq!(size(to_pgm(map)), (spec.width, spec.height));
    assert_eq!(size(to_png(map).expect("a PNG")), (spec.width, spec.height));
}

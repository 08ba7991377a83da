//! Transient obstacles, on a sequence of map states.

use zenav_protocol::messages::{MapRef, Tile};

use super::*;

const SPEC: GridSpec = GridSpec {
    origin: Point2::new(-3.2, 6.4),
    resolution: 0.05,
    width: 128,
    height: 128,
};

/// A sequence of map states, and the transient cells at the end.
struct Shown {
    transients: Transients,
    grid: OccupancyGrid,
    secs: f64,
}

impl Shown {
    fn new() -> Self {
        Self {
            transients: Transients::default(),
            grid: OccupancyGrid::filled(SPEC, Occupancy::UNKNOWN),
            secs: 0.0,
        }
    }

    /// Ten seconds later these cells have this value.
    fn show(&mut self, value: i8, columns: std::ops::Range<u32>, rows: std::ops::Range<u32>) -> &mut Self {
        for (x, y) in rows.flat_map(|y| columns.clone().map(move |x| (x, y))) {
            self.grid[zenav_protocol::grid::Cell::new(x, y)] = value;
        }
        self.secs += 10.0;
        let tiles = [(0, 0), (1, 0), (0, 1), (1, 1)].map(|(x, y)| Tile {
            x,
            y,
            values: (0..64 * 64)
                .map(|at| self.grid.values()[((y * 64 + at / 64) * 128 + x * 64 + at % 64) as usize])
                .collect(),
        });
        let map = MapRef::new("m", self.secs as u64);
        let patch = MapPatch {
            stamp: Stamp::ZERO,
            base_revision: 0,
            map,
            spec: SPEC,
            tiles: tiles.to_vec(),
        };
        self.transients.observe(Stamp::from_secs(self.secs), &patch);
        self
    }

    fn cells(&self, grows: bool) -> Vec<TransientCell> {
        self.transients
            .cells(&self.grid, grows, &[SPEC.from_cells(Point2::new(64.0, 64.0))])
    }
}

#[test]
fn what_came_may_leave_and_is_known_since_when() {
    let mut shown = Shown::new();
    shown.show(0, 20..110, 20..110).show(100, 60..68, 62..66);
    let cells = shown.cells(false);
    assert_eq!(cells.len(), 32);
    assert!(cells.iter().all(|cell| cell.since == Some(Stamp::from_secs(20.0))));
    let first = SPEC.from_cells(Point2::new(60.5, 62.5));
    assert!((cells[0].center - first).norm() < 1e-9, "{:?}", cells[0]);
    // A repeated whole map changes nothing.
    shown.transients.observe_all(Stamp::from_secs(30.0), "m", &shown.grid);
    assert_eq!(shown.cells(false), cells);
    shown.show(0, 60..68, 62..66);
    assert!(shown.cells(true).is_empty());
}

#[test]
fn a_door_may_leave_and_the_surface_of_a_wall_may_not_though_both_were_seen_free() {
    let mut shown = Shown::new();
    // A wall with a door of 0.9 m, seen from both sides.
    shown.show(0, 20..110, 20..110).show(100, 20..50, 64..66);
    shown.show(100, 68..110, 64..66).show(100, 50..68, 64..65);
    let cells = shown.cells(false);
    assert!(
        cells
            .iter()
            .filter(|cell| cell.since == Some(Stamp::from_secs(40.0)))
            .count()
            >= 18
    );
    // Only the door, although the surface of the walls beside it was taken for free.
    let mut shown = Shown::new();
    shown
        .show(0, 20..110, 20..64)
        .show(0, 50..68, 20..110)
        .show(0, 20..110, 70..110);
    shown
        .show(100, 20..50, 63..64)
        .show(100, 68..110, 63..64)
        .show(100, 50..68, 65..66);
    let cells = shown.cells(false);
    let low = SPEC.from_cells(Point2::new(47.0, 62.0));
    let high = SPEC.from_cells(Point2::new(71.0, 67.0));
    assert!(cells.iter().filter(|cell| cell.center.y > high.y - 0.1 - 1e-9).count() >= 16);
    assert!(
        cells.iter().all(|cell| cell.center > low && cell.center < high),
        "{cells:?}"
    );
    // A wall whose surface a grazing beam once showed as free, with never any free space seen behind it.
    let mut shown = Shown::new();
    shown.show(0, 20..110, 20..65).show(100, 20..110, 64..65);
    assert!(shown.cells(true).is_empty());
}

#[test]
fn the_last_cells_of_who_went_on_may_leave_and_noise_at_a_wall_may_not() {
    let mut shown = Shown::new();
    shown.show(100, 20..110, 110..111).show(0, 20..110, 20..110);
    shown.show(100, 64..65, 64..65).show(100, 80..81, 109..110);
    let cells = shown.cells(true);
    let left = SPEC.from_cells(Point2::new(64.5, 64.5));
    assert!(
        matches!(cells[..], [cell] if (cell.center - left).norm() < 1e-9),
        "{cells:?}"
    );
}

#[test]
fn what_stands_alone_may_leave_unless_it_is_large_or_in_a_stored_map() {
    let mut shown = Shown::new();
    shown.show(100, 60..68, 62..64).show(100, 20..40, 62..64);
    // The same holds for a piece of a wall.
    assert!(shown.cells(true).is_empty());
    shown
        .show(0, 50..60, 52..70)
        .show(0, 68..78, 52..70)
        .show(0, 60..68, 52..62);
    assert_eq!(shown.cells(true).len(), 16);
    assert!(shown.cells(false).is_empty());
}

#[test]
fn what_was_never_seen_to_come_is_in_the_way_since_it_was_noticed_first_until_it_leaves() {
    let mut shown = Shown::new();
    shown.show(100, 60..68, 62..64).show(0, 50..60, 52..70);
    let centers: Vec<Point2<f64>> = (60..68)
        .map(|x| SPEC.from_cells(Point2::new(f64::from(x) + 0.5, 62.5)))
        .collect();
    let at = Stamp::from_secs;
    let notice = |shown: &mut Shown, secs: f64| shown.transients.notice(&shown.grid, &centers, at(secs));
    assert_eq!(notice(&mut shown, 30.0), at(30.0));
    // Another goal comes to it, and the map changes elsewhere.
    shown.show(0, 68..78, 52..70);
    assert_eq!(notice(&mut shown, 90.0), at(30.0));
    // Some of it leaves, then all of it; what comes there later is another obstacle, whose time is known.
    shown.show(0, 60..64, 62..64);
    assert_eq!(notice(&mut shown, 100.0), at(30.0));
    shown.show(0, 60..68, 62..64).show(100, 60..68, 62..64);
    assert_eq!(notice(&mut shown, 200.0), at(200.0));
}

#[test]
fn who_comes_to_stand_beside_an_old_obstacle_has_not_stood_there_as_long() {
    let mut shown = Shown::new();
    shown.show(100, 60..68, 62..64).show(0, 50..60, 52..70);
    let centers = |columns: std::ops::Range<usize>| -> Vec<Point2<f64>> {
        let center = |x: usize| SPEC.from_cells(Point2::new(x as f64 + 0.5, 62.5));
        columns.map(center).collect()
    };
    let at = Stamp::from_secs;
    assert_eq!(
        shown.transients.notice(&shown.grid, &centers(60..68), at(30.0)),
        at(30.0)
    );
    // Noise at its edge is nobody.
    shown.show(100, 58..60, 62..64);
    assert_eq!(
        shown.transients.notice(&shown.grid, &centers(58..68), at(90.0)),
        at(30.0)
    );
    shown.show(100, 52..58, 62..64);
    assert_eq!(
        shown.transients.notice(&shown.grid, &centers(52..68), at(200.0)),
        at(200.0)
    );
}

#[test]
fn a_map_of_senseless_size_is_left_alone() {
    let mut transients = Transients::default();
    let spec = GridSpec {
        origin: Point2::new(1e300, -1e300),
        resolution: 1e-300,
        ..SPEC
    };
    let grid = OccupancyGrid::filled(spec, Occupancy::OCCUPIED);
    transients.observe_all(Stamp::ZERO, "m", &grid);
    assert!(transients.cells(&grid, true, &[Point2::origin()]).is_empty());
    transients.observe_all(Stamp::ZERO, "m", &OccupancyGrid::filled(SPEC, Occupancy::FREE));
    assert!(
        transients
            .cells(&grid, true, &[Point2::new(f64::NAN, 1e300)])
            .is_empty()
    );
}

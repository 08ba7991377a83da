//! Tests of inserting beams into the grid.

use zenav_protocol::grid::{Cell, Occupancy};
use zenav_protocol::messages::TILE;
use zenav_protocol::time::Stamp;

use super::*;
use crate::sensor_model::UNSEEN;

const BEAMS: BeamSettings = BeamSettings {
    trim: 0,
    max_range: None,
    clear_without_return: true,
    lost_run: 0,
};

/// A scan from a pose whose beams start straight ahead and go counter-clockwise by `step`.
fn scan(pose: Pose2, step: f64, ranges: Vec<f32>) -> Scan {
    Scan {
        stamp: Stamp(1),
        angle_min: 0.0,
        angle_increment: step,
        range_min: 0.02,
        range_max: 5.0,
        ranges,
        odom_from_base: pose,
        ..Scan::default()
    }
}

fn empty() -> LogOddsGrid {
    LogOddsGrid::new(0.05, &SensorModel::default())
}

fn at(map: &LogOddsGrid, x: f64, y: f64) -> Occupancy {
    map.to_occupancy()
        .at(Point2::new(x, y))
        .map_or(Occupancy::Unknown, |value| Occupancy::of(*value))
}

proptest::proptest! {
    #![proptest_config(proptest::test_runner::Config::with_cases(32))]

    #[test]
    fn reference_insertion_is_a_walk_along_every_beam_and_between_neighbours(looks in proptest::collection::vec((-3.0..3.0, -3.0..3.0, -3.1..3.1, 0.01..0.3, proptest::collection::vec(0.05_f32..7.0, 1..40)), 1..12)) {
        let (mut map, model) = (empty(), QuantizedModel::new(&SensorModel::default()));
        let whole = GridSpec { origin: Point2::new(-12.8, -12.8), resolution: 0.05, width: 512, height: 512 };
        let mut bytes = vec![UNSEEN; whole.len()];
        for (x, y, yaw, step, mut ranges) in looks {
            ranges.truncate((std::f64::consts::TAU / step) as usize);
            let scan = scan(Pose2::new(x, y, yaw), step, ranges);
            proptest::prop_assert!(map.insert(&scan, &BEAMS, InsertMode::Reference, None).is_some());
            let (mut seen, mut hit) = (std::collections::BTreeSet::new(), std::collections::BTreeSet::new());
            for (beam, range) in scan.ranges.iter().enumerate() {
                let length = f64::from(*range).min(scan.range_max);
                let end = Point2::new(x, y) + Vector2::new((yaw + scan.angle(beam)).cos(), (yaw + scan.angle(beam)).sin()) * length;
                seen.extend(whole.walk(Point2::new(x, y), end).map(|cell| whole.index(cell)));
                hit.extend((f64::from(*range) <= scan.range_max).then(|| whole.index(whole.cell_at(end).unwrap())));
            }
            // Where neighbours are at most 0.1 m apart, enough rays between them that none is farther than a cell from the next.
            for (beam, pair) in scan.ranges.windows(2).enumerate() {
                let nearest = f64::from(pair[0].min(pair[1])).min(scan.range_max);
                let passed = (nearest / whole.resolution - 1.0).clamp(0.0, 0.1 / (whole.resolution * step));
                let [first, second] = [beam, beam + 1].map(|beam| {
                    let yaw = yaw + scan.angle(beam);
                    Vector2::new(yaw.cos(), yaw.sin()) * whole.resolution
                });
                let gaps = (passed / step.recip()).ceil() as u32;
                for nth in 1..gaps {
                    let direction = first.lerp(&second, f64::from(nth) / f64::from(gaps));
                    let [a, b] = [step.recip(), passed].map(|cells| Point2::new(x, y) + direction * cells);
                    seen.extend(whole.walk(a, b).map(|cell| whole.index(cell)));
                }
            }
            for index in seen {
                bytes[index] = if hit.contains(&index) { model.after_hit(bytes[index]) } else { model.after_miss(bytes[index]) };
            }
        }
        let map = map.to_occupancy();
        for (index, byte) in bytes.iter().enumerate() {
            let value = map.at(whole.center(whole.cell(index))).copied().unwrap_or(Occupancy::UNKNOWN);
            proptest::prop_assert_eq!(value, model.percent(*byte), "at {}", whole.center(whole.cell(index)));
        }
    }
}

proptest::proptest! {
    #[test]
    fn fast_insertion_marks_nearly_the_same_cells(ranges in proptest::collection::vec((0.3_f32..5.0, 1_usize..60), 5..40), x in -1.0..1.0, yaw in -3.0..3.0, step in 0.005..0.02) {
        let ranges: Vec<f32> = ranges.iter().flat_map(|(range, times)| (0..*times).map(move |i| range + 0.003 * i as f32)).collect();
        let count = ranges.len().min((std::f64::consts::TAU / step) as usize);
        let scan = scan(Pose2::new(x, 0.4, yaw), step, ranges[..count].to_vec());
        let [exact, fast] = [InsertMode::Reference, InsertMode::Fast].map(|mode| {
            let mut map = empty();
            map.insert(&scan, &BEAMS, mode, None);
            map.to_occupancy()
        });
        let differ = exact.values().iter().zip(fast.values()).filter(|(exact, fast)| exact != fast).count();
        let known = exact.values().iter().filter(|value| **value >= 0).count();
        proptest::prop_assert!(differ * 200 <= known, "{differ} of {known} cells differ");
    }
}

#[test]
fn a_beam_frees_the_cells_it_passes_and_fills_its_last() {
    let mut map = empty();
    map.insert(
        &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![2.0]),
        &BEAMS,
        InsertMode::Reference,
        None,
    );
    assert_eq!(at(&map, 1.0, 0.01), Occupancy::Free);
    assert_eq!(at(&map, 2.01, 0.01), Occupancy::Occupied);
    assert_eq!(at(&map, 2.06, 0.01), Occupancy::Unknown);
    assert_eq!(at(&map, 1.0, 0.11), Occupancy::Unknown);
    assert_eq!(map.counts().occupied, 1);
}

#[test]
fn a_beam_without_a_return_frees_its_whole_range() {
    let mut map = empty();
    map.insert(
        &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![f32::INFINITY]),
        &BEAMS,
        InsertMode::Reference,
        None,
    );
    assert_eq!((at(&map, 4.9, 0.01), map.counts().occupied), (Occupancy::Free, 0));
    let mut map = empty();
    map.insert(
        &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![f32::INFINITY]),
        &BeamSettings {
            clear_without_return: false,
            ..BEAMS
        },
        InsertMode::Reference,
        None,
    );
    assert_eq!(map.counts().free, 0);
}

#[test]
fn a_hit_is_not_erased_by_another_beam_of_its_scan() {
    let mut map = empty();
    // The second beam continues through the cell in which the first one ended.
    map.insert(
        &scan(Pose2::new(0.01, 0.01, 0.0), 1e-4, vec![1.0, 2.0]),
        &BEAMS,
        InsertMode::Reference,
        None,
    );
    assert_eq!(at(&map, 1.01, 0.01), Occupancy::Occupied);
    // Later scans do erase it.
    for _ in 0..5 {
        map.insert(
            &scan(Pose2::new(0.01, 0.01, 0.0), 1e-4, vec![2.0, 2.0]),
            &BEAMS,
            InsertMode::Reference,
            None,
        );
    }
    assert_eq!(at(&map, 1.01, 0.01), Occupancy::Free);
}

#[test]
fn the_cells_under_the_robot_are_free() {
    let mut map = empty();
    map.insert(
        &scan(Pose2::new(3.0, -2.0, 0.3), 0.1, vec![0.1; 40]),
        &BEAMS,
        InsertMode::Reference,
        Some(&Footprint::Radius(0.25)),
    );
    for (x, y) in [(3.0, -2.0), (3.2, -2.0), (2.8, -2.0), (3.0, -1.8), (3.1, -2.0)] {
        assert_eq!(at(&map, x, y), Occupancy::Free);
    }
}

#[test]
fn growing_keeps_what_was_known_where_it_was() {
    let mut map = empty();
    map.insert(
        &scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![1.0]),
        &BEAMS,
        InsertMode::Reference,
        None,
    );
    let before = map.spec();
    map.insert(
        &scan(Pose2::new(-20.0, -30.0, 0.0), 0.1, vec![1.0]),
        &BEAMS,
        InsertMode::Reference,
        None,
    );
    let after = map.spec();
    assert!(after.len() > before.len() && after.width.is_multiple_of(TILE) && after.height.is_multiple_of(TILE));
    assert_eq!(
        (at(&map, 0.5, 0.01), at(&map, 1.01, 0.01)),
        (Occupancy::Free, Occupancy::Occupied)
    );
    assert_eq!(
        (at(&map, -19.5, -30.0), at(&map, -18.99, -29.99)),
        (Occupancy::Free, Occupancy::Occupied)
    );
}

#[test]
fn a_beam_beyond_the_largest_map_is_left_out() {
    let mut map = empty();
    let mut far = scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![1.0, 1e9]);
    far.range_max = 1e10;
    let count = BeamCount {
        inserted: 1,
        left_out: 1,
    };
    assert_eq!(map.insert(&far, &BEAMS, InsertMode::Reference, None), Some(count));
    let nowhere = scan(Pose2::new(1e12, 0.0, 0.0), 0.1, vec![1.0]);
    assert_eq!(map.insert(&nowhere, &BEAMS, InsertMode::Reference, None), None);
    assert_eq!(at(&map, 1.01, 0.01), Occupancy::Occupied);
}

#[test]
fn changed_tiles_are_given_once() {
    let mut map = empty();
    let still = scan(Pose2::new(0.01, 0.01, 0.0), 0.1, vec![1.0]);
    map.insert(&still, &BEAMS, InsertMode::Reference, None);
    let tiles = map.take_dirty(usize::MAX);
    assert_eq!(tiles.len(), 1);
    assert_eq!(tiles[0].values, map.to_occupancy().values());
    assert!(!map.is_dirty());
    // A scene that no longer changes is not sent again.
    for _ in 0..100 {
        map.insert(&still, &BEAMS, InsertMode::Reference, None);
    }
    map.take_dirty(usize::MAX);
    map.insert(&still, &BEAMS, InsertMode::Reference, None);
    assert!(!map.is_dirty());
}

#[test]
fn known_values_are_taken_over_and_padded() {
    let spec = GridSpec {
        origin: Point2::new(0.3, -0.7),
        resolution: 0.1,
        width: 70,
        height: 3,
    };
    let grid = zenav_fixtures::map_with_occupied(spec, &[(69, 2)]);
    let map = LogOddsGrid::from_occupancy(&grid, &SensorModel::default());
    assert_eq!(
        (map.spec().width, map.spec().height, map.spec().origin),
        (128, 64, spec.origin)
    );
    assert_eq!(
        map.counts(),
        CellCounts {
            free: 209,
            occupied: 1,
            unknown: 128 * 64 - 210
        }
    );
    assert_eq!(Occupancy::of(map.to_occupancy()[Cell::new(69, 2)]), Occupancy::Occupied);
}

/// Where the robot touched something 2 m ahead while its beams end at 4 m.
fn touched(secs: f64, lines: Vec<[[f64; 4]; 2]>) -> Scan {
    Scan {
        stamp: Stamp::from_secs(secs),
        touched: lines,
        ..scan(Pose2::new(0.01, 0.01, 0.0), 0.05, vec![4.0; 4])
    }
}

#[test]
fn what_the_robot_touched_stays_though_beams_pass_it_until_it_is_old_or_the_robot_stands_there() {
    let pane = || vec![[[2.01, -0.4, 2.01, 0.4]; 2]];
    for mode in [InsertMode::Reference, InsertMode::Fast] {
        let mut map = empty().with_decay(Duration::from_secs(10));
        let body = Footprint::Radius(0.3);
        let look = |map: &mut LogOddsGrid, scan: &Scan| {
            assert!(map.insert(scan, &BEAMS, mode, Some(&body)).is_some());
        };
        for second in 0..60 {
            look(&mut map, &touched(f64::from(second), Vec::new()));
        }
        assert_eq!(at(&map, 2.01, 0.21), Occupancy::Free);
        look(&mut map, &touched(60.0, pane()));
        for second in 61..200 {
            look(&mut map, &touched(f64::from(second), Vec::new()));
        }
        for y in [-0.3, 0.0, 0.21, 0.39] {
            assert_eq!(at(&map, 2.02, y), Occupancy::Occupied, "{mode:?}, {y}");
        }
        assert_eq!(at(&map, 1.8, 0.1), Occupancy::Free);
        map.decay_now();
        assert_eq!(at(&map, 2.02, 0.1), Occupancy::Occupied);
        // The same scans, drawn again from other poses.
        let mut redrawn = map.unseen();
        let moved = Scan {
            map_from_odom: Pose2::new(1.0, 0.0, 0.0),
            ..touched(60.0, pane())
        };
        for _ in 0..2 {
            look(&mut redrawn, &moved);
        }
        assert_eq!(at(&redrawn, 3.02, 0.1), Occupancy::Occupied);
        assert_eq!(at(&redrawn, 2.02, 0.1), Occupancy::Free);
        // The robot stands on part of it.
        let there = Scan {
            odom_from_base: Pose2::new(2.0, 0.3, 0.0),
            ..touched(201.0, Vec::new())
        };
        for _ in 0..20 {
            look(&mut map, &there);
        }
        for second in 202..220 {
            look(&mut map, &touched(f64::from(second), Vec::new()));
        }
        assert_eq!(at(&map, 2.02, 0.21), Occupancy::Free);
        assert_eq!(at(&map, 2.02, -0.3), Occupancy::Occupied);
        // Where beams pass, it is free an hour later.
        look(&mut map, &touched(221.0, vec![[[2.01, 0.1, 2.01, 0.3]; 2]]));
        for second in 222..230 {
            look(&mut map, &touched(f64::from(second), Vec::new()));
        }
        assert_eq!(at(&map, 2.02, 0.21), Occupancy::Occupied);
        for second in 0..20 {
            look(&mut map, &touched(4000.0 + f64::from(second), Vec::new()));
        }
        assert_eq!(at(&map, 2.02, 0.21), Occupancy::Free);
    }
}

#[test]
fn what_is_only_assumed_of_a_surface_is_cleared_by_beams_or_decays_after_a_short_while() {
    let body = Footprint::Radius(0.3);
    for looks_there in [true, false] {
        let mut map = empty().with_decay(Duration::from_secs(10));
        let look = |map: &mut LogOddsGrid, secs: f64, yaw: f64, lines: Vec<[[f64; 4]; 2]>| {
            let scan = Scan {
                odom_from_base: Pose2::new(0.01, 0.01, yaw),
                ..touched(secs, lines)
            };
            assert!(map.insert(&scan, &BEAMS, InsertMode::Reference, Some(&body)).is_some());
        };
        for second in 0..60 {
            look(&mut map, f64::from(second), 0.0, Vec::new());
        }
        look(
            &mut map,
            60.0,
            0.0,
            vec![[[2.01, 0.2, 2.01, 0.2], [2.01, 0.0, 2.01, 0.4]]],
        );
        let yaw = if looks_there { 0.0 } else { 3.0 };
        for second in 61..100 {
            look(&mut map, f64::from(second), yaw, Vec::new());
        }
        for y in [0.11, 0.21, 0.35] {
            assert_eq!(at(&map, 2.02, y), Occupancy::Occupied, "{y}");
        }
        for second in 100..130 {
            look(&mut map, f64::from(second), yaw, Vec::new());
        }
        assert_eq!(at(&map, 2.02, 0.21), Occupancy::Occupied);
        assert_eq!(at(&map, 2.02, 0.11), Occupancy::Free, "{looks_there}");
    }
}

#[test]
fn what_beams_met_before_it_was_touched_does_not_decay_afterwards() {
    let mut map = empty().with_decay(Duration::from_secs(10));
    let look = |map: &mut LogOddsGrid, secs: f64, yaw: f64, range: f32, lines: Vec<[[f64; 4]; 2]>| {
        let scan = Scan {
            ranges: vec![range; 4],
            odom_from_base: Pose2::new(0.01, 0.01, yaw),
            ..touched(secs, lines)
        };
        assert!(map.insert(&scan, &BEAMS, InsertMode::Reference, None).is_some());
    };
    for second in 0..60 {
        look(&mut map, f64::from(second), 0.0, 4.0, Vec::new());
    }
    for second in 60..66 {
        look(&mut map, f64::from(second), 0.0, 2.01, Vec::new());
    }
    assert_eq!(at(&map, 2.02, 0.02), Occupancy::Occupied);
    look(&mut map, 66.0, 0.0, 4.0, vec![[[2.01, 0.01, 2.01, 0.01]; 2]]);
    // The scan at which the hits of the beams would have decayed, and a later one.
    for secs in [75.5, 76.0] {
        look(&mut map, secs, 3.0, 4.0, Vec::new());
        assert_eq!(at(&map, 2.02, 0.02), Occupancy::Occupied, "{secs}");
    }
    map.decay_now();
    assert_eq!(at(&map, 2.02, 0.02), Occupancy::Occupied);
}

#[test]
fn touched_cells_outlast_a_restart_of_the_robot_s_clock_and_a_scan_out_of_bounds_reports_none() {
    let mut map = empty();
    let look = |map: &mut LogOddsGrid, scan: &Scan| map.insert(scan, &BEAMS, InsertMode::Reference, None);
    let pane = || vec![[[2.01, -0.4, 2.01, 0.4]; 2]];
    let far = Scan {
        odom_from_base: Pose2::new(1e7, 0.0, 0.0),
        ..touched(5000.0, pane())
    };
    assert!(look(&mut map, &touched(5000.0, Vec::new())).is_some());
    assert!(look(&mut map, &far).is_none());
    assert_eq!(map.touched.tiles().count(), 0);
    for scan in [touched(5001.0, pane()), touched(1.0, Vec::new())] {
        assert!(look(&mut map, &scan).is_some());
    }
    for second in 2..20 {
        assert!(look(&mut map, &touched(f64::from(second), Vec::new())).is_some());
    }
    assert_eq!(at(&map, 2.02, 0.21), Occupancy::Occupied);
}

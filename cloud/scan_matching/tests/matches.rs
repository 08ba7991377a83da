//! Tests of matching: the best pose is found every time, and a missing one is reported.

#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::{Matrix3, Point2};
use proptest::prelude::*;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy};
use zenav_scan_matching::{
    FieldSettings, LikelihoodField, Prior, Pyramid, Refinable, RefineSettings, Surfels, VerdictSettings, Window,
    heading_step, judge, refine, search,
};

/// Points on the walls of a room of 6 m by 4 m with a pillar, as seen from a pose in it.
fn room(map_from_scan: Pose2) -> Vec<Point2<f64>> {
    let mut points = Vec::new();
    for step in 0..=120 {
        let x = 0.05 * f64::from(step);
        points.extend([Point2::new(x, 0.0), Point2::new(x, 4.0)]);
    }
    for step in 0..=80 {
        let y = 0.05 * f64::from(step);
        points.extend([Point2::new(0.0, y), Point2::new(6.0, y)]);
    }
    points.extend((0..8).map(|step| Point2::new(4.5, 2.5 + 0.05 * f64::from(step))));
    let scan_from_map = map_from_scan.inverse();
    points
        .iter()
        .map(|point| scan_from_map.transform_point(*point))
        .collect()
}

fn field_of(points: &[Point2<f64>]) -> LikelihoodField {
    let mut field = LikelihoodField::new(&FieldSettings::default());
    field.insert(Pose2::IDENTITY, points);
    field
}

/// The best score in a window, by trying every pose.
fn brute_force(field: &LikelihoodField, points: &[Point2<f64>], window: &Window) -> f64 {
    let resolution = field.spec().resolution;
    let farthest = points.iter().map(|point| point.coords.norm()).fold(0.0, f64::max);
    let step = heading_step(&[Point2::new(farthest.min(window.lever), 0.0)], resolution);
    let (turns, reach) = (
        (window.turn / step).floor() as i64,
        (window.reach / resolution).floor() as i64,
    );
    let mut best = 0.0_f64;
    for turn in -turns..=turns {
        let turned = Pose2::new(window.center.x, window.center.y, window.center.yaw + turn as f64 * step);
        let cells: Vec<(i64, i64)> = points
            .iter()
            .map(|point| (turned.transform_point(*point) - field.spec().origin) / resolution)
            .map(|at| (at.x.floor() as i64, at.y.floor() as i64))
            .collect();
        for dy in -reach..=reach {
            for dx in -reach..=reach {
                let value = |&(x, y): &(i64, i64)| {
                    let is_inside = field.spec().contains(x + dx, y + dy);
                    let index = (y + dy) * i64::from(field.spec().width) + x + dx;
                    if is_inside {
                        u64::from(field.values()[index as usize])
                    } else {
                        0
                    }
                };
                let sum: u64 = cells.iter().map(value).sum();
                best = best.max(sum as f64 / (255.0 * points.len() as f64));
            }
        }
    }
    best
}

fn points() -> impl Strategy<Value = Vec<Point2<f64>>> {
    prop::collection::vec((-3.0..3.0, -3.0..3.0), 1..25)
        .prop_map(|points| points.into_iter().map(|(x, y)| Point2::new(x, y)).collect())
}

fn pose(reach: f64) -> impl Strategy<Value = Pose2> {
    (-reach..reach, -reach..reach, -3.1..3.1).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]

    #[test]
    fn branch_and_bound_finds_what_trying_every_pose_finds(
        map in points(), scan in points(), center in pose(2.0), reach in 0.0..0.8, turn in 0.0..0.12, highest in 0u32..6,
    ) {
        let pyramid = Pyramid::new(field_of(&map), highest);
        let window = Window::around(center, reach, turn);
        let result = search(&pyramid, &scan, &window);
        prop_assert!(result.is_exact);
        let best = brute_force(pyramid.field(), &scan, &window);
        prop_assert!((result.found[0].score - best).abs() < 1e-12, "{} {best}", result.found[0].score);
    }

    /// Enough headings to be grouped, and points beyond the lever.
    #[test]
    fn groups_of_headings_and_points_far_out_are_bounded_too(
        map in points(), scan in points(), center in pose(2.0), reach in 0.0..0.3, turn in 0.4..1.2, lever in 0.5..5.0, highest in 1u32..6,
    ) {
        let pyramid = Pyramid::new(field_of(&map), highest);
        let window = Window { lever, ..Window::around(center, reach, turn) };
        let result = search(&pyramid, &scan, &window);
        prop_assert!(result.is_exact);
        let best = brute_force(pyramid.field(), &scan, &window);
        prop_assert!((result.found[0].score - best).abs() < 1e-12, "{} {best}", result.found[0].score);
    }

    #[test]
    fn no_moved_point_exceeds_its_bound(map in points(), side in 1u32..48, x in -80i32..160, y in -80i32..160) {
        let pyramid = Pyramid::new(field_of(&map), 5);
        let bound = pyramid.bound(side, x, y);
        for dy in 0..side as i32 {
            for dx in 0..side as i32 {
                prop_assert!(pyramid.bound(1, x + dx, y + dy) <= bound);
            }
        }
    }

    #[test]
    fn candidates_come_best_first_and_are_distinct(map in points(), scan in points(), center in pose(1.0)) {
        let pyramid = Pyramid::new(field_of(&map), 5);
        let window = Window { count: 4, ..Window::around(center, 0.6, 0.2) };
        let found = search(&pyramid, &scan, &window).found;
        for pair in found.windows(2) {
            prop_assert!(pair[0].score >= pair[1].score);
        }
        for (index, a) in found.iter().enumerate() {
            for b in &found[..index] {
                let turn = wrap_angle(a.pose.yaw - b.pose.yaw).abs();
                prop_assert!(a.pose.distance(&b.pose) >= window.apart - 1e-9 || turn >= window.apart_turn - 1e-9);
            }
        }
    }

    #[test]
    fn a_scan_in_a_room_is_refined_to_a_millimetre_or_two(
        x in 1.0..5.0, y in 1.0..3.0, yaw in -3.0..3.0, dx in -0.05..0.05, dy in -0.05..0.05, turn in -0.02..0.02,
    ) {
        let truth = Pose2::new(x, y, yaw);
        let mut field = LikelihoodField::new(&FieldSettings::default());
        field.insert(Pose2::IDENTITY, &room(Pose2::IDENTITY));
        let start = Pose2::new(x + dx, y + dy, yaw + turn);
        let refined = refine(&field, &room(truth), start, None, &RefineSettings::default());
        prop_assert!(refined.pose.distance(&truth) < 0.003, "{:?}", refined.pose);
        prop_assert!(wrap_angle(refined.pose.yaw - yaw).abs() < 0.002);
        prop_assert!(refined.degenerate.is_none());
    }

    #[test]
    fn inserting_in_any_order_makes_the_same_field(map in points(), other in points(), at in pose(3.0)) {
        let (mut one, mut two) = (LikelihoodField::new(&FieldSettings::default()), LikelihoodField::new(&FieldSettings::default()));
        one.insert(Pose2::IDENTITY, &map);
        one.insert(at, &other);
        two.insert(at, &other);
        two.insert(Pose2::IDENTITY, &map);
        for point in &map {
            prop_assert!((one.at(*point) - two.at(*point)).abs() < 0.02);
            prop_assert!(one.at(*point) > 0.8);
        }
    }
}

#[test]
fn a_corridor_is_known_across_and_not_along() {
    let walls: Vec<Point2<f64>> = (0..400)
        .flat_map(|step| [-1.0, 1.0].map(|y| Point2::new(0.05 * f64::from(step) - 10.0, y)))
        .collect();
    let scan: Vec<Point2<f64>> = walls.iter().copied().filter(|point| point.x.abs() < 4.0).collect();
    let prior = Prior {
        pose: Pose2::new(0.5, 0.04, 0.0),
        information: Matrix3::identity() * 100.0,
    };
    let refined = refine(
        &field_of(&walls),
        &scan,
        prior.pose,
        Some(&prior),
        &RefineSettings::default(),
    );
    assert!(
        (refined.pose.x - 0.5).abs() < 0.01,
        "the prior alone counts along it: {:?}",
        refined.pose
    );
    assert!(refined.pose.y.abs() < 0.005, "{:?}", refined.pose);
    let along = refined.degenerate.unwrap();
    assert!(along.x.abs() > 0.99, "{along}");
}

#[test]
fn a_pillar_alone_tells_no_heading() {
    // Seen from 3.3 m beside it: a robot that drives on and turns back sees the same.
    let pillar: Vec<Point2<f64>> = (0..15)
        .map(|step| 0.06 * f64::from(step) - 0.42 - std::f64::consts::FRAC_PI_2)
        .map(|angle| Point2::new(0.3 * angle.cos(), 3.3 + 0.3 * angle.sin()))
        .collect();
    let refined = refine(
        &field_of(&pillar),
        &pillar,
        Pose2::IDENTITY,
        None,
        &RefineSettings::default(),
    );
    assert!(refined.degenerate.is_some(), "{refined:?}");
    let expected = Pose2::new(0.05, 0.0, 0.01);
    let followed = refined.expected_where_degenerate(expected);
    // Of x, y and yaw each, with the others unknown.
    let covariance = (followed.information + Matrix3::identity() * 1e-9)
        .try_inverse()
        .unwrap();
    let known = covariance.diagonal().map(f64::recip);
    assert!(known.x < 1.0 && known.y > 1e3 && known.z < 100.0, "{known}");
    assert!(
        followed.pose.x > 0.03 && followed.pose.y.abs() < 0.01,
        "{:?}",
        followed.pose
    );
}

#[test]
fn what_the_scan_alone_says_is_told_beside_what_a_prior_made_of_it() {
    let truth = Pose2::new(0.3, -0.2, 0.1);
    let prior = Prior {
        pose: truth * Pose2::new(0.02, -0.01, 0.004),
        information: Matrix3::from_diagonal(&nalgebra::Vector3::new(1e5, 1e5, 1e6)),
    };
    let field = field_of(&room(Pose2::IDENTITY));
    let refined = refine(
        &field,
        &room(truth),
        prior.pose,
        Some(&prior),
        &RefineSettings::default(),
    );
    let alone = refined.pose * refined.by_scan;
    assert!(
        refined.pose.distance(&truth) > 0.01,
        "the prior has a say: {:?}",
        refined.pose
    );
    assert!(
        alone.distance(&truth) < 0.005 && (alone.yaw - truth.yaw).abs() < 0.002,
        "{alone:?}"
    );
}

#[test]
fn the_wrong_room_is_told_by_beams_through_walls() {
    let field = field_of(&room(Pose2::IDENTITY));
    let here = Pose2::new(2.0, 2.0, 0.3);
    let settings = VerdictSettings::default();
    let right = judge(&field, Point2::origin(), &room(here), here, &settings);
    assert!(right.explained > 0.95 && right.through_walls < 0.05, "{right:?}");
    let wrong = judge(
        &field,
        Point2::origin(),
        &room(here),
        Pose2::new(4.0, 3.5, 0.3),
        &settings,
    );
    assert!(wrong.explained < 0.5 && wrong.through_walls > 0.2, "{wrong:?}");
}

#[test]
fn in_a_narrow_door_many_beams_pass_a_jamb_and_none_goes_through_a_wall() {
    // A wall 10 cm thick with a door 36 cm wide, seen from x < 0.
    let face = (-50..=50).map(|step| Point2::new(-0.05, 0.05 * f64::from(step)));
    let jambs = [-0.18, 0.18]
        .into_iter()
        .flat_map(|y| (-1..=1).map(move |step| Point2::new(0.05 * f64::from(step), y)));
    let known: Vec<_> = face.filter(|point| point.y.abs() > 0.18).chain(jambs).collect();
    let seen = |degrees: i32| {
        let beam = Pose2::new(0.0, 0.0, f64::from(degrees).to_radians());
        let jamb = 0.18 / beam.yaw.sin().abs().max(1e-9);
        let is_jamb = (jamb * beam.yaw.cos()).abs() <= 0.05;
        beam.transform_point(Point2::new(if is_jamb { jamb } else { 2.5 }, 0.0))
    };
    let scan: Vec<_> = (0..360).map(seen).collect();
    let judged = |at| {
        judge(
            &field_of(&known),
            Point2::origin(),
            &scan,
            at,
            &VerdictSettings::default(),
        )
    };
    let here = judged(Pose2::IDENTITY);
    assert!(
        here.through_walls > 0.08 && here.surely_through_walls < 0.02,
        "{here:?}"
    );
    let beside = judged(Pose2::new(0.1, 0.8, 0.0));
    assert!(beside.surely_through_walls > 0.3, "{beside:?}");
}

#[test]
fn a_symmetric_room_has_a_second_place_that_fits_as_well() {
    let mut walls = room(Pose2::IDENTITY);
    walls.retain(|point| !(point.x > 4.0 && point.x < 5.0 && point.y > 1.0 && point.y < 3.5));
    let here = Pose2::new(2.0, 1.5, 0.2);
    let scan: Vec<Point2<f64>> = walls
        .iter()
        .map(|point| here.inverse().transform_point(*point))
        .collect();
    let window = Window {
        count: 2,
        ..Window::around(Pose2::new(3.0, 2.0, 0.0), 2.0, std::f64::consts::PI)
    };
    let result = search(&Pyramid::new(field_of(&walls), 6), &scan, &window);
    assert!(result.margin().unwrap() < 0.1, "{result:?}");
    let asymmetric = search(&Pyramid::new(field_of(&room(Pose2::IDENTITY)), 6), &room(here), &window);
    assert!(asymmetric.found[0].pose.distance(&here) < 0.1, "{asymmetric:?}");
}

#[test]
fn a_budget_ends_the_search_and_says_so() {
    let pyramid = Pyramid::new(field_of(&room(Pose2::IDENTITY)), 3);
    let window = Window {
        budget: 10,
        ..Window::around(Pose2::new(3.0, 2.0, 0.0), 1.0, 0.5)
    };
    let cut = search(&pyramid, &room(Pose2::new(3.2, 2.1, 0.1)), &window);
    assert!(!cut.is_exact);
    let nothing = search(&pyramid, &[], &window);
    assert!(nothing.found.is_empty() && nothing.margin().is_none());
}

#[test]
fn an_occupancy_grid_makes_a_field() {
    let spec = GridSpec {
        origin: Point2::new(-1.0, 2.0),
        resolution: 0.1,
        width: 30,
        height: 20,
    };
    let mut grid = Grid::filled(spec, Occupancy::FREE);
    grid[Cell::new(10, 10)] = Occupancy::OCCUPIED;
    let field = LikelihoodField::from_grid(&grid, 0.1);
    let center = spec.center(Cell::new(10, 10));
    assert_eq!(field.at(center), 1.0);
    let beside = field.at(Point2::new(center.x + 0.1, center.y));
    assert!((beside - (-0.5_f64).exp()).abs() < 0.003, "{beside}");
    assert_eq!(field.at(Point2::new(9.0, 9.0)), 0.0);
}

/// The points of a lidar in a box of 4 m by 3 m, seen from a pose, each range off by up to a centimetre and a half; `scan`: number of the
/// scan.
fn boxed(map_from_scan: Pose2, scan: u32) -> Vec<Point2<f64>> {
    let seen = |beam: u32| {
        let angle = map_from_scan.yaw + (0.5 * f64::from(beam)).to_radians();
        let to = |wall: f64, from: f64, along: f64| {
            if along * wall > 0.0 {
                (wall - from) / along
            } else {
                f64::INFINITY
            }
        };
        let walls = [
            (2.0, map_from_scan.x, angle.cos()),
            (-2.0, map_from_scan.x, angle.cos()),
        ];
        let others = [
            (1.5, map_from_scan.y, angle.sin()),
            (-1.5, map_from_scan.y, angle.sin()),
        ];
        let range = walls
            .into_iter()
            .chain(others)
            .map(|(wall, from, along)| to(wall, from, along));
        let off = 0.015 * (f64::from(beam) * 2.4 + f64::from(scan) * 1.7).sin();
        let (range, angle) = (range.fold(f64::INFINITY, f64::min) + off, angle - map_from_scan.yaw);
        Point2::new(range * angle.cos(), range * angle.sin())
    };
    (0..720).map(seen).collect()
}

#[test]
fn surfels_make_a_match_exact_that_a_field_does_not() {
    let settings = RefineSettings::default();
    let (mut field, mut surfels) = (LikelihoodField::new(&FieldSettings::default()), Surfels::default());
    for scan in 0..20 {
        let at = Pose2::new(0.02 * f64::from(scan), 0.0, 0.0);
        let points = boxed(at, scan);
        field.insert(at, &points);
        surfels.insert(at, &points, Refinable::new(&points).normals());
    }
    let truth = Pose2::new(0.45, 0.05, 0.02);
    let points = boxed(truth, 21);
    let scan = Refinable::new(&points);
    let rough = scan.refine(&field, Pose2::new(0.43, 0.06, 0.03), None, &settings);
    let fine = scan.polish(&field, &surfels, &rough, None, &settings).unwrap();
    assert!(fine.pose.distance(&truth) < 0.002, "{:?}", fine.pose);
    assert!(wrap_angle(fine.pose.yaw - truth.yaw).abs() < 0.001, "{:?}", fine.pose);
    assert_eq!(scan.polish(&field, &Surfels::default(), &rough, None, &settings), None);
}

#[test]
fn surfels_make_a_match_of_seventeen_points_exact() {
    // A corner, first with a point every 5 cm, then with one every 15 cm, as of a lidar that loses most of its beams.
    let corner = |count: i32, apart: f64| -> Vec<Point2<f64>> {
        let sides = (-count..=count).map(|step| apart * f64::from(step));
        sides
            .map(|way| Point2::new(2.0 - way.max(0.0), 2.0 + way.min(0.0)))
            .collect()
    };
    let (settings, dense, sparse) = (RefineSettings::default(), corner(40, 0.05), corner(8, 0.15));
    let (field, mut surfels) = (field_of(&dense), Surfels::default());
    surfels.insert(Pose2::IDENTITY, &dense, Refinable::new(&dense).normals());
    let scan = Refinable::new(&sparse);
    let rough = scan.refine(&field, Pose2::new(0.03, -0.02, 0.01), None, &settings);
    let fine = scan.polish(&field, &surfels, &rough, None, &settings).unwrap();
    assert!(fine.pose.distance(&Pose2::IDENTITY) < 0.005, "{:?}", fine.pose);
}

//! Tests of localisation's claims.

#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::Point2;
use zenav_fixtures::{map_where, spec, walled_room};
use zenav_localisation::{Found, Hypothesis, KnownMap, LocalisationSettings, Localiser, Located, evidence, find};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::Health;
use zenav_scan_matching::{ScanSettings, points};

mod house;

use house::{drive, house, look};

fn is_near(a: Pose2, b: Pose2) -> bool {
    a.distance(&b) < 0.1 && wrap_angle(a.yaw - b.yaw).abs() < 0.035
}

#[test]
fn a_robot_is_followed_with_odometry_that_is_wrong_all_the_time() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let guess = Pose2::new(1.1, 1.95, 0.65);
    let mut worst = 0.0_f64;
    for (number, (truth, odometry)) in drive().into_iter().enumerate() {
        let scan = look(&map, 100 + number as u64, truth, odometry, guess);
        let located = localiser.step(&scan).unwrap();
        assert!(located.health.is_trusted(), "scan {number}: {located:?}");
        worst = worst.max(located.pose.distance(&truth));
    }
    assert!(worst < 0.06, "off by {worst} m");
}

#[test]
fn a_robot_is_found_in_the_whole_map_without_a_guess_and_the_place_is_the_only_one() {
    let map = house();
    let settings = LocalisationSettings::default();
    let known = KnownMap::new(&map, settings.tracking.sigma);
    for truth in [
        Pose2::new(1.5, 2.5, 2.0),
        Pose2::new(6.5, 1.5, -1.0),
        Pose2::new(10.5, 6.0, 3.0),
    ] {
        let scan = look(&map, 1, truth, Pose2::IDENTITY, Pose2::IDENTITY);
        let seen = points(&scan, Pose2::IDENTITY, 0.1, &ScanSettings::default());
        match find(&known, Point2::origin(), &seen, &settings) {
            Found::Unique(place) => assert!(is_near(place.pose, truth), "{truth:?}: {place:?}"),
            other => panic!("{truth:?}: {other:?}"),
        }
    }
}

#[test]
fn in_two_rooms_that_look_alike_the_answer_is_that_it_is_ambiguous() {
    let room = |at: Point2<f64>, x: f64| {
        let (dx, dy) = ((at.x - x - 2.0).abs(), (at.y - 2.0).abs());
        (dx < 2.0 && dy < 1.5) && (dx > 1.9 || dy > 1.4 || (at.x - x < 0.8 && at.y < 1.2))
    };
    let map = map_where(spec(220, 80, 0.05), |at| room(at, 0.5) || room(at, 5.5));
    let settings = LocalisationSettings::default();
    let known = KnownMap::new(&map, settings.tracking.sigma);
    let truth = Pose2::new(2.6, 2.2, 0.4);
    let scan = look(&map, 1, truth, Pose2::IDENTITY, Pose2::IDENTITY);
    let seen = points(&scan, Pose2::IDENTITY, 0.1, &ScanSettings::default());
    let Found::Ambiguous(places) = find(&known, Point2::origin(), &seen, &settings) else {
        panic!("not ambiguous");
    };
    assert!(places.iter().any(|place| is_near(place.pose, truth)), "{places:?}");
    let other = Pose2::new(truth.x + 5.0, truth.y, truth.yaw);
    assert!(places.iter().any(|place| is_near(place.pose, other)), "{places:?}");
}

#[test]
fn a_rival_that_scores_less_than_the_best_place_has_to_makes_it_ambiguous_too() {
    let room = |at: Point2<f64>, x: f64| {
        let (dx, dy) = ((at.x - x - 2.0).abs(), (at.y - 2.0).abs());
        (dx < 2.0 && dy < 1.5) && (dx > 1.9 || dy > 1.4 || (at.x - x < 0.8 && at.y < 1.2))
    };
    // The right wall of the second room has a gap.
    let gap = |at: Point2<f64>| at.x > 9.0 && (1.7..2.5).contains(&at.y);
    let map = map_where(spec(220, 80, 0.05), |at| room(at, 0.5) || room(at, 5.5) && !gap(at));
    let mut settings = LocalisationSettings::default();
    let known = KnownMap::new(&map, settings.tracking.sigma);
    let truth = Pose2::new(2.6, 2.2, 0.4);
    let other = Pose2::new(truth.x + 5.0, truth.y, truth.yaw);
    let scan = look(&map, 1, truth, Pose2::IDENTITY, Pose2::IDENTITY);
    let seen = points(&scan, Pose2::IDENTITY, 0.1, &ScanSettings::default());
    // With a falling bound of scores, first neither room is a place, then both are: no bound separates them.
    let bounds = (0..20).map(|nth| 1.0 - 0.02 * f64::from(nth));
    let answers: Vec<Found> = bounds
        .map(|bound| {
            (settings.global.min_score, settings.global.good_score) = (bound, bound);
            find(&known, Point2::origin(), &seen, &settings)
        })
        .collect();
    let is_there = |places: &[Hypothesis], pose: Pose2| places.iter().any(|place| place.pose.distance(&pose) < 0.3);
    let nowhere = answers.iter().take_while(|found| **found == Found::Nowhere).count();
    assert!((1..answers.len()).contains(&nowhere), "{answers:?}");
    for found in answers.iter().skip(nowhere) {
        let Found::Ambiguous(places) = found else {
            panic!("{found:?}");
        };
        assert!(is_there(places, truth) && is_there(places, other), "{places:?}");
    }
}

/// A room of 4 m by 3 m with a corner cut off, its left wall at `x`.
fn is_room(at: Point2<f64>, x: f64) -> bool {
    let (dx, dy) = ((at.x - x - 2.0).abs(), (at.y - 2.0).abs());
    (dx < 2.0 && dy < 1.5) && (dx > 1.9 || dy > 1.4 || (at.x - x < 0.8 && at.y < 1.2))
}

#[test]
fn a_box_that_stands_in_one_of_two_rooms_tells_them_apart() {
    // 6 % of the scan.
    let is_box = |at: Point2<f64>| (1.8..2.2).contains(&at.x) && (3.0..3.4).contains(&at.y);
    let map = map_where(spec(220, 80, 0.05), |at| {
        is_room(at, 0.5) || is_room(at, 5.5) || is_box(at)
    });
    let settings = LocalisationSettings::default();
    let known = KnownMap::new(&map, settings.tracking.sigma);
    let find_from = |truth: Pose2, settings: &LocalisationSettings| {
        let scan = look(&map, 1, truth, Pose2::IDENTITY, Pose2::IDENTITY);
        let seen = points(&scan, Pose2::IDENTITY, 0.1, &ScanSettings::default());
        find(&known, Point2::origin(), &seen, settings)
    };
    let look_from = |truth: Pose2| find_from(truth, &settings);
    let with = Pose2::new(2.6, 2.0, 0.4);
    let Found::Unique(place) = look_from(with) else {
        panic!("{:?}", look_from(with));
    };
    assert!(is_near(place.pose, with), "{place:?}");
    // From the room without it, the box may have been taken away.
    let without = look_from(Pose2::new(7.6, 2.0, 0.4));
    assert!(matches!(without, Found::Ambiguous(_)), "{without:?}");
    // If there may be more places than were examined, the box tells nothing.
    let mut few = settings;
    few.global.places = 2;
    let found = find_from(with, &few);
    assert!(matches!(found, Found::Ambiguous(_)), "{found:?}");
}

#[test]
fn a_lost_robot_that_turns_remembers_what_it_saw() {
    // Of three rooms one has boxes to the left and to the right, the others have one of them.
    let is_box = |at: Point2<f64>, x: f64| (x..x + 0.5).contains(&at.x) && (2.3..3.4).contains(&at.y);
    let map = map_where(spec(320, 80, 0.05), |at| {
        let boxes = [0.6, 3.9, 8.9, 10.6].iter().any(|x| is_box(at, *x));
        [0.5, 5.5, 10.5].iter().any(|x| is_room(at, *x)) || boxes
    });
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    localiser.lose();
    // Its lidar sees 120 degrees, never both sides at once. It turns from the left by the near side to the right.
    let mut found = None;
    for number in 0..13_u64 {
        let yaw = -std::f64::consts::PI + 0.25 * number as f64;
        let truth = Pose2::new(2.5, 2.0, yaw);
        let odometry = Pose2::new(0.0, 0.0, 0.25 * number as f64);
        let mut scan = look(&map, (1 + number) * 500_000_000, truth, odometry, Pose2::IDENTITY);
        for beam in (0..80).chain(160..240) {
            scan.ranges[beam] = f32::INFINITY;
        }
        // Meanwhile somebody hides all but the tenth part: that is no reason to forget the rest.
        let mut hidden = look(
            &map,
            (1 + number) * 500_000_000 - 200_000_000,
            truth,
            odometry,
            Pose2::IDENTITY,
        );
        for (beam, range) in hidden.ranges.iter_mut().enumerate() {
            *range = if (115..125).contains(&beam) { 0.5 } else { f32::INFINITY };
        }
        if number > 0 {
            assert!(!localiser.step(&hidden).unwrap().health.is_trusted());
        }
        let located = localiser.step(&scan).unwrap();
        if located.is_found_anew {
            found = Some((located.pose, truth));
            break;
        }
        assert!(!located.health.is_trusted());
    }
    assert!(found.is_some_and(|(pose, truth)| is_near(pose, truth)), "{found:?}");
}

#[test]
fn in_a_crowd_a_place_is_taken_once_a_later_search_or_another_view_confirms_it() {
    let map = house();
    // At rest, and while it turns.
    for (turn, searches) in [(0.0, 5), (0.05, 3)] {
        let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
        localiser.lose();
        let mut found = None;
        for nth in 0..30_u64 {
            let turned = Pose2::new(0.0, 0.0, turn * nth as f64);
            let truth = Pose2::new(6.5, 1.5, -1.0) * turned;
            let mut scan = look(&map, (1 + nth) * 100_000_000, truth, turned, Pose2::IDENTITY);
            for person in [20, 110, 190] {
                let hidden = scan.ranges.iter_mut().skip(person).take(15);
                hidden.for_each(|range| *range = range.min(0.8));
            }
            let located = localiser.step(&scan).unwrap();
            if located.is_found_anew {
                assert!(is_near(located.pose, truth), "{located:?} instead of {truth:?}");
                found = Some(nth);
                break;
            }
            assert_eq!(located.health, Health::Searching);
        }
        assert_eq!(found, Some(5 * (searches - 1)), "turning {turn} rad a scan");
    }
}

#[test]
fn a_lost_robot_that_is_carried_at_rest_forgets_what_it_saw_before() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let (before, after) = (Pose2::new(1.5, 2.5, 0.3), Pose2::new(1.5, 3.5, 0.3));
    localiser.lose();
    // So many people stand around it that a second search has to confirm the place.
    let mut first = look(&map, 100, before, Pose2::IDENTITY, Pose2::IDENTITY);
    for person in [20, 110, 190] {
        let hidden = first.ranges.iter_mut().skip(person).take(15);
        hidden.for_each(|range| *range = range.min(0.8));
    }
    assert_eq!(localiser.step(&first).unwrap().health, Health::Searching);
    let scan = look(&map, 500_000_100, after, Pose2::IDENTITY, Pose2::IDENTITY);
    let located = localiser.step(&scan).unwrap();
    assert!(located.is_found_anew && is_near(located.pose, after), "{located:?}");
}

#[test]
fn a_robot_that_was_carried_away_is_lost_at_once_and_found_again() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let first = Pose2::new(1.5, 2.5, 0.3);
    let second = 100_000_000;
    for number in 0..5 {
        let step = Pose2::new(0.05 * number as f64, 0.0, 0.0);
        let scan = look(&map, (number + 1) * second, first * step, step, first);
        assert!(localiser.step(&scan).unwrap().health.is_trusted());
    }
    // Odometry does not notice that the robot is carried.
    let elsewhere = Pose2::new(9.5, 6.0, 1.0);
    let (mut lost_after, mut found_after) = (None, None);
    for number in 0..30_u64 {
        let step = Pose2::new(0.05 * number as f64, 0.0, 0.0);
        let odometry = Pose2::new(0.2, 0.0, 0.0) * step;
        let truth = elsewhere * Pose2::new(0.02 * number as f64, 0.0, 0.0);
        let odometry = Pose2::new(odometry.x - 0.03 * number as f64, 0.0, 0.0);
        let located = localiser
            .step(&look(&map, (number + 6) * second, truth, odometry, first))
            .unwrap();
        if !located.health.is_trusted() {
            lost_after.get_or_insert(number);
        }
        if located.is_found_anew {
            assert!(is_near(located.pose, truth), "{located:?} instead of {truth:?}");
            found_after.get_or_insert(number);
        }
    }
    assert!(
        lost_after.is_some_and(|scans| scans < 10),
        "lost after {lost_after:?} scans"
    );
    assert!(
        found_after.is_some_and(|scans| scans < 30),
        "found after {found_after:?} scans"
    );
}

#[test]
fn a_robot_that_is_carried_away_at_rest_notices_and_is_found() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let (first, elsewhere) = (Pose2::new(1.5, 2.5, 0.3), Pose2::new(9.5, 6.0, 1.0));
    let look_from = |number: u64, truth: Pose2| look(&map, number * 100_000_000, truth, Pose2::IDENTITY, first);
    for number in 1..4 {
        assert!(localiser.step(&look_from(number, first)).unwrap().health.is_trusted());
    }
    let mut found = None;
    let mut was_lost = false;
    for number in 4..24 {
        let located = localiser.step(&look_from(number, elsewhere)).unwrap();
        was_lost |= !located.health.is_trusted();
        if located.is_found_anew {
            found = Some(located.pose);
        }
    }
    assert!(was_lost);
    assert!(found.is_some_and(|found| is_near(found, elsewhere)), "{found:?}");
}

#[test]
fn a_robot_is_searched_for_until_the_first_search_has_a_result_and_between_searches_it_is_lost() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let truth = Pose2::new(1.5, 2.5, 0.3);
    let at = |millis: u64| look(&map, millis * 1_000_000, truth, Pose2::IDENTITY, truth);
    let blind = |millis: u64| {
        let mut scan = at(millis);
        scan.ranges.fill(f32::INFINITY);
        scan
    };
    assert!(localiser.step(&at(100)).unwrap().health.is_trusted());
    localiser.lose();
    assert_eq!(*localiser.health(), Health::Searching);
    for millis in [200, 300, 600] {
        let located = localiser.step(&blind(millis)).unwrap();
        assert_eq!(
            (located.health, located.covariance),
            (Health::Lost, None),
            "{millis} ms"
        );
    }
    assert_eq!(
        localiser.step(&at(650)).unwrap().health,
        Health::Lost,
        "the next search is not due yet"
    );
    assert_eq!(localiser.step(&at(710)).unwrap().health, Health::Tracking);
    // Carried away: noticed with one scan, searched for with the next.
    let elsewhere = Pose2::new(9.5, 6.0, 1.0);
    let carried = (20..40).map(|nth| look(&map, nth * 100_000_000, elsewhere, Pose2::IDENTITY, truth));
    let health: Vec<Health> = carried.map(|scan| localiser.step(&scan).unwrap().health).collect();
    let noticed = health.iter().position(|health| !health.is_trusted()).unwrap();
    assert_eq!(health[noticed], Health::Searching, "{health:?}");
}

#[test]
fn a_robot_that_is_told_a_wrong_room_is_lost_and_found() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let (truth, told) = (Pose2::new(1.5, 2.5, 0.3), Pose2::new(8.5, 3.0, 2.0));
    let all = (1..20).map(|number| {
        let scan = look(&map, number * 100_000_000, truth, Pose2::IDENTITY, told);
        localiser.step(&scan).unwrap()
    });
    let found: Vec<_> = all.filter(|located| located.is_found_anew).collect();
    assert!(found.len() == 1 && is_near(found[0].pose, truth), "{found:?}");
}

#[test]
fn the_end_of_a_lane_shows_how_far_odometry_is_off_and_not_that_the_robot_was_carried_away() {
    // Two lanes of 24 m that look alike from either end.
    let map = walled_room(spec(480, 100, 0.05), |at| (2.45..2.55).contains(&at.y));
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let start = Pose2::new(1.0, 1.25, 0.0);
    for number in 0..720_u32 {
        let way = 0.03 * f64::from(number);
        let truth = start * Pose2::new(way, 0.0, 0.0);
        let odometry = Pose2::new(1.025 * way, 0.0, 0.0);
        let scan = look(&map, 100 + 100_000_000 * u64::from(number), truth, odometry, start);
        let located = localiser.step(&scan).unwrap();
        assert!(located.health.is_trusted(), "{way} m: {located:?}");
        if number == 719 {
            assert!(is_near(located.pose, truth), "{located:?} instead of {truth:?}");
        }
    }
}

#[test]
fn among_equal_bays_a_robot_that_lost_count_says_so() {
    // A lane whose walls have a box every 1.5 m, seen after 12 m without any: odometry may be off by more than a bay.
    let map = walled_room(spec(560, 60, 0.05), |at| {
        at.x > 14.0 && (at.x - 14.0) % 1.5 < 0.4 && !(0.5..2.5).contains(&at.y)
    });
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let start = Pose2::new(1.0, 1.5, 0.0);
    let mut was_sure = true;
    for number in 0..700_u32 {
        let way = 0.03 * f64::from(number);
        let truth = start * Pose2::new(way, 0.0, 0.0);
        let odometry = Pose2::new(1.05 * way, 0.0, 0.0);
        // A lidar of 3 m.
        let mut scan = look(&map, 100 + 100_000_000 * u64::from(number), truth, odometry, start);
        scan.ranges
            .iter_mut()
            .filter(|range| **range > 3.0)
            .for_each(|range| *range = f32::INFINITY);
        let located = localiser.step(&scan).unwrap();
        was_sure &= located.health.is_trusted();
        assert!(
            !was_sure || way < 15.0 || located.pose.distance(&truth) < 0.3,
            "{way} m: {located:?} instead of {truth:?}"
        );
    }
}

#[test]
fn a_house_whose_furniture_was_moved_is_still_that_house() {
    let map = house();
    // Two boxes are gone, a wall has another door, and something stands where nothing stood.
    let mut changed = map.clone();
    let inside =
        |at: Point2<f64>, x: [f64; 2], y: [f64; 2]| (x[0]..x[1]).contains(&at.x) && (y[0]..y[1]).contains(&at.y);
    for index in 0..changed.spec().len() {
        let cell = changed.spec().cell(index);
        let at = changed.spec().center(cell);
        if inside(at, [0.9, 1.9], [6.1, 7.1])
            || inside(at, [3.1, 4.3], [0.4, 1.0])
            || inside(at, [4.9, 5.2], [1.0, 2.0])
        {
            changed[cell] = Occupancy::FREE;
        }
        if inside(at, [2.2, 2.8], [4.6, 5.0]) || inside(at, [3.6, 4.0], [5.6, 6.2]) {
            changed[cell] = Occupancy::OCCUPIED;
        }
    }
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let guess = Pose2::new(1.0, 2.0, 0.6);
    for (number, (truth, odometry)) in drive().into_iter().enumerate() {
        let scan = look(&changed, 100 + 100_000_000 * number as u64, truth, odometry, guess);
        let located = localiser.step(&scan).unwrap();
        assert!(
            located.health.is_trusted() && !located.is_found_anew,
            "scan {number}: {located:?}"
        );
        assert!(
            located.pose.distance(&truth) < 0.1,
            "scan {number}: {located:?} instead of {truth:?}"
        );
    }
}

#[test]
fn a_robot_is_followed_through_furniture_that_is_gone() {
    let mut map = house();
    // Once a cupboard of 0.8 m stood where the robot drives: there all its beams pass walls.
    let changed = map.clone();
    for index in 0..map.spec().len() {
        let cell = map.spec().cell(index);
        let at = map.spec().center(cell);
        if (1.6..2.4).contains(&at.x) && (2.3..3.1).contains(&at.y) {
            map[cell] = Occupancy::OCCUPIED;
        }
    }
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let guess = Pose2::new(1.0, 2.0, 0.6);
    let mut through = 0.0_f64;
    for (number, (truth, odometry)) in drive().into_iter().enumerate() {
        let scan = look(&changed, 100 + 100_000_000 * number as u64, truth, odometry, guess);
        let located = localiser.step(&scan).unwrap();
        through = through.max(located.evidence.through_walls);
        assert!(
            located.health.is_trusted() && !located.is_found_anew && located.pose.distance(&truth) < 0.1,
            "scan {number}: {located:?} instead of {truth:?}"
        );
    }
    assert!(through > 0.9, "{through}");
}

/// Drives a robot straight on by 5 cm a scan, in this world and with this map; returns where it is, and what it is told.
fn straight_on(
    world: &OccupancyGrid,
    map: &OccupancyGrid,
    localiser: &mut Localiser,
    scans: u64,
) -> Vec<(Pose2, Located)> {
    assert_eq!(world.spec(), map.spec());
    let start = Pose2::new(0.6, 2.5, 0.0);
    let step = |number: u64| {
        let driven = Pose2::new(0.05 * number as f64, 0.0, 0.0);
        let scan = look(world, 100 + 100_000_000 * number, start * driven, driven, start);
        (start * driven, localiser.step(&scan).unwrap())
    };
    (0..scans).map(step).collect()
}

#[test]
fn a_robot_that_was_followed_well_is_followed_past_screens_that_hide_the_map() {
    let (map, mut world) = (house(), house());
    for index in 0..world.spec().len() {
        let cell = world.spec().cell(index);
        let at = world.spec().center(cell);
        if (2.4..4.7).contains(&at.x) && ((2.1..2.2).contains(&at.y) || (2.8..2.9).contains(&at.y)) {
            world[cell] = Occupancy::OCCUPIED;
        }
    }
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let told = straight_on(&world, &map, &mut localiser, 64);
    let contradicting = told
        .iter()
        .filter(|(_, located)| located.evidence.agreeing < 0.4)
        .count();
    let agreeing: Vec<f64> = told.iter().map(|(_, located)| located.evidence.agreeing).collect();
    assert!(contradicting > 5, "{agreeing:.2?}");
    for (truth, located) in told {
        assert!(
            located.health.is_trusted() && !located.is_found_anew && located.pose.distance(&truth) < 0.1,
            "{located:?} instead of {truth:?}"
        );
        // Such a match is no correction.
        assert!(
            located.evidence.agreeing >= 0.6 || located.covariance.is_none(),
            "{located:?}"
        );
    }
}

#[test]
fn a_robot_that_was_followed_well_and_is_carried_away_is_lost_all_the_same() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let told = straight_on(&map, &map, &mut localiser, 80);
    assert!(told.iter().all(|(_, located)| located.health.is_trusted()));
    let odometry = Pose2::new(0.05 * 79.0, 0.0, 0.0);
    let elsewhere = Pose2::new(9.5, 6.0, 1.0);
    let lost_after = (0..10).find(|number| {
        let scan = look(
            &map,
            100 + 100_000_000 * (80 + number),
            elsewhere,
            odometry,
            Pose2::IDENTITY,
        );
        !localiser.step(&scan).unwrap().health.is_trusted()
    });
    assert!(lost_after.is_some_and(|scans| scans < 5), "{lost_after:?}");
}

#[test]
fn people_who_walk_around_the_robot_neither_lose_it_nor_pull_it_along() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let guess = Pose2::new(1.0, 2.0, 0.6);
    for (number, (truth, odometry)) in drive().into_iter().enumerate() {
        let mut scan = look(&map, 100 + 100_000_000 * number as u64, truth, odometry, guess);
        // Three people, each as wide as 15 of the 240 beams.
        for person in [20, 110, 190] {
            let hidden = scan.ranges.iter_mut().skip(person + number % 20).take(15);
            hidden.for_each(|range| *range = range.min(0.8));
        }
        let located = localiser.step(&scan).unwrap();
        assert!(
            located.health.is_trusted() && !located.is_found_anew && located.pose.distance(&truth) < 0.1,
            "scan {number}: {located:?} instead of {truth:?}"
        );
    }
}

#[test]
fn rooms_that_the_map_does_not_know_are_no_contradiction_and_walls_in_the_way_are() {
    let mut map = house();
    let settings = LocalisationSettings::default();
    let truth = Pose2::new(4.0, 3.5, 0.0);
    let scan = look(&map, 1, truth, Pose2::IDENTITY, Pose2::IDENTITY);
    let seen = points(&scan, Pose2::IDENTITY, 0.1, &ScanSettings::default());
    for index in 0..map.spec().len() {
        let cell = map.spec().cell(index);
        if map.spec().center(cell).x > 5.2 {
            map[cell] = -1;
        }
    }
    let known = KnownMap::new(&map, settings.tracking.sigma);
    let weigh = |pose| evidence(&known, Point2::origin(), &seen, pose, &settings.evidence);
    let (right, wrong) = (weigh(truth), weigh(Pose2::new(2.0, 6.0, 1.0)));
    assert!(right.agreeing > 0.95 && right.points < seen.len(), "{right:?}");
    assert!(wrong.agreeing < 0.5 && wrong.through_walls > 0.1, "{wrong:?}");
}

#[test]
fn malformed_and_late_scans_change_nothing() {
    let map = house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    let truth = Pose2::new(1.5, 2.5, 0.3);
    let scan = look(&map, 10, truth, Pose2::IDENTITY, truth);
    assert!(localiser.step(&scan).is_some());
    assert_eq!(localiser.step(&scan), None);
    let mut malformed = look(&map, 11, truth, Pose2::IDENTITY, truth);
    malformed.odom_from_base.x = f64::NAN;
    assert_eq!(localiser.step(&malformed), None);
}

use zenav_protocol::messages::CoursePlace;
use zenav_protocol::robot::Footprint;
use zenav_space::UnknownPolicy;

use super::*;

const RADIUS: f64 = 0.3;

/// A hall of 10 m by 8 m.
fn hall(occupied: &[(u32, u32)]) -> ConfigurationSpace {
    let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(200, 160, 0.05), occupied);
    ConfigurationSpace::new(&grid, &Footprint::Radius(RADIUS), UnknownPolicy::Blocked, 0.0)
}

/// A robot at constant velocity from a place on, for 30 s.
fn course(from: [f64; 2], velocity: [f64; 2]) -> KnownCourse {
    let place = |secs: f64| CoursePlace {
        secs,
        x: from[0] + velocity[0] * secs,
        y: from[1] + velocity[1] * secs,
    };
    KnownCourse {
        radius: RADIUS,
        places: (0..=60).map(|nth| place(0.5 * f64::from(nth))).collect(),
    }
}

fn query(courses: &[KnownCourse]) -> SpaceTimeQuery<'_> {
    SpaceTimeQuery {
        start: Point2::new(1.0, 4.0),
        goal: Point2::new(9.0, 4.0),
        speed: 0.5,
        radius: RADIUS,
        courses,
    }
}

fn find(space: &ConfigurationSpace, courses: &[KnownCourse]) -> SpaceTimePath {
    search(space, &query(courses), &SpaceTimeSettings::default(), Budget::UNLIMITED).unwrap()
}

/// The least distance between the two centers at any one time, m.
fn nearest(path: &SpaceTimePath, course: &KnownCourse) -> f64 {
    let off = path.places.iter().map(|(secs, place)| {
        let there = pieces(course, *secs, secs + 1e-3).next();
        there.map_or(f64::INFINITY, |(at, _)| (at - place).norm())
    });
    off.fold(f64::INFINITY, f64::min)
}

#[test]
fn alone_it_goes_straight() {
    let path = find(&hall(&[]), &[]);
    assert!((path.arrival() - 16.0).abs() < 0.1, "{}", path.arrival());
    assert_eq!((path.waits, path.in_the_way), (0.0, 0.0));
}

#[test]
fn an_oncoming_robot_is_passed_at_a_distance() {
    let course = course([9.0, 4.0], [-0.5, 0.0]);
    let path = find(&hall(&[]), std::slice::from_ref(&course));
    assert!(nearest(&path, &course) > 2.0 * RADIUS + 0.3);
    assert!(path.arrival() < 19.0 && path.in_the_way == 0.0, "{path:?}");
}

#[test]
fn a_crossing_robot_is_passed_behind_or_waited_for_and_the_others_are_too() {
    let courses: Vec<KnownCourse> = (0..4)
        .map(|nth| course([5.0, 0.5 - f64::from(nth)], [0.0, 0.5]))
        .collect();
    let path = find(&hall(&[]), &courses);
    assert!(path.in_the_way == 0.0 && path.arrival() < 30.0, "{path:?}");
    for course in &courses {
        assert!(nearest(&path, course) > 2.0 * RADIUS + 0.3);
    }
}

#[test]
fn in_a_lane_it_waits_until_the_other_one_is_through() {
    // A wall with a gap of 1 m in the middle of the hall.
    let wall: Vec<(u32, u32)> = (0..160).filter(|y| !(70..90).contains(y)).map(|y| (100, y)).collect();
    let oncoming = course([8.0, 4.0], [-0.5, 0.0]);
    let path = find(&hall(&wall), std::slice::from_ref(&oncoming));
    assert!(path.in_the_way == 0.0 && path.arrival() > 18.0, "{path:?}");
    assert!(nearest(&path, &oncoming) > 2.0 * RADIUS + 0.3);
}

#[test]
fn who_stands_in_the_way_gets_out_of_it() {
    // Faster than this one, from behind.
    let course = course([-2.0, 4.0], [1.0, 0.0]);
    let path = find(&hall(&[]), std::slice::from_ref(&course));
    assert!(path.in_the_way < 3.0 && path.arrival() < 30.0, "{path:?}");
    assert!(nearest(&path, &course) > 2.0 * RADIUS, "it is run over");
}

#[test]
fn what_is_met_stands_beside_the_path_and_the_pulled_path_keeps_its_side() {
    let space = hall(&[]);
    let courses = [course([9.0, 4.0], [-0.5, 0.0])];
    let (settings, query) = (SpaceTimeSettings::default(), query(&courses));
    let path = find(&space, &courses);
    let discs = path.meets(&query, &settings, 0.1);
    assert!(!discs.is_empty());
    let line: Vec<Point2<f64>> = path.places.iter().map(|(_, place)| *place).collect();
    for (center, radius) in &discs {
        assert!(distance_to_line(*center, &line) >= radius + RADIUS + 0.1 - 1e-9);
    }
    let widest = |points: &[Point2<f64>]| {
        let side = |point: &Point2<f64>| point.y - 4.0;
        let widest = points.iter().max_by(|a, b| side(a).abs().total_cmp(&side(b).abs()));
        widest.map_or(0.0, side)
    };
    // With the discs marked the path is pulled taut on its side of them; without them it is straight.
    let marked: Vec<(u32, u32)> = (0..160)
        .flat_map(|y| (0..200).map(move |x| (x, y)))
        .filter(|(x, y)| {
            let at = Point2::new(0.05 * f64::from(*x) + 0.025, 0.05 * f64::from(*y) + 0.025);
            discs.iter().any(|(center, radius)| (at - center).norm() <= *radius)
        })
        .collect();
    let [marked, empty] = [hall(&marked), space].map(|space| pulled(&space, &path));
    assert!((marked[marked.len() - 1] - query.goal).norm() < 1e-9);
    assert!(widest(&line) * widest(&marked) > 0.0 && widest(&marked).abs() > 0.2);
    assert!(widest(&empty).abs() < 0.01);
}

#[test]
fn a_robot_known_at_one_time_alone_is_passed_at_a_distance_then() {
    let place = CoursePlace {
        secs: 8.0,
        x: 5.0,
        y: 4.0,
    };
    let course = KnownCourse {
        radius: RADIUS,
        places: vec![place],
    };
    let path = find(&hall(&[]), std::slice::from_ref(&course));
    let then = path.places.iter().filter(|(secs, _)| (7.0..8.5).contains(secs));
    let distances: Vec<f64> = then.map(|(_, at)| (at - place.at()).norm()).collect();
    assert!(!distances.is_empty() && distances.iter().all(|distance| *distance > 2.0 * RADIUS));
    assert!(path.arrival() < 20.0 && path.in_the_way == 0.0, "{path:?}");
}

#[test]
fn where_no_way_leads_there_is_none() {
    let wall: Vec<(u32, u32)> = (0..160).map(|y| (100, y)).collect();
    let found = search(
        &hall(&wall),
        &query(&[]),
        &SpaceTimeSettings::default(),
        Budget::UNLIMITED,
    );
    assert_eq!(found, None);
}

#[test]
fn a_goal_that_the_place_before_its_node_does_not_see_is_reached_over_the_node() {
    // Beside the last metre stands a post, 0.35 m from the row of nodes and 0.31 m from the straight line to the goal.
    let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(200, 160, 0.05), &[(177, 87)]);
    let space = ConfigurationSpace::new(&grid, &Footprint::Radius(0.32), UnknownPolicy::Blocked, 0.0);
    let query = SpaceTimeQuery {
        goal: Point2::new(9.09, 4.08),
        radius: 0.32,
        ..query(&[])
    };
    let path = search(&space, &query, &SpaceTimeSettings::default(), Budget::UNLIMITED).unwrap();
    let places: Vec<_> = path
        .places
        .iter()
        .map(|(_, place)| space.spec().to_cells(*place))
        .collect();
    assert!(places.windows(2).all(|leg| space.sees(leg[0], leg[1])), "{path:?}");
    let (_, end) = path.places[path.places.len() - 1];
    assert_eq!(end, query.goal);
    assert!(path.places.windows(2).all(|pair| pair[0].0 < pair[1].0));
}

#[test]
fn ends_off_the_map_and_speeds_that_are_none_have_no_path() {
    let space = hall(&[]);
    let good = query(&[]);
    let asked = |query: SpaceTimeQuery<'_>| search(&space, &query, &SpaceTimeSettings::default(), Budget::UNLIMITED);
    for bad in [f64::NAN, f64::INFINITY, -1.0, 1e300] {
        let place = Point2::new(bad, 4.0);
        assert_eq!(asked(SpaceTimeQuery { goal: place, ..good }), None);
        assert_eq!(asked(SpaceTimeQuery { start: place, ..good }), None);
    }
    for speed in [0.0, -0.5, f64::NAN] {
        assert_eq!(asked(SpaceTimeQuery { speed, ..good }), None);
    }
    assert!(asked(good).is_some());
    // Less than half a node away.
    let near = SpaceTimeQuery {
        goal: Point2::new(1.05, 4.0),
        ..good
    };
    let path = asked(near).unwrap();
    assert_eq!((path.places[0].1, path.places[1].1), (near.start, near.goal));
}

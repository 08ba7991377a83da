#![allow(clippy::unwrap_used, reason = "tests")]

use super::super::suites::{Suite, half_width};
use super::*;
use crate::files;
use zenav_sim::World;

/// A run in a world of 8 m by 4 m without outer walls, with `things` in it.
fn case(robot: &str, things: &str, [x, y, yaw]: [f64; 3], goal: [f64; 2]) -> Case {
    let mut case = Suite::S3
        .cases(&[robot.to_owned()], 0, Some(1), None)
        .unwrap()
        .swap_remove(0);
    let text = format!("size = [8, 4]\n[start]\nx = {x}\ny = {y}\nyaw = {yaw}\n{things}");
    case.world = World::from_toml(&text, "w", &|_| Err(String::new())).unwrap();
    (case.goal, case.timeout) = (goal.into(), 60.0);
    case
}

fn driven(anchor: Anchor, case: &Case) -> Driven {
    let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
    drive(anchor, case, &field, |_, _| {}).unwrap()
}

/// A wall across the world at 4 m with a gap of this width.
fn door(width: f64) -> String {
    let (low, high) = (2.03 - 0.5 * width, 2.03 + 0.5 * width);
    format!(
        "[[wall]]\nfrom = [4, 0]\nto = [4, {low}]\nthickness = 0.1\n[[wall]]\nfrom = [4, {high}]\nto = [4, 4]\nthickness = 0.1\n"
    )
}

/// A person on a path with rests, s.
fn person(speed: f64, path: &[[f64; 2]], rests: &[f64]) -> String {
    format!("[[mover]]\nradius = 0.25\nspeed = {speed}\npath = {path:?}\nrest_secs = {rests:?}\n")
}

#[test]
fn each_parks_within_the_tolerance_without_delay() {
    for robot in ["tiago", "turtlebot3_waffle"] {
        let case = case(robot, "", [2.5, 2.0, 2.5], [5.0, 2.5]);
        let straight = 2.5_f64.hypot(0.5) / case.model.drive.top_speed();
        for anchor in Anchor::ALL {
            let driven = driven(anchor, &case);
            assert!(
                driven.referee.is_reached(),
                "{anchor:?} {robot} {}",
                driven.referee.error()
            );
            assert!(
                driven.time_s < 1.3 * straight + 4.0,
                "{anchor:?} {robot} {}",
                driven.time_s
            );
        }
    }
}

#[test]
fn each_passes_a_door_20_cm_wider_than_the_robot() {
    for robot in ["tiago", "jackal"] {
        let width = 2.0 * half_width(&files::robot(robot).unwrap()) + 0.2;
        let case = case(robot, &door(width), [1.5, 1.2, 0.0], [6.5, 2.5]);
        // To ORCA a Jackal is a disc, wider than this door.
        let all = Anchor::ALL.into_iter();
        for anchor in all.filter(|anchor| robot == "tiago" || *anchor != Anchor::Orca) {
            let driven = driven(anchor, &case);
            let contacts = driven.referee.contacts();
            assert!(
                driven.referee.is_reached() && contacts.is_empty(),
                "{anchor:?} {robot} {contacts:?}"
            );
        }
    }
}

#[test]
fn each_goes_on_when_somebody_has_left_the_door() {
    let stander = person(1.0, &[[4.0, 2.03], [5.5, 2.03], [5.5, 0.5]], &[6.0, 0.0, 1e4]);
    let case = case("tiago", &(door(0.9) + &stander), [1.5, 2.0, 0.0], [6.5, 2.5]);
    for anchor in Anchor::ALL {
        let driven = driven(anchor, &case);
        assert!(
            driven.referee.is_reached() && driven.time_s < 30.0,
            "{anchor:?} {}",
            driven.time_s
        );
        assert!(driven.referee.own_contact().is_none(), "{anchor:?}");
    }
}

#[test]
fn each_goes_on_after_a_contact() {
    // Between a wall and a person who touches it at once: there is no room to avoid him.
    let (x, reach) = (1.3152, 0.265 + 0.25);
    let wall = "[[wall]]\nfrom = [1, 0]\nto = [1, 4]\nthickness = 0.1\n";
    let toucher = person(
        1.0,
        &[[x + reach + 3e-4, 2.0], [x + reach + 8e-5, 2.0], [4.0, 3.5]],
        &[0.0, 5.0, 1e4],
    );
    let case = case("tiago", &format!("{wall}{toucher}"), [x, 2.0, 0.0], [5.0, 2.0]);
    for anchor in Anchor::ALL {
        let driven = driven(anchor, &case);
        let contacts = driven.referee.contacts();
        let own = driven.referee.own_contact();
        assert!(!contacts.is_empty() && own.is_none(), "{anchor:?} {contacts:?}");
        assert!(
            driven.referee.is_reached() && driven.time_s < 30.0,
            "{anchor:?} {}",
            driven.time_s
        );
    }
}

#[test]
fn orca_passes_two_who_come_towards_it_and_make_way_too() {
    let oncoming = |y: f64| person(0.8, &[[7.0 + 0.5 * y, y], [0.6, y]], &[0.0, 1e4]) + "manners = \"orca\"\n";
    let case = case("tiago", &(oncoming(1.4) + &oncoming(2.2)), [1.0, 2.0, 0.0], [7.0, 2.2]);
    let driven = driven(Anchor::Orca, &case);
    let contacts = driven.referee.contacts();
    assert!(driven.referee.is_reached() && contacts.is_empty(), "{contacts:?}");
}

#[test]
fn the_way_leads_round_somebody_who_stands_and_through_him_in_the_only_door() {
    let cost = |things: &str| {
        let case = case("tiago", things, [1.5, 2.0, 0.0], [6.5, 2.03]);
        let field = Field::new(&case.world, case.model.footprint.inscribed_radius(), case.goal);
        let mut to_go = CostToGo::new(&case, &field);
        to_go.update([(Point2::new(4.0, 2.03), 0.25)]);
        to_go.at(Point2::new(3.0, 2.03))
    };
    let (open, shut) = (cost(""), cost(&door(0.9)));
    assert!((3.5..5.0).contains(&open), "{open}");
    assert!((15.0..35.0).contains(&shut), "{shut}");
}

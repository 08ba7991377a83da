//! Does a robot avoid people who ignore it? In lockstep, by the simulator's ground truth.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use zenav_tests::process::run;

const ZENAV: &str = env!("CARGO_BIN_EXE_zenav-under-test");

/// A room with walls at y = ±`half`, from x = -1 to 13, and people who walk back and forth.
fn room(half: f64, people: &[[f64; 5]]) -> String {
    let mut world = format!(
        "size = [15.0, {}]\norigin = [-1.5, {}]\n[start]\nx = 0.0\ny = 0.0\n",
        2.0 * half + 1.0,
        -half - 0.5
    );
    for [x1, y1, x2, y2] in [
        [-1.0, -half, 13.0, -half],
        [13.0, -half, 13.0, half],
        [13.0, half, -1.0, half],
        [-1.0, half, -1.0, -half],
    ] {
        world += &format!("[[wall]]\nfrom = [{x1:.2}, {y1:.2}]\nto = [{x2:.2}, {y2:.2}]\nthickness = 0.1\n");
    }
    for [x1, y1, x2, y2, speed] in people {
        world +=
            &format!("[[mover]]\nradius = 0.25\npath = [[{x1:.2}, {y1:.2}], [{x2:.2}, {y2:.2}]]\nspeed = {speed:.2}\n");
    }
    world
}

/// Outcome, contacts and time (s) of a drive to (11.5, 0).
fn drive(robot: &str, world: &str) -> (String, u64, f64) {
    drive_with("--goal 11.5 0 --tolerance 0.3 --timeout 60", robot, world)
}

/// The same with these options.
fn drive_with(options: &str, robot: &str, world: &str) -> (String, u64, f64) {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join("room.toml"), world).unwrap();
    let arguments = format!("run --world room.toml {options} -o json --robot {robot}");
    let arguments: Vec<&str> = arguments.split(' ').collect();
    let output = run(ZENAV, &arguments, folder.path(), Duration::from_secs(120));
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let (contacts, secs) = (
        report["collisions"].as_u64().unwrap(),
        report["time_s"].as_f64().unwrap(),
    );
    (report["outcome"].as_str().unwrap().to_owned(), contacts, secs)
}

#[test]
fn it_passes_people_who_cross_its_way() {
    let people = [[4.0, 4.2, 4.1, -4.4, 1.0], [7.0, -4.0, 7.0, 4.0, 0.8]];
    for robot in ["tiago", "jackal"] {
        let (outcome, contacts, secs) = drive(robot, &room(5.0, &people));
        assert!(
            outcome == "reached" && contacts == 0,
            "{robot}: {outcome}, {contacts} contacts, {secs} s"
        );
    }
}

#[test]
fn it_steps_aside_for_somebody_who_comes_along_the_middle_of_a_corridor() {
    for robot in ["tiago", "jackal"] {
        let (outcome, contacts, secs) = drive(robot, &room(1.5, &[[9.0, -0.1, -0.4, -0.2, 0.9]]));
        assert!(
            outcome == "reached" && contacts == 0,
            "{robot}: {outcome}, {contacts} contacts, {secs} s"
        );
    }
}

#[test]
fn it_waits_for_somebody_who_stands_at_its_goal_and_does_not_go_round_them() {
    // The near side of the person hides the goal, and the floor behind looks free.
    let mut world = room(2.5, &[[5.5, 0.0, 5.5, -1.9, 0.8]]);
    world += "rest_secs = [22.0, 10000.0]\n";
    let options = "--goal 5.5 0 --timeout 90 --poses slam --seed 1";
    for robot in ["tiago", "neato", "turtlebot3_waffle", "jackal"] {
        let (outcome, contacts, secs) = drive_with(options, robot, &world);
        assert!(
            outcome == "reached" && contacts == 0 && secs > 22.0,
            "{robot}: {outcome}, {contacts} contacts, {secs} s"
        );
    }
}

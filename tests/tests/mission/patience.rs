//! Obstacles that may leave are waited for; those that stay are not.

use zenav_protocol::messages::{GoalPhase, GoalRequest};

use super::rig::Rig;

/// Two rooms, from (0, 0) to (6.4, 5), with a door 0.9 m wide at (4, 2.5) between them; the robot starts at (1, 2.5), from where its lidar
/// reaches the last wall.
const ROOMS: &str = "size = [6.8, 5.4]\norigin = [-0.2, -0.2]\n[start]\nx = 1\ny = 2.5\n\
    [[wall]]\nfrom = [-0.1, -0.1]\nto = [6.5, -0.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [-0.1, 5.1]\nto = [6.5, 5.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [-0.1, -0.1]\nto = [-0.1, 5.1]\nthickness = 0.2\n\
    [[wall]]\nfrom = [6.5, -0.1]\nto = [6.5, 5.1]\nthickness = 0.2\n\
    [[polygon]]\npoints = [[3.9, 0], [4.1, 0], [4.1, 2.05], [3.9, 2.05]]\n\
    [[polygon]]\npoints = [[3.9, 2.95], [4.1, 2.95], [4.1, 5], [3.9, 5]]\n";

/// A person who stands at a place for some time, and then leaves.
fn somebody(x: f64, y: f64, secs: f64) -> String {
    format!(
        "[[mover]]\nradius = 0.25\nspeed = 0.8\npath = [[{x:.2}, {y:.2}], [{x:.2}, 0.6], [6.0, 0.6]]\nrest_secs = [{secs}, 0, 10000]\n"
    )
}

/// Two halls, from (0, 0) to (20, 5), with a door 0.9 m wide at (4, 2.5) between them, and another opening from x = `other` to `end`. The
/// robot starts at (2, 1.2), with somebody in the door who goes away after some time.
fn halls(other: f64, end: f64, secs: f64) -> String {
    let wall = |from: [f64; 2], to: [f64; 2]| format!("[[wall]]\nfrom = {from:?}\nto = {to:?}\nthickness = 0.2\n");
    let wall_between = |from: f64, to: f64| {
        format!("[[polygon]]\npoints = [[{from:.2}, 2.4], [{to:.2}, 2.4], [{to:.2}, 2.6], [{from:.2}, 2.6]]\n")
    };
    let walls = [
        wall([-0.1, -0.1], [20.1, -0.1]),
        wall([-0.1, 5.1], [20.1, 5.1]),
        wall([-0.1, -0.1], [-0.1, 5.1]),
        wall([20.1, -0.1], [20.1, 5.1]),
        wall_between(0.0, 3.55),
        wall_between(4.45, other),
        wall_between(end, 20.0),
    ]
    .concat();
    let person = format!(
        "[[mover]]\nradius = 0.25\nspeed = 0.8\npath = [[4, 2.5], [4, 4], [9, 4.4]]\nrest_secs = [{secs:.1}, 0, 10000]\n"
    );
    format!("size = [20.4, 5.4]\norigin = [-0.2, -0.2]\n[start]\nx = 2\ny = 1.2\n{walls}{person}")
}

/// A corridor along the x axis, 5 m wide, with a door 0.9 m wide at its end, (8, 2.5). The way round leads through an opening at its other
/// end, (-7.8, 5), and back along another corridor. The robot starts at (3, 2.5). Somebody comes into the door 2.5 s later, stands there for
/// some time, and leaves.
fn somebody_comes(secs: f64) -> String {
    let walls = [
        ([-9.1, -0.1], [12.1, -0.1]),
        ([-9.1, 8.1], [12.1, 8.1]),
        ([-9.1, -0.1], [-9.1, 8.1]),
        ([12.1, -0.1], [12.1, 8.1]),
    ];
    let walls = walls.map(|(from, to)| format!("[[wall]]\nfrom = {from:?}\nto = {to:?}\nthickness = 0.2\n"));
    let between = [
        ([7.9, 8.1], [0.0, 2.05]),
        ([7.9, 8.1], [2.95, 5.1]),
        ([-6.5, 8.1], [4.9, 5.1]),
    ];
    let between = between.map(|([left, right], [low, high])| {
        format!(
            "[[polygon]]\npoints = [[{left}, {low:.2}], [{right}, {low:.2}], [{right}, {high}], [{left}, {high}]]\n"
        )
    });
    format!(
        "size = [21.4, 8.4]\norigin = [-9.2, -0.2]\n[start]\nx = 3\ny = 2.5\n{}{}[[mover]]\nradius = 0.25\nspeed = 0.8\n\
        path = [[8.9, 3.6], [8.9, 2.5], [8, 2.5], [8.9, 2.5], [8.9, 4.8]]\nrest_secs = [0, 0, {secs:.1}, 0, 10000]\n",
        walls.concat(),
        between.concat()
    )
}

/// A tree that replans while driving, and has no recovery.
const REPLANS: &str = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><PipelineSequence>
    <RateController hz="1.0"><ComputePathToPose goal="{goal}" path="{path}"/></RateController>
    <FollowPath path="{path}"/></PipelineSequence></BehaviorTree></root>"#;

fn to(x: f64, y: f64) -> GoalRequest {
    GoalRequest {
        id: Some("a".to_owned()),
        x: Some(x),
        y: Some(y),
        ..GoalRequest::default()
    }
}

#[test]
fn somebody_in_the_only_door_is_waited_for_and_the_robot_sets_out_at_once() {
    let door = "[[mover]]\nradius = 0.25\nspeed = 0.8\npath = [[4, 2.5], [5.5, 2.5], [5.5, 0.6]]\nrest_secs = [25, 0, 10000]\n";
    let mut rig = Rig::in_world(&format!("{ROOMS}{door}"));
    rig.submit(to(5.5, 2.5)).unwrap();
    rig.run_until(10.0, |rig| rig.goal("a").feedback.blockage.is_some());
    rig.run(1.0);
    let feedback = rig.goal("a").feedback.clone();
    let blockage = feedback.blockage.unwrap_or_else(|| panic!("{feedback:?}"));
    assert!((blockage.x - 4.0).hypot(blockage.y - 2.5) < 0.5, "{blockage:?}");
    assert!(feedback.step.contains("waits for what has stood at"), "{feedback:?}");
    rig.run_until(30.0, |rig| rig.stage.now().as_secs() >= 25.0);
    assert!(rig.is_at_rest());
    // One second to step out of the door.
    assert!(
        rig.run_until(3.0, |rig| !rig.is_at_rest()),
        "{:?}",
        rig.goal("a").feedback
    );
    let goal = rig.success_of("a", 40.0);
    assert_eq!(goal.feedback.blockage, None);
}

#[test]
fn a_goal_that_is_taken_is_waited_for_and_given_up_with_who_stands_there_for_how_long() {
    let world = format!("{ROOMS}{}", somebody(2.8, 3.5, 10_000.0));
    let mut rig = Rig::in_world(&world);
    rig.config.settings.patience = 20.0;
    rig.start();
    rig.run(2.0);
    rig.submit(to(2.8, 3.5)).unwrap();
    let goal = rig.end_of("a", 60.0);
    assert_eq!(goal.state, GoalPhase::Aborted);
    let reason = goal.reason.unwrap();
    assert!(
        reason.contains("the goal (2.80, 3.50) is occupied") && reason.contains("has stood at (2."),
        "{reason}"
    );
    let secs = rig.stage.now().as_secs();
    assert!((20.0..30.0).contains(&secs), "{secs} s");
}

#[test]
fn a_deadline_ends_the_waiting_and_tells_what_was_waited_for() {
    let world = format!("{ROOMS}{}", somebody(2.8, 3.5, 10_000.0));
    let mut rig = Rig::in_world(&world);
    rig.run(2.0);
    let request = GoalRequest {
        deadline_secs: Some(10.0),
        ..to(2.8, 3.5)
    };
    rig.submit(request).unwrap();
    let reason = rig.end_of("a", 20.0).reason.unwrap();
    assert!(
        reason.contains("deadline of 10 s: something that may leave has stood at (2."),
        "{reason}"
    );
}

#[test]
fn a_deadline_after_the_usual_patience_is_waited_for() {
    let world = format!("{ROOMS}{}", somebody(2.8, 3.5, 30.0));
    let mut rig = Rig::in_world(&world);
    rig.config.settings.patience = 10.0;
    rig.start();
    rig.run(2.0);
    let request = GoalRequest {
        deadline_secs: Some(60.0),
        ..to(2.8, 3.5)
    };
    rig.submit(request).unwrap();
    rig.success_of("a", 60.0);
}

#[test]
fn a_short_way_round_is_driven_at_once() {
    let mut rig = Rig::in_world(&halls(5.2, 6.4, 10_000.0));
    rig.submit(to(2.0, 3.8)).unwrap();
    let waits = rig.run_until(25.0, |rig| {
        rig.goal("a").feedback.blockage.is_some() || rig.phase("a").is_end()
    });
    assert!(waits && rig.phase("a") == GoalPhase::Succeeded, "{:?}", rig.goal("a"));
}

#[test]
fn somebody_who_comes_into_the_door_on_the_way_is_waited_for_where_the_way_round_is_long() {
    for tree in ["navigate", "navigate_with_recovery", REPLANS] {
        let mut rig = Rig::in_world(&somebody_comes(8.0));
        let goal = GoalRequest {
            tree: Some(tree.to_owned()),
            ..to(10.0, 2.5)
        };
        rig.submit(goal).unwrap();
        let waits = rig.run_until(12.0, |rig| rig.goal("a").feedback.blockage.is_some());
        assert!(waits, "{tree}: {:?} {:?}", rig.pose(), rig.goal("a").feedback);
        rig.success_of("a", 40.0);
        assert!(rig.driven() < 8.0, "{tree}: {} m", rig.driven());
    }
}

#[test]
fn who_comes_into_the_door_and_stays_is_waited_for_at_a_distance_and_then_driven_round() {
    let mut rig = Rig::in_world(&somebody_comes(10_000.0));
    rig.submit(to(10.0, 2.5)).unwrap();
    let waits = rig.run_until(12.0, |rig| rig.goal("a").feedback.blockage.is_some());
    assert!(waits, "{:?} {:?}", rig.pose(), rig.goal("a").feedback);
    let nearest = rig.success_past("a", 200.0, &[(8.0, 2.5)])[0];
    // 0.25 m of the person, 0.27 m of the robot, and 0.5 m between them.
    assert!(nearest > 0.9, "{nearest} m");
    let feedback = &rig.goal("a").feedback;
    assert!(feedback.recoveries == 0 && rig.driven() > 30.0, "{feedback:?}");
}

#[test]
fn who_is_out_of_sight_in_the_door_is_driven_to_and_waited_for_there() {
    let mut rig = Rig::in_world(&somebody_comes(24.0));
    // From the first place the robot sees who stands in the door, from the second one it does not.
    for (id, x) in [("near", 5.0), ("away", 2.5)] {
        let goal = GoalRequest {
            id: Some(id.to_owned()),
            ..to(x, 2.5)
        };
        rig.submit(goal).unwrap();
        rig.success_of(id, 20.0);
        rig.run(1.0);
    }
    rig.submit(to(10.0, 2.5)).unwrap();
    rig.success_of("a", 60.0);
    assert!(rig.driven() < 14.0, "{} m", rig.driven());
}

#[test]
fn a_stop_that_the_tree_adds_is_driven_to_while_somebody_is_waited_for() {
    let tree = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Parallel success_count="2" failure_count="1">
        <Sequence><ComputePathToPose goal="{goal}" path="{path}"/><FollowPath path="{path}"/></Sequence>
        <Delay delay_msec="6000"><ComputePathThroughPoses goals="5;0.8|10;2.5" path="{path}"/></Delay>
        </Parallel></BehaviorTree></root>"#;
    let mut rig = Rig::in_world(&somebody_comes(10_000.0));
    let goal = GoalRequest {
        tree: Some(tree.to_owned()),
        ..to(10.0, 2.5)
    };
    rig.submit(goal).unwrap();
    let stops = rig.run_until(30.0, |rig| rig.distance(5.0, 0.8) < 0.3);
    assert!(stops, "{:?} {:?}", rig.pose(), rig.goal("a").feedback);
}

#[test]
fn a_robot_on_the_way_round_turns_back_when_the_short_way_is_free() {
    let mut rig = Rig::in_world(&halls(11.0, 12.5, 33.0));
    rig.submit(to(2.0, 3.8)).unwrap();
    assert!(rig.run_until(39.0, |rig| rig.pose().x > 6.0), "{:?}", rig.pose());
    rig.success_of("a", 40.0);
    assert!(rig.driven() < 25.0, "{} m", rig.driven());
}

#[test]
fn a_door_that_shuts_in_its_face_is_waited_for_by_nav2_s_tree_too() {
    let door =
        "[[door]]\nfrom = [4, 2.05]\nto = [4, 2.95]\nthickness = 0.1\nclosed_secs = 8\nopen_secs = 4\nslide_secs = 1\n";
    let mut rig = Rig::in_world(&format!("{ROOMS}{door}"));
    let goal = GoalRequest {
        tree: Some("navigate_with_recovery".to_owned()),
        ..to(5.5, 2.5)
    };
    // The robot has seen the door open, and shut again.
    rig.run(15.0);
    rig.submit(goal).unwrap();
    rig.run(1.0);
    let feedback = rig.goal("a").feedback.clone();
    assert!(feedback.blockage.is_some(), "{feedback:?}");
    rig.success_of("a", 60.0);
}

#[test]
fn a_door_that_shut_and_is_out_of_sight_is_driven_to() {
    // A hall before the door: from its far end the lidar cannot see the door.
    let hall = ROOMS
        .replace(
            "size = [6.8, 5.4]\norigin = [-0.2, -0.2]",
            "size = [13.8, 5.4]\norigin = [-7.2, -0.2]",
        )
        .replace("from = [-0.1, ", "from = [-7.1, ")
        .replace("to = [-0.1, 5.1]", "to = [-7.1, 5.1]");
    let door = "[[door]]\nfrom = [4, 2.05]\nto = [4, 2.95]\nthickness = 0.1\nclosed_secs = 30\nopen_secs = 10\nslide_secs = 1\n";
    let mut rig = Rig::in_world(&format!("{hall}{door}"));
    // The robot has seen the door open, and shut again.
    rig.run(46.0);
    let away = GoalRequest {
        id: Some("away".to_owned()),
        ..to(-6.0, 2.5)
    };
    rig.submit(away).unwrap();
    rig.success_of("away", 30.0);
    rig.submit(to(5.5, 2.5)).unwrap();
    assert!(
        rig.run_until(10.0, |rig| rig.goal("a").feedback.blockage.is_some()),
        "{:?}",
        rig.goal("a").feedback
    );
    assert!(
        rig.run_until(20.0, |rig| !rig.is_at_rest()),
        "{:?}",
        rig.goal("a").feedback
    );
    rig.success_of("a", 90.0);
}

#[test]
fn a_room_without_a_door_is_not_waited_for() {
    let mut rig = Rig::in_world(&format!(
        "{ROOMS}[[polygon]]\npoints = [[3.9, 2.05], [4.1, 2.05], [4.1, 2.95], [3.9, 2.95]]\n"
    ));
    rig.run(2.0);
    let refused = rig.submit(to(5.5, 2.5)).unwrap_err().to_string();
    assert!(refused.contains("(5.50, 2.50) cannot be reached"), "{refused}");
}

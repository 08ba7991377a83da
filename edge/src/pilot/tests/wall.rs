//! Claims about wall following and return to home, driven in closed loop in a square room.

#![allow(clippy::unwrap_used, reason = "tests")]

use zenav_protocol::messages::{
    EventKind, LeaseAction, LeaseRequest, LeaseRole, LostPolicy, Mode, ModeRequest, ParamRequest, Refusal,
    ResumeRequest, StopRequest, WallFollowerState,
};

use super::by_hand;
use super::rig::{ROOM, Rig};
use zenav_protocol::topics::{EdgeReply, EdgeRequest};

use crate::control_io::Persisted;

/// A robot without a lease holder whose policy is to follow walls.
fn left_alone() -> (Rig, u64) {
    let (mut rig, epoch) = commanded(LostPolicy::WallFollow);
    rig.heartbeat = None;
    rig.run(3.5);
    (rig, epoch)
}

/// A robot of this policy that a mission commands.
fn commanded(policy: LostPolicy) -> (Rig, u64) {
    let mut model = zenav_fixtures::robot("tiago");
    // Enough beams for walls, and quick; it also sees where it backs up to.
    let lidar = model.lidar.as_mut().unwrap();
    (lidar.beams, lidar.field_of_view) = (180, std::f64::consts::TAU);
    let mut rig = Rig::of(model, Persisted::default());
    let epoch = rig.mission();
    rig.ask(EdgeRequest::Mode(ModeRequest {
        on_lost: Some(policy),
        epoch: Some(epoch),
    }))
    .unwrap();
    (rig, epoch)
}

fn state(rig: &Rig) -> Option<WallFollowerState> {
    rig.state.as_ref().unwrap().wall_follower
}

fn transitions(rig: &Rig) -> Vec<(String, String)> {
    let of = |event: &EventKind| match event {
        EventKind::Transition { from, to, .. } => Some((from.clone(), to.clone())),
        _ => None,
    };
    rig.events.iter().filter_map(of).collect()
}

/// Distance to the nearest wall of the room, m.
fn distance(rig: &Rig) -> f64 {
    ROOM - rig.pose.x.abs().max(rig.pose.y.abs())
}

/// The operator takes the lease; returns its epoch.
fn operator(rig: &mut Rig, request_id: &str) -> u64 {
    rig.lease("hand", LeaseRole::Operator, request_id).unwrap()
}

fn give_back(rig: &mut Rig) {
    rig.ask(EdgeRequest::Lease(LeaseRequest::new(
        "hand",
        LeaseRole::Operator,
        LeaseAction::Release,
        format!("back-{:?}", rig.now),
    )))
    .unwrap();
}

#[test]
fn it_searches_approaches_turns_and_follows_at_its_distance() {
    let (mut rig, _) = left_alone();
    let target = rig.model.wall_following.target_distance;
    rig.run(35.0);
    assert_eq!(
        state(&rig),
        Some(WallFollowerState::WallFollow),
        "{:?}",
        transitions(&rig)
    );
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::WallFollow);
    let begun = transitions(&rig);
    let names: Vec<_> = begun.iter().map(|(from, to)| (from.as_str(), to.as_str())).collect();
    assert_eq!(
        names[..3],
        [
            ("wall_search", "approach"),
            ("approach", "turn"),
            ("turn", "wall_follow")
        ]
    );
    assert!((distance(&rig) - target).abs() < 0.02, "{:?}", rig.pose);
    for name in ["wall", "target_line"] {
        let marker = rig.markers.iter().rev().find(|marker| marker.name == name).unwrap();
        assert_eq!(marker.points.len(), 2, "{name}");
        let off = ROOM - marker.points[0].x.abs().max(marker.points[0].y.abs());
        let expected = if name == "wall" { 0.0 } else { target };
        assert!((off - expected).abs() < 0.02, "{name}: {:?}", marker.points);
    }
}

#[test]
fn its_distance_can_be_changed_while_it_follows_and_nonsense_changes_nothing() {
    let (mut rig, _) = left_alone();
    // Setting a parameter needs the lease.
    let epoch = operator(&mut rig, "p");
    let mut set = |name: &str, value| {
        rig.ask(EdgeRequest::Param(ParamRequest {
            name: Some(name.into()),
            value: Some(value),
            epoch: Some(epoch),
        }))
    };
    assert!(
        matches!(set("target_distance", 0.1), Err(Refusal::Rejected { reason, .. }) if reason.contains("target_distance"))
    );
    assert!(matches!(
        set("target_distance", f64::NAN),
        Err(Refusal::Rejected { .. })
    ));
    assert!(matches!(set("wall_min_points", 2.5), Err(Refusal::Rejected { .. })));
    let Ok(EdgeReply::Param(reply)) = set("target_distance", 0.75) else {
        panic!()
    };
    assert_eq!(reply.params["target_distance"], 0.75);
    give_back(&mut rig);
    rig.run(45.0);
    assert_eq!(state(&rig), Some(WallFollowerState::WallFollow));
    assert!((distance(&rig) - 0.75).abs() < 0.03, "{:?}", rig.pose);
}

#[test]
fn an_operator_stops_it_at_once_and_gives_it_back() {
    let (mut rig, _) = left_alone();
    rig.run(10.0);
    assert!(!rig.at_rest());
    operator(&mut rig, "o");
    rig.run(1.0);
    assert!(rig.at_rest() && rig.state.as_ref().unwrap().mode == Mode::Teleop);
    give_back(&mut rig);
    rig.run(1.0);
    assert!(!rig.at_rest() && rig.state.as_ref().unwrap().mode == Mode::WallFollow);
}

#[test]
fn a_bump_from_anywhere_is_left_only_by_an_operator_who_drives_away() {
    for secs in [0.5, 8.0, 25.0] {
        let (mut rig, _) = left_alone();
        rig.run(secs);
        rig.bump = Some(0.3);
        rig.run(1.0);
        assert_eq!(state(&rig), Some(WallFollowerState::Bump), "after {secs} s");
        assert!(rig.at_rest());
        // Neither time nor a released bumper frees it.
        rig.bump = None;
        rig.run(5.0);
        assert!(rig.at_rest() && state(&rig) == Some(WallFollowerState::Bump));
        let epoch = operator(&mut rig, "o");
        rig.run(0.2);
        by_hand(&mut rig, epoch, 0.1, 1.5);
        assert_eq!(state(&rig), Some(WallFollowerState::Bump), "towards the obstacle");
        by_hand(&mut rig, epoch, -0.2, 4.0);
        assert_eq!(
            state(&rig),
            Some(WallFollowerState::WallSearch),
            "after {secs} s: {:?}",
            rig.pose
        );
        give_back(&mut rig);
        rig.run(1.0);
        assert!(!rig.at_rest());
    }
}

#[test]
fn a_stop_by_hand_holds_it_until_it_is_resumed() {
    let (mut rig, _) = left_alone();
    rig.run(10.0);
    rig.ask(EdgeRequest::Stop(StopRequest::default())).unwrap();
    rig.run(5.0);
    assert!(rig.at_rest() && rig.state.as_ref().unwrap().mode == Mode::Stopped);
    rig.ask(EdgeRequest::Resume(ResumeRequest::default())).unwrap();
    rig.run(1.0);
    assert!(!rig.at_rest());
}

#[test]
fn a_robot_that_lost_everybody_goes_home_the_way_it_came_and_rests_there() {
    let (mut rig, _) = commanded(LostPolicy::ReturnHome);
    let hand = operator(&mut rig, "1");
    by_hand(&mut rig, hand, 0.4, 3.0);
    let out = rig.pose;
    assert!(out.x > 0.8, "{out:?}");
    rig.run(2.0);
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::Idle, "the link is not lost yet");
    rig.run(4.0);
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::ReturnHome);
    rig.run(20.0);
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::Idle);
    assert!(rig.pose.position().coords.norm() < 0.3, "{:?}", rig.pose);
    let there = rig.pose;
    rig.run(5.0);
    assert!((rig.pose.position() - there.position()).norm() < 0.02, "it rests");
}

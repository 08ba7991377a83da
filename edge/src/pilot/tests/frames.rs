//! A map that moves under a robot.

use nalgebra::Matrix3;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{BasedOn, Correction, MapRef, Plan, Revision};

use super::rig::Rig;
use crate::control_io::{Outbox, Persisted, Publication};

/// A robot without a compass that has just begun to drive four metres ahead.
fn driving() -> (Rig, u64, Plan) {
    let mut model = zenav_fixtures::robot("tiago");
    model.lidar.as_mut().unwrap().field_of_view = std::f64::consts::TAU;
    model.imu.compass_noise = None;
    let mut rig = Rig::of(model, Persisted::default());
    let epoch = rig.mission();
    let plan = rig.ahead(epoch, 1, 7, 4.0);
    rig.send(plan.clone());
    rig.run(2.0);
    assert!(rig.velocity.v > 0.3, "{:?}", rig.velocity);
    (rig, epoch, plan)
}

/// The move of the map.
const MOVE: Pose2 = Pose2 {
    x: 0.8,
    y: -0.6,
    yaw: 0.2,
};

/// A frame that mapping cannot have reached since the last one.
const FAR: u64 = u64::MAX - 1;

/// A correction from mapping: the robot's pose in a frame, and the moves that led to that frame.
fn say(rig: &mut Rig, map_from_base: Pose2, frame: u64, moves: &[Pose2]) {
    rig.inbox.corrections.push(Correction {
        stamp: rig.now,
        boot_id: "boot-1".into(),
        map_from_base,
        covariance: std::array::from_fn(|index| Matrix3::from_diagonal(&[1e-3, 1e-3, 1e-4].into())[index]),
        is_found_anew: frame == FAR,
        frame,
        moves: moves.to_vec(),
    });
}

/// The pose that the robot announces to others in a tick, if it does.
fn announced(out: &Outbox) -> Option<Pose2> {
    out.publications.iter().find_map(|publication| match publication {
        Publication::Intent(intent) => Some(intent.map_from_base),
        _ => None,
    })
}

#[test]
fn a_map_that_moves_moves_belief_and_plan_with_it_and_nothing_else() {
    let (mut rig, ..) = driving();
    let here = rig.pilot.map_from_base();
    say(&mut rig, here, 0, &[]);
    rig.run(0.2);
    let (before, speed) = (rig.pilot.map_from_base(), rig.velocity.v);
    say(&mut rig, MOVE * before, 1, &[MOVE]);
    rig.tick();
    let after = rig.pilot.map_from_base();
    assert!(after.distance(&(MOVE * before)) < 0.05, "{after:?} after {before:?}");
    let mut slowest = f64::INFINITY;
    for _ in 0..50 {
        rig.tick();
        slowest = slowest.min(rig.velocity.v);
        assert!(rig.velocity.w.abs() < 0.05, "it twitches: {:?}", rig.velocity);
    }
    assert!(slowest > 0.9 * speed, "{slowest} after {speed}");
    assert_eq!(rig.rejection(), None);
}

#[test]
fn a_robot_whose_map_moves_announces_its_course_at_once() {
    let (mut rig, ..) = driving();
    let here = rig.pilot.map_from_base();
    say(&mut rig, here, 0, &[]);
    rig.tick();
    // The next announcement would be due a period after this one.
    assert!((0..50).any(|_| announced(&rig.tick()).is_some()));
    let before = rig.pilot.map_from_base();
    say(&mut rig, MOVE * before, 1, &[MOVE]);
    let told = announced(&rig.tick());
    assert!(
        told.is_some_and(|told| told.distance(&(MOVE * before)) < 0.05),
        "{told:?}"
    );
    assert_eq!(announced(&rig.tick()), None, "and then a period later again");
}

#[test]
fn a_correction_of_an_older_frame_or_of_one_that_cannot_be_reached_does_nothing() {
    let (mut rig, ..) = driving();
    let here = rig.pilot.map_from_base();
    say(&mut rig, here, 3, &[]);
    rig.tick();
    for (frame, moves) in [
        (2, vec![]),
        (5, vec![MOVE]),
        (4, vec![]),
        (u64::MAX, vec![MOVE; 16]),
        // Even where the robot is found anew: no later frame could follow.
        (FAR, vec![]),
        (4, vec![Pose2 { x: f64::NAN, ..MOVE }]),
    ] {
        let before = rig.pilot.map_from_base();
        let near = Pose2::new(before.x, before.y + 0.1, before.yaw);
        say(&mut rig, near, frame, &moves);
        rig.tick();
        let after = rig.pilot.map_from_base();
        assert!(
            (after.y - before.y).abs() < 0.005,
            "frame {frame}: {before:?}, {after:?}"
        );
    }
}

#[test]
fn a_plan_of_another_frame_is_carried_over_where_the_way_there_is_known_and_refused_where_it_is_not() {
    let (mut rig, epoch, plan) = driving();
    let here = rig.pilot.map_from_base();
    say(&mut rig, here, 1, &[]);
    rig.tick();
    let here = rig.pilot.map_from_base();
    say(&mut rig, MOVE * here, 2, &[MOVE]);
    rig.tick();
    let of_frame = |plan: &Plan, frame: u64, counter: u64, stamp| Plan {
        map: MapRef {
            frame,
            ..plan.map.clone()
        },
        based_on: BasedOn {
            stamp,
            ..plan.based_on.clone()
        },
        revision: Revision {
            incarnation: plan.revision.incarnation,
            counter,
        },
        ..plan.clone()
    };
    // The robot keeps driving its earlier plan: the mission renews it unchanged.
    let renewed = of_frame(&plan, plan.map.frame, 2, rig.now);
    rig.send(renewed);
    assert_eq!(rig.rejection(), None);
    for (frame, counter) in [(0, 3), (3, 4)] {
        let strange = of_frame(&rig.ahead(epoch, counter, 20 + frame, 1.0), frame, counter, rig.now);
        rig.send(strange);
        assert!(
            rig.rejection().is_some_and(|reason| reason.starts_with("OldFrame")),
            "{:?}",
            rig.rejection()
        );
    }
    rig.events.clear();
    rig.run(5.2);
    assert!(rig.at_rest(), "{:?}", rig.velocity);
    // A plan made in the previous frame, from the robot's pose in that frame, is carried over.
    let before = of_frame(&rig.ahead(epoch, 5, 30, 1.0), 1, 5, rig.now);
    rig.send(before);
    assert_eq!(rig.rejection(), None);
}

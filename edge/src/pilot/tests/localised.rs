//! A robot that does not know where it is.

use nalgebra::Matrix3;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{
    BasedOn, Correction, EventKind, Health, Localisation, LostPolicy, ModeRequest, Plan, Revision,
};
use zenav_protocol::topics::EdgeRequest;

use super::driving;
use super::rig::Rig;

fn say(rig: &mut Rig, boot_id: &str, health: Health) {
    let said = Localisation {
        stamp: rig.now,
        boot_id: boot_id.to_owned(),
        health,
        map_from_base: rig.pose,
        agreeing: 0.5,
        through_walls: 0.0,
    };
    rig.inbox.localisations.push(said);
}

/// A global search has found the robot.
fn found_anew(rig: &Rig, map_from_base: Pose2) -> Correction {
    Correction {
        stamp: rig.now,
        boot_id: "boot-1".into(),
        map_from_base,
        covariance: std::array::from_fn(|index| Matrix3::from_diagonal(&[0.01, 0.01, 0.001].into())[index]),
        is_found_anew: true,
        ..Correction::default()
    }
}

fn again(rig: &Rig, plan: &Plan, counter: u64, trajectory_id: u64) -> Plan {
    Plan {
        based_on: BasedOn {
            stamp: rig.now,
            ..plan.based_on.clone()
        },
        revision: Revision {
            incarnation: plan.revision.incarnation,
            counter,
        },
        trajectory_id,
        ..plan.clone()
    }
}

#[test]
fn a_robot_that_is_lost_brakes_and_takes_no_plan_until_it_is_found() {
    for lost in [
        Health::Searching,
        Health::Lost,
        Health::Ambiguous {
            hypotheses: vec![Pose2::IDENTITY; 2],
        },
    ] {
        let (mut rig, epoch, plan) = driving();
        say(&mut rig, "boot-1", lost);
        rig.run(1.5);
        assert!(rig.at_rest(), "{:?}", rig.velocity);
        let refused = again(&rig, &plan, 2, 8);
        rig.send(refused);
        assert!(rig.rejection().is_some_and(|reason| reason.contains("not known where")));
        rig.run(1.0);
        assert!(rig.at_rest());
        say(&mut rig, "boot-1", Health::Degraded { direction: 0.0 });
        rig.run(0.1);
        let mut ahead = rig.ahead(epoch, 3, 9, 3.0);
        ahead.based_on.stamp = rig.now;
        rig.events.clear();
        rig.send(ahead);
        assert_eq!(rig.rejection(), None);
        rig.run(1.0);
        assert!(rig.velocity.v > 0.2, "{:?}", rig.velocity);
    }
}

#[test]
fn what_is_said_of_another_boot_or_of_a_corridor_stops_nothing() {
    let (mut rig, ..) = driving();
    say(&mut rig, "boot-0", Health::Lost);
    say(&mut rig, "boot-1", Health::Degraded { direction: 1.0 });
    rig.run(0.5);
    assert!(rig.velocity.v > 0.3);
    let told = |event: &EventKind| matches!(event, EventKind::Localisation { .. });
    assert!(!rig.events.iter().any(told));
}

#[test]
fn a_robot_that_is_found_somewhere_else_believes_it_at_once_and_drops_its_plan() {
    let (mut rig, ..) = driving();
    let found = Pose2::new(-3.0, 2.0, 1.5);
    rig.bump = Some(0.0);
    rig.run(0.3);
    rig.bump = None;
    let touched = |rig: &Rig| rig.pilot.obstacles.touched_lines(rig.now, Pose2::IDENTITY).len();
    assert_eq!(touched(&rig), 1);
    let correction = found_anew(&rig, found);
    rig.inbox.corrections.push(correction);
    rig.tick();
    assert_eq!(touched(&rig), 0, "odometry does not tell where the robot has been");
    assert!(
        rig.pilot.map_from_base().distance(&found) < 0.1,
        "{:?}",
        rig.pilot.map_from_base()
    );
    let discarded = |event: &EventKind| matches!(event, EventKind::PlanDiscarded { reason, .. } if reason.contains("somewhere else"));
    assert!(rig.events.iter().any(discarded), "{:?}", rig.events);
    rig.run(1.5);
    assert!(rig.at_rest());
}

#[test]
fn a_robot_whose_estimate_is_contradicted_three_times_in_a_row_drops_its_plan() {
    let (mut rig, ..) = driving();
    let aside = |rig: &Rig| {
        let place = rig.pilot.map_from_base() * Pose2::new(0.0, 3.0, 0.0);
        Correction {
            is_found_anew: false,
            ..found_anew(rig, place)
        }
    };
    let discarded = |rig: &Rig| {
        let is_discarded = |event: &EventKind| matches!(event, EventKind::PlanDiscarded { reason, .. } if reason.contains("somewhere else"));
        rig.events.iter().any(is_discarded)
    };
    for nth in 1..=3 {
        let correction = aside(&rig);
        rig.inbox.corrections.push(correction);
        rig.run(0.2);
        assert_eq!(discarded(&rig), nth == 3, "after {nth}");
    }
    rig.run(1.5);
    assert!(rig.at_rest());
}

#[test]
fn the_way_home_is_none_that_was_taken_for_it_somewhere_else() {
    let elsewhere = Pose2::new(-3.0, 2.0, 1.5);
    for is_found in [false, true] {
        let (mut rig, epoch, _) = driving();
        rig.ask(EdgeRequest::Mode(ModeRequest {
            on_lost: Some(LostPolicy::ReturnHome),
            epoch: Some(epoch),
        }))
        .unwrap();
        rig.run(2.0);
        if is_found {
            let correction = found_anew(&rig, elsewhere);
            rig.inbox.corrections.push(correction);
        }
        rig.heartbeat = None;
        // The cloud is gone: at most the plan's validity later the robot is on its own.
        rig.run(30.0);
        let ends = if is_found { elsewhere } else { Pose2::IDENTITY };
        let off = (rig.pilot.map_from_base().position() - ends.position()).norm();
        assert!(off < 0.5 && rig.at_rest(), "found anew: {is_found}: {off:.2} m off");
    }
}

//! Claims about which goals are accepted.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_mission::{Client, Inputs};
use zenav_protocol::messages::{
    Annotations, GoalPhase, GoalPoint, GoalRequest, GoalsRequest, InfoRequest, OnBusy, Refusal, Zone, ZoneRule,
};
use zenav_protocol::topics::{MissionReply, MissionRequest};
use zenav_space::Zones;

use super::rig::{Rig, cancel, room, to};

#[test]
fn a_step_is_brief_while_no_goal_is_open_and_nobody_asks_for_anything() {
    let mut rig = Rig::new();
    rig.run(1.0);
    let is_brief = |rig: &Rig, inputs: &Inputs| rig.stage.robots[0].mission.as_ref().unwrap().is_brief(inputs);
    let nothing = Inputs::default();
    let asked = Inputs {
        requests: vec![(Client(1), MissionRequest::Info(InfoRequest {}))],
        ..Inputs::default()
    };
    assert!(is_brief(&rig, &nothing) && !is_brief(&rig, &asked));
    rig.submit(to(2.0, 0.0, "there")).unwrap();
    assert!(!is_brief(&rig, &nothing));
    rig.success_of("there", 30.0);
    assert!(is_brief(&rig, &nothing));
}

#[test]
fn what_is_no_goal_is_answered_with_what_was_expected() {
    let mut rig = Rig::new();
    rig.run(1.0);
    let ok = to(1.0, 1.0, "ok");
    let bad = [
        (GoalRequest { y: None, ..ok.clone() }, "go together"),
        (
            GoalRequest {
                x: None,
                y: None,
                ..ok.clone()
            },
            "exactly one",
        ),
        (
            GoalRequest {
                place: Some("sink".into()),
                ..ok.clone()
            },
            "exactly one",
        ),
        (
            GoalRequest {
                id: Some("a/b".into()),
                ..ok.clone()
            },
            "valid name",
        ),
        (
            GoalRequest {
                x: Some(f64::NAN),
                ..ok.clone()
            },
            "finite",
        ),
        (
            GoalRequest {
                x: Some(1e300),
                ..ok.clone()
            },
            "finite",
        ),
        (
            GoalRequest {
                yaw: Some(f64::INFINITY),
                ..ok.clone()
            },
            "radians",
        ),
        (
            GoalRequest {
                tolerance: Some(0.0),
                ..ok.clone()
            },
            "tolerance",
        ),
        (
            GoalRequest {
                deadline_secs: Some(-1.0),
                ..ok.clone()
            },
            "deadline",
        ),
        (
            GoalRequest {
                x: None,
                y: None,
                tree: Some("<root".into()),
                ..ok.clone()
            },
            "tree",
        ),
        (
            GoalRequest {
                x: None,
                y: None,
                waypoints: vec![GoalPoint {
                    x: f64::NAN,
                    y: 0.0,
                    yaw: None,
                }],
                ..ok.clone()
            },
            "waypoints[0]",
        ),
    ];
    for (request, expected) in bad {
        match rig.submit(request.clone()) {
            Err(Refusal::BadRequest { reason }) => assert!(reason.contains(expected), "{reason}"),
            other => panic!("{request:?}: {other:?}"),
        }
    }
    let nowhere = GoalRequest {
        place: Some("moon".into()),
        ..GoalRequest::default()
    };
    let early = rig.submit(nowhere.clone());
    assert!(
        matches!(early, Err(Refusal::Busy { .. })),
        "the places of the map have not come yet: {early:?}"
    );
    rig.annotate(Annotations {
        places: rig.config.places.clone(),
        ..Annotations::default()
    });
    assert!(matches!(rig.submit(nowhere), Err(Refusal::NotFound { what }) if what.contains("sink")));
    assert!(rig.goals.is_empty());
    assert_eq!(rig.submit(ok).unwrap().state, GoalPhase::Accepted);
}

#[test]
fn a_goal_in_a_wall_is_rejected_with_the_nearest_place_that_would_do() {
    let mut rig = Rig::on(room(|at| (at.x - 2.05).abs() < 0.05 && (at.y - 2.05).abs() < 0.05));
    rig.run(1.0);
    match rig.submit(to(2.05, 2.05, "wall")) {
        Err(Refusal::Rejected {
            nearest_free: Some(free),
            ..
        }) => assert!((0.2..0.6).contains(&(free.x - 2.05).hypot(free.y - 2.05)), "{free:?}"),
        other => panic!("{other:?}"),
    }
    match rig.submit(to(100.0, 0.0, "far")) {
        Err(Refusal::Rejected { reason, .. }) => assert!(reason.contains("outside the map"), "{reason}"),
        other => panic!("{other:?}"),
    }
    assert!(
        rig.submit(GoalRequest {
            place: Some("sink".into()),
            ..GoalRequest::default()
        })
        .is_ok()
    );
}

#[test]
fn a_goal_in_a_closed_zone_is_rejected_with_its_name_and_the_nearest_place_outside() {
    let mut rig = Rig::new();
    let zones = "[[keep_out]]\nname = \"stairs\"\npoints = [[2.0, 2.0], [4.0, 2.0], [4.0, 4.0], [2.0, 4.0]]";
    rig.config.zones = Arc::new(Zones::from_toml(zones, "zones").unwrap());
    rig.start();
    rig.run(1.0);
    match rig.submit(to(2.2, 3.0, "closed")) {
        Err(Refusal::Rejected {
            reason,
            nearest_free: Some(free),
        }) => assert!(
            reason.contains("stairs") && free.x < 1.8 && free.x > 1.4 && (free.y - 3.0).abs() < 0.2,
            "{reason} {free:?}"
        ),
        other => panic!("{other:?}"),
    }
    assert!(rig.submit(to(2.0, 0.0, "open")).is_ok());
}

#[test]
fn a_place_that_is_added_is_a_goal_and_a_zone_that_is_added_closes_one() {
    let mut rig = Rig::new();
    rig.run(1.0);
    let fridge = GoalPoint {
        x: 2.0,
        y: 0.0,
        yaw: None,
    };
    let mut annotations = Annotations {
        places: [("fridge".to_owned(), fridge)].into(),
        ..Annotations::default()
    };
    rig.annotate(annotations.clone());
    let to_fridge = |id: &str| GoalRequest {
        id: Some(id.to_owned()),
        place: Some("fridge".into()),
        ..GoalRequest::default()
    };
    rig.submit(to_fridge("a")).unwrap();
    annotations.zones = vec![Zone {
        name: "wet".into(),
        rule: ZoneRule::KeepOut,
        points: [[1.5, -0.5], [2.5, -0.5], [2.5, 0.5], [1.5, 0.5]]
            .map(Point2::from)
            .into(),
    }];
    rig.annotate(annotations.clone());
    let refused = rig.submit(to_fridge("b")).unwrap_err().to_string();
    assert!(refused.contains("keep-out zone: wet"), "{refused}");
    // An invalid zone is refused, and the existing ones stay.
    annotations.zones[0].points.truncate(2);
    rig.annotate(annotations);
    assert!(rig.submit(to_fridge("c")).is_err());
}

#[test]
fn a_goal_to_a_place_that_was_added_is_kept_while_nobody_tells_where_that_is() {
    let mut rig = Rig::new();
    rig.run(1.0);
    let shelf = GoalPoint {
        x: 1.5,
        y: 0.5,
        yaw: None,
    };
    let annotations = Annotations {
        places: [("shelf".to_owned(), shelf)].into(),
        ..Annotations::default()
    };
    rig.annotate(annotations.clone());
    rig.submit(to(1.0, 0.0, "first")).unwrap();
    rig.submit(GoalRequest {
        id: Some("second".to_owned()),
        place: Some("shelf".into()),
        ..GoalRequest::default()
    })
    .unwrap();
    // The mission restarts; mapping, which stores the places, does not.
    rig.kill();
    rig.start();
    rig.success_of("first", 30.0);
    rig.run(20.0);
    assert_eq!(
        rig.phase("second"),
        GoalPhase::Accepted,
        "{:?}",
        rig.goal("second").reason
    );
    rig.annotate(annotations);
    rig.success_of("second", 30.0);
}

#[test]
fn a_repeated_goal_is_the_same_goal_and_another_content_is_refused() {
    let mut rig = Rig::new();
    rig.submit(to(1.0, 0.0, "a")).unwrap();
    rig.run(1.0);
    assert_eq!(rig.submit(to(1.0, 0.0, "a")).unwrap().state, GoalPhase::Active);
    assert!(matches!(rig.submit(to(2.0, 0.0, "a")), Err(Refusal::Rejected { .. })));
    rig.success_of("a", 20.0);
    assert_eq!(rig.submit(to(1.0, 0.0, "a")).unwrap().state, GoalPhase::Succeeded);
    let plans = rig.plans.len();
    rig.run(2.0);
    assert_eq!(rig.plans.len(), plans, "it is not driven again");
}

#[test]
fn a_busy_mission_queues_preempts_or_refuses_as_asked() {
    let mut rig = Rig::new();
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    rig.submit(to(1.0, 1.0, "b")).unwrap();
    rig.run(2.0);
    let refused = rig.submit(GoalRequest {
        on_busy: OnBusy::Reject,
        ..to(2.0, 0.0, "c")
    });
    assert!(matches!(refused, Err(Refusal::Rejected { ref reason, .. }) if reason.contains("busy with goal a")));
    rig.submit(GoalRequest {
        on_busy: OnBusy::Preempt,
        ..to(1.0, 0.0, "d")
    })
    .unwrap();
    assert_eq!(rig.phase("a"), GoalPhase::Canceled);
    assert_eq!(rig.phase("d"), GoalPhase::Active, "it goes before the one that waits");
    rig.success_of("b", 60.0);
    assert_eq!(rig.phase("d"), GoalPhase::Succeeded);
}

#[test]
fn a_repeated_cancel_gets_its_first_answer_and_an_unknown_goal_is_not_found() {
    let mut rig = Rig::new();
    assert!(matches!(rig.answer(cancel(None, "r0")), Err(Refusal::NotFound { .. })));
    assert!(matches!(
        rig.answer(cancel(Some("x"), "r0")),
        Err(Refusal::NotFound { .. })
    ));
    rig.submit(to(4.0, 0.0, "a")).unwrap();
    let first = rig.answer(cancel(None, "r1")).unwrap();
    assert!(matches!(&first, MissionReply::Cancel(reply) if reply.id == "a" && reply.state == GoalPhase::Canceled));
    rig.submit(to(4.0, 0.0, "b")).unwrap();
    rig.start();
    assert_eq!(rig.answer(cancel(None, "r1")).unwrap(), first, "also after a restart");
    assert_eq!(rig.phase("b"), GoalPhase::Active);
    rig.answer(cancel(Some("b"), "r2")).unwrap();
    assert_eq!(rig.phase("b"), GoalPhase::Canceled);
}

#[test]
fn lists_tell_every_goal_and_info_tells_the_schema() {
    let mut rig = Rig::new();
    rig.submit(to(1.0, 0.0, "a")).unwrap();
    rig.submit(GoalRequest {
        x: Some(1.0),
        y: Some(1.0),
        ..GoalRequest::default()
    })
    .unwrap();
    match rig.answer(MissionRequest::Goals(GoalsRequest::default())).unwrap() {
        MissionReply::Goals(reply) => assert_eq!(reply.goals.len(), 2),
        other => panic!("{other:?}"),
    }
    assert!(
        matches!(rig.answer(MissionRequest::Info(InfoRequest {})).unwrap(), MissionReply::Info(info) if info.component == "mission")
    );
}

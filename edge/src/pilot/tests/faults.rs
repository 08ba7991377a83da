//! Claims about a robot that one forged message, a silent body or a full disk must not put out of service.

use zenav_protocol::messages::{EventKind, LeaseRole, Mode, Plan, ResumeRequest, Revision, StopReply, StopRequest};
use zenav_protocol::readings::{Readings, Sweep};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{EdgeReply, EdgeRequest};

use super::rig::Rig;
use super::{driving, fresh};
use crate::control_io::{Inbox, Outbox, Publication, Ticket};

const FORGED: [Revision; 2] = [
    Revision {
        incarnation: 1,
        counter: u64::MAX,
    },
    Revision {
        incarnation: u64::MAX,
        counter: u64::MAX,
    },
];

/// The holder renews its plan, and the robot drives it to its end.
fn assert_drives_on(rig: &mut Rig, plan: Plan) {
    assert_drives_to_within(0.03, rig, plan);
}

/// As [`assert_drives_on`]; `tolerance`: distance from the end at rest, m.
fn assert_drives_to_within(tolerance: f64, rig: &mut Rig, mut plan: Plan) {
    for counter in 2..12 {
        plan.revision.counter = counter;
        plan.based_on.stamp = rig.now;
        rig.send(plan.clone());
        rig.run(1.0);
    }
    assert!(
        (rig.pose.x - 4.0).abs() < tolerance && rig.at_rest(),
        "{:?}: {:?}",
        rig.pose,
        rig.rejection()
    );
}

#[test]
fn a_tick_whose_stamp_goes_back_does_no_harm() {
    let (mut rig, _, plan) = driving();
    rig.now = rig.now.plus_secs(-0.1);
    let out = rig.tick();
    assert!(out.wheels.iter().all(|speed| speed.is_finite()), "{:?}", out.wheels);
    // What it drives in the time that comes twice is not counted.
    assert_drives_to_within(0.1, &mut rig, plan);
}

#[test]
fn a_sweep_of_the_future_blinds_no_lidar() {
    let (mut rig, _, plan) = driving();
    let beams = rig.model.first_lidar().unwrap().beams;
    let ahead = Stamp::from_secs(rig.now.as_secs() + 3600.0);
    let readings = Readings {
        sweeps: vec![Sweep::new(ahead, vec![f32::INFINITY; beams])],
        ..rig.readings()
    };
    rig.pilot.step(rig.now, &readings, Inbox::default());
    assert_drives_on(&mut rig, plan);
}

#[test]
fn an_invalid_plan_with_the_greatest_counter_does_not_lock_the_holder_out() {
    for revision in FORGED {
        let (mut rig, _, plan) = driving();
        rig.send(Plan {
            revision,
            valid_for: f64::NAN,
            ..plan.clone()
        });
        assert!(rig.rejection().is_some());
        assert_drives_on(&mut rig, plan);
    }
}

#[test]
fn a_plan_that_is_good_but_for_a_counter_that_leaps_is_refused() {
    for revision in FORGED {
        let (mut rig, _, mut plan) = driving();
        plan.based_on.stamp = rig.now;
        rig.send(Plan {
            revision,
            ..plan.clone()
        });
        assert!(rig.rejection().unwrap().contains("leaps"), "{:?}", rig.rejection());
        assert_drives_on(&mut rig, plan);
    }
}

#[test]
fn a_waypoint_that_no_map_reaches_is_refused_whatever_the_tracker() {
    for law in crate::trackers::LAWS {
        let mut model = zenav_fixtures::robot("tiago");
        law.name.clone_into(&mut model.controller.tracker);
        let mut rig = Rig::of(model, super::Persisted::default());
        let epoch = rig.mission();
        let plan = rig.waypoints(epoch, 1, 7, &[(-1e200, 1e200), (1.0, 0.0)]);
        rig.send(plan);
        assert!(
            rig.rejection().is_some_and(|reason| reason.contains("too far")),
            "{}: {:?}",
            law.name,
            rig.rejection()
        );
        let plan = rig.waypoints(epoch, 2, 8, &[(1.0, 0.0)]);
        rig.send(plan);
        rig.run(1.0);
        assert!(rig.velocity.v > 0.1, "{}: {:?}", law.name, rig.velocity);
    }
}

#[test]
fn a_forged_plan_in_the_same_tick_does_not_hide_the_holder_s() {
    let mut rig = fresh();
    let epoch = rig.mission();
    let plan = rig.ahead(epoch, 1, 7, 4.0);
    rig.inbox.plans.push(Plan {
        revision: FORGED[0],
        trajectory_id: 9,
        valid_for: -1.0,
        ..plan.clone()
    });
    rig.send(plan);
    rig.run(2.0);
    assert!(rig.velocity.v > 0.3, "{:?}", rig.rejection());
}

fn events(out: &Outbox) -> Vec<&EventKind> {
    let mut events = Vec::new();
    for publication in &out.publications {
        if let Publication::Event(event) = publication {
            events.push(&event.kind);
        }
    }
    events
}

#[test]
fn without_readings_the_robot_says_so_and_obeys_a_stop_and_drives_once_they_come_again() {
    let (mut rig, epoch, _) = driving();
    let inbox = Inbox {
        requests: vec![(Ticket(1), EdgeRequest::Stop(StopRequest::default()))],
        ..Inbox::default()
    };
    let out = rig.pilot.step_blind(inbox, "no readings for 200ms");
    assert_eq!(
        out.replies,
        [(Ticket(1), Ok(EdgeReply::Stop(StopReply { stopped: true })))]
    );
    assert!(
        out.persist.as_ref().is_some_and(|stored| stored.stopped),
        "and it is stored"
    );
    assert_eq!(out.wheels, [0.0; 2]);
    let state = out.publications.iter().find_map(|publication| match publication {
        Publication::State(state) => Some(state),
        _ => None,
    });
    let state = state.unwrap();
    assert_eq!((state.mode, state.stamp), (Mode::Stopped, rig.now), "its clock stands");
    assert_eq!(state.faults.body.as_deref(), Some("no readings for 200ms"));
    let silent = |kind: &&EventKind| matches!(kind, EventKind::Transition { to, .. } if to == "silent");
    assert_eq!(events(&out).into_iter().filter(silent).count(), 1);
    let again = rig.pilot.step_blind(Inbox::default(), "no readings for 200ms");
    assert_eq!(events(&again).into_iter().filter(silent).count(), 0, "said once");

    rig.ask(EdgeRequest::Resume(ResumeRequest::default())).unwrap();
    rig.run(1.0);
    assert!(rig.state.as_ref().unwrap().faults.are_none());
    let before = rig.pose;
    let new = rig.ahead(epoch, 6, 8, 1.0);
    rig.send(new);
    rig.run(2.0);
    assert!(before.distance(&rig.pose) > 0.3, "{:?}", rig.rejection());
}

#[test]
fn a_robot_that_has_never_had_readings_answers_and_grants() {
    let config = crate::config::EdgeConfig::new(
        zenav_protocol::id::Id::robot("tiago").unwrap(),
        zenav_fixtures::robot("tiago"),
        zenav_protocol::geometry::Pose2::IDENTITY,
    );
    let mut pilot = crate::pilot::Pilot::new(config, "boot-1".into(), super::Persisted::default());
    let lease = zenav_protocol::messages::LeaseRequest::new(
        "m",
        LeaseRole::Mission,
        zenav_protocol::messages::LeaseAction::Acquire,
        "r1",
    );
    let inbox = Inbox {
        requests: vec![(Ticket(1), EdgeRequest::Lease(lease))],
        ..Inbox::default()
    };
    assert!(pilot.step_blind(inbox, "silent").replies[0].1.is_ok());
}

#[test]
fn what_cannot_be_stored_is_said_until_it_is() {
    let mut rig = fresh();
    for not_stored in [Some("no room"), Some("no room"), None] {
        for _ in 0..10 {
            rig.inbox.not_stored = not_stored.map(str::to_owned);
            rig.tick();
        }
        assert_eq!(rig.state.as_ref().unwrap().faults.storage.as_deref(), not_stored);
    }
    let told = rig
        .events
        .iter()
        .filter(|event| matches!(event, EventKind::Transition { behaviour, .. } if behaviour == "storage"));
    assert_eq!(told.count(), 2);
}

#[test]
fn a_grant_that_cannot_be_stored_is_told_only_once_its_holder_is_heard() {
    let leases = |rig: &Rig| -> Vec<String> {
        let reasons = rig.events.iter().filter_map(|event| match event {
            EventKind::Lease { reason, .. } => Some(reason.clone()),
            _ => None,
        });
        reasons.collect()
    };
    let mut rig = fresh();
    let mut epoch = 0;
    for request in ["r1", "r2", "r3"] {
        rig.run(3.0);
        rig.inbox.not_stored = Some("no room".to_owned());
        epoch = rig.lease("m", LeaseRole::Mission, request).unwrap();
    }
    assert!(leases(&rig).is_empty(), "{:?}", rig.events);
    rig.heartbeat = Some(epoch);
    rig.run(0.5);
    assert_eq!(leases(&rig), ["granted"]);
}

#[test]
fn a_lidar_that_is_mounted_crooked_is_noticed_on_the_way_and_slows_the_robot() {
    for crooked in [0.0, 0.1] {
        let mut rig = fresh();
        rig.model.lidar.as_mut().unwrap().mount.yaw += crooked;
        let epoch = rig.mission();
        let mut plan = rig.ahead(epoch, 1, 7, 4.0);
        let mut fastest: f64 = 0.0;
        for counter in 1..10 {
            plan.revision.counter = counter;
            plan.based_on.stamp = rig.now;
            rig.send(plan.clone());
            rig.run(1.0);
            fastest = if rig.pose.x > 3.2 {
                fastest.max(rig.velocity.v)
            } else {
                0.0
            };
        }
        let state = rig.state.as_ref().unwrap();
        let told =
            |event: &&EventKind| matches!(event, EventKind::Transition { behaviour, .. } if behaviour == "lidar");
        let events = rig.events.iter().filter(told).count();
        if crooked > 0.0 {
            assert!(
                state
                    .faults
                    .lidar
                    .as_deref()
                    .is_some_and(|what| what.contains("to the left")),
                "{state:?}"
            );
            assert_eq!(events, 1);
            assert!(fastest < 0.51 * rig.model.drive.top_speed(), "{fastest} m/s");
        } else {
            assert_eq!((&state.faults.lidar, events), (&None, 0));
        }
    }
}

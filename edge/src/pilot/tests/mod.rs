//! Claims about the robot's promises, whatever the network does, driven in closed loop.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod faults;
mod frames;
mod localised;
mod rig;
mod robots;
mod simulated_errors;
mod wall;

use proptest::prelude::*;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{
    BasedOn, BehaviourAction, BehaviourReply, BehaviourRequest, BehaviourState, EventKind, GuardZone, LeaseRole, Link,
    LostPolicy, Mode, ModeRequest, Plan, ResumeRequest, Revision, Splice, StopReply, StopRequest, Teleop,
};
use zenav_protocol::trajectory::TrajectoryPoint;

use rig::{ROOM, Rig};
use zenav_protocol::topics::{EdgeReply, EdgeRequest};

use crate::control_io::{Persisted, Publication};

fn fresh() -> Rig {
    Rig::new(Persisted::default())
}

/// Teleop at this speed, ten commands a second.
fn by_hand(rig: &mut Rig, epoch: u64, v: f64, secs: f64) {
    for _ in 0..(secs / 0.1) as usize {
        rig.inbox.teleops.push(Teleop {
            epoch,
            twist: Twist2::new(v, 0.0),
            echo: rig.now,
        });
        rig.run(0.1);
    }
}

/// A robot that has just begun to drive four metres ahead.
fn driving() -> (Rig, u64, Plan) {
    let mut rig = fresh();
    let epoch = rig.mission();
    let plan = rig.ahead(epoch, 1, 7, 4.0);
    rig.send(plan.clone());
    assert_eq!(rig.rejection(), None);
    rig.run(2.0);
    assert!(rig.velocity.v > 0.3, "{:?}", rig.velocity);
    (rig, epoch, plan)
}

#[test]
fn a_low_battery_is_reported_once_until_it_has_been_charged() {
    let mut rig = fresh();
    let told = |rig: &Rig| {
        let low = |event: &&EventKind| matches!(event, EventKind::BatteryLow { .. });
        rig.events.iter().filter(low).count()
    };
    for (charge, expected) in [(0.3, 0), (0.19, 1), (0.21, 1), (0.19, 1), (0.9, 1), (0.1, 2)] {
        rig.charge = charge;
        rig.run(0.5);
        assert_eq!(told(&rig), expected, "at {charge}");
    }
}

#[test]
fn the_compass_goes_out_with_the_scans_of_the_main_lidar_whatever_its_name() {
    for name in ["lidar", "front"] {
        let mut model = zenav_fixtures::robot("tiago");
        if let Some(lidar) = model.lidar.take_if(|_| name != "lidar") {
            model.lidars.insert(name.to_owned(), lidar);
        }
        let mut rig = Rig::of(model, Persisted::default());
        let mut fixes = Vec::new();
        for _ in 0..10 {
            for publication in rig.tick().publications {
                if let Publication::Scan(lidar, scan) = publication {
                    fixes.push((lidar, scan.fixes.len()));
                }
            }
        }
        assert_eq!(fixes, [(None::<String>, 1), (None, 1)], "{name}");
    }
}

#[test]
fn a_renewed_plan_is_driven_to_its_end() {
    let (mut rig, _, mut plan) = driving();
    for counter in 2..12 {
        plan.revision.counter = counter;
        plan.based_on.stamp = rig.now;
        rig.send(plan.clone());
        rig.run(1.0);
    }
    assert!((rig.pose.x - 4.0).abs() < 0.03 && rig.at_rest(), "{:?}", rig.pose);
    assert!(rig.state.unwrap().plan.unwrap().finished);
    assert_eq!(
        rig.events
            .iter()
            .filter(|event| matches!(event, EventKind::PlanAccepted { .. }))
            .count(),
        1
    );
}

#[test]
fn with_the_heartbeats_gone_the_robot_is_at_rest_by_the_expiry() {
    let (mut rig, _, plan) = driving();
    rig.heartbeat = None;
    let expiry = plan.based_on.stamp.plus_secs(plan.valid_for);
    rig.run(1.5);
    assert!(rig.velocity.v > 0.3, "it finishes the horizon");
    while rig.now.plus_secs(0.02) < expiry {
        rig.tick();
    }
    assert!(rig.at_rest(), "{:?}", rig.velocity);
    let stopped = rig.pose;
    rig.run(5.0);
    assert!(stopped.distance(&rig.pose) < 0.01 && rig.pose.x < 3.0);
    assert!(rig.events.contains(&EventKind::PlanExpired { goal_id: "g".into() }));
    assert_eq!(rig.state.unwrap().link, Link::Lost);
}

#[test]
fn the_policy_stop_brakes_as_soon_as_the_lease_is_lost() {
    let (mut rig, epoch, _) = driving();
    rig.ask(EdgeRequest::Mode(ModeRequest {
        on_lost: Some(LostPolicy::Stop),
        epoch: Some(epoch),
    }))
    .unwrap();
    rig.heartbeat = None;
    rig.run(1.7);
    assert!(rig.at_rest(), "{:?}", rig.velocity);
}

#[test]
fn a_mission_that_comes_back_renews_and_the_robot_goes_on_where_it_is() {
    let (mut rig, _, mut plan) = driving();
    rig.heartbeat = None;
    rig.run(6.0);
    let waited = rig.pose;
    let epoch = rig.mission();
    assert_eq!(epoch, 2, "a lapsed lease gets a new epoch");
    plan.epoch = epoch;
    for counter in 2..10 {
        plan.revision.counter = counter;
        plan.based_on.stamp = rig.now;
        rig.send(plan.clone());
        assert_eq!(rig.rejection(), None);
        rig.run(1.0);
    }
    assert!(
        waited.x < 3.0 && (rig.pose.x - 4.0).abs() < 0.03,
        "{waited:?} {:?}",
        rig.pose
    );
}

#[test]
fn a_plan_of_an_old_epoch_moves_nothing() {
    let (mut rig, epoch, plan) = driving();
    rig.heartbeat = None;
    rig.run(6.0);
    rig.lease("other", LeaseRole::Mission, "x").unwrap();
    let before = rig.pose;
    rig.send(Plan {
        based_on: BasedOn {
            stamp: rig.now,
            ..plan.based_on.clone()
        },
        revision: Revision {
            incarnation: 9,
            counter: 9,
        },
        ..plan
    });
    rig.run(2.0);
    assert!(before.distance(&rig.pose) < 0.01);
    assert!(
        rig.rejection().unwrap().contains(&format!("epoch {epoch}")),
        "{:?}",
        rig.rejection()
    );
}

#[test]
fn out_of_a_burst_only_the_newest_plan_of_the_grant_is_taken() {
    let mut rig = fresh();
    let epoch = rig.mission();
    for (epoch, counter, id) in [(epoch, 1, 1), (epoch, 3, 3), (epoch + 5, 9, 9), (epoch, 2, 2)] {
        let plan = rig.ahead(epoch, counter, id, 2.0);
        rig.inbox.plans.push(plan);
    }
    rig.run(0.2);
    assert_eq!(rig.state.unwrap().plan.unwrap().trajectory_id, 3);
}

/// Lifts a stop that the rig's boot has counted.
fn resume_of(stop: u64) -> ResumeRequest {
    ResumeRequest::new("somebody", "boot-1", stop)
}

#[test]
fn copies_of_a_stop_and_of_a_resume_that_the_network_repeats_change_nothing() {
    let mut rig = driving().0;
    let (stop, resume) = (StopRequest::new("somebody"), resume_of(1));
    let stopped = |rig: &Rig| {
        let state = rig.state.as_ref().unwrap();
        (state.mode == Mode::Stopped, state.stops)
    };
    for _ in 0..3 {
        rig.ask(EdgeRequest::Stop(stop.clone())).unwrap();
    }
    rig.run(0.2);
    assert_eq!(stopped(&rig), (true, 1));
    rig.ask(EdgeRequest::Resume(resume.clone())).unwrap();
    rig.run(0.2);
    assert_eq!(stopped(&rig), (false, 1));
    // A copy of the resume arrives after the next stop, even one that names no stop.
    let careless = ResumeRequest {
        stop: None,
        ..resume_of(1)
    };
    rig.ask(EdgeRequest::Resume(careless.clone())).unwrap();
    rig.ask(EdgeRequest::Stop(StopRequest::new("somebody else"))).unwrap();
    for copy in [resume, careless] {
        let _ = rig.ask(EdgeRequest::Resume(copy));
        rig.run(0.2);
        assert_eq!(stopped(&rig), (true, 2));
    }
    // A late copy of the first stop is obeyed: stopping is safe.
    rig.ask(EdgeRequest::Resume(resume_of(2))).unwrap();
    rig.ask(EdgeRequest::Stop(stop)).unwrap();
    rig.run(0.2);
    assert_eq!(stopped(&rig), (true, 3));
}

#[test]
fn stop_needs_no_lease_and_a_replayed_plan_after_resume_moves_nothing() {
    let (mut rig, epoch, mut plan) = driving();
    assert_eq!(
        rig.ask(EdgeRequest::Stop(StopRequest::default())),
        Ok(EdgeReply::Stop(StopReply { stopped: true }))
    );
    rig.run(1.0);
    assert!(rig.at_rest());
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::Stopped);
    let stopped = rig.pose;
    // A delayed resume, requested before another operator stopped the robot again.
    let seen = rig.state.as_ref().unwrap().stops;
    rig.ask(EdgeRequest::Stop(StopRequest::default())).unwrap();
    rig.ask(EdgeRequest::Resume(resume_of(seen))).unwrap_err();
    rig.ask(EdgeRequest::Resume(resume_of(seen + 1))).unwrap();
    rig.send(plan.clone());
    // A renewal by a mission that has not noticed the stop must not move it either: the motion is gone for good.
    plan.revision.counter = 5;
    plan.based_on.stamp = rig.now;
    rig.send(plan);
    rig.run(2.0);
    assert!(stopped.distance(&rig.pose) < 0.01);
    let new = rig.ahead(epoch, 6, 8, 1.0);
    rig.send(new);
    rig.run(2.0);
    assert!(stopped.distance(&rig.pose) > 0.3, "a new plan is driven");
}

#[test]
fn a_resume_asked_before_a_restart_lifts_no_stop_of_after_it() {
    let mut rig = fresh();
    rig.ask(EdgeRequest::Stop(StopRequest::new("me"))).unwrap();
    // The boot before counted as many stops, but lost power before this was on disk.
    let refused = rig.ask(EdgeRequest::Resume(ResumeRequest::new("somebody", "boot-0", 1)));
    assert!(refused.unwrap_err().to_string().contains("restarted since"));
    let of_no_boot = ResumeRequest {
        boot_id: None,
        ..resume_of(1)
    };
    let refused = rig.ask(EdgeRequest::Resume(of_no_boot)).unwrap_err();
    assert!(refused.to_string().contains("`boot_id`"));
    rig.run(0.2);
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::Stopped);
    rig.ask(EdgeRequest::Resume(resume_of(1))).unwrap();
    rig.run(0.2);
    assert_ne!(rig.state.as_ref().unwrap().mode, Mode::Stopped);
}

#[test]
fn a_stop_survives_a_restart_and_epochs_go_on() {
    let mut rig = fresh();
    rig.mission();
    rig.ask(EdgeRequest::Stop(StopRequest::new("me"))).unwrap();
    let mut rig = Rig::new(rig.stored);
    assert_eq!(rig.state.as_ref().unwrap().mode, Mode::Stopped);
    let epoch = rig.mission();
    assert_eq!(epoch, 2);
    let plan = rig.ahead(epoch, 1, 1, 1.0);
    rig.send(plan);
    rig.run(1.0);
    assert!(rig.at_rest() && rig.rejection().unwrap().contains("stopped"));
}

#[test]
fn a_change_of_holder_discards_the_plan_and_the_operator_drives() {
    let (mut rig, _, _) = driving();
    let epoch = rig.lease("me", LeaseRole::Operator, "o").unwrap();
    rig.run(1.2);
    assert!(rig.at_rest());
    assert!(
        rig.events
            .iter()
            .any(|event| matches!(event, EventKind::PlanDiscarded { .. }))
    );
    let before = rig.pose;
    let epoch = if rig.state.as_ref().unwrap().lease.live {
        epoch
    } else {
        rig.lease("me", LeaseRole::Operator, "o2").unwrap()
    };
    for _ in 0..20 {
        by_hand(&mut rig, epoch, -0.3, 0.1);
    }
    assert!(rig.pose.x < before.x - 0.2, "{:?}", rig.pose);
    rig.run(1.0);
    assert!(rig.at_rest(), "the dead-man's switch");
    assert_eq!(stops_for(&rig, "teleop timed out"), 1);
}

#[test]
fn a_replayed_teleop_drive_does_not_override_a_later_stop_and_is_reported_once() {
    let (mut rig, _, _) = driving();
    rig.run(1.0);
    rig.lease("me", LeaseRole::Operator, "o").unwrap();
    rig.run(1.2);
    let epoch = rig.lease("me", LeaseRole::Operator, "o2").unwrap();
    let by_hand = |v, echo| Teleop {
        epoch,
        twist: Twist2::new(v, 0.0),
        echo,
    };
    let echo = rig.now;
    rig.inbox.teleops.extend([by_hand(-0.3, echo), by_hand(0.0, echo)]);
    rig.tick();
    let before = rig.pose;
    for _ in 0..40 {
        rig.inbox.teleops.push(by_hand(-0.3, echo));
        rig.tick();
    }
    assert!((rig.pose.x - before.x).abs() < 0.01, "{:?}", rig.pose);
    let told: Vec<&String> = rig
        .events
        .iter()
        .filter_map(|event| match event {
            EventKind::TeleopDropped { reason } => Some(reason),
            _ => None,
        })
        .collect();
    assert_eq!(told.len(), 2, "once for each cause: {told:?}");
}

/// How often the collision monitor reported a stop for this reason.
fn stops_for(rig: &Rig, because: &str) -> usize {
    let tells = |event: &&EventKind| matches!(event, EventKind::Guard { zone: GuardZone::Stop, reason } if reason.contains(because));
    rig.events.iter().filter(tells).count()
}

#[test]
fn a_bump_stops_the_robot_and_is_reported() {
    let (mut rig, _, _) = driving();
    rig.bump = Some(0.0);
    rig.run(1.5);
    assert!(rig.at_rest());
    assert_eq!(stops_for(&rig, "contact"), 1);
    assert!(rig.events.iter().any(|event| matches!(event, EventKind::Bumped)));
}

#[test]
fn a_plan_feels_its_way_into_the_blind_spot_and_teleop_and_a_robot_that_was_touched_there_creep() {
    const GENTLE: f64 = -0.01;
    let mut rig = Rig::of(zenav_fixtures::robot("tiago"), Persisted::default());
    let epoch = rig.mission();
    let ahead = rig.ahead(epoch, 1, 7, 1.0);
    let back = |point: &TrajectoryPoint| TrajectoryPoint {
        x: -point.x,
        v: -point.v,
        ..*point
    };
    rig.send(Plan {
        trajectory: ahead.trajectory.iter().map(back).collect(),
        ..ahead
    });
    assert_eq!(rig.rejection(), None);
    rig.run(1.5);
    assert!((rig.velocity.v + 0.05).abs() < 0.005, "{:?}", rig.velocity);
    rig.bump = Some(std::f64::consts::PI);
    rig.run(0.1);
    rig.bump = None;
    rig.run(1.0);
    assert!(rig.velocity.v >= GENTLE, "{:?}", rig.velocity);
    let mut rig = Rig::of(zenav_fixtures::robot("tiago"), Persisted::default());
    let epoch = rig.lease("me", LeaseRole::Operator, "o").unwrap();
    for _ in 0..10 {
        by_hand(&mut rig, epoch, -0.3, 0.1);
        assert!(rig.velocity.v >= GENTLE, "{:?}", rig.velocity);
    }
}

#[test]
fn who_is_touched_in_front_backs_away_as_fast_as_ever() {
    let backed = |touched: Option<f64>| {
        let mut rig = fresh();
        rig.bump = touched;
        let epoch = rig.lease("me", LeaseRole::Operator, "o").unwrap();
        for _ in 0..10 {
            by_hand(&mut rig, epoch, -0.3, 0.1);
        }
        -rig.pose.x
    };
    let (free, touched) = (backed(None), backed(Some(0.0)));
    assert!(
        free > 0.1 && touched > 0.9 * free,
        "{touched} m, {free} m where nothing touches"
    );
}

#[test]
fn what_was_touched_though_no_beam_shows_it_is_not_touched_again() {
    let mut rig = fresh();
    rig.bump = Some(0.0);
    rig.run(0.5);
    rig.bump = None;
    let epoch = rig.mission();
    let plan = rig.ahead(epoch, 1, 1, 2.0);
    rig.send(plan);
    assert!(rig.rejection().unwrap().contains("blocked"), "{:?}", rig.rejection());
    let epoch = rig.lease("me", LeaseRole::Operator, "o").unwrap();
    by_hand(&mut rig, epoch, -0.2, 4.0);
    assert!(rig.pose.x < -0.3, "{:?}", rig.pose);
    by_hand(&mut rig, epoch, 0.3, 4.0);
    assert!((-0.1..-0.01).contains(&rig.pose.x), "{:?}", rig.pose);
    assert!(rig.velocity.v < 0.02, "it creeps up to it: {:?}", rig.velocity);
}

#[test]
fn what_a_bumper_without_a_bearing_touched_is_not_remembered() {
    for (bearing, remembered) in [(0.0, 1), (f64::NAN, 0)] {
        let mut rig = fresh();
        rig.bump = Some(bearing);
        rig.run(0.5);
        rig.bump = None;
        rig.run(0.2);
        let lines = rig.pilot.obstacles.touched_lines(rig.now, Pose2::IDENTITY);
        assert_eq!(lines.len(), remembered, "{lines:?}");
    }
}

#[test]
fn a_repeated_request_gets_the_first_answer() {
    let mut rig = fresh();
    assert_eq!(rig.lease("m", LeaseRole::Mission, "r1"), Ok(1));
    rig.run(3.0);
    assert_eq!(rig.lease("other", LeaseRole::Mission, "r2"), Ok(2));
    assert_eq!(rig.lease("m", LeaseRole::Mission, "r1"), Ok(1), "and changes nothing");
    rig.run(0.2);
    assert_eq!(rig.state.as_ref().unwrap().lease.holder.as_deref(), Some("other"));
}

#[test]
fn a_plan_into_a_wall_that_the_scan_sees_is_refused() {
    let mut rig = fresh();
    rig.pose = Pose2::new(2.0, 0.0, 0.0);
    let config = crate::config::EdgeConfig {
        start: rig.pose,
        ..crate::config::EdgeConfig::new(
            zenav_protocol::id::Id::robot("r").unwrap(),
            rig.model.clone(),
            Pose2::IDENTITY,
        )
    };
    rig.pilot = crate::pilot::Pilot::new(config, "boot-1".into(), Persisted::default());
    rig.run(0.2);
    let epoch = rig.mission();
    let plan = rig.ahead(epoch, 1, 1, ROOM - 2.0);
    rig.send(plan);
    assert!(rig.rejection().unwrap().contains("blocked"), "{:?}", rig.rejection());
    let plan = rig.ahead(epoch, 2, 2, ROOM - 2.0 - 0.265 - 0.05);
    rig.send(plan);
    assert_eq!(
        rig.state.as_ref().map(|_| rig
            .events
            .iter()
            .filter(|e| matches!(e, EventKind::PlanAccepted { .. }))
            .count()),
        Some(1)
    );
}

#[test]
fn a_replan_is_joined_at_speed() {
    let (mut rig, epoch, plan) = driving();
    let time = rig.state.as_ref().unwrap().plan.as_ref().unwrap().time + 0.3;
    let rest: Vec<_> = plan
        .trajectory
        .iter()
        .filter(|point| point.t >= time)
        .copied()
        .collect();
    let start = rest[0].t;
    let next = Plan {
        trajectory: rest
            .iter()
            .map(|point| TrajectoryPoint {
                t: point.t - start,
                ..*point
            })
            .collect(),
        splice: Some(Splice {
            trajectory_id: 7,
            time: start,
        }),
        based_on: BasedOn {
            stamp: rig.now,
            ..plan.based_on.clone()
        },
        ..rig.waypoints(epoch, 2, 8, &[])
    };
    rig.send(next);
    assert_eq!(rig.rejection(), None);
    let mut slowest = f64::INFINITY;
    for _ in 0..100 {
        rig.tick();
        slowest = slowest.min(rig.velocity.v);
    }
    assert!(slowest > 0.45, "no slowdown at the splice: {slowest}");
    assert_eq!(rig.state.unwrap().plan.unwrap().trajectory_id, 8);
}

#[test]
fn waypoints_are_driven_while_renewed() {
    let mut rig = fresh();
    let epoch = rig.mission();
    for counter in 1..30 {
        let plan = rig.waypoints(epoch, counter, 1, &[(1.5, 0.0), (1.5, 1.5), (0.0, 1.5)]);
        rig.send(plan);
        rig.run(1.0);
    }
    assert!(rig.state.unwrap().plan.unwrap().finished);
    assert!(rig.pose.distance(&Pose2::new(0.0, 1.5, 0.0)) < 0.15, "{:?}", rig.pose);
}

#[test]
fn a_maneuver_runs_once_for_its_id() {
    let mut rig = fresh();
    let epoch = rig.mission();
    let spin = |id: &str| {
        EdgeRequest::Behaviour(BehaviourRequest {
            id: id.into(),
            action: BehaviourAction::Spin { angle: 1.0 },
            epoch: Some(epoch),
        })
    };
    rig.ask(spin("s1")).unwrap();
    rig.run(4.0);
    assert!((rig.pose.yaw - 1.0).abs() < 0.05, "{:?}", rig.pose);
    let Ok(EdgeReply::Behaviour(BehaviourReply { report: Some(report) })) = rig.ask(spin("s1")) else {
        panic!()
    };
    assert_eq!(report.state, BehaviourState::Succeeded);
    rig.run(2.0);
    assert!((rig.pose.yaw - 1.0).abs() < 0.05, "nothing starts again");
}

#[test]
fn a_maneuver_that_is_canceled_before_its_start_comes_does_not_begin_and_none_is_so_slow_that_it_lasts_for_hours() {
    let mut rig = fresh();
    let epoch = rig.mission();
    let ask = |rig: &mut Rig, id: &str, action| {
        rig.ask(EdgeRequest::Behaviour(BehaviourRequest {
            id: id.into(),
            action,
            epoch: Some(epoch),
        }))
    };
    ask(&mut rig, "late", BehaviourAction::Cancel).unwrap();
    let reply = ask(&mut rig, "late", BehaviourAction::Spin { angle: 1.0 });
    let Ok(EdgeReply::Behaviour(BehaviourReply { report: Some(report) })) = reply else {
        panic!("{reply:?}")
    };
    assert_eq!(report.state, BehaviourState::Canceled);
    rig.run(2.0);
    assert!(rig.pose.yaw.abs() < 0.01, "{:?}", rig.pose);
    let crawl = BehaviourAction::Drive {
        distance: 10.0,
        speed: 1e-9,
    };
    let reply = ask(&mut rig, "crawl", crawl);
    let report = match &reply {
        Ok(EdgeReply::Behaviour(BehaviourReply { report })) => report.clone(),
        _ => None,
    };
    assert!(
        reply.is_err() || report.is_some_and(|report| report.state == BehaviourState::Failed),
        "{reply:?}"
    );
}

#[test]
fn from_close_to_a_wall_it_drives_to_the_nearest_free_place() {
    let mut rig = fresh();
    rig.pose = Pose2::new(ROOM - 0.265 - 0.03, 0.0, 0.0);
    rig.pilot = crate::pilot::Pilot::new(
        crate::config::EdgeConfig::new(zenav_protocol::id::Id::robot("r").unwrap(), rig.model.clone(), rig.pose),
        "boot-1".into(),
        Persisted::default(),
    );
    rig.run(0.3);
    let epoch = rig.mission();
    let to_free = |id: &str, within| {
        EdgeRequest::Behaviour(BehaviourRequest {
            id: id.into(),
            action: BehaviourAction::ToFree { clearance: 0.2, within },
            epoch: Some(epoch),
        })
    };
    rig.ask(to_free("near", 0.05)).unwrap();
    rig.run(0.5);
    let report = rig.state.as_ref().unwrap().behaviour.clone().unwrap();
    assert_eq!(report.state, BehaviourState::Failed, "not within five centimetres");
    assert!(rig.at_rest());
    rig.ask(to_free("free", 1.0)).unwrap();
    rig.run(15.0);
    let report = rig.state.as_ref().unwrap().behaviour.clone().unwrap();
    assert_eq!(
        (report.id.as_str(), report.state),
        ("free", BehaviourState::Succeeded),
        "{report:?} {:?}",
        rig.pose
    );
    let clearance = ROOM - rig.pose.x.abs().max(rig.pose.y.abs()) - 0.265;
    assert!((0.18..0.3).contains(&clearance), "{clearance}: {:?}", rig.pose);
}

#[test]
fn a_blind_robot_stops() {
    let (mut rig, _, _) = driving();
    rig.scanning = false;
    rig.run(1.5);
    assert!(rig.at_rest());
    assert_eq!(stops_for(&rig, "scan too old"), 1);
}

/// Everything that may be wrong with a plan.
fn spoil(plan: &mut Plan, how: usize, index: usize) {
    let index = index % plan.trajectory.len();
    let last = plan.trajectory.len() - 1;
    let mut points = plan.trajectory.to_vec();
    match how {
        0 => plan.epoch += 1,
        1 => {
            plan.revision = Revision {
                incarnation: 0,
                counter: 99,
            }
        }
        2 => plan.based_on.boot_id = "boot-0".into(),
        3 => plan.based_on.stamp = zenav_protocol::time::Stamp::from_secs(1e6),
        4 => plan.valid_for = -1.0,
        5 => plan.valid_for = f64::NAN,
        6 => plan.frame = "odom".into(),
        7 => points[index].x = f64::NAN,
        8 => points[index.max(1)].t = 0.0,
        9 => points[index].v = 3.0,
        10 => points.iter_mut().for_each(|point| point.y += 1.0),
        11 => points[last].v = 0.4,
        12 => points.truncate(0),
        13 => points[index].w = f64::INFINITY,
        14 => plan.based_on.stamp = zenav_protocol::time::Stamp::from_secs(1.0),
        _ => points[index].x += 40.0,
    }
    plan.trajectory = points.into();
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(48))]
    #[test]
    fn a_broken_stale_or_foreign_plan_never_moves_the_robot(how in 0..16_usize, index in 0..200_usize) {
        let mut rig = fresh();
        let epoch = rig.mission();
        let good = rig.waypoints(epoch, 3, 1, &[(0.02, 0.0)]);
        rig.send(good);
        rig.run(0.5);
        let before = rig.pose;
        let mut plan = rig.ahead(epoch, 4, 2, 2.0);
        spoil(&mut plan, how, index);
        rig.send(plan);
        rig.run(1.0);
        prop_assert!(before.distance(&rig.pose) < 0.01, "{how} moved it to {:?}", rig.pose);
        prop_assert!(rig.rejection().is_some());
    }

    #[test]
    fn re_ordered_plans_end_in_the_newest(order in Just((1..=6_u64).collect::<Vec<_>>()).prop_shuffle()) {
        let mut rig = fresh();
        let epoch = rig.mission();
        let plans: Vec<_> = order.iter().map(|counter| rig.ahead(epoch, *counter, *counter, 1.0)).collect();
        for plan in plans {
            rig.send(plan);
        }
        rig.run(0.2);
        prop_assert_eq!(rig.state.unwrap().plan.unwrap().trajectory_id, 6);
    }
}

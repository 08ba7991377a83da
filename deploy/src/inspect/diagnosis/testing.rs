//! Observations of a robot that is well, for tests.

use std::time::Duration;

use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::{EdgeState, LeaseRole, LeaseState, Link, Mode, PoseEstimate};
use zenav_protocol::time::Stamp;

use super::{Heard, Robot, judge};
use crate::inspect::check::Verdict;

pub(super) const TIME: Duration = Duration::from_secs(2);

pub(super) fn state() -> EdgeState {
    EdgeState {
        stamp: Stamp(1),
        boot_id: "b".into(),
        mode: Mode::Follow,
        link: Link::Connected,
        lease: LeaseState {
            holder: Some("m1".into()),
            role: Some(LeaseRole::Mission),
            epoch: 4,
            live: true,
            ..LeaseState::default()
        },
        velocity: Twist2::new(0.4, 0.0),
        battery: 0.9,
        uplink: 1.0,
        ..EdgeState::default()
    }
}

pub(super) fn fresh<T>(last: T) -> Heard<T> {
    Heard {
        first: None,
        last: Some(last),
        count: 20,
        age: Some(Duration::from_millis(50)),
    }
}

pub(super) fn well() -> Robot {
    let pose = PoseEstimate {
        stamp: Stamp(1),
        map_from_base: Pose2::IDENTITY,
        covariance: [0.0; 9],
        velocity: Twist2::ZERO,
        frame: 0,
    };
    Robot {
        name: "r".into(),
        alive: ["edge", "mapping", "mission"].map(str::to_owned).into(),
        state: fresh(state()),
        pose: fresh(pose),
        scan: fresh(()),
        heartbeat: fresh(()),
        ..Robot::default()
    }
}

pub(super) fn worst(robot: &Robot, check: &str) -> Verdict {
    judge(robot, TIME)
        .iter()
        .filter(|found| found.check == check)
        .map(|found| found.verdict)
        .max()
        .unwrap()
}

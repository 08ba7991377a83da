//! Lease. Who may command the robot, and does its mission lead?

use zenav_protocol::messages::{EdgeState, InfoReply, Leader, LeaseRole, MissionStatus};

use super::Robot;
use crate::inspect::check::Check;

pub(super) fn lease(robot: &Robot, state: &EdgeState) -> Check {
    const MAKE_ROOM: &str = "make room on the disk of its mission (`storage` above), which then leads again";
    let name = robot.name.as_str();
    let has_no_room = state
        .lease
        .leader
        .as_ref()
        .is_some_and(|leader| waits_for_room(robot, leader));
    let Some(holder) = &state.lease.holder else {
        let seen = format!("nobody holds the lease (last epoch {})", state.lease.epoch);
        return match &state.lease.leader {
            Some(leader) if !state.lease.leader_live => Check::fail(
                name,
                "lease",
                format!("{seen}; only {} may lead next", leader.caught_up.join(" or ")),
                match has_no_room {
                    true => MAKE_ROOM,
                    false => "start the mission with that store; if it will not come back: `zenav lease forget`",
                },
            ),
            _ => Check::warn(
                name,
                "lease",
                seen,
                "start a mission (`zenav cloud mission`), or take it: `zenav teleop`",
            ),
        };
    };
    let beats = match robot.heartbeat.age {
        Some(age) => format!("heartbeat {:.2} s ago", age.as_secs_f64()),
        None => "no heartbeat".to_owned(),
    };
    let seen = format!("{holder} (epoch {}), link {:?}, {beats}", state.lease.epoch, state.link);
    if !state.lease.live {
        let mut seen = format!("{seen}, lapsed");
        if let Some(leader) = &state.lease.leader {
            seen.push_str(&format!("; only {} may lead next", leader.caught_up.join(" or ")));
        }
        let advice = match has_no_room {
            true => MAKE_ROOM,
            false => {
                "is a mission with that store running, and linked to this router? if its disk is lost: `zenav lease forget`"
            }
        };
        Check::fail(name, "lease", seen, advice)
    } else if state.lease.role == Some(LeaseRole::Operator) {
        Check::warn(
            name,
            "lease",
            seen,
            "an operator is driving: missions wait until the lease is released (Enter in `zenav teleop`, or `zenav lease release`)",
        )
    } else {
        Check::ok(name, "lease", seen)
    }
}

/// Whether a mission that may lead only waits for room on its disk. One that started without room does not know its store's name yet.
fn waits_for_room(robot: &Robot, leader: &Leader) -> bool {
    let may_lead = |info: &InfoReply| info.store.as_ref().is_none_or(|store| leader.caught_up.contains(store));
    robot
        .infos
        .iter()
        .any(|info| info.not_stored.is_some() && may_lead(info))
}

pub(super) fn mission(name: &str, told: &MissionStatus) -> Check {
    let (holder, queued) = (&told.holder, told.queued);
    if told.leads {
        let goal = told.goal_id.as_deref().unwrap_or("no goal");
        let seen = format!("{holder} leads, {}: {goal}, {queued} waiting", standbys(told));
        Check::ok(name, "mission", seen)
    } else {
        let seen = format!("{holder} does not lead");
        Check::warn(name, "mission", seen, "`zenav lease` shows who may command the robot")
    }
}

/// The standbys that could take over from a leader, in words.
pub(in super::super) fn standbys(mission: &MissionStatus) -> String {
    match mission.standbys.len() {
        0 => "alone".to_owned(),
        1 => "with a standby".to_owned(),
        more => format!("with {more} standbys"),
    }
}

#[cfg(test)]
mod tests {
    use zenav_protocol::SCHEMA_VERSION;
    use zenav_protocol::messages::Mode;

    use super::super::judge;
    use super::super::testing::{TIME, fresh, state, well, worst};
    use super::*;
    use crate::inspect::check::Verdict;

    #[test]
    fn a_lapsed_lease_fails_and_a_stopped_robot_warns() {
        let mut robot = well();
        let mut seen = state();
        seen.lease.live = false;
        seen.mode = Mode::Stopped;
        robot.state = fresh(seen);
        assert_eq!(
            (worst(&robot, "lease"), worst(&robot, "mode")),
            (Verdict::Fail, Verdict::Warn)
        );
    }

    #[test]
    fn a_mission_without_room_is_named_and_its_goals_are_not_given_up() {
        let mut robot = well();
        let mut seen = state();
        seen.lease.live = false;
        seen.lease.leader = Some(Leader {
            store: "anna".into(),
            epoch: 3,
            caught_up: vec!["anna".into()],
            revision: 1,
        });
        let mission = InfoReply {
            component: "mission".into(),
            schema: SCHEMA_VERSION,
            store: Some("anna".into()),
            not_stored: Some("mission.redb: no space left on device".into()),
            ..InfoReply::default()
        };
        for holder in [seen.lease.holder.clone(), None] {
            seen.lease.holder = holder;
            robot.state = fresh(seen.clone());
            let lease = |robot: &Robot| {
                let checks = judge(robot, TIME);
                let lease = checks.iter().find(|check| check.check == "lease").unwrap();
                lease.advice.clone().unwrap()
            };
            robot.infos.clear();
            assert!(lease(&robot).contains("`zenav lease forget`"));
            robot.infos.push(mission.clone());
            assert!(lease(&robot).starts_with("make room on the disk"), "{}", lease(&robot));
            // One that started without room does not know its store yet.
            robot.infos[0].store = None;
            assert!(lease(&robot).starts_with("make room on the disk"), "{}", lease(&robot));
        }
        let checks = judge(&robot, TIME);
        let storage = checks.iter().find(|check| check.check == "storage").unwrap();
        assert_eq!(storage.verdict, Verdict::Fail);
        assert!(storage.seen.contains("mission.redb: no space left"), "{}", storage.seen);
    }
}

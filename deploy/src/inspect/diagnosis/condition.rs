//! Condition. Do the robot's messages arrive, does its control loop keep time, and what keeps it from driving?

use std::time::Duration;

use zenav_edge::collision_monitor::{NO_SCAN, SCAN_TOO_OLD};
use zenav_protocol::messages::{EdgeState, Faults, GuardZone, Mode};

use super::Heard;
use crate::inspect::check::Check;
use crate::output::{counted, hundredths, piece};

/// Longest age of a robot's newest message, if its link carries all of them.
const FRESH: Duration = Duration::from_millis(500);

/// Whether messages arrive of which the robot sends only a share (0 to 1).
pub(super) fn heard<T>(name: &str, topic: &'static str, heard: &Heard<T>, time: Duration, share: f64) -> Check {
    let longest = FRESH.div_f64(share);
    let silence = format!("nothing in {:.1} s", time.as_secs_f64());
    match heard.age {
        None if time < longest => Check::ok(name, topic, format!("{silence}, for the link is narrow")),
        None => Check::fail(name, topic, silence, "is the edge running, and linked to this router?"),
        Some(age) => {
            let rate = heard.count as f64 / time.as_secs_f64().max(1e-3);
            let seen = format!("{rate:.1} a second, the newest {:.2} s old", age.as_secs_f64());
            if age > longest {
                Check::warn(name, topic, seen, "the link stutters, or the writer is overloaded")
            } else {
                Check::ok(name, topic, seen)
            }
        }
    }
}

/// Whether ticks came too late between the first and the last state heard. Earlier ones alone are no reason to act now.
pub(super) fn control_loop(name: &str, first: Option<&EdgeState>, last: &EdgeState, time: Duration) -> Option<Check> {
    const CHECK: &str = "control loop";
    let all = last.missed_ticks;
    let before = first.filter(|first| first.boot_id == last.boot_id);
    let late = all.saturating_sub(before.map_or(0, |first| first.missed_ticks));
    let secs = time.as_secs_f64();
    match (all, late) {
        (0, _) => None,
        (_, 0) => {
            let seen = format!("none of its ticks came too late in {secs:.1} s; {all} since the start");
            Some(Check::ok(name, CHECK, seen))
        }
        _ => {
            let seen = match before {
                Some(_) => format!(
                    "{} came too late in {secs:.1} s; {all} since the start",
                    counted(late, "tick")
                ),
                None => format!("{} came too late since the start", counted(all, "tick")),
            };
            Some(Check::warn(name, CHECK, seen, "give the robot's machine less to do"))
        }
    }
}

/// Doubts about the robot's link and battery.
pub(super) fn doubts(name: &str, state: &EdgeState) -> Vec<Check> {
    let narrow = (state.uplink < 1.0).then(|| {
        let share = 100.0 * state.uplink;
        let seen = format!("the robot sends {share:.0} % of its scans, poses and readings");
        let advice = "its link carries no more: maps grow later, and driving goes on; a wider link mends it";
        Check::warn(name, "uplink", seen, advice)
    });
    let low = (state.battery < 0.15).then(|| {
        let seen = format!("{:.0} %", 100.0 * state.battery);
        Check::warn(name, "battery", seen, "charge the robot")
    });
    [narrow, low].into_iter().flatten().collect()
}

/// The faults that the robot itself reports.
pub(super) fn faults(name: &str, faults: &Faults) -> Vec<Check> {
    let body = faults.body.iter().map(|why| {
        Check::fail(
            name,
            "body",
            why,
            "does the process that reads the sensors run, and nobody else under the robot's name? if its time began anew: restart the edge",
        )
    });
    let storage = faults.storage.iter().map(|why| {
        Check::fail(
            name,
            "storage",
            format!("epoch and stop are not stored: {why}"),
            "make room on the robot's disk; before that a restart of its edge forgets a stop, and no lease is granted",
        )
    });
    let lidar = faults.lidar.iter().map(|what| {
        Check::warn(
            name,
            "lidar",
            format!("{what}: the robot drives slowly"),
            "mount it straight, or correct `mount.yaw` in the robot's file; then restart the edge",
        )
    });
    body.chain(storage).chain(lidar).collect()
}

pub(super) fn mode(name: &str, state: &EdgeState, reason: Option<&str>) -> Check {
    let seen = format!("{:?}, {:+.2} m/s", state.mode, hundredths(state.velocity.v));
    if state.mode == Mode::Stopped {
        Check::warn(name, "mode", seen, "stopped by an operator: `zenav resume` releases it")
    } else if state.guard == GuardZone::Stop {
        let why = piece(reason, |reason| format!(": {reason}"));
        let advice = match reason {
            Some(SCAN_TOO_OLD | NO_SCAN) => "do all its lidars send, at the rates of the robot's file?",
            _ => "if an obstacle is too near: remove it, or drive away with `zenav teleop`",
        };
        Check::warn(
            name,
            "mode",
            format!("{seen}, held by its collision monitor{why}"),
            advice,
        )
    } else {
        Check::ok(name, "mode", seen)
    }
}

#[cfg(test)]
mod tests {
    use super::super::judge;
    use super::super::testing::{TIME, fresh, state, well, worst};
    use super::*;
    use crate::inspect::check::Verdict;

    #[test]
    fn ticks_that_came_too_late_before_doctor_listened_are_told_and_no_warning() {
        let mut robot = well();
        let missed = |missed_ticks| EdgeState {
            missed_ticks,
            ..state()
        };
        for (first, last, verdict, told) in [
            (None, 7, Verdict::Warn, "7 ticks came too late since the start"),
            (Some(7), 7, Verdict::Ok, "7 since the start"),
            (Some(7), 9, Verdict::Warn, "2 ticks came too late in "),
            (Some(7), 8, Verdict::Warn, "1 tick came too late in "),
        ] {
            robot.state = fresh(missed(last));
            robot.state.first = first.map(missed);
            let checks = judge(&robot, TIME);
            let check = checks.iter().find(|check| check.check == "control loop").unwrap();
            assert_eq!(check.verdict, verdict, "{}", check.seen);
            assert!(check.seen.contains(told), "{}", check.seen);
        }
        robot.state = fresh(missed(0));
        assert!(judge(&robot, TIME).iter().all(|check| check.check != "control loop"));
    }

    #[test]
    fn what_a_narrow_link_holds_back_is_not_missed() {
        let mut robot = well();
        robot.scan = Heard::default();
        let mut seen = state();
        seen.uplink = 0.05;
        robot.state = fresh(seen.clone());
        assert_eq!(
            (worst(&robot, "scan"), worst(&robot, "uplink")),
            (Verdict::Ok, Verdict::Warn)
        );
        seen.uplink = 0.5;
        robot.state = fresh(seen);
        assert_eq!(worst(&robot, "scan"), Verdict::Fail, "two seconds are long enough");
    }

    #[test]
    fn a_silent_body_and_a_full_disk_fail_and_are_named() {
        let mut robot = well();
        let mut seen = state();
        seen.faults = Faults {
            body: Some("no readings for 200ms".into()),
            storage: Some("no space left".into()),
            lidar: Some("`lidar` looks 5° farther to the left than its file says".into()),
        };
        robot.state = fresh(seen);
        assert_eq!(
            (worst(&robot, "body"), worst(&robot, "storage"), worst(&robot, "lidar")),
            (Verdict::Fail, Verdict::Fail, Verdict::Warn)
        );
    }

    #[test]
    fn a_robot_that_its_collision_monitor_holds_is_told_why() {
        let mut robot = well();
        robot.state = fresh(EdgeState {
            guard: GuardZone::Stop,
            ..state()
        });
        for (reason, advice) in [
            (SCAN_TOO_OLD, "do all its lidars send"),
            ("obstacle in the way", "remove it"),
        ] {
            robot.guard_reason = Some(reason.to_owned());
            let checks = judge(&robot, TIME);
            let mode = checks.iter().find(|check| check.check == "mode").unwrap();
            assert!(
                mode.seen.ends_with(&format!("collision monitor: {reason}")),
                "{}",
                mode.seen
            );
            assert!(mode.advice.as_ref().unwrap().contains(advice), "{:?}", mode.advice);
        }
    }
}

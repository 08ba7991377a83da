//! Diagnosis. Judges each observation of a deployment as ok, warn or fail, with advice. Pure: the observations are passed in.

use std::collections::BTreeSet;
use std::time::Duration;

use zenav_edge::collision_monitor::{NO_SCAN, SCAN_TOO_OLD};
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::messages::{
    EdgeState, Faults, GuardZone, Health, InfoReply, Leader, LeaseRole, Localisation, MapInfo, MissionStatus, Mode,
    PoseEstimate,
};

use super::check::Check;
use crate::output::hundredths;

/// What was received on a topic while listening.
#[derive(Clone, Debug)]
pub(super) struct Heard<T> {
    /// The first value, once there is a second one.
    pub(super) first: Option<T>,
    /// The newest value.
    pub(super) last: Option<T>,
    /// Number of values received.
    pub(super) count: u64,
    /// Time from the newest value to the end of listening.
    pub(super) age: Option<Duration>,
}

// Not derived: the derive would require `T: Default` of the message.
impl<T> Default for Heard<T> {
    fn default() -> Self {
        Self {
            first: None,
            last: None,
            count: 0,
            age: None,
        }
    }
}

/// Observations of one robot.
#[derive(Clone, Debug, Default)]
pub(super) struct Robot {
    pub(super) name: String,
    /// Components with a liveliness token.
    pub(super) alive: BTreeSet<String>,
    pub(super) state: Heard<EdgeState>,
    /// What the collision monitor's last verdict was based on.
    pub(super) guard_reason: Option<String>,
    pub(super) pose: Heard<PoseEstimate>,
    pub(super) scan: Heard<()>,
    pub(super) heartbeat: Heard<()>,
    pub(super) mission: Option<MissionStatus>,
    pub(super) map: Option<MapInfo>,
    /// The last word of the off-board source of poses, if there is one.
    pub(super) localisation: Option<Localisation>,
    /// Replies to `info`.
    pub(super) infos: Vec<InfoReply>,
}

/// Longest age of a robot's newest message, if its link carries all of them.
const FRESH: Duration = Duration::from_millis(500);

/// Observations of the clock.
#[derive(Clone, Debug, Default)]
pub(super) struct ClockSeen {
    /// Simulated seconds per wall second, if simulated time is published.
    pub(super) simulated_rate: Option<f64>,
    /// Number of times it stepped back by more than a second.
    pub(super) steps_back: u32,
}

/// Judges one robot after listening for `time`.
pub(super) fn judge(robot: &Robot, time: Duration) -> Vec<Check> {
    let name = robot.name.as_str();
    let mut checks = vec![
        alive(robot, "edge", "the robot itself: `zenav edge`"),
        alive(robot, "mapping", "`zenav cloud mapping`"),
        alive(robot, "mission", "`zenav cloud mission`"),
    ];
    checks.extend(namesakes(robot));
    checks.extend(robot.infos.iter().map(|info| schema(name, info)));
    checks.extend(robot.infos.iter().filter_map(|info| stores_nothing(name, info)));
    checks.push(heard(name, "state", &robot.state, time, 1.0));
    // On a narrow link the robot itself decimates these.
    let share = robot
        .state
        .last
        .as_ref()
        .map_or(1.0, |state| state.uplink)
        .clamp(1e-3, 1.0);
    checks.push(heard(name, "pose", &robot.pose, time, share));
    checks.push(heard(name, "scan", &robot.scan, time, share));
    if let Some(state) = &robot.state.last {
        checks.push(lease(robot, state));
        checks.push(mode(name, state, robot.guard_reason.as_deref()));
        checks.extend(faults(name, &state.faults));
        checks.extend(control_loop(name, robot.state.first.as_ref(), state, time));
        checks.extend(doubts(name, state));
    }
    let boot = robot.state.last.as_ref().map(|state| &state.boot_id);
    let told = robot.localisation.as_ref();
    let told = told.filter(|told| boot.is_none_or(|boot| *boot == told.boot_id));
    let has_stored_map = robot.map.as_ref().is_some_and(|map| map.stored);
    checks.extend(told.map(|told| localisation(name, told, has_stored_map)));
    let is_trusted = told.is_none_or(|told| told.health.is_trusted());
    if let Some(pose) = robot.pose.last.as_ref().filter(|_| is_trusted) {
        checks.push(estimate(name, pose));
    }
    checks.push(map(robot));
    checks.extend(robot.mission.as_ref().map(|told| mission(name, told)));
    checks
}

/// Whether ticks came too late between the first and the last state heard. Earlier ones alone are no reason to act now.
fn control_loop(name: &str, first: Option<&EdgeState>, last: &EdgeState, time: Duration) -> Option<Check> {
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
                Some(_) => format!("{late} ticks came too late in {secs:.1} s; {all} since the start"),
                None => format!("{all} ticks came too late since the start"),
            };
            Some(Check::warn(name, CHECK, seen, "give the robot's machine less to do"))
        }
    }
}

/// Doubts about the robot's link and battery.
fn doubts(name: &str, state: &EdgeState) -> Vec<Check> {
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

fn estimate(name: &str, pose: &PoseEstimate) -> Check {
    let (at, check) = (pose.map_from_base, "estimate");
    let spread = pose.covariance[0].max(pose.covariance[4]).max(0.0).sqrt();
    if !at.is_finite() || !spread.is_finite() {
        Check::fail(name, check, "not a number", "restart the edge, and report this")
    } else if spread > 0.5 {
        let seen = format!("uncertain by {spread:.2} m");
        let advice = "the robot may not know where it is: check its sensors and start pose";
        Check::warn(name, check, seen, advice)
    } else {
        let seen = format!("({:.2}, {:.2}), standard deviation {spread:.3} m", at.x, at.y);
        Check::ok(name, check, seen)
    }
}

fn mission(name: &str, told: &MissionStatus) -> Check {
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
pub(super) fn standbys(mission: &MissionStatus) -> String {
    match mission.standbys.len() {
        0 => "alone".to_owned(),
        1 => "with a standby".to_owned(),
        more => format!("with {more} standbys"),
    }
}

fn alive(robot: &Robot, component: &'static str, start: &str) -> Check {
    if robot.alive.contains(component) {
        Check::ok(&robot.name, component, "alive")
    } else {
        Check::fail(&robot.name, component, "does not show", &format!("start it: {start}"))
    }
}

/// Several edges with one name: all other observations of them are mixed up.
fn namesakes(robot: &Robot) -> Option<Check> {
    let edges = robot.infos.iter().filter(|info| info.component == "edge");
    let processes = edges.filter_map(|edge| edge.process.as_ref());
    let told: BTreeSet<_> = processes
        .map(|process| (&process.host, process.pid, process.instance))
        .collect();
    (told.len() > 1).then(|| {
        let names: Vec<String> = told
            .iter()
            .map(|(host, pid, _)| format!("{host} (pid {pid})"))
            .collect();
        Check::fail(
            &robot.name,
            "edge",
            format!("{} edges have this name: {}", told.len(), names.join(", ")),
            "stop all but one, or give each its own name; the other checks of this robot mix them up",
        )
    })
}

/// Whether the robot knows its place in the map, as the source of poses judges by its scans.
fn localisation(name: &str, told: &Localisation, has_stored_map: bool) -> Check {
    let at = told.map_from_base;
    let check = "localisation";
    match &told.health {
        Health::Tracking => Check::ok(name, check, "its scans agree with the map"),
        Health::Degraded { direction } => Check::ok(
            name,
            check,
            format!("its scans agree with the map, which leaves the pose open along {direction:.2} rad"),
        ),
        Health::Unchecked => Check::ok(
            name,
            check,
            match has_stored_map {
                true => {
                    "the robot's own estimate; its scans were not compared with a known map: the map is unknown around the robot, the pose \
                     was just set, or mapping began without a map"
                }
                false => "the robot's own estimate; its scans were not compared with a known map: there is none",
            },
        ),
        Health::Contradicted => Check::fail(
            name,
            check,
            format!(
                "its scans do not agree with the map at its own estimate, ({:.2}, {:.2}, {:.2} rad): {:.0} % of the last one",
                at.x,
                at.y,
                at.yaw,
                100.0 * told.agreeing
            ),
            "it drives all the same. Is it the right map? `zenav pose set X Y YAW` tells it where it is; with `mapping.poses = \"localise\"` \
             it is corrected, and `zenav pose search` finds it. If the building has changed, map it anew: `zenav map reset`",
        ),
        Health::Ambiguous { hypotheses } => {
            let places: Vec<String> = hypotheses
                .iter()
                .map(|at| format!("({:.2}, {:.2}, {:.2} rad)", at.x, at.y, at.yaw))
                .collect();
            Check::fail(
                name,
                check,
                format!("its scan fits {} places: {}", places.len(), places.join(", ")),
                "tell it which one is right: `zenav pose set X Y YAW`; it does not drive meanwhile",
            )
        }
        untrusted => Check::fail(
            name,
            check,
            format!("{untrusted}, last at ({:.2}, {:.2}, {:.2} rad)", at.x, at.y, at.yaw),
            "is it the right map? tell it where it is: `zenav pose set X Y YAW`; it does not drive meanwhile",
        ),
    }
}

fn schema(name: &str, info: &InfoReply) -> Check {
    let seen = format!("{} {}, messages version {}", info.component, info.version, info.schema);
    if info.schema == SCHEMA_VERSION {
        Check::ok(name, "version", seen)
    } else {
        Check::fail(
            name,
            "version",
            format!("{seen}, this program has {SCHEMA_VERSION}"),
            "install the same zenav everywhere",
        )
    }
}

/// A mission whose disk is full.
fn stores_nothing(name: &str, info: &InfoReply) -> Option<Check> {
    let why = info.not_stored.as_ref()?;
    let host = info.process.as_ref().map(|process| process.host.as_str());
    let seen = format!("the mission on {} stores no goals: {why}", host.unwrap_or("its host"));
    let advice = "make room on that disk: the mission then goes on by itself; before that it acknowledges nothing, and does not lead";
    Some(Check::fail(name, "storage", seen, advice))
}

/// Whether a mission that may lead only waits for room on its disk. One that started without room does not know its store's name yet.
fn waits_for_room(robot: &Robot, leader: &Leader) -> bool {
    let may_lead = |info: &InfoReply| info.store.as_ref().is_none_or(|store| leader.caught_up.contains(store));
    robot
        .infos
        .iter()
        .any(|info| info.not_stored.is_some() && may_lead(info))
}

/// Whether messages arrive of which the robot sends only a share (0 to 1).
fn heard<T>(name: &str, topic: &'static str, heard: &Heard<T>, time: Duration, share: f64) -> Check {
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

fn lease(robot: &Robot, state: &EdgeState) -> Check {
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

/// The faults that the robot itself reports.
fn faults(name: &str, faults: &Faults) -> Vec<Check> {
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

fn mode(name: &str, state: &EdgeState, reason: Option<&str>) -> Check {
    let seen = format!("{:?}, {:+.2} m/s", state.mode, hundredths(state.velocity.v));
    if state.mode == Mode::Stopped {
        Check::warn(name, "mode", seen, "stopped by an operator: `zenav resume` releases it")
    } else if state.guard == GuardZone::Stop {
        let why = reason.map_or_else(String::new, |reason| format!(": {reason}"));
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

fn map(robot: &Robot) -> Check {
    let name = robot.name.as_str();
    let Some(info) = &robot.map else {
        return Check::warn(
            name,
            "map",
            "none yet",
            "is mapping running? A map begins with the first scan",
        );
    };
    let spec = &info.spec;
    let seen = format!(
        "{} revision {}, {:.1} m by {:.1} m at {} m, {} scans{}",
        info.map.id,
        info.map.revision,
        f64::from(spec.width) * spec.resolution,
        f64::from(spec.height) * spec.resolution,
        spec.resolution,
        info.scans,
        if info.stored { ", stored" } else { "" }
    );
    if info.free == 0 {
        Check::warn(
            name,
            "map",
            format!("{seen}, no free cell"),
            "let the robot see its surroundings: drive a mapping tour",
        )
    } else {
        Check::ok(name, "map", seen)
    }
}

/// Judges the link of this command: `is_at_robot` if only robots answer there.
pub(super) fn link(is_at_robot: bool) -> Check {
    match is_at_robot {
        false => Check::ok("router", "link", "connected"),
        true => Check::warn(
            "router",
            "link",
            "only the robot answers: this is its own endpoint, or nothing else runs",
            "the cloud is seen from a router: `--connect` names one",
        ),
    }
}

/// Judges the workers shared by all robots.
pub(super) fn workers(service: &'static str, count: usize) -> Check {
    match count {
        0 => Check::fail("svc", service, "no worker shows", "start one: `zenav cloud motion`"),
        1 => Check::ok("svc", service, "1 worker"),
        several => Check::ok("svc", service, format!("{several} workers")),
    }
}

/// Judges the common clock.
pub(super) fn clock(seen: &ClockSeen) -> Check {
    match seen.simulated_rate {
        Some(_) if seen.steps_back > 1 => Check::fail(
            "clock",
            "time",
            "two simulations give the time",
            "end one of the edges: robots of one deployment share one world (`zenav up`, or `zenav sim serve` with `zenav edge --attach`)",
        ),
        None => Check::ok("clock", "time", "wall clock (no simulated time is published)"),
        Some(rate) if rate < 0.05 => Check::fail(
            "clock",
            "time",
            "simulated time stands still",
            "the simulation has stopped: restart the edge that hosts it",
        ),
        Some(rate) => Check::ok("clock", "time", format!("simulated, {rate:.2} times wall time")),
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
pub(super) mod tests {
    use zenav_protocol::geometry::{Pose2, Twist2};
    use zenav_protocol::messages::{LeaseState, Link, ProcessInfo};
    use zenav_protocol::time::Stamp;

    use super::super::check::Verdict;
    use super::*;

    const TIME: Duration = Duration::from_secs(2);

    pub(in super::super) fn state() -> EdgeState {
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

    fn fresh<T>(last: T) -> Heard<T> {
        Heard {
            first: None,
            last: Some(last),
            count: 20,
            age: Some(Duration::from_millis(50)),
        }
    }

    fn well() -> Robot {
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

    fn worst(robot: &Robot, check: &str) -> Verdict {
        judge(robot, TIME)
            .iter()
            .filter(|found| found.check == check)
            .map(|found| found.verdict)
            .max()
            .unwrap()
    }

    #[test]
    fn a_well_robot_fails_nothing() {
        assert!(judge(&well(), TIME).iter().all(|check| check.verdict != Verdict::Fail));
    }

    #[test]
    fn what_is_missing_fails_and_says_what_to_do() {
        let mut robot = well();
        robot.alive.remove("mission");
        robot.scan = Heard::default();
        assert_eq!(
            (worst(&robot, "mission"), worst(&robot, "scan")),
            (Verdict::Fail, Verdict::Fail)
        );
        assert!(
            judge(&robot, TIME)
                .iter()
                .all(|check| (check.verdict == Verdict::Ok) == check.advice.is_none())
        );
    }

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
    fn two_edges_of_one_name_fail_and_are_named() {
        let mut robot = well();
        let edge = |pid| InfoReply {
            component: "edge".into(),
            schema: SCHEMA_VERSION,
            process: Some(ProcessInfo {
                host: "anna".into(),
                pid,
                ..ProcessInfo::default()
            }),
            ..InfoReply::default()
        };
        robot.infos = vec![edge(3), edge(3)];
        assert_eq!(worst(&robot, "edge"), Verdict::Ok, "one, heard twice");
        robot.infos.push(edge(4));
        let checks = judge(&robot, TIME);
        let failed = checks.iter().find(|check| check.verdict == Verdict::Fail).unwrap();
        assert_eq!(failed.seen, "2 edges have this name: anna (pid 3), anna (pid 4)");
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

    #[test]
    fn a_robot_that_localises_itself_fails_where_its_scans_contradict_the_map() {
        let mut robot = well();
        for (health, verdict, seen) in [
            (
                Health::Unchecked,
                Verdict::Ok,
                "not compared with a known map: there is none",
            ),
            (Health::Contradicted, Verdict::Fail, "do not agree with the map"),
        ] {
            robot.localisation = Some(Localisation {
                stamp: Stamp(1),
                boot_id: "b".into(),
                health,
                map_from_base: Pose2::IDENTITY,
                agreeing: 0.1,
                through_walls: 0.3,
            });
            let checks = judge(&robot, TIME);
            let found = checks.iter().find(|check| check.check == "localisation").unwrap();
            assert_eq!(found.verdict, verdict);
            assert!(found.seen.contains(seen), "{}", found.seen);
        }
    }

    #[test]
    fn beside_a_stored_map_it_is_said_why_scans_are_not_compared() {
        let mut robot = well();
        robot.localisation = Some(Localisation {
            stamp: Stamp(1),
            boot_id: "b".into(),
            health: Health::Unchecked,
            map_from_base: Pose2::IDENTITY,
            agreeing: 0.0,
            through_walls: 0.0,
        });
        robot.map = serde_json::from_value(serde_json::json!({
            "stamp": 1, "map": { "id": "m", "revision": 1 },
            "spec": { "origin": [0.0, 0.0], "resolution": 0.05, "width": 10, "height": 10 },
            "free": 60, "occupied": 40, "unknown": 0, "scans": 0, "stored": true
        }))
        .unwrap();
        let checks = judge(&robot, TIME);
        let found = checks.iter().find(|check| check.check == "localisation").unwrap();
        assert!(
            found.seen.contains("the map is unknown around the robot"),
            "{}",
            found.seen
        );
    }

    #[test]
    fn a_robot_at_rest_has_a_speed_without_a_sign_and_an_estimate_with_its_deviation() {
        let mut robot = well();
        robot.state = fresh(EdgeState {
            velocity: Twist2::new(-0.001, 0.0),
            ..state()
        });
        let checks = judge(&robot, TIME);
        let seen = |name: &str| checks.iter().find(|check| check.check == name).unwrap().seen.clone();
        assert!(seen("mode").ends_with("+0.00 m/s"), "{}", seen("mode"));
        assert!(
            seen("estimate").ends_with("standard deviation 0.000 m"),
            "{}",
            seen("estimate")
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

    #[test]
    fn another_schema_fails_and_names_both() {
        let mut robot = well();
        robot.infos.push(InfoReply {
            component: "edge".into(),
            version: "0".into(),
            schema: SCHEMA_VERSION + 1,
            robot: "r".into(),
            ..InfoReply::default()
        });
        let check = judge(&robot, TIME)
            .into_iter()
            .find(|check| check.check == "version")
            .unwrap();
        assert_eq!(check.verdict, Verdict::Fail);
        assert!(
            check.seen.contains(&format!("has {SCHEMA_VERSION}"))
                && check.seen.contains(&format!("version {}", SCHEMA_VERSION + 1)),
            "{}",
            check.seen
        );
    }

    #[test]
    fn simulated_time_that_stands_still_fails() {
        assert_eq!(
            clock(&ClockSeen {
                simulated_rate: Some(0.0),
                steps_back: 0,
            })
            .verdict,
            Verdict::Fail
        );
        assert_eq!(
            clock(&ClockSeen {
                simulated_rate: None,
                steps_back: 0
            })
            .verdict,
            Verdict::Ok
        );
        assert_eq!(workers("motion", 0).verdict, Verdict::Fail);
    }
}

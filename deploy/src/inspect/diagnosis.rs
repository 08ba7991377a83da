//! Diagnosis. Judges each observation of a deployment as ok, warn or fail, with advice. Pure: the observations are passed in.

use std::collections::BTreeSet;
use std::time::Duration;

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::messages::{
    EdgeState, Faults, GuardZone, Health, InfoReply, LeaseRole, Localisation, MapInfo, MissionStatus, Mode,
    PoseEstimate,
};

use super::check::Check;

/// What was received on a topic while listening.
#[derive(Clone, Debug)]
pub(super) struct Heard<T> {
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
        checks.push(mode(name, state));
        checks.extend(faults(name, &state.faults));
        if state.missed_ticks > 0 {
            checks.push(Check::warn(
                name,
                "control loop",
                format!("{} ticks came too late since the start", state.missed_ticks),
                "give the robot's machine less to do",
            ));
        }
        if state.uplink < 1.0 {
            checks.push(Check::warn(
                name,
                "uplink",
                format!(
                    "the robot sends {:.0} % of its scans, poses and readings",
                    100.0 * state.uplink
                ),
                "its link carries no more: maps grow later, and driving goes on; a wider link mends it",
            ));
        }
        if state.battery < 0.15 {
            checks.push(Check::warn(
                name,
                "battery",
                format!("{:.0} %", 100.0 * state.battery),
                "charge the robot",
            ));
        }
    }
    let boot = robot.state.last.as_ref().map(|state| &state.boot_id);
    let told = robot.localisation.as_ref();
    let told = told.filter(|told| boot.is_none_or(|boot| *boot == told.boot_id));
    checks.extend(told.map(|told| localisation(name, told)));
    let is_trusted = told.is_none_or(|told| told.health.is_trusted());
    if let Some(pose) = robot.pose.last.as_ref().filter(|_| is_trusted) {
        let spread = pose.covariance[0].max(pose.covariance[4]).max(0.0).sqrt();
        checks.push(if !pose.map_from_base.is_finite() || !spread.is_finite() {
            Check::fail(name, "estimate", "not a number", "restart the edge, and report this")
        } else if spread > 0.5 {
            Check::warn(
                name,
                "estimate",
                format!("uncertain by {spread:.2} m"),
                "the robot may not know where it is: check its sensors and start pose",
            )
        } else {
            Check::ok(
                name,
                "estimate",
                format!(
                    "({:.2}, {:.2}), sure to {spread:.3} m",
                    pose.map_from_base.x, pose.map_from_base.y
                ),
            )
        });
    }
    checks.push(map(robot));
    if let Some(mission) = &robot.mission {
        checks.push(if mission.leads {
            let goal = mission.goal_id.as_deref().unwrap_or("no goal");
            Check::ok(
                name,
                "mission",
                format!(
                    "{} leads, {}: {goal}, {} waiting",
                    mission.holder,
                    standbys(mission),
                    mission.queued
                ),
            )
        } else {
            Check::warn(
                name,
                "mission",
                format!("{} does not lead", mission.holder),
                "`zenav lease` shows who may command the robot",
            )
        });
    }
    checks
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
fn localisation(name: &str, told: &Localisation) -> Check {
    let at = told.map_from_base;
    let check = "localisation";
    match &told.health {
        Health::Tracking => Check::ok(name, check, "its scans agree with the map"),
        Health::Degraded { direction } => Check::ok(
            name,
            check,
            format!("its scans agree with the map, which leaves the pose open along {direction:.2} rad"),
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
    let name = robot.name.as_str();
    let Some(holder) = &state.lease.holder else {
        let seen = format!("nobody holds the lease (last epoch {})", state.lease.epoch);
        return match &state.lease.leader {
            Some(leader) if !state.lease.leader_live => Check::fail(
                name,
                "lease",
                format!("{seen}; only {} may lead next", leader.caught_up.join(" or ")),
                "start the mission with that store; if it will not come back: `zenav lease forget`",
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
        Check::fail(
            name,
            "lease",
            seen,
            "is a mission with that store running, and linked to this router? if its disk is lost: `zenav lease forget`",
        )
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
    body.chain(storage).collect()
}

fn mode(name: &str, state: &EdgeState) -> Check {
    let seen = format!("{:?}, {:+.2} m/s", state.mode, state.velocity.v);
    if state.mode == Mode::Stopped {
        Check::warn(name, "mode", seen, "stopped by an operator: `zenav resume` releases it")
    } else if state.guard == GuardZone::Stop {
        Check::warn(
            name,
            "mode",
            format!("{seen}, held by its collision monitor"),
            "an obstacle is too near: remove it, or drive away with `zenav teleop`",
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
            frame: 0,
            boot_id: "b".into(),
            mode: Mode::Follow,
            link: Link::Connected,
            lease: LeaseState {
                holder: Some("m1".into()),
                role: Some(LeaseRole::Mission),
                epoch: 4,
                live: true,
                leader: None,
                leader_live: false,
            },
            plan: None,
            velocity: Twist2::new(0.4, 0.0),
            guard: GuardZone::Clear,
            battery: 0.9,
            behaviour: None,
            wall_follower: None,
            missed_ticks: 0,
            uplink: 1.0,
            round_trip_secs: None,
            stops: 0,
            makes_way: false,
            faults: Default::default(),
        }
    }

    fn fresh<T>(last: T) -> Heard<T> {
        Heard {
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
        };
        robot.state = fresh(seen);
        assert_eq!(
            (worst(&robot, "body"), worst(&robot, "storage")),
            (Verdict::Fail, Verdict::Fail)
        );
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

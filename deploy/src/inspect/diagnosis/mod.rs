//! Diagnosis. Judges each observation of a deployment as ok, warn or fail, with advice. Pure: the observations are passed in.
//!
//! | file | answers |
//! |---|---|
//! | `deployment` | what all robots share: the link, the workers, the clock |
//! | `parts` | do the robot and its services run, in one version? |
//! | `condition` | do its messages arrive, and does it drive undisturbed? |
//! | `lease` | who may command it? |
//! | `place` | does it know its place in the map? |
//! | `hosts` | do the machines fit together? |

mod condition;
mod deployment;
pub(super) mod hosts;
mod lease;
mod parts;
mod place;
#[cfg(test)]
mod testing;

use std::collections::BTreeSet;
use std::time::Duration;

use zenav_protocol::messages::{EdgeState, InfoReply, Localisation, MapInfo, MissionStatus, PoseEstimate};

use super::check::Check;
use condition::{control_loop, doubts, faults, heard, mode};
pub(super) use deployment::{ClockSeen, clock, link, workers};
pub(super) use lease::standbys;
use lease::{lease, mission};
use parts::{alive, namesakes, schema, stores_nothing};
use place::{estimate, localisation, map};

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

#[cfg(test)]
mod tests {
    use zenav_protocol::geometry::Twist2;

    use super::super::check::Verdict;
    use super::testing::{TIME, fresh, state, well, worst};
    use super::*;

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
}

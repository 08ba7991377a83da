//! Parts. Do the robot and its services run, each once, in this program's version, with room on their disks?

use std::collections::BTreeSet;

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::messages::InfoReply;

use super::Robot;
use crate::inspect::check::Check;
use crate::output::listed;

pub(super) fn alive(robot: &Robot, component: &'static str, start: &str) -> Check {
    if robot.alive.contains(component) {
        Check::ok(&robot.name, component, "alive")
    } else {
        Check::fail(&robot.name, component, "does not show", &format!("start it: {start}"))
    }
}

/// Several edges with one name: all other observations of them are mixed up.
pub(super) fn namesakes(robot: &Robot) -> Option<Check> {
    let edges = robot.infos.iter().filter(|info| info.component == "edge");
    let processes = edges.filter_map(|edge| edge.process.as_ref());
    let told: BTreeSet<_> = processes
        .map(|process| (&process.host, process.pid, process.instance))
        .collect();
    (told.len() > 1).then(|| {
        let names = listed(told.iter().map(|(host, pid, _)| format!("{host} (pid {pid})")));
        Check::fail(
            &robot.name,
            "edge",
            format!("{} edges have this name: {names}", told.len()),
            "stop all but one, or give each its own name; the other checks of this robot mix them up",
        )
    })
}

pub(super) fn schema(name: &str, info: &InfoReply) -> Check {
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
pub(super) fn stores_nothing(name: &str, info: &InfoReply) -> Option<Check> {
    let why = info.not_stored.as_ref()?;
    let host = info.process.as_ref().map(|process| process.host.as_str());
    let seen = format!("the mission on {} stores no goals: {why}", host.unwrap_or("its host"));
    let advice = "make room on that disk: the mission then goes on by itself; before that it acknowledges nothing, and does not lead";
    Some(Check::fail(name, "storage", seen, advice))
}

#[cfg(test)]
mod tests {
    use zenav_protocol::messages::ProcessInfo;

    use super::super::judge;
    use super::super::testing::{TIME, well, worst};
    use super::*;
    use crate::inspect::check::Verdict;

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
}

//! Hosts. Checks that the machines of a deployment fit together: one check per host, from what its parts report.

use std::collections::{BTreeMap, BTreeSet};

use zenav_protocol::SCHEMA_VERSION;

use crate::inspect::check::Check;
use crate::inspect::parts::PartStatus;
use crate::output::listed;

/// Largest clock offset of a host; beyond it, log times mislead, s.
const CLOCK: f64 = 1.0;

/// Judges every host from its parts' reports: message versions and clock.
pub(in super::super) fn judge(parts: &[PartStatus]) -> Vec<Check> {
    let mut hosts: BTreeMap<&str, Vec<&PartStatus>> = BTreeMap::new();
    for part in parts.iter().filter(|part| !part.host.is_empty()) {
        hosts.entry(&part.host).or_default().push(part);
    }
    let mut checks = mapper_copies(parts);
    for (host, parts) in hosts {
        for part in parts.iter().filter(|part| part.schema != SCHEMA_VERSION) {
            checks.push(Check::fail(
                host,
                "version",
                format!(
                    "{}: zenav {}, messages version {}, this program has {SCHEMA_VERSION}",
                    part.part, part.version, part.schema
                ),
                "install the same zenav everywhere",
            ));
        }
        let processes: BTreeSet<(u32, u32)> = parts.iter().map(|part| (part.pid, part.instance)).collect();
        let count = |count: usize, one: &str, more: &str| match count {
            1 => format!("1 {one}"),
            _ => format!("{count} {more}"),
        };
        let (parts_told, processes_told) = (
            count(parts.len(), "part", "parts"),
            count(processes.len(), "process", "processes"),
        );
        let seen = format!("{parts_told} in {processes_told}");
        checks.push(match parts.iter().find(|part| part.clock_is_off(CLOCK)) {
            Some(off) => Check::warn(
                host,
                "host",
                format!("{seen}, its clock is {:+.1} s off this machine's", off.clock_ahead_secs),
                "set its clock: no robot minds, but logs of two hosts are hard to compare",
            ),
            None => Check::ok(host, "host", seen),
        });
    }
    checks
}

/// Several mapping services of one robot: one leads, and the others stand by.
fn mapper_copies(parts: &[PartStatus]) -> Vec<Check> {
    let mut mappers: BTreeMap<&str, BTreeMap<(&str, u32, u32), bool>> = BTreeMap::new();
    for part in parts.iter().filter(|part| part.component == "mapping") {
        let process = (part.host.as_str(), part.pid, part.instance);
        mappers
            .entry(&part.robot)
            .or_default()
            .insert(process, part.leads == Some(true));
    }
    mappers.retain(|_, processes| processes.len() > 1);
    mappers
        .into_iter()
        .map(|(robot, processes)| {
            let named = |leads: bool| {
                let those = processes.iter().filter(|(_, other)| **other == leads);
                listed(those.map(|((host, pid, _), _)| format!("{host} (pid {pid})")))
            };
            match processes.values().filter(|leads| **leads).count() {
                0 => Check::warn(
                    robot,
                    "mapping",
                    format!("no mapping service leads; these stand by: {}", named(false)),
                    "one takes over once it hears the robot",
                ),
                1 => Check::ok(
                    robot,
                    "mapping",
                    format!("{} leads; {} stands by", named(true), named(false)),
                ),
                count => Check::fail(
                    robot,
                    "mapping",
                    format!("{count} mapping services write its map: {}", named(true)),
                    "they do not hear one another: connect both to the routers of the fleet",
                ),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::check::Verdict;

    fn part(host: &str, pid: u32, schema: u32, clock_ahead_secs: f64) -> PartStatus {
        PartStatus {
            part: "mapping-a".to_owned(),
            component: "mapping".to_owned(),
            robot: "a".to_owned(),
            leads: Some(true),
            answers: true,
            not_stored: None,
            host: host.to_owned(),
            pid,
            instance: 0,
            version: "0.1.0".to_owned(),
            schema,
            uptime_secs: 1.0,
            load: None,
            memory_bytes: 0,
            clock_ahead_secs,
            clock_uncertainty_secs: 0.1,
        }
    }

    #[test]
    fn a_host_with_another_schema_fails_and_one_with_another_time_is_warned_of() {
        let parts = [
            part("cloud", 1, SCHEMA_VERSION, 0.05),
            part("cloud", 1, SCHEMA_VERSION, 0.05),
            PartStatus {
                robot: "b".to_owned(),
                ..part("site", 2, SCHEMA_VERSION + 1, 3600.0)
            },
            // An old version that does not report its host.
            PartStatus {
                robot: "c".to_owned(),
                ..part("", 0, SCHEMA_VERSION, 0.0)
            },
        ];
        let checks = judge(&parts);
        let seen: Vec<_> = checks
            .iter()
            .map(|check| (check.about.as_str(), check.verdict))
            .collect();
        assert_eq!(
            seen,
            [("cloud", Verdict::Ok), ("site", Verdict::Fail), ("site", Verdict::Warn)]
        );
        assert_eq!(checks[0].seen, "2 parts in 1 process");
        assert!(checks[2].seen.contains("+3600.0 s"), "{}", checks[2].seen);
    }

    #[test]
    fn of_several_mapping_services_of_one_robot_one_leads_and_two_that_do_fail_and_are_named() {
        let one = part("cloud", 1, SCHEMA_VERSION, 0.0);
        let verdicts = |parts: &[PartStatus]| judge(parts).iter().map(|check| check.verdict).collect::<Vec<_>>();
        assert_eq!(verdicts(&[one.clone(), one.clone()]), [Verdict::Ok], "one, heard twice");
        let checks = judge(&[one, part("cloud", 2, SCHEMA_VERSION, 0.0)]);
        assert_eq!(
            checks[0].seen,
            "2 mapping services write its map: cloud (pid 1), cloud (pid 2)"
        );
        assert_eq!((checks[0].about.as_str(), checks[0].verdict), ("a", Verdict::Fail));
        let copy = |leads| PartStatus {
            leads: Some(leads),
            ..part("site", 2, SCHEMA_VERSION, 0.0)
        };
        let checks = judge(&[part("cloud", 1, SCHEMA_VERSION, 0.0), copy(false)]);
        assert_eq!(
            (checks[0].seen.as_str(), checks[0].verdict),
            ("cloud (pid 1) leads; site (pid 2) stands by", Verdict::Ok)
        );
        let none = PartStatus { pid: 3, ..copy(false) };
        assert_eq!(judge(&[copy(false), none])[0].verdict, Verdict::Warn);
    }
}

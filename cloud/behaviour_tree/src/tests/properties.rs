//! Properties of every tree.

use std::collections::BTreeMap;
use std::time::Duration;

use proptest::prelude::*;

use super::rig::Rig;
use crate::Status;

/// A random tree in which every leaf has its own name and plan, of this form.
fn tree(plans: &'static str) -> impl Strategy<Value = String> {
    let leaf = plans.prop_map(|plan| format!("<T name=\"?\" plan=\"{plan}\"/>"));
    leaf.prop_recursive(5, 40, 4, |inner| {
        let control = prop::sample::select(vec![
            "Sequence",
            "AsyncSequence",
            "SequenceWithMemory",
            "ReactiveSequence",
            "Fallback",
            "AsyncFallback",
            "ReactiveFallback",
            "Parallel",
            "ParallelAll",
            "ParallelAny",
            #[cfg(feature = "nav2")]
            "PipelineSequence",
            #[cfg(feature = "nav2")]
            "RoundRobin",
        ]);
        let fixed = prop::sample::select(vec![
            #[cfg(feature = "nav2")]
            ("RecoveryNode", 2),
            ("IfThenElse", 3),
            ("WhileDoElse", 3),
            ("TryCatch", 3),
            ("TryCatch catch_on_halt=\"true\"", 3),
        ]);
        let decorator = prop::sample::select(vec![
            "Inverter",
            "ForceSuccess",
            "RetryUntilSuccessful num_attempts=\"3\"",
            "Repeat num_cycles=\"3\"",
            "Timeout msec=\"25\"",
            "Delay delay_msec=\"15\"",
            #[cfg(feature = "nav2")]
            "RateController hz=\"40\"",
            "RunOnce",
            #[cfg(feature = "nav2")]
            "SingleTrigger",
            "KeepRunningUntilFailure",
        ]);
        let close = |open: &str, inside: String| {
            let name = open.split(' ').next().unwrap_or(open).to_owned();
            format!("<{open}>{inside}</{name}>")
        };
        prop_oneof![
            (control, prop::collection::vec(inner.clone(), 1..4))
                .prop_map(move |(name, children)| close(name, children.concat())),
            (fixed, prop::collection::vec(inner.clone(), 3))
                .prop_map(move |((name, count), children)| close(name, children[..count].concat())),
            (decorator, inner).prop_map(move |(name, child)| close(name, child)),
        ]
    })
    .prop_map(|text| {
        let mut number = 0;
        text.split('?').fold(String::new(), |mut named, part| {
            if !named.is_empty() {
                named += &format!("t{number}");
                number += 1;
            }
            named + part
        })
    })
}

/// Plans of leaves, without and with errors.
const PLANS: &str = "[SFRK]{1,5}";
const PLANS_WITH_ERRORS: &str = "[SFRKE]{1,5}";

/// Why a log is not that of a tree in which every started leaf ends or is halted exactly once, and nothing else is ever halted.
fn is_unbalanced(body: &str, log: &[String]) -> Option<String> {
    let mut running: BTreeMap<&str, bool> = BTreeMap::new();
    let mut calls: BTreeMap<&str, usize> = BTreeMap::new();
    for event in log {
        let name = event.trim_end_matches(['.', '!']);
        let runs = running.entry(name).or_default();
        if *runs != event.ends_with(['.', '!']) {
            return Some(format!("{event} while running is {runs}"));
        }
        *runs = false;
        if !event.ends_with('!') {
            let plan = body
                .split(&format!("name=\"{name}\" plan=\""))
                .nth(1)
                .unwrap_or_default();
            let plan: Vec<char> = plan.chars().take_while(|letter| *letter != '"').collect();
            let call = calls.entry(name).or_default();
            *runs = plan.get(*call).or(plan.last()) == Some(&'R');
            *call += 1;
        }
    }
    let left: Vec<&str> = running
        .iter()
        .filter(|(_, runs)| **runs)
        .map(|(name, _)| *name)
        .collect();
    (!left.is_empty()).then(|| format!("left running: {left:?}"))
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 300, ..ProptestConfig::default() })]

    /// Every started leaf ends or is halted exactly once; nothing else is ever halted.
    #[test]
    fn every_start_ends_once(body in tree(PLANS), ticks in 1_usize..12) {
        let mut rig = Rig::new(&body);
        let answers = rig.ticks(ticks);
        rig.halt();
        rig.halt();
        prop_assert_eq!(is_unbalanced(&body, &rig.world.log), None, "{} {}", body, answers);
        prop_assert!(rig.tree.statuses().all(|(_, status, _)| status == Status::Idle));
    }

    /// The same of a tree that leaves end with an error; afterwards nothing runs.
    #[test]
    fn every_start_ends_once_with_errors_too(body in tree(PLANS_WITH_ERRORS), ticks in 1_u64..12) {
        let mut rig = Rig::new(&body);
        for tick in 0..ticks {
            let ticked = rig.tree.tick(Duration::from_millis(10 * tick), &mut rig.world);
            prop_assert!(ticked.is_ok() || rig.tree.statuses().all(|(_, status, _)| status == Status::Idle), "{}", body);
        }
        // A clean-up may end with an error, too.
        let _ = rig.tree.halt(Duration::from_secs(1), &mut rig.world);
        prop_assert_eq!(is_unbalanced(&body, &rig.world.log), None, "{}", body);
    }

    /// Stored and restored after any tick, a tree continues as if nothing had happened.
    #[test]
    fn a_restart_changes_nothing(body in tree(PLANS), before in 1_usize..8, after in 1_usize..8) {
        let mut whole = Rig::new(&body);
        whole.ticks(before);
        let stored = serde_json::to_string(&whole.tree.snapshot()).unwrap();
        let mut fresh = Rig::new(&body);
        fresh.tree.restore(serde_json::from_str(&stored).unwrap()).unwrap();
        fresh.now_ms = whole.now_ms;
        std::mem::swap(&mut fresh.world, &mut whole.world);
        let log = fresh.world.log.len();
        let answers = fresh.ticks(after);
        let resumed: Vec<String> = fresh.world.log.drain(log..).map(|event| event.replace('~', ".")).collect();
        fresh.world.log.clear();
        // The same ticks without a restart, from the beginning.
        let mut again = Rig::new(&body);
        again.ticks(before);
        let log = again.world.log.len();
        prop_assert_eq!(answers, again.ticks(after));
        prop_assert_eq!(resumed, again.world.log.split_off(log));
    }

    /// No variation of a tree file makes the reader panic.
    #[test]
    fn a_damaged_file_is_read_or_refused(body in tree(PLANS), at in 0_usize..2000, byte in any::<u8>(), cut in any::<bool>()) {
        let mut bytes = format!("<root BTCPP_format=\"4\"><BehaviorTree ID=\"Main\">{body}</BehaviorTree></root>").into_bytes();
        let at = at % bytes.len();
        if cut { bytes.truncate(at) } else { bytes[at] = byte }
        let _ = crate::build("x.xml", &bytes, &super::rig::registry(), None, &mut |_, _| Err(String::new()));
    }
}

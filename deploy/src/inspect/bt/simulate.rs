//! `zenav bt simulate`. Runs a tree in simulated time, with a script that gives the results of its leaves.

use std::collections::BTreeSet;
use std::path::Path;

use zenav_behaviour_tree::simulate::{self, Script, Simulation};
use zenav_behaviour_tree::{Tree, build};

use super::{Source, bad_tree, includer};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};

pub(super) fn simulate(file: &str, path: Option<&Path>, id: Option<&str>, format: Format) -> Outcome {
    let script: Script = match path {
        Some(path) => serde_json::from_str(&files::text(path)?).map_err(Failure::usage_at(path))?,
        None => Script::default(),
    };
    let source = Source::read(file)?;
    let mut include = includer(&source.name);
    let registry = simulate::registry();
    let tree = build(&source.name, &source.text, &registry, id, &mut include);
    let mut tree = tree.map_err(|errors| bad_tree(&errors))?;
    if let Some(path) = path {
        check_leaves(&tree, &script).map_err(Failure::usage_at(path))?;
    }
    let outcome = simulate::play(&mut tree, &script);
    for warning in &outcome.warnings {
        tracing::warn!("{warning}");
    }
    output::value(format, &outcome, |outcome| {
        let counts = outcome.counts.iter();
        let rows = counts.map(|(leaf, starts)| [leaf.clone(), starts.to_string()]);
        let error = output::piece(outcome.error.as_ref(), |error| format!(": {error}"));
        let late = if outcome.timed_out { ", time ran out" } else { "" };
        format!(
            "{}{error} after {}, {} ms{late}\n\n{}",
            outcome.status,
            output::counted(outcome.ticks, "tick"),
            outcome.sim_time_ms,
            output::table(&["LEAF", "STARTS"], rows)
        )
    })?;
    Ok(if outcome.error.is_some() {
        exit_code::FAILED
    } else {
        exit_code::OK
    })
}

/// Checks that the leaves of a script are in the tree, by id or name.
///
/// # Errors
/// The leaf that is not, and the nearest one, or all of them.
fn check_leaves(tree: &Tree<Simulation>, script: &Script) -> Result<(), String> {
    let leaves = tree
        .iter()
        .filter(|node| matches!(node.category.as_str(), "Action" | "Condition"));
    let known: BTreeSet<String> = leaves.flat_map(|leaf| [leaf.id, leaf.name]).collect();
    let events = script.events.iter().map(|event| &event.when.leaf);
    let Some(unknown) = script.leaves.keys().chain(events).find(|leaf| !known.contains(*leaf)) else {
        return Ok(());
    };
    let known = || known.iter().map(String::as_str);
    let perhaps = match output::perhaps(unknown, known()) {
        near if near.is_empty() => format!(": expected one of {}", output::listed(known())),
        near => near,
    };
    Err(format!("the tree has no leaf `{unknown}`{perhaps}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_script_for_a_leaf_that_is_not_in_the_tree_is_refused() {
        let text = r#"<root BTCPP_format="4"><BehaviorTree ID="T"><Sequence>
            <FollowPath path="{path}" name="ToTheDoor"/><Wait/></Sequence></BehaviorTree></root>"#;
        let none = &mut |_: &str, _: &str| Err(String::new());
        let tree = build("t.xml", text.as_bytes(), &simulate::registry(), None, none).unwrap();
        let check = |script: &str| check_leaves(&tree, &serde_json::from_str(script).unwrap());
        for known in ["FollowPath", "ToTheDoor", "Wait"] {
            assert_eq!(check(&format!(r#"{{"leaves": {{"{known}": {{}}}}}}"#)), Ok(()));
        }
        for (script, told) in [
            (
                r#"{"leaves": {"FolowPath": {}}}"#,
                "the tree has no leaf `FolowPath`, perhaps `FollowPath`",
            ),
            (
                r#"{"leaves": {"Sequence": {}}}"#,
                "the tree has no leaf `Sequence`: expected one of FollowPath, ToTheDoor, Wait",
            ),
            (
                r#"{"events": [{"when": {"leaf": "Wat", "starts": 1}, "set": {}}]}"#,
                "the tree has no leaf `Wat`, perhaps `Wait`",
            ),
        ] {
            assert_eq!(check(script).unwrap_err(), told);
        }
    }
}

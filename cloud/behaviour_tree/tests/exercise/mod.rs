//! Test procedure shared by the fuzzer and by the ordinary tests of its corpus.

use std::time::Duration;

use serde_json::Value;
use zenav_behaviour_tree::simulate::{Script, Simulation, registry};
use zenav_behaviour_tree::{Limits, Status, TreeErrors, TreeSnapshot, build, check};

/// Ticks per tested tree.
const TICKS: u64 = 50;
/// Between a tree file and JSON that changes what is stored of its tree half-way.
const BETWEEN: &[u8] = b"\n%%\n";

/// Tests bytes as a tree file: reads and checks them, and if they are a tree, ticks it against leaves that succeed, stores it half-way,
/// continues from the snapshot, changed by the rest of the bytes if there is one, and halts it.
///
/// For any bytes it returns, soon, and without a panic.
///
/// # Errors
/// All errors in the file.
pub fn exercise(bytes: &[u8]) -> Result<Status, TreeErrors> {
    let at = bytes.windows(BETWEEN.len()).position(|window| window == BETWEEN);
    let (bytes, changes) = at.map_or((bytes, None), |at| {
        let (file, rest) = bytes.split_at(at);
        (file, serde_json::from_slice::<Value>(&rest[BETWEEN.len()..]).ok())
    });
    let registry = registry();
    let none = &mut |_: &str, _: &str| Err("there are no other files".to_owned());
    check("fuzz.xml", bytes, &registry, none, Limits::default())?;
    let mut tree = build("fuzz.xml", bytes, &registry, None, none)?;
    let mut simulation = Simulation::new(Script::default());
    let mut status = Status::Idle;
    for tick in 0..TICKS {
        let now = Duration::from_millis(10 * tick);
        // A tree with an error has been halted, and starts over.
        status = tree.tick(now, &mut simulation).unwrap_or(Status::Failure);
        if tick == TICKS / 2 {
            let stored = tree.snapshot();
            let changed = changes.as_ref().and_then(|changes| changed(&stored, changes));
            let is_changed = changed.is_some();
            let restored = tree.restore(changed.unwrap_or(stored));
            assert!(restored.is_ok() || is_changed, "{restored:?}");
        }
    }
    let _ = tree.halt(Duration::from_secs(1), &mut simulation);
    assert!(changes.is_some() || tree.iter().all(|node| node.status == Status::Idle));
    assert!(!tree.render().is_empty());
    Ok(status)
}

/// A snapshot with changes, if it is one then.
fn changed(stored: &TreeSnapshot, changes: &Value) -> Option<TreeSnapshot> {
    let mut snapshot = serde_json::to_value(stored).ok()?;
    lay_over(&mut snapshot, changes);
    serde_json::from_value(snapshot).ok()
}

/// Members and items that both have are laid over one another; all others are those of the changes.
fn lay_over(value: &mut Value, changes: &Value) {
    match (value, changes) {
        (Value::Object(members), Value::Object(changes)) => {
            for (name, changes) in changes {
                lay_over(members.entry(name).or_insert(Value::Null), changes);
            }
        }
        (Value::Array(items), Value::Array(changes)) => {
            items
                .iter_mut()
                .zip(changes)
                .for_each(|(item, changes)| lay_over(item, changes));
        }
        (value, changes) => *value = changes.clone(),
    }
}

//! Test procedure shared by the fuzzer and by the ordinary tests of its corpus.

use std::time::Duration;

use zenav_behaviour_tree::simulate::{Script, Simulation, registry};
use zenav_behaviour_tree::{Limits, Status, TreeErrors, build, check};

/// Ticks per tested tree.
const TICKS: u64 = 50;

/// Tests bytes as a tree file: reads and checks them, and if they are a tree, ticks it against leaves that succeed, stores it half-way,
/// continues from the snapshot, and halts it.
///
/// For any bytes it returns, soon, and without a panic.
///
/// # Errors
/// All errors in the file.
pub fn exercise(bytes: &[u8]) -> Result<Status, TreeErrors> {
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
            let restored = tree.restore(stored);
            assert!(restored.is_ok(), "{restored:?}");
        }
    }
    let _ = tree.halt(Duration::from_secs(1), &mut simulation);
    assert!(tree.iter().all(|node| node.status == Status::Idle));
    assert!(!tree.render().is_empty());
    Ok(status)
}

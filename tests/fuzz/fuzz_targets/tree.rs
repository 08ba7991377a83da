//! Bytes from anywhere as a tree file: read, checked, and if it is a tree, run against leaves that succeed. It begins with the corpus, which
//! the ordinary tests run too.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../../../cloud/behaviour_tree/tests/exercise/mod.rs"]
mod exercise;

fuzz_target!(init: zenav_fuzz::begin("tree", &[]), |bytes: &[u8]| {
    let _ = exercise::exercise(bytes);
});

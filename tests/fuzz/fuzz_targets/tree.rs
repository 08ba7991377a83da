//! Bytes from anywhere as a tree file: read, checked, and if it is a tree, run against leaves that succeed.
//!
//! `cargo +nightly fuzz run tree fuzz/found/tree fuzz/corpus/tree -- -dict=fuzz/tree.dict -max_len=65536` in `tests`. What the ordinary tests
//! play of the same is the corpus.
#![no_main]

use libfuzzer_sys::fuzz_target;

#[path = "../../../cloud/behaviour_tree/tests/exercise/mod.rs"]
mod exercise;

fuzz_target!(|bytes: &[u8]| {
    let _ = exercise::exercise(bytes);
});

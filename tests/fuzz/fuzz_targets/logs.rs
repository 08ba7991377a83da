//! Bytes from anywhere as a CARMEN log, a pose graph, relations, or a SLAM session.
//!
//! `cargo +nightly fuzz run logs fuzz/found/logs fuzz/found/seeds/logs` in `tests`; CONTRIBUTING.md has the preparations.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    zenav_tests::untrusted::logs::exercise(bytes);
});

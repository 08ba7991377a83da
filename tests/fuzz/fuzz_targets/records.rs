//! Bytes from anywhere as a record of a run, or its samples.
//!
//! `cargo +nightly fuzz run records fuzz/found/records fuzz/found/seeds/records` in `tests`; CONTRIBUTING.md has the preparations.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    zenav_tests::untrusted::records::exercise(bytes);
});

//! Bytes from anywhere as a script of `zenav netem`.
//!
//! `cargo +nightly fuzz run scripts fuzz/found/scripts fuzz/found/seeds/scripts` in `tests`; CONTRIBUTING.md has the preparations.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    zenav_tests::untrusted::scripts::exercise(bytes);
});

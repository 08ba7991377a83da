//! Bytes from anywhere as a file of a robot, an option, a world, a deployment, or zones.
//!
//! `cargo +nightly fuzz run settings fuzz/found/settings fuzz/found/seeds/settings` in `tests`; CONTRIBUTING.md has the preparations.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    zenav_tests::untrusted::settings::exercise(bytes);
});

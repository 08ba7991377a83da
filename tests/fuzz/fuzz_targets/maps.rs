//! Bytes from anywhere as a map image, a description with its image, or a Moving AI map.
//!
//! `cargo +nightly fuzz run maps fuzz/found/maps fuzz/found/seeds/maps` in `tests`; CONTRIBUTING.md has the preparations.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    zenav_tests::untrusted::maps::exercise(bytes);
});

//! Bytes from anywhere as the message of every row of the key table, as JSON and as CBOR.
//!
//! `cargo +nightly fuzz run wire fuzz/found/wire fuzz/found/seeds/wire` in `tests`; CONTRIBUTING.md has the preparations.
#![no_main]

use libfuzzer_sys::fuzz_target;

fuzz_target!(|bytes: &[u8]| {
    zenav_tests::untrusted::wire::exercise(bytes);
});

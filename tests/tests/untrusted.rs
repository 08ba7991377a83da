//! Are bytes from outside taken or refused, whatever they are? What the fuzz targets of `tests/fuzz` run, from the same seeds, with small
//! changes instead of a fuzzer.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::path::Path;

use proptest::prelude::*;
use proptest::sample::Index;
use zenav_tests::untrusted::{FAMILIES, Family};

/// Words that readers of numbers and of text may stumble over.
const WORDS: &[&[u8]] = &[
    b"",
    b"0",
    b"-0.0",
    b"-1",
    b"1e308",
    b"-1e308",
    b"1e-320",
    b"nan",
    b"inf",
    b"18446744073709551615",
    b"-9223372036854775808",
    b"99999999999999999999999999",
    b"null",
    b"true",
    b"[]",
    b"[[[[[[[[",
    b"{}",
    b"\"",
    b"\n",
    b"\0",
    b"\xff\xfe",
    b"\xfb\x7f\xf0\0\0\0\0\0\0",
    b"\x9b\xff\xff\xff\xff\xff\xff\xff\xff",
];

/// A change of a file. Places are shares of its length.
#[derive(Clone, Debug)]
enum Change {
    /// Only the part between two places is left.
    Cut(f64, f64),
    /// The part between two places stands there twice.
    Repeat(f64, f64),
    /// One byte is another.
    Byte(f64, u8),
    /// A word stands at a place too.
    Insert(f64, Index),
    /// The first number behind a place is a word.
    Number(f64, Index),
    /// From a place on it is another seed, from the same share on.
    Join(f64, Index),
}

fn change() -> impl Strategy<Value = Change> {
    let place = || 0.0..1.0_f64;
    prop_oneof![
        1 => (place(), place()).prop_map(|(from, to)| Change::Cut(from, to)),
        1 => (place(), place()).prop_map(|(from, to)| Change::Repeat(from, to)),
        2 => (place(), any::<u8>()).prop_map(|(at, byte)| Change::Byte(at, byte)),
        2 => (place(), any::<Index>()).prop_map(|(at, word)| Change::Insert(at, word)),
        4 => (place(), any::<Index>()).prop_map(|(at, word)| Change::Number(at, word)),
        1 => (place(), any::<Index>()).prop_map(|(at, seed)| Change::Join(at, seed)),
    ]
}

fn changed(seeds: &[Vec<u8>], seed: Index, changes: &[Change]) -> Vec<u8> {
    let mut bytes = seed.get(seeds).clone();
    for change in changes {
        let place = |share: f64| (share * bytes.len() as f64) as usize;
        let between = |from: f64, to: f64| place(from.min(to))..place(from.max(to));
        match change {
            Change::Cut(from, to) => bytes = bytes[between(*from, *to)].to_vec(),
            Change::Repeat(from, to) => {
                let part = bytes[between(*from, *to)].to_vec();
                let at = between(*from, *to).end;
                bytes.splice(at..at, part);
            }
            Change::Byte(at, byte) => {
                let at = place(*at);
                if let Some(old) = bytes.get_mut(at) {
                    *old = *byte;
                }
            }
            Change::Insert(at, word) => {
                let at = place(*at);
                bytes.splice(at..at, word.get(WORDS).to_vec());
            }
            Change::Number(at, word) => {
                let number = number_behind(&bytes, place(*at));
                bytes.splice(number, word.get(WORDS).to_vec());
            }
            Change::Join(at, seed) => {
                let other = seed.get(seeds);
                let rest = other[(at * other.len() as f64) as usize..].to_vec();
                let at = place(*at);
                bytes.truncate(at);
                bytes.extend(rest);
            }
        }
    }
    bytes
}

/// Where the first number behind a place stands.
fn number_behind(bytes: &[u8], at: usize) -> std::ops::Range<usize> {
    let rest = &bytes[at..];
    let Some(begin) = rest.iter().position(u8::is_ascii_digit) else {
        return at..at;
    };
    let is_part = |byte: &u8| byte.is_ascii_digit() || matches!(byte, b'.' | b'e' | b'E' | b'-' | b'+');
    let length = rest[begin..].iter().take_while(|byte| is_part(byte)).count();
    at + begin..at + begin + length
}

fn family(name: &str) -> &'static Family {
    FAMILIES.iter().find(|family| family.name == name).unwrap()
}

/// A property test of each family, with so many cases.
macro_rules! families {
    ($($name:ident: $cases:literal;)*) => {
        mod changed_seeds_are_taken_or_refused {
            use super::*;

            $(
                #[test]
                fn $name() {
                    let family = family(stringify!($name));
                    let seeds = (family.seeds)();
                    let config = ProptestConfig {
                        source_file: Some(file!()),
                        ..ProptestConfig::with_cases($cases)
                    };
                    proptest!(config, |(seed in any::<Index>(), changes in prop::collection::vec(change(), 1..5))| {
                        (family.exercise)(&changed(&seeds, seed, &changes));
                    });
                }
            )*
        }

        /// How many families have a test here.
        const TESTED: usize = [$(stringify!($name)),*].len();
    };
}

families! {
    wire: 300;
    identities: 100;
    mission: 100;
    pilot: 40;
    routes: 300;
    settings: 300;
    deployments: 100;
    maps: 1000;
    logs: 200;
    records: 60;
    scripts: 1000;
}

#[test]
fn every_family_has_a_test_and_a_fuzz_target() {
    assert_eq!(TESTED, FAMILIES.len());
    let targets = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/fuzz_targets");
    for family in FAMILIES {
        let target = targets.join(family.name).with_extension("rs");
        assert!(target.is_file(), "{}", target.display());
    }
}

#[test]
fn every_seed_is_taken() {
    for family in FAMILIES {
        for (number, seed) in (family.seeds)().iter().enumerate() {
            let taken = (family.exercise)(seed);
            assert!(taken > 0, "{} {number}: {}", family.name, String::from_utf8_lossy(seed));
        }
    }
}

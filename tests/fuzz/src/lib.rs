//! The bodies of the fuzz targets: the modules of `zenav_tests::untrusted`, from the same files, without the rest of that package. What needs
//! the whole program has the feature `program`; all else is built without Zenoh.

use std::path::Path;

#[cfg(feature = "program")]
#[path = "../../src/untrusted/deployments.rs"]
pub mod deployments;
#[cfg(feature = "program")]
#[path = "../../src/untrusted/identities.rs"]
pub mod identities;
#[path = "../../src/untrusted/logs.rs"]
pub mod logs;
#[path = "../../src/untrusted/maps.rs"]
pub mod maps;
#[path = "../../src/untrusted/mission.rs"]
pub mod mission;
#[cfg(feature = "program")]
#[path = "../../src/untrusted/pilot.rs"]
pub mod pilot;
#[cfg(feature = "program")]
#[path = "../../src/untrusted/records.rs"]
pub mod records;
#[path = "../../src/untrusted/routes.rs"]
pub mod routes;
#[cfg(feature = "program")]
#[path = "../../src/untrusted/scripts.rs"]
pub mod scripts;
#[path = "../../src/untrusted/settings.rs"]
pub mod settings;
#[path = "../../src/untrusted/wire.rs"]
pub mod wire;

/// Writes inputs to begin with to `found/TARGET`, the folder where the fuzzer adds its own.
pub fn begin(target: &str, seeds: &[Vec<u8>]) {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("found").join(target);
    std::fs::create_dir_all(&folder).expect("a folder");
    for (number, seed) in seeds.iter().enumerate() {
        std::fs::write(folder.join(format!("seed-{number}")), seed).expect("a file");
    }
}

/// The target of a module of this name.
#[macro_export]
macro_rules! target {
    ($name:ident) => {
        libfuzzer_sys::fuzz_target!(
            init: $crate::begin(stringify!($name), &$crate::$name::seeds()),
            |bytes: &[u8]| {
                $crate::$name::exercise(bytes);
            }
        );
    };
}

//! `zenav demo slam`: the kitchen's drives by a robot without GPS and compass, in a map that SLAM makes anew in every run.

use super::{Script, kitchen};

pub(super) const SCRIPT: Script = Script {
    name: "slam",
    uses_stored_map: false,
    ..kitchen::SCRIPT
};

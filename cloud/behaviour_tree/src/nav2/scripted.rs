//! Nav2's nodes against scripted leaves. How do they answer if the script does not name them?

use super::conditions;
use super::decorators::{Measure, Travel, decorator};
use super::{controls, specs};
use crate::leaf::{Leaf, LeafIo};
use crate::registry::Registry;
use crate::simulate::Simulation;
use crate::status::Status;
use crate::value::Value;

/// Nav2's nodes; those with leaves are declared, for the simulation to script.
pub(crate) fn registry() -> Registry<Simulation> {
    let mut registry = controls();
    for spec in specs() {
        match decorator(&spec.id) {
            Some(make) => {
                let added = registry.decorator(spec, move |_| make());
                debug_assert!(added.is_ok(), "{added:?}");
            }
            None => registry.declare(spec),
        }
    }
    registry
}

/// The condition with this id, if it depends only on the blackboard, for a robot at the origin.
pub(crate) fn scripted_condition(id: &str) -> Option<Box<dyn Leaf<Simulation>>> {
    conditions::scripted_condition(id)
}

/// Writes what every Nav2 node writes on success: no error; a selector also writes its default.
pub(crate) fn succeed(io: &mut LeafIo<'_>) -> Status {
    // Failures are ignored: an entry of another type is an error in the tree.
    let _ = io.set("error_code_id", 0_i64);
    let _ = io.set("error_msg", "");
    if let Some(selector) = io.id().strip_suffix("Selector") {
        let mut kind = String::new();
        for letter in selector.chars() {
            if letter.is_uppercase() && !kind.is_empty() {
                kind.push('_');
            }
            kind.extend(letter.to_lowercase());
        }
        match io.get::<String>(&format!("default_{kind}")) {
            Ok(default) => {
                let _ = io.set(&format!("selected_{kind}"), default);
            }
            Err(_) => return io.fail("nothing selected and no default"),
        }
    }
    Status::Success
}

/// A stationary robot, and paths without a length.
impl Travel for Simulation {
    fn position(&self) -> Option<[f64; 2]> {
        Some([0.0, 0.0])
    }

    fn speed(&self) -> f64 {
        0.0
    }

    fn measure(&self, _: &Value) -> Option<Measure> {
        None
    }
}

//! Nav2's nodes against scripted leaves. What do they answer where the script says nothing?

use super::conditions;
use super::decorators::{Measure, Travel, decorator};
use super::{controls, specs};
use crate::leaf::{Leaf, LeafIo};
use crate::registry::Registry;
use crate::simulate::Simulation;
use crate::status::Status;
use crate::value::Value;

/// Nav2's nodes; those that have leaves are declared, for the simulation to script.
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

/// The condition of that id, if the blackboard decides it for a robot that stands at the origin.
pub(crate) fn scripted_condition(id: &str) -> Option<Box<dyn Leaf<Simulation>>> {
    conditions::scripted_condition(id)
}

/// Writes what every Nav2 node writes when it succeeds: no error; a selector its default.
pub(crate) fn succeed(io: &mut LeafIo<'_>) -> Status {
    // Entries of another type are the tree's affair: nothing but these ports is written.
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

/// A robot that stands still, and paths that have no length.
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

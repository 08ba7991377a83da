//! `zenav bt show`: draws a tree in the terminal, or as a picture.

use std::path::Path;

use zenav_behaviour_tree::{self as trees, simulate};

use super::{Source, bad_tree, includer};
use crate::drawing::tree;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};

/// Builds the tree with the simulation's nodes, so that a tree for another robot can be drawn too.
pub(super) fn show(file: &str, id: Option<&str>, out: Option<&Path>, format: Format) -> Outcome {
    let source = Source::read(file)?;
    let mut include = includer(&source.name);
    let built = trees::build(&source.name, &source.text, &simulate::registry(), id, &mut include)
        .map_err(|errors| bad_tree(&errors))?;
    let Some(out) = out else {
        output::value(format, &built.report(), |_| built.render())?;
        return Ok(exit_code::OK);
    };
    let ending = out
        .extension()
        .and_then(|ending| ending.to_str())
        .map(str::to_ascii_lowercase);
    let picture = match ending.as_deref() {
        Some("svg") => tree::svg(&built.report()).into_bytes(),
        Some("png") => tree::png(&built.report())?,
        _ => {
            return Err(Failure::usage(format!(
                "--out {}: expected a name that ends with .svg or .png",
                out.display()
            )));
        }
    };
    files::write(out, picture)?;
    Ok(exit_code::OK)
}

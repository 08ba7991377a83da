//! XML. How does a file become a tree, or a list of everything that is wrong with it?
//!
//! In four steps, each of bounded time and memory: `guard` refuses what an XML parser should not
//! be given, `document` reads files and their includes, `check` compares every tree with the
//! registry, `expand` unfolds SubTrees into the arena of nodes. Errors are collected, not thrown:
//! a tree file is input.

mod check;
mod document;
mod error;
mod expand;
mod guard;
mod inline;
mod nearest;
mod unfold;

use super::registry::Registry;
use super::tree::Tree;

pub use check::Summary;
pub(crate) use error::shortened;
pub use error::{TreeError, TreeErrors};
pub use inline::inline;

/// Finds an included file: given the including file and the `path` attribute, the name by which
/// to know it and its bytes, or what went wrong.
pub type Include<'a> = dyn FnMut(&str, &str) -> Result<(String, Vec<u8>), String> + 'a;

/// How large a tree file may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of all files together. A caller that reads a file should look at its size first.
    pub bytes: usize,
    /// Levels of nodes, SubTrees unfolded. At most 512.
    pub depth: usize,
    /// Nodes, SubTrees unfolded. At most 65,534: a uid has 16 bits.
    pub nodes: usize,
    /// Included files.
    pub includes: usize,
    /// Errors that are told one by one.
    pub errors: usize,
}

impl Default for Limits {
    fn default() -> Self {
        Limits {
            bytes: 4 << 20,
            depth: 256,
            nodes: 10_000,
            includes: 64,
            errors: 100,
        }
    }
}

impl Limits {
    fn nodes(&self) -> u64 {
        self.nodes.min(usize::from(u16::MAX) - 1) as u64
    }

    /// The recursion of a tick is as deep as the tree, and a thread's stack is finite.
    fn depth(&self) -> usize {
        self.depth.min(512)
    }
}

/// Most nodes that [`check`] unfolds, in trees of `Limits::nodes`: a file has many trees, and each may contain the largest.
const UNFOLDED: u64 = 20;

/// Checks every tree of a file as [`build`] would, whichever of them were to run. `file` is its name for messages. A node
/// that the registry does not implement but it, or the file's `TreeNodesModel`, describes is accepted with a warning.
///
/// # Errors
/// Everything that is wrong with it.
pub fn check<C>(
    file: &str,
    bytes: &[u8],
    registry: &Registry<C>,
    include: &mut Include<'_>,
    limits: Limits,
) -> Result<Summary, TreeErrors> {
    let mut errors = error::Collector::new(limits.errors);
    let forest = document::read(file, bytes, include, &limits, &mut errors);
    let checked = check::check(&forest, registry, &limits, &mut errors);
    if forest.trees.len() > 1 && forest.main.is_none() {
        let message = "several trees and no main_tree_to_execute: whoever runs one has to name it";
        errors.warn(forest.start, message);
    }
    let mut left = UNFOLDED * limits.nodes();
    for root in checked.roots.iter().filter(|_| checked.is_bounded) {
        let size = checked.trees.get(root).copied().unwrap_or(0);
        if size > left {
            errors.warn(
                forest.start,
                "too many trees: not all entries that ports share were looked at",
            );
            break;
        }
        left -= size;
        expand::expand(&forest, registry, root, true, &mut errors);
    }
    let summary = Summary {
        trees: checked.trees,
        warnings: errors.warnings(),
    };
    errors.into_result(summary)
}

/// Makes a tree from a file: `tree_id`, else the one that `main_tree_to_execute` names, else the
/// only one.
///
/// # Errors
/// Everything that is wrong with the file, whether this tree uses it or not.
pub fn build<C>(
    file: &str,
    bytes: &[u8],
    registry: &Registry<C>,
    tree_id: Option<&str>,
    include: &mut Include<'_>,
) -> Result<Tree<C>, TreeErrors> {
    build_within(file, bytes, registry, tree_id, include, Limits::default())
}

/// As [`build`], with other limits.
///
/// # Errors
/// Everything that is wrong with the file, whether this tree uses it or not.
pub fn build_within<C>(
    file: &str,
    bytes: &[u8],
    registry: &Registry<C>,
    tree_id: Option<&str>,
    include: &mut Include<'_>,
    limits: Limits,
) -> Result<Tree<C>, TreeErrors> {
    let mut errors = error::Collector::new(limits.errors);
    let forest = document::read(file, bytes, include, &limits, &mut errors);
    let checked = check::check(&forest, registry, &limits, &mut errors);
    // A tree with errors is unfolded too, as long as it can be: all errors are told at once.
    let main = check::main_tree(&forest, tree_id, &mut errors).filter(|_| checked.is_bounded);
    match main.and_then(|main| expand::expand(&forest, registry, &main, false, &mut errors)) {
        Some(tree) => errors.into_result(tree),
        None => Err(errors.into_errors()),
    }
}

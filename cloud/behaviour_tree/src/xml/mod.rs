//! XML. How does a file become a tree, or a list of all its errors?
//!
//! In four steps, each of bounded time and memory: `guard` refuses text that is unsafe for an XML parser, `document` reads files and their
//! includes, `check` compares every tree with the registry, `expand` unfolds SubTrees into the arena of nodes. Errors are collected, not
//! thrown: a tree file is external input.

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

/// Finds an included file: given the including file and the `path` attribute, returns its name and its bytes, or an error message.
pub type Include<'a> = dyn FnMut(&str, &str) -> Result<(String, Vec<u8>), String> + 'a;

/// Limits of a tree file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of all files together. A caller that reads a file should check its size first.
    pub bytes: usize,
    /// Levels of nodes with SubTrees unfolded. At most 512.
    pub depth: usize,
    /// Nodes with SubTrees unfolded. At most 65,534: a uid has 16 bits.
    pub nodes: usize,
    /// Included files.
    pub includes: usize,
    /// Errors that are reported individually.
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

/// Most nodes that [`check`] unfolds, as a multiple of `Limits::nodes`: a file may have many trees, each containing the largest.
const UNFOLDED: u64 = 20;

/// Checks every tree of a file as [`build`] would, whichever of them is to run. `file` is its name for messages. A node without an
/// implementation in the registry is accepted with a warning if the registry or the file's `TreeNodesModel` describes it.
///
/// # Errors
/// All errors in the file.
///
/// ```
/// use zenav_behaviour_tree::{Limits, Registry, check};
///
/// let text = "<root BTCPP_format=\"4\"><BehaviorTree ID=\"Main\">\n<Sleep msec=\"soon\"/>\n</BehaviorTree></root>";
/// let mut include = |_: &str, _: &str| Err("no includes".to_owned());
/// let checked = check("wait.xml", text.as_bytes(), &Registry::<()>::new(), &mut include, Limits::default());
/// let errors = checked.unwrap_err().to_string();
/// assert_eq!(errors, "wait.xml:2:8: port `msec` is `soon`: expected an integer of at least 0");
/// ```
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

/// Builds a tree from a file: `tree_id`, or else the one named by `main_tree_to_execute`, or else the only one.
///
/// # Errors
/// All errors in the file, whether or not they concern this tree.
///
/// ```
/// use zenav_behaviour_tree::{Registry, build};
///
/// let main = r#"<root BTCPP_format="4"><include path="dock.xml"/>
///     <BehaviorTree ID="Main"><Sequence><SubTree ID="Dock"/><AlwaysSuccess/></Sequence></BehaviorTree></root>"#;
/// let dock = r#"<root BTCPP_format="4"><BehaviorTree ID="Dock"><AlwaysSuccess/></BehaviorTree></root>"#;
/// let mut include = |_from: &str, path: &str| match path {
///     "dock.xml" => Ok((path.to_owned(), dock.as_bytes().to_vec())),
///     _ => Err("no such file".to_owned()),
/// };
/// let tree = build("main.xml", main.as_bytes(), &Registry::<()>::new(), Some("Main"), &mut include)?;
/// assert_eq!((tree.id(), tree.len()), ("Main", 4), "the SubTree is unfolded");
/// # Ok::<(), zenav_behaviour_tree::TreeErrors>(())
/// ```
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
/// All errors in the file, whether or not they concern this tree.
///
/// ```
/// use zenav_behaviour_tree::{Limits, Registry, build_within};
///
/// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Inverter><Sleep msec="10"/></Inverter></BehaviorTree></root>"#;
/// let within = |nodes| {
///     let limits = Limits { nodes, ..Limits::default() };
///     build_within("two.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()), limits)
/// };
/// assert!(within(2).is_ok());
/// assert!(within(1).unwrap_err().to_string().contains("2 nodes"));
/// ```
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
    // A tree with errors is unfolded too, if possible: all errors are reported at once.
    let main = check::main_tree(&forest, tree_id, &mut errors).filter(|_| checked.is_bounded);
    match main.and_then(|main| expand::expand(&forest, registry, &main, false, &mut errors)) {
        Some(tree) => errors.into_result(tree),
        None => Err(errors.into_errors()),
    }
}

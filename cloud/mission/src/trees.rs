//! Shipped trees. Which trees are there, and how is a goal's tree built?
//!
//! A module of its own, because its functions are clear only with its name: `trees::build`, `trees::shipped`.

use std::fmt;
use std::sync::OnceLock;

use super::context::Context;
use super::leaves;
use zenav_behaviour_tree::{DuplicateNode, Registry, Tree, TreeErrors, build as build_tree};

/// Drives to one place: plans, follows, and retries after a failure.
pub const NAVIGATE: &str = "navigate";
/// Drives through places in order.
pub const NAVIGATE_THROUGH: &str = "navigate_through";

/// Shipped trees: name and XML.
pub const SHIPPED: &[(&str, &str)] = &[
    (NAVIGATE, include_str!("../trees/navigate.xml")),
    (NAVIGATE_THROUGH, include_str!("../trees/navigate_through.xml")),
    (
        "navigate_with_recovery",
        include_str!("../trees/navigate_with_recovery.xml"),
    ),
    ("kitchen", include_str!("../trees/kitchen.xml")),
    ("online", include_str!("../trees/online.xml")),
    ("kidnapped", include_str!("../trees/kidnapped.xml")),
];

/// The text of a shipped tree.
///
/// ```
/// use zenav_mission::trees::{NAVIGATE, SHIPPED, shipped};
///
/// assert!(shipped(NAVIGATE).unwrap().contains("<BehaviorTree"));
/// assert!(SHIPPED.iter().any(|(name, _)| *name == "kitchen") && shipped("bathroom").is_none());
/// ```
#[must_use]
pub fn shipped(name: &str) -> Option<&'static str> {
    SHIPPED.iter().find(|(known, _)| *known == name).map(|(_, text)| *text)
}

/// Why a tree could not be built.
#[derive(Clone, Debug)]
pub enum NoTree {
    /// The text is neither XML nor the name of a shipped tree.
    Unknown(String),
    /// All errors in the XML.
    Bad(String),
}

impl fmt::Display for NoTree {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Unknown(name) => {
                let names: Vec<&str> = SHIPPED.iter().map(|(name, _)| *name).collect();
                write!(f, "no tree `{name}`: expected XML or one of {}", names.join(", "))
            }
            Self::Bad(errors) => f.write_str(errors),
        }
    }
}

/// The nodes available to this process's trees, fixed on first use.
static REGISTRY: OnceLock<Registry<Context>> = OnceLock::new();

/// The registry of nodes available to the missions of this process.
#[must_use]
pub fn registry() -> &'static Registry<Context> {
    REGISTRY.get_or_init(leaves::registry)
}

/// Why leaves were not added.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum CannotAdd {
    /// An id is taken.
    #[error(transparent)]
    Taken(#[from] DuplicateNode),
    /// Leaves were added before, or a tree has been built.
    #[error("leaves are added once, before the first tree is built")]
    Late,
}

/// Adds user-defined leaves to those known to the missions of this process. The crate's documentation has an example.
///
/// # Errors
/// [`CannotAdd`]: an id is taken, or the first tree was already built.
pub fn add_leaves(add: impl FnOnce(&mut Registry<Context>) -> Result<(), DuplicateNode>) -> Result<(), CannotAdd> {
    let mut registry = leaves::registry();
    add(&mut registry)?;
    REGISTRY.set(registry).map_err(|_| CannotAdd::Late)
}

/// Builds a tree from XML, or from the name of a shipped one. XML can include shipped trees only, because it may come from another machine.
///
/// # Errors
/// [`NoTree`].
///
/// ```
/// use zenav_mission::trees::{build, shipped};
///
/// assert!(build("navigate").is_ok());
/// let refused = build("navigat").unwrap_err().to_string();
/// assert!(refused.starts_with("no tree `navigat`: expected XML or one of navigate, "));
/// let tree = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Sleep msec="soon"/></BehaviorTree></root>"#;
/// assert!(build(tree).unwrap_err().to_string().contains("port `msec` is `soon`"));
/// ```
pub fn build(tree: &str) -> Result<Tree<Context>, NoTree> {
    let (name, text) = match shipped(tree) {
        Some(text) => (format!("{tree}.xml"), text),
        None if tree.trim_start().starts_with('<') => ("tree".to_owned(), tree),
        None => return Err(NoTree::Unknown(tree.chars().take(80).collect())),
    };
    let mut include = |_: &str, path: &str| {
        let text = path.strip_suffix(".xml").and_then(shipped);
        let text = text.ok_or_else(|| "a tree sent as text can include shipped trees only".to_owned())?;
        Ok((path.to_owned(), text.as_bytes().to_vec()))
    };
    build_tree(&name, text.as_bytes(), registry(), None, &mut include)
        .map_err(|errors: TreeErrors| NoTree::Bad(errors.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_shipped_tree_can_be_built() {
        for (name, _) in SHIPPED {
            build(name).unwrap_or_else(|error| panic!("{error}"));
        }
    }

    #[test]
    fn what_is_no_tree_is_told_apart() {
        assert!(build("kitchn").unwrap_err().to_string().contains("kitchen"));
        let error =
            build("<root BTCPP_format=\"4\"><BehaviorTree ID=\"A\"><Folow/></BehaviorTree></root>").unwrap_err();
        assert!(error.to_string().contains("Folow"), "{error}");
    }
}

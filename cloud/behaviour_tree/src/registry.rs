//! Registry. Which nodes may a tree use? Every node has a specification; most also have an implementation.
//!
//! A node that is only declared can be validated and drawn, but not ticked.

use std::collections::BTreeMap;

use super::leaf::{Decorator, FnLeaf, Leaf, LeafIo};
use super::nodes::{self, MakeBuiltin, Row};
use super::ports::{Direction, LiteralRules, PortSpec, PortType};
use super::status::Status;

/// Category of a node, as named by Groot2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Category {
    /// A leaf with an effect.
    Action,
    /// A leaf that only observes.
    Condition,
    /// Several children.
    Control,
    /// One child.
    Decorator,
    /// Another tree.
    SubTree,
}

impl Category {
    /// The tag of the explicit form, `Action` in `<Action ID="Foo"/>`.
    pub fn as_str(self) -> &'static str {
        match self {
            Category::Action => "Action",
            Category::Condition => "Condition",
            Category::Control => "Control",
            Category::Decorator => "Decorator",
            Category::SubTree => "SubTree",
        }
    }

    /// The category with that tag.
    pub fn from_tag(tag: &str) -> Option<Category> {
        use Category::*;
        [Action, Condition, Control, Decorator, SubTree]
            .into_iter()
            .find(|category| category.as_str() == tag)
    }

    /// Whether nodes of this category have no children.
    pub fn is_leaf(self) -> bool {
        matches!(self, Category::Action | Category::Condition)
    }
}

/// Specification of a node: its id, category, ports, and number of children.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeSpec {
    /// Registration id, unique in a registry.
    pub id: String,
    /// Category of the node.
    pub category: Category,
    /// Its ports, in display order.
    pub ports: Vec<PortSpec>,
    /// Least and greatest number of children.
    pub children: (usize, usize),
    /// Whether it accepts attributes without a declared port (leaves invented by a simulation).
    pub open: bool,
    /// One-line description.
    pub doc: String,
}

impl NodeSpec {
    /// A specification without ports.
    pub fn new(category: Category, id: impl Into<String>, doc: impl Into<String>) -> NodeSpec {
        let children = match category {
            Category::Action | Category::Condition | Category::SubTree => (0, 0),
            Category::Decorator => (1, 1),
            Category::Control => (1, usize::MAX),
        };
        NodeSpec {
            id: id.into(),
            category,
            ports: Vec::new(),
            children,
            open: false,
            doc: doc.into(),
        }
    }

    /// An action.
    pub fn action(id: impl Into<String>, doc: impl Into<String>) -> NodeSpec {
        NodeSpec::new(Category::Action, id, doc)
    }

    /// A condition.
    pub fn condition(id: impl Into<String>, doc: impl Into<String>) -> NodeSpec {
        NodeSpec::new(Category::Condition, id, doc)
    }

    /// A decorator.
    pub fn decorator(id: impl Into<String>, doc: impl Into<String>) -> NodeSpec {
        NodeSpec::new(Category::Decorator, id, doc)
    }

    /// A control node with between `least` and `most` children.
    pub fn control(id: &str, doc: &str, least: usize, most: usize) -> NodeSpec {
        NodeSpec {
            children: (least, most),
            ..NodeSpec::new(Category::Control, id, doc)
        }
    }

    /// A SubTree node: its ports are the names it remaps.
    pub(crate) fn subtree(id: &str) -> NodeSpec {
        NodeSpec {
            open: true,
            ..NodeSpec::new(Category::SubTree, id, "Another tree, with its own blackboard.")
        }
    }

    /// Adds an input port that the tree file must set.
    pub fn input(self, name: &str, kind: PortType, doc: &str) -> NodeSpec {
        self.port(name, Direction::Input, kind, None, true, doc)
    }

    /// Adds an input port with a default, which may be `{key}`.
    pub fn input_or(self, name: &str, kind: PortType, default: &str, doc: &str) -> NodeSpec {
        self.port(name, Direction::Input, kind, Some(default), false, doc)
    }

    /// Adds an input port that the tree file may omit.
    pub fn input_optional(self, name: &str, kind: PortType, doc: &str) -> NodeSpec {
        self.port(name, Direction::Input, kind, None, false, doc)
    }

    /// Adds an output port, which the tree file may omit.
    pub fn output(self, name: &str, kind: PortType, doc: &str) -> NodeSpec {
        self.port(name, Direction::Output, kind, None, false, doc)
    }

    /// Adds a port that is read and written.
    pub fn inout(self, name: &str, kind: PortType, doc: &str) -> NodeSpec {
        self.port(name, Direction::InOut, kind, None, true, doc)
    }

    /// Adds a port.
    pub fn port(
        mut self,
        name: &str,
        direction: Direction,
        kind: PortType,
        default: Option<&str>,
        required: bool,
        doc: &str,
    ) -> NodeSpec {
        self.ports.push(PortSpec {
            name: name.to_owned(),
            direction,
            kind,
            default: default.map(str::to_owned),
            required,
            doc: doc.to_owned(),
        });
        self
    }

    /// The port with this name.
    pub fn find_port(&self, name: &str) -> Option<&PortSpec> {
        self.ports.iter().find(|port| port.name == name)
    }
}

/// Information for a factory about the node that its leaf belongs to.
#[derive(Debug, Clone, Copy)]
pub struct LeafSite<'a> {
    /// Registration id.
    pub id: &'a str,
    /// `name` in the tree file.
    pub name: &'a str,
    /// The node's number.
    pub uid: u16,
    /// Specification of the node.
    pub spec: &'a NodeSpec,
}

type MakeLeaf<C> = Box<dyn Fn(LeafSite<'_>) -> Box<dyn Leaf<C>> + Send + Sync>;
type MakeDecorator<C> = Box<dyn Fn(LeafSite<'_>) -> Box<dyn Decorator<C>> + Send + Sync>;

/// How a node is constructed.
pub(crate) enum Make<C> {
    Builtin(MakeBuiltin<C>),
    Leaf(MakeLeaf<C>),
    Decorator(MakeDecorator<C>),
    /// Known, but without an implementation.
    Declared,
}

/// An id that is already registered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a node `{0}` is registered already")]
pub struct DuplicateNode(pub String);

/// The nodes available to trees over the context `C`: the built-in ones and the added ones.
pub struct Registry<C> {
    nodes: BTreeMap<String, (NodeSpec, Make<C>)>,
    enums: BTreeMap<String, i64>,
    literals: Option<LiteralRules>,
    unknown: Option<MakeLeaf<C>>,
}

impl<C> Default for Registry<C> {
    fn default() -> Self {
        let mut registry = Registry {
            nodes: BTreeMap::new(),
            enums: BTreeMap::new(),
            literals: None,
            unknown: None,
        };
        registry.add_builtins(nodes::rows());
        registry
    }
}

impl<C> Registry<C> {
    /// The built-in nodes: BehaviorTree.CPP's, and `ParallelAny`.
    pub fn new() -> Registry<C> {
        Registry::default()
    }

    /// Adds a leaf.
    ///
    /// # Errors
    /// [`DuplicateNode`] if its id is taken. A declaration of the same id is replaced.
    pub fn leaf(
        &mut self,
        spec: NodeSpec,
        make: impl Fn(LeafSite<'_>) -> Box<dyn Leaf<C>> + Send + Sync + 'static,
    ) -> Result<(), DuplicateNode> {
        self.add(spec, Make::Leaf(Box::new(make)))
    }

    /// Adds a leaf consisting of a single function, called on every tick.
    ///
    /// # Errors
    /// [`DuplicateNode`] if its id is taken.
    pub fn function(
        &mut self,
        spec: NodeSpec,
        ask: impl Fn(&mut LeafIo<'_>, &mut C) -> Status + Clone + Send + Sync + 'static,
    ) -> Result<(), DuplicateNode> {
        self.leaf(spec, move |_| Box::new(FnLeaf(ask.clone())))
    }

    /// Adds a decorator.
    ///
    /// # Errors
    /// [`DuplicateNode`] if its id is taken.
    pub fn decorator(
        &mut self,
        spec: NodeSpec,
        make: impl Fn(LeafSite<'_>) -> Box<dyn Decorator<C>> + Send + Sync + 'static,
    ) -> Result<(), DuplicateNode> {
        self.add(spec, Make::Decorator(Box::new(make)))
    }

    /// Declares a node without an implementation. Does nothing if its id is taken.
    pub fn declare(&mut self, spec: NodeSpec) {
        self.nodes.entry(spec.id.clone()).or_insert((spec, Make::Declared));
    }

    /// Declared nodes without an implementation, sorted by id.
    pub fn declared(&self) -> impl Iterator<Item = &NodeSpec> {
        self.nodes
            .values()
            .filter(|(_, make)| matches!(make, Make::Declared))
            .map(|(spec, _)| spec)
    }

    /// Defines a name for a number in scripts, and in the `case_*` ports of Switch.
    pub fn name_number(&mut self, name: impl Into<String>, number: i64) {
        self.enums.insert(name.into(), number);
    }

    /// Accepts undeclared leaves, and implements every leaf that is only declared.
    pub fn invent_unknown_leaves(&mut self, make: impl Fn(LeafSite<'_>) -> Box<dyn Leaf<C>> + Send + Sync + 'static) {
        self.unknown = Some(Box::new(make));
    }

    /// Sets the format of literals of structured types ([`PortType::Data`]); without it, JSON.
    pub fn literals(&mut self, rules: LiteralRules) {
        self.literals = Some(rules);
    }

    /// The specification of a node.
    pub fn spec(&self, id: &str) -> Option<&NodeSpec> {
        self.nodes.get(id).map(|(spec, _)| spec)
    }

    /// All specifications, built-in ones first, each group sorted by id.
    pub fn specs(&self) -> impl Iterator<Item = &NodeSpec> {
        let part = |builtin: bool| {
            self.nodes
                .values()
                .filter(move |(_, make)| matches!(make, Make::Builtin(_)) == builtin)
                .map(|(spec, _)| spec)
        };
        part(true).chain(part(false))
    }

    pub(crate) fn make(&self, id: &str) -> Option<&Make<C>> {
        self.nodes.get(id).map(|(_, make)| make)
    }

    pub(crate) fn enums(&self) -> &BTreeMap<String, i64> {
        &self.enums
    }

    pub(crate) fn literal_rules(&self) -> Option<LiteralRules> {
        self.literals
    }

    pub(crate) fn inventor(&self) -> Option<&MakeLeaf<C>> {
        self.unknown.as_ref()
    }

    pub(crate) fn add_builtins(&mut self, rows: Vec<Row<C>>) {
        let rows = rows.into_iter();
        self.nodes
            .extend(rows.map(|(spec, make)| (spec.id.clone(), (spec, Make::Builtin(make)))));
    }

    fn add(&mut self, spec: NodeSpec, make: Make<C>) -> Result<(), DuplicateNode> {
        let known = self.make(&spec.id);
        if known.is_some_and(|known| !matches!(known, Make::Declared)) {
            return Err(DuplicateNode(spec.id));
        }
        self.nodes.insert(spec.id.clone(), (spec, make));
        Ok(())
    }
}

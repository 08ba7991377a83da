//! Which nodes may a tree use? Every node has a specification; most have an implementation too.
//!
//! A node that is only declared can be validated and drawn, but not ticked.

use std::collections::BTreeMap;

use super::builtins;
use super::leaf::{FnLeaf, Gate, Leaf, LeafIo};
use super::ports::{Direction, PortSpec, PortType};
use super::status::Status;

/// What kind of node it is, as Groot2 names them.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum Category {
    /// A leaf with an effect.
    Action,
    /// A leaf that only looks.
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

/// What a node offers: its id, its kind, its ports, how many children it takes.
#[derive(Debug, Clone, PartialEq)]
pub struct NodeSpec {
    /// Registration id, unique in a registry.
    pub id: String,
    /// What kind of node it is.
    pub category: Category,
    /// Its ports, in the order to show them.
    pub ports: Vec<PortSpec>,
    /// Fewest and most children.
    pub children: (usize, usize),
    /// Accepts attributes that are no declared port (leaves that a simulation makes up).
    pub open: bool,
    /// What it does, in a line.
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

    /// A control node that takes between `least` and `most` children.
    pub fn control(id: &str, doc: &str, least: usize, most: usize) -> NodeSpec {
        NodeSpec {
            children: (least, most),
            ..NodeSpec::new(Category::Control, id, doc)
        }
    }

    /// Adds an input port that a tree must set.
    pub fn input(self, name: &str, kind: PortType, doc: &str) -> NodeSpec {
        self.port(name, Direction::Input, kind, None, true, doc)
    }

    /// Adds an input port with a default, which may be `{key}`.
    pub fn input_or(self, name: &str, kind: PortType, default: &str, doc: &str) -> NodeSpec {
        self.port(name, Direction::Input, kind, Some(default), false, doc)
    }

    /// Adds an input port that a tree may leave out.
    pub fn input_optional(self, name: &str, kind: PortType, doc: &str) -> NodeSpec {
        self.port(name, Direction::Input, kind, None, false, doc)
    }

    /// Adds an output port. A tree may leave it out.
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

    /// The port of that name.
    pub fn find_port(&self, name: &str) -> Option<&PortSpec> {
        self.ports.iter().find(|port| port.name == name)
    }
}

/// What a factory knows of the node it makes a leaf for.
#[derive(Debug, Clone, Copy)]
pub struct LeafSite<'a> {
    /// Registration id.
    pub id: &'a str,
    /// `name` in the tree file.
    pub name: &'a str,
    /// The node's number.
    pub uid: u16,
    /// What the node offers.
    pub spec: &'a NodeSpec,
}

type MakeLeaf<C> = Box<dyn Fn(LeafSite<'_>) -> Box<dyn Leaf<C>> + Send + Sync>;
type MakeGate<C> = Box<dyn Fn(LeafSite<'_>) -> Box<dyn Gate<C>> + Send + Sync>;

/// How a node is made.
pub(crate) enum Make<C> {
    Leaf(MakeLeaf<C>),
    Gate(MakeGate<C>),
    /// Known, but nothing here does it.
    Declared,
}

/// How the tree builder finds a node.
pub(crate) enum Known<'a, C> {
    Builtin(&'a NodeSpec),
    Registered(&'a NodeSpec, &'a Make<C>),
}

impl<'a, C> Known<'a, C> {
    pub(crate) fn spec(&self) -> &'a NodeSpec {
        match self {
            Known::Builtin(spec) | Known::Registered(spec, _) => spec,
        }
    }
}

/// A registration that cannot be.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("a node `{0}` is registered already")]
pub struct DuplicateNode(pub String);

/// The nodes that trees over the context `C` may use: the built-in ones and those added.
pub struct Registry<C> {
    nodes: BTreeMap<String, (NodeSpec, Make<C>)>,
    enums: BTreeMap<String, i64>,
    unknown: Option<MakeLeaf<C>>,
}

impl<C> Default for Registry<C> {
    fn default() -> Self {
        Registry {
            nodes: BTreeMap::new(),
            enums: BTreeMap::new(),
            unknown: None,
        }
    }
}

impl<C> Registry<C> {
    /// The built-in nodes alone.
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

    /// Adds a leaf that is one function, asked on every tick.
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
        make: impl Fn(LeafSite<'_>) -> Box<dyn Gate<C>> + Send + Sync + 'static,
    ) -> Result<(), DuplicateNode> {
        self.add(spec, Make::Gate(Box::new(make)))
    }

    /// Makes a node known without an implementation. Does nothing if its id is taken.
    pub fn declare(&mut self, spec: NodeSpec) {
        if builtins::spec(&spec.id).is_none() {
            self.nodes.entry(spec.id.clone()).or_insert((spec, Make::Declared));
        }
    }

    /// A name for a number in scripts, and in the `case_*` ports of Switch.
    pub fn name_number(&mut self, name: impl Into<String>, number: i64) {
        self.enums.insert(name.into(), number);
    }

    /// Accepts leaves that nothing declares, and implements every leaf that is only declared.
    pub fn invent_unknown_leaves(&mut self, make: impl Fn(LeafSite<'_>) -> Box<dyn Leaf<C>> + Send + Sync + 'static) {
        self.unknown = Some(Box::new(make));
    }

    /// The specification of a node.
    pub fn spec(&self, id: &str) -> Option<&NodeSpec> {
        self.find(id).map(|known| known.spec())
    }

    /// Every specification, built-in ones first, each part sorted by id.
    pub fn specs(&self) -> impl Iterator<Item = &NodeSpec> {
        builtins::specs()
            .values()
            .chain(self.nodes.values().map(|(spec, _)| spec))
    }

    pub(crate) fn find(&self, id: &str) -> Option<Known<'_, C>> {
        builtins::spec(id)
            .map(Known::Builtin)
            .or_else(|| self.nodes.get(id).map(|(spec, make)| Known::Registered(spec, make)))
    }

    pub(crate) fn enums(&self) -> &BTreeMap<String, i64> {
        &self.enums
    }

    pub(crate) fn inventor(&self) -> Option<&MakeLeaf<C>> {
        self.unknown.as_ref()
    }

    fn add(&mut self, spec: NodeSpec, make: Make<C>) -> Result<(), DuplicateNode> {
        let taken = builtins::spec(&spec.id).is_some()
            || self
                .nodes
                .get(&spec.id)
                .is_some_and(|(_, make)| !matches!(make, Make::Declared));
        if taken {
            return Err(DuplicateNode(spec.id));
        }
        self.nodes.insert(spec.id.clone(), (spec, make));
        Ok(())
    }
}

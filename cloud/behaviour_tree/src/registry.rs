//! Registry. Which nodes may a tree use? Every node has a specification; most also have an implementation.
//!
//! A node that is only declared can be validated and drawn, but not ticked.

use std::collections::BTreeMap;

use serde::Serialize;

use super::leaf::{Decorator, FnLeaf, Leaf, LeafIo};
use super::nodes::{self, MakeBuiltin, Row};
use super::ports::{Direction, LiteralRules, PortSpec, PortType};
use super::status::Status;

/// Category of a node, as named by Groot2.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Serialize)]
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
///
/// ```
/// use zenav_behaviour_tree::{NodeSpec, PortType};
///
/// let spec = NodeSpec::action("MoveTo", "Drives to a place.")
///     .input("place", PortType::Text, "its name")
///     .input_or("speed", PortType::Positive, "0.5", "at most, m/s")
///     .output("driven", PortType::Double, "distance, m");
/// let speed = spec.find_port("speed").unwrap();
/// assert!(!speed.required && speed.default.as_deref() == Some("0.5"));
/// assert_eq!(spec.children, (0, 0), "a leaf");
/// ```
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct NodeSpec {
    /// Registration id, unique in a registry.
    pub id: String,
    /// Category of the node.
    pub category: Category,
    /// One-line description.
    pub doc: String,
    /// Its ports, in display order.
    pub ports: Vec<PortSpec>,
    /// Least and greatest number of children.
    #[serde(skip)]
    pub children: (usize, usize),
    /// Whether it accepts attributes without a declared port (leaves invented by a simulation).
    #[serde(skip)]
    pub open: bool,
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

    /// The specification of an action, without ports.
    pub fn action(id: impl Into<String>, doc: impl Into<String>) -> NodeSpec {
        NodeSpec::new(Category::Action, id, doc)
    }

    /// The specification of a condition, without ports.
    pub fn condition(id: impl Into<String>, doc: impl Into<String>) -> NodeSpec {
        NodeSpec::new(Category::Condition, id, doc)
    }

    /// The specification of a decorator, without ports.
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
    ///
    /// ```
    /// use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, Registry, Status, build};
    ///
    /// /// Logs the name that it has in the tree.
    /// struct Log(String);
    /// impl Leaf<Vec<String>> for Log {
    ///     fn start(&mut self, _: &mut LeafIo<'_>, log: &mut Vec<String>) -> Status {
    ///         log.push(self.0.clone());
    ///         Status::Success
    ///     }
    /// }
    /// let mut registry = Registry::<Vec<String>>::new();
    /// registry.leaf(NodeSpec::action("Log", "Logs its name."), |site| Box::new(Log(format!("{}: {}", site.uid, site.name))))?;
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
    ///     <Sequence><Log name="dock"/><Log name="charge"/></Sequence>
    /// </BehaviorTree></root>"#;
    /// # let mut tree = build("log.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into()))?;
    /// let mut log = Vec::new();
    /// tree.tick(std::time::Duration::ZERO, &mut log)?;
    /// assert_eq!(log, ["2: dock", "3: charge"]);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
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
    ///
    /// ```
    /// use zenav_behaviour_tree::{NodeSpec, Registry, Status};
    ///
    /// let mut registry = Registry::<bool>::new();
    /// let spec = NodeSpec::condition("DoorIsOpen", "SUCCESS while the door is open.");
    /// registry.function(spec.clone(), |_, open| Status::from_truth(*open))?;
    /// let again = registry.function(spec, |_, _| Status::Success);
    /// assert_eq!(again.unwrap_err().to_string(), "a node `DoorIsOpen` is registered already");
    /// # Ok::<(), zenav_behaviour_tree::DuplicateNode>(())
    /// ```
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
    ///
    /// ```
    /// # use std::time::Duration;
    /// use zenav_behaviour_tree::{Decorator, Enter, LeafIo, NodeSpec, Registry, Status, build};
    ///
    /// /// Ticks its child while the battery has charge.
    /// struct WhileCharged;
    /// impl Decorator<f64> for WhileCharged {
    ///     fn enter(&mut self, _: &mut LeafIo<'_>, charge: &mut f64, _: Status) -> Enter {
    ///         if *charge > 0.2 { Enter::TickChild } else { Enter::Answer(Status::Failure) }
    ///     }
    /// }
    /// let mut registry = Registry::<f64>::new();
    /// registry.decorator(NodeSpec::decorator("WhileCharged", "FAILURE at 20 % or less."), |_| Box::new(WhileCharged))?;
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><WhileCharged><Sleep msec="1000"/></WhileCharged></BehaviorTree></root>"#;
    /// # let mut tree = build("work.xml", text.as_bytes(), &registry, None, &mut |_, _| Err("no includes".into()))?;
    /// assert_eq!(tree.tick(Duration::ZERO, &mut 0.5)?, Status::Running);
    /// assert_eq!(tree.tick(Duration::from_millis(10), &mut 0.2)?, Status::Failure, "Sleep is halted");
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn decorator(
        &mut self,
        spec: NodeSpec,
        make: impl Fn(LeafSite<'_>) -> Box<dyn Decorator<C>> + Send + Sync + 'static,
    ) -> Result<(), DuplicateNode> {
        self.add(spec, Make::Decorator(Box::new(make)))
    }

    /// Declares a node without an implementation. Does nothing if its id is taken.
    ///
    /// ```
    /// use zenav_behaviour_tree::{Limits, NodeSpec, Registry, build, check};
    ///
    /// let mut registry = Registry::<()>::new();
    /// registry.declare(NodeSpec::action("Dock", "Docks."));
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main"><Dock/></BehaviorTree></root>"#;
    /// let mut include = |_: &str, _: &str| Err("no includes".to_owned());
    /// let summary = check("dock.xml", text.as_bytes(), &registry, &mut include, Limits::default())?;
    /// assert!(summary.warnings[0].contains("nothing here implements `Dock`"));
    /// assert!(build("dock.xml", text.as_bytes(), &registry, None, &mut include).is_err());
    /// # Ok::<(), zenav_behaviour_tree::TreeErrors>(())
    /// ```
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
    ///
    /// ```
    /// use zenav_behaviour_tree::Registry;
    ///
    /// let registry = Registry::<()>::new();
    /// let sleep = registry.spec("Sleep").unwrap();
    /// assert_eq!((&*sleep.ports[0].name, &*sleep.ports[0].doc), ("msec", "wait, ms"));
    /// assert!(registry.spec("Sleeep").is_none());
    /// ```
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

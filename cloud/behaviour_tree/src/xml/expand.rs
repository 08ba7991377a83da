//! Expansion. How does a checked file become an arena of nodes? Depth first, with SubTrees unfolded and entry names resolved to slots of
//! the blackboard.

use std::collections::BTreeMap;
use std::sync::Arc;

use super::check::{pointer, specification};
use super::document::{Attribute, Element, ElementId, Forest};
use super::error::{Collector, Place};
use super::nearest::hint;
use crate::blackboard::{Blackboard, ScopeId, Slot};
use crate::node::{Guards, Info, Memory, Node, NodeId, NodeState, Role};
use crate::nodes::{Always, Ports, SubTree};
use crate::ports::{BoundPort, PortType, Source};
use crate::registry::{Category, LeafSite, Make, NodeSpec, Registry};
use crate::script::{self, Program};
use crate::status::Status;
use crate::tick::Body;
use crate::tree::Tree;
use crate::value::{ValueType, parse_bool};

/// Unfolds the tree `main`. The file has been checked: its depth and size are bounded. A node without an implementation is an error, or
/// only a warning if the tree is merely `looked_at`. Errors already reported are skipped.
pub(super) fn expand<C>(
    forest: &Forest,
    registry: &Registry<C>,
    main: &str,
    looked_at: bool,
    errors: &mut Collector,
) -> Option<Tree<C>> {
    let mut builder = Builder {
        forest,
        registry,
        looked_at,
        enums: Arc::new(registry.enums().clone()),
        errors,
        kinds: BTreeMap::new(),
        tree: Tree {
            id: main.to_owned(),
            nodes: Vec::new(),
            infos: Vec::new(),
            children: Vec::new(),
            states: Vec::new(),
            memories: Vec::new(),
            bodies: Vec::new(),
            board: Blackboard::default(),
            shape: 0xcbf2_9ce4_8422_2325,
            changes: 0,
        },
    };
    let root = forest.trees.get(main)?.root?;
    builder.node(root, None, 0, 0);
    Some(builder.tree)
}

struct Builder<'f, C> {
    forest: &'f Forest,
    registry: &'f Registry<C>,
    looked_at: bool,
    enums: Arc<BTreeMap<String, i64>>,
    errors: &'f mut Collector,
    /// Type of each entry according to the first port that uses it.
    kinds: BTreeMap<u32, (PortType, Place)>,
    tree: Tree<C>,
}

impl<C> Builder<'_, C> {
    fn node(&mut self, id: ElementId, parent: Option<NodeId>, depth: u16, scope: ScopeId) -> Option<NodeId> {
        let forest = self.forest;
        let registry = self.registry;
        let element = forest.element(id)?;
        let spec = specification(element, forest, registry, false).ok()?;
        let node = self.tree.nodes.len() as NodeId;
        let name = element
            .attribute("name")
            .map_or(spec.id.as_str(), |name| name.value.as_str());
        self.hash(element, &spec.id, depth);
        let mut site = Site {
            builder: self,
            element,
            spec: &spec,
            scope,
        };
        let guards = site.guards();
        let (role, ports) = site.role(node, name);
        self.tree.nodes.push(Node {
            role,
            guards,
            first_child: 0,
            child_count: 0,
        });
        self.tree.states.push(NodeState::default());
        self.tree.memories.push(Memory::default());
        self.tree.infos.push(Info {
            name: Arc::from(name),
            id: Arc::from(spec.id.as_str()),
            category: spec.category,
            parent,
            depth,
            scope,
            ports,
            written: element.written(),
        });
        let below: Vec<NodeId> = if spec.category == Category::SubTree {
            let inner = self.scope(element, &spec.id, name, scope);
            let root = forest.trees.get(&spec.id).and_then(|tree| tree.root);
            root.and_then(|root| self.node(root, Some(node), depth + 1, inner))
                .into_iter()
                .collect()
        } else {
            let children = element.children.iter();
            children
                .filter_map(|child| self.node(*child, Some(node), depth + 1, scope))
                .collect()
        };
        if let Some(made) = self.tree.nodes.get_mut(node as usize) {
            made.first_child = self.tree.children.len() as u32;
            made.child_count = below.len() as u32;
        }
        self.tree.children.extend(below);
        Some(node)
    }

    /// Hashes everything that a snapshot relies on (FNV-1a, 64 bits: the same on every machine).
    fn hash(&mut self, element: &Element, id: &str, depth: u16) {
        let depth = depth.to_string();
        let attributes = element.attributes.iter().flat_map(|own| [&*own.name, &*own.value]);
        for text in [id, &depth].into_iter().chain(attributes) {
            for byte in text.bytes().chain([0xff]) {
                self.tree.shape = (self.tree.shape ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
            }
        }
    }

    /// The scope of a SubTree: remapped names, and literals as its own entries.
    fn scope(&mut self, element: &Element, tree: &str, name: &str, outer: ScopeId) -> ScopeId {
        let autoremap = element
            .attribute("_autoremap")
            .and_then(|remap| parse_bool(&remap.value))
            .unwrap_or(false);
        let inner = self.tree.board.add_scope(name.to_owned(), outer, autoremap);
        let own = element.remappings();
        let mut remapped: Vec<(&str, &str)> = own.map(|own| (own.name.as_str(), own.value.as_str())).collect();
        let forest = self.forest;
        if let Some(model) = forest.subtree_models.get(tree)
            && !autoremap
        {
            for port in &model.ports {
                if let (Some(default), None) = (&port.default, element.attribute(&port.name)) {
                    remapped.push((&port.name, default));
                }
            }
        }
        for (key, value) in remapped {
            match pointer(value, key) {
                Some(outer_key) => {
                    let slot = self.tree.board.resolve(outer, outer_key);
                    self.tree.board.alias(inner, key, slot);
                }
                None => {
                    let slot = self.tree.board.add_entry(inner, key);
                    self.tree.board.write_constant(slot, value);
                }
            }
        }
        inner
    }

    /// Reports an entry shared by ports of incompatible types.
    fn entry_of(&mut self, slot: Slot, kind: &PortType, port: &str, at: Place) {
        if matches!(kind, PortType::Any | PortType::Text | PortType::Key | PortType::List(_)) {
            return;
        }
        match self.kinds.get(&slot.index()) {
            None => {
                self.kinds.insert(slot.index(), (kind.clone(), at));
            }
            Some((other, first)) if !other.shares_entry_with(kind) => {
                if !self.errors.is_new_clash(at, *first) {
                    return;
                }
                let message = format!(
                    "port `{port}` and the port at {} share an entry",
                    self.errors.describe(*first)
                );
                let expected = format!("the same type, not {} and {}", kind.expected(), other.expected());
                self.errors.add(at, message, expected);
            }
            Some(_) => {}
        }
    }
}

/// One node under construction.
struct Site<'s, 'f, C> {
    builder: &'s mut Builder<'f, C>,
    element: &'s Element,
    spec: &'s NodeSpec,
    scope: ScopeId,
}

impl<C> Site<'_, '_, C> {
    fn role(&mut self, node: NodeId, name: &str) -> (Role<C>, Box<[BoundPort]>) {
        if self.spec.category == Category::SubTree {
            return (Role::Builtin(Box::new(SubTree)), Box::default());
        }
        let registry = self.builder.registry;
        let spec = self.spec;
        let make = registry.make(&spec.id);
        if let Some(Make::Builtin(make)) = make {
            return (Role::Builtin(make(self)), Box::default());
        }
        let ports = self.bound_ports();
        let body = self.builder.tree.bodies.len() as u32;
        let site = LeafSite {
            id: &spec.id,
            name,
            uid: (node + 1) as u16,
            spec,
        };
        match (make, registry.inventor()) {
            (Some(Make::Leaf(make)), _) => {
                self.builder.tree.bodies.push(Body::Leaf(make(site)));
                (Role::Leaf(body), ports)
            }
            (Some(Make::Decorator(make)), _) => {
                self.builder.tree.bodies.push(Body::Decorator(make(site)));
                (Role::Decorator(body), ports)
            }
            (_, Some(invent)) if spec.category.is_leaf() => {
                self.builder.tree.bodies.push(Body::Leaf(invent(site)));
                (Role::Leaf(body), ports)
            }
            _ => {
                let known = registry.specs().map(|known| known.id.as_str());
                let can_run = |id: &&str| !matches!(registry.make(id), Some(Make::Declared));
                let hint = hint(&spec.id, known.filter(can_run));
                let message = format!("nothing here implements `{}`", spec.id);
                let (at, errors) = (self.element.at, &mut *self.builder.errors);
                match self.builder.looked_at {
                    true => errors.warn(at, &format!("{message}: a mission would refuse it{hint}")),
                    false => errors.add(at, message, format!("a node that this program can run{hint}")),
                }
                (Role::Builtin(Box::new(Always(Status::Failure))), ports)
            }
        }
    }

    fn bound_ports(&mut self) -> Box<[BoundPort]> {
        let spec = self.spec;
        let mut ports: Vec<BoundPort> = spec
            .ports
            .iter()
            .map(|port| BoundPort {
                name: Arc::from(port.name.as_str()),
                kind: port.kind.clone(),
                source: self.source(&port.name),
            })
            .collect();
        if spec.open {
            let element = self.element;
            for attribute in element.remappings().filter(|own| spec.find_port(&own.name).is_none()) {
                let source = self.source_of(&attribute.name, &attribute.value, &PortType::Any, attribute.at);
                ports.push(BoundPort {
                    name: Arc::from(attribute.name.as_str()),
                    kind: PortType::Any,
                    source,
                });
            }
        }
        ports.retain(|port| port.source != Source::Unset);
        ports.into()
    }

    /// The text on a port, from the tree file or the specification.
    fn text(&self, port: &str) -> Option<(String, Place)> {
        if let Some(attribute) = self.element.attribute(port) {
            return Some((attribute.value.clone(), attribute.at));
        }
        let default = self.spec.find_port(port)?.default.clone()?;
        Some((default, self.element.at))
    }

    /// The name of an entry on a port, with or without braces.
    fn key(&self, port: &str) -> String {
        let text = self.text(port).map(|(text, _)| text).unwrap_or_default();
        pointer(&text, port).unwrap_or(text.trim()).to_owned()
    }

    fn source_of(&mut self, port: &str, value: &str, kind: &PortType, at: Place) -> Source {
        match pointer(value, port) {
            Some(key) => {
                let slot = self.builder.tree.board.resolve(self.scope, key);
                self.builder.tree.board.declare(slot);
                self.builder.entry_of(slot, kind, port, at);
                Source::Slot(slot)
            }
            None => kind.parse(value).map_or(Source::Unset, Source::Literal),
        }
    }

    fn guards(&mut self) -> Option<Box<Guards>> {
        let mut guards = Guards::default();
        let mut any = false;
        let element = self.element;
        let filled = |attribute: &&Attribute| !attribute.value.trim().is_empty();
        for attribute in element.attributes.iter().filter(filled) {
            let place = match attribute.name.as_str() {
                "_failureIf" => &mut guards.failure_if,
                "_successIf" => &mut guards.success_if,
                "_skipIf" => &mut guards.skip_if,
                "_while" => &mut guards.while_true,
                "_onSuccess" => &mut guards.on_success,
                "_onFailure" => &mut guards.on_failure,
                "_onHalted" => &mut guards.on_halted,
                "_post" => &mut guards.post,
                _ => continue,
            };
            *place = Some(self.bind(&attribute.value));
            any = true;
        }
        any.then(|| Box::new(guards))
    }

    fn bind(&mut self, text: &str) -> Program {
        let statements = script::parse(text).unwrap_or_default();
        let enums = self.builder.enums.clone();
        let (board, scope) = (&mut self.builder.tree.board, self.scope);
        Program::bind(text, statements, &enums, &mut |name| board.resolve(scope, name))
    }
}

impl<C> Ports for Site<'_, '_, C> {
    fn source(&mut self, port: &str) -> Source {
        let kind = self
            .spec
            .find_port(port)
            .map_or(PortType::Any, |port| port.kind.clone());
        match self.text(port) {
            Some((value, at)) => self.source_of(port, &value, &kind, at),
            None => Source::Unset,
        }
    }

    fn sources(&mut self, prefix: &str) -> Vec<Source> {
        let spec = self.spec;
        let ports = spec.ports.iter().filter(|port| port.name.starts_with(prefix));
        ports.map(|port| self.source(&port.name)).collect()
    }

    fn value_type(&self, port: &str) -> ValueType {
        let port = self.spec.find_port(port);
        port.and_then(|port| port.kind.value_type()).unwrap_or(ValueType::Text)
    }

    fn slot(&mut self, port: &str) -> Slot {
        let key = self.key(port);
        self.builder.tree.board.resolve(self.scope, &key)
    }

    #[cfg(feature = "nav2")]
    fn root_slot(&mut self, port: &str) -> Slot {
        let key = self.key(port);
        self.builder.tree.board.resolve(0, key.trim_start_matches('@'))
    }

    fn program(&mut self, port: &str) -> Program {
        let text = self.text(port).map(|(text, _)| text).unwrap_or_default();
        self.bind(&text)
    }

    fn enums(&self) -> Arc<BTreeMap<String, i64>> {
        self.builder.enums.clone()
    }
}

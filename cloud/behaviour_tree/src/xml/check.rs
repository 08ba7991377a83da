//! Validation. Does every tree use known nodes with their ports and children, and can it be unfolded?

use std::borrow::Cow;
use std::collections::{BTreeMap, BTreeSet};

use super::Limits;
use super::document::{Attribute, Element, ElementId, Forest};
use super::error::{Collector, shortened};
use super::nearest::hint;
use super::unfold::{Size, unfold};
use crate::ports::{Direction, LiteralRules, PortSpec, PortType};
use crate::registry::{Category, NodeSpec, Registry};
use crate::script;
use crate::value::{Value, parse_bool};

/// Summary of a valid file.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Summary {
    /// Id of every tree, with its number of nodes after unfolding SubTrees.
    pub trees: BTreeMap<String, u64>,
    /// Valid but possibly refused where the tree is to run: `file:line:column: what`.
    pub warnings: Vec<String>,
}

/// Results of `check`.
pub(super) struct Checked {
    /// Number of nodes of each tree with its SubTrees unfolded.
    pub(super) trees: BTreeMap<String, u64>,
    /// Trees that no other tree contains.
    pub(super) roots: Vec<String>,
    /// Whether all trees can be unfolded.
    pub(super) is_bounded: bool,
}

/// The scripts around a node.
pub(super) const GUARDS: [&str; 8] = [
    "_skipIf",
    "_successIf",
    "_failureIf",
    "_while",
    "_onSuccess",
    "_onFailure",
    "_onHalted",
    "_post",
];

/// `{key}` as the key; `{=}` means the name of the port.
pub(super) fn pointer<'v>(value: &'v str, port: &'v str) -> Option<&'v str> {
    let key = value.trim().strip_prefix('{')?.strip_suffix('}')?.trim();
    Some(if key == "=" { port } else { key })
}

/// The specification of the node that an element stands for, or an error, with a message only if it will be reported (`told`).
pub(super) fn specification<'f, C>(
    element: &'f Element,
    forest: &'f Forest,
    registry: &'f Registry<C>,
    told: bool,
) -> Result<Cow<'f, NodeSpec>, (String, String)> {
    let explicit = Category::from_tag(&element.tag);
    let id = match (explicit, element.attribute("ID")) {
        (Some(category), None) => {
            return Err((
                format!("<{}> without ID", category.as_str()),
                "the registration id".into(),
            ));
        }
        (Some(Category::SubTree), Some(id)) => {
            if forest.trees.contains_key(&id.value) {
                return Ok(Cow::Owned(NodeSpec::subtree(&id.value)));
            }
            if !told {
                return Err(Default::default());
            }
            return Err((format!("unknown tree `{}`", id.value), known_tree(forest, &id.value)));
        }
        (Some(_), Some(id)) => id.value.as_str(),
        (None, _) => element.tag.as_str(),
    };
    let found = registry.spec(id).or_else(|| forest.models.get(id));
    match (found, explicit) {
        (Some(spec), Some(category)) if spec.category != category => Err((
            format!("`{id}` as <{}>", category.as_str()),
            format!("<{} ID=\"{id}\">", spec.category.as_str()),
        )),
        (Some(spec), _) => Ok(Cow::Borrowed(spec)),
        (None, _) if forest.trees.contains_key(id) => {
            Err((format!("<{id}> is a tree"), format!("<SubTree ID=\"{id}\"/>")))
        }
        (None, category)
            if registry.inventor().is_some()
                && element.children.is_empty()
                && category.is_none_or(Category::is_leaf) =>
        {
            let category = category.unwrap_or(Category::Action);
            Ok(Cow::Owned(NodeSpec {
                open: true,
                ..NodeSpec::new(category, id, "")
            }))
        }
        (None, _) if !told => Err(Default::default()),
        (None, _) => {
            let known = registry.specs().map(|spec| spec.id.as_str());
            let hint = hint(id, known.chain(forest.models.keys().map(String::as_str)));
            Err((format!("unknown node `{id}`"), format!("a registered node{hint}")))
        }
    }
}

/// What was expected in place of an unknown tree.
fn known_tree(forest: &Forest, id: &str) -> String {
    let hint = hint(id, forest.trees.keys().map(String::as_str));
    format!("the ID of a <BehaviorTree>{hint}")
}

/// Checks every tree, used or not.
pub(super) fn check<C>(forest: &Forest, registry: &Registry<C>, limits: &Limits, errors: &mut Collector) -> Checked {
    let mut sizes = BTreeMap::new();
    for (id, tree) in &forest.trees {
        // As in BehaviorTree.CPP: `<Sequence/>` would be ambiguous.
        if registry.spec(id).is_some() {
            errors.add(
                tree.at,
                format!("tree `{id}` has the name of a node"),
                "an ID of its own",
            );
        }
        sizes.insert(id.as_str(), nodes(&tree.body, forest, registry, errors));
    }
    nodes(&forest.stray, forest, registry, errors);
    if let Some((main, at)) = &forest.main
        && !forest.trees.contains_key(main)
    {
        errors.add(*at, format!("unknown tree `{main}`"), known_tree(forest, main));
    }
    let before = errors.count();
    let trees = unfold(&sizes, forest, limits, errors);
    let inner: BTreeSet<&str> = sizes
        .values()
        .flat_map(|size| size.subtrees.iter().map(|(id, _, _)| id.as_str()))
        .collect();
    let roots = trees
        .keys()
        .filter(|id| !inner.contains(id.as_str()))
        .cloned()
        .collect();
    Checked {
        roots,
        is_bounded: errors.count() == before,
        trees,
    }
}

/// Checks the content of a `<BehaviorTree>`.
fn nodes<C>(body: &[ElementId], forest: &Forest, registry: &Registry<C>, errors: &mut Collector) -> Size {
    let mut size = Size::default();
    let mut todo: Vec<(ElementId, usize)> = body.iter().rev().map(|root| (*root, 1)).collect();
    while let Some((element, depth)) = todo.pop() {
        let Some(element) = forest.element(element) else {
            continue;
        };
        size.nodes += 1;
        let bytes = element.attributes.iter().map(|attribute| attribute.value.len() as u64);
        size.bytes += bytes.sum::<u64>();
        size.depth = size.depth.max(depth);
        match specification(element, forest, registry, !errors.is_full()) {
            Ok(spec) => {
                node(element, &spec, forest, registry.literal_rules(), errors);
                if spec.category == Category::SubTree {
                    size.subtrees.push((spec.id.clone(), element.at, depth));
                }
            }
            Err((message, expected)) => errors.add(element.at, message, expected),
        }
        todo.extend(element.children.iter().rev().map(|child| (*child, depth + 1)));
    }
    size
}

/// The tree to run.
pub(super) fn main_tree(forest: &Forest, wanted: Option<&str>, errors: &mut Collector) -> Option<String> {
    let named = wanted.or(forest.main.as_ref().map(|(id, _)| id.as_str()));
    let mut ids = forest.trees.keys();
    match (named, ids.next(), ids.next()) {
        (Some(id), _, _) if forest.trees.contains_key(id) => Some(id.to_owned()),
        (Some(id), _, _) => {
            if wanted.is_some() {
                errors.add(forest.start, format!("no tree `{id}`"), known_tree(forest, id));
            }
            None
        }
        (None, Some(only), None) => Some(only.clone()),
        (None, None, _) => {
            if errors.is_empty() {
                errors.add(forest.start, "no tree", "a <BehaviorTree>");
            }
            None
        }
        (None, Some(_), Some(_)) => {
            errors.add(
                forest.start,
                "several trees and no main_tree_to_execute",
                "the ID of the tree to run",
            );
            None
        }
    }
}

fn node(element: &Element, spec: &NodeSpec, forest: &Forest, literals: Option<LiteralRules>, errors: &mut Collector) {
    let explicit = Category::from_tag(&element.tag).is_some();
    for attribute in &element.attributes {
        match attribute.name.as_str() {
            "name" => {}
            "ID" if explicit => {}
            name if name.starts_with('_') => special(attribute, spec, errors),
            name => match spec.find_port(name) {
                Some(port) => port_value(attribute, port, literals, errors),
                None if spec.open => key_name(attribute, errors),
                None if errors.is_full() => errors.add(attribute.at, "", ""),
                None => {
                    let ports = spec.ports.iter().map(|port| port.name.as_str());
                    let hint = hint(name, ports.clone());
                    let ports: Vec<&str> = ports.collect();
                    let expected = if ports.is_empty() {
                        "no port".to_owned()
                    } else {
                        format!("one of {}", ports.join(", "))
                    };
                    errors.add(
                        attribute.at,
                        format!("`{}` has no port `{name}`", spec.id),
                        format!("{expected}{hint}"),
                    );
                }
            },
        }
    }
    for port in spec.ports.iter().filter(|port| port.required) {
        if element.attribute(&port.name).is_none() {
            errors.add(
                element.at,
                format!("`{}` without port `{}`", spec.id, port.name),
                format!("{} ({})", port.kind.expected(), port.doc),
            );
        }
    }
    if spec.category == Category::SubTree {
        let autoremap = element
            .attribute("_autoremap")
            .is_some_and(|remap| parse_bool(&remap.value) == Some(true));
        for port in forest
            .subtree_models
            .get(&spec.id)
            .map_or(&[][..], |model| &model.ports)
        {
            if port.default.is_none() && !autoremap && element.attribute(&port.name).is_none() {
                errors.add(
                    element.at,
                    format!("SubTree `{}` without `{}`", spec.id, port.name),
                    "a remapping: the TreeNodesModel gives no default",
                );
            }
        }
    }
    let (least, most) = spec.children;
    let count = element.children.len();
    if count < least || count > most {
        let expected = match (least, most) {
            (0, 0) => "none".to_owned(),
            (least, usize::MAX) => format!("at least {least}"),
            (least, most) if least == most => format!("exactly {least}"),
            (least, most) => format!("{least} to {most}"),
        };
        errors.add(element.at, format!("`{}` has {count} children", spec.id), expected);
    }
}

/// Checks attributes that begin with `_`: scripts around the node, `_autoremap`; others belong to editors.
fn special(attribute: &Attribute, spec: &NodeSpec, errors: &mut Collector) {
    let name = attribute.name.as_str();
    if GUARDS.contains(&name) {
        // An empty field of an editor: no script.
        if !attribute.value.trim().is_empty()
            && let Err(wrong) = script::parse(&attribute.value)
        {
            errors.add(
                attribute.at,
                format!("{name}: {} at character {}", wrong.message, wrong.at),
                wrong.expected,
            );
        }
    } else if name == "_autoremap" && spec.category == Category::SubTree {
        if parse_bool(&attribute.value).is_none() {
            errors.add(
                attribute.at,
                format!("_autoremap `{}`", attribute.value),
                "true or false",
            );
        }
    } else if !["_description", "_uid", "_fullpath", "_collapsed", "_autoremap"].contains(&name) {
        let known = GUARDS.into_iter().chain(["_autoremap"]);
        if let Some(known) = super::nearest::nearest(name, known) {
            errors.add(
                attribute.at,
                format!("unknown attribute `{name}`"),
                format!("`{known}`"),
            );
        }
    }
}

/// A remapping must name an entry.
fn key_name(attribute: &Attribute, errors: &mut Collector) {
    if let Some(key) = pointer(&attribute.value, &attribute.name)
        && !is_key(key)
    {
        errors.add(
            attribute.at,
            format!("`{}` names no blackboard entry", attribute.value),
            "{name}, of letters, digits and _",
        );
    }
}

fn is_key(key: &str) -> bool {
    let key = key.strip_prefix('@').unwrap_or(key);
    !key.is_empty() && key.len() <= 256 && !key.contains(['{', '}', '@', '"', '\'', '<', '>'])
}

fn port_value(attribute: &Attribute, port: &PortSpec, literals: Option<LiteralRules>, errors: &mut Collector) {
    let value = attribute.value.as_str();
    if port.kind == PortType::Script {
        if let Err(wrong) = script::parse(value) {
            errors.add(
                attribute.at,
                format!("port `{}`: {} at character {}", port.name, wrong.message, wrong.at),
                wrong.expected,
            );
        }
        return;
    }
    if pointer(value, &port.name).is_some() {
        return key_name(attribute, errors);
    }
    if port.kind == PortType::Key {
        if !is_key(value.trim()) {
            errors.add(
                attribute.at,
                format!("port `{}` is `{value}`", port.name),
                port.kind.expected(),
            );
        }
        return;
    }
    if port.direction == Direction::Output {
        errors.add(
            attribute.at,
            format!("output port `{}` is the literal `{}`", port.name, shortened(value, 60)),
            "a blackboard entry, as in {key}",
        );
        return;
    }
    let data = match &port.kind {
        PortType::Data(kind) => literals.map(|rules| (rules, kind)),
        _ => None,
    };
    if port.kind.parse(value).is_none() || data.is_some_and(|(rules, kind)| !(rules.fits)(kind, value)) {
        let form = data.and_then(|(rules, kind)| (rules.form)(kind));
        let form = form.map(|form| format!(": {form}")).unwrap_or_default();
        errors.add(
            attribute.at,
            format!("port `{}` is `{}`", port.name, shortened(value, 60)),
            port.kind.expected() + &form,
        );
    } else if let Some(name) = data.and_then(|(rules, kind)| (rules.name)(kind, value)) {
        let name = shortened(name, 60);
        let message = format!("port `{}`: `{name}` is taken for the name of a place", port.name);
        errors.warn(attribute.at, &message);
    } else if let Some(number) = Value::text(value).as_double()
        && let Some(doubt) = literals.and_then(|rules| (rules.doubt)(&port.name, number))
    {
        errors.warn(attribute.at, &format!("port `{}` is {number}: {doubt}", port.name));
    }
}

//! Document. What is the content of the files? Elements with their positions, trees by id, models of nodes.

use std::collections::BTreeMap;

use super::error::{Collector, Place};
use super::guard::guard;
use super::nearest::hint;
use super::{Include, Limits};
use crate::ports::{Direction, PortSpec, PortType};
use crate::registry::{Category, NodeSpec};

/// Most XML nodes (elements, texts, comments) of one file.
const XML_NODES: u32 = 300_000;

pub(super) type ElementId = usize;

pub(super) struct Attribute {
    pub(super) name: String,
    pub(super) value: String,
    pub(super) at: Place,
}

pub(super) struct Element {
    pub(super) tag: String,
    pub(super) at: Place,
    pub(super) attributes: Vec<Attribute>,
    pub(super) children: Vec<ElementId>,
    text: String,
}

impl Element {
    pub(super) fn attribute(&self, name: &str) -> Option<&Attribute> {
        self.attributes.iter().find(|attribute| attribute.name == name)
    }

    /// Attributes that name an entry or one of the node's own ports.
    pub(super) fn remappings(&self) -> impl Iterator<Item = &Attribute> {
        let is_own = |name: &str| !matches!(name, "ID" | "name") && !name.starts_with('_');
        self.attributes.iter().filter(move |attribute| is_own(&attribute.name))
    }

    /// Ports and scripts with their texts; an editor's own notes and empty scripts are left out.
    pub(super) fn written(&self) -> Box<[(Box<str>, Box<str>)]> {
        let is_told = |attribute: &&Attribute| match attribute.name.as_str() {
            "ID" | "name" | "_uid" | "_fullpath" | "_description" => false,
            script if script.starts_with('_') => !attribute.value.trim().is_empty(),
            _ => true,
        };
        let told = self.attributes.iter().filter(is_told);
        told.map(|attribute| (attribute.name.as_str().into(), attribute.value.as_str().into()))
            .collect()
    }
}

/// A `<BehaviorTree>`.
pub(super) struct Definition {
    pub(super) at: Place,
    /// Its only child; `None` unless there is exactly one.
    pub(super) root: Option<ElementId>,
    /// All its children.
    pub(super) body: Vec<ElementId>,
}

/// The content of all files.
#[derive(Default)]
pub(super) struct Forest {
    pub(super) elements: Vec<Element>,
    pub(super) trees: BTreeMap<String, Definition>,
    /// Children of trees without a usable id: they cannot run, but are checked.
    pub(super) stray: Vec<ElementId>,
    /// Models of nodes in `TreeNodesModel`.
    pub(super) models: BTreeMap<String, NodeSpec>,
    /// Models of SubTrees in `TreeNodesModel`.
    pub(super) subtree_models: BTreeMap<String, NodeSpec>,
    /// `main_tree_to_execute` of the first file.
    pub(super) main: Option<(String, Place)>,
    /// Position of the first file's root.
    pub(super) start: Place,
}

impl Forest {
    pub(super) fn element(&self, id: ElementId) -> Option<&Element> {
        self.elements.get(id)
    }
}

/// Reads a file and everything it includes.
pub(super) fn read(
    file: &str,
    bytes: &[u8],
    include: &mut Include<'_>,
    limits: &Limits,
    errors: &mut Collector,
) -> Forest {
    let mut forest = Forest::default();
    let index = errors.add_file(file);
    forest.start = Place { file: index, offset: 0 };
    let mut budget = limits.bytes;
    let mut includes = limits.includes;
    let mut graph = Includes::default();
    // Files yet to be read: name, index, bytes.
    let mut todo = vec![(file.to_owned(), index, bytes.to_vec())];
    while let Some((name, index, bytes)) = todo.pop() {
        let start = Place { file: index, offset: 0 };
        if bytes.len() > budget {
            let message = format!("{} bytes", bytes.len());
            errors.add(start, message, format!("at most {} bytes in all files", limits.bytes));
            continue;
        }
        budget -= bytes.len();
        let Some(root) = parse(&bytes, index, limits, &mut forest, errors) else {
            continue;
        };
        for (path, at) in sort(root, index == 0, &mut forest, errors) {
            if includes == 0 {
                errors.add(at, "too many includes", format!("at most {}", limits.includes));
                break;
            }
            includes -= 1;
            match include(&name, &path) {
                Err(why) => errors.add(at, format!("include `{path}`: {why}"), "a file that can be read"),
                Ok((found, bytes)) => {
                    // Files included twice, or including one another, are read once.
                    let known = errors.file_index(&found);
                    let target = known.unwrap_or_else(|| errors.add_file(&found));
                    graph.edges.push((index, target, at));
                    if known.is_none() {
                        todo.push((found, target, bytes));
                    }
                }
            }
        }
    }
    graph.tell_cycles(errors);
    if let (Some(nameless), true) = (forest.trees.get(""), forest.trees.len() > 1) {
        errors.add(nameless.at, NO_ID.0, NO_ID.1);
    }
    forest
}

const NO_ID: (&str, &str) = ("<BehaviorTree> without ID", "an ID, where there are several trees");

/// Which file includes which, and where.
#[derive(Default)]
struct Includes {
    edges: Vec<(u16, u16, Place)>,
}

impl Includes {
    /// Chain of includes from one file to another, both ends included; `None` if there is none.
    fn way(&self, from: u16, to: u16) -> Option<Vec<u16>> {
        let mut ways = vec![vec![from]];
        let mut seen = vec![from];
        while let Some(way) = ways.pop() {
            let end = way.last().copied()?;
            if end == to {
                return Some(way);
            }
            for (_, next, _) in self.edges.iter().filter(|(file, _, _)| *file == end) {
                if !seen.contains(next) {
                    seen.push(*next);
                    ways.push(way.iter().copied().chain([*next]).collect());
                }
            }
        }
        None
    }

    /// Warns about files that include one another: they are read once each here, but BehaviorTree.CPP never finishes reading them.
    fn tell_cycles(&self, errors: &mut Collector) {
        let mut told: Vec<u16> = Vec::new();
        for (from, to, at) in &self.edges {
            if told.contains(from) {
                continue;
            }
            if let Some(way) = self.way(*to, *from) {
                let names: Vec<&str> = [*from].iter().chain(&way).map(|file| errors.file_name(*file)).collect();
                let message = format!("files include one another: {}: each is read once", names.join(" > "));
                errors.warn(*at, &message);
                told.extend(way);
            }
        }
    }
}

/// Reads one file into elements; returns the id of its root.
fn parse(bytes: &[u8], file: u16, limits: &Limits, forest: &mut Forest, errors: &mut Collector) -> Option<ElementId> {
    let text = match std::str::from_utf8(bytes) {
        Ok(text) => text.strip_prefix('\u{feff}').unwrap_or(text),
        Err(wrong) => {
            let before = bytes.iter().take(wrong.valid_up_to());
            let line = before.filter(|byte| **byte == b'\n').count() as u32 + 1;
            errors.add_at(file, (line, 1), "bytes that are not text", "UTF-8");
            return None;
        }
    };
    errors.add_text(file, text);
    let place = |offset: usize| Place {
        file,
        offset: offset as u32,
    };
    // Two more levels for `root` and `BehaviorTree`.
    if let Err(refused) = guard(text, limits.depth() + 2) {
        errors.add(place(refused.at), refused.message, refused.expected);
        return None;
    }
    let options = roxmltree::ParsingOptions {
        nodes_limit: XML_NODES,
        ..Default::default()
    };
    let document = match roxmltree::Document::parse_with_options(text, options) {
        Ok(document) => document,
        Err(wrong) => {
            let at = (wrong.pos().row, wrong.pos().col);
            errors.add_at(file, at, format!("not XML: {wrong}"), "well-formed XML of bounded size");
            return None;
        }
    };
    // The parser's ids are dense and in document order, so parents come first.
    let mut known: BTreeMap<usize, ElementId> = BTreeMap::new();
    for node in document.descendants() {
        let parent = node
            .parent()
            .and_then(|parent| known.get(&parent.id().get_usize()).copied());
        if node.is_text()
            && let (Some(parent), Some(text)) = (parent, node.text())
            && let Some(parent) = forest.elements.get_mut(parent)
        {
            let text = text.trim();
            if !text.is_empty() && parent.text.is_empty() {
                parent.text = text.chars().take(1_000).collect();
            }
        }
        if !node.is_element() {
            continue;
        }
        let id = forest.elements.len();
        known.insert(node.id().get_usize(), id);
        if let Some(parent) = parent.and_then(|parent| forest.elements.get_mut(parent)) {
            parent.children.push(id);
        }
        forest.elements.push(Element {
            tag: node.tag_name().name().to_owned(),
            at: place(node.range().start),
            attributes: node
                .attributes()
                .map(|attribute| Attribute {
                    name: attribute.name().to_owned(),
                    value: attribute.value().to_owned(),
                    at: place(attribute.range().start),
                })
                .collect(),
            children: Vec::new(),
            text: String::new(),
        });
    }
    known.get(&document.root_element().id().get_usize()).copied()
}

/// Sorts the children of a root into trees and models; returns the includes.
fn sort(root: ElementId, first: bool, forest: &mut Forest, errors: &mut Collector) -> Vec<(String, Place)> {
    let mut includes = Vec::new();
    let Some(element) = forest.elements.get(root) else {
        return includes;
    };
    let at = element.at;
    if element.tag != "root" {
        errors.add(at, format!("<{}> at the top", element.tag), "<root BTCPP_format=\"4\">");
        return includes;
    }
    let mut main = None;
    for attribute in &element.attributes {
        match attribute.name.as_str() {
            "BTCPP_format" if attribute.value.trim() == "4" => {}
            "BTCPP_format" => errors.add(attribute.at, format!("BTCPP_format `{}`", attribute.value), "4"),
            "main_tree_to_execute" => main = Some((attribute.value.clone(), attribute.at)),
            name if name.starts_with('_') || name == "project_name" => {}
            name => {
                let known = ["BTCPP_format", "main_tree_to_execute"];
                let hint = hint(name, known.into_iter());
                errors.add(
                    attribute.at,
                    format!("unknown attribute `{name}` of <root>"),
                    format!("BTCPP_format or main_tree_to_execute{hint}"),
                );
            }
        }
    }
    let children = element.children.clone();
    if first {
        forest.main = main;
        forest.start = at;
    }
    for child in children {
        let Some(element) = forest.elements.get(child) else {
            continue;
        };
        match element.tag.as_str() {
            "BehaviorTree" => define(child, forest, errors),
            "TreeNodesModel" => models(child, forest, errors),
            "include" => match element.attribute("path") {
                Some(_) if element.attribute("ros_pkg").is_some() => {
                    errors.add(
                        element.at,
                        "include by ros_pkg",
                        "a path alone: there are no ROS packages here",
                    );
                }
                Some(path) => includes.push((path.value.clone(), path.at)),
                None => errors.add(element.at, "<include> without a path", "<include path=\"file.xml\"/>"),
            },
            tag => {
                let known = ["BehaviorTree", "TreeNodesModel", "include"];
                let hint = hint(tag, known.into_iter());
                errors.add(
                    element.at,
                    format!("<{tag}> below <root>"),
                    format!("BehaviorTree, TreeNodesModel or include{hint}"),
                );
            }
        }
    }
    includes
}

fn define(id: ElementId, forest: &mut Forest, errors: &mut Collector) {
    let Some(element) = forest.elements.get(id) else { return };
    let at = element.at;
    for attribute in &element.attributes {
        // Groot2 marks editable trees.
        if !matches!(attribute.name.as_str(), "ID" | "editable") && !attribute.name.starts_with('_') {
            errors.add(
                attribute.at,
                format!("unknown attribute `{}` of <BehaviorTree>", attribute.name),
                "ID",
            );
        }
    }
    let name = element.attribute("ID").map(|id| id.value.clone()).unwrap_or_default();
    let body = element.children.clone();
    let root = match body.as_slice() {
        [root] => Some(*root),
        children => {
            errors.add(
                at,
                format!("tree `{name}` has {} children", children.len()),
                "exactly 1",
            );
            None
        }
    };
    if name.is_empty() && !forest.trees.is_empty() {
        errors.add(at, NO_ID.0, NO_ID.1);
        forest.stray.extend(body);
        return;
    }
    if let Some(other) = forest.trees.get(&name) {
        let message = format!("tree `{name}` is defined twice, first at {}", errors.describe(other.at));
        errors.add(at, message, "one tree of an ID");
        forest.stray.extend(body);
        return;
    }
    forest.trees.insert(name, Definition { at, root, body });
}

fn models(id: ElementId, forest: &mut Forest, errors: &mut Collector) {
    let children = forest
        .elements
        .get(id)
        .map(|model| model.children.clone())
        .unwrap_or_default();
    for child in children {
        let Some(element) = forest.elements.get(child) else {
            continue;
        };
        let Some(category) = Category::from_tag(&element.tag) else {
            errors.add(
                element.at,
                format!("<{}> in TreeNodesModel", element.tag),
                "Action, Condition, Control, Decorator or SubTree",
            );
            continue;
        };
        let Some(name) = element.attribute("ID").map(|id| id.value.clone()) else {
            let message = format!("<{}> without ID", element.tag);
            errors.add(element.at, message, "the registration id");
            continue;
        };
        let mut spec = NodeSpec::new(category, name.clone(), element.text.clone());
        for port in &element.children {
            let Some(port) = forest.elements.get(*port) else {
                continue;
            };
            spec.ports.extend(port_model(port, errors));
        }
        let models = if category == Category::SubTree {
            &mut forest.subtree_models
        } else {
            &mut forest.models
        };
        // Several included files may describe the same node.
        models.entry(name).or_insert(spec);
    }
}

fn port_model(port: &Element, errors: &mut Collector) -> Option<PortSpec> {
    let direction = match port.tag.as_str() {
        "input_port" => Direction::Input,
        "output_port" => Direction::Output,
        "inout_port" | "bidirectional_port" => Direction::InOut,
        "MetadataFields" | "description" => return None,
        tag => {
            errors.add(
                port.at,
                format!("<{tag}> in the model of a node"),
                "input_port, output_port or inout_port",
            );
            return None;
        }
    };
    let Some(name) = port.attribute("name") else {
        errors.add(
            port.at,
            format!("<{}> without a name", port.tag),
            "the name of the port",
        );
        return None;
    };
    let kind = PortType::from_name(port.attribute("type").map_or("", |kind| kind.value.as_str()));
    // Nav2's model writes text defaults in quotation marks, and C++ code where it has no literal.
    let default = port
        .attribute("default")
        .map(|default| default.value.trim_matches('"').to_owned())
        .filter(|default| default.starts_with('{') || kind.parse(default).is_some());
    Some(PortSpec {
        name: name.value.clone(),
        direction,
        kind,
        default,
        required: false,
        doc: port.text.clone(),
    })
}

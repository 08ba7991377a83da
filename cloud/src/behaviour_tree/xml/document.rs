//! What do the files say? Elements with their places, trees by id, models of nodes.

use std::collections::BTreeMap;

use super::error::{Collector, Place};
use super::guard::guard;
use super::nearest::hint;
use super::{Include, Limits};
use crate::behaviour_tree::ports::{Direction, PortSpec, PortType};
use crate::behaviour_tree::registry::{Category, NodeSpec};

/// XML nodes (elements, texts, comments) of one file.
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
}

/// A `<BehaviorTree>`.
pub(super) struct Definition {
    pub(super) at: Place,
    /// Its one child; `None` if that is wrong.
    pub(super) root: Option<ElementId>,
}

/// All files together.
#[derive(Default)]
pub(super) struct Forest {
    pub(super) elements: Vec<Element>,
    pub(super) trees: BTreeMap<String, Definition>,
    /// What `TreeNodesModel` says of nodes.
    pub(super) models: BTreeMap<String, NodeSpec>,
    /// What `TreeNodesModel` says of SubTrees.
    pub(super) subtree_models: BTreeMap<String, NodeSpec>,
    /// `main_tree_to_execute` of the first file.
    pub(super) main: Option<(String, Place)>,
    /// Where the first file's root stands.
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
    // Files still to be read: name, index, bytes.
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
                // Included twice, or including one another: read once.
                Ok((found, _)) if errors.file_index(&found).is_some() => {}
                Ok((found, bytes)) => {
                    let index = errors.add_file(&found);
                    todo.push((found, index, bytes));
                }
            }
        }
    }
    forest
}

/// Reads one file into elements; the id of its root.
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
    // Two levels are `root` and `BehaviorTree`.
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

/// Sorts what stands below a root into trees and models; answers the includes.
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
        // Groot2 notes what it may edit.
        if !matches!(attribute.name.as_str(), "ID" | "editable") && !attribute.name.starts_with('_') {
            errors.add(
                attribute.at,
                format!("unknown attribute `{}` of <BehaviorTree>", attribute.name),
                "ID",
            );
        }
    }
    let name = element.attribute("ID").map(|id| id.value.clone()).unwrap_or_default();
    let root = match element.children.as_slice() {
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
        errors.add(at, "<BehaviorTree> without ID", "an ID, where there are several trees");
        return;
    }
    if let Some(other) = forest.trees.get(&name) {
        let message = format!("tree `{name}` is defined twice, first at {}", errors.describe(other.at));
        errors.add(at, message, "one tree of an ID");
        return;
    }
    forest.trees.insert(name, Definition { at, root });
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
            errors.add(
                element.at,
                format!("<{}> without ID", element.tag),
                "the registration id",
            );
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
        // The same node may be described in several included files.
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
    // Nav2's model writes text defaults in quotation marks, and C++ where it has no literal.
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

//! `zenav bt nodes`. The nodes that a tree may use, with their ports, as a table or as the `TreeNodesModel` that Groot2 loads as its
//! palette.

use std::fmt::Write as _;

use serde::Serialize;
use zenav_behaviour_tree::{Category, Direction, NodeSpec, PortSpec, PortType};
use zenav_mission::trees;

use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

#[derive(Debug, Serialize)]
struct Node {
    id: String,
    category: &'static str,
    doc: String,
    ports: Vec<Port>,
}

#[derive(Debug, Serialize)]
struct Port {
    name: String,
    direction: &'static str,
    #[serde(rename = "type")]
    kind: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    default: Option<String>,
    required: bool,
    doc: String,
}

impl Port {
    fn of(port: &PortSpec) -> Self {
        Self {
            name: port.name.clone(),
            direction: direction(port.direction),
            kind: type_name(&port.kind),
            default: port.default.clone(),
            required: port.required,
            doc: port.doc.clone(),
        }
    }
}

/// Prints the nodes that missions know, or those whose id or description contains a word.
pub(super) fn nodes(word: Option<&str>, xml: bool, format: Format) -> Outcome {
    if xml && format != Format::Table {
        return Err(Failure::usage("-o: expected no other form beside --xml"));
    }
    let word = word.unwrap_or_default().to_lowercase();
    let wanted = |spec: &&NodeSpec| {
        let text = format!("{} {} {}", spec.id, spec.category.as_str(), spec.doc);
        spec.category != Category::SubTree && text.to_lowercase().contains(&word)
    };
    let mut specs: Vec<&NodeSpec> = trees::registry().specs().filter(wanted).collect();
    specs.sort_by(|a, b| (a.category, &a.id).cmp(&(b.category, &b.id)));
    if specs.is_empty() {
        return Err(Failure::not_found(format!(
            "no node matches `{word}` (`zenav bt nodes` lists all)"
        )));
    }
    if xml {
        output::line(&model(&specs));
        return Ok(exit_code::OK);
    }
    let nodes: Vec<Node> = specs
        .iter()
        .map(|spec| Node {
            id: spec.id.clone(),
            category: spec.category.as_str(),
            doc: spec.doc.clone(),
            ports: spec.ports.iter().map(Port::of).collect(),
        })
        .collect();
    output::values(format, &nodes, table)?;
    Ok(exit_code::OK)
}

fn table(nodes: &[Node]) -> String {
    let mut text = String::new();
    for node in nodes {
        let doc = if node.doc.is_empty() {
            String::new()
        } else {
            format!(": {}", node.doc)
        };
        let _ = writeln!(text, "{} ({}){doc}", node.id, node.category);
        for port in &node.ports {
            let default = port
                .default
                .as_ref()
                .map(|value| format!(" = {value}"))
                .unwrap_or_default();
            let must = if port.required { ", required" } else { "" };
            let _ = writeln!(
                text,
                "    {} {}: {}{default}{must}  {}",
                port.direction, port.name, port.kind, port.doc
            );
        }
    }
    text
}

const fn direction(direction: Direction) -> &'static str {
    match direction {
        Direction::Input => "input",
        Direction::Output => "output",
        Direction::InOut => "inout",
    }
}

/// The type as BehaviorTree.CPP spells it.
fn type_name(kind: &PortType) -> String {
    match kind {
        PortType::Any => "BT::AnyTypeAllowed",
        PortType::Bool => "bool",
        PortType::Int => "int",
        PortType::Unsigned => "unsigned int",
        PortType::Double | PortType::Positive => "double",
        PortType::Text | PortType::Script | PortType::Key | PortType::List(_) => "std::string",
        PortType::Status => "BT::NodeStatus",
        PortType::Ints => "std::vector<int>",
        PortType::Data(name) => return name.clone(),
    }
    .to_owned()
}

/// The nodes as a file that Groot2 loads: `<TreeNodesModel>`.
fn model(specs: &[&NodeSpec]) -> String {
    let mut text =
        String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<root BTCPP_format=\"4\">\n  <TreeNodesModel>\n");
    for spec in specs {
        let (tag, id) = (spec.category.as_str(), escaped(&spec.id));
        let _ = write!(text, "    <{tag} ID=\"{id}\"");
        if spec.doc.is_empty() && spec.ports.is_empty() {
            text.push_str("/>\n");
            continue;
        }
        text.push_str(">\n");
        for port in &spec.ports {
            let tag = format!("{}_port", direction(port.direction));
            let _ = write!(
                text,
                "      <{tag} name=\"{}\" type=\"{}\"",
                escaped(&port.name),
                escaped(&type_name(&port.kind))
            );
            if let Some(default) = &port.default {
                let _ = write!(text, " default=\"{}\"", escaped(default));
            }
            let _ = writeln!(text, ">{}</{tag}>", escaped(&port.doc));
        }
        if !spec.doc.is_empty() {
            let _ = writeln!(text, "      <description>{}</description>", escaped(&spec.doc));
        }
        let _ = writeln!(text, "    </{tag}>");
    }
    text.push_str("  </TreeNodesModel>\n</root>");
    text
}

/// Text with XML special characters escaped.
fn escaped(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for letter in text.chars() {
        match letter {
            '&' => escaped.push_str("&amp;"),
            '<' => escaped.push_str("&lt;"),
            '>' => escaped.push_str("&gt;"),
            '"' => escaped.push_str("&quot;"),
            other => escaped.push(other),
        }
    }
    escaped
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn groot_s_palette_is_xml_that_names_every_node_and_port() {
        let specs: Vec<&NodeSpec> = trees::registry().specs().collect();
        let text = model(&specs);
        let document = roxmltree::Document::parse(&text).unwrap();
        let model = document.root_element().first_element_child().unwrap();
        assert_eq!(model.tag_name().name(), "TreeNodesModel");
        let nodes: Vec<_> = model.children().filter(roxmltree::Node::is_element).collect();
        assert_eq!(nodes.len(), specs.len());
        let follow = nodes
            .iter()
            .find(|node| node.attribute("ID") == Some("FollowPath"))
            .unwrap();
        assert_eq!(follow.tag_name().name(), "Action");
        let ports: Vec<_> = follow.children().filter_map(|port| port.attribute("name")).collect();
        assert!(ports.contains(&"path"), "{ports:?}");
        for (spec, node) in specs.iter().zip(nodes) {
            let ports = node.children().filter(|port| port.has_attribute("name")).count();
            assert_eq!(ports, spec.ports.len(), "{}", spec.id);
        }
    }

    #[test]
    fn a_type_is_spelt_so_that_it_reads_back() {
        for kind in [
            PortType::Bool,
            PortType::Int,
            PortType::Unsigned,
            PortType::Double,
            PortType::Text,
        ] {
            assert_eq!(PortType::from_name(&type_name(&kind)), kind);
        }
    }
}

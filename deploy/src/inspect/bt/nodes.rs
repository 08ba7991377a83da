//! `zenav bt nodes`. The nodes that a tree may use, with their ports, as a table or as the `TreeNodesModel` that Groot2 loads as its
//! palette.

use std::fmt::Write as _;

use zenav_behaviour_tree::{Category, NodeSpec};
use zenav_mission::trees;

use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format, escape};

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
    output::values(format, &specs, table)
}

fn table(nodes: &[&NodeSpec]) -> String {
    let mut text = String::new();
    for node in nodes {
        let doc = if node.doc.is_empty() {
            String::new()
        } else {
            format!(": {}", node.doc)
        };
        let _ = writeln!(text, "{} ({}){doc}", node.id, node.category.as_str());
        for port in &node.ports {
            let default = output::piece(port.default.as_ref(), |value| format!(" = {value}"));
            let must = if port.required { ", required" } else { "" };
            let _ = writeln!(
                text,
                "    {} {}: {}{default}{must}  {}",
                port.direction.as_str(),
                port.name,
                port.kind.name(),
                port.doc
            );
        }
    }
    text
}

/// The nodes as a file that Groot2 loads: `<TreeNodesModel>`.
fn model(specs: &[&NodeSpec]) -> String {
    let mut text =
        String::from("<?xml version=\"1.0\" encoding=\"UTF-8\"?>\n<root BTCPP_format=\"4\">\n  <TreeNodesModel>\n");
    for spec in specs {
        let (tag, id) = (spec.category.as_str(), escape(&spec.id));
        let _ = write!(text, "    <{tag} ID=\"{id}\"");
        if spec.doc.is_empty() && spec.ports.is_empty() {
            text.push_str("/>\n");
            continue;
        }
        text.push_str(">\n");
        for port in &spec.ports {
            let tag = format!("{}_port", port.direction.as_str());
            let _ = write!(
                text,
                "      <{tag} name=\"{}\" type=\"{}\"",
                escape(&port.name),
                escape(port.kind.name())
            );
            if let Some(default) = &port.default {
                let _ = write!(text, " default=\"{}\"", escape(default));
            }
            let _ = writeln!(text, ">{}</{tag}>", escape(&port.doc));
        }
        if !spec.doc.is_empty() {
            let _ = writeln!(text, "      <description>{}</description>", escape(&spec.doc));
        }
        let _ = writeln!(text, "    </{tag}>");
    }
    text.push_str("  </TreeNodesModel>\n</root>");
    text
}

#[cfg(test)]
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
}

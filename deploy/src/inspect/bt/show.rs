//! `zenav bt show`: draws a tree in the terminal, or as a picture.

use std::collections::BTreeMap;
use std::path::Path;

use serde::Serialize;
use zenav_behaviour_tree::{self as trees, NodeReport, Tree, simulate};

use super::{Source, bad_tree, includer};
use crate::drawing::tree;
use crate::exit_code;
use crate::failure::Outcome;
use crate::files;
use crate::output::{self, Format};

/// A node, with the ports and scripts that its file sets.
#[derive(Debug, Serialize)]
struct Shown {
    #[serde(flatten)]
    node: NodeReport,
    ports: BTreeMap<String, String>,
}

fn shown<C>(tree: &Tree<C>) -> Vec<Shown> {
    let ports = |uid| {
        let written = tree.written(uid);
        written.map(|(port, text)| (port.to_owned(), text.to_owned())).collect()
    };
    let nodes = tree.iter().map(|node| Shown {
        ports: ports(node.uid),
        node,
    });
    nodes.collect()
}

/// A hint for each node of a picture: its ports, one per line.
fn hints<C>(tree: &Tree<C>) -> Vec<String> {
    let hint = |node: NodeReport| {
        let ports = tree.written(node.uid);
        ports
            .map(|(port, text)| format!("{port}=\"{text}\""))
            .collect::<Vec<_>>()
            .join("\n")
    };
    tree.iter().map(hint).collect()
}

/// Builds the tree with the simulation's nodes, so that a tree for another robot can be drawn too.
pub(super) fn show(file: &str, id: Option<&str>, out: Option<&Path>, format: Format) -> Outcome {
    let source = Source::read(file)?;
    let mut include = includer(&source.name);
    let built = trees::build(&source.name, &source.text, &simulate::registry(), id, &mut include)
        .map_err(|errors| bad_tree(&errors))?;
    let Some(out) = out else {
        return output::value(format, &shown(&built), |_| built.render_written());
    };
    let picture = match files::ending(out).as_str() {
        "svg" => tree::svg(&built.report(), &hints(&built)).into_bytes(),
        "png" => tree::png(&built.report())?,
        _ => return Err(files::unknown_ending(out, ".svg or .png")),
    };
    files::write(out, picture)?;
    Ok(exit_code::OK)
}

#[cfg(test)]
mod tests {
    use zenav_mission::trees;

    use super::*;

    #[test]
    fn a_node_is_shown_with_its_ports() {
        let tree = trees::build("navigate").unwrap();
        let json = serde_json::to_value(shown(&tree)).unwrap();
        let plan = json
            .as_array()
            .unwrap()
            .iter()
            .find(|node| node["id"] == "ComputePathToPose")
            .unwrap();
        assert_eq!(plan["ports"]["goal"], "{goal}");
        assert!(
            tree.render_written()
                .contains("ComputePathToPose goal=\"{goal}\" path=\"{path}\"")
        );
        let hint = &hints(&tree)[usize::try_from(plan["uid"].as_u64().unwrap()).unwrap() - 1];
        assert!(hint.starts_with("goal=\"{goal}\"\npath="), "{hint}");
    }
}

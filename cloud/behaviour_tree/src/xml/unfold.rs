//! Expansion size. How large is a tree with its SubTrees unfolded? Computed without unfolding it: first the trees without SubTrees, then
//! those that contain only these, and so on. The remaining trees are cyclic.

use std::collections::BTreeMap;

use super::Limits;
use super::document::Forest;
use super::error::{Collector, Place};

/// Size of one tree, its SubTrees not unfolded.
#[derive(Default)]
pub(super) struct Size {
    pub(super) nodes: u64,
    /// Size of all attribute values: the least cost of every copy of the tree.
    pub(super) bytes: u64,
    pub(super) depth: usize,
    /// SubTrees: id, place, depth below the root of this tree. All of them exist.
    pub(super) subtrees: Vec<(String, Place, usize)>,
}

/// Size of one tree, its SubTrees unfolded.
#[derive(Clone, Copy)]
struct Whole {
    nodes: u64,
    bytes: u64,
    depth: usize,
}

/// Number of nodes of every tree that can be unfolded; reports trees that are too large or cyclic.
pub(super) fn unfold(
    sizes: &BTreeMap<&str, Size>,
    forest: &Forest,
    limits: &Limits,
    errors: &mut Collector,
) -> BTreeMap<String, u64> {
    let mut waiting: BTreeMap<&str, usize> = BTreeMap::new();
    let mut users: BTreeMap<&str, Vec<&str>> = BTreeMap::new();
    for (id, size) in sizes {
        waiting.insert(id, size.subtrees.len());
        for (sub, _, _) in &size.subtrees {
            users.entry(sub).or_default().push(id);
        }
    }
    let mut ready: Vec<&str> = waiting
        .iter()
        .filter(|(_, left)| **left == 0)
        .map(|(id, _)| *id)
        .collect();
    let mut done: BTreeMap<&str, Whole> = BTreeMap::new();
    let mut told = false;
    while let Some(id) = ready.pop() {
        let Some(size) = sizes.get(id) else { continue };
        let mut whole = Whole {
            nodes: size.nodes,
            bytes: size.bytes,
            depth: size.depth,
        };
        for (sub, _, at) in &size.subtrees {
            if let Some(more) = done.get(sub.as_str()) {
                whole.nodes = whole.nodes.saturating_add(more.nodes);
                whole.bytes = whole.bytes.saturating_add(more.bytes);
                whole.depth = whole.depth.max(at.saturating_add(more.depth));
            }
        }
        done.insert(id, whole);
        // A tree that is too large makes all its users too large: reporting the first is enough.
        if !told && let Some((message, expected)) = excess(&whole, limits) {
            told = true;
            let at = forest.trees.get(id).map(|tree| tree.at).unwrap_or_default();
            errors.add(at, format!("tree `{id}` has {message} with its SubTrees"), expected);
        }
        for user in users.get(id).into_iter().flatten() {
            if let Some(left) = waiting.get_mut(user) {
                *left -= 1;
                if *left == 0 {
                    ready.push(user);
                }
            }
        }
    }
    cycles(sizes, &done, errors);
    done.into_iter()
        .map(|(id, whole)| (id.to_owned(), whole.nodes))
        .collect()
}

fn excess(whole: &Whole, limits: &Limits) -> Option<(String, String)> {
    let most_bytes = 2 * limits.bytes as u64;
    if whole.nodes > limits.nodes() {
        Some((format!("{} nodes", whole.nodes), format!("at most {}", limits.nodes())))
    } else if whole.depth > limits.depth() {
        Some((format!("{} levels", whole.depth), format!("at most {}", limits.depth())))
    } else if whole.bytes > most_bytes {
        Some((
            format!("{} bytes of attributes", whole.bytes),
            format!("at most {most_bytes}"),
        ))
    } else {
        None
    }
}

/// Reports every cycle once.
fn cycles(sizes: &BTreeMap<&str, Size>, done: &BTreeMap<&str, Whole>, errors: &mut Collector) {
    let mut seen: BTreeMap<&str, usize> = BTreeMap::new();
    let left_over = sizes.keys().filter(|id| !done.contains_key(*id));
    for (walk, start) in left_over.enumerate() {
        let mut path: Vec<(&str, Place)> = Vec::new();
        let mut here = *start;
        // A path that meets an earlier one leads to a cycle that has been reported.
        while !seen.contains_key(here) {
            seen.insert(here, walk);
            let next = sizes.get(here).and_then(|size| {
                size.subtrees
                    .iter()
                    .find(|(sub, _, _)| !done.contains_key(sub.as_str()))
            });
            let Some((sub, at, _)) = next else { break };
            path.push((here, *at));
            here = sub;
        }
        if let Some(from) = path.iter().position(|(id, _)| *id == here)
            && seen.get(here) == Some(&walk)
            && let Some((_, at)) = path.last()
        {
            let names: Vec<&str> = path[from..].iter().map(|(id, _)| *id).chain([here]).collect();
            let message = format!("trees contain one another: {}", names.join(" > "));
            errors.add(*at, message, "SubTrees without a cycle");
        }
    }
}

//! Report. How is a tree displayed? One record per node for publishing, and a drawing for a terminal.

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

use super::node::{Info, NodeId};
use super::status::Status;
use super::tree::Tree;
use super::value::Value;

/// One node as displayed.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct NodeReport {
    /// Number of the node: its position in document order with SubTrees unfolded, from 1.
    pub uid: u16,
    /// Number of its parent; `None` for the root.
    pub parent: Option<u16>,
    /// 0 for the root.
    pub depth: u16,
    /// `name` in the tree file, or the registration id.
    pub name: String,
    /// Registration id; for a SubTree, the id of its tree.
    pub id: String,
    /// `Action`, `Condition`, `Control`, `Decorator`, `SubTree`.
    pub category: String,
    /// As its parent sees it.
    pub status: Status,
    /// Its last answer: kept when the parent resets it.
    pub last: Status,
    /// How often it was entered from a status other than `Running`.
    pub starts: u32,
    /// A leaf's own feedback.
    pub feedback: String,
}

/// Longest text for a value, characters.
const LONGEST: usize = 60;
/// Most fields of structured data that are shown.
const FIELDS: usize = 4;

/// A short text for a value; a path of a thousand poses is shown by its length only.
fn words(value: &Value) -> String {
    let inner = |value: &Json| match value {
        Json::Number(number) if number.is_f64() => number
            .as_f64()
            .map_or_else(String::new, |number| format!("{number:.2}")),
        Json::String(text) => text.chars().take(LONGEST).collect(),
        Json::Array(items) => format!("{} items", items.len()),
        Json::Object(_) => "…".to_owned(),
        other => other.to_string(),
    };
    let text = match value {
        Value::Data(data) => match &**data {
            Json::Object(fields) => {
                let named = fields
                    .iter()
                    .take(FIELDS)
                    .map(|(name, value)| format!("{name} {}", inner(value)));
                named.collect::<Vec<_>>().join(", ")
            }
            other => inner(other),
        },
        Value::Text(text) => text.chars().take(LONGEST + 1).collect(),
        scalar => scalar.to_string(),
    };
    if text.chars().count() > LONGEST {
        text.chars().take(LONGEST - 1).chain(std::iter::once('…')).collect()
    } else {
        text
    }
}

impl<C> Tree<C> {
    /// Every node, in document order.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use zenav_behaviour_tree::{Registry, Status, build};
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
    ///     <RetryUntilSuccessful num_attempts="3"><AlwaysFailure name="grab"/></RetryUntilSuccessful>
    /// </BehaviorTree></root>"#;
    /// # let mut tree = build("grab.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()))?;
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// let grab = &tree.report()[1];
    /// assert_eq!((grab.uid, grab.parent, &*grab.name, &*grab.id), (2, Some(1), "grab", "AlwaysFailure"));
    /// assert_eq!((grab.last, grab.starts), (Status::Failure, 3));
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn report(&self) -> Vec<NodeReport> {
        self.iter().collect()
    }

    /// Every node, in document order, one at a time.
    pub fn iter(&self) -> impl Iterator<Item = NodeReport> {
        let parts = self.infos.iter().zip(&self.states).zip(&self.memories);
        (1_u16..).zip(parts).map(|(uid, ((info, state), memory))| NodeReport {
            uid,
            parent: info.parent.map(|parent| (parent + 1) as u16),
            depth: info.depth,
            name: info.name.to_string(),
            id: info.id.to_string(),
            category: info.category.as_str().to_owned(),
            status: state.status,
            last: state.last,
            starts: state.starts,
            feedback: memory.feedback.clone(),
        })
    }

    /// Number, status and last answer of every node: the part that changes from tick to tick, without copying names.
    pub fn statuses(&self) -> impl Iterator<Item = (u16, Status, Status)> + '_ {
        (1_u16..)
            .zip(&self.states)
            .map(|(uid, state)| (uid, state.status, state.last))
    }

    /// The ports of a node and their present values, as `(port, text)`; a port without a value is left out.
    ///
    /// `uid` as in [`NodeReport`]; an unknown one has no ports. The texts are short for any value: structured data is described by its
    /// fields.
    pub fn port_values(&self, uid: u16) -> impl Iterator<Item = (&str, String)> {
        let ports = self.info(uid).map(|info| &*info.ports).unwrap_or_default();
        ports
            .iter()
            .filter_map(move |port| Some((&*port.name, words(port.source.value(&self.board)?))))
    }

    /// The ports and scripts that the tree file sets for a node, in its order, as `(name, text)`; `uid` as in [`NodeReport`].
    pub fn written(&self, uid: u16) -> impl Iterator<Item = (&str, &str)> {
        let written = self.info(uid).map(|info| &*info.written).unwrap_or_default();
        written.iter().map(|(name, text)| (&**name, &**text))
    }

    fn info(&self, uid: u16) -> Option<&Info> {
        self.infos.get(usize::from(uid).checked_sub(1)?)
    }

    /// The tree drawn with lines, one node per row: name, id, status if any, feedback.
    ///
    /// ```
    /// # use std::time::Duration;
    /// # use zenav_behaviour_tree::{Registry, build};
    /// let text = r#"<root BTCPP_format="4"><BehaviorTree ID="Main">
    ///     <Sequence name="go"><AlwaysSuccess name="plan"/><Sleep msec="500"/></Sequence>
    /// </BehaviorTree></root>"#;
    /// # let mut tree = build("go.xml", text.as_bytes(), &Registry::<()>::new(), None, &mut |_, _| Err("no includes".into()))?;
    /// tree.tick(Duration::ZERO, &mut ())?;
    /// let rows = ["go [Sequence]  RUNNING", "├─ plan [AlwaysSuccess]  SUCCESS", "└─ Sleep  RUNNING"];
    /// assert_eq!(tree.render().lines().collect::<Vec<_>>(), rows);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    pub fn render(&self) -> String {
        self.draw(|id, drawn| self.render_status(id, drawn))
    }

    /// The tree drawn with lines, one node per row: name, id, and the ports and scripts that the tree file sets.
    pub fn render_written(&self) -> String {
        use std::fmt::Write as _;
        self.draw(|id, drawn| {
            for (name, text) in self.written((id + 1) as u16) {
                // A script of several lines must not break the drawing. Writing to a String cannot fail.
                let words: Vec<&str> = text.split_whitespace().collect();
                let _ = write!(drawn, " {name}=\"{}\"", words.join(" "));
            }
        })
    }

    /// The tree drawn with lines, one node per row: name, id, and whatever else.
    fn draw(&self, more: impl Fn(NodeId, &mut String)) -> String {
        let mut drawn = String::new();
        let mut todo: Vec<(NodeId, String, String)> = vec![(0, String::new(), String::new())];
        while let Some((id, first, rest)) = todo.pop() {
            if let Some(info) = self.infos.get(id as usize) {
                drawn.push_str(&first);
                drawn.push_str(&info.name);
                if info.id != info.name {
                    drawn.extend([" [", &*info.id, "]"]);
                }
                more(id, &mut drawn);
                drawn.push('\n');
            }
            let Some(node) = self.nodes.get(id as usize) else {
                continue;
            };
            let children = node.first_child as usize..(node.first_child + node.child_count) as usize;
            for (place, child) in self.children.get(children).unwrap_or_default().iter().rev().enumerate() {
                let (branch, below) = if place == 0 {
                    ("└─ ", "   ")
                } else {
                    ("├─ ", "│  ")
                };
                todo.push((*child, format!("{rest}{branch}"), format!("{rest}{below}")));
            }
        }
        drawn
    }

    fn render_status(&self, id: NodeId, drawn: &mut String) {
        use std::fmt::Write as _;
        let index = id as usize;
        let (Some(state), Some(memory)) = (self.states.get(index), self.memories.get(index)) else {
            return;
        };
        // Writing to a String cannot fail.
        let _ = match (state.status, state.last) {
            (Status::Idle, Status::Idle) => Ok(()),
            (Status::Idle, last) => write!(drawn, "  ({last})"),
            (status, _) => write!(drawn, "  {status}"),
        };
        if !memory.feedback.is_empty() {
            let _ = write!(drawn, "  {}", memory.feedback);
        }
    }
}

#[cfg(test)]
mod tests {
    use serde_json::json;

    use super::*;

    #[test]
    fn whole_numbers_are_shown_whole_and_others_with_two_digits() {
        let path = json!({"route": 4_294_967_300_u64, "length": 2.0, "turn": -0.125});
        let shown = words(&Value::Data(path.into()));
        let mut fields: Vec<&str> = shown.split(", ").collect();
        fields.sort_unstable();
        assert_eq!(fields, ["length 2.00", "route 4294967300", "turn -0.12"]);
    }
}

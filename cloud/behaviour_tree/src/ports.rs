//! Ports. What are the inputs and outputs of a node? Named, typed, documented ports, and the values or entries bound to them at each use of
//! a node in a tree.

use serde::{Serialize, Serializer};

use super::blackboard::{Blackboard, Slot};
use super::value::{MOST_NESTED, Value, ValueType, is_nested_within, parse_bool};

/// Direction of a port's value.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Direction {
    /// Read by the node.
    Input,
    /// Written by the node.
    Output,
    /// Read and written by the node.
    InOut,
}

impl Direction {
    /// The name used in a `TreeNodesModel`: `input`, `output`, `inout`.
    pub fn as_str(self) -> &'static str {
        match self {
            Direction::Input => "input",
            Direction::Output => "output",
            Direction::InOut => "inout",
        }
    }
}

/// Type of a port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum PortType {
    /// A value of any type.
    Any,
    /// `true` or `false`.
    Bool,
    /// Integer.
    Int,
    /// Integer of at least 0 (also milliseconds).
    Unsigned,
    /// Number.
    Double,
    /// Number above 0.
    Positive,
    /// Any text, as it is written.
    Text,
    /// `SUCCESS`, `FAILURE`, `SKIPPED`, `RUNNING`.
    Status,
    /// Integers separated by `;`, or a JSON list.
    Ints,
    /// Values of this type separated by `;`, a JSON list, or an entry with a list.
    List(ValueType),
    /// A script of BehaviorTree.CPP, as in `x := 1; y == 2`.
    Script,
    /// The name of a blackboard entry, with or without braces.
    Key,
    /// Structured data of this type name (`Path`, `PoseStamped`). A literal is JSON after `json:`, or text in the format of the registry's
    /// [`LiteralRules`].
    Data(String),
}

impl PortType {
    /// The type named in a `TreeNodesModel` (C++ spelling).
    pub fn from_name(name: &str) -> PortType {
        let name = name.trim();
        let short = name.rsplit("::").next().unwrap_or(name).trim();
        match short {
            "bool" => PortType::Bool,
            "int" | "int8_t" | "int16_t" | "int32_t" | "int64_t" | "int16" | "int32" | "int64" | "long" | "short" => {
                PortType::Int
            }
            "uint8_t" | "uint16_t" | "uint32_t" | "uint64_t" | "uint8" | "uint16" | "uint32" | "uint64"
            | "unsigned int" | "unsigned" | "size_t" | "milliseconds" => PortType::Unsigned,
            "double" | "float" => PortType::Double,
            "string" | "basic_string" | "string_view" => PortType::Text,
            "NodeStatus" => PortType::Status,
            "" | "Any" | "AnyTypeAllowed" => PortType::Any,
            _ => match name.split_once("vector<") {
                Some((_, "int>")) => PortType::Ints,
                // `vector<a::b::C>`: the last part ends with the bracket.
                Some(_) => PortType::Data(format!("vector<{short}").replace("<vector<", "<")),
                None => PortType::Data(short.to_owned()),
            },
        }
    }

    /// The name of the type in a `TreeNodesModel` (C++ spelling).
    pub fn name(&self) -> &str {
        match self {
            PortType::Any => "BT::AnyTypeAllowed",
            PortType::Bool => "bool",
            PortType::Int => "int",
            PortType::Unsigned => "unsigned int",
            PortType::Double | PortType::Positive => "double",
            PortType::Text | PortType::Script | PortType::Key | PortType::List(_) => "std::string",
            PortType::Status => "BT::NodeStatus",
            PortType::Ints => "std::vector<int>",
            PortType::Data(name) => name,
        }
    }

    /// Description of the expected value, for messages.
    pub fn expected(&self) -> String {
        match self {
            PortType::Any => "a value",
            PortType::Bool => "true or false",
            PortType::Int => "an integer",
            PortType::Unsigned => "an integer of at least 0",
            PortType::Double => "a number",
            PortType::Positive => "a number above 0",
            PortType::Text => "text",
            PortType::Status => "SUCCESS, FAILURE, SKIPPED or RUNNING",
            PortType::Ints => "integers separated by ;",
            PortType::List(ValueType::Int) => "integers separated by ;",
            PortType::List(ValueType::Double) => "numbers separated by ;",
            PortType::List(ValueType::Bool) => "true or false, separated by ;",
            PortType::List(_) => "texts separated by ;",
            PortType::Script => "a script",
            PortType::Key => "the name of a blackboard entry",
            PortType::Data(name) => return format!("a {name}"),
        }
        .to_owned()
    }

    /// The type that this port's writes give to a blackboard entry, if known.
    pub fn value_type(&self) -> Option<ValueType> {
        match self {
            PortType::Bool => Some(ValueType::Bool),
            PortType::Int | PortType::Unsigned => Some(ValueType::Int),
            PortType::Double | PortType::Positive => Some(ValueType::Double),
            PortType::Text => Some(ValueType::Text),
            _ => None,
        }
    }

    /// Parses a literal of the tree file as a value of this type; `None` if it is invalid.
    ///
    /// ```
    /// use zenav_behaviour_tree::{PortType, Value};
    ///
    /// assert_eq!(PortType::Unsigned.parse("250"), Some(Value::Int(250)));
    /// assert_eq!(PortType::Positive.parse("0"), None);
    /// assert_eq!(PortType::Status.parse("done"), None, "expected SUCCESS, FAILURE, SKIPPED or RUNNING");
    /// ```
    pub fn parse(&self, text: &str) -> Option<Value> {
        let whole = Value::text(text);
        match self {
            PortType::Bool => parse_bool(text).map(Value::Bool),
            PortType::Int => whole.as_int().map(Value::Int),
            PortType::Unsigned => whole.as_int().filter(|value| *value >= 0).map(Value::Int),
            PortType::Double => whole.as_double().map(Value::Double),
            PortType::Positive => whole.as_double().filter(|value| *value > 0.0).map(Value::Double),
            PortType::Status => super::Status::from_name(text).map(|_| whole),
            PortType::Ints => parse_ints(&whole).map(|_| whole),
            PortType::List(kind) => items_fit(text, *kind).then(|| json_or_text(text)).flatten(),
            PortType::Data(_) | PortType::Any => json_or_text(text),
            PortType::Text | PortType::Script | PortType::Key => Some(whole),
        }
    }

    /// Whether one entry may serve ports of both types. Text and `Any` are compatible with everything, and numbers with one another: their
    /// values are converted when they are read.
    pub(crate) fn shares_entry_with(&self, other: &PortType) -> bool {
        use PortType::*;
        match (self, other) {
            (Data(one), Data(two)) => one == two,
            (Data(_), Bool | Int | Unsigned | Double | Positive) => false,
            (Bool | Int | Unsigned | Double | Positive, Data(_)) => false,
            _ => true,
        }
    }
}

/// Format of literals of structured types, by the name of the type ([`PortType::Data`]).
#[derive(Debug, Clone, Copy)]
pub struct LiteralRules {
    /// Whether a text is a valid literal of a type.
    pub fits: fn(kind: &str, text: &str) -> bool,
    /// Format of a type's literals, for messages.
    pub form: fn(kind: &str) -> Option<&'static str>,
    /// The first name in a literal that can only be resolved where the tree runs; causes a warning.
    pub name: for<'t> fn(kind: &str, text: &'t str) -> Option<&'t str>,
    /// Why a number on a port of this name is probably a mistake; causes a warning.
    pub doubt: fn(port: &str, number: f64) -> Option<&'static str>,
}

/// A literal as data if it is JSON, otherwise as text.
fn json_or_text(text: &str) -> Option<Value> {
    match text.strip_prefix("json:") {
        Some(json) => serde_json::from_str(json)
            .ok()
            .filter(|data| is_nested_within(data, MOST_NESTED))
            .map(|data: serde_json::Value| Value::from(data)),
        None => Some(Value::text(text)),
    }
}

/// Whether every item of a list is of this type.
fn items_fit(text: &str, kind: ValueType) -> bool {
    let fits = |item: &Value| match kind {
        ValueType::Int => item.as_int().is_some(),
        ValueType::Double => item.as_double().is_some(),
        ValueType::Bool => item.as_bool().is_some(),
        ValueType::Text | ValueType::Data => true,
    };
    if text.starts_with("json:") {
        let list = json_or_text(text).map(|list| list.to_json());
        let items = list.as_ref().and_then(serde_json::Value::as_array);
        return items.is_some_and(|items| {
            items
                .iter()
                .all(|item| Value::from_json(item).is_some_and(|item| fits(&item)))
        });
    }
    let items = text.split(';').map(str::trim).filter(|item| !item.is_empty());
    items.map(Value::text).all(|item| fits(&item))
}

/// The integers of `1;2;3`, of `[1,2,3]` or of one integer.
pub(crate) fn parse_ints(value: &Value) -> Option<Vec<i64>> {
    match value {
        Value::Text(text) => text
            .split([';', ','])
            .map(str::trim)
            .filter(|item| !item.is_empty())
            .map(|item| item.parse().ok())
            .collect(),
        Value::Data(data) => data.as_array()?.iter().map(serde_json::Value::as_i64).collect(),
        other => other.as_int().map(|value| vec![value]),
    }
}

/// Specification of a port.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PortSpec {
    /// Its name, as in the tree file.
    pub name: String,
    /// Direction of its value.
    pub direction: Direction,
    /// Type that a literal is parsed as, and that the entry behind the port must hold.
    #[serde(rename = "type", serialize_with = "type_name")]
    pub kind: PortType,
    /// Default if the tree file does not set the port. May be `{key}`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub default: Option<String>,
    /// Whether the tree file must set the port.
    pub required: bool,
    /// Description, with the unit.
    pub doc: String,
}

fn type_name<S: Serializer>(kind: &PortType, serializer: S) -> Result<S::Ok, S::Error> {
    serializer.serialize_str(kind.name())
}

/// The binding of a port at one use of a node.
#[derive(Debug, Clone, PartialEq)]
pub(crate) enum Source {
    Unset,
    Literal(Value),
    Slot(Slot),
}

impl Source {
    /// The literal, or the value of the entry.
    pub(crate) fn value<'s>(&'s self, board: &'s Blackboard) -> Option<&'s Value> {
        match self {
            Source::Literal(value) => Some(value),
            Source::Slot(slot) => board.read(*slot),
            Source::Unset => None,
        }
    }
}

/// A bound port of a node in a tree.
#[derive(Debug, Clone)]
pub(crate) struct BoundPort {
    pub(crate) name: std::sync::Arc<str>,
    pub(crate) kind: PortType,
    pub(crate) source: Source,
}

/// Why a port could not be read or written.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum PortError {
    /// The tree file does not set the port, and there is no default.
    #[error("port `{0}` is not set in the tree")]
    Unset(String),
    /// The entry behind the port has never been written.
    #[error("the blackboard entry behind port `{0}` has no value yet")]
    Empty(String),
    /// The value has another type.
    #[error("port `{port}` holds `{value}`: expected {expected}")]
    Type {
        /// Name of the port.
        port: String,
        /// The value that it holds, as text.
        value: String,
        /// Type that the node asked for.
        expected: String,
    },
    /// A literal cannot be written to.
    #[error("output port `{0}` is a literal: expected a blackboard entry, as in `{{key}}`")]
    Literal(String),
}

/// The text of the error, as the reason of a leaf that fails.
impl From<PortError> for String {
    fn from(error: PortError) -> Self {
        error.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_type_is_spelt_so_that_it_reads_back() {
        for kind in [
            PortType::Bool,
            PortType::Int,
            PortType::Unsigned,
            PortType::Double,
            PortType::Text,
        ] {
            assert_eq!(PortType::from_name(kind.name()), kind);
        }
    }

    #[test]
    fn literals_are_checked_by_type() {
        assert_eq!(PortType::Unsigned.parse("-1"), None);
        assert_eq!(PortType::Int.parse("-1"), Some(Value::Int(-1)));
        assert_eq!(PortType::Double.parse("1e-3"), Some(Value::Double(1e-3)));
        assert_eq!(PortType::Bool.parse("maybe"), None);
        assert_eq!(PortType::Status.parse("success"), Some(Value::text("success")));
        assert_eq!(PortType::Ints.parse("1;x"), None);
        assert_eq!(PortType::Data("Path".into()).parse("json:{"), None);
        assert_eq!(PortType::Positive.parse("0"), None);
        assert_eq!(PortType::Positive.parse("0.5"), Some(Value::Double(0.5)));
        for (kind, list) in [
            (ValueType::Int, "1;x;3"),
            (ValueType::Double, "json:[1, \"x\"]"),
            (ValueType::Bool, "2"),
        ] {
            assert_eq!(PortType::List(kind).parse(list), None, "{list}");
        }
        assert_eq!(
            PortType::List(ValueType::Int).parse("1; 2;"),
            Some(Value::text("1; 2;"))
        );
    }

    #[test]
    fn the_types_of_a_node_model_are_known_by_their_cpp_names() {
        assert_eq!(PortType::from_name("chrono::milliseconds"), PortType::Unsigned);
        assert_eq!(PortType::from_name("std::string"), PortType::Text);
        assert_eq!(PortType::from_name("vector<int>"), PortType::Ints);
        assert_eq!(
            PortType::from_name("nav_msgs::msg::Path"),
            PortType::Data("Path".into())
        );
        for poses in ["vector<geometry_msgs::msg::PoseStamped>", "std::vector<PoseStamped>"] {
            let expected = PortType::Data("vector<PoseStamped>".into());
            assert_eq!(PortType::from_name(poses), expected);
        }
    }

    #[test]
    fn a_path_and_a_number_never_share_an_entry() {
        let path = PortType::Data("Path".into());
        assert!(!path.shares_entry_with(&PortType::Int));
        assert!(!path.shares_entry_with(&PortType::Data("PoseStamped".into())));
        assert!(path.shares_entry_with(&PortType::Text));
        assert!(PortType::Int.shares_entry_with(&PortType::Double));
    }
}

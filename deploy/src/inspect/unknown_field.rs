//! Unknown fields. Which field of a JSON value is not in its type's JSON Schema? Decoding ignores such a field, but whoever typed it meant
//! something by it.

use serde_json::{Map, Value};

/// Path of the first field that the schema does not have, such as `waypoints.0.floor`, in a value that fits the schema otherwise.
///
/// A value may have several forms: a variant of an enum, or `null`. A field is known if any of them has it.
pub(super) fn unknown_field(schema: &Value, value: &Value) -> Option<String> {
    within(schema, &[schema], value)
}

/// As [`unknown_field`], for a part of a value that fits any of these parts of the schema `root`.
fn within<'s>(root: &'s Value, schemas: &[&'s Value], value: &Value) -> Option<String> {
    let mut forms = Vec::new();
    for schema in schemas {
        gather(root, schema, &mut forms);
    }
    match value {
        Value::Object(fields) => {
            forms.retain(|form| is_of_objects(form));
            // Any value fits, and so does any field.
            if forms.is_empty() {
                return None;
            }
            fields.iter().find_map(|(name, inner)| {
                let known: Vec<&Value> = forms.iter().filter_map(|form| field(form, name)).collect();
                if known.is_empty() {
                    return Some(name.clone());
                }
                within(root, &known, inner).map(|path| format!("{name}.{path}"))
            })
        }
        Value::Array(items) => items.iter().enumerate().find_map(|(index, inner)| {
            let known: Vec<&Value> = forms.iter().filter_map(|form| item(form, index)).collect();
            within(root, &known, inner).map(|path| format!("{index}.{path}"))
        }),
        _ => None,
    }
}

/// A schema, the one that it refers to, and its alternatives.
fn gather<'s>(root: &'s Value, schema: &'s Value, forms: &mut Vec<&'s Map<String, Value>>) {
    let Value::Object(form) = schema else { return };
    forms.push(form);
    let reference = form.get("$ref").and_then(Value::as_str);
    let pointer = reference.and_then(|reference| reference.strip_prefix('#'));
    let named = pointer.and_then(|pointer| root.pointer(pointer));
    let alternatives = ["allOf", "anyOf", "oneOf"]
        .into_iter()
        .filter_map(|key| form.get(key)?.as_array());
    for inner in named.into_iter().chain(alternatives.flatten()) {
        gather(root, inner, forms);
    }
}

fn is_of_objects(form: &Map<String, Value>) -> bool {
    let is_object = form.get("type").is_some_and(|kind| kind == "object");
    is_object || form.contains_key("properties") || form.contains_key("additionalProperties")
}

/// The schema of a field: of a struct by its name, of a map for every name.
fn field<'s>(form: &'s Map<String, Value>, name: &str) -> Option<&'s Value> {
    let named = form.get("properties").and_then(|properties| properties.get(name));
    let others = || {
        form.get("additionalProperties")
            .filter(|schema| **schema != Value::Bool(false))
    };
    named.or_else(others)
}

/// The schema of an item: of a tuple by its position, of a list for all.
fn item(form: &Map<String, Value>, index: usize) -> Option<&Value> {
    let placed = form.get("prefixItems").and_then(|items| items.get(index));
    placed.or_else(|| form.get("items"))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use serde_json::json;

    use super::super::schema::json_schema;
    use super::*;

    /// Golden messages, one a line: name and JSON.
    const GOLDEN: &str = include_str!("../../../protocol/tests/wire.golden");

    #[test]
    fn every_field_of_every_golden_message_is_known_and_one_more_is_not() {
        let mut messages = 0;
        for (name, text) in GOLDEN.lines().filter_map(|line| line.split_once(' ')) {
            // A remote action is in no table, and a schema has any field.
            let Some(schema) = json_schema(name).filter(|_| name != "SchemaReply") else {
                continue;
            };
            let mut value: Value = serde_json::from_str(text).unwrap();
            assert_eq!(unknown_field(&schema, &value), None, "{name} {text}");
            value["no_such_field"] = Value::Null;
            let unknown = unknown_field(&schema, &value);
            assert_eq!(unknown.as_deref(), Some("no_such_field"), "{name} {text}");
            messages += 1;
        }
        assert!(messages > 100, "{messages}");
    }

    #[test]
    fn an_unknown_field_is_found_at_any_depth_and_by_its_path() {
        let path = |message: &str, value: Value| unknown_field(&json_schema(message).unwrap(), &value);
        let waypoints = json!({ "waypoints": [{ "x": 1, "y": 2 }, { "x": 1, "y": 2, "floor": 3 }] });
        assert_eq!(path("GoalRequest", waypoints).as_deref(), Some("waypoints.1.floor"));
        // Whatever a tree understands may be on its blackboard.
        let blackboard = json!({ "tree": "kitchen", "blackboard": { "any": { "thing": 1 } } });
        assert_eq!(path("GoalRequest", blackboard), None);
        // Of a map each value, of an enum with data each variant, of one with a tag too.
        let places = json!({ "places": { "sink": { "x": 1, "y": 2, "floor": 3 } } });
        assert_eq!(path("Annotations", places).as_deref(), Some("places.sink.floor"));
        let action = json!({ "action": { "remove_place": { "name": "sink", "floor": 1 } } });
        assert_eq!(
            path("AnnotateRequest", action).as_deref(),
            Some("action.remove_place.floor")
        );
        let plan = json!({ "kind": "plan", "start": { "x": 1, "y": 2, "yaw": 0, "floor": 0 } });
        assert_eq!(path("MotionRequest", plan).as_deref(), Some("start.floor"));
        let event = json!({ "stamp": 1, "event": "stopped", "by": "anna", "floor": 3 });
        assert_eq!(path("Event", event).as_deref(), Some("floor"));
    }
}

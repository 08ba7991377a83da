//! Unknown fields. Which field of a JSON value is not in its type's JSON Schema? Decoding ignores such a field, but whoever typed it meant
//! something by it.

use serde_json::{Map, Value};

/// Path of the first field that the schema does not have, such as `waypoints.0.floor`, in a value that was decoded.
///
/// A value may have several forms: a variant of an enum, or `null`. A field is known if any of them has it. An object has no known field if
/// the schema has no form for objects there, so such a gap in a schema is reported as well.
pub(super) fn unknown_field(schema: &Value, value: &Value) -> Option<String> {
    within(schema, &[schema], value)
}

/// Whether a value may have the part that a path names, as `zenav topic echo --field` takes it: fields, and indices of lists.
pub(super) fn has_part(schema: &Value, path: &str) -> bool {
    let mut parts = vec![schema];
    for name in path.split('.') {
        let mut forms = Vec::new();
        for part in &parts {
            gather(schema, part, &mut forms);
        }
        if forms.iter().any(|form| is_any(form)) {
            return true;
        }
        let index = name.parse::<usize>().ok();
        parts = forms
            .into_iter()
            .filter_map(|form| field(form, name).or_else(|| listed(form, index?)))
            .collect();
    }
    !parts.is_empty()
}

/// As [`unknown_field`], for a part of a value that fits any of these parts of the schema `root`.
fn within<'s>(root: &'s Value, schemas: &[&'s Value], value: &Value) -> Option<String> {
    let mut forms = Vec::new();
    for schema in schemas {
        gather(root, schema, &mut forms);
    }
    if forms.iter().any(|form| is_any(form)) {
        return None;
    }
    match value {
        Value::Object(fields) => fields.iter().find_map(|(name, inner)| {
            let known: Vec<&Value> = forms.iter().filter_map(|form| field(form, name)).collect();
            if !known.is_empty() {
                return within(root, &known, inner).map(|path| format!("{name}.{path}"));
            }
            // Serde reads a variant without data as `"name"` and as `{"name": null}`; its schema has the string only.
            let is_variant = inner.is_null() && forms.iter().any(|form| has_variant(form, name));
            (!is_variant).then(|| name.clone())
        }),
        Value::Array(items) => items.iter().enumerate().find_map(|(index, inner)| {
            let known: Vec<&Value> = forms.iter().flat_map(|form| item(form, index)).collect();
            within(root, &known, inner).map(|path| format!("{index}.{path}"))
        }),
        _ => None,
    }
}

/// A schema, the one that it refers to, and its alternatives.
fn gather<'s>(root: &'s Value, schema: &'s Value, forms: &mut Vec<&'s Value>) {
    forms.push(schema);
    let reference = schema.get("$ref").and_then(Value::as_str);
    let pointer = reference.and_then(|reference| reference.strip_prefix('#'));
    let named = pointer.and_then(|pointer| root.pointer(pointer));
    let alternatives = ["allOf", "anyOf", "oneOf"]
        .into_iter()
        .filter_map(|key| schema.get(key)?.as_array());
    for inner in named.into_iter().chain(alternatives.flatten()) {
        gather(root, inner, forms);
    }
}

/// Whether any value fits: the schema is `true`, or only describes.
fn is_any(form: &Value) -> bool {
    let describes = |key: &String| ["$schema", "title", "description", "default"].contains(&key.as_str());
    match form {
        Value::Object(form) => form.keys().all(describes),
        form => *form == Value::Bool(true),
    }
}

/// The schema of a field: of a struct by its name, of a map for every name.
fn field<'s>(form: &'s Value, name: &str) -> Option<&'s Value> {
    let named = form.get("properties").and_then(|properties| properties.get(name));
    let others = || {
        form.get("additionalProperties")
            .filter(|schema| **schema != Value::Bool(false))
    };
    named.or_else(others)
}

/// Whether this form of an enum has a variant of this name, without data.
fn has_variant(form: &Value, name: &str) -> bool {
    let listed = form.get("enum").and_then(Value::as_array).into_iter().flatten();
    form.get("const")
        .into_iter()
        .chain(listed)
        .any(|variant| variant.as_str() == Some(name))
}

/// The schema of an item: of a tuple by its position, of a list the same for all.
fn listed(form: &Value, index: usize) -> Option<&Value> {
    let placed = form.get("prefixItems").and_then(|items| items.get(index));
    placed.or_else(|| form.get("items"))
}

/// Schemas of an item. Serde also reads a struct as a list of its fields, whose order a schema does not have: an item may be any of them.
fn item(form: &Value, index: usize) -> impl Iterator<Item = &Value> {
    let fields = form.get("properties").and_then(Value::as_object);
    listed(form, index)
        .into_iter()
        .chain(fields.into_iter().flat_map(Map::values))
}

#[cfg(test)]
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

    fn path(message: &str, value: Value) -> Option<String> {
        unknown_field(&json_schema(message).unwrap(), &value)
    }

    #[test]
    fn an_unknown_field_is_found_at_any_depth_and_by_its_path() {
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

    #[test]
    fn a_part_that_a_message_may_leave_out_is_known_by_its_path() {
        for (message, path, known) in [
            ("EdgeState", "faults.body", true),
            ("EdgeState", "plan.time_left", true),
            ("EdgeState", "faults.wheel", false),
            ("EdgeState", "faults.body.0", false),
            ("Annotations", "places.sink.x", true),
            ("Annotations", "places.sink.floor", false),
            ("GoalRequest", "waypoints.1.x", true),
            ("GoalRequest", "waypoints.x", false),
            ("GoalRequest", "blackboard.any.thing", true),
        ] {
            let schema = json_schema(message).unwrap();
            assert_eq!(has_part(&schema, path), known, "{message} {path}");
        }
    }

    #[test]
    fn a_value_with_several_forms_on_the_wire_is_searched_in_each() {
        let misspelt = json!({ "stamp": 1, "ranges": [1.0], "lidr": "rear" });
        let one = path("Readings", json!({ "sweep": misspelt }));
        assert_eq!(one.as_deref(), Some("sweep.lidr"));
        let many = path(
            "Readings",
            json!({ "sweep": [{ "stamp": 1, "ranges": [null] }, misspelt] }),
        );
        assert_eq!(many.as_deref(), Some("sweep.1.lidr"));
        assert_eq!(path("Readings", json!({ "sweep": null })), None);
        // A struct as a list of its fields.
        let remove = |place: Value| path("AnnotateRequest", json!([{ "remove_place": place }, null, null]));
        assert_eq!(remove(json!({ "name": "sink" })), None);
        assert_eq!(
            remove(json!({ "name": "sink", "floor": 1 })).as_deref(),
            Some("0.remove_place.floor")
        );
    }

    #[test]
    fn a_schema_without_a_form_for_an_object_hides_no_field() {
        let list = json!({ "properties": { "sweep": { "type": "array", "items": true } } });
        let unknown = unknown_field(&list, &json!({ "sweep": { "stamp": 1 } }));
        assert_eq!(unknown.as_deref(), Some("sweep.stamp"));
        assert_eq!(unknown_field(&list, &json!({ "sweep": [{ "stamp": 1 }] })), None);
    }

    #[test]
    fn a_variant_without_data_may_be_an_object() {
        let annotate = |action: Value| path("AnnotateRequest", json!({ "action": action }));
        assert_eq!(annotate(json!({ "clear_zones": null })), None);
        assert_eq!(
            annotate(json!({ "clear_zone": null })).as_deref(),
            Some("action.clear_zone")
        );
        assert_eq!(
            annotate(json!({ "add_zone": { "zone": { "rule": { "keep_out": null } } } })),
            None
        );
        let cancel = json!({ "id": "b1", "action": { "cancel": null } });
        assert_eq!(path("BehaviourRequest", cancel), None);
        // Of variants that are listed without a description each, too.
        let listed = json!({ "type": "string", "enum": ["near", "far"] });
        assert_eq!(unknown_field(&listed, &json!({ "far": null })), None);
    }

    #[test]
    fn the_fields_of_a_robot_model_are_known() {
        let mount = json!({ "x": 0, "y": 0, "yaw": 0, "z": 1 });
        let front = json!({ "model": { "footprint": { "radius": 0.2 }, "lidar": { "mount": mount } } });
        assert_eq!(path("AttachRequest", front).as_deref(), Some("model.lidar.mount.z"));
        let rear = json!({ "kind": "plan", "model": { "lidars": { "rear": { "mount": mount } } } });
        assert_eq!(
            path("MotionRequest", rear).as_deref(),
            Some("model.lidars.rear.mount.z")
        );
    }
}

//! JSON Schema. Fields of a message, for tools that offer them: from its type, or for a key unknown to zenav inferred from its first
//! message.
//!
//! Foxglove supports plain JSON Schema only: objects, lists and scalars, written out. Therefore references are resolved, variants are
//! merged into one object with all their fields, and a nullable field gets its other type. What cannot be expressed this way (lists of
//! lists, lists of several types) is left out of the schema, but stays in the messages.

use serde_json::{Map, Value, json};
use zenav_protocol::topics;

use crate::inspect::json_schema;

/// Name of JSON Schema in MCAP and Foxglove.
pub const ENCODING: &str = "jsonschema";
/// Deepest nesting followed.
const DEPTH: usize = 12;

/// The message type of a key; for an ask, the type of its replies.
fn message(key: &str) -> Option<&'static str> {
    topics::row_of(key).map(|row| row.message.rsplit(" -> ").next().unwrap_or(row.message))
}

/// Title of the messages of a key.
#[must_use]
pub fn title(key: &str) -> String {
    message(key).map_or_else(|| key.to_owned(), |message| format!("zenav.{message}"))
}

/// The schema for a key, with an example of its messages; `None` if they are not JSON objects.
#[must_use]
pub fn of(key: &str, example: &[u8]) -> Option<Value> {
    let known = message(key).and_then(json_schema);
    let mut schema = match &known {
        Some(known) => plain(known, known, DEPTH),
        None => of_example(example),
    };
    let fields = schema.as_mut()?.as_object_mut()?;
    if fields.get("type")? != "object" {
        return None;
    }
    fields.insert("title".to_owned(), title(key).into());
    schema
}

/// A schema without references and variants; `whole` is the document that references point into.
fn plain(schema: &Value, whole: &Value, depth: usize) -> Option<Value> {
    let depth = depth.checked_sub(1)?;
    let mut fields = if let Some(Value::String(reference)) = schema.get("$ref") {
        plain(whole.pointer(reference.strip_prefix('#')?)?, whole, depth)?
    } else {
        let variants = ["oneOf", "anyOf", "allOf"]
            .iter()
            .filter_map(|word| schema.get(word)?.as_array());
        let variants = variants
            .flatten()
            .filter(|variant| variant.get("type") != Some(&"null".into()));
        let own = own_type(schema, whole, depth);
        let all = own
            .into_iter()
            .chain(variants.map(|variant| plain(variant, whole, depth)));
        all.reduce(|one, other| joined(one?, other?))??
    };
    if let Some(words) = schema.get("description") {
        fields.as_object_mut()?.insert("description".to_owned(), words.clone());
    }
    Some(fields)
}

/// The type that a schema itself states: none, one that cannot be expressed plainly, or a plain schema.
fn own_type(schema: &Value, whole: &Value, depth: usize) -> Option<Option<Value>> {
    let names: Vec<&str> = match schema.get("type")? {
        Value::String(name) => vec![name],
        Value::Array(names) => names
            .iter()
            .filter_map(Value::as_str)
            .filter(|name| *name != "null")
            .collect(),
        _ => return Some(None),
    };
    let [name] = names.as_slice() else {
        return Some(None);
    };
    Some(match *name {
        "object" => {
            let fields = schema
                .get("properties")
                .and_then(Value::as_object)
                .into_iter()
                .flatten();
            let fields = fields.filter_map(|(name, field)| Some((name.clone(), plain(field, whole, depth)?)));
            Some(json!({ "type": "object", "properties": fields.collect::<Map<_, _>>() }))
        }
        "array" => {
            let item = schema.get("items").and_then(|item| plain(item, whole, depth));
            let item = item.filter(|item| item.get("type") != Some(&"array".into()));
            item.map(|item| json!({ "type": "array", "items": item }))
        }
        scalar => Some(json!({ "type": scalar })),
    })
}

/// The union of two types: for objects, the fields of both.
fn joined(mut one: Value, other: Value) -> Option<Value> {
    if one.get("type") != other.get("type") {
        return None;
    }
    if let (Some(Value::Object(fields)), Some(Value::Object(more))) =
        (one.get_mut("properties"), other.get("properties"))
    {
        for (name, field) in more {
            fields.entry(name.clone()).or_insert_with(|| field.clone());
        }
    }
    Some(one)
}

/// The schema of an object like this example.
fn of_example(payload: &[u8]) -> Option<Value> {
    let example: Value = serde_json::from_slice(payload).ok()?;
    schema(&example).filter(|_| example.is_object())
}

fn schema(example: &Value) -> Option<Value> {
    let named = |name: &str| Some(json!({ "type": name }));
    match example {
        Value::Null => None,
        Value::Bool(_) => named("boolean"),
        Value::Number(number) if number.is_f64() => named("number"),
        Value::Number(_) => named("integer"),
        Value::String(_) => named("string"),
        Value::Array(items) => {
            let item = item(items)?;
            Some(json!({ "type": "array", "items": item }))
        }
        Value::Object(fields) => {
            let properties: Map<String, Value> = fields
                .iter()
                .filter_map(|(name, value)| Some((name.clone(), schema(value)?)))
                .collect();
            Some(json!({ "type": "object", "properties": properties }))
        }
    }
}

/// The common schema of a list's items, if there is one.
fn item(items: &[Value]) -> Option<Value> {
    let mut known = items.iter().filter(|item| !item.is_null());
    let first = known.next()?;
    if first.is_array() || known.any(|item| std::mem::discriminant(item) != std::mem::discriminant(first)) {
        return None;
    }
    // Some of several numbers may be integers by chance.
    if items.iter().any(|item| item.is_f64()) {
        return Some(json!({ "type": "number" }));
    }
    schema(first)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_field_that_tools_can_offer_is_named_with_its_type() {
        let payload = br#"{"stamp":7,"ranges":[1,null,2.5],"base":{"x":0.5,"name":"b"},"ok":true,"none":null,"empty":[],"points":[[1.0,2.0]],"mixed":[1,"a"]}"#;
        let schema = of("somebody/probe", payload).unwrap();
        assert_eq!(
            schema,
            json!({
                "title": "somebody/probe",
                "type": "object",
                "properties": {
                    "stamp": { "type": "integer" },
                    "ranges": { "type": "array", "items": { "type": "number" } },
                    "base": { "type": "object", "properties": { "x": { "type": "number" }, "name": { "type": "string" } } },
                    "ok": { "type": "boolean" },
                },
            })
        );
    }

    #[test]
    fn what_is_no_object_has_no_schema() {
        for payload in ["[1]", "7", "no JSON", ""] {
            assert_eq!(of("x", payload.as_bytes()), None);
        }
    }

    #[test]
    fn a_message_has_the_fields_of_its_type_whatever_the_first_one_held() {
        let schema = of("zenav/tiago/edge/state", br#"{"plan":null}"#).unwrap();
        assert_eq!(schema["title"], "zenav.EdgeState");
        let kind = |path: &str| schema.pointer(path).unwrap_or_else(|| panic!("{path}: {schema}"))["type"].clone();
        assert_eq!(kind("/properties/velocity/properties/v"), "number");
        assert_eq!(
            kind("/properties/plan/properties/distance_left"),
            "number",
            "it may be null"
        );
        assert_eq!(kind("/properties/round_trip_secs"), "number");
        assert_eq!(kind("/properties/mode"), "string");
    }

    #[test]
    fn every_schema_of_the_table_is_plain() {
        fn check(schema: &Value, at: &str) {
            let fields = schema.as_object().unwrap();
            for name in fields.keys() {
                assert!(
                    ["type", "title", "description", "properties", "items"].contains(&name.as_str()),
                    "{at}: {name}"
                );
            }
            match fields["type"].as_str().unwrap() {
                "object" => {
                    for (name, field) in fields["properties"].as_object().unwrap() {
                        check(field, &format!("{at}.{name}"));
                    }
                }
                "array" => {
                    assert_ne!(fields["items"]["type"], "array", "{at}");
                    check(&fields["items"], at);
                }
                scalar => assert!(
                    ["string", "number", "integer", "boolean"].contains(&scalar),
                    "{at}: {scalar}"
                ),
            }
        }
        for row in topics::TABLE {
            let key = row
                .pattern
                .split('/')
                .map(|chunk| if chunk.starts_with('{') { "x" } else { chunk });
            let key = key.collect::<Vec<_>>().join("/");
            check(&of(&key, b"{}").unwrap_or_else(|| panic!("{key} has no schema")), &key);
        }
    }
}

//! JSON Schema. Which fields has a message, for tools that offer them? Told from its first example.
//!
//! What Foxglove cannot have in a schema is left out of it, and still is in the messages: lists of lists, lists of several types, and what
//! was `null` or empty in the example.

use serde_json::{Map, Value, json};
use zenav_protocol::topics;

/// What MCAP and Foxglove call JSON Schema.
pub const ENCODING: &str = "jsonschema";

/// What the messages of a key are called.
#[must_use]
pub fn title(key: &str) -> String {
    let message = topics::row_of(key).map(|row| row.message.rsplit(" -> ").next().unwrap_or(row.message));
    message.map_or_else(|| key.to_owned(), |message| format!("zenav.{message}"))
}

/// The schema of an object like this one; `None` for what is no JSON object.
#[must_use]
pub fn of_example(title: &str, payload: &[u8]) -> Option<Value> {
    let example: Value = serde_json::from_slice(payload).ok()?;
    let mut schema = schema(&example).filter(|_| example.is_object())?;
    schema.as_object_mut()?.insert("title".to_owned(), title.into());
    Some(schema)
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

/// The schema of a list's items, if they have one in common.
fn item(items: &[Value]) -> Option<Value> {
    let mut known = items.iter().filter(|item| !item.is_null());
    let first = known.next()?;
    if first.is_array() || known.any(|item| std::mem::discriminant(item) != std::mem::discriminant(first)) {
        return None;
    }
    // Of numbers some may be whole by chance.
    if items.iter().any(|item| item.is_f64()) {
        return Some(json!({ "type": "number" }));
    }
    schema(first)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    #[test]
    fn every_field_that_tools_can_offer_is_named_with_its_type() {
        let payload = br#"{"stamp":7,"ranges":[1,null,2.5],"base":{"x":0.5,"name":"b"},"ok":true,"none":null,"empty":[],"points":[[1.0,2.0]],"mixed":[1,"a"]}"#;
        let schema = of_example("zenav.Probe", payload).unwrap();
        assert_eq!(
            schema,
            json!({
                "title": "zenav.Probe",
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
            assert_eq!(of_example("x", payload.as_bytes()), None);
        }
    }
}

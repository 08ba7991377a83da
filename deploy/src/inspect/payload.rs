//! Payloads. How is one shown to a person? JSON as it came; CBOR as JSON; anything else by its size.

use std::fmt;

use serde::de::{Deserialize, Deserializer, Error, MapAccess, SeqAccess, Visitor};
use serde_json::{Map, Number, Value};
use zenav_protocol::bus::RawSample;
use zenav_protocol::codec::{self, Encoding};

/// The payload as one line.
pub(super) fn text(sample: &RawSample) -> String {
    if sample.deleted {
        return "(deleted)".to_owned();
    }
    let unreadable = |why: &str| format!("({} bytes of {}, {why})", sample.bytes.len(), sample.encoding);
    match Encoding::of(&sample.encoding) {
        Encoding::Json => match std::str::from_utf8(&sample.bytes) {
            Ok(text) => text.trim_end().to_owned(),
            Err(_) => unreadable("not text"),
        },
        Encoding::Cbor => match codec::decode::<Readable>(&sample.bytes, Encoding::Cbor, usize::MAX) {
            Ok(Readable(value)) => value.to_string(),
            Err(error) => unreadable(&error.to_string()),
        },
    }
}

/// The payload as a JSON value; text that is no JSON stays a text.
pub(super) fn value(sample: &RawSample) -> Value {
    let text = text(sample);
    serde_json::from_str(&text).unwrap_or(Value::String(text))
}

/// Any CBOR value that JSON has a form for. A byte string becomes an array of signed numbers: here it holds occupancy values.
struct Readable(Value);

impl<'de> Deserialize<'de> for Readable {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(ReadableVisitor).map(Self)
    }
}

struct ReadableVisitor;

impl<'de> Visitor<'de> for ReadableVisitor {
    type Value = Value;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a value with a JSON form")
    }

    fn visit_unit<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_none<E>(self) -> Result<Value, E> {
        Ok(Value::Null)
    }

    fn visit_some<D: Deserializer<'de>>(self, deserializer: D) -> Result<Value, D::Error> {
        deserializer.deserialize_any(self)
    }

    fn visit_bool<E>(self, value: bool) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_i64<E>(self, value: i64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_u64<E>(self, value: u64) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_f64<E>(self, value: f64) -> Result<Value, E> {
        Ok(Number::from_f64(value).map_or(Value::Null, Value::Number))
    }

    fn visit_str<E>(self, value: &str) -> Result<Value, E> {
        Ok(value.into())
    }

    fn visit_bytes<E>(self, value: &[u8]) -> Result<Value, E> {
        Ok(value.iter().map(|byte| Value::from(byte.cast_signed())).collect())
    }

    fn visit_seq<A: SeqAccess<'de>>(self, mut seq: A) -> Result<Value, A::Error> {
        let mut values = Vec::new();
        while let Some(Readable(value)) = seq.next_element()? {
            values.push(value);
        }
        Ok(Value::Array(values))
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<Value, A::Error> {
        let mut values = Map::new();
        while let Some((Readable(key), Readable(value))) = map.next_entry()? {
            let key = match key {
                Value::String(text) => text,
                Value::Number(number) => number.to_string(),
                other => return Err(A::Error::custom(format!("{other} as a key"))),
            };
            values.insert(key, value);
        }
        Ok(Value::Object(values))
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use zenav_protocol::messages::Tile;

    use super::*;

    fn sample(bytes: Vec<u8>, encoding: &str) -> RawSample {
        RawSample {
            key: "zenav/r/x".into(),
            bytes,
            encoding: encoding.into(),
            stamp: None,
            deleted: false,
        }
    }

    #[test]
    fn json_is_shown_as_it_came() {
        let odd = br#"{"b":1.50,  "a":2}"#;
        assert_eq!(
            text(&sample(odd.to_vec(), "application/json")),
            String::from_utf8_lossy(odd)
        );
    }

    #[test]
    fn cbor_is_shown_as_json_with_the_values_of_a_tile() {
        let tile = Tile {
            x: 1,
            y: 2,
            values: vec![-1, 0, 100],
        };
        let bytes = codec::encode(&tile, Encoding::Cbor).unwrap();
        let shown = text(&sample(bytes, "application/cbor"));
        assert_eq!(serde_json::from_str::<Tile>(&shown).unwrap(), tile, "{shown}");
    }

    #[test]
    fn what_cannot_be_read_is_told_by_its_size() {
        assert!(text(&sample(vec![0xff, 0xfe], "application/json")).contains("2 bytes"));
        assert!(text(&sample(vec![0x9b], "application/cbor")).contains("1 bytes"));
    }
}

//! Payloads. Human-readable form: JSON as received, CBOR as JSON, anything else by its size.

use ciborium::Value as Cbor;
use serde_json::{Number, Value};
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
        Encoding::Cbor => codec::decode::<Cbor>(&sample.bytes, Encoding::Cbor, usize::MAX)
            .map_err(|error| error.to_string())
            .and_then(json)
            .map_or_else(|why| unreadable(&why), |value| value.to_string()),
    }
}

/// The payload as a JSON value; text that is not JSON becomes a string.
pub(super) fn value(sample: &RawSample) -> Value {
    let text = text(sample);
    serde_json::from_str(&text).unwrap_or(Value::String(text))
}

/// A CBOR value as JSON. A byte string becomes an array of signed numbers: byte strings hold occupancy values here.
///
/// # Errors
/// A value without a JSON form, in words.
fn json(value: Cbor) -> Result<Value, String> {
    Ok(match value {
        Cbor::Null => Value::Null,
        Cbor::Bool(truth) => truth.into(),
        Cbor::Integer(number) => match Number::from_i128(number.into()) {
            Some(number) => Value::Number(number),
            None => return Err("an integer of more than 64 bits".to_owned()),
        },
        Cbor::Float(number) => Number::from_f64(number).map_or(Value::Null, Value::Number),
        Cbor::Text(text) => text.into(),
        Cbor::Bytes(bytes) => bytes.into_iter().map(|byte| Value::from(byte.cast_signed())).collect(),
        Cbor::Array(values) => Value::Array(values.into_iter().map(json).collect::<Result<_, _>>()?),
        Cbor::Map(entries) => {
            let entry = |(key, value)| match json(key)? {
                Value::String(text) => Ok((text, json(value)?)),
                Value::Number(number) => Ok((number.to_string(), json(value)?)),
                other => Err(format!("{other} as a key")),
            };
            Value::Object(entries.into_iter().map(entry).collect::<Result<_, String>>()?)
        }
        _ => return Err("a value without a JSON form".to_owned()),
    })
}

#[cfg(test)]
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

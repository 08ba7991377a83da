//! Value. What can a blackboard entry or a port hold? Four scalar types and structured data.
//!
//! Conversions follow BehaviorTree.CPP: text is read as the reader's type, and numbers are cast only without loss.

use std::sync::Arc;

use serde::{Deserialize, Deserializer, Serialize, Serializer};

use super::status::Status;

/// The type that an entry keeps after its first assignment.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ValueType {
    /// Truth value.
    Bool,
    /// 64-bit integer.
    Int,
    /// 64-bit float.
    Double,
    /// UTF-8 text.
    Text,
    /// Structured data (poses, paths, lists).
    Data,
}

/// A value on the blackboard. Cloning is cheap: long values are shared.
#[derive(Debug, Clone, PartialEq)]
pub enum Value {
    /// Truth value.
    Bool(bool),
    /// 64-bit integer.
    Int(i64),
    /// 64-bit float.
    Double(f64),
    /// UTF-8 text.
    Text(Arc<str>),
    /// Structured data (poses, paths, lists).
    Data(Arc<serde_json::Value>),
}

/// Largest magnitude below which every integer is an exact `f64`.
const EXACT: i64 = 1 << 53;

impl Value {
    /// Text as a value, copied into shared storage.
    pub fn text(text: impl AsRef<str>) -> Value {
        Value::Text(Arc::from(text.as_ref()))
    }

    /// Structured data from any serialisable value.
    ///
    /// # Errors
    /// What serde_json reports, for example a map whose keys are not text.
    ///
    /// ```
    /// use zenav_behaviour_tree::{Value, ValueType};
    ///
    /// let path = Value::data(&[[0.0, 0.0], [1.0, 2.5]])?;
    /// assert_eq!(path.kind(), ValueType::Data);
    /// assert_eq!(path.to_string(), "[[0.0,0.0],[1.0,2.5]]");
    /// # Ok::<(), serde_json::Error>(())
    /// ```
    pub fn data<T: Serialize>(data: &T) -> Result<Value, serde_json::Error> {
        Ok(Value::Data(Arc::new(serde_json::to_value(data)?)))
    }

    /// The type of this value.
    pub fn kind(&self) -> ValueType {
        match self {
            Value::Bool(_) => ValueType::Bool,
            Value::Int(_) => ValueType::Int,
            Value::Double(_) => ValueType::Double,
            Value::Text(_) => ValueType::Text,
            Value::Data(_) => ValueType::Data,
        }
    }

    /// A JSON scalar as a scalar, an array or object as data; `None` for null, and for JSON nested more than [`MOST_NESTED`] deep, which
    /// could not be read back from a stored tree.
    pub fn from_json(json: &serde_json::Value) -> Option<Value> {
        if !is_nested_within(json, MOST_NESTED) {
            return None;
        }
        Some(match json {
            serde_json::Value::Null => return None,
            serde_json::Value::Bool(value) => Value::Bool(*value),
            serde_json::Value::Number(number) => match number.as_i64() {
                Some(value) => Value::Int(value),
                None => Value::Double(number.as_f64()?),
            },
            serde_json::Value::String(text) => Value::text(text),
            other => Value::Data(Arc::new(other.clone())),
        })
    }

    /// The value as JSON, for display and the wire.
    pub fn to_json(&self) -> serde_json::Value {
        match self {
            Value::Bool(value) => (*value).into(),
            Value::Int(value) => (*value).into(),
            Value::Double(value) => (*value).into(),
            Value::Text(text) => (&**text).into(),
            Value::Data(data) => (**data).clone(),
        }
    }

    /// As a truth value: the numbers 0 and 1, text `true`, `false`, `1`, `0`.
    pub fn as_bool(&self) -> Option<bool> {
        match self {
            Value::Bool(value) => Some(*value),
            Value::Int(0) => Some(false),
            Value::Int(1) => Some(true),
            Value::Double(value) if *value == 0.0 || *value == 1.0 => Some(*value == 1.0),
            Value::Text(text) => parse_bool(text),
            Value::Data(data) => data.as_bool(),
            _ => None,
        }
    }

    /// As an integer, if nothing is lost.
    pub fn as_int(&self) -> Option<i64> {
        match self {
            Value::Bool(value) => Some(i64::from(*value)),
            Value::Int(value) => Some(*value),
            Value::Double(value) if value.fract() == 0.0 && value.abs() <= EXACT as f64 => Some(*value as i64),
            Value::Double(_) => None,
            Value::Text(text) => text.trim().parse().ok(),
            Value::Data(data) => data.as_i64(),
        }
    }

    /// As a float, if nothing is lost. Text `nan` is not a number.
    pub fn as_double(&self) -> Option<f64> {
        match self {
            Value::Bool(value) => Some(f64::from(u8::from(*value))),
            Value::Int(value) if value.abs() <= EXACT => Some(*value as f64),
            Value::Int(_) => None,
            Value::Double(value) => Some(*value),
            Value::Text(text) => text.trim().parse().ok().filter(|value: &f64| !value.is_nan()),
            Value::Data(data) => data.as_f64(),
        }
    }

    fn word(&self) -> Option<bool> {
        match self {
            Value::Text(text) => truth_word(text),
            _ => None,
        }
    }

    /// Converted to `kind` without loss; a number does not convert to text, and text `true` becomes 1.
    ///
    /// ```
    /// use zenav_behaviour_tree::{Value, ValueType};
    ///
    /// assert_eq!(Value::text("0.5").convert(ValueType::Double), Some(Value::Double(0.5)));
    /// assert_eq!(Value::Double(2.5).convert(ValueType::Int), None, "half would be lost");
    /// assert_eq!(Value::text("true").convert(ValueType::Int), Some(Value::Int(1)));
    /// ```
    pub fn convert(&self, kind: ValueType) -> Option<Value> {
        match kind {
            ValueType::Bool => self.as_bool().map(Value::Bool),
            ValueType::Int => self.as_int().or_else(|| self.word().map(i64::from)).map(Value::Int),
            ValueType::Double => {
                let word = || self.word().map(|truth| f64::from(u8::from(truth)));
                self.as_double().or_else(word).map(Value::Double)
            }
            ValueType::Text => match self {
                Value::Text(_) => Some(self.clone()),
                // Structured data can also be read from its JSON text, because people write lists as text.
                Value::Data(data) => Some(Value::text(data.to_string())),
                _ => None,
            },
            ValueType::Data => Some(match self {
                Value::Data(_) => self.clone(),
                other => Value::Data(Arc::new(other.to_json())),
            }),
        }
    }
}

/// `true` or `false`, as BehaviorTree.CPP's scripts spell them.
pub(crate) fn truth_word(text: &str) -> Option<bool> {
    match text {
        "true" => Some(true),
        "false" => Some(false),
        _ => None,
    }
}

/// `true`, `false`, `1`, `0`, in any case.
pub(crate) fn parse_bool(text: &str) -> Option<bool> {
    let text = text.trim();
    if text == "1" || text.eq_ignore_ascii_case("true") {
        Some(true)
    } else if text == "0" || text.eq_ignore_ascii_case("false") {
        Some(false)
    } else {
        None
    }
}

impl std::fmt::Display for Value {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Value::Bool(value) => write!(out, "{value}"),
            Value::Int(value) => write!(out, "{value}"),
            Value::Double(value) => write!(out, "{value}"),
            Value::Text(text) => write!(out, "{text}"),
            Value::Data(data) => write!(out, "{data}"),
        }
    }
}

macro_rules! value_from {
    ($($kind:ty: |$value:ident| $made:expr;)*) => { $(
        impl From<$kind> for Value {
            fn from($value: $kind) -> Value {
                $made
            }
        }
    )* };
}
value_from! {
    bool: |value| Value::Bool(value);
    i64: |value| Value::Int(value);
    f64: |value| Value::Double(value);
    &str: |text| Value::text(text);
    String: |text| Value::Text(Arc::from(text));
    serde_json::Value: |data| Value::Data(Arc::new(data));
}

/// Greatest nesting depth of arrays and objects.
pub const MOST_NESTED: usize = 64;

/// Whether JSON is nested at most this deep. Recursive, which is safe because JSON readers limit the depth.
pub fn is_nested_within(json: &serde_json::Value, most: usize) -> bool {
    let Some(left) = most.checked_sub(1) else {
        return !(json.is_array() || json.is_object());
    };
    match json {
        serde_json::Value::Array(items) => items.iter().all(|item| is_nested_within(item, left)),
        serde_json::Value::Object(fields) => fields.values().all(|field| is_nested_within(field, left)),
        _ => true,
    }
}

/// A type as which a leaf can read a port.
pub trait FromValue: Sized {
    /// The value, if it converts without loss.
    fn from_value(value: &Value) -> Option<Self>;
    /// What the reader expected, for messages.
    const EXPECTED: &'static str;
}

macro_rules! from_value {
    ($($kind:ty, $expected:literal: |$value:ident| $read:expr;)*) => { $(
        impl FromValue for $kind {
            fn from_value($value: &Value) -> Option<Self> {
                $read
            }
            const EXPECTED: &'static str = $expected;
        }
    )* };
}
from_value! {
    bool, "true or false": |value| value.as_bool();
    i64, "an integer": |value| value.as_int();
    u64, "an integer of at least 0": |value| value.as_int()?.try_into().ok();
    f64, "a number": |value| value.as_double();
    String, "text": |value| Some(value.to_string());
    Status, "a status": |value| Status::from_name(&value.to_string());
    Value, "a value": |value| Some(value.clone());
}

/// The stored form: tagged, so that `1`, `1.0` and `"1"` are restored exactly.
#[derive(Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Stored {
    Bool(bool),
    Int(i64),
    Double(f64),
    /// Infinities and NaN, which JSON numbers cannot hold.
    Special(String),
    Text(String),
    Data(serde_json::Value),
}

impl Serialize for Value {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match self {
            Value::Bool(value) => Stored::Bool(*value),
            Value::Int(value) => Stored::Int(*value),
            Value::Double(value) if value.is_finite() => Stored::Double(*value),
            Value::Double(value) => Stored::Special(value.to_string()),
            Value::Text(text) => Stored::Text(text.to_string()),
            Value::Data(data) => Stored::Data((**data).clone()),
        }
        .serialize(serializer)
    }
}

impl<'de> Deserialize<'de> for Value {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        Ok(match Stored::deserialize(deserializer)? {
            Stored::Bool(value) => Value::Bool(value),
            Stored::Int(value) => Value::Int(value),
            Stored::Double(value) => Value::Double(value),
            Stored::Special(text) => Value::Double(text.parse().map_err(serde::de::Error::custom)?),
            Stored::Text(text) => Value::Text(Arc::from(text)),
            Stored::Data(data) => Value::Data(Arc::new(data)),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_read_as_what_the_reader_wants() {
        assert_eq!(Value::text(" 106 ").as_int(), Some(106));
        assert_eq!(Value::text("0.5").as_double(), Some(0.5));
        assert_eq!(Value::text("True").as_bool(), Some(true));
        assert_eq!(Value::text("nan").as_double(), None);
    }

    #[test]
    fn a_number_is_cast_only_where_nothing_is_lost() {
        assert_eq!(Value::Double(3.0).as_int(), Some(3));
        assert_eq!(Value::Double(3.5).as_int(), None);
        assert_eq!(Value::Int(i64::MAX).as_double(), None);
        assert_eq!(Value::Int(2).as_bool(), None);
        assert_eq!(Value::Int(2).convert(ValueType::Text), None);
    }

    #[test]
    fn what_is_stored_comes_back_as_it_was() {
        for value in [
            Value::Bool(true),
            Value::Int(1),
            Value::Double(1.0),
            Value::Double(f64::INFINITY),
            Value::text("1"),
            Value::Data(Arc::new(serde_json::json!({"x": [1, 2.5]}))),
        ] {
            let stored = serde_json::to_string(&value).unwrap();
            assert_eq!(serde_json::from_str::<Value>(&stored).unwrap(), value, "{stored}");
        }
    }
}

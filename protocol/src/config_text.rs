//! Configuration text. What is set in a user's file, on which line, and is it within its bounds?

use std::f64::consts::TAU;
use std::fmt;

use nalgebra::Point2;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Deserializer, Serialize};
use thiserror::Error;

use crate::settings::Bounds;

/// Exactly two numbers: silently taking the first two of `[1, 2, 3]` would hide a mistake.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "Vec<f64>")]
pub struct Pair(pub [f64; 2]);

impl TryFrom<Vec<f64>> for Pair {
    type Error = String;

    fn try_from(numbers: Vec<f64>) -> Result<Self, String> {
        match numbers[..] {
            [a, b] => Ok(Self([a, b])),
            _ => Err(format!("expected 2 numbers, found {}", numbers.len())),
        }
    }
}

impl From<Pair> for Point2<f64> {
    fn from(pair: Pair) -> Self {
        Self::from(pair.0)
    }
}

/// Reads a [`Pair`] into a plain array.
pub(crate) fn pair<'de, D: Deserializer<'de>>(deserializer: D) -> Result<[f64; 2], D::Error> {
    Pair::deserialize(deserializer).map(|Pair(numbers)| numbers)
}

/// Why a file's text was refused.
#[derive(Debug, Error)]
pub enum TextError {
    /// The TOML does not fit: an unknown, missing or mistyped key.
    #[error("{file}:{line}: {source}")]
    Toml {
        /// Name of the file.
        file: String,
        /// Counted from 1.
        line: usize,
        /// What and where.
        source: Box<toml::de::Error>,
    },
    /// A value that may not be.
    #[error("{file}:{line}: `{key}`: {problem}")]
    Value {
        /// Name of the file.
        file: String,
        /// Counted from 1.
        line: usize,
        /// Key of the value.
        key: &'static str,
        /// What is wrong with it.
        problem: String,
    },
}

/// A file's text, whose errors name the line.
///
/// ```
/// use std::collections::BTreeMap;
/// use zenav_protocol::config_text::Source;
///
/// let source = Source { text: "a = 1\nb = -2\n", file: "my.toml" };
/// let numbers: BTreeMap<String, toml::Spanned<f64>> = source.toml()?;
/// let refused = source.refused(numbers["b"].span().start, "b", "-2: expected a positive number");
/// assert_eq!(refused.to_string(), "my.toml:2: `b`: -2: expected a positive number");
/// # Ok::<(), zenav_protocol::config_text::TextError>(())
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Source<'a> {
    /// Text of the file, unchanged: positions count its bytes.
    pub text: &'a str,
    /// The file's name, for errors.
    pub file: &'a str,
}

impl Source<'_> {
    /// The text, read as TOML.
    ///
    /// # Errors
    /// [`TextError::Toml`].
    pub fn toml<T: DeserializeOwned>(self) -> Result<T, TextError> {
        toml::from_str(self.text).map_err(|error| TextError::Toml {
            file: self.file.to_owned(),
            line: self.line(error.span().map_or(0, |span| span.start)),
            source: Box::new(error),
        })
    }

    /// Line of a byte, from 1.
    #[must_use]
    pub fn line(self, byte: usize) -> usize {
        1 + self.text.bytes().take(byte).filter(|byte| *byte == b'\n').count()
    }

    /// Why the value at a byte is refused.
    #[must_use]
    pub fn refused(self, byte: usize, key: &'static str, problem: impl Into<String>) -> TextError {
        TextError::Value {
            file: self.file.to_owned(),
            line: self.line(byte),
            key,
            problem: problem.into(),
        }
    }
}

/// A setting whose value is out of bounds.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("`{key}` {problem}")]
pub struct OutOfBounds {
    /// Key of the setting, joined by dots with its enclosing sections.
    pub key: String,
    /// The value, and what was expected.
    pub problem: String,
}

impl OutOfBounds {
    /// For a number out of its range.
    #[must_use]
    pub fn outside(key: &str, value: f64, bounds: &Bounds, unit: &str) -> Self {
        Self::unlike(key, value, format!("{bounds} {unit}").trim_end())
    }

    /// For a number that is not as expected.
    #[must_use]
    pub fn unlike(key: &str, value: f64, expected: impl fmt::Display) -> Self {
        Self {
            key: key.to_owned(),
            problem: format!("is {}: expected {expected}", Number(value)),
        }
    }

    /// The same error, with the key as seen from the enclosing section.
    #[must_use]
    pub fn within(self, section: &str) -> Self {
        Self {
            key: format!("{section}.{}", self.key),
            ..self
        }
    }
}

/// Expected range of a number in a file.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Expected {
    /// Finite and greater than zero.
    Positive,
    /// Finite and not less than zero.
    NotNegative,
    /// From zero to one.
    Share,
    /// Any finite number.
    Finite,
    /// An angle in rad, at most a full turn: a larger value was probably written in degrees.
    Angle,
    /// From the first to the second number, and the range in words.
    Range(f64, f64, &'static str),
}

impl Expected {
    /// Returns the value if it is as expected.
    ///
    /// # Errors
    /// A sentence with the value and what was expected.
    pub fn check(self, value: f64) -> Result<f64, String> {
        if self.holds(value) {
            Ok(value)
        } else {
            Err(format!("{}: expected {self}", Number(value)))
        }
    }

    /// Whether a value is as expected.
    #[must_use]
    pub fn holds(self, value: f64) -> bool {
        match self {
            Self::Positive => value.is_finite() && value > 0.0,
            Self::NotNegative => value.is_finite() && value >= 0.0,
            Self::Share => (0.0..=1.0).contains(&value),
            Self::Finite => value.is_finite(),
            Self::Angle => value.abs() <= TAU,
            Self::Range(least, most, _) => (least..=most).contains(&value),
        }
    }
}

impl fmt::Display for Expected {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Positive => "a positive number",
            Self::NotNegative => "zero or a positive number",
            Self::Share => "a share, 0 to 1",
            Self::Finite => "a finite number",
            Self::Angle => "radians within a full turn; 90 degrees are 1.571",
            Self::Range(.., words) => words,
        })
    }
}

/// Checks values by key.
///
/// # Errors
/// The first value that is not as expected.
pub fn check_all(values: &[(&'static str, f64, Expected)]) -> Result<(), OutOfBounds> {
    match values.iter().find(|(_, value, expected)| !expected.holds(*value)) {
        Some((name, value, expected)) => Err(OutOfBounds::unlike(name, *value, expected)),
        None => Ok(()),
    }
}

/// A number in a message, in scientific notation if it is very large or very small.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Number(pub f64);

impl fmt::Display for Number {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if self.0.is_finite() && (size >= 1e9 || (size > 0.0 && size < 1e-6)) {
            write!(f, "{:e}", self.0)
        } else {
            fmt::Display::fmt(&self.0, f)
        }
    }
}

/// Line (from 1) of a dotted key in a TOML text; the line of its table if the key is not written. `None` if neither is written, or if the
/// text is not TOML.
///
/// ```
/// use zenav_protocol::config_text::line_of;
///
/// let text = "name = \"rover\"\n[drive]\nwheel_radius = -1\n";
/// assert_eq!(line_of(text, "drive.wheel_radius"), Some(3));
/// assert_eq!(line_of(text, "drive.max_speed"), Some(2), "not written: the line of its table");
/// ```
#[must_use]
pub fn line_of(text: &str, key: &str) -> Option<usize> {
    Some(nearest(text, key)?.0)
}

/// As [`line_of`], but `None` if the key itself is not written.
#[must_use]
pub fn line_if_written(text: &str, key: &str) -> Option<usize> {
    let (line, is_whole) = nearest(text, key)?;
    is_whole.then_some(line)
}

/// Line of a key or of the innermost table on its way, and whether it is the key's own. A quoted name may have dots of its own.
fn nearest(text: &str, key: &str) -> Option<(usize, bool)> {
    let document = toml::de::DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let (mut rest, mut found, mut is_whole) = (key, None, false);
    loop {
        let named = table.iter().filter_map(|(name, value)| {
            let left = rest.strip_prefix(&**name.get_ref())?;
            let left = if left.is_empty() { left } else { left.strip_prefix('.')? };
            Some((left, name, value))
        });
        let Some((left, name, value)) = named.min_by_key(|(left, ..)| left.len()) else {
            break;
        };
        (rest, found, is_whole) = (left, Some(name.span().start), left.is_empty());
        match value.get_ref().as_table() {
            Some(inner) if !is_whole => table = inner,
            _ => break,
        }
    }
    Some((Source { text, file: "" }.line(found?), is_whole))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pair_is_two_numbers() {
        let read = |text: &str| toml::from_str::<std::collections::BTreeMap<String, Pair>>(text);
        assert_eq!(read("a = [1, 2.5]").unwrap()["a"], Pair([1.0, 2.5]));
        let error = read("b = [0, 0]\na = [1, 2, 3]").unwrap_err().to_string();
        assert!(
            error.contains("line 2") && error.contains("expected 2 numbers, found 3"),
            "{error}"
        );
        assert!(read("a = [1]").is_err());
        assert_eq!(serde_json::to_string(&Pair([1.0, 2.0])).unwrap(), "[1.0,2.0]");
    }

    #[test]
    fn a_key_is_found_in_tables_of_any_form() {
        let text = "a = 1\n[b]\nc = 2\nd.e = 3\n[b.f]\n# none\ng = 4\nh = { i = 5 }\n";
        for (key, line) in [
            ("a", Some(1)),
            ("b.c", Some(3)),
            ("b.d.e", Some(4)),
            ("b.f.g", Some(7)),
            ("b.f.h.i", Some(8)),
            // Not written: the line of their table.
            ("b.x", Some(2)),
            ("b.f.x.y", Some(5)),
            ("x", None),
        ] {
            assert_eq!(line_of(text, key), line, "{key}");
        }
        assert_eq!(line_of("a = ", "a"), None);
        let text = "[hosts.fleet]\nrole = 1\n[hosts.\"fleet.b\"]\nrole = 2\n";
        for (key, line, own) in [
            ("hosts.fleet.b.role", Some(4), Some(4)),
            ("hosts.fleet.b.address", Some(3), None),
            ("hosts.fleet.b", Some(3), Some(3)),
            ("hosts.fleet.role", Some(2), Some(2)),
            ("hosts.flee", Some(1), None),
        ] {
            assert_eq!((line_of(text, key), line_if_written(text, key)), (line, own), "{key}");
        }
    }

    #[test]
    fn a_huge_number_is_short() {
        let said = |value| Number(value).to_string();
        assert_eq!(
            (said(1e300), said(-0.25), said(100_000.0)),
            ("1e300".into(), "-0.25".into(), "100000".into())
        );
        assert_eq!(
            (said(f64::NAN), said(1e-300), said(0.0)),
            ("NaN".into(), "1e-300".into(), "0".into())
        );
    }
}

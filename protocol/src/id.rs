//! Ids. Which names are valid in a key, and how is a unique one made?
//!
//! An id matches `[A-Za-z0-9_-]{1,64}`, so that no name can widen or break a key expression.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;
use uuid::Uuid;

/// Name of a robot, goal, worker or place.
///
/// ```
/// use zenav_protocol::id::Id;
///
/// assert_eq!(Id::robot("tiago-1").unwrap().as_str(), "tiago-1");
/// assert!(Id::robot("tiago/*").is_err());
/// ```
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(try_from = "String", into = "String")]
pub struct Id(String);

/// A name that is not valid in a key.
#[derive(Clone, Debug, Error, PartialEq, Eq)]
#[error("`{name}` is not a valid name: expected 1 to 64 of A-Z a-z 0-9 _ -{note}")]
pub struct InvalidId {
    name: String,
    note: &'static str,
}

impl Id {
    /// Checks a name from an external source.
    ///
    /// # Errors
    /// [`InvalidId`] unless it matches `[A-Za-z0-9_-]{1,64}`; `zenav` is refused, because it is the first chunk of every key.
    pub fn new(name: impl Into<String>) -> Result<Self, InvalidId> {
        let name: String = name.into();
        if name == "zenav" {
            return Err(InvalidId {
                name,
                note: ", and not zenav",
            });
        }
        let valid = (1..=64).contains(&name.len())
            && name
                .bytes()
                .all(|b| b.is_ascii_alphanumeric() || b == b'_' || b == b'-');
        if valid {
            Ok(Self(name))
        } else {
            Err(InvalidId {
                name: name.chars().take(80).collect(),
                note: "",
            })
        }
    }

    /// Checks a robot's name: `svc` and `sim` are reserved for services and the simulator.
    ///
    /// # Errors
    /// [`InvalidId`].
    pub fn robot(name: impl Into<String>) -> Result<Self, InvalidId> {
        let id = Self::new(name)?;
        if id.0 == "svc" || id.0 == "sim" {
            Err(InvalidId {
                name: id.0,
                note: ", and not svc or sim",
            })
        } else {
            Ok(id)
        }
    }

    /// A unique id: 128 random bits (UUID version 4) as 32 hexadecimal digits.
    #[must_use]
    pub fn unique() -> Self {
        Self(Uuid::new_v4().simple().to_string())
    }

    /// The id as text.
    #[must_use]
    pub fn as_str(&self) -> &str {
        &self.0
    }
}

impl fmt::Display for Id {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.0)
    }
}

impl AsRef<str> for Id {
    fn as_ref(&self) -> &str {
        &self.0
    }
}

impl TryFrom<String> for Id {
    type Error = InvalidId;
    fn try_from(name: String) -> Result<Self, InvalidId> {
        Self::new(name)
    }
}

impl FromStr for Id {
    type Err = InvalidId;
    fn from_str(name: &str) -> Result<Self, InvalidId> {
        Self::new(name)
    }
}

impl From<Id> for String {
    fn from(id: Id) -> Self {
        id.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unique_id_is_valid_and_never_the_same() {
        let ids: std::collections::BTreeSet<String> = (0..1000).map(|_| Id::unique().into()).collect();
        assert_eq!(ids.len(), 1000);
        assert!(ids.iter().all(|id| id.len() == 32 && Id::new(id.clone()).is_ok()));
    }

    #[test]
    fn a_name_cannot_widen_a_key() {
        for bad in ["", "*", "a/b", "zenav", "a b", "ü", "$x", &"a".repeat(65)] {
            assert!(Id::new(bad).is_err(), "{bad}");
        }
        assert!(Id::robot("svc").is_err() && Id::robot("sim").is_err());
        assert!(Id::robot("tiago-1_a").is_ok());
        assert!(serde_json::from_str::<Id>("\"**\"").is_err());
    }
}

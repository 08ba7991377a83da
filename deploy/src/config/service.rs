//! Section of a service. How a deployment runs it, and its library's settings, side by side.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Deserializer, Error as _, IntoDeserializer as _, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::settings::{Row, Settings};

/// A section with the deployment's own settings `R` beside a library's `S`.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Service<R, S> {
    /// How it runs.
    #[serde(flatten)]
    pub run: R,
    /// The library's settings.
    #[serde(flatten)]
    pub settings: S,
}

impl<R: Settings, S: Settings> Settings for Service<R, S> {
    fn rows() -> Vec<Row> {
        [R::rows(), S::rows()].concat()
    }

    fn check(&self) -> Result<(), OutOfBounds> {
        self.run.check()?;
        self.settings.check()
    }
}

/// Hand-written: serde's `flatten` would neither refuse unknown keys nor report where they are.
impl<'de, R: Settings, S: Settings> Deserialize<'de> for Service<R, S> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_map(Section(PhantomData))
    }
}

struct Section<R, S>(PhantomData<(R, S)>);

impl<'de, R: Settings, S: Settings> Visitor<'de> for Section<R, S> {
    type Value = Service<R, S>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("a section")
    }

    fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Self::Value, A::Error> {
        let mut run = R::default();
        let others = Others {
            map,
            keys: R::rows().into_iter().map(|row| row.key).collect(),
            taken: toml::Table::new(),
            run: &mut run,
        };
        let settings = S::deserialize(MapAccessDeserializer::new(others))?;
        Ok(Service { run, settings })
    }
}

/// The entries of a section without the deployment's own keys, which are taken out.
struct Others<'a, A, R> {
    map: A,
    keys: Vec<String>,
    taken: toml::Table,
    /// Built from the keys taken out.
    run: &'a mut R,
}

impl<'de, A: MapAccess<'de>, R: Settings> MapAccess<'de> for Others<'_, A, R> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        let mut seed = Some(seed);
        loop {
            let key = Key {
                keys: &self.keys,
                seed: &mut seed,
            };
            match self.map.next_key_seed(key)? {
                None => return Ok(None),
                Some(Found::Other(key)) => return Ok(Some(key)),
                Some(Found::Ours(key)) => {
                    let (taken, run) = (&mut self.taken, &mut *self.run);
                    self.map.next_value_seed(Own { key, taken, run })?;
                }
            }
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.map.next_value_seed(seed)
    }
}

/// A key, read while its position in the text is known, so that errors carry it.
struct Key<'a, K> {
    keys: &'a [String],
    seed: &'a mut Option<K>,
}

enum Found<V> {
    Ours(String),
    Other(V),
}

impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for Key<'_, K> {
    type Value = Found<K::Value>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        let key = String::deserialize(deserializer)?;
        if self.keys.contains(&key) {
            return Ok(Found::Ours(key));
        }
        let seed = self
            .seed
            .take()
            .ok_or_else(|| D::Error::custom("a key was read twice"))?;
        seed.deserialize(key.into_deserializer()).map(Found::Other)
    }
}

/// The value of a key taken out, read while its position is known.
struct Own<'a, R> {
    key: String,
    taken: &'a mut toml::Table,
    run: &'a mut R,
}

impl<'de, R: Settings> DeserializeSeed<'de> for Own<'_, R> {
    type Value = ();

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<(), D::Error> {
        self.taken.insert(self.key, toml::Value::deserialize(deserializer)?);
        let run = self.taken.clone().try_into();
        *self.run = run.map_err(|error: toml::de::Error| D::Error::custom(error.message()))?;
        Ok(())
    }
}

//! Section of a service. The settings of its library, and whether it runs: `enabled`.

use std::fmt;
use std::marker::PhantomData;

use serde::de::value::MapAccessDeserializer;
use serde::de::{DeserializeSeed, Deserializer, IntoDeserializer as _, MapAccess, Visitor};
use serde::{Deserialize, Serialize};
use zenav_protocol::config_text::OutOfBounds;
use zenav_protocol::settings::{Row, Settings};

/// A library's settings in a section that also says whether the service runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Service<S> {
    /// Whether it runs.
    pub enabled: bool,
    /// The library's own.
    #[serde(flatten)]
    pub settings: S,
}

impl<S: Default> Default for Service<S> {
    fn default() -> Self {
        Self {
            enabled: true,
            settings: S::default(),
        }
    }
}

impl<S: Settings> Settings for Service<S> {
    fn rows() -> Vec<Row> {
        let enabled = Row::new("enabled", "bool", &true, "Whether it runs.");
        [enabled].into_iter().chain(S::rows()).collect()
    }

    fn check(&self) -> Result<(), OutOfBounds> {
        self.settings.check()
    }
}

/// By hand: serde's `flatten` would neither refuse unknown keys nor tell where they stand.
impl<'de, S: Deserialize<'de>> Deserialize<'de> for Service<S> {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct Section<S>(PhantomData<S>);
        impl<'de, S: Deserialize<'de>> Visitor<'de> for Section<S> {
            type Value = Service<S>;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a section")
            }

            fn visit_map<A: MapAccess<'de>>(self, map: A) -> Result<Service<S>, A::Error> {
                let mut enabled = true;
                let others = Others {
                    map,
                    enabled: &mut enabled,
                };
                let settings = S::deserialize(MapAccessDeserializer::new(others))?;
                Ok(Service { enabled, settings })
            }
        }
        deserializer.deserialize_map(Section(PhantomData))
    }
}

/// The entries of a section but for `enabled`, which is taken out.
struct Others<'a, A> {
    map: A,
    enabled: &'a mut bool,
}

impl<'de, A: MapAccess<'de>> MapAccess<'de> for Others<'_, A> {
    type Error = A::Error;

    fn next_key_seed<K: DeserializeSeed<'de>>(&mut self, seed: K) -> Result<Option<K::Value>, A::Error> {
        let mut seed = Some(seed);
        loop {
            match self.map.next_key_seed(Key(&mut seed))? {
                None => return Ok(None),
                Some(Some(key)) => return Ok(Some(key)),
                Some(None) => *self.enabled = self.map.next_value()?,
            }
        }
    }

    fn next_value_seed<V: DeserializeSeed<'de>>(&mut self, seed: V) -> Result<V::Value, A::Error> {
        self.map.next_value_seed(seed)
    }
}

/// A key for the settings, or `None` for `enabled`.
struct Key<'a, K>(&'a mut Option<K>);

impl<'de, K: DeserializeSeed<'de>> DeserializeSeed<'de> for Key<'_, K> {
    type Value = Option<K::Value>;

    fn deserialize<D: Deserializer<'de>>(self, deserializer: D) -> Result<Self::Value, D::Error> {
        let key = String::deserialize(deserializer)?;
        if key == "enabled" {
            return Ok(None);
        }
        let seed = self
            .0
            .take()
            .ok_or_else(|| serde::de::Error::custom("a key was read twice"))?;
        seed.deserialize(key.into_deserializer()).map(Some)
    }
}

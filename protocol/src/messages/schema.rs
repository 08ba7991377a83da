//! Schemas. Which form does a message have, for programs that do not know its type?

use serde::{Deserialize, Serialize};

/// Asks for the schema of the message whose name is the last chunk of the key.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct SchemaRequest {}

/// JSON Schema (draft 2020-12) of a message.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(transparent)]
pub struct SchemaReply(pub serde_json::Map<String, serde_json::Value>);

//! `zenav schema`. The JSON Schema (draft 2020-12) of a message, with the documentation of every field; also on the bus, at
//! `zenav/svc/schema/{message}`.

use std::collections::BTreeMap;

use schemars::{JsonSchema, Schema, schema_for};
use serde::Serialize;
use serde_json::Value;
use zenav_protocol::bus::{Bus, BusError};
use zenav_protocol::messages::{Refusal, SchemaReply};
use zenav_protocol::topics::{self, Ask, MESSAGE_SCHEMA, Message, TableVisitor, Topic};

use crate::completion;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};
use crate::tasks;

/// Schemas of messages.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  zenav schema --list\n  zenav schema GoalRequest\n  zenav schema edge/pose")]
pub struct SchemaArgs {
    /// Name of a message (`GoalRequest`), or a key
    #[arg(value_name = "TYPE", required_unless_present = "list", add = completion::messages())]
    message: Option<String>,
    /// List all messages and their keys
    #[arg(long, conflicts_with = "message")]
    list: bool,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// A message, and its keys.
#[derive(Debug)]
struct Described {
    schema: fn() -> Schema,
    keys: Vec<String>,
}

#[derive(Debug, Default)]
struct Catalogue(BTreeMap<&'static str, Described>);

impl Catalogue {
    fn new() -> Self {
        let mut all = Self::default();
        topics::visit_table(&mut all);
        all.note::<Refusal>("Refusal", "every ask, as its error".to_owned());
        all
    }

    fn note<T: JsonSchema>(&mut self, name: &'static str, key: String) {
        let entry = self.0.entry(name).or_insert_with(|| Described {
            schema: || schema_for!(T),
            keys: Vec::new(),
        });
        entry.keys.push(key);
    }
}

impl TableVisitor for Catalogue {
    fn topic<T: Message>(&mut self, topic: Topic<T>, message: &'static str) {
        self.note::<T>(message, topic.pattern.to_owned());
    }

    fn ask<Q: Message, R: Message>(&mut self, ask: Ask<Q, R>, request: &'static str, reply: &'static str) {
        self.note::<Q>(request, format!("{} (request)", ask.pattern));
        self.note::<R>(reply, format!("{} (reply)", ask.pattern));
    }
}

/// The JSON Schema of a message.
pub(crate) fn json_schema(message: &str) -> Option<Value> {
    let all = Catalogue::new();
    let described = all.0.get(message)?;
    Some((described.schema)().to_value())
}

/// Serves the schemas of all messages until the bus is closed.
///
/// # Errors
/// [`BusError::Closed`].
pub(crate) fn serve_schemas(bus: &Bus) -> Result<(), BusError> {
    let mut server = bus.serve(&MESSAGE_SCHEMA, &["*"])?;
    tasks::spawn(async move {
        while let Some(request) = server.next().await {
            let message = request.chunks.concat();
            match json_schema(&message) {
                Some(Value::Object(schema)) => request.reply(&SchemaReply(schema)),
                _ => request.refuse(&Refusal::NotFound {
                    what: format!("message `{message}`"),
                }),
            }
        }
    });
    Ok(())
}

/// Names of all messages.
pub(crate) fn message_names() -> Vec<String> {
    let all = Catalogue::new();
    all.0.keys().map(|name| (*name).to_owned()).collect()
}

/// Names of all fields of a message, at any depth; for suggestions.
pub(super) fn fields(message: &str) -> Vec<String> {
    let mut names = Vec::new();
    if let Some(described) = Catalogue::new().0.get(message) {
        gather((described.schema)().as_value(), &mut names);
    }
    names
}

fn gather(schema: &Value, names: &mut Vec<String>) {
    match schema {
        Value::Object(entries) => {
            if let Some(Value::Object(properties)) = entries.get("properties") {
                names.extend(properties.keys().cloned());
            }
            entries.values().for_each(|inner| gather(inner, names));
        }
        Value::Array(entries) => entries.iter().for_each(|inner| gather(inner, names)),
        _ => {}
    }
}

#[derive(Debug, Serialize)]
struct Listed {
    message: &'static str,
    keys: Vec<String>,
}

/// Prints the schema of a message, or lists all.
///
/// # Errors
/// [`crate::exit_code::NOT_FOUND`] for an unknown message.
pub fn schema(args: &SchemaArgs) -> Outcome {
    let all = Catalogue::new();
    let Some(wanted) = &args.message else {
        let listed: Vec<Listed> = all
            .0
            .into_iter()
            .map(|(message, described)| Listed {
                message,
                keys: described.keys,
            })
            .collect();
        return output::values(args.output, &listed, |listed| {
            let rows = listed.iter().map(|row| [row.message.to_owned(), row.keys.join(", ")]);
            output::table(&["MESSAGE", "KEYS"], rows)
        });
    };
    let is_meant = |(name, described): &(&&str, &Described)| {
        let by_key = |key: &String| {
            let pattern = key.split(' ').next().unwrap_or(key);
            pattern.ends_with(&format!("/{wanted}")) || topics::alive_chunks(pattern, wanted).is_some()
        };
        name.eq_ignore_ascii_case(wanted) || (wanted.contains('/') && described.keys.iter().any(by_key))
    };
    let Some((_, described)) = all.0.iter().find(is_meant) else {
        let perhaps = output::perhaps(wanted, all.0.keys().copied());
        return Err(Failure::not_found(format!(
            "no message `{wanted}`{perhaps} (`zenav schema --list` lists all)"
        )));
    };
    let schema = (described.schema)();
    output::value(args.output, &schema, |schema| {
        output::pretty(schema).unwrap_or_default()
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_message_of_the_table_has_a_schema_with_documentation() {
        for (name, described) in &Catalogue::new().0 {
            let schema = (described.schema)();
            let text = serde_json::to_string(&schema).unwrap();
            assert!(text.contains("description"), "{name}: {text}");
        }
    }

    #[test]
    fn fields_are_found_at_any_depth() {
        let names = fields("GoalRequest");
        assert!(names.iter().any(|name| name == "tolerance") && names.iter().any(|name| name == "waypoints"));
    }
}

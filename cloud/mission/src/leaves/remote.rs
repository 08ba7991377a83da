//! RemoteAction: an action executed by another program, in any language, through queries on a Zenoh key.
//!
//! ```xml
//! <RemoteAction name="Grab" server="kitchen/gripper" item="{item}" weight="{weight}"/>
//! ```
//!
//! `server` is the key; `period_ms` (100) is the polling period, `timeout_ms` (10,000) the longest silence. All other ports belong to the
//! action: ports with a value are its inputs, and its outputs are written to ports that lead to entries. The wire messages are
//! [`zenav_protocol::messages::RemoteRequest`] and its reply, where the protocol is described; `cloud/mission/examples/remote_action.py` is a
//! server.
//!
//! The execution's id is stored before the first request, so that after a restart the mission continues under the same id.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use zenav_protocol::messages::{RemoteAction, RemoteReply, RemoteRequest, RemoteStatus};
use zenav_protocol::time::Stamp;

use super::progress::LONGEST_LOOK;
use super::{fail, step};
use crate::context::Context;
use crate::io::{Answer, Ask, NoAnswer, Ticket};
use zenav_behaviour_tree::{Leaf, LeafIo, NodeSpec, PortType, Status, Value};

/// Ports that do not belong to the action.
const SERVER: &str = "server";
const PERIOD: &str = "period_ms";
const TIMEOUT: &str = "timeout_ms";
/// Longest key, bytes.
const LONGEST_KEY: usize = 256;
/// Largest inputs, bytes of JSON.
const MAX_INPUTS: usize = 32 * 1024;

/// Specification of the node.
#[must_use]
pub fn spec() -> NodeSpec {
    NodeSpec {
        open: true,
        ..NodeSpec::action("RemoteAction", "Another program does it, asked on a Zenoh key.")
            .input(SERVER, PortType::Text, "Zenoh key, without wildcards")
            .input_or(PERIOD, PortType::Unsigned, "100", "time between two questions, ms")
            .input_or(TIMEOUT, PortType::Unsigned, "10000", "so long it may be silent, ms")
    }
}

/// An action of another program.
#[derive(Default)]
pub struct Remote {
    ticket: Option<Ticket>,
    next_ask: Stamp,
    /// Time of the last tick, and time without an answer, s: a pause does not count.
    looked: Stamp,
    silent: f64,
}

/// The execution, stored before it has an effect.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Execution {
    id: String,
    server: String,
    inputs: BTreeMap<String, serde_json::Value>,
}

impl Execution {
    fn read(io: &LeafIo<'_>, id: String) -> Result<Self, String> {
        let server: String = io.get(SERVER)?;
        check_key(&server)?;
        let own = io.ports().filter(|port| ![SERVER, PERIOD, TIMEOUT].contains(port));
        let inputs: BTreeMap<String, serde_json::Value> = own
            .filter_map(|port| Some((port.to_owned(), io.value(port).ok()?.to_json())))
            .collect();
        let size = serde_json::to_vec(&inputs).map_or(usize::MAX, |bytes| bytes.len());
        if size > MAX_INPUTS {
            return Err(format!("inputs of {size} bytes: expected at most {MAX_INPUTS}"));
        }
        Ok(Self { id, server, inputs })
    }

    fn request(&self, io: &LeafIo<'_>, ctx: &Context, action: RemoteAction, epoch: u64) -> Ask {
        let request = RemoteRequest {
            execution: self.id.clone(),
            action,
            robot: ctx.config.robot.to_string(),
            goal: ctx.goal.id.clone(),
            node: io.name().to_owned(),
            epoch,
            inputs: self.inputs.clone(),
        };
        Ask::Remote(self.server.clone(), Box::new(request))
    }
}

/// A tree may come from anybody, so it must not send asks on the keys that command robots and services.
fn check_key(key: &str) -> Result<(), String> {
    let chunks: Vec<&str> = key.split('/').collect();
    let wild = key.contains(['*', '$', '?', '#']) || chunks.iter().any(|chunk| chunk.is_empty());
    if wild || key.len() > LONGEST_KEY {
        return Err(format!(
            "`{SERVER}` is `{}`: expected a Zenoh key without wildcards, of at most {LONGEST_KEY} bytes",
            key.chars().take(60).collect::<String>()
        ));
    }
    let own = chunks.first() == Some(&"zenav") && (chunks.get(1) == Some(&"svc") || chunks.get(2) == Some(&"ask"));
    if own {
        return Err(format!(
            "`{SERVER}` is `{key}`: expected a key that is not the stack's own"
        ));
    }
    Ok(())
}

impl Leaf<Context> for Remote {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let id = ctx.execution_id();
        let remembered =
            Execution::read(io, id).and_then(|execution| io.remember(&execution).map_err(|e| e.to_string()));
        if let Err(why) = remembered {
            return fail(io, ctx, None, why);
        }
        *self = Self {
            looked: ctx.now,
            ..Self::default()
        };
        // The first request follows in the next tick, when the execution's id is stored.
        step(io, ctx, "begins")
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let Some(execution) = io.recall::<Execution>() else {
            return fail(io, ctx, None, "the execution id is lost");
        };
        let Some(epoch) = ctx.lease.epoch() else {
            (self.looked, self.silent) = (ctx.now, 0.0);
            return step(io, ctx, "waiting for the lease");
        };
        self.silent += ctx.now.secs_since(self.looked).min(LONGEST_LOOK);
        self.looked = ctx.now;
        let mut feedback = String::new();
        if let Some(answer) = self.ticket.and_then(|ticket| ctx.asks.take(ticket)) {
            self.ticket = None;
            match answer {
                Ok(Answer::Remote(reply)) if reply.execution == execution.id => {
                    self.silent = 0.0;
                    if let Some(status) = ended(io, ctx, &reply) {
                        return status;
                    }
                    feedback = reply.feedback;
                }
                Ok(_) => tracing::warn!(server = execution.server, "an answer about something else"),
                Err(NoAnswer::Refused(refusal)) => return fail(io, ctx, None, refusal.to_string()),
                Err(NoAnswer::Silent(why)) => tracing::debug!(server = execution.server, why, "no answer yet"),
            }
        }
        let seconds = |port: &str, otherwise: f64| io.number_or(port, otherwise).unwrap_or(otherwise).max(0.0) * 1e-3;
        let (period, patience) = (seconds(PERIOD, 100.0), seconds(TIMEOUT, 10_000.0));
        let silent = self.silent;
        if silent > patience {
            self.halt(io, ctx);
            let why = format!("no answer on `{}` for {silent:.0} s", execution.server);
            return fail(io, ctx, None, why);
        }
        if self.ticket.is_none() && ctx.now >= self.next_ask {
            self.next_ask = ctx.now.plus_secs(period);
            let ask = execution.request(io, ctx, RemoteAction::Run, epoch);
            self.ticket = Some(ctx.asks.ask(ask));
        }
        if feedback.is_empty() {
            Status::Running
        } else {
            step(io, ctx, &feedback)
        }
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        *self = Self {
            looked: ctx.now,
            ..Self::default()
        };
        self.tick(io, ctx)
    }

    fn halt(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) {
        ctx.asks.forget(self.ticket.take());
        if let (Some(execution), Some(epoch)) = (io.recall::<Execution>(), ctx.lease.epoch()) {
            let ask = execution.request(io, ctx, RemoteAction::Cancel, epoch);
            let ticket = ctx.asks.ask(ask);
            ctx.asks.forget(ticket);
        }
    }
}

/// The status of an ended execution; `None` while it runs.
fn ended(io: &mut LeafIo<'_>, ctx: &mut Context, reply: &RemoteReply) -> Option<Status> {
    if reply.status == RemoteStatus::Running {
        return None;
    }
    for (port, value) in &reply.outputs {
        let Some(value) = Value::from_json(value).filter(|_| io.is_writable(port)) else {
            continue;
        };
        if let Err(wrong) = io.set(port, value) {
            return Some(fail(io, ctx, None, format!("output `{port}`: {wrong}")));
        }
    }
    Some(match reply.status {
        RemoteStatus::Success => {
            io.say(reply.feedback.as_str());
            Status::Success
        }
        _ if reply.feedback.is_empty() => fail(io, ctx, None, "it failed"),
        _ => fail(io, ctx, None, reply.feedback.as_str()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_of_the_stack_and_wildcards_are_no_servers() {
        for key in ["kitchen/gripper", "zenav/tiago/tool/gripper", "a"] {
            assert_eq!(check_key(key), Ok(()), "{key}");
        }
        for key in [
            "",
            "a//b",
            "/a",
            "a/*",
            "**",
            "a?b",
            "zenav/svc/motion/w",
            "zenav/tiago/ask/edge/stop",
        ] {
            assert!(check_key(key).is_err(), "{key}");
        }
    }
}

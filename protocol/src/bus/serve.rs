//! Server. How are requests answered?
//!
//! In order, from a bounded queue. A malformed or oversized request is refused before the service sees it.

use std::collections::BTreeMap;
use std::fmt;
use std::sync::Arc;

use serde::Serialize;
use serde::de::DeserializeOwned;
use zenoh::Wait;
use zenoh::bytes::{Encoding as Wire, ZBytes};
use zenoh::key_expr::KeyExpr;
use zenoh::query::{Query, Queryable};

use super::flow::Arrivals;
use super::inbox::{Inbox, Queue};
use super::subscribe::encoding_of;
use super::{Bus, BusError, threads};
use crate::SCHEMA_VERSION;
use crate::codec::{self, CodecError, Encoding};
use crate::messages::Refusal;
use crate::topics::{Ask, Asker, CLOUD_INFO, Decode, EDGE_INFO, EncodeAs, MESSAGE_SCHEMA, PART_INFO, STOP, row_of};

/// Selector parameter with the schema version of the program that asks. Without it, as from plain Zenoh tools, any request is read.
pub(super) const SCHEMA: &str = "schema";
/// Most queued requests; further ones are refused as `Busy`.
const MAX_WAITING: usize = 64;
/// Replies larger than this may block for a long time until there is room, bytes.
const BULK: usize = 32 * 1024;

/// Receives the requests of one ask.
pub struct Server<Q, R> {
    desk: Desk,
    ask: Ask<Q, R>,
}

/// The part of a server that does not depend on the types of its requests and replies: it is compiled once, not for each type.
struct Desk {
    inbox: Arc<Inbox<Queue<Query>>>,
    pattern: &'static str,
    key: KeyExpr<'static>,
    flow: Arrivals,
    _queryable: Queryable<()>,
}

impl<Q, R> fmt::Debug for Server<Q, R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Server")
            .field("key", &self.desk.key)
            .finish_non_exhaustive()
    }
}

impl Bus {
    /// Serves the ask's key with these chunks. A chunk may be `*` (one service for all robots); requests must then name the robot.
    ///
    /// # Errors
    /// [`BusError::Key`] for chunks that do not form a key, [`BusError::Closed`] after the bus was closed.
    pub fn serve<Q, R>(&self, ask: &Ask<Q, R>, chunks: &[&str]) -> Result<Server<Q, R>, BusError> {
        Ok(Server {
            desk: self.desk(ask.pattern, ask.key(chunks), ask.max_bytes)?,
            ask: *ask,
        })
    }

    fn desk(&self, pattern: &'static str, key: String, limit: usize) -> Result<Desk, BusError> {
        let key = Self::key(key)?;
        let flow = Arrivals::new(self, pattern);
        let (inbox, slot) = Inbox::gauged(Queue::new(MAX_WAITING), flow.waiting.clone());
        let arrived = flow.clone();
        let queryable = self
            .session
            .declare_queryable(key.clone())
            .callback(move |query: Query| {
                let got = query.payload().map_or(0, ZBytes::len);
                arrived.received(got);
                if got > limit {
                    arrived.refused(&CodecError::TooLarge { limit, got });
                    refuse(&query, &Refusal::TooLarge { limit });
                } else if let Some(query) = slot.put_within(query, MAX_WAITING) {
                    arrived.dropped();
                    refuse(
                        &query,
                        &Refusal::Busy {
                            reason: format!("{MAX_WAITING} requests are waiting already"),
                        },
                    );
                }
            })
            .wait();
        Ok(Desk {
            inbox,
            pattern,
            key,
            flow,
            _queryable: self.declared(queryable)?,
        })
    }
}

impl<Q: DeserializeOwned, R> Server<Q, R> {
    /// Waits for the next request; `None` after the bus was closed. A request that cannot be decoded is refused here, with the reason, and so is
    /// one without a payload on a key with wildcards, unless the ask changes nothing.
    pub async fn next(&mut self) -> Option<Request<Q, R>> {
        loop {
            let (key, query) = self.desk.next().await?;
            match read_body(&query, self.ask.decode_request, self.ask.max_bytes) {
                Ok(body) => {
                    return Some(Request {
                        body,
                        chunks: self.ask.chunks(key.as_str()),
                        parameters: parameters_of(&query),
                        key,
                        query,
                        encode: self.ask.encode_reply,
                    });
                }
                Err(error) => self.desk.refuse_body(&query, &error),
            }
        }
    }
}

impl Desk {
    /// Waits for the next request whose body may be decoded, with the key to reply on.
    async fn next(&mut self) -> Option<(KeyExpr<'static>, Query)> {
        loop {
            let query = self.inbox.next().await?;
            match self.admit(&query) {
                Ok(key) => return Some((key, query)),
                Err(refusal) => refuse(&query, &refusal),
            }
        }
    }

    /// The key to reply on.
    fn admit(&self, query: &Query) -> Result<KeyExpr<'static>, Refusal> {
        let key = if !self.key.is_wild() {
            self.key.clone()
        } else if !query.key_expr().is_wild() {
            query.key_expr().clone()
        } else {
            return Err(Refusal::bad_request("expected a key without wildcards"));
        };
        let theirs = query
            .parameters()
            .get(SCHEMA)
            .and_then(|schema| schema.parse::<u32>().ok());
        if let Some(theirs) = theirs.filter(|theirs| *theirs != SCHEMA_VERSION && !suits_every_schema(self.pattern)) {
            return Err(Refusal::bad_request(format!(
                "the program that asks speaks schema {theirs}, this one ({}) schema {SCHEMA_VERSION}: expected the same",
                env!("CARGO_PKG_VERSION")
            )));
        }
        // Otherwise somebody who looks at `zenav/**` would stop a robot and cancel its goal.
        let is_read = row_of(self.pattern).is_some_and(|row| row.asked_by == Some(Asker::Viewer));
        if is_empty(query) && query.key_expr().is_wild() && !is_read {
            return Err(Refusal::bad_request(
                "a request on a key with wildcards: expected a payload, at least `{}`",
            ));
        }
        Ok(key)
    }

    fn refuse_body(&self, query: &Query, error: &CodecError) {
        let refusal = match error {
            CodecError::TooLarge { limit, .. } => Refusal::TooLarge { limit: *limit },
            _ => {
                self.flow.refused(error);
                Refusal::bad_request(error)
            }
        };
        refuse(query, &refusal);
    }
}

fn parameters_of(query: &Query) -> BTreeMap<String, String> {
    query
        .parameters()
        .iter()
        .filter(|(name, _)| *name != SCHEMA)
        .map(|(name, value)| (name.to_owned(), value.to_owned()))
        .collect()
}

/// Whether programs of any schema may send the request: a stop is always obeyed, info tells the versions, and the schema the differences.
fn suits_every_schema(pattern: &str) -> bool {
    let all = [
        STOP.pattern,
        EDGE_INFO.pattern,
        CLOUD_INFO.pattern,
        PART_INFO.pattern,
        MESSAGE_SCHEMA.pattern,
    ];
    all.contains(&pattern)
}

fn is_empty(query: &Query) -> bool {
    query.payload().is_none_or(ZBytes::is_empty)
}

/// Decodes a request. An empty payload means `{}`, or `null` if the request type accepts that.
fn read_body<Q>(query: &Query, decode: Decode<Q>, max_bytes: usize) -> Result<Q, CodecError> {
    match query.payload().filter(|payload| !payload.is_empty()) {
        Some(payload) => decode(
            &payload.to_bytes(),
            query.encoding().map_or(Encoding::Json, encoding_of),
            max_bytes,
        ),
        None => decode(b"{}", Encoding::Json, max_bytes)
            .or_else(|error| decode(b"null", Encoding::Json, max_bytes).map_err(|_| error)),
    }
}

/// A request, answered once. When it is dropped without a reply, the client repeats it until its deadline.
pub struct Request<Q, R> {
    /// The request, as the client sent it.
    pub body: Q,
    /// The named chunks of the key, in the order of the pattern's names.
    pub chunks: Vec<String>,
    /// Parameters of the selector: `format` is `png` in `map?format=png`.
    pub parameters: BTreeMap<String, String>,
    key: KeyExpr<'static>,
    query: Query,
    encode: EncodeAs<R>,
}

impl<Q: fmt::Debug, R> fmt::Debug for Request<Q, R> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Request")
            .field("key", &self.key)
            .field("body", &self.body)
            .finish_non_exhaustive()
    }
}

impl<Q, R: Serialize> Request<Q, R> {
    /// Replies, in JSON unless the selector contains `format=cbor`.
    pub fn reply(self, reply: &R) {
        let encoding = if self.parameters.get("format").is_some_and(|format| format == "cbor") {
            Encoding::Cbor
        } else {
            Encoding::Json
        };
        match (self.encode)(reply, encoding) {
            Ok(bytes) => self.reply_bytes(bytes, encoding.mime()),
            Err(error) => self.refuse(&Refusal::internal(error)),
        }
    }
}

impl<Q, R> Request<Q, R> {
    /// The body, and the request without it.
    pub(super) fn split(self) -> (Q, Request<(), R>) {
        let rest = Request {
            body: (),
            chunks: self.chunks,
            parameters: self.parameters,
            key: self.key,
            query: self.query,
            encode: self.encode,
        };
        (self.body, rest)
    }

    /// Replies with bytes of any encoding, such as `image/png`.
    pub fn reply_bytes(self, bytes: Vec<u8>, mime: &str) {
        reply_with(&self.query, &self.key, bytes, mime);
    }

    /// Refuses the request, with the reason.
    pub fn refuse(self, refusal: &Refusal) {
        refuse(&self.query, refusal);
    }
}

fn reply_with(query: &Query, key: &KeyExpr<'static>, bytes: Vec<u8>, mime: &str) {
    let is_bulk = bytes.len() > BULK;
    let reply = query.reply(key, bytes).encoding(Wire::from(mime));
    let result = if is_bulk {
        threads::waiting_for_room(|| reply.wait())
    } else {
        reply.wait()
    };
    sent(query, result);
}

fn refuse(query: &Query, refusal: &Refusal) {
    // A refusal can always be encoded as JSON.
    let bytes = codec::encode(refusal, Encoding::Json).unwrap_or_default();
    sent(query, query.reply_err(bytes).encoding(Wire::APPLICATION_JSON).wait());
}

fn sent(query: &Query, result: zenoh::Result<()>) {
    if let Err(error) = result {
        // The client disappeared or gave up.
        tracing::debug!(key = %query.key_expr(), %error, "reply not sent");
    }
}

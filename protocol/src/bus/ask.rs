//! Ask. How does a client get an answer over a network that loses messages?
//!
//! The client repeats the request until the deadline. An ended query without a reply is not an answer (the server may be starting, or
//! reconnecting), nor is silence (the server may be frozen): after a while the client sends the request again, and a reply to an earlier
//! copy still counts. `NotLeader` from a standby, and `Busy`, are skipped until the deadline. A repeated request repeats its effects, so a
//! request that changes something carries an id.

use std::time::Duration;

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;
use tokio::sync::mpsc;
use tokio::time::{Instant, sleep_until};
use zenoh::Wait;
use zenoh::key_expr::KeyExpr;
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply};

use super::rights::{Act, Denied};
use super::serve::SCHEMA;
use super::subscribe::{decode_sample, encoding_of};
use super::{Bus, BusError};
use crate::SCHEMA_VERSION;
use crate::codec::{self, CodecError, Encoding};
use crate::messages::Refusal;
use crate::topics::Ask;

/// Largest reply that is decoded, bytes.
const MAX_REPLY: usize = 64 * 1024 * 1024;
/// Largest refusal that is decoded, bytes.
const MAX_REFUSAL: usize = 64 * 1024;
/// Most replies queued for decoding.
const MAX_WAITING: usize = 256;
/// First pause after a request without any reply; doubles up to `LONGEST_WAIT`.
const SHORTEST_WAIT: Duration = Duration::from_millis(20);
/// Longest pause between two requests.
const LONGEST_WAIT: Duration = Duration::from_millis(500);
/// A silent server counts as frozen after a third of the deadline, but not before this time.
const LEAST_PATIENCE: Duration = Duration::from_millis(250);

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AskError {
    /// No server answered in time.
    #[error("no answer from {key} in time")]
    Timeout {
        /// The key of the ask.
        key: String,
    },
    /// The server refused the request.
    #[error("{0}")]
    Refused(Refusal),
    /// The reply could not be decoded: the server uses another version.
    #[error("unreadable answer from {key}: {reason}")]
    Malformed {
        /// The key of the ask.
        key: String,
        /// What the decoder expected.
        reason: String,
    },
    /// The request cannot be encoded, or its chunks do not form a key.
    #[error("cannot ask {key}: {reason}")]
    Unaskable {
        /// The key of the ask.
        key: String,
        /// What is wrong with the request.
        reason: String,
    },
    /// This process's member of the fleet may not send the request: nothing was sent.
    #[error(transparent)]
    Denied(#[from] Denied),
    /// The bus was closed.
    #[error("the bus is closed")]
    Closed,
}

/// The answer of one of several servers.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer<R> {
    /// The chunks of the answering server's key; empty for a refusal, which carries no key.
    pub chunks: Vec<String>,
    /// The reply, or the refusal.
    pub result: Result<R, Refusal>,
}

/// A reply to a request that was sent, or `None` when no further reply will come.
type Event = Option<Reply>;

/// Sends the end marker when Zenoh drops the callback.
struct Replies(mpsc::Sender<Event>);

impl Drop for Replies {
    fn drop(&mut self) {
        // If the queue is full, a reader is active and ends by its own deadline.
        let _ = self.0.try_send(None);
    }
}

/// A decoded reply.
enum Verdict<R> {
    Answer(Answer<R>),
    Unreadable(CodecError),
    /// Zenoh's own report of a timeout.
    Nothing,
}

impl Bus {
    /// Sends a request, and repeats it until a server answers with anything but `NotLeader` or `Busy`, for at most `deadline` (wall time).
    /// A chunk may be `*`.
    ///
    /// # Errors
    /// [`AskError::Timeout`] with the key; [`AskError::Refused`] with the server's refusal, also with `NotLeader` or `Busy` when there was
    /// no other answer; [`AskError::Denied`] at once; [`AskError::Malformed`], [`AskError::Unaskable`], [`AskError::Closed`].
    pub async fn ask<Q: Serialize, R: DeserializeOwned>(
        &self,
        ask: &Ask<Q, R>,
        chunks: &[&str],
        request: &Q,
        deadline: Duration,
    ) -> Result<R, AskError> {
        let question = self.question(ask, chunks, request)?;
        let start = Instant::now();
        let end = start
            .checked_add(deadline)
            .unwrap_or_else(|| start + Duration::from_secs(365 * 24 * 3600));
        let patience = (deadline / 3).max(LEAST_PATIENCE);
        let (sender, mut events) = mpsc::channel(MAX_WAITING);
        let mut wait = SHORTEST_WAIT;
        let mut refusal = None;
        let mut unreadable = None;
        let mut open = 0_usize;
        let mut again = start;
        loop {
            // Tokio's timer rounds up to a millisecond, several times the duration of an answer.
            if Instant::now() >= again {
                self.send(&question, end.saturating_duration_since(Instant::now()), &sender)?;
                open += 1;
                again = Instant::now() + patience;
            }
            let event = tokio::select! {
                biased;
                () = sleep_until(end) => break,
                event = events.recv() => event,
                () = sleep_until(again) => continue,
            };
            match event {
                Some(Some(reply)) => match read(ask, reply) {
                    Verdict::Answer(Answer { result: Ok(answer), .. }) => return Ok(answer),
                    Verdict::Answer(Answer {
                        result: Err(no @ (Refusal::NotLeader | Refusal::Busy { .. })),
                        ..
                    }) => refusal = Some(no),
                    Verdict::Answer(Answer { result: Err(no), .. }) => return Err(AskError::Refused(no)),
                    Verdict::Unreadable(error) => unreadable = Some(error),
                    Verdict::Nothing => {}
                },
                Some(None) => {
                    if self.session.is_closed() {
                        return Err(AskError::Closed);
                    }
                    // Until now another server might have answered; now it is certain that none did.
                    if let Some(error) = unreadable {
                        return Err(question.malformed(&error));
                    }
                    open = open.saturating_sub(1);
                    if open == 0 {
                        again = Instant::now() + wait;
                        wait = (wait * 2).min(LONGEST_WAIT);
                    }
                }
                None => break,
            }
        }
        match (refusal, unreadable) {
            (Some(refusal), _) => Err(AskError::Refused(refusal)),
            (None, Some(error)) => Err(question.malformed(&error)),
            (None, None) => Err(AskError::Timeout {
                key: question.key.to_string(),
            }),
        }
    }

    /// Asks every server once and collects the answers that arrive before `deadline`.
    ///
    /// # Errors
    /// [`AskError::Denied`], [`AskError::Unaskable`], [`AskError::Closed`]. No answer at all gives an empty list, not an error.
    pub async fn ask_all<Q: Serialize, R: DeserializeOwned>(
        &self,
        ask: &Ask<Q, R>,
        chunks: &[&str],
        request: &Q,
        deadline: Duration,
    ) -> Result<Vec<Answer<R>>, AskError> {
        let question = self.question(ask, chunks, request)?;
        let (sender, mut events) = mpsc::channel(MAX_WAITING);
        self.send(&question, deadline, &sender)?;
        drop(sender);
        let mut answers = Vec::new();
        let gather = async {
            while let Some(Some(reply)) = events.recv().await {
                match read(ask, reply) {
                    Verdict::Answer(answer) => answers.push(answer),
                    Verdict::Unreadable(error) => {
                        tracing::warn!(key = %question.key, %error, "reply ignored: it cannot be decoded")
                    }
                    Verdict::Nothing => {}
                }
            }
        };
        // Zenoh ends the query at the deadline; this is a fallback.
        let _ = tokio::time::timeout(deadline + LEAST_PATIENCE, gather).await;
        answers.sort_by(|a, b| a.chunks.cmp(&b.chunks));
        Ok(answers)
    }

    fn question<Q: Serialize, R>(&self, ask: &Ask<Q, R>, chunks: &[&str], request: &Q) -> Result<Question, AskError> {
        if self.session.is_closed() {
            return Err(AskError::Closed);
        }
        let key = Self::key(ask.key(chunks)).map_err(|error| AskError::Unaskable {
            key: ask.key(chunks),
            reason: error.to_string(),
        })?;
        self.check_key(Act::Ask, &key)?;
        let bytes = codec::encode(request, Encoding::Json).map_err(|error| AskError::Unaskable {
            key: key.to_string(),
            reason: error.to_string(),
        })?;
        // The server would refuse it, and routers drop larger requests on the way.
        if bytes.len() > ask.max_bytes {
            return Err(AskError::Refused(Refusal::TooLarge { limit: ask.max_bytes }));
        }
        let format = match ask.reply_encoding {
            Encoding::Json => "",
            Encoding::Cbor => "format=cbor;",
        };
        let parameters = format!("{format}{SCHEMA}={SCHEMA_VERSION}");
        Ok(Question {
            key,
            parameters,
            payload: bytes.into(),
        })
    }

    fn send(&self, question: &Question, timeout: Duration, events: &mpsc::Sender<Event>) -> Result<(), AskError> {
        let replies = Replies(events.clone());
        self.session
            .get((&question.key, question.parameters.as_str()))
            .payload(question.payload.clone())
            .encoding(zenoh::bytes::Encoding::APPLICATION_JSON)
            .target(QueryTarget::All)
            // Deliver the first reply at once, not after the last server has answered.
            .consolidation(ConsolidationMode::None)
            .priority(Priority::InteractiveHigh)
            .timeout(timeout.max(Duration::from_millis(1)))
            .callback(move |reply| {
                // When the queue is full, further replies are dropped.
                let _ = replies.0.try_send(Some(reply));
            })
            .wait()
            .map_err(|error| {
                if self.session.is_closed() {
                    AskError::Closed
                } else {
                    AskError::Unaskable {
                        key: question.key.to_string(),
                        reason: error.to_string(),
                    }
                }
            })
    }
}

/// An encoded request that can be sent repeatedly.
struct Question {
    key: KeyExpr<'static>,
    parameters: String,
    payload: zenoh::bytes::ZBytes,
}

impl Question {
    fn malformed(&self, error: &CodecError) -> AskError {
        AskError::Malformed {
            key: self.key.to_string(),
            reason: error.to_string(),
        }
    }
}

fn read<Q, R: DeserializeOwned>(ask: &Ask<Q, R>, reply: Reply) -> Verdict<R> {
    match reply.result() {
        Ok(sample) => match decode_sample(sample, MAX_REPLY) {
            Ok(message) => Verdict::Answer(Answer {
                chunks: ask.chunks(sample.key_expr().as_str()),
                result: Ok(message),
            }),
            Err(error) => Verdict::Unreadable(error),
        },
        Err(error) => match codec::decode(&error.payload().to_bytes(), encoding_of(error.encoding()), MAX_REFUSAL) {
            Ok(refusal) => Verdict::Answer(Answer {
                chunks: Vec::new(),
                result: Err(refusal),
            }),
            Err(_) if error.payload().to_bytes().as_ref() == b"Timeout" => Verdict::Nothing,
            Err(error) => Verdict::Unreadable(error),
        },
    }
}

impl From<BusError> for AskError {
    fn from(error: BusError) -> Self {
        match error {
            BusError::Key { key, reason } => Self::Unaskable { key, reason },
            BusError::Denied(denied) => Self::Denied(denied),
            _ => Self::Closed,
        }
    }
}

//! How does one get an answer over a network that loses things? Ask until the deadline.
//!
//! No reply is not an answer (a server may just be starting, or reconnecting), nor is silence (it may be frozen): after a while the
//! question is asked again, while the answer to the earlier one still counts. A standby's `NotLeader` and a `Busy` are passed over until
//! the deadline. Since asking repeats effects, requests that change something carry an id.

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

use super::subscribe::{decode_sample, encoding_of};
use super::{Bus, BusError};
use crate::codec::{self, CodecError, Encoding};
use crate::messages::{Refusal, exit_code};
use crate::topics::Ask;

/// Largest reply looked at, bytes.
const MAX_REPLY: usize = 64 * 1024 * 1024;
/// Largest refusal looked at, bytes.
const MAX_REFUSAL: usize = 64 * 1024;
/// Replies that wait to be looked at.
const MAX_WAITING: usize = 256;
/// The first wait after a question that got no reply; doubles up to `LONGEST_WAIT`.
const SHORTEST_WAIT: Duration = Duration::from_millis(20);
const LONGEST_WAIT: Duration = Duration::from_millis(500);
/// Silence is taken for a frozen server after a third of the deadline, at least this.
const LEAST_PATIENCE: Duration = Duration::from_millis(250);

/// Why there is no answer.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum AskError {
    /// Nobody answered in time.
    #[error("no answer from {key} in time")]
    Timeout {
        /// The key asked.
        key: String,
    },
    /// The server said no.
    #[error("{0}")]
    Refused(Refusal),
    /// The server's answer could not be read: it speaks another version.
    #[error("unreadable answer from {key}: {reason}")]
    Malformed {
        /// The key asked.
        key: String,
        /// Where it went wrong.
        reason: String,
    },
    /// The question has no form on the wire, or its chunks make no key.
    #[error("cannot ask {key}: {reason}")]
    Unaskable {
        /// The key asked.
        key: String,
        /// Why.
        reason: String,
    },
    /// The bus was closed.
    #[error("the bus is closed")]
    Closed,
}

impl AskError {
    /// The exit code of a command line that got no answer.
    #[must_use]
    pub const fn exit_code(&self) -> u8 {
        match self {
            Self::Timeout { .. } => exit_code::TIMEOUT,
            Self::Refused(refusal) => refusal.exit_code(),
            Self::Malformed { .. } => exit_code::FAILED,
            Self::Unaskable { .. } => exit_code::USAGE,
            Self::Closed => exit_code::CANNOT_CONNECT,
        }
    }
}

/// One of several answers.
#[derive(Clone, Debug, PartialEq)]
pub struct Answer<R> {
    /// The chunks of the answering server's key; empty for a refusal, which carries no key.
    pub chunks: Vec<String>,
    /// What it said.
    pub result: Result<R, Refusal>,
}

/// What comes back from a question that was sent: a reply, or `None` when no more come.
type Event = Option<Reply>;

/// Sends the end when Zenoh lets go of the callback.
struct Replies(mpsc::Sender<Event>);

impl Drop for Replies {
    fn drop(&mut self) {
        // A full queue is being read, and its reader gives up on its own.
        let _ = self.0.try_send(None);
    }
}

/// A reply, read.
enum Verdict<R> {
    Answer(Answer<R>),
    Unreadable(CodecError),
    /// Zenoh's own word that time is up.
    Nothing,
}

impl Bus {
    /// The first answer that is neither `NotLeader` nor `Busy`, before `deadline` (wall time) is over. A chunk may be `*`.
    ///
    /// # Errors
    /// [`AskError`]; after a deadline with nothing but `NotLeader` or `Busy`, that refusal.
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
            // Not left to the timer alone: it rounds up to a millisecond, several times what an answer takes.
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
                    // Another server may have answered well; only now is it sure that none did.
                    if let Some(error) = unreadable {
                        return Err(AskError::Malformed {
                            key: question.key.to_string(),
                            reason: error.to_string(),
                        });
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
            (None, Some(error)) => Err(AskError::Malformed {
                key: question.key.to_string(),
                reason: error.to_string(),
            }),
            (None, None) => Err(AskError::Timeout {
                key: question.key.to_string(),
            }),
        }
    }

    /// What all servers answer that are there now, asked once; those that are silent until `deadline` are left out.
    ///
    /// # Errors
    /// [`AskError::Unaskable`] and [`AskError::Closed`]; no answer at all is an empty list.
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
                        tracing::warn!(key = %question.key, %error, "unreadable answer left out")
                    }
                    Verdict::Nothing => {}
                }
            }
        };
        // Zenoh ends the question at the deadline by itself; this is for a Zenoh that does not.
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
        let bytes = codec::encode(request, Encoding::Json).map_err(|error| AskError::Unaskable {
            key: key.to_string(),
            reason: error.to_string(),
        })?;
        let parameters = match ask.reply_encoding {
            Encoding::Json => "",
            Encoding::Cbor => "format=cbor",
        };
        Ok(Question {
            key,
            parameters,
            payload: bytes.into(),
        })
    }

    fn send(&self, question: &Question, timeout: Duration, events: &mpsc::Sender<Event>) -> Result<(), AskError> {
        let replies = Replies(events.clone());
        self.session
            .get((&question.key, question.parameters))
            .payload(question.payload.clone())
            .encoding(zenoh::bytes::Encoding::APPLICATION_JSON)
            .target(QueryTarget::All)
            // The first reply at once, not when the last server has answered.
            .consolidation(ConsolidationMode::None)
            .priority(Priority::InteractiveHigh)
            .timeout(timeout.max(Duration::from_millis(1)))
            .callback(move |reply| {
                // Padding what waits there a flood of replies is dropped.
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

/// A question, ready to be sent again.
struct Question {
    key: KeyExpr<'static>,
    parameters: &'static str,
    payload: zenoh::bytes::ZBytes,
}

fn read<Q, R: DeserializeOwned>(ask: &Ask<Q, R>, reply: Reply) -> Verdict<R> {
    match reply.result() {
        Ok(sample) => match decode_sample(sample, MAX_REPLY) {
            Ok(message) => {
                let chunks = ask
                    .chunks(sample.key_expr().as_str())
                    .unwrap_or_default()
                    .into_iter()
                    .map(str::to_owned)
                    .collect();
                Verdict::Answer(Answer {
                    chunks,
                    result: Ok(message),
                })
            }
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
            _ => Self::Closed,
        }
    }
}

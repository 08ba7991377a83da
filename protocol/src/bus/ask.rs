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
use tokio::time::{Instant, sleep_until, timeout_at};
use zenoh::Wait;
use zenoh::key_expr::KeyExpr;
use zenoh::qos::Priority;
use zenoh::query::{ConsolidationMode, QueryTarget, Reply, ReplyError};
use zenoh::sample::Sample;

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

/// A decoded reply that carries an error.
enum ErrorReply {
    Refusal(Refusal),
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
        let question = self.question(ask.key(chunks), ask.max_bytes, ask.reply_encoding, &|| {
            (ask.encode_request)(request)
        })?;
        let mut asking = Asking::new(self, question, deadline);
        loop {
            let sample = asking.reply().await?;
            match decode_sample(&sample, ask.decode_reply, MAX_REPLY) {
                Ok(answer) => return Ok(answer),
                Err(error) => asking.unreadable = Some(error),
            }
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
        let question = self.question(ask.key(chunks), ask.max_bytes, ask.reply_encoding, &|| {
            (ask.encode_request)(request)
        })?;
        let mut gathering = self.ask_once(question, deadline)?;
        let mut answers = Vec::new();
        while let Some(reply) = gathering.next().await {
            match reply {
                Ok(sample) => match decode_sample(&sample, ask.decode_reply, MAX_REPLY) {
                    Ok(message) => answers.push(Answer {
                        chunks: ask.chunks(sample.key_expr().as_str()),
                        result: Ok(message),
                    }),
                    Err(error) => gathering.ignore(&error),
                },
                Err(refusal) => answers.push(Answer {
                    chunks: Vec::new(),
                    result: Err(refusal),
                }),
            }
        }
        answers.sort_by(|a, b| a.chunks.cmp(&b.chunks));
        Ok(answers)
    }

    /// Sends a request once.
    fn ask_once(&self, question: Question, deadline: Duration) -> Result<Gathering, AskError> {
        let (sender, events) = mpsc::channel(MAX_WAITING);
        self.send(&question, deadline, &sender)?;
        Ok(Gathering {
            question,
            events,
            // Zenoh ends the query at the deadline; this is a fallback.
            end: after(Instant::now(), deadline + LEAST_PATIENCE),
        })
    }

    fn question(
        &self,
        text: String,
        max_bytes: usize,
        reply_encoding: Encoding,
        encode: &dyn Fn() -> Result<Vec<u8>, CodecError>,
    ) -> Result<Question, AskError> {
        if self.session.is_closed() {
            return Err(AskError::Closed);
        }
        let key = Self::key(text.clone()).map_err(|error| AskError::Unaskable {
            key: text,
            reason: error.to_string(),
        })?;
        self.check_key(Act::Ask, &key)?;
        let bytes = encode().map_err(|error| AskError::Unaskable {
            key: key.to_string(),
            reason: error.to_string(),
        })?;
        // The server would refuse it, and routers drop larger requests on the way.
        if bytes.len() > max_bytes {
            return Err(AskError::Refused(Refusal::TooLarge { limit: max_bytes }));
        }
        let format = match reply_encoding {
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

/// A request that is repeated until there is an answer.
struct Asking<'a> {
    bus: &'a Bus,
    question: Question,
    sender: mpsc::Sender<Event>,
    events: mpsc::Receiver<Event>,
    end: Instant,
    patience: Duration,
    /// When the request is sent again.
    again: Instant,
    /// Pause after the next request without any reply.
    wait: Duration,
    /// Number of queries that have not ended.
    open: usize,
    /// The last refusal that is not final.
    refusal: Option<Refusal>,
    /// Why the last unreadable reply could not be decoded.
    unreadable: Option<CodecError>,
}

impl<'a> Asking<'a> {
    fn new(bus: &'a Bus, question: Question, deadline: Duration) -> Self {
        let start = Instant::now();
        let (sender, events) = mpsc::channel(MAX_WAITING);
        Self {
            bus,
            question,
            sender,
            events,
            end: after(start, deadline),
            patience: (deadline / 3).max(LEAST_PATIENCE),
            again: start,
            wait: SHORTEST_WAIT,
            open: 0,
            refusal: None,
            unreadable: None,
        }
    }

    /// Waits for the next reply that is not an error; sends the request whenever that is due.
    async fn reply(&mut self) -> Result<Sample, AskError> {
        loop {
            // Tokio's timer rounds up to a millisecond, several times the duration of an answer.
            if Instant::now() >= self.again {
                self.send()?;
            }
            let event = tokio::select! {
                biased;
                () = sleep_until(self.end) => break,
                event = self.events.recv() => event,
                () = sleep_until(self.again) => continue,
            };
            match event {
                Some(Some(reply)) => match reply.into_result() {
                    Ok(sample) => return Ok(sample),
                    Err(error) => self.failed(&error)?,
                },
                Some(None) => self.ended()?,
                None => break,
            }
        }
        Err(self.unanswered())
    }

    fn send(&mut self) -> Result<(), AskError> {
        let left = self.end.saturating_duration_since(Instant::now());
        self.bus.send(&self.question, left, &self.sender)?;
        self.open += 1;
        self.again = Instant::now() + self.patience;
        Ok(())
    }

    /// Takes a reply that carries an error; fails if it is final.
    fn failed(&mut self, error: &ReplyError) -> Result<(), AskError> {
        match read_error(error) {
            ErrorReply::Refusal(no @ (Refusal::NotLeader | Refusal::Busy { .. })) => self.refusal = Some(no),
            ErrorReply::Refusal(no) => return Err(AskError::Refused(no)),
            ErrorReply::Unreadable(error) => self.unreadable = Some(error),
            ErrorReply::Nothing => {}
        }
        Ok(())
    }

    /// Takes the end of a query: no further reply to it will come.
    fn ended(&mut self) -> Result<(), AskError> {
        if self.bus.session.is_closed() {
            return Err(AskError::Closed);
        }
        // Until now another server might have answered; now it is certain that none did.
        if let Some(error) = &self.unreadable {
            return Err(self.question.malformed(error));
        }
        self.open = self.open.saturating_sub(1);
        if self.open == 0 {
            self.again = Instant::now() + self.wait;
            self.wait = (self.wait * 2).min(LONGEST_WAIT);
        }
        Ok(())
    }

    /// Why there is no answer at the deadline.
    fn unanswered(&mut self) -> AskError {
        match (self.refusal.take(), &self.unreadable) {
            (Some(refusal), _) => AskError::Refused(refusal),
            (None, Some(error)) => self.question.malformed(error),
            (None, None) => AskError::Timeout {
                key: self.question.key.to_string(),
            },
        }
    }
}

/// The replies to a request that was sent once.
struct Gathering {
    question: Question,
    events: mpsc::Receiver<Event>,
    end: Instant,
}

impl Gathering {
    /// Waits for the next reply or refusal; `None` when no more will come.
    async fn next(&mut self) -> Option<Result<Sample, Refusal>> {
        while let Ok(Some(Some(reply))) = timeout_at(self.end, self.events.recv()).await {
            let error = match reply.into_result() {
                Ok(sample) => return Some(Ok(sample)),
                Err(error) => error,
            };
            match read_error(&error) {
                ErrorReply::Refusal(refusal) => return Some(Err(refusal)),
                ErrorReply::Unreadable(error) => self.ignore(&error),
                ErrorReply::Nothing => {}
            }
        }
        None
    }

    fn ignore(&self, error: &CodecError) {
        tracing::warn!(key = %self.question.key, %error, "reply ignored: it cannot be decoded");
    }
}

/// A time after another; a year later if the clock cannot show it.
fn after(start: Instant, time: Duration) -> Instant {
    start
        .checked_add(time)
        .unwrap_or_else(|| start + Duration::from_secs(365 * 24 * 3600))
}

fn read_error(error: &ReplyError) -> ErrorReply {
    let payload = error.payload().to_bytes();
    match codec::decode(&payload, encoding_of(error.encoding()), MAX_REFUSAL) {
        Ok(refusal) => ErrorReply::Refusal(refusal),
        Err(_) if payload.as_ref() == b"Timeout" => ErrorReply::Nothing,
        Err(error) => ErrorReply::Unreadable(error),
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

//! Typed keys. What is known of a key: who writes, serves or asks it, its quality of service, and the types of its messages.

use std::fmt::Debug;
use std::marker::PhantomData;

use serde::Serialize;
use serde::de::DeserializeOwned;

#[cfg(feature = "bus")]
use crate::codec::CodecError;
use crate::codec::Encoding;

use super::pattern::{fill, owned_chunks};

/// How a topic is carried.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Qos {
    /// Plain publication, dropped under congestion; a receiver keeps only the newest.
    Latest,
    /// As `Latest`, at real-time priority and sent at once.
    RealTime,
    /// Advanced publication: the writer keeps this many samples for late joiners and for recovery of gaps; receivers get all samples, in
    /// order.
    Events {
        /// Samples kept by the writer.
        cache: usize,
    },
    /// Advanced publication; the writer keeps the last value for late joiners.
    State,
}

/// Who writes a topic or serves an ask.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Producer {
    /// The robot.
    Edge,
    /// The mapping service.
    Mapping,
    /// A motion worker.
    Motion,
    /// The mission that holds the robot's lease.
    Mission,
    /// The holder of the robot's lease: a mission or an operator.
    Holder,
    /// An operator who drives by hand.
    Operator,
    /// The simulator.
    Sim,
    /// Any off-board component: topics and asks that all of them have.
    Part,
    /// The drive base with sensors and motors, if it is a separate process from the edge.
    Body,
}

/// Who may send an ask, where access is controlled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Asker {
    /// Everybody but robots: the ask changes nothing.
    Viewer,
    /// Operators and services: the ask changes something, or can.
    Operator,
    /// Services only.
    Service,
    /// Robots, to attach a simulated body to a world.
    Robot,
}

/// A key that carries `T`. [`Topic::key`] fills `{robot}`, `{id}` and `{worker}` in the pattern.
#[derive(Debug)]
pub struct Topic<T> {
    /// Key with named chunks.
    pub pattern: &'static str,
    /// Quality of service.
    pub qos: Qos,
    /// Most messages a second of one writer on one key, in the robot's own time; a receiver drops what comes faster by far. `None`: never
    /// limited, because the newest message may be a stop, or is the time itself.
    pub rate: Option<u16>,
    /// Largest payload that a receiver decodes, bytes.
    pub max_bytes: usize,
    /// Encoding used by the writer; a receiver accepts JSON everywhere.
    pub encoding: Encoding,
    #[cfg(feature = "bus")]
    pub(crate) encode: Encode<T>,
    #[cfg(feature = "bus")]
    pub(crate) decode: Decode<T>,
    pub(super) message: PhantomData<fn() -> T>,
}

/// A key on which `Q` is answered with `R` or with a [`Refusal`](crate::messages::Refusal).
#[derive(Debug)]
pub struct Ask<Q, R> {
    /// Key with named chunks.
    pub pattern: &'static str,
    /// Largest request in bytes that a server looks at.
    pub max_bytes: usize,
    /// Encoding of the reply to typed requesters (selector parameter `format=cbor`); all others get JSON.
    pub reply_encoding: Encoding,
    #[cfg(feature = "bus")]
    pub(crate) encode_request: Encode<Q>,
    #[cfg(feature = "bus")]
    pub(crate) decode_request: Decode<Q>,
    #[cfg(feature = "bus")]
    pub(crate) encode_reply: EncodeAs<R>,
    #[cfg(feature = "bus")]
    pub(crate) decode_reply: Decode<R>,
    pub(super) message: PhantomData<fn() -> (Q, R)>,
}

// The bus encodes and decodes through the functions that the table's macros write for each message. They are not generic, so encoders and
// decoders are compiled once, with this crate, and not again in every crate that uses the message.

/// Encodes a message in its writer's encoding.
#[cfg(feature = "bus")]
pub(crate) type Encode<T> = fn(&T) -> Result<Vec<u8>, CodecError>;

/// Encodes a message in either encoding.
#[cfg(feature = "bus")]
pub(crate) type EncodeAs<T> = fn(&T, Encoding) -> Result<Vec<u8>, CodecError>;

/// Decodes a message of at most this many bytes.
#[cfg(feature = "bus")]
pub(crate) type Decode<T> = fn(&[u8], Encoding, usize) -> Result<T, CodecError>;

/// A topic without the type of its message.
#[cfg(feature = "bus")]
#[derive(Clone, Copy, Debug)]
pub(crate) struct Untyped {
    pub(crate) pattern: &'static str,
    pub(crate) qos: Qos,
    pub(crate) rate: Option<u16>,
    pub(crate) max_bytes: usize,
    pub(crate) encoding: Encoding,
}

#[cfg(feature = "bus")]
impl Untyped {
    /// As [`Topic::key`].
    pub(crate) fn key(&self, chunks: &[&str]) -> String {
        fill(self.pattern, chunks)
    }
}

// Not derived: a derive would require `T: Copy` of the message.
impl<T> Clone for Topic<T> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<T> Copy for Topic<T> {}
impl<Q, R> Clone for Ask<Q, R> {
    fn clone(&self) -> Self {
        *self
    }
}
impl<Q, R> Copy for Ask<Q, R> {}

impl<T> Topic<T> {
    /// The key, with its named chunks filled in order; a chunk may be `*`.
    ///
    /// ```
    /// use zenav_protocol::topics::{GOAL_STATE, SCAN};
    ///
    /// assert_eq!(SCAN.key(&["tiago"]), "zenav/tiago/edge/scan");
    /// assert_eq!(GOAL_STATE.key(&["tiago", "*"]), "zenav/tiago/cloud/goal/*", "all goals of a robot");
    /// ```
    #[must_use]
    pub fn key(&self, chunks: &[&str]) -> String {
        fill(self.pattern, chunks)
    }

    /// The chunks of a concrete key at this pattern's names; empty for a key of another topic.
    ///
    /// ```
    /// use zenav_protocol::topics::{GOAL_STATE, PLAN};
    ///
    /// let key = "zenav/tiago/cloud/goal/tea-1";
    /// assert_eq!(GOAL_STATE.chunks(key), ["tiago", "tea-1"]);
    /// assert!(PLAN.chunks(key).is_empty());
    /// ```
    #[must_use]
    pub fn chunks(&self, key: &str) -> Vec<String> {
        owned_chunks(self.pattern, key)
    }

    /// The same topic without a rate, for benches: they publish faster than any robot.
    #[must_use]
    pub fn without_rate(self) -> Self {
        Self { rate: None, ..self }
    }

    /// Encodes a message in the writer's encoding.
    ///
    /// # Errors
    /// [`CodecError::Unencodable`] if the encoding cannot represent the message.
    #[cfg(feature = "bus")]
    pub fn encode(&self, message: &T) -> Result<Vec<u8>, CodecError> {
        (self.encode)(message)
    }

    /// Decodes a message.
    ///
    /// # Errors
    /// [`CodecError`] if it is larger than the key allows, or malformed.
    #[cfg(feature = "bus")]
    pub fn decode(&self, bytes: &[u8], encoding: Encoding) -> Result<T, CodecError> {
        (self.decode)(bytes, encoding, self.max_bytes)
    }

    #[cfg(feature = "bus")]
    pub(crate) fn untyped(&self) -> Untyped {
        Untyped {
            pattern: self.pattern,
            qos: self.qos,
            rate: self.rate,
            max_bytes: self.max_bytes,
            encoding: self.encoding,
        }
    }
}

impl<Q, R> Ask<Q, R> {
    /// The key, with its named chunks filled in order; a chunk may be `*`.
    #[must_use]
    pub fn key(&self, chunks: &[&str]) -> String {
        fill(self.pattern, chunks)
    }

    /// The chunks of a concrete key at this pattern's names; empty for a key of another ask.
    #[must_use]
    pub fn chunks(&self, key: &str) -> Vec<String> {
        owned_chunks(self.pattern, key)
    }

    /// Decodes a reply of any size.
    ///
    /// # Errors
    /// [`CodecError::Malformed`].
    #[cfg(feature = "bus")]
    pub fn decode_reply(&self, bytes: &[u8], encoding: Encoding) -> Result<R, CodecError> {
        (self.decode_reply)(bytes, encoding, usize::MAX)
    }
}

/// All asks that one component serves, as one request type and one reply type: the input and output of the component's core.
pub trait PartAsks: Clone + Debug + Send + Sync + 'static {
    /// The replies, with a variant of the same name for each request.
    type Reply: Debug + Send + 'static;

    /// Passes every ask of the component to `visitor`, in the order of the table.
    ///
    /// # Errors
    /// The visitor's first error.
    fn visit<V: AskVisitor<Self>>(visitor: &mut V) -> Result<(), V::Error>;
}

/// Visitor of all asks of a component; the bus uses it to declare a server for each.
pub trait AskVisitor<P: PartAsks> {
    /// Error that ends the visit.
    type Error;

    /// Visits one ask. `request` wraps a request into the core's type; `reply` unwraps the reply (`None`: the reply belongs to another
    /// ask).
    ///
    /// # Errors
    /// Ends the visit.
    fn visit<Q, R>(
        &mut self,
        ask: Ask<Q, R>,
        request: fn(Q) -> P,
        reply: fn(P::Reply) -> Option<R>,
    ) -> Result<(), Self::Error>
    where
        Q: DeserializeOwned + Send + Sync + 'static,
        R: Serialize + Send + Sync + 'static;
}

/// Bounds that every message of the table meets.
#[cfg(feature = "schema")]
pub trait Message: Serialize + DeserializeOwned + schemars::JsonSchema {}
#[cfg(feature = "schema")]
impl<T: Serialize + DeserializeOwned + schemars::JsonSchema> Message for T {}

/// Bounds that every message of the table meets.
#[cfg(not(feature = "schema"))]
pub trait Message: Serialize + DeserializeOwned {}
#[cfg(not(feature = "schema"))]
impl<T: Serialize + DeserializeOwned> Message for T {}

/// Visitor of every row of the table with its types, for tools that identify a message by its key alone.
pub trait TableVisitor {
    /// A topic and the name of its message.
    fn topic<T: Message>(&mut self, topic: Topic<T>, message: &'static str);

    /// An ask and the names of its request and reply.
    fn ask<Q: Message, R: Message>(&mut self, ask: Ask<Q, R>, request: &'static str, reply: &'static str);
}

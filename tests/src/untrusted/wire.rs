//! Messages. The same bytes as the message of every row of the key table, in both encodings.

#![allow(
    clippy::expect_used,
    reason = "an accepted message that cannot be encoded is a finding"
)]

use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{Annotations, MapPatch, MapReply, Scan};
use zenav_protocol::topics::{self, Ask, Message, TableVisitor, Topic};
use zenav_space::Zones;

/// Golden messages, one a line: name and JSON.
const GOLDEN: &str = include_str!("../../../protocol/tests/wire.golden");
/// Largest reply that is decoded, bytes, as in the bus.
const MAX_REPLY: usize = 64 << 20;

/// Name and JSON of a message of every kind, several of some.
pub(super) fn golden() -> impl Iterator<Item = (&'static str, &'static str)> {
    GOLDEN.lines().filter_map(|line| line.split_once(' '))
}

/// The golden messages, as JSON and as CBOR.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let json = golden().map(|(_, json)| json.as_bytes().to_vec());
    let mut encoder = Encoder(Vec::new());
    topics::visit_table(&mut encoder);
    json.chain(encoder.0).collect()
}

/// Decodes the bytes as every message, and gives maps, scans and zones to the code that uses them.
///
/// # Panics
/// When an accepted message cannot be encoded, or changes by being encoded and decoded.
pub fn exercise(bytes: &[u8]) -> usize {
    let mut decoder = Decoder { bytes, taken: 0 };
    topics::visit_table(&mut decoder);
    use_contents(bytes);
    decoder.taken
}

/// Decodes the same bytes as one type after the other.
struct Decoder<'a> {
    bytes: &'a [u8],
    taken: usize,
}

impl Decoder<'_> {
    fn read<T: Message>(&mut self, name: &str, max_bytes: usize) {
        for encoding in [Encoding::Json, Encoding::Cbor] {
            let Ok(message) = codec::decode::<T>(self.bytes, encoding, max_bytes) else {
                continue;
            };
            self.taken += 1;
            let encoded = codec::encode(&message, Encoding::Cbor).expect(name);
            // Refused only if it is nested deeper than CBOR may be.
            if let Ok(again) = codec::decode::<T>(&encoded, Encoding::Cbor, usize::MAX) {
                let twice = codec::encode(&again, Encoding::Cbor).expect(name);
                assert_eq!(encoded, twice, "{name}");
            }
            // Numbers that are not finite become null, which not every field may be.
            let text = codec::encode(&message, Encoding::Json).expect(name);
            let _ = codec::decode::<T>(&text, Encoding::Json, usize::MAX);
        }
    }
}

impl TableVisitor for Decoder<'_> {
    fn topic<T: Message>(&mut self, topic: Topic<T>, message: &'static str) {
        self.read::<T>(message, topic.max_bytes);
    }

    fn ask<Q: Message, R: Message>(&mut self, ask: Ask<Q, R>, request: &'static str, reply: &'static str) {
        self.read::<Q>(request, ask.max_bytes);
        self.read::<R>(reply, MAX_REPLY);
    }
}

/// Encodes the golden messages as CBOR.
struct Encoder(Vec<Vec<u8>>);

impl Encoder {
    fn write<T: Message>(&mut self, name: &str) {
        let named = golden().filter(|(known, _)| *known == name);
        self.0.extend(named.filter_map(|(_, json)| {
            let message: T = codec::decode(json.as_bytes(), Encoding::Json, MAX_REPLY).ok()?;
            codec::encode(&message, Encoding::Cbor).ok()
        }));
    }
}

impl TableVisitor for Encoder {
    fn topic<T: Message>(&mut self, _: Topic<T>, message: &'static str) {
        self.write::<T>(message);
    }

    fn ask<Q: Message, R: Message>(&mut self, _: Ask<Q, R>, request: &'static str, reply: &'static str) {
        self.write::<Q>(request);
        self.write::<R>(reply);
    }
}

/// Uses the contents of messages whose numbers decide over memory and geometry.
fn use_contents(bytes: &[u8]) {
    for encoding in [Encoding::Json, Encoding::Cbor] {
        if let Ok(patch) = codec::decode::<MapPatch>(bytes, encoding, topics::MAP_PATCH.max_bytes) {
            let mut replica = MapReplica::new();
            let _ = replica.apply(&patch);
            // The same map goes on from there.
            let _ = replica.apply(&patch);
        }
        if let Ok(reply) = codec::decode::<MapReply>(bytes, encoding, MAX_REPLY) {
            let _ = reply.grid();
        }
        if let Ok(scan) = codec::decode::<Scan>(bytes, encoding, topics::SCAN.max_bytes) {
            let _ = Mapper::new(MappingSettings::default(), "fuzz").insert(&scan);
        }
        if let Ok(annotations) = codec::decode::<Annotations>(bytes, encoding, topics::ANNOTATIONS.max_bytes) {
            let _ = Zones::new(&annotations.zones);
        }
    }
}

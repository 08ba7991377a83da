//! Messages. The same bytes as the message of every row of the key table, of remote actions, and as a refusal, in both encodings.

#![allow(
    clippy::expect_used,
    reason = "an accepted message that cannot be encoded is a finding"
)]

use serde::de::IgnoredAny;
use zenav_gateway::{Client, FleetView, Update};
use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::codec::{self, Encoding};
use zenav_protocol::map_replica::MapReplica;
use zenav_protocol::messages::{MapReply, Refusal};
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

/// Decodes the bytes as every message, gives maps, scans and zones to the code that uses them, and shows the rest to a browser.
///
/// # Panics
/// When an accepted message cannot be encoded, or changes by being encoded and decoded; when a frame for a browser is not JSON.
pub fn exercise(bytes: &[u8]) -> usize {
    let mut decoder = Decoder { bytes, taken: 0 };
    topics::visit_table(&mut decoder);
    decoder.ask(topics::REMOTE_ACTION, "RemoteRequest", "RemoteReply");
    decoder.read::<Refusal>("Refusal", MAX_REPLY);
    if decoder.taken > 0 {
        for encoding in [Encoding::Json, Encoding::Cbor] {
            use_contents(bytes, encoding);
            show(bytes, encoding);
        }
    }
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
fn use_contents(bytes: &[u8], encoding: Encoding) {
    if let Some(patch) = read(bytes, encoding, &topics::MAP_PATCH) {
        let mut replica = MapReplica::new();
        let _ = replica.apply(&patch);
        // The same map goes on from there.
        let _ = replica.apply(&patch);
    }
    if let Ok(reply) = codec::decode::<MapReply>(bytes, encoding, MAX_REPLY) {
        let _ = reply.grid();
    }
    if let Some(scan) = read(bytes, encoding, &topics::SCAN) {
        let _ = Mapper::new(MappingSettings::default(), "fuzz").insert(&scan);
    }
    if let Some(annotations) = read(bytes, encoding, &topics::ANNOTATIONS) {
        let _ = Zones::new(&annotations.zones);
    }
}

/// Shows the message to a browser that watches the robot: frames are JSON.
fn show(bytes: &[u8], encoding: Encoding) {
    let updates = [
        read(bytes, encoding, &topics::STATE).map(Update::State),
        read(bytes, encoding, &topics::POSE).map(Update::Pose),
        read(bytes, encoding, &topics::SCAN).map(|scan| Update::Scan("rear".to_owned(), scan)),
        read(bytes, encoding, &topics::PLAN).map(Update::Plan),
        read(bytes, encoding, &topics::MISSION).map(Update::Mission),
        read(bytes, encoding, &topics::GOAL_STATE).map(Update::Goal),
        read(bytes, encoding, &topics::EVENT).map(Update::Event),
        read(bytes, encoding, &topics::MARKER).map(Update::Marker),
        read(bytes, encoding, &topics::OBSTACLES).map(Update::Obstacles),
        read(bytes, encoding, &topics::TREE).map(Update::Tree),
        codec::decode(bytes, encoding, MAX_REPLY).ok().map(Update::Motion),
        read(bytes, encoding, &topics::GRAPH).map(Update::Graph),
        read(bytes, encoding, &topics::MAP_PATCH).map(Update::Patch),
        read(bytes, encoding, &topics::ANNOTATIONS).map(Update::Annotations),
        read(bytes, encoding, &topics::LOCALISATION).map(Update::Localisation),
        codec::decode(bytes, encoding, MAX_REPLY).ok().map(Update::Map),
        codec::decode(bytes, encoding, MAX_REPLY).ok().map(Update::Info),
    ];
    let (mut view, mut client) = (FleetView::new(), Client::new());
    client.watch(Some("fuzz".to_owned()));
    for update in updates.into_iter().flatten() {
        view.take("fuzz", update, 1.0);
    }
    let text = client.frame(&view, 1.0, true).text.unwrap_or_default();
    serde_json::from_str::<IgnoredAny>(&text).expect("JSON");
}

fn read<T: Message>(bytes: &[u8], encoding: Encoding, topic: &Topic<T>) -> Option<T> {
    codec::decode(bytes, encoding, topic.max_bytes).ok()
}

//! Wire format. Does every message still have the same form on the wire?
//!
//! Each line of `wire.golden` is the name of a message and its JSON. A line must decode, and encode to the same bytes again. A change of a
//! line is a change of the contract: unless it only adds an optional field, it raises `SCHEMA_VERSION`. To regenerate the lines:
//! `ZENAV_WRITE_GOLDEN=1 cargo test -p zenav-protocol --test wire`, and read the diff.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

use std::collections::BTreeSet;
use std::path::Path;

use serde::Serialize;
use serde::de::DeserializeOwned;
use zenav_protocol::codec::{CodecError, Encoding, decode, encode};
use zenav_protocol::messages::{
    AnnotateRequest, Annotations, AttachReply, AttachRequest, Battery, BehaviourReply, BehaviourRequest, Bump,
    CancelRequest, Correction, EdgeState, Event, GoalReply, GoalRequest, GoalState, GoalsReply, GoalsRequest,
    Heartbeat, Imu, InfoReply, InfoRequest, Intent, JoinReply, JoinRequest, JournalEntry, JournalReply, LeaseReply,
    LeaseRequest, Localisation, LocaliseReply, LocaliseRequest, LogReply, LogRequest, MapFrame, MapInfo, MapPatch,
    MapReply, MapRequest, MappingLeader, Marker, MissionStatus, ModeReply, ModeRequest, MotionRecord, MotionReply,
    MotionRequest, MoveGoalRequest, Obstacles, Odometry, ParamReply, ParamRequest, PauseRequest, Plan, PoseEstimate,
    PoseGraph, Refusal, RemoteReply, RemoteRequest, ResumeRequest, Scan, SchemaReply, SchemaRequest, SearchTree,
    SimClock, StopReply, StopRequest, Teleop, Tile, WheelSpeeds, Yield,
};
use zenav_protocol::readings::Readings;
use zenav_protocol::topics::TABLE;

const LIMIT: usize = 1 << 20;

/// Decodes a message and encodes it again, in JSON directly, and through CBOR.
fn round_trips<T: Serialize + DeserializeOwned>(json: &str) -> Result<[String; 2], CodecError> {
    let message: T = decode(json.as_bytes(), Encoding::Json, LIMIT)?;
    let cbor: T = decode(&encode(&message, Encoding::Cbor)?, Encoding::Cbor, LIMIT)?;
    let text =
        |message: &T| encode(message, Encoding::Json).map(|bytes| String::from_utf8(bytes).expect("JSON is text"));
    Ok([text(&message)?, text(&cbor)?])
}

macro_rules! messages {
    ([$($name:ident)*]
     $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        fn round_trips_of(name: &str, json: &str) -> Result<[String; 2], CodecError> {
            match name {
                $(stringify!($name) => round_trips::<$name>(json),)*
                $(stringify!($Reading) => round_trips::<zenav_protocol::sensors::$Reading>(json),)*
                _ => panic!("`{name}` is no message: add it to `messages!`"),
            }
        }
    };
}

zenav_protocol::sensor_kinds!(messages [
    Readings
    WheelSpeeds
    Scan
    Odometry
    Imu
    Bump
    Battery
    PoseEstimate
    EdgeState
    Event
    Obstacles
    Intent
    Yield
    Marker
    MapInfo
    MapPatch
    MapFrame
    PoseGraph
    MappingLeader
    Correction
    Heartbeat
    Plan
    SearchTree
    MotionRecord
    MissionStatus
    GoalState
    Teleop
    SimClock
    GoalRequest
    GoalReply
    CancelRequest
    PauseRequest
    MoveGoalRequest
    GoalsRequest
    GoalsReply
    MapRequest
    MapReply
    Annotations
    AnnotateRequest
    Localisation
    LocaliseReply
    LocaliseRequest
    LogRequest
    LogReply
    InfoRequest
    InfoReply
    JoinRequest
    JoinReply
    JournalEntry
    JournalReply
    LeaseRequest
    LeaseReply
    StopRequest
    StopReply
    ResumeRequest
    ModeRequest
    ModeReply
    ParamRequest
    ParamReply
    BehaviourRequest
    BehaviourReply
    MotionRequest
    MotionReply
    AttachRequest
    AttachReply
    SchemaRequest
    SchemaReply
    RemoteRequest
    RemoteReply
    Refusal
]);

#[test]
fn every_message_looks_as_it_always_did() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/wire.golden");
    let golden = std::fs::read_to_string(&path).unwrap();
    let write = std::env::var_os("ZENAV_WRITE_GOLDEN").is_some();
    let mut written = String::new();
    let mut differ = Vec::new();
    for line in golden.lines() {
        let (name, json) = line.split_once(' ').expect("a name and its JSON");
        match round_trips_of(name, json) {
            Ok([text, by_cbor]) => {
                assert_eq!(by_cbor, text, "{name}: CBOR loses something");
                if text != json {
                    differ.push(format!("  was {line}\n  now {name} {text}"));
                }
                written.push_str(&format!("{name} {text}\n"));
            }
            Err(error) => {
                differ.push(format!("  {line}\n  does not decode: {error}"));
                written.push_str(&format!("{line}\n"));
            }
        }
    }
    if write {
        std::fs::write(&path, written).unwrap();
    }
    assert!(write || differ.is_empty(), "the wire changed:\n{}", differ.join("\n"));
    let names: BTreeSet<&str> = golden.lines().filter_map(|line| line.split(' ').next()).collect();
    for message in TABLE.iter().flat_map(|row| row.message.split(" -> ")) {
        assert!(names.contains(message), "`{message}` has no line in {}", path.display());
    }
}

#[test]
fn what_a_person_types_is_enough() {
    for (name, json) in [
        ("GoalRequest", r#"{"x": 0.88, "y": 0.09}"#),
        ("GoalRequest", r#"{"place": "sink"}"#),
        ("CancelRequest", "{}"),
        ("MapRequest", r#"{"action": "reset", "epoch": 7}"#),
        ("AnnotateRequest", r#"{"action": "clear_zones", "epoch": 7}"#),
        ("StopRequest", "{}"),
        (
            "BehaviourRequest",
            r#"{"id": "e1", "action": {"spin": {"angle": 1.57}}, "epoch": 7}"#,
        ),
        (
            "LeaseRequest",
            r#"{"holder": "anna", "role": "operator", "request_id": "r1", "mood": "calm"}"#,
        ),
    ] {
        assert!(round_trips_of(name, json).is_ok(), "{name} {json}");
    }
}

#[test]
fn the_cells_of_a_tile_are_one_byte_string_in_cbor() {
    let tile = Tile {
        x: 1,
        y: 2,
        values: vec![-1, 0, 100],
    };
    assert_eq!(
        encode(&tile, Encoding::Cbor).unwrap(),
        b"\xa3\x61x\x01\x61y\x02\x66values\x43\xff\x00\x64"
    );
}

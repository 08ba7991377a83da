//! Key table. Which keys exist, and who writes or serves each, with which type and quality of service? This table is the only definition.
//!
//! In `zenav/{robot}/{side}/{name}` the third chunk determines who may write or serve the key, so one access rule covers a side.
//!
//! A new ask is one row here: key, request, reply, server, permitted requesters, size and encoding. A component that serves several asks
//! receives them as one type ([`EdgeRequest`], [`MissionRequest`], [`MappingRequest`]): the row adds a variant, the bus serves it, and the
//! component does not compile until it answers it.

mod pattern;
mod typed;

use std::marker::PhantomData;

#[cfg(feature = "bus")]
use crate::codec::CodecError;
use crate::codec::Encoding;
use crate::messages::{
    AnnotateRequest, Annotations, AttachReply, AttachRequest, Battery, BehaviourReply, BehaviourRequest, Bump,
    CancelRequest, Correction, EdgeState, Event, GoalReply, GoalRequest, GoalState, GoalsReply, GoalsRequest,
    Heartbeat, Imu, InfoReply, InfoRequest, Intent, JoinReply, JoinRequest, JournalEntry, JournalReply, LeaseReply,
    LeaseRequest, Localisation, LocaliseReply, LocaliseRequest, LogReply, LogRequest, MapFrame, MapInfo, MapPatch,
    MapReply, MapRequest, MappingLeader, Marker, MissionStatus, ModeReply, ModeRequest, MotionRecord, MotionReply,
    MotionRequest, MoveGoalRequest, Obstacles, Odometry, ParamReply, ParamRequest, PauseRequest, Plan, PoseEstimate,
    PoseGraph, RemoteReply, RemoteRequest, ResumeRequest, Scan, SchemaReply, SchemaRequest, SearchTree, SimClock,
    StopReply, StopRequest, Teleop, WheelSpeeds, Yield,
};
use crate::readings::Readings;
use pattern::unfill;

pub use pattern::{ALIVE_COMPONENT, ALIVE_WORKER, alive_chunks, alive_key};
pub use typed::{Ask, AskVisitor, Asker, Message, PartAsks, Producer, Qos, TableVisitor, Topic};
#[cfg(feature = "bus")]
pub(crate) use typed::{Decode, Encode, EncodeAs, Untyped};

/// One line of the key table.
#[derive(Clone, Copy, Debug)]
pub struct Row {
    /// Key with named chunks.
    pub pattern: &'static str,
    /// Message type, or request and reply.
    pub message: &'static str,
    /// Who writes or serves it.
    pub producer: Producer,
    /// Quality of service of a topic; `None` for an ask.
    pub qos: Option<Qos>,
    /// Most messages a second of one writer on one key; `None` for an ask, and for a topic that is never limited.
    pub rate: Option<u16>,
    /// Permitted requesters; `None` for a topic.
    pub asked_by: Option<Asker>,
    /// Largest payload that is decoded, bytes.
    pub max_bytes: usize,
}

const KIB: usize = 1024;
const MIB: usize = 1024 * KIB;

/// Rate of what a robot publishes at most once in a control tick, of 20 ms by default.
const TICKS: Option<u16> = Some(250);

/// JSON unless the table says otherwise.
macro_rules! encoding {
    () => {
        Encoding::Json
    };
    ($encoding:ident) => {
        Encoding::$encoding
    };
}

/// Encodes a message of the table in the encoding of its writer.
#[cfg(feature = "bus")]
macro_rules! encoder {
    ($message:ty) => {
        encoder!($message, Json)
    };
    ($message:ty, Json) => {{
        #[inline(never)]
        fn encode(message: &$message) -> Result<Vec<u8>, CodecError> {
            crate::codec::encode_json(message)
        }
        encode
    }};
    ($message:ty, Cbor) => {{
        #[inline(never)]
        fn encode(message: &$message) -> Result<Vec<u8>, CodecError> {
            crate::codec::encode_cbor(message)
        }
        encode
    }};
}

/// Encodes a message of the table in either encoding.
#[cfg(feature = "bus")]
macro_rules! encoder_as {
    ($message:ty) => {{
        #[inline(never)]
        fn encode_as(message: &$message, encoding: Encoding) -> Result<Vec<u8>, CodecError> {
            crate::codec::encode(message, encoding)
        }
        encode_as
    }};
}

/// Decodes a message of the table.
#[cfg(feature = "bus")]
macro_rules! decoder {
    ($message:ty) => {{
        #[inline(never)]
        fn decode(bytes: &[u8], encoding: Encoding, max_bytes: usize) -> Result<$message, CodecError> {
            crate::codec::decode(bytes, encoding, max_bytes)
        }
        decode
    }};
}

macro_rules! key_table {
    // The topics of the sensor table go between the topics listed here.
    ([{ $($before:tt)* } sensors { $($after:tt)* } $($rest:tt)*]
     $($(#[doc = $doc:literal])* $(#[serde $serde:tt])* $kind:ident: $Model:ident => $Reading:ident, $TOPIC:ident = $key:literal;)*) => {
        $(use crate::sensors::$Reading;)*

        key_table! {
            topics { $($before)* $($TOPIC: $Reading = $key, Edge, Qos::Latest, TICKS, 4 * KIB;)* $($after)* }
            $($rest)*
        }
    };
    (topics { $($topic:ident: $message:ty = $pattern:literal, $producer:ident, $qos:expr, $rate:expr, $max:expr $(, $encoding:ident)?;)* }
     $(part $server:ident, $Request:ident => $Reply:ident {
        $($part_ask:ident, $variant:ident: $part_request:ty => $part_reply:ty = $part_pattern:literal, $part_asker:ident, $part_max:expr $(, $part_encoding:ident)?;)*
     })*
     asks { $($ask:ident: $request:ty => $reply:ty = $ask_pattern:literal, $ask_server:ident, $asker:ident, $ask_max:expr $(, $reply_encoding:ident)?;)* }) => {
        $(
            #[doc = concat!("`", $pattern, "`: ", stringify!($message), ", written by ", stringify!($producer), ".")]
            pub const $topic: Topic<$message> = Topic {
                pattern: $pattern,
                qos: $qos,
                rate: $rate,
                max_bytes: $max,
                encoding: encoding!($($encoding)?),
                #[cfg(feature = "bus")]
                encode: encoder!($message $(, $encoding)?),
                #[cfg(feature = "bus")]
                decode: decoder!($message),
                message: PhantomData,
            };
        )*
        $(
            $(ask!($part_ask: $part_request => $part_reply = $part_pattern, $server, $part_max $(, $part_encoding)?);)*

            #[doc = concat!("A request to the ", stringify!($server), ", whichever ask it came by.")]
            #[derive(Clone, Debug, PartialEq)]
            #[allow(clippy::large_enum_variant, reason = "a few at a time, moved twice")]
            pub enum $Request {
                $(
                    #[doc = concat!("`", $part_pattern, "`.")]
                    $variant($part_request),
                )*
            }

            #[doc = concat!("The reply of the ", stringify!($server), " to the [`", stringify!($Request), "`] of the same name.")]
            #[derive(Clone, Debug, PartialEq)]
            #[allow(clippy::large_enum_variant, reason = "a few at a time, moved twice")]
            pub enum $Reply {
                $(
                    #[doc = concat!("Answers `", $part_pattern, "`.")]
                    $variant($part_reply),
                )*
            }

            impl PartAsks for $Request {
                type Reply = $Reply;

                fn visit<V: AskVisitor<Self>>(visitor: &mut V) -> Result<(), V::Error> {
                    $(visitor.visit($part_ask, Self::$variant, |reply| match reply {
                        $Reply::$variant(reply) => Some(reply),
                        _ => None,
                    })?;)*
                    Ok(())
                }
            }
        )*
        $(ask!($ask: $request => $reply = $ask_pattern, $ask_server, $ask_max $(, $reply_encoding)?);)*

        /// Shows every row of the table to a visitor, in the order of [`TABLE`].
        pub fn visit_table(visitor: &mut impl TableVisitor) {
            $(visitor.topic($topic, stringify!($message));)*
            $($(visitor.ask($part_ask, stringify!($part_request), stringify!($part_reply));)*)*
            $(visitor.ask($ask, stringify!($request), stringify!($reply));)*
        }

        /// Every topic and ask, in the order of the data way.
        pub const TABLE: &[Row] = &[
            $(Row { pattern: $pattern, message: stringify!($message), producer: Producer::$producer, qos: Some($qos), rate: $rate, asked_by: None, max_bytes: $max },)*
            $($(Row { pattern: $part_pattern, message: concat!(stringify!($part_request), " -> ", stringify!($part_reply)), producer: Producer::$server, qos: None, rate: None, asked_by: Some(Asker::$part_asker), max_bytes: $part_max },)*)*
            $(Row { pattern: $ask_pattern, message: concat!(stringify!($request), " -> ", stringify!($reply)), producer: Producer::$ask_server, qos: None, rate: None, asked_by: Some(Asker::$asker), max_bytes: $ask_max },)*
        ];
    };
}

macro_rules! ask {
    ($ask:ident: $request:ty => $reply:ty = $pattern:literal, $server:ident, $max:expr $(, $encoding:ident)?) => {
        #[doc = concat!("`", $pattern, "`: ", stringify!($request), " answered with ", stringify!($reply), " by ", stringify!($server), ".")]
        pub const $ask: Ask<$request, $reply> = ask!($request => $reply = $pattern, $max $(, $encoding)?);
    };
    ($request:ty => $reply:ty = $pattern:literal, $max:expr $(, $encoding:ident)?) => {
        Ask {
            pattern: $pattern,
            max_bytes: $max,
            reply_encoding: encoding!($($encoding)?),
            #[cfg(feature = "bus")]
            encode_request: encoder!($request),
            #[cfg(feature = "bus")]
            decode_request: decoder!($request),
            #[cfg(feature = "bus")]
            encode_reply: encoder_as!($reply),
            #[cfg(feature = "bus")]
            decode_reply: decoder!($reply),
            message: PhantomData,
        }
    };
}

crate::sensor_kinds!(key_table [
    {
        READINGS: Readings = "zenav/{robot}/body/readings", Body, Qos::RealTime, TICKS, 256 * KIB;
        WHEELS: WheelSpeeds = "zenav/{robot}/edge/wheels", Edge, Qos::RealTime, None, KIB;
        SCAN: Scan = "zenav/{robot}/edge/scan", Edge, Qos::Latest, Some(50), 256 * KIB;
        LIDAR_SCAN: Scan = "zenav/{robot}/edge/scan/{lidar}", Edge, Qos::Latest, Some(50), 256 * KIB;
        ODOMETRY: Odometry = "zenav/{robot}/edge/odometry", Edge, Qos::Latest, TICKS, 4 * KIB;
        IMU: Imu = "zenav/{robot}/edge/imu", Edge, Qos::Latest, TICKS, 4 * KIB;
    }
    sensors {
        BUMP: Bump = "zenav/{robot}/edge/bump", Edge, Qos::Latest, TICKS, 4 * KIB;
        BATTERY: Battery = "zenav/{robot}/edge/battery", Edge, Qos::Latest, Some(10), 4 * KIB;
        POSE: PoseEstimate = "zenav/{robot}/edge/pose", Edge, Qos::Latest, TICKS, 4 * KIB;
        STATE: EdgeState = "zenav/{robot}/edge/state", Edge, Qos::Latest, Some(50), 16 * KIB;
        EVENT: Event = "zenav/{robot}/edge/event", Edge, Qos::Events { cache: 256 }, Some(50), 16 * KIB;
        OBSTACLES: Obstacles = "zenav/{robot}/edge/obstacles", Edge, Qos::Latest, Some(50), 64 * KIB;
        INTENT: Intent = "zenav/{robot}/edge/intent", Edge, Qos::Latest, Some(50), 16 * KIB;
        YIELD: Yield = "zenav/{robot}/edge/yield", Edge, Qos::Latest, Some(5), 256 * KIB;
        MARKER: Marker = "zenav/{robot}/edge/marker", Edge, Qos::Latest, Some(50), 64 * KIB;
        MAP_INFO: MapInfo = "zenav/{robot}/cloud/map", Mapping, Qos::State, Some(100), 16 * KIB;
        MAP_PATCH: MapPatch = "zenav/{robot}/cloud/map_patch", Mapping, Qos::Events { cache: 4 }, Some(100), 64 * MIB, Cbor;
        MAP_FRAME: MapFrame = "zenav/{robot}/cloud/frame", Mapping, Qos::State, Some(20), MIB;
        ANNOTATIONS: Annotations = "zenav/{robot}/cloud/annotations", Mapping, Qos::State, Some(20), 4 * MIB;
        CORRECTION: Correction = "zenav/{robot}/cloud/correction", Mapping, Qos::Latest, Some(100), 4 * KIB;
        LOCALISATION: Localisation = "zenav/{robot}/cloud/localisation", Mapping, Qos::State, Some(100), 16 * KIB;
        GRAPH: PoseGraph = "zenav/{robot}/cloud/graph", Mapping, Qos::Latest, Some(1), 4 * MIB;
        MAPPING_LEADER: MappingLeader = "zenav/{robot}/cloud/mapping", Mapping, Qos::Latest, Some(50), 4 * KIB;
        HEARTBEAT: Heartbeat = "zenav/{robot}/cloud/heartbeat", Holder, Qos::RealTime, None, 4 * KIB;
        PLAN: Plan = "zenav/{robot}/cloud/plan", Mission, Qos::State, Some(50), 4 * MIB;
        TREE: SearchTree = "zenav/{robot}/cloud/tree", Motion, Qos::Latest, Some(50), 4 * MIB;
        MOTION: MotionRecord = "zenav/{robot}/cloud/motion", Motion, Qos::Events { cache: 16 }, Some(50), 8 * MIB;
        MISSION: MissionStatus = "zenav/{robot}/cloud/mission", Mission, Qos::State, Some(50), 4 * MIB;
        GOAL_STATE: GoalState = "zenav/{robot}/cloud/goal/{id}", Mission, Qos::State, Some(50), 2 * MIB;
        TELEOP: Teleop = "zenav/{robot}/operator/teleop", Operator, Qos::RealTime, Some(100), 4 * KIB;
        SIM_CLOCK: SimClock = "zenav/sim/clock", Sim, Qos::Latest, None, KIB;
    }
    part Edge, EdgeRequest => EdgeReply {
        LEASE, Lease: LeaseRequest => LeaseReply = "zenav/{robot}/ask/edge/lease", Operator, 16 * KIB;
        STOP, Stop: StopRequest => StopReply = "zenav/{robot}/ask/edge/stop", Operator, 16 * KIB;
        RESUME, Resume: ResumeRequest => StopReply = "zenav/{robot}/ask/edge/resume", Operator, 16 * KIB;
        MODE, Mode: ModeRequest => ModeReply = "zenav/{robot}/ask/edge/mode", Operator, 16 * KIB;
        PARAM, Param: ParamRequest => ParamReply = "zenav/{robot}/ask/edge/param", Operator, 16 * KIB;
        BEHAVIOUR, Behaviour: BehaviourRequest => BehaviourReply = "zenav/{robot}/ask/edge/behaviour", Operator, 16 * KIB;
        EDGE_INFO, Info: InfoRequest => InfoReply = "zenav/{robot}/ask/edge/info", Viewer, 4 * KIB;
    }
    part Mission, MissionRequest => MissionReply {
        GOAL, Goal: GoalRequest => GoalReply = "zenav/{robot}/ask/cloud/goal", Operator, MIB;
        CANCEL, Cancel: CancelRequest => GoalReply = "zenav/{robot}/ask/cloud/cancel", Operator, 16 * KIB;
        PAUSE, Pause: PauseRequest => GoalReply = "zenav/{robot}/ask/cloud/pause", Operator, 16 * KIB;
        MOVE_GOAL, MoveGoal: MoveGoalRequest => GoalReply = "zenav/{robot}/ask/cloud/move_goal", Operator, 16 * KIB;
        GOALS, Goals: GoalsRequest => GoalsReply = "zenav/{robot}/ask/cloud/goals", Viewer, 16 * KIB;
        CLOUD_INFO, Info: InfoRequest => InfoReply = "zenav/{robot}/ask/cloud/info", Viewer, 4 * KIB;
        JOIN, Join: JoinRequest => JoinReply = "zenav/{robot}/ask/cloud/join", Service, 4 * MIB;
    }
    part Mapping, MappingRequest => MappingReply {
        MAP, Map: MapRequest => MapReply = "zenav/{robot}/ask/cloud/map", Operator, 64 * MIB, Cbor;
        LOCALISE, Localise: LocaliseRequest => LocaliseReply = "zenav/{robot}/ask/cloud/localise", Operator, 4 * KIB;
        ANNOTATE, Annotate: AnnotateRequest => Annotations = "zenav/{robot}/ask/cloud/annotate", Operator, MIB;
    }
    asks {
        JOURNAL: JournalEntry => JournalReply = "zenav/{robot}/ask/cloud/journal/{store}", Mission, Service, 16 * MIB;
        MOTION_SERVICE: MotionRequest => MotionReply = "zenav/svc/motion/{worker}", Motion, Service, 4 * MIB;
        EDGE_LOG: LogRequest => LogReply = "zenav/{robot}/ask/edge/log", Edge, Operator, 4 * KIB;
        PART_LOG: LogRequest => LogReply = "zenav/svc/log/{part}", Part, Operator, 4 * KIB;
        PART_INFO: InfoRequest => InfoReply = "zenav/svc/info/{part}", Part, Viewer, 4 * KIB;
        MESSAGE_SCHEMA: SchemaRequest => SchemaReply = "zenav/svc/schema/{message}", Part, Viewer, 4 * KIB;
        ATTACH: AttachRequest => AttachReply = "zenav/sim/attach", Sim, Robot, 64 * KIB;
    }
]);

/// The row that a concrete key belongs to; `None` for a key outside the table.
///
/// ```
/// use zenav_protocol::topics::{Asker, Producer, row_of};
///
/// let plan = row_of("zenav/tiago/cloud/plan").unwrap();
/// assert_eq!((plan.message, plan.producer), ("Plan", Producer::Mission));
/// let stop = row_of("zenav/tiago/ask/edge/stop").unwrap();
/// assert_eq!((stop.message, stop.asked_by), ("StopRequest -> StopReply", Some(Asker::Operator)));
/// assert!(row_of("zenav/tiago/edge/plan").is_none());
/// ```
#[must_use]
pub fn row_of(key: &str) -> Option<&'static Row> {
    TABLE.iter().find(|row| unfill(row.pattern, key).is_some())
}

/// The server of a tree's `RemoteAction` chooses its own key, which is the single chunk here; the key is not part of the table.
pub const REMOTE_ACTION: Ask<RemoteRequest, RemoteReply> = ask!(RemoteRequest => RemoteReply = "{server}", 64 * KIB);

/// The key table as Markdown, as in `ARCHITECTURE.md`.
#[must_use]
pub fn table_markdown() -> String {
    let mut text = String::from("| key | message | written or served by | kind | at most |\n|---|---|---|---|---|\n");
    for row in TABLE {
        let kind = match row.qos {
            Some(Qos::Latest) => "plain, drop, latest only".to_owned(),
            Some(Qos::RealTime) => "plain, real-time priority, drop".to_owned(),
            Some(Qos::Events { cache }) => format!("advanced, {cache} kept, gaps recovered"),
            Some(Qos::State) => "advanced, last value kept".to_owned(),
            None => match row.asked_by {
                Some(Asker::Viewer) | None => "ask, by everybody".to_owned(),
                Some(Asker::Operator) => "ask, by operators and services".to_owned(),
                Some(Asker::Service) => "ask, by services".to_owned(),
                Some(Asker::Robot) => "ask, by robots".to_owned(),
            },
        };
        let size = if row.max_bytes >= MIB {
            format!("{} MiB", row.max_bytes / MIB)
        } else {
            format!("{} KiB", row.max_bytes / KIB)
        };
        let rate = row.rate.map_or(String::new(), |rate| format!(", {rate} a second"));
        let producer = format!("{:?}", row.producer).to_lowercase();
        text.push_str(&format!(
            "| `{}` | `{}` | {producer} | {kind} | {size}{rate} |\n",
            row.pattern, row.message
        ));
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_fill_and_unfill() {
        let key = GOAL_STATE.key(&["tiago", "g1"]);
        assert_eq!(key, "zenav/tiago/cloud/goal/g1");
        assert_eq!(GOAL_STATE.chunks(&key), ["tiago", "g1"]);
        assert_eq!(SCAN.key(&["*"]), "zenav/*/edge/scan");
        assert!(SCAN.chunks("zenav/tiago/edge/pose").is_empty());
        assert_eq!(SIM_CLOCK.key(&[]), "zenav/sim/clock");
    }

    #[test]
    fn what_may_be_a_stop_is_never_limited() {
        let unlimited = TABLE.iter().filter(|row| row.qos.is_some() && row.rate.is_none());
        let patterns: Vec<_> = unlimited.map(|row| row.pattern).collect();
        assert_eq!(patterns, [WHEELS.pattern, HEARTBEAT.pattern, SIM_CLOCK.pattern]);
        assert!(TABLE.iter().all(|row| row.qos.is_some() || row.rate.is_none()), "asks");
    }

    #[test]
    fn every_key_stands_once_in_the_table() {
        let mut patterns: Vec<_> = TABLE.iter().map(|row| row.pattern).collect();
        patterns.sort_unstable();
        patterns.dedup();
        assert_eq!(patterns.len(), TABLE.len());
    }
}

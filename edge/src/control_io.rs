//! Control I/O. What goes into one control tick, and what comes out of it? Typed and decoded: there is no bus in here.

use std::mem::discriminant;

use zenav_protocol::messages::{
    Battery, Bump, Correction, EdgeState, Event, Heartbeat, Imu, Intent, Leader, Localisation, Marker, Obstacles,
    Odometry, Plan, PoseEstimate, Refusal, Scan, Teleop, Yield,
};
use zenav_protocol::readings::KindReading;
use zenav_protocol::topics::{EdgeReply, EdgeRequest};

/// Identifies a request, so that its reply reaches the caller.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Ticket(pub u64);

/// What arrived since the last tick, in the order of arrival.
#[derive(Clone, Debug, Default)]
pub struct Inbox {
    /// New and renewed plans.
    pub plans: Vec<Plan>,
    /// Renewals of the lease.
    pub heartbeats: Vec<Heartbeat>,
    /// Teleop twists.
    pub teleops: Vec<Teleop>,
    /// Pose measurements made off board.
    pub corrections: Vec<Correction>,
    /// Off-board reports on whether the robot's pose in the map can be trusted.
    pub localisations: Vec<Localisation>,
    /// The courses that other robots announce.
    pub intents: Vec<Intent>,
    /// Requests that wait for a reply.
    pub requests: Vec<(Ticket, EdgeRequest)>,
    /// Control ticks missed since start.
    pub missed_ticks: u64,
    /// How late this tick began, if measured.
    pub late: Option<std::time::Duration>,
    /// Brake now: the edge shuts down.
    pub halt: bool,
    /// Why the state that must survive a restart is not stored, while it is not.
    pub not_stored: Option<String>,
}

/// State that must survive a restart of the edge.
#[derive(Clone, Debug, Default, PartialEq, Eq, serde::Serialize, serde::Deserialize)]
pub struct Persisted {
    /// The highest epoch ever granted.
    pub epoch: u64,
    /// Whether the stop is latched.
    pub stopped: bool,
    /// Which mission store leads.
    pub leader: Option<Leader>,
}

/// A message to publish.
#[derive(Clone, Debug, PartialEq)]
pub enum Publication {
    /// A scan of the further lidar of this name, or of the main one if there is no name, with the poses at its own stamp.
    Scan(Option<String>, Scan),
    /// Odometry by dead reckoning.
    Odometry(Odometry),
    /// Gyro and compass.
    Imu(Imu),
    /// A reading of any other sensor.
    Sensor(KindReading),
    /// Bumper contact.
    Bump(Bump),
    /// Battery charge and energy drawn.
    Battery(Battery),
    /// The pose estimate.
    Pose(PoseEstimate),
    /// State of the edge.
    State(Box<EdgeState>),
    /// An event of the event log.
    Event(Event),
    /// The tracks of moving obstacles.
    Obstacles(Obstacles),
    /// The course that this robot announces.
    Intent(Intent),
    /// The robots that it gives way to on its plan.
    Yield(Yield),
    /// Shapes to draw.
    Marker(Marker),
}

impl Publication {
    /// Whether a newer message makes this one obsolete. Markers are told apart by name, scans by lidar.
    #[must_use]
    pub fn is_replaced_by(&self, newer: &Self) -> bool {
        match (self, newer) {
            (Self::Marker(old), Self::Marker(new)) => old.name == new.name,
            (Self::Scan(old, _), Self::Scan(new, _)) => old == new,
            (Self::Sensor(old), Self::Sensor(new)) => discriminant(old) == discriminant(new),
            _ => discriminant(self) == discriminant(newer),
        }
    }
}

/// The output of one control tick.
#[derive(Clone, Debug, Default)]
pub struct Outbox {
    /// Wanted wheel speeds (left, right; rad/s).
    pub wheels: [f64; 2],
    /// What to publish, in order.
    pub publications: Vec<Publication>,
    /// What to store **before** the replies go out.
    pub persist: Option<Persisted>,
    /// Replies to requests.
    pub replies: Vec<(Ticket, Result<EdgeReply, Refusal>)>,
    /// The verdict on the plan that was judged, if one was: `accepted`, `renewed` or the kind of the rejection.
    pub verdict: Option<&'static str>,
    /// Time taken by the limiter and the collision monitor.
    pub monitor: std::time::Duration,
}

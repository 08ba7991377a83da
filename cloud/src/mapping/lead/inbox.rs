//! Inbox. What does a leader hear: scans, the robot's state, requests, and what others publish on its keys?

use zenav_protocol::bus::{Bus, BusError, Call, Latest, Received};
use zenav_protocol::messages::{Annotations, EdgeState, Localisation, MapFrame, Scan};
use zenav_protocol::topics::{ANNOTATIONS, LIDAR_SCAN, LOCALISATION, MAP_FRAME, MappingRequest, SCAN, STATE};

use crate::requests::Requests;

/// What arrives from the moment that a service begins to lead, and waits until its map is loaded.
pub(super) struct Waiting {
    scans: Latest<Scan>,
    further_scans: Latest<Scan>,
    states: Latest<EdgeState>,
}

impl Waiting {
    /// # Errors
    /// If the bus is closed, or a key cannot be declared.
    pub(super) fn open(bus: &Bus, robot: &str) -> Result<Self, BusError> {
        let chunks = [robot];
        Ok(Self {
            scans: bus.latest(&SCAN, &chunks)?,
            further_scans: bus.latest(&LIDAR_SCAN, &[robot, "*"])?,
            states: bus.latest(&STATE, &chunks)?,
        })
    }
}

/// All that a leader hears.
pub(super) struct Inbox {
    waiting: Waiting,
    requests: Requests<MappingRequest>,
    // What others are told in the name of this service.
    frames: Latest<MapFrame>,
    annotations: Latest<Annotations>,
    localisations: Latest<Localisation>,
}

/// One thing that a leader hears.
pub(super) enum Heard {
    State(Box<EdgeState>),
    Request(Call<MappingRequest>),
    Scan(Box<Received<Scan>>),
    FurtherScan(Box<Received<Scan>>),
    /// On a key of this service, also by itself.
    Frame(MapFrame),
    /// On a key of this service, also by itself.
    Annotations(Annotations),
    /// On a key of this service, also by itself.
    Localisation(Localisation),
}

impl Inbox {
    /// Once the map, its places and zones are there. Only then are requests served: a change that waited for them would be carried out
    /// after its client has given up. Clients repeat their requests until their own deadline.
    ///
    /// # Errors
    /// If the bus is closed, or a key cannot be declared.
    pub(super) fn open(waiting: Waiting, bus: &Bus, robot: &str) -> Result<Self, BusError> {
        let chunks = [robot];
        Ok(Self {
            waiting,
            requests: Requests::open(bus, robot)?,
            frames: bus.latest(&MAP_FRAME, &chunks)?,
            annotations: bus.latest(&ANNOTATIONS, &chunks)?,
            localisations: bus.latest(&LOCALISATION, &chunks)?,
        })
    }

    /// The next one; `None` once the bus is closed. The robot's state goes before requests: the newest lease decides who may change the
    /// map. Loses nothing if it is dropped.
    pub(super) async fn next(&mut self, takes_scans: bool) -> Option<Heard> {
        let Waiting {
            scans,
            further_scans,
            states,
        } = &mut self.waiting;
        Some(tokio::select! {
            biased;
            state = states.next() => Heard::State(Box::new(state?.message)),
            request = self.requests.next() => Heard::Request(request?),
            scan = scans.next(), if takes_scans => Heard::Scan(Box::new(scan?)),
            scan = further_scans.next(), if takes_scans => Heard::FurtherScan(Box::new(scan?)),
            told = self.frames.next() => Heard::Frame(told?.message),
            told = self.annotations.next() => Heard::Annotations(told?.message),
            told = self.localisations.next() => Heard::Localisation(told?.message),
        })
    }
}

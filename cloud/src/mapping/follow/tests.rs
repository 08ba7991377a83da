//! Tests of several mapping services of one robot, on the network.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::net::SocketAddr;
use std::path::{Path, PathBuf};

use tempfile::TempDir;
use tokio::io::copy_bidirectional;
use tokio::net::{TcpListener, TcpStream};
use tokio::task::JoinHandle;
use zenav_protocol::bus::{BusConfig, Clock, Publisher, RawReply, Router, Shutdown, Subscription};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{
    AnnotateAction, AnnotateRequest, Annotations, EdgeState, GoalPoint, LeaseRole, LeaseState, MapAction, MapPatch,
    MapRef, MappingLeader, Scan,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{ANNOTATE, Producer, Row, SCAN, TABLE};

use super::super::{MappingConfig, PoseSettings, PoseSource, run};
use super::*;
use crate::testing::router;

const DEADLINE: Duration = Duration::from_secs(60);
/// Twice as long as a copy waits for a leader that is frozen.
const QUIET: Duration = Duration::from_secs(6);
const ROBOT: &str = "tiago";
const CHUNKS: [&str; 1] = [ROBOT];

/// A robot that stands between three walls, its mapping services, each with a folder of its own, and whoever looks at its map.
struct Stage {
    router: Router,
    endpoint: String,
    client: Bus,
    scans: Publisher<Scan>,
    states: Publisher<EdgeState>,
    /// Steps of the robot so far.
    count: u64,
    /// Source of the services' poses.
    source: PoseSource,
    folders: TempDir,
}

impl Stage {
    /// A router and a robot; no service yet.
    async fn new(source: PoseSource) -> Self {
        let (router, endpoint) = router().await;
        let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
        Self {
            router,
            scans: client.publisher(&SCAN, &CHUNKS).unwrap(),
            states: client.publisher(&STATE, &CHUNKS).unwrap(),
            endpoint,
            client,
            count: 0,
            source,
            folders: tempfile::tempdir().unwrap(),
        }
    }

    /// The folder of a service.
    fn folder(&self, number: usize) -> PathBuf {
        let folder = self.folders.path().join(number.to_string());
        std::fs::create_dir_all(&folder).unwrap();
        folder
    }

    /// Starts a service at the router.
    async fn start(&self, number: usize) -> Mapping {
        self.start_in(&self.folder(number), &self.endpoint).await
    }

    async fn start_in(&self, folder: &Path, endpoint: &str) -> Mapping {
        let bus = Bus::open(BusConfig::service("mapping", endpoint)).await.unwrap();
        let config = MappingConfig {
            folder: Some(folder.to_owned()),
            poses: PoseSettings {
                source: self.source,
                ..PoseSettings::default()
            },
            ..MappingConfig::new(ROBOT)
        };
        let shutdown = Shutdown::new();
        Mapping(
            tokio::spawn(run(bus, Clock::wall(), config, shutdown.clone())),
            shutdown,
        )
    }

    /// Starts the first service, and waits for its map.
    async fn lead(&mut self) -> (Mapping, MapReply) {
        let leader = self.start(0).await;
        (leader, self.map(has_cells).await)
    }

    /// Starts a service, and waits until it holds the leader's map.
    async fn copy(&self, number: usize) -> Mapping {
        let copy = self.start(number).await;
        self.shows(STANDBY).await;
        copy
    }

    /// Ends services and router.
    async fn end<const N: usize>(self, services: [Mapping; N]) {
        for service in services {
            service.end().await;
        }
        self.router.close().await;
    }

    /// The robot says where it is, and what it sees: a mission commands it, under epoch 7.
    async fn step(&mut self) {
        self.count += 1;
        let lease = LeaseState {
            holder: Some("mission-a".into()),
            role: Some(LeaseRole::Mission),
            epoch: 7,
            live: true,
            ..LeaseState::default()
        };
        let state = serde_json::json!({
            "stamp": self.count, "boot_id": "b", "mode": "idle", "link": "Connected", "lease": lease, "velocity": {"v": 0.0, "w": 0.0},
            "guard": "clear", "battery": 1.0
        });
        self.states.put(&serde_json::from_value(state).unwrap());
        self.scans.put(&Scan {
            stamp: Stamp::from_secs(0.1 * self.count as f64),
            boot_id: "b".into(),
            angle_min: -1.0,
            angle_increment: 0.02,
            range_min: 0.02,
            range_max: 5.0,
            ranges: (0_u8..100).map(|beam| range(-1.0 + 0.02 * f32::from(beam))).collect(),
            odom_from_base: Pose2::new(0.1, 0.0, 0.0),
            ..Scan::default()
        });
        tokio::time::sleep(Duration::from_millis(50)).await;
    }

    /// The map, while the robot goes on, once it fits.
    async fn map(&mut self, fits: impl Fn(&MapReply) -> bool) -> MapReply {
        let end = Instant::now() + DEADLINE;
        while Instant::now() < end {
            self.step().await;
            let request = MapRequest::default();
            let asked = self.client.ask(&MAP, &CHUNKS, &request, Duration::from_millis(300));
            if let Ok(reply) = asked.await
                && fits(&reply)
            {
                return reply;
            }
        }
        panic!("no such map within {DEADLINE:?}");
    }

    /// The map of the service that leads after another one.
    async fn map_after(&mut self, before: &MapReply) -> MapReply {
        self.map(|map| map.info.map.id != before.info.map.id).await
    }

    /// The robot goes on for this number of twentieths of a second.
    async fn pass(&mut self, steps: usize) {
        for _ in 0..steps {
            self.step().await;
        }
    }

    fn beats(&self) -> Subscription<MappingLeader> {
        self.client.subscribe(&MAPPING_LEADER, &CHUNKS, MOST_BEATS).unwrap()
    }

    /// Waits for a beat that fits, while the robot goes on.
    async fn beat(&mut self, fits: impl Fn(&MappingLeader) -> bool) -> MappingLeader {
        let mut beats = self.beats();
        let end = Instant::now() + DEADLINE;
        while Instant::now() < end {
            self.step().await;
            while let Some(beat) = beats.try_next() {
                if fits(&beat.message) {
                    return beat.message;
                }
            }
        }
        panic!("no such beat within {DEADLINE:?}");
    }

    /// Adds a place to the map.
    async fn add(&self, name: &str) -> Result<Annotations, AskError> {
        self.add_within(name, DEADLINE).await
    }

    async fn add_within(&self, name: &str, deadline: Duration) -> Result<Annotations, AskError> {
        let add = AnnotateRequest {
            action: AnnotateAction::AddPlace {
                name: name.into(),
                at: GoalPoint {
                    x: 1.0,
                    y: 0.5,
                    yaw: None,
                },
            },
            request_id: Some(name.into()),
            epoch: Some(7),
        };
        self.client.ask(&ANNOTATE, &CHUNKS, &add, deadline).await
    }

    /// Changes the map under the mission's lease.
    async fn change_map(&self, action: MapAction, name: Option<&str>) {
        let request = MapRequest {
            action,
            name: name.map(str::to_owned),
            epoch: Some(7),
            ..MapRequest::default()
        };
        self.client.ask(&MAP, &CHUNKS, &request, DEADLINE).await.unwrap();
    }

    async fn annotations(&self) -> Annotations {
        let request = AnnotateRequest::default();
        self.client.ask(&ANNOTATE, &CHUNKS, &request, DEADLINE).await.unwrap()
    }

    /// Waits until a component shows.
    async fn shows(&self, component: &str) {
        let looked = async {
            let key = alive_key(ALIVE_COMPONENT, &[ROBOT, component]);
            while self.client.list_alive(key.clone(), DEADLINE).await.unwrap().is_empty() {}
        };
        tokio::time::timeout(DEADLINE, looked).await.unwrap();
    }
}

/// A link to a router that can be cut.
struct Link {
    router: SocketAddr,
    here: SocketAddr,
    task: JoinHandle<()>,
}

impl Link {
    async fn new(stage: &Stage) -> Self {
        let router = stage.endpoint.trim_start_matches("tcp/").parse().unwrap();
        let listener = TcpListener::bind("127.0.0.1:0").await.unwrap();
        Self {
            router,
            here: listener.local_addr().unwrap(),
            task: tokio::spawn(forward(listener, router)),
        }
    }

    /// Starts a service behind the link.
    async fn start(&self, stage: &Stage, number: usize) -> Mapping {
        stage
            .start_in(&stage.folder(number), &format!("tcp/{}", self.here))
            .await
    }

    /// Closes all connections, and accepts none.
    fn cut(&self) {
        self.task.abort();
    }

    async fn mend(&mut self) {
        let listener = TcpListener::bind(self.here).await.unwrap();
        self.task = tokio::spawn(forward(listener, self.router));
    }
}

async fn forward(listener: TcpListener, to: SocketAddr) {
    let mut connections = JoinSet::new();
    loop {
        let (mut here, _) = listener.accept().await.unwrap();
        connections.spawn(async move {
            if let Ok(mut there) = TcpStream::connect(to).await {
                let _ = copy_bidirectional(&mut here, &mut there).await;
            }
        });
    }
}

/// Whether a map is worth copying.
fn has_cells(map: &MapReply) -> bool {
    map.info.free > 100
}

/// Distance to the walls: ahead, to the left and to the right.
fn range(angle: f32) -> f32 {
    let side = if angle > 0.0 {
        1.5 / angle.sin()
    } else {
        -1.2 / angle.sin()
    };
    (2.0 / angle.cos()).min(side)
}

/// A running mapping service.
struct Mapping(JoinHandle<Result<(), MappingError>>, Shutdown);

impl Mapping {
    /// Ends at once, without another word.
    async fn kill(self) {
        self.0.abort();
        assert!(self.0.await.unwrap_err().is_cancelled());
    }

    async fn end(self) {
        self.1.trigger();
        self.0.await.unwrap().unwrap();
    }
}

/// Waits for a beat of this term; the robot says nothing meanwhile.
async fn next_term(beats: &mut Subscription<MappingLeader>, term: u64) {
    while beats.next().await.unwrap().message.term != term {}
}

/// Share of the known cells of a map that are the same in a later one.
fn kept(before: &MapReply, after: &MapReply) -> f64 {
    let grids = [before, after].map(|map| map.grid().unwrap());
    let [before, after]: &[OccupancyGrid; 2] = &grids;
    let (mut known, mut same) = (0.0, 0.0);
    for (index, value) in before.values().iter().enumerate() {
        let is = Occupancy::of(*value);
        if is != Occupancy::Unknown {
            known += 1.0;
            let cell = Cell {
                x: index as u32 % before.spec().width,
                y: index as u32 / before.spec().width,
            };
            let there = after.at(before.spec().center(cell)).map(|value| Occupancy::of(*value));
            same += f64::from(u8::from(there == Some(is)));
        }
    }
    assert!(known > 100.0);
    same / known
}

/// Kills the leader of two services; returns the stage, the one that has taken over, and the maps before and after.
async fn succeeded(source: PoseSource) -> (Stage, Mapping, MapReply, MapReply) {
    let mut stage = Stage::new(source).await;
    let (leader, _) = stage.lead().await;
    stage.add("fridge").await.unwrap();
    let copy = stage.copy(1).await;
    let before = stage.map(has_cells).await;
    assert_eq!(stage.beat(|_| true).await.term, 1);
    leader.kill().await;
    let after = stage.map_after(&before).await;
    assert!(kept(&before, &after) > 0.98, "{}", kept(&before, &after));
    (stage, copy, before, after)
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_takes_over_the_map_its_places_and_the_authority_and_a_leader_that_returns_follows() {
    let (mut stage, copy, before, after) = succeeded(PoseSource::Edge).await;
    let told = stage.annotations().await;
    assert_eq!((told.revision, told.places["fridge"].x), (2, 1.0));
    // A request that the leader has answered is carried out again, and this one then changes nothing.
    assert_eq!(stage.add("fridge").await.unwrap(), told);
    // The first map request after the takeover needs the lease's epoch, as any other.
    let reset = MapRequest {
        action: MapAction::Reset,
        ..MapRequest::default()
    };
    let refused = stage.client.ask(&MAP, &CHUNKS, &reset, DEADLINE).await.unwrap_err();
    assert!(refused.to_string().contains("expected `epoch`"), "{refused}");

    let returned = stage.copy(0).await;
    let beat = stage.beat(|_| true).await;
    assert_eq!((beat.term, &beat.map.id), (2, &after.info.map.id));
    copy.kill().await;
    let back = stage.map_after(&after).await;
    assert!(kept(&before, &back) > 0.98);
    stage.end([returned]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn every_ask_of_mapping_is_answered_by_the_leader_and_by_no_copy() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (leader, _) = stage.lead().await;
    let copy = stage.copy(1).await;
    let is_ours = |row: &&Row| row.producer == Producer::Mapping && row.asked_by.is_some();
    for row in TABLE.iter().filter(is_ours) {
        let key = row.pattern.replace("{robot}", ROBOT);
        let asked = stage.client.raw_query(&key, Some(b"{}".to_vec()), DEADLINE);
        let replies = asked.await.unwrap();
        assert!(matches!(replies[..], [RawReply::Ok(_)]), "{key}: {replies:?}");
    }
    stage.end([copy, leader]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_without_the_leader_s_folder_goes_on_with_slam_in_the_map_that_it_followed() {
    let (mut stage, copy, before, after) = succeeded(PoseSource::Slam).await;
    // It draws in it, from where SLAM holds the robot to be.
    let scans = after.info.scans;
    let later = stage.map(|map| map.info.scans > scans + 5).await;
    assert_eq!(later.info.map.id, after.info.map.id);
    assert!(kept(&before, &later) > 0.95, "{}", kept(&before, &later));
    stage.end([copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_copy_in_the_leader_s_folder_goes_on_with_its_session() {
    let mut stage = Stage::new(PoseSource::Slam).await;
    let (leader, before) = stage.lead().await;
    // Stored by a request, not only every so many nodes.
    stage.change_map(MapAction::Save, None).await;
    let copy = stage.copy(0).await;
    assert!(stage.folder(0).join("slam.session").exists());
    leader.kill().await;
    let after = stage
        .map(|map| map.info.map.id != before.info.map.id && has_cells(map))
        .await;
    assert!(kept(&before, &after) > 0.9, "{}", kept(&before, &after));
    assert!(
        !stage.folder(0).join("slam.session.before").exists(),
        "it is resumed, and not set aside"
    );
    stage.end([copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_leader_that_was_cut_off_says_nothing_of_its_map_once_the_link_is_back() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let mut link = Link::new(&stage).await;
    let leader = link.start(&stage, 0).await;
    stage.map(has_cells).await;
    let copy = stage.copy(1).await;
    let before = stage.map(has_cells).await;
    link.cut();
    let after = stage.map_after(&before).await;
    // The cut lasts four seconds longer than the takeover.
    stage.pass(80).await;
    let mut told = stage.client.subscribe(&MAP_INFO, &CHUNKS, 4096).unwrap();
    link.mend().await;
    stage.shows(STANDBY).await;
    while let Some(info) = told.try_next() {
        assert_eq!(info.message.map.id, after.info.map.id);
    }
    stage.end([leader, copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_leader_whose_copy_has_left_goes_on_with_its_map_after_a_cut() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let mut link = Link::new(&stage).await;
    let leader = link.start(&stage, 0).await;
    let before = stage.map(has_cells).await;
    let copy = stage.copy(1).await;
    copy.end().await;
    // Twice as long as the leader still counts with the copy, and as it may be cut off if there is one.
    stage.pass(80).await;
    link.cut();
    stage.pass(80).await;
    link.mend().await;
    let after = stage.map(|map| map.info.scans > before.info.scans).await;
    assert_eq!(after.info.map.id, before.info.map.id);
    stage.end([leader]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_the_robot_is_off_no_copy_takes_over_and_one_does_with_the_whole_map_once_it_is_back() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (leader, _) = stage.lead().await;
    let copy = stage.copy(1).await;
    let before = stage.map(has_cells).await;
    let mut beats = stage.beats();
    leader.kill().await;
    let taken_over = tokio::time::timeout(QUIET, next_term(&mut beats, 2)).await;
    assert!(taken_over.is_err(), "it may itself be cut off");
    let after = stage.map_after(&before).await;
    assert!(kept(&before, &after) > 0.98, "{}", kept(&before, &after));
    assert_eq!(stage.beat(|_| true).await.term, 2);
    stage.end([copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_leader_that_is_started_again_while_the_robot_is_off_leads_with_its_own_folder() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (leader, _) = stage.lead().await;
    stage.add("fridge").await.unwrap();
    let copy = stage.copy(1).await;
    leader.kill().await;
    let mut beats = stage.beats();
    let again = stage.start(0).await;
    tokio::time::timeout(DEADLINE, next_term(&mut beats, 2)).await.unwrap();
    assert!(stage.annotations().await.places.contains_key("fridge"));
    stage.end([again, copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn while_a_copy_waits_for_the_robot_only_the_last_leader_s_folder_goes_before_it() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (leader, _) = stage.lead().await;
    let copy = stage.copy(1).await;
    let is_newest = |number: usize| storage::is_of_last_leader(ROBOT, Some(&stage.folder(number)));
    assert_eq!([0, 1, 2].map(is_newest), [true, false, false]);
    let look = |is_newest: bool| vacancy(stage.client.clone(), ROBOT.to_owned(), is_newest);
    assert_eq!(look(false).await, Vacancy::Taken);
    leader.kill().await;
    let seen = tokio::join!(look(true), look(false));
    assert_eq!(seen, (Vacancy::Open, Vacancy::Kept));
    stage.end([copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_took_over_has_the_last_leader_s_folder_once_its_map_is_stored_there() {
    let (stage, copy, ..) = succeeded(PoseSource::Edge).await;
    let folder = stage.folder(1);
    let is_newest = || storage::is_of_last_leader(ROBOT, Some(&folder));
    assert!(!is_newest(), "the map that it leads with is not stored");
    for (name, expected) in [(Some("kitchen"), false), (None, true)] {
        stage.change_map(MapAction::Save, name).await;
        assert_eq!(is_newest(), expected, "saved as {name:?}");
    }
    stage.end([copy]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_held_map_that_slam_took_over_is_what_the_next_start_begins_with_once_it_is_stored() {
    let mut stage = Stage::new(PoseSource::Slam).await;
    let folder = stage.folder(1);
    let is_newest = || storage::is_of_last_leader(ROBOT, Some(&folder));
    // An earlier leadership has left its session in the folder.
    let earlier = stage.start(1).await;
    stage.map(has_cells).await;
    earlier.end().await;
    let old = std::fs::read(folder.join("slam.session")).unwrap();

    let (leader, _) = stage.lead().await;
    stage.change_map(MapAction::Hold, None).await;
    let copy = stage.copy(1).await;
    let before = stage.map(has_cells).await;
    leader.kill().await;
    let held = stage.map_after(&before).await;
    assert!(!is_newest(), "the map that it leads with is not stored");
    stage.change_map(MapAction::Save, None).await;
    assert!(is_newest());
    assert_eq!(std::fs::read(folder.join("slam.session.before")).unwrap(), old);

    copy.kill().await;
    let again = stage.start(1).await;
    let begun = stage.map_after(&held).await;
    assert!(
        begun.info.stored && kept(&held, &begun) > 0.98,
        "{}",
        kept(&held, &begun)
    );
    stage.end([again]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn slam_s_session_since_a_takeover_has_the_map_that_was_taken_over() {
    let (mut stage, second, _, taken_over) = succeeded(PoseSource::Slam).await;
    let folder = stage.folder(1);
    let is_newest = || storage::is_of_last_leader(ROBOT, Some(&folder));
    // SLAM stores it unasked; once a request to store it is answered, it is not being stored any more.
    let before = stage.map(|_| folder.join("slam.session").exists()).await;
    assert_eq!(before.info.map.id, taken_over.info.map.id);
    stage.change_map(MapAction::Save, None).await;
    assert!(is_newest() && folder.join("slam.base").exists());

    // A copy in the same folder goes on with that session, and so does a service that is started alone.
    let third = stage.copy(1).await;
    second.kill().await;
    let after = stage
        .map(|map| map.info.map.id != before.info.map.id && has_cells(map))
        .await;
    assert!(kept(&before, &after) > 0.9, "{}", kept(&before, &after));
    third.kill().await;
    let fourth = stage.start(1).await;
    let alone = stage
        .map(|map| map.info.map.id != after.info.map.id && has_cells(map))
        .await;
    assert!(kept(&before, &alone) > 0.9, "{}", kept(&before, &alone));
    assert!(
        !folder.join("slam.session.before").exists(),
        "it is resumed, and not set aside"
    );

    // A map of its own needs no other.
    stage.change_map(MapAction::Reset, None).await;
    stage.map(|_| folder.join("slam.session").exists()).await;
    assert!(!folder.join("slam.base").exists());
    stage.end([fourth]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_stranger_s_word_deposes_a_leader_for_seconds_only_and_its_map_is_kept() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (service, before) = stage.lead().await;
    let stranger = Bus::open(BusConfig::service("stranger", &stage.endpoint))
        .await
        .unwrap();
    let said = stranger.publisher(&MAPPING_LEADER, &CHUNKS).unwrap();
    let forged = MappingLeader {
        name: "stranger".into(),
        term: 40,
        ..MappingLeader::default()
    };
    // Repeated until it is heard.
    let end = Instant::now() + DEADLINE;
    let mut deposed = false;
    while !deposed && Instant::now() < end {
        said.put(&forged);
        stage.step().await;
        let key = alive_key(ALIVE_COMPONENT, &[ROBOT, LEADER]);
        deposed = stage.client.list_alive(key, DEADLINE).await.unwrap().is_empty();
    }
    assert!(deposed);
    let after = stage.map_after(&before).await;
    assert!(kept(&before, &after) > 0.98);
    stage.end([service]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn places_and_terms_outlive_restarts_of_all_services_in_any_order() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (leader, _) = stage.lead().await;
    let copy = stage.copy(1).await;
    stage.add("fridge").await.unwrap();
    // A copy stores what it follows.
    let file = stage.folder(1).join("annotations.json");
    let end = Instant::now() + DEADLINE;
    while !file.exists() && Instant::now() < end {
        stage.step().await;
    }
    leader.kill().await;
    copy.kill().await;
    let copy = stage.start(1).await;
    stage.map(has_cells).await;
    assert!(stage.annotations().await.places.contains_key("fridge"));
    assert!(
        stage.beat(|_| true).await.term > 1,
        "it knows the term that it followed"
    );
    copy.kill().await;

    // One that knows of nothing leads first, and the one that knows follows.
    let stranger = stage.start(2).await;
    let before = stage.map(has_cells).await;
    assert!(!stage.annotations().await.places.contains_key("fridge"));
    let returned = stage.copy(0).await;
    stranger.kill().await;
    stage.map_after(&before).await;
    assert!(stage.annotations().await.places.contains_key("fridge"));
    let term = stage.beat(|_| true).await.term;
    returned.kill().await;
    let again = stage.start(0).await;
    assert_eq!(stage.beat(|beat| beat.term != term).await.term, term + 1);
    stage.end([again]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_broken_file_is_refused_at_the_start_of_a_copy_and_set_aside_at_a_takeover() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let file = stage.folder(1).join("annotations.json");
    let (leader, before) = stage.lead().await;
    stage.add("fridge").await.unwrap();
    std::fs::write(&file, "{").unwrap();
    let refused = stage.start(1).await;
    let error = refused.0.await.unwrap().unwrap_err().to_string();
    assert!(error.contains("annotations.json"), "{error}");

    std::fs::remove_file(&file).unwrap();
    let copy = stage.copy(1).await;
    std::fs::write(&file, "{").unwrap();
    leader.kill().await;
    stage.map_after(&before).await;
    assert!(stage.annotations().await.places.contains_key("fridge"));
    assert!(stage.folder(1).join("annotations.json.unreadable").exists());
    stage.end([copy]).await;
}

#[cfg(unix)]
#[tokio::test(flavor = "multi_thread")]
async fn a_service_that_still_loads_its_map_leads_already() {
    let slow_folder = tempfile::tempdir().unwrap();
    // A map whose end does not come before the pipe is closed.
    let file = slow_folder.path().join("map.yaml");
    let made = std::process::Command::new("mkfifo").arg(&file).status().unwrap();
    assert!(made.success());
    let pipe = std::fs::OpenOptions::new().read(true).write(true).open(&file).unwrap();
    // Dropped in this order, also if an assertion fails: a pipe that is still there would be opened again, and wait for ever.
    let slow_folder = (slow_folder, pipe);
    let mut stage = Stage::new(PoseSource::Edge).await;
    let slow = stage.start_in(slow_folder.0.path(), &stage.endpoint).await;
    let loading = stage.beat(|_| true).await;
    assert_eq!(loading.map, MapRef::default());
    // Its client gives up while the map is loaded: it must not be carried out later.
    let given_up = stage.add_within("oven", Duration::from_millis(500)).await;
    assert!(matches!(given_up, Err(AskError::Timeout { .. })), "{given_up:?}");
    let fast = stage.start(1).await;
    // Longer than a copy waits for a leader that is frozen.
    for _ in 0..20 {
        assert_eq!(stage.beat(|_| true).await.name, loading.name);
    }
    drop(slow_folder);
    assert_eq!(stage.beat(|beat| beat.map.revision > 0).await.name, loading.name);
    assert!(!stage.annotations().await.places.contains_key("oven"));
    stage.shows(STANDBY).await;
    stage.end([fast, slow]).await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_leader_that_can_store_nothing_acknowledges_no_place() {
    let mut stage = Stage::new(PoseSource::Edge).await;
    let (leader, before) = stage.lead().await;
    stage.add("fridge").await.unwrap();
    let copy = stage.copy(1).await;
    // As a frozen leader does in a shared folder.
    let lock = storage::guard(&stage.folder(1)).unwrap().unwrap();
    leader.kill().await;
    stage.map_after(&before).await;
    let refused = stage.add("oven").await.unwrap_err();
    assert!(refused.to_string().contains("cannot be stored"), "{refused}");
    assert!(stage.annotations().await.places.contains_key("fridge"));
    drop(lock);
    stage.end([copy]).await;
}

fn leader(name: &str, term: u64, map: &str, revision: u64) -> MappingLeader {
    MappingLeader {
        name: name.into(),
        term,
        map: MapRef {
            id: map.into(),
            revision,
            frame: 0,
        },
        held: false,
    }
}

/// The first patch of a map.
fn patch(map: &str) -> MapPatch {
    MapPatch {
        stamp: Stamp::ZERO,
        map: leader("", 0, map, 1).map,
        base_revision: 0,
        spec: GridSpec {
            origin: nalgebra::Point2::origin(),
            resolution: 0.05,
            width: 64,
            height: 64,
        },
        tiles: Vec::new(),
    }
}

#[test]
fn a_map_of_another_leader_is_not_inherited() {
    let mut followed = Followed::default();
    assert!(followed.hears(leader("a", 1, "m", 1)) && followed.is_behind() && followed.inherited().is_none());
    followed.take(patch("m"));
    assert!(!followed.is_behind());
    assert_eq!(followed.inherited().map(|leader| leader.term), Some(1));
    // The next leader has begun another map, which has not arrived.
    assert!(followed.hears(leader("b", 2, "n", 1)));
    assert!(followed.is_behind() && followed.inherited().is_none());
    assert!(!followed.hears(leader("a", 1, "m", 1)));
}

#[test]
fn a_patch_of_a_map_that_no_beat_has_named_waits_and_replaces_nothing() {
    let mut followed = Followed::default();
    // The first patch may overtake the first beat.
    followed.take(patch("m"));
    assert!(followed.hears(leader("a", 1, "m", 1)) && !followed.is_behind());
    followed.take(patch("forged"));
    assert_eq!(followed.replica.map().id, "m");
    assert!(followed.hears(leader("a", 1, "m", 1)) && followed.inherited().is_some());
    followed.take(patch("n"));
    assert!(followed.hears(leader("b", 2, "n", 1)) && !followed.is_behind());
    assert!(followed.early.is_empty());
}

#[test]
fn a_map_that_was_reset_is_not_inherited_and_one_of_a_leader_that_still_loads_is() {
    let mut followed = Followed::default();
    assert!(followed.hears(leader("a", 1, "m", 1)));
    followed.take(patch("m"));
    assert!(followed.hears(leader("b", 2, "", 0)) && followed.inherited().is_some());
    assert!(followed.hears(leader("b", 2, "n", 0)) && followed.inherited().is_some());
    assert!(followed.hears(leader("b", 2, "o", 0)) && followed.inherited().is_none());
}

#[test]
fn a_copy_is_as_old_as_the_last_word_of_a_leader_whose_map_it_held_and_says_once_that_nobody_leads() {
    let start = Instant::now();
    let at = |secs: u64| start + Duration::from_secs(secs);
    let mut word = LastWord::new(start);
    word.heard(at(2), false);
    word.heard(at(5), true);
    assert_eq!(word.age(at(6)), Duration::from_secs(4));
    let told: Vec<u64> = (6..60).filter(|secs| word.is_newly_overdue(at(*secs))).collect();
    assert_eq!(told, [20]);
    word.heard(at(60), false);
    assert_eq!(word.age(at(60)), Duration::ZERO);
    assert!(!word.is_newly_overdue(at(74)) && word.is_newly_overdue(at(75)));
}

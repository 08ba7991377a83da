//! Tests of the mapping service on the network.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use nalgebra::Point2;
use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::bus::{AskError, Bus, BusConfig, Clock, Shutdown};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::map_replica::{MapReplica, PatchResult};
use zenav_protocol::messages::{
    AnnotateAction, AnnotateRequest, EdgeState, GivenMap, GoalPoint, LeaseRole, LeaseState, MapAction, MapReply,
    MapRequest, Refusal, Scan,
};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{ANNOTATE, ANNOTATIONS, MAP, MAP_PATCH, SCAN, STATE};

use super::*;
use crate::testing::router;

const DEADLINE: Duration = Duration::from_secs(10);

fn scan(stamp: u64) -> Scan {
    Scan {
        stamp: Stamp(stamp),
        angle_min: -1.0,
        angle_increment: 0.02,
        range_min: 0.02,
        range_max: 5.0,
        ranges: vec![2.0; 100],
        odom_from_base: Pose2::new(0.1, 0.0, 0.0),
        ..Scan::default()
    }
}

fn request(action: MapAction, id: &str, epoch: Option<u64>) -> MapRequest {
    MapRequest {
        action,
        request_id: Some(id.to_owned()),
        epoch,
        ..MapRequest::default()
    }
}

/// State of a robot whose lease a mission holds under this epoch (`live`), or has let lapse.
fn state(epoch: u64, live: bool) -> EdgeState {
    let lease = LeaseState {
        holder: Some("mission-a".into()),
        role: Some(LeaseRole::Mission),
        epoch,
        live,
        ..LeaseState::default()
    };
    serde_json::from_value(serde_json::json!({
        "stamp": 1, "boot_id": "b", "mode": "idle", "link": "Connected", "lease": lease, "velocity": {"v": 0.0, "w": 0.0},
        "guard": "clear", "battery": 1.0
    }))
    .unwrap()
}

#[test]
fn a_term_is_known_after_a_restart_and_never_goes_down() {
    let folder = tempfile::tempdir().unwrap();
    let noted = |term| storage::note_term("tiago", Some(folder.path()), term);
    assert_eq!([noted(0), noted(4), noted(2), noted(0)], [0, 4, 4, 4]);
    assert_eq!(storage::note_term("tiago", None, 3), 3);
    // A folder from which somebody led goes before a copy's until another one leads.
    let is_newest = || storage::is_of_last_leader("tiago", Some(folder.path()));
    assert!(!is_newest());
    storage::note_leadership("tiago", Some(folder.path()), 50);
    assert!(is_newest() && noted(0) == 50);
    noted(51);
    assert!(!is_newest());
}

#[test]
fn a_map_that_does_not_move_is_in_the_frame_of_its_robot_whatever_that_was_before() {
    let mut core = MappingCore::new(Mapper::new(MappingSettings::default(), "map"), &PoseSettings::default());
    let mut replica = MapReplica::default();
    core.hear_frame(0);
    core.insert(&scan(1), "boot");
    let mut take = |core: &mut MappingCore| {
        while let Some(patch) = core.mapper.take_patch() {
            assert_eq!(replica.apply(&patch), PatchResult::Applied);
        }
        replica.map().frame
    };
    assert_eq!(take(&mut core), 0);
    // An earlier run's SLAM left the robot in frame 2; then the robot restarts.
    for frame in [2, 0] {
        core.hear_frame(frame);
        assert!(core.mapper.has_changes(), "not one cell is another, and yet it is news");
        assert_eq!(take(&mut core), frame);
        core.hear_frame(frame);
        assert!(!core.mapper.has_changes());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_scan_becomes_a_patch_and_a_saved_map_is_there_after_a_restart() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let folder = tempfile::tempdir().unwrap();
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        ..MappingConfig::new("tiago")
    };
    let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
    let mut patches = client.subscribe(&MAP_PATCH, &chunks, 16).unwrap();
    let scans = client.publisher(&SCAN, &chunks).unwrap();

    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(
        open("mapping").await.unwrap(),
        Clock::wall(),
        config.clone(),
        shutdown.clone(),
    ));
    let empty = client
        .ask(&MAP, &chunks, &MapRequest::default(), DEADLINE)
        .await
        .unwrap();
    assert!(!empty.info.stored && empty.values.is_empty());
    let refused = client
        .ask(&MAP, &chunks, &request(MapAction::Save, "too early", None), DEADLINE)
        .await;
    assert!(refused.is_err());

    // The route to the service may not be declared yet: send repeatedly, as a robot does.
    let mut replica = MapReplica::new();
    let mut stamp = 0;
    while !replica.has_map() {
        stamp += 1;
        // The robot touches a pane of glass.
        scans.put(&Scan {
            touched: vec![[[1.02, -0.2, 1.02, 0.2]; 2]],
            ..scan(stamp)
        });
        if let Ok(Some(patch)) = tokio::time::timeout(Duration::from_millis(100), patches.next()).await {
            assert_eq!(replica.apply(&patch.message), PatchResult::Applied);
        }
    }
    let saved = client
        .ask(&MAP, &chunks, &request(MapAction::Save, "save", None), DEADLINE)
        .await
        .unwrap();
    assert!(saved.info.stored && saved.values.is_empty());
    let again = client
        .ask(&MAP, &chunks, &request(MapAction::Save, "save", None), DEADLINE)
        .await
        .unwrap();
    assert_eq!(again, saved);
    shutdown.trigger();
    service.await.unwrap().unwrap();

    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(
        open("mapping").await.unwrap(),
        Clock::wall(),
        config,
        shutdown.clone(),
    ));
    let loaded = client
        .ask(&MAP, &chunks, &MapRequest::default(), DEADLINE)
        .await
        .unwrap();
    assert!(loaded.info.stored && loaded.info.free > 0 && loaded.trajectory.len() == 1);
    assert_eq!(
        (loaded.info.free, loaded.info.occupied),
        (saved.info.free, saved.info.occupied)
    );
    let resumed = request(MapAction::Resume, "resume", None);
    client.ask(&MAP, &chunks, &resumed, DEADLINE).await.unwrap();
    let map = loop {
        stamp += 1;
        scans.put(&scan(stamp));
        let map = client.ask(&MAP, &chunks, &MapRequest::default(), DEADLINE).await;
        let map = map.unwrap();
        if map.info.scans >= loaded.info.scans + 30 {
            break OccupancyGrid::from_values(map.info.spec, map.values).unwrap();
        }
    };
    let glass = map.at(Point2::new(1.12, 0.02)).map(|value| Occupancy::of(*value));
    assert_eq!(glass, Some(Occupancy::Occupied), "though beams pass it");
    let reset = client
        .ask(&MAP, &chunks, &request(MapAction::Reset, "reset", None), DEADLINE)
        .await
        .unwrap();
    assert!(!reset.info.stored && reset.info.map.id != loaded.info.map.id);
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_mission_s_map_is_changed_under_its_epoch_only_and_once() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(
        open("mapping").await.unwrap(),
        Clock::wall(),
        MappingConfig::new("tiago"),
        shutdown.clone(),
    ));
    let states = client.publisher(&STATE, &chunks).unwrap();
    let ask = async |request: MapRequest| client.ask(&MAP, &chunks, &request, DEADLINE).await;
    let until = async |epoch: u64, live: bool, wanted: fn(&Result<MapReply, AskError>) -> bool| {
        tokio::time::timeout(DEADLINE, async {
            loop {
                states.put(&state(epoch, live));
                let plain = MapRequest {
                    action: MapAction::Reset,
                    ..MapRequest::default()
                };
                let answer = ask(plain).await;
                if wanted(&answer) {
                    return answer;
                }
            }
        })
        .await
        .unwrap()
    };

    // While the mission holds the lease, an operator's request is refused, and the refusal says what is missing.
    let refused = until(7, true, Result::is_err).await.unwrap_err();
    assert!(refused.to_string().contains("expected `epoch`"), "{refused}");
    states.put(&state(7, true));
    let wrong = ask(request(MapAction::Reset, "a", Some(6))).await.unwrap_err();
    assert_eq!(wrong, AskError::Refused(Refusal::WrongEpoch { got: 6, current: 7 }));
    // The same request under the right epoch succeeds; repeating it does not reset again.
    states.put(&state(7, true));
    let first = ask(request(MapAction::Reset, "a", Some(7))).await.unwrap();
    assert_eq!(ask(request(MapAction::Reset, "a", Some(7))).await.unwrap(), first);
    let map = ask(MapRequest::default()).await.unwrap();
    assert_eq!(map.info.map, first.info.map);
    // Once the lease has lapsed, the plain request is carried out.
    let reset = until(7, false, Result::is_ok).await.unwrap();
    assert_ne!(reset.info.map.id, first.info.map.id);

    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_comes_with_a_request_is_held_and_named_maps_are_stored_beside_the_robot_s_own() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let folder = tempfile::tempdir().unwrap();
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        ..MappingConfig::new("tiago")
    };
    let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(
        open("mapping").await.unwrap(),
        Clock::wall(),
        config,
        shutdown.clone(),
    ));
    let ask = async |request: MapRequest| client.ask(&MAP, &chunks, &request, DEADLINE).await;
    let mut values = vec![0; 12];
    values[5] = 100;
    let given = GivenMap {
        spec: GridSpec {
            origin: Point2::new(-1.0, 2.0),
            resolution: 0.05,
            width: 4,
            height: 3,
        },
        values,
    };
    let load = MapRequest {
        map: Some(given.clone()),
        ..request(MapAction::Load, "load", None)
    };
    let loaded = ask(load.clone()).await.unwrap();
    assert!(loaded.info.stored && loaded.info.occupied == 1, "{loaded:?}");
    assert_eq!(
        ask(load.clone()).await.unwrap(),
        loaded,
        "a repeated request loads nothing again"
    );
    let named = |action, id: &str, name: &str| MapRequest {
        name: Some(name.to_owned()),
        ..request(action, id, None)
    };
    ask(named(MapAction::Save, "save", "attic")).await.unwrap();
    ask(request(MapAction::Reset, "reset", None)).await.unwrap();
    let list = ask(MapRequest {
        action: MapAction::List,
        ..MapRequest::default()
    });
    let names: Vec<String> = list.await.unwrap().stored.into_iter().map(|map| map.name).collect();
    assert_eq!(names, ["attic"]);
    let back = ask(named(MapAction::Load, "back", "attic")).await.unwrap();
    assert_eq!(back.info.occupied, 1);
    for (bad, what) in [
        (named(MapAction::Load, "b1", "moon"), "stored map `moon`"),
        (named(MapAction::Save, "b2", "../up"), "`name`"),
        (request(MapAction::Load, "b3", None), "a stored map of the robot"),
        (
            MapRequest {
                name: Some("attic".into()),
                ..load.clone()
            },
            "first answer",
        ),
        (
            MapRequest {
                map: Some(GivenMap {
                    values: vec![0; 5],
                    ..given.clone()
                }),
                ..request(MapAction::Load, "b4", None)
            },
            "`map`",
        ),
    ] {
        match ask(bad).await {
            Err(error) => assert!(error.to_string().contains(what), "{what}: {error}"),
            Ok(answer) => assert!(what == "first answer" && answer == loaded),
        }
    }
    assert!(!folder.path().parent().unwrap().join("up").exists());
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn annotations_are_published_to_late_joiners_and_changed_under_the_epoch_in_force() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let (client, chunks) = (open("client").await.unwrap(), ["tiago"]);
    let shutdown = Shutdown::new();
    let sink = GoalPoint {
        x: 1.0,
        y: 2.0,
        yaw: None,
    };
    let config = MappingConfig {
        places: [("sink".to_owned(), sink)].into(),
        ..MappingConfig::new("tiago")
    };
    let service = tokio::spawn(run(
        open("mapping").await.unwrap(),
        Clock::wall(),
        config,
        shutdown.clone(),
    ));
    let states = client.publisher(&STATE, &chunks).unwrap();
    let add = |id: &str, epoch| AnnotateRequest {
        action: AnnotateAction::AddPlace {
            name: "fridge".into(),
            at: sink,
        },
        request_id: Some(id.to_owned()),
        epoch,
    };
    let ask = async |request: &AnnotateRequest| client.ask(&ANNOTATE, &chunks, request, DEADLINE).await;
    // Wait until mapping has heard that a mission commands the robot.
    tokio::time::timeout(DEADLINE, async {
        let mut count = 0;
        loop {
            count += 1;
            states.put(&state(7, true));
            let remove = AnnotateRequest {
                action: AnnotateAction::RemovePlace { name: "fridge".into() },
                request_id: Some(format!("r{count}")),
                epoch: None,
            };
            if ask(&remove).await.unwrap_err().to_string().contains("expected `epoch`") {
                return;
            }
        }
    })
    .await
    .unwrap();
    states.put(&state(7, true));
    assert!(ask(&add("a", Some(6))).await.is_err());
    let added = ask(&add("a", Some(7))).await.unwrap();
    assert_eq!((added.revision, added.places.len()), (1, 2));
    let late_bus = open("late").await.unwrap();
    let mut late = late_bus.latest(&ANNOTATIONS, &chunks).unwrap();
    let heard = tokio::time::timeout(DEADLINE, late.next()).await.unwrap().unwrap();
    assert_eq!(heard.message, added);
    assert_eq!(ask(&AnnotateRequest::default()).await.unwrap(), added);
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

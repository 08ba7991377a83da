//! Tests of stored SLAM sessions, on disk and on the network.

#![allow(clippy::unwrap_used, reason = "tests")]

use std::time::Duration;

use zenav_mapping::{Insertion, Mapper, MappingSettings};
use zenav_protocol::bus::{Bus, BusConfig, Clock, Shutdown};
use zenav_protocol::messages::{Correction, EdgeState, GoalPoint, Health, LeaseState, MapAction, MapFrame, MapRequest};
use zenav_protocol::time::Stamp;
use zenav_protocol::topics::{ANNOTATIONS, CORRECTION, MAP, SCAN, STATE};

use super::super::annotations::AnnotationBook;
use super::super::core::{Mapped, MappingCore, PoseSettings, PoseSource};
use super::super::{KnownMap, MappingConfig, run};
use super::*;
use crate::testing::router;

mod graph;
mod large_map;
mod lost;
mod redraw;

const DEADLINE: Duration = Duration::from_secs(20);
/// The wheels overestimate distance by this factor.
const TOO_FAR: f64 = 1.04;

/// Left, low, right and high side of boxes, m: the walls of a hall and its furniture.
type Boxes = [(f64, f64, f64, f64)];

const HALL: [(f64, f64, f64, f64); 8] = [
    (1.0, 0.8, 1.5, 1.5),
    (3.2, -1.6, 3.6, -0.9),
    (5.0, 1.0, 5.8, 1.4),
    (7.0, -1.5, 7.3, -0.7),
    (-1.0, -2.0, 10.0, -1.9),
    (-1.0, 1.9, 10.0, 2.0),
    (-1.0, -2.0, -0.9, 2.0),
    (9.9, -2.0, 10.0, 2.0),
];

/// The scan of a robot that has driven this far along the hall, m; range 6 m.
fn scan(way: f64) -> Scan {
    seen_among(&HALL, way)
}

fn seen_among(boxes: &Boxes, way: f64) -> Scan {
    let range = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let hits = boxes.iter().filter_map(|(left, low, right, high)| {
            let (x1, x2) = ((left - way) / cos, (right - way) / cos);
            let (y1, y2) = (low / sin, high / sin);
            let (enter, leave) = (x1.min(x2).max(y1.min(y2)), x1.max(x2).min(y1.max(y2)));
            (0.0 < enter && enter <= leave).then_some(enter)
        });
        hits.fold(100.0, f64::min) as f32
    };
    let angles = (0..360).map(|beam| -3.1399 + f64::from(beam) * 0.017_45);
    Scan {
        stamp: Stamp::from_secs(10.0 + way),
        angle_min: -3.1399,
        angle_increment: 0.017_45,
        range_min: 0.02,
        range_max: 6.0,
        ranges: angles.map(range).collect(),
        odom_from_base: Pose2::new(TOO_FAR * way, 0.0, 0.0),
        ..Scan::default()
    }
}

fn settings() -> PoseSettings {
    PoseSettings {
        source: PoseSource::Slam,
        ..PoseSettings::default()
    }
}

fn core() -> MappingCore {
    MappingCore::new(Mapper::new(MappingSettings::default(), "new"), &settings())
}

/// The session to store, if it is due.
fn kept(mapping: &mut MappingCore, anyway: bool) -> Option<Kept> {
    mapping.is_keep_due(anyway).then(|| mapping.kept().unwrap().unwrap())
}

#[test]
fn a_frame_is_kept_before_it_is_told_and_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = core();
    let (mut told, mut before) = (0, mapping.mapper.info());
    for step in 0..80 {
        if step == 40 {
            mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
        }
        let mapped = mapping.insert(&scan(0.05 * f64::from(step)), "boot");
        if let Some(kept) = kept(&mut mapping, false) {
            mapping.was_kept(write(folder.path(), kept).unwrap());
            before = mapping.mapper.info();
        }
        told = mapped.frame.map_or(told, |frame| frame.map.frame);
        if told > 0 {
            assert_eq!(read(folder.path()).unwrap().unwrap().head.frame, told);
        }
    }
    assert_eq!(told, 1);
    // A line cut off when the process was killed belongs to no session.
    let mut scans = OpenOptions::new().append(true).open(folder.path().join(SCANS)).unwrap();
    scans.write_all(b"{\"stamp\"").unwrap();

    let mut after = core().going_on(read(folder.path()).unwrap().unwrap());
    assert_eq!(after.untold_frame(Stamp::ZERO).unwrap().map.frame, 1);
    let drawn = after.mapper.info();
    // Only the scans of nodes are redrawn.
    assert!(
        drawn.occupied as f64 > 0.9 * before.occupied as f64,
        "{} of {}",
        drawn.occupied,
        before.occupied
    );
    let mut last: Option<Correction> = None;
    for step in 90..130 {
        let mapped = after.insert(&scan(0.05 * f64::from(step)), "boot");
        last = mapped.correction.or(last);
        if let Some(kept) = kept(&mut after, true) {
            after.was_kept(write(folder.path(), kept).unwrap());
        }
    }
    let correction = last.unwrap();
    let away = correction
        .map_from_base
        .distance(&Pose2::new(correction.stamp.as_secs() - 10.0, 0.5, 0.0));
    assert!(correction.frame == 1 && away < 0.05, "{correction:?}: {away} m off");
    assert_eq!(read(folder.path()).unwrap().unwrap().head.frame, 1);
    remove(folder.path()).unwrap();
    assert!(read(folder.path()).unwrap().is_none());
}

/// The scan of a robot that was restarted after driving `before`, m: its odometry starts there.
fn restarted(way: f64, before: f64) -> Scan {
    Scan {
        odom_from_base: Pose2::new(TOO_FAR * (way - before), 0.0, 0.0),
        ..scan(way)
    }
}

/// Mapping of a robot that has driven this far, m.
fn driven(way: f64, folder: &Path) -> MappingCore {
    let mut mapping = core();
    let steps = (way / 0.05).round() as usize;
    for step in 0..=steps {
        mapping.insert(&scan(0.05 * step as f64), "boot");
        if let Some(kept) = kept(&mut mapping, false) {
            mapping.was_kept(write(folder, kept).unwrap());
        }
    }
    mapping
}

/// Position error of a scan taken after this much travel, m.
fn off(mapped: &Mapped, way: f64) -> f64 {
    let localisation = mapped.localisation.as_ref().unwrap();
    localisation.map_from_base.distance(&Pose2::new(way, 0.0, 0.0))
}

#[test]
fn a_robot_that_was_restarted_and_stands_is_tracked() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    for step in 0..12 {
        let mut scan = restarted(3.0, 3.0);
        scan.stamp = Stamp::from_secs(20.0 + f64::from(step));
        let mapped = mapping.insert(&scan, "another boot");
        assert_eq!(mapped.localisation.as_ref().unwrap().health, Health::Tracking);
        assert!(off(&mapped, 3.0) < 0.05, "{mapped:?}");
        // The edge starts at its configured pose and adopts the first correction as is.
        let correction = mapped.correction.map(|correction| correction.is_found_anew);
        assert_eq!(correction.unwrap_or_default(), step == 0, "{step}");
    }
}

#[test]
fn a_robot_that_drove_on_while_mapping_was_restarted_is_where_its_odometry_says() {
    let folder = tempfile::tempdir().unwrap();
    driven(3.0, folder.path());
    let mut mapping = core().going_on(read(folder.path()).unwrap().unwrap());
    // The first scan may arrive before the robot's first state.
    assert_eq!(mapping.insert(&scan(3.9), "").insertion, Insertion::Held);
    let mapped = mapping.insert(&scan(4.0), "boot");
    assert!(off(&mapped, 4.0) < 0.06, "{mapped:?}");
}

#[test]
fn a_robot_that_lost_power_with_mapping_is_found_where_it_came_after_the_session_was_kept() {
    let folder = tempfile::tempdir().unwrap();
    driven(3.0, folder.path());
    let stored = read(folder.path()).unwrap().unwrap();
    let kept = stored.head.map_from_odom * stored.scans.last().unwrap().odom_from_base;
    let way = kept.x + 1.7;
    let mut mapping = core().going_on(stored);
    for step in 0..8 {
        let mut scan = restarted(way, way);
        scan.stamp = Stamp::from_secs(20.0 + f64::from(step));
        let mapped = mapping.insert(&scan, "another boot");
        let localisation = mapped.localisation.as_ref().unwrap();
        assert_eq!(localisation.health, Health::Tracking);
        assert!(off(&mapped, way) < 0.1, "{mapped:?}");
    }
}

/// Inserts the scans between two distances along the hall, m, storing nothing.
fn drive(mapping: &mut MappingCore, from: f64, to: f64) {
    let steps = ((to - from) / 0.05).round() as usize;
    for step in 1..=steps {
        mapping.insert(&scan(from + 0.05 * step as f64), "boot");
    }
}

/// The same scan from a lidar mounted behind.
fn rear(scan: Scan) -> Scan {
    Scan {
        base_from_laser: Pose2::new(-0.2, 0.0, 0.0),
        ..scan
    }
}

#[test]
fn a_scan_of_another_boot_than_the_state_is_left_out() {
    let mut mapping = core();
    drive(&mut mapping, 0.0, 1.0);
    // The robot started again, and its state has not come yet; or the scan was on its way when the new state came.
    let other = Scan {
        boot_id: "another".to_owned(),
        odom_from_base: Pose2::IDENTITY,
        ..scan(1.05)
    };
    let before = mapping.mapper.info();
    let mapped = mapping.insert(&other, "boot");
    assert_eq!((mapped.insertion, mapped.correction), (Insertion::OutOfOrder, None));
    assert_eq!(mapping.insert_further(&rear(other), "boot"), Insertion::OutOfOrder);
    assert_eq!(mapping.mapper.info(), before);
    let own = Scan {
        boot_id: "boot".to_owned(),
        ..scan(1.05)
    };
    assert_eq!(mapping.insert(&own, "boot").insertion, Insertion::Inserted);
}

#[test]
fn a_scan_of_a_further_lidar_waits_until_the_main_one_has_placed_the_robot() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = core();
    assert_eq!(mapping.insert_further(&rear(scan(0.0)), "boot"), Insertion::Held);
    mapping.insert(&scan(0.0), "boot");
    assert_eq!(mapping.insert_further(&rear(scan(0.0)), "boot"), Insertion::Inserted);
    drive(&mut mapping, 0.0, 3.0);
    mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
    write(folder.path(), kept(&mut mapping, true).unwrap()).unwrap();

    let mut mapping = core().going_on(read(folder.path()).unwrap().unwrap());
    assert_eq!(mapping.mapper.map().frame, 1, "the closure moved the map at the start");
    assert_eq!(
        mapping.insert_further(&rear(scan(3.0)), "another boot"),
        Insertion::Held
    );
    // Far enough from the last trajectory point to add one.
    mapping.insert_further(&rear(scan(3.15)), "boot");
    let place = mapping.mapper.trajectory().last().unwrap();
    assert!((place.x - 3.15).abs() < 0.02 && (place.y - 0.5).abs() < 0.02, "{place}");
}

#[test]
fn a_write_that_fails_leaves_the_session_as_it_was_and_the_next_one_adds_to_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    let before = read(folder.path()).unwrap().unwrap().scans;
    let whole = std::fs::read(folder.path().join(SCANS)).unwrap();
    // The scans can be written, the session that refers to them cannot.
    let blocker = folder.path().join(format!(".{SESSION}.{}.part", std::process::id()));
    std::fs::create_dir(&blocker).unwrap();
    drive(&mut mapping, 3.0, 4.0);
    let failing = kept(&mut mapping, true).unwrap();
    assert!(matches!(write(folder.path(), failing), Err(KeepError::File(_))));
    mapping.was_not_kept(false);
    assert_eq!(read(folder.path()).unwrap().unwrap().scans, before);

    drive(&mut mapping, 4.0, 4.2);
    let again = kept(&mut mapping, false).unwrap();
    assert_eq!(
        again.on_disk.scans,
        before.len(),
        "what is on disk is not written again"
    );
    assert!(write(folder.path(), again).is_err());
    mapping.was_not_kept(false);
    assert!(std::fs::read(folder.path().join(SCANS)).unwrap().starts_with(&whole));
    assert_eq!(read(folder.path()).unwrap().unwrap().scans, before);

    std::fs::remove_dir(blocker).unwrap();
    let kept = kept(&mut mapping, false).unwrap();
    let expected = kept.head.scans;
    mapping.was_kept(write(folder.path(), kept).unwrap());
    let after = read(folder.path()).unwrap().unwrap();
    assert!(after.scans.len() > before.len() && after.scans.starts_with(&before));
    assert_eq!(after.scans.len(), expected);
}

#[test]
fn scans_that_somebody_else_cut_are_all_written_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    let before = read(folder.path()).unwrap().unwrap().scans;
    let file = OpenOptions::new().write(true).open(folder.path().join(SCANS)).unwrap();
    file.set_len(1000).unwrap();
    drive(&mut mapping, 3.0, 3.5);
    let missing = write(folder.path(), kept(&mut mapping, true).unwrap());
    assert!(matches!(missing, Err(KeepError::Changed { .. })), "{missing:?}");
    mapping.was_not_kept(true);
    let kept = kept(&mut mapping, false).unwrap();
    mapping.was_kept(write(folder.path(), kept).unwrap());
    let after = read(folder.path()).unwrap().unwrap().scans;
    assert!(after.len() > before.len() && after.starts_with(&before));
}

#[tokio::test(flavor = "multi_thread")]
async fn a_place_lies_where_a_closure_has_moved_it_after_a_restart_too() {
    let sink = GoalPoint {
        x: 1.0,
        y: 0.5,
        yaw: None,
    };
    // A closure before the restart of mapping, with the map already redrawn or not yet.
    for is_drawn in [true, false] {
        let folder = tempfile::tempdir().unwrap();
        let config = MappingConfig {
            folder: Some(folder.path().to_owned()),
            poses: settings(),
            places: [("sink".to_owned(), sink)].into(),
            ..MappingConfig::new("tiago")
        };
        let mut mapping = core();
        let mut book = AnnotationBook::open(config.places.clone(), &config.zones, config.folder.as_deref()).unwrap();
        let mut frame = MapFrame::default();
        for step in 0..60 {
            if let Some(next) = mapping.insert(&scan(0.05 * f64::from(step)), "boot").frame {
                frame = next;
            }
        }
        mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
        if is_drawn {
            let next = mapping.insert(&scan(3.0), "boot").frame.unwrap();
            book.carry_over(&frame, &next);
        }
        let mut kept = kept(&mut mapping, true).unwrap();
        assert_eq!(kept.head.frame, u64::from(is_drawn));
        kept.head.annotations = book.carried();
        write(folder.path(), kept).unwrap();

        let (router, endpoint) = router().await;
        let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
        let mut annotations = client.latest(&ANNOTATIONS, &["tiago"]).unwrap();
        let bus = Bus::open(BusConfig::service("mapping", &endpoint)).await.unwrap();
        let shutdown = Shutdown::new();
        let service = tokio::spawn(run(bus, Clock::wall(), config, shutdown.clone()));
        let told = tokio::time::timeout(DEADLINE, annotations.next())
            .await
            .unwrap()
            .unwrap()
            .message;
        let told_sink = told.places["sink"];
        let off = (told_sink.x - sink.x).hypot(told_sink.y - 1.0);
        assert!(told.frame == 1 && off < 1e-9, "{told:?}");
        shutdown.trigger();
        service.await.unwrap().unwrap();
        // The same again, from what the service has stored.
        let kept = read(folder.path()).unwrap().unwrap().head;
        assert!(kept.frame == 1 && kept.annotations != Carried::default());
        router.close().await;
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn mapping_that_is_killed_in_mid_drive_goes_on_with_its_map() {
    let (router, endpoint) = router().await;
    let open = |name: &'static str| Bus::open(BusConfig::service(name, &endpoint));
    let folder = tempfile::tempdir().unwrap();
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        poses: settings(),
        ..MappingConfig::new("tiago")
    };
    let client = open("client").await.unwrap();
    let chunks = ["tiago"];
    let scans = client.publisher(&SCAN, &chunks).unwrap();
    let states = client.publisher(&STATE, &chunks).unwrap();
    let mut corrections = client.subscribe(&CORRECTION, &chunks, 64).unwrap();
    let begin = async |name| {
        let bus = open(name).await.unwrap();
        let shutdown = Shutdown::new();
        (
            tokio::spawn(run(bus, Clock::wall(), config.clone(), shutdown.clone())),
            shutdown,
        )
    };
    let asked = async || {
        client
            .ask(&MAP, &chunks, &MapRequest::default(), DEADLINE)
            .await
            .unwrap()
    };

    let (service, _) = begin("mapping").await;
    asked().await;
    let mut way = 0.0;
    let drive = async |way: &mut f64| {
        *way += 0.05;
        scans.put(&scan(*way));
        // The state comes after the scan, and less often.
        if (*way / 0.05).round() as usize % 4 == 3 {
            states.put(&state());
        }
        tokio::time::sleep(Duration::from_millis(15)).await;
    };
    while way < 4.0 {
        drive(&mut way).await;
    }
    let before = asked().await;
    service.abort();
    assert!(service.await.unwrap_err().is_cancelled());
    let kept = read(folder.path()).unwrap().unwrap();
    assert!(kept.scans.len() >= 10, "{} nodes", kept.scans.len());

    // Meanwhile the robot drives on, farther than the search after its own restart would reach.
    way += 1.5;
    let (service, shutdown) = begin("mapping-again").await;
    let after = asked().await;
    assert!(
        after.info.occupied > before.info.occupied / 3,
        "{:?} {:?}",
        after.info,
        before.info
    );
    while corrections.try_next().is_some() {}
    let found = tokio::time::timeout(DEADLINE, async {
        while way < 8.0 {
            drive(&mut way).await;
        }
        corrections.next().await.unwrap().message
    });
    let correction = found.await.unwrap();
    let off = correction
        .map_from_base
        .distance(&Pose2::new(correction.stamp.as_secs() - 10.0, 0.0, 0.0));
    assert!(off < 0.06, "{correction:?}: {off} m off");
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

/// The robot's state in its boot.
fn state() -> EdgeState {
    serde_json::from_value(serde_json::json!({
        "stamp": 1, "boot_id": "boot", "mode": "idle", "link": "Connected", "lease": LeaseState::default(),
        "velocity": {"v": 0.0, "w": 0.0}, "guard": "clear", "battery": 1.0
    }))
    .unwrap()
}

fn asked(action: MapAction) -> MapRequest {
    MapRequest {
        action,
        ..MapRequest::default()
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn a_map_that_another_source_begins_anew_leaves_the_session_alone() {
    let (router, endpoint) = router().await;
    let folder = tempfile::tempdir().unwrap();
    driven(3.0, folder.path());
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        ..MappingConfig::new("tiago")
    };
    let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
    let bus = Bus::open(BusConfig::service("mapping", &endpoint)).await.unwrap();
    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(bus, Clock::wall(), config, shutdown.clone()));
    let reset = client.ask(&MAP, &["tiago"], &asked(MapAction::Reset), DEADLINE).await;
    assert!(reset.is_ok(), "{reset:?}");
    shutdown.trigger();
    service.await.unwrap().unwrap();
    assert!(read(folder.path()).unwrap().is_some());
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn slam_in_a_given_map_sets_the_session_aside_that_it_did_not_begin_with() {
    let (router, endpoint) = router().await;
    let folder = tempfile::tempdir().unwrap();
    let grid = driven(3.0, folder.path()).mapper.grid();
    let before = std::fs::read(folder.path().join(SESSION)).unwrap();
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        poses: settings(),
        known: Some(KnownMap {
            grid: grid.into(),
            live: true,
        }),
        ..MappingConfig::new("tiago")
    };
    let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
    let scans = client.publisher(&SCAN, &["tiago"]).unwrap();
    let states = client.publisher(&STATE, &["tiago"]).unwrap();
    let bus = Bus::open(BusConfig::service("mapping", &endpoint)).await.unwrap();
    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(bus, Clock::wall(), config, shutdown.clone()));
    let aside = folder.path().join("slam.session.before");
    let mut way = 0.0;
    tokio::time::timeout(DEADLINE, async {
        while !aside.exists() {
            way += 0.05;
            states.put(&state());
            scans.put(&scan(way));
            tokio::time::sleep(Duration::from_millis(20)).await;
        }
    })
    .await
    .unwrap();
    shutdown.trigger();
    service.await.unwrap().unwrap();
    assert_eq!(std::fs::read(&aside).unwrap(), before);
    assert!(folder.path().join("slam.scans.before").exists());
    let new = read(folder.path()).unwrap().unwrap();
    assert!(new.scans.len() < 20, "{} nodes", new.scans.len());
    router.close().await;
}

#[tokio::test(flavor = "multi_thread")]
async fn a_session_that_the_disk_does_not_give_stops_mapping_and_one_that_means_nothing_is_set_aside() {
    let folder = tempfile::tempdir().unwrap();
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        poses: settings(),
        ..MappingConfig::new("tiago")
    };
    // A folder cannot be read as a file.
    std::fs::create_dir(folder.path().join(SESSION)).unwrap();
    let error = super::super::storage::session(&config).await.unwrap_err();
    assert!(error.to_string().contains("not dropped silently"), "{error}");
    assert!(folder.path().join(SESSION).exists());
    std::fs::remove_dir(folder.path().join(SESSION)).unwrap();
    for name in ["slam.session.unreadable", "slam.session.unreadable.2"] {
        std::fs::write(folder.path().join(SESSION), name).unwrap();
        std::fs::write(folder.path().join(SCANS), name).unwrap();
        assert!(super::super::storage::session(&config).await.unwrap().is_none());
        assert_eq!(std::fs::read(folder.path().join(name)).unwrap(), name.as_bytes());
        assert!(!folder.path().join(SESSION).exists());
    }
}

#[tokio::test(flavor = "multi_thread")]
async fn whoever_stores_the_map_hears_that_the_session_is_not_kept_and_may_ask_again_at_once() {
    let (router, endpoint) = router().await;
    let folder = tempfile::tempdir().unwrap();
    let config = MappingConfig {
        folder: Some(folder.path().to_owned()),
        poses: settings(),
        ..MappingConfig::new("tiago")
    };
    let blocker = folder.path().join(format!(".{SESSION}.{}.part", std::process::id()));
    std::fs::create_dir(&blocker).unwrap();
    let client = Bus::open(BusConfig::service("client", &endpoint)).await.unwrap();
    let scans = client.publisher(&SCAN, &["tiago"]).unwrap();
    let states = client.publisher(&STATE, &["tiago"]).unwrap();
    let bus = Bus::open(BusConfig::service("mapping", &endpoint)).await.unwrap();
    let shutdown = Shutdown::new();
    let service = tokio::spawn(run(bus, Clock::wall(), config, shutdown.clone()));
    let ask = async |request: MapRequest| client.ask(&MAP, &["tiago"], &request, DEADLINE).await;
    let mut way = 0.0;
    while ask(MapRequest::default()).await.unwrap().info.scans < 10 {
        way += 0.05;
        states.put(&state());
        scans.put(&scan(way));
    }
    let refused = ask(asked(MapAction::Save)).await.unwrap_err().to_string();
    assert!(refused.contains("the session of SLAM is not kept"), "{refused}");
    let named = MapRequest {
        name: Some("attic".to_owned()),
        ..asked(MapAction::Save)
    };
    assert!(ask(named).await.is_ok(), "with a name it is about the drawing alone");
    std::fs::remove_dir(blocker).unwrap();
    ask(asked(MapAction::Save)).await.unwrap();
    let kept = read(folder.path()).unwrap().unwrap();
    assert!(kept.scans.len() > 3, "{} nodes", kept.scans.len());
    shutdown.trigger();
    service.await.unwrap().unwrap();
    router.close().await;
}

#[test]
fn settings_that_were_edited_meanwhile_hold_for_the_scans_to_come() {
    let folder = tempfile::tempdir().unwrap();
    driven(3.0, folder.path());
    let stored = read(folder.path()).unwrap().unwrap();
    let before = stored.scans.len();
    let mut edited = settings();
    edited.slam.front.distance = 0.5;
    edited.slam.field.sigma *= 1.2;
    let mut mapping = MappingCore::new(Mapper::new(MappingSettings::default(), "new"), &edited).going_on(stored);
    for step in 0..20 {
        let way = 3.0 + 0.1 * f64::from(step);
        let mapped = mapping.insert(&scan(way), "boot");
        let off = mapped
            .localisation
            .map(|told| told.map_from_base.distance(&Pose2::new(way, 0.0, 0.0)));
        assert!(off.is_none_or(|off| off < 0.06), "{off:?} m off");
    }
    let kept = kept(&mut mapping, true).unwrap();
    let new = kept.head.scans - before;
    assert!((3..6).contains(&new), "{new} nodes in 2 m");
    write(folder.path(), kept).unwrap();
    assert_eq!(*read(folder.path()).unwrap().unwrap().slam.settings(), edited.slam);
}

//! Tests of places and zones.

#![allow(clippy::unwrap_used, reason = "tests")]

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::{MapFrame, Zone, ZoneRule};

use super::super::storage;
use super::*;

fn at(x: f64) -> GoalPoint {
    GoalPoint { x, y: 0.0, yaw: None }
}

fn zone(name: &str, side: f64) -> Zone {
    Zone {
        name: name.into(),
        rule: ZoneRule::KeepOut,
        points: [[0.0, 0.0], [side, 0.0], [side, side]].map(Point2::from).into(),
    }
}

fn add(name: &str, x: f64) -> AnnotateAction {
    AnnotateAction::AddPlace {
        name: name.into(),
        at: at(x),
    }
}

fn book(folder: &Path) -> AnnotationBook {
    let zones = Zones::new(&[zone("stairs", 1.0)]).unwrap();
    AnnotationBook::open([("sink".to_owned(), at(1.0))].into(), &zones, Some(folder)).unwrap()
}

fn names(book: &AnnotationBook) -> (Vec<String>, Vec<String>) {
    let now = book.now();
    let zones = now.zones.iter().map(|zone| zone.name.clone());
    (now.places.keys().cloned().collect(), zones.collect())
}

#[tokio::test]
async fn what_was_changed_is_there_after_a_restart_and_the_base_may_change_under_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = book(folder.path());
    assert!(first.change(add("fridge", 2.0)).await.unwrap());
    assert!(!first.change(add("fridge", 2.0)).await.unwrap(), "the same again");
    let remove = AnnotateAction::RemovePlace { name: "sink".into() };
    first.change(remove).await.unwrap();
    first
        .change(AnnotateAction::AddZone { zone: zone("wet", 2.0) })
        .await
        .unwrap();
    assert_eq!(first.now().revision, 3);
    let second = book(folder.path());
    assert_eq!(second.now(), first.now());
    assert_eq!(
        names(&second),
        (vec!["fridge".into()], vec!["stairs".into(), "wet".into()])
    );
    let base = AnnotationBook::open(
        [("oven".to_owned(), at(3.0))].into(),
        &Zones::default(),
        Some(folder.path()),
    );
    assert_eq!(
        names(&base.unwrap()),
        (vec!["fridge".into(), "oven".into()], vec!["wet".into()])
    );
}

#[tokio::test]
async fn another_service_takes_over_what_was_published_last_and_stores_it() {
    let folders = [(); 2].map(|()| tempfile::tempdir().unwrap());
    let mut led = book(folders[0].path());
    led.change(add("fridge", 2.0)).await.unwrap();
    led.change(AnnotateAction::RemovePlace { name: "sink".into() })
        .await
        .unwrap();
    led.change(AnnotateAction::AddZone {
        zone: zone("stairs", 3.0),
    })
    .await
    .unwrap();
    let mut copy = book(folders[1].path());
    // What this service had stored itself, an earlier time that it led.
    copy.change(add("oven", 5.0)).await.unwrap();
    copy.take_over("tiago", led.now()).await;
    let newer = Annotations {
        revision: led.now().revision + 1,
        ..led.now().clone()
    };
    assert_eq!(*copy.now(), newer);
    assert_eq!(*book(folders[1].path()).now(), newer);
    let malformed = Annotations {
        zones: vec![Zone {
            points: Vec::new(),
            ..zone("none", 1.0)
        }],
        ..Annotations::default()
    };
    copy.take_over("tiago", &malformed).await;
    assert_eq!(*copy.now(), newer);
}

#[tokio::test]
async fn a_list_that_does_not_know_another_one_removes_nothing_from_it() {
    let folders = [(); 3].map(|()| tempfile::tempdir().unwrap());
    let [mut mine, mut empty, mut other] = [0, 1, 2].map(|index: usize| book(folders[index].path()));
    let wet = AnnotateAction::AddZone { zone: zone("wet", 2.0) };
    mine.change(wet).await.unwrap();
    // One that leads with an older list, or with another of the same revision.
    mine.follow("tiago", empty.now()).await;
    assert_eq!(
        (mine.now().revision, names(&mine).1),
        (1, vec!["stairs".into(), "wet".into()])
    );
    other
        .change(AnnotateAction::AddZone {
            zone: zone("crane", 3.0),
        })
        .await
        .unwrap();
    assert!(!mine.is_succeeded_by(other.now()));
    mine.follow("tiago", other.now()).await;
    let all: Vec<String> = ["crane", "stairs", "wet"].map(String::from).into();
    assert_eq!((mine.now().revision, names(&mine).1), (2, all.clone()));
    assert_eq!(names(&book(folders[0].path())).1, all, "it is stored");
    mine.take_over("tiago", empty.now()).await;
    assert_eq!(names(&mine).1, all);
    // One that follows it has all of them, and knows of a removal.
    empty.follow("tiago", mine.now()).await;
    assert_eq!(empty.now(), mine.now());
    mine.change(AnnotateAction::RemoveZone { name: "wet".into() })
        .await
        .unwrap();
    assert!(empty.is_succeeded_by(mine.now()));
    empty.follow("tiago", mine.now()).await;
    assert_eq!(names(&empty).1, ["crane", "stairs"]);
    assert_eq!(book(folders[1].path()).now(), mine.now());
    let leapt = Annotations {
        revision: u64::MAX,
        ..Annotations::default()
    };
    empty.follow("tiago", &leapt).await;
    assert_eq!(empty.now(), mine.now());
}

#[tokio::test]
async fn the_folder_of_another_service_is_not_written() {
    let folder = tempfile::tempdir().unwrap();
    let other = tempfile::tempdir().unwrap();
    let mut led = book(other.path());
    led.change(add("fridge", 2.0)).await.unwrap();
    let lock = storage::guard(folder.path()).unwrap().unwrap();
    let mut copy = book(folder.path());
    copy.follow("tiago", led.now()).await;
    assert_eq!(copy.now(), led.now());
    assert!(!folder.path().join(FILE).exists());
    drop(lock);
}

#[tokio::test]
async fn zones_are_removed_one_by_one_or_all() {
    let folder = tempfile::tempdir().unwrap();
    let mut book = book(folder.path());
    book.change(AnnotateAction::AddZone { zone: zone("wet", 2.0) })
        .await
        .unwrap();
    let remove = AnnotateAction::RemoveZone { name: "stairs".into() };
    book.change(remove.clone()).await.unwrap();
    assert_eq!(names(&book).1, ["wet"]);
    let refusal = book.change(remove).await.unwrap_err().to_string();
    assert!(refusal.contains("zone `stairs`; there are wet"), "{refusal}");
    book.change(AnnotateAction::ClearZones).await.unwrap();
    assert!(names(&book).1.is_empty());
}

/// A map of one part, which lies elsewhere in each frame.
fn frame(number: u64, part: Pose2) -> MapFrame {
    let mut frame = MapFrame {
        parts: vec![part],
        ..MapFrame::default()
    };
    frame.map.frame = number;
    frame
}

#[tokio::test]
async fn a_session_that_goes_on_has_its_places_and_zones_where_it_had_carried_them() {
    let folder = tempfile::tempdir().unwrap();
    let mut first = book(folder.path());
    first.change(add("fridge", 2.0)).await.unwrap();
    let begun = frame(0, Pose2::IDENTITY);
    let moved = frame(1, Pose2::new(0.0, 3.0, 0.0));
    first.carry_over(&begun, &moved);
    let carried = first.carried();
    assert_eq!(
        (first.now().places["sink"].y, first.now().places["fridge"].y),
        (3.0, 3.0)
    );
    let mut again = book(folder.path());
    again.go_on(&carried, 1);
    assert_eq!(again.now(), first.now());
    assert_eq!(again.carried(), carried);

    // An item added in the new frame is in the file with its coordinates, like all others.
    first.change(add("oven", 4.0)).await.unwrap();
    let mut again = book(folder.path());
    again.go_on(&carried, 1);
    assert_eq!(again.now(), first.now());
    assert_eq!(again.now().places["oven"].y, 0.0);
    let turned = frame(2, Pose2::new(0.0, 5.0, 0.0));
    again.carry_over(&moved, &turned);
    let mut third = book(folder.path());
    third.go_on(&again.carried(), 2);
    assert_eq!(third.now(), again.now());
    assert_eq!((third.now().places["sink"].y, third.now().places["oven"].y), (5.0, 2.0));

    // A place of the deployment that was edited meanwhile is where the edit puts it.
    let sinks = [("sink".to_owned(), at(1.5))].into();
    let mut edited = AnnotationBook::open(sinks, &Zones::default(), Some(folder.path())).unwrap();
    edited.go_on(&again.carried(), 2);
    assert_eq!(edited.now().places["sink"], at(1.5));
}

#[tokio::test]
async fn what_cannot_be_is_refused_and_changes_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut book = book(folder.path());
    let before = book.now().clone();
    for (action, what) in [
        (add("a|b", 1.0), "the name"),
        (add("", 1.0), "the name"),
        (add("far", f64::NAN), "finite"),
        (
            AnnotateAction::AddPlace {
                name: "turned".into(),
                at: GoalPoint {
                    yaw: Some(90.0),
                    ..at(0.0)
                },
            },
            "expected radians",
        ),
        (
            AnnotateAction::AddZone {
                zone: zone("flat", 0.0),
            },
            "zone `flat`",
        ),
        (AnnotateAction::RemovePlace { name: "moon".into() }, "there are sink"),
    ] {
        let refusal = book.change(action).await.unwrap_err().to_string();
        assert!(refusal.contains(what), "{what}: {refusal}");
    }
    assert_eq!(*book.now(), before);
}

#[test]
fn a_file_that_cannot_be_read_is_not_passed_over() {
    let folder = tempfile::tempdir().unwrap();
    std::fs::write(folder.path().join(FILE), "{\"places\": 3}").unwrap();
    let error = AnnotationBook::open(BTreeMap::new(), &Zones::default(), Some(folder.path())).unwrap_err();
    assert!(error.to_string().contains(FILE), "{error}");
}

#[test]
fn zones_that_share_a_name_get_names_of_their_own() {
    let zones = with_own_names(vec![zone("a", 1.0), zone("a", 2.0), zone("a", 3.0)]);
    let names: Vec<&str> = zones.iter().map(|zone| zone.name.as_str()).collect();
    assert_eq!(names, ["a", "a_2", "a_3"]);
}

//! Tests of the redraw after a closure: scans do not wait for it, and a successor comes to the same frame.

use nalgebra::Point2;
use zenav_protocol::grid::Occupancy;
use zenav_protocol::messages::MapRef;

use super::super::super::slam_redraw::Ahead;
use super::*;

/// A hall that was mapped along 3 m, and then moved by half a metre.
fn moved_hall() -> MappingCore {
    let mut mapping = core();
    mapping.insert(&scan(0.0), "boot");
    drive(&mut mapping, 0.0, 3.0);
    mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
    mapping
}

#[test]
fn the_map_is_the_same_whether_another_thread_has_redrawn_it_ahead_or_not() {
    let map = |is_ahead: bool| {
        let mut mapping = moved_hall();
        let work = mapping.take_ahead();
        assert_eq!(work.len(), 1);
        for work in work.iter().filter(|_| is_ahead) {
            work.run();
        }
        let frames: Vec<Option<u64>> = [3.0001, 3.05, 3.1]
            .map(|way| {
                let mapped = mapping.insert(&scan(way), "boot");
                mapped.frame.map(|frame| frame.map.frame)
            })
            .into();
        assert!(mapping.take_ahead().is_empty());
        (frames, mapping.mapper.grid())
    };
    let (frames, grid) = map(true);
    assert_eq!(
        frames[..2],
        [None, Some(1)],
        "not before it is due by the scans' stamps"
    );
    assert!((frames, grid) == map(false));
}

#[test]
fn a_redraw_that_a_later_one_has_replaced_is_not_drawn() {
    let mut mapping = moved_hall();
    let work = mapping.take_ahead();
    let Ahead::Redraw(drawing) = &work[0] else {
        panic!("{work:?}")
    };
    mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
    work[0].run();
    assert!(drawing.map(|| true).grid() == mapping.mapper.redrawing().grid());
}

#[test]
fn the_map_that_a_copy_has_taken_over_outlives_a_closure() {
    let mut led = Mapper::new(MappingSettings::default(), "led");
    led.insert(&scan(0.0));
    // Another hall, which the robot does not see again.
    led.insert(&Scan {
        stamp: Stamp::from_secs(11.0),
        map_from_odom: Pose2::new(-20.0, 0.0, 0.0),
        ..scan(0.0)
    });
    let map = MapRef {
        id: "copy".into(),
        revision: 0,
        frame: 3,
    };
    let taken_over = Mapper::inheriting(MappingSettings::default(), map, &led.grid(), None);
    let mut mapping = MappingCore::new(taken_over, &settings());
    mapping.locate_first();
    drive(&mut mapping, 0.0, 3.0);
    mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
    let mapped = mapping.insert(&scan(3.05), "boot");
    assert_eq!(mapped.frame.map(|frame| frame.map.frame), Some(4));
    let elsewhere = mapping
        .mapper
        .grid()
        .at(Point2::new(-19.5, 0.0))
        .map(|value| Occupancy::of(*value));
    assert_eq!(elsewhere, Some(Occupancy::Free));

    // It outlives a restart, too.
    let folder = tempfile::tempdir().unwrap();
    let written = kept(&mut mapping, true).unwrap();
    assert_eq!((written.head.base.as_str(), written.base.is_some()), ("copy", true));
    mapping.was_kept(write(folder.path(), written).unwrap());
    let successor = core().going_on(read(folder.path()).unwrap().unwrap());
    let elsewhere = successor
        .mapper
        .grid()
        .at(Point2::new(-19.5, 0.0))
        .map(|value| Occupancy::of(*value));
    assert_eq!(elsewhere, Some(Occupancy::Free));

    // It is written once, and not with a map that SLAM begins by itself.
    drive(&mut mapping, 3.1, 5.0);
    let again = kept(&mut mapping, true).unwrap();
    assert_eq!((again.head.base.as_str(), again.base.is_some()), ("copy", false));
    mapping.reset("own");
    mapping.insert(&scan(5.1), "boot");
    let own = kept(&mut mapping, true).unwrap();
    assert_eq!((own.head.base.as_str(), own.base.is_some()), ("", false));
}

#[test]
fn a_session_whose_first_map_is_missing_is_not_resumed_without_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut led = Mapper::new(MappingSettings::default(), "led");
    led.insert(&scan(0.0));
    let mut mapping = core();
    let map = MapRef {
        id: "loaded".into(),
        ..MapRef::default()
    };
    mapping.load(map, &led.grid(), Vec::new(), 1);
    mapping.locate_first();
    mapping.mapper.resume();
    drive(&mut mapping, 0.0, 1.0);
    write(folder.path(), kept(&mut mapping, true).unwrap()).unwrap();
    assert!(read(folder.path()).unwrap().is_some());
    std::fs::rename(folder.path().join(BASE), folder.path().join("elsewhere")).unwrap();
    let error = read(folder.path()).unwrap_err();
    assert!(
        !error.is_transient() && error.to_string().contains("`loaded`"),
        "{error}"
    );
    std::fs::rename(folder.path().join("elsewhere"), folder.path().join(BASE)).unwrap();

    // It goes with its session wherever that goes.
    let aside = set_aside(folder.path(), "before").unwrap().unwrap();
    assert!(aside.exists() && folder.path().join("slam.base.before/map.yaml").exists());
    assert!(!folder.path().join(BASE).exists());
}

#[test]
fn after_a_restart_of_the_robot_with_an_earlier_clock_the_new_map_does_not_wait_for_the_old_one() {
    let mut mapping = moved_hall();
    let earlier = Scan {
        stamp: Stamp::from_secs(1.0),
        ..scan(3.05)
    };
    assert!(mapping.insert(&earlier, "another boot").frame.is_some());
}

#[test]
fn a_session_stored_while_the_map_is_redrawn_leads_a_successor_to_the_frame_that_it_begins() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = moved_hall();
    let kept = kept(&mut mapping, false).unwrap();
    let change = kept.change;
    write(folder.path(), kept).unwrap();
    assert!(mapping.in_force() < change, "the frame before the closure");
    let frame = mapping.insert(&scan(3.05), "boot").frame.unwrap();
    assert_eq!((frame.map.frame, mapping.in_force()), (1, change));

    let mut successor = core().going_on(read(folder.path()).unwrap().unwrap());
    let resumed = successor.untold_frame(Stamp::ZERO).unwrap();
    assert_eq!((resumed.map.frame, resumed.moves.len()), (1, 1));
    assert!(resumed.moves[0].distance(&frame.moves[0]) < 1e-9, "{resumed:?}");
    let parts = resumed.parts.iter().zip(&frame.parts);
    assert!(
        parts.map(|(a, b)| a.distance(b)).fold(0.0, f64::max) < 1e-9,
        "{resumed:?}"
    );
}

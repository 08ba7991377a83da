//! Tests of a lost robot: what happens to the map meanwhile, and how the robot is found.

use super::*;

/// A scan that fits nowhere, with beams through walls.
fn nowhere(way: f64) -> Scan {
    let mut scan = scan(way);
    for (beam, range) in scan.ranges.iter_mut().enumerate() {
        *range += 0.8 + 0.5 * ((beam * 7 % 11) as f32 / 11.0);
    }
    scan
}

/// The same scan a second later.
fn later(scan: Scan) -> Scan {
    Scan {
        stamp: Stamp::from_secs(scan.stamp.as_secs() + 1.0),
        ..scan
    }
}

/// Two rooms with a door between them.
const ROOMS: [(f64, f64, f64, f64); 12] = [
    (4.0, -3.1, 10.0, -3.0),
    (4.0, 2.5, 10.0, 2.6),
    (-2.0, -1.9, 4.0, -1.8),
    (-2.0, 3.2, 4.0, 3.3),
    (-2.1, -1.9, -2.0, 3.3),
    (10.0, -3.1, 10.1, 2.6),
    (3.9, -3.1, 4.1, -0.8),
    (3.9, 0.8, 4.1, 3.3),
    (-2.0, 1.7, -0.8, 3.2),
    (0.5, -1.8, 1.1, -1.2),
    (8.8, -3.0, 10.0, -1.7),
    (6.2, 1.6, 7.0, 2.2),
];

/// Scans of a standing robot that was carried in the rooms, from one distance along its drive to an earlier one, m.
fn carried(from: f64, to: f64) -> impl Iterator<Item = Scan> {
    (0..).map(move |nth| Scan {
        stamp: Stamp::from_secs(100.0 + 0.2 * f64::from(nth)),
        odom_from_base: scan(from).odom_from_base,
        ..seen_among(&ROOMS, to)
    })
}

/// The scan of a robot that was carried back to its start after 6 m and has driven this far from there, m.
fn on_from_start(way: f64) -> Scan {
    Scan {
        stamp: Stamp::from_secs(200.0 + way),
        odom_from_base: Pose2::new(TOO_FAR * (6.0 + way), 0.0, 0.0),
        ..seen_among(&ROOMS, way)
    }
}

/// The rooms without the wall on one side of the door.
fn opened() -> Vec<(f64, f64, f64, f64)> {
    let stays = |wall: &&(f64, f64, f64, f64)| wall.3 > 0.0 || wall.0 != 3.9;
    ROOMS.iter().filter(stays).copied().collect()
}

/// Mapping of a robot that has driven this far through the rooms, m.
fn driven_through_rooms(way: f64) -> MappingCore {
    let mut mapping = core();
    for step in 0..=(way / 0.05).round() as usize {
        mapping.insert(&seen_among(&ROOMS, 0.05 * step as f64), "boot");
    }
    mapping
}

#[test]
fn what_a_lost_robot_sees_is_drawn_neither_at_once_nor_later() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    let kept_before = kept(&mut mapping, true).unwrap();
    mapping.was_kept(write(folder.path(), kept_before).unwrap());
    let stored = read(folder.path()).unwrap().unwrap();
    let nodes = stored.head.scans;
    let clean = core().going_on(stored).mapper.info();
    let before = mapping.mapper.info();
    // The robot stands, gets lost, and drives on. Its last scans before were lost on their way: nothing says whether it was carried.
    for step in 1..=7 {
        let scan = later(nowhere(if step < 7 { 3.0 + 1e-3 * f64::from(step) } else { 3.15 }));
        let mapped = mapping.insert(&scan, "boot");
        assert_eq!(mapped.insertion, Insertion::Held, "{step}");
        assert_eq!(mapping.insert_further(&rear(scan), "boot"), Insertion::Held, "{step}");
        let is_lost = mapping.health() == Health::Lost;
        assert_eq!(is_lost, step >= 5, "{step}");
    }
    let drawn = mapping.mapper.info();
    assert_eq!((drawn.free, drawn.occupied), (before.free, before.occupied));
    write(folder.path(), kept(&mut mapping, false).unwrap()).unwrap();
    let stored = read(folder.path()).unwrap().unwrap();
    assert_eq!(stored.head.scans, nodes);
    assert_eq!(core().going_on(stored).health(), Health::Searching, "it still is lost");
    mapping.bend(|pose| Pose2::new(pose.x, pose.y + 0.5, pose.yaw));
    mapping.insert(&later(nowhere(3.16)), "boot");
    assert_eq!(mapping.mapper.map().frame, 1);
    let drawn = mapping.mapper.info();
    assert!(drawn.occupied.abs_diff(clean.occupied) < 30, "{drawn:?} {clean:?}");
}

#[test]
fn where_the_building_has_changed_the_robot_stays_where_it_is_and_draws_it_anew() {
    let mut mapping = driven_through_rooms(3.2);
    let occupied = mapping.mapper.info().occupied;
    // The wall beside the door in front of the robot is gone.
    let opened = opened();
    for nth in 0..40 {
        let scan = Scan {
            stamp: Stamp::from_secs(100.0 + 0.2 * f64::from(nth)),
            odom_from_base: scan(3.2).odom_from_base,
            ..seen_among(&opened, 3.2)
        };
        mapping.insert(&scan, "boot");
    }
    assert_eq!(mapping.health(), Health::Tracking);
    assert!(mapping.mapper.info().occupied < occupied, "the wall is still drawn");
    let on = Scan {
        stamp: Stamp::from_secs(200.0),
        ..seen_among(&opened, 3.5)
    };
    let mapped = mapping.insert(&on, "boot");
    let off = mapped
        .localisation
        .unwrap()
        .map_from_base
        .distance(&Pose2::new(3.5, 0.0, 0.0));
    assert!(off < 0.05, "{off} m off");
}

#[test]
fn a_robot_that_was_carried_away_while_it_maps_is_found_in_its_map_and_maps_on() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven_through_rooms(6.0);
    let before = mapping.mapper.info();
    let mut found = None;
    for (nth, scan) in carried(6.0, 0.0).enumerate().take(12) {
        let mapped = mapping.insert(&scan, "boot");
        if let Some(correction) = mapped.correction {
            found.get_or_insert((nth, correction));
        }
    }
    let (nth, correction) = found.unwrap();
    assert!(nth < 6 && correction.is_found_anew, "{nth}: {correction:?}");
    let off = correction.map_from_base.distance(&Pose2::IDENTITY);
    assert!(off < 0.05, "{off} m off");
    assert_eq!(mapping.health(), Health::Tracking);

    // The robot drives on, and its session survives the process.
    for step in 1..=40 {
        mapping.insert(&on_from_start(0.05 * f64::from(step)), "boot");
    }
    let after = mapping.mapper.info();
    assert!(
        after.occupied.abs_diff(before.occupied) < before.occupied / 10,
        "{} of {}",
        after.occupied,
        before.occupied
    );
    write(folder.path(), kept(&mut mapping, true).unwrap()).unwrap();
    let mut mapping = core().going_on(read(folder.path()).unwrap().unwrap());
    let mapped = mapping.insert(&on_from_start(2.1), "boot");
    let off = mapped.localisation.unwrap().map_from_base;
    assert!(off.distance(&Pose2::new(2.1, 0.0, 0.0)) < 0.06, "{off:?}");
}

#[test]
fn a_robot_that_is_carried_between_two_scans_is_found_with_the_first_scan_after_it() {
    let mut mapping = driven_through_rooms(6.0);
    let carried = Scan {
        stamp: Stamp::from_secs(16.2),
        odom_from_base: scan(6.0).odom_from_base,
        ..seen_among(&ROOMS, 0.0)
    };
    let found = mapping.insert(&carried, "boot").correction.unwrap();
    let off = found.map_from_base.distance(&Pose2::IDENTITY);
    assert!(found.is_found_anew && off < 0.05, "{found:?}");
}

#[test]
fn where_a_robot_was_carried_nothing_counts_as_changed() {
    for (is_carried, health) in [(false, Health::Tracking), (true, Health::Lost)] {
        let mut mapping = driven_through_rooms(3.2);
        for nth in 0..40 {
            // A cloth is over the lidar of the robot that is carried; then it stands where it was, and a third of what was in sight is gone.
            let mut seen = seen_among(&ROOMS, 3.2);
            if nth == 0 && is_carried {
                seen = nowhere(3.2);
            } else {
                let third = seen.ranges.len() / 3;
                seen.ranges[..third].iter_mut().for_each(|range| *range += 1.0);
            }
            let stamp = Stamp::from_secs(13.4 + 0.2 * f64::from(nth));
            let odom_from_base = scan(3.2).odom_from_base;
            mapping.insert(
                &Scan {
                    stamp,
                    odom_from_base,
                    ..seen
                },
                "boot",
            );
        }
        assert_eq!(mapping.health(), health, "{is_carried}");
    }
}

#[test]
fn a_place_is_believed_where_the_scan_agrees_and_the_whole_map_is_looked_at_on_request() {
    let mut mapping = driven_through_rooms(6.0);
    let refused = mapping.place(Pose2::IDENTITY).unwrap_err().to_string();
    assert!(
        refused.contains("(0.00, 0.00)") && refused.contains("agrees"),
        "{refused}"
    );
    assert_eq!(mapping.health(), Health::Tracking);

    // If the robot is where it is held to be, a search of the whole map confirms it at once.
    let told = mapping.look_everywhere().unwrap().unwrap();
    assert_eq!(mapping.health(), Health::Searching, "until then nobody knows");
    assert_eq!(told.health, Health::Searching, "told before the next scan");
    let mapped = mapping.insert(&seen_among(&ROOMS, 6.0), "boot");
    assert_eq!(mapping.health(), Health::Tracking);
    assert_eq!(
        mapped.localisation.as_ref().unwrap().health,
        Health::Tracking,
        "told at once"
    );
    let off = mapped
        .correction
        .unwrap()
        .map_from_base
        .distance(&Pose2::new(6.0, 0.0, 0.0));
    assert!(off < 0.05, "{off} m off");

    // The search finds another place, too, long before enough scans contradict the map.
    let mut asked = mapping.clone();
    asked.look_everywhere().unwrap();
    let correction = asked
        .insert(&carried(6.0, 0.0).next().unwrap(), "boot")
        .correction
        .unwrap();
    assert!(
        correction.is_found_anew && correction.map_from_base.position().coords.norm() < 0.05,
        "{correction:?}"
    );

    mapping.insert(&carried(6.0, 0.0).next().unwrap(), "boot");
    let told = mapping.place(Pose2::new(0.4, 0.3, 0.1)).unwrap();
    let off = told.map_from_base.distance(&Pose2::IDENTITY);
    assert!(told.is_found_anew && off < 0.05, "{off} m off");
    let mapped = mapping.insert(&carried(6.0, 0.0).nth(1).unwrap(), "boot");
    assert_eq!(mapped.insertion, Insertion::Inserted);
}

#[test]
fn in_a_map_that_is_held_the_robot_is_localised_and_slam_goes_on_from_there() {
    let mut mapping = driven_through_rooms(6.0);
    mapping.mapper.hold();
    let before = mapping.mapper.info();
    // The robot is carried while the map is held, and drives back.
    let mut last = None;
    for scan in carried(6.0, 0.0).take(8) {
        let mapped = mapping.insert(&scan, "boot");
        assert_eq!(mapped.insertion, Insertion::Held);
        last = mapped.correction.or(last);
    }
    let off = |correction: Option<Correction>, way: f64| {
        correction.unwrap().map_from_base.distance(&Pose2::new(way, 0.0, 0.0))
    };
    assert!(off(last, 0.0) < 0.05 && mapping.health() == Health::Tracking);
    for step in 1..=40 {
        mapping.insert(&on_from_start(0.05 * f64::from(step)), "boot");
    }
    let after = mapping.mapper.info();
    assert_eq!((after.free, after.occupied), (before.free, before.occupied));
    mapping.mapper.resume();
    let mut last = None;
    for step in 41..=60 {
        let mapped = mapping.insert(&on_from_start(0.05 * f64::from(step)), "boot");
        assert_eq!(mapped.insertion, Insertion::Inserted, "{step}");
        last = mapped.correction.or(last);
    }
    assert!(off(last, 3.0) < 0.1);
    let after = mapping.mapper.info();
    assert!(after.occupied.abs_diff(before.occupied) < before.occupied / 10);
}

#[test]
fn after_a_hold_in_which_odometry_was_right_slam_goes_on_as_if_there_had_been_none() {
    let mut mapping = driven_through_rooms(3.0);
    mapping.mapper.hold();
    for step in 61..=90 {
        mapping.insert(&seen_among(&ROOMS, 0.05 * f64::from(step)), "boot");
    }
    mapping.mapper.resume();
    for step in 91..=110 {
        let mapped = mapping.insert(&seen_among(&ROOMS, 0.05 * f64::from(step)), "boot");
        assert!(
            mapped.correction.is_none_or(|correction| !correction.is_found_anew),
            "{step}"
        );
    }
    let sessions = kept(&mut mapping, true).unwrap();
    let slam = zenav_slam::Slam::load(&sessions.session.into_bytes().unwrap()).unwrap();
    assert_eq!(slam.sessions().len(), 1);
}

#[test]
fn a_lost_robot_stays_lost_while_its_map_is_held_and_after_that() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    let mut at = 3.0;
    let mut lost = |mapping: &mut MappingCore, scans: usize| {
        for _ in 0..scans {
            at += 1e-3;
            mapping.insert(&nowhere(at), "boot");
        }
        mapping.health()
    };
    assert_eq!(lost(&mut mapping, 6), Health::Lost);
    mapping.mapper.hold();
    assert_eq!(lost(&mut mapping, 1), Health::Lost);
    mapping.mapper.resume();
    assert_eq!(lost(&mut mapping, 1), Health::Lost);
}

#[test]
fn a_search_on_request_that_finds_nothing_leaves_the_robot_lost() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    mapping.look_everywhere().unwrap();
    let mapped = mapping.insert(&nowhere(3.001), "boot");
    assert_eq!(mapping.health(), Health::Lost);
    assert_eq!(
        mapped.localisation.unwrap().health,
        Health::Lost,
        "the search's own scan tells"
    );
    assert_eq!((mapped.insertion, mapped.correction), (Insertion::Held, None));
    mapping.look_everywhere().unwrap();
    assert_eq!(mapping.health(), Health::Searching);
}

#[test]
fn a_gate_that_opened_before_a_robot_hides_no_kidnapping_after_it() {
    let mut mapping = driven_through_rooms(3.2);
    let opened = opened();
    let stands = |nth: u32, way: f64| Scan {
        stamp: Stamp::from_secs(100.0 + 0.2 * f64::from(nth)),
        odom_from_base: scan(3.2).odom_from_base,
        ..seen_among(&opened, way)
    };
    for nth in 0..40 {
        mapping.insert(&stands(nth, 3.2), "boot");
    }
    assert_eq!(mapping.health(), Health::Tracking);
    let found = (40..60).find_map(|nth| mapping.insert(&stands(nth, 0.0), "boot").correction);
    let found = found.unwrap();
    let off = found.map_from_base.distance(&Pose2::IDENTITY);
    assert!(found.is_found_anew && off < 0.06, "{found:?}");
}

#[test]
fn a_robot_that_sees_nothing_for_half_a_metre_is_degraded_until_it_sees_something_again() {
    let folder = tempfile::tempdir().unwrap();
    let mut mapping = driven(3.0, folder.path());
    let mut drives = |sees: bool, way: f64| {
        let mut scan = scan(way);
        if !sees {
            scan.ranges.fill(100.0);
        }
        mapping.insert(&scan, "boot");
        mapping.health()
    };
    assert_eq!(drives(false, 3.4), Health::Tracking, "odometry is right for so far");
    let Health::Degraded { direction } = drives(false, 3.6) else {
        panic!("it sees nothing");
    };
    assert!(direction.abs() < 0.1, "along its way: {direction}");
    assert_eq!(drives(true, 3.65), Health::Tracking);
}

use std::f64::consts::{FRAC_PI_2, PI};

use zenav_protocol::time::Stamp;

use super::view::half_circle_increment;
use super::*;

fn scan(time: f64, laser: Pose2, angle_min: f64, angle_increment: f64, range_max: f64, ranges: Vec<f32>) -> Scan {
    Scan {
        stamp: Stamp::from_secs(time),
        angle_min,
        angle_increment,
        range_min: RANGE_MIN,
        range_max,
        ranges,
        odom_from_base: laser,
        ..Scan::default()
    }
}

const LOG: &str = "# a comment\nPARAM robot_length 70\nODOM 0 0 0 0 0 0 0.1 host 0.1\nFLASER 3 1.0 2.0 81.9 0.5 -0.5 0.1 0.5 -0.5 0.1 1.25 host 1.25\nROBOTLASER1 0 -1.5 3.0 0.5 20 0.01 0 3 1.5 2.5 20 0 1 2 0.3 1 2 0.3 0 0 0.3 0.3 1e6 2.5 host 2.5\n";

#[test]
fn scans_of_both_kinds_are_read_and_all_else_is_passed_over() {
    let scans: Vec<Scan> = CarmenReader::new(LOG.as_bytes()).map(Result::unwrap).collect();
    assert_eq!(scans.len(), 2);
    assert_eq!(
        (scans[0].ranges.as_slice(), scans[0].map_from_laser(), scans[0].stamp),
        (
            [1.0, 2.0, 81.9].as_slice(),
            Pose2::new(0.5, -0.5, 0.1),
            Stamp::from_secs(1.25)
        )
    );
    assert!((scans[0].angle(2) - FRAC_PI_2).abs() < 1e-12 && !scans[0].is_return(81.9));
    assert_eq!(
        (scans[1].angle_min, scans[1].angle_increment, scans[1].ranges.len()),
        (-1.5, 0.5, 3)
    );
    // The maximum range means no return.
    assert_eq!(scans[1].ranges, [1.5, 2.5, f32::INFINITY]);
}

#[test]
fn the_reading_of_a_laser_where_nothing_is_in_range_is_found_in_its_log() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("short.log");
    let reading = |scan: usize, beam: usize| {
        if beam.is_multiple_of(3) {
            8.19
        } else {
            1.0 + 0.03 * ((scan + beam) % 200) as f64
        }
    };
    let readings = |scan| {
        (0..180)
            .map(|beam| format!(" {:.2}", reading(scan, beam)))
            .collect::<String>()
    };
    let log: String = (0..40)
        .map(|scan| {
            format!(
                "FLASER 180{} {scan} 0 0 {scan} 0 0 {scan} host {scan}\n",
                readings(scan)
            )
        })
        .collect();
    std::fs::write(&path, log).unwrap();
    let scans: Vec<Scan> = open(&path).unwrap().map(Result::unwrap).collect();
    assert_eq!(scans.len(), 40);
    for scan in scans {
        assert!(
            !scan.is_return(8.19) && scan.is_return(6.97) && scan.range_max > 8.1,
            "{}",
            scan.range_max
        );
    }
}

/// What is read from the lines of scans.
fn read_back(scans: &[Scan], odom_from_base: Pose2) -> Vec<Scan> {
    let text: String = scans.iter().map(|scan| line(scan, odom_from_base)).collect();
    CarmenReader::new(text.as_bytes()).map(Result::unwrap).collect()
}

#[test]
fn the_lines_of_scans_are_read_back_as_the_same_scans() {
    let corrected = |scan: Scan| Scan {
        odom_from_base: Pose2::new(3.25, -7.5, 2.5),
        ..scan
    };
    let mut scans: Vec<Scan> = CarmenReader::new(LOG.as_bytes())
        .map(|scan| corrected(scan.unwrap()))
        .collect();
    // The maximum range of some lasers is no number of single precision.
    let wide =
        "ROBOTLASER1 0 -2.1 4.2 1.4 5.6 0.01 0 4 0.01 5.6 1.1 4.9 0 1 2 0.3 1 2 0.3 0 0 0.3 0.3 1e6 2.5 host 2.5\n";
    let wide = CarmenReader::new(wide.as_bytes()).next().unwrap().unwrap();
    assert_eq!(wide.ranges, [0.01, f32::INFINITY, 1.1, 4.9]);
    scans.push(corrected(wide));
    for readings in [180, 181, 360, 361, 541] {
        let ranges = (0..readings).map(|reading| 0.1 + reading as f32 * 0.01).collect();
        let laser = Pose2::new(0.1, 0.2, -0.3);
        scans.push(scan(
            7.5,
            laser,
            -FRAC_PI_2,
            half_circle_increment(readings),
            NOTHING_SEEN,
            ranges,
        ));
    }
    assert_eq!(read_back(&scans, Pose2::new(1.0, 2.0, 3.0)), scans);
    let words = line(&scans[0], Pose2::new(1.0, 2.0, 3.0));
    assert_eq!(words, "FLASER 3 1 2 81.9 3.25 -7.5 2.5 1 2 3 1.25 zenav 1.25\n");
    assert!(
        line(&scans[1], Pose2::IDENTITY).starts_with("ROBOTLASER1 0 -1.5 1 0.5 20 0 0 3 1.5 2.5 20 0 3.25 -7.5 2.5 ")
    );
}

#[test]
fn a_beam_without_a_return_is_read_back_without_one() {
    for angle_min in [-FRAC_PI_2, -1.0] {
        let near = Scan {
            range_min: 0.5,
            ranges: vec![f32::INFINITY, f32::NAN, 0.3, 9.0, 4.0],
            ..scan(
                1.0,
                Pose2::IDENTITY,
                angle_min,
                half_circle_increment(5),
                8.0,
                Vec::new(),
            )
        };
        let read = &read_back(std::slice::from_ref(&near), Pose2::IDENTITY)[0];
        let returns = |scan: &Scan| -> Vec<bool> { scan.ranges.iter().map(|range| scan.is_return(*range)).collect() };
        assert_eq!(returns(read), [false, false, false, false, true]);
        assert_eq!(returns(read), returns(&near));
    }
}

/// Survey and scans of a log in a file.
fn opened(text: &str) -> (Survey, Vec<Scan>) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("drive.log");
    std::fs::write(&path, text).unwrap();
    let scans = open(&path).unwrap().map(Result::unwrap).collect();
    (survey(&path).unwrap(), scans)
}

fn xs(scans: &[Scan]) -> Vec<f64> {
    scans.iter().map(|scan| scan.odom_from_base.x).collect()
}

fn secs(scans: &[Scan]) -> Vec<f64> {
    scans.iter().map(|scan| scan.stamp.0 as f64 / 1e9).collect()
}

#[test]
fn a_pose_that_stands_still_while_another_one_moves_is_not_taken() {
    let log = |line: fn(u32) -> String| (0..5).map(line).collect::<String>();
    let told = |survey: &Survey| survey.remarks().join("\n");
    let (survey, scans) = opened(&log(|i| format!("FLASER 2 1 2 0 0 0 {i} 0 0 {i} host {i}\n")));
    assert_eq!(xs(&scans), [0.0, 1.0, 2.0, 3.0, 4.0]);
    assert!(told(&survey).contains("the laser's pose stands still"), "{survey:?}");
    // Where it stood at first says how the laser is mounted: backwards, 0.25 m ahead.
    let mounted = opened(&log(|i| {
        format!("FLASER 2 1 2 5.25 0 3.1 {} 0 0 {i} host {i}\n", 5 + i)
    }));
    assert_eq!(xs(&mounted.1), [5.25, 6.25, 7.25, 8.25, 9.25]);
    assert!(
        mounted
            .1
            .iter()
            .all(|scan| (scan.odom_from_base.yaw - 3.1).abs() < 1e-12)
    );
    let place = "with the laser on the robot at x 0.25 m, y 0.00 m, yaw 178 degrees";
    assert!(told(&mounted.0).contains(place), "{:?}", mounted.0);
    // No laser is mounted sideways, or far to the side: a localiser set the pose once.
    for pose in ["0.5 0.2 1.5708", "0.5 0.4 0"] {
        let line = |i: u32| format!("FLASER 2 1 2 {pose} {i} 0 0 {i} host {i}\n");
        let (survey, scans) = opened(&(0..5).map(line).collect::<String>());
        assert_eq!(xs(&scans), [0.0, 1.0, 2.0, 3.0, 4.0], "{pose}");
        assert!(scans.iter().all(|scan| scan.odom_from_base.yaw == 0.0), "{pose}");
        assert!(told(&survey).ends_with("taken for the laser's pose"), "{survey:?}");
    }
    // Both move: the laser's counts, be it corrected or not.
    let (survey, scans) = opened(&log(|i| format!("FLASER 2 1 2 {i} 0 0 {} 0 0 {i} host {i}\n", 2 * i)));
    assert_eq!(
        (xs(&scans), told(&survey)),
        (vec![0.0, 1.0, 2.0, 3.0, 4.0], String::new())
    );
    // A laser's pose that is updated at every second scan has not stopped.
    let (_, scans) = opened(&log(|i| {
        format!("FLASER 2 1 2 {} 0 0 {i} 0 0 {i} host {i}\n", i / 2 * 2)
    }));
    assert_eq!(xs(&scans), [0.0, 0.0, 2.0, 2.0, 4.0]);
    // Neither moves, but the ODOM lines do: a scan lies halfway between two of them.
    let (survey, scans) = opened(&log(|i| {
        format!("ODOM {i} 0 0 0 0 0 {i} host {i}\nFLASER 2 1 2 0 0 0 0 0 0 {i}.5 host {i}.5\n")
    }));
    assert_eq!(xs(&scans), [0.5, 1.5, 2.5, 3.5, 4.0]);
    assert!(told(&survey).contains("ODOM"), "{survey:?}");
}

#[test]
fn a_log_of_raw_sweeps_takes_its_poses_from_odometry() {
    let line = |i: u32| {
        let raw = format!("RAWLASER1 0 -1.570796 3.141593 1.570796 81.9 0.01 0 3 1 2 3 0 {i}.25 host {i}.3");
        format!("PARAM robot_length 70\nODOM {i} 0 0.1 0 0 0 {i} host {i}\nSYNC start\n{raw}\n")
    };
    let text: String = (0..4).map(line).collect();
    let (survey, scans) = opened(&text);
    assert_eq!(xs(&scans), [0.25, 1.25, 2.25, 3.0]);
    assert_eq!(secs(&scans), [0.25, 1.25, 2.25, 3.25]);
    assert_eq!(
        (survey.line(1), survey.line(2), survey.line(5)),
        (Some(4), Some(8), None)
    );
    assert!(survey.remarks()[0].contains("RAWLASER1"), "{survey:?}");
    // Beside lines with poses they are passed over, whatever is in them.
    let robot = "ROBOTLASER1 0 -1.570796 3.141593 1.570796 81.9 0.01 0 3 1 2 3 0 7 0 0 7 0 0 0 0 0 0 0 3.25 host 3.3\n";
    let (survey, scans) = opened(&format!("RAWLASER1 broken\n{text}{robot}"));
    assert_eq!((xs(&scans), survey.remarks().len()), (vec![7.0], 0));
}

#[test]
fn a_clock_that_was_set_back_is_replaced_by_that_of_the_logger() {
    let log = |time: fn(u32) -> u32, logged: fn(u32) -> u32| -> String {
        let line = |i: u32| format!("FLASER 2 1 2 {i} 0 0 {i} 0 0 {} host {}\n", time(i), logged(i));
        (0..20).map(line).collect()
    };
    let steady: Vec<f64> = (0..20).map(|i| f64::from(100 + i)).collect();
    let (survey, scans) = opened(&log(|i| 50 + i % 10, |i| 100 + i));
    assert_eq!(secs(&scans), steady);
    let expected =
        "line 11: the time goes back from 59 s to 50 s: the logger's times at the ends of the lines are taken";
    assert_eq!(survey.remarks(), [expected]);
    let (survey, scans) = opened(&log(|_| 7, |i| 100 + i));
    assert_eq!(secs(&scans), steady);
    assert!(
        survey.remarks()[0].starts_with("all scans have the time 7 s"),
        "{survey:?}"
    );
    // One late scan is left to those who order the scans, and so is a log whose logger is no better.
    let (survey, scans) = opened(&log(|i| if i == 9 { 57 } else { 50 + i }, |i| 100 + i));
    assert_eq!((secs(&scans)[9], survey.remarks().len()), (57.0, 0));
    let (survey, scans) = opened(&log(|i| 50 + i % 10, |i| 50 + i % 10));
    assert_eq!((secs(&scans)[10], survey.remarks().len()), (50.0, 0));
}

#[test]
fn one_time_far_ahead_does_not_cost_the_robots_clock() {
    let log = |time: fn(u32) -> u32| -> String {
        let line = |i: u32| format!("FLASER 2 1 2 {i} 0 0 {i} 0 0 {} host {}\n", time(i), 9000 + i);
        (0..1000).map(line).collect()
    };
    let (survey, scans) = opened(&log(|i| if i == 100 { 3700 } else { i }));
    assert_eq!((secs(&scans)[999], survey.remarks().len()), (999.0, 0));
    // Set back half way, it does.
    let (survey, scans) = opened(&log(|i| i % 500));
    assert_eq!((secs(&scans)[0], secs(&scans)[999]), (9000.0, 9999.0));
    assert!(
        survey.remarks()[0].starts_with("line 501: the time goes back from 499 s to 0 s"),
        "{survey:?}"
    );
}

#[test]
fn scans_without_times_are_counted() {
    let log: String = (0..30).map(|i| format!("FLASER 2 1 2 {i} 0 0 {i} 0 0\n")).collect();
    let (survey, scans) = opened(&log);
    assert_eq!(
        (scans.len(), scans[0].stamp, scans[29].stamp),
        (30, Stamp(0), Stamp::from_secs(2.9))
    );
    let expected = "the scans have no times: they are taken to be 0.1 s apart";
    assert_eq!(survey.remarks(), [expected]);
    let log: String = (0..30)
        .map(|i| format!("FLASER 2 1 2 {i} 0 0 {i} 0 0 0 host 0\n"))
        .collect();
    let (survey, scans) = opened(&log);
    assert_eq!((secs(&scans)[29], survey.remarks().len()), (2.9, 1));
    // Among scans with times it is a mistake.
    let log = "FLASER 1 1 0 0 0 0 0 0 5 host 5\nFLASER 1 1 0 0 0 0 0 0\n";
    let refused = CarmenReader::new(log.as_bytes()).find_map(Result::err).unwrap();
    let expected = "line 2: expected the time, found the end of the line: is the number of readings right?";
    assert_eq!(refused.to_string(), expected);
}

#[test]
fn a_sweep_that_is_logged_as_two_kinds_of_lines_is_one_scan() {
    let line = |i: u32| {
        let robot = "ROBOTLASER1 0 -1.570796 3.141593 1.570796 81.9 0.01 0 3 1.001 2 3 0";
        format!("FLASER 3 1.00 2 3 {i} 0 0 {i} 0 0 {i} host {i}\n{robot} {i} 0 0 {i} 0 0 0 0 0 0 0 {i} host {i}\n")
    };
    let (survey, scans) = opened(&(0..3).map(line).collect::<String>());
    assert_eq!(xs(&scans), [0.0, 1.0, 2.0]);
    assert_eq!((survey.line(2), survey.line(3)), (Some(3), Some(5)));
}

#[test]
fn lines_that_other_drivers_write_are_read() {
    let read = |text: &str| -> Scan { CarmenReader::new(text.as_bytes()).next().unwrap().unwrap() };
    let behind = "1 2 0.3 1 2 0.3 0 0 inf 0.3 1e6 2.5 host 2.5";
    let stated = |resolution: f64, range_max: &str, remissions: &str| {
        format!("ROBOTLASER1 1 -1.5 3 {resolution} {range_max} 0.01 1 3 1.5 2.5 20 {remissions} {behind}\n")
    };
    let usual = read(&stated(1.5, "30", "0"));
    assert_eq!(
        (usual.ranges.as_slice(), usual.stamp),
        ([1.5, 2.5, 20.0].as_slice(), Stamp::from_secs(2.5))
    );
    // Remissions, an unstated range, no remissions though their number is stated; a resolution that is not.
    for (resolution, range_max, remissions) in [
        (1.5, "30", "3 255 nan 0"),
        (1.5, "30", "3"),
        (0.0, "30", "0"),
        (100.0, "30", "0"),
    ] {
        assert_eq!(
            read(&stated(resolution, range_max, remissions)),
            usual,
            "{resolution} {remissions}"
        );
    }
    for range_max in ["0", "inf", "81.9"] {
        let scan = read(&stated(1.5, range_max, "0"));
        assert_eq!(
            (scan.range_max, scan.ranges.as_slice()),
            (80.0, [1.5, 2.5, 20.0].as_slice()),
            "{range_max}"
        );
    }
    // Clockwise, from the left.
    let clockwise = format!("ROBOTLASER1 0 1.5 3 -1.5 30 0 0 3 20 2.5 1.5 0 {behind}\n");
    let read_clockwise = read(&clockwise);
    assert_eq!(read_clockwise.ranges, usual.ranges);
    assert!((read_clockwise.angle_min + 1.5).abs() < 1e-12 && read_clockwise.angle_increment == 1.5);
    let indented = read("\u{feff}\t FLASER 1 2.5 1 0 0 1 0 0 0.5 h\u{f6}st 0.5\r\n");
    assert_eq!(
        (indented.odom_from_base.x, indented.stamp),
        (1.0, Stamp::from_secs(0.5))
    );
}

#[test]
fn a_laser_that_sees_three_quarters_of_a_circle_and_one_upside_down_are_recognised() {
    let room = |angle: f64| {
        let (sin, cos) = angle.sin_cos();
        let (ahead, aside) = (if cos > 0.0 { 4.0 } else { 2.5 }, if sin > 0.0 { 3.0 } else { 1.5 });
        f64::min(ahead / cos.abs().max(1e-3), aside / sin.abs().max(1e-3))
    };
    // A robot that turns on the spot, with directions from the first to the last reading.
    let log = |readings: usize, first: f64, last: f64| -> String {
        let line = |number: u32| {
            let yaw = 0.1 * f64::from(number);
            let step = (last - first) / (readings - 1) as f64;
            let ranges: String = (0..readings)
                .map(|reading| format!(" {:.2}", room(yaw + first + step * reading as f64)))
                .collect();
            format!("FLASER {readings}{ranges} 1 1 {yaw} 1 1 {yaw} {number} host {number}\n")
        };
        (0..30).map(line).collect()
    };
    let wide = opened(&log(541, -0.75 * PI, 0.75 * PI));
    assert!((wide.1[0].angle_min + 0.75 * PI).abs() < 1e-9 && wide.0.remarks().is_empty());
    let narrow = opened(&log(541, -FRAC_PI_2, FRAC_PI_2));
    assert!((narrow.1[0].angle_min + FRAC_PI_2).abs() < 1e-9, "{:?}", narrow.0);
    assert!(narrow.0.remarks()[0].ends_with("the 541 readings of FLASER lines span 180 degrees"));
    let upright = opened(&log(181, -FRAC_PI_2, FRAC_PI_2));
    let upside_down = opened(&log(181, FRAC_PI_2, -FRAC_PI_2));
    assert!(upright.0.remarks().is_empty() && upside_down.0.remarks()[0].contains("upside down"));
    let pairs = upright.1.iter().zip(&upside_down.1);
    assert!(pairs.clone().count() == 30 && pairs.clone().all(|(a, b)| a.ranges == b.ranges));
    assert!(pairs.clone().all(|(a, b)| (a.angle_min - b.angle_min).abs() < 1e-9));
}

#[test]
fn a_mistake_is_named_with_its_line() {
    let error = |text: &str| {
        CarmenReader::new(text.as_bytes())
            .find_map(Result::err)
            .unwrap()
            .to_string()
    };
    assert_eq!(
        error("ODOM\nFLASER 3 1.0 2.0\n"),
        "line 2: expected a reading, found the end of the line"
    );
    assert_eq!(
        error("FLASER many 1.0\n"),
        "line 1: expected the number of readings, found `many`"
    );
    assert_eq!(
        error("FLASER 1e9 1.0\n"),
        "line 1: expected the number of readings up to 10000, found 1000000000"
    );
    assert_eq!(
        error("FLASER 2 1.0 2.0 3.0 0.5 -0.5 0.1 0.5 -0.5 0.1 1.25 host 1.25\n"),
        "line 1: expected the host and its time at the end of the line, found 3 words: is the number of readings right?"
    );
    assert_eq!(
        error("FLASER 4 1.0 2.0 3.0 0.5 -0.5 0.1 0.5 -0.5 0.1 1.25 host 1.25\n"),
        "line 1: expected the time, found `host`: is the number of readings right?"
    );
    assert_eq!(
        error("FLASER 1 far 0 0 0 0 0 0 1\n"),
        "line 1: expected a reading, found `far`"
    );
    assert_eq!(error("FLASER 1 1 nan 0 0 0 0 0 1\n"), "line 1: expected x, found `nan`");
}

#[test]
fn a_reading_that_is_no_number_is_no_return() {
    let log = "FLASER 5 1 inf nan -inf 2 0 0 0 0 0 0 1\n";
    let scan = CarmenReader::new(log.as_bytes()).next().unwrap().unwrap();
    let infinity = f32::INFINITY;
    assert_eq!(scan.ranges, [1.0, infinity, infinity, infinity, 2.0]);
}

#[test]
fn a_log_is_read_up_to_a_last_line_that_is_cut_off() {
    let read = |text: &str| {
        let mut reader = CarmenReader::new(text.as_bytes());
        let scans = reader.by_ref().collect::<Result<Vec<Scan>, CarmenError>>();
        (
            scans.map(|scans| scans.len()).ok(),
            reader.cut_off().map(ToString::to_string),
        )
    };
    let cut = LOG.find(" 0.1 1.25 host").unwrap();
    assert_eq!(
        read(&LOG[..cut]),
        (
            Some(0),
            Some("line 4: expected theta, found the end of the line".to_owned())
        )
    );
    assert_eq!(read(LOG.trim_end()), (Some(2), None));
    // The same mistake before the end is one.
    assert_eq!(read(&format!("{}\n{LOG}", &LOG[..cut])), (None, None));
}

#[test]
fn a_compressed_log_reads_like_a_plain_one_and_a_broken_one_is_an_error() {
    use std::io::Write;
    let folder = tempfile::tempdir().unwrap();
    let (plain, packed, broken) = (
        folder.path().join("a.log"),
        folder.path().join("a.log.gz"),
        folder.path().join("b.log.gz"),
    );
    std::fs::write(&plain, LOG).unwrap();
    let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
    encoder.write_all(LOG.as_bytes()).unwrap();
    let bytes = encoder.finish().unwrap();
    std::fs::write(&packed, &bytes).unwrap();
    std::fs::write(&broken, &bytes[..bytes.len() / 2]).unwrap();
    let read = |path| open(path).unwrap().collect::<Result<Vec<Scan>, CarmenError>>();
    assert_eq!(read(&plain).unwrap(), read(&packed).unwrap());
    assert!(matches!(read(&broken), Err(CarmenError::Io { .. })));
}

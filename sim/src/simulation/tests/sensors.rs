//! Tests of sensors: each errs as its model says, and no other does. For a robot at rest in front of a wall the true values are known.

use zenav_protocol::messages::{Gps, Imu};
use zenav_protocol::readings::Sweep;

use super::*;

/// True distance from the lidar to the wall straight ahead, m.
const AHEAD: f64 = 0.95 - 0.2;
/// Pose of the robot: x and yaw.
const STANDS: (f64, f64) = (0.0, 0.0);
const TICKS: usize = 2000;

/// Readings, each with its time of arrival.
#[derive(Default)]
struct Heard {
    sweeps: Vec<(Stamp, Sweep)>,
    imu: Vec<(Stamp, Imu)>,
    gps: Vec<(Stamp, Gps)>,
}

impl Heard {
    fn ahead(&self) -> Vec<f64> {
        let beams = self.sweeps.iter().map(|(_, sweep)| f64::from(sweep.ranges[3]));
        beams.filter(|range| range.is_finite()).collect()
    }

    fn rates(&self) -> Vec<f64> {
        self.imu.iter().map(|(_, imu)| imu.yaw_rate).collect()
    }

    fn headings(&self) -> Vec<f64> {
        self.imu.iter().filter_map(|(_, imu)| imu.yaw).collect()
    }

    fn eastings(&self) -> Vec<f64> {
        self.gps.iter().map(|(_, gps)| gps.x).collect()
    }
}

/// A robot whose sensors are perfect, except for what `spoil` changes.
fn heard(spoil: impl Fn(&mut RobotModel)) -> Heard {
    let mut spec = robot("a", "tiago", Pose2::new(STANDS.0, 0.0, STANDS.1));
    let model = &mut spec.model;
    lidar(model).beams = 7;
    (lidar(model).noise, lidar(model).resolution) = (0.0, 0.0);
    (model.imu.gyro_noise, model.imu.gyro_bias, model.imu.compass_noise) = (0.0, 0.0, Some(0.0));
    model.gps.as_mut().unwrap().noise = 0.0;
    spoil(model);
    let mut simulation = simulate(&world(WALL), vec![spec]);
    let mut heard = Heard::default();
    for _ in 0..TICKS {
        simulation.step();
        let readings = simulation.readings(0);
        heard
            .sweeps
            .extend(readings.sweeps.into_iter().map(|sweep| (readings.stamp, sweep)));
        heard.imu.extend(readings.imu.map(|imu| (readings.stamp, imu)));
        heard.gps.extend(readings.gps.map(|gps| (readings.stamp, gps)));
    }
    heard
}

fn lidar(model: &mut RobotModel) -> &mut zenav_protocol::robot::LidarModel {
    model.lidar.as_mut().unwrap()
}

fn gps(model: &mut RobotModel) -> &mut zenav_protocol::robot::GpsModel {
    model.gps.as_mut().unwrap()
}

/// Mean and standard deviation.
fn spread(values: &[f64]) -> (f64, f64) {
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|value| (value - mean).powi(2)).sum::<f64>() / values.len() as f64;
    (mean, variance.sqrt())
}

/// Whether values lie around `expected` with a standard deviation.
fn lie(values: &[f64], expected: f64, deviation: f64) -> bool {
    let (mean, spread) = spread(values);
    (mean - expected).abs() <= 0.2 * deviation + 1e-6 && (spread - deviation).abs() <= 0.1 * deviation + 1e-6
}

#[test]
fn sensors_without_errors_tell_the_truth() {
    let heard = heard(|_| ());
    assert!(lie(&heard.ahead(), AHEAD, 0.0) && lie(&heard.rates(), 0.0, 0.0));
    assert!(lie(&heard.headings(), STANDS.1, 0.0) && lie(&heard.eastings(), STANDS.0, 0.0));
}

#[test]
fn each_sensor_has_its_own_noise() {
    let heard = heard(|model| {
        (lidar(model).noise, model.imu.gyro_noise, model.imu.compass_noise) = (0.01, 0.02, Some(0.03));
        gps(model).noise = 0.04;
    });
    assert!(lie(&heard.ahead(), AHEAD, 0.01) && lie(&heard.rates(), 0.0, 0.02));
    assert!(lie(&heard.headings(), STANDS.1, 0.03) && lie(&heard.eastings(), STANDS.0, 0.04));
}

#[test]
fn each_sensor_has_its_own_bias() {
    let heard = heard(|model| {
        (lidar(model).bias, model.imu.gyro_bias, model.imu.compass_bias) = (0.1, 0.2, 0.3);
        gps(model).bias = [0.4, -0.5];
    });
    assert!(lie(&heard.ahead(), AHEAD + 0.1, 0.0) && lie(&heard.rates(), 0.2, 0.0));
    assert!(lie(&heard.headings(), STANDS.1 + 0.3, 0.0) && lie(&heard.eastings(), STANDS.0 + 0.4, 0.0));
    assert!(heard.gps.iter().all(|(_, gps)| (gps.y + 0.5).abs() < 1e-9));
}

#[test]
fn each_sensor_loses_its_own_share() {
    let heard = heard(|model| {
        (lidar(model).dropout, model.imu.dropout) = (0.1, 0.3);
        gps(model).dropout = 0.6;
    });
    let share = |count: usize, of: usize| 1.0 - count as f64 / of as f64;
    let beams: Vec<f32> = heard
        .sweeps
        .iter()
        .flat_map(|(_, sweep)| sweep.ranges[2..5].to_vec())
        .collect();
    let seen = beams.iter().filter(|range| range.is_finite()).count();
    assert!(
        (share(seen, beams.len()) - 0.1).abs() < 0.04,
        "{seen} of {}",
        beams.len()
    );
    assert!(
        (share(heard.imu.len(), TICKS) - 0.3).abs() < 0.04,
        "{}",
        heard.imu.len()
    );
    assert!(
        (share(heard.gps.len(), TICKS / 5) - 0.6).abs() < 0.08,
        "{}",
        heard.gps.len()
    );
}

#[test]
fn each_sensor_has_its_own_steps() {
    let heard = heard(|model| {
        (lidar(model).noise, lidar(model).resolution) = (0.1, 0.05);
        (model.imu.gyro_noise, model.imu.resolution) = (0.1, 0.02);
        (gps(model).noise, gps(model).resolution) = (1.0, 0.25);
    });
    let on = |values: &[f64], step: f64| {
        let spread = spread(values).1;
        spread > step
            && values
                .iter()
                .all(|value| (value / step - (value / step).round()).abs() < 1e-4)
    };
    assert!(on(&heard.ahead(), 0.05) && on(&heard.rates(), 0.02) && on(&heard.eastings(), 0.25));
}

#[test]
fn each_sensor_has_its_own_rate_and_latency_and_keeps_the_stamp_of_its_measurement() {
    let heard = heard(|model| {
        (lidar(model).rate_hz, lidar(model).latency) = (5.0, 0.1);
        (model.imu.rate_hz, model.imu.latency) = (25.0, 0.06);
        (gps(model).rate_hz, gps(model).latency) = (1.0, 0.5);
    });
    let late = |came: Stamp, stamp: Stamp, latency: f64| (came.secs_since(stamp) - latency).abs() < 1e-9;
    assert!(heard.sweeps.iter().all(|(came, sweep)| late(*came, sweep.stamp, 0.1)));
    assert!(heard.imu.iter().all(|(came, imu)| late(*came, imu.stamp, 0.06)));
    assert!(heard.gps.iter().all(|(came, gps)| late(*came, gps.stamp, 0.5)));
    let secs = TICKS as f64 * 0.02;
    for (count, rate) in [
        (heard.sweeps.len(), 5.0),
        (heard.imu.len(), 25.0),
        (heard.gps.len(), 1.0),
    ] {
        assert!((count as f64 - rate * secs).abs() <= 2.0, "{count} at {rate} Hz");
    }
}

#[test]
fn faults_break_the_sensor_that_they_name_in_their_window() {
    let fault = |keys: &str| format!("[[fault]]\nrobot = \"a\"\n{keys}\n");
    let faults = [
        "sensor = \"lidar\"\nkind = \"dead\"\nfrom = 2\nuntil = 4",
        "sensor = \"lidar\"\nkind = \"late\"\namount = 0.5\nfrom = 6\nuntil = 8",
        "sensor = \"imu\"\nkind = \"dead\"\nfrom = 1",
    ];
    let text: String = faults.into_iter().map(fault).collect();
    let both = vec![
        robot("a", "tiago", Pose2::IDENTITY),
        robot("b", "tiago", Pose2::new(-3.0, 0.0, 0.0)),
    ];
    let mut simulation = simulate(&world(&text), both);
    let (mut taken, mut latest, mut imu) = (Vec::new(), 0.0_f64, [0; 2]);
    for _ in 0..500 {
        simulation.step();
        for (robot, count) in imu.iter_mut().enumerate() {
            *count += u32::from(simulation.readings(robot).imu.is_some());
        }
        for sweep in simulation.readings(0).sweeps {
            taken.push(sweep.stamp.as_secs());
            latest = latest.max(simulation.now().secs_since(sweep.stamp));
        }
    }
    let within = |from: f64, until: f64| taken.iter().filter(|secs| (from..until).contains(*secs)).count();
    assert_eq!((within(1.0, 2.0), within(2.0, 4.0), within(4.0, 5.0)), (10, 0, 10));
    assert!((latest - 0.5).abs() < 0.021, "{latest}");
    // One second of 50 Hz, and ten of them.
    assert!(imu[0] < 52 && imu[1] > 490, "{imu:?}");
    for (wrong, robots) in [("lidr", "a"), ("bump", "a")] {
        let text = fault(&format!("sensor = \"{wrong}\"\nkind = \"dead\""));
        let error = Simulation::new(&world(&text), vec![robot(robots, "tiago", Pose2::IDENTITY)], 1);
        let error = error.err().unwrap().to_string();
        assert!(
            error.contains(wrong)
                && error.contains("a sensor that there is: encoders, gps, imu, lidar")
                && error.starts_with("test.toml:3: `fault.sensor` is "),
            "{error}"
        );
    }
    let text = fault("sensor = \"imu\"\nkind = \"dead\"");
    let error = Simulation::new(&world(&text), vec![robot("b", "tiago", Pose2::IDENTITY)], 1);
    let error = error.err().unwrap().to_string();
    assert!(
        error.ends_with("`fault.robot` is `a`: expected a robot that there is: b"),
        "{error}"
    );
}

/// A Neato turns on the spot in front of a wall, with a noise-free lidar in its middle. Returns the truth at each step and the sweeps.
fn turning(sweep_time: f64) -> (Vec<(Stamp, Pose2)>, Vec<Sweep>) {
    let mut spec = robot("a", "neato", Pose2::IDENTITY);
    let model = lidar(&mut spec.model);
    (model.noise, model.resolution, model.mount) = (0.0, 0.0, Pose2::IDENTITY);
    (model.sweep_time, model.range_max) = (sweep_time, 20.0);
    let mut simulation = simulate(&world(WALL), vec![spec]);
    let (mut truth, mut sweeps) = (Vec::new(), Vec::new());
    simulation.drive(0, [-5.0, 5.0]);
    for _ in 0..200 {
        simulation.step();
        truth.push((simulation.now(), simulation.truth(0).map_from_base));
        sweeps.extend(simulation.readings(0).sweeps);
    }
    (truth, sweeps)
}

#[test]
fn each_beam_is_measured_from_where_the_lidar_is_at_its_time() {
    for sweep_time in [0.0, 0.2, -0.15] {
        let (truth, sweeps) = turning(sweep_time);
        let mut spec = robot("a", "neato", Pose2::IDENTITY);
        let model = lidar(&mut spec.model);
        model.sweep_time = sweep_time;
        let yaw = |at: Stamp| {
            let after = truth.partition_point(|(stamp, _)| *stamp < at);
            let ((before, from), (next, to)) = (truth[after - 1], truth[after]);
            from.interpolate(&to, at.secs_since(before) / next.secs_since(before))
                .yaw
        };
        let mut met = 0;
        for sweep in sweeps.iter().filter(|sweep| sweep.stamp > Stamp::from_secs(1.0)) {
            for (beam, range) in sweep.ranges.iter().enumerate() {
                let at = sweep.stamp.plus_secs(-model.before_end(beam as f64));
                let direction = yaw(at) + model.angle_min() + beam as f64 * model.angle_increment();
                let expected = 0.95 / direction.cos();
                if (0.0..4.0).contains(&expected) {
                    met += 1;
                    assert!(
                        (f64::from(*range) - expected).abs() < 0.002 * expected * expected,
                        "{range} {expected}"
                    );
                }
            }
        }
        assert!(met > 1000, "{met} with {sweep_time}");
    }
}

#[test]
fn a_sweep_at_rest_is_the_same_however_long_it_takes() {
    let sweeps = |sweep_time: f64| {
        let heard = heard(|model| {
            lidar(model).noise = 0.01;
            lidar(model).sweep_time = sweep_time;
        });
        let ranges = heard.sweeps.into_iter().map(|(_, sweep)| (sweep.stamp, sweep.ranges));
        ranges.collect::<Vec<_>>()
    };
    assert_eq!(sweeps(0.0), sweeps(0.09));
}

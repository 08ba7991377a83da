//! Accuracy of a log's poses: a simulated house, or a CARMEN log with reference relations.
//!
//! `cargo run --release -p zenav-slam --example log [-- LOG [RELATIONS [setting=value …]]]`
//!
//! With `LAMA_PEER` and `CARTOGRAPHER_PEER`, LaMa and Cartographer get the same scans and odometry: see `peers/lama.cpp` and
//! `peers/cartographer.cpp`.

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example shows its result and stops at what is wrong"
)]

use zenav_fixtures::thread_time;
use zenav_protocol::messages::Scan;
use zenav_protocol::settings::Settings;
use zenav_slam::{Relation, Slam, SlamSettings, in_order, read_relations, relation_errors};

#[path = "../tests/house/mod.rs"]
mod house;
mod peers;

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let (scans, relations) = match arguments.first() {
        Some(log) => {
            let log = zenav_mapping::carmen::open(log.as_ref()).unwrap();
            let relations = arguments.get(1).map(|path| std::fs::read_to_string(path).unwrap());
            let relations = read_relations(&relations.unwrap_or_default()).unwrap();
            (in_order(log.map(Result::unwrap).collect()).unwrap().scans, relations)
        }
        None => house::drive(1),
    };
    let mut settings = SlamSettings::default();
    for argument in arguments.iter().skip(2) {
        let (key, value) = argument.split_once('=').unwrap();
        settings = settings.with_number(key, value.parse().unwrap()).unwrap().unwrap();
    }
    run(&scans, &relations, settings);
}

fn run(scans: &[Scan], relations: &[Relation], settings: SlamSettings) {
    let odometry: Vec<_> = scans
        .iter()
        .map(|scan| (scan.stamp.as_secs(), scan.odom_from_base))
        .collect();
    let errors = |what: &str, trajectory: &[_]| {
        if let Some(errors) = relation_errors(trajectory, relations) {
            println!(
                "{what}: {:.4} +- {:.4} m, {:.3} +- {:.3} deg over {} relations",
                errors.translation.mean,
                errors.translation.deviation,
                errors.rotation.mean.to_degrees(),
                errors.rotation.deviation.to_degrees(),
                errors.count
            );
        }
    };
    errors("odometry", &odometry);
    let mut slam = Slam::new(settings);
    let start = thread_time().as_secs_f64();
    for scan in scans {
        slam.step(scan).unwrap();
    }
    let online = thread_time().as_secs_f64() - start;
    errors("online  ", &slam.trajectory());
    let solved = slam.finish().unwrap();
    let all = thread_time().as_secs_f64() - start;
    errors("finished", &slam.trajectory());
    let per_scan = |secs: f64| 1e3 * secs / scans.len() as f64;
    println!("{:?}, {} submaps", slam.counts(), slam.submaps());
    println!(
        "graph: {} nodes, {} edges, {} held to be false, {:?}",
        slam.graph().poses().len(),
        slam.graph().edges().len(),
        slam.weights().iter().filter(|weight| **weight == 0.0).count(),
        solved.solution.certificate.optimality
    );
    println!(
        "processor time: {:.2} ms a scan, {:.2} ms with the finish",
        per_scan(online),
        per_scan(all)
    );
    for peer in peers::PEERS {
        let Some(program) = peer.program() else {
            continue;
        };
        let log = peers::log(scans);
        for (arguments, what) in peer.uses {
            let answer = peer.run(&program, arguments, &log);
            println!(
                "{what}: {} scans used, processor time: {:.2} ms a scan, {:.2} ms with the finish",
                answer.updates,
                per_scan(answer.online_secs),
                per_scan(answer.secs)
            );
            for (when, poses) in [("  online  ", answer.online), ("  finished", answer.finished)] {
                let stamps = scans.iter().map(|scan| scan.stamp.as_secs());
                errors(when, &stamps.zip(poses).collect::<Vec<_>>());
            }
        }
    }
}

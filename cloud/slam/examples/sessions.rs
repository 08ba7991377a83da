//! Joins two halves of a log into one map: merged as the maps of two robots, and with the second half as a session of unknown start.
//!
//! `cargo run --release -p zenav-slam --example sessions -- LOG [RELATIONS]`

#![allow(
    clippy::print_stdout,
    clippy::unwrap_used,
    reason = "an example shows its result and stops at what is wrong"
)]

use zenav_fixtures::thread_time;
use zenav_protocol::messages::Scan;
use zenav_slam::{Relation, Slam, SlamSettings, in_order, merge, read_relations, relation_errors};

fn main() {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let log = zenav_mapping::carmen::open(arguments[0].as_ref()).unwrap();
    let scans = in_order(log.map(Result::unwrap).collect()).unwrap().scans;
    let relations = arguments.get(1).map(|path| std::fs::read_to_string(path).unwrap());
    let relations = read_relations(&relations.unwrap_or_default()).unwrap();
    let (first, second) = scans.split_at(scans.len() / 2);
    let first = mapped("first half", Slam::new(SlamSettings::default()), first);

    let bytes = timed("save", || first.save().unwrap());
    let loaded = timed("load", || Slam::load(&bytes).unwrap());
    assert!(loaded.save().unwrap() == bytes, "another session was loaded");
    println!("session: {:.2} MB", bytes.len() as f64 / 1e6);

    let other = mapped("second half", Slam::new(SlamSettings::default()), second);
    let (a, b) = (loaded.clone(), other);
    match timed("merge", || merge(a, b)) {
        Ok((merged, solved)) => {
            told("merged", &merged, &relations);
            println!("  {:?}", solved.solution.certificate.optimality);
            let whole = merged.save().unwrap();
            println!("  session: {:.2} MB", whole.len() as f64 / 1e6);
            timed("  load", || Slam::load(&whole).unwrap());
        }
        Err(error) => println!("merged: {error}"),
    }

    let continued = timed("begin", || loaded.begin_session(None));
    let continued = mapped("continued", continued, second);
    told("continued", &continued, &relations);
}

/// Maps scans to the end.
fn mapped(what: &str, mut slam: Slam, scans: &[Scan]) -> Slam {
    let mut located = None;
    timed(what, || {
        for (index, scan) in scans.iter().enumerate() {
            slam.step(scan).unwrap();
            if located.is_none() && slam.is_located() {
                located = Some(index);
            }
        }
        slam.finish().unwrap();
    });
    println!("  located with scan {located:?} of {}", scans.len());
    slam
}

fn told(what: &str, slam: &Slam, relations: &[Relation]) {
    println!("{what}: sessions of {:?} nodes, {:?}", slam.sessions(), slam.counts());
    if let Some(errors) = relation_errors(&slam.trajectory(), relations) {
        println!(
            "  {:.4} +- {:.4} m, {:.3} +- {:.3} deg over {} relations",
            errors.translation.mean,
            errors.translation.deviation,
            errors.rotation.mean.to_degrees(),
            errors.rotation.deviation.to_degrees(),
            errors.count
        );
    }
}

fn timed<T>(what: &str, act: impl FnOnce() -> T) -> T {
    let start = thread_time().as_secs_f64();
    let result = act();
    println!("{what}: {:.2} s", thread_time().as_secs_f64() - start);
    result
}

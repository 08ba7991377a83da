//! Finds a robot in a house without a guess, then follows it.
//!
//! `cargo run --release -p zenav-localisation --example find_me`

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use zenav_localisation::{LocalisationSettings, Localiser};
use zenav_protocol::geometry::Pose2;

#[path = "../tests/house/mod.rs"]
mod house;

fn main() {
    let map = house::house();
    let mut localiser = Localiser::new(LocalisationSettings::default(), &map);
    localiser.lose();
    for (number, (truth, odometry)) in house::drive().into_iter().enumerate() {
        let scan = house::look(&map, 1 + number as u64 * 100_000_000, truth, odometry, Pose2::IDENTITY);
        let Some(located) = localiser.step(&scan) else {
            continue;
        };
        if number % 20 == 0 || located.is_found_anew {
            println!(
                "scan {number:3}: {:.3} m off, {:.0} % of the scan agrees, {:?}{}",
                located.pose.distance(&truth),
                100.0 * located.evidence.agreeing,
                located.health,
                if located.is_found_anew { ", found" } else { "" }
            );
        }
    }
}

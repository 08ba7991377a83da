//! Asks for a robot at random places of a map, without a guess: how soon, and how often right?
//!
//! `cargo run --release -p zenav-localisation --example everywhere -- 200 [MAP.yaml | MAP.pgm]…`; without a map in an office of 100 m by 100 m.

#![allow(clippy::print_stdout, reason = "an example shows its result")]

use std::path::Path;

use zenav_fixtures::thread_time;
use zenav_localisation::LocalisationSettings;
use zenav_mapping::read_map;

#[path = "../../../tests/src/acceptance/everywhere.rs"]
mod everywhere;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args().skip(1);
    let count = arguments.next().map_or(Ok(100), |count| count.parse())?;
    let mut settings = LocalisationSettings::default();
    for word in std::env::var("TRY").unwrap_or_default().split(',') {
        let Some((key, value)) = word.split_once('=') else {
            continue;
        };
        let value: f64 = value.parse()?;
        let global = &mut settings.global;
        match key {
            "within" => global.within = value,
            "good" => global.good_score = value,
            "lever" => global.lever = value,
            "min" => global.min_score = value,
            "points" => global.points = value as u32,
            "places" => global.places = value as u32,
            "budget" => global.budget = value as u32,
            "margin" => global.margin = value,
            "agrees" => global.agrees = value,
            "sigma" => settings.tracking.sigma = value,
            _ => panic!("{key}"),
        }
    }
    let mut maps = Vec::new();
    for file in arguments {
        maps.push((file.clone(), read_map(Path::new(&file), 0.05)?));
    }
    if maps.is_empty() {
        maps.push(("office".to_owned(), everywhere::office(1)));
    }
    for (name, map) in maps {
        let tally = everywhere::ask_everywhere(&map, count, 1, &settings, &thread_time);
        println!("{name}: {}", tally.line());
        for (truth, found, agreeing) in &tally.wrong {
            println!(
                "  wrong: {truth:?} was taken for {found:?}, {:.0} % agree",
                100.0 * agreeing
            );
        }
    }
    Ok(())
}

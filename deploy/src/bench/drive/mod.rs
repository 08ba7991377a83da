//! `zenav bench drive`: driving quality. Every run is judged by ground truth, beside anchors in the same worlds with the same body.

mod runs;
mod table;

use std::collections::HashSet;
use std::path::PathBuf;

use clap::ValueEnum as _;
use serde::Serialize;

use self::runs::{Run, all, compare};
use self::table::{EXTRAS, Extra, Row};
use super::suites::Suite;
use crate::arguments;
use crate::completion;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{Format, line, table, value};
use crate::parallel;

/// Arguments of `zenav bench drive`.
#[derive(Debug, clap::Args)]
pub struct DriveArgs {
    /// Suite to run; without it, all
    #[arg(long, value_enum, value_name = "S", ignore_case = true)]
    suite: Option<Suite>,
    /// Seeds per scenario and robot [default: 20 worlds a level in S2, 4 in S4, 2 in S9, 1 in S1, S11 and S12, else 3]
    #[arg(long, value_name = "N", value_parser = arguments::whole_in(1..=10_000_u64))]
    seeds: Option<u64>,
    /// First seed: choose worlds that nothing was tuned on
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = arguments::whole_in(0..=1_000_000_000_u64))]
    first_seed: u64,
    /// Drive with this robot, a shipped one or a file, `+OPTION` for each option; may be repeated [default: those of the suite]
    #[arg(long = "robot", value_name = "NAME", add = completion::models())]
    robots: Vec<String>,
    /// Folder of BARN's worlds for S1, `world_N.world` or `world_N.toml`
    #[arg(long, value_name = "DIR")]
    worlds: Option<PathBuf>,
    /// Standard deviation of the lidar's ranges in S1, cm; at least the lidar's own
    #[arg(long, value_name = "CM", default_value_t = 1.0, requires = "worlds", value_parser = arguments::finite)]
    noise: f64,
    /// Run only the run of this name, as in the table
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Drive zenav only
    #[arg(long)]
    no_anchors: bool,
    /// Write each world here, with the `zenav run` command for it, and drive nothing
    #[arg(long, value_name = "DIR")]
    world_out: Option<PathBuf>,
    /// Parallel runs [default: one per core]
    #[arg(long, value_name = "N", value_parser = arguments::whole_in(1..=1024_u16))]
    threads: Option<u16>,
    /// Output format
    #[arg(short, long, value_enum, default_value_t)]
    output: Format,
}

/// Output of `-o json`.
#[derive(Serialize)]
struct Report {
    rows: Vec<Row>,
    runs: Vec<Run>,
}

/// `zenav bench drive`.
///
/// # Errors
/// An unknown run, an unknown robot, or two of one name; a folder that cannot be written.
pub(super) fn drive(args: &DriveArgs) -> Outcome {
    let suites = args
        .suite
        .map_or_else(|| Suite::value_variants().to_vec(), |suite| vec![suite]);
    if !(0.0..=100.0).contains(&args.noise) {
        return Err(Failure::usage(format!("--noise {}: expected 0 to 100 cm", args.noise)));
    }
    if args.suite == Some(Suite::S1) && args.worlds.is_none() {
        return Err(Failure::usage(
            "--suite s1: expected --worlds DIR, a folder of BARN's worlds",
        ));
    }
    let barn = args.worlds.as_deref().map(|folder| (folder, 0.01 * args.noise));
    let mut cases = Vec::new();
    for suite in suites {
        cases.extend(suite.cases(&args.robots, args.first_seed, args.seeds, barn)?);
    }
    let mut names = HashSet::new();
    if let Some(twice) = cases.iter().find(|case| !names.insert(case.name.as_str())) {
        return Err(Failure::usage(format!(
            "--robot: two robots make the run {}; expected robots of different names",
            twice.name
        )));
    }
    if let Some(only) = &args.only {
        cases.retain(|case| case.name == *only);
        if cases.is_empty() {
            return Err(Failure::not_found(format!(
                "--only {only}: no run of that name; `zenav bench drive --world-out DIR` writes all of them"
            )));
        }
    }
    if args.no_anchors {
        cases.iter_mut().for_each(|case| case.anchors = &[]);
    }
    if let Some(folder) = &args.world_out {
        std::fs::create_dir_all(folder).map_err(Failure::failed_at(folder))?;
        for case in &cases {
            files::write(&folder.join(format!("{}.toml", case.name)), case.file())?;
            line(&case.command());
        }
        return Ok(exit_code::OK);
    }
    let threads = args.threads.map_or_else(parallel::cores, usize::from);
    let mut runs = all(&cases, threads)?;
    compare(&mut runs);
    let mut rows: Vec<Row> = Vec::new();
    for run in &runs {
        if !rows
            .iter()
            .any(|row| row.scenario == run.scenario && row.driver == run.driver)
        {
            let alike = |other: &&Run| other.scenario == run.scenario && other.driver == run.driver;
            rows.extend(Row::of(&runs.iter().filter(alike).collect::<Vec<_>>()));
        }
    }
    value(args.output, &Report { rows, runs }, |report| {
        let has = |extra: &&Extra| report.rows.iter().any(|row| extra.1(row).is_some());
        let extras: Vec<&Extra> = EXTRAS.iter().filter(has).collect();
        let mut header = vec![
            "SCENARIO",
            "DRIVER",
            "RUNS",
            "REACHED",
            "UNTOUCHED",
            "OWN",
            "AFTER OWN",
            "AT REST",
            "TIME/IDEAL",
        ];
        header.extend(extras.iter().map(|extra| extra.0));
        header.push("WORST");
        let rows: Vec<Vec<String>> = report.rows.iter().map(|row| row.cells(&extras)).collect();
        table(&header, &rows)
    })
}

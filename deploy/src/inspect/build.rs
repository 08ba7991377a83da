//! `zenav map build`. Builds `map_server` files from a CARMEN log with poses.

use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::ProgressBar;
use serde::Serialize;
use zenav_mapping::carmen::{self, LOG_BEAMS};
use zenav_mapping::{Agreement, BuiltMap, InsertMode, agreement, build_map, write_map};
use zenav_protocol::messages::Scan;

use crate::arguments::resolution;
use crate::batch::thread_time;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

/// Build a map from a log.
///
/// The reported rate covers inserting all scans in one thread, by that thread's processor time; reading, comparing and writing do not
/// count.
#[derive(Debug, clap::Args)]
pub(super) struct BuildArgs {
    /// CARMEN log, compressed by gzip or not
    #[arg(long, value_name = "FILE")]
    log: PathBuf,
    /// Side of a cell, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = resolution)]
    resolution: f64,
    /// Folder for map.pgm and map.yaml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// How scans are inserted: every beam exactly, or by filled wedges
    #[arg(long, value_enum, default_value_t)]
    mode: BuildMode,
}

/// How scans are inserted into a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum BuildMode {
    /// Every beam, exactly
    #[default]
    Reference,
    /// Wedges between beams are filled; its agreement with `reference` is reported
    Fast,
}

/// What `map build` prints.
#[derive(Debug, Serialize)]
struct Built {
    scans: u64,
    /// Scans inserted per second of this thread's processor time, independent of other load on the machine.
    scans_per_s: f64,
    /// Scans inserted per second of wall time.
    scans_per_s_wall: f64,
    beams: u64,
    cells: u64,
    occupied: u64,
    free: u64,
    unknown: u64,
    agreement_occupied: f64,
    agreement_free: f64,
    width: u32,
    height: u32,
    resolution: f64,
    map: PathBuf,
}

/// Builds a map from a log.
pub(super) fn build(args: &BuildArgs, format: Format) -> Outcome {
    let (scans, _) = read_log(&args.log)?;
    let build = |mode| build_map(&scans, args.resolution, mode, &LOG_BEAMS).map_err(Failure::usage_at(&args.log));
    let mode = match args.mode {
        BuildMode::Reference => InsertMode::Reference,
        BuildMode::Fast => InsertMode::Fast,
    };
    // Only inserting the scans is timed: not reading the log, not comparing and writing the map.
    let (wall, thread) = (Instant::now(), thread_time());
    let BuiltMap { map, beams } = build(mode)?;
    let rate = |took: Duration| scans.len() as f64 / took.as_secs_f64().max(1e-9);
    let (wall, thread) = (wall.elapsed(), thread_time().saturating_sub(thread));
    let (counts, grid) = (map.counts(), map.to_occupancy());
    drop(map);
    let agreement = match mode {
        InsertMode::Reference => Agreement {
            occupied: 1.0,
            free: 1.0,
        },
        InsertMode::Fast => agreement(&build(InsertMode::Reference)?.map.to_occupancy(), &grid),
    };
    let map = write_map(&args.out, "map", &grid, "built from a log").map_err(Failure::failed)?;
    let built = Built {
        scans: scans.len() as u64,
        scans_per_s: rate(thread),
        scans_per_s_wall: rate(wall),
        beams,
        cells: grid.spec().len() as u64,
        occupied: counts.occupied,
        free: counts.free,
        unknown: counts.unknown,
        agreement_occupied: agreement.occupied,
        agreement_free: agreement.free,
        width: grid.spec().width,
        height: grid.spec().height,
        resolution: args.resolution,
        map,
    };
    output::value(format, &built, |built| {
        // The reference agrees with itself.
        let agreement = match args.mode {
            BuildMode::Reference => String::new(),
            BuildMode::Fast => format!(
                "; of the cells of `--mode reference`, {:.2} % of the occupied and {:.2} % of the free ones are the same",
                100.0 * built.agreement_occupied,
                100.0 * built.agreement_free
            ),
        };
        format!(
            "{}: {} scans at {:.0} scans/s, {} x {} cells of {} m, {} occupied, {} free{agreement}",
            built.map.display(),
            built.scans,
            built.scans_per_s,
            built.width,
            built.height,
            built.resolution,
            built.occupied,
            built.free
        )
    })
}

/// All scans of a CARMEN log, and what it says as a whole.
pub(crate) fn read_log(path: &Path) -> Result<(Vec<Scan>, carmen::Survey), Failure> {
    if !path.is_file() {
        return Err(Failure::not_found(format!("{}: no such log", path.display())));
    }
    let bad = |error: &dyn std::fmt::Display| Failure::usage(format!("{}: {error}", path.display()));
    let bar = output::progress(ProgressBar::new_spinner(), "{spinner} {pos} scans read");
    let mut scans = Vec::new();
    let mut log = carmen::open(path).map_err(|error| bad(&error))?;
    for scan in &mut log {
        scans.push(scan.map_err(|error| bad(&error))?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    if let Some(error) = log.cut_off() {
        tracing::warn!("{}: {error}: the last line is cut off and is not read", path.display());
    }
    if scans.is_empty() {
        Err(bad(&"no laser scan with a pose in it (FLASER, ROBOTLASER1)"))
    } else {
        Ok((scans, log.into_survey()))
    }
}

//! Offline commands. What can be done in batches without a robot? Planning, smoothing, simulating.
//!
//! | file | answers |
//! |---|---|
//! | `queries` | which paths are asked for? (lines of cells, or a Moving AI `.scen`) |
//! | `watchdog` | how is a search ended in time? |
//! | `plan` | `zenav plan`: searches alone |
//! | `smooth` | `zenav smooth`: search, corridor, geometry, time law |
//! | `bench` | `zenav sim bench` |
//! | `show` | `zenav sim show`: a picture of a world |

mod bench;
mod plan;
mod queries;
mod show;
pub mod sim_bench;
mod smooth;
mod watchdog;

pub use bench::{SimArgs, sim};
pub use plan::{PlanArgs, plan};
pub(crate) use show::backdrop;
pub use smooth::{SmoothArgs, smooth};

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::ProgressBar;
use zenav_mapping::map_file;
use zenav_planning::Planner;
use zenav_protocol::grid::OccupancyGrid;

use crate::failure::Failure;
use crate::{files, output};

/// A bar on a terminal, else nothing.
pub(crate) fn progress(length: usize) -> ProgressBar {
    output::progress(ProgressBar::new(length as u64), "{bar:40} {pos}/{len} {eta}")
}

/// The map, at the resolution asked for where its file does not say one.
fn read_map(path: &Path, resolution: Option<f64>) -> Result<OccupancyGrid, Failure> {
    match resolution {
        Some(resolution) if path.is_file() => map_file::read_map(path, resolution).map_err(Failure::usage),
        _ => files::map(path),
    }
}

/// A planner by name; the error names those that there are.
fn planner(name: &str) -> Result<Planner, String> {
    name.parse()
        .map_err(|error: zenav_planning::UnknownPlanner| error.to_string())
}

/// A file of results: written line by line, complete once [`Results::finish`] was called. `-` is stdout.
struct Results {
    path: PathBuf,
    out: Box<dyn Write>,
}

impl Results {
    fn create(path: &Path) -> Result<Self, Failure> {
        let out: Box<dyn Write> = if path == Path::new("-") {
            Box::new(std::io::stdout())
        } else {
            Box::new(std::fs::File::create(path).map_err(Failure::failed_at(path))?)
        };
        Ok(Self {
            path: path.to_owned(),
            out: Box::new(BufWriter::new(out)),
        })
    }

    fn line(&mut self, text: std::fmt::Arguments<'_>) -> Result<(), Failure> {
        let written = self.out.write_fmt(text).and_then(|()| self.out.write_all(b"\n"));
        self.written(written)
    }

    fn finish(mut self) -> Result<(), Failure> {
        let flushed = self.out.flush();
        self.written(flushed)
    }

    fn written(&self, result: std::io::Result<()>) -> Result<(), Failure> {
        match result {
            // Whoever reads stdout has seen enough (`zenav plan … | head`).
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => std::process::exit(0),
            result => result.map_err(Failure::failed_at(&self.path)),
        }
    }
}

/// What this thread has computed so far: one core is timed, whatever else the machine does.
pub(crate) fn thread_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::try_from(time).unwrap_or_default()
}

/// A folder for one file a query, made where it is missing.
fn folder(path: Option<&Path>) -> Result<(), Failure> {
    path.map_or(Ok(()), |path| {
        std::fs::create_dir_all(path).map_err(Failure::failed_at(path))
    })
}

/// The value in the middle; NaN for none.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

//! Offline commands. Batch planning and smoothing, and simulation, without a robot.
//!
//! | file | answers |
//! |---|---|
//! | `queries` | the queries of a batch (lines of cells, or a Moving AI `.scen`) |
//! | `watchdog` | how is a search stopped at its time limit? |
//! | `plan` | `zenav plan`: search only |
//! | `smooth` | `zenav smooth`: search, corridor, geometry, time law |
//! | `sim` | `zenav sim`: show, bench, serve |
//! | `show` | `zenav sim show`: a picture of a world |

mod plan;
mod queries;
mod show;
mod sim;
mod smooth;
mod watchdog;

pub use plan::{PlanArgs, plan};
pub(crate) use show::backdrop;
pub use sim::{SimArgs, sim};
pub use smooth::{SmoothArgs, smooth};

use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use indicatif::ProgressBar;
use zenav_planning::Planner;

use crate::failure::Failure;
use crate::output;

/// A progress bar on a terminal, otherwise nothing.
pub(crate) fn progress(length: usize) -> ProgressBar {
    output::progress(ProgressBar::new(length as u64), "{bar:40} {pos}/{len} {eta}")
}

/// A planner by name; the error lists the known ones.
fn planner(name: &str) -> Result<Planner, String> {
    name.parse()
        .map_err(|error: zenav_planning::UnknownPlanner| error.to_string())
}

/// A results file, written line by line; complete only after [`Results::finish`]. `-` is stdout.
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
            // The reader of stdout has closed it (`zenav plan … | head`).
            Err(error) if error.kind() == std::io::ErrorKind::BrokenPipe => std::process::exit(0),
            result => result.map_err(Failure::failed_at(&self.path)),
        }
    }
}

/// Processor time of this thread: one core, independent of other load on the machine.
pub(crate) fn thread_time() -> Duration {
    let time = rustix::time::clock_gettime(rustix::time::ClockId::ThreadCPUTime);
    Duration::try_from(time).unwrap_or_default()
}

/// Creates the folder for one file per query, if missing.
fn folder(path: Option<&Path>) -> Result<(), Failure> {
    path.map_or(Ok(()), |path| {
        std::fs::create_dir_all(path).map_err(Failure::failed_at(path))
    })
}

/// The median; NaN for no values.
pub(crate) fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    values.get(values.len() / 2).copied().unwrap_or(f64::NAN)
}

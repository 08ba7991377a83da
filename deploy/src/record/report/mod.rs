//! `zenav report`. Summarises a run in one self-contained HTML file.
//!
//! | file | answers |
//! |---|---|
//! | `page` | layout and style of the page |
//! | `floor` | the map with the driven path |
//! | `chart` | a figure over time; when the nodes of a tree ran |

mod chart;
mod floor;
mod page;

use std::path::{Path, PathBuf};

use super::run::Run;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output;

/// Arguments of `zenav report`.
#[derive(Debug, clap::Args)]
#[command(after_help = "Examples:\n  zenav report run.mcap\n  zenav report run.mcap --out monday.html")]
pub struct ReportArgs {
    /// Record to report on
    #[arg(value_name = "RUN.mcap")]
    record: PathBuf,
    /// Page to write [default: beside the record, with the extension .html]
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
}

/// `zenav report`.
///
/// # Errors
/// A bad record, or a page that cannot be written.
pub fn report(args: &ReportArgs) -> Outcome {
    let out = args.out.clone().unwrap_or_else(|| args.record.with_extension("html"));
    if !matches!(files::ending(&out).as_str(), "html" | "htm") {
        return Err(files::unknown_ending(&out, ".html"));
    }
    write_report(&args.record, &out)?;
    output::line(&format!("wrote {}", out.display()));
    Ok(exit_code::OK)
}

/// Writes the page of a record.
///
/// # Errors
/// A bad record, or a page that cannot be written.
pub fn write_report(record: &Path, out: &Path) -> Result<(), Failure> {
    let run = Run::read(record)?;
    if run.robots.is_empty() {
        return Err(Failure::not_found(format!(
            "{}: no pose and no goal of a robot is in the record",
            record.display()
        )));
    }
    files::write(out, page::html(&run)?)
}

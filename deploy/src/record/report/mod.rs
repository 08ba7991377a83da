//! `zenav report`. How is a run told to a colleague? One page in one file, without anything from elsewhere.
//!
//! | file | answers |
//! |---|---|
//! | `page` | what stands where, and how does it look? |
//! | `floor` | the map with the path that was driven |
//! | `chart` | a number over time; when nodes of a tree ran |

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
    /// Record
    #[arg(value_name = "RUN.mcap")]
    record: PathBuf,
    /// Page to write [default: beside the record, with the ending .html]
    #[arg(long, value_name = "FILE.html")]
    out: Option<PathBuf>,
}

/// `zenav report`.
///
/// # Errors
/// A bad record, or a page that cannot be written.
pub fn report(args: &ReportArgs) -> Outcome {
    let out = args.out.clone().unwrap_or_else(|| args.record.with_extension("html"));
    let ending = out.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    if !ending.eq_ignore_ascii_case("html") && !ending.eq_ignore_ascii_case("htm") {
        return Err(Failure::usage(format!(
            "--out {}: expected a name that ends with .html",
            out.display()
        )));
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

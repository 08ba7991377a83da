//! Faults. Runs the rows of the fault suite, each as a process in its own network, and writes their table.

use std::path::PathBuf;
use std::process::{Command, Stdio};

use tokio::runtime::Runtime;
use zenav::parallel;
use zenav_tests::acceptance::faults::{self, OWN_NETWORK, OwnNetwork, Result, Row};

use crate::{Verdict, zenav};

/// Prefix of the line in which a row's process reports its results.
const FOUND: &str = "found: ";

/// The rows to run, and the file for the table.
#[derive(Debug, clap::Args)]
pub struct Faults {
    /// A few rows only
    #[arg(long)]
    short: bool,
    /// The row of this name; without one, rows whose names contain it [default: all]
    #[arg(long, default_value = "", hide_default_value = true)]
    only: String,
    /// Rows at a time
    #[arg(long, default_value_t = 1)]
    parallel: usize,
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File for the table
    #[arg(long)]
    write: Option<PathBuf>,
    /// Run one row here and print its results
    #[arg(long, hide = true)]
    row: Option<String>,
}

/// Runs the rows.
pub fn run(arguments: &Faults) -> Verdict {
    let rows = if arguments.short {
        faults::short()
    } else {
        faults::all()
    };
    if let Some(name) = &arguments.row {
        let row = rows.iter().find(|row| row.name == *name).ok_or("no such row")?;
        let found = Runtime::new()?.block_on(faults::run(zenav(), row, arguments.seed))?;
        println!("{FOUND}{}", serde_json::to_string(&found)?);
        return Ok(found.is_good());
    }
    let rows = faults::select(&rows, &arguments.only)?;
    let network = if can_unshare() { OwnNetwork::Yes } else { OwnNetwork::No };
    println!("{} rows, network of their own: {network:?}", rows.len());
    let mut found = parallel::in_order(rows.len(), arguments.parallel.max(1), |number| {
        let result = child(&rows[number], arguments, network);
        println!("{}", line(&result));
        result
    });
    faults::compare(&rows, &mut found);
    for result in &found {
        println!("{}", verdict(result));
    }
    let short = if arguments.short { " --short" } else { "" };
    let only = match arguments.only.as_str() {
        "" => String::new(),
        only => format!(" --only \"{only}\""),
    };
    let command = format!("acceptance faults{short}{only} --seed {}", arguments.seed);
    let page = faults::markdown(&command, &found, network);
    match &arguments.write {
        Some(path) => std::fs::write(path, page)?,
        None => println!("{page}"),
    }
    Ok(found.iter().all(Result::is_good))
}

/// The figures of a row as soon as it has run. Its verdict may need another row.
fn line(found: &Result) -> String {
    let (asked, succeeded) = found.missions;
    format!(
        "{}: {succeeded} of {asked} missions in {:.1?} s, resumes {:.2?}, {:.0} % at rest; {:?} {:?}",
        found.name,
        found.secs,
        found.resumes,
        100.0 * found.rest,
        found.failures,
        found.invalid.first()
    )
}

/// Whether a row is good, or what it missed.
fn verdict(found: &Result) -> String {
    match found.is_good() {
        true => format!("{}: good", found.name),
        false => format!("{}: FELL SHORT: {}", found.name, found.missed().join("; ")),
    }
}

/// Whether a process may have its own network here, and impair it.
fn can_unshare() -> bool {
    let try_it =
        "ip link set lo up && iptables -A INPUT -p tcp --dport 1 -m statistic --mode random --probability 0.5 -j DROP";
    let mut command = Command::new("unshare");
    command.args(["--net", "sh", "-c", try_it]);
    command.stdout(Stdio::null()).stderr(Stdio::null());
    command.status().is_ok_and(|status| status.success())
}

/// Runs a row in its own process.
fn child(row: &Row, arguments: &Faults, network: OwnNetwork) -> Result {
    let own = std::env::current_exe().unwrap_or_default();
    let mut command = match network {
        OwnNetwork::Yes => {
            let mut command = Command::new("unshare");
            command.args(["--net", "sh", "-c", "ip link set lo up && exec \"$@\"", "sh"]);
            command.arg(&own).env(OWN_NETWORK, "1");
            command
        }
        OwnNetwork::No => Command::new(&own),
    };
    command.args(["faults", "--row", &row.name, "--seed", &arguments.seed.to_string()]);
    if arguments.short {
        command.arg("--short");
    }
    let failed = |why: String| Result {
        name: row.name.clone(),
        failures: vec![why],
        ..Result::default()
    };
    let output = match command.output() {
        Ok(output) => output,
        Err(error) => return failed(error.to_string()),
    };
    let text = String::from_utf8_lossy(&output.stdout).into_owned();
    let found = text
        .lines()
        .find_map(|line| serde_json::from_str(line.strip_prefix(FOUND)?).ok());
    found.unwrap_or_else(|| failed(String::from_utf8_lossy(&output.stderr).trim().to_owned()))
}

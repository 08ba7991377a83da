//! `zenav bt simulate`. Runs a tree in simulated time, with a script that gives the results of its leaves.

use std::path::Path;

use zenav_behaviour_tree::simulate;

use super::{Source, bad_tree, includer};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};

pub(super) fn simulate(file: &str, script: Option<&Path>, id: Option<&str>, format: Format) -> Outcome {
    let script: simulate::Script = match script {
        Some(path) => serde_json::from_str(&files::text(path)?).map_err(Failure::usage_at(path))?,
        None => simulate::Script::default(),
    };
    let source = Source::read(file)?;
    let mut include = includer(&source.name);
    let outcome = simulate::simulate(&source.name, &source.text, id, &script, &mut include)
        .map_err(|errors| bad_tree(&errors))?;
    for warning in &outcome.warnings {
        tracing::warn!("{warning}");
    }
    output::value(format, &outcome, |outcome| {
        let rows: Vec<Vec<String>> = outcome
            .counts
            .iter()
            .map(|(leaf, starts)| vec![leaf.clone(), starts.to_string()])
            .collect();
        let error = outcome
            .error
            .as_ref()
            .map(|error| format!(": {error}"))
            .unwrap_or_default();
        let late = if outcome.timed_out { ", time ran out" } else { "" };
        format!(
            "{}{error} after {} ticks, {} ms{late}\n\n{}",
            outcome.status,
            outcome.ticks,
            outcome.sim_time_ms,
            output::table(&["LEAF", "STARTS"], &rows)
        )
    })?;
    Ok(if outcome.error.is_some() {
        exit_code::FAILED
    } else {
        exit_code::OK
    })
}

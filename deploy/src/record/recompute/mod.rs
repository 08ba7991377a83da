//! `zenav replay --recompute`. Checks that the cores give the same outputs for the same inputs.
//!
//! | file | answers |
//! |---|---|
//! | `mapping` | does mapping make the recorded map from the recorded scans? |
//! | `motion` | do motion workers give the recorded answers to the recorded requests? |
//! | `settings` | which settings did the parts of the run have? |

mod mapping;
mod motion;
mod settings;

use std::path::Path;

use clap::ValueEnum;
use serde::Serialize;
use zenav_cloud::mapping::PoseSettings;
use zenav_cloud::motion::MotionSettings;
use zenav_mapping::MappingSettings;

use self::settings::RunSettings;
use super::reader::RecordReader;
use crate::config::{self, Deployment};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

pub use mapping::MapVerdict;
pub use motion::{MotionVerdict, Uncompared};

/// What can be recomputed.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Recomputable {
    /// Maps from scans
    Mapping,
    /// Trajectories from requests
    Motion,
}

/// Settings of the parts of a run.
#[derive(Clone, Debug, Default, PartialEq)]
struct PartSettings {
    mapping: MappingSettings,
    poses: PoseSettings,
    motion: MotionSettings,
}

impl PartSettings {
    fn of(deployment: &Deployment) -> Self {
        Self {
            poses: deployment.poses(),
            motion: deployment.motion(),
            mapping: deployment.mapping.settings.clone(),
        }
    }
}

/// Result of recomputing a record.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Recomputed {
    /// The map of each robot.
    pub maps: Vec<MapVerdict>,
    /// The answers of each motion worker.
    pub motion: Vec<MotionVerdict>,
    /// Whether everything requested is in the record and came out the same.
    pub identical: bool,
    /// What could not be recomputed, or only under other conditions, and why.
    pub notes: Vec<String>,
}

/// `zenav replay FILE --recompute PARTS`.
pub(super) fn run(file: &Path, parts: &[Recomputable], deployment: Option<&Path>, format: Format) -> Outcome {
    let deployment = deployment.map(|path| config::load(Some(path))).transpose()?;
    let recomputed = recompute(file, parts, deployment.as_ref())?;
    output::value(format, &recomputed, table)?;
    Ok(if recomputed.identical {
        exit_code::OK
    } else {
        exit_code::FAILED
    })
}

/// Recomputes parts of a record with the settings of a deployment, otherwise those that the run's parts reported, otherwise the defaults.
///
/// # Errors
/// A bad record, or one with another message version.
pub fn recompute(file: &Path, parts: &[Recomputable], deployment: Option<&Deployment>) -> Result<Recomputed, Failure> {
    RecordReader::open(file)?.check_messages()?;
    let mut settings = RunSettings::of(file, deployment.map(PartSettings::of))?;
    let mut recomputed = Recomputed {
        identical: true,
        ..Recomputed::default()
    };
    if parts.contains(&Recomputable::Mapping) {
        recomputed.maps = mapping::recompute(file, &mut settings)?;
        recomputed.identical &= !recomputed.maps.is_empty() && recomputed.maps.iter().all(|map| map.identical);
        if recomputed.maps.is_empty() {
            let note = "mapping: no patch of a map is in the record";
            recomputed.notes.push(note.to_owned());
        }
    }
    if parts.contains(&Recomputable::Motion) {
        recomputed.motion = motion::recompute(file, &mut settings)?;
        recomputed.identical &=
            !recomputed.motion.is_empty() && recomputed.motion.iter().all(|worker| worker.identical);
        if recomputed.motion.is_empty() {
            let note = "motion: no answer of a motion worker is in the record";
            recomputed.notes.push(note.to_owned());
        }
    }
    recomputed.notes.extend(settings.notes());
    Ok(recomputed)
}

fn table(recomputed: &Recomputed) -> String {
    let maps = recomputed.maps.iter().map(MapVerdict::line);
    let motion = recomputed.motion.iter().map(MotionVerdict::lines);
    let notes = recomputed.notes.iter().map(|note| format!("note: {note}"));
    maps.chain(motion).chain(notes).collect::<Vec<_>>().join("\n")
}

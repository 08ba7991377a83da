//! `zenav replay --recompute`. Do the cores make the same of the same inputs?
//!
//! | file | answers |
//! |---|---|
//! | `mapping` | does mapping make the recorded map of the recorded scans? |
//! | `motion` | do the motion workers answer the recorded requests as they did? |

mod mapping;
mod motion;

use std::path::Path;

use clap::ValueEnum;
use serde::Serialize;
use serde::de::DeserializeOwned;
use zenav_cloud::motion::MotionSettings;
use zenav_mapping::MappingSettings;

use super::format::{MAPPING_ENTRY, MOTION_ENTRY};
use super::reader::RecordReader;
use crate::config;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::output::{self, Format};

pub use mapping::MapVerdict;
pub use motion::{MotionVerdict, Uncompared};

/// What can be computed again.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Part {
    /// Maps from scans
    Mapping,
    /// Trajectories from requests
    Motion,
}

/// Settings that the parts of a run had, where they are known.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Told {
    /// The mapper's.
    pub mapping: Option<MappingSettings>,
    /// The motion workers'.
    pub motion: Option<MotionSettings>,
}

/// What came of a record's inputs.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Recomputed {
    /// The map of each robot.
    pub maps: Vec<MapVerdict>,
    /// The answers of each motion worker.
    pub motion: Vec<MotionVerdict>,
    /// Whether everything that was asked for is there, and is what was recorded.
    pub identical: bool,
    /// What could not be computed again, or not as it was, and why.
    pub notes: Vec<String>,
}

/// `zenav replay FILE --recompute PARTS`.
pub(super) fn run(file: &Path, parts: &[Part], deployment: Option<&Path>, format: Format) -> Outcome {
    let told = match deployment.map(|path| config::load(Some(path))).transpose()? {
        Some(deployment) => Told {
            motion: Some(deployment.motion()),
            mapping: Some(deployment.mapping.settings),
        },
        None => Told::default(),
    };
    let recomputed = recompute(file, parts, told)?;
    output::value(format, &recomputed, table)?;
    Ok(if recomputed.identical {
        exit_code::OK
    } else {
        exit_code::FAILED
    })
}

/// Computes parts of a record again. Settings are those told, else the record's, else the defaults.
///
/// # Errors
/// A bad record, or one of other messages.
pub fn recompute(file: &Path, parts: &[Part], told: Told) -> Result<Recomputed, Failure> {
    let reader = RecordReader::open(file)?;
    reader.check_messages()?;
    let mut recomputed = Recomputed {
        identical: true,
        ..Recomputed::default()
    };
    if parts.contains(&Part::Mapping) {
        let settings = settings(&reader, file, MAPPING_ENTRY, told.mapping, &mut recomputed.notes)?;
        recomputed.maps = mapping::recompute(file, &settings)?;
        recomputed.identical &= !recomputed.maps.is_empty() && recomputed.maps.iter().all(|map| map.identical);
        if recomputed.maps.is_empty() {
            let note = "mapping: no patch of a map is in the record";
            recomputed.notes.push(note.to_owned());
        }
    }
    if parts.contains(&Part::Motion) {
        let settings = settings(&reader, file, MOTION_ENTRY, told.motion, &mut recomputed.notes)?;
        recomputed.motion = motion::recompute(file, &settings)?;
        recomputed.identical &=
            !recomputed.motion.is_empty() && recomputed.motion.iter().all(|worker| worker.identical);
        if recomputed.motion.is_empty() {
            let note = "motion: no answer of a motion worker is in the record";
            recomputed.notes.push(note.to_owned());
        }
    }
    Ok(recomputed)
}

/// The settings of a part: those told, else the record's, else the defaults, with a note.
fn settings<S: DeserializeOwned + Default>(
    reader: &RecordReader,
    file: &Path,
    part: &str,
    told: Option<S>,
    notes: &mut Vec<String>,
) -> Result<S, Failure> {
    match (told, reader.about().get(part)) {
        (Some(settings), _) => Ok(settings),
        (None, Some(text)) => serde_json::from_str(text).map_err(Failure::usage_at(file)),
        (None, None) => {
            notes.push(format!(
                "{part}: the record does not say its settings; taken are the defaults"
            ));
            Ok(S::default())
        }
    }
}

fn table(recomputed: &Recomputed) -> String {
    let maps = recomputed.maps.iter().map(MapVerdict::line);
    let motion = recomputed.motion.iter().map(MotionVerdict::lines);
    let notes = recomputed.notes.iter().map(|note| format!("note: {note}"));
    maps.chain(motion).chain(notes).collect::<Vec<_>>().join("\n")
}

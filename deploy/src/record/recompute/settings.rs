//! Settings of a recorded run. Taken from a named deployment, otherwise from the parts' reports to the recorder, otherwise the defaults.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use serde::de::DeserializeOwned;
use serde_json::Value;
use zenav_cloud::mapping::PoseSettings;
use zenav_cloud::motion::MotionSettings;
use zenav_mapping::MappingSettings;
use zenav_protocol::topics;

use super::PartSettings;
use crate::failure::Failure;
use crate::record::reader::RecordReader;

/// The settings of each part of a run.
#[derive(Debug, Default)]
pub(super) struct RunSettings {
    /// Settings for every part, replacing the reported ones.
    named: Option<PartSettings>,
    /// Settings that each part reported, by section.
    told: BTreeMap<String, BTreeMap<String, Value>>,
    notes: BTreeSet<String>,
}

impl RunSettings {
    /// The settings of a record.
    pub(super) fn of(file: &Path, named: Option<PartSettings>) -> Result<Self, Failure> {
        let mut told = BTreeMap::new();
        let mut reader = RecordReader::open(file)?;
        while let Some(sample) = reader.next_sample()? {
            if let Some((part, info)) = sample.reply(&topics::PART_INFO)
                && !info.settings.is_empty()
            {
                told.insert(part, info.settings);
            }
        }
        reader.warn_of_losses();
        Ok(Self {
            named,
            told,
            notes: BTreeSet::new(),
        })
    }

    /// Settings of a robot's mapping, and the source of its poses.
    pub(super) fn mapping(&mut self, robot: &str) -> (MappingSettings, PoseSettings) {
        if let Some(named) = &self.named {
            return (named.mapping.clone(), named.poses);
        }
        let part = format!("mapping-{robot}");
        (self.section(&part, "mapping"), self.section(&part, "poses"))
    }

    /// Settings of a motion worker.
    pub(super) fn motion(&mut self, worker: &str) -> MotionSettings {
        if let Some(named) = &self.named {
            return named.motion.clone();
        }
        self.section(&format!("motion-{worker}"), "motion")
    }

    fn section<S: DeserializeOwned + Default>(&mut self, part: &str, section: &str) -> S {
        let told = self.told.get(part).and_then(|sections| sections.get(section));
        let why = match told.map(S::deserialize) {
            Some(Ok(settings)) => return settings,
            Some(Err(error)) => format!("are not those of this version ({error})"),
            None => "are not in the record".to_owned(),
        };
        self.notes.insert(format!(
            "{part}: its settings `{section}` {why}; taken are the defaults (--deployment FILE names others)"
        ));
        S::default()
    }

    /// Notes on settings that were not known.
    pub(super) fn notes(self) -> BTreeSet<String> {
        self.notes
    }
}

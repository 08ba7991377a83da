//! Record of a demonstration. The bus traffic, kept for the report page, and as a separate file on request.

use std::path::{Path, PathBuf};

use zenav_protocol::bus::{Bus, BusConfig};

use super::{DemoArgs, Script};
use crate::failure::Failure;
use crate::record::{self, RecordOptions, Recording, Written};
use crate::report::DemoReport;

/// Name of the page, beside `report.json`.
const PAGE: &str = "report.html";

/// Records all traffic of a demonstration's router.
pub(super) struct Recorder {
    bus: Bus,
    recording: Recording,
    page: PathBuf,
    /// Whether the user asked for the record.
    is_kept: bool,
}

impl Recorder {
    /// Starts recording, into a file in `state` if none was named.
    pub(super) async fn begin(args: &DemoArgs, script: &Script, endpoint: &str, state: &Path) -> Result<Self, Failure> {
        let file = args.record.clone().unwrap_or_else(|| state.join("run.mcap"));
        let is_kept = args.record.is_some();
        std::fs::create_dir_all(state).map_err(Failure::failed_at(state))?;
        let title = format!("{}, seed {}, speed {}", script.name, args.seed, args.speed);
        let options = RecordOptions {
            about: [(record::TITLE_ENTRY.to_owned(), title)].into(),
            // The page needs only the samples themselves.
            raw_only: !is_kept,
            ..RecordOptions::default()
        };
        let bus = Bus::open(BusConfig::command("recorder", endpoint)).await?;
        let recording = Recording::start(&bus, &["zenav/**".to_owned()], &file, options)?;
        Ok(Self {
            bus,
            recording,
            page: args.folder().join(PAGE),
            is_kept,
        })
    }

    /// Ends the recording, and adds page and record to the report. A missing page is only noted; a missing record that was asked for is a
    /// failure.
    pub(super) async fn end(self, played: Result<DemoReport, Failure>) -> Result<DemoReport, Failure> {
        let recorded = self.recording.finish().await;
        self.bus.close().await;
        let mut report = played?;
        let told = recorded.and_then(|written| tell(&mut report, written, &self.page, self.is_kept));
        match told {
            Err(failure) if self.is_kept => return Err(failure),
            Err(failure) => report.notes.push(format!("no {PAGE}: {failure}")),
            Ok(()) => {}
        }
        Ok(report)
    }
}

fn tell(report: &mut DemoReport, written: Written, page: &Path, is_kept: bool) -> Result<(), Failure> {
    if written.dropped > 0 {
        report.notes.push(format!(
            "the record lacks {} samples: this machine was too slow",
            written.dropped
        ));
    }
    for file in written.files {
        record::write_report(&file, page)?;
        report.files.extend(is_kept.then_some(file));
        report.files.push(page.to_owned());
    }
    Ok(())
}

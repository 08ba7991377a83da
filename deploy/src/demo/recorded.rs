//! Record of a demonstration. The bus traffic, kept for the report page, and as a film and a separate file on request.

use std::path::{Path, PathBuf};

use zenav_protocol::bus::{Bus, BusConfig, Shutdown};

use super::DemoArgs;
use super::script::Script;
use crate::failure::Failure;
use crate::record::{self, RecordOptions, Recording};
use crate::report::DemoReport;

/// Name of the page, beside `report.json`.
const PAGE: &str = "report.html";

/// Records all traffic of a demonstration's router.
pub(super) struct Recorder {
    bus: Bus,
    recording: Recording,
    page: PathBuf,
    film: Option<PathBuf>,
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
            film: args.film.clone(),
            is_kept,
        })
    }

    /// Ends the recording, and adds page, film and record to the report. A missing page is only noted; a missing film or record that was
    /// asked for is a failure, beside the report.
    pub(super) async fn end(self, played: Result<DemoReport, Failure>, stop: &Shutdown) -> Result<Played, Failure> {
        let recorded = self.recording.finish().await;
        self.bus.close().await;
        let mut report = played?;
        let kept = match recorded {
            Ok(written) => {
                if written.dropped > 0 {
                    report.notes.push(format!(
                        "the record lacks {} samples: this machine was too slow",
                        written.dropped
                    ));
                }
                let mut made = Made::default();
                let mut files = written.files.iter();
                let film = self.film.as_deref();
                let kept = files.try_for_each(|file| made.add(file, &self.page, film, self.is_kept, stop));
                report.files.append(&mut made.files);
                report.notes.append(&mut made.notes);
                kept
            }
            Err(failure) if self.is_kept || self.film.is_some() => Err(failure),
            Err(failure) => {
                report.notes.push(no_page(&failure));
                Ok(())
            }
        };
        Ok(Played { report, kept })
    }
}

/// A demonstration that was played.
pub(super) struct Played {
    pub report: DemoReport,
    /// Whether everything that was asked for could be written.
    pub kept: Result<(), Failure>,
}

fn no_page(failure: &Failure) -> String {
    format!("no {PAGE}: {failure}")
}

/// What was made of a record, and notes on what was not.
#[derive(Debug, Default)]
struct Made {
    files: Vec<PathBuf>,
    notes: Vec<String>,
}

impl Made {
    /// Makes the page and the film of a record. A missing page is only noted.
    fn add(
        &mut self,
        record: &Path,
        page: &Path,
        film: Option<&Path>,
        is_kept: bool,
        stop: &Shutdown,
    ) -> Result<(), Failure> {
        match record::write_report(record, page) {
            Ok(()) => self.files.push(page.to_owned()),
            Err(failure) => self.notes.push(no_page(&failure)),
        }
        self.files.extend(is_kept.then(|| record.to_owned()));
        if let Some(film) = film {
            tracing::info!("rendering {}", film.display());
            let goes_on = || match stop.is_set() {
                true => Err(Failure::interrupted()),
                false => Ok(()),
            };
            record::write_film(record, None, film, goes_on)?;
            self.files.push(film.to_owned());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{cli, exit_code, lockstep};

    #[test]
    fn film_and_record_do_not_need_the_page() {
        let folder = tempfile::tempdir().unwrap();
        let path = |name: &str| folder.path().join(name);
        let record = path("run.mcap");
        let name = record.display().to_string();
        let words = "--world empty --goal 3 0 --timeout 2 --record".split(' ');
        let words: Vec<&str> = words.chain([name.as_str()]).collect();
        lockstep::run(&cli::parsed(&words).unwrap()).unwrap();
        let (page, film, nowhere) = (path("report.html"), path("last.png"), path("none/last.png"));

        let stop = Shutdown::new();
        let mut without_page = Made::default();
        without_page
            .add(&record, &path("none/report.html"), Some(&film), true, &stop)
            .unwrap();
        assert_eq!(without_page.files, [record.clone(), film]);
        let notes = &without_page.notes;
        assert!(notes[0].starts_with("no report.html: "), "{notes:?}");
        let mut without_film = Made::default();
        assert!(without_film.add(&record, &page, Some(&nowhere), true, &stop).is_err());
        assert_eq!(without_film.files, [page.clone(), record.clone()]);

        // Rendering takes long: Ctrl-C ends it.
        stop.trigger();
        let film = path("run.gif");
        let ended = Made::default().add(&record, &page, Some(&film), true, &stop);
        assert_eq!(ended.unwrap_err().code, exit_code::INTERRUPTED);
        assert!(!film.exists());
    }
}

//! Writer. Writes samples to a file that survives a killed recorder, and starts the next file when one is full.
//!
//! Chunks are written whole: a file that was cut off can be read up to its last chunk.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Duration;

use mcap::records::{MessageHeader, Metadata};
use mcap::write::NoSeek;
use mcap::{Compression, McapError, WriteOptions};
use serde::Serialize;
use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::codec::Encoding;
use zenav_protocol::topics;

use super::format::{
    ABOUT, ATTACHMENT, DRAWN, ENCODING, FORMAT_ENTRY, KIND, Kind, PROFILE, Problem, RecordError, SCHEMA_ENTRY,
    STARTED_ENTRY, Sample, VERSION,
};
use super::foxglove::{self, Artist, Drawn};
use super::maps::Maps;
use super::schema;

/// Size at which a chunk is written, bytes; [`RecordWriter::flush`] writes it sooner.
const CHUNK: u64 = 1 << 20;
/// Encoding of bytes without structure.
const UNTYPED: &str = "application/octet-stream";

/// Options of a recording.
#[derive(Clone, Debug, Default)]
pub struct RecordOptions {
    /// Largest size of a file before the next one is started, bytes.
    pub max_bytes: Option<u64>,
    /// Longest time in a file before the next one is started.
    pub max_time: Option<Duration>,
    /// Most files kept: the oldest is deleted when one more is started.
    pub max_files: Option<usize>,
    /// Whether to leave out Foxglove's messages.
    pub raw_only: bool,
    /// Entries of the metadata `zenav` about the run.
    pub about: BTreeMap<String, String>,
}

impl RecordOptions {
    fn rotates(&self) -> bool {
        self.max_bytes.is_some() || self.max_time.is_some()
    }
}

/// Summary of a recording.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Written {
    /// The files that were kept, in order.
    pub files: Vec<PathBuf>,
    /// Older files that were deleted.
    pub deleted: u64,
    /// Samples.
    pub messages: u64,
    /// Samples of each key.
    pub keys: BTreeMap<String, u64>,
    /// Bytes of the samples' payloads.
    pub payload_bytes: u64,
    /// Bytes of all files, the deleted ones included.
    pub file_bytes: u64,
    /// Samples dropped because the disk or the machine was too slow.
    pub dropped: u64,
    /// Time from the first sample to the last, s.
    pub secs: f64,
}

/// Writes a run, in one file or several.
pub struct RecordWriter {
    path: PathBuf,
    options: RecordOptions,
    file: RecordFile,
    artist: Artist,
    maps: Maps,
    /// Replies, written at the start of every file.
    replies: BTreeMap<String, Sample>,
    written: Written,
    /// Number of the present file, if there are several.
    number: usize,
    first: Option<u64>,
    last: u64,
}

impl RecordWriter {
    /// Starts a recording at `now`, ns since the UNIX epoch. With a size or time limit the files are named `OUT_0001.mcap` and so on.
    ///
    /// # Errors
    /// The file exists already or cannot be created.
    pub fn create(path: &Path, options: RecordOptions, now: u64) -> Result<Self, RecordError> {
        let first = if options.rotates() {
            numbered(path, 1)
        } else {
            path.to_owned()
        };
        let file = RecordFile::create(&first, &options, now)?;
        Ok(Self {
            path: path.to_owned(),
            options,
            file,
            artist: Artist::default(),
            maps: Maps::default(),
            replies: BTreeMap::new(),
            written: Written {
                files: vec![first],
                ..Written::default()
            },
            number: 1,
            first: None,
            last: now,
        })
    }

    /// Writes a sample.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn write(&mut self, sample: &Sample) -> Result<(), RecordError> {
        if self.is_full(sample.logged) {
            self.next_file(sample.logged)?;
        }
        self.first.get_or_insert(sample.logged);
        self.last = self.last.max(sample.logged);
        self.file.sample(sample)?;
        if sample.kind == Kind::Reply {
            self.replies.insert(sample.key.clone(), sample.clone());
        } else {
            self.written.messages += 1;
            self.written.payload_bytes += sample.bytes.len() as u64;
            count(&mut self.written.keys, &sample.key);
        }
        self.draw(sample)
    }

    /// Writes a sample as Foxglove messages.
    fn draw(&mut self, sample: &Sample) -> Result<(), RecordError> {
        let changed = self.maps.see(sample);
        if self.options.raw_only {
            return Ok(());
        }
        for drawn in self.artist.draw(sample) {
            self.file.drawn(&drawn, sample.logged)?;
        }
        if let Some(robot) = changed
            && let Some(map) = self.maps.grid(&robot)
            && let Some(drawn) = self.artist.draw_map(&robot, map, sample.logged, false)
        {
            self.file.drawn(&drawn, sample.logged)?;
        }
        Ok(())
    }

    /// Robots whose maps are incomplete in the recording.
    pub fn incomplete_maps(&self) -> Vec<String> {
        self.maps.incomplete().map(str::to_owned).collect()
    }

    /// Draws the current maps at the end of a file.
    fn draw_maps(&mut self) -> Result<(), RecordError> {
        for robot in self.artist.undrawn() {
            if let Some(map) = self.maps.grid(&robot)
                && let Some(drawn) = self.artist.draw_map(&robot, map, self.last, true)
            {
                self.file.drawn(&drawn, self.last)?;
            }
        }
        Ok(())
    }

    /// Writes buffered data: it then outlives this process.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn flush(&mut self) -> Result<(), RecordError> {
        self.file.flush()
    }

    /// Ends the recording; `dropped` samples were lost before they came here.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn finish(mut self, dropped: u64) -> Result<Written, RecordError> {
        self.draw_maps()?;
        self.written.file_bytes += self.file.finish()?;
        self.written.dropped = dropped;
        self.written.secs = self.last.saturating_sub(self.first.unwrap_or(self.last)) as f64 * 1e-9;
        Ok(self.written)
    }

    fn is_full(&self, now: u64) -> bool {
        let bytes = self.options.max_bytes.is_some_and(|most| self.file.bytes() >= most);
        let age = Duration::from_nanos(now.saturating_sub(self.file.begun));
        bytes || self.options.max_time.is_some_and(|most| age >= most)
    }

    fn next_file(&mut self, now: u64) -> Result<(), RecordError> {
        self.draw_maps()?;
        self.written.file_bytes += self.file.finish()?;
        let next = loop {
            self.number += 1;
            let next = numbered(&self.path, self.number);
            match RecordFile::create(&next, &self.options, now) {
                // Left over from another recording: try the next number.
                Err(error) if matches!(error.problem, Problem::Exists) => {}
                created => {
                    self.file = created?;
                    break next;
                }
            }
        };
        self.written.files.push(next);
        self.delete_oldest();
        self.artist.begin_file();
        // Makes each file usable without the ones before it.
        let mut beginning: Vec<Sample> = self.replies.values().cloned().collect();
        beginning.retain(|reply| topics::MAP.chunks(&reply.key).is_empty());
        beginning.extend(self.maps.replies(now));
        for reply in beginning {
            let reply = Sample { logged: now, ..reply };
            self.file.sample(&reply)?;
            self.draw(&reply)?;
        }
        Ok(())
    }

    /// Deletes the oldest files of this recording beyond those that are kept.
    fn delete_oldest(&mut self) {
        let kept = self.options.max_files.unwrap_or(usize::MAX).max(1);
        let excess = self.written.files.len().saturating_sub(kept);
        for file in self.written.files.drain(..excess) {
            match std::fs::remove_file(&file) {
                // Moved away meanwhile.
                Err(error) if error.kind() == std::io::ErrorKind::NotFound => {}
                Err(error) => {
                    tracing::warn!(%error, file = %file.display(), "an old file of the record is not deleted")
                }
                Ok(()) => {}
            }
            self.written.deleted += 1;
        }
    }
}

fn count(keys: &mut BTreeMap<String, u64>, key: &str) {
    if let Some(count) = keys.get_mut(key) {
        *count += 1;
    } else {
        keys.insert(key.to_owned(), 1);
    }
}

/// `run.mcap` becomes `run_0001.mcap`.
fn numbered(path: &Path, number: usize) -> PathBuf {
    let stem = path.file_stem().unwrap_or_default().to_string_lossy();
    let ending = path.extension().unwrap_or_default().to_string_lossy();
    let dot = if ending.is_empty() { "" } else { "." };
    path.with_file_name(format!("{stem}_{number:04}{dot}{ending}"))
}

/// Counts bytes written to a file.
struct Counted {
    file: BufWriter<File>,
    bytes: Arc<AtomicU64>,
}

impl Write for Counted {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let written = self.file.write(bytes)?;
        self.bytes.fetch_add(written as u64, Ordering::Relaxed);
        Ok(written)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// Identity of a channel in a file.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct ChannelName {
    topic: String,
    kind: &'static str,
    encoding: String,
}

/// One MCAP file.
struct RecordFile {
    path: PathBuf,
    begun: u64,
    mcap: mcap::Writer<NoSeek<Counted>>,
    bytes: Arc<AtomicU64>,
    /// For each channel its number, and the number of its next message.
    channels: BTreeMap<ChannelName, (u16, u32)>,
}

impl RecordFile {
    fn create(path: &Path, options: &RecordOptions, now: u64) -> Result<Self, RecordError> {
        let file = File::create_new(path).map_err(|error| match error.kind() {
            std::io::ErrorKind::AlreadyExists => RecordError::new(path, Problem::Exists),
            _ => RecordError::new(path, Problem::Io(error)),
        })?;
        let bytes = Arc::new(AtomicU64::new(0));
        let counted = Counted {
            file: BufWriter::new(file),
            bytes: Arc::clone(&bytes),
        };
        // Without seeking, a chunk is assembled in memory and written whole.
        let mcap = WriteOptions::new()
            .profile(PROFILE)
            .library(concat!("zenav/", env!("CARGO_PKG_VERSION")))
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(CHUNK))
            .disable_seeking(true)
            .create(NoSeek::new(counted))
            .map_err(|error| broken(path, error))?;
        let mut file = Self {
            path: path.to_owned(),
            begun: now,
            mcap,
            bytes,
            channels: BTreeMap::new(),
        };
        let mut about = options.about.clone();
        for (name, value) in [
            (FORMAT_ENTRY, VERSION.to_owned()),
            (SCHEMA_ENTRY, SCHEMA_VERSION.to_string()),
            (STARTED_ENTRY, now.to_string()),
        ] {
            about.insert(name.to_owned(), value);
        }
        let about = Metadata {
            name: ABOUT.to_owned(),
            metadata: about,
        };
        let told = file.mcap.write_metadata(&about);
        told.map_err(|error| broken(path, error))?;
        file.flush()?;
        Ok(file)
    }

    fn bytes(&self) -> u64 {
        self.bytes.load(Ordering::Relaxed)
    }

    fn sample(&mut self, sample: &Sample) -> Result<(), RecordError> {
        let name = ChannelName {
            topic: sample.key.clone(),
            kind: sample.kind.name(),
            encoding: sample.encoding.clone(),
        };
        let (channel, sequence) = self.channel(&name, |mcap| {
            // A deletion holds nothing, which is no JSON.
            if sample.kind == Kind::Delete {
                return Ok((0, UNTYPED));
            }
            if Encoding::of(&sample.encoding) == Encoding::Cbor {
                return Ok((0, "cbor"));
            }
            let Some(schema) = schema::of(&sample.key, &sample.bytes) else {
                // Text that is not a JSON object, or bytes of another program: named as Zenoh does.
                return Ok((0, sample.encoding.as_str()));
            };
            let (title, schema) = (schema::title(&sample.key), schema.to_string());
            Ok((mcap.add_schema(&title, schema::ENCODING, schema.as_bytes())?, "json"))
        })?;
        // Written before its sample: a reader then has it when the sample comes.
        if let Some(attachment) = &sample.attachment {
            let attached = ChannelName {
                kind: ATTACHMENT,
                encoding: format!("{} {}", sample.kind.name(), sample.encoding),
                ..name
            };
            let (attached, _) = self.channel(&attached, |_| Ok((0, UNTYPED)))?;
            self.message(attached, sequence, sample.logged, None, attachment)?;
        }
        self.message(channel, sequence, sample.logged, sample.published, &sample.bytes)
    }

    fn drawn(&mut self, drawn: &Drawn, logged: u64) -> Result<(), RecordError> {
        let name = ChannelName {
            topic: drawn.topic.clone(),
            kind: DRAWN,
            encoding: foxglove::ENCODING.to_owned(),
        };
        let schema = &drawn.schema;
        let (channel, sequence) = self.channel(&name, |mcap| {
            let schema = mcap.add_schema(&schema.name, &schema.encoding, &schema.data)?;
            Ok((schema, foxglove::ENCODING))
        })?;
        self.message(channel, sequence, logged, None, &drawn.bytes)
    }

    /// The channel's number and that of its next message; `described` gives the schema (0 for none) and the encoding of a new channel.
    fn channel<'e>(
        &mut self,
        name: &ChannelName,
        described: impl FnOnce(&mut mcap::Writer<NoSeek<Counted>>) -> Result<(u16, &'e str), McapError>,
    ) -> Result<(u16, u32), RecordError> {
        if let Some((channel, sequence)) = self.channels.get_mut(name) {
            *sequence = sequence.wrapping_add(1);
            return Ok((*channel, *sequence));
        }
        let metadata = [(KIND, name.kind), (ENCODING, name.encoding.as_str())];
        let metadata = metadata.map(|(entry, value)| (entry.to_owned(), value.to_owned()));
        let channel = described(&mut self.mcap)
            .and_then(|(schema, encoding)| self.mcap.add_channel(schema, &name.topic, encoding, &metadata.into()))
            .map_err(|error| broken(&self.path, error))?;
        self.channels.insert(name.clone(), (channel, 0));
        Ok((channel, 0))
    }

    fn message(
        &mut self,
        channel_id: u16,
        sequence: u32,
        log_time: u64,
        published: Option<u64>,
        bytes: &[u8],
    ) -> Result<(), RecordError> {
        let header = MessageHeader {
            channel_id,
            sequence,
            log_time,
            publish_time: published.unwrap_or(log_time),
        };
        let written = self.mcap.write_to_known_channel(&header, bytes);
        written.map_err(|error| broken(&self.path, error))
    }

    fn flush(&mut self) -> Result<(), RecordError> {
        self.mcap.flush().map_err(|error| broken(&self.path, error))
    }

    /// Finishes the file; returns its size, bytes.
    fn finish(&mut self) -> Result<u64, RecordError> {
        self.mcap.finish().map_err(|error| broken(&self.path, error))?;
        Ok(self.bytes())
    }
}

fn broken(path: &Path, error: McapError) -> RecordError {
    let problem = match error {
        McapError::Io(error) => Problem::Io(error),
        other => Problem::Io(std::io::Error::other(other)),
    };
    RecordError::new(path, problem)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_of_one_recording_are_numbered() {
        assert_eq!(numbered(Path::new("a/run.mcap"), 2), Path::new("a/run_0002.mcap"));
        assert_eq!(numbered(Path::new("run"), 11), Path::new("run_0011"));
    }

    #[test]
    fn of_many_files_only_the_newest_are_kept() {
        let folder = tempfile::tempdir().unwrap();
        let options = RecordOptions {
            max_time: Some(Duration::from_secs(1)),
            max_files: Some(2),
            ..RecordOptions::default()
        };
        let mut writer = RecordWriter::create(&folder.path().join("run.mcap"), options, 0).unwrap();
        for second in 0..5 {
            let sample = Sample {
                key: "a/b".to_owned(),
                encoding: Encoding::Json.mime().to_owned(),
                kind: Kind::Put,
                bytes: b"{}".to_vec(),
                attachment: None,
                logged: second * 1_000_000_000,
                published: None,
            };
            writer.write(&sample).unwrap();
        }
        let written = writer.finish(0).unwrap();
        let names = ["run_0004.mcap", "run_0005.mcap"].map(|name| folder.path().join(name));
        assert_eq!((written.files.as_slice(), written.deleted), (&names[..], 3));
        assert_eq!(written.messages, 5);
        let mut left: Vec<PathBuf> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().path())
            .collect();
        left.sort();
        assert_eq!(left, names);
    }
}

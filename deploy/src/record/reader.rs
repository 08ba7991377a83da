//! Reader. Reads the samples of a record one after another, in order of arrival, also from a file that was cut off.

use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::{BufReader, Read as _};
use std::path::{Path, PathBuf};

use mcap::records::{Channel, MessageHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, parse_record};
use zenav_protocol::SCHEMA_VERSION;

use super::format::{
    ABOUT, ATTACHMENT, ENCODING, FORMAT_ENTRY, KIND, Kind, PROFILE, Problem, RecordError, SCHEMA_ENTRY, Sample, VERSION,
};

/// Largest record of a file that is read, bytes: larger than the largest message.
const MOST: usize = 256 << 20;
/// Most attachments held for their samples.
const MOST_ATTACHED: usize = 64;

/// Reads a record from its beginning to its end.
pub struct RecordReader {
    path: PathBuf,
    file: BufReader<File>,
    /// Bytes of the file not yet read.
    left: u64,
    reader: LinearReader,
    about: BTreeMap<String, String>,
    channels: HashMap<u16, Carried>,
    attached: Vec<Attached>,
    /// The first sample, read while the file was opened.
    first: Option<Sample>,
    cut_off: bool,
    ended: bool,
}

impl std::fmt::Debug for RecordReader {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("RecordReader")
            .field("path", &self.path)
            .finish_non_exhaustive()
    }
}

/// An attachment: kind, key and number of its sample, and its bytes.
type Attached = (Kind, String, u32, Vec<u8>);

/// Contents of a channel.
enum Carried {
    Samples { key: String, kind: Kind, encoding: String },
    Attachments { key: String, kind: Kind },
    Other,
}

impl Carried {
    fn of(channel: &Channel) -> Self {
        let entry = |name| channel.metadata.get(name).map_or("", String::as_str);
        let key = channel.topic.clone();
        if entry(KIND) == ATTACHMENT {
            let kind = entry(ENCODING).split(' ').next().and_then(Kind::named);
            return kind.map_or(Self::Other, |kind| Self::Attachments { key, kind });
        }
        Kind::named(entry(KIND)).map_or(Self::Other, |kind| Self::Samples {
            key,
            kind,
            encoding: entry(ENCODING).to_owned(),
        })
    }
}

impl RecordReader {
    /// Opens a record and reads up to its first sample.
    ///
    /// # Errors
    /// [`RecordError`] for a file that is not a record of this version, or that has no samples.
    pub fn open(path: &Path) -> Result<Self, RecordError> {
        let io = |error| RecordError::io(path, error);
        let file = File::open(path).map_err(io)?;
        let facts = file.metadata().map_err(io)?;
        if !facts.is_file() {
            return Err(io(std::io::Error::other("expected a file")));
        }
        let options = LinearReaderOptions::default()
            .with_record_length_limit(MOST)
            .with_validate_chunk_crcs(true);
        let mut reader = Self {
            path: path.to_owned(),
            file: BufReader::new(file),
            left: facts.len(),
            reader: LinearReader::new_with_options(options),
            about: BTreeMap::new(),
            channels: HashMap::new(),
            attached: Vec::new(),
            first: None,
            cut_off: false,
            ended: false,
        };
        reader.first = reader.read()?;
        if reader.first.is_none() {
            return Err(reader.error(Problem::Empty));
        }
        Ok(reader)
    }

    /// Entries of the metadata `zenav` about the run.
    #[must_use]
    pub fn about(&self) -> &BTreeMap<String, String> {
        &self.about
    }

    /// Checks that the messages have this program's version.
    ///
    /// # Errors
    /// They have another version.
    pub fn check_messages(&self) -> Result<(), RecordError> {
        let found = self.about.get(SCHEMA_ENTRY).map_or("", String::as_str);
        let expected = SCHEMA_VERSION.to_string();
        if found == expected {
            return Ok(());
        }
        Err(self.error(Problem::Version {
            what: "its messages are of version",
            found: found.to_owned(),
            expected,
        }))
    }

    /// Whether the file was cut off, as after its recorder was killed. Known only after reading all of it.
    #[must_use]
    pub const fn is_cut_off(&self) -> bool {
        self.cut_off
    }

    /// The next sample; `None` at the end.
    ///
    /// # Errors
    /// The file is damaged, not merely cut off.
    pub fn next_sample(&mut self) -> Result<Option<Sample>, RecordError> {
        match self.first.take() {
            Some(sample) => Ok(Some(sample)),
            None => self.read(),
        }
    }

    fn error(&self, problem: Problem) -> RecordError {
        RecordError::new(&self.path, problem)
    }

    fn read(&mut self) -> Result<Option<Sample>, RecordError> {
        while !self.ended {
            let Some(record) = self.record()? else {
                self.ended = true;
                break;
            };
            match record {
                Record::Header(header) if header.profile != PROFILE => {
                    let profile = header.profile;
                    return Err(self.error(Problem::Foreign { profile }));
                }
                Record::Metadata(metadata) if metadata.name == ABOUT => {
                    self.about = metadata.metadata;
                    self.check_format()?;
                }
                Record::Channel(channel) => {
                    self.channels.insert(channel.id, Carried::of(&channel));
                }
                Record::Message { header, data } => {
                    if let Some(sample) = self.message(&header, data.into_owned()) {
                        return Ok(Some(sample));
                    }
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// The next record with content; `None` at the end of the data.
    fn record(&mut self) -> Result<Option<Record<'static>>, RecordError> {
        loop {
            let need = match self.reader.next_event() {
                None => return Ok(None),
                Some(Ok(LinearReadEvent::ReadRequest(need))) => need,
                Some(Ok(LinearReadEvent::Record { opcode, data })) => match opcode {
                    op::HEADER | op::METADATA | op::CHANNEL | op::MESSAGE => {
                        let record = parse_record(opcode, data).map(Record::into_owned);
                        return record.map(Some).map_err(|error| damaged(&self.path, &error));
                    }
                    // Behind it are only summaries of the rest.
                    op::DATA_END => return Ok(None),
                    _ => continue,
                },
                Some(Err(McapError::UnexpectedEof)) => {
                    self.cut_off = true;
                    return Ok(None);
                }
                Some(Err(McapError::BadMagic)) => return Err(self.error(Problem::NotMcap)),
                Some(Err(error)) => return Err(damaged(&self.path, &error)),
            };
            self.supply(need)?;
        }
    }

    /// The sample of a message; an attachment is held for its sample.
    fn message(&mut self, header: &MessageHeader, bytes: Vec<u8>) -> Option<Sample> {
        match self.channels.get(&header.channel_id)? {
            Carried::Samples { key, kind, encoding } => {
                let is_its = |(of, on, sequence, _): &Attached| of == kind && on == key && *sequence == header.sequence;
                let attached = self.attached.iter().position(is_its);
                Some(Sample {
                    key: key.clone(),
                    encoding: encoding.clone(),
                    kind: *kind,
                    bytes,
                    attachment: attached.map(|place| self.attached.swap_remove(place).3),
                    logged: header.log_time,
                    published: (header.publish_time != header.log_time).then_some(header.publish_time),
                })
            }
            Carried::Attachments { key, kind } if self.attached.len() < MOST_ATTACHED => {
                self.attached.push((*kind, key.clone(), header.sequence, bytes));
                None
            }
            _ => None,
        }
    }

    fn check_format(&self) -> Result<(), RecordError> {
        let found = self.about.get(FORMAT_ENTRY).map_or("", String::as_str);
        if found == VERSION {
            return Ok(());
        }
        Err(self.error(Problem::Version {
            what: "a record of format",
            found: found.to_owned(),
            expected: VERSION.to_owned(),
        }))
    }

    /// Reads more of the file into the reader.
    fn supply(&mut self, need: usize) -> Result<(), RecordError> {
        // A length claimed by a damaged file allocates no more than the file's size.
        let need = usize::try_from(self.left).unwrap_or(usize::MAX).min(need);
        let read = self.file.read(self.reader.insert(need));
        let read = read.map_err(|error| RecordError::io(&self.path, error))?;
        self.left -= (read as u64).min(self.left);
        self.reader.notify_read(read);
        Ok(())
    }
}

fn damaged(path: &Path, error: &McapError) -> RecordError {
    RecordError::new(path, Problem::Damaged(error.to_string()))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use std::time::Duration;

    use zenav_protocol::codec::Encoding;

    use super::super::writer::{RecordOptions, RecordWriter};
    use super::*;

    fn sample(nth: u64, key: &str, bytes: &[u8]) -> Sample {
        Sample {
            key: key.to_owned(),
            encoding: "application/json".to_owned(),
            kind: Kind::Put,
            bytes: bytes.to_vec(),
            attachment: None,
            logged: 1_000_000_000 + nth * 10_000_000,
            published: Some(7 + nth),
        }
    }

    fn run() -> Vec<Sample> {
        let mut samples: Vec<Sample> = (0..50)
            .map(|nth| sample(nth, "zenav/r/edge/bump", br#"{"stamp":1, "pressed":false}"#))
            .collect();
        samples.push(Sample {
            attachment: Some(vec![0, 255, 3]),
            ..sample(50, "zenav/r/edge/bump", b"{ }")
        });
        samples.push(Sample {
            encoding: Encoding::Cbor.mime().to_owned(),
            published: None,
            ..sample(51, "zenav/r/cloud/map_patch", &[0, 1, 2, 255])
        });
        samples.push(Sample {
            kind: Kind::Delete,
            ..sample(52, "zenav/r/edge/bump", b"")
        });
        samples.push(Sample {
            encoding: "zenoh/bytes;x".to_owned(),
            ..sample(53, "somebody/else's", &[1, 2])
        });
        samples
    }

    fn read(path: &Path) -> Result<(Vec<Sample>, bool), RecordError> {
        let mut reader = RecordReader::open(path)?;
        let mut samples = Vec::new();
        while let Some(sample) = reader.next_sample()? {
            samples.push(sample);
        }
        Ok((samples, reader.is_cut_off()))
    }

    fn problem(path: &Path) -> String {
        let error = read(path).expect_err("no record");
        let told = error.to_string();
        assert!(told.contains(path.file_name().unwrap().to_str().unwrap()), "{told}");
        told
    }

    #[test]
    fn what_was_written_is_read_byte_for_byte() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut writer = RecordWriter::create(&path, RecordOptions::default(), 5).unwrap();
        let samples = run();
        samples.iter().for_each(|sample| writer.write(sample).unwrap());
        let written = writer.finish(3).unwrap();
        assert_eq!((written.messages, written.dropped), (samples.len() as u64, 3));
        assert_eq!(written.keys["zenav/r/edge/bump"], 52);
        assert_eq!(written.file_bytes, std::fs::metadata(&path).unwrap().len());
        assert_eq!(read(&path).unwrap(), (samples, false));
        // The summary, which tools read first.
        let bytes = std::fs::read(&path).unwrap();
        let summary = mcap::Summary::read(&bytes).unwrap().expect("a summary");
        assert_eq!(summary.stats.expect("statistics").message_count, 55);
        assert!(
            RecordWriter::create(&path, RecordOptions::default(), 5).is_err(),
            "nothing is overwritten"
        );
    }

    #[test]
    fn wherever_a_file_is_cut_off_it_is_read_up_to_there() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut writer = RecordWriter::create(&path, RecordOptions::default(), 5).unwrap();
        let samples = run();
        for (nth, sample) in samples.iter().enumerate() {
            writer.write(sample).unwrap();
            if nth % 10 == 9 {
                writer.flush().unwrap();
            }
        }
        writer.flush().unwrap();
        let flushed = std::fs::read(&path).unwrap();
        // A killed recorder writes no footer.
        std::mem::forget(writer);
        let part = folder.path().join("part.mcap");
        for length in (0..=flushed.len()).rev().step_by(7) {
            std::fs::write(&part, &flushed[..length]).unwrap();
            match read(&part) {
                Ok((read, cut_off)) => {
                    assert!(cut_off, "{length}");
                    assert_eq!(read, samples[..read.len()], "{length}");
                    assert!(length < flushed.len() || read.len() == samples.len());
                }
                Err(error) => assert!(matches!(error.problem, Problem::Empty), "{length}: {error}"),
            }
        }
    }

    #[test]
    fn what_is_no_record_is_refused_with_its_name_and_what_is_wrong() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("other.mcap");
        assert!(problem(&path).contains("no such file"));
        std::fs::write(&path, b"").unwrap();
        assert!(problem(&path).contains("ends before"));
        std::fs::write(&path, b"{\"this\": \"is JSON\"}").unwrap();
        assert!(problem(&path).contains("expected an MCAP file"));
        let mut foreign = mcap::WriteOptions::new()
            .profile("ros2")
            .create(File::create(&path).unwrap())
            .unwrap();
        foreign.finish().unwrap();
        assert!(problem(&path).contains("its profile is `ros2`"));
        let mut later = mcap::WriteOptions::new()
            .profile(PROFILE)
            .create(File::create(&path).unwrap())
            .unwrap();
        let metadata = [(FORMAT_ENTRY.to_owned(), "99".to_owned())].into();
        let about = mcap::records::Metadata {
            name: ABOUT.to_owned(),
            metadata,
        };
        later.write_metadata(&about).unwrap();
        later.finish().unwrap();
        assert!(problem(&path).contains("a record of format 99, this program reads 1"));
    }

    #[test]
    fn a_damaged_file_is_an_error_and_never_a_panic() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let mut writer = RecordWriter::create(&path, RecordOptions::default(), 5).unwrap();
        run().iter().for_each(|sample| writer.write(sample).unwrap());
        writer.finish(0).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let bad = folder.path().join("bad.mcap");
        for place in (0..whole.len()).step_by(3) {
            let mut bytes = whole.clone();
            bytes[place] ^= 0x55;
            std::fs::write(&bad, &bytes).unwrap();
            // Fewer samples may come out, but never a changed payload: chunks have checksums.
            if let Err(error) = read(&bad) {
                assert!(!error.to_string().is_empty());
            }
        }
    }

    #[test]
    fn a_full_file_is_followed_by_the_next() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("run.mcap");
        let options = RecordOptions {
            max_time: Some(Duration::from_millis(100)),
            ..RecordOptions::default()
        };
        let mut writer = RecordWriter::create(&path, options, 1_000_000_000).unwrap();
        let samples: Vec<Sample> = run().into_iter().take(50).collect();
        samples.iter().for_each(|sample| writer.write(sample).unwrap());
        let written = writer.finish(0).unwrap();
        assert_eq!(written.files.len(), 5, "{written:?}");
        assert_eq!(written.files[1], folder.path().join("run_0002.mcap"));
        let all: Vec<Sample> = written.files.iter().flat_map(|file| read(file).unwrap().0).collect();
        assert_eq!(all, samples);
    }
}

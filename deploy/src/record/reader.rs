//! Reader. Reads the samples of a record one after another, in order of arrival, also from a file that was cut off or is damaged.

use std::collections::{BTreeMap, HashMap, VecDeque};
use std::fs::File;
use std::io::{BufReader, Read as _, Seek as _};
use std::path::{Path, PathBuf};

use mcap::records::{MessageHeader, Record, op};
use mcap::sans_io::linear_reader::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::sans_io::summary_reader::{SummaryReadEvent, SummaryReader, SummaryReaderOptions};
use mcap::{McapError, McapResult, parse_record};
use zenav_protocol::SCHEMA_VERSION;

use super::format::{
    ABOUT, ATTACHMENT, ENCODING, FORMAT_ENTRY, KIND, Kind, PROFILE, Problem, RecordError, SCHEMA_ENTRY, Sample, VERSION,
};
use crate::output::counted;

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
    /// Records of the last chunk not yet read.
    unpacked: VecDeque<Record<'static>>,
    about: BTreeMap<String, String>,
    channels: HashMap<u16, Carried>,
    attached: Vec<Attached>,
    /// The first sample, read while the file was opened.
    first: Option<Sample>,
    cut_off: bool,
    /// Damaged chunks so far, and their bytes in the file.
    damaged: (usize, u64),
    ended: bool,
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
    fn of(topic: &str, metadata: &BTreeMap<String, String>) -> Self {
        let entry = |name| metadata.get(name).map_or("", String::as_str);
        let key = topic.to_owned();
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
            .with_emit_chunks(true);
        let mut reader = Self {
            path: path.to_owned(),
            file: BufReader::new(file),
            left: facts.len(),
            reader: LinearReader::new_with_options(options),
            unpacked: VecDeque::new(),
            about: BTreeMap::new(),
            channels: HashMap::new(),
            attached: Vec::new(),
            first: None,
            cut_off: false,
            damaged: (0, 0),
            ended: false,
        };
        reader.first = reader.read()?;
        match (reader.first.is_some(), reader.damaged.0) {
            (true, _) => Ok(reader),
            (false, 0) => Err(reader.error(Problem::Empty)),
            (false, chunks) => {
                let chunks = counted(chunks, "chunk");
                Err(reader.error(Problem::Damaged(format!("of its {chunks}, none is intact"))))
            }
        }
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
        self.check(SCHEMA_ENTRY, "its messages are of version", &SCHEMA_VERSION.to_string())
    }

    /// Whether the file was cut off, as after its recorder was killed. Known only after reading all of it.
    #[must_use]
    pub const fn is_cut_off(&self) -> bool {
        self.cut_off
    }

    /// Number of damaged chunks, which are left out. Known only after reading all of the file.
    #[must_use]
    pub const fn damaged_chunks(&self) -> usize {
        self.damaged.0
    }

    /// Logs what of the file could not be read; for the end of a command's first reading to the end.
    pub fn warn_of_losses(&self) {
        let path = self.path.display();
        if self.cut_off {
            tracing::warn!("{path}: cut off, as by a killed recorder");
        }
        if let (chunks @ 1.., bytes) = self.damaged {
            let chunks = counted(chunks, "damaged chunk");
            tracing::warn!("{path}: left out {chunks} ({bytes} bytes); the rest was read");
        }
    }

    /// The next sample; `None` at the end.
    ///
    /// # Errors
    /// The file is damaged outside its chunks, not merely cut off.
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
                    self.check(FORMAT_ENTRY, "a record of format", VERSION)?;
                }
                Record::Channel(channel) => {
                    let carried = Carried::of(&channel.topic, &channel.metadata);
                    self.channels.insert(channel.id, carried);
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
            if let Some(record) = self.unpacked.pop_front() {
                return Ok(Some(record));
            }
            let need = match self.reader.next_event() {
                None => return Ok(None),
                Some(Ok(LinearReadEvent::ReadRequest(need))) => need,
                Some(Ok(LinearReadEvent::Record { opcode, data })) => match opcode {
                    op::CHUNK => {
                        let bytes = data.len() as u64;
                        match unpacked(data) {
                            Ok(records) => self.unpacked = records,
                            Err(_) => self.lose_chunk(bytes),
                        }
                        continue;
                    }
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

    /// Counts a damaged chunk. The channels that it began are repeated in the file's summary.
    fn lose_chunk(&mut self, bytes: u64) {
        if self.damaged.0 == 0 {
            for (id, carried) in repeated_channels(&self.path).unwrap_or_default() {
                self.channels.entry(id).or_insert(carried);
            }
        }
        self.damaged = (self.damaged.0 + 1, self.damaged.1 + bytes);
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

    /// Refuses a record one of whose versions is another one.
    fn check(&self, entry: &str, what: &'static str, expected: &str) -> Result<(), RecordError> {
        let found = self.about.get(entry).map_or("", String::as_str);
        if found == expected {
            return Ok(());
        }
        Err(self.error(Problem::Version {
            what,
            found: found.to_owned(),
            expected: expected.to_owned(),
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

/// The records of a chunk with content: all, or an error if it is damaged, so that no changed payload is read.
fn unpacked(chunk: &[u8]) -> McapResult<VecDeque<Record<'static>>> {
    let options = LinearReaderOptions::default()
        .with_skip_start_magic(true)
        .with_skip_end_magic(true)
        .with_record_length_limit(MOST)
        .with_prevalidate_chunk_crcs(true);
    let mut reader = LinearReader::new_with_options(options);
    let length = (chunk.len() as u64).to_le_bytes();
    let framed = [&[op::CHUNK], length.as_slice(), chunk].concat();
    let mut bytes = framed.as_slice();
    let mut records = VecDeque::new();
    while let Some(event) = reader.next_event() {
        match event? {
            LinearReadEvent::ReadRequest(need) => {
                let (now, rest) = bytes.split_at(need.min(bytes.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                bytes = rest;
            }
            LinearReadEvent::Record { opcode, data } => {
                if matches!(opcode, op::CHANNEL | op::MESSAGE) {
                    records.push_back(parse_record(opcode, data)?.into_owned());
                }
            }
        }
    }
    Ok(records)
}

/// The channels in a file's summary.
fn repeated_channels(path: &Path) -> McapResult<Vec<(u16, Carried)>> {
    let mut file = File::open(path)?;
    let options = SummaryReaderOptions::default()
        .with_file_size(file.metadata()?.len())
        .with_record_length_limit(MOST);
    let mut reader = SummaryReader::new_with_options(options);
    while let Some(event) = reader.next_event() {
        match event? {
            SummaryReadEvent::SeekRequest(to) => reader.notify_seeked(file.seek(to)?),
            SummaryReadEvent::ReadRequest(need) => {
                let read = file.read(reader.insert(need))?;
                reader.notify_read(read);
            }
        }
    }
    let channels = reader.finish().map(|summary| summary.channels).unwrap_or_default();
    let carried = |channel: &mcap::Channel<'_>| (channel.id, Carried::of(&channel.topic, &channel.metadata));
    Ok(channels.values().map(|channel| carried(channel)).collect())
}

fn damaged(path: &Path, error: &McapError) -> RecordError {
    RecordError::new(path, Problem::Damaged(error.to_string()))
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use zenav_protocol::codec::Encoding;

    use super::super::made_up;
    use super::super::writer::{RecordOptions, RecordWriter};
    use super::*;

    fn sample(nth: u64, key: &str, bytes: &[u8]) -> Sample {
        let logged = 1_000_000_000 + nth * 10_000_000;
        Sample {
            published: Some(7 + nth),
            ..Sample::new(key.to_owned(), Kind::Put, Encoding::Json, bytes.to_vec(), logged)
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

    fn all(reader: &mut RecordReader) -> Result<Vec<Sample>, RecordError> {
        std::iter::from_fn(|| reader.next_sample().transpose()).collect()
    }

    fn read(path: &Path) -> Result<(Vec<Sample>, bool), RecordError> {
        let mut reader = RecordReader::open(path)?;
        Ok((all(&mut reader)?, reader.is_cut_off()))
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
        for channel in summary.channels.values() {
            let is_deletion = channel.metadata[KIND] == Kind::Delete.name();
            assert!(
                !is_deletion || channel.schema.is_none() && channel.message_encoding != "json",
                "an empty payload is no JSON: {channel:?}"
            );
        }
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
        let begin = |profile: &str| {
            let options = mcap::WriteOptions::new().profile(profile);
            options.create(File::create(&path).unwrap()).unwrap()
        };
        begin("ros2").finish().unwrap();
        assert!(problem(&path).contains("its profile is `ros2`"));
        let mut later = begin(PROFILE);
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
        made_up::record(&path, run());
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

    /// Where the chunks of a file are.
    fn chunks(file: &[u8]) -> Vec<std::ops::Range<usize>> {
        let (mut at, mut found) = (mcap::MAGIC.len(), Vec::new());
        while let Some((head, _)) = file.get(at..).and_then(|rest| rest.split_first_chunk::<9>()) {
            let length = u64::from_le_bytes(head[1..].try_into().unwrap()) as usize;
            if head[0] == op::CHUNK {
                found.push(at + 9..at + 9 + length);
            }
            at += 9 + length;
        }
        found
    }

    #[test]
    fn a_damaged_chunk_is_left_out_and_the_rest_is_read() {
        let folder = tempfile::tempdir().unwrap();
        let (path, bad) = (folder.path().join("run.mcap"), folder.path().join("bad.mcap"));
        let mut writer = RecordWriter::create(&path, RecordOptions::default(), 5).unwrap();
        let samples = run();
        for samples in samples.chunks(10) {
            samples.iter().for_each(|sample| writer.write(sample).unwrap());
            writer.flush().unwrap();
        }
        writer.finish(0).unwrap();
        let whole = std::fs::read(&path).unwrap();
        let chunks = chunks(&whole);
        assert_eq!(chunks.len(), 6);
        // A chunk's checksum is at 24, its compressed records begin at 43.
        let spoilt = |chunks: &[std::ops::Range<usize>], at: usize| {
            let mut bytes = whole.clone();
            for chunk in chunks {
                bytes[chunk.start + at] ^= 0x55;
            }
            std::fs::write(&bad, bytes).unwrap();
        };
        for (nth, at) in (0..chunks.len()).flat_map(|nth| [(nth, 24), (nth, 43)]) {
            spoilt(&chunks[nth..=nth], at);
            let mut reader = RecordReader::open(&bad).unwrap();
            let read = all(&mut reader).unwrap();
            let lost = 10 * nth..samples.len().min(10 * nth + 10);
            assert_eq!(
                read,
                [&samples[..lost.start], &samples[lost.end..]].concat(),
                "chunk {nth}"
            );
            assert_eq!((reader.damaged_chunks(), reader.is_cut_off()), (1, false));
        }
        spoilt(&chunks, 24);
        assert!(problem(&bad).contains("damaged: of its 6 chunks, none is intact"));
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

//! Records. Bytes as a record of a run, and as the samples of one: read as `zenav replay` reads them, and reported on.

#![allow(clippy::expect_used, reason = "no test without its folder")]

use std::path::Path;

use tempfile::TempDir;
use zenav::record::{Kind, RecordOptions, RecordReader, RecordWriter, Sample, write_report};
use zenav_protocol::codec::Encoding;
use zenav_protocol::topics::TABLE;

use super::wire::golden;

/// First bytes of an MCAP file.
const MCAP: &[u8] = b"\x89MCAP0\r\n";
/// Time between two samples, ns.
const PERIOD: u64 = 50_000_000;
/// Most samples of a record.
const MOST: usize = 1000;

/// A run with a message of every topic, as samples and as the record of them.
///
/// # Panics
/// Without a temporary folder.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let topics = TABLE.iter().filter(|row| row.qos.is_some());
    let lines = topics.flat_map(|row| {
        let key = row
            .pattern
            .replace("{robot}", "r")
            .replace("{id}", "g1")
            .replace("{lidar}", "rear");
        let named = golden().filter(|(name, _)| *name == row.message);
        named.map(move |(_, json)| format!("{key} {json}\n"))
    });
    let samples = lines.collect::<String>().into_bytes();
    let folder = folder();
    let file = folder.path().join("seed.mcap");
    write(&file, &samples);
    let record = std::fs::read(&file).expect("a record");
    vec![samples, record]
}

/// Reads the bytes as a record, or if they are none as lines of samples, a key and a payload each, of which a record is made.
///
/// # Panics
/// Without a temporary folder.
pub fn exercise(bytes: &[u8]) -> usize {
    let folder = folder();
    let file = folder.path().join("fuzz.mcap");
    if bytes.starts_with(MCAP) {
        std::fs::write(&file, bytes).expect("a temporary file");
    } else {
        write(&file, bytes);
    }
    let is_read = RecordReader::open(&file).is_ok_and(|mut reader| {
        let samples = std::iter::from_fn(|| reader.next_sample().ok().flatten());
        samples.count() > 0
    });
    let is_reported = write_report(&file, &folder.path().join("fuzz.html")).is_ok();
    usize::from(is_read) + usize::from(is_reported)
}

fn folder() -> TempDir {
    tempfile::tempdir().expect("a temporary folder")
}

/// Writes lines of samples as a record.
fn write(file: &Path, bytes: &[u8]) {
    let mut writer = RecordWriter::create(file, RecordOptions::default(), PERIOD).expect("a record");
    let lines = bytes.split(|byte| *byte == b'\n').take(MOST);
    for (line, logged) in lines.zip((PERIOD..).step_by(PERIOD as usize)) {
        let Some(at) = line.iter().position(|byte| *byte == b' ') else {
            continue;
        };
        let _ = writer.write(&Sample {
            key: String::from_utf8_lossy(&line[..at]).into_owned(),
            encoding: Encoding::Json.mime().to_owned(),
            kind: Kind::Put,
            bytes: line[at + 1..].to_vec(),
            attachment: None,
            logged,
            published: None,
        });
    }
    let _ = writer.finish(0);
}

//! Logs and graphs. The same bytes as a CARMEN log, a pose graph (g2o), relations, and a SLAM session.

#![allow(
    clippy::expect_used,
    reason = "a graph or a session that was read and cannot be written is a finding"
)]

use std::f32::consts::TAU;

use zenav_fixtures::scan;
use zenav_mapping::carmen::CarmenReader;
use zenav_pose_graph::g2o;
use zenav_protocol::geometry::Pose2;
use zenav_slam::{Slam, SlamSettings, read_relations};

/// First bytes of a session, and the places of its content's length and checksum.
const SESSION: &[u8] = b"zenavSLM";
const LENGTH: std::ops::Range<usize> = 12..20;
const CHECKSUM: std::ops::Range<usize> = 20..24;

/// A small log of every kind.
///
/// # Panics
/// When a session cannot be saved.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    let carmen = "# a log\n\
        FLASER 5 1.0 1.5 2.0 1.5 81.9 0.1 0.2 0.3 0.0 0.0 0.0 10.5 host 10.5\n\
        ODOM 0.1 0.0 0.0 0.2 0.0 0.0 10.6 host 10.6\n\
        ROBOTLASER1 0 -1.570796 3.141593 1.570796 81.9 0.01 0 3 1.0 2.0 3.0 0 0.5 0.1 0.0 0.4 0.1 0.0 0 0 0 0 0 11.0 host 11.0\n";
    let graph = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0.1\nFIX 0\n\
        EDGE_SE2 0 1 1 0 0.1 100 0 0 100 0 400\nEDGE_SE2 1 2 1 0 1.57 100 0 0 100 0 400\n";
    let relations = "# t1 t2 x y z roll pitch yaw\n10.5 11.0 0.1 0.0 0 0 0 0.05\n";
    let texts = [carmen, graph, relations].map(|text| text.as_bytes().to_vec());
    texts.into_iter().chain([session()]).collect()
}

/// A session of a short drive through a square room.
fn session() -> Vec<u8> {
    let mut slam = Slam::new(SlamSettings::default());
    for nth in 0..12_u8 {
        let pose = Pose2::new(0.1 * f64::from(nth), 0.0, 0.0);
        let ranges = (0..180_u8).map(|beam| {
            let (sin, cos) = (TAU * f32::from(beam) / 180.0 - TAU / 2.0).sin_cos();
            let ahead = (3.0 * cos.signum() - pose.x as f32) / cos;
            let aside = 3.0 * sin.signum() / sin;
            ahead.min(aside)
        });
        let stamp = 1_000_000_000 + 100_000_000 * u64::from(nth);
        let _ = slam.step(&scan(stamp, pose, ranges.collect()));
    }
    slam.save().expect("a session")
}

/// Reads the bytes as every kind of file, and writes what was read.
///
/// # Panics
/// When a graph or a session that was read cannot be written and read again.
pub fn exercise(bytes: &[u8]) -> usize {
    let scans = CarmenReader::new(bytes).map_while(Result::ok).count();
    let text = std::str::from_utf8(bytes).unwrap_or_default();
    let relations = read_relations(text).is_ok_and(|relations| !relations.is_empty());
    [scans > 0, is_graph(text), relations, is_session(bytes)]
        .into_iter()
        .filter(|taken| *taken)
        .count()
}

fn is_graph(text: &str) -> bool {
    let Ok(document) = g2o::read(text) else { return false };
    let again = g2o::read(&g2o::write(&document.graph, &document.ids)).expect("a graph that was written");
    assert_eq!(again.ids, document.ids);
    !again.ids.is_empty()
}

/// Whether the bytes are a session, once their length and checksum fit: otherwise hardly any change would get past these.
fn is_session(bytes: &[u8]) -> bool {
    let mut bytes = bytes.to_vec();
    if bytes.starts_with(SESSION) && bytes.len() >= CHECKSUM.end {
        let length = (bytes.len() - CHECKSUM.end) as u64;
        bytes[LENGTH].copy_from_slice(&length.to_le_bytes());
        let sum = crc32(bytes[SESSION.len()..LENGTH.end].iter().chain(&bytes[CHECKSUM.end..]));
        bytes[CHECKSUM].copy_from_slice(&sum.to_le_bytes());
    }
    let Ok(slam) = Slam::load(&bytes) else { return false };
    if let Ok(saved) = slam.save() {
        Slam::load(&saved).expect("a session that was saved");
    }
    true
}

/// CRC-32 (IEEE 802.3).
fn crc32<'a>(bytes: impl Iterator<Item = &'a u8>) -> u32 {
    let sum = bytes.fold(u32::MAX, |sum, byte| {
        (0..8).fold(sum ^ u32::from(*byte), |sum, _| (sum >> 1) ^ (0xedb8_8320 * (sum & 1)))
    });
    !sum
}

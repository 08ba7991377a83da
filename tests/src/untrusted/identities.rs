//! Identities. Bytes as the certificate of a folder that `zenav keys` makes, and as its list of members.

#![allow(clippy::expect_used, reason = "no test without its folder")]

use zenav_protocol::bus::{Identity, MEMBERS};

use super::maps::BETWEEN;

/// A certificate of `robot.tiago`, valid for a hundred years, whose key was thrown away.
const CERTIFICATE: &[u8] = include_bytes!("robot.pem");
/// A list of members of every role.
const FLEET: &[u8] = b"# the fleet\nrouter.hub\nrobot.tiago\nservice.site1 # here\n\noperator.anna\nviewer.wall\n";

/// A certificate with a list of members, and one without.
#[must_use]
pub fn seeds() -> Vec<Vec<u8>> {
    vec![[CERTIFICATE, BETWEEN, FLEET].concat(), CERTIFICATE.to_vec()]
}

/// Reads the bytes as the certificate of a member, and behind a line of `%%` as the list of members beside it.
///
/// # Panics
/// Without a temporary folder.
pub fn exercise(bytes: &[u8]) -> usize {
    let folder = tempfile::tempdir().expect("a temporary folder");
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder.path().join(name), bytes).expect("a temporary file");
    let at = bytes.windows(BETWEEN.len()).position(|window| window == BETWEEN);
    write("ca.pem", b"");
    write("key.pem", b"");
    write("cert.pem", &bytes[..at.unwrap_or(bytes.len())]);
    if let Some(at) = at {
        write(MEMBERS, &bytes[at + BETWEEN.len()..]);
    }
    usize::from(Identity::load(folder.path()).is_ok())
}

//! Session file. Encodes a session, and checks that bytes are a complete session of a known version.
//!
//! ```text
//! bytes 0..8     zenavSLM
//! bytes 8..12    version, little endian
//! bytes 12..20   length of the content, bytes, little endian
//! bytes 20..24   CRC-32 of version, length and content
//! then           content: CBOR (RFC 8949)
//! ```

use thiserror::Error;

use super::content::Content;

/// First bytes of every session.
const MAGIC: [u8; 8] = *b"zenavSLM";
/// The version that is written, and the only one that is read.
const VERSION: u32 = 3;
const HEAD: usize = 24;
/// Largest session, bytes: some hundred hours of driving.
pub const MOST_BYTES: usize = 1 << 30;
/// Largest nesting depth of structures.
const MAX_DEPTH: usize = 16;

/// Why bytes are not a session, or a map cannot be saved as one.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum SessionError {
    /// Another kind of file: pass the one that `save` made.
    #[error("expected a SLAM session, which begins with `zenavSLM`")]
    Foreign,
    /// Written by another version of zenav: read it with that version.
    #[error("expected a session of version {VERSION}, found version {0}")]
    Version(u32),
    /// The end is missing, or there are extra bytes: copy the file again.
    #[error("expected {expected} bytes, found {found}: the file was cut, or something was added")]
    Length {
        /// Length by its head, bytes.
        expected: u64,
        /// Length found, bytes.
        found: u64,
    },
    /// The file was damaged: copy it again.
    #[error("the content does not fit its checksum: the file was damaged")]
    Checksum,
    /// The file is intact, but its content is inconsistent.
    #[error("expected {0}")]
    Content(String),
    /// More than [`MOST_BYTES`].
    #[error("expected at most {MOST_BYTES} bytes, found {0}")]
    TooLarge(u64),
    /// The session was not found in the map it began in, so there is no single map to save.
    #[error("the session was not located in the older map: there is no one map to save")]
    Unlocated,
}

/// Encodes a session.
pub(super) fn written(content: &Content) -> Result<Vec<u8>, SessionError> {
    let mut bytes = vec![0; HEAD];
    ciborium::into_writer(content, &mut bytes).map_err(|error| SessionError::Content(error.to_string()))?;
    if bytes.len() > MOST_BYTES {
        return Err(SessionError::TooLarge(bytes.len() as u64));
    }
    let length = (bytes.len() - HEAD) as u64;
    bytes[..8].copy_from_slice(&MAGIC);
    bytes[8..12].copy_from_slice(&VERSION.to_le_bytes());
    bytes[12..20].copy_from_slice(&length.to_le_bytes());
    let sum = checksum(&bytes[8..20], &bytes[HEAD..]);
    bytes[20..HEAD].copy_from_slice(&sum.to_le_bytes());
    Ok(bytes)
}

/// Decodes the bytes of a session.
pub(super) fn read(bytes: &[u8]) -> Result<Content, SessionError> {
    let found = bytes.len() as u64;
    if bytes.len() > MOST_BYTES {
        return Err(SessionError::TooLarge(found));
    }
    if !bytes.starts_with(&MAGIC) {
        return Err(SessionError::Foreign);
    }
    let Some((head, body)) = bytes.split_at_checked(HEAD) else {
        return Err(SessionError::Length {
            expected: HEAD as u64,
            found,
        });
    };
    let version = number(&head[8..12]) as u32;
    if version != VERSION {
        return Err(SessionError::Version(version));
    }
    let expected = number(&head[12..20]).saturating_add(HEAD as u64);
    if expected != found {
        return Err(SessionError::Length { expected, found });
    }
    if number(&head[20..]) != u64::from(checksum(&head[8..20], body)) {
        return Err(SessionError::Checksum);
    }
    let mut rest = body;
    let content = ciborium::de::from_reader_with_recursion_limit(&mut rest, MAX_DEPTH)
        .map_err(|error| SessionError::Content(format!("the content of a session: {error}")))?;
    if rest.is_empty() {
        Ok(content)
    } else {
        Err(SessionError::Content("nothing after the content".to_owned()))
    }
}

/// A number, little endian.
fn number(bytes: &[u8]) -> u64 {
    bytes
        .iter()
        .rev()
        .fold(0, |number, byte| number << 8 | u64::from(*byte))
}

fn checksum(head: &[u8], body: &[u8]) -> u32 {
    let mut sum = crc32fast::Hasher::new();
    sum.update(head);
    sum.update(body);
    sum.finalize()
}

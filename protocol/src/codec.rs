//! Codec. How are messages encoded to bytes and decoded?
//!
//! JSON where people may read the message, CBOR (RFC 8949) for bulk data. A receiver decodes by the sample's encoding, and treats
//! everything but CBOR as JSON, so that a goal typed into any Zenoh client works. External input is bounded before it is decoded: its size
//! by the key's limit, its depth by [`MAX_DEPTH`] (CBOR) or serde_json's own 128 (JSON). Neither decoder allocates memory according to a
//! length that the input merely claims.
//!
//! ```
//! use zenav_protocol::codec::{Encoding, decode, encode};
//! use zenav_protocol::geometry::Pose2;
//!
//! let pose = Pose2::new(1.0, 2.0, 0.5);
//! let bytes = encode(&pose, Encoding::Json).unwrap();
//! assert_eq!(bytes, br#"{"x":1.0,"y":2.0,"yaw":0.5}"#);
//! assert_eq!(decode::<Pose2>(&bytes, Encoding::Json, 1024).unwrap(), pose);
//! assert_eq!(decode::<Pose2>(&bytes, Encoding::Json, 8).unwrap_err().to_string(), "27 bytes, at most 8 here");
//! ```

use std::fmt;

use serde::Serialize;
use serde::de::DeserializeOwned;
use thiserror::Error;

/// Deepest nesting of CBOR that is decoded.
pub const MAX_DEPTH: usize = 64;

/// Longest decoder error kept, bytes: it may quote the input.
const MAX_REASON: usize = 240;

/// The two encodings on the wire.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Encoding {
    /// `application/json`, exactly, without a schema suffix.
    #[default]
    Json,
    /// `application/cbor`, for bulk data.
    Cbor,
}

impl Encoding {
    /// The encoding's name on the wire.
    #[must_use]
    pub const fn mime(self) -> &'static str {
        match self {
            Self::Json => "application/json",
            Self::Cbor => "application/cbor",
        }
    }

    /// The encoding by its name: CBOR for `application/cbor` (a schema suffix after `;` is ignored), JSON for everything else.
    ///
    /// ```
    /// use zenav_protocol::codec::Encoding;
    ///
    /// assert_eq!(Encoding::of("application/cbor;zenav/map_patch"), Encoding::Cbor);
    /// assert_eq!(Encoding::of("zenoh/bytes"), Encoding::Json, "what a plain Zenoh client sends");
    /// ```
    #[must_use]
    pub fn of(mime: &str) -> Self {
        let name = mime.split(';').next().unwrap_or_default().trim();
        if name.eq_ignore_ascii_case("application/cbor") {
            Self::Cbor
        } else {
            Self::Json
        }
    }
}

impl fmt::Display for Encoding {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.mime())
    }
}

/// Why a message could not be decoded or encoded.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum CodecError {
    /// The payload is larger than its key allows; it was not decoded.
    #[error("{got} bytes, at most {limit} here")]
    TooLarge {
        /// The key's limit, bytes.
        limit: usize,
        /// Size of the payload, bytes.
        got: usize,
    },
    /// The payload is not a valid message in this encoding.
    #[error("{reason}")]
    Malformed {
        /// What the decoder expected; for JSON, with line and column.
        reason: String,
    },
    /// The encoding cannot represent the message, for example a JSON map whose keys are not strings.
    #[error("cannot be encoded as {encoding}: {reason}")]
    Unencodable {
        /// The requested encoding.
        encoding: Encoding,
        /// The encoder's error.
        reason: String,
    },
}

impl CodecError {
    fn malformed(reason: &dyn fmt::Display) -> Self {
        let mut reason = reason.to_string();
        if reason.len() > MAX_REASON {
            let end = (0..=MAX_REASON)
                .rev()
                .find(|&at| reason.is_char_boundary(at))
                .unwrap_or_default();
            reason.truncate(end);
            reason.push('…');
        }
        Self::Malformed { reason }
    }

    fn unencodable(encoding: Encoding, error: &dyn fmt::Display) -> Self {
        Self::Unencodable {
            encoding,
            reason: error.to_string(),
        }
    }
}

/// Encodes a message. In JSON, a number that is not finite becomes `null`.
///
/// # Errors
/// [`CodecError::Unencodable`] for a type that the encoding cannot represent: a bug in the program, not in the data.
pub fn encode<T: Serialize + ?Sized>(message: &T, encoding: Encoding) -> Result<Vec<u8>, CodecError> {
    match encoding {
        Encoding::Json => encode_json(message),
        Encoding::Cbor => encode_cbor(message),
    }
}

/// As [`encode`] in JSON. For a message that is never written in CBOR: no CBOR encoder of it is compiled.
pub(crate) fn encode_json<T: Serialize + ?Sized>(message: &T) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(256);
    serde_json::to_writer(&mut bytes, message).map_err(|error| CodecError::unencodable(Encoding::Json, &error))?;
    Ok(bytes)
}

/// As [`encode`] in CBOR. For a message that is never written in JSON: no JSON encoder of it is compiled.
pub(crate) fn encode_cbor<T: Serialize + ?Sized>(message: &T) -> Result<Vec<u8>, CodecError> {
    let mut bytes = Vec::with_capacity(256);
    ciborium::into_writer(message, &mut bytes).map_err(|error| CodecError::unencodable(Encoding::Cbor, &error))?;
    Ok(bytes)
}

/// An encoded message, if a receiver decodes that many bytes.
#[cfg(feature = "bus")]
pub(crate) fn within(bytes: Vec<u8>, max_bytes: usize) -> Result<Vec<u8>, CodecError> {
    check_size(&bytes, max_bytes)?;
    Ok(bytes)
}

fn check_size(bytes: &[u8], limit: usize) -> Result<(), CodecError> {
    let got = bytes.len();
    if got > limit {
        return Err(CodecError::TooLarge { limit, got });
    }
    Ok(())
}

/// Decodes a message of at most `max_bytes`.
///
/// ```
/// use zenav_protocol::codec::{CodecError, Encoding, decode};
/// use zenav_protocol::messages::StopReply;
///
/// let reply: StopReply = decode(br#"{"stopped": true, "news": 1}"#, Encoding::Json, 1024)?;
/// assert!(reply.stopped, "unknown fields are ignored");
/// let cut = decode::<StopReply>(br#"{"stopped": tr"#, Encoding::Json, 1024);
/// assert!(matches!(cut, Err(CodecError::Malformed { .. })));
/// # Ok::<(), CodecError>(())
/// ```
///
/// # Errors
/// [`CodecError::TooLarge`], without decoding anything; [`CodecError::Malformed`] unless the bytes are exactly one message.
pub fn decode<T: DeserializeOwned>(bytes: &[u8], encoding: Encoding, max_bytes: usize) -> Result<T, CodecError> {
    check_size(bytes, max_bytes)?;
    match encoding {
        Encoding::Json => serde_json::from_slice(bytes).map_err(|error| CodecError::malformed(&error)),
        Encoding::Cbor => {
            let mut rest = bytes;
            let message = ciborium::de::from_reader_with_recursion_limit(&mut rest, MAX_DEPTH)
                .map_err(|error| CodecError::malformed(&error))?;
            if rest.is_empty() {
                Ok(message)
            } else {
                Err(CodecError::malformed(&format_args!(
                    "{} bytes after the message",
                    rest.len()
                )))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use serde::Deserialize;

    use super::*;

    #[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
    struct Probe {
        stamp: u64,
        x: f64,
        #[serde(default)]
        ranges: Vec<Option<f64>>,
        #[serde(default)]
        name: String,
    }

    const KIB: usize = 1024;

    fn malformed<T: fmt::Debug>(result: Result<T, CodecError>) -> String {
        match result {
            Err(CodecError::Malformed { reason }) => reason,
            other => panic!("not malformed: {other:?}"),
        }
    }

    proptest! {
        #[test]
        fn a_message_survives_either_encoding_to_the_last_bit(
            stamp: u64,
            x in proptest::num::f64::NORMAL,
            ranges in prop::collection::vec(prop::option::of(proptest::num::f64::NORMAL), 0..40),
            name in ".{0,20}",
        ) {
            let probe = Probe { stamp, x, ranges, name };
            for encoding in [Encoding::Json, Encoding::Cbor] {
                let bytes = encode(&probe, encoding).unwrap();
                prop_assert_eq!(&decode::<Probe>(&bytes, encoding, 64 * KIB).unwrap(), &probe);
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..400)) {
            let _ = decode::<Probe>(&bytes, Encoding::Json, KIB);
            let _ = decode::<Probe>(&bytes, Encoding::Cbor, KIB);
            let _ = decode::<serde_json::Value>(&bytes, Encoding::Cbor, KIB);
        }
    }

    #[test]
    fn only_cbor_by_name_is_cbor() {
        assert_eq!(Encoding::of("application/cbor"), Encoding::Cbor);
        assert_eq!(Encoding::of("Application/CBOR;MapPatch"), Encoding::Cbor);
        for json in [
            "",
            "application/json",
            "text/plain",
            "zenoh/bytes",
            "zenoh/string",
            "no such thing",
            "application/cbor-seq",
        ] {
            assert_eq!(Encoding::of(json), Encoding::Json, "{json}");
        }
    }

    #[test]
    fn a_payload_over_the_limit_is_not_looked_at() {
        let bytes = vec![b'['; 10 << 20];
        assert_eq!(
            decode::<Probe>(&bytes, Encoding::Json, KIB),
            Err(CodecError::TooLarge {
                limit: KIB,
                got: 10 << 20
            })
        );
    }

    #[test]
    fn nesting_is_bounded_in_both_encodings() {
        let deep_json = vec![b'['; 100_000];
        assert!(
            malformed(decode::<serde_json::Value>(&deep_json, Encoding::Json, 1 << 20)).contains("recursion limit")
        );
        // An unknown field is skipped, not built; the limit applies there too.
        let skipped = [br#"{"stamp":1,"x":1.0,"deep":"#.as_slice(), &deep_json].concat();
        malformed(decode::<Probe>(&skipped, Encoding::Json, 1 << 20));
        // 0x81: an array of one item.
        let deep_cbor = vec![0x81; 100_000];
        malformed(decode::<serde_json::Value>(&deep_cbor, Encoding::Cbor, 1 << 20));
    }

    #[test]
    fn a_claimed_length_allocates_nothing() {
        // Arrays, byte strings, texts and maps that claim 2^62 items in nine bytes.
        for head in [0x9b, 0x5b, 0x7b, 0xbb] {
            let bytes = [&[head][..], &(1_u64 << 62).to_be_bytes()].concat();
            malformed(decode::<Vec<u64>>(&bytes, Encoding::Cbor, KIB));
            malformed(decode::<serde_json::Value>(&bytes, Encoding::Cbor, KIB));
            malformed(decode::<String>(&bytes, Encoding::Cbor, KIB));
        }
    }

    #[test]
    fn what_is_not_a_number_is_not_accepted_for_one() {
        for text in [
            r#"{"stamp":1,"x":NaN}"#,
            r#"{"stamp":1,"x":Infinity}"#,
            r#"{"stamp":1,"x":1e999}"#,
            r#"{"stamp":1,"x":null}"#,
            r#"{"stamp":-1,"x":0}"#,
        ] {
            malformed(decode::<Probe>(text.as_bytes(), Encoding::Json, KIB));
        }
    }

    #[test]
    fn exactly_one_message_is_read() {
        assert!(malformed(decode::<u8>(b"1 2", Encoding::Json, KIB)).contains("column 3"));
        assert!(malformed(decode::<u8>(&[1, 2], Encoding::Cbor, KIB)).contains("1 bytes after"));
    }

    #[test]
    fn a_reason_does_not_carry_the_input_back() {
        #[derive(Debug, Deserialize)]
        enum One {
            #[allow(dead_code, reason = "only its name matters")]
            Only,
        }
        let text = format!("\"{}\"", "é".repeat(10_000));
        assert!(malformed(decode::<One>(text.as_bytes(), Encoding::Json, 1 << 20)).len() < 300);
    }

    #[test]
    fn the_wire_is_golden() {
        let probe = Probe {
            stamp: 1,
            x: 0.1,
            ranges: vec![None, Some(2.0)],
            name: "a".into(),
        };
        assert_eq!(
            encode(&probe, Encoding::Json).unwrap(),
            br#"{"stamp":1,"x":0.1,"ranges":[null,2.0],"name":"a"}"#
        );
        assert_eq!(
            encode(&probe, Encoding::Cbor).unwrap(),
            b"\xa4\x65stamp\x01\x61x\xfb\x3f\xb9\x99\x99\x99\x99\x99\x9a\x66ranges\x82\xf6\xf9\x40\x00\x64name\x61a"
        );
    }
}

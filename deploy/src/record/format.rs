//! Format. The layout of a run in an MCAP file, and the errors of files that are not valid records.
//!
//! | in the file | holds |
//! |---|---|
//! | header | profile `zenav`, library `zenav/VERSION` |
//! | metadata `zenav` | version of this format and of the messages, start time of the recording, further entries about the run |
//! | channels with `zenav.kind` `put` or `delete` | the samples, byte for byte: topic is the key, `zenav.encoding` Zenoh's encoding |
//! | `attachment` | the attachment of the sample on that key with the same sequence number |
//! | `reply` | answers to the recorder's own requests: the robot's model, the map that existed before |
//! | `drawn` | the same run as Foxglove's messages; zenav's own readers ignore them |

use std::path::{Path, PathBuf};

use thiserror::Error;
use zenav_protocol::codec::Encoding;
use zenav_protocol::topics::{Ask, Topic};

use crate::exit_code;
use crate::failure::Failure;

/// The header's profile.
pub const PROFILE: &str = "zenav";
/// Version of this format.
pub const VERSION: &str = "1";
/// Name of the metadata about the run.
pub const ABOUT: &str = "zenav";
/// Entry of a channel's metadata: kind of its contents.
pub const KIND: &str = "zenav.kind";
/// Entry of a channel's metadata: Zenoh's encoding of the samples.
pub const ENCODING: &str = "zenav.encoding";
/// Entries of [`ABOUT`].
pub const FORMAT_ENTRY: &str = "format";
/// Version of the messages.
pub const SCHEMA_ENTRY: &str = "schema";
/// Start of the recording, ns since the UNIX epoch.
pub const STARTED_ENTRY: &str = "started";
/// A human-readable title.
pub const TITLE_ENTRY: &str = "title";

/// Kind of a channel with attachments of samples.
pub const ATTACHMENT: &str = "attachment";
/// Kind of a channel with Foxglove's messages.
pub const DRAWN: &str = "drawn";

/// Kind of a sample.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// A value was published.
    Put,
    /// A key's value was deleted.
    Delete,
    /// An answer to a request of the recorder.
    Reply,
}

impl Kind {
    /// Name in a channel's metadata.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Put => "put",
            Self::Delete => "delete",
            Self::Reply => "reply",
        }
    }

    /// The kind with this name.
    #[must_use]
    pub fn named(name: &str) -> Option<Self> {
        [Self::Put, Self::Delete, Self::Reply]
            .into_iter()
            .find(|kind| kind.name() == name)
    }
}

/// A sample of a record.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Sample {
    /// Key of the sample.
    pub key: String,
    /// Zenoh's encoding of the payload.
    pub encoding: String,
    /// Kind of the sample.
    pub kind: Kind,
    /// The payload.
    pub bytes: Vec<u8>,
    /// Attachment by its publisher.
    pub attachment: Option<Vec<u8>>,
    /// Arrival at the recorder, ns since the UNIX epoch, by a clock that never steps back.
    pub logged: u64,
    /// Timestamp by the publisher's session, ns since the UNIX epoch.
    pub published: Option<u64>,
}

impl Sample {
    /// A sample that arrived at `logged`, without an attachment and without a timestamp of its publisher.
    #[must_use]
    pub fn new(key: String, kind: Kind, encoding: Encoding, bytes: Vec<u8>, logged: u64) -> Self {
        Self {
            key,
            encoding: encoding.mime().to_owned(),
            kind,
            bytes,
            attachment: None,
            logged,
            published: None,
        }
    }

    /// The robot's name and the message, if this is a value of that topic that can be decoded.
    #[must_use]
    pub fn message<T>(&self, topic: &Topic<T>) -> Option<(String, T)> {
        if self.kind != Kind::Put {
            return None;
        }
        let robot = topic.chunks(&self.key).into_iter().next()?;
        let message = topic.decode(&self.bytes, Encoding::of(&self.encoding)).ok()?;
        Some((robot, message))
    }

    /// The robot's name and the reply, if this is an answer to that ask.
    #[must_use]
    pub fn reply<Q, R>(&self, ask: &Ask<Q, R>) -> Option<(String, R)> {
        if self.kind != Kind::Reply {
            return None;
        }
        let robot = ask.chunks(&self.key).into_iter().next()?;
        let reply = ask.decode_reply(&self.bytes, Encoding::of(&self.encoding)).ok()?;
        Some((robot, reply))
    }
}

/// An error with a record.
#[derive(Debug, Error)]
#[error("{}: {problem}", path.display())]
pub struct RecordError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: Problem,
}

/// Problem of a record.
#[derive(Debug, Error)]
pub enum Problem {
    /// There is no such file.
    #[error("no such file")]
    Missing,
    /// It exists already: nothing is overwritten.
    #[error("exists already; name another file, or delete it first")]
    Exists,
    /// It cannot be read or written.
    #[error("{0}")]
    Io(std::io::Error),
    /// It is not an MCAP file.
    #[error("expected an MCAP file, which begins with \\x89MCAP0")]
    NotMcap,
    /// It is an MCAP file of another program.
    #[error("an MCAP file, but no record of zenav (its profile is `{profile}`, expected `{PROFILE}`)")]
    Foreign {
        /// The profile in its header.
        profile: String,
    },
    /// It has another version of the format or of the messages.
    #[error("{what} {found}, this program reads {expected}")]
    Version {
        /// What the version is of.
        what: &'static str,
        /// Version in the file.
        found: String,
        /// Version of this program.
        expected: String,
    },
    /// It is damaged, not merely cut off.
    #[error("damaged: {0}")]
    Damaged(String),
    /// It ends before its first sample.
    #[error("ends before its first sample")]
    Empty,
}

impl RecordError {
    /// A problem of a file.
    #[must_use]
    pub fn new(path: &Path, problem: Problem) -> Self {
        Self {
            path: path.to_owned(),
            problem,
        }
    }

    /// An error from the file system.
    #[must_use]
    pub fn io(path: &Path, error: std::io::Error) -> Self {
        let missing = error.kind() == std::io::ErrorKind::NotFound;
        Self::new(path, if missing { Problem::Missing } else { Problem::Io(error) })
    }
}

impl From<RecordError> for Failure {
    fn from(error: RecordError) -> Self {
        let code = match error.problem {
            Problem::Missing => exit_code::NOT_FOUND,
            Problem::Io(_) => exit_code::FAILED,
            _ => exit_code::USAGE,
        };
        Self::new(code, error)
    }
}

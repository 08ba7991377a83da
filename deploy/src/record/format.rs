//! Format. How does a run lie in an MCAP file, and what is wrong with a file that is no record?
//!
//! | in the file | holds |
//! |---|---|
//! | header | profile `zenav`, library `zenav/VERSION` |
//! | metadata `zenav` | version of this format and of the messages, when the recording began, what else is known of the run |
//! | channels with `zenav.kind` `put` or `delete` | the samples, byte for byte: topic is the key, `zenav.encoding` Zenoh's encoding |
//! | `attachment` | what was attached to the sample of that key with the same sequence number |
//! | `reply` | what the recorder asked for: the robot's model, the map that was there already |
//! | `drawn` | the same run as Foxglove's own messages; no reader of zenav looks at them |

use std::path::{Path, PathBuf};

use thiserror::Error;
use zenav_protocol::codec::{self, CodecError, Encoding};
use zenav_protocol::topics::{Ask, Topic};

use crate::exit_code;
use crate::failure::Failure;

/// The header's profile.
pub const PROFILE: &str = "zenav";
/// Version of this format.
pub const VERSION: &str = "1";
/// Name of the metadata that tells of the run.
pub const ABOUT: &str = "zenav";
/// Entry of a channel's metadata: what it carries.
pub const KIND: &str = "zenav.kind";
/// Entry of a channel's metadata: Zenoh's encoding of the samples.
pub const ENCODING: &str = "zenav.encoding";
/// Entries of [`ABOUT`].
pub const FORMAT_ENTRY: &str = "format";
/// Version of the messages.
pub const SCHEMA_ENTRY: &str = "schema";
/// When the recording began, ns since the UNIX epoch.
pub const STARTED_ENTRY: &str = "started";
/// A title for people.
pub const TITLE_ENTRY: &str = "title";

/// Kind of a channel that holds what was attached to samples.
pub const ATTACHMENT: &str = "attachment";
/// Kind of a channel that holds Foxglove's own messages.
pub const DRAWN: &str = "drawn";

/// What a sample of a record is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Kind {
    /// A value was published.
    Put,
    /// A key's value was deleted.
    Delete,
    /// The recorder asked for it.
    Reply,
}

impl Kind {
    /// The name in a channel's metadata.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Put => "put",
            Self::Delete => "delete",
            Self::Reply => "reply",
        }
    }

    /// The kind by its name.
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
    /// The key that it came on.
    pub key: String,
    /// Zenoh's encoding of the payload.
    pub encoding: String,
    /// What it is.
    pub kind: Kind,
    /// The payload.
    pub bytes: Vec<u8>,
    /// What its publisher attached to it.
    pub attachment: Option<Vec<u8>>,
    /// When it reached the recorder, ns since the UNIX epoch, by a clock that never steps back.
    pub logged: u64,
    /// When its publisher's session stamped it, ns since the UNIX epoch.
    pub published: Option<u64>,
}

impl Sample {
    /// The message, if this is a value of that topic; with the chunks of its key.
    ///
    /// # Errors
    /// What is wrong with a payload of that topic.
    pub fn message<T: serde::de::DeserializeOwned>(
        &self,
        topic: &Topic<T>,
    ) -> Result<Option<(Vec<String>, T)>, CodecError> {
        if self.kind != Kind::Put {
            return Ok(None);
        }
        let chunks = topic.chunks(&self.key);
        if chunks.is_empty() && topic.pattern != self.key {
            return Ok(None);
        }
        let message = codec::decode(&self.bytes, Encoding::of(&self.encoding), topic.max_bytes)?;
        Ok(Some((chunks, message)))
    }

    /// The reply, if the recorder asked this of a robot; with the robot's name.
    #[must_use]
    pub fn reply<Q, R: serde::de::DeserializeOwned>(&self, ask: &Ask<Q, R>) -> Option<(String, R)> {
        if self.kind != Kind::Reply {
            return None;
        }
        let robot = ask.chunks(&self.key).into_iter().next()?;
        let reply = codec::decode(&self.bytes, Encoding::of(&self.encoding), usize::MAX).ok()?;
        Some((robot, reply))
    }
}

/// What cannot be done with a record.
#[derive(Debug, Error)]
#[error("{}: {problem}", path.display())]
pub struct RecordError {
    /// The file.
    pub path: PathBuf,
    /// What is wrong with it.
    pub problem: Problem,
}

/// What is wrong with a record.
#[derive(Debug, Error)]
pub enum Problem {
    /// There is no such file.
    #[error("no such file")]
    Missing,
    /// It exists, and nothing is overwritten.
    #[error("exists already; name another file, or delete it first")]
    Exists,
    /// It cannot be read or written.
    #[error("{0}")]
    Io(std::io::Error),
    /// It is no MCAP file.
    #[error("expected an MCAP file, which begins with \\x89MCAP0")]
    NotMcap,
    /// It is somebody else's MCAP file.
    #[error("an MCAP file, but no record of zenav (its profile is `{profile}`, expected `{PROFILE}`)")]
    Foreign {
        /// The profile in its header.
        profile: String,
    },
    /// It was written in another version of the format, or with other messages.
    #[error("{what} {found}, this program reads {expected}")]
    Version {
        /// Of what.
        what: &'static str,
        /// The file's.
        found: String,
        /// This program's.
        expected: String,
    },
    /// It is damaged beyond the place where it was cut off.
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

    /// An error of the file system.
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

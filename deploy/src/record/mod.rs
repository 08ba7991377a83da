//! Records. A run on the bus written to a file, then replayed, recomputed, compared, and summarised in a page.
//!
//! A record is an MCAP file. It holds every sample byte for byte, and the same run again as Foxglove's own messages, so that its tools
//! show it without conversion.
//!
//! | file | answers |
//! |---|---|
//! | `command` | what does `zenav record` do and print? |
//! | `listener` | what arrives on the bus, including what a late listener has missed? |
//! | `recorder` | how do samples get into a file without ever delaying the bus? |
//! | `live` | how is a run shown in Foxglove while it is running? |
//! | `format` | what is the layout of a record, and what makes a file invalid? |
//! | `writer`, `reader` | how are samples written and read, including files that were cut off? |
//! | `schema` | JSON Schemas of zenav's messages |
//! | `foxglove` | how is a run converted for Foxglove's tools? |
//! | `maps` | which maps were known at a given moment? |
//! | `replay` | how is a run published on a bus again? |
//! | `recompute` | do the cores give the same outputs for the same inputs? |
//! | `run` | a run in numbers: path, speed, clearance, goals, plans, stages, tree |
//! | `run_clock` | time within a run |
//! | `diff` | how do two runs differ? |
//! | `report`, `film` | a run as one page, and as an animation |
//! | `words` | events in one line each |

mod command;
mod diff;
mod film;
mod format;
mod foxglove;
mod listener;
mod live;
#[cfg(test)]
mod made_up;
mod maps;
mod reader;
mod recompute;
mod recorder;
mod replay;
mod report;
mod run;
mod run_clock;
mod schema;
mod words;
mod writer;

pub use command::{RecordArgs, record};
pub use diff::{DiffArgs, diff};
pub use film::{FilmArgs, film, write_film};
pub use format::{Kind, Problem, RecordError, Sample, TITLE_ENTRY};
pub use live::{DEFAULT_LISTEN as FOXGLOVE_LISTEN, LiveView, ViewArgs, view};
pub use reader::RecordReader;
pub use recompute::{MapVerdict, MotionVerdict, Recomputable, Recomputed, Uncompared, recompute};
pub use recorder::Recording;
pub use replay::{ReplayArgs, replay};
pub use report::{ReportArgs, report, write_report};
pub(crate) use run::{node_status, status_at_end, with_depths};
pub use writer::{RecordOptions, RecordWriter, Written};

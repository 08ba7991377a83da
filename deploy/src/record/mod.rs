//! Records. What happened in a run? Written down as it goes over the bus, played again, computed again, compared, and told in a page.
//!
//! A record is an MCAP file. It holds every sample byte for byte, and the same run once more as Foxglove's own messages, so that its tools
//! show it as it is.
//!
//! | file | answers |
//! |---|---|
//! | `command` | what does `zenav record` do and print? |
//! | `listener` | what comes on the bus, with what a late listener has missed? |
//! | `recorder` | how do samples get into a file, without ever holding up the bus? |
//! | `live` | how does Foxglove see a run while it goes on? |
//! | `format` | how does a run lie in the file, and what is wrong with a file that is no record? |
//! | `writer`, `reader` | how are samples written and read, also in a file that was cut off? |
//! | `schema` | which fields have our messages, as JSON Schema? |
//! | `foxglove` | how does the run look in Foxglove's tools? |
//! | `maps` | which maps were known at a moment? |
//! | `replay` | how does the run come onto a bus again? |
//! | `recompute` | do the cores make the same of the same inputs? |
//! | `run` | what happened, in numbers: path, speed, clearance, goals, plans, stages, tree |
//! | `run_clock` | when in the run? |
//! | `diff` | how do two runs differ? |
//! | `report`, `film` | the run as one page, and as a moving picture |
//! | `words` | events in a line |

mod command;
mod diff;
mod film;
mod format;
mod foxglove;
mod listener;
mod live;
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
pub use film::{FilmArgs, film};
pub use format::{Kind, Problem, RecordError, Sample, TITLE_ENTRY};
pub use live::{DEFAULT_LISTEN as FOXGLOVE_LISTEN, LiveView, ViewArgs, view};
pub use reader::RecordReader;
pub use recompute::{MapVerdict, MotionVerdict, Part, Recomputed, Uncompared, recompute};
pub use recorder::Recording;
pub use replay::{ReplayArgs, replay};
pub use report::{ReportArgs, report, write_report};
pub use writer::{RecordOptions, RecordWriter, Written};

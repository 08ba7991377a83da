//! How does a part of zenav tell how it is? Metrics, readiness, the HTTP endpoint of both, and logs.
//!
//! One process has one registry, whatever parts run in it: a scrape is one answer, and a stage counts without being handed anything. Nothing
//! here knows a robot or a network of robots.
//!
//! | module | subject |
//! |---|---|
//! | [`metrics`] | every metric, one row each: name, kind, labels, help, stage |
//! | [`readiness`] | what a part waits for before it can do its work |
//! | [`server`] | `/livez`, `/readyz`, `/metrics` |
//! | [`trace`] | spans of what goes from part to part |
//! | [`process`] | memory, processor time, open files, age of this process |
//! | [`logging`], [`recent`] | log lines as text or JSON; the newest ones, for whoever asks |

mod declare;
pub mod logging;
pub mod metrics;
pub mod process;
pub mod readiness;
pub mod recent;
pub mod server;
pub mod trace;

pub use declare::{Kind, Row};
pub use prometheus::{Gauge, Histogram, IntCounter, IntGauge};
pub use readiness::{Condition, Readiness};

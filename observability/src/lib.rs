//! Observability of zenav's parts: metrics, readiness, the HTTP endpoint for both, traces, and logs.
//!
//! A process has one registry for all parts in it: one scrape covers them all, and a stage counts without being passed a handle. Nothing
//! here depends on robots or on the bus.
//!
//! | module | subject |
//! |---|---|
//! | [`metrics`] | every metric, one row each: name, kind, labels, help, stage |
//! | [`readiness`] | the conditions that a part waits for |
//! | [`server`] | `/livez`, `/readyz`, `/metrics` |
//! | [`trace`] | spans across parts |
//! | [`declarations`] | whether Zenoh has dropped what another router declared |
//! | [`process`] | memory, processor time, open files, age of this process |
//! | [`logging`], [`recent`] | log lines as text or JSON; the newest ones, on request |

pub mod declarations;
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

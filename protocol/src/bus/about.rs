//! About. Who is this component, and where does it run? Every part answers, so that one question finds all of them.

use std::collections::BTreeMap;

use zenav_observability::{process, recent};

use super::{Bus, BusError};
use crate::SCHEMA_VERSION;
use crate::messages::{InfoReply, InfoRequest, LogLine, LogReply, LogRequest, ProcessInfo};
use crate::topics::{Ask, PART_INFO, PART_LOG};

fn process_info(part: &str) -> ProcessInfo {
    let facts = process::facts();
    ProcessInfo {
        part: part.to_owned(),
        host: facts.host.unwrap_or_default(),
        pid: facts.pid,
        instance: facts.instance,
        uptime_secs: facts.uptime_secs.unwrap_or_default(),
        cpu_secs: facts.cpu_secs.unwrap_or_default(),
        memory_bytes: facts.memory_bytes.unwrap_or_default(),
        unix_secs: process::unix_secs(),
    }
}

/// What this process said after a line.
fn log(part: &str, since: u64) -> LogReply {
    let facts = process::facts();
    let line = |line: recent::Line| LogLine {
        sequence: line.sequence,
        unix_secs: line.unix_secs,
        level: line.level.to_owned(),
        message: line.message,
        fields: line
            .fields
            .into_iter()
            .map(|(name, value)| (name.to_owned(), value))
            .collect(),
    };
    LogReply {
        host: facts.host.unwrap_or_default(),
        pid: facts.pid,
        instance: facts.instance,
        part: part.to_owned(),
        lines: recent::since(since).into_iter().map(line).collect(),
    }
}

impl Bus {
    /// The process that this component runs in, now.
    #[must_use]
    pub fn process_info(&self) -> ProcessInfo {
        process_info(self.name())
    }

    /// Answers with the newest lines of this process's log at `zenav/svc/log/{part}` until the bus is closed. An edge does so at its own ask.
    ///
    /// # Errors
    /// [`BusError::Key`] for a name that may not stand in a key, [`BusError::Closed`].
    pub fn serve_log(&self) -> Result<(), BusError> {
        self.serve_log_at(&PART_LOG, self.name())
    }

    /// As [`Self::serve_log`], at an ask with this chunk.
    ///
    /// # Errors
    /// As [`Self::serve_log`].
    pub fn serve_log_at(&self, ask: &Ask<LogRequest, LogReply>, chunk: &str) -> Result<(), BusError> {
        let mut server = self.serve(ask, &[chunk])?;
        let name = self.name.clone();
        tokio::spawn(async move {
            while let Some(request) = server.next().await {
                let said = log(&name, request.body.since);
                request.reply(&said);
            }
        });
        Ok(())
    }

    /// Answers for this component, with settings that others need to compute its results again, at `zenav/svc/info/{part}`, and with its log,
    /// until the bus is closed. An edge and a mission tell of themselves at their own asks.
    ///
    /// # Errors
    /// [`BusError::Key`] for a name that may not stand in a key, [`BusError::Closed`].
    pub fn serve_info(
        &self,
        component: &str,
        robot: &str,
        settings: BTreeMap<String, serde_json::Value>,
    ) -> Result<(), BusError> {
        self.serve_log()?;
        let mut server = self.serve(&PART_INFO, &[self.name()])?;
        let info = InfoReply {
            component: component.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            schema: SCHEMA_VERSION,
            robot: robot.to_owned(),
            settings,
            ..InfoReply::default()
        };
        // Not the bus itself: it would be kept open.
        let name = self.name.clone();
        tokio::spawn(async move {
            while let Some(request) = server.next().await {
                let InfoRequest {} = request.body;
                request.reply(&InfoReply {
                    process: Some(process_info(&name)),
                    ..info.clone()
                });
            }
        });
        Ok(())
    }
}

//! About. What is this component, and where does it run? Every component answers, so a single request finds all of them.

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

/// Log lines of this process after a line number.
fn log(part: &str, since: u64) -> LogReply {
    let facts = process::facts();
    let line = |line: recent::Line| LogLine {
        sequence: line.sequence,
        unix_secs: line.unix_secs,
        level: line.level,
        message: line.message,
        fields: line.fields,
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
    /// Facts about the process that this component runs in, as of now.
    #[must_use]
    pub fn process_info(&self) -> ProcessInfo {
        process_info(self.name())
    }

    /// Serves the newest lines of this process's log at `zenav/svc/log/{part}` until the bus is closed. An edge serves them at its own ask
    /// instead.
    ///
    /// # Errors
    /// [`BusError::Key`] for a name that is not valid in a key, [`BusError::Closed`].
    pub fn serve_log(&self) -> Result<(), BusError> {
        self.serve_log_at(&PART_LOG, self.name())
    }

    /// As [`Self::serve_log`], on this ask with this chunk.
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

    /// Serves the component's identity and the settings needed to reproduce its results, at `zenav/svc/info/{part}`, and its log, until the
    /// bus is closed. An edge and a mission serve this information at their own asks.
    ///
    /// # Errors
    /// [`BusError::Key`] for a name that is not valid in a key, [`BusError::Closed`].
    pub fn serve_info(
        &self,
        component: &str,
        robot: &str,
        settings: BTreeMap<String, serde_json::Value>,
    ) -> Result<(), BusError> {
        self.serve_info_of_copy(component, robot, settings, || false)
    }

    /// As [`Self::serve_info`], for a component of which several copies may run: `leads` says at each request whether this one leads.
    ///
    /// # Errors
    /// As [`Self::serve_info`].
    pub fn serve_info_of_copy(
        &self,
        component: &str,
        robot: &str,
        settings: BTreeMap<String, serde_json::Value>,
        leads: impl Fn() -> bool + Send + 'static,
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
        // Holds the name only: a clone of the bus would keep it open.
        let name = self.name.clone();
        tokio::spawn(async move {
            while let Some(request) = server.next().await {
                let InfoRequest {} = request.body;
                request.reply(&InfoReply {
                    leads: leads(),
                    process: Some(process_info(&name)),
                    ..info.clone()
                });
            }
        });
        Ok(())
    }
}

//! Health. A long-running command serves `/livez`, `/readyz` and `/metrics` at the address of `--metrics`, and writes its spans into the
//! file `--trace`.

use std::io::ErrorKind;
use std::path::PathBuf;

use clap::Args;
use zenav_observability::{server, trace};
use zenav_protocol::bus::Security;

use crate::arguments;
use crate::exit_code;
use crate::failure::Failure;

/// Address of the health endpoint, and the trace file.
#[derive(Debug, Default, Args)]
pub(crate) struct HealthArgs {
    /// Serve /livez, /readyz and /metrics at this address; port 0 takes a free one
    #[arg(long, value_name = "ADDRESS:PORT", env = "ZENAV_METRICS", hide_env_values = true, value_parser = arguments::address)]
    metrics: Option<String>,
    /// Write trace spans of messages between parts into this file: OTLP in JSON, one per line
    #[arg(long, value_name = "FILE", env = "ZENAV_TRACE", hide_env_values = true)]
    trace: Option<PathBuf>,
}

impl HealthArgs {
    /// Serves as long as the runtime runs, to other machines only if `security` allows it. Started before anything else, so that a part
    /// still waiting for a router can be queried too.
    ///
    /// # Errors
    /// An address that is invalid, taken, or reachable from other machines; a file that cannot be created.
    pub(crate) async fn serve(&self, security: &Security) -> Result<(), Failure> {
        if let Some(address) = &self.metrics {
            security.check_metrics(address)?;
        }
        if let Some(file) = &self.trace {
            trace::start(file).map_err(|error| Failure::failed(format!("--trace {}: {error}", file.display())))?;
        }
        let Some(address) = &self.metrics else {
            return Ok(());
        };
        let served = server::serve(address).await.map_err(|error| {
            let code = match error.kind() {
                ErrorKind::InvalidInput => exit_code::USAGE,
                _ => exit_code::FAILED,
            };
            Failure::new(code, format!("--metrics {address}: {error}"))
        })?;
        tracing::info!("health: http://{served}/readyz, http://{served}/metrics");
        Ok(())
    }
}

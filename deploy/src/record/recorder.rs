//! Recorder. Writes bus traffic to a file without ever delaying the bus or filling the memory.
//!
//! Zenoh's threads put samples into a queue bounded in bytes ([`Listener`]); a separate thread writes them. Samples that do not fit are
//! dropped and counted.

use std::path::Path;
use std::time::Duration;

use tokio::runtime::Handle;
use tokio::task::JoinHandle;
use zenav_protocol::bus::{Bus, Shutdown};

use super::listener::Listener;
use super::writer::{RecordOptions, RecordWriter, Written};
use crate::failure::Failure;

/// Period of flushing, so that the data written outlive this process.
const FLUSH: Duration = Duration::from_secs(1);

/// A running recording.
#[derive(Debug)]
pub struct Recording {
    shutdown: Shutdown,
    task: JoinHandle<Result<Written, Failure>>,
}

impl Recording {
    /// Records the keys that match one of the patterns.
    ///
    /// # Errors
    /// Bad patterns, or a file that cannot be created.
    pub fn start(bus: &Bus, patterns: &[String], path: &Path, options: RecordOptions) -> Result<Self, Failure> {
        let listener = Listener::new(bus, patterns)?;
        let writer = RecordWriter::create(path, options, listener.began())?;
        let shutdown = Shutdown::new();
        let (handle, ended) = (Handle::current(), shutdown.clone());
        // A slow disk may block this thread, and nothing else.
        let task = tokio::task::spawn_blocking(move || handle.block_on(record(listener, writer, &ended)));
        Ok(Self { shutdown, task })
    }

    /// Waits until it ends by itself: the disk is full, or the bus was closed. Cancel-safe.
    ///
    /// # Errors
    /// The file could not be written.
    pub async fn ended(&mut self) -> Result<Written, Failure> {
        (&mut self.task).await.map_err(Failure::failed)?
    }

    /// Ends it: everything received so far is written.
    ///
    /// # Errors
    /// The file could not be written.
    pub async fn finish(mut self) -> Result<Written, Failure> {
        self.shutdown.trigger();
        self.ended().await
    }
}

async fn record(mut listener: Listener, mut writer: RecordWriter, shutdown: &Shutdown) -> Result<Written, Failure> {
    let mut flushing = tokio::time::interval(FLUSH);
    flushing.set_missed_tick_behavior(tokio::time::MissedTickBehavior::Skip);
    let mut told = 0;
    loop {
        tokio::select! {
            sample = listener.next() => match sample {
                Some(sample) => writer.write(&sample)?,
                None => break,
            },
            _ = flushing.tick() => {
                writer.flush()?;
                listener.ask_for_maps(writer.incomplete_maps());
                let dropped = listener.dropped();
                if dropped > told {
                    tracing::warn!(dropped, "too slow for all samples: some are not recorded");
                    told = dropped;
                }
            }
            () = shutdown.wait() => break,
        }
    }
    // Samples that arrive from now on are excluded, however fast they come.
    let end = listener.now();
    while let Some(sample) = listener.try_next() {
        if sample.logged > end {
            break;
        }
        writer.write(&sample)?;
    }
    Ok(writer.finish(listener.dropped())?)
}

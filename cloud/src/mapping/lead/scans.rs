//! Scans. What does the leader do with a scan?

use std::num::NonZero;
use std::sync::LazyLock;
use std::time::Instant;

use tokio::sync::Semaphore;
use zenav_mapping::Insertion;
use zenav_observability::trace::{self, Context};
use zenav_protocol::messages::Scan;
use zenav_protocol::time::Stamp;

use super::super::MappingCore;
use super::Leadership;

/// Solves and redraws at a time, of all robots of this process: one core is left for scans.
static AHEAD: LazyLock<Semaphore> = LazyLock::new(|| {
    let cores = std::thread::available_parallelism().map_or(1, NonZero::get);
    Semaphore::new((cores - 1).max(1))
});

impl Leadership {
    /// Draws a scan, and passes on what follows from it: a correction, a frame, a graph, work for coming scans.
    pub(super) async fn insert(&mut self, scan: &Scan, trace: Option<Context>, now: Stamp) {
        // What is still being computed for this scan blocks no thread.
        while self.core.waits_for_ahead(scan.stamp) && self.ahead.join_next().await.is_some() {}
        let boot_id = self.boot_id.clone();
        let mapped = self.draw(scan, trace, now, |core| {
            let mapped = core.insert(scan, &boot_id);
            (mapped.insertion, mapped)
        });
        for work in self.core.take_ahead() {
            self.ahead.spawn(async move {
                let turn = AHEAD.acquire().await;
                let _ = tokio::task::spawn_blocking(move || {
                    work.run();
                    drop(turn);
                })
                .await;
            });
        }
        if let Some(frame) = &mapped.frame {
            self.carry_over(frame);
        }
        // A successor of this process must know every frame that was ever published.
        let _ = self.keep(now, false).await;
        let is_new_frame = mapped.frame.is_some_and(|frame| self.tell_frame(frame));
        if let Some(correction) = &mapped.correction {
            self.outbox.corrections.put(correction);
        }
        if let Some(localisation) = &mapped.localisation {
            self.outbox.localisation.put(localisation);
        }
        // The correction does not wait until the whole map is encoded.
        if is_new_frame {
            self.publish(now);
        }
        self.drawn(mapped.insertion, now);
        self.tell_graph(now);
    }

    /// Draws a scan of a further lidar.
    pub(super) fn insert_further(&mut self, scan: &Scan, trace: Option<Context>, now: Stamp) {
        let boot_id = self.boot_id.clone();
        let insertion = self.draw(scan, trace, now, |core| {
            let insertion = core.insert_further(scan, &boot_id);
            (insertion, insertion)
        });
        self.drawn(insertion, now);
    }

    /// Draws a scan, with metrics and trace.
    fn draw<R>(
        &mut self,
        scan: &Scan,
        trace: Option<Context>,
        now: Stamp,
        insert: impl FnOnce(&mut MappingCore) -> (Insertion, R),
    ) -> R {
        self.metrics.took(scan.stamp, now);
        let began = Instant::now();
        let span = trace.and_then(|trace| trace::child(&trace, &self.part(), "scan inserted"));
        let (insertion, done) = insert(&mut self.core);
        self.metrics.drew(began, insertion);
        // A process that writes no spans passes the trace on unchanged.
        self.trace = span.as_ref().map(trace::Span::context).or(trace).or(self.trace);
        if let Some(span) = span {
            span.end();
        }
        done
    }

    fn drawn(&mut self, insertion: Insertion, now: Stamp) {
        match insertion {
            Insertion::Inserted => {
                self.pending = true;
                // After a restart of the simulation its clock is before the last patch.
                if now.since(self.published) >= self.period || now < self.published {
                    self.publish(now);
                }
            }
            Insertion::Held => {}
            outcome => tracing::debug!(robot = self.config.robot, ?outcome, "scan left out"),
        }
    }
}

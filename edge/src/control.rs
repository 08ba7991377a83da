//! Control loop. When does the pilot step? On a thread of its own, at absolute deadlines or when the body has new readings; a missed tick
//! is skipped and counted, never caught up. The loop never waits for the network.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use zenav_protocol::time::Stamp;

use crate::body::Body;
use crate::handoff::Handoff;
use crate::metrics::ControlMetrics;
use crate::pilot::Pilot;

/// Most ticks to come to rest at shutdown.
const HALTING_TICKS: u32 = 150;
/// Speed below which the body counts as at rest, m/s.
const AT_REST: f64 = 0.01;
/// Period of blind ticks while no readings come: the longest wait of a request, and the period at which the robot reports the fault.
const BLIND_PERIOD: Duration = Duration::from_millis(100);

/// Stops the wheels however the thread ends, even by a panic.
struct Wheels(Box<dyn Body>);

impl Drop for Wheels {
    fn drop(&mut self) {
        if let Err(error) = self.0.drive([0.0; 2]) {
            tracing::error!(%error, "the wheels could not be stopped");
        }
    }
}

/// A timer with absolute deadlines.
struct Timer {
    period: Duration,
    deadline: Instant,
}

impl Timer {
    /// Waits for the next tick; returns how many were skipped, and how late this one is.
    fn wait(&mut self) -> (u64, Duration) {
        self.deadline += self.period;
        let now = Instant::now();
        if let Some(left) = self.deadline.checked_duration_since(now) {
            std::thread::sleep(left);
            return (0, self.deadline.elapsed());
        }
        let late = now.duration_since(self.deadline);
        let skipped = u32::try_from(late.as_nanos() / self.period.as_nanos().max(1)).unwrap_or(u32::MAX);
        self.deadline += self.period.saturating_mul(skipped);
        (u64::from(skipped), late)
    }
}

/// Lateness of ticks that the body's readings pace.
struct Pace {
    period: Duration,
    last: Option<(Stamp, Instant)>,
}

impl Pace {
    /// Readings have arrived; returns how many before them are missing, and how late they are.
    fn arrived(&mut self, stamp: Stamp, secs: f64) -> (u64, Option<Duration>) {
        let now = Instant::now();
        let Some((before, then)) = self.last.replace((stamp, now)) else {
            return (0, None);
        };
        let steps = (stamp.secs_since(before) / secs).round().max(1.0) as u32;
        let late = now
            .duration_since(then)
            .saturating_sub(self.period.saturating_mul(steps));
        (u64::from(steps - 1), Some(late))
    }
}

/// Runs the loop until `halt` is set and the robot is at rest. `tick` is the body's time between readings, s; `speed` is the rate of its time
/// against wall time.
pub(crate) fn run(
    body: Box<dyn Body>,
    mut pilot: Pilot,
    handoff: &Arc<Handoff>,
    (tick, speed): (f64, f64),
    halt: &Arc<AtomicBool>,
    metrics: &ControlMetrics,
) {
    let mut body = Wheels(body);
    let period = Duration::from_secs_f64(tick / speed);
    let mut timer = (!body.0.gives_the_pace()).then(|| Timer {
        period,
        deadline: Instant::now(),
    });
    let mut pace = Pace { period, last: None };
    let mut missed_ticks = 0;
    let mut halting = 0;
    let mut failing = false;
    let mut blind: Option<Instant> = None;
    loop {
        let mut late = None;
        let missed_before = missed_ticks;
        if let Some(timer) = &mut timer {
            let (missed, by) = timer.wait();
            missed_ticks += missed;
            late = Some(by);
        }
        let readings = match body.0.read() {
            Ok(readings) => readings,
            Err(error) => {
                if !std::mem::replace(&mut failing, true) {
                    tracing::error!(%error, "no readings: braking");
                }
                let _ = body.0.drive([0.0; 2]);
                if halt.load(Ordering::Relaxed) {
                    return;
                }
                if blind.is_none_or(|last| last.elapsed() >= BLIND_PERIOD) {
                    blind = Some(Instant::now());
                    let outbox = pilot.step_blind(handoff.take_inbox(), &error.0);
                    handoff.put_outbox(pilot.now(), outbox);
                }
                continue;
            }
        };
        failing = false;
        if timer.is_none() {
            let (missed, by) = pace.arrived(readings.stamp, tick);
            missed_ticks += missed;
            late = by;
        }
        let mut inbox = handoff.take_inbox();
        (inbox.missed_ticks, inbox.late) = (missed_ticks, late);
        inbox.halt = halt.load(Ordering::Relaxed);
        halting += u32::from(inbox.halt);
        metrics.began(late, missed_ticks - missed_before);
        let began = Instant::now();
        let outbox = pilot.timed_step(readings.stamp, &readings, inbox, &mut || began.elapsed());
        let wheels = outbox.wheels;
        if let Err(error) = body.0.drive(wheels) {
            tracing::error!(%error, "the wheels do not answer");
        }
        metrics.ended(began.elapsed(), outbox.monitor, outbox.verdict);
        handoff.put_outbox(readings.stamp, outbox);
        let velocity = pilot.velocity();
        let at_rest = wheels == [0.0; 2] && velocity.v.abs() < AT_REST && velocity.w.abs() < 5.0 * AT_REST;
        if halting > 0 && (at_rest || halting > HALTING_TICKS) {
            return;
        }
    }
}

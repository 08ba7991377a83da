//! When does the pilot step? On a thread of its own, at absolute deadlines or when the body has new readings; a missed tick is skipped and
//! counted, never caught up. It never waits for the network.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use zenav_protocol::time::Stamp;

use crate::body::Body;
use crate::handoff::Handoff;
use crate::pilot::Pilot;

/// Time to come to rest at the end, in ticks.
const HALTING_TICKS: u32 = 150;
/// Wheel speed below which the body counts as at rest, m/s and rad/s.
const AT_REST: f64 = 0.01;

/// Stops the wheels however the thread ends, by a panic too.
struct Wheels(Box<dyn Body>);

impl Drop for Wheels {
    fn drop(&mut self) {
        if let Err(error) = self.0.drive([0.0; 2]) {
            tracing::error!(%error, "the wheels could not be stopped");
        }
    }
}

/// Ticks at absolute deadlines.
struct Beat {
    period: Duration,
    deadline: Instant,
}

impl Beat {
    /// Waits for the next tick; returns how many had to be left out, and how late this one is.
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

/// The pace that a body gives: how late is each tick by it?
struct Pace {
    period: Duration,
    last: Option<(Stamp, Instant)>,
}

impl Pace {
    /// Readings have come; returns how many before them never did, and how much longer than the pace it took.
    fn heard(&mut self, stamp: Stamp, secs: f64) -> (u64, Option<Duration>) {
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

/// Runs the loop until `halt` is set and the robot is at rest. `tick` is the body's time between readings, `speed` its time against wall
/// time.
pub fn run(
    body: Box<dyn Body>,
    mut pilot: Pilot,
    exchange: &Arc<Handoff>,
    (tick, speed): (f64, f64),
    halt: &Arc<AtomicBool>,
) {
    let mut body = Wheels(body);
    let period = Duration::from_secs_f64(tick / speed);
    let mut beat = (!body.0.gives_the_pace()).then(|| Beat {
        period,
        deadline: Instant::now(),
    });
    let mut pace = Pace { period, last: None };
    let mut missed_ticks = 0;
    let mut halting = 0;
    let mut failing = false;
    loop {
        let mut late = None;
        if let Some(beat) = &mut beat {
            let (missed, by) = beat.wait();
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
                continue;
            }
        };
        failing = false;
        if beat.is_none() {
            let (missed, by) = pace.heard(readings.stamp, tick);
            missed_ticks += missed;
            late = by;
        }
        let mut inbox = exchange.take_inbox();
        (inbox.missed_ticks, inbox.late) = (missed_ticks, late);
        inbox.halt = halt.load(Ordering::Relaxed);
        halting += u32::from(inbox.halt);
        let outbox = pilot.step(readings.stamp, &readings, inbox);
        let wheels = outbox.wheels;
        if let Err(error) = body.0.drive(wheels) {
            tracing::error!(%error, "the wheels do not answer");
        }
        exchange.put_outbox(readings.stamp, outbox);
        let velocity = pilot.velocity();
        let at_rest = wheels == [0.0; 2] && velocity.v.abs() < AT_REST && velocity.w.abs() < 5.0 * AT_REST;
        if halting > 0 && (at_rest || halting > HALTING_TICKS) {
            return;
        }
    }
}

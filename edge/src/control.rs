//! Control loop. When does the pilot step? On a thread of its own, at absolute deadlines or when the body has new readings; a missed tick
//! is skipped and counted, never caught up. The loop never waits for the network. Readings whose stamp cannot be the body's true time
//! ([`BodyClock`]), or that are the last ones again for too long, are none: the robot brakes.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use zenav_protocol::time::Stamp;

use crate::body::{Body, BodyError};
use crate::body_clock::{BodyClock, NotNow};
use crate::handoff::Handoff;
use crate::metrics::ControlMetrics;
use crate::pilot::Pilot;

/// Most ticks to come to rest at shutdown.
const HALTING_TICKS: u32 = 150;
/// Speed below which the body counts as at rest, m/s.
const AT_REST: f64 = 0.01;
/// Most ticks for which the first readings may be unconfirmed before that is a fault.
const CONFIRMING_TICKS: u32 = 10;
/// Longest time for which the body may repeat its last readings, s: as long as a body on the bus may be silent.
const LONGEST_REPEAT: f64 = 0.2;
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

/// Judges readings by their stamps.
struct StampJudge {
    /// `None` if the body itself refuses stamps that cannot be its true time.
    clock: Option<BodyClock>,
    /// Longest wall time for which readings may be repeated.
    longest_repeat: Duration,
    /// When the last new readings were accepted.
    renewed: Option<Instant>,
}

impl StampJudge {
    /// Judges readings, of which the last ones used are of `last`. With a clock that was set back everything that has a deadline would last
    /// for as long again; after readings of the far future all others would be old. While readings are repeated the robot's time stands
    /// still: nothing expires, and the wheels keep their speeds.
    fn judge(&mut self, stamp: Stamp, last: Stamp) -> Result<(), NotNow> {
        let (got, shown) = (stamp.as_secs(), last.as_secs());
        if stamp == last
            && let Some(renewed) = self.renewed
        {
            let is_short = renewed.elapsed() <= self.longest_repeat;
            return if is_short { Ok(()) } else { Err(NotNow::Repeated(got)) };
        }
        match &mut self.clock {
            Some(clock) => clock.judge(stamp)?,
            None if stamp < last => return Err(NotNow::Old { got, shown }),
            None => {}
        }
        self.renewed = Some(Instant::now());
        Ok(())
    }
}

/// Longest wall time for which the body may repeat its last readings: two ticks at least, since even a single repetition comes a tick later.
fn longest_repeat(tick: f64, speed: f64) -> Duration {
    Duration::from_secs_f64(LONGEST_REPEAT.max(2.0 * tick) / speed)
}

/// Runs the loop until `halt` is set and the robot is at rest. `tick` is the body's time between readings, s; `speed` is the rate of its time
/// against wall time.
pub(crate) fn run(
    (body, clock): (Box<dyn Body>, BodyClock),
    mut pilot: Pilot,
    handoff: &Arc<Handoff>,
    (tick, speed): (f64, f64),
    halt: &Arc<AtomicBool>,
    metrics: &ControlMetrics,
) {
    let mut body = Wheels(body);
    let mut stamps = StampJudge {
        clock: (!body.0.judges_stamps()).then_some(clock),
        longest_repeat: longest_repeat(tick, speed),
        renewed: None,
    };
    let period = Duration::from_secs_f64(tick / speed);
    let mut timer = (!body.0.gives_the_pace()).then(|| Timer {
        period,
        deadline: Instant::now(),
    });
    let mut pace = Pace { period, last: None };
    let mut missed_ticks = 0;
    let mut halting = 0;
    let mut unconfirmed = 0;
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
        let read = match body.0.read() {
            Ok(readings) => match stamps.judge(readings.stamp, pilot.now()) {
                Ok(()) => Ok(readings),
                // The robot has not set out yet, and two more readings confirm the first.
                Err(NotNow::First(_)) if unconfirmed < CONFIRMING_TICKS && !halt.load(Ordering::Relaxed) => {
                    unconfirmed += 1;
                    continue;
                }
                Err(not_now) => Err(BodyError(not_now.to_string())),
            },
            Err(error) => Err(error),
        };
        let readings = match read {
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

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use std::sync::Mutex;

    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::id::Id;
    use zenav_protocol::messages::LostPolicy;
    use zenav_protocol::readings::Readings;
    use zenav_protocol::robot::RobotModel;

    use super::*;
    use crate::config::{EdgeConfig, TICK};
    use crate::control_io::{Persisted, Publication};

    /// Readings until the body's clock goes wrong, and after that.
    const READINGS: [u32; 2] = [400, 20];

    /// A perfect body in a square room, whose clock goes wrong; it ends the loop some readings later.
    struct WrongClock {
        model: RobotModel,
        /// Its time at the nth reading, s.
        secs: fn(u32) -> f64,
        read: u32,
        last: Readings,
        pose: Pose2,
        angles: [f64; 2],
        /// The commands before and after.
        commands: Arc<Mutex<[Vec<[f64; 2]>; 2]>>,
        halt: Arc<AtomicBool>,
    }

    impl Body for WrongClock {
        fn read(&mut self) -> Result<Readings, BodyError> {
            self.read += 1;
            if self.read > READINGS[0] + READINGS[1] {
                self.halt.store(true, Ordering::Relaxed);
            }
            let stamp = Stamp::from_secs((self.secs)(self.read));
            if stamp == self.last.stamp {
                return Ok(self.last.clone());
            }
            let sweep = self.read.is_multiple_of(5).then(|| {
                let lidar = self.model.first_lidar().unwrap();
                zenav_fixtures::sweep_in_room(lidar, stamp.as_secs(), self.pose, (2.5, 2.5), &[])
            });
            self.last = Readings {
                wheels: self.angles,
                sweeps: sweep.into_iter().collect(),
                ..Readings::new(stamp)
            };
            Ok(self.last.clone())
        }

        fn drive(&mut self, wheels: [f64; 2]) -> Result<(), BodyError> {
            let after = usize::from(self.read > READINGS[0]);
            self.commands.lock().unwrap()[after].push(wheels);
            self.angles = [0, 1].map(|side: usize| self.angles[side] + TICK * wheels[side]);
            self.pose = self.pose.advance(self.model.drive.twist(wheels), TICK);
            Ok(())
        }

        fn gives_the_pace(&self) -> bool {
            true
        }
    }

    /// The time of the nth reading by a clock that began at `hours`, s.
    fn time(hours: f64, nth: u32) -> f64 {
        3600.0 * hours + TICK * f64::from(nth)
    }

    /// What a robot that follows walls by itself commands before and after its clock goes wrong, and the loop's last messages. `speed`: the
    /// rate of its time against wall time.
    fn driven(secs: fn(u32) -> f64, speed: f64) -> ([Vec<[f64; 2]>; 2], Arc<Handoff>) {
        let model = zenav_fixtures::robot("tiago");
        let config = EdgeConfig {
            on_lost: LostPolicy::WallFollow,
            ..EdgeConfig::new(Id::robot("tiago").unwrap(), model.clone(), Pose2::IDENTITY)
        };
        let (commands, halt) = (Arc::default(), Arc::new(AtomicBool::new(false)));
        let body = WrongClock {
            model,
            secs,
            read: 0,
            last: Readings::new(Stamp::ZERO),
            pose: Pose2::IDENTITY,
            angles: [0.0; 2],
            commands: Arc::clone(&commands),
            halt: Arc::clone(&halt),
        };
        let clock = BodyClock::new(config.settings.body.longest_step);
        let pilot = Pilot::new(config, "boot-1".into(), Persisted::default());
        let (handoff, metrics) = (Arc::new(Handoff::default()), ControlMetrics::new("tiago"));
        run((Box::new(body), clock), pilot, &handoff, (TICK, speed), &halt, &metrics);
        let commands = std::mem::take(&mut *commands.lock().unwrap());
        assert!(commands[0].iter().any(|wheels| *wheels != [0.0; 2]), "it drove");
        (commands, handoff)
    }

    /// The body's fault in the last state that the robot published.
    async fn fault(handoff: &Handoff) -> Option<String> {
        let published = handoff.bundle().await?.publications;
        published.into_iter().find_map(|publication| match publication {
            Publication::State(state) => state.faults.body,
            _ => None,
        })
    }

    #[tokio::test]
    async fn a_robot_whose_clock_is_set_back_stands_still_and_says_why() {
        let set_back = |nth: u32| time(if nth > READINGS[0] { 1.0 } else { 2.0 }, nth);
        let ([_, after], handoff) = driven(set_back, 1.0);
        assert!(after.iter().all(|wheels| *wheels == [0.0; 2]), "{after:?}");
        let fault = fault(&handoff).await;
        assert!(
            fault.as_ref().is_some_and(|why| why.contains("began anew")),
            "{fault:?}"
        );
    }

    #[tokio::test]
    async fn a_robot_whose_body_repeats_its_last_readings_for_too_long_stands_still_and_says_why() {
        let hangs = |nth: u32| time(2.0, nth.min(READINGS[0]));
        // At this rate the time allowed is a fifth of a microsecond of wall time, less than any step of the loop takes.
        let ([_, after], handoff) = driven(hangs, 1e6);
        assert!(after.iter().all(|wheels| *wheels == [0.0; 2]), "{after:?}");
        let fault = fault(&handoff).await;
        assert!(
            fault.as_ref().is_some_and(|why| why.contains("no new ones")),
            "{fault:?}"
        );
        // And here it is 200 s: more than all of them together.
        let ([_, after], _) = driven(hangs, 1e-3);
        assert!(after.iter().take(20).any(|wheels| *wheels != [0.0; 2]), "{after:?}");
    }

    #[test]
    fn a_body_may_repeat_its_readings_for_two_ticks_however_long_they_are() {
        for (tick, speed, secs) in [(TICK, 1.0, 0.2), (0.25, 1.0, 0.5), (0.25, 10.0, 0.05)] {
            assert_eq!(longest_repeat(tick, speed), Duration::from_secs_f64(secs));
        }
    }

    #[test]
    fn one_reading_of_the_far_future_does_not_stop_the_robot() {
        let first = |nth: u32| time(if nth == 1 { 1e4 } else { 2.0 }, nth);
        let later = |nth: u32| time(if nth == READINGS[0] + 1 { 1e4 } else { 2.0 }, nth);
        for secs in [first as fn(u32) -> f64, later] {
            let ([_, after], _) = driven(secs, 1.0);
            assert!(after.iter().take(20).any(|wheels| *wheels != [0.0; 2]), "{after:?}");
        }
    }
}

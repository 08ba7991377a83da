//! Clock. What time is it, by the wall clock or in the simulation?
//!
//! A service uses only the clock that it is given. The wall clock is UNIX time at the start plus monotonic time since then: it never jumps
//! when the system time is set. A simulated clock stands still until its handle, or the topic `zenav/sim/clock`, moves it.
//!
//! On the topic, a single message far ahead has no effect: the clock jumps only when the next message continues from there, as after a
//! pause of the link. A restart of the simulation is accepted only after several consecutive messages in the new time: if two simulations
//! publish the time, the clock does not alternate between them, and the first one counts.

use std::collections::BTreeMap;
use std::pin::Pin;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::task::{Context, Poll, Waker};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use tokio::sync::watch;
use tokio::time::Instant;

use super::{Bus, BusError};
use crate::time::Stamp;
use crate::topics::SIM_CLOCK;

/// A step back by more than this means that the simulation restarted; a smaller one is a reordered message.
const RESTART: Duration = Duration::from_secs(1);
/// Consecutive messages in the new time after which a step back is accepted.
const BEGUN_ANEW: u32 = 20;
/// A longer step forwards on the topic is accepted only when the next message continues from there.
const LEAP: Duration = Duration::from_secs(10);
/// Latest plausible simulated time: 73 years.
const LATEST: Stamp = Stamp(u64::MAX / 8);

/// Clock of a service. All clones show the same time.
///
/// ```
/// use std::time::Duration;
/// use zenav_protocol::bus::Clock;
/// use zenav_protocol::time::Stamp;
///
/// let (clock, handle) = Clock::simulated(Stamp::ZERO);
/// handle.advance(Duration::from_secs(2));
/// assert_eq!(clock.now(), Stamp::from_secs(2.0));
/// ```
#[derive(Clone, Debug)]
pub struct Clock(Kind);

#[derive(Clone, Debug)]
enum Kind {
    Wall { start: Instant, start_stamp: Stamp },
    Simulated(Simulated),
}

/// A simulated time, and the tasks that wait for it.
#[derive(Clone, Debug)]
struct Simulated {
    time: watch::Receiver<Stamp>,
    sleepers: Arc<Sleepers>,
}

/// Tasks that wait until a time, each with a number of its own. Each is woken once, when it is due: the time may move two hundred times a
/// second, and a process may have a task for each of a hundred robots.
#[derive(Debug, Default)]
struct Sleepers(Mutex<Waiting>);

#[derive(Debug, Default)]
struct Waiting {
    wakers: BTreeMap<(Stamp, u64), Waker>,
    numbers: u64,
}

impl Sleepers {
    fn lock(&self) -> MutexGuard<'_, Waiting> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Wakes the tasks that wait for `now` or earlier.
    fn wake(&self, now: Stamp) {
        let due = {
            let mut waiting = self.lock();
            let later = waiting.wakers.split_off(&(now, u64::MAX));
            std::mem::replace(&mut waiting.wakers, later)
        };
        due.into_values().for_each(Waker::wake);
    }
}

/// Waits until a simulated clock shows a time.
struct Sleep<'a> {
    clock: &'a Simulated,
    until: Stamp,
    /// Its number among the sleepers, once it waits.
    number: Option<u64>,
}

impl Future for Sleep<'_> {
    type Output = ();

    fn poll(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<()> {
        let clock = self.clock;
        let mut waiting = clock.sleepers.lock();
        // Under the lock: the time moves before its sleepers are woken.
        if *clock.time.borrow() >= self.until {
            return Poll::Ready(());
        }
        let number = *self.number.get_or_insert_with(|| {
            waiting.numbers += 1;
            waiting.numbers
        });
        waiting.wakers.insert((self.until, number), context.waker().clone());
        Poll::Pending
    }
}

impl Drop for Sleep<'_> {
    fn drop(&mut self) {
        if let Some(number) = self.number {
            self.clock.sleepers.lock().wakers.remove(&(self.until, number));
        }
    }
}

/// The time shown to a service, derived from the stamps of the simulation.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Follower {
    shown: Stamp,
    /// Lead of the service's time over the time of a restarted simulation.
    ahead: Duration,
    /// Target of an unconfirmed leap.
    leap: Option<Stamp>,
    /// Consecutive messages that are back in time.
    back: u32,
}

impl Follower {
    /// The time to show after a stamp; `None` if the stamp is nothing new, or is not accepted yet.
    pub(super) fn follow(&mut self, stamp: Stamp) -> Option<Stamp> {
        if stamp > LATEST {
            return None;
        }
        let now = stamp + self.ahead;
        if now > self.shown + LEAP {
            // At most as far as the leap itself: the messages of a fast simulation may all be far apart.
            let goes_on = self.leap.is_some_and(|leap| {
                let leapt = (leap + self.ahead).since(self.shown);
                stamp > leap && stamp.since(leap) <= leapt
            });
            self.leap = (!goes_on).then_some(stamp);
            if !goes_on {
                return None;
            }
        }
        self.leap = None;
        if self.shown.since(now) > RESTART {
            self.back += 1;
            if self.back < BEGUN_ANEW {
                return None;
            }
            self.ahead = self.shown.since(stamp);
        }
        self.back = 0;
        self.shown = self.shown.max(stamp + self.ahead);
        Some(self.shown)
    }
}

/// Moves a simulated clock.
#[derive(Clone, Debug)]
pub struct ClockHandle {
    time: Arc<watch::Sender<Stamp>>,
    sleepers: Arc<Sleepers>,
}

impl ClockHandle {
    /// Sets the time, and wakes the waiting tasks. A small step back is ignored; a large one means that the simulation restarted.
    pub fn set(&self, now: Stamp) {
        let moved = self.time.send_if_modified(|current| {
            let moved = now > *current || current.since(now) > RESTART;
            if moved {
                *current = now;
            }
            moved
        });
        if moved {
            self.sleepers.wake(now);
        }
    }

    /// Moves the time forwards.
    pub fn advance(&self, by: Duration) {
        self.time.send_modify(|current| *current = *current + by);
        self.sleepers.wake(*self.time.borrow());
    }
}

impl Clock {
    /// The wall clock, UNIX time.
    #[must_use]
    pub fn wall() -> Self {
        let since_epoch = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
        Self(Kind::Wall {
            start: Instant::now(),
            start_stamp: Stamp::ZERO + since_epoch,
        })
    }

    /// A simulated clock and its handle.
    #[must_use]
    pub fn simulated(start: Stamp) -> (Self, ClockHandle) {
        let (sender, time) = watch::channel(start);
        let sleepers = Arc::default();
        let handle = ClockHandle {
            time: Arc::new(sender),
            sleepers: Arc::clone(&sleepers),
        };
        (Self(Kind::Simulated(Simulated { time, sleepers })), handle)
    }

    /// Follows the simulated clock on the bus; shows zero until the first message. Must be called in a Tokio runtime.
    ///
    /// When the simulation restarts, this clock continues from its last time, so that no deadline of a service refers to a time that has
    /// already passed.
    ///
    /// # Errors
    /// [`BusError::Closed`] after the bus was closed.
    pub fn follow(bus: &Bus) -> Result<Self, BusError> {
        let mut topic = bus.latest(&SIM_CLOCK, &[])?;
        let (clock, handle) = Self::simulated(Stamp::ZERO);
        let mut follower = Follower::default();
        tokio::spawn(async move {
            loop {
                tokio::select! {
                    // The last clone of the clock was dropped.
                    () = handle.time.closed() => return,
                    open = topic.changed() => if !open { return },
                }
                if let Some(now) = topic.take().and_then(|message| follower.follow(message.stamp)) {
                    handle.set(now);
                }
            }
        });
        Ok(clock)
    }

    /// Whether the clock is a simulation's.
    #[must_use]
    pub const fn is_simulated(&self) -> bool {
        matches!(self.0, Kind::Simulated(_))
    }

    /// The time that the clock shows now.
    #[must_use]
    pub fn now(&self) -> Stamp {
        match &self.0 {
            Kind::Wall { start, start_stamp } => *start_stamp + start.elapsed(),
            Kind::Simulated(clock) => *clock.time.borrow(),
        }
    }

    /// Waits until the clock shows `stamp`; forever if the simulation ends before.
    pub async fn sleep_until(&self, stamp: Stamp) {
        match &self.0 {
            Kind::Wall { start, start_stamp } => match start.checked_add(stamp.since(*start_stamp)) {
                Some(instant) => tokio::time::sleep_until(instant).await,
                None => std::future::pending().await,
            },
            Kind::Simulated(clock) => {
                let sleep = Sleep {
                    clock,
                    until: stamp,
                    number: None,
                };
                sleep.await;
            }
        }
    }

    /// Waits for a duration on this clock.
    pub async fn sleep(&self, duration: Duration) {
        self.sleep_until(self.now() + duration).await;
    }

    /// Waits for a future, for at most `duration` on this clock; then `None`.
    pub async fn timeout<F: Future>(&self, duration: Duration, future: F) -> Option<F::Output> {
        tokio::select! {
            biased;
            output = future => Some(output),
            () = self.sleep(duration) => None,
        }
    }

    /// An interval that ticks every `period`; the first tick is immediate.
    #[must_use]
    pub fn interval(&self, period: Duration) -> Interval {
        Interval {
            next: self.now(),
            clock: self.clone(),
            period: period.max(Duration::from_nanos(1)),
        }
    }
}

/// Absolute deadlines, one period apart. A missed deadline is skipped, never made up for.
#[derive(Clone, Debug)]
pub struct Interval {
    clock: Clock,
    next: Stamp,
    period: Duration,
}

impl Interval {
    /// Waits for the next deadline; returns the time now.
    pub async fn tick(&mut self) -> Stamp {
        self.clock.sleep_until(self.next).await;
        let now = self.clock.now();
        // The simulation restarted: the deadlines restart too.
        if self.next.since(now) > RESTART {
            self.next = now;
        }
        let period = u64::try_from(self.period.as_nanos()).unwrap_or(u64::MAX);
        let late = now.0.saturating_sub(self.next.0) / period;
        self.next = Stamp(
            self.next
                .0
                .saturating_add(period.saturating_mul(late.saturating_add(1))),
        );
        now
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[tokio::test]
    async fn simulated_time_moves_by_its_handle_alone() {
        let (clock, handle) = Clock::simulated(Stamp(100));
        let sleeper = tokio::spawn({
            let clock = clock.clone();
            async move {
                clock.sleep_until(Stamp(150)).await;
                clock.now()
            }
        });
        tokio::task::yield_now().await;
        handle.set(Stamp(149));
        handle.set(Stamp(120));
        assert_eq!(clock.now(), Stamp(149), "a reordered message does not turn time back");
        tokio::task::yield_now().await;
        assert!(!sleeper.is_finished());
        handle.set(Stamp(151));
        assert_eq!(sleeper.await.ok(), Some(Stamp(151)));
    }

    #[test]
    fn a_task_is_woken_once_when_it_is_due_and_leaves_nothing_behind() {
        #[derive(Default)]
        struct Count(std::sync::atomic::AtomicUsize);
        impl std::task::Wake for Count {
            fn wake(self: Arc<Self>) {
                self.0.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
            }
        }
        let (clock, handle) = Clock::simulated(Stamp(100));
        let count = Arc::new(Count::default());
        let waker = Waker::from(Arc::clone(&count));
        let woken = || count.0.load(std::sync::atomic::Ordering::Relaxed);
        let mut sleep = Box::pin(clock.sleep_until(Stamp(150)));
        let mut other = Box::pin(clock.sleep_until(Stamp(150)));
        for now in [110, 120, 149] {
            assert!(sleep.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
            assert!(other.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
            handle.set(Stamp(now));
            assert_eq!(woken(), 0);
        }
        drop(other);
        handle.set(Stamp(150));
        handle.set(Stamp(200));
        assert_eq!(woken(), 1);
        assert!(sleep.as_mut().poll(&mut Context::from_waker(&waker)).is_ready());
        drop(sleep);
        assert!(handle.sleepers.lock().wakers.is_empty());
    }

    #[tokio::test]
    async fn a_simulation_that_begins_anew_is_followed() {
        let (clock, handle) = Clock::simulated(Stamp::from_secs(100.0));
        handle.set(Stamp::from_secs(0.5));
        assert_eq!(clock.now(), Stamp::from_secs(0.5));
    }

    #[test]
    fn one_stamp_of_the_far_future_does_not_stop_the_time() {
        for forged in [Stamp(u64::MAX), Stamp::from_secs(1e9), Stamp::from_secs(100.0)] {
            let mut follower = Follower::default();
            for tick in 0..3_u32 {
                let now = Stamp::from_secs(1.0 + 0.02 * f64::from(tick));
                assert_eq!(follower.follow(forged), None, "{forged:?}");
                assert_eq!(follower.follow(now), Some(now));
            }
        }
    }

    #[test]
    fn a_pause_of_the_link_is_caught_up_and_a_simulation_that_begins_anew_goes_on() {
        let mut follower = Follower::default();
        let (late, later) = (Stamp::from_secs(500.0), Stamp::from_secs(500.02));
        assert_eq!((follower.follow(late), follower.follow(later)), (None, Some(later)));
        for _ in 1..BEGUN_ANEW {
            assert_eq!(follower.follow(Stamp::from_secs(0.02)), None);
        }
        let begun = follower.follow(Stamp::from_secs(0.02)).map(Stamp::as_secs);
        assert!(begun.is_some_and(|begun| (begun - 500.02).abs() < 1e-6), "{begun:?}");
        let on = follower.follow(Stamp::from_secs(0.52)).map(Stamp::as_secs);
        assert!(on.is_some_and(|on| (on - 500.52).abs() < 1e-6), "{on:?}");
    }

    #[test]
    fn of_two_simulations_that_give_the_time_one_counts() {
        for behind in [3.0, 12.0, 100.0] {
            let mut follower = Follower::default();
            let mut shown = Stamp::ZERO;
            for tick in 0..2_000_u32 {
                let now = 1.0 + 0.01 * f64::from(tick);
                shown = follower.follow(Stamp::from_secs(now + behind)).unwrap_or(shown);
                shown = follower.follow(Stamp::from_secs(now)).unwrap_or(shown);
            }
            let passed = shown.as_secs() - 1.0;
            let is_of = |line: f64| (passed - line - 19.99).abs() < 0.1;
            assert!(is_of(0.0) || is_of(behind), "{behind}: {passed}");
        }
    }

    #[tokio::test]
    async fn missed_ticks_are_skipped() {
        let (clock, handle) = Clock::simulated(Stamp(0));
        let mut interval = clock.interval(Duration::from_nanos(10));
        assert_eq!(interval.tick().await, Stamp(0));
        handle.set(Stamp(37));
        assert_eq!(interval.tick().await, Stamp(37));
        assert_eq!(interval.next, Stamp(40));
    }

    #[tokio::test]
    async fn a_timeout_is_of_this_clock() {
        let (clock, handle) = Clock::simulated(Stamp(0));
        let wait = tokio::spawn(async move {
            clock
                .timeout(Duration::from_secs(3600), std::future::pending::<()>())
                .await
        });
        tokio::task::yield_now().await;
        handle.advance(Duration::from_secs(3600));
        assert_eq!(wait.await.ok(), Some(None));
    }

    #[test]
    fn the_wall_clock_is_monotonic_unix_time() {
        let clock = Clock::wall();
        let first = clock.now();
        assert!(first.as_secs() > 1.7e9);
        assert!(clock.now() >= first);
    }
}

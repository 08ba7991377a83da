//! Flood. Recent messages on every key are republished at ten times their rate.

use std::collections::BTreeMap;
use std::time::Duration;

use tokio::time::{Instant, MissedTickBehavior, interval};
use zenav_protocol::bus::{Bus, BusError, RawSample};

/// Listening time.
const HEARD: Duration = Duration::from_secs(2);
/// Factor from the observed message rate to that of the flood.
const TIMES: f64 = 10.0;
/// Publishing period.
const PERIOD: Duration = Duration::from_millis(10);

/// The last message of each key, with its rate.
#[derive(Debug)]
pub struct Flood(Vec<(RawSample, f64)>);

impl Flood {
    /// Listens to every key for a time.
    ///
    /// # Errors
    /// When the bus is closed.
    pub async fn listen(bus: &Bus) -> Result<Self, BusError> {
        let mut heard = bus.raw_subscribe("zenav/**", 65536)?;
        let mut keys = BTreeMap::<String, (RawSample, f64)>::new();
        let end = Instant::now() + HEARD;
        while let Ok(Some(sample)) = tokio::time::timeout_at(end, heard.next()).await {
            let count = keys.get(&sample.key).map_or(0.0, |(_, count)| *count);
            keys.insert(sample.key.clone(), (sample, count + 1.0));
        }
        Ok(Self(keys.into_values().collect()))
    }

    /// Publishes for a time and returns the number of messages.
    pub async fn pour(self, bus: Bus, time: Duration) -> usize {
        let mut due = vec![0.0; self.0.len()];
        let mut count = 0;
        let mut ticks = interval(PERIOD);
        ticks.set_missed_tick_behavior(MissedTickBehavior::Burst);
        let end = Instant::now() + time;
        while Instant::now() < end {
            ticks.tick().await;
            for ((sample, heard), due) in self.0.iter().zip(&mut due) {
                *due += TIMES * heard * PERIOD.as_secs_f64() / HEARD.as_secs_f64();
                while *due >= 1.0 {
                    *due -= 1.0;
                    count += usize::from(bus.raw_put(&sample.key, sample.bytes.clone(), &sample.encoding).is_ok());
                }
            }
        }
        count
    }
}

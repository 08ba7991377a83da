//! Delay line. Delivers messages after a seeded random delay, in order.

use std::collections::VecDeque;

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::time::Stamp;

/// Largest deviation of a delay, as a share of the mean.
const JITTER: f64 = 0.2;

/// A link in one direction.
#[derive(Clone, Debug)]
pub struct Link<T> {
    mean_secs: f64,
    rng: Pcg64Mcg,
    under_way: VecDeque<(Stamp, T)>,
}

impl<T> Link<T> {
    /// A link with a delay of `mean_secs`, plus or minus a fifth.
    #[must_use]
    pub fn new(mean_secs: f64, seed: u64) -> Self {
        Self {
            mean_secs,
            rng: Pcg64Mcg::seed_from_u64(seed),
            under_way: VecDeque::new(),
        }
    }

    /// Sends a message; it never overtakes an earlier one.
    pub fn send(&mut self, now: Stamp, message: T) {
        let factor = 1.0 + JITTER * self.rng.random_range(-1.0..=1.0);
        let arrival = now.plus_secs(self.mean_secs * factor);
        let arrival = self.under_way.back().map_or(arrival, |(last, _)| arrival.max(*last));
        self.under_way.push_back((arrival, message));
    }

    /// Takes the messages that have arrived.
    pub fn receive(&mut self, now: Stamp) -> Vec<T> {
        let arrived = self.under_way.iter().take_while(|(arrival, _)| *arrival <= now).count();
        self.under_way.drain(..arrived).map(|(_, message)| message).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn messages_arrive_in_order_after_about_the_mean_and_alike_for_a_seed() {
        let arrivals = |seed| {
            let mut link = Link::new(0.1, seed);
            for number in 0..50_u64 {
                link.send(Stamp::from_secs(0.02 * number as f64), number);
            }
            (0..200)
                .map(|tick| link.receive(Stamp::from_secs(0.01 * f64::from(tick))))
                .collect::<Vec<_>>()
        };
        let (once, again) = (arrivals(7), arrivals(7));
        assert_eq!(once, again);
        assert_eq!(once.concat(), (0..50).collect::<Vec<u64>>());
        assert!(once[..8].iter().all(Vec::is_empty), "nothing arrives before 80 ms");
    }
}

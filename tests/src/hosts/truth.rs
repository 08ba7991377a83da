//! Truth. Ground truth of the robots' bodies, from the readings that their world publishes, which faults of the fleet's network do not
//! affect.

use std::collections::BTreeMap;
use std::path::Path;
use std::time::Duration;

use tokio::time::{Instant, timeout_at};
use zenav_protocol::bus::{Bus, Subscription};
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_protocol::topics;

/// A wheel that turns less than this between two samples is at rest, rad; encoder noise is below it.
const TURNED: f64 = 0.02;
/// Sampling interval of the wheels, s of the world's time.
const LOOK: f64 = 0.1;

/// The observations of one body.
#[derive(Clone, Copy, Debug)]
struct Seen {
    now: Stamp,
    looked: Stamp,
    wheels: [f64; 2],
    /// Last time that a wheel turned.
    moved: Stamp,
    /// Longest rest since [`Truth::reset`], s of the world's time.
    rest: f64,
    touched: bool,
}

/// The robots' bodies.
#[derive(Debug)]
pub struct Truth {
    readings: Subscription<Readings>,
    bodies: BTreeMap<String, Seen>,
    _bus: Bus,
}

impl Truth {
    /// Listens at the world's endpoint of a site, as its operator.
    ///
    /// # Errors
    /// When no world is served there.
    pub async fn listen(world: &str, operator: &Path) -> Result<Self, String> {
        let bus = super::join("truth", world, operator).await?;
        let readings = bus
            .subscribe(&topics::READINGS, &["*"], 4096)
            .map_err(|error| error.to_string())?;
        Ok(Self {
            readings,
            bodies: BTreeMap::new(),
            _bus: bus,
        })
    }

    /// Listens until `enough` holds for every robot's current rest, s of the world's time.
    ///
    /// # Errors
    /// The robots for which it does not hold within `limit` of wall time.
    pub async fn until(
        &mut self,
        what: &str,
        limit: Duration,
        enough: impl Fn(&str, f64) -> bool,
    ) -> Result<(), String> {
        self.catch_up();
        let deadline = Instant::now() + limit;
        loop {
            let Ok(Some(received)) = timeout_at(deadline, self.readings.next()).await else {
                let resting = self
                    .bodies
                    .iter()
                    .map(|(robot, seen)| format!("{robot} rests for {:.1} s", seen.now.secs_since(seen.moved)));
                return Err(format!(
                    "not within {limit:?}: {what}; {}",
                    resting.collect::<Vec<_>>().join(", ")
                ));
            };
            if let Some(robot) = received.chunks.first() {
                self.see(robot, &received.message);
            }
            let all = |(robot, seen): (&String, &Seen)| enough(robot, seen.now.secs_since(seen.moved));
            if self.bodies.len() >= 3 && self.bodies.iter().all(all) {
                return Ok(());
            }
        }
    }

    /// Listens for a duration, s of the world's time.
    ///
    /// # Errors
    /// When the world stands still.
    pub async fn during(&mut self, secs: f64) -> Result<(), String> {
        self.catch_up();
        let mut first = None;
        let patience = Duration::from_secs_f64(secs * 10.0 + 10.0);
        let deadline = Instant::now() + patience;
        while let Ok(Some(received)) = timeout_at(deadline, self.readings.next()).await {
            let now = received.message.stamp;
            if let Some(robot) = received.chunks.first() {
                self.see(robot, &received.message);
            }
            if now.secs_since(*first.get_or_insert(now)) >= secs {
                return Ok(());
            }
        }
        Err(format!("the world does not get on by {secs} s within {patience:?}"))
    }

    /// Takes the readings that came while nobody listened.
    fn catch_up(&mut self) {
        while let Some(received) = self.readings.try_next() {
            if let Some(robot) = received.chunks.first() {
                self.see(robot, &received.message);
            }
        }
    }

    fn see(&mut self, robot: &str, readings: &Readings) {
        let now = readings.stamp;
        let seen = self.bodies.entry(robot.to_owned()).or_insert(Seen {
            now,
            looked: now,
            wheels: readings.wheels,
            moved: now,
            rest: 0.0,
            touched: false,
        });
        seen.now = now;
        seen.touched |= readings.bump.pressed;
        if now.secs_since(seen.looked) < LOOK {
            return;
        }
        let turned = (0..2)
            .map(|wheel| (readings.wheels[wheel] - seen.wheels[wheel]).abs())
            .fold(0.0, f64::max);
        if turned > TURNED {
            seen.moved = now;
        }
        seen.rest = seen.rest.max(now.secs_since(seen.moved));
        (seen.looked, seen.wheels) = (now, readings.wheels);
    }

    /// Resets the longest rests.
    pub fn reset(&mut self) {
        for seen in self.bodies.values_mut() {
            (seen.moved, seen.rest) = (seen.now, 0.0);
        }
    }

    /// The longest rest of any robot since the last reset, s of the world's time, and that robot.
    #[must_use]
    pub fn longest_rest(&self) -> (f64, String) {
        let longest = self.bodies.iter().max_by(|(_, a), (_, b)| a.rest.total_cmp(&b.rest));
        longest
            .map(|(robot, seen)| (seen.rest, robot.clone()))
            .unwrap_or_default()
    }

    /// Robots that have touched something.
    #[must_use]
    pub fn touched(&self) -> Vec<&String> {
        self.bodies
            .iter()
            .filter(|(_, seen)| seen.touched)
            .map(|(robot, _)| robot)
            .collect()
    }
}

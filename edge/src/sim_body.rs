//! Simulated body. How does a simulated robot become a [`Body`]? All robots of a process share one world, which steps once each of them has
//! asked for its next readings: all act at the same simulated time.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use zenav_protocol::geometry::Pose2;
use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_sim::{SimError, Simulation, Truth, World};

use crate::body::{Body, BodyError};

/// Wall time that a robot waits for the others before it reports an error; its wheels are stopped then.
const PATIENCE: Duration = Duration::from_secs(1);

/// A robot in a world of its own process.
pub struct SimBody {
    shared: Arc<Shared>,
    robot: usize,
    /// The step count when this robot asked for its next readings, if it has.
    asked: Option<u64>,
}

/// Ground truth of one robot, to judge a run by. The pilot never sees it.
#[derive(Clone)]
pub struct Referee {
    shared: Arc<Shared>,
    robot: usize,
}

struct Shared {
    world: Mutex<SharedWorld>,
    stepped: Condvar,
}

struct SharedWorld {
    simulation: Simulation,
    /// Number of steps so far.
    steps: u64,
    /// Robots that are driven.
    driven: usize,
    /// Robots that have asked for the next step.
    asked: usize,
}

impl SharedWorld {
    /// Steps the world once all robots have asked for it. Returns whether it stepped.
    fn step(&mut self) -> bool {
        let everybody = self.asked >= self.driven && self.driven > 0;
        if everybody {
            self.simulation.step();
            self.steps += 1;
            self.asked = 0;
        }
        everybody
    }
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, SharedWorld> {
        self.world.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl SimBody {
    /// All robots of a simulation in order, each with its ground truth. The world stands still until each of them is driven or dropped.
    ///
    /// ```
    /// # use zenav_protocol::{id::Id, time::Stamp};
    /// # use zenav_sim::{RobotSpec, Simulation, World};
    /// # let kitchen = World::shipped("kitchen")?;
    /// # let tiago = RobotSpec { id: Id::robot("tiago")?, model: zenav_fixtures::robot("tiago"), start: kitchen.start() };
    /// use zenav_edge::{Body, SimBody};
    ///
    /// let (mut body, referee) = SimBody::all(Simulation::new(&kitchen, vec![tiago], 1)?).remove(0);
    /// body.drive([3.0, 3.0])?;
    /// for _ in 0..50 {
    ///     body.read()?;
    /// }
    /// assert_eq!(referee.now(), Stamp::from_secs(1.0), "each reading is a step of 20 ms");
    /// assert!(referee.truth().length > 0.1);
    /// # Ok::<(), Box<dyn std::error::Error>>(())
    /// ```
    #[must_use]
    pub fn all(simulation: Simulation) -> Vec<(Self, Referee)> {
        let robots = simulation.robots();
        let turn = SharedWorld {
            simulation,
            steps: 0,
            driven: robots,
            asked: 0,
        };
        let shared = Arc::new(Shared {
            world: Mutex::new(turn),
            stepped: Condvar::new(),
        });
        let one = |robot| {
            let body = Self {
                shared: Arc::clone(&shared),
                robot,
                asked: None,
            };
            let referee = Referee {
                shared: Arc::clone(&shared),
                robot,
            };
            (body, referee)
        };
        (0..robots).map(one).collect()
    }
}

impl SimBody {
    /// Requests the next readings without waiting for them, so that one thread can drive several robots.
    pub fn ask(&mut self) {
        let shared = Arc::clone(&self.shared);
        self.ask_of(&mut shared.lock());
    }

    /// Asks for the next step; returns the number of steps when the robot first asked.
    fn ask_of(&mut self, turn: &mut SharedWorld) -> u64 {
        let before = *self.asked.get_or_insert_with(|| {
            turn.asked += 1;
            turn.steps
        });
        if turn.steps == before && turn.step() {
            self.shared.stepped.notify_all();
        }
        before
    }
}

impl Body for SimBody {
    fn read(&mut self) -> Result<Readings, BodyError> {
        let shared = Arc::clone(&self.shared);
        let mut turn = shared.lock();
        let before = self.ask_of(&mut turn);
        let (turn, _) = self
            .shared
            .stepped
            .wait_timeout_while(turn, PATIENCE, |turn| turn.steps == before)
            .unwrap_or_else(PoisonError::into_inner);
        if turn.steps == before {
            return Err(BodyError("another robot of this world does not step".to_owned()));
        }
        self.asked = None;
        Ok(turn.simulation.readings(self.robot))
    }

    fn drive(&mut self, wheels: [f64; 2]) -> Result<(), BodyError> {
        self.shared.lock().simulation.drive(self.robot, wheels);
        Ok(())
    }
}

impl Drop for SimBody {
    /// The robot stays where it is, as an obstacle to the others, which no longer wait for it.
    fn drop(&mut self) {
        let mut turn = self.shared.lock();
        turn.driven -= 1;
        turn.asked -= usize::from(self.asked == Some(turn.steps));
        if turn.step() {
            self.shared.stepped.notify_all();
        }
    }
}

impl Referee {
    /// Ground truth now.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.shared.lock().simulation.truth(self.robot)
    }

    /// Carries the robot to another place of its world.
    ///
    /// # Errors
    /// If the robot does not fit there.
    pub fn carry(&self, world: &World, to: Pose2) -> Result<(), SimError> {
        self.shared.lock().simulation.carry(world, self.robot, to)
    }

    /// Simulated time.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.shared.lock().simulation.now()
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::id::Id;
    use zenav_sim::RobotSpec;

    use super::*;

    fn bodies(count: usize) -> Vec<(SimBody, Referee)> {
        let model = zenav_fixtures::robot("turtlebot3_waffle");
        let robot = |i: usize| RobotSpec {
            id: Id::new(format!("robot{i}")).unwrap(),
            model: model.clone(),
            start: Pose2::new(2.0 + 2.0 * i as f64, 3.0, 0.0),
        };
        let world = World::from_toml("name = \"hall\"\nsize = [20.0, 6.0]\n", "hall", &|_: &str| {
            Err(String::new())
        })
        .unwrap();
        SimBody::all(Simulation::new(&world, (0..count).map(robot).collect(), 1).unwrap())
    }

    #[test]
    fn robots_of_one_world_live_in_the_same_time_and_one_that_ends_holds_nobody_up() {
        let (mut first, second) = {
            let mut all = bodies(2).into_iter();
            (all.next().unwrap(), all.next().unwrap())
        };
        let other = std::thread::spawn(move || {
            let (mut body, _) = second;
            (0..50).map(|_| body.read().unwrap().stamp).collect::<Vec<_>>()
        });
        let stamps: Vec<_> = (0..80).map(|_| first.0.read().unwrap().stamp).collect();
        let others = other.join().unwrap();
        assert_eq!(&stamps[..50], &others[..]);
        assert!(
            stamps
                .windows(2)
                .all(|pair| pair[1].since(pair[0]) == stamps[0].since(Stamp::ZERO))
        );
        assert_eq!(first.1.now(), stamps[79]);
    }

    #[test]
    fn a_robot_that_waits_in_vain_is_told_and_goes_on_when_the_other_does() {
        let mut all = bodies(2);
        let (mut second, _) = all.pop().unwrap();
        let (mut first, _) = all.pop().unwrap();
        assert!(first.read().is_err() && first.read().is_err());
        let other = std::thread::spawn(move || second.read().unwrap().stamp);
        assert_eq!(first.read().unwrap().stamp, other.join().unwrap());
    }

    /// What a robot commands in a tick.
    fn command(robot: usize, tick: usize) -> [f64; 2] {
        let phase = (robot * 7 + tick) as f64;
        [3.0 + phase.sin(), 3.0 + (0.7 * phase).cos()]
    }

    const ROBOTS: usize = 8;
    const TICKS: usize = 120;

    /// Everything that each robot reads in a drive, as bytes, driven by this many threads, in reverse order if asked.
    fn driven_by(threads: usize, reversed: bool) -> Vec<String> {
        let bodies: Vec<_> = bodies(ROBOTS).into_iter().enumerate().collect();
        let referee = bodies.first().unwrap().1.1.clone();
        let mut shares: Vec<Vec<(usize, SimBody)>> = (0..threads).map(|_| Vec::new()).collect();
        for (robot, (body, _)) in bodies {
            shares[robot % threads].push((robot, body));
        }
        if reversed {
            shares.reverse();
        }
        let running: Vec<_> = shares
            .into_iter()
            .map(|mut share| {
                if reversed {
                    share.reverse();
                }
                std::thread::spawn(move || {
                    let mut said: Vec<(usize, String)> =
                        share.iter().map(|(robot, _)| (*robot, String::new())).collect();
                    for tick in 0..TICKS {
                        for (robot, body) in &mut share {
                            body.drive(command(*robot, tick)).unwrap();
                            if (*robot + tick) % 3 == 0 {
                                std::thread::yield_now();
                            }
                        }
                        // A thread with several robots asks for all of them before it waits for any.
                        share.iter_mut().for_each(|(_, body)| body.ask());
                        for ((_, body), (_, said)) in share.iter_mut().zip(&mut said) {
                            *said += &format!("{:?}\n", body.read().unwrap());
                        }
                    }
                    said
                })
            })
            .collect();
        let mut said: Vec<(usize, String)> = running.into_iter().flat_map(|thread| thread.join().unwrap()).collect();
        said.sort();
        let mut said: Vec<String> = said.into_iter().map(|(_, said)| said).collect();
        said.push(format!("{:?} {:?}", referee.truth(), referee.now()));
        said
    }

    #[test]
    fn a_seed_gives_the_same_bytes_whatever_the_number_and_order_of_threads() {
        let alone = driven_by(1, false);
        assert!(alone.iter().take(ROBOTS).all(|said| said.lines().count() == TICKS));
        for threads in [1, 2, 8] {
            for reversed in [false, true] {
                assert!(
                    driven_by(threads, reversed) == alone,
                    "{threads} threads, reversed: {reversed}"
                );
            }
        }
    }
}

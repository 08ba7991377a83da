//! Replay. Where will everybody be, if no robot holds them up?

use nalgebra::Point2;
use zenav_sim::Simulation;

use crate::driver::TICKS_PER_DECISION;

/// Positions of all movers over time.
pub(crate) struct Replay {
    /// Time of the first positions, s.
    begins: f64,
    /// Time between positions, s.
    step: f64,
    places: Vec<Vec<Point2<f64>>>,
}

impl Replay {
    /// Lets the movers of a simulation go on without its robots until a time, s.
    pub(crate) fn new(simulation: &Simulation, until: f64) -> Self {
        let mut simulation = simulation.clone();
        (0..simulation.robots())
            .rev()
            .for_each(|robot| simulation.remove(robot));
        let begins = simulation.now().as_secs();
        let mut places = vec![simulation.movers().collect()];
        while simulation.now().as_secs() < until {
            (0..TICKS_PER_DECISION).for_each(|_| simulation.step());
            places.push(simulation.movers().collect());
        }
        Self {
            begins,
            step: simulation.tick().as_secs_f64() * TICKS_PER_DECISION as f64,
            places,
        }
    }

    /// Position of a mover at a time (s); the last one after the end of the record.
    pub(crate) fn at(&self, mover: usize, secs: f64) -> Point2<f64> {
        let place = |index: usize| {
            let row = self.places.get(index).or(self.places.last());
            row.and_then(|row| row.get(mover)).copied().unwrap_or_default()
        };
        let share = ((secs - self.begins) / self.step).max(0.0);
        let from = place(share as usize);
        from + (place(share as usize + 1) - from) * share.fract()
    }
}

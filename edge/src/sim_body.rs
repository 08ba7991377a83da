//! How is a simulated robot a [`Body`]? Each read advances its world by one tick.

use std::sync::{Arc, Mutex, PoisonError};

use zenav_protocol::readings::Readings;
use zenav_protocol::time::Stamp;
use zenav_sim::{Simulation, Truth};

use crate::body::{Body, BodyError};

/// A robot in a world of its own process. The world holds further robots only as bystanders: this body moves time.
pub struct SimBody {
    shared: Arc<Mutex<Simulation>>,
    robot: usize,
}

/// A look at the true world, for a referee. It never goes to the pilot.
#[derive(Clone)]
pub struct Referee {
    shared: Arc<Mutex<Simulation>>,
    robot: usize,
}

impl SimBody {
    /// The robot with this index in the simulation, and its referee.
    ///
    /// # Errors
    /// [`BodyError`] when the simulation has no such robot.
    pub fn new(simulation: Simulation, robot: usize) -> Result<(Self, Referee), BodyError> {
        if robot >= simulation.robots() {
            return Err(BodyError(format!(
                "the simulation has {} robots, not a number {robot}",
                simulation.robots()
            )));
        }
        let shared = Arc::new(Mutex::new(simulation));
        Ok((
            Self {
                shared: Arc::clone(&shared),
                robot,
            },
            Referee { shared, robot },
        ))
    }
}

impl Body for SimBody {
    fn read(&mut self) -> Result<Readings, BodyError> {
        let mut simulation = self.shared.lock().unwrap_or_else(PoisonError::into_inner);
        simulation.step();
        Ok(simulation.readings(self.robot))
    }

    fn drive(&mut self, wheels: [f64; 2]) -> Result<(), BodyError> {
        self.shared
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .drive(self.robot, wheels);
        Ok(())
    }
}

impl Referee {
    /// The truth now.
    #[must_use]
    pub fn truth(&self) -> Truth {
        self.shared
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .truth(self.robot)
    }

    /// Simulated time.
    #[must_use]
    pub fn now(&self) -> Stamp {
        self.shared.lock().unwrap_or_else(PoisonError::into_inner).now()
    }
}

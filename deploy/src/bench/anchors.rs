//! Anchors. How does a reference driver get on in the same worlds? It drives the same simulated body from the same start to the same goal, and
//! the same referee judges it.

use zenav_protocol::id::Id;
use zenav_protocol::time::Stamp;
use zenav_reference_drivers::{DrivingTask, Field, Method, ReferenceDriver, TICKS_PER_DECISION};
use zenav_sim::{RobotSpec, Simulation, Truth};

use super::suites::Case;
use crate::failure::Failure;
use crate::lockstep::Referee;

/// Tolerance if a case uses the deployment's, m.
const TOLERANCE: f64 = 0.15;

/// Result of an anchor's run.
pub(super) struct Driven {
    pub referee: Referee,
    pub truth: Truth,
    pub time_s: f64,
}

/// Drives a case to its end; `see` is called with the ground truth after every tick.
///
/// # Errors
/// A robot that cannot start where the world file says.
pub(super) fn drive(
    method: Method,
    case: &Case,
    field: &Field,
    mut see: impl FnMut(Stamp, &Truth),
) -> Result<Driven, Failure> {
    let task = DrivingTask {
        world: &case.world,
        model: &case.model,
        start: case.world.start(),
        goal: case.goal,
        tolerance: case.tolerance.unwrap_or(TOLERANCE),
        timeout: case.timeout,
    };
    let reach = case.model.footprint.circumscribed_radius();
    let mut referee = Referee::new(task.goal, task.tolerance, reach);
    let spec = RobotSpec {
        id: Id::robot("robot").map_err(Failure::failed)?,
        model: case.model.clone(),
        start: task.start,
    };
    let mut simulation = Simulation::new(&case.world, vec![spec], case.seed).map_err(Failure::usage)?;
    let mut driver = ReferenceDriver::new(method, task, field, &simulation);
    let mut tick = 0_u64;
    loop {
        if tick.is_multiple_of(TICKS_PER_DECISION) {
            let wheels = driver.decide(&simulation);
            simulation.drive(0, wheels);
        }
        simulation.step();
        tick += 1;
        let truth = simulation.truth(0);
        see(simulation.now(), &truth);
        referee.watch(simulation.now(), &truth);
        let time_s = simulation.now().as_secs();
        if referee.is_reached() || time_s >= case.timeout {
            return Ok(Driven { referee, truth, time_s });
        }
    }
}

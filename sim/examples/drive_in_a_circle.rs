//! A TIAGo drives in a circle through a kitchen for ten seconds; prints its poses, its distance and its contacts.

use zenav_protocol::{
    id::Id,
    robot::{self, RobotModel},
};
use zenav_sim::{RobotSpec, Simulation, World};

#[allow(clippy::print_stdout, reason = "an example")]
fn main() -> Result<(), Box<dyn std::error::Error>> {
    let world = World::shipped("kitchen")?;
    let model = RobotModel::from_toml(robot::shipped("tiago").unwrap_or_default(), "tiago")?;
    let tiago = RobotSpec {
        id: Id::robot("tiago")?,
        model,
        start: world.start(),
    };
    let mut simulation = Simulation::new(&world, vec![tiago], 1)?;
    // Wheel speeds, rad/s.
    simulation.drive(0, [1.5, 3.0]);
    println!("   t s     x m     y m  yaw rad");
    for step in 1..=500 {
        simulation.step();
        if step % 50 == 0 {
            let pose = simulation.truth(0).map_from_base;
            println!(
                "{:6.1} {:7.2} {:7.2} {:8.2}",
                f64::from(step) * 0.02,
                pose.x,
                pose.y,
                pose.yaw
            );
        }
    }
    let truth = simulation.truth(0);
    println!("{:.2} m driven, {} contacts", truth.length, truth.collisions);
    Ok(())
}

//! Moving obstacles tracked by a robot.

use serde::{Deserialize, Serialize};

use crate::time::Stamp;

/// The moving obstacles tracked by a robot. Published with each scan while there are any, and once when the last is gone.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Obstacles {
    /// Time that positions and velocities are for, on the robot's clock.
    pub stamp: Stamp,
    /// The tracks.
    pub obstacles: Vec<Obstacle>,
}

/// A moving obstacle: a disc with constant velocity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Obstacle {
    /// Track number; unique within one start of the edge.
    pub id: u64,
    /// Center, map frame, m.
    pub x: f64,
    /// Center, map frame, m.
    pub y: f64,
    /// Velocity over the floor, map frame, m/s.
    pub vx: f64,
    /// Velocity over the floor, map frame, m/s.
    pub vy: f64,
    /// Radius of the disc, m.
    pub radius: f64,
    /// Variance of the position on each axis, m²; covariance of position and velocity, m²/s; variance of the velocity, (m/s)².
    pub variance: [f64; 3],
    /// Time since it was last seen, s; a hidden obstacle is predicted for a while.
    pub unseen_for: f64,
}

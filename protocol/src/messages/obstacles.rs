//! Moving obstacles that a robot tracks.

use serde::{Deserialize, Serialize};

use crate::time::Stamp;

/// The moving obstacles that a robot tracks, published with each scan while there are any, and once when there are none any more.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Obstacles {
    /// The time that positions and velocities are for, on the robot's clock.
    pub stamp: Stamp,
    /// The tracks.
    pub obstacles: Vec<Obstacle>,
}

/// A moving obstacle: a disc that goes on at constant velocity.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Obstacle {
    /// Its number; none is given twice by one start of the edge.
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
    /// How long ago it was seen, s: a hidden obstacle goes on by its prediction for a while.
    pub unseen_for: f64,
}

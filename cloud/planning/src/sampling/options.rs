//! What can be chosen about sampling planners? Shares and counts that hold on maps of any size.

use nalgebra::Point2;

/// Parameters of the sampling planners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Options {
    /// Longest edge, as a share of the map's diagonal (default 0.2).
    pub step: f64,
    /// Share of samples that are the goal, in a single tree (default 0.05).
    pub goal_bias: f64,
    /// Samples before trees are led out of what they have covered (default 64): a way across open ground is found sooner by chance alone.
    pub patience: u64,
    /// Exits that are drawn each time; the one nearest to the other tree is taken (default 8).
    pub exits: usize,
    /// Share of samples at the corners of obstacles once a way is known: shortest ways bend nowhere else (default 0.5).
    pub corners: f64,
    /// Samples with which a way is improved at most, whatever the budget (default a million, about 100 MB).
    pub improving: u64,
    /// Low and high corner of the box that samples are drawn from, cells (default the whole map). Start and goal may lie outside.
    pub domain: Option<[Point2<f64>; 2]>,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            step: 0.2,
            goal_bias: 0.05,
            patience: 64,
            exits: 8,
            corners: 0.5,
            improving: 1_000_000,
            domain: None,
        }
    }
}

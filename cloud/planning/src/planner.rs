//! Which planners are there, by which names, and with which options?
//!
//! To add a planner: a file beside [`super::astar`], a variant of [`Planner`] with its name in [`Planner::ALL`], an arm in
//! [`Searcher::search`](super::Searcher::search).

use std::fmt;
use std::str::FromStr;

use super::sampling;

/// The searches there are.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Planner {
    /// A* over eight neighbours; takes costs.
    #[default]
    AStar,
    /// Jump point search: the shortest way, fastest where the map is open; takes no costs.
    Jps,
    /// Lazy Theta*: a short way in any direction, from cell centre to cell centre.
    Theta,
    /// One random tree from the start: its first way.
    Rrt,
    /// Two random trees that meet: their first way.
    RrtConnect,
    /// A random tree with costs, whose way becomes shorter for as long as it may.
    RrtStar,
}

impl Planner {
    /// Every planner, in the order in which they are listed to users.
    pub const ALL: &[(&'static str, Self)] = &[
        ("astar", Self::AStar),
        ("jps", Self::Jps),
        ("theta", Self::Theta),
        ("rrt", Self::Rrt),
        ("rrt_connect", Self::RrtConnect),
        ("rrt_star", Self::RrtStar),
    ];

    /// Whether it grows trees towards samples.
    #[must_use]
    pub const fn grows_trees(self) -> bool {
        matches!(self, Self::Rrt | Self::RrtConnect | Self::RrtStar)
    }

    /// Whether its paths keep clear of obstacles where there is room; those of the others may pass as close as the robot fits.
    #[must_use]
    pub const fn keeps_clear(self) -> bool {
        matches!(self, Self::AStar)
    }

    /// Its name, as in requests and on the command line.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::ALL
            .iter()
            .find(|(_, planner)| *planner == self)
            .map_or("", |(name, _)| name)
    }
}

impl fmt::Display for Planner {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// No planner has this name.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("unknown planner `{name}`: expected one of {}", names())]
pub struct UnknownPlanner {
    /// What was asked for.
    pub name: String,
}

fn names() -> String {
    Planner::ALL
        .iter()
        .map(|(name, _)| *name)
        .collect::<Vec<_>>()
        .join(", ")
}

impl FromStr for Planner {
    type Err = UnknownPlanner;

    fn from_str(name: &str) -> Result<Self, UnknownPlanner> {
        Self::ALL
            .iter()
            .find(|(known, _)| *known == name)
            .map(|(_, planner)| *planner)
            .ok_or_else(|| UnknownPlanner { name: name.to_owned() })
    }
}

/// How a path is searched for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanOptions {
    /// Which planner.
    pub planner: Planner,
    /// A path keeps this far from obstacles where there is room, m, beyond the robot's radius.
    pub clearance: f64,
    /// Metres of detour that a metre along an obstacle is worth; 0 asks for the shortest path. At most 7.
    pub clearance_weight: f64,
    /// Parameters of sampling planners.
    pub sampling: sampling::Options,
    /// Seed of sampling planners.
    pub seed: u64,
    /// The robot may begin with any heading, whatever the start says.
    pub any_heading: bool,
    /// A robot that stands in an obstacle of the map may go this far to the nearest free place, m (default 0: it is refused).
    pub escape: f64,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self::new(Planner::AStar)
    }
}

impl PlanOptions {
    /// The defaults for a planner.
    #[must_use]
    pub fn new(planner: Planner) -> Self {
        Self {
            planner,
            clearance: 0.4,
            clearance_weight: 3.0,
            sampling: sampling::Options::default(),
            seed: 1,
            any_heading: false,
            escape: 0.0,
        }
    }

    /// The shortest path on the grid, whatever its clearance.
    #[must_use]
    pub fn shortest(planner: Planner) -> Self {
        Self {
            clearance: 0.0,
            clearance_weight: 0.0,
            ..Self::new(planner)
        }
    }
}

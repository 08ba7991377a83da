//! Which planners are there, by which names, and with which options?
//!
//! To add a planner: a file beside [`super::astar`], a variant of [`Planner`] with its name in [`Planner::ALL`], an arm in
//! [`Searcher::search`](super::Searcher::search).

use std::fmt;
use std::str::FromStr;

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

    /// Whether its ways keep away from obstacles for the robot's comfort; those of the others may pass as close as the robot fits.
    #[must_use]
    pub const fn keeps_away(self) -> bool {
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

/// How a way is looked for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlanOptions {
    /// Which search.
    pub planner: Planner,
    /// A way keeps this far from obstacles where there is room, m, beyond the robot's radius.
    pub comfort: f64,
    /// Metres of detour that a metre along an obstacle is worth; 0 asks for the shortest way. At most 7.
    pub comfort_weight: f64,
    /// Seed of planners that draw samples.
    pub seed: u64,
    /// The robot may begin with any heading, whatever the start says.
    pub any_heading: bool,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self {
            planner: Planner::AStar,
            comfort: 0.4,
            comfort_weight: 3.0,
            seed: 1,
            any_heading: false,
        }
    }
}

impl PlanOptions {
    /// The shortest way on the grid, whatever its clearance.
    #[must_use]
    pub fn shortest(planner: Planner) -> Self {
        Self {
            planner,
            comfort: 0.0,
            comfort_weight: 0.0,
            seed: 1,
            any_heading: false,
        }
    }
}

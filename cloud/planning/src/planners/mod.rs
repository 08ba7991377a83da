//! Planners. The registry of all planners and their names.
//!
//! To add one: a file in this folder with a type that implements [`PathSearch`], its `mod` line, and its row in `planners!` below. The
//! worker, the batch command and the missions find it by its name.

pub(crate) mod astar;
mod jps;
mod rrt;
mod rrt_connect;
mod rrt_star;
mod theta;

use std::fmt;
use std::str::FromStr;

use nalgebra::Point2;
use zenav_space::LineOfSight;

use super::budget::Budget;
use super::grid_graph::GridGraph;
use super::searcher::{Query, Searched};
use super::settings::SamplingSettings;

/// Input of a planner.
#[derive(Debug)]
pub(crate) struct Map<'a, S> {
    /// The free cells and the steps between them.
    pub(crate) graph: &'a GridGraph,
    /// The space of the free cells.
    pub(crate) sight: &'a S,
    /// Settings of sampling planners.
    pub(crate) sampling: &'a SamplingSettings,
    /// The box that samples are drawn from, cells.
    pub(crate) domain: Option<[Point2<f64>; 2]>,
    /// Only the line of sight may be queried.
    pub(crate) black_box: bool,
}

/// A planner with the memory that it keeps from one search to the next.
pub(crate) trait PathSearch {
    /// A path between two points on a grid; independent of earlier searches.
    fn search<S: LineOfSight>(&mut self, map: &Map<'_, S>, query: &Query, budget: Budget<'_>) -> Searched;

    /// Edges of the trees of the last search, cells, at most `limit` of them.
    fn edges(&self, _limit: usize) -> Vec<[Point2<f64>; 2]> {
        Vec::new()
    }
}

/// Structure of a planner's paths.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Kind {
    /// Steps over the grid graph, by cost.
    CostGrid,
    /// Steps over the grid graph, by length alone.
    Grid,
    /// Straight legs between cell centres.
    AnyAngle,
    /// Straight legs between samples.
    Tree,
}

macro_rules! planners {
    ($($(#[$doc:meta])* $variant:ident = $name:ident: $search:ty, $kind:ident;)*) => {
        /// The available planners.
        ///
        /// ```
        /// use zenav_planning::Planner;
        ///
        /// assert_eq!("jps".parse(), Ok(Planner::Jps));
        /// assert!("dijkstra".parse::<Planner>().unwrap_err().to_string().contains("astar, jps"));
        /// assert!(Planner::AStar.keeps_clear() && Planner::RrtStar.grows_trees());
        /// ```
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum Planner {
            $($(#[$doc])* $variant,)*
        }

        impl Planner {
            /// Every planner by its name, in the order in which they are listed to users.
            pub const ALL: &[(&'static str, Self)] = &[$((stringify!($name), Self::$variant),)*];

            const fn kind(self) -> Kind {
                match self {
                    $(Self::$variant => Kind::$kind,)*
                }
            }
        }

        /// Every planner with the memory that it keeps from one search to the next.
        #[derive(Clone, Debug, Default)]
        pub(crate) struct Searches {
            $(pub(crate) $name: $search,)*
        }

        impl Searches {
            pub(crate) fn search<S: LineOfSight>(
                &mut self,
                planner: Planner,
                map: &Map<'_, S>,
                query: &Query,
                budget: Budget<'_>,
            ) -> Searched {
                match planner {
                    $(Planner::$variant => self.$name.search(map, query, budget),)*
                }
            }

            pub(crate) fn edges(&self, planner: Planner, limit: usize) -> Vec<[Point2<f64>; 2]> {
                match planner {
                    $(Planner::$variant => self.$name.edges(limit),)*
                }
            }
        }
    };
}

planners! {
    /// A* over eight neighbours; the only planner whose paths keep clear of obstacles where there is room.
    AStar = astar: astar::Memory, CostGrid;
    /// Jump point search: the shortest path on the grid, fastest where the map is open.
    Jps = jps: jps::Jps, Grid;
    /// Lazy Theta*: a short any-angle path from cell centre to cell centre.
    Theta = theta: theta::Memory, AnyAngle;
    /// RRT: one random tree from the start, its first path.
    Rrt = rrt: rrt::Rrt, Tree;
    /// RRT-Connect: two random trees, the first path on which they meet.
    RrtConnect = rrt_connect: rrt_connect::RrtConnect, Tree;
    /// RRT*: a random tree with costs, whose path gets shorter until the budget ends.
    RrtStar = rrt_star: rrt_star::RrtStar, Tree;
}

impl Planner {
    /// Whether it grows trees towards samples.
    #[must_use]
    pub fn grows_trees(self) -> bool {
        self.kind() == Kind::Tree
    }

    /// Whether its paths are steps over the grid.
    pub(crate) fn is_on_the_grid(self) -> bool {
        matches!(self.kind(), Kind::CostGrid | Kind::Grid)
    }

    /// Whether its paths keep clear of obstacles where there is room; paths of the others may pass as close as the robot fits.
    ///
    /// ```
    /// use zenav_planning::Planner;
    ///
    /// let clear = Planner::ALL.iter().filter(|(_, planner)| planner.keeps_clear());
    /// assert_eq!(clear.map(|(name, _)| *name).collect::<Vec<_>>(), ["astar"]);
    /// ```
    #[must_use]
    pub fn keeps_clear(self) -> bool {
        self.kind() == Kind::CostGrid
    }

    /// Its name, as in requests and on the command line.
    ///
    /// ```
    /// use zenav_planning::Planner;
    ///
    /// assert_eq!(Planner::RrtConnect.name(), "rrt_connect");
    /// assert!(Planner::ALL.iter().all(|(name, planner)| name.parse::<Planner>() == Ok(*planner)));
    /// ```
    #[must_use]
    pub fn name(self) -> &'static str {
        let mut all = Self::ALL.iter();
        all.find(|(_, planner)| *planner == self).map_or("", |(name, _)| name)
    }
}

#[allow(clippy::derivable_impls, reason = "the variants come from the rows of `planners!`")]
impl Default for Planner {
    fn default() -> Self {
        Self::AStar
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
    /// The requested name.
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

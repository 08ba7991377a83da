//! SLAM in the plane. Estimates the robot's poses and the map from laser scans and odometry, and from GPS and compass where there are any.
//!
//! # The problem
//!
//! Given are scans, each with the odometry at its stamp; wanted are the poses `map_from_base` under which all scans draw one map. Odometry
//! is exact over short distances but drifts; a match with the surrounding map is absolute, or wrong. Both are separate measurements in one
//! pose graph:
//!
//! ```text
//! minimise   Σ odometry  +  Σ matches with growing submaps  +  Σ closures with older submaps (those that hold)
//!            +  Σ fixes by GPS and compass (those that hold)
//! ```
//!
//! A step goes through these phases:
//!
//! 1. **points**: the scan's points in the base frame, thinned, the sweep straightened by odometry
//!    ([`points`](zenav_scan_matching::points())).
//! 2. **front**: after 0.1 m or 3 degrees the scan is refined on the older of two growing submaps, with odometry as prior. If the match is
//!    doubtful (by its score, or its distance from odometry), an exact search of a wide window decides. In between, scans are matched but
//!    become no nodes.
//! 3. **closure**: one inserted scan in six is searched for in the nearest older submap, by exact branch and bound, within three standard
//!    deviations of the covariance between the two. A match is accepted if it scores well, no second place is as good, the points are
//!    explained and the beams pass no walls. A match far from the expected pose needs a second scan that confirms it.
//! 4. **back end**: new closures lead to a [solve](Solve) of the graph; closures that do not fit are switched off and may come back. Beside a
//!    robot its poses are adopted with a later scan.
//!
//! [`Slam::finish`] ends a log: closures are decided again ([`zenav_pose_graph::solve_robust`]), every scan is matched to surrounding
//! submaps that it is not part of, and the result is certified.
//!
//! Sessions: [`Slam::save`] and [`Slam::load`] convert a map to bytes and back, [`Slam::begin_session`] begins another drive in it,
//! [`merge`] joins two maps, [`Slam::trim`] drops what newer sessions have seen again.
//!
//! Frames: `map` begins at the first scan's base; `anchor` is the base at a submap's first scan; `base` and `laser` are the robot's.
//! Metres, radians, seconds. The core has no clock, no randomness, no files: the same scans give the same map.
//!
//! # Use
//!
//! [`Slam::step`] takes a scan, [`Slam::finish`] ends the log, [`Slam::trajectory`] has a pose for each scan; [`relation_errors`] measures
//! its accuracy.
//! `cargo run --release -p zenav-slam --example log` maps a simulated house, with arguments a CARMEN log.
//!
//! | file | answers |
//! |---|---|
//! | `order` | in which order were the scans of a log driven? |
//! | `slam` | what does the map hold, and how is a scan taken in? |
//! | `step` | what did a scan do to the map? |
//! | `front_end` | where is the robot, and does the map take the scan in? |
//! | `carried` | was the robot carried between two scans? |
//! | `doubt` | is the robot where the map says, elsewhere, or has the world changed? |
//! | `submap` | what does a short stretch of the drive look like? |
//! | `closure` | was the robot here before? |
//! | `drift` | how certain is a node's pose relative to an old submap? |
//! | `back_end` | which poses agree best? |
//! | `solve` | which poses are adopted while scans arrive, and are they certified? |
//! | `fixes` | what do GPS and compass say about the nodes? |
//! | `drawing` | what of the pose graph is drawn? |
//! | `finish` | where does each scan lie once all are known? |
//! | `session` | how is a map saved and continued later? |
//! | `joining` | where in an older map is this one, and is that certain? |
//! | `metric` | how far is a trajectory from reference relations? |
//! | `settings` | what can be tuned? |

mod back_end;
mod carried;
mod closure;
mod doubt;
mod drawing;
mod drift;
mod finish;
mod fixes;
mod front_end;
mod joining;
mod metric;
mod order;
mod session;
mod settings;
mod slam;
mod solve;
mod step;
mod submap;

pub use joining::{MergeError, merge, merge_timed};
pub use metric::{Relation, RelationError, RelationErrors, Spread, read_relations, relation_errors};
pub use order::{Disorder, Mended, Ordered, in_order};
pub use session::{MOST_BYTES, SessionError, Snapshot};
pub use settings::{ClosureSettings, FinishSettings, FrontSettings, SlamSettings};
pub use slam::Slam;
pub use solve::Solve;
pub use step::{Counts, Effects, SlamError};

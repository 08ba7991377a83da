//! SLAM in the plane. Where is the robot, and what does the world look like, from laser scans and odometry alone?
//!
//! # The problem
//!
//! Given scans, each with the odometry at its stamp; wanted are the poses `map_from_base` under which all scans draw one map. Odometry
//! knows short ways and drifts; a match with the map around knows where it is, or is wrong. Both are measurements of their own in one pose
//! graph:
//!
//! ```text
//! minimise   Σ odometry  +  Σ matches with growing submaps  +  Σ closures with older submaps (those that hold)
//! ```
//!
//! A step goes through these phases:
//!
//! 1. **points**: what the scan saw, in the frame of the base, thinned, the sweep straightened by odometry ([`points`](zenav_scan_matching::points())).
//! 2. **front**: after 0.1 m or 3 degrees the scan is refined on the older of two submaps that grow, with odometry as prior. Where the
//!    match is doubtful (its score, or how far it is from odometry), an exact search of a wide window decides. In between, scans are
//!    matched and make no node.
//! 3. **closure**: one inserted scan of six is searched for in the nearest older submap, by exact branch and bound, within three standard
//!    deviations of the covariance between the two; taken where it scores well, no second place is as good, the points are explained and
//!    the beams pass no walls. A match far from where it was expected needs a second scan that confirms it.
//! 4. **back end**: a new closure settles the graph; closures that do not fit fall out and may come back.
//!
//! [`Slam::finish`] ends a log: closures are decided anew ([`zenav_pose_graph::solve_robust`]), every scan is matched to submaps around
//! that it is not part of, and the result is certified.
//!
//! Sessions: [`Slam::save`] and [`Slam::load`] make a map bytes and back, [`Slam::begin_session`] begins another drive in it, [`merge`] makes
//! one map of two, [`Slam::trim`] drops what newer sessions have seen again.
//!
//! Frames: `map` begins at the first scan's base; `anchor` is the base at a submap's first scan; `base` and `laser` are the robot's.
//! Metres, radians, seconds. The core has no clock, no chance, no files: the same scans give the same map.
//!
//! # Use
//!
//! [`Slam::step`] takes a scan, [`Slam::finish`] ends the log, [`Slam::trajectory`] has a pose for each scan; [`relation_errors`] measures
//! it.
//! `cargo run --release -p zenav-slam --example log` maps a simulated house, with arguments a CARMEN log.
//!
//! | file | answers |
//! |---|---|
//! | `order` | which scans of a log come one after the other? |
//! | `slam` | where is the robot? |
//! | `step` | what did a scan do to the map? |
//! | `doubt` | is it, and if not, is it elsewhere, or has the world changed? |
//! | `submap` | what does a short stretch of the way look like? |
//! | `closure` | was the robot here before? |
//! | `drift` | how well is a node known as seen from an old submap? |
//! | `back_end` | which poses agree best? |
//! | `finish` | where does each scan lie once all are known? |
//! | `session` | how does a map go on at another time? |
//! | `joining` | where in an older map is this one, and is that certain? |
//! | `metric` | how far is a trajectory from reference relations? |
//! | `settings` | what can be tuned? |

mod back_end;
mod closure;
mod doubt;
mod drift;
mod finish;
mod joining;
mod metric;
mod order;
mod session;
mod settings;
mod slam;
mod step;
mod submap;

pub use joining::{MergeError, merge};
pub use metric::{Relation, RelationError, RelationErrors, Spread, read_relations, relation_errors};
pub use order::{Disorder, Ordered, in_order};
pub use session::{MOST_BYTES, SessionError, Snapshot};
pub use settings::{ClosureSettings, FinishSettings, FrontSettings, SlamSettings};
pub use slam::Slam;
pub use step::{Counts, Effects, SlamError};

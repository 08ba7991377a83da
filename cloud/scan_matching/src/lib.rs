//! Scan matching in the plane. Finds where a laser scan was taken, how certain that is, and whether the scan fits at all.
//!
//! # The problem
//!
//! Given points `p₁ … pₙ` that a scan saw in its own frame and a map as a [`LikelihoodField`] `m`, 0 to 1; wanted is the pose
//! `T = field_from_scan` that
//!
//! ```text
//! maximises   (1/n) Σ m(T pᵢ)      within a window of poses
//! ```
//!
//! and its margin over any other place. It is solved in three steps:
//!
//! 1. **search** ([`search()`]): exact branch and bound over cells and headings, with bounds from a [`Pyramid`]; yields the best pose of
//!    the window, and the second-best place.
//! 2. **refinement** ([`refine()`]): Gauss-Newton beyond cells, with a prior; yields the information matrix of the scan alone, and a
//!    direction that the scan does not constrain (a corridor). If the map was drawn from scans, [`Surfels`] make it exact
//!    ([`Refinable::polish`]).
//! 3. **verdict** ([`judge()`]): the share of the points that the map explains, and of the beams that pass through its walls.
//!
//! Frames: `field` is the map's, `scan` that of the points. Metres, radians, yaw counter-clockwise.
//!
//! # Use
//!
//! `cargo run -p zenav-scan-matching --example find_in_a_room` finds a scan in a room without a guess.
//!
//! | file | answers |
//! |---|---|
//! | `points` | which points did a scan see? |
//! | `field` | how near is a point to a known surface? |
//! | `pyramid` | what can a block of positions score at most? |
//! | `headings` | which headings are tried, and where do points fall at each? |
//! | `search` | which pose of a window fits best, and by how much? |
//! | `refine` | where exactly, and how certain is that? |
//! | `normals` | what is the normal of the surface at a point? |
//! | `surfels` | where exactly is the surface that a point was seen on? |
//! | `verdict` | does the scan fit? |
//! | `information` | how certain are odometry and matches? |
//! | `odometry` | how good is odometry, as shown by matches? |
//! | `settings` | what can be tuned? |

mod field;
mod headings;
mod information;
mod normals;
mod odometry;
mod points;
mod pyramid;
mod refine;
mod search;
mod settings;
mod surfels;
mod verdict;

pub use field::LikelihoodField;
pub use headings::heading_step;
pub use information::{floored, odometry_information, turned};
pub use odometry::{ExpectedStep, OdometryFilter};
pub use points::points;
pub use pyramid::Pyramid;
pub use refine::{Prior, Refinable, Refined, refine};
pub use search::{Candidate, Search, Window, search, search_among};
pub use settings::{FieldSettings, OdometrySettings, RefineSettings, ScanSettings, VerdictSettings};
pub use surfels::Surfels;
pub use verdict::{Verdict, judge, standing};

//! Pose graphs in the plane. Finds the poses that agree best with relative measurements, and certifies, if possible, that no answer is
//! better.
//!
//! # The problem
//!
//! Nodes are poses `xᵢ = (tᵢ, θᵢ)` in the map's frame. An edge measures node `j` from node `i`, `zᵢⱼ`, with the information matrix `Ωᵢⱼ`
//! (3x3: x, y in 1/m², yaw in 1/rad², in the frame of g2o: that of the measured pose). Wanted is
//!
//! ```text
//! minimise   Σ wᵢⱼ eᵢⱼᵀ Ωᵢⱼ eᵢⱼ       eᵢⱼ = zᵢⱼ⁻¹ · (xᵢ⁻¹ · xⱼ)  as (x, y, yaw)
//! ```
//!
//! over all poses but one, the anchor. The weights `w` are 1, or 0 for a false loop closure. It is solved in phases:
//!
//! 1. **consistency** (as [`supported()`]): closures that agree with another one around a short cycle (Mangelson et al. 2018, pairwise
//!    consistency), and better than false ones do by chance.
//! 2. **start** ([`chordal_start()`]): rotations from a linear problem, then positions from another (Carlone et al. 2015).
//! 3. **companion** ([`certify()`]): the same graph with isotropic weights and the chordal distance of rotations, minimised by Newton's
//!    method, with positions following rotations at each step. With complex `zᵢ = exp(i θᵢ)` its cost is a Hermitian form `x* M x`, and
//!    with `λᵢ = Re(z̄ᵢ (M x)ᵢ)` its stationary point is the **global optimum** if `S = M - diag(0, λ)` has no negative eigenvalue (Carlone
//!    et al. 2016; Rosen et al. 2019). One sparse factorisation counts them, by Sylvester's law of inertia.
//! 4. **descent** ([`descend()`]): Gauss-Newton from there, with Marquardt's damping where needed.
//! 5. **robust weights** ([`solve_robust()`]): graduated non-convexity with truncated least squares (Yang et al. 2020) decides on closures
//!    that agree; then **evidence** on all others: a closure is accepted if it lies within chi squared of what the accepted edges foresee, and
//!    if no false closure may be expected to fit as well.
//!
//! Linear systems are sparse, of blocks that [`amd`] orders, factorised as LDLᵀ.
//!
//! Meaning of a certificate: with these weights, no other arrangement of the nodes has a lower cost in the companion problem, and the
//! solution returned lies in the valley that the companion's optimum leads to. It does not say whether the measurements are true.
//!
//! # Use
//!
//! [`solve()`] and [`solve_robust()`] run all phases; [`marginal_covariance()`] returns the uncertainty of nodes; [`g2o`] reads and writes
//! files.
//! `cargo run -p zenav-pose-graph --example manhattan` solves a graph of its own with false closures.
//!
//! | file | answers |
//! |---|---|
//! | `graph` | what is given: nodes, edges, anchor? |
//! | `g2o` | how is a graph written to a file? |
//! | `solver` | which poses agree best, all phases together? |
//! | `start` | where does the descent begin? |
//! | `descent` | how is the cost of the measurements minimised? |
//! | `companion`, `certificate` | is there no better valley? |
//! | `consistency`, `robust`, `evidence` | which closures are false? |
//! | `chance` | how many false closures may be expected to fit as well? |
//! | `covariance` | how certain are nodes? |
//! | `uncertain` | how certain is a node along a chain of measurements? |
//! | `reduced` | what remains known when nodes are dropped? |
//! | `linear` | how is a sparse system of blocks solved? |
//! | `settings` | what can be tuned? |

mod certificate;
mod chance;
mod companion;
mod consistency;
mod covariance;
mod descent;
mod evidence;
pub mod g2o;
mod graph;
mod linear;
mod reduced;
mod robust;
mod settings;
mod solver;
mod start;
mod uncertain;

pub use certificate::{Certificate, Optimality, certify};
pub use consistency::supported;
pub use covariance::{marginal_covariance, relative_covariance};
pub use descent::{Descent, DescentStatus, chi_squared, descend, edge_chi_squared};
pub use graph::{Edge, EdgeKind, GraphError, PoseGraph};
pub use reduced::composed_edges;
pub use robust::{RobustSolution, solve_robust};
pub use settings::{DescentSettings, RobustSettings};
pub use solver::{Solution, SolveError, Unknown, solve};
pub use start::{chordal_start, odometry_start};
pub use uncertain::Uncertain;

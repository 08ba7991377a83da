//! Solve. Which poses agree best with everything measured so far, and is that proven?
//!
//! A solve is made of a copy of the graph. Beside a robot, scans do not wait for it: its poses are adopted with a later scan, and nodes
//! inserted meanwhile move with the last one of the solve. Which scan that is follows from the stamps and from the number of nodes alone, so
//! the map is the same whether another thread has computed the solve until then or not.

use std::sync::{Arc, OnceLock};

use zenav_pose_graph::{
    DescentSettings, DescentStatus, GraphError, Optimality, PoseGraph, RobustSettings, certify, descend,
};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::GraphCertificate;

use crate::back_end::{BackEnd, settle};
use crate::fixes::{Factor, in_world};
use crate::slam::Slam;

/// While scans arrive, the graph need not be fully converged.
const BETWEEN: DescentSettings = DescentSettings {
    max_iterations: 4,
    tolerance: 1e-4,
};
/// Time from the start of a solve to the adoption of its poses beside a robot, by the stamps of scans, s for each node: about its processor
/// time.
const ADOPTED_AFTER: f64 = 2e-5;
/// Farthest that a node may be from its certified pose, m and rad.
const AT_BOTTOM: (f64, f64) = (0.01, 0.002);

/// A solve of the graph while scans arrive, and the proof of its result.
#[derive(Debug)]
pub struct Solve {
    graph: PoseGraph,
    weights: Vec<f64>,
    factors: Vec<Factor>,
    /// Where the first node was begun, `map_from_node`.
    start: Pose2,
    robust: RobustSettings,
    settled: OnceLock<Result<Settled, GraphError>>,
    certificate: OnceLock<GraphCertificate>,
}

/// The result of a solve, for the nodes and edges that it began with.
#[derive(Debug)]
pub(crate) struct Settled {
    /// The graph at its new poses; with factors, its first node is the world.
    problem: PoseGraph,
    /// Those of the graph's edges, then those of its factors.
    weights: Vec<f64>,
    /// Number of edges.
    edges: usize,
    is_in_world: bool,
}

impl Settled {
    /// `map_from_node`.
    pub(crate) fn poses(&self) -> &[Pose2] {
        &self.problem.poses()[usize::from(self.is_in_world)..]
    }

    /// Weights of the edges.
    pub(crate) fn weights(&self) -> &[f64] {
        &self.weights[..self.edges]
    }

    /// Weights of the factors.
    pub(crate) fn factor_weights(&self) -> &[f64] {
        &self.weights[self.edges..]
    }

    /// The verdict on the bottom of the valley that the solve ended in: the solve stops when little is left to gain. Unknown if the bottom
    /// is farther away than [`AT_BOTTOM`].
    fn certificate(&self) -> GraphCertificate {
        let (problem, weights) = (&self.problem, &self.weights);
        let bottom = descend(problem, problem.poses(), weights, &DescentSettings::default());
        let (way, turn) = AT_BOTTOM;
        let is_near = |(adopted, best): (&Pose2, &Pose2)| {
            adopted.distance(best) <= way && wrap_angle(best.yaw - adopted.yaw).abs() <= turn
        };
        let is_at_bottom = problem.poses().iter().zip(&bottom.poses).all(is_near);
        if bottom.status != DescentStatus::Converged || !is_at_bottom {
            return GraphCertificate::Unknown;
        }
        match certify(problem, &bottom.poses, weights).optimality {
            Optimality::Certified => GraphCertificate::Certified,
            Optimality::Refused => GraphCertificate::Refused,
            Optimality::Elsewhere => GraphCertificate::Elsewhere,
            Optimality::Unknown => GraphCertificate::Unknown,
        }
    }
}

impl Solve {
    fn of(back_end: &BackEnd, start: Pose2, robust: &RobustSettings) -> Self {
        Self {
            graph: back_end.graph().clone(),
            weights: back_end.weights().to_vec(),
            factors: back_end.factors().to_vec(),
            start,
            robust: *robust,
            settled: OnceLock::new(),
            certificate: OnceLock::new(),
        }
    }

    /// Computes the poses, then their certificate; each is computed once, whoever asks first. Cost: up to some twenty sparse factorisations,
    /// about half of them for the certificate.
    pub fn run(&self) {
        let settled = self.settled();
        self.certificate.get_or_init(|| match settled {
            Ok(settled) => settled.certificate(),
            Err(_) => GraphCertificate::Unknown,
        });
    }

    fn settled(&self) -> &Result<Settled, GraphError> {
        self.settled.get_or_init(|| {
            let is_in_world = !self.factors.is_empty();
            let (mut problem, mut weights) = if is_in_world {
                in_world(&self.graph, &self.weights, &self.factors, self.start)?
            } else {
                (self.graph.clone(), self.weights.clone())
            };
            settle(&mut problem, &mut weights, &BETWEEN, &self.robust)?;
            Ok(Settled {
                problem,
                weights,
                edges: self.weights.len(),
                is_in_world,
            })
        })
    }
}

impl Slam {
    /// The last solve while scans arrive; [`Effects::begins_solve`](crate::Effects::begins_solve) reports a new one. Whoever has a thread
    /// to spare may [run](Solve::run) it before the scan that adopts its poses; without that, its certificate is never computed.
    #[must_use]
    pub fn last_solve(&self) -> Option<&Arc<Solve>> {
        self.solve.as_ref()
    }

    /// Whether the poses of the [last solve](Self::last_solve) are certified. Pending until they are adopted and the proof was computed.
    /// [`Self::finish`] has a certificate of its own.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// use zenav_protocol::messages::GraphCertificate;
    ///
    /// // Without a closure there is nothing to solve.
    /// assert_eq!(slam.certificate(), GraphCertificate::NotSolved);
    /// assert!(slam.last_solve().is_none());
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn certificate(&self) -> GraphCertificate {
        let Some(solve) = &self.solve else {
            return GraphCertificate::NotSolved;
        };
        let proven = solve.certificate.get().filter(|_| self.adopts_at.is_none());
        proven.copied().unwrap_or(GraphCertificate::Pending)
    }

    /// Whether a scan at a stamp, s, adopts poses of the last solve that are not computed yet. Whoever must not wait in [`Self::step`] lets
    /// the solve be [run](Solve::run) before.
    #[must_use]
    pub fn waits_for_solve(&self, stamp: f64) -> bool {
        let solve = self.solve.as_ref().filter(|_| self.is_adoption_due(stamp));
        solve.is_some_and(|solve| solve.settled.get().is_none())
    }

    fn is_adoption_due(&self, stamp: f64) -> bool {
        self.adopts_at.is_some_and(|at| stamp >= at)
    }

    /// Begins a solve at a scan's stamp, s. Its poses are adopted at once in a log, and later beside a robot.
    pub(crate) fn begin_solve(&mut self, stamp: f64) {
        let nodes = if self.keeps_all { 0 } else { self.scans.len() };
        self.solve = Some(Arc::new(Solve::of(&self.back_end, self.start, &self.settings.robust)));
        self.adopts_at = Some(stamp + ADOPTED_AFTER * nodes as f64);
        self.is_dirty = false;
    }

    /// Adopts the poses of the last solve if that is due at a stamp, s. Returns how the surroundings of the newest node moved.
    pub(crate) fn adopt_solve(&mut self, stamp: f64) -> Result<Option<Pose2>, GraphError> {
        if !self.is_adoption_due(stamp) {
            return Ok(None);
        }
        self.adopts_at = None;
        let Some(solve) = &self.solve else {
            return Ok(None);
        };
        let settled = solve.settled().as_ref().map_err(Clone::clone)?;
        self.back_end.adopt(settled).map(Some)
    }

    /// Forgets the last solve, because the graph is no longer the one that it began with. If its poses were not adopted yet, another one is
    /// due.
    pub(crate) fn drop_solve(&mut self) {
        self.is_dirty |= self.adopts_at.take().is_some();
        self.solve = None;
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Matrix3;
    use zenav_pose_graph::{Edge, EdgeKind};

    use super::*;

    const NODES: usize = 40;

    /// A ring of trusted measurements, its nodes wound around it this many times: once is the truth, twice a wrong valley.
    fn ring(wound: f64) -> Solve {
        let turn = std::f64::consts::TAU / NODES as f64;
        let (mut graph, mut pose) = (BackEnd::default(), Pose2::IDENTITY);
        for _ in 0..NODES {
            graph.add_node(pose).unwrap();
            pose = pose * Pose2::new(1.0, 0.0, wound * turn);
        }
        for from in 0..NODES {
            let edge = Edge {
                from,
                to: (from + 1) % NODES,
                measurement: Pose2::new(1.0, 0.0, turn),
                information: Matrix3::from_diagonal(&[400.0, 400.0, 2500.0].into()),
                kind: EdgeKind::Odometry,
            };
            graph.add_edge(edge).unwrap();
        }
        Solve::of(&graph, Pose2::IDENTITY, &RobustSettings::default())
    }

    #[test]
    fn a_solve_is_certified_in_the_right_valley_and_not_in_a_wrong_one() {
        let certified = |solve: Solve| {
            solve.run();
            *solve.certificate.get().unwrap()
        };
        assert_eq!(certified(ring(1.0)), GraphCertificate::Certified);
        let wrong = certified(ring(2.0));
        assert!(
            matches!(wrong, GraphCertificate::Refused | GraphCertificate::Unknown),
            "{wrong:?}"
        );
    }

    #[test]
    fn poses_away_from_the_bottom_of_their_valley_are_not_said_to_be_certified() {
        let at = |off: f64| {
            let Solve { graph, weights, .. } = ring(1.0);
            let mut settled = Settled {
                problem: graph,
                edges: weights.len(),
                weights,
                is_in_world: false,
            };
            let mut poses = settled.poses().to_vec();
            poses[NODES / 2].x += off;
            settled.problem.set_poses(&poses).unwrap();
            settled.certificate()
        };
        assert_eq!(at(0.005), GraphCertificate::Certified);
        assert_eq!(at(0.05), GraphCertificate::Unknown);
    }
}

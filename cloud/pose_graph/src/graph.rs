//! Pose graph. Nodes, and measurements between them.

use nalgebra::Matrix3;
use thiserror::Error;
use zenav_protocol::geometry::Pose2;

/// Negative eigenvalues of an information matrix down to this share of the largest are rounding.
const SEMIDEFINITE: f64 = 1e-6;
/// The same where every digit counts.
const ROUNDING: f64 = 1e-12;

/// Origin of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EdgeKind {
    /// Odometry, or a match between neighbours: trusted.
    Odometry,
    /// A recognised place: may be false.
    Closure,
}

/// A relative measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Edge {
    /// Index of the node from which the measurement is taken.
    pub from: usize,
    /// Index of the measured node.
    pub to: usize,
    /// `from_from_to`: pose of `to` in the frame of `from`, m and rad.
    pub measurement: Pose2,
    /// Information of x, y, yaw in the frame of the measured pose, 1/m², 1/(m rad), 1/rad²: symmetric, without negative eigenvalues; all
    /// edges together must constrain the yaw and each direction of the plane.
    pub information: Matrix3<f64>,
    /// Whether it may be false.
    pub kind: EdgeKind,
}

/// Why a node or edge cannot be added to a graph.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum GraphError {
    /// The edge refers to a node that was not added: add nodes first.
    #[error("node {node} of {nodes} does not exist")]
    NoSuchNode {
        /// The index.
        node: usize,
        /// Number of nodes.
        nodes: usize,
    },
    /// Both ends are the same node.
    #[error("an edge from node {0} to itself measures nothing")]
    Loop(usize),
    /// A number of a pose, measurement or information matrix is not finite.
    #[error("a number of {0} is not finite")]
    NotFinite(&'static str),
    /// The information matrix is not symmetric, or has a negative eigenvalue: it is not the inverse of a covariance.
    #[error("the information matrix is not symmetric and positive semidefinite")]
    Information,
    /// The information matrix is zero: leave the measurement out.
    #[error("the information matrix is zero: the edge measures nothing, leave it out")]
    NoInformation,
}

/// Nodes, and measurements between them. Indices count from 0 in order of insertion.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PoseGraph {
    poses: Vec<Pose2>,
    edges: Vec<Edge>,
}

impl PoseGraph {
    /// A graph without nodes.
    #[must_use]
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a node at an initial guess `map_from_node`; returns its index. The first node is the anchor, which never moves.
    ///
    /// ```
    /// use zenav_pose_graph::{GraphError, PoseGraph};
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// let mut graph = PoseGraph::new();
    /// assert_eq!(graph.add_node(Pose2::IDENTITY), Ok(0), "the anchor");
    /// assert_eq!(graph.add_node(Pose2::new(1.0, 0.0, 0.1)), Ok(1));
    /// assert_eq!(graph.add_node(Pose2::new(f64::NAN, 0.0, 0.0)), Err(GraphError::NotFinite("a pose")));
    /// ```
    ///
    /// # Errors
    /// [`GraphError::NotFinite`].
    pub fn add_node(&mut self, map_from_node: Pose2) -> Result<usize, GraphError> {
        if !map_from_node.is_finite() {
            return Err(GraphError::NotFinite("a pose"));
        }
        self.poses.push(map_from_node);
        Ok(self.poses.len() - 1)
    }

    /// Adds a measurement; returns its index.
    ///
    /// ```
    /// use nalgebra::Matrix3;
    /// use zenav_pose_graph::{Edge, EdgeKind, GraphError, PoseGraph};
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// let mut graph = PoseGraph::new();
    /// let (from, to) = (graph.add_node(Pose2::IDENTITY)?, graph.add_node(Pose2::new(1.0, 0.0, 0.0))?);
    /// // Standard deviations of 0.1 m and 0.05 rad.
    /// let information = Matrix3::from_diagonal(&[100.0, 100.0, 400.0].into());
    /// let step = Edge { from, to, measurement: Pose2::new(1.1, 0.0, 0.0), information, kind: EdgeKind::Odometry };
    /// assert_eq!(graph.add_edge(step), Ok(0));
    /// assert_eq!(graph.add_edge(Edge { to: 2, ..step }), Err(GraphError::NoSuchNode { node: 2, nodes: 2 }));
    /// assert_eq!(graph.add_edge(Edge { information: -information, ..step }), Err(GraphError::Information));
    /// # Ok::<(), GraphError>(())
    /// ```
    ///
    /// # Errors
    /// An end that does not exist, identical ends, a number that is not finite, an information matrix that is invalid or zero.
    pub fn add_edge(&mut self, edge: Edge) -> Result<usize, GraphError> {
        let nodes = self.poses.len();
        for node in [edge.from, edge.to] {
            if node >= nodes {
                return Err(GraphError::NoSuchNode { node, nodes });
            }
        }
        if edge.from == edge.to {
            return Err(GraphError::Loop(edge.from));
        }
        if !edge.measurement.is_finite() {
            return Err(GraphError::NotFinite("a measurement"));
        }
        check(&edge.information)?;
        self.edges.push(edge);
        Ok(self.edges.len() - 1)
    }

    /// Moves all nodes.
    ///
    /// ```
    /// use zenav_pose_graph::PoseGraph;
    /// use zenav_protocol::geometry::Pose2;
    ///
    /// let mut graph = PoseGraph::new();
    /// graph.add_node(Pose2::IDENTITY)?;
    /// graph.set_poses(&[Pose2::new(3.0, 4.0, 0.0)])?;
    /// assert_eq!(graph.poses(), [Pose2::new(3.0, 4.0, 0.0)]);
    /// assert!(graph.set_poses(&[]).is_err(), "one for each node");
    /// # Ok::<(), zenav_pose_graph::GraphError>(())
    /// ```
    ///
    /// # Errors
    /// [`GraphError::NoSuchNode`] if the number of poses differs, [`GraphError::NotFinite`].
    pub fn set_poses(&mut self, poses: &[Pose2]) -> Result<(), GraphError> {
        if poses.len() != self.poses.len() {
            return Err(GraphError::NoSuchNode {
                node: poses.len(),
                nodes: self.poses.len(),
            });
        }
        if !poses.iter().all(Pose2::is_finite) {
            return Err(GraphError::NotFinite("a pose"));
        }
        self.poses.copy_from_slice(poses);
        Ok(())
    }

    /// `map_from_node` of each node: the initial guesses, or as set since.
    #[must_use]
    pub fn poses(&self) -> &[Pose2] {
        &self.poses
    }

    /// All measurements.
    #[must_use]
    pub fn edges(&self) -> &[Edge] {
        &self.edges
    }

    /// The first node that is not connected to the anchor by edges with a weight above zero.
    pub(crate) fn disconnected(&self, weights: &[f64]) -> Option<usize> {
        let mut parent: Vec<usize> = (0..self.poses.len()).collect();
        fn root(parent: &mut [usize], mut node: usize) -> usize {
            while parent[node] != node {
                parent[node] = parent[parent[node]];
                node = parent[node];
            }
            node
        }
        for (edge, weight) in self.edges.iter().zip(weights) {
            if *weight > 0.0 {
                let (a, b) = (root(&mut parent, edge.from), root(&mut parent, edge.to));
                parent[a.max(b)] = a.min(b);
            }
        }
        (0..self.poses.len()).find(|node| root(&mut parent, *node) != 0)
    }
}

/// Checks an information matrix.
fn check(information: &Matrix3<f64>) -> Result<(), GraphError> {
    if !information.iter().all(|entry| entry.is_finite()) {
        return Err(GraphError::NotFinite("an information matrix"));
    }
    let largest = information.amax();
    if largest == 0.0 {
        return Err(GraphError::NoInformation);
    }
    let is_symmetric = (information - information.transpose()).amax() <= SEMIDEFINITE * largest;
    if is_symmetric && information.symmetric_eigenvalues().min() >= -SEMIDEFINITE * largest {
        Ok(())
    } else {
        Err(GraphError::Information)
    }
}

/// Whether a symmetric matrix of finite numbers has no negative eigenvalue, be it scaled to ones on its diagonal: information on metres and on
/// radians may differ by a factor of a million, and a share of the largest entry says nothing about the smaller ones.
pub(crate) fn is_semidefinite_scaled(information: &Matrix3<f64>) -> bool {
    if information.symmetric_eigenvalues().min() >= -ROUNDING * information.amax() {
        return true;
    }
    let diagonal = information.diagonal();
    if diagonal.min() <= 0.0 {
        return false;
    }
    let scale = Matrix3::from_diagonal(&diagonal.map(|entry| entry.sqrt().recip()));
    let scaled = scale * information * scale;
    scaled.iter().all(|entry| entry.is_finite()) && scaled.symmetric_eigenvalues().min() >= -SEMIDEFINITE
}

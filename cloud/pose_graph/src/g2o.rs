//! g2o files. Reads and writes pose graphs in the plane.
//!
//! The text format of g2o (Kuemmerle et al. 2011): `VERTEX_SE2 id x y yaw`, `EDGE_SE2 from to x y yaw I11 I12 I13 I22 I23 I33` with the
//! upper triangle of the information matrix, row by row; `FIX id` names the vertex that never moves, of which there can be one; comments
//! (`#`) and parameters of sensors (`PARAMS_…`) are skipped. Lengths are metres, angles radians. The same in TORO's format (Grisetti et al.
//! 2007) is read, too: `VERTEX2`, and `EDGE2`, whose information is `I11 I12 I22 I33 I13 I23`.
//!
//! The format does not mark loop closures. An edge between ids that differ by 1 is odometry, any other a closure. If hardly any differ by 1,
//! as where other vertices were taken out, an edge between ids that follow each other is odometry.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use nalgebra::Matrix3;
use thiserror::Error;
use zenav_protocol::geometry::Pose2;

use crate::graph::{Edge, EdgeKind, GraphError, PoseGraph, is_semidefinite_scaled};
use crate::start::odometry_start;

/// A graph, and the ids of its nodes in the file.
#[derive(Clone, Debug, PartialEq)]
pub struct Document {
    /// The graph; the fixed vertex comes first, as the anchor, then all others in the order of their ids. Without a fixed vertex the lowest
    /// id is the anchor.
    pub graph: PoseGraph,
    /// The id of each node.
    pub ids: Vec<u64>,
}

/// Why a file is not a graph.
///
/// ```
/// use zenav_pose_graph::g2o;
///
/// let mistake = g2o::read("VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 zero 0\n").unwrap_err();
/// assert_eq!(mistake.to_string(), "line 2, field 4: expected y in metres, found `zero`");
/// let spatial = g2o::read("VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n").unwrap_err();
/// assert!(spatial.to_string().starts_with("line 1, field 1: expected VERTEX_SE2"));
/// ```
#[derive(Clone, Debug, PartialEq, Error)]
pub enum G2oError {
    /// A field is malformed: correct the line.
    #[error("line {line}, field {field}: {what}")]
    Field {
        /// Number of the line, from 1.
        line: usize,
        /// Number of the word in the line, from 1: the tag is 1.
        field: usize,
        /// What was expected, and what was found.
        what: String,
    },
    /// The line is well formed, but its content is invalid.
    #[error("line {line}: {source}")]
    Graph {
        /// Number of the line, from 1.
        line: usize,
        /// Why it is invalid.
        source: GraphError,
    },
}

/// An edge's line in a file, its ends by id, and its data.
#[derive(Clone, Copy)]
struct EdgeLine {
    line: usize,
    from: u64,
    to: u64,
    measurement: Pose2,
    information: Matrix3<f64>,
}

/// The fixed vertex, and the number of its line, from 1.
#[derive(Clone, Copy)]
struct Fixed {
    line: usize,
    id: u64,
}

/// Edges that count as odometry.
enum Odometry {
    /// Between ids that differ by 1.
    ByOne,
    /// Between ids that follow each other: the number of each vertex.
    ByRank(BTreeMap<u64, usize>),
}

impl Odometry {
    /// By the vertices' ids, ascending, and the edges.
    fn of(ids: impl Iterator<Item = u64>, edges: &[EdgeLine]) -> Self {
        let ranks: BTreeMap<u64, usize> = ids.zip(0..).collect();
        let by_one = edges.iter().filter(|edge| edge.from.abs_diff(edge.to) == 1).count();
        if SELDOM * by_one < ranks.len() {
            Self::ByRank(ranks)
        } else {
            Self::ByOne
        }
    }

    fn kind(&self, edge: &EdgeLine) -> EdgeKind {
        let apart = match self {
            Self::ByOne => edge.from.abs_diff(edge.to),
            Self::ByRank(ranks) => ranks[&edge.from].abs_diff(ranks[&edge.to]) as u64,
        };
        if apart == 1 {
            EdgeKind::Odometry
        } else {
            EdgeKind::Closure
        }
    }
}

/// Reads the text of a file. Nodes that only edges name start at their pose by odometry.
///
/// ```
/// let text = "EDGE_SE2 3 4 1 0 0 100 0 0 100 0 400\nEDGE_SE2 4 5 1 0 1.57 100 0 0 100 0 400\n";
/// let document = zenav_pose_graph::g2o::read(text)?;
/// assert_eq!(document.ids, [3, 4, 5]);
/// assert_eq!(document.graph.poses()[2].x, 2.0);
/// # Ok::<(), zenav_pose_graph::g2o::G2oError>(())
/// ```
///
/// # Errors
/// The first line and field that is malformed or of another kind (3D, landmarks), a second fixed vertex, or the line of the first invalid
/// edge.
pub fn read(text: &str) -> Result<Document, G2oError> {
    let mut vertices: BTreeMap<u64, Option<Pose2>> = BTreeMap::new();
    let mut lines: Vec<EdgeLine> = Vec::new();
    let mut fixed: Option<Fixed> = None;
    for (number, line) in (1..).zip(text.lines()) {
        let mut words = Words::new(number, line);
        match words.next() {
            None => continue,
            Some(tag) if tag.starts_with('#') || tag.starts_with("PARAMS_") => continue,
            Some("FIX") => {
                let mut id = words.id("the id of a vertex")?;
                loop {
                    if let Some(before) = fixed.filter(|before| before.id != id) {
                        let what = format!("expected one fixed vertex, found {id} beside {}", before.id);
                        return Err(words.wrong(what));
                    }
                    fixed = Some(Fixed { line: number, id });
                    if words.is_at_end() {
                        break;
                    }
                    id = words.id("the id of a vertex")?;
                }
            }
            Some("VERTEX_SE2" | "VERTEX2") => {
                let id = words.id("an id")?;
                let pose = words.pose()?;
                if let Some(Some(before)) = vertices.insert(id, Some(pose))
                    && before != pose
                {
                    return Err(words.wrong_at(2, format!("expected a new id, found {id} again")));
                }
            }
            Some(tag @ ("EDGE_SE2" | "EDGE2")) => {
                let edge = words.edge(if tag == "EDGE2" { &TORO } else { &UPPER })?;
                for id in [edge.from, edge.to] {
                    vertices.entry(id).or_insert(None);
                }
                lines.push(edge);
            }
            Some(tag) => {
                let found: String = tag.chars().take(40).collect();
                return Err(words.wrong(format!("expected VERTEX_SE2, EDGE_SE2 or FIX, found `{found}`")));
            }
        }
        words.end()?;
    }
    let ids = in_order(&vertices, fixed)?;
    let mut graph = PoseGraph::new();
    for id in &ids {
        // All numbers were checked when read.
        graph
            .add_node(vertices[id].unwrap_or_default())
            .map_err(|source| G2oError::Graph { line: 0, source })?;
    }
    let indices: BTreeMap<u64, usize> = ids.iter().copied().zip(0..).collect();
    let odometry = Odometry::of(vertices.keys().copied(), &lines);
    for edge in lines {
        let built = Edge {
            from: indices[&edge.from],
            to: indices[&edge.to],
            measurement: edge.measurement,
            information: edge.information,
            kind: odometry.kind(&edge),
        };
        let line = edge.line;
        graph
            .add_edge(built)
            .map_err(|source| G2oError::Graph { line, source })?;
        if !is_semidefinite_scaled(&built.information) {
            let source = GraphError::Information;
            return Err(G2oError::Graph { line, source });
        }
    }
    if vertices.values().any(Option::is_none) {
        let known: Vec<bool> = ids.iter().map(|id| vertices[id].is_some()).collect();
        let start = odometry_start(&graph, &known);
        graph
            .set_poses(&start)
            .map_err(|source| G2oError::Graph { line: 0, source })?;
    }
    Ok(Document { graph, ids })
}

/// The ids of all vertices: the fixed one, then the others, ascending.
fn in_order(vertices: &BTreeMap<u64, Option<Pose2>>, fixed: Option<Fixed>) -> Result<Vec<u64>, G2oError> {
    let Some(Fixed { line, id: fixed }) = fixed else {
        return Ok(vertices.keys().copied().collect());
    };
    if !vertices.contains_key(&fixed) {
        return Err(G2oError::Field {
            line,
            field: 2,
            what: format!("expected the id of a vertex, found {fixed}"),
        });
    }
    let others = vertices.keys().copied().filter(|id| *id != fixed);
    Ok(std::iter::once(fixed).chain(others).collect())
}

/// Writes the text of a file: vertices, the anchor as `FIX`, edges. [`read`] returns the same graph, bit for bit; but edges are odometry or
/// closures by their ids, since the format cannot mark them.
///
/// A node without an id in `ids` gets its index.
///
/// ```
/// use zenav_pose_graph::g2o;
///
/// let document = g2o::read("EDGE_SE2 7 8 1 0 0.1 100 0 0 100 0 400\n")?;
/// let text = g2o::write(&document.graph, &document.ids);
/// assert!(text.starts_with("VERTEX_SE2 7 0 0 0\nFIX 7\n"), "{text}");
/// assert_eq!(g2o::read(&text)?, document);
/// # Ok::<(), g2o::G2oError>(())
/// ```
#[must_use]
pub fn write(graph: &PoseGraph, ids: &[u64]) -> String {
    write_weighted(graph, ids, &[])
}

/// [`write()`], with an edge of weight 0 as a comment: it was held to be false, and whoever reads the file should not heed it. `weights`: one
/// for each edge; 1 where there is none.
///
/// ```
/// use zenav_pose_graph::g2o;
///
/// let text = "EDGE_SE2 0 1 1 0 0 100 0 0 100 0 400\nEDGE_SE2 0 1 9 0 0 100 0 0 100 0 400\n";
/// let document = g2o::read(text)?;
/// let written = g2o::write_weighted(&document.graph, &document.ids, &[1.0, 0.0]);
/// assert!(written.ends_with("\n# EDGE_SE2 0 1 9 0 0 100 0 0 100 0 400\n"), "{written}");
/// assert_eq!(g2o::read(&written)?.graph.edges().len(), 1);
/// # Ok::<(), g2o::G2oError>(())
/// ```
#[must_use]
pub fn write_weighted(graph: &PoseGraph, ids: &[u64], weights: &[f64]) -> String {
    let id = |node: usize| ids.get(node).copied().unwrap_or(node as u64);
    let mut text = String::new();
    for (node, pose) in graph.poses().iter().enumerate() {
        // Writing to a string does not fail.
        let _ = writeln!(text, "VERTEX_SE2 {} {} {} {}", id(node), pose.x, pose.y, pose.yaw);
        if node == 0 {
            let _ = writeln!(text, "FIX {}", id(0));
        }
    }
    for (index, edge) in graph.edges().iter().enumerate() {
        if weights.get(index).is_some_and(|weight| *weight == 0.0) {
            text.push_str("# ");
        }
        let Pose2 { x, y, yaw } = edge.measurement;
        let _ = write!(text, "EDGE_SE2 {} {} {x} {y} {yaw}", id(edge.from), id(edge.to));
        for (row, column) in UPPER {
            let _ = write!(text, " {}", edge.information[(row, column)]);
        }
        text.push('\n');
    }
    text
}

/// The upper triangle, row by row.
const UPPER: [(usize, usize); 6] = [(0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)];
/// The upper triangle in TORO's order.
const TORO: [(usize, usize); 6] = [(0, 0), (0, 1), (1, 1), (2, 2), (0, 2), (1, 2)];
/// Ids seldom differ by 1 if there are more than this many vertices for each such edge.
const SELDOM: usize = 4;

struct Words<'t> {
    line: usize,
    field: usize,
    words: std::str::SplitAsciiWhitespace<'t>,
}

impl<'t> Words<'t> {
    fn new(line: usize, text: &'t str) -> Self {
        Self {
            line,
            field: 0,
            words: text.split_ascii_whitespace(),
        }
    }

    fn next(&mut self) -> Option<&'t str> {
        self.field += 1;
        self.words.next()
    }

    fn is_at_end(&self) -> bool {
        self.words.clone().next().is_none()
    }

    fn wrong(&self, what: String) -> G2oError {
        self.wrong_at(self.field, what)
    }

    fn wrong_at(&self, field: usize, what: String) -> G2oError {
        G2oError::Field {
            line: self.line,
            field,
            what,
        }
    }

    fn parsed<T: std::str::FromStr>(&mut self, what: &str, is_valid: impl Fn(&T) -> bool) -> Result<T, G2oError> {
        match self.next() {
            None => Err(self.wrong(format!("expected {what}, found the end of the line"))),
            Some(word) => word.parse().ok().filter(is_valid).ok_or_else(|| {
                let found: String = word.chars().take(40).collect();
                self.wrong(format!("expected {what}, found `{found}`"))
            }),
        }
    }

    fn id(&mut self, what: &str) -> Result<u64, G2oError> {
        self.parsed(what, |_| true)
    }

    fn number(&mut self, what: &str) -> Result<f64, G2oError> {
        self.parsed(what, |number: &f64| number.is_finite())
    }

    fn pose(&mut self) -> Result<Pose2, G2oError> {
        let (x, y) = (self.number("x in metres")?, self.number("y in metres")?);
        Ok(Pose2::new(x, y, self.number("a yaw in radians")?))
    }

    /// An edge whose entries of the information matrix are in this order.
    fn edge(&mut self, order: &[(usize, usize); 6]) -> Result<EdgeLine, G2oError> {
        let (from, to) = (self.id("an id")?, self.id("an id")?);
        let measurement = self.pose()?;
        let mut information = Matrix3::zeros();
        for (row, column) in *order {
            let value = self.number("an entry of the information matrix")?;
            information[(row, column)] = value;
            information[(column, row)] = value;
        }
        let line = self.line;
        Ok(EdgeLine {
            line,
            from,
            to,
            measurement,
            information,
        })
    }

    fn end(&mut self) -> Result<(), G2oError> {
        match self.next() {
            None => Ok(()),
            Some(word) => {
                let found: String = word.chars().take(40).collect();
                Err(self.wrong(format!("expected the end of the line, found `{found}`")))
            }
        }
    }
}

//! Relations. Error of a trajectory against reference relations.
//!
//! The metric of Kuemmerle et al., "On measuring the accuracy of SLAM algorithms" (Autonomous Robots 27, 2009): for pairs of times with a
//! known relative pose, the difference to the estimated one, translation and rotation apart: the mean of their absolute values. Independent of
//! the map's frame.

use thiserror::Error;
use zenav_protocol::geometry::Pose2;

/// A relation counts if the trajectory begins and ends at most this long after and before it, s: odometry is logged before the first scan.
const BEYOND: f64 = 1.0;

/// A known relative pose between two times.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relation {
    /// Seconds, as in the log.
    pub from: f64,
    /// Seconds.
    pub to: f64,
    /// `from_from_to`, m and rad.
    pub relative: Pose2,
}

/// Mean and standard deviation.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Spread {
    /// Arithmetic mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
}

/// Errors over all relations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RelationErrors {
    /// Number of relations that count.
    pub count: usize,
    /// Number of the others: their times lie beyond the trajectory.
    pub outside: usize,
    /// Of the translation, m.
    pub translation: Spread,
    /// Of the rotation, rad.
    pub rotation: Spread,
}

/// A malformed line.
#[derive(Clone, Debug, PartialEq, Error)]
#[error("line {line}: expected `t1 t2 x y z roll pitch yaw`, found `{found}`")]
pub struct RelationError {
    /// Number of the line, from 1.
    pub line: usize,
    /// The line, or its beginning.
    pub found: String,
}

/// Reads lines `t1 t2 x y z roll pitch yaw`; empty lines and comments (`#`) are passed over.
///
/// ```
/// use zenav_protocol::geometry::Pose2;
/// use zenav_slam::read_relations;
///
/// let relations = read_relations("# t1 t2 x y z roll pitch yaw\n0.0 2.5 1.2 0.1 0 0 0 0.3\n")?;
/// assert_eq!((relations[0].from, relations[0].to, relations[0].relative), (0.0, 2.5, Pose2::new(1.2, 0.1, 0.3)));
/// let error = read_relations("0.0 2.5 1.2\n").unwrap_err();
/// assert_eq!(error.to_string(), "line 1: expected `t1 t2 x y z roll pitch yaw`, found `0.0 2.5 1.2`");
/// # Ok::<(), zenav_slam::RelationError>(())
/// ```
///
/// # Errors
/// The first malformed line.
pub fn read_relations(text: &str) -> Result<Vec<Relation>, RelationError> {
    let mut relations = Vec::new();
    for (line, text) in (1..).zip(text.lines().map(str::trim)) {
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let words = text.split_ascii_whitespace();
        let number = |word: &str| word.parse().ok().filter(|number: &f64| number.is_finite());
        let numbers: Option<Vec<f64>> = words.map(number).collect();
        let Some([from, to, x, y, _, _, _, yaw]) = numbers.as_deref() else {
            let found = text.chars().take(80).collect();
            return Err(RelationError { line, found });
        };
        relations.push(Relation {
            from: *from,
            to: *to,
            relative: Pose2::new(*x, *y, *yaw),
        });
    }
    Ok(relations)
}

/// The errors of a trajectory, poses `map_from_base` by ascending time, s. It is interpolated between poses and held constant for a second
/// beyond its ends; relations farther beyond do not count. `None` if no relation counts, or if times go back: two drives by one clock.
///
/// ```
/// use zenav_protocol::geometry::Pose2;
/// use zenav_slam::{Relation, relation_errors};
///
/// // 2 m were driven; the trajectory says 2.2 m, by 4 s, with nothing in between.
/// let trajectory = [(0.0, Pose2::IDENTITY), (4.0, Pose2::new(2.2, 0.0, 0.0))];
/// let whole = Relation { from: 0.0, to: 4.0, relative: Pose2::new(2.0, 0.0, 0.0) };
/// let half = Relation { to: 2.0, relative: Pose2::new(1.1, 0.0, 0.0), ..whole };
/// let errors = relation_errors(&trajectory, &[whole, half]).unwrap();
/// assert!((errors.translation.mean - 0.5 * (0.2 + 0.0)).abs() < 1e-9 && errors.rotation.mean == 0.0);
/// // By another clock no relation says anything.
/// let elsewhen = Relation { from: 1e9, to: 1e9 + 4.0, ..whole };
/// assert_eq!(relation_errors(&trajectory, &[elsewhen]), None);
/// assert_eq!(relation_errors(&trajectory, &[whole, elsewhen]).unwrap().outside, 1);
/// ```
#[must_use]
pub fn relation_errors(trajectory: &[(f64, Pose2)], relations: &[Relation]) -> Option<RelationErrors> {
    let ((first, _), (last, _)) = (trajectory.first()?, trajectory.last()?);
    if !trajectory.is_sorted_by(|a, b| a.0 <= b.0) {
        return None;
    }
    let times = first - BEYOND..=last + BEYOND;
    let at = |time: f64| -> Pose2 {
        let after = trajectory.partition_point(|(stamp, _)| *stamp < time);
        let (Some((t1, b)), Some((t0, a))) = (
            trajectory.get(after),
            after.checked_sub(1).and_then(|at| trajectory.get(at)),
        ) else {
            return trajectory[after.min(trajectory.len() - 1)].1;
        };
        a.interpolate(b, (time - t0) / (t1 - t0))
    };
    let errors: Vec<(f64, f64)> = relations
        .iter()
        .filter(|relation| times.contains(&relation.from) && times.contains(&relation.to))
        .map(|relation| {
            let estimated = at(relation.from).inverse() * at(relation.to);
            let error = relation.relative.inverse() * estimated;
            (error.x.hypot(error.y), error.yaw.abs())
        })
        .collect();
    if errors.is_empty() {
        return None;
    }
    let spread = |of: fn(&(f64, f64)) -> f64| {
        let count = errors.len() as f64;
        let mean = errors.iter().map(of).sum::<f64>() / count;
        let squares = errors.iter().map(|error| (of(error) - mean).powi(2)).sum::<f64>();
        Spread {
            mean,
            deviation: (squares / count).sqrt(),
        }
    };
    Some(RelationErrors {
        count: errors.len(),
        outside: relations.len() - errors.len(),
        translation: spread(|error| error.0),
        rotation: spread(|error| error.1),
    })
}

//! Relations. Error of a trajectory against reference relations.
//!
//! The metric of Kuemmerle et al., "On measuring the accuracy of SLAM algorithms" (Autonomous Robots 27, 2009): for pairs of times with a
//! known relative pose, the difference to the estimated one, translation and rotation apart. Independent of the map's frame.

use thiserror::Error;
use zenav_protocol::geometry::Pose2;

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
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
}

/// Errors over all relations.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RelationErrors {
    /// Number of relations.
    pub count: usize,
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
/// # Errors
/// The first malformed line.
pub fn read_relations(text: &str) -> Result<Vec<Relation>, RelationError> {
    let mut relations = Vec::new();
    for (line, text) in (1..).zip(text.lines().map(str::trim)) {
        if text.is_empty() || text.starts_with('#') {
            continue;
        }
        let numbers: Vec<f64> = text
            .split_ascii_whitespace()
            .filter_map(|word| word.parse().ok())
            .collect();
        let (true, [from, to, x, y, _, _, _, yaw]) =
            (numbers.iter().all(|number| number.is_finite()), numbers.as_slice())
        else {
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

/// The errors of a trajectory, poses `map_from_base` by ascending time, s. It is interpolated between poses and held constant beyond its
/// ends. `None` for an empty trajectory or no relations.
#[must_use]
pub fn relation_errors(trajectory: &[(f64, Pose2)], relations: &[Relation]) -> Option<RelationErrors> {
    if trajectory.is_empty() || relations.is_empty() {
        return None;
    }
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
        .map(|relation| {
            let estimated = at(relation.from).inverse() * at(relation.to);
            let error = relation.relative.inverse() * estimated;
            (error.x.hypot(error.y), error.yaw.abs())
        })
        .collect();
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
        translation: spread(|error| error.0),
        rotation: spread(|error| error.1),
    })
}

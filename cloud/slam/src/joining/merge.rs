//! Merge. Decides whether two maps show one building, and joins them.

use thiserror::Error;
use zenav_pose_graph::{EdgeKind, RobustSolution};
use zenav_protocol::geometry::Pose2;

use super::join::{closures, joined};
use super::overview::{Overview, verdict};
use super::repeated::repeated;
use super::vote::{Count, count};
use crate::slam::Slam;
use crate::step::SlamError;

/// Most searches; submaps are picked evenly.
const SEARCHES: usize = 20;
/// Least number of searches that agree.
const VOTES: usize = 3;
/// Largest share of scans whose beams pass through the other map's walls: more means another building.
const CONTRADICTING: f64 = 0.2;
/// A scan contradicts if this share of its beams passes through walls: people and open doors cause less.
const THROUGH_WALLS: f64 = 0.4;
/// One scan in this many is judged.
const JUDGED: usize = 5;
/// Least share of the closures between the maps that agree with everything else.
const KEPT: f64 = 0.6;

/// Why two maps were not merged.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MergeError {
    /// The maps share no place, or too little of one: drive through a place that both know.
    #[error("no common place was found: {votes} of {searches} searches agree on a place, expected at least {VOTES}")]
    NoCommonPlace {
        /// Searches that agree.
        votes: usize,
        /// Searches made, one for each submap picked.
        searches: usize,
    },
    /// Rooms or floors look alike: drive where they differ.
    #[error("two alignments explain it as well: {best} searches agree on one, {second} on another")]
    Ambiguous {
        /// Searches that agree on the best alignment.
        best: usize,
        /// Searches that agree on the second best.
        second: usize,
    },
    /// One place looks alike, the rest does not: two buildings, or one that was rebuilt.
    #[error(
        "the maps contradict each other where they lie best: {share:.0} % of the scans look through walls of the other map"
    )]
    Contradiction {
        /// Share of such scans, percent.
        share: f64,
    },
    /// The alignment does not hold scan by scan.
    #[error("of the places that both maps show {kept} of {found} agree with the rest of them")]
    Disagreement {
        /// Closures between the maps that hold.
        kept: usize,
        /// All closures between the maps.
        found: usize,
    },
    /// Both maps hold the same session: merge the later of the two saved maps only.
    #[error(
        "session {first} of the first map is session {second} of the second map: its measurements would count twice"
    )]
    Repeated {
        /// Number of the session in the first map, from 1.
        first: usize,
        /// Its number in the second map, from 1.
        second: usize,
    },
    /// A session that has not been located is not part of its map yet: let it drive on.
    #[error("expected maps in which every session was located")]
    Unlocated,
    /// The merged graph has no solution.
    #[error(transparent)]
    Slam(#[from] SlamError),
}

/// Merges two sessions' maps into one, in the frame of the first, finished and solved. Their relative pose need not be known.
///
/// Submaps of `b` are searched for in all of `a`. The maps are merged if at least three searches agree on one alignment, no other alignment
/// has more than half of its votes, at most a fifth of the scans of either map contradict the other, and closures between single scans and
/// submaps hold in the robust solution. They must not share a session. Measurements by GPS and compass are dropped.
///
/// ```
#[doc = include_str!("../doc_setup/mapped_room.txt")]
/// use zenav_slam::{MergeError, merge};
///
/// let refused = merge(slam.clone(), slam).unwrap_err();
/// assert_eq!(refused, MergeError::Repeated { first: 1, second: 1 }, "its measurements would count twice");
/// # Ok::<(), zenav_slam::SlamError>(())
/// ```
///
/// # Errors
/// See [`MergeError`]: unless the result is certain, nothing is merged.
pub fn merge(a: Slam, b: Slam) -> Result<(Slam, RobustSolution), MergeError> {
    merge_timed(a, b, &mut || 0.0).map(|(merged, solved, _)| (merged, solved))
}

/// [`merge`], and how long the graph was solved in it, certificate included, s by the caller's `clock`.
///
/// # Errors
/// As [`merge`].
pub fn merge_timed(
    mut a: Slam,
    mut b: Slam,
    clock: &mut dyn FnMut() -> f64,
) -> Result<(Slam, RobustSolution, f64), MergeError> {
    if !a.is_located() || !b.is_located() {
        return Err(MergeError::Unlocated);
    }
    if let Some((first, second)) = repeated(&a, &b) {
        return Err(MergeError::Repeated {
            first: first + 1,
            second: second + 1,
        });
    }
    a.back_end.drop_factors();
    b.back_end.drop_factors();
    let overview = Overview::new(&a);
    let step = b.submaps.len().div_ceil(SEARCHES).max(2);
    // Neighbouring submaps share half of their scans; every second one is independent.
    let searches: Vec<_> = b
        .submaps
        .iter()
        .step_by(step)
        .map(|submap| overview.places(&a, &b, submap, None))
        .collect();
    let Count { best, votes, second } = count(&searches).ok_or(MergeError::NoCommonPlace {
        votes: 0,
        searches: searches.len(),
    })?;
    if votes < VOTES {
        return Err(MergeError::NoCommonPlace {
            votes,
            searches: searches.len(),
        });
    }
    if 2 * second > votes {
        return Err(MergeError::Ambiguous { best: votes, second });
    }
    let a_from_b = best.map_from_other;
    let share = contradicting(&a, &b, a_from_b).max(contradicting(&b, &a, a_from_b.inverse()));
    if share > CONTRADICTING {
        return Err(MergeError::Contradiction { share: 100.0 * share });
    }
    let found = closures(&mut a, &b, a_from_b);
    if found.is_empty() {
        return Err(MergeError::Disagreement { kept: 0, found: 0 });
    }
    let first = a.scans.len();
    let mut merged = joined(a, b, a_from_b, &found).map_err(SlamError::from)?;
    let (solved, solving) = merged.finish_timed(clock)?;
    let between = merged.back_end.edges().filter(|(edge, _, is_final)| {
        let crosses = edge.from < first && edge.to >= first;
        crosses && !is_final && edge.kind == EdgeKind::Closure
    });
    let kept = between.filter(|(_, weight, _)| *weight > 0.0).count();
    if (kept as f64) < KEPT * found.len() as f64 {
        return Err(MergeError::Disagreement {
            kept,
            found: found.len(),
        });
    }
    Ok((merged, solved, solving))
}

/// Share of the scans near another map whose beams pass through that map's walls.
fn contradicting(map: &Slam, other: &Slam, map_from_other: Pose2) -> f64 {
    let nodes = (0..other.scans.len()).step_by(JUDGED);
    let verdicts: Vec<f64> = nodes
        .filter_map(|node| verdict(map, other, node, map_from_other))
        .map(|verdict| verdict.through_walls)
        .collect();
    let against = verdicts.iter().filter(|through| **through > THROUGH_WALLS).count();
    against as f64 / verdicts.len().max(1) as f64
}

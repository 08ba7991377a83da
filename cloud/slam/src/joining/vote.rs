//! Vote. Finds the place of one map in another that several searches agree on.

use zenav_protocol::geometry::{Pose2, wrap_angle};

/// Votes closer than this at the place where they were cast, m and rad, agree; the limit grows by [`DRIFT`] for each metre between these
/// places.
const AGREEING: (f64, f64) = (0.3, 0.1);
/// How far a map may be bent over a distance, m/m.
const DRIFT: f64 = 0.02;

/// A place that a search allows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Vote {
    /// Pose of the other map.
    pub(crate) map_from_other: Pose2,
    /// Where in this map the vote was cast.
    pub(crate) seen_from: Pose2,
    /// Share of the points that this map explains.
    pub(crate) explained: f64,
}

/// The combined result of the searches.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Count {
    /// The vote that explains most, of those for the place with most votes.
    pub(crate) best: Vote,
    /// Searches that allow that place.
    pub(crate) votes: usize,
    /// Searches that allow the runner-up.
    pub(crate) second: usize,
}

/// Counts the votes of searches, each of which may allow several places. `None` if none allows any.
pub(crate) fn count(searches: &[Vec<Vote>]) -> Option<Count> {
    let votes_for = |place: &Vote| {
        let allows = |search: &&Vec<Vote>| search.iter().any(|vote| agree(vote, place));
        searches.iter().filter(allows).count()
    };
    let mut places: Vec<(usize, Vote)> = searches
        .iter()
        .flatten()
        .map(|place| (votes_for(place), *place))
        .collect();
    places.sort_by(|(a, x), (b, y)| b.cmp(a).then(y.explained.total_cmp(&x.explained)));
    let (votes, best) = *places.first()?;
    let others = places.iter().filter(|(_, place)| !agree(place, &best));
    Some(Count {
        best,
        votes,
        second: others.map(|(votes, _)| *votes).max().unwrap_or(0),
    })
}

/// Whether two votes mean one place: they agree on the other map's pose where they were cast.
fn agree(a: &Vote, b: &Vote) -> bool {
    let moved = a.map_from_other * b.map_from_other.inverse() * b.seen_from;
    let way = a.seen_from.distance(&b.seen_from);
    let turn = wrap_angle(a.map_from_other.yaw - b.map_from_other.yaw).abs();
    moved.distance(&b.seen_from) <= AGREEING.0 + DRIFT * way && turn <= AGREEING.1
}

#[cfg(test)]
mod tests {
    use super::*;

    fn vote(x: f64, y: f64, yaw: f64, at: (f64, f64)) -> Vote {
        Vote {
            map_from_other: Pose2::new(x, y, yaw),
            seen_from: Pose2::new(at.0, at.1, 0.0),
            explained: 0.9,
        }
    }

    #[test]
    fn a_place_counts_once_for_each_search_and_the_next_best_is_known() {
        let searches = [
            vec![vote(1.0, 2.0, 0.0, (0.0, 0.0)), vote(1.1, 2.0, 0.0, (0.0, 0.0))],
            vec![vote(1.1, 2.1, 0.02, (3.0, 0.0)), vote(9.0, 2.0, 3.1, (0.0, 4.0))],
            vec![],
        ];
        let counted = count(&searches).map(|count| (count.votes, count.second));
        assert_eq!(counted, Some((2, 1)));
        assert_eq!(count(&[vec![]]), None);
    }
}

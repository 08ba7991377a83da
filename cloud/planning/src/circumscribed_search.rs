//! Circumscribed search. A path with room to turn everywhere, for a robot that is longer than wide: A* over the cells where its
//! circumscribed disc fits.
//!
//! Most paths that the footprint cannot drive only brush an obstacle. This search finds the way round it in milliseconds; the search over
//! positions and headings ([`super::se2_search`]) may take a thousand times as long.

use nalgebra::Point2;

use zenav_space::ConfigurationSpace;

use super::budget::Budget;
use super::cell_cost::CellCost;
use super::se2_search::{Query, is_drivable};
use super::searcher::{NotFound, Searched, Searcher};

/// A path that the true footprint can drive, corner by corner; `costs` are those of the map's cells. [`NotFound::NoPath`] if every path,
/// its ends included, passes a place without room to turn.
pub(super) fn search(
    space: &ConfigurationSpace,
    costs: &impl CellCost,
    query: &Query,
    budget: Budget<'_>,
) -> Searched<Vec<Point2<f64>>> {
    let spec = space.spec();
    let (Some(first), Some(last), Ok(mut searcher)) = (
        spec.cell_at(query.start),
        spec.cell_at(query.goal),
        Searcher::new(space.for_disc(space.footprint().circumscribed_radius()).free()),
    ) else {
        return Searched::failed(NotFound::OutOfMap);
    };
    let Searched { result, expansions } = searcher.search_with(costs, first, last, budget);
    let result = result.and_then(|path| {
        let between = path.corners.iter().map(|corner| spec.from_cells(*corner));
        let mut path: Vec<_> = [query.start].into_iter().chain(between).chain([query.goal]).collect();
        path.dedup_by(|a, b| (*a - *b).norm() < 1e-9);
        is_drivable(space, &path, &[], query.heading)
            .then_some(path)
            .ok_or(NotFound::NoPath)
    });
    Searched { result, expansions }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::cell_cost::Uniform;
    use zenav_space::UnknownPolicy;

    /// A robot of 0.8 m by 0.3 m in a field of 6 m by 4 m.
    fn space(occupied: &[(u32, u32)]) -> ConfigurationSpace {
        let grid = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(120, 80, 0.05), occupied);
        let footprint = zenav_fixtures::footprint(&[(-0.5, -0.15), (0.3, -0.15), (0.3, 0.15), (-0.5, 0.15)]);
        ConfigurationSpace::new(&grid, &footprint, UnknownPolicy::Blocked, 0.0)
    }

    fn ask(space: &ConfigurationSpace, heading: Option<f64>) -> Result<Vec<Point2<f64>>, NotFound> {
        let query = Query {
            start: Point2::new(0.81, 1.03),
            heading,
            goal: Point2::new(5.02, 3.01),
            tolerance: 0.0,
        };
        let found = search(space, &Uniform, &query, Budget::UNLIMITED).result;
        if let Ok(path) = &found {
            assert!(
                is_drivable(space, path, &[], heading) && path[0] == query.start && path[path.len() - 1] == query.goal
            );
        }
        found
    }

    #[test]
    fn a_gap_without_room_to_turn_is_gone_round_and_never_through() {
        // A wall with a gap of 0.5 m, which the robot fits lengthways.
        let gap: Vec<_> = (0..80).filter(|y| !(30..40).contains(y)).map(|y| (60, y)).collect();
        assert_eq!(ask(&space(&gap), None), Err(NotFound::NoPath));
        // The wall ends where there is room.
        let short: Vec<_> = gap.into_iter().filter(|(_, y)| *y < 50).collect();
        let path = ask(&space(&short), None).unwrap();
        assert!(path.iter().any(|p| p.y > 2.8));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn whatever_is_found_can_be_driven(occupied in prop::collection::vec((0_u32..120, 0_u32..80), 0..25), heading in prop::option::of(-3.1..3.1_f64)) {
            let _ = ask(&space(&occupied), heading);
        }
    }
}

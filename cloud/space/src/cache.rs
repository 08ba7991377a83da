//! Cache of configuration spaces. One space per map, robot and policy, built once and then updated with the map's tiles.

use std::collections::{BTreeSet, VecDeque};
use std::sync::Arc;

use nalgebra::{Point2, Vector2};
use zenav_protocol::grid::{Cell, Occupancy};
use zenav_protocol::messages::{MapRef, TILE};
use zenav_protocol::robot::Footprint;

use super::{ConfigurationSpace, UnknownPolicy, Zones};
use zenav_protocol::map_replica::MapReplica;

/// Average excess thickness of mapped walls, in cells: a surface lies anywhere in its occupied cell. In tight places the footprint is
/// shrunk by as much on all sides …
const THICKENING: f64 = 0.5;
/// … and by no more than this, m: whether the robot fits by its own sensors is left to its collision monitor.
const MOST_THICKENING: f64 = 0.0125;

/// How closely a robot may pass mapped obstacles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fit {
    /// The full footprint, with walls as thick as their cells.
    Full,
    /// The footprint shrunk by the excess thickness of walls: for places where it does not fit otherwise.
    Tight,
}

/// Number of spaces that are kept.
const KEPT: usize = 8;

/// The most recently used spaces.
#[derive(Clone, Debug, Default)]
pub struct SpaceCache {
    /// The last one requested comes first; each with the state of the map that it belongs to.
    kept: VecDeque<(MapRef, Arc<ConfigurationSpace>)>,
    zones: Arc<Zones>,
}

impl SpaceCache {
    /// Empty, for maps with these zones.
    #[must_use]
    pub fn new(zones: Arc<Zones>) -> Self {
        Self {
            kept: VecDeque::new(),
            zones,
        }
    }

    /// Sets the zones of the spaces from now on.
    pub fn set_zones(&mut self, zones: Arc<Zones>) {
        self.zones = zones;
    }

    /// The space of a map's present state; the same `Arc` (`Arc::ptr_eq`) while no cell changes its meaning.
    ///
    /// An older space that is still held elsewhere stays unchanged; otherwise it is updated in place.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::grid::{GridSpec, Occupancy};
    /// # use zenav_protocol::map_replica::{MapReplica, PatchResult};
    /// # use zenav_protocol::messages::{MapPatch, MapRef, TILE, Tile};
    /// # use zenav_protocol::time::Stamp;
    /// use std::sync::Arc;
    /// use zenav_protocol::robot::Footprint;
    /// use zenav_space::{Fit, SpaceCache, UnknownPolicy};
    ///
    /// # let mut map = MapReplica::new();
    /// # let patch = MapPatch {
    /// #     stamp: Stamp(1),
    /// #     map: MapRef::new("kitchen", 1),
    /// #     base_revision: 0,
    /// #     spec: GridSpec { origin: Point2::origin(), resolution: 0.05, width: TILE, height: TILE },
    /// #     tiles: vec![Tile { x: 0, y: 0, values: vec![Occupancy::FREE; (TILE * TILE) as usize] }],
    /// # };
    /// # assert_eq!(map.apply(&patch), PatchResult::Applied);
    /// // `map` is the `MapReplica` of a map with cells of 0.05 m.
    /// let (mut cache, robot) = (SpaceCache::default(), Footprint::Radius(0.2));
    /// let mut get = |fit| cache.get(&map, &robot, UnknownPolicy::Blocked, fit);
    /// assert!(Arc::ptr_eq(&get(Fit::Full), &get(Fit::Full)), "it is built once");
    /// assert!((get(Fit::Tight).radius() - 0.1875).abs() < 1e-9, "12.5 mm less on each side");
    /// ```
    pub fn get(
        &mut self,
        map: &MapReplica,
        footprint: &Footprint,
        unknown: UnknownPolicy,
        fit: Fit,
    ) -> Arc<ConfigurationSpace> {
        let footprint = &match fit {
            Fit::Full => footprint.clone(),
            Fit::Tight => footprint.offset(-(THICKENING * map.grid().spec().resolution).min(MOST_THICKENING)),
        };
        let fits = |(of, space): &(MapRef, Arc<ConfigurationSpace>)| {
            let same_zones = Arc::ptr_eq(space.zones(), &self.zones);
            of.id == map.map().id && same_zones && space.unknown_policy() == unknown && space.footprint() == footprint
        };
        let kept = self.kept.iter().position(fits).and_then(|at| self.kept.remove(at));
        let space = match kept {
            Some((of, space)) => Self::brought_up(space, of.revision, map),
            None => None,
        };
        let anew = || ConfigurationSpace::with_zones(map.grid(), footprint, unknown, 0.0, &self.zones);
        let space = space.unwrap_or_else(|| Arc::new(anew()));
        self.kept.push_front((map.map().clone(), Arc::clone(&space)));
        self.kept.truncate(KEPT);
        space
    }

    /// The space of a map without the obstacles at these points (map frame, m); it is not kept.
    #[must_use]
    pub fn cleared(
        &mut self,
        map: &MapReplica,
        footprint: &Footprint,
        unknown: UnknownPolicy,
        points: &[Point2<f64>],
    ) -> ConfigurationSpace {
        let spec = *map.grid().spec();
        let cells = points.iter().filter_map(|point| spec.cell_at(*point));
        self.altered(map, footprint, unknown, cells, Occupancy::FREE)
    }

    /// The space of a map with these discs (center and radius, map frame, m) marked as occupied; it is not kept.
    #[must_use]
    pub fn with_discs(
        &mut self,
        map: &MapReplica,
        footprint: &Footprint,
        unknown: UnknownPolicy,
        discs: &[(Point2<f64>, f64)],
    ) -> ConfigurationSpace {
        let spec = *map.grid().spec();
        let bound = |value: f64, size: u32| value.floor().clamp(0.0, f64::from(size)) as u32;
        let cells = discs.iter().flat_map(|(center, radius)| {
            let [low, high] = [-*radius, *radius].map(|off| spec.to_cells(center + Vector2::repeat(off)));
            let columns = bound(low.x, spec.width)..bound(high.x + 1.0, spec.width);
            let rows = bound(low.y, spec.height)..bound(high.y + 1.0, spec.height);
            let cells = rows.flat_map(move |y| columns.clone().map(move |x| Cell::new(x, y)));
            cells.filter(move |cell| (spec.center(*cell) - center).norm() <= *radius)
        });
        self.altered(map, footprint, unknown, cells, Occupancy::OCCUPIED)
    }

    /// The space of a map in which these cells have a value. Cost: a copy of the map, and an update around each cell.
    fn altered(
        &mut self,
        map: &MapReplica,
        footprint: &Footprint,
        unknown: UnknownPolicy,
        cells: impl Iterator<Item = Cell>,
        value: i8,
    ) -> ConfigurationSpace {
        let space = self.get(map, footprint, unknown, Fit::Full);
        let mut grid = map.grid().clone();
        let mut tiles = BTreeSet::new();
        for cell in cells {
            grid[cell] = value;
            tiles.insert((cell.x / TILE, cell.y / TILE));
        }
        let tiles: Vec<_> = tiles.into_iter().collect();
        let mut altered = ConfigurationSpace::clone(&space);
        match altered.update(&grid, &tiles) {
            Ok(_) => altered,
            Err(_) => ConfigurationSpace::with_zones(&grid, footprint, unknown, 0.0, &self.zones),
        }
    }

    /// The space of a revision, updated to the map's present one; `None` if it has to be rebuilt.
    fn brought_up(
        mut space: Arc<ConfigurationSpace>,
        revision: u64,
        map: &MapReplica,
    ) -> Option<Arc<ConfigurationSpace>> {
        let differences = space.differences(map.grid(), &map.changed_since(revision)).ok()?;
        if !differences.is_empty() {
            Arc::make_mut(&mut space).apply(map.grid(), &differences);
        }
        Some(space)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use zenav_protocol::messages::{MapPatch, TILE, Tile};
    use zenav_protocol::time::Stamp;

    use super::*;
    use zenav_protocol::map_replica::PatchResult;

    /// A patch of a map with `columns` by 2 tiles, with one occupied cell in each given tile.
    fn patch(base_revision: u64, columns: u32, tiles: &[(u32, u32, usize)]) -> MapPatch {
        let tile = |(x, y, at): &(u32, u32, usize)| {
            let mut values = vec![0; (TILE * TILE) as usize];
            values[*at] = 100;
            Tile { x: *x, y: *y, values }
        };
        MapPatch {
            stamp: Stamp::ZERO,
            map: MapRef::new("m", base_revision + 1),
            base_revision,
            spec: zenav_fixtures::spec(columns * TILE, 2 * TILE, 0.1),
            tiles: tiles.iter().map(tile).collect(),
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn a_kept_space_equals_one_that_is_built_anew(steps in prop::collection::vec((prop::collection::vec((0_u32..3, 0_u32..2, 0_usize..4096), 0..3), any::<bool>(), any::<bool>(), any::<bool>()), 1..8)) {
            let (mut mirror, mut cache) = (MapReplica::new(), SpaceCache::default());
            let (mut columns, mut held) = (3, None);
            let footprint = Footprint::Radius(0.3);
            for (revision, (tiles, grow, hold, ask)) in (0..).zip(steps) {
                columns += u32::from(grow);
                prop_assert_eq!(mirror.apply(&patch(revision, columns, &tiles)), PatchResult::Applied);
                if !ask {
                    continue;
                }
                for policy in [UnknownPolicy::Free, UnknownPolicy::Blocked] {
                    let kept = cache.get(&mirror, &footprint, policy, Fit::Tight);
                    let anew = ConfigurationSpace::new(mirror.grid(), kept.footprint(), policy, 0.0);
                    prop_assert_eq!((kept.spec(), kept.free(), kept.field()), (anew.spec(), anew.free(), anew.field()));
                    prop_assert_eq!((kept.obstacles(), kept.forbidden()), (anew.obstacles(), anew.forbidden()));
                    prop_assert!(Arc::ptr_eq(&kept, &cache.get(&mirror, &footprint, policy, Fit::Tight)));
                    if hold {
                        held = Some((kept, anew));
                    }
                }
                if let Some((kept, anew)) = &held {
                    prop_assert_eq!((kept.free(), kept.field()), (anew.free(), anew.field()), "what others hold stays as it was");
                }
            }
        }
    }

    #[test]
    fn a_revision_in_which_no_cell_means_anything_else_has_the_same_space() {
        let (mut mirror, mut cache) = (MapReplica::new(), SpaceCache::default());
        let footprint = Footprint::Radius(0.3);
        let _ = mirror.apply(&patch(0, 2, &[(0, 0, 5)]));
        let first = cache.get(&mirror, &footprint, UnknownPolicy::Free, Fit::Tight);
        assert_eq!(mirror.apply(&patch(1, 2, &[(0, 0, 5)])), PatchResult::Applied);
        assert!(Arc::ptr_eq(
            &first,
            &cache.get(&mirror, &footprint, UnknownPolicy::Free, Fit::Tight)
        ));
        assert_eq!(mirror.apply(&patch(2, 2, &[(0, 0, 6)])), PatchResult::Applied);
        assert!(!Arc::ptr_eq(
            &first,
            &cache.get(&mirror, &footprint, UnknownPolicy::Free, Fit::Tight)
        ));
    }
}

//! Which configuration space belongs to a map, a robot and a policy? Made once for each state of the map.

use std::collections::VecDeque;
use std::sync::Arc;

use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::MapRef;
use zenav_protocol::robot::Footprint;

use super::{ConfigurationSpace, UnknownPolicy};

/// Spaces that are kept.
const KEPT: usize = 8;

/// The latest spaces.
#[derive(Clone, Debug, Default)]
pub struct SpaceCache {
    kept: VecDeque<(MapRef, Arc<ConfigurationSpace>)>,
}

impl SpaceCache {
    /// The space of a map's state. `map` must name the grid's content: the same name is the same content.
    pub fn get(
        &mut self,
        map: &MapRef,
        grid: &OccupancyGrid,
        footprint: &Footprint,
        unknown: UnknownPolicy,
    ) -> Arc<ConfigurationSpace> {
        let fits = |(of, space): &(MapRef, Arc<ConfigurationSpace>)| {
            of == map && space.unknown_policy() == unknown && space.footprint() == footprint
        };
        if let Some((_, space)) = self.kept.iter().find(|kept| fits(kept)) {
            return Arc::clone(space);
        }
        let space = Arc::new(ConfigurationSpace::new(grid, footprint, unknown, 0.0));
        self.kept.push_front((map.clone(), Arc::clone(&space)));
        self.kept.truncate(KEPT);
        space
    }
}

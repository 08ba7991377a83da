//! Temporal decay. Frees obstacles that left while no beam saw them go.
//!
//! Beams clear the cells that they pass, but nothing clears cells that the robot no longer looks at: a passer-by in a doorway would block
//! it forever. So an obstacle that appears on cells that had long been free is transient at first, and one of three things happens:
//!
//! 1. beams pass its cells, and the sensor model frees them;
//! 2. it is hit for longer than the decay time: it is furniture, and permanent;
//! 3. it is not hit for the decay time: its cells decay to free.
//!
//! Cells beside a permanent obstacle are never transient: no robot fits there, and a wall that a wrong pose or a grazing beam once showed
//! as free must not decay. The idea is that of Nav2's decaying obstacle layers (Macenski et al., "Spatio-Temporal Voxel Layer", 2020),
//! applied to one map that holds permanent and transient obstacles. Time is measured by the scans' stamps.

use std::collections::BTreeMap;
use std::time::Duration;

use zenav_protocol::grid::Occupancy;
use zenav_protocol::time::Stamp;

use super::tile::Bits;
use super::tiles::{TILE_SIDE, Tiles};
use crate::sensor_model::QuantizedModel;

/// Cells this close to a permanent obstacle on each axis are never transient, m.
const BESIDE: f64 = 0.1;
/// A stamp this long before the newest one means that the clock restarted.
const CLOCK_RESTART: Duration = Duration::from_secs(10);

/// Time by the scans' stamps, since the first scan. A stamp before the newest one does not advance it, since scans of several lidars arrive
/// out of order; a stamp far before it means that the robot's clock restarted.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ScanClock {
    pub(super) now: Duration,
    newest: Option<Stamp>,
}

impl ScanClock {
    /// Advances to a scan's stamp.
    pub(super) fn advance(&mut self, stamp: Stamp) -> Duration {
        let before = self.newest.unwrap_or(stamp);
        let is_late = stamp <= before && before.since(stamp) <= CLOCK_RESTART;
        if self.newest.is_none() || !is_late {
            self.newest = Some(stamp);
        }
        self.now = self.now.saturating_add(stamp.since(before));
        self.now
    }
}

/// Transient obstacles of a map.
#[derive(Clone, Debug)]
pub(super) struct Decay {
    after: Duration,
    clock: ScanClock,
    /// Its time.
    now: Duration,
    /// Time of the next round, which collects the cells that stayed free since the last one.
    next_round: Duration,
    /// Time of the next decay.
    due: Duration,
    tiles: BTreeMap<[i64; 2], TileHistory>,
}

/// Free cells and transient obstacles of a tile.
#[derive(Clone, Debug)]
struct TileHistory {
    /// Cells at the lowest log-odds ever since the last round.
    free: Bits,
    /// Cells that also had them during the whole previous round.
    long_free: Bits,
    /// Transient cells by row and column: times of the first and the last hit.
    transient: BTreeMap<(usize, usize), [Duration; 2]>,
}

impl TileHistory {
    const EMPTY: Self = Self {
        free: [0; TILE_SIDE],
        long_free: [0; TILE_SIDE],
        transient: BTreeMap::new(),
    };
}

impl Decay {
    /// Decay after this time without a hit.
    pub(super) fn new(after: Duration) -> Self {
        Self {
            after,
            clock: ScanClock::default(),
            now: Duration::ZERO,
            next_round: after,
            due: Duration::MAX,
            tiles: BTreeMap::new(),
        }
    }

    /// The same decay for a map that is redrawn.
    pub(super) fn restarted(&self) -> Self {
        Self::new(self.after)
    }

    /// Advances to a scan's stamp and frees what is due.
    pub(super) fn advance(&mut self, stamp: Stamp, map: &mut Tiles, model: &QuantizedModel) {
        self.now = self.clock.advance(stamp);
        if self.now >= self.due {
            self.decay(map, model);
        }
        if self.now >= self.next_round {
            self.next_round = self.now.saturating_add(self.after);
            for (at, tile) in map.known() {
                let history = self.tiles.entry(at).or_insert(TileHistory::EMPTY);
                for ((free, long_free), freest) in
                    history.free.iter_mut().zip(&mut history.long_free).zip(tile.freest())
                {
                    (*free, *long_free) = (*freest, *free & freest);
                }
            }
        }
    }

    /// Frees every transient obstacle now.
    pub(super) fn all_now(&mut self, map: &mut Tiles, model: &QuantizedModel) {
        let after = std::mem::replace(&mut self.after, Duration::ZERO);
        self.decay(map, model);
        self.after = after;
    }

    fn decay(&mut self, map: &mut Tiles, model: &QuantizedModel) {
        self.due = Duration::MAX;
        for (at, history) in &mut self.tiles {
            history.transient.retain(|(row, column), [_, last]| {
                let due = last.saturating_add(self.after);
                if due > self.now {
                    self.due = self.due.min(due);
                    return true;
                }
                if let Some(index) = map.index(*at)
                    && map.tiles[index].is_some()
                {
                    let tile = map.tile_mut(index);
                    let changes = tile.rows()[*row][*column] != model.least;
                    tile.set(*column, *row, model.least, model);
                    map.dirty[index] |= changes;
                    history.free[*row] |= 1 << column;
                    history.long_free[*row] |= 1 << column;
                }
                false
            });
        }
    }

    /// Cells of a tile were touched: they are not transient. Those only assumed to be are, for as long as that lasts.
    pub(super) fn touch(&mut self, at: [i64; 2], [known, assumed]: &[Bits; 2]) {
        let Some(history) = self.tiles.get_mut(&at) else {
            return;
        };
        let is_known = |row: usize, column: usize| known[row] >> column & 1 == 1;
        history.transient.retain(|(row, column), _| !is_known(*row, *column));
        for row in 0..TILE_SIDE {
            history.free[row] &= !(known[row] | assumed[row]);
            history.long_free[row] &= !known[row];
            let mut left = assumed[row] & !known[row];
            while left != 0 {
                let column = left.trailing_zeros() as usize;
                let bit = left & left.wrapping_neg();
                left ^= bit;
                let was_free = history.long_free[row] & bit != 0;
                history.long_free[row] &= !bit;
                if was_free || history.transient.contains_key(&(row, column)) {
                    history.transient.insert((row, column), [self.now; 2]);
                    self.due = self.due.min(self.now.saturating_add(self.after));
                }
            }
        }
    }

    /// Observes a tile's hits, before the map takes them.
    pub(super) fn observe(&mut self, at: [i64; 2], hits: &Bits, map: &Tiles, model: &QuantizedModel) {
        let Some(history) = self.tiles.get_mut(&at) else {
            return;
        };
        let mut new = Vec::new();
        for (row, hits) in hits.iter().enumerate() {
            let mut left = *hits;
            history.free[row] &= !left;
            while left != 0 {
                let column = left.trailing_zeros() as usize;
                let bit = left & left.wrapping_neg();
                left ^= bit;
                if history.long_free[row] & bit != 0 {
                    history.long_free[row] ^= bit;
                    new.push((row, column));
                } else if let Some([first, last]) = history.transient.get_mut(&(row, column)) {
                    // Beams freed the cell in between, so this is another obstacle.
                    if !is_occupied(map.byte(at, row, column), model) {
                        *first = self.now;
                    }
                    *last = self.now;
                    if last.saturating_sub(*first) >= self.after {
                        history.transient.remove(&(row, column));
                    }
                }
            }
        }
        for (row, column) in new {
            if !self.is_beside_permanent(at, row, column, map, model)
                && let Some(history) = self.tiles.get_mut(&at)
            {
                history.transient.insert((row, column), [self.now; 2]);
                self.due = self.due.min(self.now.saturating_add(self.after));
            }
        }
    }

    fn is_beside_permanent(
        &self,
        at: [i64; 2],
        row: usize,
        column: usize,
        map: &Tiles,
        model: &QuantizedModel,
    ) -> bool {
        let side = TILE_SIDE as i64;
        let reach = (BESIDE / map.frame.resolution).round() as i64;
        let around = |center: i64| center - reach..=center + reach;
        around(at[1] * side + row as i64).any(|y| {
            around(at[0] * side + column as i64).any(|x| {
                let at = [x.div_euclid(side), y.div_euclid(side)];
                let (row, column) = (y.rem_euclid(side) as usize, x.rem_euclid(side) as usize);
                is_occupied(map.byte(at, row, column), model)
                    && !self
                        .tiles
                        .get(&at)
                        .is_some_and(|history| history.transient.contains_key(&(row, column)))
            })
        })
    }
}

fn is_occupied(byte: u8, model: &QuantizedModel) -> bool {
    Occupancy::of(model.percent(byte)) == Occupancy::Occupied
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::Scan;

    use super::*;
    use crate::{Insertion, Mapper, MappingSettings};

    const AFTER: f64 = 10.0;
    const SECOND: u64 = 1_000_000_000;

    /// A robot at the origin that looks along x or away from it, at two scans a second.
    struct Robot {
        mapper: Mapper,
        stamp: u64,
    }

    impl Robot {
        fn new(decay_after: f64) -> Self {
            let settings = MappingSettings {
                decay_after,
                ..MappingSettings::default()
            };
            Self {
                mapper: Mapper::new(settings, "m"),
                stamp: 0,
            }
        }

        /// Looks along `yaw`, where the nearest obstacle is at `range`.
        fn look(&mut self, secs: f64, yaw: f64, range: f32) {
            for _ in 0..(2.0 * secs) as u64 {
                self.stamp += SECOND / 2;
                let scan = Scan {
                    stamp: Stamp(self.stamp),
                    angle_min: -0.1,
                    angle_increment: 0.01,
                    range_min: 0.02,
                    range_max: 6.0,
                    ranges: vec![range; 21],
                    odom_from_base: Pose2::new(0.01, 0.01, yaw),
                    ..Scan::default()
                };
                assert_eq!(self.mapper.insert(&scan), Insertion::Inserted);
            }
        }

        fn at(&self, x: f64) -> Occupancy {
            let grid = self.mapper.grid();
            grid.at(Point2::new(x, 0.01))
                .map_or(Occupancy::Unknown, |value| Occupancy::of(*value))
        }
    }

    const AHEAD: f64 = 0.0;
    const AWAY: f64 = 3.0;

    /// A wall was seen at 4 m for a long time, then a person stood at 2 m for a while.
    fn somebody_passed(decay_after: f64, secs: f64) -> Robot {
        let mut robot = Robot::new(decay_after);
        robot.look(5.0 * AFTER, AHEAD, 4.0);
        robot.look(secs, AHEAD, 2.0);
        assert_eq!(
            (robot.at(2.01), robot.at(4.01)),
            (Occupancy::Occupied, Occupancy::Occupied)
        );
        robot
    }

    #[test]
    fn an_obstacle_that_left_unseen_decays_and_the_patch_says_so() {
        let mut robot = somebody_passed(AFTER, 2.0);
        robot.look(AFTER - 1.0, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        while robot.mapper.take_patch().is_some() {}
        robot.look(2.0, AWAY, 1.0);
        assert_eq!((robot.at(2.01), robot.at(4.01)), (Occupancy::Free, Occupancy::Occupied));
        let patch = robot.mapper.take_patch().unwrap();
        let tile = patch.spec.to_cells(Point2::new(2.01, 0.01)) / 64.0;
        assert!(patch.tiles.iter().any(|t| (t.x, t.y) == (tile.x as u32, tile.y as u32)));
    }

    #[test]
    fn transient_obstacles_decay_at_once_on_demand_and_the_wall_does_not() {
        let mut robot = somebody_passed(AFTER, 2.0);
        while robot.mapper.take_patch().is_some() {}
        robot.mapper.decay_now();
        assert_eq!((robot.at(2.01), robot.at(4.01)), (Occupancy::Free, Occupancy::Occupied));
        assert!(robot.mapper.take_patch().is_some(), "replicas are told");
        robot.look(1.0, AHEAD, 2.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied, "what is still there is seen again");
    }

    #[test]
    fn an_obstacle_that_comes_back_decays_again() {
        let mut robot = somebody_passed(AFTER, 2.0);
        robot.look(2.0 * AFTER, AWAY, 1.0);
        robot.look(2.0, AHEAD, 2.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        robot.look(2.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Free);
        // Seen free in between, it is another obstacle, not furniture.
        for _ in 0..5 {
            robot.look(2.0, AHEAD, 2.0);
            robot.look(3.0, AHEAD, 4.0);
        }
        robot.look(2.0, AHEAD, 2.0);
        robot.look(2.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Free);
    }

    #[test]
    fn an_obstacle_that_stays_longer_than_the_decay_time_is_permanent() {
        let mut robot = somebody_passed(AFTER, 1.5 * AFTER);
        robot.look(20.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
    }

    #[test]
    fn obstacles_seen_from_the_first_look_on_are_permanent() {
        let mut robot = Robot::new(AFTER);
        robot.look(1.0, AHEAD, 4.0);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(4.01), Occupancy::Occupied);
        // A cell that became free only shortly before is never transient.
        let mut robot = Robot::new(AFTER);
        robot.look(0.5 * AFTER, AHEAD, 4.0);
        robot.look(1.0, AHEAD, 2.0);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
    }

    #[test]
    fn a_wall_that_is_seen_a_cell_nearer_for_a_moment_stays() {
        let mut robot = Robot::new(AFTER);
        robot.look(5.0 * AFTER, AHEAD, 4.0);
        robot.look(2.0, AHEAD, 3.95);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(3.96), Occupancy::Occupied);
    }

    #[test]
    fn without_decay_and_after_a_restart_of_the_clock_nothing_decays() {
        let mut robot = somebody_passed(0.0, 2.0);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        let mut robot = somebody_passed(AFTER, 2.0);
        robot.stamp = 0;
        robot.look(0.5 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        robot.look(AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Free);
    }
}

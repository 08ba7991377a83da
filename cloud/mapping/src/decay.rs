//! What went away without being seen to go? Places that had been free for long and were then hit for a short while are free
//! again after some time without another look at the obstacle.
//!
//! Beams clear what they pass through, but nothing clears where a robot does not look any more: a passer-by in a door would
//! block it for ever. So hits on cells that had been free for long are doubted. A doubt ends in one of three ways: beams find
//! the cell free; hits go on for as long as others take to fade, and it is furniture; or no hit confirms it any more, and it
//! fades. Cells beside anything that lasts are not doubted: no robot fits there, and a wall that a wrong pose or a slanting
//! beam had once seen free must not fade. The idea is that of Nav2's obstacle layers with decay (Macenski et al.,
//! "Spatio-Temporal Voxel Layer", 2020), for one map that keeps both what lasts and what passes. Time is that of the scans.

use std::collections::BTreeMap;
use std::time::Duration;

use zenav_protocol::grid::Occupancy;
use zenav_protocol::time::Stamp;

use super::sensor_model::Evidence;
use super::tile::Bits;
use super::tiles::{TILE_SIDE, Tiles};

/// Cells this near to something that lasts are not doubted.
const BESIDE: i64 = 2;

/// What is remembered of a map in order to let things fade.
#[derive(Clone, Debug)]
pub(super) struct Decay {
    after: Duration,
    /// Time that scans have told of.
    now: Duration,
    newest: Option<Stamp>,
    /// When it is next looked which cells stayed free.
    round: Duration,
    /// Nothing fades before.
    due: Duration,
    tiles: BTreeMap<[i64; 2], Memory>,
}

/// What is remembered of a tile.
#[derive(Clone, Debug)]
struct Memory {
    /// Cells that have been as free as cells get since the last round.
    free: Bits,
    /// Cells that were so for the whole round before, too.
    long_free: Bits,
    /// First and last hit of cells that were long free, by row and column.
    doubts: BTreeMap<(usize, usize), [Duration; 2]>,
}

impl Memory {
    const NONE: Self = Self {
        free: [0; TILE_SIDE],
        long_free: [0; TILE_SIDE],
        doubts: BTreeMap::new(),
    };
}

impl Decay {
    /// Decay after so long without a hit.
    pub(super) fn new(after: Duration) -> Self {
        Self {
            after,
            now: Duration::ZERO,
            newest: None,
            round: after,
            due: Duration::MAX,
            tiles: BTreeMap::new(),
        }
    }

    /// Goes on to a scan's time and lets fade what is due. A clock that began anew counts as standing still.
    pub(super) fn go_on(&mut self, stamp: Stamp, map: &mut Tiles, evidence: &Evidence) {
        let before = self.newest.replace(stamp).unwrap_or(stamp);
        self.now = self.now.saturating_add(stamp.since(before));
        if self.now >= self.due {
            self.fade(map, evidence);
        }
        if self.now >= self.round {
            self.round = self.now.saturating_add(self.after);
            for (at, tile) in map.known() {
                let memory = self.tiles.entry(at).or_insert(Memory::NONE);
                for ((free, long_free), freest) in memory.free.iter_mut().zip(&mut memory.long_free).zip(tile.freest())
                {
                    (*free, *long_free) = (*freest, *free & freest);
                }
            }
        }
    }

    /// Lets everything fade that is in doubt, as if it had not been seen for long.
    pub(super) fn forget(&mut self, map: &mut Tiles, evidence: &Evidence) {
        let after = std::mem::replace(&mut self.after, Duration::ZERO);
        self.fade(map, evidence);
        self.after = after;
    }

    fn fade(&mut self, map: &mut Tiles, evidence: &Evidence) {
        self.due = Duration::MAX;
        for (at, memory) in &mut self.tiles {
            memory.doubts.retain(|(row, column), [_, last]| {
                let fades = last.saturating_add(self.after);
                if fades > self.now {
                    self.due = self.due.min(fades);
                    return true;
                }
                if let Some(index) = map.index(*at)
                    && let Some(tile) = &mut map.tiles[index]
                {
                    map.dirty[index] |= tile.rows()[*row][*column] != evidence.least;
                    tile.set(*column, *row, evidence.least, evidence);
                    memory.free[*row] |= 1 << column;
                    memory.long_free[*row] |= 1 << column;
                }
                false
            });
        }
    }

    /// Takes notice of a tile's hits, before the map does.
    pub(super) fn notice(&mut self, at: [i64; 2], hits: &Bits, map: &Tiles, evidence: &Evidence) {
        let Some(memory) = self.tiles.get_mut(&at) else {
            return;
        };
        let mut new = Vec::new();
        for (row, hits) in hits.iter().enumerate() {
            let mut struck = *hits;
            memory.free[row] &= !struck;
            while struck != 0 {
                let column = struck.trailing_zeros() as usize;
                let bit = struck & struck.wrapping_neg();
                struck ^= bit;
                if memory.long_free[row] & bit != 0 {
                    memory.long_free[row] ^= bit;
                    new.push((row, column));
                } else if let Some([first, last]) = memory.doubts.get_mut(&(row, column)) {
                    // Beams found it gone in between: somebody else is there now.
                    if !is_occupied(map.byte(at, row, column), evidence) {
                        *first = self.now;
                    }
                    *last = self.now;
                    if last.saturating_sub(*first) >= self.after {
                        memory.doubts.remove(&(row, column));
                    }
                }
            }
        }
        for (row, column) in new {
            if !self.is_beside_lasting(at, row, column, map, evidence)
                && let Some(memory) = self.tiles.get_mut(&at)
            {
                memory.doubts.insert((row, column), [self.now; 2]);
                self.due = self.due.min(self.now.saturating_add(self.after));
            }
        }
    }

    fn is_beside_lasting(&self, at: [i64; 2], row: usize, column: usize, map: &Tiles, evidence: &Evidence) -> bool {
        let side = TILE_SIDE as i64;
        let around = |center: i64| center - BESIDE..=center + BESIDE;
        around(at[1] * side + row as i64).any(|y| {
            around(at[0] * side + column as i64).any(|x| {
                let at = [x.div_euclid(side), y.div_euclid(side)];
                let (row, column) = (y.rem_euclid(side) as usize, x.rem_euclid(side) as usize);
                is_occupied(map.byte(at, row, column), evidence)
                    && !self
                        .tiles
                        .get(&at)
                        .is_some_and(|memory| memory.doubts.contains_key(&(row, column)))
            })
        })
    }
}

fn is_occupied(byte: u8, evidence: &Evidence) -> bool {
    Occupancy::of(evidence.percent[usize::from(byte)]) == Occupancy::Occupied
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::geometry::Pose2;
    use zenav_protocol::messages::Scan;

    use super::super::config::MapperConfig;
    use super::super::mapper::{Insertion, Mapper};
    use super::*;

    const AFTER: f64 = 10.0;
    const SECOND: u64 = 1_000_000_000;

    /// A robot at the origin that looks along x or away from it, at two scans a second.
    struct Robot {
        mapper: Mapper,
        stamp: u64,
    }

    impl Robot {
        fn new(fade_after: Option<f64>) -> Self {
            let config = MapperConfig {
                fade_after,
                ..MapperConfig::default()
            };
            Self {
                mapper: Mapper::new(config, "m"),
                stamp: 0,
            }
        }

        /// Looks along `yaw`, where the nearest thing is at `range`.
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
                    base_from_laser: Pose2::IDENTITY,
                    map_from_odom: Pose2::IDENTITY,
                    odom_from_base: Pose2::new(0.01, 0.01, yaw),
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

    /// A wall has been seen at 4 m for long, and somebody was at 2 m for a while.
    fn somebody_passed(fade_after: Option<f64>, secs: f64) -> Robot {
        let mut robot = Robot::new(fade_after);
        robot.look(5.0 * AFTER, AHEAD, 4.0);
        robot.look(secs, AHEAD, 2.0);
        assert_eq!(
            (robot.at(2.01), robot.at(4.01)),
            (Occupancy::Occupied, Occupancy::Occupied)
        );
        robot
    }

    #[test]
    fn somebody_who_went_away_unseen_is_forgotten_and_the_patch_tells() {
        let mut robot = somebody_passed(Some(AFTER), 2.0);
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
    fn what_may_have_passed_is_forgotten_at_once_if_asked_and_the_wall_is_not() {
        let mut robot = somebody_passed(Some(AFTER), 2.0);
        while robot.mapper.take_patch().is_some() {}
        robot.mapper.forget();
        assert_eq!((robot.at(2.01), robot.at(4.01)), (Occupancy::Free, Occupancy::Occupied));
        assert!(robot.mapper.take_patch().is_some(), "who keeps a copy is told");
        robot.look(1.0, AHEAD, 2.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied, "who is still there is seen again");
    }

    #[test]
    fn what_passes_again_is_forgotten_again() {
        let mut robot = somebody_passed(Some(AFTER), 2.0);
        robot.look(2.0 * AFTER, AWAY, 1.0);
        robot.look(2.0, AHEAD, 2.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        robot.look(2.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Free);
        // Seen to be free in between, it is somebody else, not furniture.
        for _ in 0..5 {
            robot.look(2.0, AHEAD, 2.0);
            robot.look(3.0, AHEAD, 4.0);
        }
        robot.look(2.0, AHEAD, 2.0);
        robot.look(2.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Free);
    }

    #[test]
    fn what_stays_longer_than_others_take_to_fade_is_furniture() {
        let mut robot = somebody_passed(Some(AFTER), 1.5 * AFTER);
        robot.look(20.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
    }

    #[test]
    fn walls_and_what_stood_there_from_the_first_look_on_stay() {
        let mut robot = Robot::new(Some(AFTER));
        robot.look(1.0, AHEAD, 4.0);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(4.01), Occupancy::Occupied);
        // A place that was only just found to be free is not doubted.
        let mut robot = Robot::new(Some(AFTER));
        robot.look(0.5 * AFTER, AHEAD, 4.0);
        robot.look(1.0, AHEAD, 2.0);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
    }

    #[test]
    fn a_wall_that_is_seen_a_cell_nearer_for_a_moment_stays() {
        let mut robot = Robot::new(Some(AFTER));
        robot.look(5.0 * AFTER, AHEAD, 4.0);
        robot.look(2.0, AHEAD, 3.95);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(3.96), Occupancy::Occupied);
    }

    #[test]
    fn without_the_option_nothing_fades_and_a_clock_that_begins_anew_makes_nothing_fade() {
        let mut robot = somebody_passed(None, 2.0);
        robot.look(100.0 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        let mut robot = somebody_passed(Some(AFTER), 2.0);
        robot.stamp = 0;
        robot.look(0.5 * AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Occupied);
        robot.look(AFTER, AWAY, 1.0);
        assert_eq!(robot.at(2.01), Occupancy::Free);
    }
}

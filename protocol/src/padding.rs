//! Map padding. How far does a map replica extend beyond the map?
//!
//! Paths may lead through unseen cells, also beyond the map's border. So a replica can be padded with whole tiles of unknown cells, out to
//! every requested position.

use nalgebra::{Point2, Vector2};

use crate::grid::{GridSpec, MAX_CELLS};
use crate::messages::TILE;
use crate::robot::Footprint;

/// Extent of the map that a planner needs, seen or not.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Extent {
    /// Places that the replica must cover, map frame, m.
    pub places: Vec<Point2<f64>>,
    /// Width of the unknown ring around those places and around the map, m.
    pub ring: f64,
}

impl Extent {
    /// The places, with a ring wide enough for a robot of this footprint to drive around everything.
    #[must_use]
    pub fn of(footprint: &Footprint, places: Vec<Point2<f64>>) -> Self {
        Self {
            places,
            ring: 2.0 * footprint.circumscribed_radius() + RING_MARGIN,
        }
    }
}

/// Width of the ring beyond the robot's own width, m.
const RING_MARGIN: f64 = 0.5;

/// A replica keeps earlier extents while their sum has at most this many times the cells of the newest one alone.
const MOST_TIMES: u64 = 4;

/// Padding of a map replica: the union of the requested extents.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Padding {
    /// Lower-left and upper-right corner of all requested places, m.
    bounds: Option<[Point2<f64>; 2]>,
    /// Width of the ring around them and around the map, m.
    ring: f64,
}

impl Padding {
    /// Adds an extent: afterwards its places and the map lie at least the ring's width inside the border. Numbers that are not finite are
    /// ignored.
    pub fn include(&mut self, Extent { places, ring }: &Extent) {
        for place in places.iter().filter(|place| place.coords.iter().all(|c| c.is_finite())) {
            let [low, high] = self.bounds.unwrap_or([*place; 2]);
            self.bounds = Some([low.inf(place), high.sup(place)]);
        }
        if ring.is_finite() {
            self.ring = self.ring.max(*ring);
        }
    }

    /// The padding after a new extent: the union with this one, or the new one alone if the union would be far larger than needed or exceed
    /// the largest map. If the new extent alone exceeds it, the padding stays unchanged.
    #[must_use]
    pub fn widened(&self, extent: &Extent, spec: GridSpec) -> Self {
        let (mut both, mut alone) = (*self, Self::default());
        both.include(extent);
        alone.include(extent);
        let cells = |padding: &Self| Some(padding.padded(spec)?.len() as u64);
        match (cells(&both), cells(&alone)) {
            (Some(sum), Some(least)) if sum <= MOST_TIMES.saturating_mul(least) => both,
            (_, Some(_)) => alone,
            (_, None) => *self,
        }
    }

    /// Geometry of the padded replica of a map. It grows by whole tiles, so that the map's tiles stay aligned. If it would exceed the
    /// largest map, the map's own geometry is returned.
    #[must_use]
    pub fn around(&self, spec: GridSpec) -> GridSpec {
        self.padded(spec).unwrap_or(spec)
    }

    /// As [`Self::around`]; `None` if it would exceed the largest map.
    fn padded(&self, spec: GridSpec) -> Option<GridSpec> {
        if spec.is_empty() || *self == Self::default() {
            return Some(spec);
        }
        let [low, high] = self.bounds.unwrap_or([spec.origin; 2]);
        let size = Vector2::new(f64::from(spec.width), f64::from(spec.height)) * spec.resolution;
        let tile = f64::from(TILE) * spec.resolution;
        let out = Vector2::repeat(self.ring);
        let below = (spec.origin - low.inf(&spec.origin) + out) / tile;
        let above = (high.sup(&(spec.origin + size)) - (spec.origin + size) + out) / tile;
        let tiles = |share: f64| share.ceil().clamp(0.0, 1e6) as u64;
        let side =
            |cells: u32, more: f64, further: f64| u64::from(cells) + (tiles(more) + tiles(further)) * u64::from(TILE);
        let (width, height) = (side(spec.width, below.x, above.x), side(spec.height, below.y, above.y));
        let fits = width.checked_mul(height).is_some_and(|cells| cells <= MAX_CELLS);
        let larger = GridSpec {
            origin: spec.origin - Vector2::new(tiles(below.x) as f64, tiles(below.y) as f64) * tile,
            width: u32::try_from(width).unwrap_or(u32::MAX),
            height: u32::try_from(height).unwrap_or(u32::MAX),
            ..spec
        };
        larger.checked().ok().filter(|_| fits)
    }
}

/// Padding to the left of a map and below it, in columns and rows of tiles.
#[must_use]
pub fn tiles_before(padded: &GridSpec, map: &GridSpec) -> (u32, u32) {
    // Casts saturate.
    let tiles = padded.to_cells(map.origin) / f64::from(TILE);
    (tiles.x.round() as u32, tiles.y.round() as u32)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn spec(width: u32, height: u32) -> GridSpec {
        GridSpec {
            origin: Point2::new(-3.0, 2.0),
            resolution: 0.05,
            width,
            height,
        }
    }

    proptest! {
        #[test]
        fn every_place_lies_inside_the_ring(width in 1_u32..300, height in 1_u32..300, x in -60.0..60.0_f64, y in -60.0..60.0_f64, ring in 0.0..4.0_f64) {
            let (map, place) = (spec(width, height), Point2::new(x, y));
            let mut padding = Padding::default();
            padding.include(&Extent { places: vec![place], ring });
            let copy = padding.around(map);
            for corner in [place, map.origin, map.from_cells(Point2::new(f64::from(width), f64::from(height)))] {
                let p = copy.to_cells(corner) * copy.resolution;
                let far = [p.x, p.y, f64::from(copy.width) * 0.05 - p.x, f64::from(copy.height) * 0.05 - p.y];
                prop_assert!(far.iter().all(|far| *far >= ring - 1e-6), "{far:?}");
            }
            let (columns, rows) = tiles_before(&copy, &map);
            let shift = copy.to_cells(map.origin) - Point2::new(f64::from(columns * TILE), f64::from(rows * TILE));
            prop_assert!(shift.norm() < 1e-6, "tiles stay tiles");
            prop_assert_eq!(padding.around(map), copy);
        }
    }

    #[test]
    fn without_an_extent_or_beyond_the_largest_map_there_is_no_padding() {
        let to = |x| Extent {
            places: vec![Point2::new(x, 0.0)],
            ring: 1.0,
        };
        let mut padding = Padding::default();
        assert_eq!(padding.around(spec(10, 10)), spec(10, 10));
        padding.include(&to(f64::NAN));
        assert_eq!(padding.around(spec(10, 10)).width, 10 + 2 * TILE, "the ring alone");
        // Too far: the earlier padding stays. Far: only the new extent is kept.
        let map = spec(10, 10);
        let wide = padding.widened(&to(9.0), map);
        assert_eq!(wide.widened(&to(1e9), map), wide);
        assert!(wide.widened(&to(400.0), map).around(map).width > 8000);
        assert_eq!(wide.widened(&to(400.0), map).widened(&to(9.0), map), wide);
        padding.include(&to(1e9));
        assert_eq!(padding.around(spec(10, 10)), spec(10, 10));
        assert_eq!(padding.around(spec(0, 0)), spec(0, 0));
    }
}

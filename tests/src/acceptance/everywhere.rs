//! Global localisation. Whether a robot is found in a map without an initial guess, from any place, how fast, and whether failures are
//! reported.
//!
//! Each random place of a map is searched for by one scan, as seen by a lidar of 270 degrees and 25 m.

use std::f64::consts::PI;
use std::time::Duration;

use nalgebra::{Point2, Vector2};
use rand::{RngExt, SeedableRng};
use rand_pcg::Pcg64Mcg;
use zenav_localisation::{Found, KnownMap, LocalisationSettings, find};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::{Cell, Grid, GridSpec, Occupancy, OccupancyGrid};

/// Beams over the field of view, rad, and their range, m.
const LIDAR: (u32, f64, f64) = (360, 1.5 * PI, 25.0);
/// Standard deviation of a range, m.
const NOISE: f64 = 0.01;
/// Largest error of a right answer, m and rad.
const RIGHT: (f64, f64) = (0.1, 0.035);
/// Free space around each place, m.
const ROOM: f64 = 0.3;
/// Fewest returns: places with fewer are left out.
const FEWEST: usize = 60;

/// Answers for all places.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Processor time of each answer, s, in order.
    pub took: Vec<f64>,
    /// A unique and right place.
    pub right: usize,
    /// Several places, the right one among them.
    pub ambiguous: usize,
    /// Several places, all of them wrong.
    pub ambiguous_wrong: usize,
    /// No place.
    pub nowhere: usize,
    /// The budget was used up.
    pub out_of_budget: usize,
    /// A unique and wrong place: the truth, the answer, and the share of the scan that agreed there.
    pub wrong: Vec<(Pose2, Pose2, f64)>,
}

impl Tally {
    /// The processor time that a share of all answers does not exceed, s.
    #[must_use]
    pub fn within(&self, share: f64) -> f64 {
        let mut took = self.took.clone();
        took.sort_by(f64::total_cmp);
        let last = took.len().saturating_sub(1);
        took.get((share * last as f64).ceil() as usize)
            .copied()
            .unwrap_or(f64::NAN)
    }

    /// Summary in one line.
    #[must_use]
    pub fn line(&self) -> String {
        format!(
            "{} places: {} right, {} ambiguous ({} without the right one), {} nowhere, {} out of budget, {} wrong; {:.2} s median, {:.2} s 95 %, {:.2} s at most",
            self.took.len(),
            self.right,
            self.ambiguous + self.ambiguous_wrong,
            self.ambiguous_wrong,
            self.nowhere,
            self.out_of_budget,
            self.wrong.len(),
            self.within(0.5),
            self.within(0.95),
            self.within(1.0)
        )
    }
}

/// Searches for `count` random places of a map, drawn by a seed; `time` is the processor time so far.
pub fn ask_everywhere(
    map: &OccupancyGrid,
    count: usize,
    seed: u64,
    settings: &LocalisationSettings,
    time: &dyn Fn() -> Duration,
) -> Tally {
    let known = KnownMap::new(map, settings.tracking.sigma);
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let mut tally = Tally::default();
    let mut tries = 0;
    while tally.took.len() < count && tries < 1000 * count {
        tries += 1;
        let Some(truth) = place(map, &mut rng) else { continue };
        let points = look(map, truth, &mut rng);
        if points.len() < FEWEST {
            continue;
        }
        let begun = time();
        let found = find(&known, Point2::origin(), &points, settings);
        tally.took.push(time().saturating_sub(begun).as_secs_f64());
        let is_right =
            |pose: Pose2| pose.distance(&truth) <= RIGHT.0 && wrap_angle(pose.yaw - truth.yaw).abs() <= RIGHT.1;
        match found {
            Found::Unique(place) if is_right(place.pose) => tally.right += 1,
            Found::Unique(place) => tally.wrong.push((truth, place.pose, place.evidence.agreeing)),
            Found::Ambiguous(places) if places.iter().any(|place| is_right(place.pose)) => tally.ambiguous += 1,
            Found::Ambiguous(_) => tally.ambiguous_wrong += 1,
            Found::Nowhere => tally.nowhere += 1,
            Found::OutOfBudget => tally.out_of_budget += 1,
        }
    }
    tally
}

/// Draws a random pose; `None` unless it is free with room around it.
fn place(map: &OccupancyGrid, rng: &mut Pcg64Mcg) -> Option<Pose2> {
    let spec = map.spec();
    let cell = Cell::new(rng.random_range(0..spec.width), rng.random_range(0..spec.height));
    let reach = (ROOM / spec.resolution).ceil() as i64;
    let is_free = |x: i64, y: i64| {
        let inside = x >= 0 && y >= 0 && x < i64::from(spec.width) && y < i64::from(spec.height);
        inside && Occupancy::of(map[Cell::new(x as u32, y as u32)]) == Occupancy::Free
    };
    let (x, y) = (i64::from(cell.x), i64::from(cell.y));
    let free = (-reach..=reach).all(|dx| (-reach..=reach).all(|dy| is_free(x + dx, y + dy)));
    let at = spec.center(cell);
    let off = |rng: &mut Pcg64Mcg| (rng.random::<f64>() - 0.5) * spec.resolution;
    let (dx, dy) = (off(rng), off(rng));
    let yaw = rng.random_range(-PI..PI);
    free.then(|| Pose2::new(at.x + dx, at.y + dy, yaw))
}

/// The ends of a lidar's beams at a pose, in its own frame.
fn look(map: &OccupancyGrid, pose: Pose2, rng: &mut Pcg64Mcg) -> Vec<Point2<f64>> {
    let (beams, field, range) = LIDAR;
    let step = 0.25 * map.spec().resolution;
    let mut points = Vec::new();
    for beam in 0..beams {
        let angle = field * (f64::from(beam) / f64::from(beams - 1) - 0.5);
        let (sin, cos) = (pose.yaw + angle).sin_cos();
        let way = Vector2::new(cos, sin);
        let meets = |count: &u32| {
            let at = pose.position() + way * (step * f64::from(*count));
            map.at(at).is_none_or(|value| Occupancy::of(*value) != Occupancy::Free)
        };
        let Some(count) = (1..(range / step) as u32).find(meets) else {
            continue;
        };
        let end = pose.position() + way * (step * f64::from(count));
        // Beams beyond the map have no return.
        if map
            .at(end)
            .is_none_or(|value| Occupancy::of(*value) != Occupancy::Occupied)
        {
            continue;
        }
        let noise: f64 = (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let distance = step * f64::from(count) + NOISE * noise;
        points.push(Point2::new(distance * angle.cos(), distance * angle.sin()));
    }
    points
}

/// An office of 100 m by 100 m: corridors with rooms of all sizes, doors and furniture.
#[must_use]
pub fn office(seed: u64) -> OccupancyGrid {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let (side, resolution) = (100.0, 0.05);
    let spec = GridSpec {
        origin: Point2::origin(),
        resolution,
        width: (side / resolution) as u32,
        height: (side / resolution) as u32,
    };
    let mut map = Grid::filled(spec, Occupancy::FREE);
    let mut fill = |low: (f64, f64), high: (f64, f64), value: i8| {
        let cell = |metres: f64| (metres / resolution).clamp(0.0, f64::from(spec.width)) as u32;
        for y in cell(low.1)..cell(high.1) {
            for x in cell(low.0)..cell(high.0) {
                map[Cell::new(x, y)] = value;
            }
        }
    };
    let wall = 0.15;
    let (taken, free) = (Occupancy::OCCUPIED, Occupancy::FREE);
    for (low, high) in [
        ((0.0, 0.0), (side, wall)),
        ((0.0, side - wall), (side, side)),
        ((0.0, 0.0), (wall, side)),
        ((side - wall, 0.0), (side, side)),
    ] {
        fill(low, high, taken);
    }
    // Corridors along x with a row of rooms on each side, joined by one corridor along y.
    let mut y = 0.0;
    while y < side - 8.0 {
        let (below, corridor) = (rng.random_range(4.0..8.0), rng.random_range(1.8..3.0));
        let above = rng.random_range(4.0..8.0);
        let rows = [
            (y, y + below, true),
            (y + below + corridor, y + below + corridor + above, false),
        ];
        for (low, high, is_below) in rows {
            let high = f64::min(high, side);
            let mut x = 0.0;
            while x < side - 2.0 {
                let width: f64 = rng.random_range(3.0..9.0);
                let end = f64::min(x + width, side);
                fill((end, low), (end + wall, high), taken);
                let front = if is_below { high } else { low };
                fill((x, front), (end, front + wall), taken);
                let door = rng.random_range(x + 0.4..f64::max(end - 1.4, x + 0.5));
                fill((door, front), (door + 1.0, front + wall), free);
                for _ in 0..rng.random_range(1..6) {
                    let at = (rng.random_range(x..end), rng.random_range(low..high));
                    let size = (rng.random_range(0.3..1.6), rng.random_range(0.3..1.0));
                    fill(at, (f64::min(at.0 + size.0, end), f64::min(at.1 + size.1, high)), taken);
                }
                x = end;
            }
        }
        y += below + corridor + above;
        fill((0.0, y), (side, y + wall), taken);
    }
    fill((48.0, wall), (50.5, side - wall), free);
    map
}

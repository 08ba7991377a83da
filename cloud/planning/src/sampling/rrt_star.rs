//! How does the way that was found become the shortest one? A tree with costs, new vertices where they can still help, for as long as there is time.
//!
//! Sources: Karaman and Frazzoli, "Sampling-Based Algorithms for Optimal Motion Planning", 2011 (RRT*, the radius within which vertices are
//! rewired); Gammell, Srinivasa and Barfoot, "Informed RRT*", 2014 (samples and vertices only where a shorter way can lead). The first way is that
//! of [`rrt_connect`](super::rrt_connect). Each better way is pulled taut and its corners become vertices. A share of the samples is drawn at the
//! convex corners of obstacles, where shortest ways bend; the rest stays uniform, which is what optimality in the limit rests on.

use nalgebra::Point2;

use super::Search;
use super::rewiring::CostTree;
use super::sampler::Ellipse;
use super::shortcut::{length, tighten};
use super::tree::Ground;
use zenav_space::LineOfSight;

/// Samples between two looks at whether the tree knows a better way.
const PERIOD: u64 = 128;
/// Better by less than this share is not worth pulling taut.
const WORTH: f64 = 1e-5;

/// Improves a way until the search's budget ends; never longer than it was.
pub fn improve<S: LineOfSight>(
    ground: &Ground<'_, S>,
    tree: &mut CostTree,
    way: Vec<Point2<f64>>,
    search: &mut Search<'_>,
) -> Vec<Point2<f64>> {
    let mut best = way;
    let (Some(start), Some(goal)) = (best.first().copied(), best.last().copied()) else {
        return best;
    };
    let budget = search.budget;
    tighten(ground.sight, &mut best, || budget.is_cancelled());
    let mut bound = length(&best);
    tree.plant(ground.sight.size(), &best);
    search.sampler.narrow(Ellipse::new([start, goal], bound));
    let last = search.samples.saturating_add(search.options.improving);
    // Nothing is shorter than straight.
    while bound > (goal - start).norm() * (1.0 + 1e-9) && search.samples < last && search.next().is_ok() {
        let corner = search.sampler.unit() < search.options.corners;
        let sample = if corner {
            search.sampler.corner(ground.lattice)
        } else {
            search.sampler.free(ground.lattice)
        };
        if let Some(sample) = sample {
            let radius = radius(search.sampler.free_area(), tree.len()).min(ground.step);
            tree.insert(ground.sight, sample, radius, ground.step, bound);
        }
        if search.samples.is_multiple_of(PERIOD) && tree.cost() < bound * (1.0 - WORTH) {
            let mut way = tree.way();
            tighten(ground.sight, &mut way, || budget.is_cancelled());
            best = way;
            bound = length(&best);
            let radius = radius(search.sampler.free_area(), tree.len()).min(ground.step);
            tree.lay(ground.sight, &best, radius);
            search.sampler.narrow(Ellipse::new([start, goal], bound));
        }
    }
    if tree.cost() < bound { tree.way() } else { best }
}

/// The radius within which `vertices` that are spread over an area are rewired, cells: the least one that optimality in the limit asks for
/// (Karaman and Frazzoli, theorem 38), and a tenth.
fn radius(area: f64, vertices: usize) -> f64 {
    let n = vertices.max(2) as f64;
    1.1 * 2.0 * (1.5 * area / std::f64::consts::PI).sqrt() * (n.ln() / n).sqrt()
}

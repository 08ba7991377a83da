//! Jump points on bitmaps. One bitmap of stops for each direction: a run over free cells stops at an obstacle, or where an obstacle
//! beside it ends.
//!
//! A run is a search for the next set bit, 64 cells at a time: along rows, along columns on a transposed copy, and along diagonals on
//! sheared copies. Diagonal runs stop at obstacles too, and at each cell from which a straight run leads to a jump point; all other cells
//! are skipped.
//!
//! Memory: eight bits a cell; built in time linear in them.
//!
//! Source: Harabor and Grastien, "Improving Jump Point Search", ICAPS 2014 (block scanning); the diagonals are our own.

use zenav_protocol::grid::Cell;

use super::grid_graph::{GridGraph, STEPS, Step};
use super::lines::Lines;

/// The stops of a graph. Cells are in padded coordinates, counted from the graph's border.
#[derive(Clone, Debug)]
pub struct JumpGrid {
    rays: [Ray; 8],
}

/// A direction and the stops of the runs along it.
///
/// Its lines of bits are rows, columns, or diagonals that wrap around at the graph's last column. A run goes towards higher bits; for the
/// opposite direction the lines are reversed.
#[derive(Clone, Debug)]
pub(super) struct Ray {
    /// One step of it.
    pub(super) step: Step,
    stops: Lines,
    /// Columns of the graph, padding included.
    pitch: u32,
}

impl Ray {
    /// Steps from a free cell to the next stop, at least one.
    #[inline]
    pub(super) fn length(&self, from: Cell) -> u32 {
        let Step { x, y, .. } = self.step;
        let (line, along) = if y == 0 {
            (from.y, from.x)
        } else {
            (self.line(from), from.y)
        };
        let is_turned = if y == 0 { x < 0 } else { y < 0 };
        let from = if is_turned {
            self.stops.stride as u32 * 64 - 1 - along
        } else {
            along
        };
        let mut at = line as usize * self.stops.stride + from as usize / 64;
        let mut found = self.stops.words[at] >> (from % 64) >> 1;
        if found != 0 {
            return found.trailing_zeros() + 1;
        }
        let mut passed = 64 - from % 64;
        loop {
            at += 1;
            found = self.stops.words[at];
            if found != 0 {
                return passed + found.trailing_zeros();
            }
            // The blocked border stops every run.
            passed += 64;
        }
    }

    /// The column or the diagonal of a cell.
    #[inline]
    fn line(&self, Cell { x, y }: Cell) -> u32 {
        let y = if y < self.pitch { y } else { y % self.pitch };
        let line = match self.step.x * self.step.y {
            0 => x,
            1 => x + self.pitch - y,
            _ => x + y,
        };
        if line < self.pitch { line } else { line - self.pitch }
    }

    /// The cell `steps` steps on.
    #[inline]
    pub(super) fn after(&self, from: Cell, steps: u32) -> Cell {
        let Step { x, y, .. } = self.step;
        let on = |from: u32, step: i32| from.wrapping_add_signed(step * steps.cast_signed());
        Cell::new(on(from.x, x), on(from.y, y))
    }
}

impl JumpGrid {
    /// Prepares a graph: linear in its words.
    #[must_use]
    pub fn new(graph: &GridGraph) -> Self {
        let rows = graph.rows();
        let columns = rows.transposed();
        let [east, west] = stops(&rows);
        let [north, south] = stops(&columns);
        let leads = [
            leads(&rows, &east, true),
            leads(&rows, &west, false),
            leads(&columns, &north, true).transposed(),
            leads(&columns, &south, false).transposed(),
        ];
        let squares = squares(&rows);
        let mut straight = [east, west.reversed(), north, south.reversed()].map(Some);
        let rays = [0, 1, 2, 3, 4, 5, 6, 7].map(|direction| {
            let step = STEPS[direction];
            let stops = match straight.get_mut(direction).and_then(Option::take) {
                Some(stops) => stops,
                None => {
                    let [side, end] = [usize::from(step.x < 0), 2 + usize::from(step.y < 0)].map(|side| &leads[side]);
                    let turns = turns(step, side, end, &squares).sheared(step.x * step.y);
                    if step.y < 0 { turns.reversed() } else { turns }
                }
            };
            let pitch = graph.pitch();
            Ray { step, stops, pitch }
        });
        Self { rays }
    }

    /// A direction, by its place in [`STEPS`].
    #[inline]
    pub(super) fn ray(&self, direction: usize) -> &Ray {
        &self.rays[direction & 7]
    }
}

/// Stops of runs towards higher and towards lower positions along each line of free cells.
fn stops(free: &Lines) -> [Lines; 2] {
    let mut up = free.clone();
    up.words.iter_mut().for_each(|word| *word = !*word);
    let mut down = up.clone();
    for line in 0..free.count() {
        let bits = free.line(line);
        for (at, here) in bits.iter().enumerate().filter(|(_, here)| **here != 0) {
            let before = at.checked_sub(1).map_or(0, |at| bits[at] >> 63);
            let after = bits.get(at + 1).map_or(0, |bits| bits << 63);
            // Free cells directly past the end of an obstacle: a run in a line beside them may turn there.
            let (ends_up, ends_down) = (here & !(here << 1 | before), here & !(here >> 1 | after));
            // The border's lines hold no free cell, so every line that does has a line on both sides.
            for beside in [line - 1, line + 1] {
                up.words[beside * up.stride + at] |= ends_up;
                down.words[beside * up.stride + at] |= ends_down;
            }
        }
    }
    [up, down]
}

/// Cells from which a run towards higher positions (`up`), or lower ones, leads to a jump point.
fn leads(free: &Lines, stops: &Lines, up: bool) -> Lines {
    let mut leads = free.clone();
    // Jump points are carried towards higher bits.
    let turned = |word: u64| if up { word.reverse_bits() } else { word };
    let lines = leads.words.chunks_mut(stops.stride);
    for (line, stops) in lines.zip(stops.words.chunks(stops.stride)) {
        let mut carry = false;
        for i in 0..line.len() {
            let at = if up { line.len() - 1 - i } else { i };
            line[at] = turned(carries(turned(line[at] & stops[at]), turned(stops[at]), &mut carry));
        }
    }
    leads
}

/// Bits above jump points, up to the next stop, as the carries of a sum: a jump point generates a carry, a cell that is no stop
/// propagates it.
fn carries(jumps: u64, stops: u64, carry: &mut bool) -> u64 {
    let passing = jumps | !stops;
    let (sum, first) = passing.overflowing_add(jumps);
    let (sum, second) = sum.overflowing_add(u64::from(*carry));
    *carry = first || second;
    sum ^ passing ^ jumps
}

/// Cells that are free together with the cells to the right, above, and diagonally between.
fn squares(rows: &Lines) -> Lines {
    let mut squares = rows.clone();
    let stride = rows.stride;
    for at in 0..rows.words.len() {
        let both = |at: usize| {
            rows.words
                .get(at)
                .map_or(0, |word| word & rows.words.get(at + stride).copied().unwrap_or(0))
        };
        // The last column is blocked, so the word after a row's last one does not matter.
        squares.words[at] = both(at) & (both(at) >> 1 | both(at + 1) << 63);
    }
    squares
}

/// Stops of diagonal runs: where the next step is blocked, and where a horizontal or vertical run leads to a jump point.
fn turns(step: Step, side: &Lines, end: &Lines, squares: &Lines) -> Lines {
    let mut turns = squares.clone();
    let below = if step.y < 0 { squares.stride } else { 0 };
    for (at, word) in turns.words.iter_mut().enumerate() {
        // The square that the step crosses, by its lower left cell.
        let square = |at: usize| at.checked_sub(below).map_or(0, |at| squares.words[at]);
        let can_go = if step.x > 0 {
            square(at)
        } else {
            square(at) << 1 | at.checked_sub(1).map_or(0, square) >> 63
        };
        *word = side.words[at] | end.words[at] | !can_go;
    }
    turns
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use zenav_space::BitGrid;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(40))]

        #[test]
        fn runs_stop_where_a_walk_step_by_step_would(width in 1_u32..150, height in 1_u32..150, blocks in prop::collection::vec((0_u32..150, 0_u32..150, 1_u32..20, 1_u32..20), 0..40)) {
            let free = BitGrid::from_fn(width, height, |cell| {
                !blocks.iter().any(|(x, y, w, h)| cell.x >= *x && cell.x < x + w && cell.y >= *y && cell.y < y + h)
            });
            let graph = GridGraph::new(&free).unwrap();
            let grid = JumpGrid::new(&graph);
            let is_free = |cell: Cell| free.get(Cell::new(cell.x.wrapping_sub(1), cell.y.wrapping_sub(1)));
            let is_jump = |cell: Cell, step: Step| {
                is_free(cell) && [1, -1].iter().any(|side| {
                    let beside = |back: i32| Cell::new(cell.x.wrapping_add_signed(step.y * side - step.x * back), cell.y.wrapping_add_signed(step.x * side - step.y * back));
                    is_free(beside(0)) && !is_free(beside(1))
                })
            };
            let walk = |from: Cell, ray: &Ray| {
                let mut at = ray.after(from, 1);
                while is_free(at) && !is_jump(at, ray.step) {
                    at = ray.after(at, 1);
                }
                at
            };
            for x in 1..=width {
                let from = Cell::new(x, (x * 61 + width) % height + 1);
                for direction in (0..8).filter(|_| is_free(from)) {
                    let ray = grid.ray(direction);
                    if direction < 4 {
                        prop_assert_eq!(ray.after(from, ray.length(from)), walk(from, ray));
                    } else if graph.steps(graph.padded(from)) >> direction & 1 == 1 {
                        let sides = [usize::from(ray.step.x < 0), 2 + usize::from(ray.step.y < 0)].map(|side| grid.ray(side));
                        let mut at = ray.after(from, 1);
                        while graph.steps(graph.padded(at)) >> direction & 1 == 1 && !sides.iter().any(|side| is_free(walk(at, side))) {
                            at = ray.after(at, 1);
                        }
                        prop_assert_eq!(ray.after(from, ray.length(from)), at);
                    }
                }
            }
        }
    }
}

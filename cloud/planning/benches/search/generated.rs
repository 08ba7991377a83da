//! Generated maps. Five kinds of a million cells each, made from a seed, for runs without given maps.

use rand::{RngExt as _, SeedableRng as _};
use rand_pcg::Pcg64Mcg;
use zenav_protocol::grid::Cell;
use zenav_space::BitGrid;

use super::{Case, queries};

/// Side of a map, cells.
const SIDE: u32 = 1000;

/// Draws a map.
type Make = fn(&mut Pcg64Mcg) -> BitGrid;

/// The generated maps whose name holds `only`.
pub fn maps(only: &str) -> Vec<Case> {
    let kinds: [(&str, Make); 5] = [
        ("office", office),
        ("clutter-10", |random| clutter(random, 0.10)),
        ("clutter-25", |random| clutter(random, 0.25)),
        ("maze", maze),
        ("hall", hall),
    ];
    let chosen = kinds.iter().filter(|(name, _)| name.contains(only));
    chosen
        .map(|(name, make)| {
            let free = make(&mut Pcg64Mcg::seed_from_u64(queries::SEED));
            let queries = queries::drawn(&free);
            Case {
                name: (*name).to_owned(),
                free,
                queries,
            }
        })
        .collect()
}

/// Free space within an outer wall.
fn open() -> BitGrid {
    BitGrid::from_fn(SIDE, SIDE, |cell| {
        cell.x > 0 && cell.y > 0 && cell.x + 1 < SIDE && cell.y + 1 < SIDE
    })
}

fn fill(free: &mut BitGrid, [x, y]: [u32; 2], [width, height]: [u32; 2], value: bool) {
    for row in y..y + height {
        for column in x..x + width {
            free.set(Cell::new(column, row), value);
        }
    }
}

/// Rooms of 5 m at 5 cm in blocks of two by two between corridors; each room has a door and furniture.
fn office(random: &mut Pcg64Mcg) -> BitGrid {
    const ROOM: u32 = 100;
    const CORRIDOR: u32 = 40;
    const BLOCK: u32 = 2 * ROOM + CORRIDOR;
    let mut free = open();
    for by in 0..SIDE / BLOCK {
        for bx in 0..SIDE / BLOCK {
            let corner = [bx * BLOCK + CORRIDOR, by * BLOCK + CORRIDOR];
            fill(&mut free, corner, [2 * ROOM; 2], false);
            for (i, j) in [(0, 0), (1, 0), (0, 1), (1, 1)] {
                let [x, y] = [corner[0] + i * ROOM, corner[1] + j * ROOM];
                fill(&mut free, [x + 2, y + 2], [ROOM - 4; 2], true);
                // To the corridor at the left or right of the block, or through to the neighbouring room.
                let door = y + random.random_range(10..ROOM - 30);
                fill(&mut free, [if i == 0 { x } else { x + ROOM - 2 }, door], [2, 18], true);
                if random.random_bool(0.3) {
                    fill(
                        &mut free,
                        [corner[0] + ROOM - 2, y + random.random_range(10..ROOM - 30)],
                        [4, 18],
                        true,
                    );
                }
                for _ in 0..random.random_range(3..9) {
                    let size = [random.random_range(4..24), random.random_range(4..24)];
                    let at = [
                        x + random.random_range(22..ROOM - 46),
                        y + random.random_range(4..ROOM - 28),
                    ];
                    fill(&mut free, at, size, false);
                }
            }
        }
    }
    free
}

/// Single blocked cells, uniformly distributed.
fn clutter(random: &mut Pcg64Mcg, share: f64) -> BitGrid {
    BitGrid::from_fn(SIDE, SIDE, |_| !random.random_bool(share))
}

/// Corridors of 8 cells between walls of 2, without loops.
fn maze(random: &mut Pcg64Mcg) -> BitGrid {
    const WAY: u32 = 8;
    const PITCH: u32 = WAY + 2;
    let side = (SIDE - 2) / PITCH;
    let mut free = BitGrid::new(SIDE, SIDE);
    let mut seen = BitGrid::new(side, side);
    let mut stack = vec![Cell::new(0, 0)];
    seen.set(stack[0], true);
    fill(&mut free, [2, 2], [WAY; 2], true);
    while let Some(cell) = stack.last().copied() {
        let around = [(1, 0), (-1, 0), (0, 1), (0, -1)]
            .map(|(x, y)| Cell::new(cell.x.wrapping_add_signed(x), cell.y.wrapping_add_signed(y)));
        let next: Vec<Cell> = around
            .into_iter()
            .filter(|to| to.x < side && to.y < side && !seen.get(*to))
            .collect();
        if next.is_empty() {
            stack.pop();
            continue;
        }
        let to = next[random.random_range(0..next.len())];
        seen.set(to, true);
        let (low, high) = (
            Cell::new(cell.x.min(to.x), cell.y.min(to.y)),
            Cell::new(cell.x.max(to.x), cell.y.max(to.y)),
        );
        let size = [(high.x - low.x) * PITCH + WAY, (high.y - low.y) * PITCH + WAY];
        fill(&mut free, [2 + low.x * PITCH, 2 + low.y * PITCH], size, true);
        stack.push(to);
    }
    free
}

/// A hall with shelves and pillars.
fn hall(random: &mut Pcg64Mcg) -> BitGrid {
    let mut free = open();
    for _ in 0..60 {
        let [long, thin] = [random.random_range(10..120), random.random_range(3..10)];
        let size = if random.random_bool(0.5) {
            [long, thin]
        } else {
            [thin, long]
        };
        let at = [
            random.random_range(1..SIDE - size[0]),
            random.random_range(1..SIDE - size[1]),
        ];
        fill(&mut free, at, size, false);
    }
    free
}

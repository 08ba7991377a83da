//! Random worlds. A walled square with table legs, posts, boxes and partitions, and movers among them.

use std::fmt::Write as _;

use nalgebra::Point2;
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::polygon::{Edge, edges};
use zenav_protocol::robot::Footprint;
use zenav_sim::World;

use super::sim_rig::SimRigError;

/// Half the side of the world, m.
pub const HALF: f64 = 4.0;
/// Paths drawn for a mover; if none is free it walks at random.
const PATHS: u32 = 50;
/// Spacing of collision checks along a path, m.
const STEP: f64 = 0.05;

/// Seeded random numbers.
pub struct Rng(Pcg64Mcg);

impl Rng {
    /// The generator of a seed; `purpose` makes streams of one seed independent.
    #[must_use]
    pub fn new(seed: u64, purpose: u64) -> Self {
        let spread = u128::from(seed).wrapping_mul(0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c835);
        let mut rng = Pcg64Mcg::new(spread ^ (u128::from(purpose) << 64) | 1);
        // The first draws of neighbouring states are similar.
        for _ in 0..8 {
            let _: u64 = rng.random();
        }
        Self(rng)
    }

    /// Uniform between two bounds.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// Uniform whole number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.0.random::<f64>() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Standard normal (Box and Muller).
    pub fn gauss(&mut self) -> f64 {
        let (radius, turn) = (self.0.random::<f64>().max(1e-300), self.0.random::<f64>());
        (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
    }

    /// True with this probability.
    pub fn chance(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }
}

/// A random world. Movers move at up to `mover_speed` (m/s); zero for a static world.
///
/// # Errors
/// [`SimRigError::World`] when the generated file is not a valid world.
pub fn random_world(rng: &mut Rng, mover_speed: f64) -> Result<World, SimRigError> {
    let side = 2.0 * HALF;
    let mut text = format!(
        "name = \"random\"\nsize = [{side}, {side}]\norigin = [{}, {}]\n",
        -HALF, -HALF
    );
    let at = |rng: &mut Rng| rng.between(-HALF, HALF);
    for (from, to) in [
        ((-1, -1), (1, -1)),
        ((1, -1), (1, 1)),
        ((1, 1), (-1, 1)),
        ((-1, 1), (-1, -1)),
    ] {
        let place = |(x, y): (i32, i32)| format!("[{}, {}]", f64::from(x) * HALF, f64::from(y) * HALF);
        let _ = write!(
            text,
            "[[wall]]\nfrom = {}\nto = {}\nthickness = 0.1\n",
            place(from),
            place(to)
        );
    }
    for _ in 0..4 + rng.below(14) {
        let (x, y) = (at(rng), at(rng));
        let _ = match rng.below(4) {
            0 => write!(
                text,
                "[[circle]]\nx = {x}\ny = {y}\nradius = {}\n",
                rng.between(0.015, 0.04)
            ),
            1 => write!(
                text,
                "[[circle]]\nx = {x}\ny = {y}\nradius = {}\n",
                rng.between(0.05, 0.5)
            ),
            2 => write!(
                text,
                "[[wall]]\nfrom = [{x}, {y}]\nto = [{}, {}]\nthickness = {}\n",
                x + rng.between(0.2, 1.5),
                y + rng.between(-1.5, 1.5),
                rng.between(0.02, 0.15)
            ),
            _ => {
                let (half, breadth, turn) = (rng.between(0.05, 0.8), rng.between(0.05, 0.5), rng.between(0.0, 3.1));
                let (sin, cos) = f64::sin_cos(turn);
                let corners = [(1.0, 1.0), (-1.0, 1.0), (-1.0, -1.0), (1.0, -1.0)].map(|(a, b)| {
                    let (u, v) = (a * half, b * breadth);
                    format!("[{}, {}]", x + cos * u - sin * v, y + sin * u + cos * v)
                });
                write!(text, "[[polygon]]\npoints = [{}]\n", corners.join(", "))
            }
        };
    }
    if mover_speed > 0.0 {
        let walls = world(&text)?;
        for _ in 0..1 + rng.below(4) {
            let speed = mover_speed * rng.between(0.1, 1.0);
            let radius = rng.between(0.08, 0.35);
            let _ = write!(text, "[[mover]]\nradius = {radius}\nspeed = {speed}\n");
            let path = (0..PATHS).find_map(|_| {
                let corners: Vec<_> = (0..2 + rng.below(3)).map(|_| Point2::new(at(rng), at(rng))).collect();
                is_free(&walls, radius, &corners).then_some(corners)
            });
            let _ = match path.filter(|_| rng.chance(0.7)) {
                Some(corners) => {
                    let corners: Vec<_> = corners.iter().map(|at| format!("[{}, {}]", at.x, at.y)).collect();
                    writeln!(text, "path = [{}]", corners.join(", "))
                }
                None => write!(
                    text,
                    "start = [{}, {}]\nwalk = [[{}, {}], [{HALF}, {HALF}]]\n",
                    at(rng),
                    at(rng),
                    -HALF,
                    -HALF
                ),
            };
        }
    }
    world(&text)
}

fn world(text: &str) -> Result<World, SimRigError> {
    Ok(World::from_toml(text, "random", &|_| {
        Err("a random world has no map".to_owned())
    })?)
}

/// Whether a disc is free all along a closed path.
fn is_free(walls: &World, radius: f64, corners: &[Point2<f64>]) -> bool {
    edges(corners).all(|Edge { a: from, b: to }| {
        let steps = ((to - from).norm() / STEP).ceil().max(1.0);
        (0..=steps as u32).all(|step| {
            let at = from + (to - from) * (f64::from(step) / steps);
            walls.clearance(&Footprint::Radius(radius), Pose2::new(at.x, at.y, 0.0)) > 0.0
        })
    })
}

/// Writes a wall 0.1 m thick into a world's file.
pub fn wall(text: &mut String, from: (f64, f64), to: (f64, f64)) {
    let _ = write!(
        text,
        "[[wall]]\nfrom = [{}, {}]\nto = [{}, {}]\nthickness = 0.1\n",
        from.0, from.1, to.0, to.1
    );
}

/// Writes the four walls around a floor with a corner at the origin; `size`: length and width, m.
pub fn outer_walls(text: &mut String, (long, wide): (f64, f64)) {
    let corners = [(0.0, 0.0), (long, 0.0), (long, wide), (0.0, wide)];
    for (nth, from) in corners.into_iter().enumerate() {
        wall(text, from, corners[(nth + 1) % 4]);
    }
}

//! What does a random world look like? A walled square with legs, posts, boxes and partitions, and movers among them.

use std::fmt::Write as _;

use nalgebra::Point2;
use rand::RngExt as _;
use rand_pcg::Pcg64Mcg;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;
use zenav_sim::World;

use super::sim_rig::SimRigError;

/// Half the side of the square, m.
pub const HALF: f64 = 4.0;
/// Paths that are drawn for a mover; where none is free it walks at random.
const PATHS: u32 = 50;
/// Spacing of what is looked at on a path, m.
const STEP: f64 = 0.05;

/// Draws from ranges.
pub struct Rng(Pcg64Mcg);

impl Rng {
    /// The dice of a seed and what they are for.
    #[must_use]
    pub fn new(seed: u64, purpose: u64) -> Self {
        let spread = u128::from(seed).wrapping_mul(0x9e37_79b9_7f4a_7c15_f39c_c060_5ced_c835);
        let mut rng = Pcg64Mcg::new(spread ^ (u128::from(purpose) << 64) | 1);
        // The first draws of neighbouring states are alike.
        for _ in 0..8 {
            let _: u64 = rng.random();
        }
        Self(rng)
    }

    /// A number between two.
    pub fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.0.random::<f64>()
    }

    /// A whole number below `count`.
    pub fn below(&mut self, count: usize) -> usize {
        ((self.0.random::<f64>() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// A standard normal number (Box and Muller).
    pub fn gauss(&mut self) -> f64 {
        let (radius, turn) = (self.0.random::<f64>().max(1e-300), self.0.random::<f64>());
        (-2.0 * radius.ln()).sqrt() * (std::f64::consts::TAU * turn).cos()
    }

    /// True with a chance.
    pub fn chance(&mut self, share: f64) -> bool {
        self.0.random::<f64>() < share
    }
}

/// A random world. Movers go at up to `mover_speed` (m/s); zero for a world that stands still.
///
/// # Errors
/// [`SimRigError::World`] when the generator wrote what a world file may not say.
pub fn random(dice: &mut Rng, mover_speed: f64) -> Result<World, SimRigError> {
    let side = 2.0 * HALF;
    let mut text = format!(
        "name = \"random\"\nsize = [{side}, {side}]\norigin = [{}, {}]\n",
        -HALF, -HALF
    );
    let at = |dice: &mut Rng| dice.between(-HALF, HALF);
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
    for _ in 0..4 + dice.below(14) {
        let (x, y) = (at(dice), at(dice));
        let _ = match dice.below(4) {
            0 => write!(
                text,
                "[[circle]]\nx = {x}\ny = {y}\nradius = {}\n",
                dice.between(0.015, 0.04)
            ),
            1 => write!(
                text,
                "[[circle]]\nx = {x}\ny = {y}\nradius = {}\n",
                dice.between(0.05, 0.5)
            ),
            2 => write!(
                text,
                "[[wall]]\nfrom = [{x}, {y}]\nto = [{}, {}]\nthickness = {}\n",
                x + dice.between(0.2, 1.5),
                y + dice.between(-1.5, 1.5),
                dice.between(0.02, 0.15)
            ),
            _ => {
                let (half, breadth, turn) = (dice.between(0.05, 0.8), dice.between(0.05, 0.5), dice.between(0.0, 3.1));
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
        let standing = world(&text)?;
        for _ in 0..1 + dice.below(4) {
            let speed = mover_speed * dice.between(0.1, 1.0);
            let radius = dice.between(0.08, 0.35);
            let _ = write!(text, "[[mover]]\nradius = {radius}\nspeed = {speed}\n");
            let path = (0..PATHS).find_map(|_| {
                let corners: Vec<_> = (0..2 + dice.below(3))
                    .map(|_| Point2::new(at(dice), at(dice)))
                    .collect();
                is_free(&standing, radius, &corners).then_some(corners)
            });
            let _ = match path.filter(|_| dice.chance(0.7)) {
                Some(corners) => {
                    let corners: Vec<_> = corners.iter().map(|at| format!("[{}, {}]", at.x, at.y)).collect();
                    writeln!(text, "path = [{}]", corners.join(", "))
                }
                None => write!(
                    text,
                    "start = [{}, {}]\nwalk = [[{}, {}], [{HALF}, {HALF}]]\n",
                    at(dice),
                    at(dice),
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

/// Whether a disc can go round a path: nothing goes through walls.
fn is_free(standing: &World, radius: f64, corners: &[Point2<f64>]) -> bool {
    let legs = corners.iter().zip(corners.iter().cycle().skip(1));
    legs.into_iter().all(|(from, to)| {
        let steps = ((to - from).norm() / STEP).ceil().max(1.0);
        (0..=steps as u32).all(|step| {
            let at = from + (to - from) * (f64::from(step) / steps);
            standing.clearance(&Footprint::Radius(radius), Pose2::new(at.x, at.y, 0.0)) > 0.0
        })
    })
}

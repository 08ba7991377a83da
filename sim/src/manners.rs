//! Manners. The velocity that a walker chooses among others: a blind walker goes straight on; others make way by one of two published
//! models.
//!
//! - ORCA (van den Berg, Guy, Lin and Manocha, "Reciprocal n-Body Collision Avoidance", 2011): each neighbour gives a half-plane of
//!   velocities that keep both apart for a time, with half of the effort taken by the walker; the permitted velocity nearest to the
//!   wanted one is chosen. Towards walls the walker takes the whole effort. The optimum of so small a problem is the wanted velocity, its
//!   projection on a bound, or a point where two bounds meet: all are tried.
//! - Social force (Helbing and Molnár, "Social force model for pedestrian dynamics", 1995): the walker is attracted by its goal, and
//!   repelled by others through elliptical potentials along their next step, and by walls; repulsion from behind counts half.

use std::f64::consts::PI;

use nalgebra::{Rotation2, Vector2};
use serde::Deserialize;

/// Whether and how a walker makes way.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Manners {
    /// Ignores everybody else.
    #[default]
    Blind,
    /// Optimal reciprocal collision avoidance; the walker takes half of the effort.
    Orca,
    /// Social force model: others and walls repel the walker.
    SocialForce,
}

/// Others farther away are ignored, m.
pub(crate) const SIGHT: f64 = 5.0;
/// Top speed of a walker that makes way, as a multiple of its preferred speed (Helbing and Molnár: 1.3).
const HASTE: f64 = 1.3;
/// Largest number of neighbours in ORCA, the nearest first.
const NEIGHBOURS: usize = 10;
/// ORCA keeps walkers apart for this long, and off walls for this long, s.
const HORIZON: f64 = 2.5;
const WALL_HORIZON: f64 = 0.5;
/// Extra distance that ORCA keeps, m: without it walkers graze one another.
const BERTH: f64 = 0.1;
/// Neighbours that are already too close are to be apart after this, s.
const PARTING: f64 = 0.2;
/// Tolerance of a bound, m/s.
const TOLERANCE: f64 = 1e-9;
/// Social force: relaxation time, s; strength, m²/s², and range, m, of other people's potential and of walls'; length of a step in time, s.
const RELAXATION: f64 = 0.5;
const PEOPLE: (f64, f64) = (2.1, 0.3);
const WALLS: (f64, f64) = (10.0, 0.2);
const STEP: f64 = 2.0;
/// Turn of the wanted velocity, rad: two walkers who meet face to face both keep to the right.
const KEEP_RIGHT: f64 = -0.05;
/// Half of the angle of sight, rad, and the weight of repulsion from outside it.
const HALF_SIGHT: f64 = PI / 1.8;
const UNSEEN: f64 = 0.5;

/// Another walker or robot, seen from a walker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Neighbour {
    /// From the walker's centre to its own, m.
    pub offset: Vector2<f64>,
    /// Velocity, m/s.
    pub velocity: Vector2<f64>,
    /// Radius, m.
    pub radius: f64,
}

/// A walker that chooses its velocity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walker {
    /// Velocity, m/s.
    pub velocity: Vector2<f64>,
    /// Wanted velocity, m/s.
    pub wanted: Vector2<f64>,
    /// Radius, m.
    pub radius: f64,
    /// Preferred walking speed, m/s.
    pub speed: f64,
}

/// Permitted velocities: those `v` with `(v - at) . inwards >= 0`.
#[derive(Clone, Copy, Debug)]
struct HalfPlane {
    at: Vector2<f64>,
    inwards: Vector2<f64>,
}

impl HalfPlane {
    /// Distance of a velocity from the bound, m/s; negative outside.
    fn margin(&self, velocity: Vector2<f64>) -> f64 {
        (velocity - self.at).dot(&self.inwards)
    }

    fn along(&self) -> Vector2<f64> {
        Vector2::new(self.inwards.y, -self.inwards.x)
    }
}

impl Manners {
    /// Top speed of a walker of these manners whose preferred speed is `speed`, m/s.
    #[must_use]
    pub fn top_speed(self, speed: f64) -> f64 {
        match self {
            Self::Blind => speed,
            Self::Orca | Self::SocialForce => HASTE * speed,
        }
    }

    /// The velocity for the next `secs` seconds among `others` and nearest points of walls (from the walker's centre, m).
    ///
    /// ```
    /// use nalgebra::Vector2;
    /// use zenav_sim::manners::{Manners, Neighbour, Walker};
    ///
    /// // Somebody comes towards a walker, a little to its left.
    /// let ahead = Vector2::new(1.0, 0.0);
    /// let walker = Walker { velocity: ahead, wanted: ahead, radius: 0.3, speed: 1.0 };
    /// let other = Neighbour { offset: Vector2::new(2.0, 0.1), velocity: -ahead, radius: 0.3 };
    /// assert_eq!(Manners::Blind.velocity(&walker, &[other], &[], 0.1), ahead);
    /// assert!(Manners::Orca.velocity(&walker, &[other], &[], 0.1).y < 0.0, "it passes on the right");
    /// ```
    #[must_use]
    pub fn velocity(self, walker: &Walker, others: &[Neighbour], walls: &[Vector2<f64>], secs: f64) -> Vector2<f64> {
        match self {
            Self::Blind => walker.wanted,
            Self::Orca => orca(walker, others, walls),
            Self::SocialForce => social_force(walker, others, walls, secs),
        }
    }
}

fn orca(walker: &Walker, others: &[Neighbour], walls: &[Vector2<f64>]) -> Vector2<f64> {
    let mut nearest: Vec<&Neighbour> = others.iter().collect();
    nearest.sort_by(|a, b| a.offset.norm_squared().total_cmp(&b.offset.norm_squared()));
    let mut planes: Vec<HalfPlane> = nearest
        .into_iter()
        .take(NEIGHBOURS)
        .map(|other| reciprocal(walker, other))
        .collect();
    planes.extend(walls.iter().filter_map(|wall| {
        let distance = wall.norm();
        let towards = wall.try_normalize(1e-9)?;
        let free = distance - walker.radius;
        let secs = if free > 0.0 { WALL_HORIZON } else { PARTING };
        Some(HalfPlane {
            at: towards * (free / secs),
            inwards: -towards,
        })
    }));
    let top = Manners::Orca.top_speed(walker.speed);
    let worst = |velocity: Vector2<f64>| {
        let margins = planes.iter().map(|plane| plane.margin(velocity));
        margins.fold(top - velocity.norm(), f64::min)
    };
    // The best so far: violated bounds count first, then the distance from the wanted velocity.
    let mut best: (f64, f64, Vector2<f64>) = (f64::NEG_INFINITY, f64::INFINITY, Vector2::zeros());
    candidates(walker.wanted, top, &planes, |velocity| {
        let broken = worst(velocity).min(-TOLERANCE);
        let off = (velocity - walker.wanted).norm();
        if broken > best.0 + TOLERANCE || (broken >= best.0 - TOLERANCE && off < best.1) {
            best = (broken, off, velocity);
        }
    });
    best.2.cap_magnitude(top)
}

/// The velocities that keep a walker and another apart for the horizon, if the other makes half of the effort too.
fn reciprocal(walker: &Walker, other: &Neighbour) -> HalfPlane {
    let (offset, radius) = (other.offset, walker.radius + other.radius + BERTH);
    let relative = walker.velocity - other.velocity;
    let squared = offset.norm_squared();
    let away = |secs: f64| {
        // Out of the disc of velocities that meet after exactly this time.
        let from_center = relative - offset / secs;
        let outwards = from_center
            .try_normalize(1e-9)
            .or_else(|| (-offset).try_normalize(1e-9))
            .unwrap_or_else(Vector2::x);
        (outwards * (radius / secs - from_center.norm()), outwards)
    };
    let (change, inwards) = if squared <= radius * radius {
        away(PARTING)
    } else {
        let from_center = relative - offset / HORIZON;
        let ahead = from_center.dot(&offset);
        if ahead < 0.0 && ahead * ahead > radius * radius * from_center.norm_squared() {
            away(HORIZON)
        } else {
            // Out of the cone, over the side that is nearer.
            let tangent = (squared - radius * radius).sqrt();
            let left = offset.perp(&from_center) > 0.0;
            let turn = if left { radius } else { -radius };
            let side = Vector2::new(
                offset.x * tangent - offset.y * turn,
                offset.x * turn + offset.y * tangent,
            ) / squared;
            let outwards = if left {
                Vector2::new(-side.y, side.x)
            } else {
                Vector2::new(side.y, -side.x)
            };
            (side * relative.dot(&side) - relative, outwards)
        }
    };
    HalfPlane {
        at: walker.velocity + 0.5 * change,
        inwards,
    }
}

/// All candidates for the optimum: the wanted velocity, its projections on the bounds, and the points where two bounds meet.
fn candidates(wanted: Vector2<f64>, top: f64, planes: &[HalfPlane], mut visit: impl FnMut(Vector2<f64>)) {
    visit(wanted.cap_magnitude(top));
    visit(Vector2::zeros());
    for (index, plane) in planes.iter().enumerate() {
        visit(wanted - plane.inwards * plane.margin(wanted));
        // Where the bound crosses the circle of the top speed.
        let foot = plane.inwards * plane.at.dot(&plane.inwards);
        let half = (top * top - foot.norm_squared()).max(0.0).sqrt();
        visit(foot + plane.along() * half);
        visit(foot - plane.along() * half);
        for other in planes.iter().skip(index + 1) {
            let crossing = other.inwards.dot(&plane.along());
            if crossing.abs() > 1e-9 {
                visit(plane.at - plane.along() * (other.margin(plane.at) / crossing));
            }
        }
    }
}

fn social_force(walker: &Walker, others: &[Neighbour], walls: &[Vector2<f64>], secs: f64) -> Vector2<f64> {
    let heading = walker.wanted.try_normalize(1e-9);
    // Repulsion from behind counts less.
    let seen = |push: Vector2<f64>| match heading {
        Some(heading) if heading.dot(&-push) < push.norm() * HALF_SIGHT.cos() => push * UNSEEN,
        _ => push,
    };
    let mut force = (walker.wanted - walker.velocity) / RELAXATION;
    for other in others {
        // The model's people are points; here the other one has an outline, and robots come in all sizes.
        let apart = other.offset.norm();
        let Some(towards) = other.offset.try_normalize(1e-9) else {
            continue;
        };
        let from_other = -towards * (apart - other.radius).max(0.05);
        let step = other.velocity * STEP;
        let after = from_other - step;
        let sum = from_other.norm() + after.norm();
        let minor = 0.5 * (sum * sum - step.norm_squared()).max(1e-4).sqrt();
        let direction = -towards + after.try_normalize(1e-9).unwrap_or_else(Vector2::zeros);
        let (strength, range) = PEOPLE;
        force += seen(direction * (strength / range * (-minor / range).exp() * sum / (4.0 * minor)));
    }
    // As in the model, only the nearest point of all walls repels.
    let wall = walls
        .iter()
        .min_by(|a, b| a.norm_squared().total_cmp(&b.norm_squared()));
    if let Some((towards, distance)) = wall.and_then(|wall| Some((wall.try_normalize(1e-9)?, wall.norm()))) {
        let (strength, range) = WALLS;
        force -= towards * (strength / range * (-distance / range).exp());
    }
    (walker.velocity + force * secs).cap_magnitude(Manners::SocialForce.top_speed(walker.speed))
}

/// Wanted velocity of a walker towards a place (from its centre, m): straight there, slower on the last steps.
pub(crate) fn wanted(to_place: Vector2<f64>, speed: f64) -> Vector2<f64> {
    Rotation2::new(KEEP_RIGHT) * (to_place / RELAXATION).cap_magnitude(speed)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two walkers approach each other; returns the least distance between their centres, m, and the distance that each has left to its
    /// goal, m.
    fn meeting(manners: [Manners; 2]) -> (f64, [f64; 2]) {
        let secs = 0.02;
        let mut at = [Vector2::new(-4.0, 0.0), Vector2::new(4.0, 0.1)];
        let goals = [Vector2::new(4.0, 0.0), Vector2::new(-4.0, 0.1)];
        let mut velocity = [Vector2::zeros(); 2];
        let mut least = f64::INFINITY;
        for _ in 0..500 {
            let before = (at, velocity);
            for (this, other) in [(0, 1), (1, 0)] {
                let walker = Walker {
                    velocity: before.1[this],
                    wanted: wanted(goals[this] - before.0[this], 1.2),
                    radius: 0.25,
                    speed: 1.2,
                };
                let neighbour = Neighbour {
                    offset: before.0[other] - before.0[this],
                    velocity: before.1[other],
                    radius: 0.25,
                };
                velocity[this] = manners[this].velocity(&walker, &[neighbour], &[], secs);
                at[this] += velocity[this] * secs;
            }
            least = least.min((at[0] - at[1]).norm());
        }
        (least, [0, 1].map(|who: usize| (goals[who] - at[who]).norm()))
    }

    #[test]
    fn two_who_make_way_pass_each_other_and_arrive() {
        for manners in [Manners::Orca, Manners::SocialForce] {
            let (least, left) = meeting([manners; 2]);
            assert!(least > 0.49, "{manners:?} {least}");
            assert!(left.iter().all(|left| *left < 0.2), "{manners:?} {left:?}");
        }
    }

    #[test]
    fn orca_chooses_the_permitted_velocity_nearest_to_the_wanted_one() {
        let walker = Walker {
            velocity: Vector2::new(1.0, 0.0),
            wanted: Vector2::new(1.0, 0.0),
            radius: 0.25,
            speed: 1.0,
        };
        assert_eq!(orca(&walker, &[], &[]), walker.wanted);
        // Half a metre of room before a wall: half a metre per half second. In a corner less.
        let wall = Vector2::new(0.5, 0.0);
        assert!((orca(&walker, &[], &[wall]) - Vector2::new(0.5, 0.0)).norm() < 1e-9);
        let close = [Vector2::new(0.25, 0.0), Vector2::new(-0.2, 0.0), Vector2::new(0.0, 0.3)];
        let chosen = orca(&walker, &[], &close);
        assert!(chosen.norm() <= 1.3 && chosen.y <= 0.1 + 1e-9, "{chosen}");
    }
}

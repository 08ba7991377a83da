//! Certificate. Checks a trajectory before it is sent: the true footprint's sweep against the map, and the largest use of every limit of
//! the drive, both computed from the trajectory itself and not from what a solver reported. The sweep is measured by `zenav_space`,
//! whose own code `cargo bench -p zenav-space --bench space` compares with parry's.

use zenav_protocol::geometry::{Pose2, Twist2, wrap_angle};
use zenav_protocol::messages::{Certificate, CorridorFigures, LimitUse, SolverFigures};
use zenav_protocol::robot::{Drive, Footprint};

use super::corridor::FreePolygon;
use super::shortcut::is_permitted_along;
use super::timing::{JerkFigures, Limits, PiecewiseTrajectory};
use zenav_space::ConfigurationSpace;

/// Largest distance between two checked poses, m, and turn between them, rad.
const STEP: f64 = 0.03;
const TURN: f64 = 0.08;
/// Between two checked poses a long footprint is no farther from the straight line and the even turn than about this, m.
const BULGE: f64 = 5e-4;

/// The trajectory touches an obstacle, or enters unknown cells that the policy forbids.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("collision")]
pub struct Collision;

/// Least distance (m) of the true footprint to an obstacle along a trajectory; `None` if nothing is within the space's reach.
///
/// Collisions within the first `exempt` metres around the start are no reason to refuse: a robot that stands in an obstacle has to leave
/// it. These metres count in the reported clearance.
///
/// # Errors
/// [`Collision`].
pub fn clearance(
    space: &ConfigurationSpace,
    trajectory: &PiecewiseTrajectory,
    limits: &Limits,
    exempt: f64,
) -> Result<Option<f64>, Collision> {
    let stray = stray(space.footprint(), limits, trajectory.at(0.0).point.twist());
    let turning = match space.footprint() {
        Footprint::Polygon(_) => (TURN / limits.yaw_rate).min((8.0 * BULGE / stray).sqrt()),
        Footprint::Radius(_) => f64::INFINITY,
    };
    let period = (STEP / limits.speed).min(turning);
    let all: Vec<Pose2> = trajectory
        .states(period)
        .into_iter()
        .map(|state| state.point.pose())
        .collect();
    // Poses are joined by straight lines and even turns. The number of states is bounded: in a very long trajectory they are farther apart.
    let period = trajectory.duration() / (all.len().max(2) - 1) as f64;
    let bulge = stray * period * period / 8.0;
    let leaving = all.first().filter(|_| exempt > 0.0).map_or(0, |start| {
        let left = all.iter().position(|pose| pose.distance(start) > exempt);
        left.unwrap_or(all.len())
    });
    let poses = &all[leaving..];
    if poses
        .windows(2)
        .any(|pair| !is_permitted_along(space, pair[0].position(), pair[1].position()))
    {
        return Err(Collision);
    }
    let least = sweep(space, poses);
    if least <= bulge && !poses.is_empty() {
        return Err(Collision);
    }
    let least = if leaving > 0 {
        least.min(sweep(space, &all[..leaving]))
    } else {
        least
    };
    Ok((least < space.reach()).then_some(least))
}

/// Acceleration (m/s²) at which a point of the footprint leaves a straight line and an even turn at most: between two poses a time `t` apart
/// it is at most `t²/8` times this away from them. `start` is the velocity at the start, which may be above the limits.
fn stray(footprint: &Footprint, limits: &Limits, start: Twist2) -> f64 {
    // The base leaves its chord by its lateral acceleration: by that of the limits, or of the start, from which on both speeds fall.
    let lateral = limits.lateral_acceleration.max((start.v * start.w).abs());
    // A heading leaves the even turn by its yaw acceleration, and takes the outermost point of a long footprint along; a disc has none.
    match footprint {
        Footprint::Polygon(_) => {
            lateral + footprint.circumscribed_radius() * limits.wheel_acceleration / limits.half_separation
        }
        Footprint::Radius(_) => lateral,
    }
}

/// Number of poses that are measured together.
const CHUNK: usize = 16;

/// Like [`ConfigurationSpace::sweep_clearance_within`], but the distance field first tells which poses are worth measuring.
fn sweep(space: &ConfigurationSpace, poses: &[Pose2]) -> f64 {
    let radius = space.footprint().circumscribed_radius();
    let bound = |pose: &Pose2| {
        let Some(cell) = space.spec().cell_at(pose.position()) else {
            return 0.0;
        };
        space.field().distance(cell) - (space.spec().center(cell) - pose.position()).norm() - radius
    };
    // A disc does not move where it turns.
    let turning = match space.footprint() {
        Footprint::Polygon(_) => radius,
        Footprint::Radius(_) => 0.0,
    };
    let moved = |pair: &[Pose2]| pair[0].distance(&pair[1]) + wrap_angle(pair[1].yaw - pair[0].yaw).abs() * turning;
    // Between two such poses no point is farther from where it is in the nearer one than half of what it moves.
    let bounds = (0..poses.len()).step_by(CHUNK).map(|begin| {
        let chunk = &poses[begin..(begin + CHUNK + 1).min(poses.len())];
        let most = chunk.windows(2).map(moved).fold(0.0, f64::max);
        (
            chunk.iter().map(bound).fold(f64::INFINITY, f64::min) - 0.5 * most,
            chunk,
        )
    });
    let mut chunks: Vec<_> = bounds.collect();
    chunks.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut least = space.reach();
    for (bound, chunk) in chunks {
        if bound >= least {
            break;
        }
        least = space.sweep_clearance_within(chunk, least);
    }
    least
}

/// Corridor and solver figures of a curve, added part by part.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Evidence {
    corridor: Option<CorridorFigures>,
    geometry: Option<SolverFigures>,
    /// The corridor's polygons, in order.
    pub polygons: Vec<FreePolygon>,
}

impl Evidence {
    /// Adds a curve through polygons.
    pub fn add(&mut self, polygons: &[FreePolygon], solver: SolverFigures) {
        let width = polygons.iter().map(width).fold(f64::INFINITY, f64::min);
        let corridor = self.corridor.get_or_insert(CorridorFigures {
            polygons: 0,
            least_width: f64::INFINITY,
        });
        corridor.polygons += polygons.len();
        corridor.least_width = corridor.least_width.min(width);
        self.polygons.extend_from_slice(polygons);
        let known = self.geometry.get_or_insert_with(|| SolverFigures {
            status: solver.status.clone(),
            ..SolverFigures::default()
        });
        if known.status == "Solved" {
            known.status = solver.status;
        }
        known.iterations += solver.iterations;
        known.gap = known.gap.max(solver.gap);
    }

    /// The geometry solver's status; empty without a curve.
    #[must_use]
    pub fn status(&self) -> String {
        self.geometry
            .as_ref()
            .map_or(String::new(), |solver| solver.status.clone())
    }
}

/// Width of a polygon across the middle of its piece, m.
fn width(polygon: &FreePolygon) -> f64 {
    let along = polygon.to - polygon.from;
    let across = nalgebra::Vector2::new(-along.y, along.x);
    let Some(across) = across.try_normalize(1e-9) else {
        return f64::INFINITY;
    };
    let middle = nalgebra::center(&polygon.from, &polygon.to);
    let reach = |direction: nalgebra::Vector2<f64>| {
        let sides = polygon
            .sides
            .iter()
            .map(|side| (side.depth(middle), side.normal.dot(&direction)));
        sides
            .filter(|(_, towards)| *towards > 1e-9)
            .map(|(depth, towards)| depth / towards)
            .fold(f64::INFINITY, f64::min)
    };
    reach(across) + reach(-across)
}

/// The certificate of a trajectory, from the evidence of its parts and from the trajectory itself.
#[must_use]
pub fn certify(
    trajectory: &PiecewiseTrajectory,
    drive: &Drive,
    evidence: Evidence,
    jerk: Option<JerkFigures>,
) -> Certificate {
    let time_law = match &jerk {
        None => "sweep".to_owned(),
        Some(JerkFigures { failed: None, .. }) => "jerk_limited".to_owned(),
        Some(JerkFigures {
            failed: Some(error), ..
        }) => format!("sweep:{error}"),
    };
    Certificate {
        corridor: evidence.corridor,
        geometry: evidence.geometry,
        time_law,
        timing: jerk.map(|figures| figures.solver),
        largest_use: largest_use(trajectory, drive),
        lower_bound: trajectory.lower_bound(),
        over_lower_bound: if trajectory.lower_bound() > 0.0 {
            trajectory.duration() / trajectory.lower_bound()
        } else {
            1.0
        },
    }
}

/// An acceleration that differs by less than this where two pieces of a trajectory meet is continuous, m/s².
const SAME_ACCELERATION: f64 = 1e-6;

/// Largest use of each limit along a trajectory.
#[must_use]
pub fn largest_use(trajectory: &PiecewiseTrajectory, drive: &Drive) -> LimitUse {
    let mut most = LimitUse::default();
    let mut jerk = 0.0_f64;
    let half = 0.5 * drive.wheel_separation;
    let mut before: Option<(f64, f64)> = None;
    for rates in trajectory.rates() {
        let (v, w) = (rates.twist.v, rates.twist.w);
        for wheel in drive.wheels(rates.twist) {
            most.wheel_speed = most.wheel_speed.max(wheel.abs() / drive.max_wheel_speed);
        }
        let accelerations = [rates.a - half * rates.alpha, rates.a + half * rates.alpha];
        for wheel in accelerations {
            most.wheel_acceleration = most.wheel_acceleration.max(wheel.abs() / drive.acceleration());
        }
        most.speed = most.speed.max(v.abs() / drive.top_speed());
        most.lateral_acceleration = most
            .lateral_acceleration
            .max((v * w).abs() / drive.max_lateral_acceleration);
        most.yaw_rate = most.yaw_rate.max(w.abs() / drive.top_yaw_rate());
        // In a turn on the spot the base does not move: the acceleration is a wheel's.
        let acceleration = if v == 0.0 && rates.a == 0.0 {
            half * rates.alpha
        } else {
            rates.a
        };
        if let Some((t, other)) = before {
            let change = (acceleration - other).abs();
            if rates.t - t > 1e-9 {
                jerk = jerk.max(change / (rates.t - t));
            } else if change > SAME_ACCELERATION {
                jerk = f64::INFINITY;
            }
        }
        before = Some((rates.t, acceleration));
    }
    most.jerk = drive
        .max_jerk
        .map(|limit| jerk / limit)
        .filter(|use_of| use_of.is_finite());
    most
}

#[cfg(test)]
mod tests {
    use super::super::timing::{GeometricPath, PathPoint};
    use super::*;
    use nalgebra::Point2;
    use proptest::prelude::*;
    use zenav_protocol::robot::RobotModel;

    fn tiago(jerk: Option<f64>) -> RobotModel {
        let mut model = zenav_fixtures::robot("tiago");
        model.drive.max_jerk = jerk;
        model
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(24))]

        #[test]
        fn the_largest_use_is_what_fine_sampling_finds(
            turns in prop::collection::vec((-5.0..5.0_f64, 5_usize..30), 1..6), angle in -3.0..3.0_f64, jerk in prop::option::of(0.5..5.0_f64),
        ) {
            let model = tiago(jerk);
            let (drive, limits) = (&model.drive, Limits::of(&model));
            let mut k = 0.0;
            let mut links = Vec::new();
            for (target, pieces) in turns {
                links.extend((1..=pieces).map(|i| (0.02, k + (target - k) * i as f64 / pieces as f64)));
                k = target;
            }
            let mut trajectory = PiecewiseTrajectory::new();
            trajectory.spin(Pose2::new(0.0, 0.0, -angle), angle, &limits);
            trajectory.follow(GeometricPath::chain(PathPoint::default(), &links).unwrap(), 0.0, &limits).unwrap();
            let (trajectory, figures) = trajectory.with_limited_jerk(&limits);
            let found = largest_use(&trajectory, drive);
            let mut fine = LimitUse::default();
            let mut fine_jerk = 0.0_f64;
            let states = trajectory.states(2e-4);
            let half = 0.5 * drive.wheel_separation;
            for pair in states.windows(2) {
                let (point, a, alpha) = (pair[1].point, pair[1].a, pair[1].alpha);
                fine.speed = fine.speed.max(point.v / drive.top_speed());
                fine.wheel_speed = fine.wheel_speed.max((point.v.abs() + half * point.w.abs()) / drive.wheel_radius / drive.max_wheel_speed);
                fine.wheel_acceleration = fine.wheel_acceleration.max((a.abs() + half * alpha.abs()) / drive.acceleration());
                fine.lateral_acceleration = fine.lateral_acceleration.max((point.v * point.w).abs() / drive.max_lateral_acceleration);
                fine.yaw_rate = fine.yaw_rate.max(point.w.abs() / drive.top_yaw_rate());
                let dt = point.t - pair[0].point.t;
                let change = if point.v == 0.0 { half * (alpha - pair[0].alpha) } else { a - pair[0].a };
                fine_jerk = fine_jerk.max(change.abs() / dt);
            }
            for (found, fine) in [
                (found.speed, fine.speed), (found.wheel_speed, fine.wheel_speed), (found.wheel_acceleration, fine.wheel_acceleration),
                (found.lateral_acceleration, fine.lateral_acceleration), (found.yaw_rate, fine.yaw_rate),
            ] {
                prop_assert!(found <= 0.95 + 1e-6 && (found - fine).abs() < 5e-3, "{} against {}", found, fine);
            }
            match (jerk, figures.map(|figures| figures.failed)) {
                (Some(limit), Some(None)) => {
                    let share = found.jerk.unwrap();
                    prop_assert!(share <= 0.95 + 1e-6 && (share - fine_jerk / limit).abs() < 0.02, "{} against {}", share, fine_jerk / limit);
                }
                _ => prop_assert_eq!(found.jerk, None),
            }
        }
    }

    #[test]
    fn between_two_checked_poses_no_point_strays_by_more_than_the_bulge() {
        let corners = [(-0.6, -0.2), (0.2, -0.2), (0.2, 0.2), (-0.6, 0.2)].map(|(x, y)| Point2::new(x, y));
        let (long, disc) = (Footprint::Polygon(corners.to_vec()), Footprint::Radius(0.3));
        let (limits, period) = (Limits::of(&tiago(None)), 0.05);
        let bulge = |footprint: &Footprint, start| stray(footprint, &limits, start) * period * period / 8.0;
        // The largest yaw acceleration against an even turn.
        let alpha = limits.wheel_acceleration / limits.half_separation;
        let yaw = |t: f64| 0.5 * alpha * t * t;
        let turned = |corner: &Point2<f64>, yaw: f64| Pose2::new(0.0, 0.0, yaw).transform_point(*corner);
        let off = |t: f64| {
            let even = yaw(period) * t / period;
            let moved = corners
                .iter()
                .map(|corner| (turned(corner, yaw(t)) - turned(corner, even)).norm());
            moved.fold(0.0, f64::max)
        };
        let most = (0..=100).map(|i| off(0.01 * f64::from(i) * period)).fold(0.0, f64::max);
        let swing = bulge(&long, Twist2::ZERO) - bulge(&disc, Twist2::ZERO);
        assert!(most <= swing + 1e-12 && most > 0.9 * swing, "{most} of {swing}");
        // An arc, faster than the limits allow: how far is it from its chord?
        let (v, w) = (1.0_f64, 2.0_f64);
        let sagitta = v / w * (1.0 - (0.5 * w * period).cos());
        assert!(v * w > limits.lateral_acceleration);
        assert!(sagitta > bulge(&disc, Twist2::ZERO) && sagitta <= bulge(&disc, Twist2::new(v, w)));
    }

    #[test]
    fn parts_of_a_curve_add_up_and_the_worst_status_stays() {
        let side = |x: f64, y: f64, offset: f64| super::super::corridor::HalfPlane {
            normal: nalgebra::Vector2::new(x, y),
            offset,
        };
        let polygon = |width: f64| FreePolygon {
            sides: vec![
                side(0.0, 1.0, 0.5 * width),
                side(0.0, -1.0, 0.5 * width),
                side(1.0, 0.0, 3.0),
                side(-1.0, 0.0, 1.0),
            ],
            from: Point2::new(0.0, 0.1),
            to: Point2::new(2.0, 0.1),
            length: 2.0,
        };
        let solver = |status: &str, iterations, gap| SolverFigures {
            status: status.to_owned(),
            iterations,
            gap,
        };
        let mut evidence = Evidence::default();
        evidence.add(&[polygon(2.0), polygon(0.7)], solver("AlmostSolved", 9, 1e-5));
        evidence.add(&[polygon(1.0)], solver("Solved", 7, 1e-9));
        let certificate = certify(&PiecewiseTrajectory::new(), &tiago(None).drive, evidence, None);
        let corridor = certificate.corridor.unwrap();
        assert!(corridor.polygons == 3 && (corridor.least_width - 0.7).abs() < 1e-12);
        assert_eq!(certificate.geometry.unwrap(), solver("AlmostSolved", 16, 1e-5));
        assert_eq!(certificate.over_lower_bound, 1.0);
    }
}

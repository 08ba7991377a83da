//! Refinement. Where exactly does a scan fit, how well is that known, and in which direction is it not?
//!
//! Minimises `Σ σ² (1 - m(p))` over the points, `m = exp(-d² / 2σ²)` the smooth likelihood field, and a prior. Near a surface that is half
//! the squared distance, far from it a constant: Gauss and Newton's steps with weights `m` (Welsch's robust kernel), along the normals of
//! surfaces. The information returned is that of these distances, and counts neighbouring points as one: it does not grow with the number
//! of beams alone.

use nalgebra::{Matrix2, Matrix3, Point2, Vector2, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::field::{LikelihoodField, placed};
use crate::settings::RefineSettings;

/// Points with a likelihood below this do not pull: nothing known is near.
const NEAR: f64 = 0.02;
/// Neighbours on one surface are at most this far apart, m and rad as seen from the base.
const FARTHEST: f64 = 1.0;
const NEIGHBOURS: f64 = 0.03;
/// Neighbours up to this distance to each side tell the direction of a surface, m.
const STRETCH: f64 = 0.2;
/// On a straight surface they lie on a line to within this standard deviation, m, and to within this share of their spread along it.
const STRAIGHT: f64 = 0.03;
const FLAT: f64 = 0.05;
/// A scan is not believed to know the heading otherwise by more than this, rad.
const FARTHEST_TURN: f64 = 0.03;
/// Added to the diagonal, so that a scan without any point near stays where the prior is.
const LEAST_INFORMATION: f64 = 1e-9;
/// Added where a direction was left out, and rounding must not bring it back: known to 30 m or rad.
const UNKNOWN: f64 = 1e-3;

/// What is known of the pose without the scan: odometry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prior {
    /// `field_from_scan` as expected.
    pub pose: Pose2,
    /// Its information: x, y (1/m², frame of the field), yaw (1/rad²).
    pub information: Matrix3<f64>,
}

/// A refined pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Refined {
    /// `field_from_scan`.
    pub pose: Pose2,
    /// From the pose to the one that the scan alone would have, without the prior: half a field's width and 0.03 rad away at most, and not
    /// along `degenerate`.
    pub by_scan: Pose2,
    /// What the scan alone says: information of x, y (1/m², frame of the scan's pose) and yaw (1/rad²). The prior is not in it.
    pub information: Matrix3<f64>,
    /// Mean likelihood of the points, 0 to 1.
    pub score: f64,
    /// Unit vector in the frame of the field along which the scan alone does not know the position, if there is one; with two, the worse.
    pub degenerate: Option<Vector2<f64>>,
}

impl Refined {
    /// This match, along `degenerate` as near to the pose that was expected as the scan allows, a metre counting as much as a radian. What the
    /// scan says there is not only little but wrong: along a corridor the ends of what is seen of the walls come with the robot. After Zhang, Kaess and Singh, "On degeneracy of optimization-based state
    /// estimation problems", ICRA 2016.
    #[must_use]
    pub fn expected_where_degenerate(self, expected: Pose2) -> Self {
        let Some(along) = self.degenerate else {
            return self;
        };
        let (sin, cos) = self.pose.yaw.sin_cos();
        let along = Vector2::new(cos * along.x + sin * along.y, cos * along.y - sin * along.x);
        let away = self.pose.inverse() * expected;
        let free = Free::along(&self.information, along);
        let share = free.way.dot(&Vector3::new(away.x, away.y, away.yaw)) / free.way.norm_squared();
        let way = free.way * share;
        Self {
            pose: self.pose * Pose2::new(way.x, way.y, way.z),
            information: free.without(&self.information),
            ..self
        }
    }
}

/// A way of the pose that a scan hardly tells: along a direction, turning as the scan asks.
#[derive(Clone, Copy, Debug)]
struct Free {
    /// Unit vector.
    along: Vector2<f64>,
    /// For each metre along it: x, y, m, and yaw, rad.
    way: Vector3<f64>,
}

impl Free {
    /// Along an eigenvector of the position's information, the heading being unknown.
    fn along(information: &Matrix3<f64>, along: Vector2<f64>) -> Self {
        let mixed = Vector2::new(information.m13, information.m23);
        let turn = -mixed.dot(&along) / information.m33.max(LEAST_INFORMATION);
        Self {
            along,
            way: Vector3::new(along.x, along.y, turn),
        }
    }

    /// Information of all else. By the choice of the way it acts along `along` alone: `H w = (w' H w) (along, 0)`.
    fn without(&self, information: &Matrix3<f64>) -> Matrix3<f64> {
        let along = Vector3::new(self.along.x, self.along.y, 0.0);
        let known = self.way.dot(&(information * self.way));
        information - along * along.transpose() * known
    }

    /// A gradient without its part along the way.
    fn across(&self, gradient: Vector3<f64>) -> Vector3<f64> {
        gradient - Vector3::new(self.along.x, self.along.y, 0.0) * self.way.dot(&gradient)
    }
}

/// Refines a pose. `points`: of the scan, in its frame, m.
#[must_use]
pub fn refine(
    field: &LikelihoodField,
    points: &[Point2<f64>],
    start: Pose2,
    prior: Option<&Prior>,
    settings: &RefineSettings,
) -> Refined {
    Refinable::new(points).refine(field, start, prior, settings)
}

/// A scan that is refined from several poses: what takes longest is the same for all of them.
#[derive(Clone, Debug)]
pub struct Refinable<'a> {
    points: &'a [Point2<f64>],
    /// Of the surfaces that the points lie on.
    normals: Vec<Option<Vector2<f64>>>,
}

impl<'a> Refinable<'a> {
    /// `points`: of the scan, in its frame, m.
    #[must_use]
    pub fn new(points: &'a [Point2<f64>]) -> Self {
        Self {
            points,
            normals: normals(points),
        }
    }

    /// As [`refine()`].
    #[must_use]
    pub fn refine(
        &self,
        field: &LikelihoodField,
        start: Pose2,
        prior: Option<&Prior>,
        settings: &RefineSettings,
    ) -> Refined {
        let Self { points, normals } = self;
        let mut pose = start;
        // A step is short against the width of the field: surfaces keep their direction.
        let surfaces = surfaces(field, points, normals, pose);
        for _ in 0..settings.max_iterations {
            let (mut hessian, mut gradient, _) = sums(field, points, &surfaces, pose, settings);
            if let Some(prior) = prior {
                let away = Vector3::new(
                    pose.x - prior.pose.x,
                    pose.y - prior.pose.y,
                    wrap_angle(pose.yaw - prior.pose.yaw),
                );
                hessian += prior.information;
                gradient += prior.information * away;
            }
            hessian += Matrix3::identity() * LEAST_INFORMATION;
            let Some(factor) = hessian.cholesky() else {
                break;
            };
            let mut step = factor.solve(&gradient);
            // Further away the field bends.
            let farthest = step.x.hypot(step.y);
            if farthest > field.sigma() {
                step *= field.sigma() / farthest;
            }
            pose = Pose2::new(pose.x - step.x, pose.y - step.y, pose.yaw - step.z);
            if step.norm() < settings.tolerance {
                break;
            }
        }
        let surfaces = self::surfaces(field, points, normals, pose);
        let (information, gradient, score) = sums(field, points, &surfaces, pose, settings);
        let degenerate = degenerate(&information, settings);
        let (sin, cos) = pose.yaw.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let free = degenerate.map(|along| Free::along(&information, along));
        let known = free.map_or(information, |free| free.without(&information));
        let gradient = free.map_or(gradient, |free| free.across(gradient));
        let by_scan = turn.transpose() * newton_step(&known, gradient, 0.5 * field.sigma());
        Refined {
            pose,
            by_scan: Pose2::new(by_scan.x, by_scan.y, by_scan.z),
            information: turn.transpose() * information * turn,
            score,
            degenerate,
        }
    }
}

/// Where the minimum of a parabola with this Hessian and gradient lies, as far as a parabola can be trusted.
fn newton_step(hessian: &Matrix3<f64>, gradient: Vector3<f64>, farthest: f64) -> Vector3<f64> {
    let known = hessian + Matrix3::identity() * UNKNOWN;
    let step = known
        .cholesky()
        .map_or_else(Vector3::zeros, |factor| -factor.solve(&gradient));
    let too_far = (step.x.hypot(step.y) / farthest).max(step.z.abs() / FARTHEST_TURN);
    step / too_far.max(1.0)
}

/// How a point pulls.
#[derive(Clone, Copy, Debug)]
struct Surface {
    /// `n nᵀ` of the normal of the surface that it lies on; shorter where that has no one direction.
    plane: Matrix2<f64>,
    /// In which directions it pulls.
    pull: Matrix2<f64>,
}

/// The surface of each point. Where neighbours in the scan show its direction, it pulls across it alone: the end of what is seen of a wall
/// moves along it with the robot, and would draw the scan back to where it ended before. Elsewhere the slopes of the field around the point
/// tell.
fn surfaces(
    field: &LikelihoodField,
    points: &[Point2<f64>],
    normals: &[Option<Vector2<f64>>],
    pose: Pose2,
) -> Vec<Surface> {
    let away = field.sigma();
    let around = [(away, 0.0), (-away, 0.0), (0.0, away), (0.0, -away)].map(|(x, y)| Vector2::new(x, y));
    let (sin, cos) = pose.yaw.sin_cos();
    let turn = Matrix2::new(cos, -sin, sin, cos);
    let of = |(point, normal): (Point2<f64>, &Option<Vector2<f64>>)| {
        if let Some(normal) = normal {
            let normal = turn * normal;
            let plane = normal * normal.transpose();
            return Surface { plane, pull: plane };
        }
        let slopes = around.map(|offset| field.likelihood(point + offset).1);
        let tensor: Matrix2<f64> = slopes.iter().map(|slope| slope * slope.transpose()).sum();
        let sum = tensor.trace();
        let difference = (tensor.m11 - tensor.m22).hypot(2.0 * tensor.m12);
        let smaller = 0.5 * (sum - difference);
        Surface {
            plane: (tensor - Matrix2::identity() * smaller) / sum.max(f64::MIN_POSITIVE),
            pull: Matrix2::identity(),
        }
    };
    placed(pose, points).into_iter().zip(normals).map(of).collect()
}

/// Normals of the straight surfaces that points lie on, by their neighbours in the scan.
fn normals(points: &[Point2<f64>]) -> Vec<Option<Vector2<f64>>> {
    let is_near = |a: &Point2<f64>, b: &Point2<f64>| {
        let turn = a.coords.perp(&b.coords).atan2(a.coords.dot(&b.coords));
        (b - a).norm() <= FARTHEST && turn.abs() <= NEIGHBOURS
    };
    let of = |number: usize| {
        let (mut first, mut last) = (number, number);
        while first > 0
            && (points[number] - points[first]).norm() < STRETCH
            && is_near(&points[first], &points[first - 1])
        {
            first -= 1;
        }
        while last + 1 < points.len()
            && (points[number] - points[last]).norm() < STRETCH
            && is_near(&points[last], &points[last + 1])
        {
            last += 1;
        }
        let stretch = &points[first..=last];
        if stretch.len() < 3 {
            return None;
        }
        let count = stretch.len() as f64;
        let middle = stretch.iter().map(|point| point.coords).sum::<Vector2<f64>>() / count;
        let spread: Matrix2<f64> = stretch
            .iter()
            .map(|point| (point.coords - middle) * (point.coords - middle).transpose())
            .sum::<Matrix2<f64>>()
            / count;
        let eigen = spread.symmetric_eigen();
        let least = eigen.eigenvalues.imin();
        let (small, large) = (eigen.eigenvalues[least], eigen.eigenvalues[1 - least]);
        (small <= STRAIGHT * STRAIGHT && small <= FLAT * large).then(|| eigen.eigenvectors.column(least).into_owned())
    };
    (0..points.len()).map(of).collect()
}

/// Information and gradient of the points, and their mean likelihood.
fn sums(
    field: &LikelihoodField,
    points: &[Point2<f64>],
    surfaces: &[Surface],
    pose: Pose2,
    settings: &RefineSettings,
) -> (Matrix3<f64>, Vector3<f64>, f64) {
    let (mut hessian, mut gradient, mut total) = (Matrix3::zeros(), Vector3::zeros(), 0.0);
    for (point, surface) in placed(pose, points).iter().zip(surfaces) {
        let (likelihood, slope) = field.likelihood(*point);
        total += likelihood;
        if likelihood < NEAR {
            continue;
        }
        let lever = Vector2::new(pose.y - point.y, point.x - pose.x);
        let slope = surface.pull * slope;
        gradient -= Vector3::new(slope.x, slope.y, slope.dot(&lever));
        let plane = surface.plane * likelihood;
        let mixed = plane * lever;
        hessian += Matrix3::new(
            plane.m11,
            plane.m12,
            mixed.x,
            plane.m21,
            plane.m22,
            mixed.y,
            mixed.x,
            mixed.y,
            lever.dot(&mixed),
        );
    }
    let per_point = settings.point_sigma.powi(-2) / settings.points_per_independent;
    let score = if points.is_empty() {
        0.0
    } else {
        total / points.len() as f64
    };
    (
        hessian * per_point,
        gradient * (per_point * field.sigma().powi(2)),
        score,
    )
}

/// The direction in which the position is known worst, where that is too little. The heading is unknown too, as far as the scan goes.
fn degenerate(information: &Matrix3<f64>, settings: &RefineSettings) -> Option<Vector2<f64>> {
    let plane: Matrix2<f64> = information.fixed_view::<2, 2>(0, 0).into_owned();
    let mixed = Vector2::new(information.m13, information.m23);
    let position = plane - mixed * mixed.transpose() / information.m33.max(LEAST_INFORMATION);
    let eigen = position.symmetric_eigen();
    let worst = eigen.eigenvalues.imin();
    let least = settings.degenerate_sigma.powi(-2);
    (eigen.eigenvalues[worst] < least).then(|| eigen.eigenvectors.column(worst).into_owned())
}

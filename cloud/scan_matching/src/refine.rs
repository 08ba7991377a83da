//! Refinement. Refines a scan's pose beyond cells, with its certainty and the direction that it does not constrain.
//!
//! Minimises `Σ σ² (1 - m(p))` over the points, `m = exp(-d² / 2σ²)` the smooth likelihood field, and a prior. Near a surface that is half
//! the squared distance, far from it a constant: Gauss-Newton steps with weights `m` (Welsch's robust kernel), along the normals of
//! surfaces. The information returned is that of these distances, and counts neighbouring points as one: it does not grow with the number
//! of beams alone.
//!
//! A field is only as sharp as its `σ` and the noise of the scans in it. If [surfels](Surfels) are available, [`Refinable::polish`]
//! continues from there: points with a known normal are drawn to the surfels, along the mean of both normals, the others to the field.

use nalgebra::{Matrix2, Matrix3, Point2, Rotation2, Vector2, Vector3};
use zenav_protocol::geometry::{Pose2, wrap_angle};

use crate::field::{LikelihoodField, placed};
use crate::normals::normals;
use crate::settings::RefineSettings;
use crate::surfels::Surfels;

/// Points with a likelihood below this have no pull: no known surface is near.
const NEAR: f64 = 0.02;
/// Largest correction of the heading by the scan alone, rad.
const FARTHEST_TURN: f64 = 0.03;
/// Range in which the parabola around a match on surfels is valid, m.
const FARTHEST_STEP: f64 = 0.04;
/// If surfels would move a scan farther than this, m and rad, they are the wrong ones.
const ELSEWHERE: (f64, f64) = (0.1, 0.05);
/// Surfels count if at least this share of the points lies on some; never fewer points than the first number, and no more need be than the
/// second.
const ON_SURFELS: f64 = 0.33;
const FEWEST: (f64, f64) = (10.0, 20.0);
/// Points without a normal count in polishing from this likelihood on: a surface farther away is a different one, such as the other side of
/// a wall.
const SURE: f64 = 0.8;
/// Error of a wall's normals, rad: a direction in which the scan has no more information than this error causes counts as unconstrained.
const TILT: f64 = 0.1;
/// Standard deviation of a point around its surfel, m: farther off it pulls less.
const TOUCHING: f64 = 0.05;
/// Added to the diagonal, so that a scan without any point near a surface stays at the prior.
const LEAST_INFORMATION: f64 = 1e-9;
/// Added where a direction was left out, so that rounding does not bring it back: known to 30 m or rad.
const UNKNOWN: f64 = 1e-3;

/// Knowledge of the pose without the scan: odometry.
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
    /// Transform from the pose to the pose by the scan alone, without the prior: at most half a field's width (on surfels 0.04 m) and 0.03
    /// rad, and not along `degenerate`.
    pub by_scan: Pose2,
    /// Information of the scan alone, without the prior: x, y (1/m², frame of the scan's pose) and yaw (1/rad²).
    pub information: Matrix3<f64>,
    /// Mean likelihood of the points, 0 to 1.
    pub score: f64,
    /// Unit vector in the frame of the field along which the scan alone does not constrain the position, if there is one; of two, the
    /// worse.
    pub degenerate: Option<Vector2<f64>>,
}

impl Refined {
    /// Moves this match along `degenerate` to the expected pose. The scan's information there is not only weak but wrong: along a corridor
    /// the visible ends of the walls move with the robot. After Zhang, Kaess and Singh, "On degeneracy of optimization-based state
    /// estimation problems", ICRA 2016.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_scan_matching::{FieldSettings, LikelihoodField, RefineSettings, refine};
    /// # let wall: Vec<_> = (-60..=60).map(|i| Point2::new(2.0, 0.05 * f64::from(i))).collect();
    /// # let mut field = LikelihoodField::new(&FieldSettings::default());
    /// # field.insert(Pose2::IDENTITY, &wall);
    /// // A long wall along the y axis says nothing about y: there odometry counts.
    /// let by_odometry = Pose2::new(0.02, 0.3, 0.0);
    /// let matched = refine(&field, &wall, by_odometry, None, &RefineSettings::default());
    /// assert!(matched.degenerate.unwrap().y.abs() > 0.99);
    /// let pose = matched.expected_where_degenerate(by_odometry).pose;
    /// assert!(pose.x.abs() < 0.01 && (pose.y - 0.3).abs() < 0.01, "{pose:?}");
    /// ```
    #[must_use]
    pub fn expected_where_degenerate(self, expected: Pose2) -> Self {
        let Some(along) = self.degenerate else {
            return self;
        };
        let (sin, cos) = self.pose.yaw.sin_cos();
        let along = Vector2::new(cos * along.x + sin * along.y, cos * along.y - sin * along.x);
        let away = self.pose.inverse() * expected;
        let way = along * along.dot(&Vector2::new(away.x, away.y));
        Self {
            pose: self.pose * Pose2::new(way.x, way.y, 0.0),
            information: Untold::along(&self.information, along).without(&self.information),
            ..self
        }
    }
}

/// A direction that a scan hardly constrains. Its information along that direction is noise, and so is the correlation with the rest: only
/// what holds for every position along the direction counts.
#[derive(Clone, Copy, Debug)]
struct Untold {
    /// Unit vector: x, y, and no turn.
    along: Vector3<f64>,
    /// The scan's information along it: mixed with the whole pose, and its own.
    mixed: Vector3<f64>,
    own: f64,
}

impl Untold {
    fn along(information: &Matrix3<f64>, along: Vector2<f64>) -> Self {
        let along = Vector3::new(along.x, along.y, 0.0);
        let mixed = information * along;
        Self {
            along,
            mixed,
            own: mixed.dot(&along).max(LEAST_INFORMATION),
        }
    }

    /// Information of the rest: that of the marginal distribution.
    fn without(&self, information: &Matrix3<f64>) -> Matrix3<f64> {
        information - self.mixed * self.mixed.transpose() / self.own
    }

    /// A gradient of the rest.
    fn across(&self, gradient: Vector3<f64>) -> Vector3<f64> {
        gradient - self.mixed * (self.along.dot(&gradient) / self.own)
    }
}

/// Refines a pose. `points`: of the scan, in its frame, m.
///
/// ```
/// # use nalgebra::Point2;
/// # use zenav_protocol::geometry::Pose2;
/// # use zenav_scan_matching::{FieldSettings, LikelihoodField, RefineSettings, refine};
/// # let side = || (0..40).map(|i| 0.05 * f64::from(i));
/// # let corner: Vec<_> = side().map(|y| Point2::new(2.0, y)).chain(side().map(|x| Point2::new(2.0 - x, 2.0))).collect();
/// # let mut field = LikelihoodField::new(&FieldSettings::default());
/// // The corner of a room, seen from (1, 1); odometry is off by 4 cm and 0.02 rad.
/// let truth = Pose2::new(1.0, 1.0, 0.0);
/// field.insert(truth, &corner);
/// let refined = refine(&field, &corner, Pose2::new(1.03, 0.97, 0.02), None, &RefineSettings::default());
/// assert!(refined.pose.distance(&truth) < 0.01 && refined.pose.yaw.abs() < 0.01, "{refined:?}");
/// assert!(refined.score > 0.7 && refined.degenerate.is_none());
/// ```
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

/// A scan to be refined from several poses; the expensive preparation is shared by all of them.
#[derive(Clone, Debug)]
pub struct Refinable<'a> {
    points: &'a [Point2<f64>],
    /// Normals of the surfaces at the points.
    normals: Vec<Option<Vector2<f64>>>,
}

impl<'a> Refinable<'a> {
    /// `points`: of the scan, in its frame, m.
    #[must_use]
    pub fn new(points: &'a [Point2<f64>]) -> Self {
        Self::seen_from(Point2::origin(), points)
    }

    /// The same for a scan whose beams begin at `laser`, in its frame, m: normals point towards it.
    ///
    /// ```
    /// use nalgebra::{Point2, Vector2};
    /// use zenav_scan_matching::Refinable;
    ///
    /// let wall: Vec<_> = (-10..=10).map(|i| Point2::new(2.0, 0.05 * f64::from(i))).collect();
    /// let seen = Refinable::seen_from(Point2::new(0.2, 0.0), &wall);
    /// let normal = seen.normals()[10].unwrap();
    /// assert!((normal - Vector2::new(-1.0, 0.0)).norm() < 1e-9, "towards the laser");
    /// ```
    #[must_use]
    pub fn seen_from(laser: Point2<f64>, points: &'a [Point2<f64>]) -> Self {
        Self {
            points,
            normals: normals(laser, points),
        }
    }

    /// [`refine()`] on these points, whose normals are computed only once.
    #[must_use]
    pub fn refine(
        &self,
        field: &LikelihoodField,
        start: Pose2,
        prior: Option<&Prior>,
        settings: &RefineSettings,
    ) -> Refined {
        // Steps are short compared with the width of the field, so surfaces keep their direction. Further away the field bends.
        let surfaces = surfaces(field, self.points, &self.normals, start, Pull::Anywhere);
        let at = |pose| Some(sums(field, self.points, &surfaces, pose, settings));
        let pose = descend(start, prior, field.sigma(), settings, at).unwrap_or(start);
        let surfaces = self::surfaces(field, self.points, &self.normals, pose, Pull::Anywhere);
        let sums = sums(field, self.points, &surfaces, pose, settings);
        Refined::new(pose, &sums, 0.5 * field.sigma(), settings.degenerate_sigma)
    }

    /// The scan's points, in its frame, m.
    #[must_use]
    pub const fn points(&self) -> &'a [Point2<f64>] {
        self.points
    }

    /// The normals of the surfaces at the points, towards the laser, where their neighbours determine them.
    #[must_use]
    pub fn normals(&self) -> &[Option<Vector2<f64>>] {
        &self.normals
    }

    /// Makes a match that was [refined](Self::refine) in a field exact on the surfels that belong to it; `None` if few points lie on
    /// surfels, or if these would move the scan elsewhere.
    ///
    /// ```
    /// # use nalgebra::Point2;
    /// # use zenav_protocol::geometry::Pose2;
    /// # use zenav_scan_matching::{FieldSettings, LikelihoodField, Refinable, RefineSettings, Surfels};
    /// # let side = || (0..40).map(|i| 0.05 * f64::from(i));
    /// # let corner: Vec<_> = side().map(|y| Point2::new(2.0, y)).chain(side().map(|x| Point2::new(2.0 - x, 2.0))).collect();
    /// # let (settings, mut field) = (RefineSettings::default(), LikelihoodField::new(&FieldSettings::default()));
    /// let scan = Refinable::new(&corner);
    /// let mut surfels = Surfels::default();
    /// field.insert(Pose2::IDENTITY, scan.points());
    /// surfels.insert(Pose2::IDENTITY, scan.points(), scan.normals());
    /// let rough = scan.refine(&field, Pose2::new(0.03, 0.0, 0.01), None, &settings);
    /// let exact = scan.polish(&field, &surfels, &rough, None, &settings).unwrap();
    /// assert!(exact.pose.distance(&Pose2::IDENTITY) < 0.005, "{exact:?}");
    /// assert!(scan.polish(&field, &Surfels::default(), &rough, None, &settings).is_none(), "without surfels");
    /// ```
    #[must_use]
    pub fn polish(
        &self,
        field: &LikelihoodField,
        surfels: &Surfels,
        rough: &Refined,
        prior: Option<&Prior>,
        settings: &RefineSettings,
    ) -> Option<Refined> {
        let surfaces = surfaces(field, self.points, &self.normals, rough.pose, Pull::Across);
        let at = |pose| self.touches(field, surfels, &surfaces, pose, settings);
        let pose = descend(rough.pose, prior, FARTHEST_STEP, settings, at)?;
        let off = rough.pose.inverse() * pose;
        let is_near = off.x.hypot(off.y) <= ELSEWHERE.0 && off.yaw.abs() <= ELSEWHERE.1;
        let sums = at(pose).filter(|_| is_near)?;
        Some(Refined {
            score: rough.score,
            ..Refined::new(pose, &sums, FARTHEST_STEP, settings.degenerate_sigma)
        })
    }

    /// Sums over the points at a pose: those with a normal on surfels, the others in the field; `None` if few lie on a surfel. A point with
    /// a normal but without a surfel is new: in the field it would be drawn to the end of the known surface.
    fn touches(
        &self,
        field: &LikelihoodField,
        surfels: &Surfels,
        surfaces: &[Surface],
        pose: Pose2,
        settings: &RefineSettings,
    ) -> Option<Sums> {
        let turn = Rotation2::new(pose.yaw);
        let (mut sums, mut touched) = (Sums::default(), 0_u32);
        for ((point, normal), surface) in placed(pose, self.points).into_iter().zip(&self.normals).zip(surfaces) {
            let Some(normal) = normal else {
                sums.add_likely(field, point, surface, pose, SURE);
                continue;
            };
            let Some(touch) = surfels.touched(point, turn * normal) else {
                continue;
            };
            touched += 1;
            let weight = touch.trust * (-0.5 * (touch.distance / TOUCHING).powi(2)).exp();
            let across = touch.normal;
            sums.add(
                point,
                &(across * across.transpose() * weight),
                -across * (weight * touch.distance),
                pose,
            );
        }
        let least = (ON_SURFELS * self.points.len() as f64).clamp(FEWEST.0, FEWEST.1);
        (f64::from(touched) >= least).then(|| sums.of(self.points.len(), settings.surfel_sigma, settings))
    }
}

/// Gauss-Newton steps to the minimum of `at` and a prior, none longer than `farthest`, m; `None` where `at` has no value.
fn descend(
    start: Pose2,
    prior: Option<&Prior>,
    farthest: f64,
    settings: &RefineSettings,
    at: impl Fn(Pose2) -> Option<Sums>,
) -> Option<Pose2> {
    let mut pose = start;
    for _ in 0..settings.max_iterations {
        let Sums {
            mut information,
            mut gradient,
            ..
        } = at(pose)?;
        if let Some(prior) = prior {
            let away = Vector3::new(
                pose.x - prior.pose.x,
                pose.y - prior.pose.y,
                wrap_angle(pose.yaw - prior.pose.yaw),
            );
            information += prior.information;
            gradient += prior.information * away;
        }
        information += Matrix3::identity() * LEAST_INFORMATION;
        let Some(factor) = information.cholesky() else {
            break;
        };
        let mut step = factor.solve(&gradient);
        let length = step.x.hypot(step.y);
        if length > farthest {
            step *= farthest / length;
        }
        pose = Pose2::new(pose.x - step.x, pose.y - step.y, pose.yaw - step.z);
        if step.norm() < settings.tolerance {
            break;
        }
    }
    Some(pose)
}

impl Refined {
    /// From the sums of a scan alone at a pose. `farthest`: range in which the parabola is valid, m; a direction known worse than
    /// `degenerate_sigma`, m, is degenerate.
    fn new(pose: Pose2, sums: &Sums, farthest: f64, degenerate_sigma: f64) -> Self {
        let information = sums.information;
        let degenerate = degenerate(&information, degenerate_sigma);
        let (sin, cos) = pose.yaw.sin_cos();
        let turn = Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0);
        let untold = degenerate.map(|along| Untold::along(&information, along));
        let known = untold.map_or(information, |untold| untold.without(&information));
        let gradient = untold.map_or(sums.gradient, |untold| untold.across(sums.gradient));
        let by_scan = turn.transpose() * newton_step(&known, gradient, farthest);
        Self {
            pose,
            by_scan: Pose2::new(by_scan.x, by_scan.y, by_scan.z),
            information: turn.transpose() * information * turn,
            score: sums.score,
            degenerate,
        }
    }
}

/// The step to the minimum of a parabola with this Hessian and gradient, limited to its range of validity.
fn newton_step(hessian: &Matrix3<f64>, gradient: Vector3<f64>, farthest: f64) -> Vector3<f64> {
    let known = hessian + Matrix3::identity() * UNKNOWN;
    let step = known
        .cholesky()
        .map_or_else(Vector3::zeros, |factor| -factor.solve(&gradient));
    let too_far = (step.x.hypot(step.y) / farthest).max(step.z.abs() / FARTHEST_TURN);
    step / too_far.max(1.0)
}

/// Direction of pull of a point whose surface only the field shows.
#[derive(Clone, Copy, Debug)]
enum Pull {
    /// To the nearest known surface point.
    Anywhere,
    /// Across the surface.
    Across,
}

/// The pull of a point.
#[derive(Clone, Copy, Debug)]
struct Surface {
    /// `n nᵀ` of the normal of its surface; shorter if the surface has no single direction.
    plane: Matrix2<f64>,
    /// The directions in which it pulls.
    pull: Matrix2<f64>,
}

/// The surface of each point. Where the neighbours in the scan determine its normal, the point pulls only across the surface: the visible
/// end of a wall moves along it with the robot, and would draw the scan back to where it ended before. Elsewhere the slopes of the field
/// around the point give the direction.
fn surfaces(
    field: &LikelihoodField,
    points: &[Point2<f64>],
    normals: &[Option<Vector2<f64>>],
    pose: Pose2,
    pull: Pull,
) -> Vec<Surface> {
    let away = field.sigma();
    let around = [(away, 0.0), (-away, 0.0), (0.0, away), (0.0, -away)].map(|(x, y)| Vector2::new(x, y));
    let turn = Rotation2::new(pose.yaw);
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
        let plane = (tensor - Matrix2::identity() * smaller) / sum.max(f64::MIN_POSITIVE);
        let pull = match pull {
            Pull::Across => plane,
            Pull::Anywhere => Matrix2::identity(),
        };
        Surface { plane, pull }
    };
    placed(pose, points).into_iter().zip(normals).map(of).collect()
}

/// Sums over the points of a scan at a pose.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    /// Of the pose, axes of the field.
    information: Matrix3<f64>,
    /// Of the cost.
    gradient: Vector3<f64>,
    /// Mean likelihood of the points in the field.
    score: f64,
}

impl Sums {
    /// Adds a point with the information of its position, and its displacement, m.
    fn add(&mut self, point: Point2<f64>, plane: &Matrix2<f64>, drawn: Vector2<f64>, pose: Pose2) {
        let lever = Vector2::new(pose.y - point.y, point.x - pose.x);
        self.gradient -= Vector3::new(drawn.x, drawn.y, drawn.dot(&lever));
        let mixed = plane * lever;
        self.information += Matrix3::new(
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

    /// Adds a point that the field draws across its surface, if its likelihood is at least `least`.
    fn add_likely(&mut self, field: &LikelihoodField, point: Point2<f64>, surface: &Surface, pose: Pose2, least: f64) {
        let (likelihood, slope) = field.likelihood(point);
        self.score += likelihood;
        if likelihood >= least {
            let drawn = surface.pull * slope * field.sigma().powi(2);
            self.add(point, &(surface.plane * likelihood), drawn, pose);
        }
    }

    /// Scales the sums over this many points, each with a standard deviation `sigma`, m.
    fn of(self, points: usize, sigma: f64, settings: &RefineSettings) -> Self {
        let per_point = sigma.powi(-2) / settings.points_per_independent;
        Self {
            information: self.information * per_point,
            gradient: self.gradient * per_point,
            score: self.score / points.max(1) as f64,
        }
    }
}

/// Sums over the points in a field.
fn sums(
    field: &LikelihoodField,
    points: &[Point2<f64>],
    surfaces: &[Surface],
    pose: Pose2,
    settings: &RefineSettings,
) -> Sums {
    let mut sums = Sums::default();
    for (point, surface) in placed(pose, points).into_iter().zip(surfaces) {
        sums.add_likely(field, point, surface, pose, NEAR);
    }
    sums.of(points.len(), settings.point_sigma, settings)
}

/// The least certain direction of the position, if it is too uncertain, with the heading unknown, too.
fn degenerate(information: &Matrix3<f64>, degenerate_sigma: f64) -> Option<Vector2<f64>> {
    let plane: Matrix2<f64> = information.fixed_view::<2, 2>(0, 0).into_owned();
    let mixed = Vector2::new(information.m13, information.m23);
    let position = plane - mixed * mixed.transpose() / information.m33.max(LEAST_INFORMATION);
    let eigen = position.symmetric_eigen();
    let worst = eigen.eigenvalues.imin();
    let least = degenerate_sigma.powi(-2).max(TILT * TILT * eigen.eigenvalues.max());
    (eigen.eigenvalues[worst] < least).then(|| eigen.eigenvectors.column(worst).into_owned())
}

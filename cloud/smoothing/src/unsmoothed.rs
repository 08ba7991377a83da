//! Unsmoothed path. The path itself as stop, turn and go without smoothing, certified like any other trajectory.

use nalgebra::Point2;
use zenav_protocol::geometry::{Pose2, Twist2};
use zenav_protocol::messages::PlanStatistics;
use zenav_protocol::robot::RobotModel;

use super::certificate::{Evidence, certify};
use super::outcome::{Fallback, Outcome};
use super::smoother::Smoothed;
use super::timing::stop_turn_go::stop_turn_go;
use super::timing::{Limits, UNRESTRICTED};

/// The unsmoothed path (corner points, map frame, the start included or not) from a pose and velocity, to rest at a heading.
///
/// It needs neither map nor solver; the caller may replace `status`.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_protocol::geometry::{Pose2, Twist2};
/// use zenav_protocol::robot::{RobotModel, shipped};
/// use zenav_smoothing::unsmoothed;
///
/// let model = RobotModel::from_toml(shipped("tiago").unwrap(), "tiago").unwrap();
/// let path = [Point2::new(2.0, 0.0), Point2::new(2.0, 1.0)];
/// let found = unsmoothed(&path, Pose2::IDENTITY, Twist2::ZERO, None, &model).statistics;
/// assert!((found.length - 3.0).abs() < 1e-6 && found.status == "fallback:not_tried");
/// assert!(found.certificate.largest_use.wheel_speed < 0.951, "a plan leaves 5 % for control");
/// ```
#[must_use]
pub fn unsmoothed(
    path: &[Point2<f64>],
    start: Pose2,
    velocity: Twist2,
    goal_yaw: Option<f64>,
    model: &RobotModel,
) -> Smoothed {
    let limits = Limits::of(model);
    let trajectory = stop_turn_go(path, start, velocity, goal_yaw, &limits, UNRESTRICTED);
    let (trajectory, jerk) = trajectory.with_limited_jerk(&limits);
    let outcome = Outcome::Unsmoothed(Fallback::NotTried);
    let statistics = PlanStatistics {
        status: outcome.to_string(),
        length: trajectory.length(),
        duration: trajectory.duration(),
        energy_j: trajectory.energy(model),
        certificate: certify(&trajectory, &model.drive, Evidence::default(), jerk),
        ..PlanStatistics::default()
    };
    Smoothed {
        outcome,
        trajectory,
        corridor: Vec::new(),
        statistics,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_certified_with_and_without_a_limited_jerk() {
        let mut model = zenav_fixtures::robot("tiago");
        let path = [Point2::new(2.0, 0.0), Point2::new(2.0, 1.0)];
        let run = |model: &RobotModel| unsmoothed(&path, Pose2::IDENTITY, Twist2::ZERO, Some(0.0), model).statistics;
        let sweep = run(&model);
        assert_eq!(
            (sweep.certificate.time_law.as_str(), sweep.certificate.over_lower_bound),
            ("sweep", 1.0)
        );
        assert!(sweep.certificate.corridor.is_none() && sweep.certificate.largest_use.jerk.is_none());
        model.drive.max_jerk = Some(2.0);
        let limited = run(&model);
        assert_eq!(limited.certificate.time_law, "jerk_limited");
        assert!(limited.duration > sweep.duration && limited.certificate.lower_bound == sweep.duration);
        assert!((0.5..=0.951).contains(&limited.certificate.largest_use.jerk.unwrap()));
    }
}

//! Words and shapes. An event as one line of text, and a footprint as corners.

use nalgebra::Point2;
use zenav_protocol::messages::EventKind;
use zenav_protocol::robot::Footprint;

/// The event in one line.
#[must_use]
pub fn event(kind: &EventKind) -> String {
    match kind {
        EventKind::Started => "started".to_owned(),
        EventKind::PlanAccepted {
            goal_id, trajectory_id, ..
        } => format!("plan accepted: goal {goal_id}, trajectory {trajectory_id}"),
        EventKind::PlanRejected { goal_id, reason, .. } => format!("plan rejected: goal {goal_id}: {reason}"),
        EventKind::PlanFinished { goal_id, .. } => format!("plan finished: goal {goal_id}"),
        EventKind::PlanExpired { goal_id } => format!("plan expired: goal {goal_id}"),
        EventKind::PlanDiscarded { goal_id, reason } => format!("plan discarded: goal {goal_id}: {reason}"),
        EventKind::Bumped => "bumped".to_owned(),
        EventKind::BatteryLow { charge } => format!("battery low: {:.0} %", 100.0 * charge),
        EventKind::InputsDropped { too_late, broken } => {
            format!("measurements dropped: {too_late} too late, {broken} broken")
        }
        EventKind::Localisation { health } => format!("localisation: {health}"),
        EventKind::TeleopDropped { reason } => format!("teleop command dropped: {reason}"),
        EventKind::Guard { zone, reason } => format!("collision monitor {zone:?}: {reason}"),
        EventKind::Lease { holder, epoch, reason } => {
            let holder = holder.as_deref().unwrap_or("nobody");
            format!("lease: {holder}, epoch {epoch}: {reason}")
        }
        EventKind::LinkChanged { link } => format!("link {link:?}"),
        EventKind::Stopped { by } => format!("stopped by {by}"),
        EventKind::Resumed { by } => format!("resumed by {by}"),
        EventKind::BehaviourDone { report } => {
            let reason = report.reason.as_deref().map(|reason| format!(": {reason}"));
            format!(
                "maneuver {} {:?}{}",
                report.id,
                report.state,
                reason.unwrap_or_default()
            )
        }
        EventKind::Transition {
            behaviour,
            from,
            to,
            reason,
        } => format!("{behaviour}: {from} to {to}: {reason}"),
    }
}

/// The outline as corners, base frame, m; a disc is given `corners` of them.
#[must_use]
pub fn outline(footprint: &Footprint, corners: u32) -> Vec<Point2<f64>> {
    match footprint {
        Footprint::Polygon(points) => points.clone(),
        Footprint::Radius(radius) => {
            let corner = |nth: u32| {
                let angle = std::f64::consts::TAU * f64::from(nth) / f64::from(corners.max(3));
                Point2::new(radius * angle.cos(), radius * angle.sin())
            };
            (0..corners.max(3)).map(corner).collect()
        }
    }
}

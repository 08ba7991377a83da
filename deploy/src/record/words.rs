//! Words. An event as one line of text, and its severity.

use zenav_protocol::messages::{EventKind, GuardZone, Link};

use crate::output::piece;

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
        EventKind::Guard { zone, reason } => format!("collision monitor {}: {reason}", lower(zone)),
        EventKind::Lease { holder, epoch, reason } => {
            let holder = holder.as_deref().unwrap_or("nobody");
            format!("lease: {holder}, epoch {epoch}: {reason}")
        }
        EventKind::LinkChanged { link } => format!("link {}", lower(link)),
        EventKind::Stopped { by } => format!("stopped by {by}"),
        EventKind::Resumed { by } => format!("resumed by {by}"),
        EventKind::BehaviourDone { report } => {
            let reason = piece(report.reason.as_deref(), |reason| format!(": {reason}"));
            format!("maneuver {} {}{reason}", report.id, lower(&report.state))
        }
        EventKind::Transition {
            behaviour,
            from,
            to,
            reason,
        } => format!("{behaviour}: {from} to {to}: {reason}"),
    }
}

/// The name of a variant, in small letters.
fn lower(variant: &impl std::fmt::Debug) -> String {
    format!("{variant:?}").to_lowercase()
}

/// Whether the event needs attention.
#[must_use]
pub const fn is_warning(kind: &EventKind) -> bool {
    matches!(
        kind,
        EventKind::Bumped
            | EventKind::PlanRejected { .. }
            | EventKind::PlanExpired { .. }
            | EventKind::BatteryLow { .. }
            | EventKind::InputsDropped { .. }
            | EventKind::TeleopDropped { .. }
            | EventKind::Stopped { .. }
            | EventKind::Guard {
                zone: GuardZone::Stop,
                ..
            }
            | EventKind::LinkChanged {
                link: Link::Stale | Link::Lost
            }
    )
}

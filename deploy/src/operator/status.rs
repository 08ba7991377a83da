//! Status line of teleoperation. Who commands the robot now, and what it does, from the robot's own state while that is fresh. Pure.

use std::time::Duration;

use zenav_protocol::geometry::Twist2;
use zenav_protocol::messages::{EdgeState, GuardZone, LeaseReply, LostPolicy, Mode};

use crate::output::hundredths;

/// Age from which a state is reported as old: the robot drops commands that echo it.
pub(super) const OLD: Duration = Duration::from_millis(300);

/// Why a newer state shows that a grant is lost; `None` while the grant is valid.
pub(super) fn lost(grant: &LeaseReply, holder: &str, state: &EdgeState) -> Option<String> {
    let lease = &state.lease;
    if state.boot_id != grant.boot_id {
        return Some("control was lost: the robot's edge has restarted".to_owned());
    }
    // Every later grant has a higher epoch: a state with a lower one was sent before ours.
    let ours = lease.live && lease.holder.as_deref() == Some(holder);
    if lease.epoch < grant.epoch || (lease.epoch == grant.epoch && ours) {
        return None;
    }
    Some(match &lease.holder {
        Some(other) if lease.live => format!("control was lost to {other}"),
        Some(_) => format!("control has lapsed: the robot heard nothing for {} s", grant.ttl_secs),
        None => "control was released elsewhere".to_owned(),
    })
}

/// Contents of the status line.
pub(super) struct View<'a> {
    pub(super) robot: &'a str,
    /// The lease grant under which commands are sent; `None`: no control.
    pub(super) held: Option<&'a LeaseReply>,
    /// Age of the state.
    pub(super) age: Duration,
    pub(super) state: &'a EdgeState,
    /// Top speeds at the present step.
    pub(super) limit: Twist2,
}

impl View<'_> {
    /// One line, most important part first: a narrow terminal cuts off its end.
    pub(super) fn line(&self) -> String {
        let Self {
            robot, state, limit, ..
        } = self;
        let link = if self.age > OLD {
            format!("silent for {:.1} s", self.age.as_secs_f64())
        } else {
            format!("{:?}", state.link)
        };
        let stopped = match state.mode {
            Mode::Stopped => " (R resumes)",
            _ => "",
        };
        let guard = match state.guard {
            GuardZone::Clear => String::new(),
            zone => format!(" | collision monitor {zone:?}"),
        };
        format!(
            "{robot} | {} | {:?}{stopped} | {link}{guard} | {}/{:.2} m/s {}/{:.2} rad/s | {:.0} %",
            self.command(),
            state.mode,
            signed(state.velocity.v),
            limit.v,
            signed(state.velocity.w),
            limit.w,
            100.0 * state.battery,
        )
    }

    fn command(&self) -> String {
        let lease = &self.state.lease;
        match (self.held, &lease.holder) {
            // No state for longer than the lease lasts: it may have expired.
            (Some(grant), _) if self.age.as_secs_f64() > grant.ttl_secs => "YOU, if it hears you".to_owned(),
            (Some(_), _) => "YOU".to_owned(),
            (None, Some(holder)) if lease.live => holder.clone(),
            _ => match (self.state.mode, self.state.wall_follower) {
                (Mode::WallFollow, Some(follower)) => format!("itself: {}", follower.name()),
                (Mode::ReturnHome, _) => "itself: return home".to_owned(),
                _ => "nobody".to_owned(),
            },
        }
    }
}

/// What is known of a robot that could not be stopped: `commanded` if this session held the lease, `alone` is its policy after loss of its
/// commander, `heard` its last state with age.
pub(super) fn unstopped(commanded: bool, alone: Option<LostPolicy>, heard: Option<(Duration, &EdgeState)>) -> String {
    let Some((age, state)) = heard else {
        return "what it does is not known".to_owned();
    };
    let then = match (state.mode, commanded, alone) {
        (Mode::Stopped, _, _) => "it stays so until resumed",
        (_, _, Some(LostPolicy::WallFollow)) => "it follows walls on its own when it loses its commander",
        (_, _, Some(LostPolicy::ReturnHome)) => "it returns to its start on its own when it loses its commander",
        (_, true, Some(LostPolicy::FinishHorizon | LostPolicy::Stop)) => {
            "it brakes without commands, but still obeys other commanders"
        }
        (_, true, None) => "it brakes without commands; what it does then is not known",
        (_, false, _) => "it keeps obeying its present commander",
    };
    let ago = age.as_secs_f64();
    format!("heard last {ago:.1} s ago in mode {:?}, {then}", state.mode)
}

/// The part of a line that fits into `columns`.
pub(super) fn cut(line: &str, columns: usize) -> String {
    line.chars().take(columns.saturating_sub(1)).collect()
}

/// With a sign; zero is always `+0.00`.
fn signed(value: f64) -> String {
    format!("{:+.2}", hundredths(value))
}

#[cfg(test)]
mod tests {
    use zenav_protocol::messages::{LeaseState, Link};

    use super::*;

    fn grant() -> LeaseReply {
        LeaseReply {
            epoch: 5,
            ttl_secs: 1.0,
            boot_id: "b1".to_owned(),
            round_trip_secs: None,
        }
    }

    fn state(epoch: u64, holder: Option<&str>, live: bool) -> EdgeState {
        EdgeState {
            boot_id: "b1".to_owned(),
            mode: Mode::Teleop,
            link: Link::Connected,
            lease: LeaseState {
                holder: holder.map(str::to_owned),
                epoch,
                live,
                ..LeaseState::default()
            },
            velocity: Twist2::new(0.3, -0.001),
            battery: 1.0,
            uplink: 1.0,
            ..EdgeState::default()
        }
    }

    fn why(state: &EdgeState) -> Option<String> {
        lost(&grant(), "me", state)
    }

    #[test]
    fn a_lapsed_lease_is_lost_although_its_epoch_stays() {
        assert_eq!(why(&state(5, Some("me"), true)), None);
        assert!(why(&state(5, Some("me"), false)).unwrap().contains("lapsed"));
        assert!(why(&state(5, None, false)).unwrap().contains("released"));
        assert!(why(&state(6, Some("you"), true)).unwrap().contains("lost to you"));
        let restarted = EdgeState {
            boot_id: "b2".to_owned(),
            ..state(5, None, false)
        };
        assert!(why(&restarted).unwrap().contains("restarted"));
    }

    #[test]
    fn a_state_that_was_sent_before_the_grant_takes_nothing_away() {
        assert_eq!(why(&state(4, Some("mission"), true)), None);
        assert_eq!(why(&state(4, Some("me"), false)), None);
    }

    fn view<'a>(held: Option<&'a LeaseReply>, age: u64, state: &'a EdgeState) -> View<'a> {
        View {
            robot: "neo",
            held,
            age: Duration::from_millis(age),
            state,
            limit: Twist2::new(0.5, 1.0),
        }
    }

    #[test]
    fn the_line_tells_who_commands_and_fits_into_eighty_columns() {
        let (held, state) = (grant(), state(5, Some("me"), true));
        let line = view(Some(&held), 100, &state).line();
        assert_eq!(
            line,
            "neo | YOU | Teleop | Connected | +0.30/0.50 m/s +0.00/1.00 rad/s | 100 %"
        );
        assert!(line.len() < 80);
        assert!(view(None, 100, &state).line().starts_with("neo | me |"));
        let silent = view(Some(&held), 1200, &state).line();
        assert!(
            silent.starts_with("neo | YOU, if it hears you | Teleop | silent for 1.2 s"),
            "{silent}"
        );
        assert_eq!(cut(&silent, 10), "neo | YOU");
    }

    fn heard(state: &EdgeState) -> Option<(Duration, &EdgeState)> {
        Some((Duration::from_secs(2), state))
    }

    #[test]
    fn of_a_robot_that_was_not_stopped_only_what_is_true_is_told() {
        use LostPolicy::{FinishHorizon, ReturnHome, WallFollow};
        let state = state(5, Some("me"), true);
        let told = |commanded, alone| unstopped(commanded, alone, heard(&state));
        assert!(told(true, Some(FinishHorizon)).contains("brakes without commands"));
        assert!(told(false, Some(FinishHorizon)).contains("its present commander"));
        for (alone, does) in [
            (Some(WallFollow), "follows walls"),
            (Some(ReturnHome), "returns to its start"),
            (None, "not known"),
        ] {
            assert!(told(true, alone).contains(does), "{alone:?}");
        }
        let stopped = EdgeState {
            mode: Mode::Stopped,
            ..state.clone()
        };
        assert!(unstopped(true, Some(WallFollow), heard(&stopped)).contains("until resumed"));
        assert!(unstopped(true, None, None).contains("not known"));
    }
}

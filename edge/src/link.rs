//! What may move the robot, given the link, the lease and the plan? The motion table.
//!
//! | lease | plan | motion |
//! |---|---|---|
//! | live, a mission's | valid | follow |
//! | live, a mission's | expired or none | at rest |
//! | expired | valid | `finish_horizon`: follow to the expiry; `stop`: brake now |
//! | expired | expired or none | at rest |
//! | expired, the link lost | expired or none | `wall_follow`: follow walls; `return_home`: back to the start |
//! | live, an operator's | any | teleop only |

use std::time::Duration;

use zenav_protocol::messages::{LeaseRole, Link, LostPolicy};

/// What moves the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionSource {
    /// The accepted plan.
    Plan,
    /// The operator's twists.
    Teleop,
    /// The wall follower.
    WallFollow,
    /// The way back to the start.
    ReturnHome,
    /// Nothing: at rest, or on the way there within the normal limits.
    Rest,
    /// Nothing: brake as hard as possible.
    Brake,
}

/// Reads the motion table. `plan_valid`: there is an accepted plan that has not expired.
#[must_use]
pub fn motive(
    lease_live: bool,
    role: Option<LeaseRole>,
    plan_valid: bool,
    policy: LostPolicy,
    link: Link,
) -> MotionSource {
    match (lease_live, role) {
        (true, Some(LeaseRole::Operator)) => MotionSource::Teleop,
        (true, _) if plan_valid => MotionSource::Plan,
        (false, _) if plan_valid && policy == LostPolicy::Stop => MotionSource::Brake,
        (false, _) if plan_valid => MotionSource::Plan,
        (false, _) if policy == LostPolicy::WallFollow && link == Link::Lost => MotionSource::WallFollow,
        (false, _) if policy == LostPolicy::ReturnHome && link == Link::Lost => MotionSource::ReturnHome,
        _ => MotionSource::Rest,
    }
}

/// The link by the age of the lease's last renewal; nobody has the lease: lost.
#[must_use]
pub fn link(age: Option<Duration>, stale_after: Duration, lost_after: Duration) -> Link {
    match age {
        Some(age) if age < stale_after => Link::Connected,
        Some(age) if age < lost_after => Link::Stale,
        _ => Link::Lost,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motion_table_is_as_written() {
        use LeaseRole::{Mission, Operator};
        use LostPolicy::{FinishHorizon, ReturnHome, Stop, WallFollow};
        let motive = |live, role, plan_valid, policy| motive(live, role, plan_valid, policy, Link::Stale);
        for policy in [FinishHorizon, Stop, WallFollow, ReturnHome] {
            assert_eq!(motive(true, Some(Mission), true, policy), MotionSource::Plan);
            assert_eq!(motive(true, Some(Mission), false, policy), MotionSource::Rest);
            assert_eq!(motive(false, Some(Mission), false, policy), MotionSource::Rest);
            assert_eq!(motive(true, Some(Operator), true, policy), MotionSource::Teleop);
            assert_eq!(motive(false, None, false, policy), MotionSource::Rest);
        }
        assert_eq!(motive(false, Some(Mission), true, FinishHorizon), MotionSource::Plan);
        assert_eq!(motive(false, Some(Mission), true, Stop), MotionSource::Brake);
        assert_eq!(motive(false, Some(Mission), true, WallFollow), MotionSource::Plan);
        for (policy, motive) in [
            (WallFollow, MotionSource::WallFollow),
            (ReturnHome, MotionSource::ReturnHome),
        ] {
            let lost = |live, plan_valid| super::motive(live, Some(Mission), plan_valid, policy, Link::Lost);
            assert_eq!(lost(false, false), motive);
            assert_eq!(
                (lost(false, true), lost(true, false)),
                (MotionSource::Plan, MotionSource::Rest)
            );
        }
    }

    #[test]
    fn the_link_ages() {
        let at = |ms| {
            link(
                Some(Duration::from_millis(ms)),
                Duration::from_millis(500),
                Duration::from_secs(3),
            )
        };
        assert_eq!(
            (at(0), at(499), at(500), at(2999), at(3000)),
            (Link::Connected, Link::Connected, Link::Stale, Link::Stale, Link::Lost)
        );
        assert_eq!(link(None, Duration::ZERO, Duration::ZERO), Link::Lost);
    }
}

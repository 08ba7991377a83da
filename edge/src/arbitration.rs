//! Motion arbitration. Which source may move the robot, given the lease, the plan, the policy and the link? The motion table:
//!
//! | lease | plan | motion |
//! |---|---|---|
//! | live, a mission's | valid | follow |
//! | live, a mission's | expired or none | at rest |
//! | expired | valid | `finish_horizon`: follow to the expiry; `stop`: brake now |
//! | expired | expired or none | at rest |
//! | expired, the link lost | expired or none | `wall_follow`: follow walls; `return_home`: return to the start |
//! | live, an operator's | any | teleop only |

use zenav_protocol::messages::{LeaseRole, Link, LostPolicy};

/// What moves the robot.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MotionSource {
    /// The accepted plan.
    Plan,
    /// Teleop twists of the operator.
    Teleop,
    /// The wall follower.
    WallFollow,
    /// Return to home: the path it came by, backwards.
    ReturnHome,
    /// Nothing: come to rest within the normal limits.
    Rest,
    /// Nothing: brake as hard as the robot can.
    Brake,
}

/// Reads the motion table. `plan_valid`: there is an accepted plan that has not expired.
///
/// ```
/// use zenav_edge::arbitration::{MotionSource, motion_source};
/// use zenav_protocol::messages::{LeaseRole, Link, LostPolicy};
///
/// let source = |live, plan_valid| motion_source(live, Some(LeaseRole::Mission), plan_valid, LostPolicy::ReturnHome, Link::Lost);
/// assert_eq!(source(true, true), MotionSource::Plan);
/// assert_eq!(source(false, true), MotionSource::Plan, "the horizon is finished without a cloud");
/// assert_eq!(source(false, false), MotionSource::ReturnHome);
/// ```
#[must_use]
pub fn motion_source(
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_motion_table_is_as_written() {
        use LeaseRole::{Mission, Operator};
        use LostPolicy::{FinishHorizon, ReturnHome, Stop, WallFollow};
        let source = |live, role, plan_valid, policy| motion_source(live, role, plan_valid, policy, Link::Stale);
        for policy in [FinishHorizon, Stop, WallFollow, ReturnHome] {
            assert_eq!(source(true, Some(Mission), true, policy), MotionSource::Plan);
            assert_eq!(source(true, Some(Mission), false, policy), MotionSource::Rest);
            assert_eq!(source(false, Some(Mission), false, policy), MotionSource::Rest);
            assert_eq!(source(true, Some(Operator), true, policy), MotionSource::Teleop);
            assert_eq!(source(false, None, false, policy), MotionSource::Rest);
        }
        assert_eq!(source(false, Some(Mission), true, FinishHorizon), MotionSource::Plan);
        assert_eq!(source(false, Some(Mission), true, Stop), MotionSource::Brake);
        assert_eq!(source(false, Some(Mission), true, WallFollow), MotionSource::Plan);
        for (policy, expected) in [
            (WallFollow, MotionSource::WallFollow),
            (ReturnHome, MotionSource::ReturnHome),
        ] {
            let lost = |live, plan_valid| super::motion_source(live, Some(Mission), plan_valid, policy, Link::Lost);
            assert_eq!(lost(false, false), expected);
            assert_eq!(
                (lost(false, true), lost(true, false)),
                (MotionSource::Plan, MotionSource::Rest)
            );
        }
    }
}

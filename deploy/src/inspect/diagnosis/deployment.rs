//! Deployment. Are the link, the workers and the clock as they should be, which all robots share?

use crate::inspect::check::Check;

/// Observations of the clock.
#[derive(Clone, Debug, Default)]
pub(in super::super) struct ClockSeen {
    /// Simulated seconds per wall second, if simulated time is published.
    pub(in super::super) simulated_rate: Option<f64>,
    /// Number of times it stepped back by more than a second.
    pub(in super::super) steps_back: u32,
}

/// Judges the link of this command: `is_at_robot` if only robots answer there.
pub(in super::super) fn link(is_at_robot: bool) -> Check {
    match is_at_robot {
        false => Check::ok("router", "link", "connected"),
        true => Check::warn(
            "router",
            "link",
            "only the robot answers: this is its own endpoint, or nothing else runs",
            "the cloud is seen from a router: `--connect` names one",
        ),
    }
}

/// Judges the workers shared by all robots.
pub(in super::super) fn workers(service: &'static str, count: usize) -> Check {
    match count {
        0 => Check::fail("svc", service, "no worker shows", "start one: `zenav cloud motion`"),
        1 => Check::ok("svc", service, "1 worker"),
        several => Check::ok("svc", service, format!("{several} workers")),
    }
}

/// Judges the common clock.
pub(in super::super) fn clock(seen: &ClockSeen) -> Check {
    match seen.simulated_rate {
        Some(_) if seen.steps_back > 1 => Check::fail(
            "clock",
            "time",
            "two simulations give the time",
            "end one of the edges: robots of one deployment share one world (`zenav up`, or `zenav sim serve` with `zenav edge --attach`)",
        ),
        None => Check::ok("clock", "time", "wall clock (no simulated time is published)"),
        Some(rate) if rate < 0.05 => Check::fail(
            "clock",
            "time",
            "simulated time stands still",
            "the simulation has stopped: restart the edge that hosts it",
        ),
        Some(rate) => Check::ok("clock", "time", format!("simulated, {rate:.2} times wall time")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::inspect::check::Verdict;

    #[test]
    fn simulated_time_that_stands_still_fails() {
        assert_eq!(
            clock(&ClockSeen {
                simulated_rate: Some(0.0),
                steps_back: 0,
            })
            .verdict,
            Verdict::Fail
        );
        assert_eq!(
            clock(&ClockSeen {
                simulated_rate: None,
                steps_back: 0
            })
            .verdict,
            Verdict::Ok
        );
        assert_eq!(workers("motion", 0).verdict, Verdict::Fail);
    }
}

//! Spin, BackUp, DriveOnHeading, DriveToFree: maneuvers that the robot executes on its own, identified by an execution id.

use std::f64::consts::PI;

use serde::{Deserialize, Serialize};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::{BehaviourAction, BehaviourReport, BehaviourRequest, BehaviourState};
use zenav_protocol::time::Stamp;

use super::{fail, no_error, step};
use crate::context::Context;
use crate::io::{Answer, NoAnswer, Ticket};
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Time for which an unanswered request is repeated, s.
const PATIENCE: f64 = 10.0;
/// Period at which the robot is asked for progress, s.
const PERIOD: f64 = 0.2;

/// Remainder below which a maneuver interrupted by a pause counts as done, m and rad.
const ALL_BUT: (f64, f64) = (0.02, 0.03);

/// Nav2's error code of a failed maneuver, by registration id. The next one means that it took too long.
fn failed(id: &str) -> i64 {
    match id {
        "Spin" => 700,
        "BackUp" => 710,
        _ => 720,
    }
}

/// A maneuver of the robot.
#[derive(Default)]
pub struct Behaviour {
    ticket: Option<Ticket>,
    since: Stamp,
    next_ask: Stamp,
    asked: bool,
    cancels: u64,
}

/// The execution, stored before it has an effect.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Execution {
    id: String,
    action: BehaviourAction,
    /// Time at which it is given up, s of the tree's time.
    #[serde(default)]
    until: Option<f64>,
    /// Where it began, map frame.
    #[serde(default)]
    from: Option<Pose2>,
}

impl Execution {
    /// The rest of it for a robot that has reached `here`; `None` if nothing is left.
    fn rest(&self, here: Option<Pose2>) -> Option<BehaviourAction> {
        let (Some(from), Some(here)) = (self.from, here) else {
            return Some(self.action.clone());
        };
        match self.action.clone() {
            BehaviourAction::Drive { distance, speed } => {
                let driven = (here.position() - from.position()).dot(&from.heading()) * distance.signum();
                let left = distance.abs() - driven.max(0.0);
                (left > ALL_BUT.0).then_some(BehaviourAction::Drive {
                    distance: left * distance.signum(),
                    speed,
                })
            }
            BehaviourAction::Spin { angle } if angle.abs() < PI => {
                let turned = wrap_angle(here.yaw - from.yaw) * angle.signum();
                let left = angle.abs() - turned.max(0.0);
                (left > ALL_BUT.1).then_some(BehaviourAction::Spin {
                    angle: left * angle.signum(),
                })
            }
            action => Some(action),
        }
    }
}

impl Leaf<Context> for Behaviour {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let code = failed(io.id());
        let allowance = io.number_or("time_allowance", f64::INFINITY).map_err(String::from);
        let (action, allowance) = match (action(io), allowance) {
            (Ok(action), Ok(allowance)) => (action, allowance),
            (Err(why), _) | (_, Err(why)) => return fail(io, ctx, Some(code), why),
        };
        *self = Self {
            since: ctx.now,
            cancels: ctx.cancels(io.id()),
            ..Self::default()
        };
        let execution = Execution {
            id: ctx.execution_id(),
            action,
            until: Some(io.now().as_secs_f64() + allowance).filter(|until| until.is_finite()),
            from: ctx.robot.pose(),
        };
        if let Err(error) = io.remember(&execution) {
            return fail(io, ctx, Some(code), error.to_string());
        }
        // The request follows in the next tick, when the execution's id is stored.
        step(io, ctx, "begins")
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let code = failed(io.id());
        let Some(execution) = io.recall::<Execution>() else {
            return fail(io, ctx, Some(code), "the execution id is lost");
        };
        if ctx.cancels(io.id()) != self.cancels {
            self.halt(io, ctx);
            io.say("canceled by the tree");
            return Status::Success;
        }
        if execution.until.is_some_and(|until| io.now().as_secs_f64() > until) {
            self.halt(io, ctx);
            return fail(io, ctx, Some(code + 1), "not finished within `time_allowance`");
        }
        let Some(epoch) = ctx.lease.epoch() else {
            self.since = ctx.now;
            return step(io, ctx, "waiting for the lease");
        };
        let reported = ctx
            .robot
            .state()
            .and_then(|state| state.behaviour.clone())
            .filter(|report| report.id == execution.id);
        if let Some(status) = reported.and_then(|report| self.ended(io, ctx, &report)) {
            return status;
        }
        if let Some(answer) = self.ticket.and_then(|ticket| ctx.asks.take(ticket)) {
            self.ticket = None;
            match answer {
                Ok(Answer::Behaviour(reply)) => {
                    self.asked = true;
                    self.since = ctx.now;
                    if let Some(status) = reply.report.and_then(|report| self.ended(io, ctx, &report)) {
                        return status;
                    }
                }
                Ok(_) => {}
                Err(NoAnswer::Refused(refusal)) => return fail(io, ctx, Some(code), refusal.to_string()),
                Err(NoAnswer::Silent(why)) if ctx.now.secs_since(self.since) > PATIENCE => {
                    return fail(io, ctx, Some(code), why);
                }
                Err(NoAnswer::Silent(_)) => {}
            }
        }
        if self.ticket.is_none() && ctx.now >= self.next_ask {
            self.next_ask = ctx.now.plus_secs(PERIOD);
            let action = if self.asked {
                BehaviourAction::Report
            } else {
                execution.action
            };
            self.ticket = Some(ctx.ask_maneuver(BehaviourRequest {
                id: execution.id,
                action,
                epoch: Some(epoch),
            }));
        }
        step(io, ctx, "running")
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        *self = Self {
            since: ctx.now,
            cancels: ctx.cancels(io.id()),
            ..Self::default()
        };
        self.tick(io, ctx)
    }

    fn halt(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) {
        ctx.asks.forget(self.ticket.take());
        if let Some(execution) = io.recall::<Execution>() {
            ctx.call_off(execution.id);
        }
    }
}

impl Behaviour {
    /// The status that a report of the robot means; `None` while the maneuver runs. After a pause of the goal, the rest of the maneuver
    /// is started again.
    fn ended(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, report: &BehaviourReport) -> Option<Status> {
        if report.state != BehaviourState::Canceled || !ctx.is_held_up(&report.id) {
            return judge(io, ctx, report);
        }
        let execution = io.recall::<Execution>()?;
        let Some(action) = execution.rest(ctx.robot.pose()) else {
            no_error(io);
            return Some(Status::Success);
        };
        let rest = Execution {
            id: ctx.execution_id(),
            action,
            from: ctx.robot.pose(),
            ..execution
        };
        if let Err(error) = io.remember(&rest) {
            return Some(fail(io, ctx, Some(failed(io.id())), error.to_string()));
        }
        *self = Self {
            since: ctx.now,
            cancels: self.cancels,
            ..Self::default()
        };
        Some(step(io, ctx, "goes on"))
    }
}

/// The maneuver requested by the node's ports.
fn action(io: &LeafIo<'_>) -> Result<BehaviourAction, String> {
    let get = |port: &str, default: f64| -> Result<f64, String> {
        let value = io.number_or(port, default)?;
        if value.is_finite() {
            Ok(value)
        } else {
            Err(format!("`{port}`: expected a finite number"))
        }
    };
    Ok(match io.id() {
        "Spin" => BehaviourAction::Spin {
            angle: get("spin_dist", 1.57)?,
        },
        "DriveToFree" => BehaviourAction::ToFree {
            clearance: get("clearance", 0.1)?,
            within: get("within", 1.0)?,
        },
        "BackUp" => BehaviourAction::Drive {
            distance: -get("backup_dist", 0.15)?.abs(),
            speed: get("backup_speed", 0.1)?.abs(),
        },
        _ => BehaviourAction::Drive {
            distance: get("dist_to_travel", 0.15)?,
            speed: get("speed", 0.1)?.abs(),
        },
    })
}

/// The status of an ended maneuver; `None` while it runs.
fn judge(io: &mut LeafIo<'_>, ctx: &mut Context, report: &BehaviourReport) -> Option<Status> {
    match report.state {
        BehaviourState::Running => None,
        BehaviourState::Succeeded => {
            no_error(io);
            Some(Status::Success)
        }
        BehaviourState::Failed | BehaviourState::Canceled => {
            let why = report
                .reason
                .clone()
                .unwrap_or_else(|| format!("{:?}", report.state).to_lowercase());
            let code = failed(io.id());
            Some(fail(io, ctx, Some(code), why))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn after_a_pause_the_rest_of_a_motion_is_driven() {
        let rest = |action: BehaviourAction, here: Pose2| {
            let execution = Execution {
                id: "e".to_owned(),
                action,
                until: None,
                from: Some(Pose2::new(1.0, 2.0, PI / 2.0)),
            };
            execution.rest(Some(here))
        };
        let drive = |distance| BehaviourAction::Drive { distance, speed: 0.2 };
        let at = |y: f64| Pose2::new(1.0, 2.0 + y, PI / 2.0);
        let left = |action: Option<BehaviourAction>| match action {
            Some(BehaviourAction::Drive { distance, .. }) => distance,
            Some(BehaviourAction::Spin { angle }) => angle,
            _ => 0.0,
        };
        assert!((left(rest(drive(5.0), at(4.5))) - 0.5).abs() < 1e-9);
        assert!((left(rest(drive(-1.0), at(-0.4))) + 0.6).abs() < 1e-9);
        assert!((left(rest(drive(1.0), at(-0.1))) - 1.0).abs() < 1e-9, "pushed back");
        assert_eq!(rest(drive(1.0), at(0.99)), None);
        let turned = Pose2::new(1.0, 2.0, PI / 2.0 - 1.0);
        assert!((left(rest(BehaviourAction::Spin { angle: -1.5 }, turned)) + 0.5).abs() < 1e-9);
    }
}

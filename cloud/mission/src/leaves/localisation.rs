//! ReinitializeGlobalLocalization, IsLocalised, WaitForLocalisation: a robot with unknown pose has mapping search for it.
//!
//! Nav2's service call succeeds once the search has begun, and so does the leaf; the next leaf checks whether the robot was found.

use zenav_protocol::messages::{LocaliseAction, LocaliseRequest, Refusal};
use zenav_protocol::time::Stamp;

use super::missing::SEND_GOAL_FAILURE;
use super::{fail, no_error, step};
use crate::context::Context;
use crate::io::{Ask, NoAnswer, Ticket};
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Time for which mapping is asked repeatedly, s.
const PATIENCE: f64 = 10.0;
/// Pause for mapping to learn of a new grant, s.
const EPOCH_WAIT: f64 = 0.3;
/// Default time limit of a search, s.
const ALLOWANCE: f64 = 5.0;

/// Starts a search for the robot in the whole map: SUCCESS once it has begun, FAILURE without localisation.
#[derive(Default)]
pub struct Reinitialize {
    since: Stamp,
    not_before: Stamp,
    ticket: Option<Ticket>,
}

impl Leaf<Context> for Reinitialize {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        *self = Self {
            since: ctx.now,
            ..Self::default()
        };
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let waits = ctx.now.secs_since(self.since) < PATIENCE;
        let Some(epoch) = ctx.lease.epoch() else {
            return step(io, ctx, "waiting for the lease");
        };
        if ctx.now < self.not_before {
            return Status::Running;
        }
        let ticket = *self.ticket.get_or_insert_with(|| {
            ctx.asks.ask(Ask::Localise(LocaliseRequest {
                action: LocaliseAction::Global,
                epoch: Some(epoch),
                ..LocaliseRequest::default()
            }))
        });
        let why = match ctx.asks.take(ticket) {
            None => return step(io, ctx, "has the robot looked for"),
            Some(Ok(_)) => {
                no_error(io);
                io.say("the robot is being looked for in the whole map");
                return Status::Success;
            }
            // Mapping does not know the grant yet.
            Some(Err(NoAnswer::Refused(Refusal::WrongEpoch { .. }))) if waits => "waiting for mapping".to_owned(),
            Some(Err(NoAnswer::Silent(why))) if waits => why,
            Some(Err(no)) => {
                let status = fail(io, ctx, Some(SEND_GOAL_FAILURE), no.to_string());
                // The goal's end reports that the robot is lost, rather than that no search was possible.
                if let Some(lost) = ctx.robot.lost() {
                    ctx.goal.failure = Some(format!("{lost}; {no}"));
                }
                return status;
            }
        };
        self.ticket = None;
        self.not_before = ctx.now.plus_secs(EPOCH_WAIT);
        step(io, ctx, &why)
    }

    /// Searching again does no harm.
    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.start(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        ctx.asks.forget(self.ticket.take());
    }
}

/// SUCCESS unless the robot is known to be lost.
pub struct IsLocalised;

impl Leaf<Context> for IsLocalised {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        match ctx.robot.lost() {
            None => Status::Success,
            // Not `fail`: being lost is an answer, not an error.
            Some(why) => io.fail(why),
        }
    }
}

/// SUCCESS once a report after the start says that the robot is localised, FAILURE if none does within `time_allowance`.
#[derive(Default)]
pub struct WaitForLocalisation {
    since: Stamp,
    allowance: f64,
}

impl Leaf<Context> for WaitForLocalisation {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let allowance = match io.get_optional::<f64>("time_allowance") {
            Ok(secs) => secs.unwrap_or(ALLOWANCE),
            Err(error) => return fail(io, ctx, None, error.to_string()),
        };
        if !(allowance.is_finite() && allowance >= 0.0) {
            return fail(io, ctx, None, "`time_allowance`: expected seconds, at least 0");
        }
        (self.since, self.allowance) = (ctx.now, allowance);
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if ctx.robot.is_localised_since(self.since) {
            no_error(io);
            io.say("the robot knows where it is");
            return Status::Success;
        }
        if ctx.now.secs_since(self.since) < self.allowance {
            return step(io, ctx, "waiting until the robot knows where it is");
        }
        let health = ctx
            .robot
            .lost()
            .unwrap_or_else(|| "nobody says where the robot is".to_owned());
        let why = format!("{health}, after a search of {:.0} s", self.allowance);
        let status = fail(io, ctx, None, why.clone());
        ctx.goal.failure = Some(why);
        status
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.start(io, ctx)
    }
}

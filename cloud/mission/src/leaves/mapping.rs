//! DoesMapExist, MapEnvironment, SaveMap: is there a map, and how is one made?

use serde::{Deserialize, Serialize};
use zenav_protocol::messages::{MapAction, MapRequest, Refusal};
use zenav_protocol::time::Stamp;

use super::{fail, remember, step};
use crate::context::Context;
use crate::io::{Ask, NoAnswer, Ticket};
use zenav_behaviour_tree::{Leaf, LeafIo, Status};

/// Time to wait for a mapping service that is just starting, s.
const PATIENCE: f64 = 10.0;
/// Time for which an action on the map is requested repeatedly, s.
const ACTION_PATIENCE: f64 = 30.0;
/// Pause for mapping to learn of a new grant, s.
const EPOCH_WAIT: f64 = 0.3;

/// SUCCESS if mapping serves a stored map, FAILURE if the map is not stored or none is served.
#[derive(Default)]
pub struct DoesMapExist {
    since: Option<Stamp>,
}

impl Leaf<Context> for DoesMapExist {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.since = None;
        self.tick(io, ctx)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        let since = *self.since.get_or_insert(ctx.now);
        match ctx.map.info() {
            Some(info) if info.stored => {
                io.say("a map is stored");
                Status::Success
            }
            // Not `fail`: a missing map is an answer, not an error.
            Some(_) => io.fail("no map is stored yet"),
            None if ctx.now.secs_since(since) < PATIENCE => step(io, ctx, "waiting for the mapping service"),
            None => io.fail("no mapping service answers"),
        }
    }
}

/// A request that changes the map, repeated under one id until it is answered.
#[derive(Default)]
pub struct Action {
    ticket: Option<Ticket>,
    since: Stamp,
    not_before: Stamp,
}

/// The execution, stored before it has an effect.
#[derive(Clone, Debug, Serialize, Deserialize)]
struct Execution {
    id: String,
    done: bool,
}

/// State of a request that changes the map.
pub enum Acting {
    /// Not answered yet.
    Busy,
    /// The map is as it was to be.
    Done,
    /// Refused, or unanswered.
    Failed(String),
}

impl Action {
    /// A new request; it is sent in the first step.
    pub fn begin(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) {
        *self = Self {
            since: ctx.now,
            ..Self::default()
        };
        let execution = Execution {
            id: ctx.execution_id(),
            done: false,
        };
        remember(io, &execution);
    }

    /// The same request after a restart.
    pub fn resume(&mut self, ctx: &Context) {
        *self = Self {
            since: ctx.now,
            ..Self::default()
        };
    }

    /// Sends the request, repeatedly if necessary.
    pub fn step(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context, action: MapAction) -> Acting {
        let Some(mut execution) = io.recall::<Execution>() else {
            return Acting::Failed("the execution id is lost".to_owned());
        };
        if execution.done {
            return Acting::Done;
        }
        // The request moves no robot, but only the robot's mission may send it.
        let Some(epoch) = ctx.lease.epoch() else {
            return Acting::Busy;
        };
        if ctx.now < self.not_before {
            return Acting::Busy;
        }
        let request = MapRequest {
            action,
            request_id: Some(execution.id.clone()),
            epoch: Some(epoch),
            ..MapRequest::default()
        };
        let ticket = *self.ticket.get_or_insert_with(|| ctx.asks.ask(Ask::Map(request)));
        match ctx.asks.take(ticket) {
            None => Acting::Busy,
            Some(Ok(_)) => {
                execution.done = true;
                remember(io, &execution);
                Acting::Done
            }
            Some(Err(NoAnswer::Refused(refusal @ Refusal::WrongEpoch { .. }))) => {
                // Mapping does not know the grant yet.
                self.ticket = None;
                if ctx.now.secs_since(self.since) > ACTION_PATIENCE {
                    return Acting::Failed(refusal.to_string());
                }
                self.not_before = ctx.now.plus_secs(EPOCH_WAIT);
                Acting::Busy
            }
            Some(Err(NoAnswer::Refused(refusal))) => Acting::Failed(refusal.to_string()),
            Some(Err(NoAnswer::Silent(why))) => {
                self.ticket = None;
                if ctx.now.secs_since(self.since) > ACTION_PATIENCE {
                    Acting::Failed(why)
                } else {
                    Acting::Busy
                }
            }
        }
    }

    /// Stops waiting.
    pub fn forget(&mut self, ctx: &mut Context) {
        ctx.asks.forget(self.ticket.take());
    }
}

/// Starts a new map and stays RUNNING while scans are inserted; a parallel node decides when the map is complete.
#[derive(Default)]
pub struct MapEnvironment {
    action: Action,
    resumed: bool,
}

impl Leaf<Context> for MapEnvironment {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.resumed = false;
        self.action.begin(io, ctx);
        // The request follows in the next tick, when the execution's id is stored.
        step(io, ctx, "starting a new map")
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        // What was mapped before a restart is kept.
        let action = if self.resumed {
            MapAction::Resume
        } else {
            MapAction::Reset
        };
        match self.action.step(io, ctx, action) {
            Acting::Busy => step(io, ctx, "starting a new map"),
            Acting::Failed(why) => fail(io, ctx, None, why),
            Acting::Done => {
                let scans = ctx.map.info().map_or(0, |info| info.scans);
                io.say(format!("mapping: {scans} scans"));
                Status::Running
            }
        }
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        if io.recall::<Execution>().is_some_and(|execution| execution.done) {
            self.resumed = true;
            self.action.begin(io, ctx);
            return Status::Running;
        }
        self.action.resume(ctx);
        self.tick(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        self.action.forget(ctx);
    }
}

/// Requests an action on the map from mapping, and waits until it is done.
pub struct OnMap {
    action: Action,
    which: MapAction,
    doing: &'static str,
    done: &'static str,
}

impl OnMap {
    /// Stores the map, which then exists.
    #[must_use]
    pub fn save() -> Self {
        Self::new(MapAction::Save, "storing the map", "stored")
    }

    /// Removes obstacles that may have been temporary; those still there will be seen again.
    #[must_use]
    pub fn forget() -> Self {
        Self::new(MapAction::Forget, "clearing the map", "cleared")
    }

    fn new(which: MapAction, doing: &'static str, done: &'static str) -> Self {
        Self {
            action: Action::default(),
            which,
            doing,
            done,
        }
    }
}

impl Leaf<Context> for OnMap {
    fn start(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.action.begin(io, ctx);
        // The request follows in the next tick, when the execution's id is stored.
        step(io, ctx, self.doing)
    }

    fn tick(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        match self.action.step(io, ctx, self.which) {
            Acting::Busy => step(io, ctx, self.doing),
            Acting::Failed(why) => fail(io, ctx, None, why),
            Acting::Done => {
                io.say(self.done);
                Status::Success
            }
        }
    }

    fn resume(&mut self, io: &mut LeafIo<'_>, ctx: &mut Context) -> Status {
        self.action.resume(ctx);
        self.tick(io, ctx)
    }

    fn halt(&mut self, _io: &mut LeafIo<'_>, ctx: &mut Context) {
        self.action.forget(ctx);
    }
}

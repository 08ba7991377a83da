//! Declarations. Has Zenoh dropped what another router declared?
//!
//! Linked routers tell each other what their parts subscribe to and answer. Zenoh 1.10 drops that, for good, if it comes from a router whose
//! place in the net it does not know (<https://github.com/eclipse-zenoh/zenoh/issues/1886>), and tells nobody but its log.

use std::fmt::Debug;

use tokio::sync::Notify;
use tracing::field::{Field, Visit};
use tracing::{Event, Level, Subscriber};
use tracing_subscriber::Layer;
use tracing_subscriber::filter::Targets;
use tracing_subscriber::layer::Context;

/// Where Zenoh's routing between routers logs.
const TARGET: &str = "zenoh::net::routing::hat::router";
/// How its message of a dropped declaration ends; before it, what was declared: a subscriber, a queryable, a token.
const DROPPED: &str = "from unknown router";

static NOTED: Notify = Notify::const_new();

/// Ends once Zenoh has dropped a declaration of another router in this process, also if that was before the call. Never ends without
/// [`logging::init`](crate::logging::init).
pub async fn dropped() {
    NOTED.notified().await;
}

/// What [`NoteDropped`] has to see.
pub(crate) fn filter() -> Targets {
    Targets::new().with_target(TARGET, Level::ERROR)
}

/// Notes dropped declarations, of the events that [`filter`] lets through.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NoteDropped;

impl<S: Subscriber> Layer<S> for NoteDropped {
    fn on_event(&self, event: &Event<'_>, _: Context<'_, S>) {
        let mut is_drop = IsDrop(false);
        event.record(&mut is_drop);
        if is_drop.0 {
            NOTED.notify_one();
        }
    }
}

/// Whether an event's message tells of a dropped declaration.
struct IsDrop(bool);

impl Visit for IsDrop {
    fn record_debug(&mut self, field: &Field, value: &dyn Debug) {
        self.0 |= field.name() == "message" && format!("{value:?}").ends_with(DROPPED);
    }
}

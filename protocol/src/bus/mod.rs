//! How do the parts talk? Typed topics and asks over Zenoh; no other module knows that it is Zenoh.
//!
//! | file | answers |
//! |---|---|
//! | `session` | how a part joins: a client of the router, or (with an endpoint of its own) a router of its own that outlives the others |
//! | `router` | the router itself |
//! | `publish`, `subscribe` | topics: publishers, the newest value, all values in order |
//! | `ask`, `serve` | questions with a deadline, and those who answer |
//! | `serve_part` | all asks of one part, in its core's own type |
//! | `alive` | who is there |
//! | `raw` | bytes, for tools that know no types |
//! | `clock`, `shutdown` | time and the end, the only ones a service gets |
//! | `overhead` | what all this costs over raw Zenoh |
//! | `inbox` | the bounded boxes between Zenoh's threads and ours |
//!
//! No Zenoh callback blocks or decodes: it puts a sample in a bounded box and wakes the reader. What cannot be decoded is
//! counted, logged now and then, and otherwise harmless. Declaring is quick and synchronous, and works from any thread
//! (in a Tokio runtime it must be the multi-threaded one). Every `next` and `changed` may be dropped halfway, as `select!` does:
//! nothing is lost.

mod alive;
mod ask;
mod clock;
mod inbox;
pub mod overhead;
mod publish;
mod raw;
mod router;
mod serve;
mod serve_part;
mod session;
mod shutdown;
mod subscribe;

pub use alive::{AliveToken, AliveWatch};
pub use ask::{Answer, AskError};
pub use clock::{Clock, ClockHandle, Interval};
pub use publish::Publisher;
pub use raw::{RawReply, RawSample, RawSubscription};
pub use router::{Router, RouterConfig};
pub use serve::{Request, Server};
pub use serve_part::{Call, PartServer, Responder};
pub use session::{Bus, BusConfig, BusError};
pub use shutdown::Shutdown;
pub use subscribe::{Latest, Received, Subscription};

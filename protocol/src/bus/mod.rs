//! Bus. How do the components communicate? Typed publish, subscribe and ask over Zenoh.
//!
//! ```
//! # use std::time::Duration;
//! # use zenav_protocol::bus::{Bus, BusConfig, Router, RouterConfig};
//! # use zenav_protocol::messages::{SimClock, StopReply, StopRequest};
//! # use zenav_protocol::time::Stamp;
//! # use zenav_protocol::topics::{SIM_CLOCK, STOP};
//! # #[tokio::main]
//! # async fn main() -> Result<(), Box<dyn std::error::Error>> {
//! // A router on a free port, and two components that join it.
//! let router = Router::open(&RouterConfig { listen: vec!["tcp/127.0.0.1:0".into()], ..RouterConfig::default() }).await?;
//! let endpoint = router.endpoints().await.remove(0);
//! let robot = Bus::open(BusConfig::service("robot", &endpoint)).await?;
//! let cloud = Bus::open(BusConfig::service("cloud", &endpoint)).await?;
//!
//! // Serve and ask.
//! let mut stops = robot.serve(&STOP, &["tiago"])?;
//! tokio::spawn(async move {
//!     while let Some(request) = stops.next().await {
//!         request.reply(&StopReply { stopped: true });
//!     }
//! });
//! let reply = cloud.ask(&STOP, &["tiago"], &StopRequest::default(), Duration::from_secs(10)).await?;
//! assert!(reply.stopped);
//!
//! // Publish and subscribe.
//! let mut clock = cloud.latest(&SIM_CLOCK, &[])?;
//! let publisher = robot.publisher(&SIM_CLOCK, &[])?;
//! while clock.borrow().is_none() {
//!     publisher.put(&SimClock { stamp: Stamp::from_secs(1.0) });
//!     tokio::time::sleep(Duration::from_millis(10)).await;
//! }
//! # Ok(())
//! # }
//! ```
//!
//! | file | subject |
//! |---|---|
//! | `session` | [`Bus`]: a component's session, a client of the router, or a router itself when it listens on an endpoint of its own |
//! | `router` | [`Router`] |
//! | `security` | how links are protected: [`Security`], as a deployment's [`SecuritySection`] says |
//! | `identity`, `access_control` | which member of the fleet a process is: [`Identity`]; what others may do on an endpoint |
//! | `rights` | what this process may do itself: an [`Act`] that would be [`Denied`] |
//! | `publish`, `subscribe` | topics: [`Publisher`], [`Latest`] value, [`Subscription`] to all values in order |
//! | `keyed` | last values on many short-lived keys, from one declaration: [`KeyedPublisher`] |
//! | `repeat` | last numbers, repeated so that a subscriber notices a lost last value |
//! | `ask`, `serve` | requests with a deadline, and the [`Server`] that answers them |
//! | `serve_part` | all asks of one component, as its core's own request type |
//! | `about` | identity of a component, and where it runs |
//! | `alive` | liveliness tokens: which components are present |
//! | `raw` | untyped bytes, for tools |
//! | `tap` | all samples as they arrive, byte for byte with arrival times, for recorders; publishing them again |
//! | `clock`, `shutdown` | the only [`Clock`] of a service, and its [`Shutdown`] |
//! | `threads`, `memory` | Zenoh's threads: how many a process needs; what keeps its memory bounded |
//! | `service_manager` | notifications to the service manager: ready, alive, stopping |
//! | `overhead` | cost of the typed bus over raw Zenoh |
//! | `probe` | whether a router answers at an endpoint, however late |
//! | `link`, `flow` | for the metrics and the log: links to routers; traffic and losses per topic |
//! | `inbox` | bounded queues between Zenoh's threads and the readers |
//! | `rate`, `limiter` | samples that come far faster than the rate of their key |
//!
//! No Zenoh callback blocks, or decodes anything but the simulated time: it puts the sample into a bounded queue and wakes the reader. A payload that cannot be decoded is
//! counted, logged now and then, and otherwise ignored. Declarations are synchronous and work from any thread; inside a Tokio runtime, the
//! runtime must be multi-threaded. Every `next` and `changed` is cancel-safe: a `select!` that drops it loses nothing.

mod about;
mod access_control;
mod alive;
mod ask;
mod clock;
mod flow;
mod identity;
mod inbox;
mod keyed;
mod limiter;
mod link;
mod memory;
pub mod overhead;
mod probe;
mod publish;
mod rate;
mod raw;
mod repeat;
mod rights;
mod router;
mod security;
mod serve;
mod serve_part;
pub mod service_manager;
mod session;
mod shutdown;
mod subscribe;
mod tap;
pub mod threads;

pub use alive::{AliveToken, AliveWatch};
pub use ask::{Answer, AskError};
pub use clock::{Clock, ClockHandle, Interval};
pub use identity::{Identity, IdentityError, MEMBERS};
pub use keyed::KeyedPublisher;
pub use link::SETTLING;
pub use publish::Publisher;
pub use raw::{RawReply, RawSample, RawSubscription};
pub use rights::{Act, Denied};
pub use router::{Router, RouterConfig};
pub use security::{Profile, Security, SecuritySection, link_protocol};
pub use serve::{Request, Server};
pub use serve_part::{Call, PartServer, Responder};
pub use session::{Bus, BusConfig, BusError, DEFAULT_ENDPOINT, ROBOT_ENDPOINT, client_settings};
pub use shutdown::{Shutdown, interrupted};
pub use subscribe::{Latest, Received, Subscription};
pub use tap::{RawPublisher, Tap, Tapped, matches};

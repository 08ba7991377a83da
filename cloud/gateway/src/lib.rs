//! Mission control for mobile robots in a browser: a live map, goals, stop and teleoperation, over HTTP and one WebSocket.
//!
//! # The problem
//!
//! Robots publish tens of messages a second each; browsers come and go, and read as fast as their link and tab allow. Every browser must
//! see the newest state, none may slow down another or the robots, and memory must stay bounded in any case.
//!
//! [`FleetView`] keeps the newest message of each kind for each robot as JSON text, with the number of the change that brought it. A client
//! is a cursor over those numbers: its next frame is everything that changed after the last change it was told of. There are no per-client
//! queues; a slow client skips values.
//!
//! ```
//! use zenav_gateway::{Client, FleetView, Update};
//!
//! let (mut view, mut client) = (FleetView::new(), Client::new());
//! view.take("tiago", Update::Part { component: "edge".into(), alive: true }, 1.0);
//! let told = client.frame(&view, 1.0, true).text.unwrap();
//! assert!(told.contains(r#""tiago":{"parts":{"age":0.000,"data":["edge"]}}"#));
//! assert_eq!(client.frame(&view, 1.1, true).text, None, "nothing is news twice");
//! ```
//!
//! # Where to begin
//!
//! A [`Hub`] is fed with [`Update`]s and served by [`router`]; requests to robots go out through an [`Operator`]. This library does not
//! depend on a bus: in `zenav` the service in `zenav-cloud` feeds it. The example `fleet` feeds it with made-up robots.
//!
//! The gateway is an operator: it submits goals, stops, resumes and drives by hand under a lease. It never writes plans.
//!
//! | file | subject |
//! |---|---|
//! | `settings` | all tunables: [`GatewaySettings`] |
//! | `view` | the latest state of every robot, pure |
//! | `client` | what one browser lacks, pure |
//! | `access`, `hold` | who may use it, and the dead-man's switch, pure |
//! | `hub` | where feed and clients meet |
//! | `operator` | the operations on robots |
//! | `http` | the API under `/api/v1`, its OpenAPI document, the WebSocket |
//! | `page` | the files of the page |

mod access;
mod client;
mod hold;
mod http;
mod hub;
mod operator;
mod page;
mod settings;
mod view;

pub use access::{Access, Denied};
pub use client::{Client, Frame};
pub use hold::{HOLD_SECS, Hold};
pub use http::{listen, router, serve};
pub use hub::Hub;
pub use operator::{Answer, AskFailure, Drive, Operator};
pub use settings::{DEFAULT_LISTEN, GatewaySettings};
pub use view::{FleetView, Update};

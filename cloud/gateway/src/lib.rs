//! Mission control for mobile robots in a browser: a live map, goals, stop and teleoperation, over HTTP and one WebSocket.
//!
//! # The problem
//!
//! Robots publish tens of messages a second each; browsers come and go, and read as fast as their link and their tab allow. Every browser is
//! to see the newest state, none may slow down another or the robots, and memory must be bounded whatever they do.
//!
//! [`FleetView`] keeps the newest message of each kind for each robot as JSON text, with the number of the change that brought it. A client is
//! a cursor over those numbers: its next frame is whatever changed after the change that it was told of last. There is no queue for a client;
//! one that reads slowly skips values.
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
//! A [`Hub`] is fed with [`Update`]s and served by [`router`]; what people want of robots goes out through an [`Operator`]. This library knows
//! no bus: in `zenav` the service in `zenav-cloud` feeds it. The example `fleet` feeds it with robots that it makes up.
//!
//! The gateway is an operator: it submits goals, stops, resumes and drives by hand under a lease. It never writes plans.
//!
//! | file | subject |
//! |---|---|
//! | `settings` | all tunables: [`GatewaySettings`] |
//! | `view` | the latest state of every robot, pure |
//! | `client` | what one browser lacks, pure |
//! | `access`, `rate`, `hold` | who may use it, how often, and the dead man's switch, pure |
//! | `hub` | where feed and clients meet |
//! | `operator` | what may be done to robots |
//! | `http` | the API under `/api/v1`, its OpenAPI document, the WebSocket |
//! | `page` | the files of the page |

mod access;
mod client;
mod hold;
mod http;
mod hub;
mod operator;
mod page;
mod rate;
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

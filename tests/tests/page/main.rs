//! Does the mission-control page do what users expect? In a real browser, against separate processes for router, robot, cloud and gateway.
//! The screenshots stay in `target/tmp/page`.
//!
//! | file | claims |
//! |---|---|
//! | `control` | see, send, stop and hand-drive the robot; the page reports lost parts |
//! | `drawing` | places, zones, the pose and the order of the queue |
//! | `hands` | fingers, keys, screens; a stop while the link is lost |
//! | `panels` | layers, tree, events and plots; Escape during a drag, a page that is lost while it drives, and a gateway's token |
//! | `accessible` | the page is accessible |
//! | `fleet` | twenty robots at 10 Hz; a thousand browsers that do not read |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod accessible;
mod control;
mod drawing;
mod fleet;
mod hands;
mod panels;
mod site;

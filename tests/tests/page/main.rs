//! Does the mission-control page do what a person expects of it? In a real browser, against a router, a robot, a cloud and a gateway that are
//! processes of their own. The screenshots stay in `target/tmp/page`.
//!
//! | file | claims |
//! |---|---|
//! | `control` | the robot is seen, sent, stopped, driven by hand; the page says what is gone |
//! | `drawing` | places, zones, the pose and the order of the queue |
//! | `accessible` | everybody can use it |
//! | `fleet` | twenty robots at 10 Hz; a thousand browsers that do not read |

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]

mod accessible;
mod control;
mod drawing;
mod fleet;
mod site;

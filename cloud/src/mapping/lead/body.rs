//! Body. The robot's outline, by which the mapper clears the cells under it, and its message schema.

use std::time::Duration;

use zenav_protocol::SCHEMA_VERSION;
use zenav_protocol::bus::{AskError, Bus};
use zenav_protocol::messages::{InfoReply, InfoRequest};
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics::EDGE_INFO;

/// Time limit of each request for the robot's footprint.
const FOOTPRINT_DEADLINE: Duration = Duration::from_secs(30);
/// Pause before a robot with another schema is asked again: it may have been replaced.
pub(super) const FOREIGN: Duration = Duration::from_secs(5);

/// The robot's answer about its body.
pub(super) enum Body {
    /// Its outline.
    Known(Footprint),
    /// Another message schema.
    Foreign,
    /// No answer on its outline.
    Unknown,
}

/// Asks for the robot's body, after a delay, until it answers.
pub(super) async fn ask_body(bus: &Bus, robot: &str, after: Duration) -> Body {
    tokio::time::sleep(after).await;
    loop {
        match bus
            .ask(&EDGE_INFO, &[robot], &InfoRequest::default(), FOOTPRINT_DEADLINE)
            .await
        {
            Ok(info) if info.schema != SCHEMA_VERSION => {
                let InfoReply { version, schema, .. } = info;
                tracing::error!(
                    robot,
                    "its scans are not drawn: its edge ({version}) speaks schema {schema}, this mapping ({}) schema {SCHEMA_VERSION}: \
                     expected the same",
                    env!("CARGO_PKG_VERSION")
                );
                return Body::Foreign;
            }
            Ok(info) => return info.model.map_or(Body::Unknown, |model| Body::Known(model.footprint)),
            Err(AskError::Timeout { .. }) => {}
            Err(error) => {
                tracing::warn!(robot, %error, "the robot's footprint is not known: the cells under it are not cleared");
                return Body::Unknown;
            }
        }
    }
}

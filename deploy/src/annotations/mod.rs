//! `zenav place` and `zenav zone`. Show and change the annotations on a running robot's map by asking its mapping service, which stores
//! them and passes them to missions, motion workers and the mission-control page.
//!
//! | file | answers |
//! |---|---|
//! | `place` | named goals: list, add, remove |
//! | `zone` | keep-out and speed zones: list, add, remove, clear |

mod place;
mod zone;

use std::time::Duration;

use zenav_cloud::operator;
use zenav_protocol::bus::Bus;
use zenav_protocol::messages::{AnnotateAction, AnnotateRequest, Annotations};
use zenav_protocol::topics;

pub use place::{PlaceArgs, place};
pub use zone::{ZoneArgs, zone};

use crate::connect::fresh_id;
use crate::failure::Failure;

/// The annotations of a robot's map.
pub(crate) async fn read(bus: &Bus, robot: &str, within: Duration) -> Result<Annotations, Failure> {
    let request = AnnotateRequest::default();
    Ok(bus.ask(&topics::ANNOTATE, &[robot], &request, within).await?)
}

/// Changes the annotations under the lease in force: a moving robot drives on.
async fn change(bus: &Bus, robot: &str, within: Duration, action: AnnotateAction) -> Result<Annotations, Failure> {
    let request_id = Some(fresh_id("annotate"));
    let ask = async |epoch| {
        let request = AnnotateRequest {
            action: action.clone(),
            request_id: request_id.clone(),
            epoch,
        };
        bus.ask(&topics::ANNOTATE, &[robot], &request, within).await
    };
    Ok(operator::in_force(bus, robot, within, ask).await?)
}

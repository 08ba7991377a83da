//! `zenav map load|store|reset|hold|resume|list`. Selects the map that a robot drives by, and switches mapping on and off.

use std::path::Path;

use serde::Serialize;
use zenav_cloud::operator;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GivenMap, MapAction, MapReply, MapRequest, StoredMapInfo};
use zenav_protocol::topics;

use crate::connect::{self, RobotArgs, fresh_id};
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::operator::holder;
use crate::output::{self, Format};

/// A request that does not change the cells the robot drives by.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Mapping {
    /// Insert no more scans.
    Hold,
    /// Insert scans again.
    Resume,
}

/// Printed state of a robot's map after a change.
#[derive(Debug, Serialize)]
struct Changed {
    robot: String,
    id: String,
    revision: u64,
    width: u32,
    height: u32,
    resolution: f64,
    occupied: u64,
    free: u64,
    scans: u64,
    stored: bool,
}

impl Changed {
    fn new(robot: &str, reply: MapReply) -> Self {
        let info = reply.info;
        Self {
            robot: robot.to_owned(),
            id: info.map.id,
            revision: info.map.revision,
            width: info.spec.width,
            height: info.spec.height,
            resolution: info.spec.resolution,
            occupied: info.occupied,
            free: info.free,
            scans: info.scans,
            stored: info.stored,
        }
    }

    fn size(&self) -> String {
        format!(
            "{} x {} cells of {} m, {} occupied, {} free",
            self.width, self.height, self.resolution, self.occupied, self.free
        )
    }
}

fn request(action: MapAction) -> MapRequest {
    MapRequest {
        action,
        request_id: Some(fresh_id("map")),
        ..MapRequest::default()
    }
}

/// Sends a map change and prints its reply: under the lease in force, or for a robot that must be `at_rest` under the operator's own.
fn apply(
    robot: &RobotArgs,
    format: Format,
    request: &MapRequest,
    at_rest: bool,
    said: impl Fn(&str, &Changed) -> String,
) -> Outcome {
    let within = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let ask = async |epoch| {
            let request = MapRequest {
                epoch,
                ..request.clone()
            };
            bus.ask(&topics::MAP, &[&robot], &request, within).await
        };
        let reply = if at_rest {
            operator::at_rest(&bus, &robot, &holder(), within, ask).await
        } else {
            operator::in_force(&bus, &robot, within, ask).await
        }?;
        output::value(format, &Changed::new(&robot, reply), |changed| said(&robot, changed))
    })
}

/// Replaces the robot's map by a file on this machine, or by a stored one of this name.
pub(super) fn load(robot: &RobotArgs, format: Format, source: &str, live: bool) -> Outcome {
    let mut request = MapRequest {
        live,
        ..request(MapAction::Load)
    };
    let path = Path::new(source);
    if path.is_file() {
        let grid = files::map(path)?;
        request.map = Some(GivenMap {
            spec: *grid.spec(),
            values: grid.into_values(),
        });
        let size = serde_json::to_vec(&request).map_err(Failure::failed)?.len();
        if size > topics::MAP.max_bytes {
            return Err(Failure::usage(format!(
                "{source}: {size} bytes on the wire, at most {} may be sent; begin with it instead (`zenav up --map {source}`)",
                topics::MAP.max_bytes
            )));
        }
    } else if Id::new(source).is_ok() {
        request.name = Some(source.to_owned());
    } else {
        return Err(Failure::not_found(format!("{source}: no such map file")));
    }
    apply(robot, format, &request, true, |robot, changed| {
        let state = match live {
            true => "scans are inserted into it".to_owned(),
            false => format!("held: `zenav map resume --robot {robot}` continues mapping"),
        };
        format!("{robot} uses {source}: {} ({state})", changed.size())
    })
}

/// Stores the robot's map in mapping's data folder: as the map for the next start, or under a name.
pub(super) fn store(robot: &RobotArgs, format: Format, name: Option<&str>) -> Outcome {
    let request = MapRequest {
        name: name.map(str::to_owned),
        ..request(MapAction::Save)
    };
    apply(robot, format, &request, false, |robot, changed| {
        let what = match name {
            Some(name) => format!("as {name} (`zenav map load {name} --robot {robot}` brings it back)"),
            None => "the next start begins with it".to_owned(),
        };
        format!("stored the map of {robot}: {}; {what}", changed.size())
    })
}

/// Starts a new map.
pub(super) fn reset(robot: &RobotArgs, format: Format) -> Outcome {
    apply(robot, format, &request(MapAction::Reset), true, |robot, _| {
        format!("{robot} begins a new map (the stored one is kept)")
    })
}

/// Holds the map, or resumes mapping.
pub(super) fn hold_or_resume(robot: &RobotArgs, format: Format, mapping: Mapping) -> Outcome {
    let (action, said) = match mapping {
        Mapping::Hold => (MapAction::Hold, "held: no more scans are inserted"),
        Mapping::Resume => (MapAction::Resume, "live: scans are inserted"),
    };
    apply(robot, format, &request(action), false, |robot, changed| {
        format!("the map of {robot} is {said} ({})", changed.size())
    })
}

/// Lists the maps stored under a name.
pub(super) fn list(robot: &RobotArgs, format: Format) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let request = MapRequest {
            action: MapAction::List,
            ..MapRequest::default()
        };
        let reply = bus.ask(&topics::MAP, &[&robot], &request, patience).await?;
        output::values(format, &reply.stored, table)
    })
}

fn table(stored: &[StoredMapInfo]) -> String {
    let row = |stored: &StoredMapInfo| {
        let map = &stored.map;
        [
            stored.name.clone(),
            map.id.clone(),
            map.revision.to_string(),
            stored.scans.to_string(),
        ]
    };
    output::table(&["NAME", "MAP", "REVISION", "SCANS"], stored.iter().map(row))
}

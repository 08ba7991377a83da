//! `zenav map load|store|reset|hold|resume|list`. Selects the map that a robot drives by, and switches mapping on and off.

use std::path::Path;
use std::time::Duration;

use serde::Serialize;
use zenav_protocol::bus::Bus;
use zenav_protocol::id::Id;
use zenav_protocol::messages::{GivenMap, MapAction, MapReply, MapRequest, StoredMapInfo};
use zenav_protocol::topics;

use crate::connect::{self, RobotArgs, fresh_id};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::operator::change;
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

/// Sends a map change: under the lease in force, or for a robot that must be `at_rest` under the operator's own lease.
async fn send(
    bus: &Bus,
    robot: &str,
    within: Duration,
    request: MapRequest,
    at_rest: bool,
) -> Result<MapReply, Failure> {
    let ask = async |epoch| {
        let request = MapRequest {
            epoch,
            ..request.clone()
        };
        bus.ask(&topics::MAP, &[robot], &request, within).await
    };
    if at_rest {
        change::at_rest(bus, robot, within, ask).await
    } else {
        change::in_force(bus, robot, within, ask).await
    }
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
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let reply = send(&bus, &robot, patience, request.clone(), true).await?;
        output::value(format, &Changed::new(&robot, reply), |changed| {
            let state = match live {
                true => "scans go on into it".to_owned(),
                false => format!("held: `zenav map resume --robot {robot}` maps on"),
            };
            format!("{robot} drives by {source}: {} ({state})", changed.size())
        })?;
        Ok(exit_code::OK)
    })
}

/// Stores the robot's map in mapping's data folder: as the map for the next start, or under a name.
pub(super) fn store(robot: &RobotArgs, format: Format, name: Option<&str>) -> Outcome {
    let request = MapRequest {
        name: name.map(str::to_owned),
        ..request(MapAction::Save)
    };
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let reply = send(&bus, &robot, patience, request.clone(), false).await?;
        output::value(format, &Changed::new(&robot, reply), |changed| {
            let what = match name {
                Some(name) => format!("as {name} (`zenav map load {name} --robot {robot}` brings it back)"),
                None => "the next start begins with it".to_owned(),
            };
            format!("stored the map of {robot}: {}; {what}", changed.size())
        })?;
        Ok(exit_code::OK)
    })
}

/// Starts a new map.
pub(super) fn reset(robot: &RobotArgs, format: Format) -> Outcome {
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let reply = send(&bus, &robot, patience, request(MapAction::Reset), true).await?;
        output::value(format, &Changed::new(&robot, reply), |_| {
            format!("{robot} begins a new map (the stored one is kept)")
        })?;
        Ok(exit_code::OK)
    })
}

/// Holds the map, or resumes mapping.
pub(super) fn hold_or_resume(robot: &RobotArgs, format: Format, mapping: Mapping) -> Outcome {
    let (action, said) = match mapping {
        Mapping::Hold => (MapAction::Hold, "held: no more scans are inserted"),
        Mapping::Resume => (MapAction::Resume, "live: scans are inserted"),
    };
    let patience = robot.link.patience();
    connect::on_robot(robot, async |bus, robot| {
        let reply = send(&bus, &robot, patience, request(action), false).await?;
        output::value(format, &Changed::new(&robot, reply), |changed| {
            format!("the map of {robot} is {said} ({})", changed.size())
        })?;
        Ok(exit_code::OK)
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
        output::values(format, &reply.stored, table)?;
        Ok(exit_code::OK)
    })
}

fn table(stored: &[StoredMapInfo]) -> String {
    let rows: Vec<Vec<String>> = stored
        .iter()
        .map(|map| {
            vec![
                map.name.clone(),
                map.map.id.clone(),
                map.map.revision.to_string(),
                map.scans.to_string(),
            ]
        })
        .collect();
    output::table(&["NAME", "MAP", "REVISION", "SCANS"], &rows)
}

//! Farewell of `zenav up`. What its end loses: the maps that nobody has stored.

use zenav_cloud::mapping::PoseSource;
use zenav_observability::logging::{self, Format};
use zenav_protocol::bus::{Bus, BusError, Latest};
use zenav_protocol::messages::MapInfo;
use zenav_protocol::topics;

use crate::config::Deployment;

/// Follows the maps of a deployment until its end.
pub(crate) struct Farewell {
    robots: Vec<String>,
    maps: Latest<MapInfo>,
    /// Keeps the subscription open.
    _bus: Bus,
}

impl Farewell {
    /// `None` for a deployment that maps nothing, or whose SLAM resumes its session.
    ///
    /// # Errors
    /// The bus is closed.
    pub(crate) fn new(deployment: &Deployment, bus: Bus) -> Result<Option<Self>, BusError> {
        let run = &deployment.mapping.run;
        if !run.enabled || run.poses != PoseSource::Edge {
            return Ok(None);
        }
        Ok(Some(Self {
            robots: deployment.robots.keys().cloned().collect(),
            maps: bus.latest(&topics::MAP_INFO, &["*"])?,
            _bus: bus,
        }))
    }

    /// Tells which maps were not kept.
    pub(crate) fn tell(mut self) {
        let mut maps = Vec::new();
        while let Some(received) = self.maps.take_received() {
            maps.extend(
                received
                    .chunks
                    .into_iter()
                    .next()
                    .map(|robot| (robot, received.message)),
            );
        }
        if logging::format() == Format::Text {
            for line in lines(&self.robots, &maps) {
                crate::output::note(line);
            }
        }
    }
}

fn lines(robots: &[String], maps: &[(String, MapInfo)]) -> Vec<String> {
    let lost = maps
        .iter()
        .filter(|(robot, map)| robots.contains(robot) && !map.stored && !map.spec.is_empty());
    let name = |robot: &str| match robots {
        [_] => String::new(),
        _ => format!(" --robot {robot}"),
    };
    lost.map(|(robot, _)| {
        format!(
            "the map of {robot} is not kept: `zenav map store{}` stores it while the deployment runs",
            name(robot)
        )
    })
    .collect()
}

#[cfg(test)]
mod tests {
    use zenav_protocol::messages::MapRef;
    use zenav_protocol::time::Stamp;

    use super::*;

    fn map(cells: u32, stored: bool) -> MapInfo {
        MapInfo {
            stamp: Stamp::ZERO,
            map: MapRef::default(),
            spec: zenav_fixtures::spec(cells, cells, 0.05),
            free: 0,
            occupied: 0,
            unknown: 0,
            scans: 0,
            stored,
        }
    }

    #[test]
    fn only_maps_that_are_lost_are_told() {
        let robots = ["anna".to_owned(), "bert".to_owned()];
        let maps = [
            ("anna", 8, false),
            ("bert", 8, true),
            ("bert", 0, false),
            ("other", 8, false),
        ];
        let maps = maps.map(|(robot, cells, stored)| (robot.to_owned(), map(cells, stored)));
        assert_eq!(
            lines(&robots, &maps),
            ["the map of anna is not kept: `zenav map store --robot anna` stores it while the deployment runs"]
        );
        assert!(lines(&robots[..1], &maps)[0].contains("`zenav map store` "));
    }
}

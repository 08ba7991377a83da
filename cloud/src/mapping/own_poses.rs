//! Poses by the robot itself. Draws scans from the robot's own estimate, and says whether they agree with the known map.
//!
//! The estimate is not corrected, and the robot drives whatever its scans say: GPS may be right where the building has changed. A scan is
//! compared with the map as it was when it was loaded or stored. What is drawn since has no influence, so a pose error cannot confirm
//! itself.

use zenav_localisation::{Evidence, KnownMap, LocalisationSettings, evidence};
use zenav_mapping::Mapper;
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Health, Localisation, Scan};
use zenav_protocol::time::Stamp;
use zenav_scan_matching::{points, refine};

use super::core::{Posed, Statements};

/// Time between two scans that are compared, s: with `tracking.patience` of them, what passes by contradicts nothing.
const PERIOD: f64 = 0.5;

/// The robot's own poses, beside the known map.
#[derive(Clone, Debug)]
pub(super) struct OwnPoses {
    settings: LocalisationSettings,
    /// `None` without a known map.
    map: Option<KnownMap>,
    health: Health,
    evidence: Evidence,
    /// Compared scans in a row that contradict the map.
    contradictions: u32,
    compared_at: Option<Stamp>,
    statements: Statements,
}

impl OwnPoses {
    /// `map`: the known map, if there is one.
    pub(super) fn new(settings: LocalisationSettings, map: Option<&OccupancyGrid>) -> Self {
        let map = map.filter(|map| !map.spec().is_empty());
        Self {
            map: map.map(|map| KnownMap::new(map, settings.tracking.sigma)),
            settings,
            health: Health::Unchecked,
            evidence: Evidence::default(),
            contradictions: 0,
            compared_at: None,
            statements: Statements::default(),
        }
    }

    /// Takes in a scan of the main lidar.
    pub(super) fn insert(&mut self, mapper: &mut Mapper, scan: &Scan, boot_id: &str) -> Posed {
        let map_from_base = scan.map_from_odom * scan.odom_from_base;
        if !scan.is_sane() || !map_from_base.is_finite() {
            return Posed::only(mapper.insert(scan));
        }
        let is_over = |then: Stamp| scan.stamp < then || scan.stamp.secs_since(then) >= PERIOD;
        if self.compared_at.is_none_or(is_over) {
            self.compared_at = Some(scan.stamp);
            self.compare(scan, map_from_base);
        }
        let report = self.report(scan.stamp, boot_id, map_from_base);
        Posed {
            localisation: self.statements.due(report),
            ..Posed::only(mapper.insert(scan))
        }
    }

    /// The report on a pose, `map_from_base`.
    pub(super) fn report(&self, stamp: Stamp, boot_id: &str, map_from_base: Pose2) -> Localisation {
        Localisation {
            stamp,
            boot_id: boot_id.to_owned(),
            health: self.health.clone(),
            map_from_base,
            agreeing: self.evidence.agreeing,
            through_walls: self.evidence.through_walls,
        }
    }

    pub(super) fn health(&self) -> &Health {
        &self.health
    }

    /// The pose was set: nothing is known of it yet.
    pub(super) fn place(&mut self) {
        self.health = Health::Unchecked;
        self.evidence = Evidence::default();
        (self.contradictions, self.compared_at) = (0, None);
    }

    /// Compares a scan with the known map, at the robot's own pose or close by: that pose is not as exact as a match.
    fn compare(&mut self, scan: &Scan, map_from_base: Pose2) {
        let (Some(map), settings) = (&self.map, &self.settings) else {
            return;
        };
        let tracking = &settings.tracking;
        let seen = points(scan, Pose2::IDENTITY, 0.0, &settings.scan);
        let refined = refine(map.field(), &seen, map_from_base, None, &settings.refine);
        let matched = refined.expected_where_degenerate(map_from_base).pose;
        let is_close = matched.distance(&map_from_base) <= tracking.reach
            && wrap_angle(matched.yaw - map_from_base.yaw).abs() <= tracking.search_turn;
        let pose = if is_close { matched } else { map_from_base };
        let here = evidence(map, scan.base_from_laser.position(), &seen, pose, &settings.evidence);
        self.evidence = here;
        let says_much = here.points >= settings.evidence.least_points as usize;
        // Few beams through walls: what stands in the way, such as people, hides the map and contradicts nothing.
        let contradicts = here.agreeing < settings.evidence.lost_below
            || here.agreeing < tracking.doubtful && here.through_walls > tracking.through_walls;
        if says_much {
            self.contradictions = if contradicts {
                self.contradictions.saturating_add(1)
            } else {
                0
            };
        }
        if !says_much {
            self.health = Health::Unchecked;
        } else if self.contradictions >= tracking.patience {
            self.health = Health::Contradicted;
        } else if !contradicts {
            self.health = Health::Tracking;
        }
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use nalgebra::Point2;
    use zenav_fixtures::{robot, scan, sweep_in_room, walled_room};
    use zenav_mapping::MappingSettings;
    use zenav_protocol::grid::GridSpec;
    use zenav_protocol::messages::MapRef;

    use super::super::core::{MappingCore, PoseSettings};
    use super::*;

    /// Where the robot is.
    const TRUTH: Pose2 = Pose2 {
        x: 0.2,
        y: 0.1,
        yaw: 0.3,
    };

    fn pillars() -> [(Point2<f64>, f64); 3] {
        [(1.4, 0.9, 0.5), (-1.6, 0.6, 0.4), (0.4, -1.3, 0.4)].map(|(x, y, radius)| (Point2::new(x, y), radius))
    }

    /// A stored room of 6 m by 4 m with three pillars.
    fn stored() -> Mapper {
        let spec = GridSpec {
            origin: Point2::new(-3.05, -2.05),
            resolution: 0.05,
            width: 122,
            height: 82,
        };
        let map = walled_room(spec, |at| {
            pillars().iter().any(|(center, radius)| (at - center).norm() < *radius)
        });
        Mapper::with_stored(MappingSettings::default(), MapRef::default(), &map, Vec::new(), 1)
    }

    /// Scans in that room over these seconds, by a robot that believes to be at a pose; the last report on it.
    fn look(core: &mut MappingCore, from: f64, secs: f64, believed: Pose2) -> Localisation {
        let lidar = robot("neato").lidar.unwrap();
        let mut last = None;
        for step in 0..(secs / 0.2) as u32 {
            let sweep = sweep_in_room(&lidar, from + 0.2 * f64::from(step), TRUTH, (3.0, 2.0), &pillars());
            let seen = Scan {
                base_from_laser: lidar.mount,
                ..scan(sweep.stamp.0, believed, sweep.ranges)
            };
            last = core.insert(&seen, "boot").localisation.or(last);
        }
        last.unwrap()
    }

    fn core(mapper: Mapper) -> MappingCore {
        MappingCore::new(mapper, &PoseSettings::default())
    }

    #[test]
    fn a_wrong_pose_in_a_known_map_is_not_called_tracking_and_the_robot_is_not_stopped() {
        for is_live in [false, true] {
            let mut mapper = stored();
            if is_live {
                mapper.resume();
            }
            let mut core = core(mapper);
            assert_eq!(core.health(), Health::Unchecked, "before the first scan");
            let wrong = Pose2::new(1.2, -0.9, 1.87);
            let told = look(&mut core, 10.0, 4.0, wrong);
            assert_eq!((&told.health, told.map_from_base), (&Health::Contradicted, wrong));
            assert!(told.agreeing < 0.6 && told.health.is_trusted(), "{told:?}");
            // What it has drawn there meanwhile confirms nothing.
            assert_eq!(look(&mut core, 14.0, 10.0, wrong).health, Health::Contradicted);
            core.place(TRUTH).unwrap();
            assert_eq!(core.health(), Health::Unchecked);
            let told = look(&mut core, 24.0, 2.0, TRUTH);
            assert_eq!(told.health, Health::Tracking);
            assert!(told.agreeing > 0.9, "{told:?}");
        }
    }

    #[test]
    fn a_pose_as_inexact_as_gps_agrees_with_the_map() {
        let mut core = core(stored());
        let told = look(&mut core, 10.0, 4.0, Pose2::new(0.3, 0.15, 0.32));
        assert_eq!(told.health, Health::Tracking, "{told:?}");
    }

    #[test]
    fn where_nothing_can_be_compared_nothing_is_claimed() {
        let mut core = core(Mapper::new(MappingSettings::default(), "new"));
        assert_eq!(look(&mut core, 10.0, 4.0, TRUTH).health, Health::Unchecked);
        // Once the map is stored, it is known.
        core.mark_stored();
        assert_eq!(look(&mut core, 14.0, 2.0, TRUTH).health, Health::Tracking);
        let wrong = Pose2::new(1.2, -0.9, 1.87);
        assert_eq!(look(&mut core, 16.0, 4.0, wrong).health, Health::Contradicted);
        core.reset("another");
        assert_eq!(look(&mut core, 20.0, 4.0, wrong).health, Health::Unchecked);
    }
}

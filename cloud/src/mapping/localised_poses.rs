//! Poses by localisation. Localises the robot in the map that mapping started with, and corrects its pose.
//!
//! Scans are matched against the map as it was at the start. What is drawn since has no influence, so a pose error cannot confirm itself.
//! Scans are drawn only while the pose is trusted.

use zenav_localisation::{LocalisationSettings, Localiser, Located};
use zenav_mapping::{Insertion, Mapper};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Health, Localisation, Scan};

use super::core::{Measured, Pace, Posed, Statements};

/// Localisation of one robot.
#[derive(Clone, Debug)]
pub(super) struct LocalisedPoses {
    localiser: Localiser,
    boot_id: String,
    /// Correction of that boot's odometry by the last scan of the main lidar; `None` after the pose was set.
    map_from_odom: Option<Pose2>,
    pace: Pace,
    statements: Statements,
}

impl LocalisedPoses {
    pub(super) fn new(settings: LocalisationSettings, map: &OccupancyGrid) -> Self {
        Self {
            localiser: Localiser::new(settings, map),
            boot_id: String::new(),
            map_from_odom: None,
            pace: Pace::default(),
            statements: Statements::default(),
        }
    }

    /// Takes in a scan of the main lidar.
    pub(super) fn insert(&mut self, mapper: &mut Mapper, scan: &Scan, boot_id: &str) -> Posed {
        if self.boot_id != boot_id {
            // The robot was restarted and may stand anywhere.
            if !self.boot_id.is_empty() {
                self.localiser.lose();
            }
            boot_id.clone_into(&mut self.boot_id);
            self.map_from_odom = None;
        }
        let Some(located) = self.localiser.step(scan) else {
            let is_sane = scan.is_sane() && scan.odom_from_base.is_finite();
            return Posed::only(if is_sane {
                Insertion::OutOfOrder
            } else {
                Insertion::NotSane
            });
        };
        self.map_from_odom = Some(located.pose * scan.odom_from_base.inverse());
        let insertion = if located.health.is_trusted() {
            mapper.insert(&self.placed(scan))
        } else {
            Insertion::Held
        };
        Posed {
            insertion,
            measured: self.measured(scan, &located),
            localisation: self.localisation(scan, &located),
        }
    }

    /// The scan at the localised pose.
    pub(super) fn placed(&self, scan: &Scan) -> Scan {
        Scan {
            map_from_odom: self.map_from_odom.unwrap_or(scan.map_from_odom),
            ..scan.clone()
        }
    }

    /// Whether a scan of a further lidar, taken in a boot of the robot, is drawn: only after the main lidar has localised that boot's
    /// odometry, and while the robot is not lost.
    pub(super) fn draws_further(&self, boot_id: &str) -> bool {
        self.map_from_odom.is_some() && self.boot_id == boot_id && self.localiser.health().is_trusted()
    }

    pub(super) fn health(&self) -> &Health {
        self.localiser.health()
    }

    pub(super) fn place(&mut self, map_from_base: Pose2) {
        self.localiser.place(map_from_base);
        self.map_from_odom = None;
        self.pace = Pace::default();
    }

    /// Searches the whole map with the next scan. Returns the report of it.
    pub(super) fn look_everywhere(&mut self) -> Option<Localisation> {
        self.localiser.lose();
        self.statements.amended(self.localiser.health())
    }

    fn measured(&mut self, scan: &Scan, located: &Located) -> Option<Measured> {
        let covariance = located.covariance?;
        if located.is_found_anew {
            self.pace = Pace::default();
        }
        self.pace.is_due(scan.stamp, located.pose).then_some(Measured {
            map_from_base: located.pose,
            covariance,
            is_found_anew: located.is_found_anew,
        })
    }

    /// The health report, if it changed or is due.
    fn localisation(&mut self, scan: &Scan, located: &Located) -> Option<Localisation> {
        self.statements.due(Localisation {
            stamp: scan.stamp,
            boot_id: self.boot_id.clone(),
            health: located.health.clone(),
            map_from_base: located.pose,
            agreeing: located.evidence.agreeing,
            through_walls: located.evidence.through_walls,
        })
    }
}

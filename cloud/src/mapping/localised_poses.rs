//! Poses by localisation. Where is the robot in the map that mapping began with, and what is it told of it?
//!
//! The map to be found in is the one at the start: what is drawn into the map since moves nothing, so that an error of a pose cannot confirm
//! itself. Scans are drawn only while the place is trusted.

use zenav_localisation::{LocalisationSettings, Localiser, Located};
use zenav_mapping::{Insertion, Mapper};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Health, Localisation, Scan};

use super::core::{Measured, Pace, Posed, Statements};

/// Localisation beside a robot.
#[derive(Clone, Debug)]
pub(super) struct LocalisedPoses {
    localiser: Localiser,
    boot_id: String,
    /// The correction of that boot's odometry, by the last scan of the main lidar since the place was told.
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
            // The robot was restarted: it may stand anywhere.
            if !self.boot_id.is_empty() {
                self.localiser.lose();
            }
            boot_id.clone_into(&mut self.boot_id);
            self.map_from_odom = None;
        }
        let Some(located) = self.localiser.step(scan) else {
            return Posed::only(Insertion::NotSane);
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

    /// The scan from where the robot was found.
    pub(super) fn placed(&self, scan: &Scan) -> Scan {
        Scan {
            map_from_odom: self.map_from_odom.unwrap_or(scan.map_from_odom),
            ..scan.clone()
        }
    }

    /// Whether a scan of a further lidar, made in a boot of the robot, is drawn: not before one of the main lidar has said where that boot's
    /// odometry lies, and not while the robot is lost.
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

    pub(super) fn look_everywhere(&mut self) {
        self.localiser.lose();
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

    /// The statement of health, where it changed or is due.
    fn localisation(&mut self, scan: &Scan, located: &Located) -> Option<Localisation> {
        self.statements
            .is_due(scan.stamp, &located.health)
            .then(|| Localisation {
                stamp: scan.stamp,
                boot_id: self.boot_id.clone(),
                health: located.health.clone(),
                map_from_base: located.pose,
                agreeing: located.evidence.agreeing,
                through_walls: located.evidence.through_walls,
            })
    }
}

//! Poses by SLAM. From which poses are a robot's scans drawn, when scans and odometry alone say so, and what is the robot told of it?
//!
//! [`Slam`] gives each scan a pose. A loop closure moves older scans too: the map is then drawn anew beside the old one, some scans with
//! each scan that comes, and takes its place when it is complete. Until then everything stays in the old map: nobody sees half of either.

use zenav_mapping::{Insertion, Mapper};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_slam::{Effects, Slam, SlamSettings};

use super::core::{Measured, Pace, Posed};

/// Scans of the old map that are drawn anew with each new scan.
const REDRAWN_A_STEP: usize = 200;
/// A move of the surroundings that is shorter, m, and turns less, rad, leaves the map as it is.
const SMALLEST_MOVE: (f64, f64) = (0.01, 0.002);

/// The map drawn anew, so far.
#[derive(Clone, Debug)]
struct Redraw {
    mapper: Mapper,
    /// How many scans are in it.
    drawn: usize,
}

/// SLAM beside a robot.
#[derive(Debug)]
pub(super) struct SlamPoses {
    settings: SlamSettings,
    slam: Option<Slam>,
    /// The scans of all nodes, in their order.
    scans: Vec<Scan>,
    redraw: Option<Redraw>,
    /// From the map as it is drawn to the one that is being drawn.
    new_from_drawn: Pose2,
    /// The correction of odometry by the last scan, in the drawn map.
    map_from_odom: Pose2,
    /// The robot's boot that odometry belongs to.
    boot_id: String,
    pace: Pace,
}

impl SlamPoses {
    pub(super) fn new(settings: SlamSettings) -> Self {
        Self {
            settings,
            slam: None,
            scans: Vec::new(),
            redraw: None,
            new_from_drawn: Pose2::IDENTITY,
            map_from_odom: Pose2::IDENTITY,
            boot_id: String::new(),
            pace: Pace::default(),
        }
    }

    /// Begins anew: the next scan is the first.
    pub(super) fn reset(&mut self) {
        *self = Self::new(self.settings);
    }

    /// Takes in a scan of the main lidar.
    pub(super) fn insert(&mut self, mapper: &mut Mapper, scan: &Scan, boot_id: &str) -> Posed {
        if mapper.is_held() {
            return Posed::only(Insertion::Held);
        }
        let slam = self
            .slam
            .get_or_insert_with(|| Slam::beside_a_robot(self.settings, scan.map_from_odom * scan.odom_from_base));
        if self.boot_id != boot_id {
            // The first boot that is heard of is the one that odometry began with.
            if !self.boot_id.is_empty() {
                slam.interrupt();
            }
            boot_id.clone_into(&mut self.boot_id);
        }
        let effects = match slam.step(scan) {
            Ok(effects) => effects,
            Err(error) => {
                tracing::debug!(%error, "scan left out");
                return Posed::only(Insertion::NotSane);
            }
        };
        if effects.is_inserted {
            self.scans.push(scan.clone());
        }
        if let Some(moved) = effects.moved {
            self.surroundings_moved(moved, mapper);
        }
        let pose = self.new_from_drawn.inverse() * effects.pose;
        self.map_from_odom = pose * scan.odom_from_base.inverse();
        let insertion = mapper.insert(&self.placed(scan));
        let was_redrawn = self.draw_on(mapper);
        let measured = self.measured(scan, &effects, was_redrawn);
        Posed {
            measured,
            ..Posed::only(insertion)
        }
    }

    /// The scan from the pose that SLAM gives the robot: those of further lidars, too.
    pub(super) fn placed(&self, scan: &Scan) -> Scan {
        Scan {
            map_from_odom: self.map_from_odom,
            ..scan.clone()
        }
    }

    fn surroundings_moved(&mut self, moved: Pose2, mapper: &Mapper) {
        self.new_from_drawn = moved * self.new_from_drawn;
        let by = self.new_from_drawn;
        if self.redraw.is_some() || by.x.hypot(by.y) > SMALLEST_MOVE.0 || by.yaw.abs() > SMALLEST_MOVE.1 {
            self.redraw = Some(Redraw {
                mapper: mapper.redrawing(),
                drawn: 0,
            });
        }
    }

    /// Draws some more scans anew; true when the new map has just taken the place of the old one.
    fn draw_on(&mut self, mapper: &mut Mapper) -> bool {
        let (Some(redraw), Some(slam)) = (&mut self.redraw, &self.slam) else {
            return false;
        };
        let end = (redraw.drawn + REDRAWN_A_STEP).min(self.scans.len());
        for (scan, pose) in self.scans[redraw.drawn..end]
            .iter()
            .zip(&slam.nodes()[redraw.drawn..end])
        {
            redraw.mapper.insert(&Scan {
                map_from_odom: *pose * scan.odom_from_base.inverse(),
                ..scan.clone()
            });
        }
        redraw.drawn = end;
        if end < self.scans.len() {
            return false;
        }
        if let Some(Redraw { mapper: new, .. }) = self.redraw.take() {
            *mapper = new.succeed(mapper);
        }
        self.map_from_odom = self.new_from_drawn * self.map_from_odom;
        self.new_from_drawn = Pose2::IDENTITY;
        true
    }

    fn measured(&mut self, scan: &Scan, effects: &Effects, was_redrawn: bool) -> Option<Measured> {
        let covariance = effects.covariance?;
        let map_from_base = self.map_from_odom * scan.odom_from_base;
        if was_redrawn {
            self.pace = Pace::default();
        }
        self.pace.is_due(scan.stamp, map_from_base).then_some(Measured {
            map_from_base,
            covariance,
            is_found_anew: false,
        })
    }
}

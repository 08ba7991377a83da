//! Mapping core. Chooses the pose from which a scan is drawn into the map, and the corrections sent to the robot. No network, no clock.

use nalgebra::{Matrix3, Point2};
use serde::{Deserialize, Serialize};
use zenav_localisation::LocalisationSettings;
use zenav_mapping::{Insertion, Mapper};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{
    Correction, Health, Localisation, MOST_MISSED_FRAMES, MapFrame, MapRef, PoseGraph, Refusal, Scan, may_follow,
};
use zenav_protocol::time::Stamp;
use zenav_slam::{SessionError, SlamSettings};

use super::localised_poses::LocalisedPoses;
use super::own_poses::OwnPoses;
use super::slam_poses::SlamPoses;
use super::slam_redraw::Ahead;
use super::slam_session::{Kept, OnDisk, Stored};

/// A correction is sent after this much travel, m, this much turning, rad, or this long at rest, s. Matches at one place share one error:
/// sending them more often would make the robot overconfident.
const PACE: (f64, f64, f64) = (0.2, 0.17, 10.0);
/// Standard deviation of the map itself, m and rad: all matches against it share this error.
const MAP_FLOOR: (f64, f64) = (0.01, 0.003);
/// A pose farther than this outside the map is refused, m: the map would grow all the way there.
const FARTHEST_OUTSIDE: f64 = 30.0;
/// Variance of a pose given by an operator, m² and rad².
const TOLD: [f64; 3] = [0.04, 0.04, 0.02];

/// Source of the poses from which scans are drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PoseSource {
    /// The robot's own estimate, from wheels, gyro, and whatever else it has: GPS, compass.
    #[default]
    Edge,
    /// SLAM from scans and odometry, and GPS and compass if the robot has them; it corrects the robot's estimate.
    Slam,
    /// Localisation in the map that mapping started with; it corrects the robot's estimate.
    Localise,
}

impl std::str::FromStr for PoseSource {
    type Err = String;

    fn from_str(name: &str) -> Result<Self, String> {
        match name {
            "edge" => Ok(Self::Edge),
            "slam" => Ok(Self::Slam),
            "localise" => Ok(Self::Localise),
            _ => Err(format!("`{name}`: expected edge, slam or localise")),
        }
    }
}

/// Source of the poses, with its settings.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseSettings {
    /// Who estimates the poses of the scans.
    pub source: PoseSource,
    /// Settings, if the source is SLAM.
    pub slam: SlamSettings,
    /// Settings, if the source is localisation in a map.
    pub localisation: LocalisationSettings,
}

/// A measured pose of the robot, and its covariance along the map's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Measured {
    pub(super) map_from_base: Pose2,
    pub(super) covariance: Matrix3<f64>,
    /// Found by a search of the whole map: independent of the previous estimate.
    pub(super) is_found_anew: bool,
}

/// Result of a scan from a pose source.
#[derive(Clone, Debug)]
pub(super) struct Posed {
    pub(super) insertion: Insertion,
    pub(super) measured: Option<Measured>,
    pub(super) localisation: Option<Localisation>,
}

impl Posed {
    pub(super) const fn only(insertion: Insertion) -> Self {
        Self {
            insertion,
            measured: None,
            localisation: None,
        }
    }
}

/// When the last correction was sent, and the robot's pose then.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace(Option<(Stamp, Pose2)>);

impl Pace {
    /// Whether a correction is due; it then counts as sent.
    pub(super) fn is_due(&mut self, now: Stamp, map_from_base: Pose2) -> bool {
        let is_due = self.0.is_none_or(|(then, last)| {
            last.distance(&map_from_base) >= PACE.0
                || wrap_angle(map_from_base.yaw - last.yaw).abs() >= PACE.1
                || now.secs_since(then) >= PACE.2
                || now < then
        });
        if is_due {
            self.0 = Some((now, map_from_base));
        }
        is_due
    }

    /// Whether the last correction is at least this old, s; it then counts as sent now.
    pub(super) fn is_older(&mut self, now: Stamp, secs: f64) -> bool {
        let Some((then, last)) = self.0 else { return true };
        let is_older = now.secs_since(then) >= secs;
        if is_older {
            self.0 = Some((now, last));
        }
        is_older
    }
}

/// The health is repeated after this time, s, even if unchanged.
const STATED_AGAIN: f64 = 1.0;

/// The last report on the health.
#[derive(Clone, Debug, Default)]
pub(super) struct Statements(Option<Localisation>);

impl Statements {
    /// The report on a scan, if the health has changed since the last report, or a repetition is due.
    pub(super) fn due(&mut self, report: Localisation) -> Option<Localisation> {
        let is_due = self.0.as_ref().is_none_or(|last| {
            std::mem::discriminant(&last.health) != std::mem::discriminant(&report.health)
                || report.stamp.secs_since(last.stamp) >= STATED_AGAIN
                || report.stamp < last.stamp
        });
        if is_due {
            self.0 = Some(report.clone());
        }
        is_due.then_some(report)
    }

    /// The last report with another health, for a change between two scans. `None` before the first report.
    pub(super) fn amended(&mut self, health: &Health) -> Option<Localisation> {
        let last = self.0.as_mut()?;
        last.health = health.clone();
        Some(last.clone())
    }
}

#[derive(Clone, Debug)]
enum Poses {
    Edge(Box<OwnPoses>),
    Slam(Box<SlamPoses>),
    Localised(Box<LocalisedPoses>),
}

impl Poses {
    /// `map`: what the mapper has drawn.
    fn new(settings: &PoseSettings, mapper: &Mapper, map: &OccupancyGrid) -> Self {
        let localisation = settings.localisation;
        match settings.source {
            PoseSource::Edge => {
                let known = mapper.is_stored().then_some(map);
                Self::Edge(Box::new(OwnPoses::new(localisation, known)))
            }
            PoseSource::Slam => {
                let frame = mapper.map().frame;
                Self::Slam(Box::new(SlamPoses::new(settings.slam, localisation, frame)))
            }
            PoseSource::Localise => Self::Localised(Box::new(LocalisedPoses::new(localisation, map))),
        }
    }
}

/// The map of a robot, and the source of its poses.
#[derive(Clone, Debug)]
pub struct MappingCore {
    /// The map.
    pub mapper: Mapper,
    poses: Poses,
    settings: PoseSettings,
    /// Stamp and boot of the newest scan.
    last: Option<(Stamp, String)>,
    /// The robot's own `map_from_base` at that scan.
    last_pose: Pose2,
    /// The frame that the robot reports.
    robot_frame: u64,
}

/// Result of a scan.
#[derive(Clone, Debug, PartialEq)]
pub struct Mapped {
    /// Whether it was drawn into the map.
    pub insertion: Insertion,
    /// Correction to send to the robot.
    pub correction: Option<Correction>,
    /// Localisation health, if it changed or is due.
    pub localisation: Option<Localisation>,
    /// The frame of the map and the poses of its parts, if they changed. To be published before the map itself.
    pub frame: Option<MapFrame>,
}

impl Mapped {
    /// A scan without any effect.
    fn left_out(why: Insertion) -> Self {
        Self {
            insertion: why,
            correction: None,
            localisation: None,
            frame: None,
        }
    }
}

/// Whether a scan is known to be of another boot than the robot's state: it was on its way while the robot started again, or it came
/// before the first state. Its odometry has another origin.
fn is_of_another_boot(scan: &Scan, boot_id: &str) -> bool {
    !scan.boot_id.is_empty() && !boot_id.is_empty() && scan.boot_id != boot_id
}

impl MappingCore {
    /// A map, and the source of the poses from which scans are drawn into it.
    #[must_use]
    pub fn new(mapper: Mapper, settings: &PoseSettings) -> Self {
        let poses = Poses::new(settings, &mapper, &mapper.grid());
        Self {
            mapper,
            poses,
            settings: *settings,
            last: None,
            last_pose: Pose2::IDENTITY,
            robot_frame: 0,
        }
    }

    /// Resumes a stored SLAM session; its map is drawn into the present, empty one.
    #[must_use]
    pub(super) fn going_on(mut self, stored: Stored) -> Self {
        let PoseSettings { slam, localisation, .. } = self.settings;
        self.poses = Poses::Slam(Box::new(SlamPoses::go_on(slam, localisation, stored, &mut self.mapper)));
        self
    }

    /// Continues in a map that SLAM did not make, as another mapping service did or somebody has loaded it: SLAM starts where the robot is
    /// localised in it, and draws over it.
    pub(super) fn locate_first(&mut self) {
        if let Poses::Slam(slam) = &mut self.poses {
            slam.locate_first(&self.mapper);
        }
    }

    /// Whether SLAM's session is to be stored; with `anyway`, also if anything is new.
    pub(super) fn is_keep_due(&self, anyway: bool) -> bool {
        matches!(&self.poses, Poses::Slam(slam) if slam.is_keep_due(anyway))
    }

    /// The SLAM session to store. One at a time: call again only after [`Self::was_kept`] or [`Self::was_not_kept`].
    pub(super) fn kept(&mut self) -> Result<Option<Kept>, SessionError> {
        match &mut self.poses {
            Poses::Slam(slam) => slam.kept(),
            Poses::Edge(_) | Poses::Localised(_) => Ok(None),
        }
    }

    /// Number of the change that led to the frame in force: the frame is published only once a session of this change or a later one is on
    /// disk.
    pub(super) fn in_force(&self) -> u64 {
        match &self.poses {
            Poses::Slam(slam) => slam.in_force(),
            Poses::Edge(_) | Poses::Localised(_) => 0,
        }
    }

    /// Work for coming scans that began with the last one. Another thread may do it before they arrive; otherwise it is done then.
    pub(super) fn take_ahead(&mut self) -> Vec<Ahead> {
        match &mut self.poses {
            Poses::Slam(slam) => slam.take_ahead(),
            Poses::Edge(_) | Poses::Localised(_) => Vec::new(),
        }
    }

    /// Whether a scan at a stamp needs work that was begun ahead of it and is not done yet.
    pub(super) fn waits_for_ahead(&self, stamp: Stamp) -> bool {
        matches!(&self.poses, Poses::Slam(slam) if slam.waits_for_ahead(stamp))
    }

    /// The session from [`Self::kept`] is on disk.
    pub(super) fn was_kept(&mut self, on_disk: OnDisk) {
        if let Poses::Slam(slam) = &mut self.poses {
            slam.was_kept(on_disk);
        }
    }

    /// The session from [`Self::kept`] could not be stored; `is_changed`: what was stored before has been altered, too.
    pub(super) fn was_not_kept(&mut self, is_changed: bool) {
        if let Poses::Slam(slam) = &mut self.poses {
            slam.was_not_kept(is_changed);
        }
    }

    /// The frame of the map and the poses of its parts, if a session was resumed or the robot was in a later frame.
    pub(super) fn untold_frame(&mut self, stamp: Stamp) -> Option<MapFrame> {
        match &mut self.poses {
            Poses::Slam(slam) => slam.untold(&self.mapper, stamp),
            Poses::Edge(_) | Poses::Localised(_) => None,
        }
    }

    /// Takes the map frame from the robot's newest state. With SLAM, a robot frame later than the map's stems from an earlier run, and the
    /// numbering of frames continues from it. With other sources the map never moves, and it takes the robot's frame.
    pub fn hear_frame(&mut self, robot_frame: u64) {
        // Robot and mission must be able to follow to the frames that come after it.
        if !may_follow(
            robot_frame.saturating_add(MOST_MISSED_FRAMES / 2),
            self.mapper.map().frame,
        ) {
            return;
        }
        self.robot_frame = robot_frame;
        let frame = match &mut self.poses {
            Poses::Slam(_) if robot_frame <= self.mapper.map().frame => return,
            Poses::Slam(slam) => slam.number_from(robot_frame),
            Poses::Edge(_) | Poses::Localised(_) => robot_frame,
        };
        self.mapper.set_frame(frame);
    }

    /// Whether a report on localisation contradicts a robot that localises itself, which drives whatever this service says of its pose.
    pub(super) fn contradicts(&self, told: &Localisation) -> bool {
        matches!(self.poses, Poses::Edge(_)) && !told.health.is_trusted()
    }

    /// The report on a robot that localises itself: it is trusted. `None` for a robot that is localised here.
    pub(super) fn by_the_robot(&self, boot_id: &str) -> Option<Localisation> {
        let stamp = self.last.as_ref().map_or(Stamp::ZERO, |(stamp, _)| *stamp);
        match &self.poses {
            Poses::Edge(own) => Some(own.report(stamp, boot_id, self.last_pose)),
            Poses::Slam(_) | Poses::Localised(_) => None,
        }
    }

    /// Bends SLAM's map as a loop closure does: a node at each pose goes where `bend` says. For tests of the components that follow frames.
    pub fn bend(&mut self, bend: impl Fn(Pose2) -> Pose2) {
        if let Poses::Slam(slam) = &mut self.poses {
            slam.bend(&self.mapper, bend);
        }
    }

    /// Draws a scan of the main lidar, taken in the robot's boot `boot_id`.
    pub fn insert(&mut self, scan: &Scan, boot_id: &str) -> Mapped {
        if is_of_another_boot(scan, boot_id) {
            return Mapped::left_out(Insertion::OutOfOrder);
        }
        self.last = Some((scan.stamp, boot_id.to_owned()));
        self.last_pose = scan.map_from_odom * scan.odom_from_base;
        let posed = match &mut self.poses {
            Poses::Edge(own) => own.insert(&mut self.mapper, scan, boot_id),
            Poses::Slam(slam) => slam.insert(&mut self.mapper, scan, boot_id, self.robot_frame),
            Poses::Localised(localised) => localised.insert(&mut self.mapper, scan, boot_id),
        };
        Mapped {
            insertion: posed.insertion,
            correction: posed
                .measured
                .map(|measured| self.correction(scan.stamp, boot_id, &measured)),
            localisation: posed.localisation,
            frame: match &mut self.poses {
                Poses::Slam(slam) => slam.untold(&self.mapper, scan.stamp),
                Poses::Edge(_) | Poses::Localised(_) => None,
            },
        }
    }

    /// Draws a scan of a further lidar, taken in the robot's boot `boot_id`.
    pub fn insert_further(&mut self, scan: &Scan, boot_id: &str) -> Insertion {
        if is_of_another_boot(scan, boot_id) {
            return Insertion::OutOfOrder;
        }
        match &self.poses {
            Poses::Edge(_) => self.mapper.insert(scan),
            Poses::Slam(slam) if slam.draws_further(boot_id) => self.mapper.insert(&slam.placed(scan)),
            Poses::Localised(localised) if localised.draws_further(boot_id) => {
                self.mapper.insert(&localised.placed(scan))
            }
            Poses::Slam(_) | Poses::Localised(_) => Insertion::Held,
        }
    }

    /// Replaces the map: localisation starts over in it; SLAM starts with the next scan.
    pub fn load(&mut self, map: MapRef, grid: &OccupancyGrid, trajectory: Vec<Point2<f64>>, scans: u64) {
        self.mapper.load(map, grid, trajectory, scans);
        self.poses = Poses::new(&self.settings, &self.mapper, grid);
    }

    /// Notes that the map was stored as the robot's own: scans of a robot that localises itself are compared with it from now on.
    pub fn mark_stored(&mut self) {
        self.mapper.mark_stored();
        if let Poses::Edge(_) = self.poses {
            self.poses = Poses::new(&self.settings, &self.mapper, &self.mapper.grid());
        }
    }

    /// Begins a new map.
    pub fn reset(&mut self, map_id: impl Into<String>) {
        self.mapper.reset(map_id);
        match &mut self.poses {
            Poses::Edge(own) => **own = OwnPoses::new(self.settings.localisation, None),
            Poses::Slam(slam) => slam.reset(),
            Poses::Localised(_) => {}
        }
    }

    /// Sets the robot's pose, `map_from_base` at its last scan. Returns the correction to send to the robot.
    ///
    /// # Errors
    /// [`Refusal::Rejected`] before the first scan, for a place far outside the map, and with SLAM for a place where the scan does not
    /// match.
    pub fn place(&mut self, map_from_base: Pose2) -> Result<Correction, Refusal> {
        let Some((stamp, boot_id)) = self.last.clone() else {
            return Err(Refusal::rejected("the robot has sent no scan yet"));
        };
        let spec = self.mapper.info().spec;
        let off = spec.distance(map_from_base.position());
        if !spec.is_empty() && off > FARTHEST_OUTSIDE {
            return Err(Refusal::rejected(format!(
                "({:.2}, {:.2}) is {off:.1} m outside the map: expected at most {FARTHEST_OUTSIDE} m (`map reset` begins a new map)",
                map_from_base.x, map_from_base.y
            )));
        }
        let map_from_base = match &mut self.poses {
            Poses::Edge(own) => {
                own.place();
                map_from_base
            }
            Poses::Slam(slam) => slam.place(&self.mapper, map_from_base)?,
            Poses::Localised(localised) => {
                localised.place(map_from_base);
                map_from_base
            }
        };
        let measured = Measured {
            map_from_base,
            covariance: Matrix3::from_diagonal(&TOLD.into()),
            is_found_anew: true,
        };
        Ok(self.correction(stamp, &boot_id, &measured))
    }

    /// Starts a search of the whole map for the robot. Returns the report that it is being searched for, if it was reported on before.
    ///
    /// # Errors
    /// [`Refusal::Rejected`] if scans are drawn from the robot's own pose.
    pub fn look_everywhere(&mut self) -> Result<Option<Localisation>, Refusal> {
        match &mut self.poses {
            Poses::Localised(localised) => Ok(localised.look_everywhere()),
            Poses::Slam(slam) => Ok(slam.look_everywhere_next()),
            Poses::Edge(_) => Err(Refusal::rejected(
                "nothing looks for the robot: expected `mapping.poses = \"localise\"` or `\"slam\"`",
            )),
        }
    }

    /// SLAM's pose graph, if it differs from the one returned last or `anyway`, and the map is not about to move.
    pub(super) fn untold_graph(&mut self, anyway: bool) -> Option<PoseGraph> {
        match &mut self.poses {
            Poses::Slam(slam) => slam.untold_graph(&self.mapper, anyway),
            Poses::Edge(_) | Poses::Localised(_) => None,
        }
    }

    /// Whether the robot's pose is trusted.
    #[must_use]
    pub fn health(&self) -> Health {
        match &self.poses {
            Poses::Edge(own) => own.health().clone(),
            Poses::Slam(slam) => slam.health().clone(),
            Poses::Localised(localised) => localised.health().clone(),
        }
    }

    fn correction(&self, stamp: Stamp, boot_id: &str, measured: &Measured) -> Correction {
        let (way, turn) = MAP_FLOOR;
        let floor = Matrix3::from_diagonal(&[way * way, way * way, turn * turn].into());
        let covariance = measured.covariance + floor;
        let (frame, moves, is_too_old) = match &self.poses {
            Poses::Slam(slam) => slam.frame(self.robot_frame),
            // These maps do not move: the robot stays in its frame.
            Poses::Edge(_) | Poses::Localised(_) => (self.robot_frame, Vec::new(), false),
        };
        Correction {
            stamp,
            boot_id: boot_id.to_owned(),
            map_from_base: measured.map_from_base,
            covariance: std::array::from_fn(|index| covariance[(index / 3, index % 3)]),
            is_found_anew: measured.is_found_anew || is_too_old,
            frame,
            moves,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_correction_is_due_after_travel_or_a_turn_or_at_rest_after_a_while_and_counts_from_the_last_one_sent() {
        let sent = Pose2::new(3.0, -1.0, 3.1);
        let at = |secs: f64| Stamp::from_secs(100.0 + secs);
        for (secs, x, yaw, is_due) in [
            (0.1, 0.0, 0.0, false),
            (1.0, 0.19, 0.16, false),
            (1.0, 0.21, 0.0, true),
            (1.0, -0.21, 0.0, true),
            // Across the half turn.
            (1.0, 0.0, 0.18, true),
            (1.0, 0.0, -0.18, true),
            (9.9, 0.0, 0.0, false),
            (10.1, 0.0, 0.0, true),
            // The robot's clock has restarted.
            (-50.0, 0.0, 0.0, true),
        ] {
            let mut pace = Pace::default();
            assert!(pace.is_due(at(0.0), sent), "the first one");
            let here = Pose2::new(sent.x + x, sent.y, wrap_angle(sent.yaw + yaw));
            assert_eq!(pace.is_due(at(secs), here), is_due, "{secs} s, {x} m, {yaw} rad");
            assert!(
                !pace.is_due(at(secs), here),
                "{secs} s, {x} m, {yaw} rad: it was just sent, or is still not due"
            );
        }
    }

    #[test]
    fn of_the_scans_every_6_cm_each_fourth_gives_a_correction() {
        let mut pace = Pace::default();
        let is_due = |index: &u32| {
            let x = 0.06 * f64::from(*index);
            pace.is_due(Stamp::from_secs(2.0 * x), Pose2::new(x, 0.0, 0.0))
        };
        let due: Vec<u32> = (0..17).filter(is_due).collect();
        assert_eq!(due, [0, 4, 8, 12, 16]);
    }

    #[test]
    fn a_robot_that_is_told_again_is_told_after_a_time_though_it_stands() {
        let (mut pace, at) = (Pace::default(), Stamp::from_secs);
        assert!(pace.is_older(at(1.0), 0.3), "nothing was sent yet");
        assert!(pace.is_due(at(1.0), Pose2::IDENTITY));
        let due: Vec<bool> = [1.1, 1.29, 1.31, 1.5, 1.62]
            .map(|secs| pace.is_older(at(secs), 0.3))
            .into();
        assert_eq!(due, [false, false, true, false, true]);
        assert!(!pace.is_due(at(11.0), Pose2::IDENTITY), "10 s count from then");
    }
}

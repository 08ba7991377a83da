//! Poses by SLAM. Poses for drawing a robot's scans, independent of its own estimate, and corrections for the robot.
//!
//! [`Slam`] gives each scan a pose. A loop closure moves older scans too. The map is then redrawn beside the old one
//! ([`slam_redraw`](super::slam_redraw)), and replaces it when complete. Until then everything stays in the old map, so no half-drawn map is
//! published. The new map starts the next **frame**: the robot is sent the move of its surroundings, everybody else the new pose of each
//! part of the map. A successor of this process resumes the [stored session](SlamPoses::kept) in the same frame.

use std::collections::VecDeque;
use std::sync::Arc;

use zenav_localisation::LocalisationSettings;
use zenav_mapping::store::StoredMap;
use zenav_mapping::{Insertion, Mapper};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::messages::{
    GraphCertificate, Health, Localisation, MOST_MOVES, MapFrame, PoseGraph, Refusal, Scan,
};
use zenav_protocol::time::Stamp;
use zenav_slam::{Effects, SessionError, Slam, SlamError, SlamSettings};

use super::annotations::Carried;
use super::core::{Measured, Pace, Posed, Statements};
use super::localised_poses::LocalisedPoses;
use super::slam_redraw::{Ahead, Redraw};
use super::slam_search::{Search, Whereabouts};
use super::slam_session::{Head, Kept, OnDisk, Stored};

/// A shorter move of the surroundings, m, with less turn, rad, leaves the map as it is.
const SMALLEST_MOVE: (f64, f64) = (0.01, 0.002);

/// A robot that has not adopted the frame in force is sent it again after this time, s.
const TOLD_AGAIN: f64 = 0.3;
/// Way by odometry since the last match, m, after which the scans determine nothing.
const UNMATCHED: f64 = 0.5;
/// The session is stored after this many new nodes. A robot that was restarted meanwhile is searched for within the distance of as many
/// nodes.
const KEPT_AFTER: u32 = 20;

/// SLAM for one robot.
#[derive(Clone, Debug)]
pub(super) struct SlamPoses {
    settings: SlamSettings,
    slam: Option<Slam>,
    /// The scans of all nodes, in node order.
    scans: Vec<Arc<Scan>>,
    redraw: Option<Redraw>,
    /// Work that began with the last scan and may be done before the next ones.
    ahead: Vec<Ahead>,
    /// Transform from the drawn map to the map being drawn.
    new_from_drawn: Pose2,
    /// Correction of odometry by the last scan, in the drawn map.
    map_from_odom: Pose2,
    /// The robot's boot that odometry belongs to.
    boot_id: String,
    /// Whether the robot was restarted or lost, and its new pose has not been sent yet.
    is_astray: bool,
    /// Whether nothing ties the robot to its old place: it was restarted or carried, or a search was requested, and no scan has fitted since.
    is_uprooted: bool,
    /// Searches the whole map for the robot.
    search: Search,
    /// Localises the robot in the map while the map is held.
    held: Option<Box<LocalisedPoses>>,
    /// The map that SLAM began in and did not make: the copy of another mapping service's, or one that was loaded. Closures do not move it.
    base: Option<Box<Mapper>>,
    /// The last scan of the main lidar, if it was sane.
    last: Option<Scan>,
    /// Whether that scan contradicts the map.
    contradicts: bool,
    /// Odometry at the last scan that matched the map; `None` before the first one of a boot.
    matched_at: Option<Pose2>,
    /// How many nodes the robot may have driven after the last store, before the previous process ended.
    unseen: u32,
    pace: Pace,
    /// The frame of the map as it is drawn.
    frame: u64,
    /// The moves into the last frames, newest last.
    moves: VecDeque<Pose2>,
    /// Poses of the map's parts in the drawn map.
    parts: Vec<Pose2>,
    /// Whether frame or parts differ from the last published ones.
    is_untold: bool,
    /// Whether the pose graph differs from the last published one.
    is_graph_untold: bool,
    /// The certificate last published.
    told_certificate: GraphCertificate,
    /// Number of redraws begun and of renumberings.
    changes: u64,
    /// The change that led to the frame in force.
    in_force: u64,
    /// What is on disk.
    on_disk: OnDisk,
    /// Number of scans handed out for storing.
    handed: usize,
    /// Whether the session must be stored again: the last attempt failed, a redraw has begun, or it was of an older frame or another map.
    is_overdue: bool,
    health: Health,
    statements: Statements,
}

/// A stored map as one to draw over, with the settings of `mapper`.
fn below(mapper: &Mapper, stored: &StoredMap) -> Mapper {
    let mut below = mapper.redrawing();
    below.load(stored.record.map.clone(), &stored.grid, Vec::new(), 0);
    below.restore_touched(&stored.record.touched);
    below
}

impl SlamPoses {
    /// Starts a map in a frame.
    pub(super) fn new(settings: SlamSettings, localisation: LocalisationSettings, frame: u64) -> Self {
        Self {
            frame,
            moves: VecDeque::new(),
            parts: Vec::new(),
            is_untold: true,
            is_graph_untold: true,
            told_certificate: GraphCertificate::NotSolved,
            changes: 0,
            in_force: 0,
            settings,
            slam: None,
            scans: Vec::new(),
            redraw: None,
            ahead: Vec::new(),
            new_from_drawn: Pose2::IDENTITY,
            map_from_odom: Pose2::IDENTITY,
            boot_id: String::new(),
            is_astray: false,
            is_uprooted: false,
            search: Search::new(localisation),
            held: None,
            base: None,
            last: None,
            contradicts: false,
            matched_at: None,
            unseen: 0,
            pace: Pace::default(),
            on_disk: OnDisk::default(),
            handed: 0,
            is_overdue: true,
            health: Health::Tracking,
            statements: Statements::default(),
        }
    }

    /// Resumes a stored session and draws its map into an empty one. If a closure had moved the map before it was redrawn, the next frame
    /// begins.
    pub(super) fn go_on(
        settings: SlamSettings,
        localisation: LocalisationSettings,
        stored: Stored,
        mapper: &mut Mapper,
    ) -> Self {
        let Stored {
            head,
            slam,
            scans,
            base,
            on_disk,
        } = stored;
        let base = base.map(|base| Box::new(below(mapper, &base)));
        let slam = if *slam.settings() == settings {
            slam
        } else {
            tracing::warn!(
                "SLAM goes on with other settings than its session was begun with: they hold for the scans to come"
            );
            slam.with_settings(settings)
        };
        let mut poses = Self {
            parts: slam.parts(),
            moves: head.moves.into(),
            // The map is redrawn before the first scan.
            map_from_odom: head.new_from_drawn * head.map_from_odom,
            is_astray: slam.is_lost(),
            // A lost robot is searched for with the first scan.
            health: if slam.is_lost() {
                Health::Searching
            } else {
                Health::Tracking
            },
            new_from_drawn: head.new_from_drawn,
            boot_id: head.boot_id,
            unseen: KEPT_AFTER,
            on_disk,
            handed: scans.len(),
            is_overdue: false,
            scans: scans.into_iter().map(Arc::new).collect(),
            base,
            ..Self::new(settings, localisation, head.frame)
        };
        mapper.set_frame(head.frame);
        let redraw = Redraw::begin(mapper, poses.base.as_deref(), &slam, &poses.scans, Stamp::ZERO);
        poses.redraw = Some(redraw);
        poses.slam = Some(slam);
        let is_moved = poses.new_from_drawn != Pose2::IDENTITY;
        poses.swap(mapper);
        if is_moved {
            poses.begin_frame(mapper);
        }
        poses
    }

    /// Whether the session is to be stored; with `anyway`, also if anything is new.
    pub(super) fn is_keep_due(&self, anyway: bool) -> bool {
        let new = self.scans.len() - self.handed;
        self.slam.is_some() && (self.is_overdue || new >= KEPT_AFTER as usize || anyway && new > 0)
    }

    /// The session to store. Nothing more is handed out until it [was kept](Self::was_kept), or was not.
    pub(super) fn kept(&mut self) -> Result<Option<Kept>, SessionError> {
        let Some(slam) = &self.slam else { return Ok(None) };
        let session = slam.snapshot()?;
        self.handed = self.scans.len();
        self.is_overdue = false;
        Ok(Some(Kept {
            head: Head {
                frame: self.frame,
                moves: self.moves.iter().copied().collect(),
                new_from_drawn: self.new_from_drawn,
                map_from_odom: self.map_from_odom,
                boot_id: self.boot_id.clone(),
                scans: self.scans.len(),
                parts: self.parts.clone(),
                // Added by the service.
                annotations: Carried::default(),
                base: self
                    .base
                    .as_ref()
                    .map_or_else(String::new, |base| base.map().id.clone()),
            },
            session,
            change: self.changes,
            on_disk: self.on_disk,
            scans: self.scans[self.on_disk.scans..].to_vec(),
            base: self
                .base
                .as_ref()
                .filter(|_| !self.on_disk.has_base)
                .map(|base| base.snapshot()),
        }))
    }

    /// Starts where the robot is localised in the present map, which SLAM did not make and which stays below what is drawn.
    pub(super) fn locate_first(&mut self, mapper: &Mapper) {
        self.held = Some(Box::new(LocalisedPoses::new(*self.search.settings(), &mapper.grid())));
        self.base = Some(Box::new(mapper.clone()));
    }

    /// Starts over: the next scan is the first.
    pub(super) fn reset(&mut self) {
        *self = Self::new(self.settings, *self.search.settings(), self.frame);
    }

    /// Takes in a scan of the main lidar. Without the robot's boot id, the scan's odometry cannot be attributed: the scan is left out. In a
    /// held map the robot is localised; SLAM continues from there.
    pub(super) fn insert(&mut self, mapper: &mut Mapper, scan: &Scan, boot_id: &str, robot_frame: u64) -> Posed {
        self.last = scan.is_sane().then(|| scan.clone());
        self.ahead.clear();
        if self.last.is_none() {
            return Posed::only(Insertion::NotSane);
        }
        if boot_id.is_empty() || mapper.is_held() && mapper.info().spec.is_empty() {
            return Posed::only(Insertion::Held);
        }
        if mapper.is_held() || self.slam.is_none() && self.is_followed_in_vain(boot_id) {
            return self.follow(mapper, scan, boot_id);
        }
        let gone_on = self.go_on_after_hold(mapper, scan, boot_id);
        let effects = match gone_on.map_or_else(|| self.step(mapper, scan, boot_id), Ok) {
            Ok(effects) => effects,
            Err(left_out) => return Posed::only(left_out),
        };
        self.contradicts = effects.contradicts;
        let insertion = if self.health.is_trusted() && !self.contradicts {
            mapper.insert(&self.placed(scan))
        } else {
            Insertion::Held
        };
        let was_redrawn = self.replace_map(mapper, scan.stamp);
        Posed {
            insertion,
            measured: self.measured(scan, &effects, was_redrawn, robot_frame),
            localisation: self.localisation(scan, &effects),
        }
    }

    /// Whether the robot is not localised in a held map that SLAM did not make: SLAM cannot start there.
    fn is_followed_in_vain(&self, boot_id: &str) -> bool {
        let held = self.held.as_ref();
        held.is_some_and(|held| !held.draws_further(boot_id))
    }

    /// Localises the robot in a held map, starting from SLAM's pose.
    fn follow(&mut self, mapper: &mut Mapper, scan: &Scan, boot_id: &str) -> Posed {
        let is_ours = self.slam.is_some() && self.boot_id == boot_id;
        let scan = if is_ours { &self.placed(scan) } else { scan };
        let held = self.held.get_or_insert_with(|| {
            let mut held = LocalisedPoses::new(*self.search.settings(), &mapper.grid());
            if !self.health.is_trusted() {
                held.look_everywhere();
            }
            Box::new(held)
        });
        held.insert(mapper, scan, boot_id)
    }

    /// Continues where the robot was localised while the map was held, or starts there in a map that SLAM did not make.
    fn go_on_after_hold(&mut self, mapper: &Mapper, scan: &Scan, boot_id: &str) -> Option<Effects> {
        let held = self.held.take()?;
        let place = held.placed(scan).map_from_odom * scan.odom_from_base;
        let is_known = held.draws_further(boot_id);
        let Some(slam) = &mut self.slam else {
            self.slam = Some(Slam::beside_a_robot(self.settings, place));
            return None;
        };
        let is_same_boot = self.boot_id == boot_id;
        if !is_known && is_same_boot {
            slam.lose();
            self.search.ask();
            (self.health, self.is_astray) = (self.search.health(), true);
        }
        // Where odometry leads to the same place, SLAM continues by itself.
        let by_odometry = self.map_from_odom * scan.odom_from_base;
        if !is_known || is_same_boot && self.search.is_one_place(by_odometry, place) {
            return None;
        }
        let effects = self.go_on_at(mapper, place, scan)?;
        boot_id.clone_into(&mut self.boot_id);
        Some(effects)
    }

    /// A step of SLAM, and a search of the whole map if due; or why SLAM leaves the scan out.
    fn step(&mut self, mapper: &Mapper, scan: &Scan, boot_id: &str) -> Result<Effects, Insertion> {
        let slam = self
            .slam
            .get_or_insert_with(|| Slam::beside_a_robot(self.settings, scan.map_from_odom * scan.odom_from_base));
        if self.boot_id != boot_id {
            // The first known boot is the one whose odometry the map began with.
            if !self.boot_id.is_empty() {
                slam.interrupt(self.unseen);
                (self.is_astray, self.is_uprooted) = (true, true);
            }
            boot_id.clone_into(&mut self.boot_id);
            self.matched_at = None;
        }
        self.unseen = 0;
        let effects = match slam.step(scan) {
            Ok(effects) => effects,
            Err(error) => {
                tracing::debug!(%error, "scan left out");
                return Err(match error {
                    SlamError::Order(_) => Insertion::OutOfOrder,
                    SlamError::Scan(_) | SlamError::Graph(_) | SlamError::Solve(_) => Insertion::NotSane,
                });
            }
        };
        let fits = effects.score.is_some() || effects.points == 0;
        let is_due = self.search.is_due(slam.is_lost(), fits, scan.stamp);
        self.take_in(mapper, scan, &effects);
        let found = if is_due {
            self.look_everywhere(mapper, scan, effects.contradicts)
        } else {
            None
        };
        Ok(found.unwrap_or(effects))
    }

    /// Takes in the effects of a scan.
    fn take_in(&mut self, mapper: &Mapper, scan: &Scan, effects: &Effects) {
        let Some(slam) = &self.slam else { return };
        if effects.is_inserted {
            self.scans.push(Arc::new(scan.clone()));
        }
        if let Some(solve) = slam.last_solve().filter(|_| effects.begins_solve) {
            self.ahead.push(Ahead::Solve(Arc::clone(solve)));
        }
        self.is_graph_untold |= effects.is_inserted;
        // Pose, in the redraw, of parts added since it began.
        if let Some(redraw) = &mut self.redraw
            && redraw.parts.len() < slam.submaps()
        {
            let new = slam.parts().into_iter().skip(redraw.parts.len());
            redraw.parts.extend(new);
        }
        if let Some(moved) = effects.moved {
            self.surroundings_moved(moved, mapper);
        }
        self.note_new_parts();
        let pose = self.new_from_drawn.inverse() * effects.pose;
        self.map_from_odom = pose * scan.odom_from_base.inverse();
        if effects.score.is_some() || self.matched_at.is_none() {
            self.matched_at = Some(scan.odom_from_base);
        }
        self.judge(scan, effects);
    }

    /// Searches the whole map for the robot, and continues at the pose found if that is another place.
    fn look_everywhere(&mut self, mapper: &Mapper, scan: &Scan, contradicts: bool) -> Option<Effects> {
        let here = self.map_from_odom * scan.odom_from_base;
        let is_lost = !self.health.is_trusted();
        let found = match self.search.find(mapper, scan, here, is_lost) {
            Whereabouts::Elsewhere(place) => self.go_on_at(mapper, place, scan),
            Whereabouts::Here => {
                let may_be_changed = (is_lost || contradicts) && !self.is_uprooted;
                if let Some(slam) = self.slam.as_mut().filter(|_| may_be_changed) {
                    slam.accept_change();
                }
                None
            }
            Whereabouts::Unknown => None,
        };
        if is_lost && found.is_none() {
            self.health = self.search.health();
        }
        found
    }

    /// Continues where the robot was carried to, `map_from_base` at a scan in the drawn map, if the scan agrees.
    fn go_on_at(&mut self, mapper: &Mapper, map_from_base: Pose2, scan: &Scan) -> Option<Effects> {
        let slam = self.slam.as_ref()?;
        // Until the redraw, each part of the map has its own move.
        let parts = self.parts.iter().zip(slam.parts());
        let nearest = parts.min_by(|(a, _), (b, _)| a.distance(&map_from_base).total_cmp(&b.distance(&map_from_base)));
        let new_from_drawn = nearest.map_or(self.new_from_drawn, |(drawn, new)| new * drawn.inverse());
        let (slam, effects) = match slam.go_on_at(new_from_drawn * map_from_base, scan) {
            Ok(gone_on) => gone_on?,
            Err(error) => {
                tracing::debug!(%error, "scan left out");
                return None;
            }
        };
        self.slam = Some(slam);
        self.new_from_drawn = new_from_drawn;
        self.is_astray = true;
        self.take_in(mapper, scan, &effects);
        Some(effects)
    }

    /// Sets the robot's pose, `map_from_base` at its last scan. Returns its pose there by that scan.
    ///
    /// # Errors
    /// [`Refusal::Rejected`] where the scan does not agree: no map is drawn from a pose that only an operator vouches for.
    pub(super) fn place(&mut self, mapper: &Mapper, map_from_base: Pose2) -> Result<Pose2, Refusal> {
        if let Some(held) = &mut self.held {
            held.place(map_from_base);
            return Ok(map_from_base);
        }
        let Some(scan) = self.last.clone() else {
            return Err(Refusal::rejected("the robot has sent no scan yet"));
        };
        if self.go_on_at(mapper, map_from_base, &scan).is_none() {
            let here = self.map_from_odom * scan.odom_from_base;
            let Some(slam) = self
                .slam
                .as_mut()
                .filter(|_| self.search.is_one_place(here, map_from_base))
            else {
                return Err(Refusal::rejected(format!(
                    "({:.2}, {:.2}): expected where SLAM holds the robot to be, ({:.2}, {:.2}), or a place within 1 m and 0.5 rad of which its last scan agrees \
                     with the map",
                    map_from_base.x, map_from_base.y, here.x, here.y
                )));
            };
            slam.accept_change();
        }
        Ok(self.map_from_odom * scan.odom_from_base)
    }

    /// Searches the whole map with the next scan, however well the last one fits; until then the robot's pose is not trusted.
    /// Returns the report of it.
    pub(super) fn look_everywhere_next(&mut self) -> Option<Localisation> {
        if let Some(held) = &mut self.held {
            return held.look_everywhere();
        }
        self.search.ask();
        self.slam.as_mut()?.lose();
        (self.health, self.is_astray) = (self.search.health(), true);
        self.is_uprooted = true;
        self.statements.amended(&self.health)
    }

    /// Whether the last pose can be trusted.
    pub(super) fn health(&self) -> &Health {
        self.held.as_ref().map_or(&self.health, |held| held.health())
    }

    /// Derives the health from a scan. While scans see little, odometry alone counts, and after a while the position is open in all
    /// directions, first of all along the robot's way.
    fn judge(&mut self, scan: &Scan, effects: &Effects) {
        let is_lost = self.slam.as_ref().is_some_and(Slam::is_lost);
        self.is_astray |= is_lost;
        self.is_uprooted &= !effects.fits;
        self.is_uprooted |= self.slam.as_ref().is_some_and(Slam::was_carried);
        // A successor of this process must know the loss, too.
        self.is_overdue |= is_lost == self.health.is_trusted();
        self.health = match effects.degenerate {
            _ if is_lost => self.search.health(),
            Some(direction) => Health::Degraded {
                direction: direction - self.new_from_drawn.yaw,
            },
            None if self.is_unmatched(scan) => Health::Degraded {
                direction: (self.map_from_odom * scan.odom_from_base).yaw,
            },
            None => Health::Tracking,
        };
    }

    /// Whether odometry alone has led here for a while.
    fn is_unmatched(&self, scan: &Scan) -> bool {
        let at = self.matched_at.as_ref();
        at.is_some_and(|at| at.distance(&scan.odom_from_base) > UNMATCHED)
    }

    /// The health report, if it changed or is due.
    fn localisation(&mut self, scan: &Scan, effects: &Effects) -> Option<Localisation> {
        self.statements.due(Localisation {
            stamp: scan.stamp,
            boot_id: self.boot_id.clone(),
            health: self.health.clone(),
            map_from_base: self.map_from_odom * scan.odom_from_base,
            agreeing: effects.score.unwrap_or(0.0),
            through_walls: 0.0,
        })
    }

    /// Whether a scan of a further lidar, taken in a boot of the robot, is drawn: only after the main lidar has localised that boot's
    /// odometry, and while the robot is neither lost nor possibly elsewhere.
    pub(super) fn draws_further(&self, boot_id: &str) -> bool {
        self.slam.is_some() && self.boot_id == boot_id && self.health.is_trusted() && !self.contradicts
    }

    /// The scan at SLAM's pose of the robot; also for further lidars.
    pub(super) fn placed(&self, scan: &Scan) -> Scan {
        Scan {
            map_from_odom: self.map_from_odom,
            ..scan.clone()
        }
    }

    /// The frame in force, its moves, and whether the robot's `robot_frame` is too old for these moves to lead from it to the frame in
    /// force.
    pub(super) fn frame(&self, robot_frame: u64) -> (u64, Vec<Pose2>, bool) {
        let is_too_old = robot_frame + (self.moves.len() as u64) < self.frame;
        (self.frame, self.moves.iter().copied().collect(), is_too_old)
    }

    /// Renumbers frames for a robot in a later frame than any begun here. A map without scans takes the robot's frame. A map in progress is
    /// not the robot's: it takes the next frame, and no move leads into it. Returns the frame.
    pub(super) fn number_from(&mut self, robot_frame: u64) -> u64 {
        self.frame = robot_frame + u64::from(self.slam.is_some());
        self.moves.clear();
        self.changes += 1;
        self.in_force = self.changes;
        (self.is_untold, self.is_graph_untold) = (true, true);
        self.is_overdue = true;
        self.frame
    }

    /// The change that led to the frame in force: a successor of this process continues in it if the stored session is of this change or a
    /// later one.
    pub(super) fn in_force(&self) -> u64 {
        self.in_force
    }

    /// Whether a scan at a stamp needs work that was begun ahead of it and is not done yet.
    pub(super) fn waits_for_ahead(&self, stamp: Stamp) -> bool {
        let (slam, redraw) = (self.slam.as_ref(), self.redraw.as_ref());
        redraw.is_some_and(|redraw| redraw.is_late(stamp))
            || slam.is_some_and(|slam| slam.waits_for_solve(stamp.as_secs()))
    }

    /// Work that began with the last scan and may be done before the next ones.
    pub(super) fn take_ahead(&mut self) -> Vec<Ahead> {
        std::mem::take(&mut self.ahead)
    }

    /// The session handed out last is on disk.
    pub(super) fn was_kept(&mut self, on_disk: OnDisk) {
        self.on_disk = on_disk;
    }

    /// Storing the session handed out last failed: the next attempt includes it. `is_changed`: the file no longer holds what was written
    /// before, so everything is written again.
    pub(super) fn was_not_kept(&mut self, is_changed: bool) {
        self.is_overdue = true;
        if is_changed {
            self.on_disk = OnDisk::default();
        }
    }

    /// Frame and parts, if they differ from the published ones.
    pub(super) fn untold(&mut self, mapper: &Mapper, stamp: Stamp) -> Option<MapFrame> {
        (std::mem::take(&mut self.is_untold) && !self.parts.is_empty()).then(|| MapFrame {
            stamp,
            map: mapper.map().clone(),
            moves: self.moves.iter().copied().collect(),
            parts: self.parts.clone(),
        })
    }

    /// The pose graph, if it differs from the published one or `anyway`, in the frame of the drawn map. A graph whose closure has moved the
    /// map waits until the map is redrawn.
    pub(super) fn untold_graph(&mut self, mapper: &Mapper, anyway: bool) -> Option<PoseGraph> {
        let certificate = self.slam.as_ref().map(Slam::certificate).unwrap_or_default();
        let is_untold = self.is_graph_untold || certificate != self.told_certificate;
        if self.redraw.is_some() || !(is_untold || anyway) {
            return None;
        }
        (self.is_graph_untold, self.told_certificate) = (false, certificate);
        let (nodes, edges) = self.slam.as_ref().map(Slam::drawn_graph).unwrap_or_default();
        Some(PoseGraph {
            stamp: self.scans.last().map(|scan| scan.stamp).unwrap_or_default(),
            boot_id: self.boot_id.clone(),
            map: mapper.map().clone(),
            certificate,
            nodes,
            edges,
        })
    }

    /// Bends the map as a loop closure does.
    pub(super) fn bend(&mut self, mapper: &Mapper, bend: impl Fn(Pose2) -> Pose2) {
        match self.slam.as_mut().map(|slam| slam.bend(bend)) {
            Some(Ok(moved)) => self.surroundings_moved(moved, mapper),
            Some(Err(error)) => tracing::warn!(%error, "the map is not bent"),
            None => {}
        }
    }

    /// Adds the poses of new parts, in the drawn map.
    fn note_new_parts(&mut self) {
        let Some(slam) = &self.slam else { return };
        if slam.submaps() > self.parts.len() && self.redraw.is_none() {
            let drawn_from_new = self.new_from_drawn.inverse();
            let new = slam.parts().into_iter().skip(self.parts.len());
            self.parts.extend(new.map(|part| drawn_from_new * part));
            self.is_untold = true;
        }
    }

    fn surroundings_moved(&mut self, moved: Pose2, mapper: &Mapper) {
        self.is_graph_untold = true;
        self.new_from_drawn = moved * self.new_from_drawn;
        let Some(slam) = &self.slam else { return };
        // A redraw in progress restarts only if its result would be wrong; otherwise a robot that keeps driving would never get its map.
        let drawn = self.redraw.as_ref().map_or(&self.parts, |redraw| &redraw.parts);
        let has_moved = drawn.iter().zip(slam.parts()).any(|(drawn, new)| {
            drawn.distance(&new) > SMALLEST_MOVE.0 || wrap_angle(new.yaw - drawn.yaw).abs() > SMALLEST_MOVE.1
        });
        if has_moved {
            let now = self.last.as_ref().map(|scan| scan.stamp).unwrap_or_default();
            let redraw = Redraw::begin(mapper, self.base.as_deref(), slam, &self.scans, now);
            self.ahead.push(redraw.ahead());
            self.redraw = Some(redraw);
            // The session as of now leads a successor to the frame that the new map begins: it is stored meanwhile.
            self.changes += 1;
            self.is_overdue = true;
        }
    }

    /// Replaces the map if its redraw is due; returns whether it was.
    fn replace_map(&mut self, mapper: &mut Mapper, now: Stamp) -> bool {
        if !self.redraw.as_ref().is_some_and(|redraw| redraw.is_due(now)) {
            return false;
        }
        self.swap(mapper);
        self.map_from_odom = self.new_from_drawn * self.map_from_odom;
        self.begin_frame(mapper);
        true
    }

    /// Replaces the old map by the redrawn one.
    fn swap(&mut self, mapper: &mut Mapper) {
        if let (Some(redraw), Some(slam)) = (self.redraw.take(), &self.slam) {
            *mapper = redraw.finish(slam, &self.scans).succeed(mapper);
            self.parts = redraw.parts;
        }
        self.is_untold = true;
    }

    /// Begins the frame of a redrawn map.
    fn begin_frame(&mut self, mapper: &mut Mapper) {
        self.frame += 1;
        if self.moves.len() == MOST_MOVES {
            self.moves.pop_front();
        }
        self.moves
            .push_back(std::mem::replace(&mut self.new_from_drawn, Pose2::IDENTITY));
        self.is_untold = true;
        self.is_overdue = true;
        self.in_force = self.changes;
        mapper.set_frame(self.frame);
    }

    fn measured(&mut self, scan: &Scan, effects: &Effects, was_redrawn: bool, robot_frame: u64) -> Option<Measured> {
        let covariance = effects.covariance.filter(|_| self.health.is_trusted())?;
        let map_from_base = self.map_from_odom * scan.odom_from_base;
        // The edge starts at its configured pose and would reject the correction as an outlier.
        let is_found_anew = self.is_astray && effects.fits;
        if was_redrawn || is_found_anew {
            self.pace = Pace::default();
        }
        // A robot still in an older frame is sent the new one again.
        let is_behind = robot_frame < self.frame && self.pace.is_older(scan.stamp, TOLD_AGAIN);
        let is_due = self.pace.is_due(scan.stamp, map_from_base) || is_behind;
        if is_due {
            self.is_astray &= !is_found_anew;
        }
        is_due.then_some(Measured {
            // The scan's own estimate: the robot fuses odometry itself.
            map_from_base: map_from_base * effects.by_scan,
            covariance,
            is_found_anew,
        })
    }
}

//! SLAM. The map under construction: what it holds, how a scan is taken in, and what can be asked of it.

use std::sync::Arc;

use nalgebra::Point2;
use zenav_pose_graph::{PoseGraph, RobustSolution};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::sensors::Fix;
use zenav_scan_matching::{OdometryFilter, points};

use crate::back_end::BackEnd;
use crate::carried::LastSeen;
use crate::doubt::Doubt;
use crate::finish;
use crate::joining::Older;
use crate::session::{Session, on_grid};
use crate::settings::SlamSettings;
use crate::solve::Solve;
use crate::step::{Counts, Effects, SlamError};
use crate::submap::Submap;

/// Pose of a scan: its time, s, a node, and the pose in that node's frame; its points, if it is not a node itself.
#[derive(Clone, Debug)]
pub(crate) struct Stand {
    pub(crate) stamp: f64,
    pub(crate) node: usize,
    pub(crate) node_from_base: Pose2,
    pub(crate) points: Vec<Point2<f64>>,
}

/// A map under construction.
#[derive(Clone, Debug)]
pub struct Slam {
    pub(crate) settings: SlamSettings,
    pub(crate) back_end: BackEnd,
    /// Points of each node's scan, shared with snapshots.
    pub(crate) scans: Vec<Arc<Vec<Point2<f64>>>>,
    pub(crate) submaps: Vec<Submap>,
    pub(crate) stands: Vec<Stand>,
    /// The sessions, each with consecutive nodes; the last one is the present one.
    pub(crate) sessions: Vec<Session>,
    /// The map of earlier sessions, while the present one has not been found in it yet.
    pub(crate) older: Option<Box<Older>>,
    /// Time, s, and odometry of the last scan.
    pub(crate) last: Option<(f64, Pose2)>,
    pub(crate) last_seen: LastSeen,
    pub(crate) last_node_odometry: Pose2,
    pub(crate) odometry: OdometryFilter,
    /// Whether odometry restarts with the next scan.
    pub(crate) is_interrupted: bool,
    /// Whether the next match is searched for widely, however well it scores.
    pub(crate) is_doubted: bool,
    /// Whether odometry restarted after the last node, so that the step from it is unknown.
    pub(crate) is_apart: bool,
    /// Number of nodes that the robot may have driven unseen before odometry restarted.
    pub(crate) unseen: u32,
    /// Whether every scan is kept for the end of a log; beside a robot only nodes are.
    pub(crate) keeps_all: bool,
    pub(crate) start: Pose2,
    /// Running mean of the scores of matches.
    pub(crate) usual: f64,
    /// Evidence on whether the robot is where the map says.
    pub(crate) doubt: Doubt,
    /// Whether closures were added since the last solve began, or a fix that disagrees with the map.
    pub(crate) is_dirty: bool,
    /// The newest fix of each kind since the last factors.
    pub(crate) fixes: [Option<Fix>; 2],
    /// The last solve while scans arrive.
    pub(crate) solve: Option<Arc<Solve>>,
    /// When its poses are adopted, s; `None` once they are.
    pub(crate) adopts_at: Option<f64>,
    pub(crate) counts: Counts,
}

impl Slam {
    /// An empty map.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// use zenav_slam::{Slam, SlamSettings};
    ///
    /// let mut slam = Slam::new(SlamSettings::default());
    /// for i in 0..9 {
    ///     slam.step(&look(0.2 * f64::from(i), Pose2::new(0.12 * f64::from(i), 0.0, 0.0)))?;
    /// }
    /// let (secs, map_from_base) = slam.trajectory()[8];
    /// assert!((secs - 1.6).abs() < 1e-6 && map_from_base.distance(&Pose2::new(0.96, 0.0, 0.0)) < 0.02);
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn new(settings: SlamSettings) -> Self {
        Self {
            settings,
            back_end: BackEnd::default(),
            scans: Vec::new(),
            submaps: Vec::new(),
            stands: Vec::new(),
            sessions: vec![Session::default()],
            older: None,
            last: None,
            last_seen: LastSeen::default(),
            last_node_odometry: Pose2::IDENTITY,
            odometry: OdometryFilter::UNSEEN,
            is_interrupted: false,
            is_doubted: false,
            is_apart: false,
            unseen: 0,
            keeps_all: true,
            start: Pose2::IDENTITY,
            usual: 0.0,
            doubt: Doubt::default(),
            is_dirty: false,
            fixes: [None; 2],
            solve: None,
            adopts_at: None,
            counts: Counts::default(),
        }
    }

    /// An empty map beside a robot that stands at `start` in it: the map grows without an end, and only the scans of nodes are kept.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// use zenav_slam::{Slam, SlamSettings};
    ///
    /// let start = Pose2::new(5.0, 2.0, 0.3);
    /// let mut slam = Slam::beside_a_robot(SlamSettings::default(), start);
    /// assert_eq!(slam.step(&look(0.0, Pose2::IDENTITY))?.pose, start);
    /// assert!(slam.trajectory().is_empty() && slam.nodes().len() == 1, "a pose is kept for each node only");
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn beside_a_robot(settings: SlamSettings, start: Pose2) -> Self {
        Self {
            keeps_all: false,
            start,
            ..Self::new(settings)
        }
    }

    /// The first node of the present session.
    pub(crate) fn session_start(&self) -> usize {
        self.scans.len() - self.sessions.last().map_or(0, |session| session.nodes)
    }

    /// Odometry restarts with the next scan, because the robot was restarted. The robot is searched for around its last place, as far as it
    /// may have driven within `unseen` nodes unknown to this map. Until a scan fits, no scan has a score; the first one that fits becomes a
    /// node, even at rest.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// // The robot is restarted where it stands: its odometry begins at zero again.
    /// slam.interrupt(0);
    /// let here = Pose2::new(0.96, 0.0, 0.0);
    /// let found = slam.step(&Scan { odom_from_base: Pose2::IDENTITY, ..look(9.0, here) })?;
    /// assert!(found.is_searched && found.pose.distance(&here) < 0.05, "{found:?}");
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    pub fn interrupt(&mut self, unseen: u32) {
        self.is_interrupted = !self.scans.is_empty();
        self.unseen = self.unseen.saturating_add(unseen);
    }

    /// Takes in one scan; its `odom_from_base` is the odometry at its stamp, its `map_from_odom` is ignored.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// use zenav_slam::{Slam, SlamError, SlamSettings};
    ///
    /// let mut slam = Slam::new(SlamSettings::default());
    /// let first = slam.step(&look(0.0, Pose2::IDENTITY))?;
    /// assert!(first.is_inserted && first.pose == Pose2::IDENTITY, "the map begins at the first scan's base");
    /// let near = slam.step(&look(0.2, Pose2::new(0.05, 0.0, 0.0)))?;
    /// assert!(!near.is_inserted && near.fits, "matched, but too near for a node");
    /// assert!(matches!(slam.step(&look(0.1, Pose2::IDENTITY)), Err(SlamError::Order(_))));
    /// # Ok::<(), SlamError>(())
    /// ```
    ///
    /// # Errors
    /// See [`SlamError`]; after a malformed or late scan the map is unchanged.
    pub fn step(&mut self, scan: &Scan) -> Result<Effects, SlamError> {
        let stamp = scan.stamp.as_secs();
        let odometry = scan.odom_from_base;
        if !scan.is_sane() || !odometry.is_finite() {
            return Err(SlamError::Scan(stamp));
        }
        if std::mem::take(&mut self.is_interrupted)
            && let Some((_, before)) = self.last.replace((stamp, odometry))
        {
            self.last_node_odometry = odometry * before.inverse() * self.last_node_odometry;
            self.doubt_place();
            self.last_seen.forget();
            // The stamp at which its poses were to be adopted may never come: the robot's clock may have begun anew.
            if self.adopts_at.is_some() {
                self.drop_solve();
            }
        }
        let (before, odometry_before) = self.last.unwrap_or((stamp, odometry));
        if stamp < before {
            return Err(SlamError::Order(stamp));
        }
        self.counts.scans += 1;
        let adopted = self.adopt_solve(stamp)?;
        self.hold_fixes(&scan.fixes);
        let step = odometry_before.inverse() * odometry;
        let seen = on_grid(points(scan, step, stamp - before, &self.settings.scan));
        self.last = Some((stamp, odometry));
        self.last_seen.take(stamp - before, step, &seen);
        if self.scans.is_empty() {
            return self.begin(stamp, odometry, seen, scan.base_from_laser.position());
        }
        let node_from_base = self.last_node_odometry.inverse() * odometry;
        let front = &self.settings.front;
        let way = node_from_base.x.hypot(node_from_base.y);
        let is_near = way < front.distance && node_from_base.yaw.abs() < front.turn;
        let laser = scan.base_from_laser.position();
        let is_certain = !(self.is_doubted || self.doubt.accepts() || self.doubt.was_carried());
        let mut effects = if is_near && is_certain {
            self.track(stamp, node_from_base, seen, laser)
        } else {
            self.insert(stamp, node_from_base, seen, laser, is_near)?
        };
        effects.moved = match (adopted, effects.moved) {
            (Some(before), Some(moved)) => Some(moved * before),
            (before, moved) => before.or(moved),
        };
        self.doubt.take(effects.fits, effects.contradicts);
        if self.is_lost() {
            if self.keeps_all || !self.doubt.was_carried() {
                self.doubt_place();
            }
            if self.keeps_all {
                // In a log nobody searches for the robot: what follows is a separate part unless closures join it.
                self.doubt.accept();
            }
        }
        Ok(effects)
    }

    /// Widens the search for the robot beyond the error of odometry, which does not explain how it got there.
    fn doubt_place(&mut self) {
        (self.is_doubted, self.is_apart) = (true, true);
        self.fixes = [None; 2];
    }

    /// Whether the robot is elsewhere than the map says: five scans contradict it, with no fitting scan between them, or the robot [was
    /// carried](Self::was_carried). Beside a robot nothing is inserted until a scan fits, the robot [continues elsewhere](Self::go_on_at),
    /// or the [world has changed](Self::accept_change).
    #[must_use]
    pub fn is_lost(&self) -> bool {
        self.doubt.is_lost()
    }

    /// Whether the robot was carried away: a scan that does not fit shows other surroundings than the one a moment before, and none since
    /// has fitted where odometry leads. Within the window of a doubtful match no other place is taken meanwhile: such a match is a chance one
    /// too often. False in a log, which continues as a separate part.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// use zenav_slam::{Slam, SlamSettings};
    ///
    /// let mut slam = Slam::beside_a_robot(SlamSettings::default(), Pose2::IDENTITY);
    /// slam.step(&look(0.0, Pose2::IDENTITY))?;
    /// // The robot is carried, unnoticed by its wheels.
    /// let there = look(0.2, Pose2::new(1.2, 0.5, 0.8));
    /// slam.step(&Scan { odom_from_base: Pose2::IDENTITY, ..there })?;
    /// assert!(slam.was_carried() && slam.is_lost());
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn was_carried(&self) -> bool {
        self.doubt.was_carried()
    }

    /// Declares the robot lost: the next scan is searched for widely.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// slam.lose();
    /// assert!(slam.is_lost());
    /// let found = slam.step(&look(9.0, Pose2::new(0.96, 0.0, 0.0)))?;
    /// assert!(found.is_searched && found.fits && !slam.is_lost());
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    pub fn lose(&mut self) {
        if !self.scans.is_empty() {
            self.doubt.lose();
            self.doubt_place();
        }
    }

    /// Declares the robot's place right and its surroundings changed: until a scan fits well again, each is inserted.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// slam.lose();
    /// slam.accept_change();
    /// let here = slam.step(&look(9.0, Pose2::new(0.96, 0.0, 0.0)))?;
    /// assert!(here.is_inserted && !here.contradicts && !slam.is_lost());
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    pub fn accept_change(&mut self) {
        self.doubt.accept();
        (self.is_doubted, self.is_apart) = (false, false);
    }

    /// Ends a log: decides on all closures again, matches every scan to the submaps around it, and solves, in rounds.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// use zenav_pose_graph::{Optimality, SolveError};
    /// use zenav_slam::{Slam, SlamError, SlamSettings};
    ///
    /// let solved = slam.finish()?;
    /// assert_eq!(solved.solution.certificate.optimality, Optimality::Certified);
    /// assert!(slam.nodes()[8].distance(&Pose2::new(0.96, 0.0, 0.0)) < 0.02);
    /// let nothing = Slam::new(SlamSettings::default()).finish();
    /// assert_eq!(nothing, Err(SlamError::Solve(SolveError::Empty)));
    /// # Ok::<(), SlamError>(())
    /// ```
    ///
    /// # Errors
    /// [`SlamError::Solve`], for instance without any scan.
    pub fn finish(&mut self) -> Result<RobustSolution, SlamError> {
        self.finish_timed(&mut || 0.0).map(|(solved, _)| solved)
    }

    /// [`Self::finish`], and how long the graph was solved in it, certificate included, s by the caller's `clock`: most of a finish is
    /// matching.
    ///
    /// # Errors
    /// As [`Self::finish`].
    pub fn finish_timed(&mut self, clock: &mut dyn FnMut() -> f64) -> Result<(RobustSolution, f64), SlamError> {
        finish::finish(self, clock)
    }

    /// `map_from_base` at each scan given so far, with its time, s.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_slam::{Slam, SlamSettings};
    /// let mut slam = Slam::new(SlamSettings::default());
    /// for (secs, x) in [(0.0, 0.0), (0.2, 0.04), (0.4, 0.08)] {
    ///     slam.step(&look(secs, Pose2::new(x, 0.0, 0.0)))?;
    /// }
    /// let trajectory = slam.trajectory();
    /// assert_eq!((trajectory.len(), slam.nodes().len()), (3, 1), "scans between nodes have a pose, too");
    /// assert!(trajectory[2].1.distance(&Pose2::new(0.08, 0.0, 0.0)) < 0.02);
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn trajectory(&self) -> Vec<(f64, Pose2)> {
        let poses = self.back_end.poses();
        let stands = self.stands.iter();
        stands
            .map(|stand| (stand.stamp, poses[stand.node] * stand.node_from_base))
            .collect()
    }

    /// The graph: a node for each inserted scan, odometry, matches and closures.
    #[must_use]
    pub fn graph(&self) -> &PoseGraph {
        self.back_end.graph()
    }

    /// The weight of each edge of the graph: 0 for a closure held to be false.
    #[must_use]
    pub fn weights(&self) -> &[f64] {
        self.back_end.weights()
    }

    /// Which edges of the graph are matches of the finish, one for each edge. The other [closures](zenav_pose_graph::EdgeKind::Closure) are
    /// places that were recognised on the way.
    #[must_use]
    pub fn rematches(&self) -> &[bool] {
        self.back_end.is_final()
    }

    /// `map_from_node` of all inserted scans, in order.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// // Nine scans, 0.12 m apart.
    /// assert_eq!((slam.nodes().len(), slam.nodes()[0]), (9, Pose2::IDENTITY));
    /// assert!(slam.nodes()[8].distance(&Pose2::new(0.96, 0.0, 0.0)) < 0.02);
    /// // Each but the first was reached by odometry, and matched to the map.
    /// assert_eq!(slam.graph().edges().len(), 2 * 8);
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn nodes(&self) -> &[Pose2] {
        self.back_end.poses()
    }

    /// Pose of each submap, `map_from_submap`, in order of creation: the parts of the map that closures move.
    #[must_use]
    pub fn parts(&self) -> Vec<Pose2> {
        let poses = self.back_end.poses();
        self.submaps.iter().map(|submap| poses[submap.anchor]).collect()
    }

    /// Bends the map like a closure that moves all of it: each node goes where `bend` says, and all measurements are adjusted to agree. For
    /// tests of the components that follow closures. Returns how the surroundings of the last node moved, `new_from_old`.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// let by = Pose2::new(0.5, -0.2, 0.0);
    /// let moved = slam.bend(|pose| by * pose)?;
    /// assert!(moved.distance(&by) < 1e-9 && slam.nodes()[0] == by);
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    ///
    /// # Errors
    /// [`SlamError::Graph`] if `bend` returns a pose that is not finite.
    pub fn bend(&mut self, bend: impl Fn(Pose2) -> Pose2) -> Result<Pose2, SlamError> {
        let last = self.back_end.poses().last().copied().unwrap_or_default();
        self.drop_solve();
        self.back_end.bend(&bend)?;
        Ok(bend(last) * last.inverse())
    }

    /// Points of an inserted scan in the frame of its base, m.
    ///
    /// ```
    #[doc = include_str!("doc_setup/room.txt")]
    /// # use zenav_slam::{Slam, SlamSettings};
    /// let mut slam = Slam::new(SlamSettings::default());
    /// slam.step(&look(0.0, Pose2::new(1.0, 0.0, 0.0)))?;
    /// // The wall ahead is 2 m from the base, although the lidar is mounted 0.1 m behind it.
    /// let ahead = slam.scan(0).unwrap().iter().map(|point| point.x).fold(0.0, f64::max);
    /// assert!((ahead - 2.0).abs() < 0.01);
    /// assert_eq!(slam.scan(1), None);
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn scan(&self, node: usize) -> Option<&[Point2<f64>]> {
        self.scans.get(node).map(|scan| scan.as_slice())
    }

    /// Counters of the run.
    ///
    /// ```
    #[doc = include_str!("doc_setup/mapped_room.txt")]
    /// let counts = slam.counts();
    /// assert_eq!((counts.scans, counts.unmatched, counts.found), (9, 0, 0));
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn counts(&self) -> Counts {
        self.counts
    }

    /// Number of submaps.
    #[must_use]
    pub fn submaps(&self) -> usize {
        self.submaps.len()
    }
}

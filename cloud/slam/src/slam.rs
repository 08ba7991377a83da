//! SLAM. Localises the robot and builds the map from its scans and odometry.

use std::sync::Arc;

use nalgebra::{Matrix3, Point2};
use zenav_pose_graph::{Edge, EdgeKind, PoseGraph, RobustSolution};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_protocol::sensors::Fix;
use zenav_scan_matching::{
    LikelihoodField, OdometryFilter, Prior, Refinable, Refined, Window, floored, judge, points, search, turned,
};

use crate::back_end::BackEnd;
use crate::carried::LastSeen;
use crate::closure::close;
use crate::doubt::Doubt;
use crate::finish;
use crate::joining::{Older, locate};
use crate::session::{Session, on_grid};
use crate::settings::SlamSettings;
use crate::solve::Solve;
use crate::step::{Counts, Effects, SlamError};
use crate::submap::{SEARCH_POINTS, Scans, Submap, thinned};

/// Weight of a new score in the usual one.
const USUAL: f64 = 0.05;
/// A correction of odometry less likely than this (half of chi squared, three degrees of freedom) makes a match doubtful.
const DOUBTFUL_CORRECTION: f64 = 8.0;
/// Evidence of one fully better-fitting scan point for a match (half of chi squared): neighbouring points share their errors.
const EVIDENCE: f64 = 1.5;
/// Beyond this way and turn from the last node, m and rad, a badly fitting scan does not wait for another: the scans of some logs are a
/// metre apart, and past a corner the next ones see nothing of the map.
const LONG: (f64, f64) = (0.75, 0.75);
/// Upper bound on how unlikely a correction of odometry is (half of chi squared): wheels slip.
const SLIPPED: f64 = 25.0;

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

    /// The older of the two growing submaps.
    fn active(&self) -> usize {
        let session = self.session_start();
        let first = self.submaps.partition_point(|submap| submap.anchor < session);
        self.submaps.len().saturating_sub(2).max(first)
    }

    /// A node's pose in a growing submap, `anchor_from_node`: where its scan was inserted. Solves move nodes, but a submap stays rigid, and
    /// what bends it would be measured as trusted matches.
    fn in_submap(&self, submap: &Submap, node: usize) -> Pose2 {
        let poses = self.back_end.poses();
        let elsewhere = || poses[submap.anchor].inverse() * poses[node];
        submap.pose_of(node).unwrap_or_else(elsewhere)
    }

    /// Stores a scan as that of a new node.
    fn keep(&mut self, seen: Arc<Vec<Point2<f64>>>, laser: Point2<f64>) {
        self.scans.push(seen);
        if let Some(session) = self.sessions.last_mut() {
            session.nodes += 1;
            session.laser = laser;
        }
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

    /// Whether the robot was carried between the present scan and the one before.
    fn is_carried(&self, laser: Point2<f64>, seen: &[Point2<f64>]) -> bool {
        self.doubt.heeds(seen.len().min(self.last_seen.points_before()))
            && self.last_seen.is_elsewhere(laser, seen, &self.settings)
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

    /// Matches a scan near the last node, without making it a node.
    fn track(&mut self, stamp: f64, step: Pose2, seen: Vec<Point2<f64>>, laser: Point2<f64>) -> Effects {
        let settings = self.settings;
        let poses = self.back_end.poses();
        let last = self.scans.len() - 1;
        let active = self.active();
        let submap = &self.submaps[active];
        let (anchor, map_from_anchor) = (submap.anchor, poses[submap.anchor]);
        let expected = self.in_submap(submap, last) * self.odometry.corrected(step);
        let by_odometry = self.odometry.expected(step, &settings.odometry);
        let prior = Prior::of_odometry(expected, &by_odometry.information());
        let refined = submap.refine(
            &Refinable::seen_from(laser, &seen),
            expected,
            Some(&prior),
            &settings.refine,
        );
        let refined = refined.expected_where_degenerate(expected);
        let least = settings.front.min_score.max(settings.front.doubtful * self.usual);
        let is_match = refined.score >= least;
        let anchor_from_base = if is_match { refined.pose } else { expected };
        let pose = map_from_anchor * anchor_from_base;
        let is_carried = !is_match && self.is_carried(laser, &seen);
        if is_carried {
            self.doubt.carry();
        }
        let contradicts = is_carried || !is_match && self.goes_through_walls(active, expected, laser, &seen);
        let effects = Effects {
            pose,
            score: is_match.then_some(refined.score),
            fits: refined.score >= settings.front.min_score && !contradicts,
            contradicts,
            points: seen.len(),
            degenerate: refined
                .degenerate
                .filter(|_| is_match)
                .map(|along| along.y.atan2(along.x) + map_from_anchor.yaw),
            covariance: is_match.then(|| self.covariance(&refined, pose)).flatten(),
            by_scan: refined.by_scan,
            ..Effects::default()
        };
        if is_match {
            self.doubt.match_well(true, seen.len());
        }
        self.stand(stamp, anchor, anchor_from_base, seen);
        effects
    }

    /// Whether a scan's beams rule out a pose in a submap. People who walked ahead of the robot and away again rule out nothing.
    fn goes_through_walls(
        &mut self,
        submap: usize,
        anchor_from_base: Pose2,
        laser: Point2<f64>,
        seen: &[Point2<f64>],
    ) -> bool {
        let (verdict, most) = (&self.settings.verdict, self.settings.closure.through_walls);
        let submap = &mut self.submaps[submap];
        let scans = Scans {
            sessions: &self.sessions,
            points: &self.scans,
        };
        let goes =
            |field: &LikelihoodField| judge(field, laser, seen, anchor_from_base, verdict).surely_through_walls > most;
        self.doubt.heeds(seen.len()) && goes(&submap.field) && goes(submap.standing(scans, verdict))
    }

    /// Covariance of a match along the map's axes.
    fn covariance(&self, refined: &Refined, map_from_base: Pose2) -> Option<Matrix3<f64>> {
        let front = &self.settings.front;
        let information = floored(&refined.information, front.floor, front.floor_turn);
        Some(turned(&information.try_inverse()?, map_from_base.yaw))
    }

    /// Records a scan's pose, and the points of one that is not a node.
    fn stand(&mut self, stamp: f64, node: usize, node_from_base: Pose2, points: Vec<Point2<f64>>) {
        if self.keeps_all {
            self.stands.push(Stand {
                stamp,
                node,
                node_from_base,
                points,
            });
        }
    }

    fn begin(
        &mut self,
        stamp: f64,
        odometry: Pose2,
        seen: Vec<Point2<f64>>,
        laser: Point2<f64>,
    ) -> Result<Effects, SlamError> {
        self.back_end.add_node(self.start)?;
        let mut submap = Submap::new(0, &self.settings.field);
        submap.insert(Pose2::IDENTITY, &Refinable::seen_from(laser, &seen));
        self.submaps.push(submap);
        self.keep(Arc::new(seen), laser);
        self.last_node_odometry = odometry;
        self.stand(stamp, 0, Pose2::IDENTITY, Vec::new());
        let effects = Effects {
            pose: self.start,
            fits: true,
            is_inserted: true,
            ..Effects::default()
        };
        self.located(false, effects)
    }

    /// The effects of a step, including the session's being found in the older map.
    fn located(&mut self, is_half: bool, effects: Effects) -> Result<Effects, SlamError> {
        let Some(older_from_session) = locate(self, is_half)? else {
            return Ok(effects);
        };
        let moved = effects.moved.unwrap_or_default();
        Ok(Effects {
            pose: older_from_session * effects.pose,
            moved: Some(older_from_session * moved),
            covariance: effects
                .covariance
                .map(|covariance| turned(&covariance, older_from_session.yaw)),
            degenerate: effects.degenerate.map(|along| along + older_from_session.yaw),
            ..effects
        })
    }

    /// Makes a scan a node, unless it contradicts the map. A scan that `is_near` the last node, or of a lost robot, becomes a node only if
    /// it fits.
    fn insert(
        &mut self,
        stamp: f64,
        step: Pose2,
        seen: Vec<Point2<f64>>,
        laser: Point2<f64>,
        is_near: bool,
    ) -> Result<Effects, SlamError> {
        let settings = self.settings;
        let last = self.scans.len() - 1;
        let was_doubted = self.is_doubted;
        let by_odometry = self.odometry.information(step, &settings.odometry);
        let (reach, turn) = self.window();
        let nothing = Matrix3::from_diagonal(&[reach, reach, turn].map(|far| far.max(0.01).powi(-2)).into());
        let known = self.odometry.expected(step, &settings.odometry);
        let prior = if was_doubted { nothing } else { known.information() };
        let information = if self.is_apart { nothing } else { by_odometry };
        let corrected = self.odometry.corrected(step);
        // The older of the two growing submaps has seen more.
        let half = (settings.front.submap_scans / 2).max(1) as usize;
        let active = self.active();
        let mut effects = Effects {
            is_inserted: true,
            points: seen.len(),
            ..Effects::default()
        };
        let anchor = self.submaps[active].anchor;
        let map_from_anchor = self.back_end.poses()[anchor];
        let expected = self.in_submap(&self.submaps[active], last) * corrected;
        if step.x.hypot(step.y) > LONG.0 || step.yaw.abs() > LONG.1 {
            self.doubt.wait_no_more();
        }
        let seen = Arc::new(seen);
        let scan = Refinable::seen_from(laser, &seen);
        let matched = self.matched(active, expected, &prior, &scan, laser, &mut effects);
        effects.contradicts |= matched.is_none()
            && ((was_doubted || self.doubt.was_carried()) && self.doubt.heeds(seen.len())
                || self.goes_through_walls(active, expected, laser, &seen));
        let waits = self.doubt.waits(seen.len());
        let is_near = is_near && !self.doubt.accepts();
        if matched.is_none() && (is_near || effects.contradicts || waits || self.is_lost()) {
            self.stand(stamp, anchor, expected, Arc::unwrap_or_clone(seen));
            return Ok(Effects {
                pose: map_from_anchor * expected,
                is_inserted: false,
                ..effects
            });
        }
        self.is_apart = false;
        let anchor_from_scan = matched.as_ref().map_or(expected, |refined| refined.pose);
        let node = self.back_end.add_node(map_from_anchor * anchor_from_scan)?;
        self.back_end.add_edge(Edge {
            from: last,
            to: node,
            measurement: corrected,
            information,
            kind: EdgeKind::Odometry,
        })?;
        if let Some(refined) = &matched {
            let by_scan = floored(&refined.information, settings.front.floor, settings.front.floor_turn);
            self.back_end.add_edge(Edge {
                from: anchor,
                to: node,
                measurement: refined.pose,
                information: by_scan,
                kind: EdgeKind::Odometry,
            })?;
            if was_doubted {
                self.odometry.begin_anew(&by_scan);
            } else {
                self.odometry.learn(
                    &known,
                    expected.inverse() * refined.pose,
                    &by_scan,
                    refined.degenerate.is_none(),
                );
            }
            effects.score = Some(refined.score);
            effects.by_scan = refined.by_scan;
            effects.fits = true;
            effects.degenerate = refined
                .degenerate
                .map(|along| along.y.atan2(along.x) + map_from_anchor.yaw);
        } else {
            self.counts.unmatched += 1;
            self.odometry.go_on(&known);
        }
        self.keep(Arc::clone(&seen), laser);
        self.last_node_odometry = self.last_node_odometry * step;
        self.stand(stamp, node, Pose2::IDENTITY, Vec::new());
        let map_from_node = self.back_end.poses()[node];
        effects.covariance = matched.and_then(|refined| self.covariance(&refined, map_from_node));
        for index in active..self.submaps.len() {
            let active_from_anchor = self.in_submap(&self.submaps[active], self.submaps[index].anchor);
            self.submaps[index].insert(active_from_anchor.inverse() * anchor_from_scan, &scan);
        }
        let is_half = self.submaps.last().is_some_and(|newest| newest.inserted.len() >= half);
        if is_half {
            let mut next = Submap::new(node, &settings.field);
            next.insert(Pose2::IDENTITY, &scan);
            self.submaps.push(next);
            self.add_factors(node);
        }
        if node % settings.closure.every as usize == 0 {
            effects.closures = close(self, node, laser)?;
        }
        if is_half && self.is_dirty && self.adopts_at.is_none() {
            self.begin_solve(stamp);
            effects.begins_solve = true;
            effects.moved = self.adopt_solve(stamp)?;
        }
        effects.pose = self.back_end.poses()[node];
        self.located(is_half, effects)
    }

    /// Half widths of the search window of a doubtful match, m and rad.
    fn window(&self) -> (f64, f64) {
        let front = &self.settings.front;
        let unseen = f64::from(self.unseen);
        let turn = front.search_turn + unseen * front.turn;
        (front.reach + unseen * front.distance, turn.min(std::f64::consts::PI))
    }

    /// Matches a scan to a growing submap; `None` if the match says no more than odometry.
    fn matched(
        &mut self,
        active: usize,
        expected: Pose2,
        odometry: &Matrix3<f64>,
        scan: &Refinable<'_>,
        laser: Point2<f64>,
        effects: &mut Effects,
    ) -> Option<Refined> {
        let settings = self.settings;
        let (reach, turn) = self.window();
        let prior = Prior::of_odometry(expected, odometry);
        let mut best = self.submaps[active].refine(scan, expected, Some(&prior), &settings.refine);
        let is_doubtful = self.is_doubted
            || best.score < settings.front.doubtful * self.usual
            || unlikely(&prior, best.pose) > DOUBTFUL_CORRECTION;
        if is_doubtful && self.is_carried(laser, scan.points()) {
            self.doubt.carry();
        }
        if is_doubtful && !self.doubt.was_carried() {
            let submap = &mut self.submaps[active];
            self.counts.wide_searches += 1;
            effects.is_searched = true;
            let window = Window {
                min_score: best.score.max(settings.front.min_score),
                budget: settings.closure.budget as usize,
                ..Window::around(expected, reach, turn)
            };
            let found = search(submap.pyramid(), &thinned(scan.points(), SEARCH_POINTS), &window);
            if let Some(candidate) = found.found.first() {
                let wide = submap.refine(scan, candidate.pose, None, &settings.refine);
                // The gain in the scan's likelihood against the loss in odometry's: few points overrule nothing.
                let gain = EVIDENCE * scan.points().len() as f64 * (wide.score - best.score);
                if gain > (unlikely(&prior, wide.pose) - unlikely(&prior, best.pose)).max(0.0) {
                    best = wide;
                }
            }
        }
        let is_far = self.unseen > 0 && best.pose.distance(&expected) > settings.front.reach;
        let least = if is_far || self.is_lost() {
            // The wider the search, the more fits by chance.
            settings.front.min_score.max(settings.front.doubtful * self.usual)
        } else {
            settings.front.min_score
        };
        let is_well = best.score >= settings.front.min_score.max(settings.front.doubtful * self.usual);
        let points = scan.points().len();
        self.doubt.match_well(is_well, points);
        if best.score < least {
            return None;
        }
        if !is_well || self.doubt.was_carried() {
            // Much of a map explains much of any scan; if the robot is elsewhere, the rest goes through walls.
            effects.contradicts = self.goes_through_walls(active, best.pose, laser, scan.points());
            if effects.contradicts || !is_well && self.doubt.waits(points) {
                return None;
            }
        }
        if !std::mem::take(&mut self.is_doubted) {
            best = best.expected_where_degenerate(expected);
        }
        self.unseen = 0;
        let share = if self.usual == 0.0 { 1.0 } else { USUAL };
        self.usual += share * (best.score - self.usual);
        Some(best)
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

    /// Which edges of the graph are matches of the finish, one for each edge. The other [closures](EdgeKind::Closure) are places that were
    /// recognised on the way.
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

/// Half of chi squared of a pose against odometry, bounded.
fn unlikely(odometry: &Prior, pose: Pose2) -> f64 {
    (0.5 * odometry.chi_squared(pose)).min(SLIPPED)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_fixtures::{robot, scan, sweep_in_room};
    use zenav_protocol::settings::Settings;

    use super::*;

    /// Distance between two scans, m.
    const STEP: f64 = 0.12;

    #[test]
    fn growing_submaps_stay_rigid_when_a_solve_moves_their_nodes() {
        let lidar = robot("neato").lidar.unwrap();
        let look = |index: u32| {
            let at = Pose2::new(STEP * f64::from(index), 0.0, 0.0);
            let sweep = sweep_in_room(&lidar, 0.2 * f64::from(index), at, (3.0, 2.0), &[]);
            Scan {
                base_from_laser: lidar.mount,
                ..scan(sweep.stamp.0, at, sweep.ranges)
            }
        };
        let settings = SlamSettings::default().with_number("front.submap_scans", 20.0);
        let mut slam = Slam::new(settings.unwrap().unwrap());
        for index in 0..16 {
            slam.step(&look(index)).unwrap();
        }
        slam.bend(|pose| Pose2::new(1.2 * pose.x, pose.y, pose.yaw)).unwrap();
        assert!(slam.step(&look(16)).unwrap().is_inserted);
        let growing = &slam.submaps[slam.active()..];
        assert_eq!(growing.len(), 2);
        for submap in growing {
            let way = STEP * f64::from(16 - u32::try_from(submap.anchor).unwrap());
            let last = submap.inserted.last().unwrap();
            assert!((last.x - way).abs() < 0.02, "{last:?} instead of {way} m");
        }
    }
}

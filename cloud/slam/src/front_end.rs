//! Front end. Where is the robot, by its newest scan and its odometry, and does the map take the scan in?
//!
//! A scan is matched to the older of the two growing submaps. Farther from the last node than a given way it becomes a node of the graph,
//! which the back end holds.

use std::sync::Arc;

use nalgebra::{Matrix3, Point2};
use zenav_pose_graph::{Edge, EdgeKind};
use zenav_protocol::geometry::Pose2;
use zenav_scan_matching::{LikelihoodField, Prior, Refinable, Refined, Window, floored, judge, search, turned};

use crate::closure::close;
use crate::joining::locate;
use crate::slam::{Slam, Stand};
use crate::step::{Effects, SlamError};
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

impl Slam {
    /// Begins the map with its first scan.
    pub(crate) fn begin(
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

    /// Matches a scan near the last node, without making it a node.
    pub(crate) fn track(&mut self, stamp: f64, step: Pose2, seen: Vec<Point2<f64>>, laser: Point2<f64>) -> Effects {
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

    /// Makes a scan a node, unless it contradicts the map. A scan that `is_near` the last node, or of a lost robot, becomes a node only if
    /// it fits.
    pub(crate) fn insert(
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

    /// Half widths of the search window of a doubtful match, m and rad.
    fn window(&self) -> (f64, f64) {
        let front = &self.settings.front;
        let unseen = f64::from(self.unseen);
        let turn = front.search_turn + unseen * front.turn;
        (front.reach + unseen * front.distance, turn.min(std::f64::consts::PI))
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

    /// Whether the robot was carried between the present scan and the one before.
    fn is_carried(&self, laser: Point2<f64>, seen: &[Point2<f64>]) -> bool {
        self.doubt.heeds(seen.len().min(self.last_seen.points_before()))
            && self.last_seen.is_elsewhere(laser, seen, &self.settings)
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
}

/// Half of chi squared of a pose against odometry, bounded.
fn unlikely(odometry: &Prior, pose: Pose2) -> f64 {
    (0.5 * odometry.chi_squared(pose)).min(SLIPPED)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_fixtures::{robot, scan, sweep_in_room};
    use zenav_protocol::messages::Scan;
    use zenav_protocol::settings::Settings;

    use super::*;
    use crate::settings::SlamSettings;

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

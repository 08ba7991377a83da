//! Resume. Finds the pose of the present session in the older map.

use nalgebra::{Matrix3, Point2, Vector3};
use zenav_pose_graph::GraphError;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Scan;
use zenav_scan_matching::points;

use super::join::{closures, joined};
use super::overview::Overview;
use super::vote::{Vote, count};
use crate::closure::{AMBIGUOUS, Around, DOUBT, Seen, seen_again};
use crate::session::{laser_of, on_grid};
use crate::slam::Slam;
use crate::step::{Effects, SlamError};
use crate::submap::Scans;

/// Least number of searches that agree when no start is given.
const VOTES: usize = 2;
/// Largest error of a given start, m and rad.
const AROUND: (f64, f64) = (1.0, 0.5);
/// Budget of the search around a start, in closure budgets: its window is that much larger.
const BUDGET: usize = 4;

/// The map of earlier sessions, in which the present one has not been found yet.
#[derive(Clone, Debug)]
pub(crate) struct Older {
    slam: Slam,
    overview: Overview,
    /// The session's pose, `older_from_session`, if it was given.
    start: Option<Pose2>,
    /// The places that each search so far allows.
    searches: Vec<Vec<Vote>>,
}

impl Older {
    /// The given start, as long as the session is searched for around it: until its first submap has grown.
    fn start_of(&self, session: &Slam) -> Option<Pose2> {
        self.start.filter(|_| session.submaps.len() < 2)
    }
}

impl Slam {
    /// Begins the next session in this map: another drive, with fresh odometry, somewhere in the same building.
    ///
    /// `start`: `map_from_base` at its first scan to within 1 m and 0.5 rad, if known. Without it the whole map is searched each time the
    /// session begins a submap. The session is found where two searches agree on a place, no other place has more than half as many votes,
    /// its scans are explained, and its beams pass through no walls. Until then the session is a map of its own, and [`Self::is_located`]
    /// is false: [`Self::trajectory`], [`Self::graph`], [`Self::nodes`] and the certificate of [`Self::finish`] cover the session alone, in
    /// the frame of its first scan. When it is found, [`Effects::moved`](crate::Effects::moved) leads from that frame into the map's, and
    /// both become one graph. Every scan of the session is kept for its finish, of a map made beside a robot too. Measurements by GPS and
    /// compass are dropped.
    ///
    /// ```
    #[doc = include_str!("../doc_setup/mapped_room.txt")]
    /// use zenav_slam::SessionError;
    ///
    /// assert_eq!((slam.sessions(), slam.is_located()), (vec![9], true));
    /// let next = slam.begin_session(None);
    /// assert!(!next.is_located() && next.is_searched_everywhere());
    /// assert_eq!(next.save(), Err(SessionError::Unlocated));
    /// # Ok::<(), zenav_slam::SlamError>(())
    /// ```
    #[must_use]
    pub fn begin_session(mut self, start: Option<Pose2>) -> Self {
        // The finish of their session has placed them.
        for stand in &mut self.stands {
            stand.points = Vec::new();
        }
        if self.scans.is_empty() {
            self.keeps_all = true;
            return self;
        }
        self.back_end.drop_factors();
        Self::new(self.settings).in_older(self, start)
    }

    fn in_older(self, older: Self, start: Option<Pose2>) -> Self {
        Self {
            older: Some(Box::new(Older {
                overview: Overview::new(&older),
                slam: older,
                start,
                searches: Vec::new(),
            })),
            ..self
        }
    }

    /// Continues where the robot was carried to: `map_from_base` at this scan, to within 1 m and 0.5 rad. The drive from there is a new
    /// session, joined to the others at once. `None` if the scan does not confirm the place.
    ///
    /// # Errors
    /// As [`Self::step`].
    pub fn go_on_at(&self, map_from_base: Pose2, scan: &Scan) -> Result<Option<(Self, Effects)>, SlamError> {
        if self.scans.is_empty() || !self.is_located() || !self.is_seen_from(map_from_base, scan) {
            return Ok(None);
        }
        // The certainty of a closure.
        let front = &self.settings.front;
        let variance = Vector3::new(front.floor, front.floor, front.floor_turn).map(|sigma| (DOUBT * sigma).powi(2));
        let mut odometry = self.odometry;
        odometry.begin_anew(&Matrix3::from_diagonal(&variance.map(f64::recip)));
        let session = Self {
            keeps_all: self.keeps_all,
            usual: self.usual,
            odometry,
            ..Self::new(self.settings)
        };
        let mut slam = session.in_older(self.clone(), Some(map_from_base));
        let effects = slam.step(scan)?;
        // The session's first frame was never published.
        let effects = Effects {
            moved: None,
            covariance: Some(Matrix3::from_diagonal(&variance)),
            ..effects
        };
        Ok(slam.is_located().then_some((slam, effects)))
    }

    /// Whether the present session has been found in the map it began in; true for the first session.
    #[must_use]
    pub fn is_located(&self) -> bool {
        self.older.is_none()
    }

    /// Whether the session is being searched for in the whole older map: no start was given, or the first scans did not confirm it.
    #[must_use]
    pub fn is_searched_everywhere(&self) -> bool {
        let older = self.older.as_deref();
        older.is_some_and(|older| older.start_of(self).is_none())
    }

    /// Number of nodes of each session, in order; nodes of one session are consecutive.
    #[must_use]
    pub fn sessions(&self) -> Vec<usize> {
        self.sessions.iter().map(|session| session.nodes).collect()
    }

    /// Origin of the beams of a node's scan in the base frame, m.
    #[must_use]
    pub fn laser_of(&self, node: usize) -> Point2<f64> {
        laser_of(&self.sessions, node)
    }
}

impl Slam {
    /// Whether the submap around a pose has seen what a scan sees, within the error allowed for a start.
    fn is_seen_from(&self, map_from_base: Pose2, scan: &Scan) -> bool {
        let Some(index) = self.nearest_submap(map_from_base).filter(|_| scan.is_sane()) else {
            return false;
        };
        let mut submap = self.submaps[index].clone();
        let expected = self.nodes()[submap.anchor].inverse() * map_from_base;
        let around = Around {
            reach: AROUND.0,
            turn: AROUND.1,
            budget: BUDGET * self.settings.closure.budget as usize,
            far_margin: AMBIGUOUS,
        };
        let seen = on_grid(points(scan, Pose2::IDENTITY, 0.0, &self.settings.scan));
        let laser = scan.base_from_laser.position();
        let scans = Scans {
            sessions: &self.sessions,
            points: &self.scans,
        };
        let seen = seen_again(&mut submap, scans, expected, around, laser, &seen, &self.settings);
        matches!(seen, Seen::At(..))
    }

    /// The submap whose middle is nearest to a pose in the map, if one is near.
    pub(crate) fn nearest_submap(&self, pose: Pose2) -> Option<usize> {
        let distances = self
            .submaps
            .iter()
            .map(|submap| self.nodes()[submap.middle()].distance(&pose));
        let (index, distance) = distances.enumerate().min_by(|(_, a), (_, b)| a.total_cmp(b))?;
        (distance <= self.settings.closure.near).then_some(index)
    }
}

/// Searches for the session in the older map, and joins both when it is found. `is_half`: whether the newest submap has just begun. Returns
/// how the session moved, `older_from_session`.
pub(crate) fn locate(slam: &mut Slam, is_half: bool) -> Result<Option<Pose2>, GraphError> {
    let Some(mut older) = slam.older.take() else {
        return Ok(None);
    };
    // A submap that has only begun says too little, unless the place to search is known.
    let start = older.start_of(slam);
    if !is_half && start.is_none() {
        slam.older = Some(older);
        return Ok(None);
    }
    let submap = &slam.submaps[slam.submaps.len().saturating_sub(2)];
    let around = start.map(|start| (start * slam.nodes()[0].inverse(), AROUND.0, AROUND.1));
    let places = older.overview.places(&older.slam, slam, submap, around);
    let counted = if start.is_some() {
        count(std::slice::from_ref(&places)).filter(|counted| counted.second == 0)
    } else {
        older.searches.push(places);
        count(&older.searches).filter(|counted| counted.votes >= VOTES && 2 * counted.second <= counted.votes)
    };
    let Some(counted) = counted else {
        slam.older = Some(older);
        return Ok(None);
    };
    let found = closures(&mut older.slam, slam, counted.best.map_from_other);
    if found.is_empty() {
        slam.older = Some(older);
        return Ok(None);
    }
    let session = std::mem::replace(slam, Slam::new(older.slam.settings));
    *slam = joined(older.slam, session, counted.best.map_from_other, &found)?;
    Ok(Some(counted.best.map_from_other))
}

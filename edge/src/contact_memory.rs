//! Contact memory. What has the robot touched that no beam shows? Glass, the edge of a table, a low step.
//!
//! A contact is remembered if beams measured while it lasts pass through the touched place, and nothing near it is seen or moves. A contact
//! shows one point of a surface, and its direction: the surface is assumed straight, and three times as wide as the robot's radius. The next
//! contact beyond an end shows that it is wider: it is then assumed to go on at both ends by the length assumed by now, so that few contacts
//! find the way round a wide pane (after Bentley and Yao, "An almost optimal algorithm for unbounded searching", Information Processing
//! Letters 5, 1976).
//!
//! Known are the places of the contacts, and the surface between two of them if the robot does not fit through: a wider gap may be an open
//! door. The rest is assumed for a minute after the last contact, unless set.
//!
//! Surfaces are kept in the odometry frame. A surface is forgotten ten minutes after the last contact with it, unless set, and when the robot
//! is far away or was found anew; points of it are forgotten when the robot's body passes over them without contact.

use std::collections::VecDeque;
use std::f64::consts::FRAC_PI_4;

use nalgebra::{Isometry2, Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;

use crate::field_of_view::rigid;
use crate::settings::ContactMemorySettings;

/// Most surfaces remembered; the oldest is dropped first. Also the most lines reported.
const MOST: usize = 32;
/// Longest surface, m.
const LONGEST: f64 = 8.0;
/// Half the width of a surface after one contact, in circumscribed radii of the robot.
const HALF_WIDTH: f64 = 1.5;
/// Spacing of the points of a surface, m.
const SPACING: f64 = 0.05;
/// A surface is reported until this long after the last contact, s: later, odometry may have drifted.
const REPORTED: f64 = 20.0;
/// The robot has passed over a point that lies this deep inside its outline, m: odometry drifts.
const PASSED_OVER: f64 = 0.05;
/// A contact this near to a known surface, or to the last contact, is the same again, m.
const SAME: f64 = 0.1;
/// A contact is with the same surface, farther along, if it lies this near to its end, m, and both directions differ by at most this, rad.
const FARTHER: (f64, f64) = (2.0, 0.5);
/// Beams that pass a contact are this far behind it, m.
const BEHIND: f64 = 0.05;
/// The bumper is read after the sweeps of a tick: a contact felt this long before a sweep began still lasted then, s.
const LATELY: f64 = 0.1;
/// A return this near to the outline, m, in this angle to either side of the contact, rad, shows what was touched: a bumper tells the bearing
/// by sectors, and a leg stands behind its foot.
const SHOWN: (f64, f64) = (0.15, FRAC_PI_4);

/// A contact that no sweep has judged yet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Contact {
    /// The touched place, odometry frame.
    pub(crate) place: Point2<f64>,
    /// Normal of the robot's outline there, odometry frame.
    normal: Vector2<f64>,
    began: Stamp,
    /// When it was last felt, and where the robot was.
    felt: Stamp,
    base_from_odom: Isometry2<f64>,
}

impl Contact {
    /// A place just behind the touched one.
    pub(crate) fn behind(&self) -> Point2<f64> {
        self.place + self.normal * BEHIND
    }
}

/// A straight surface. Places on it are given by their offset from where it was touched first, m.
#[derive(Clone, Debug)]
struct Surface {
    /// Where it was touched first, odometry frame.
    touched: Point2<f64>,
    /// Its direction.
    along: Vector2<f64>,
    /// What is known of it: the lowest and the highest offset of each part.
    known: Vec<[f64; 2]>,
    /// How far it is assumed to go; `None` once that is forgotten.
    assumed: Option<[f64; 2]>,
    /// Points on it, odometry frame.
    points: Vec<Point2<f64>>,
    /// When it was last felt.
    felt: Stamp,
    /// Whether the robot has passed over some of its points.
    is_passed: bool,
}

impl Surface {
    fn new(
        (touched, along): (Point2<f64>, Vector2<f64>),
        known: Vec<[f64; 2]>,
        [low, high]: [f64; 2],
        felt: Stamp,
    ) -> Self {
        let steps = ((high - low) / SPACING).ceil().max(1.0);
        let point = |nth: u32| touched + along * (low + (high - low) * f64::from(nth) / steps);
        Self {
            touched,
            along,
            known,
            assumed: Some([low, high]),
            points: (0..=steps as u32).map(point).collect(),
            felt,
            is_passed: false,
        }
    }

    fn at(&self, offset: f64) -> Point2<f64> {
        self.touched + self.along * offset
    }

    /// Its lowest and highest offset.
    fn ends(&self) -> [f64; 2] {
        let hull = |[low, high]: [f64; 2], part: &[f64; 2]| [low.min(part[0]), high.max(part[1])];
        self.assumed.unwrap_or_else(|| self.known.iter().fold([0.0; 2], hull))
    }

    /// Distance from a place, m.
    fn distance(&self, place: Point2<f64>) -> f64 {
        let [low, high] = self.ends();
        let offset = (place - self.touched).dot(&self.along);
        (place - self.at(offset.max(low).min(high))).norm()
    }

    /// The same surface with a contact on it; `None` if it would be too long.
    fn touched_again(&self, contact: &Contact, size: Size) -> Option<Self> {
        let at = (contact.place - self.touched).dot(&self.along);
        let [low, high] = self.ends();
        let more = if self.assumed.is_none() { size.half } else { 0.0 };
        let ends = [low.min(at) - more, high.max(at) + more];
        let known = with(self.known.iter().copied(), at, size.gap);
        (ends[1] - ends[0] <= LONGEST).then(|| Self::new((self.touched, self.along), known, ends, contact.felt))
    }

    /// The same surface with a contact beyond one of its ends; `None` if that contact is with another surface.
    fn extended(&self, contact: &Contact, size: Size) -> Option<Self> {
        let along = (contact.place - self.touched).try_normalize(SAME)?;
        let is_along = |direction: Vector2<f64>| direction.dot(&along).abs() >= FARTHER.1.cos() * direction.norm();
        let across = Vector2::new(-contact.normal.y, contact.normal.x);
        // It would no longer lie where it was touched.
        let moves = |offset: &f64| (offset * self.along.perp(&along)).abs() > SAME;
        if self.distance(contact.place) > FARTHER.0
            || !is_along(self.along)
            || !is_along(across)
            || self.known.iter().flatten().any(moves)
        {
            return None;
        }
        let turned = self.along.dot(&along);
        let on_it = |[a, b]: [f64; 2]| [(a * turned).min(b * turned), (a * turned).max(b * turned)];
        let at = (contact.place - self.touched).norm();
        let [low, high] = on_it(self.ends());
        let (low, high) = (low.min(at), high.max(at));
        let room = LONGEST - (high - low);
        let more = (high - low).max(size.half).min(0.5 * room);
        let known = with(self.known.iter().map(|part| on_it(*part)), at, size.gap);
        (room >= 0.0).then(|| Self::new((self.touched, along), known, [low - more, high + more], contact.felt))
    }

    /// Forgets what is only assumed.
    fn forget_assumed(&mut self) {
        self.assumed = None;
        let (touched, along, known) = (self.touched, self.along, &self.known);
        self.points.retain(|point| {
            let at = (point - touched).dot(&along);
            known
                .iter()
                .any(|[low, high]| (low - SPACING..=high + SPACING).contains(&at))
        });
    }
}

/// Adds a contact to the known parts of a surface, and joins those with less than this gap between them, m.
fn with(known: impl Iterator<Item = [f64; 2]>, at: f64, gap: f64) -> Vec<[f64; 2]> {
    let (mut joined, mut parts) = ([at, at], Vec::new());
    for part in known {
        if part[0] - joined[1] < gap && joined[0] - part[1] < gap {
            joined = [joined[0].min(part[0]), joined[1].max(part[1])];
        } else {
            parts.push(part);
        }
    }
    parts.push(joined);
    parts
}

/// What a contact tells of the size of a surface, m.
#[derive(Clone, Copy, Debug)]
struct Size {
    /// Half the width assumed after one contact.
    half: f64,
    /// The robot fits through no gap narrower than this.
    gap: f64,
}

/// What the robot has touched that no beam shows.
#[derive(Clone, Debug)]
pub(crate) struct ContactMemory {
    footprint: Footprint,
    /// Surfaces farther from the robot are forgotten, m.
    range: f64,
    settings: ContactMemorySettings,
    contact: Option<Contact>,
    surfaces: VecDeque<Surface>,
}

impl ContactMemory {
    /// Nothing touched yet.
    pub(crate) fn new(footprint: &Footprint, range: f64, settings: ContactMemorySettings) -> Self {
        Self {
            footprint: footprint.clone(),
            range,
            settings,
            contact: None,
            surfaces: VecDeque::new(),
        }
    }

    /// Without any contact: forgets surfaces that are old or far, what was assumed long ago, and points that the robot has passed over.
    pub(crate) fn forget(&mut self, now: Stamp, odom_from_base: Pose2) {
        let (odom_from_base, footprint, range) = (rigid(odom_from_base), &self.footprint, self.range);
        let ContactMemorySettings { memory, assumed } = self.settings;
        let (here, base_from_odom) = (odom_from_base * Point2::origin(), odom_from_base.inverse());
        self.surfaces.retain_mut(|surface| {
            if surface.assumed.is_some() && now.secs_since(surface.felt) > assumed {
                surface.forget_assumed();
            }
            let before = surface.points.len();
            surface
                .points
                .retain(|point| footprint.depth(base_from_odom * point) <= PASSED_OVER);
            surface.is_passed |= surface.points.len() < before;
            now.secs_since(surface.felt) <= memory && surface.distance(here) <= range && !surface.points.is_empty()
        });
    }

    /// Forgets everything: odometry does not tell where the robot has been.
    pub(crate) fn clear(&mut self) {
        self.contact = None;
        self.surfaces.clear();
    }

    /// Takes the present contact point, base frame.
    pub(crate) fn touch(&mut self, now: Stamp, touched: Point2<f64>, odom_from_base: Pose2) {
        let odom_from_base = rigid(odom_from_base);
        let (place, base_from_odom) = (odom_from_base * touched, odom_from_base.inverse());
        for known in &mut self.surfaces {
            if known.distance(place) <= SAME {
                known.felt = now;
            }
        }
        match &mut self.contact {
            Some(contact) if (contact.place - place).norm() <= SAME => {
                (contact.felt, contact.base_from_odom) = (now, base_from_odom);
            }
            contact => {
                *contact = Some(Contact {
                    place,
                    normal: odom_from_base * normal(&self.footprint, touched),
                    began: now,
                    felt: now,
                    base_from_odom,
                });
            }
        }
    }

    /// The contact that a sweep begun at this time can judge: it had begun before, and lasted until then.
    pub(crate) fn lasting(&mut self, begun: Stamp) -> Option<Contact> {
        self.contact = self.contact.filter(|contact| begun.secs_since(contact.felt) <= LATELY);
        self.contact.filter(|contact| contact.began <= begun)
    }

    /// Whether a return at a place (odometry frame) may be on what was touched.
    pub(crate) fn is_shown_at(&self, contact: &Contact, place: Point2<f64>) -> bool {
        let [touched, at] = [contact.place, place].map(|place| contact.base_from_odom * place);
        self.footprint.distance(at) <= SHOWN.0 && at.coords.angle(&touched.coords) <= SHOWN.1
    }

    /// Remembers what was touched: no beam shows it.
    pub(crate) fn remember(&mut self, contact: &Contact) {
        self.contact = None;
        let size = Size {
            half: HALF_WIDTH * self.footprint.circumscribed_radius(),
            gap: 2.0 * self.footprint.inscribed_radius(),
        };
        if let Some(known) = self
            .surfaces
            .iter_mut()
            .find(|surface| surface.distance(contact.place) <= SAME)
        {
            if let Some(surface) = known.touched_again(contact, size) {
                *known = surface;
            }
            return;
        }
        for known in &mut self.surfaces {
            if let Some(surface) = known.extended(contact, size) {
                *known = surface;
                return;
            }
        }
        if self.surfaces.len() == MOST {
            self.surfaces.pop_front();
        }
        let across = Vector2::new(-contact.normal.y, contact.normal.x);
        let ends = [-size.half, size.half];
        self.surfaces.push_back(Surface::new(
            (contact.place, across),
            vec![[0.0; 2]],
            ends,
            contact.felt,
        ));
    }

    /// Points on the remembered surfaces, odometry frame.
    pub(crate) fn points(&self) -> impl Iterator<Item = &Point2<f64>> {
        self.surfaces.iter().flat_map(|surface| &surface.points)
    }

    /// What the map is to know of surfaces touched lately that the robot has not passed over: each known part, and how far its surface is
    /// assumed to go; x and y of either end, m, in the base frame of a robot at `odom_from_base`.
    pub(crate) fn lines(&self, now: Stamp, odom_from_base: Pose2) -> Vec<[[f64; 4]; 2]> {
        let base_from_odom = rigid(odom_from_base).inverse();
        let is_reported = |surface: &&Surface| now.secs_since(surface.felt) <= REPORTED && !surface.is_passed;
        let newest = self.surfaces.iter().rev().filter(is_reported);
        let lines = newest.flat_map(|surface| {
            let line = move |ends: [f64; 2]| {
                let [a, b] = ends.map(|offset| base_from_odom * surface.at(offset));
                [a.x, a.y, b.x, b.y]
            };
            surface
                .known
                .iter()
                .map(move |part| [line(*part), line(surface.ends())])
        });
        lines.take(MOST).collect()
    }
}

/// Outward normal of an outline at a point just outside it, base frame.
fn normal(footprint: &Footprint, touched: Point2<f64>) -> Vector2<f64> {
    const STEP: f64 = 1e-3;
    // Not at the outline itself: beside a corner the normal would depend on the last bit.
    let outside = touched + touched.coords.try_normalize(1e-6).unwrap_or_else(Vector2::x) * 0.02;
    let slope = |along: Vector2<f64>| footprint.distance(outside + along) - footprint.distance(outside - along);
    let gradient = Vector2::new(slope(Vector2::x() * STEP), slope(Vector2::y() * STEP));
    gradient.try_normalize(1e-9).unwrap_or_else(Vector2::x)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use super::*;

    /// Radius of the robot, m.
    const RADIUS: f64 = 0.3;

    /// Of surfaces up to this far from the robot, m.
    fn within(range: f64) -> ContactMemory {
        ContactMemory::new(&Footprint::Radius(RADIUS), range, ContactMemorySettings::default())
    }

    fn memory() -> ContactMemory {
        within(3.0)
    }

    /// The robot at a pose touches something straight ahead, and a sweep shows nothing there.
    fn touch(memory: &mut ContactMemory, secs: f64, at: Pose2) {
        let now = Stamp::from_secs(secs);
        memory.touch(now, Point2::new(RADIUS + 1e-3, 0.0), at);
        if let Some(contact) = memory.lasting(now.plus_secs(0.05)) {
            memory.remember(&contact);
        }
    }

    /// Where the known parts, and the surfaces that are assumed, begin and end along y at a time.
    fn spans(memory: &ContactMemory, secs: f64) -> Vec<[[f64; 2]; 2]> {
        let lines = memory.lines(Stamp::from_secs(secs), Pose2::IDENTITY).into_iter();
        lines
            .map(|parts| parts.map(|[_, a, _, b]| [a.min(b), a.max(b)]))
            .collect()
    }

    /// Where the points begin and end along y.
    fn reach(memory: &ContactMemory) -> [f64; 2] {
        let along = memory.points().map(|point| point.y);
        along.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], y| {
            [low.min(y), high.max(y)]
        })
    }

    fn are_near(a: [f64; 2], b: [f64; 2]) -> bool {
        (a[0] - b[0]).abs() < 0.01 && (a[1] - b[1]).abs() < 0.01
    }

    #[test]
    fn a_contact_is_a_surface_across_it_and_the_next_one_makes_that_longer_at_both_ends() {
        let mut memory = memory();
        touch(&mut memory, 1.0, Pose2::IDENTITY);
        let [[known, assumed]] = spans(&memory, 1.0)[..] else {
            panic!("{memory:?}")
        };
        assert!(are_near(known, [0.0; 2]) && are_near(assumed, [-0.45, 0.45]));
        assert!(memory.points().all(|point| (point.x - RADIUS).abs() < 0.01));
        // On the same surface: more of it is known.
        touch(&mut memory, 2.0, Pose2::new(0.0, 0.2, 0.0));
        let [[known, same]] = spans(&memory, 2.0)[..] else {
            panic!("{memory:?}")
        };
        assert!(are_near(known, [0.0, 0.2]) && are_near(same, assumed), "{known:?}");
        touch(&mut memory, 9.0, Pose2::new(0.0, 0.7, 0.0));
        let [[known, assumed]] = spans(&memory, 9.0)[..] else {
            panic!("{memory:?}")
        };
        assert!(
            are_near(known, [0.0, 0.7]) && are_near(assumed, [-0.45 - 1.15, 0.7 + 1.15]),
            "{known:?} {assumed:?}"
        );
        // Something else, across.
        touch(&mut memory, 20.0, Pose2::new(-0.5, 1.0, std::f64::consts::FRAC_PI_2));
        assert_eq!(memory.surfaces.len(), 2);
    }

    #[test]
    fn what_is_only_assumed_is_forgotten_and_a_door_between_two_contacts_is_never_known_to_be_shut() {
        let mut memory = memory();
        touch(&mut memory, 1.0, Pose2::IDENTITY);
        touch(&mut memory, 9.0, Pose2::new(0.0, 1.2, 0.0));
        assert_eq!(memory.surfaces.len(), 1);
        let mut known: Vec<_> = spans(&memory, 9.0).into_iter().map(|[known, _]| known).collect();
        known.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert!(
            matches!(known[..], [a, b] if are_near(a, [0.0; 2]) && are_near(b, [1.2; 2])),
            "{known:?}"
        );
        let away = Pose2::new(-2.0, 0.0, 0.0);
        memory.forget(Stamp::from_secs(68.0), away);
        assert!(memory.points().any(|point| (point.y - 0.6).abs() < 0.1));
        memory.forget(Stamp::from_secs(70.0), away);
        assert!(reach(&memory)[0] > -0.1 && reach(&memory)[1] < 1.3 && memory.points().count() > 1);
        assert!(memory.points().all(|point| (point.y - 0.6).abs() > 0.3), "the door");
        // Touched once more beside it, it is assumed to go on.
        touch(&mut memory, 80.0, Pose2::new(0.0, 0.05, 0.0));
        assert!(are_near(reach(&memory), [-0.45, 1.65]), "{:?}", reach(&memory));
    }

    #[test]
    fn a_contact_that_would_turn_what_is_known_is_with_another_surface() {
        let mut memory = memory();
        touch(&mut memory, 1.0, Pose2::IDENTITY);
        touch(&mut memory, 5.0, Pose2::new(0.0, 0.5, 0.0));
        touch(&mut memory, 9.0, Pose2::new(0.0, 1.0, 0.0));
        assert_eq!(memory.surfaces.len(), 1);
        // Beyond its end, 0.4 m aside: the place touched at y = 1 would move by 0.12 m.
        touch(&mut memory, 20.0, Pose2::new(0.4, 3.2, 0.0));
        assert_eq!(memory.surfaces.len(), 2);
    }

    #[test]
    fn it_is_reported_for_a_short_while_and_not_where_the_robot_has_passed() {
        let mut memory = memory();
        touch(&mut memory, 1.0, Pose2::IDENTITY);
        assert_eq!(spans(&memory, 20.0).len(), 1);
        assert_eq!(spans(&memory, 22.0).len(), 0);
        memory.forget(Stamp::from_secs(2.0), Pose2::new(0.3, 0.4, 0.0));
        assert_eq!(spans(&memory, 2.0).len(), 0);
        assert!(memory.points().count() > 0, "where it was not");
        memory.clear();
        assert_eq!(memory.points().count(), 0);
    }

    #[test]
    fn both_times_until_it_is_forgotten_are_settings() {
        let settings = ContactMemorySettings {
            memory: 100.0,
            assumed: 5.0,
        };
        let mut memory = ContactMemory::new(&Footprint::Radius(RADIUS), 3.0, settings);
        touch(&mut memory, 1.0, Pose2::IDENTITY);
        let away = Pose2::new(-2.0, 0.0, 0.0);
        memory.forget(Stamp::from_secs(5.0), away);
        assert!(reach(&memory)[1] > 0.4);
        memory.forget(Stamp::from_secs(7.0), away);
        assert!(reach(&memory)[1] < 0.1, "what was only assumed");
        assert!(memory.points().count() > 0);
        memory.forget(Stamp::from_secs(102.0), away);
        assert_eq!(memory.points().count(), 0);
    }

    #[test]
    fn it_is_forgotten_after_a_long_time_far_away_and_where_the_robot_s_body_has_been() {
        let left = |secs: f64, at: Pose2| {
            let mut memory = memory();
            touch(&mut memory, 1.0, Pose2::IDENTITY);
            let all = memory.points().count();
            memory.forget(Stamp::from_secs(secs), at);
            (memory.points().count(), all)
        };
        assert!(left(600.0, Pose2::new(-2.0, 0.0, 0.0)).0 > 0);
        assert_eq!(left(602.0, Pose2::new(-2.0, 0.0, 0.0)).0, 0);
        assert_eq!(left(10.0, Pose2::new(-3.0, 0.0, 0.0)).0, 0);
        let (drifted, all) = left(10.0, Pose2::new(0.04, 0.0, 0.0));
        assert_eq!(drifted, all, "odometry drifts");
        let (beside, all) = left(10.0, Pose2::new(0.3, 0.4, 0.0));
        assert!(0 < beside && beside < all, "{beside} of {all}");
    }

    #[test]
    fn a_contact_that_ended_before_the_sweep_began_is_not_judged_by_it() {
        let mut memory = memory();
        let at = |secs: f64| Stamp::from_secs(secs);
        memory.touch(at(1.0), Point2::new(0.301, 0.0), Pose2::IDENTITY);
        assert!(memory.lasting(at(0.95)).is_none(), "it began during the sweep");
        assert!(memory.lasting(at(1.05)).is_some());
        assert!(memory.lasting(at(1.2)).is_none());
    }

    #[test]
    fn a_return_beside_the_outline_about_where_the_bumper_tells_shows_what_was_touched() {
        let mut memory = memory();
        memory.touch(Stamp::from_secs(1.0), Point2::new(0.301, 0.0), Pose2::IDENTITY);
        let contact = memory.lasting(Stamp::from_secs(1.05)).unwrap();
        let is_shown = |x: f64, y: f64| memory.is_shown_at(&contact, Point2::new(x, y));
        assert!(is_shown(0.31, 0.0) && is_shown(0.44, 0.0), "a leg behind a foot");
        assert!(is_shown(0.27, 0.16), "30 degrees off");
        assert!(!is_shown(0.5, 0.0) && !is_shown(0.0, 0.31) && !is_shown(-0.31, 0.0));
    }

    #[test]
    fn the_number_of_surfaces_is_bounded_and_the_oldest_is_dropped() {
        let mut memory = within(1000.0);
        for nth in 0..40_u32 {
            touch(&mut memory, f64::from(nth), Pose2::new(0.0, 4.0 * f64::from(nth), 0.0));
        }
        assert_eq!(memory.surfaces.len(), MOST);
        let oldest = reach(&memory)[0];
        assert!((oldest - (8.0 * 4.0 - 0.45)).abs() < 0.01, "{oldest}");
    }

    #[test]
    fn a_surface_grows_no_longer_than_is_sensible() {
        let mut memory = within(1000.0);
        for nth in 0..400_u32 {
            touch(
                &mut memory,
                0.1 * f64::from(nth),
                Pose2::new(0.0, 0.08 * f64::from(nth), 0.0),
            );
        }
        let longest = |surface: &Surface| surface.ends()[1] - surface.ends()[0];
        assert!(memory.surfaces.iter().all(|surface| longest(surface) <= LONGEST + 1e-9));
        assert!(memory.points().count() <= MOST * ((LONGEST / SPACING) as usize + 2));
    }

    #[test]
    fn a_corner_is_touched_by_a_surface_that_only_touches_the_robot() {
        let corners = [(-0.2, -0.15), (0.2, -0.15), (0.2, 0.15), (-0.2, 0.15)];
        let footprint = Footprint::Polygon(corners.map(|(x, y)| Point2::new(x, y)).to_vec());
        assert!((normal(&footprint, Point2::new(0.201, 0.05)) - Vector2::x()).norm() < 1e-6);
        let corner = normal(&footprint, Point2::new(0.2008, 0.1506));
        let into = corners.map(|(x, y)| (Point2::new(x, y) - Point2::new(0.2008, 0.1506)).dot(&corner));
        assert!(into.iter().all(|off| *off <= 0.0), "{corner:?}");
    }
}

//! Other robots. Where will the robots be that announce their course ([`Intent`]), and which of them give way to this one?
//!
//! Each becomes a track with a known future ([`crate::obstacle_tracks`]) while its messages arrive. A robot that is silent or parked is
//! only what a lidar sees of it. Clocks of two robots are never compared: a message holds from its arrival. All robots share one map frame;
//! numbers of map frames are not compared either, as each robot's mapping counts its own.

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::messages::Intent;
use zenav_protocol::time::Stamp;

use crate::course::Course;
use crate::obstacle_tracks::Track;

/// Most robots tracked: the nearest.
const MOST: usize = 64;
/// A robot silent for longer than this is forgotten, s.
const SILENT: f64 = 1.0;
/// First id of the tracks of robots: ids of lidar tracks never get this high.
const FIRST_ID: u64 = 1 << 48;

/// The robots whose messages this one receives.
#[derive(Clone, Debug, Default)]
pub struct OtherRobots {
    own: String,
    /// In the order of their names.
    heard: Vec<(Stamp, Intent)>,
}

impl OtherRobots {
    /// No robot heard yet; `own` is this robot's name.
    #[must_use]
    pub fn new(own: &str) -> Self {
        Self {
            own: own.to_owned(),
            heard: Vec::new(),
        }
    }

    /// Takes the messages that arrived while this robot is `here` (map frame), and forgets silent robots.
    pub fn receive(&mut self, now: Stamp, here: Point2<f64>, intents: Vec<Intent>) {
        for intent in intents {
            if intent.robot == self.own || !intent.is_sound() {
                continue;
            }
            match self.place_of(&intent.robot) {
                Ok(place) => self.heard[place] = (now, intent),
                Err(_) if self.heard.len() >= MOST && !self.forget_farther(here, &intent) => {}
                Err(_) => {
                    let (Ok(place) | Err(place)) = self.place_of(&intent.robot);
                    self.heard.insert(place, (now, intent));
                }
            }
        }
        self.heard.retain(|(arrived, _)| now.secs_since(*arrived) <= SILENT);
    }

    fn place_of(&self, robot: &str) -> Result<usize, usize> {
        self.heard
            .binary_search_by(|(_, known)| known.robot.as_str().cmp(robot))
    }

    /// Forgets the farthest robot, unless the new one is farther still.
    fn forget_farther(&mut self, here: Point2<f64>, new: &Intent) -> bool {
        let away = |intent: &Intent| (intent.map_from_base.position() - here).norm();
        let heard = self.heard.iter().enumerate();
        let farthest = heard.max_by(|(_, a), (_, b)| away(&a.1).total_cmp(&away(&b.1)));
        let Some(place) = farthest.filter(|(_, (_, known))| away(known) > away(new)) else {
            return false;
        };
        self.heard.remove(place.0);
        true
    }

    /// Their tracks at a time, in the odometry frame; `own` is this robot's own intent.
    pub fn tracks(&self, now: Stamp, own: &Intent, odom_from_map: Pose2) -> impl Iterator<Item = Track> {
        self.heard.iter().zip(FIRST_ID..).map(move |((arrived, intent), id)| {
            let (v, heading) = (intent.velocity.v, (odom_from_map * intent.map_from_base).heading());
            let makes_way = own.goes_before(intent);
            let places = intent.places.iter().map(|place| odom_from_map.transform_point(*place));
            let later = intent.later.iter().map(|place| odom_from_map.transform_point(*place));
            let course = Course {
                places: places.collect(),
                step: intent.step,
                later: later.collect(),
                later_step: intent.later_step,
                begun: now.secs_since(*arrived),
                planned: intent.driving,
                makes_way,
            };
            Track::of_robot(id, intent.radius, heading * v + Vector2::zeros(), now, course)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use zenav_protocol::geometry::Twist2;

    #[test]
    fn a_robot_is_where_it_said_it_would_be_until_it_is_silent_for_long() {
        let mut others = OtherRobots::new("anna");
        let intent = |robot: &str| Intent {
            robot: robot.to_owned(),
            radius: 0.3,
            step: 0.5,
            places: vec![Point2::new(1.0, 0.0), Point2::new(1.5, 0.0), Point2::new(1.5, 0.5)],
            velocity: Twist2::new(1.0, 0.0),
            driving: true,
            ..Intent::default()
        };
        let mut broken = intent("carl");
        broken.radius = f64::NAN;
        others.receive(
            Stamp::from_secs(10.0),
            Point2::origin(),
            vec![intent("anna"), intent("bert"), broken],
        );
        let own = intent("anna");
        let tracks = |others: &OtherRobots, secs| -> Vec<Track> {
            others.tracks(Stamp::from_secs(secs), &own, Pose2::IDENTITY).collect()
        };
        let tracks_now = tracks(&others, 10.25);
        assert_eq!(tracks_now.len(), 1, "neither itself nor what cannot be");
        let bert = &tracks_now[0];
        assert!((bert.position - Point2::new(1.25, 0.0)).norm() < 1e-9);
        assert!((bert.at(0.5) - Point2::new(1.5, 0.25)).norm() < 1e-9);
        assert!((bert.at(9.0) - Point2::new(1.5, 0.5)).norm() < 1e-9);
        assert!(bert.makes_way(), "by name");
        others.receive(Stamp::from_secs(11.5), Point2::origin(), Vec::new());
        assert!(tracks(&others, 11.5).is_empty());
    }

    #[test]
    fn of_too_many_robots_the_nearest_are_heard() {
        let mut others = OtherRobots::new("anna");
        let at = |x: f64| Intent {
            robot: format!("robot-{x}"),
            radius: 0.3,
            step: 0.5,
            map_from_base: Pose2::new(x, 0.0, 0.0),
            places: vec![Point2::new(x, 0.0)],
            ..Intent::default()
        };
        let far = (0..MOST).map(|nth| at(100.0 + nth as f64)).collect();
        others.receive(Stamp::ZERO, Point2::origin(), far);
        others.receive(Stamp::ZERO, Point2::origin(), vec![at(1.0), at(500.0)]);
        let own = at(0.0);
        let places = others.tracks(Stamp::ZERO, &own, Pose2::IDENTITY);
        let places: Vec<f64> = places.map(|track| track.position.x).collect();
        assert_eq!(places.len(), MOST);
        assert!(places.contains(&1.0) && !places.contains(&500.0) && !places.contains(&163.0));
    }
}

//! Referee. Judges a run by the simulator's ground truth: contacts of three kinds, and whether the goal is reached at rest.

use nalgebra::Point2;
use serde::Serialize;
use zenav_protocol::time::Stamp;
use zenav_sim::Truth;

/// A robot is at rest if no point of its outline moves faster, m/s; a contact at a higher own speed is the robot's own.
const AT_REST: f64 = 0.01;
/// A contact this long after the robot's own motion may be due to it, s.
const AFTERWARDS: f64 = 2.0;

/// Cause of a contact.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum ContactKind {
    /// The robot moved towards what it touched at more than 1 cm/s.
    Own,
    /// Touched by something else, within 2 s of the robot's own motion.
    AfterOwnMotion,
    /// Touched by something else after the robot had rested for 2 s.
    AtRest,
}

/// One contact: continuous touching counts once.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ContactReport {
    /// Start of the contact, s.
    pub time_s: f64,
    /// The robot's own speed towards what it touched, m/s; the largest during the contact.
    pub own_speed: f64,
    /// Cause of the contact.
    pub kind: ContactKind,
}

/// Watches one robot on its way to a goal.
#[derive(Clone, Debug)]
pub struct Referee {
    goal: Point2<f64>,
    tolerance: f64,
    /// Radius around the outline, m.
    reach: f64,
    contacts: Vec<ContactReport>,
    entered: Option<f64>,
    /// Time of the robot's last motion, s.
    moved: f64,
    hardest: f64,
    speed: f64,
    error: f64,
}

impl Referee {
    /// A referee for a goal with its tolerance, and a robot whose outline reaches `reach` from its centre, m.
    #[must_use]
    pub fn new(goal: Point2<f64>, tolerance: f64, reach: f64) -> Self {
        Self {
            goal,
            tolerance,
            reach,
            contacts: Vec::new(),
            entered: None,
            moved: f64::NEG_INFINITY,
            hardest: 0.0,
            speed: 0.0,
            error: f64::INFINITY,
        }
    }

    /// Judges the state at the end of a tick.
    pub fn watch(&mut self, now: Stamp, truth: &Truth) {
        let now = now.as_secs();
        if truth.collisions as usize > self.contacts.len() {
            let own_speed = truth.last_contact.map_or(0.0, |contact| contact.own_speed);
            let kind = match () {
                () if own_speed > AT_REST => ContactKind::Own,
                () if now - self.moved <= AFTERWARDS => ContactKind::AfterOwnMotion,
                () => ContactKind::AtRest,
            };
            self.contacts.push(ContactReport {
                time_s: now,
                own_speed,
                kind,
            });
        }
        // A robot that was touched may then push on.
        if let Some(contact) = self
            .contacts
            .last_mut()
            .filter(|_| truth.hardest_contact > self.hardest)
        {
            contact.own_speed = contact.own_speed.max(truth.hardest_contact);
            if contact.own_speed > AT_REST {
                contact.kind = ContactKind::Own;
            }
        }
        self.hardest = truth.hardest_contact;
        self.speed = truth.twist.v.abs() + truth.twist.w.abs() * self.reach;
        if !self.is_at_rest() {
            self.moved = now;
        }
        self.error = (truth.map_from_base.position() - self.goal).norm();
        if self.error <= self.tolerance {
            self.entered.get_or_insert(now);
        }
    }

    /// Whether the robot is at rest.
    #[must_use]
    pub fn is_at_rest(&self) -> bool {
        self.speed <= AT_REST
    }

    /// Whether the robot is at rest within the tolerance of the goal.
    #[must_use]
    pub fn is_reached(&self) -> bool {
        self.error <= self.tolerance && self.is_at_rest()
    }

    /// Distance to the goal, m.
    #[must_use]
    pub fn error(&self) -> f64 {
        self.error
    }

    /// When the robot first came within the tolerance, at any speed, s.
    #[must_use]
    pub fn entered(&self) -> Option<f64> {
        self.entered
    }

    /// All contacts, in order.
    #[must_use]
    pub fn contacts(&self) -> &[ContactReport] {
        &self.contacts
    }

    /// The first contact caused by the robot's own motion.
    #[must_use]
    pub fn own_contact(&self) -> Option<&ContactReport> {
        self.contacts.iter().find(|contact| contact.kind == ContactKind::Own)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::files;
    use zenav_protocol::id::Id;
    use zenav_sim::{RobotSpec, Simulation, World};

    /// The referee of a TIAGo at the origin whose wheels turn at this rate (rad/s) until a time (s), among `things`.
    fn watched(things: &str, goal: [f64; 2], wheels: f64, until: f64) -> Referee {
        let text = format!("size = [12, 6]\norigin = [-6, -3]\n{things}");
        let world = World::from_toml(&text, "w", &|_| Err(String::new())).unwrap();
        let model = files::robot("tiago").unwrap();
        let mut referee = Referee::new(goal.into(), 0.15, model.footprint.circumscribed_radius());
        let id = Id::robot("robot").unwrap();
        let spec = RobotSpec {
            id,
            model,
            start: world.start(),
        };
        let mut simulation = Simulation::new(&world, vec![spec], 1).unwrap();
        for _ in 0..400 {
            let drives = simulation.now().as_secs() < until;
            simulation.drive(0, if drives { [wheels; 2] } else { [0.0; 2] });
            simulation.step();
            referee.watch(simulation.now(), &simulation.truth(0));
        }
        referee
    }

    fn kinds(referee: &Referee) -> Vec<ContactKind> {
        referee.contacts().iter().map(|contact| contact.kind).collect()
    }

    #[test]
    fn a_goal_that_is_driven_through_is_entered_but_not_reached() {
        let through = watched("", [1.0, 0.0], 4.0, 8.0);
        assert!(through.entered().is_some_and(|at| at > 1.0 && at < 4.0) && !through.is_reached());
        let there = watched("", [1.0, 0.0], 2.0, 5.1);
        assert!(there.is_reached() && there.contacts().is_empty(), "{}", there.error());
    }

    #[test]
    fn who_made_a_contact_is_told_by_own_speed_and_own_motion() {
        let wall = "[[wall]]\nfrom = [1, -1]\nto = [1, 1]\nthickness = 0.1\n";
        let own = watched(wall, [3.0, 0.0], 4.0, 8.0);
        assert_eq!(kinds(&own), [ContactKind::Own]);
        assert!(own.own_contact().is_some_and(|contact| contact.own_speed > 0.3));
        let walker = "[[mover]]\nradius = 0.2\npath = [[4, 0], [-6, 0]]\nspeed = 1.0\n";
        assert_eq!(kinds(&watched(walker, [3.0, 0.0], 0.0, 0.0)), [ContactKind::AtRest]);
        assert_eq!(
            kinds(&watched(walker, [3.0, 0.0], 2.0, 2.0)),
            [ContactKind::AfterOwnMotion]
        );
        let late = watched(walker, [3.0, 0.0], 2.0, 0.5);
        assert_eq!(kinds(&late), [ContactKind::AtRest]);
        assert!(late.own_contact().is_none());
    }
}

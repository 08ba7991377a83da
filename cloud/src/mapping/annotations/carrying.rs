//! Carrying. Places and zones stay fixed in the building when the map around them moves.

use serde::{Deserialize, Serialize};
use zenav_protocol::messages::{GoalPoint, MapFrame, Zone};

use super::AnnotationBook;

/// Places and zones that a frame change has moved: name, coordinates as given, and coordinates in the session's frame.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(in crate::mapping) struct Carried {
    places: Vec<(String, GoalPoint, GoalPoint)>,
    zones: Vec<(String, Zone, Zone)>,
    changed_places: Vec<(String, GoalPoint, GoalPoint)>,
    changed_zones: Vec<(String, Zone, Zone)>,
}

/// The items that differ from how they were given; both iterators have the same order.
fn carried<'a, T: Clone + PartialEq + 'a>(
    given: impl Iterator<Item = (&'a String, &'a T)>,
    now: impl Iterator<Item = &'a T>,
) -> Vec<(String, T, T)> {
    let pairs = given.zip(now).filter(|((_, given), now)| given != now);
    pairs
        .map(|((name, given), now)| (name.clone(), given.clone(), now.clone()))
        .collect()
}

/// Moves an item to where it was carried if it is still as given; an item edited since stays as it is.
fn carry<T: Clone + PartialEq>(carried: &[(String, T, T)], name: &str, item: &mut T) {
    let known = carried.iter().find(|(known, given, _)| known == name && given == item);
    if let Some((_, _, now)) = known {
        *item = now.clone();
    }
}

impl AnnotationBook {
    /// Resumes in a frame of the map, with places and zones where the session had carried them.
    pub(in crate::mapping) fn go_on(&mut self, carried: &Carried, frame: u64) {
        for (name, place) in &mut self.base.places {
            carry(&carried.places, name, place);
        }
        for zone in &mut self.base.zones {
            let name = zone.name.clone();
            carry(&carried.zones, &name, zone);
        }
        // An overlay written in this frame already has the right coordinates.
        if self.overlay.frame != frame {
            for (name, place) in &mut self.overlay.places {
                if let Some(place) = place {
                    carry(&carried.changed_places, name, place);
                }
            }
            for (name, zone) in &mut self.overlay.zones {
                if let Some(zone) = zone {
                    carry(&carried.changed_zones, name, zone);
                }
            }
        }
        self.are_in(frame);
    }

    /// Where places and zones were carried, for the stored session.
    pub(in crate::mapping) fn carried(&self) -> Carried {
        let (base, overlay) = &self.given;
        let zones = base.zones.iter().map(|zone| (&zone.name, zone));
        Carried {
            places: carried(base.places.iter(), self.base.places.values()),
            zones: carried(zones, self.base.zones.iter()),
            changed_places: carried(overlay.places(), self.overlay.places().map(|(_, place)| place)),
            changed_zones: carried(overlay.zones(), self.overlay.zones().map(|(_, zone)| zone)),
        }
    }

    /// Keeps places and zones fixed in the building: each moves with the part of the map that it belongs to, a zone as a rigid body.
    pub(in crate::mapping) fn carry_over(&mut self, before: &MapFrame, after: &MapFrame) {
        let is_same = before.map.id == after.map.id;
        let moved = |x: f64, y: f64| is_same.then(|| before.moved_at(x, y, after)).flatten();
        let carry = |place: &mut GoalPoint| {
            if let Some(moved) = moved(place.x, place.y) {
                *place = place.moved(moved);
            }
        };
        let carry_zone = |zone: &mut Zone| {
            let count = zone.points.len().max(1) as f64;
            let middle = zone
                .points
                .iter()
                .fold((0.0, 0.0), |(x, y), point| (x + point.x / count, y + point.y / count));
            if let Some(moved) = moved(middle.0, middle.1) {
                for point in &mut zone.points {
                    *point = moved.transform_point(*point);
                }
            }
        };
        self.base.places.values_mut().for_each(carry);
        self.overlay.places.values_mut().flatten().for_each(carry);
        self.base.zones.iter_mut().for_each(carry_zone);
        self.overlay.zones.values_mut().flatten().for_each(carry_zone);
        self.are_in(after.map.frame);
    }
}

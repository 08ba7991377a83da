//! Covered goal. Does an obstacle in front of the goal extend over it?
//!
//! A lidar sees only the near side of a person, so the floor she stands on looks free, and a goal there seems reachable from behind. The
//! robot assumes that she is as deep as she is wide and waits; after [`linger`](crate::settings::MissionSettings::linger) it drives there
//! to look.

use nalgebra::{Point2, Vector2};

use super::waiting::{ONE_THING, SAME_PLACE};
use super::{NEARBY, Search};
use crate::context::Context;
use crate::transient::{LARGEST, TransientCell};

/// An obstacle not seen covering the goal for this long has left, and the next one is a new one, s: longer than driving round it to look
/// takes.
const FORGOTTEN: f64 = 60.0;

impl Search {
    /// Cells of the transient obstacle that covers the goal as seen from `from`; none once the robot has waited for it long enough.
    pub(super) fn covers_goal(&self, ctx: &mut Context, from: Point2<f64>) -> Vec<TransientCell> {
        let goal = self.request.goal.position();
        let Some(model) = ctx.robot.model() else {
            return Vec::new();
        };
        if !self.may_wait(ctx) || !ctx.map.is_occupied_within(goal, LARGEST) {
            return Vec::new();
        }
        let gap = model.footprint.inscribed_radius() - NEARBY * ctx.goal.tolerance;
        let cells = covering(&ctx.map.transient(&[goal]), from, goal, gap);
        let Some(first) = cells.first() else { return cells };
        let known = ctx.goal.covered.filter(|(place, _, last)| {
            (place - first.center).norm() <= SAME_PLACE && ctx.now.secs_since(*last) <= FORGOTTEN
        });
        let since = known.map_or(ctx.now, |(_, since, _)| since);
        let place = known.map_or(first.center, |(place, ..)| place);
        ctx.goal.covered = Some((place, since, ctx.now));
        if ctx.now.secs_since(since) > ctx.config.settings.linger {
            return Vec::new();
        }
        cells
    }
}

/// Cells of the obstacle nearest to a goal, if a disc as deep as the obstacle is wide, seen from `from`, comes nearer to the goal than
/// `gap`, m (negative: extends over it by more than that).
fn covering(cells: &[TransientCell], from: Point2<f64>, goal: Point2<f64>, gap: f64) -> Vec<TransientCell> {
    let distance = |cell: &TransientCell| (cell.center - goal).norm();
    let nearest = cells.iter().min_by(|a, b| distance(a).total_cmp(&distance(b)));
    let Some(nearest) = nearest.filter(|cell| distance(cell) <= LARGEST) else {
        return Vec::new();
    };
    let Some(ahead) = (nearest.center - from).try_normalize(1e-6) else {
        return Vec::new();
    };
    let thing = cells
        .iter()
        .filter(|cell| (cell.center - nearest.center).norm() <= ONE_THING);
    let thing: Vec<TransientCell> = thing.copied().collect();
    let across = Vector2::new(-ahead.y, ahead.x);
    let span = |axis: Vector2<f64>| {
        let along = thing.iter().map(|cell| axis.dot(&(cell.center - from)));
        along.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), at| {
            (low.min(at), high.max(at))
        })
    };
    let ((front, _), (right, left)) = (span(ahead), span(across));
    if left - right > LARGEST {
        // Too wide for a person: a closed door, for example.
        return Vec::new();
    }
    let radius = 0.5 * (left - right);
    let center = from + ahead * (front + radius) + across * (0.5 * (left + right));
    if (center - goal).norm() < radius + gap {
        thing
    } else {
        Vec::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The near half of a disc, seen from the origin.
    fn seen(center: Point2<f64>, radius: f64) -> Vec<TransientCell> {
        let toward = (-center.coords).normalize();
        let side = Vector2::new(-toward.y, toward.x);
        let angles = (-9..=9).map(|step| f64::from(step) * 10.0_f64.to_radians());
        let cells = angles.map(|angle| TransientCell {
            center: center + radius * (angle.cos() * toward + angle.sin() * side),
            since: None,
        });
        cells.collect()
    }

    #[test]
    fn somebody_covers_the_floor_where_she_stands_and_none_beside_or_behind_her() {
        let person = seen(Point2::new(3.0, 1.0), 0.25);
        let covers = |x: f64, y: f64| !covering(&person, Point2::origin(), Point2::new(x, y), 0.0).is_empty();
        assert!(covers(3.0, 1.0));
        assert!(covers(3.2, 1.07));
        assert!(!covers(3.3, 1.1));
        assert!(!covers(2.9, 1.3));
        assert!(!covers(2.7, 0.9));
        assert!(covering(&[], Point2::origin(), Point2::new(3.0, 1.0), 0.0).is_empty());
        // Too wide for a person.
        assert!(
            covering(
                &seen(Point2::new(3.0, 1.0), 0.45),
                Point2::origin(),
                Point2::new(3.0, 1.0),
                0.0
            )
            .is_empty()
        );
        // From its own position, nothing is seen.
        assert!(covering(&person[9..10], person[9].center, Point2::new(2.8, 0.9), 0.0).is_empty());
    }

    #[test]
    fn a_robot_reaches_a_goal_that_is_covered_by_less_than_its_tolerance() {
        let person = seen(Point2::new(3.0, 0.0), 0.25);
        let covers = |x: f64, gap: f64| !covering(&person, Point2::origin(), Point2::new(x, 0.0), gap).is_empty();
        assert!(covers(3.2, 0.0) && !covers(3.2, -0.1));
        assert!(!covers(3.3, 0.0) && covers(3.3, 0.1));
    }
}

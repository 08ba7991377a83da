//! How much room does the robot take? A planner knows it as a disc; whether its body fits shows when the way is made a motion.

use zenav_protocol::robot::Footprint;

use zenav_planning::Planner;

/// Between the disc that fits inside the robot's body and the one around it: shares of the difference that are tried one after the other.
const SHARES: [f64; 3] = [0.0, 0.5, 1.0];

/// How large a disc stands for the robot. A planner knows it as one; whether its body fits shows when the way is made a motion.
#[derive(Clone, Debug)]
pub(super) struct Room {
    /// Which of [`SHARES`] is planned for.
    index: usize,
    /// A planner whose ways pass obstacles as close as they may begins with the largest disc; one that keeps away by itself with the
    /// smallest.
    narrows: bool,
    /// Why a way was found that cannot be driven, if one was.
    pub undrivable: Option<String>,
}

impl Room {
    pub fn new(planner: &str) -> Self {
        let narrows = planner.parse().is_ok_and(|planner: Planner| !planner.keeps_clear());
        Self {
            index: if narrows { SHARES.len() - 1 } else { 0 },
            narrows,
            undrivable: None,
        }
    }

    /// The robot for the planner.
    pub fn disc(&self, footprint: &Footprint) -> Footprint {
        let (inner, outer) = (footprint.inscribed_radius(), footprint.circumscribed_radius());
        match SHARES.get(self.index) {
            Some(share) if *share > 0.0 && inner < outer => Footprint::Radius(inner + share * (outer - inner)),
            _ => footprint.clone(),
        }
    }

    /// Goes over to the next disc; `false` after the last one, and where all discs are the same.
    pub fn change(&mut self, footprint: &Footprint) -> bool {
        if matches!(footprint, Footprint::Radius(_)) {
            return false;
        }
        let next = if self.narrows {
            self.index.checked_sub(1)
        } else {
            Some(self.index + 1).filter(|index| *index < SHARES.len())
        };
        self.index = next.unwrap_or(self.index);
        next.is_some()
    }

    /// Goes over to a smaller disc, where that is the way to go.
    pub fn narrow(&mut self, footprint: &Footprint) -> bool {
        self.narrows && self.change(footprint)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point2;

    fn body() -> Footprint {
        Footprint::Polygon(
            [(-0.4, -0.1), (0.4, -0.1), (0.4, 0.1), (-0.4, 0.1)]
                .map(|(x, y)| Point2::new(x, y))
                .to_vec(),
        )
    }

    fn discs(planner: &str, footprint: &Footprint) -> Vec<f64> {
        let mut room = Room::new(planner);
        let mut radii = vec![room.disc(footprint).inscribed_radius()];
        while room.change(footprint) {
            radii.push(room.disc(footprint).inscribed_radius());
        }
        radii
    }

    #[test]
    fn a_planner_that_keeps_clear_begins_with_the_smallest_disc_and_others_with_the_largest() {
        let wider = discs("astar", &body());
        let is = |radius: f64, expected: f64| (radius - expected).abs() < 1e-12;
        assert!(wider.len() == 3 && wider.is_sorted());
        assert!(
            is(wider[0], 0.1) && is(wider[2], body().circumscribed_radius()),
            "{wider:?}"
        );
        let narrower = discs("rrt_star", &body());
        assert_eq!(narrower.into_iter().rev().collect::<Vec<_>>(), wider);
        assert_eq!(discs("jps", &Footprint::Radius(0.3)), vec![0.3]);
    }

    #[test]
    fn only_a_planner_that_begins_large_becomes_smaller_for_want_of_a_way() {
        assert!(!Room::new("astar").narrow(&body()));
        assert!(Room::new("theta").narrow(&body()));
    }
}

//! Blind corners. Where could a person stand behind a corner, unseen, and come out?
//!
//! Where the range jumps from one beam to the next, the nearer surface hides floor behind its end (as in Chung et al., "Safe navigation of a
//! mobile robot considering visibility of environment", IEEE Transactions on Industrial Electronics 56, 2009). A surface narrower than a
//! person, such as a post or a door jamb, hides nobody. A whole person must fit there: every beam towards them ends before them, at a
//! surface that is as thick as a thin wall at least. And a person must fit out past the corner. Of each corner, the place nearest to it
//! counts: the way from there leads round the corner.

use nalgebra::{Isometry2, Point2, Vector2};

use crate::field_of_view::ProjectedScan;
use crate::passive_safety::Mover;

/// Thickness of what hides a person at least, m.
const THICKNESS: f64 = 0.2;
/// Corners farther than this from the lidar are left out, m.
const RANGE: f64 = 3.0;
/// Places behind a corner are tried at this spacing, m, so many.
const STEP: f64 = 0.1;
const STEPS: u32 = 20;
/// Range noise and the spacing of beams, m.
const SLACK: f64 = 0.03;

/// A corner behind which a person may stand, odometry frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BlindCorner {
    /// The end of what hides them.
    pub(crate) corner: Point2<f64>,
    /// The center of the person.
    pub(crate) place: Point2<f64>,
}

impl BlindCorner {
    /// The person of this radius (m), in another frame, who comes round the corner at a speed, m/s.
    pub(crate) fn person(&self, frame_from_odom: &Isometry2<f64>, radius: f64, speed: f64) -> Mover {
        Mover {
            travelled: radius - (self.place - self.corner).norm(),
            ..Mover::at_will(frame_from_odom * self.corner, 0.0, speed)
        }
    }
}

/// Finds the blind corners in a scan with these (filtered) ranges, for people of this radius, m. Behind something that moves nobody is
/// assumed.
pub(crate) fn find(
    scan: &ProjectedScan<'_>,
    ranges: &[f32],
    radius: f64,
    moves: impl Fn(Point2<f64>) -> bool,
    corners: &mut Vec<BlindCorner>,
) {
    let view = View {
        scan,
        ranges,
        radius,
        is_circle: scan.lidar.gap() == 0.0,
    };
    let seam = (view.is_circle && ranges.len() > 1).then(|| [ranges.len() - 1, 0]);
    let pairs = (1..ranges.len()).map(|left| [left - 1, left]).chain(seam);
    corners.clear();
    corners.extend(pairs.filter_map(|[right, left]| view.behind(right, left, &moves)));
}

/// The ranges of a scan.
struct View<'a> {
    scan: &'a ProjectedScan<'a>,
    ranges: &'a [f32],
    /// Radius of a person, m.
    radius: f64,
    is_circle: bool,
}

impl View<'_> {
    /// How far a beam sees, m; `None` if that is unknown.
    fn range(&self, beam: usize) -> Option<f64> {
        let range = f64::from(*self.ranges.get(beam)?);
        (range >= self.scan.lidar.range_min).then(|| range.min(self.scan.lidar.range_max))
    }

    /// The beam with a number that may lie beyond the seam of a full circle.
    fn beam(&self, number: i64) -> Option<usize> {
        let count = self.ranges.len() as i64;
        let number = if self.is_circle {
            number.rem_euclid(count)
        } else {
            number
        };
        (0..count).contains(&number).then_some(number as usize)
    }

    /// The corner between two neighbouring beams, if somebody may stand behind it.
    fn behind(&self, right: usize, left: usize, moves: impl Fn(Point2<f64>) -> bool) -> Option<BlindCorner> {
        let [at_right, at_left] = [self.range(right)?, self.range(left)?];
        let (near, far) = (at_right.min(at_left), at_right.max(at_left));
        if far - near < 2.0 * self.radius || near > RANGE {
            return None;
        }
        let hides_left = at_left < at_right;
        let (hides, passes) = if hides_left { (left, right) } else { (right, left) };
        let (corner, along) = (self.scan.laser() + self.scan.rays[hides] * near, self.scan.rays[passes]);
        let outward = if hides_left { -1 } else { 1 };
        if moves(corner) || !self.is_wide(corner, hides, -outward) || !self.is_open(corner, passes, outward) {
            return None;
        }
        let aside = Vector2::new(along.y, -along.x) * outward as f64;
        let ways = (0..STEPS)
            .map(|step| STEP * f64::from(step))
            .take_while(|way| *way < far - near);
        let mut tried = ways.map(|way| corner + along * way + aside * self.radius);
        let place = tried.find(|place| self.hides(*place))?;
        Some(BlindCorner { corner, place })
    }

    /// Whether the surface that ends at a corner is as wide as a person, from the beam `hides` on in a direction.
    fn is_wide(&self, corner: Point2<f64>, hides: usize, inward: i64) -> bool {
        let mut last = self.range(hides);
        for nth in 1..self.ranges.len() as i64 {
            let Some(beam) = self.beam(hides as i64 + inward * nth) else {
                return false;
            };
            let Some((range, before)) = self.range(beam).zip(last) else {
                continue;
            };
            if (range - before).abs() >= 2.0 * self.radius {
                return false;
            }
            if (self.scan.laser() + self.scan.rays[beam] * range - corner).norm() >= 2.0 * self.radius {
                return true;
            }
            last = Some(range);
        }
        false
    }

    /// Whether a person fits out between a corner and what the beams beside it meet, from `passes` on in a direction.
    fn is_open(&self, corner: Point2<f64>, passes: usize, outward: i64) -> bool {
        let (laser, off) = (self.scan.laser(), corner - self.scan.laser());
        for nth in 0..self.ranges.len() as i64 {
            let Some(beam) = self.beam(passes as i64 + outward * nth) else {
                return true;
            };
            let ray = self.scan.rays[beam];
            if ray.dot(&off) <= 0.0 || ray.perp(&off).abs() >= 2.0 * self.radius {
                return true;
            }
            let met = self.range(beam).filter(|range| *range < self.scan.lidar.range_max);
            if met.is_some_and(|range| (laser + ray * range - corner).norm() < 2.0 * self.radius) {
                return false;
            }
        }
        true
    }

    /// Whether a person at a place is hidden altogether.
    fn hides(&self, place: Point2<f64>) -> bool {
        let off = place - self.scan.laser();
        let Some((middle, distance)) = self.scan.beam_to(place).filter(|(_, distance)| *distance > self.radius) else {
            return false;
        };
        let half = ((self.radius / distance).asin() / self.scan.lidar.angle_increment()).ceil() as i64;
        (middle as i64 - half..=middle as i64 + half).all(|number| {
            let Some(beam) = self.beam(number) else {
                return false;
            };
            let ray = self.scan.rays[beam];
            let (ahead, aside) = (ray.dot(&off), ray.perp(&off).abs());
            let Some(range) = self.range(beam).filter(|_| aside < self.radius - SLACK) else {
                return true;
            };
            range + THICKNESS <= ahead - (self.radius * self.radius - aside * aside).sqrt() + SLACK
        })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
mod tests {
    use zenav_protocol::geometry::{Pose2, Twist2};
    use zenav_protocol::messages::Bump;
    use zenav_protocol::robot::RobotModel;
    use zenav_protocol::time::Stamp;

    use super::*;
    use crate::collision_monitor::CollisionMonitor;
    use crate::local_obstacles::LocalObstacles;
    use crate::settings::EdgeSettings;

    type Wall = [Point2<f64>; 2];

    fn wall(from: [f64; 2], to: [f64; 2]) -> Wall {
        [from.into(), to.into()]
    }

    /// Distance along a beam to a wall, m.
    fn way(from: Point2<f64>, along: Vector2<f64>, [a, b]: &Wall) -> f64 {
        let (side, off) = (b - a, a - from);
        let across = along.perp(&side);
        let (ahead, share) = (off.perp(&side) / across, off.perp(&along) / across);
        if ahead > 0.0 && (0.0..=1.0).contains(&share) {
            ahead
        } else {
            f64::INFINITY
        }
    }

    /// What a robot at a place sees between walls.
    fn seen(model: &RobotModel, x: f64, walls: &[Wall]) -> LocalObstacles {
        seen_with(model, x, walls, &EdgeSettings::default())
    }

    fn seen_with(model: &RobotModel, x: f64, walls: &[Wall], settings: &EdgeSettings) -> LocalObstacles {
        let lidar = model.first_lidar().unwrap();
        let laser = Pose2::new(x, 0.0, 0.0) * lidar.mount;
        let sweep = zenav_fixtures::sweep(lidar, 1.0, |angle| {
            let along = Vector2::new(angle.cos(), angle.sin());
            let ways = walls.iter().map(|wall| way(laser.position(), along, wall));
            let seen = ways.filter(|range| *range <= lidar.range_max);
            seen.fold(f64::INFINITY, f64::min)
        });
        let mut obstacles = LocalObstacles::with_settings(model, settings);
        assert!(obstacles.insert(&sweep, Pose2::new(x, 0.0, 0.0)));
        obstacles
    }

    /// A corridor along x, `width` wide, with an opening in its left wall from x = 2 on.
    fn corridor(width: f64) -> Vec<Wall> {
        let half = 0.5 * width;
        vec![
            wall([-3.0, half], [2.0, half]),
            wall([2.0, half], [2.0, 4.0]),
            wall([3.5, half], [3.5, 4.0]),
            wall([3.5, half], [9.0, half]),
            wall([-3.0, -half], [9.0, -half]),
        ]
    }

    /// A wall at x = 2 with a door as wide as this.
    fn door(width: f64) -> Vec<Wall> {
        let half = 0.5 * width;
        let face = |x: f64, side: f64| wall([x, side * half], [x, side * 3.0]);
        let jamb = |side: f64| wall([2.0, side * half], [2.2, side * half]);
        vec![
            face(2.0, 1.0),
            face(2.0, -1.0),
            face(2.2, 1.0),
            face(2.2, -1.0),
            jamb(1.0),
            jamb(-1.0),
            wall([8.0, -3.0], [8.0, 3.0]),
        ]
    }

    /// The share of its top speed at which a robot may drive on from x, with people who come out from behind corners at this speed, m/s.
    fn share(model: &RobotModel, x: f64, walls: &[Wall], speed: Option<f64>) -> f64 {
        let mut settings = EdgeSettings::default();
        settings.passive_safety.speed_out_of_sight = speed;
        let mut monitor = CollisionMonitor::new(model, 0.02).with_settings(&settings);
        let (wanted, now) = (Twist2::new(model.drive.top_speed(), 0.0), Stamp::from_secs(1.05));
        let obstacles = seen(model, x, walls);
        let verdict = monitor.judge(now, wanted, &obstacles, Pose2::new(x, 0.0, 0.0), &Bump::none(now));
        verdict.twist.v / wanted.v
    }

    #[test]
    fn somebody_fits_behind_the_corner_of_a_wall_and_not_behind_a_post_or_in_a_wall() {
        let tiago = zenav_fixtures::robot("tiago");
        let places = |x: f64, walls: &[Wall]| {
            let obstacles = seen(&tiago, x, walls);
            obstacles.blind_corners().map(|corner| corner.place).collect::<Vec<_>>()
        };
        let behind = places(1.0, &corridor(1.5));
        let corner = Point2::new(2.0, 0.75);
        assert!(behind.iter().any(|place| (place - corner).norm() < 1.0), "{behind:?}");
        assert!(behind.iter().all(|place| place.y > 0.75 + 0.25), "{behind:?}");
        let post = [wall([2.0, -0.1], [2.0, 0.1]), wall([5.0, -4.0], [5.0, 4.0])];
        assert!(places(1.0, &post).is_empty());
        assert!(places(1.0, &[wall([3.0, -5.0], [3.0, 5.0])]).is_empty());
        // A gap that nobody fits through.
        let gap = [
            wall([2.0, -4.0], [2.0, -0.1]),
            wall([2.0, 0.1], [2.0, 4.0]),
            wall([4.0, -4.0], [4.0, 4.0]),
        ];
        assert!(places(1.0, &gap).is_empty());
    }

    #[test]
    fn the_width_of_a_person_is_a_setting() {
        let (tiago, mut settings) = (zenav_fixtures::robot("tiago"), EdgeSettings::default());
        let corners =
            |settings: &EdgeSettings| seen_with(&tiago, 1.0, &corridor(1.5), settings).blind_corners().count();
        assert!(corners(&settings) > 0);
        settings.passive_safety.person_radius = 1.0;
        assert_eq!(corners(&settings), 0, "the opening is 1.5 m wide");
    }

    #[test]
    fn at_rest_before_whoever_comes_round_a_corner_and_never_held_there() {
        for robot in ["tiago", "jackal"] {
            let model = zenav_fixtures::robot(robot);
            let walls = corridor(1.0);
            let shares: Vec<f64> = (0..25)
                .map(|step| share(&model, 0.1 * f64::from(step), &walls, Some(1.4)))
                .collect();
            let least = shares.iter().copied().fold(1.0, f64::min);
            assert!(
                least < 0.7 && least * model.drive.top_speed() > 0.099,
                "{robot}: {shares:?}"
            );
            assert!(shares[0] > 0.95 && shares[24] > 0.95, "{robot}: {shares:?}");
        }
    }

    #[test]
    fn predictive_control_is_slowed_by_them_as_the_monitor_is_and_never_held() {
        for robot in ["tiago", "jackal"] {
            let model = zenav_fixtures::robot(robot);
            let (walls, mut settings) = (corridor(1.0), EdgeSettings::default());
            settings.passive_safety.speed_out_of_sight = Some(1.4);
            let monitor = CollisionMonitor::new(&model, 0.02).with_settings(&settings);
            let (wanted, now) = (Twist2::new(model.drive.top_speed(), 0.0), Stamp::from_secs(1.05));
            let shares = (0..25).map(|step| {
                let x = 0.1 * f64::from(step);
                let (obstacles, here) = (seen(&model, x, &walls), Pose2::new(x, 0.0, 0.0));
                let people = monitor.people_behind_corners(&obstacles, here);
                monitor.share_past_corners(now, wanted, &people, &obstacles)
            });
            let least = shares.fold(1.0_f64, f64::min);
            let creeps = 0.1 / model.drive.top_speed();
            assert!(least < 0.7 && least > 0.99 * creeps, "{robot}: {least}");
        }
    }

    #[test]
    fn doors_and_corners_cost_little_time_where_whoever_comes_out_is_slow() {
        for robot in ["tiago", "turtlebot3_waffle", "neato", "jackal"] {
            let model = zenav_fixtures::robot(robot);
            for walls in [door(1.0), corridor(1.5)] {
                let passing = |speed: Option<f64>| {
                    let shares = (0..25).map(|step| share(&model, 0.1 * f64::from(step), &walls, speed));
                    shares.sum::<f64>()
                };
                let (free, slowed) = (passing(Some(0.0)), passing(None));
                assert!(slowed > 0.95 * free, "{robot}: {slowed} of {free}");
            }
        }
    }
}

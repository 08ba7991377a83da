//! Corrections by the real matcher. How exact localisation is in a house that has changed, and whether the robot knows how far it is off while
//! corrections come late, get lost, and are cut off for half of each minute.
//!
//! In lockstep: a robot without GPS and compass drives from goal to goal through the houses of [`super::kidnapped`]. A fifth of the furniture
//! on its map has been moved, and people walk straight across the rooms. Its wheels and gyro have errors that are drawn from the
//! filter's priors. Mapping's core localises its scans beside the loop, and sends its corrections over a bad link.

pub mod amcl;

use std::collections::VecDeque;
use std::fmt::Write as _;
use std::time::Duration;

use nalgebra::{Matrix3, Point2, Vector3};
use zenav::lockstep::{ClosedLoop, Heard};
use zenav_cloud::mapping::{MappingCore, PoseSettings, PoseSource};
use zenav_edge::Publication;
use zenav_edge::settings::EstimatorSettings;
use zenav_localisation::{LocalisationSettings, Localiser};
use zenav_mapping::{Mapper, MappingSettings};
use zenav_protocol::geometry::{Pose2, wrap_angle};
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::{Correction, MapRef, PoseEstimate, Scan};
use zenav_protocol::robot::Footprint;
use zenav_protocol::time::Stamp;
use zenav_sim::World;

use super::indoors;
use super::kidnapped::{HOUSE, House};
use super::pose;
use super::tracking::true_map;
use super::worlds::Rng;

/// One piece of furniture in this many was moved, by up to this much in each direction, m.
const MOVED: (usize, f64) = (5, 1.0);
/// People in the house, and their least and greatest speed, m/s.
const PEOPLE: (usize, f64, f64) = (10, 0.4, 1.2);
/// Latency of corrections, s.
const LATE: (f64, f64) = (0.1, 1.5);
/// Share of corrections that is lost, and the seconds of each minute in which all are.
const LOST: (f64, f64, f64) = (0.2, 15.0, 45.0);
/// Ticks between two steps at which the robot's error is compared with its covariance.
const STEP: u64 = 10;
/// Seconds after the start that are left out: the start pose is exact.
const SETTLED: f64 = 20.0;
/// A trusted pose that is farther off is wrong, m.
const WRONG: f64 = 0.1;

/// Sums over drives.
#[derive(Clone, Debug, Default)]
pub struct Tally {
    /// Error of each trusted pose that localisation gave a scan, m and rad.
    pub errors: [Vec<f64>; 2],
    /// Processor time of each scan, s.
    pub took: Vec<f64>,
    /// Number of scans with a trusted pose, of those among them that were wrong, and of all.
    pub trusted: [usize; 3],
    /// NEES of (x, y, yaw) of each correction, at the stamp of its scan.
    pub matched: Vec<f64>,
    /// For each step the sum of the NEES of (x, y, yaw) of the robot's pose, and the number of drives in it.
    pub nees: Vec<(f64, u32)>,
    /// Distance driven, m.
    pub length: f64,
    /// AMCL, if it runs beside: see [`amcl::USES`].
    pub amcl: [amcl::Sums; 2],
}

/// The link from mapping to the robot.
struct BadLink {
    rng: Rng,
    under_way: Vec<(Stamp, Correction)>,
}

impl BadLink {
    fn send(&mut self, now: Stamp, correction: Correction) {
        let (share, from, to) = LOST;
        let is_cut = (from..to).contains(&(now.as_secs() % 60.0));
        let arrival = now.plus_secs(self.rng.between(LATE.0, LATE.1));
        if !is_cut && !self.rng.chance(share) {
            self.under_way.push((arrival, correction));
        }
    }

    fn arrived(&mut self, now: Stamp) -> Vec<Correction> {
        let under_way = std::mem::take(&mut self.under_way);
        let (arrived, under_way): (Vec<_>, Vec<_>) = under_way.into_iter().partition(|(due, _)| *due <= now);
        self.under_way = under_way;
        arrived.into_iter().map(|(_, correction)| correction).collect()
    }
}

/// The true poses of the last seconds.
#[derive(Default)]
struct Truths(VecDeque<(Stamp, Pose2)>);

impl Truths {
    fn note(&mut self, now: Stamp, pose: Pose2) {
        self.0.push_back((now, pose));
        if self.0.len() > 200 {
            self.0.pop_front();
        }
    }

    fn at(&self, stamp: Stamp) -> Option<Pose2> {
        let next = self.0.partition_point(|(then, _)| *then < stamp);
        let (after, b) = self.0.get(next)?;
        let Some((before, a)) = next.checked_sub(1).and_then(|index| self.0.get(index)) else {
            return Some(*b);
        };
        Some(a.interpolate(b, stamp.secs_since(*before) / after.secs_since(*before)))
    }
}

/// Drives for `secs` and adds to the sums. `clock`: processor time so far.
///
/// # Errors
/// When the world or the robot cannot be set up.
pub fn drive(tally: &mut Tally, seed: u64, secs: f64, clock: &dyn Fn() -> Duration) -> Result<(), String> {
    let mut rng = Rng::new(seed, 13);
    let mut house = House::drawn(&mut Rng::new(seed, 12));
    let map = true_map(&indoors::world(&house.text(), "house")?);
    let text = changed(&mut house, &mut rng);
    let world = indoors::world(&text, "changed house")?;
    let body = pose::ON_TIME.body(&indoors::model()?, &EstimatorSettings::default(), &mut rng);
    let (cloud_delay, known) = (rng.between(LATE.0, 0.5), Some(map.clone()));
    let mut stage = indoors::stage_with(&world, body, PoseSource::Edge, known, cloud_delay, seed)?;
    let mut link = BadLink {
        rng: Rng::new(seed, 14),
        under_way: Vec::new(),
    };
    let mut truths = Truths::default();
    let (mut matcher, mut peer) = (Matcher::new(&map), amcl::Log::new(&map));
    let (mut ticks, mut goals, mut told) = (0_u64, 0, None::<PoseEstimate>);
    while stage.now().as_secs() < secs {
        if stage.robots[0].goal().is_none_or(|goal| goal.state.is_end()) && ticks.is_multiple_of(50) {
            goals += 1;
            let to = free(&world, &mut rng)?;
            stage.robots[0].ask(indoors::goal(&format!("goal-{goals}"), to.x, to.y));
        }
        let arrived = link.arrived(stage.now());
        stage.robots[0].inbox.corrections.extend(arrived);
        let (scans, poses) = tick(&mut stage);
        let now = stage.now();
        truths.note(now, stage.truth(0).map_from_base);
        ticks += 1;
        for scan in &scans {
            if let Some(peer) = &mut peer {
                peer.note(scan, truths.at(scan.stamp));
            }
            if let Some(correction) = matcher.step(tally, scan, &truths, clock) {
                link.send(now, correction);
            }
        }
        told = poses.into_iter().next_back().or(told);
        if let Some(told) = told
            .as_ref()
            .filter(|_| ticks.is_multiple_of(STEP) && now.as_secs() > SETTLED)
        {
            tally.compare((ticks / STEP) as usize, told, &truths);
        }
    }
    tally.length += stage.truth(0).length;
    peer.map_or(Ok(()), |peer| peer.run(seed, &mut tally.amcl))
}

/// One tick; returns the robot's scans and poses.
fn tick(stage: &mut ClosedLoop) -> (Vec<Scan>, Vec<PoseEstimate>) {
    let (mut scans, mut poses) = (Vec::new(), Vec::new());
    stage.tick_heard(|_, heard| {
        let Heard::Robot(outbox) = heard else { return };
        for publication in &outbox.publications {
            match publication {
                Publication::Scan(None, scan) => scans.push(scan.clone()),
                Publication::Pose(pose) => poses.push(pose.clone()),
                _ => {}
            }
        }
    });
    (scans, poses)
}

/// Localisation, once as mapping does it, and once more by itself to be measured.
struct Matcher {
    core: MappingCore,
    localiser: Localiser,
}

impl Matcher {
    fn new(map: &OccupancyGrid) -> Self {
        let named = MapRef {
            id: "house".to_owned(),
            revision: 0,
            frame: 0,
        };
        // A stored map is held: nothing is drawn into it.
        let mapper = Mapper::with_stored(MappingSettings::default(), named, map, Vec::new(), 0);
        let poses = PoseSettings {
            source: PoseSource::Localise,
            ..PoseSettings::default()
        };
        Self {
            core: MappingCore::new(mapper, &poses),
            localiser: Localiser::new(LocalisationSettings::default(), map),
        }
    }

    /// Takes in a scan; returns the correction that it leads to.
    fn step(
        &mut self,
        tally: &mut Tally,
        scan: &Scan,
        truths: &Truths,
        clock: &dyn Fn() -> Duration,
    ) -> Option<Correction> {
        let begun = clock();
        let located = self.localiser.step(scan);
        tally.took.push(clock().saturating_sub(begun).as_secs_f64());
        tally.trusted[2] += 1;
        let located = located.filter(|located| located.health.is_trusted());
        if let Some((located, truth)) = located.zip(truths.at(scan.stamp)) {
            let off = located.pose.distance(&truth);
            tally.trusted[0] += 1;
            tally.trusted[1] += usize::from(off > WRONG);
            tally.errors[0].push(off);
            tally.errors[1].push(wrap_angle(located.pose.yaw - truth.yaw).abs());
        }
        let correction = self.core.insert(scan, &scan.boot_id).correction;
        let told = correction.as_ref().zip(truths.at(scan.stamp));
        tally
            .matched
            .extend(told.and_then(|(told, truth)| nees(told.map_from_base, &told.covariance, truth)));
        correction
    }
}

impl Tally {
    /// Compares the robot's error in a step with its covariance.
    fn compare(&mut self, step: usize, told: &PoseEstimate, truths: &Truths) {
        let of = |truth| nees(told.map_from_base, &told.covariance, truth);
        let Some(nees) = truths.at(told.stamp).and_then(of) else {
            return;
        };
        if self.nees.len() <= step {
            self.nees.resize(step + 1, (0.0, 0));
        }
        let (sum, drives) = self.nees[step];
        self.nees[step] = (sum + nees, drives + 1);
    }
}

/// The error of a pose, squared and relative to its covariance.
fn nees(pose: Pose2, covariance: &[f64; 9], truth: Pose2) -> Option<f64> {
    let inverse = Matrix3::from_row_slice(covariance).try_inverse()?;
    let error = Vector3::new(pose.x - truth.x, pose.y - truth.y, wrap_angle(pose.yaw - truth.yaw));
    Some(error.dot(&(inverse * error)))
}

/// The world file of the house after its furniture was moved, with people in its rooms.
fn changed(house: &mut House, rng: &mut Rng) -> String {
    let (every, by) = MOVED;
    for [x, y, wide, deep] in house.boxes.iter_mut().step_by(every) {
        let (low, right, high) = (0.1, HOUSE.0 - 0.1 - *wide, HOUSE.1 - 0.1 - *deep);
        *x = (*x + rng.between(-by, by)).clamp(low, right);
        *y = (*y + rng.between(-by, by)).clamp(low, high);
    }
    let mut text = house.text();
    let (people, slowest, fastest) = PEOPLE;
    // Two in each room but that of the start.
    let rooms = [
        (5.5, 10.5, 0.0),
        (10.5, 16.0, 0.0),
        (0.0, 5.5, 5.5),
        (5.5, 10.5, 5.5),
        (10.5, 16.0, 5.5),
    ];
    for nth in 0..people {
        let (left, right, low) = rooms[nth % rooms.len()];
        let (left, right, low, high) = (left + 0.5, right - 0.5, low + 0.5, low + 4.0);
        let (x, y, speed) = (
            rng.between(left, right),
            rng.between(low, high),
            rng.between(slowest, fastest),
        );
        // Writing to a string does not fail.
        let _ = write!(
            text,
            "[[mover]]\nradius = 0.25\nspeed = {speed}\nmanners = \"orca\"\nstart = [{x}, {y}]\nwalk = [[{left}, {low}], [{right}, {high}]]\n"
        );
    }
    text
}

/// A free place for the robot.
fn free(world: &World, rng: &mut Rng) -> Result<Point2<f64>, String> {
    let room = Footprint::Radius(indoors::model()?.footprint.circumscribed_radius() + 0.1);
    loop {
        let pose = Pose2::new(rng.between(0.5, HOUSE.0 - 0.5), rng.between(0.5, HOUSE.1 - 0.5), 0.0);
        if world.clearance(&room, pose) > 0.0 {
            return Ok(pose.position());
        }
    }
}

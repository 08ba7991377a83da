//! `zenav film`. Renders a record as an animation, or only its last picture: the growing map, and what the robot saw, planned and drove.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use nalgebra::Point2;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Cell, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{EventKind, GoalPhase, GoalPoint};
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics;

use super::format::Sample;
use super::maps::Maps;
use super::reader::RecordReader;
use super::run::Run;
use super::run_clock::RunClock;
use crate::drawing::canvas::Canvas;
use crate::drawing::film::encode;
use crate::drawing::plane::{PANEL, around, points_of, returns_of};
use crate::drawing::scene::Scene;
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::{files, output};

/// Width and largest height of a picture, px.
const WIDTH: u32 = 640;
const HEIGHT: f64 = 560.0;
/// Most pictures of a film, and how long each is shown, hundredths of a second.
const PICTURES: usize = 160;
const SHOWN: u16 = 12;
/// Cells on the longer side of a kept map from which two or more are joined: a pixel then shows several of them in any case.
const FINEST: u32 = 2 * WIDTH;
/// Margin around the drawn area, m.
const MARGIN: f64 = 0.3;

/// Arguments of `zenav film`.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav film run.mcap\n  zenav film run.mcap --out run.mp4     by ffmpeg\n  zenav film run.mcap --out last.png    only the last picture"
)]
pub struct FilmArgs {
    /// Record
    #[arg(value_name = "RUN.mcap")]
    record: PathBuf,
    /// File to write: .gif, .mp4 (with ffmpeg, which must be installed), or .png for the last picture only [default: beside the record,
    /// with the extension .gif]
    #[arg(long, value_name = "FILE")]
    out: Option<PathBuf>,
    /// Robot to show; optional if the record has only one
    #[arg(long, value_name = "NAME")]
    robot: Option<String>,
}

/// `zenav film`.
///
/// # Errors
/// A bad record, one without the robot, or a film that cannot be written.
pub fn film(args: &FilmArgs) -> Outcome {
    let out = args.out.clone().unwrap_or_else(|| args.record.with_extension("gif"));
    write_film(&args.record, args.robot.as_deref(), &out, || Ok(()))?;
    output::line(&format!("wrote {}", out.display()));
    Ok(exit_code::OK)
}

/// Writes the film of one of a record's robots; the only one without a name. `goes_on` is asked before each picture, and its failure ends the
/// work.
///
/// # Errors
/// A bad record, a file that cannot be written, or the failure of `goes_on`.
pub fn write_film(
    record: &Path,
    robot: Option<&str>,
    out: &Path,
    goes_on: impl Fn() -> Result<(), Failure>,
) -> Result<(), Failure> {
    let moving = || {
        let film = Film::of(record, robot, PICTURES)?;
        encode(film.moments.len(), SHOWN, |nth| {
            goes_on()?;
            film.picture(nth)
        })
    };
    match files::ending(out).as_str() {
        "gif" => files::write(out, moving()?),
        "mp4" => write_mp4(moving()?, out),
        "png" => {
            let film = Film::of(record, robot, 1)?;
            files::write(out, film.picture(film.moments.len().saturating_sub(1))?.png()?)
        }
        _ => Err(files::unknown_ending(out, ".gif, .mp4 or .png")),
    }
}

/// Converts a GIF to MP4 with ffmpeg, in the pixel format that all players support; it requires even sides.
fn write_mp4(gif: Vec<u8>, out: &Path) -> Result<(), Failure> {
    // ffmpeg reads no GIF from a pipe.
    let source = out.with_extension("part.gif");
    files::write(&source, gif)?;
    let status = Command::new("ffmpeg")
        .args(["-loglevel", "error", "-y", "-i"])
        .arg(&source)
        .args(["-vf", "scale=trunc(iw/2)*2:trunc(ih/2)*2", "-pix_fmt", "yuv420p"])
        .args(["-movflags", "+faststart"])
        .arg(out)
        .stdin(Stdio::null())
        .status();
    let removed = std::fs::remove_file(&source).map_err(Failure::failed_at(&source));
    match status {
        Ok(status) if status.success() => removed,
        Ok(status) => Err(Failure::failed(format!("{}: ffmpeg failed: {status}", out.display()))),
        Err(error) => Err(Failure::failed(format!(
            "ffmpeg: {error}: an .mp4 needs it; a .gif needs nothing"
        ))),
    }
}

/// Contents of one picture.
#[derive(Clone, Debug, Default)]
struct Moment {
    secs: f64,
    pose: Pose2,
    map: Option<Arc<OccupancyGrid>>,
    scan: Vec<Point2<f64>>,
    plan: Arc<Vec<Point2<f64>>>,
    goal: Option<Point2<f64>>,
    note: String,
    /// Number of trail points so far.
    driven: usize,
}

/// The pictures of a run.
struct Film {
    title: String,
    area: (Point2<f64>, Point2<f64>),
    footprint: Footprint,
    places: Vec<(String, Point2<f64>)>,
    trail: Vec<Point2<f64>>,
    moments: Vec<Moment>,
    /// Trajectory of the plan that is drawn, and the one that the robot finished last.
    trajectory: Option<u64>,
    finished: Option<u64>,
    /// The goal that runs.
    running: Option<String>,
}

impl Film {
    fn of(path: &Path, wanted: Option<&str>, pictures: usize) -> Result<Self, Failure> {
        let run = Run::read(path)?;
        let names: Vec<&str> = run.robots.keys().map(String::as_str).collect();
        let name = match (wanted, names.as_slice()) {
            (Some(name), names) if names.contains(&name) => name,
            (None, [only]) => only,
            (None, [_, _, ..]) => return Err(Failure::usage(format!("--robot: one of {}", names.join(", ")))),
            _ => {
                let known = if names.is_empty() { "none" } else { &names.join(", ") };
                let told = format!("{}: no such robot in the record; it has {known}", path.display());
                return Err(Failure::not_found(told));
            }
        };
        let robot = run
            .robots
            .get(name)
            .filter(|robot| !robot.poses.is_empty())
            .ok_or_else(|| Failure::not_found(format!("{}: no pose of {name} is in the record", path.display())))?;
        let mut film = Self {
            title: run.title.clone(),
            area: area(robot.map.as_ref(), robot.poses.iter().map(|(_, pose)| pose.position())),
            footprint: robot
                .model
                .as_ref()
                .map_or(Footprint::Radius(0.1), |model| model.footprint.clone()),
            places: Vec::new(),
            trail: Vec::new(),
            moments: Vec::new(),
            trajectory: None,
            finished: None,
            running: None,
        };
        film.shoot(path, name, robot.secs / pictures.max(1) as f64, pictures)?;
        Ok(film)
    }

    /// Reads the record and keeps a moment every `every` seconds, at most `most` of them, and the last one.
    fn shoot(&mut self, path: &Path, name: &str, every: f64, most: usize) -> Result<(), Failure> {
        let mut reader = RecordReader::open(path)?;
        let mut maps = Maps::default();
        let (mut now, mut clock, mut due) = (Moment::default(), RunClock::default(), every);
        let prefix = format!("zenav/{name}/");
        while let Some(sample) = reader.next_sample()? {
            if !sample.key.starts_with(&prefix) {
                continue;
            }
            if maps.see(&sample).is_some() {
                now.map = None;
            }
            self.see(&sample, &mut now, &mut clock);
            if now.secs >= due && self.moments.len() < most {
                due = now.secs + every;
                self.keep(&mut now, &maps, name);
            }
        }
        self.keep(&mut now, &maps, name);
        Ok(())
    }

    fn keep(&mut self, now: &mut Moment, maps: &Maps, name: &str) {
        if now.map.is_none() {
            now.map = maps.grid(name).map(|map| Arc::new(reduced(map)));
        }
        now.driven = self.trail.len();
        // Nothing can be drawn before the first map.
        if now.map.is_some() {
            self.moments.push(now.clone());
        }
    }

    fn see(&mut self, sample: &Sample, now: &mut Moment, clock: &mut RunClock) {
        if let Some((_, pose)) = sample.message(&topics::POSE) {
            now.secs = clock.advance(pose.stamp);
            now.pose = pose.map_from_base;
            let at = now.pose.position();
            if self.trail.last().is_none_or(|last| (at - last).norm() > 0.02) {
                self.trail.push(at);
            }
        } else if let Some((_, scan)) = sample.message(&topics::SCAN) {
            now.scan = returns_of(&scan);
        } else if let Some((_, plan)) = sample.message(&topics::PLAN) {
            // A plan is renewed once more after its end was reached.
            if self.finished == Some(plan.trajectory_id) {
                return;
            }
            self.trajectory = Some(plan.trajectory_id);
            now.plan = Arc::new(points_of(&plan));
        } else if let Some((_, goal)) = sample.message(&topics::GOAL_STATE) {
            let runs = matches!(goal.state, GoalPhase::Active | GoalPhase::Paused);
            // Others wait, or end, meanwhile.
            if runs || self.running.as_ref() == Some(&goal.id) {
                let there = goal.legs.last().and_then(|leg| leg.goal);
                now.goal = there.map(|goal| Point2::new(goal.x, goal.y));
                now.note = if runs { goal.feedback.step } else { String::new() };
                self.running = runs.then_some(goal.id);
            }
        } else if let Some((_, drawn)) = sample.message(&topics::ANNOTATIONS) {
            let place = |(name, at): (String, GoalPoint)| (name, Point2::new(at.x, at.y));
            self.places = drawn.places.into_iter().map(place).collect();
        } else if let Some((_, event)) = sample.message(&topics::EVENT) {
            match event.kind {
                EventKind::PlanFinished { trajectory_id, .. } => {
                    self.finished = Some(trajectory_id);
                    if self.trajectory == self.finished {
                        now.plan = Arc::default();
                    }
                }
                EventKind::Bumped | EventKind::Stopped { .. } => now.note = super::words::event(&event.kind),
                _ => {}
            }
        }
    }

    fn picture(&self, nth: usize) -> Result<Canvas, Failure> {
        let nothing = || Failure::failed("there is no map in the record to draw on");
        let now = self.moments.get(nth).ok_or_else(nothing)?;
        let map = now.map.as_deref().ok_or_else(nothing)?;
        let extent = self.area.1 - self.area.0;
        let scale = (f64::from(WIDTH - PANEL) / extent.x).min(HEIGHT / extent.y);
        let scene = Scene {
            notes: vec![format!("t = {:.1} s", now.secs), now.note.clone()],
            area: Some(self.area),
            places: &self.places,
            scan: Some(&now.scan),
            plan: Some(&now.plan),
            trail: self.trail.get(..now.driven),
            goal: now.goal,
            robot: Some((now.pose, &self.footprint)),
            ..Scene::new(&self.title, map)
        };
        scene.draw((scale * extent.amax()) as u32)
    }
}

/// A map with no more than [`FINEST`] cells on a side, as far as coarser cells allow: each picture keeps its map, however large that is.
fn reduced(map: &OccupancyGrid) -> OccupancyGrid {
    let spec = map.spec();
    let scale = spec.width.max(spec.height) / FINEST;
    if scale < 2 || spec.is_empty() {
        return map.clone();
    }
    let coarse = map.coarse([Cell::new(0, 0), Cell::new(spec.width - 1, spec.height - 1)], scale);
    coarse.map(|class| match class {
        Occupancy::Unknown => Occupancy::UNKNOWN,
        Occupancy::Free => Occupancy::FREE,
        Occupancy::Occupied => Occupancy::OCCUPIED,
    })
}

/// The area to draw: the cells known at the end, and the path.
fn area(map: Option<&OccupancyGrid>, path: impl Iterator<Item = Point2<f64>>) -> (Point2<f64>, Point2<f64>) {
    let known = map.and_then(|map| Some(map.known()?.map(|cell| map.spec().center(cell))));
    let area = around(path.chain(known.into_iter().flatten()), MARGIN);
    area.unwrap_or((Point2::new(-MARGIN, -MARGIN), Point2::new(MARGIN, MARGIN)))
}

#[cfg(test)]
mod tests {
    use serde::Serialize;
    use serde_json::{Value, json};
    use zenav_protocol::messages::Plan;

    use super::super::made_up;
    use super::*;

    fn see(film: &mut Film, now: &mut Moment, key: &str, message: &impl Serialize) {
        let sample = made_up::sample(&format!("zenav/r/{key}"), message, 1);
        film.see(&sample, now, &mut RunClock::default());
    }

    fn goal(id: &str, state: &str) -> Value {
        json!({
            "id": id, "robot": "r", "state": state, "accepted": 0,
            "feedback": { "step": "drives", "distance_left": 1.0, "time_left": null, "plans": 1 },
            "request": { "place": "sink" }
        })
    }

    #[test]
    fn a_picture_keeps_of_a_large_map_no_more_than_it_shows() {
        let spec = zenav_fixtures::spec(4 * FINEST + 5, 3, 0.05);
        let wall = 4 * FINEST;
        let map = zenav_fixtures::map_with_occupied(spec, &[(wall, 1)]);
        let kept = reduced(&map);
        assert!(kept.spec().width <= FINEST + 2, "{:?}", kept.spec());
        let at = map.spec().center(Cell::new(wall, 1));
        assert_eq!(kept.at(at), Some(&Occupancy::OCCUPIED), "no wall is lost");
        let small = zenav_fixtures::map_with_occupied(zenav_fixtures::spec(2 * FINEST - 1, 1, 0.05), &[]);
        assert_eq!(reduced(&small), small);
    }

    #[test]
    fn a_finished_plan_and_the_step_of_an_ended_goal_are_no_longer_drawn() {
        let mut film = Film {
            title: String::new(),
            area: (Point2::origin(), Point2::new(1.0, 1.0)),
            footprint: Footprint::Radius(0.1),
            places: Vec::new(),
            trail: Vec::new(),
            moments: Vec::new(),
            trajectory: None,
            finished: None,
            running: None,
        };
        let plan = |trajectory_id: u64| Plan {
            trajectory_id,
            waypoints: vec![Point2::new(1.0, 2.0), Point2::new(2.0, 2.0)],
            ..made_up::plan()
        };
        let finished = |trajectory: u64| {
            json!({
                "stamp": 1, "boot_id": "b", "sequence": 1, "event": "plan_finished", "goal_id": "g", "trajectory_id": trajectory
            })
        };
        let mut now = Moment::default();
        let drawn = json!({ "places": { "sink": { "x": 1.0, "y": 2.0 } } });
        see(&mut film, &mut now, "cloud/annotations", &drawn);
        assert_eq!(film.places, [("sink".to_owned(), Point2::new(1.0, 2.0))]);
        see(&mut film, &mut now, "cloud/goal/g", &goal("g", "Active"));
        see(&mut film, &mut now, "cloud/plan", &plan(1));
        for state in ["Accepted", "Canceled"] {
            see(&mut film, &mut now, "cloud/goal/h", &goal("h", state));
        }
        assert_eq!((now.plan.len(), now.note.as_str()), (2, "drives"));
        see(&mut film, &mut now, "edge/event", &finished(0));
        assert_eq!(now.plan.len(), 2, "the end of an earlier plan");
        see(&mut film, &mut now, "edge/event", &finished(1));
        see(&mut film, &mut now, "cloud/plan", &plan(1));
        see(&mut film, &mut now, "cloud/goal/g", &goal("g", "Succeeded"));
        assert_eq!((now.plan.len(), now.note.as_str()), (0, ""));
        see(&mut film, &mut now, "cloud/plan", &plan(2));
        assert_eq!(now.plan.len(), 2);
    }
}

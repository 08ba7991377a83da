//! `zenav film`. Renders a record as an animation, or only its last picture: the growing map, and what the robot saw, planned and drove.

use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::Arc;

use nalgebra::{Point2, Vector2};
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::messages::{EventKind, GoalPhase};
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics;

use super::format::Sample;
use super::maps::Maps;
use super::reader::RecordReader;
use super::run::Run;
use super::run_clock::RunClock;
use crate::drawing::canvas::Canvas;
use crate::drawing::film::encode;
use crate::drawing::plane::PANEL;
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
    let ending = out.extension().and_then(|ending| ending.to_str()).unwrap_or_default();
    let moving = || {
        let film = Film::of(&args.record, args.robot.as_deref(), PICTURES)?;
        encode(film.moments.len(), SHOWN, |nth| film.picture(nth))
    };
    match ending.to_ascii_lowercase().as_str() {
        "gif" => files::write(&out, moving()?)?,
        "mp4" => write_mp4(moving()?, &out)?,
        "png" => {
            let film = Film::of(&args.record, args.robot.as_deref(), 1)?;
            files::write(&out, film.picture(film.moments.len().saturating_sub(1))?.png()?)?;
        }
        _ => {
            return Err(Failure::usage(format!(
                "--out {}: expected a name that ends with .gif, .mp4 or .png",
                out.display()
            )));
        }
    }
    output::line(&format!("wrote {}", out.display()));
    Ok(exit_code::OK)
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
    trail: Vec<Point2<f64>>,
    moments: Vec<Moment>,
    /// Trajectory of the plan that is drawn, and the one that the robot finished last.
    trajectory: Option<u64>,
    finished: Option<u64>,
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
                return Err(Failure::not_found(format!(
                    "{}: no such robot in the record; it has {}",
                    path.display(),
                    if names.is_empty() {
                        "none".to_owned()
                    } else {
                        names.join(", ")
                    }
                )));
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
            trail: Vec::new(),
            moments: Vec::new(),
            trajectory: None,
            finished: None,
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
            now.map = maps.grid(name).cloned().map(Arc::new);
        }
        now.driven = self.trail.len();
        // Nothing can be drawn before the first map.
        if now.map.is_some() {
            self.moments.push(now.clone());
        }
    }

    fn see(&mut self, sample: &Sample, now: &mut Moment, clock: &mut RunClock) {
        if let Ok(Some((_, pose))) = sample.message(&topics::POSE) {
            now.secs = clock.advance(pose.stamp);
            now.pose = pose.map_from_base;
            let at = now.pose.position();
            if self.trail.last().is_none_or(|last| (at - last).norm() > 0.02) {
                self.trail.push(at);
            }
        } else if let Ok(Some((_, scan))) = sample.message(&topics::SCAN) {
            let laser = scan.map_from_laser();
            now.scan = scan.returns().map(|point| laser.transform_point(point)).collect();
        } else if let Ok(Some((_, plan))) = sample.message(&topics::PLAN) {
            // A plan is renewed once more after its end was reached.
            if self.finished == Some(plan.trajectory_id) {
                return;
            }
            self.trajectory = Some(plan.trajectory_id);
            let points: Vec<Point2<f64>> = plan.trajectory.iter().map(|point| point.position()).collect();
            // A plan without a time law has only waypoints.
            now.plan = Arc::new(if points.is_empty() { plan.waypoints } else { points });
        } else if let Ok(Some((_, goal))) = sample.message(&topics::GOAL_STATE) {
            if goal.state != GoalPhase::Rejected {
                let there = goal.legs.last().and_then(|leg| leg.goal);
                now.goal = there.map(|goal| Point2::new(goal.x, goal.y));
                let is_end = goal.state.is_end();
                now.note = if is_end { String::new() } else { goal.feedback.step };
            }
        } else if let Ok(Some((_, event))) = sample.message(&topics::EVENT) {
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

/// The area to draw: the cells known at the end, and the path.
fn area(map: Option<&OccupancyGrid>, path: impl Iterator<Item = Point2<f64>>) -> (Point2<f64>, Point2<f64>) {
    let known = map.into_iter().flat_map(|map| {
        let cells = map.values().iter().enumerate();
        let known = cells.filter(|(_, value)| Occupancy::of(**value) != Occupancy::Unknown);
        known.map(|(index, _)| map.spec().center(map.spec().cell(index)))
    });
    let points = path
        .chain(known)
        .filter(|point| point.x.is_finite() && point.y.is_finite());
    let bounds = points.fold(None, |bounds: Option<(Point2<f64>, Point2<f64>)>, point| {
        let (low, high) = bounds.unwrap_or((point, point));
        Some((low.inf(&point), high.sup(&point)))
    });
    let (low, high) = bounds.unwrap_or((Point2::origin(), Point2::origin()));
    let margin = Vector2::repeat(MARGIN);
    (low - margin, high + margin)
}

#[cfg(test)]
mod tests {
    use serde_json::{Value, json};
    use zenav_protocol::codec::Encoding;

    use super::super::format::Kind;
    use super::*;

    fn see(film: &mut Film, now: &mut Moment, key: &str, message: &Value) {
        let sample = Sample {
            key: format!("zenav/r/{key}"),
            encoding: Encoding::Json.mime().to_owned(),
            kind: Kind::Put,
            bytes: message.to_string().into_bytes(),
            attachment: None,
            logged: 1,
            published: None,
        };
        film.see(&sample, now, &mut RunClock::default());
    }

    fn goal(state: &str) -> Value {
        json!({
            "id": "g", "robot": "r", "state": state, "accepted": 0,
            "feedback": { "step": "drives", "distance_left": 1.0, "time_left": null, "plans": 1 },
            "request": { "place": "sink" }
        })
    }

    #[test]
    fn a_finished_plan_and_the_step_of_an_ended_goal_are_no_longer_drawn() {
        let mut film = Film {
            title: String::new(),
            area: (Point2::origin(), Point2::new(1.0, 1.0)),
            footprint: Footprint::Radius(0.1),
            trail: Vec::new(),
            moments: Vec::new(),
            trajectory: None,
            finished: None,
        };
        let plan = |trajectory: u64| {
            json!({
                "goal_id": "g", "epoch": 1, "revision": { "incarnation": 1, "counter": 1 }, "trajectory_id": trajectory,
                "map": { "id": "m", "revision": 1 }, "frame": "map", "based_on": { "stamp": 1, "boot_id": "b" },
                "valid_for": 5.0, "waypoints": [[1.0, 2.0], [2.0, 2.0]], "trajectory": [], "splice": null,
                "statistics": { "planner": "astar", "search_ms": 0.0, "corridor_ms": 0.0, "geometry_ms": 0.0,
                    "timing_ms": 0.0, "length": 0.0, "duration": 0.0, "min_clearance": null, "status": "waypoints", "solver": "" },
            })
        };
        let finished = |trajectory: u64| {
            json!({
                "stamp": 1, "boot_id": "b", "sequence": 1, "event": "plan_finished", "goal_id": "g", "trajectory_id": trajectory
            })
        };
        let mut now = Moment::default();
        see(&mut film, &mut now, "cloud/goal/g", &goal("Active"));
        see(&mut film, &mut now, "cloud/plan", &plan(1));
        assert_eq!((now.plan.len(), now.note.as_str()), (2, "drives"));
        see(&mut film, &mut now, "edge/event", &finished(0));
        assert_eq!(now.plan.len(), 2, "the end of an earlier plan");
        see(&mut film, &mut now, "edge/event", &finished(1));
        see(&mut film, &mut now, "cloud/plan", &plan(1));
        see(&mut film, &mut now, "cloud/goal/g", &goal("Succeeded"));
        assert_eq!((now.plan.len(), now.note.as_str()), (0, ""));
        see(&mut film, &mut now, "cloud/plan", &plan(2));
        assert_eq!(now.plan.len(), 2);
    }
}

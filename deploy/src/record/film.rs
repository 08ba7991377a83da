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
            let points: Vec<Point2<f64>> = plan.trajectory.iter().map(|point| point.position()).collect();
            // A plan without a time law has only waypoints.
            now.plan = Arc::new(if points.is_empty() { plan.waypoints } else { points });
        } else if let Ok(Some((_, goal))) = sample.message(&topics::GOAL_STATE) {
            if goal.state != GoalPhase::Rejected {
                let there = goal.legs.last().and_then(|leg| leg.goal);
                now.goal = there.map(|goal| Point2::new(goal.x, goal.y));
                now.note = goal.feedback.step;
            }
        } else if let Ok(Some((_, event))) = sample.message(&topics::EVENT)
            && matches!(event.kind, EventKind::Bumped | EventKind::Stopped { .. })
        {
            now.note = super::words::event(&event.kind);
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
            ..Scene::new(&format!("zenav {}", self.title), map)
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

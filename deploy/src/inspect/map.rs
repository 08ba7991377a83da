//! `zenav map`. Shows, saves, loads, converts and builds maps: from a running robot, from files, from logs.

use std::path::{Path, PathBuf};
use std::time::Duration;

use serde::Serialize;
use zenav_mapping::{CellCounts, write_map};
use zenav_protocol::bus::Bus;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::OccupancyGrid;
use zenav_protocol::messages::MapRequest;
use zenav_protocol::robot::Footprint;
use zenav_protocol::topics;

use super::map_control::{self, Mapping};
use super::{build, convert};
use crate::arguments::{self, whole_in};
use crate::completion;
use crate::connect::{self, RobotArgs};
use crate::drawing::scene::Scene;
use crate::drawing::terminal::{self, Mark, Screen};
use crate::exit_code;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::live_map::LiveMap;
use crate::output::{self, Format};
use crate::slam::{self, MergeArgs};

/// Narrowest useful picture, in columns.
const LEAST_WIDTH: usize = 8;

/// Maps.
#[derive(Debug, clap::Args)]
#[command(
    after_help = "Examples:\n  zenav map show\n  zenav map watch\n  zenav map save kitchen          kitchen.yaml and kitchen.pgm, here\n  zenav map load kitchen.yaml\n  zenav map store                 the next start begins with it\n  zenav map convert den312d.map den312d.yaml"
)]
pub struct MapArgs {
    #[command(flatten)]
    robot: RobotArgs,
    /// Output format
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: MapCommand,
}

#[derive(Debug, clap::Subcommand)]
enum MapCommand {
    /// Save a robot's map as `map_server` files (NAME.pgm, NAME.yaml)
    Save {
        /// Path without extension
        #[arg(default_value = "map")]
        name: PathBuf,
    },
    /// Draw a robot's map, or a map file, in the terminal or as a picture
    Show {
        /// Map file; without one, the robot's map
        file: Option<PathBuf>,
        /// Largest width in columns [default: the terminal's]
        #[arg(long, value_parser = whole_in(LEAST_WIDTH..=1000))]
        width: Option<usize>,
        /// Write a PNG picture instead
        #[arg(long, value_name = "FILE.png", conflicts_with = "width")]
        out: Option<PathBuf>,
    },
    /// Watch a robot on its map: plan, scan, goal, places and other robots, five times a second, until Ctrl-C
    Watch,
    /// Switch to another map: a file on this machine, or a stored one by name; the robot stops for it
    Load {
        /// Map file, or name of a stored map
        #[arg(value_name = "FILE|NAME", add = completion::stored_maps_and_files())]
        source: String,
        /// Keep mapping into it; otherwise scans do not change it
        #[arg(long)]
        live: bool,
    },
    /// Store a robot's map in mapping's data folder: for the next start, or under a name for `map load`
    Store {
        /// Name [default: the map that the next start loads]
        #[arg(value_parser = arguments::name, add = completion::stored_maps())]
        name: Option<String>,
    },
    /// Start a new map; the robot stops for it, stored maps stay
    Reset,
    /// Hold a robot's map: scans no longer change it
    Hold,
    /// Insert scans into a held map again
    Resume,
    /// List the maps stored under a name
    List,
    /// Convert a map file to another format
    Convert(convert::ConvertArgs),
    /// Build a map from a CARMEN log with poses
    Build(build::BuildArgs),
    /// Merge two SLAM sessions of one building into one map
    Merge(MergeArgs),
}

/// Saves, draws, loads, stores, converts and builds maps.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for a missing file or map, [`exit_code::USAGE`] for a bad one.
pub fn map(args: &MapArgs) -> Outcome {
    match &args.command {
        MapCommand::Save { name } => save(&args.robot, args.output, name),
        MapCommand::Show { file, width, out } => {
            show(&args.robot, args.output, file.as_deref(), *width, out.as_deref())
        }
        MapCommand::Watch if args.output != Format::Table => Err(Failure::usage(
            "-o: `map watch` draws for people; `map show -o json` or `topic echo pose -o json` tell a program",
        )),
        MapCommand::Watch => watch(&args.robot),
        MapCommand::Load { source, live } => map_control::load(&args.robot, args.output, source, *live),
        MapCommand::Store { name } => map_control::store(&args.robot, args.output, name.as_deref()),
        MapCommand::Reset => map_control::reset(&args.robot, args.output),
        MapCommand::Hold => map_control::hold_or_resume(&args.robot, args.output, Mapping::Hold),
        MapCommand::Resume => map_control::hold_or_resume(&args.robot, args.output, Mapping::Resume),
        MapCommand::List => map_control::list(&args.robot, args.output),
        MapCommand::Convert(convert_args) => convert::convert(convert_args, args.output),
        MapCommand::Build(build_args) => build::build(build_args, args.output),
        MapCommand::Merge(merge_args) => slam::merge(merge_args, args.output),
    }
}

/// Summary of a map.
#[derive(Debug, Serialize)]
pub(super) struct Summary {
    #[serde(skip_serializing_if = "Option::is_none")]
    file: Option<PathBuf>,
    #[serde(skip_serializing_if = "Option::is_none")]
    id: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    revision: Option<u64>,
    width: u32,
    height: u32,
    resolution: f64,
    origin: [f64; 2],
    occupied: u64,
    free: u64,
    unknown: u64,
}

impl Summary {
    /// A map in a file.
    pub(super) fn of_file(file: &Path, grid: &OccupancyGrid) -> Self {
        Self {
            file: Some(file.to_owned()),
            ..Self::of(grid)
        }
    }

    fn of(grid: &OccupancyGrid) -> Self {
        let (spec, counts) = (grid.spec(), CellCounts::of(grid.values()));
        Self {
            file: None,
            id: None,
            revision: None,
            width: spec.width,
            height: spec.height,
            resolution: spec.resolution,
            origin: [spec.origin.x, spec.origin.y],
            occupied: counts.occupied,
            free: counts.free,
            unknown: counts.unknown,
        }
    }

    pub(super) fn line(&self) -> String {
        let file = output::piece(self.file.as_ref(), |file| format!("{}: ", file.display()));
        let revision = output::piece(self.revision, |revision| format!(", revision {revision}"));
        format!(
            "{file}{} x {} cells of {} m{revision}, {} occupied, {} free, {} unknown",
            self.width, self.height, self.resolution, self.occupied, self.free, self.unknown
        )
    }
}

/// A robot's current map, from the mapping service.
async fn fetch(bus: &Bus, robot: &str, within: Duration) -> Result<(OccupancyGrid, Summary), Failure> {
    let reply = bus.ask(&topics::MAP, &[robot], &MapRequest::default(), within).await?;
    let grid = reply
        .grid()
        .map_err(|error| Failure::failed(format!("the map of {robot} is not sane: {error}")))?;
    let summary = Summary {
        id: Some(reply.info.map.id),
        revision: Some(reply.info.map.revision),
        ..Summary::of(&grid)
    };
    Ok((grid, summary))
}

fn save(robot: &RobotArgs, format: Format, name: &Path) -> Outcome {
    let patience = robot.link.patience();
    let stem = name
        .file_name()
        .and_then(|stem| stem.to_str())
        .ok_or_else(|| Failure::usage(format!("{}: expected a file's name without an ending", name.display())))?;
    // `map.yaml` names the same files as `map`.
    let stem = stem
        .strip_suffix(".yaml")
        .or_else(|| stem.strip_suffix(".pgm"))
        .unwrap_or(stem);
    connect::on_robot(robot, async |bus, robot| {
        let (grid, mut summary) = fetch(&bus, &robot, patience).await?;
        if grid.spec().is_empty() {
            return Err(Failure::not_found(format!(
                "{robot} has no map yet: nothing was written"
            )));
        }
        let label = format!(
            "{} {}",
            summary.id.as_deref().unwrap_or_default(),
            summary.revision.unwrap_or_default()
        );
        let folder = name
            .parent()
            .filter(|folder| !folder.as_os_str().is_empty())
            .unwrap_or_else(|| Path::new("."));
        let wanted = folder.join(format!("{stem}.yaml"));
        summary.file = Some(write_map(folder, stem, &grid, &label).map_err(files::unwritten(&wanted))?);
        output::value(format, &summary, Summary::line)
    })
}

fn show(robot: &RobotArgs, format: Format, file: Option<&Path>, width: Option<usize>, out: Option<&Path>) -> Outcome {
    if let Some(out) = out.filter(|out| files::ending(out) != "png") {
        return Err(files::unknown_ending(out, ".png"));
    }
    let mut screen = Screen::of_terminal(3).unwrap_or(PLAIN_SCREEN);
    if let Some(width) = width {
        (screen.width, screen.height) = (width, usize::MAX);
    }
    let (grid, summary, pose) = match file {
        Some(file) => {
            let grid = files::map(file)?;
            let summary = Summary::of_file(file, &grid);
            (grid, summary, None)
        }
        None => {
            let patience = robot.link.patience();
            connect::on_robot(robot, async |bus, robot| {
                let mut poses = bus.latest(&topics::POSE, &[&robot])?;
                let (grid, summary) = fetch(&bus, &robot, patience).await?;
                // The map is drawn even without the robot's pose.
                let pose = tokio::time::timeout(Duration::from_millis(500), poses.next())
                    .await
                    .ok()
                    .flatten();
                Ok((grid, summary, pose.map(|pose| pose.message.map_from_base)))
            })?
        }
    };
    if let Some(out) = out {
        picture(out, &grid, pose, &summary)?;
    }
    output::value(format, &summary, |summary| match out {
        Some(out) => format!("{}\nwrote {}", summary.line(), out.display()),
        None => {
            let robot: Vec<Mark<'_>> = pose.map(Mark::Robot).into_iter().collect();
            format!("{}\n{}", terminal::map(&grid, &robot, screen), summary.line())
        }
    })
}

/// If stdout is no terminal, it prints a picture every second, one below the other.
fn watch(robot: &RobotArgs) -> Outcome {
    connect::on_robot(robot, async |bus, robot| {
        let mut live = LiveMap::new(&bus, &robot)?;
        let bar = output::display();
        if let Some(bar) = &bar {
            bar.set_message("Ctrl-C ends it");
            let _drawing = live.above(bar);
            let _ = tokio::signal::ctrl_c().await;
            return Ok(exit_code::INTERRUPTED);
        }
        let mut pace = tokio::time::interval(Duration::from_secs(1));
        loop {
            tokio::select! {
                biased;
                _ = tokio::signal::ctrl_c() => return Ok(exit_code::INTERRUPTED),
                _ = pace.tick() => {}
            }
            if let Some(news) = live.news().await {
                output::note(news);
            }
            output::line(&live.frame(PLAIN_SCREEN).await);
        }
    })
}

/// Without a terminal to query.
const PLAIN_SCREEN: Screen = Screen {
    width: 120,
    height: 60,
    colors: false,
};

/// Approximate length of a picture's longer side, px.
const PICTURE: u32 = 1200;
/// Radius of the dot drawn for a robot with unknown footprint, m.
const ROBOT: f64 = 0.15;

/// Writes a map as a picture.
fn picture(out: &Path, grid: &OccupancyGrid, pose: Option<Pose2>, summary: &Summary) -> Result<(), Failure> {
    if grid.spec().is_empty() {
        return Err(Failure::not_found("the map is empty: nothing was drawn"));
    }
    let name = summary.file.as_ref().and_then(|file| file.file_name());
    let name = name.map_or_else(|| "map".into(), |name| name.to_string_lossy());
    let footprint = Footprint::Radius(ROBOT);
    let scene = Scene {
        notes: vec![
            format!("{} x {} cells", summary.width, summary.height),
            format!("of {} m", summary.resolution),
        ],
        robot: pose.map(|pose| (pose, &footprint)),
        ..Scene::new(&name, grid)
    };
    files::write(out, scene.draw(PICTURE)?.png()?)
}

//! How are maps looked at, kept and made? From a running robot, from files, from logs.

use std::io::IsTerminal as _;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use clap::ValueEnum;
use indicatif::{ProgressBar, ProgressStyle};
use serde::Serialize;
use zenav_cloud::mapping::carmen::{self, LOG_BEAMS};
use zenav_cloud::mapping::map_file;
use zenav_cloud::mapping::map_yaml::MapMode;
use zenav_cloud::mapping::{CellCounts, InsertMode, image};
use zenav_protocol::bus::Bus;
use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
use zenav_protocol::messages::{MapRequest, Scan, exit_code};
use zenav_protocol::topics;

use super::draw::{self, Canvas};
use crate::connect::{self, RobotArgs, positive};
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};

/// Maps.
#[derive(Debug, clap::Args)]
pub struct MapArgs {
    /// Which robot.
    #[command(flatten)]
    robot: RobotArgs,
    /// Form of what is printed
    #[arg(short, long, global = true, value_enum, default_value_t)]
    output: Format,
    #[command(subcommand)]
    command: MapCommand,
}

#[derive(Debug, clap::Subcommand)]
enum MapCommand {
    /// Save a robot's map as `map_server` files (NAME.pgm, NAME.yaml)
    Save {
        /// Where, without an ending
        #[arg(default_value = "map")]
        name: PathBuf,
    },
    /// Draw a map in the terminal: a robot's, or a file's
    Show {
        /// A map file; without one, the robot's map
        file: Option<PathBuf>,
        /// Columns at most [default: the terminal's]
        #[arg(long)]
        width: Option<usize>,
    },
    /// Convert a map file to another kind
    Convert(ConvertArgs),
    /// Build a map from a CARMEN log with poses
    Build(BuildArgs),
}

#[derive(Debug, clap::Args)]
struct ConvertArgs {
    /// Map to read: .yaml, .pgm, .png, .map
    input: PathBuf,
    /// Map to write: .yaml (with a .pgm), .pgm or .png (with a .yaml), .map
    target: PathBuf,
    /// How cells become grey values
    #[arg(long, value_enum, default_value_t)]
    mode: ModeArg,
    /// Side of a cell where the input does not say, m
    #[arg(long, value_name = "M", value_parser = positive)]
    resolution: Option<f64>,
}

/// How cells become grey values.
#[derive(Clone, Copy, Debug, Default, ValueEnum)]
enum ModeArg {
    /// Occupied, free, unknown
    #[default]
    Trinary,
    /// Shades, unknown transparent (.png only)
    Scale,
    /// The values themselves
    Raw,
}

#[derive(Debug, clap::Args)]
struct BuildArgs {
    /// CARMEN log, compressed by gzip or not
    #[arg(long, value_name = "FILE")]
    log: PathBuf,
    /// Side of a cell, m
    #[arg(long, value_name = "M", default_value_t = 0.05, value_parser = positive)]
    resolution: f64,
    /// Folder for map.pgm and map.yaml
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    /// Every beam exactly, or by filled wedges
    #[arg(long, value_enum, default_value_t)]
    mode: BuildMode,
}

/// How scans are drawn into a map.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
enum BuildMode {
    /// Every beam, exactly
    #[default]
    Reference,
    /// Wedges between beams are filled; its agreement with `reference` is reported
    Fast,
}

/// Saves, draws, converts and builds maps.
///
/// # Errors
/// [`exit_code::NOT_FOUND`] for a missing file or map, [`exit_code::USAGE`] for a bad one.
pub fn map(args: &MapArgs) -> Outcome {
    match &args.command {
        MapCommand::Save { name } => save(&args.robot, args.output, name),
        MapCommand::Show { file, width } => show(&args.robot, args.output, file.as_deref(), *width),
        MapCommand::Convert(convert_args) => convert(convert_args, args.output),
        MapCommand::Build(build_args) => build(build_args, args.output),
    }
}

/// What is said of a map.
#[derive(Debug, Serialize)]
struct Summary {
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
    fn of(grid: &OccupancyGrid) -> Self {
        let (
            GridSpec {
                origin,
                resolution,
                width,
                height,
            },
            counts,
        ) = (*grid.spec(), CellCounts::of(grid.values()));
        Self {
            file: None,
            id: None,
            revision: None,
            width,
            height,
            resolution,
            origin: [origin.x, origin.y],
            occupied: counts.occupied,
            free: counts.free,
            unknown: counts.unknown,
        }
    }

    fn line(&self) -> String {
        let file = self
            .file
            .as_ref()
            .map(|file| format!("{}: ", file.display()))
            .unwrap_or_default();
        let revision = self
            .revision
            .map(|revision| format!(", revision {revision}"))
            .unwrap_or_default();
        format!(
            "{file}{} x {} cells of {} m{revision}, {} occupied, {} free, {} unknown",
            self.width, self.height, self.resolution, self.occupied, self.free, self.unknown
        )
    }
}

/// A robot's map as the mapping service has it.
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
    // `map.yaml` means the same files as `map`.
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
        summary.file =
            Some(map_file::write_map(folder, stem, &grid, &label).map_err(|error| Failure::failed(error.to_string()))?);
        output::value(format, &summary, Summary::line)?;
        Ok(exit_code::OK)
    })
}

fn show(robot: &RobotArgs, format: Format, file: Option<&Path>, width: Option<usize>) -> Outcome {
    let terminal = std::io::stdout().is_terminal();
    // A window of no size is one whose size is not known.
    let size = crossterm::terminal::size()
        .ok()
        .filter(|(columns, rows)| terminal && *columns > 0 && *rows > 4);
    let canvas = Canvas {
        width: width.unwrap_or_else(|| size.map_or(100, |(columns, _)| usize::from(columns))),
        height: if width.is_some() {
            usize::MAX
        } else {
            size.map_or(60, |(_, rows)| usize::from(rows) - 3)
        },
        colors: terminal && std::env::var_os("NO_COLOR").is_none(),
    };
    let (grid, summary, pose) = match file {
        Some(file) => {
            let grid = files::map(file)?;
            let summary = Summary {
                file: Some(file.to_owned()),
                ..Summary::of(&grid)
            };
            (grid, summary, None)
        }
        None => {
            let patience = robot.link.patience();
            connect::on_robot(robot, async |bus, robot| {
                let mut poses = bus.latest(&topics::POSE, &[&robot])?;
                let (grid, summary) = fetch(&bus, &robot, patience).await?;
                // A map can be drawn without its robot.
                let pose = tokio::time::timeout(Duration::from_millis(500), poses.next())
                    .await
                    .ok()
                    .flatten();
                Ok((grid, summary, pose.map(|pose| pose.message.map_from_base)))
            })?
        }
    };
    output::value(format, &summary, |summary| {
        format!("{}\n{}", draw::map(&grid, pose, canvas), summary.line())
    })?;
    Ok(exit_code::OK)
}

fn convert(args: &ConvertArgs, format: Format) -> Outcome {
    let grid = match args.resolution {
        Some(resolution) if args.input.is_file() => {
            map_file::read_map(&args.input, resolution).map_err(|error| Failure::usage(error.to_string()))?
        }
        _ => files::map(&args.input)?,
    };
    let mode = match args.mode {
        ModeArg::Trinary => MapMode::Trinary,
        ModeArg::Scale => MapMode::Scale,
        ModeArg::Raw => MapMode::Raw,
    };
    let failed = |error: &dyn std::fmt::Display| Failure::failed(error.to_string());
    let target = args.target.as_path();
    let ending = target
        .extension()
        .and_then(|ending| ending.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase();
    let picture = match ending.as_str() {
        "map" => {
            map_file::write_atomically(target, moving_ai(&grid).as_bytes()).map_err(|error| failed(&error))?;
            None
        }
        "yaml" | "yml" if matches!(mode, MapMode::Scale) => {
            return Err(Failure::usage(
                "--mode scale needs a .png: a .pgm has no transparent cells",
            ));
        }
        "pgm" if matches!(mode, MapMode::Scale) => {
            return Err(Failure::usage(
                "--mode scale needs a .png: a .pgm has no transparent cells",
            ));
        }
        "yaml" | "yml" => Some(target.with_extension("pgm")),
        "pgm" | "png" => Some(target.to_owned()),
        _ => {
            return Err(Failure::usage(format!(
                "{}: expected a map: .yaml, .pgm, .png or .map",
                target.display()
            )));
        }
    };
    let mut written = target.to_owned();
    if let Some(picture) = picture {
        let pixels = map_file::to_image(&grid, mode);
        let bytes = if picture.extension().is_some_and(|ending| ending == "png") {
            image::encode_png(&pixels).map_err(|error| failed(&error))?
        } else {
            image::encode_pgm(&pixels)
        };
        let name = picture.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        let yaml = if matches!(ending.as_str(), "yaml" | "yml") {
            target.to_owned()
        } else {
            target.with_extension("yaml")
        };
        map_file::write_atomically(&picture, &bytes).map_err(|error| failed(&error))?;
        map_file::write_atomically(&yaml, map_file::to_yaml(&grid, mode, name).to_text(&[]).as_bytes())
            .map_err(|error| failed(&error))?;
        written = yaml;
    }
    output::value(
        format,
        &Summary {
            file: Some(written),
            ..Summary::of(&grid)
        },
        Summary::line,
    )?;
    Ok(exit_code::OK)
}

/// A Moving AI map: free cells are passable, all others are not.
fn moving_ai(grid: &OccupancyGrid) -> String {
    let spec = grid.spec();
    let mut text = format!("type octile\nheight {}\nwidth {}\nmap\n", spec.height, spec.width);
    for row in grid.values().chunks_exact((spec.width as usize).max(1)).rev() {
        text.extend(row.iter().map(|value| {
            if Occupancy::of(*value) == Occupancy::Free {
                '.'
            } else {
                '@'
            }
        }));
        text.push('\n');
    }
    text
}

/// What `map build` prints.
#[derive(Debug, Serialize)]
struct Built {
    scans: u64,
    scans_per_s: f64,
    beams: u64,
    cells: u64,
    occupied: u64,
    free: u64,
    unknown: u64,
    agreement_occupied: f64,
    agreement_free: f64,
    width: u32,
    height: u32,
    resolution: f64,
    map: PathBuf,
}

fn build(args: &BuildArgs, format: Format) -> Outcome {
    let scans = read_log(&args.log)?;
    let mode = match args.mode {
        BuildMode::Reference => InsertMode::Reference,
        BuildMode::Fast => InsertMode::Fast,
    };
    let start = Instant::now();
    let (grid, report) = carmen::build_map(&scans, args.resolution, mode, &LOG_BEAMS);
    let took = start.elapsed().as_secs_f64();
    let agreement = match args.mode {
        BuildMode::Reference => carmen::Agreement {
            occupied: 1.0,
            free: 1.0,
        },
        BuildMode::Fast => carmen::agreement(
            &carmen::build_map(&scans, args.resolution, InsertMode::Reference, &LOG_BEAMS).0,
            &grid,
        ),
    };
    let map = map_file::write_map(&args.out, "map", &grid, "built from a log")
        .map_err(|error| Failure::failed(error.to_string()))?;
    let built = Built {
        scans: report.scans,
        scans_per_s: report.scans as f64 / took.max(1e-9),
        beams: report.beams,
        cells: report.cells,
        occupied: report.occupied,
        free: report.free,
        unknown: report.unknown,
        agreement_occupied: agreement.occupied,
        agreement_free: agreement.free,
        width: grid.spec().width,
        height: grid.spec().height,
        resolution: args.resolution,
        map,
    };
    output::value(format, &built, |built| {
        format!(
            "{}: {} scans at {:.0} scans/s, {} x {} cells of {} m, {} occupied, {} free",
            built.map.display(),
            built.scans,
            built.scans_per_s,
            built.width,
            built.height,
            built.resolution,
            built.occupied,
            built.free
        )
    })?;
    Ok(exit_code::OK)
}

fn read_log(path: &Path) -> Result<Vec<Scan>, Failure> {
    if !path.is_file() {
        return Err(Failure::not_found(format!("{}: no such log", path.display())));
    }
    let bad = |error: &dyn std::fmt::Display| Failure::usage(format!("{}: {error}", path.display()));
    let progress = std::io::stderr().is_terminal().then(|| {
        let bar = ProgressBar::new_spinner();
        if let Ok(style) = ProgressStyle::with_template("{spinner} {pos} scans read") {
            bar.set_style(style);
        }
        bar
    });
    let mut scans = Vec::new();
    for scan in carmen::open(path).map_err(|error| bad(&error))? {
        scans.push(scan.map_err(|error| bad(&error))?);
        if let Some(bar) = &progress {
            bar.inc(1);
        }
    }
    if let Some(bar) = progress {
        bar.finish_and_clear();
    }
    if scans.is_empty() {
        Err(bad(&"no laser scan with a pose in it (FLASER, ROBOTLASER1)"))
    } else {
        Ok(scans)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, clippy::expect_used, reason = "tests")]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::grid::Cell;

    use super::*;

    fn grid() -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 2.0),
            resolution: 0.5,
            width: 3,
            height: 2,
        };
        let mut grid = OccupancyGrid::filled(spec, Occupancy::FREE);
        grid[Cell::new(0, 0)] = Occupancy::OCCUPIED;
        grid[Cell::new(2, 1)] = Occupancy::UNKNOWN;
        grid
    }

    #[test]
    fn a_moving_ai_map_counts_rows_from_the_top() {
        assert_eq!(moving_ai(&grid()), "type octile\nheight 2\nwidth 3\nmap\n..@\n@..\n");
    }

    #[test]
    fn a_map_survives_conversion_and_back() {
        let folder = tempfile::tempdir().unwrap();
        map_file::write_map(folder.path(), "a", &grid(), "test").unwrap();
        for (target, mode) in [
            ("b.png", ModeArg::Trinary),
            ("c.png", ModeArg::Scale),
            ("d.pgm", ModeArg::Raw),
            ("e.yaml", ModeArg::Trinary),
        ] {
            let args = ConvertArgs {
                input: folder.path().join("a.yaml"),
                target: folder.path().join(target),
                mode,
                resolution: None,
            };
            convert(&args, Format::Json).unwrap();
            let back = files::map(&folder.path().join(target).with_extension("yaml")).unwrap();
            assert_eq!(back, grid(), "{target}");
        }
        let bad = ConvertArgs {
            input: folder.path().join("a.yaml"),
            target: folder.path().join("f.jpg"),
            mode: ModeArg::Trinary,
            resolution: None,
        };
        assert_eq!(convert(&bad, Format::Json).unwrap_err().code, exit_code::USAGE);
        let none = ConvertArgs {
            input: folder.path().join("none.yaml"),
            ..bad
        };
        assert_eq!(convert(&none, Format::Json).unwrap_err().code, exit_code::NOT_FOUND);
    }
}

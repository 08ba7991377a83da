//! Input files. Worlds, robots and maps, by path or by shipped name.

use std::io::{BufRead as _, BufReader, Read};
use std::path::Path;
use std::sync::Arc;

use flate2::read::MultiGzDecoder;
use zenav_edge::trackers::Law;
use zenav_mapping::MapFileError;
use zenav_protocol::geometry::Pose2;
use zenav_protocol::grid::{Occupancy, OccupancyGrid};
use zenav_protocol::robot::{self, Footprint, RobotError, RobotModel};
use zenav_sim::{World, world};
use zenav_space::Zones;

use crate::exit_code;
use crate::failure::Failure;
use crate::output::listed;

/// First bytes of a gzip file (RFC 1952).
const GZIP: [u8; 2] = [0x1f, 0x8b];
/// Largest text file that is read, bytes.
const MAX_TEXT: u64 = 64 * 1024 * 1024;
/// Free space required around the start in a world made from a map, m.
const ROOM: f64 = 0.6;
/// Cell side of a map file that gives none (a Moving AI map or a bare image), m.
pub const BARE_RESOLUTION: f64 = 0.05;

/// Reads a user's text file.
///
/// # Errors
/// Exit code 3 if it is missing, 2 if it is too large or not text.
pub fn text(path: &Path) -> Result<String, Failure> {
    text_within(path, MAX_TEXT)
}

/// As [`text`], for at most `limit` bytes, plain or gzip-compressed.
///
/// # Errors
/// As [`text`].
pub fn text_within(path: &Path, limit: u64) -> Result<String, Failure> {
    String::from_utf8(bytes_within(path, limit)?)
        .map_err(|_| Failure::usage(format!("{}: expected text in UTF-8", path.display())))
}

/// Reads at most `limit` bytes of a file, plain or gzip-compressed.
///
/// # Errors
/// Exit code 3 if it is missing, 2 if it is too large.
pub fn bytes_within(path: &Path, limit: u64) -> Result<Vec<u8>, Failure> {
    let named = |code, what: &str| Failure::new(code, format!("{}: {what}", path.display()));
    let missing = |error: std::io::Error| named(exit_code::NOT_FOUND, &error.to_string());
    let mut bytes = Vec::new();
    let source: Box<dyn Read> = if path == Path::new("-") {
        Box::new(std::io::stdin())
    } else {
        let kind = std::fs::metadata(path).map_err(missing)?.file_type();
        // A device may have no end.
        if !kind.is_file() && !is_pipe(kind) {
            return Err(named(
                exit_code::USAGE,
                "expected a file, a pipe, or `-` for standard input",
            ));
        }
        Box::new(std::fs::File::open(path).map_err(missing)?)
    };
    let mut file = BufReader::new(source);
    let is_compressed = file.fill_buf().map_err(missing)?.starts_with(&GZIP);
    let content: &mut dyn Read = if is_compressed {
        &mut MultiGzDecoder::new(file)
    } else {
        &mut file
    };
    content.take(limit + 1).read_to_end(&mut bytes).map_err(missing)?;
    if bytes.len() as u64 > limit {
        return Err(named(exit_code::USAGE, &format!("expected at most {limit} bytes")));
    }
    Ok(bytes)
}

#[cfg(unix)]
fn is_pipe(kind: std::fs::FileType) -> bool {
    use std::os::unix::fs::FileTypeExt as _;
    kind.is_fifo()
}

#[cfg(not(unix))]
fn is_pipe(_: std::fs::FileType) -> bool {
    false
}

/// Writes a file.
///
/// # Errors
/// A file that cannot be written, with its name.
pub fn write(path: &Path, bytes: impl AsRef<[u8]>) -> Result<(), Failure> {
    std::fs::write(path, bytes).map_err(Failure::failed_at(path))
}

/// Refuses a file that cannot be written, before the work for its content begins. The file is created; one that exists stays as it is.
///
/// # Errors
/// A file that cannot be written, with its name.
pub fn writable(path: &Path) -> Result<(), Failure> {
    let opened = std::fs::OpenOptions::new().create(true).append(true).open(path);
    opened.map(drop).map_err(Failure::failed_at(path))
}

/// Writes a map file atomically: no reader ever sees part of it.
///
/// # Errors
/// A file that cannot be written, with its name.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> Result<(), Failure> {
    zenav_mapping::write_atomically(path, bytes).map_err(Failure::failed)
}

/// A failure to write a map, reported with this file's name instead of the name of its image, which is written first; for `map_err`.
pub fn unwritten(path: &Path) -> impl FnOnce(MapFileError) -> Failure {
    move |error| match error {
        MapFileError::Io { source, .. } => Failure::failed_at(path)(source),
        other => Failure::failed(other),
    }
}

/// Zones of a map from a file; none without a file.
///
/// # Errors
/// Exit code 3 if there is no such file, 2 if it is bad, with line and key.
pub fn zones(path: Option<&Path>) -> Result<Arc<Zones>, Failure> {
    let Some(path) = path else { return Ok(Arc::default()) };
    Zones::from_toml(&text(path)?, &path.display().to_string())
        .map(Arc::new)
        .map_err(Failure::usage)
}

/// Failure for a name, with where it stands, that is neither shipped nor a file.
pub(crate) fn unknown(kind: &str, name: &str, place: &str, shipped: Shipped) -> Failure {
    Failure::not_found(format!(
        "no {kind} `{name}`{place}: expected a file or one of {}",
        listed(names(shipped))
    ))
}

/// Shipped files: names and texts.
pub(crate) type Shipped = &'static [(&'static str, &'static str)];

/// Names of shipped files.
pub(crate) fn names(shipped: Shipped) -> impl Iterator<Item = &'static str> {
    shipped.iter().map(|(name, _)| *name)
}

/// A world made from a map: its first robot starts at the origin, or at the nearest free place.
fn map_world(name: &str, map: OccupancyGrid) -> World {
    let probe = World::from_map(name, map.clone(), Pose2::IDENTITY);
    let spec = *map.spec();
    let free = map
        .values()
        .iter()
        .enumerate()
        .filter(|(_, value)| Occupancy::of(**value) == Occupancy::Free);
    let mut starts: Vec<_> = free.map(|(index, _)| spec.center(spec.cell(index))).collect();
    starts.sort_by(|a, b| a.coords.norm_squared().total_cmp(&b.coords.norm_squared()));
    let poses = starts.into_iter().map(|at| Pose2::new(at.x, at.y, 0.0));
    let start = poses
        .into_iter()
        .find(|pose| probe.clearance(&Footprint::Radius(0.0), *pose) > ROOM);
    World::from_map(name, map, start.unwrap_or_default())
}

/// The extension of a file's name, in lower case; empty if it has none.
#[must_use]
pub fn ending(path: &Path) -> String {
    path.extension()
        .unwrap_or_default()
        .to_string_lossy()
        .to_ascii_lowercase()
}

/// Failure of `--out` with a file of an unknown kind.
#[must_use]
pub fn unknown_ending(out: &Path, expected: &str) -> Failure {
    Failure::usage(format!(
        "--out {}: expected a name that ends with {expected}",
        out.display()
    ))
}

/// A world by file or shipped name; the `.yaml` of a ROS map counts as one too. Suspicious contents cause a warning.
///
/// # Errors
/// Exit code 3 if there is none, 2 if it is bad, with line and key.
pub fn world(name: &str) -> Result<World, Failure> {
    let world = read_world(name)?;
    for doubt in world.doubts() {
        tracing::warn!("{name}: {doubt}");
    }
    Ok(world)
}

fn read_world(name: &str) -> Result<World, Failure> {
    let path = Path::new(name);
    if !path.is_file() {
        if world::shipped(name).is_some() {
            return World::shipped(name).map_err(Failure::failed);
        }
        return Err(unknown("world", name, "", world::SHIPPED));
    }
    if matches!(ending(path).as_str(), "yaml" | "yml") {
        let stem = path
            .file_stem()
            .map_or_else(|| name.into(), |stem| stem.to_string_lossy());
        return Ok(map_world(&stem, map(path)?));
    }
    let folder = path.parent().unwrap_or_else(|| Path::new("."));
    let load =
        |yaml: &str| zenav_mapping::read_map(&folder.join(yaml), BARE_RESOLUTION).map_err(|error| error.to_string());
    let is_picture = matches!(ending(path).as_str(), "png" | "pgm");
    let text = String::from_utf8(bytes_within(path, MAX_TEXT)?).ok();
    let text = text.filter(|_| !is_picture).ok_or_else(|| {
        Failure::usage(format!(
            "{name}: expected a world in TOML, or the YAML file of a map, which names the map's picture"
        ))
    })?;
    World::from_toml(&text, name, &load).map_err(Failure::usage)
}

/// A robot by file or shipped name, with its options: `jackal+rear_lidar`.
///
/// # Errors
/// Exit code 3 if there is none, 2 if it is bad, with line and key.
pub fn robot(name: &str) -> Result<RobotModel, Failure> {
    let read = |part: &str| {
        let path = Path::new(part);
        if path.is_file() {
            return text(path).map_err(|failure| failure.to_string());
        }
        let (kind, shipped) = if name.split('+').next() == Some(part) {
            ("robot", robot::SHIPPED)
        } else {
            ("option", robot::OPTIONS)
        };
        let combined = if part == name {
            String::new()
        } else {
            format!(" in `{name}`")
        };
        Err(unknown(kind, part, &combined, shipped).to_string())
    };
    let model = RobotModel::with_options(name, read).map_err(|error| match error {
        RobotError::Unknown { reason, .. } => Failure::not_found(reason),
        error => Failure::usage(error.to_string()),
    })?;
    Law::named(&model.controller.tracker).map_err(|error| Failure::usage(format!("{name}: {error}")))?;
    Ok(model)
}

/// A map: `map_server` YAML, a bare image, or a Moving AI `.map` (of 1 m cells).
///
/// # Errors
/// Exit code 3 if there is none, 2 if it is bad.
pub fn map(path: &Path) -> Result<OccupancyGrid, Failure> {
    map_at(path, None)
}

/// As [`map`]; `resolution`, m, is the side of a cell if the file gives none.
///
/// # Errors
/// As [`map`].
pub(crate) fn map_at(path: &Path, resolution: Option<f64>) -> Result<OccupancyGrid, Failure> {
    if !path.is_file() {
        return Err(Failure::not_found(format!("{}: no such map file", path.display())));
    }
    let own = if ending(path) == "map" { 1.0 } else { BARE_RESOLUTION };
    zenav_mapping::read_map(path, resolution.unwrap_or(own)).map_err(Failure::usage)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_robot_or_an_option_that_nobody_knows_is_told_with_the_names_that_there_are() {
        let told = |name| robot(name).map(|_| ()).unwrap_err().to_string();
        let models = "expected a file or one of tiago, neato, ";
        assert!(told("waffle").starts_with(&format!("no robot `waffle`: {models}")));
        assert!(told("waffle+indoor").starts_with(&format!("no robot `waffle` in `waffle+indoor`: {models}")));
        let option = "no option `indor` in `tiago+indor`: expected a file or one of rear_lidar, indoor, ";
        assert!(told("tiago+indor").starts_with(option), "{}", told("tiago+indor"));
    }

    #[test]
    fn a_picture_is_no_world_and_the_file_that_can_be_one_is_told() {
        let folder = tempfile::tempdir().unwrap();
        for (name, content) in [
            ("map.png", &b"\x89PNG\r\n"[..]),
            ("map.pgm", b"P2\n1 1\n255\n0\n"),
            ("world.toml", b"\xfe\xff"),
        ] {
            let path = folder.path().join(name);
            std::fs::write(&path, content).unwrap();
            let refused = world(path.to_str().unwrap()).map(|_| ()).unwrap_err();
            assert_eq!(refused.code, exit_code::USAGE);
            let told = "expected a world in TOML, or the YAML file of a map";
            assert!(refused.message.contains(told), "{refused}");
        }
    }
}

//! Map files. Reads and writes maps in the formats of common map tools.
//!
//! ROS `map_server` images with their YAML description, after Nav2's `map_io`. Plain images and Moving AI maps can be read, too.

use std::fs::File;
use std::io::{Read, Write as _};
use std::path::{Path, PathBuf};

use nalgebra::Point2;
use thiserror::Error;
use zenav_protocol::grid::{GridError, GridSpec, MAX_CELLS, OccupancyGrid};

use crate::atomic::Prepared;
use crate::image::{self, GrayImage, ImageError};
use crate::map_image::{shade, to_grid, to_yaml, unknown_made_free};
use crate::map_yaml::{MapMode, MapYaml, MapYamlError};
use crate::moving_ai::{MovingAiError, parse_moving_ai_map};

/// Largest image file that is read, bytes: the largest map as text.
const MAX_FILE: u64 = 4 * MAX_CELLS + (1 << 20);
/// Largest description that is read, bytes.
const MAX_YAML: u64 = 1 << 20;

/// Why a map could not be read or written; every message names the file.
#[derive(Debug, Error)]
pub enum MapFileError {
    /// The file system failed.
    #[error("{}: {source}", path.display())]
    Io {
        /// Path of the file that failed.
        path: PathBuf,
        /// Error of the file system.
        source: std::io::Error,
    },
    /// The file is larger than any map.
    #[error("{}: larger than {limit} bytes", path.display())]
    TooLarge {
        /// Path of the file that failed.
        path: PathBuf,
        /// Largest size that is read, bytes.
        limit: u64,
    },
    /// The image named in a description cannot be read.
    #[error("{}:{line}: `image`: {source}", path.display())]
    Described {
        /// Path of the description.
        path: PathBuf,
        /// Line of the description, from 1.
        line: usize,
        /// What is wrong with the image.
        source: Box<MapFileError>,
    },
    /// The description is malformed.
    #[error("{}", source.in_file(path))]
    Yaml {
        /// Path of the file that failed.
        path: PathBuf,
        /// What was expected, and where.
        source: MapYamlError,
    },
    /// The image is malformed.
    #[error("{}: {source}", path.display())]
    Image {
        /// Path of the file that failed.
        path: PathBuf,
        /// What was expected of the image.
        source: ImageError,
    },
    /// The Moving AI map is malformed.
    #[error("{}: {source}", path.display())]
    MovingAi {
        /// Path of the file that failed.
        path: PathBuf,
        /// What was expected, and where.
        source: MovingAiError,
    },
    /// The grid is out of bounds.
    #[error("{}: {source}", path.display())]
    Grid {
        /// Path of the file that failed.
        path: PathBuf,
        /// What is wrong with it.
        source: GridError,
    },
    /// A description written by zenav was changed after it was stored.
    #[error("{}: {what}; put the stored numbers back, or remove the line `# {TAG} …` if the others are meant", path.display())]
    Changed {
        /// Path of the description.
        path: PathBuf,
        /// The difference.
        what: String,
    },
    /// The file's extension is not that of a map.
    #[error("{}: expected a map: .yaml, .pgm, .png or .map", path.display())]
    Kind {
        /// Path of the file that failed.
        path: PathBuf,
    },
}

impl MapFileError {
    /// The file system's failure at a path.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self + Copy + '_ {
        move |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    fn grid(path: &Path) -> impl Fn(GridError) -> Self + '_ {
        move |source| Self::Grid {
            path: path.to_owned(),
            source,
        }
    }
}

/// Reads a map: a `map_server` description (`.yaml`) with its image, a plain image (`.pgm`, `.png`: usual thresholds, origin zero), or a
/// Moving AI map (`.map`). Files that do not state their scale get `resolution` metres for each cell.
///
/// Memory: one byte for each cell. A binary graymap becomes the grid in place; other images exist beside their grid for a while.
///
/// # Errors
/// [`MapFileError`], naming the file and what was expected.
///
/// ```
/// use std::path::Path;
/// use zenav_mapping::read_map;
///
/// let folder = tempfile::tempdir().unwrap();
/// let image = folder.path().join("room.pgm");
/// std::fs::write(&image, "P2 3 1 255 0 205 254").unwrap();
/// assert_eq!(read_map(&image, 0.05).unwrap().values(), [100, -1, 0]);
/// let refused = read_map(Path::new("room.jpg"), 0.05).unwrap_err();
/// assert_eq!(refused.to_string(), "room.jpg: expected a map: .yaml, .pgm, .png or .map");
/// ```
pub fn read_map(path: &Path, resolution: f64) -> Result<OccupancyGrid, MapFileError> {
    let extension = path
        .extension()
        .and_then(|extension| extension.to_str())
        .unwrap_or_default()
        .to_ascii_lowercase();
    match extension.as_str() {
        "yaml" | "yml" => read_described(path),
        "pgm" | "png" => {
            let yaml = MapYaml::new("", resolution, Point2::origin());
            to_grid(read_image(path)?, &yaml).map_err(MapFileError::grid(path))
        }
        "map" => {
            let text = read_bytes(path, MAX_FILE)?;
            parse_moving_ai_map(&text, resolution).map_err(|source| MapFileError::MovingAi {
                path: path.to_owned(),
                source,
            })
        }
        _ => Err(MapFileError::Kind { path: path.to_owned() }),
    }
}

/// Reads a map stored by zenav: as [`read_map`], but a description of ours that was changed since is refused. Descriptions by other tools
/// are accepted.
///
/// # Errors
/// [`MapFileError::Changed`], and those of [`read_map`].
pub(super) fn read_stored(path: &Path) -> Result<OccupancyGrid, MapFileError> {
    let text = read_bytes(path, MAX_YAML)?;
    let text = String::from_utf8_lossy(&text);
    if let Some(tag) = own_tags(&text).next()
        && let Ok(yaml) = MapYaml::parse(&text)
    {
        let stored = MapYaml::new(yaml.image.clone(), tag.resolution, tag.origin);
        if yaml != stored {
            let what = format!(
                "resolution {}, origin ({}, {}), mode {}, negate {}, thresholds {} and {} do not fit what was stored: resolution {}, origin ({}, {}), trinary",
                yaml.resolution,
                yaml.origin.x,
                yaml.origin.y,
                yaml.mode.name(),
                yaml.negate,
                yaml.occupied_thresh,
                yaml.free_thresh,
                stored.resolution,
                stored.origin.x,
                stored.origin.y
            );
            return Err(MapFileError::Changed {
                path: path.to_owned(),
                what,
            });
        }
    }
    read_described(path)
}

/// The tags in a description; zenav writes one.
fn own_tags(text: &str) -> impl Iterator<Item = Tag> {
    text.lines()
        .filter_map(|line| Tag::parse(line.trim_start_matches('#').trim()))
}

fn read_described(path: &Path) -> Result<OccupancyGrid, MapFileError> {
    let text = read_bytes(path, MAX_YAML)?;
    let text = String::from_utf8_lossy(&text);
    let mut yaml = MapYaml::parse(&text).map_err(|source| MapFileError::Yaml {
        path: path.to_owned(),
        source,
    })?;
    for (line, key, meant) in MapYaml::slips(&text) {
        tracing::warn!(
            "{}:{line}: unknown key `{key}` is ignored, perhaps `{meant}` is meant",
            path.display()
        );
    }
    // `join` keeps an absolute path as it is.
    let image_path = path.parent().unwrap_or_else(|| Path::new("")).join(&yaml.image);
    let image = read_image(&image_path).map_err(|source| MapFileError::Described {
        path: path.to_owned(),
        line: MapYaml::line_of(&text, "image").unwrap_or(1),
        source: Box::new(source),
    })?;
    let unknown = unknown_made_free(&image, &yaml);
    if unknown > 0 {
        // In scale mode only transparent pixels are unknown.
        let (key, cause, remedy) = match yaml.mode {
            MapMode::Scale => (
                "mode",
                "`mode: scale`".to_owned(),
                "`mode: trinary` with `free_thresh: 0.196`",
            ),
            _ => (
                "free_thresh",
                format!("`free_thresh` {}", yaml.free_thresh),
                "`free_thresh: 0.196`",
            ),
        };
        tracing::warn!(
            "{}:{}: {cause} makes {unknown} cells free that `map_saver` stores as unknown (grey 205); {remedy} keeps them unknown",
            path.display(),
            MapYaml::line_of(&text, key).unwrap_or(1)
        );
    }
    // Our own images state their place too, so an image replaced just before a crash is not read with the older place.
    if let Some(tag) = image.comments.iter().find_map(|comment| Tag::parse(comment))
        && !own_tags(&text).any(|other| other == tag)
        && text.contains(TAG)
    {
        (yaml.resolution, yaml.origin) = (tag.resolution, tag.origin);
    }
    to_grid(image, &yaml).map_err(MapFileError::grid(path))
}

fn read_image(path: &Path) -> Result<GrayImage, MapFileError> {
    image::decode(read_bytes(path, MAX_FILE)?).map_err(|source| MapFileError::Image {
        path: path.to_owned(),
        source,
    })
}

/// Reads a file up to a limit.
pub(super) fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>, MapFileError> {
    let failed = MapFileError::io(path);
    let file = File::open(path).map_err(failed)?;
    let mut bytes = Vec::new();
    file.take(limit + 1).read_to_end(&mut bytes).map_err(failed)?;
    if bytes.len() as u64 > limit {
        return Err(MapFileError::TooLarge {
            path: path.to_owned(),
            limit,
        });
    }
    Ok(bytes)
}

/// Marks files written by zenav: the image and the description of one write carry the same tag.
const TAG: &str = "zenav:";

/// Place and label of an image, in a comment of the image itself.
#[derive(Clone, Debug, PartialEq)]
struct Tag {
    resolution: f64,
    origin: Point2<f64>,
    write: String,
}

impl Tag {
    fn parse(comment: &str) -> Option<Self> {
        let mut words = comment.strip_prefix(TAG)?.split_whitespace();
        let mut number = || words.next()?.parse().ok().filter(|value: &f64| value.is_finite());
        let (resolution, x, y) = (number()?, number()?, number()?);
        Some(Self {
            resolution,
            origin: Point2::new(x, y),
            write: words.collect::<Vec<_>>().join(" "),
        })
    }

    fn text(&self) -> String {
        format!(
            "{TAG} {} {} {} {}",
            self.resolution, self.origin.x, self.origin.y, self.write
        )
    }
}

/// Writes `STEM.pgm` and `STEM.yaml` (trinary) into a folder, which is created if missing. Returns the description's path.
///
/// `label` names this state of the map, for example its revision. A half-written file never replaces a good one; if the machine fails
/// between the two renames, the newer image is still read with its own place.
///
/// # Errors
/// [`MapFileError::Io`].
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::{read_map, write_map};
/// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
///
/// let spec = GridSpec { origin: Point2::new(-1.0, -2.0), resolution: 0.05, width: 20, height: 10 };
/// let map = OccupancyGrid::filled(spec, Occupancy::FREE);
/// let folder = tempfile::tempdir().unwrap();
/// let yaml = write_map(folder.path(), "kitchen", &map, "revision 1").unwrap();
/// assert_eq!(read_map(&yaml, 1.0).unwrap(), map);
/// ```
pub fn write_map(folder: &Path, stem: &str, grid: &OccupancyGrid, label: &str) -> Result<PathBuf, MapFileError> {
    std::fs::create_dir_all(folder).map_err(MapFileError::io(folder))?;
    let tag = Tag {
        resolution: grid.spec().resolution,
        origin: grid.spec().origin,
        write: label.split_whitespace().collect::<Vec<_>>().join(" "),
    }
    .text();
    let (image_name, yaml_path) = (format!("{stem}.pgm"), folder.join(format!("{stem}.yaml")));
    let yaml = to_yaml(grid, MapMode::Trinary, &image_name).to_text(std::slice::from_ref(&tag));
    let GridSpec { width, height, .. } = *grid.spec();
    let image = Prepared::new(&folder.join(&image_name), |file| {
        file.write_all(image::pgm_header(width, height, &[tag]).as_bytes())?;
        // Row by row: the whole image would double the memory of a large map.
        let mut line = Vec::with_capacity(width as usize);
        for row in grid.values().chunks_exact((width as usize).max(1)).rev() {
            line.clear();
            line.extend(row.iter().map(|value| shade(*value, MapMode::Trinary)));
            file.write_all(&line)?;
        }
        Ok(())
    })?;
    let yaml = Prepared::new(&yaml_path, |file| file.write_all(yaml.as_bytes()))?;
    image.publish()?;
    yaml.publish()?;
    Ok(yaml_path)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(width: u32, height: u32, values: Vec<i8>) -> OccupancyGrid {
        OccupancyGrid::from_values(
            GridSpec {
                origin: Point2::new(-1.25, 3.1),
                resolution: 0.05,
                width,
                height,
            },
            values,
        )
        .unwrap()
    }

    #[test]
    fn maps_of_one_cell_and_of_none_come_back() {
        let folder = tempfile::tempdir().unwrap();
        for map in [grid(1, 1, vec![100]), grid(0, 0, Vec::new()), grid(5, 0, Vec::new())] {
            let path = write_map(folder.path(), "map", &map, "1").unwrap();
            assert_eq!(read_map(&path, 1.0).unwrap(), map);
            assert!(!super::super::map_image::to_png(&map).unwrap().is_empty());
        }
    }

    #[test]
    fn a_written_map_is_read_back_and_nothing_else_is_left_in_the_folder() {
        let folder = tempfile::tempdir().unwrap();
        let map = grid(3, 2, vec![0, 100, -1, 100, 0, 0]);
        let path = write_map(folder.path(), "map", &map, "kitchen 7").unwrap();
        assert_eq!(read_map(&path, 1.0).unwrap(), map);
        write_map(folder.path(), "map", &map, "kitchen 8").unwrap();
        let mut names: Vec<String> = std::fs::read_dir(folder.path())
            .unwrap()
            .map(|entry| entry.unwrap().file_name().into_string().unwrap())
            .collect();
        names.sort();
        assert_eq!(names, ["map.pgm", "map.yaml"]);
    }

    #[test]
    fn a_crash_between_both_renames_leaves_a_picture_in_its_own_place() {
        let folder = tempfile::tempdir().unwrap();
        let old = grid(3, 2, vec![0; 6]);
        let path = write_map(folder.path(), "map", &old, "1").unwrap();
        let old_yaml = std::fs::read(&path).unwrap();
        let grown = OccupancyGrid::from_values(
            GridSpec {
                origin: Point2::new(-9.0, -9.0),
                resolution: 0.05,
                width: 4,
                height: 2,
            },
            vec![100; 8],
        )
        .unwrap();
        write_map(folder.path(), "map", &grown, "2").unwrap();
        std::fs::write(&path, old_yaml).unwrap();
        assert_eq!(read_map(&path, 1.0).unwrap(), grown);
        // A place corrected by hand, or a description by another tool, is used as is.
        std::fs::write(&path, "image: map.pgm\nresolution: 0.1\norigin: [1, 2, 0]\n").unwrap();
        assert_eq!(read_map(&path, 1.0).unwrap().spec().resolution, 0.1);
    }

    #[test]
    fn an_error_names_the_file_and_what_was_expected() {
        let folder = tempfile::tempdir().unwrap();
        let path = write_map(folder.path(), "map", &grid(3, 2, vec![0; 6]), "1").unwrap();
        let picture = folder.path().join("map.pgm");
        let whole = std::fs::read(&picture).unwrap();
        std::fs::write(&picture, &whole[..whole.len() - 2]).unwrap();
        let message = read_map(&path, 1.0).unwrap_err().to_string();
        assert!(
            message.contains("map.yaml:2: `image`: ")
                && message.ends_with("map.pgm: truncated: 6 pixels expected, 4 found"),
            "{message}"
        );
        std::fs::write(&path, "image: none.pgm\nresolution: 0.1\norigin: [1, 2, 0]\n").unwrap();
        let message = read_map(&path, 1.0).unwrap_err().to_string();
        assert!(
            message.contains("map.yaml:1: `image`: ") && message.contains("none.pgm"),
            "{message}"
        );
        std::fs::write(&path, "image: none.pgm\nresolution: 0\n").unwrap();
        let message = read_map(&path, 1.0).unwrap_err().to_string();
        assert!(message.contains("map.yaml:2: `resolution`"), "{message}");
        assert!(matches!(
            read_map(&folder.path().join("none.yaml"), 1.0),
            Err(MapFileError::Io { .. })
        ));
        assert!(matches!(
            read_map(&folder.path().join("map.txt"), 1.0),
            Err(MapFileError::Kind { .. })
        ));
        assert!(matches!(
            read_map(&picture, f64::NAN),
            Err(MapFileError::Image { .. } | MapFileError::Grid { .. })
        ));
    }
}

//! `zenav map convert`. Converts maps between `map_server` pictures with their description and Moving AI maps.

use std::path::PathBuf;

use clap::ValueEnum;
use zenav_mapping::map_image::{self, MapMode};
use zenav_protocol::grid::{Occupancy, OccupancyGrid};

use super::map::Summary;
use crate::arguments::positive;
use crate::failure::{Failure, Outcome};
use crate::files;
use crate::output::{self, Format};

/// A conversion.
#[derive(Debug, clap::Args)]
pub(super) struct ConvertArgs {
    /// Map to read: .yaml, .pgm, .png, .map
    input: PathBuf,
    /// Map to write: .yaml (with a .pgm), .pgm or .png (with a .yaml), .map
    target: PathBuf,
    /// How cells become grey values
    #[arg(long, value_enum, default_value_t)]
    mode: ModeArg,
    /// Side of a cell if the input does not give it, m
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
    /// The raw values
    Raw,
}

/// Converts a map file.
pub(super) fn convert(args: &ConvertArgs, format: Format) -> Outcome {
    let grid = files::map_at(&args.input, args.resolution)?;
    let mode = match args.mode {
        ModeArg::Trinary => MapMode::Trinary,
        ModeArg::Scale => MapMode::Scale,
        ModeArg::Raw => MapMode::Raw,
    };
    let target = args.target.as_path();
    let ending = files::ending(target);
    let picture = match ending.as_str() {
        "map" => {
            files::write_atomically(target, moving_ai(&grid).as_bytes())?;
            None
        }
        "yaml" | "yml" | "pgm" if mode == MapMode::Scale => {
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
        let pixels = map_image::to_image(&grid, mode);
        let bytes = if files::ending(&picture) == "png" {
            map_image::encode_png(&pixels).map_err(Failure::failed)?
        } else {
            map_image::encode_pgm(&pixels)
        };
        let name = picture.file_name().and_then(|name| name.to_str()).unwrap_or_default();
        if picture == target {
            written = target.with_extension("yaml");
        }
        files::write_atomically(&picture, &bytes)?;
        let yaml = map_image::to_yaml(&grid, mode, name).to_text(&[]);
        files::write_atomically(&written, yaml.as_bytes())?;
    }
    output::value(format, &Summary::of_file(&written, &grid), Summary::line)
}

/// A Moving AI map: free cells are passable, all others are not.
fn moving_ai(grid: &OccupancyGrid) -> String {
    let spec = grid.spec();
    let mut text = format!("type octile\nheight {}\nwidth {}\nmap\n", spec.height, spec.width);
    for row in grid.values().chunks_exact((spec.width as usize).max(1)).rev() {
        let free = row.iter().map(|value| Occupancy::of(*value) == Occupancy::Free);
        text.extend(free.map(|free| if free { '.' } else { '@' }));
        text.push('\n');
    }
    text
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use zenav_protocol::grid::GridSpec;

    use super::*;
    use crate::exit_code;

    fn grid() -> OccupancyGrid {
        let spec = GridSpec {
            origin: Point2::new(-1.0, 2.0),
            ..zenav_fixtures::spec(3, 2, 0.5)
        };
        zenav_fixtures::map_with(spec, &[(0, 0, Occupancy::OCCUPIED), (2, 1, Occupancy::UNKNOWN)])
    }

    #[test]
    fn a_moving_ai_map_counts_rows_from_the_top() {
        assert_eq!(moving_ai(&grid()), "type octile\nheight 2\nwidth 3\nmap\n..@\n@..\n");
    }

    #[test]
    fn a_map_survives_conversion_and_back() {
        let folder = tempfile::tempdir().unwrap();
        zenav_mapping::write_map(folder.path(), "a", &grid(), "test").unwrap();
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

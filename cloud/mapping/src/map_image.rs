//! Map images. Converts brightness to occupancy and back.
//!
//! A module of its own, because its functions are clear only with its name: `map_image::to_grid`, `map_image::to_png`.
//!
//! As in Nav2's `map_io`.

use zenav_protocol::grid::{GridError, GridSpec, Occupancy, OccupancyGrid};

pub use crate::image::{GrayImage, ImageError, decode, encode_pgm, encode_png};
pub use crate::map_yaml::{MapMode, MapYaml, MapYamlError};

/// Converts an image to a grid.
///
/// # Errors
/// [`GridError`] when the size or the description is out of bounds.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::map_image::{MapYaml, decode, to_grid};
///
/// // Black above white: the first row of an image is the highest, the first row of a grid the lowest.
/// let picture = decode(b"P2 1 2 255 0 255".to_vec()).unwrap();
/// let map = to_grid(picture, &MapYaml::new("", 0.05, Point2::origin())).unwrap();
/// assert_eq!(map.values(), [0, 100]);
/// ```
pub fn to_grid(image: GrayImage, yaml: &MapYaml) -> Result<OccupancyGrid, GridError> {
    let spec = GridSpec {
        origin: yaml.origin,
        resolution: yaml.resolution,
        width: image.width,
        height: image.height,
    }
    .checked()?;
    // One table for all values of opaque pixels.
    let mut opaque = [Occupancy::UNKNOWN; 256];
    for (gray, value) in opaque.iter_mut().enumerate() {
        *value = occupancy(gray as u8, 255, yaml);
    }
    let values: Vec<i8> = match image.opacity {
        // Reuses the image's memory: a grid of the largest size exists only once.
        None => image.gray.into_iter().map(|gray| opaque[usize::from(gray)]).collect(),
        Some(opacity) => {
            let pixels = image.gray.iter().zip(&opacity);
            pixels.map(|(gray, opacity)| occupancy(*gray, *opacity, yaml)).collect()
        }
    };
    let mut grid = OccupancyGrid::from_values(spec, values)?;
    // The first row of an image is the highest.
    let width = image.width as usize;
    let (low, high) = grid.values_mut().split_at_mut(image.height as usize / 2 * width);
    // Chunks have a length, also where there are none: an image may have no columns.
    let row = width.max(1);
    for (low, high) in low.chunks_exact_mut(row).zip(high.rchunks_exact_mut(row)) {
        low.swap_with_slice(high);
    }
    Ok(grid)
}

/// Brightness of an unknown cell as `map_saver` writes it.
const UNKNOWN_GRAY: u8 = 205;

/// Number of pixels with `map_saver`'s brightness of unknown cells that this description makes free.
pub(super) fn unknown_made_free(image: &GrayImage, yaml: &MapYaml) -> usize {
    if occupancy(UNKNOWN_GRAY, 255, yaml) != Occupancy::FREE {
        return 0;
    }
    let is_opaque = |at: usize| {
        image
            .opacity
            .as_ref()
            .is_none_or(|opacity| opacity.get(at) == Some(&255))
    };
    let pixels = image.gray.iter().enumerate();
    pixels
        .filter(|(at, gray)| **gray == UNKNOWN_GRAY && is_opaque(*at))
        .count()
}

fn occupancy(gray: u8, opacity: u8, yaml: &MapYaml) -> i8 {
    let (gray, opacity) = (f64::from(gray), f64::from(opacity));
    let shade = match yaml.mode {
        // As in `map_server`: opacity counts like one more colour.
        MapMode::Trinary if opacity < 255.0 => 0.5 * (gray + opacity) / 255.0,
        _ => gray / 255.0,
    };
    let p = if yaml.negate { shade } else { 1.0 - shade };
    match yaml.mode {
        MapMode::Raw if gray <= 100.0 => gray as i8,
        MapMode::Raw => Occupancy::UNKNOWN,
        MapMode::Scale if opacity < 255.0 => Occupancy::UNKNOWN,
        _ if p > yaml.occupied_thresh => Occupancy::OCCUPIED,
        _ if p < yaml.free_thresh => Occupancy::FREE,
        MapMode::Scale => (100.0 * (p - yaml.free_thresh) / (yaml.occupied_thresh - yaml.free_thresh).max(1e-9))
            .round()
            .clamp(0.0, 100.0) as i8,
        MapMode::Trinary => Occupancy::UNKNOWN,
    }
}

/// Converts a grid to an image: trinary as `map_saver` writes it (0, 205, 254); scale with transparent unknown cells (for PNG: a graymap
/// cannot express them); raw with 255 for unknown.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::map_image::{MapMode, to_image};
/// use zenav_protocol::grid::{GridSpec, OccupancyGrid};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 3, height: 1 };
/// let map = OccupancyGrid::from_values(spec, vec![90, -1, 10]).unwrap();
/// assert_eq!(to_image(&map, MapMode::Trinary).gray, [0, 205, 254]);
/// assert_eq!(to_image(&map, MapMode::Raw).gray, [90, 255, 10]);
/// ```
#[must_use]
pub fn to_image(grid: &OccupancyGrid, mode: MapMode) -> GrayImage {
    let spec = grid.spec();
    let rows = || grid.values().chunks_exact((spec.width as usize).max(1)).rev();
    let mut gray = Vec::with_capacity(spec.len());
    for row in rows() {
        gray.extend(row.iter().map(|value| shade(*value, mode)));
    }
    let opacity = (mode == MapMode::Scale).then(|| {
        rows()
            .flatten()
            .map(|value| if (0..=100).contains(value) { 255 } else { 0 })
            .collect()
    });
    GrayImage {
        width: spec.width,
        height: spec.height,
        gray,
        opacity,
        comments: Vec::new(),
    }
}

/// Brightness of a cell in an image of this mode.
pub(super) fn shade(value: i8, mode: MapMode) -> u8 {
    match mode {
        MapMode::Trinary => match Occupancy::of(value) {
            Occupancy::Occupied => 0,
            Occupancy::Unknown => UNKNOWN_GRAY,
            Occupancy::Free => 254,
        },
        _ if !(0..=100).contains(&value) => 255,
        MapMode::Scale => (255.0 * (1.0 - f64::from(value) / 100.0)).round() as u8,
        MapMode::Raw => value.cast_unsigned(),
    }
}

/// The description for an image of [`to_image`]; in scale mode its thresholds are 0 and 1, so that every percentage survives the round
/// trip.
#[must_use]
pub fn to_yaml(grid: &OccupancyGrid, mode: MapMode, image: &str) -> MapYaml {
    let yaml = MapYaml {
        mode,
        ..MapYaml::new(image, grid.spec().resolution, grid.spec().origin)
    };
    if mode == MapMode::Scale {
        MapYaml {
            occupied_thresh: 1.0,
            free_thresh: 0.0,
            ..yaml
        }
    } else {
        yaml
    }
}

/// The grid as a trinary binary graymap (PGM).
#[must_use]
pub fn to_pgm(grid: &OccupancyGrid) -> Vec<u8> {
    encode_pgm(&to_image(grid, MapMode::Trinary))
}

/// The grid as a trinary PNG; a grid without cells becomes one unknown pixel.
///
/// # Errors
/// [`ImageError::Png`] when the encoder fails.
///
/// ```
/// use nalgebra::Point2;
/// use zenav_mapping::map_image::{decode, to_png};
/// use zenav_protocol::grid::{GridSpec, Occupancy, OccupancyGrid};
///
/// let spec = GridSpec { origin: Point2::origin(), resolution: 0.05, width: 3, height: 2 };
/// let png = to_png(&OccupancyGrid::filled(spec, Occupancy::FREE)).unwrap();
/// assert_eq!(decode(png).unwrap().gray, [254; 6]);
/// ```
pub fn to_png(grid: &OccupancyGrid) -> Result<Vec<u8>, ImageError> {
    let mut picture = to_image(grid, MapMode::Trinary);
    if picture.gray.is_empty() {
        picture = GrayImage {
            width: 1,
            height: 1,
            gray: vec![UNKNOWN_GRAY],
            ..picture
        };
    }
    encode_png(&picture)
}

#[cfg(test)]
mod tests {
    use nalgebra::Point2;
    use proptest::prelude::*;
    use zenav_protocol::grid::Cell;

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

    proptest! {
        #[test]
        fn percentages_come_back_from_raw_and_scale_and_classes_from_trinary(values in proptest::collection::vec(-1_i8..=100, 12)) {
            let map = grid(4, 3, values);
            for mode in [MapMode::Raw, MapMode::Scale] {
                prop_assert_eq!(&to_grid(to_image(&map, mode), &to_yaml(&map, mode, "")).unwrap(), &map);
            }
            let back = to_grid(to_image(&map, MapMode::Trinary), &to_yaml(&map, MapMode::Trinary, "")).unwrap();
            prop_assert_eq!(back.map(|value| Occupancy::of(*value)), map.map(|value| Occupancy::of(*value)));
        }
    }

    #[test]
    fn a_picture_without_pixels_is_an_empty_grid() {
        for (width, height) in [(0, 0), (0, 5), (5, 0)] {
            let picture = GrayImage {
                width,
                height,
                gray: Vec::new(),
                opacity: None,
                comments: Vec::new(),
            };
            let grid = to_grid(picture, &MapYaml::new("", 0.05, Point2::origin())).unwrap();
            assert_eq!(
                (grid.spec().width, grid.spec().height, grid.values().len()),
                (width, height, 0)
            );
        }
    }

    #[test]
    fn a_picture_that_is_not_as_large_as_it_says_is_no_grid() {
        let picture = |gray, opacity| GrayImage {
            width: 3,
            height: 2,
            gray,
            opacity,
            comments: Vec::new(),
        };
        let yaml = MapYaml::new("", 0.1, Point2::origin());
        for broken in [
            picture(vec![0; 5], None),
            picture(vec![0; 7], None),
            picture(vec![0; 6], Some(vec![255; 2])),
        ] {
            assert!(matches!(
                to_grid(broken, &yaml),
                Err(GridError::Length { expected: 6, .. })
            ));
        }
    }

    #[test]
    fn a_negative_with_negate_says_the_same() {
        for mode in [MapMode::Trinary, MapMode::Scale] {
            let yaml = MapYaml {
                mode,
                ..MapYaml::new("", 0.1, Point2::origin())
            };
            let negative = MapYaml {
                negate: true,
                ..yaml.clone()
            };
            for gray in 0..=255 {
                assert_eq!(
                    occupancy(255 - gray, 255, &negative),
                    occupancy(gray, 255, &yaml),
                    "{mode:?} {gray}"
                );
            }
        }
        // Raw values are percentages, whichever shade is bright.
        let raw = MapYaml {
            mode: MapMode::Raw,
            negate: true,
            ..MapYaml::new("", 0.1, Point2::origin())
        };
        assert_eq!([0, 100, 101].map(|gray| occupancy(gray, 255, &raw)), [0, 100, -1]);
    }

    #[test]
    fn the_top_row_of_a_picture_is_the_highest_row_of_the_map() {
        let image = decode(b"P2 2 2 255  0 254  205 254".to_vec()).unwrap();
        let map = to_grid(image, &MapYaml::new("", 0.1, Point2::origin())).unwrap();
        let class = |x, y| Occupancy::of(map[Cell::new(x, y)]);
        assert_eq!(
            (class(0, 1), class(1, 1), class(0, 0), class(1, 0)),
            (
                Occupancy::Occupied,
                Occupancy::Free,
                Occupancy::Unknown,
                Occupancy::Free
            )
        );
    }

    #[test]
    fn a_threshold_that_makes_unknown_cells_free_is_counted() {
        let picture = |opacity| GrayImage {
            width: 3,
            height: 1,
            gray: vec![205, 254, 205],
            opacity,
            comments: Vec::new(),
        };
        let usual = MapYaml::new("", 0.1, Point2::origin());
        let nav2 = MapYaml {
            free_thresh: 0.25,
            ..usual.clone()
        };
        assert_eq!(unknown_made_free(&picture(None), &usual), 0);
        assert_eq!(unknown_made_free(&picture(None), &nav2), 2);
        assert_eq!(unknown_made_free(&picture(Some(vec![0, 255, 255])), &nav2), 1);
        let raw = MapYaml {
            mode: MapMode::Raw,
            ..nav2
        };
        assert_eq!(unknown_made_free(&picture(None), &raw), 0);
    }

    #[test]
    fn every_mode_reads_brightness_as_map_server_does() {
        let yaml = MapYaml::new("", 0.1, Point2::origin());
        let scale = MapYaml {
            mode: MapMode::Scale,
            ..yaml.clone()
        };
        assert_eq!(
            [0, 89, 90, 205, 206, 255].map(|gray| occupancy(gray, 255, &yaml)),
            [100, 100, -1, -1, 0, 0]
        );
        assert_eq!(
            [0, 89, 147, 206].map(|gray| occupancy(gray, 255, &scale)),
            [100, 100, 50, 0]
        );
        assert_eq!(occupancy(147, 10, &scale), -1);
        let raw = MapYaml {
            mode: MapMode::Raw,
            ..yaml.clone()
        };
        assert_eq!(
            [0, 37, 100, 101, 255].map(|gray| occupancy(gray, 255, &raw)),
            [0, 37, 100, -1, -1]
        );
        let negated = MapYaml { negate: true, ..yaml };
        assert_eq!([0, 255].map(|gray| occupancy(gray, 255, &negated)), [0, 100]);
    }
}

//! Grey images. Converts image files to pixels and back.
//!
//! Portable graymaps (P2, P5) and PNG, rows from the top.

mod pgm;
mod png;

use thiserror::Error;
use zenav_protocol::grid::{MAX_CELLS, MAX_SIDE};

pub use self::pgm::encode_pgm;
pub(crate) use self::pgm::pgm_header;
pub use self::png::encode_png;

/// A grey image, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrayImage {
    /// Width in pixels, that is, columns.
    pub width: u32,
    /// Height in pixels, that is, rows.
    pub height: u32,
    /// Brightness of every pixel, 255 is white; for a coloured pixel, the mean of its colours.
    pub gray: Vec<u8>,
    /// Opacity of every pixel, 255 is opaque; `None` if the file has none.
    pub opacity: Option<Vec<u8>>,
    /// Comments of a graymap, one for each line.
    pub comments: Vec<String>,
}

/// Why an image could not be decoded or encoded.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ImageError {
    /// The file is neither a PGM nor a PNG.
    #[error("not an image: expected a PGM (P2 or P5) or a PNG")]
    Format,
    /// The header of the graymap is malformed.
    #[error("malformed PGM header: expected {expected}, found {found}")]
    Header {
        /// What was expected at this place.
        expected: &'static str,
        /// What was found at this place.
        found: String,
    },
    /// The file ends too soon.
    #[error("truncated: {expected} pixels expected, {found} found")]
    Truncated {
        /// Number of pixels by the header.
        expected: usize,
        /// Number of pixels in the file.
        found: usize,
    },
    /// The file holds more than its pixels.
    #[error("{expected} bytes of pixels expected after the header, {found} found")]
    Length {
        /// Bytes of all pixels by the header.
        expected: usize,
        /// Bytes after the header.
        found: usize,
    },
    /// A value of a text graymap (P2) is out of bounds.
    #[error("line {line}: expected a number from 0 to {limit}, found {found}")]
    Value {
        /// Number of the line, from 1.
        line: usize,
        /// Largest value by the header.
        limit: u32,
        /// What was found at this place.
        found: String,
    },
    /// The image has more pixels than a map may have cells.
    #[error("{width} x {height} pixels: at most {MAX_SIDE} a side and {MAX_CELLS} in all")]
    TooLarge {
        /// Width in pixels, that is, columns.
        width: u64,
        /// Height in pixels, that is, rows.
        height: u64,
    },
    /// The PNG is malformed.
    #[error("malformed PNG: {0}")]
    Png(String),
}

/// Decodes a PGM or a PNG, told apart by the first bytes.
///
/// # Errors
/// [`ImageError`]. A size beyond the limits is refused before anything is allocated.
///
/// ```
/// use zenav_mapping::map_image::{ImageError, decode};
///
/// let picture = decode(b"P2 2 1 100 0 100".to_vec())?;
/// assert_eq!((picture.width, picture.height, picture.gray), (2, 1, vec![0, 255]));
/// assert_eq!(decode(b"GIF89a".to_vec()), Err(ImageError::Format));
/// # Ok::<(), ImageError>(())
/// ```
pub fn decode(bytes: Vec<u8>) -> Result<GrayImage, ImageError> {
    match bytes.as_slice() {
        [b'P', b'2' | b'5', ..] => pgm::decode(bytes),
        [0x89, b'P', b'N', b'G', ..] => png::decode(&bytes),
        _ => Err(ImageError::Format),
    }
}

fn checked_size(width: u64, height: u64) -> Result<usize, ImageError> {
    if width > u64::from(MAX_SIDE) || height > u64::from(MAX_SIDE) || width * height > MAX_CELLS {
        return Err(ImageError::TooLarge { width, height });
    }
    Ok((width * height) as usize)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn image(width: u32, height: u32, gray: Vec<u8>) -> GrayImage {
        GrayImage {
            width,
            height,
            gray,
            opacity: None,
            comments: vec!["a comment".to_owned()],
        }
    }

    proptest! {
        #[test]
        fn images_come_back_as_they_went(width in 1_u32..40, height in 1_u32..40, seed in any::<u8>(), see_through in any::<bool>()) {
            let gray: Vec<u8> = (0..width * height).map(|i| (i as u8).wrapping_mul(seed)).collect();
            let mut picture = image(width, height, gray.clone());
            prop_assert_eq!(decode(encode_pgm(&picture)).unwrap(), picture.clone());
            picture.comments.clear();
            picture.opacity = see_through.then_some(gray);
            prop_assert_eq!(decode(encode_png(&picture).unwrap()).unwrap(), picture);
        }

        #[test]
        fn no_bytes_do_harm(mut bytes in proptest::collection::vec(any::<u8>(), 0..200), kind in 0..4) {
            let good = encode_png(&image(5, 4, vec![7; 20])).unwrap();
            let start: &[u8] = [b"P2 ".as_slice(), b"P5\n3 3\n", &good[..8], &good[..33]][kind as usize];
            let mut all = start.to_vec();
            all.append(&mut bytes);
            let _ = decode(all);
        }
    }

    #[test]
    fn a_truncated_file_says_how_much_is_missing() {
        let whole = encode_pgm(&image(10, 10, vec![1; 100]));
        assert_eq!(
            decode(whole[..whole.len() - 30].to_vec()),
            Err(ImageError::Truncated {
                expected: 100,
                found: 70
            })
        );
        assert_eq!(
            decode(b"P2 2 2 255 1 2 3".to_vec()),
            Err(ImageError::Truncated { expected: 4, found: 3 })
        );
        let png = encode_png(&image(10, 10, vec![1; 100])).unwrap();
        assert!(matches!(decode(png[..png.len() / 2].to_vec()), Err(ImageError::Png(_))));
    }

    #[test]
    fn the_pixels_of_a_binary_graymap_begin_where_their_number_fits() {
        let gray = |bytes: &[u8]| decode(bytes.to_vec()).map(|image| image.gray);
        // Dark pixels look like white space and comments.
        assert_eq!(gray(b"P5\n3 1\n255\n\n# "), Ok(b"\n# ".to_vec()));
        for header in ["\r\n", "#c\n", " # made by a tool\n", "\n# one\n# two\n", " \r\n"] {
            let bytes = [b"P5\r\n3 1\r\n255".as_slice(), header.as_bytes(), &[7, 8, 9]].concat();
            assert_eq!(gray(&bytes), Ok(vec![7, 8, 9]), "{header:?}");
        }
        assert_eq!(gray(b"P5 1 2 65535\r\n\xff\xff\x80\x00"), Ok(vec![255, 128]));
        assert_eq!(gray(b"P5 3 1 255 abc\n"), Ok(b"abc".to_vec()));
        let longer = gray(b"P5 3 1 255 abcdef").unwrap_err();
        assert_eq!(
            longer.to_string(),
            "3 bytes of pixels expected after the header, 6 found"
        );
        assert!(gray(b"P5 3 1 255 # never ends").is_err());
    }

    #[test]
    fn text_and_wide_graymaps_are_read() {
        assert_eq!(
            decode(b"P2\n# made by hand\n2 2\n# another\n10\n0 5\n10 1".to_vec()).unwrap(),
            GrayImage {
                width: 2,
                height: 2,
                gray: vec![0, 128, 255, 26],
                opacity: None,
                comments: vec!["made by hand".into(), "another".into()]
            }
        );
        assert_eq!(
            decode(b"P5 1 2 65535 \xff\xff\x80\x00".to_vec()).unwrap().gray,
            vec![255, 128]
        );
        assert_eq!(
            decode(b"P2 1 1 255\n\n 300".to_vec()),
            Err(ImageError::Value {
                line: 3,
                limit: 255,
                found: "`300`".into()
            })
        );
    }

    #[test]
    fn a_file_that_claims_too_much_is_refused_before_anything_is_allocated() {
        assert!(matches!(
            decode(b"P5 4000000000 4000000000 255\n".to_vec()),
            Err(ImageError::TooLarge { .. })
        ));
        assert!(matches!(
            decode(b"P5 x 1 255\n".to_vec()),
            Err(ImageError::Header {
                expected: "the width",
                ..
            })
        ));
        assert_eq!(decode(b"GIF89a".to_vec()), Err(ImageError::Format));
    }
}

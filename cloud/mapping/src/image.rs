//! How do grey pictures become bytes, and bytes pictures? Portable graymaps (P2, P5) and PNG, rows from the top.

use std::io::Cursor;

use thiserror::Error;
use zenav_protocol::grid::MAX_SIDE;

use zenav_protocol::grid::MAX_CELLS;

/// A grey picture, rows from the top.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct GrayImage {
    /// Pixels a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// Brightness of every pixel, 255 is white; the mean of the colours of a coloured one.
    pub gray: Vec<u8>,
    /// Opacity of every pixel, 255 is opaque, where the file has it.
    pub opacity: Option<Vec<u8>>,
    /// Comments of a graymap, a line each.
    pub comments: Vec<String>,
}

/// Why bytes are not a picture.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum ImageError {
    /// Neither a graymap nor a PNG.
    #[error("not a picture: expected a PGM (P2 or P5) or a PNG")]
    Format,
    /// The graymap's header is broken.
    #[error("broken PGM header: expected {expected}, found {found}")]
    Header {
        /// What should stand there.
        expected: &'static str,
        /// What does.
        found: String,
    },
    /// The file ends too soon.
    #[error("truncated: {expected} pixels expected, {found} found")]
    Truncated {
        /// Pixels by the header.
        expected: usize,
        /// Pixels in the file.
        found: usize,
    },
    /// A value of a P2 graymap.
    #[error("line {line}: expected a number from 0 to {limit}, found {found}")]
    Value {
        /// Line of the file, from 1.
        line: usize,
        /// The header's largest value.
        limit: u32,
        /// What stands there.
        found: String,
    },
    /// More pixels than a map may have.
    #[error("{width} x {height} pixels: at most {MAX_SIDE} a side and {MAX_CELLS} in all")]
    TooLarge {
        /// Pixels a row.
        width: u64,
        /// Rows.
        height: u64,
    },
    /// The PNG is broken.
    #[error("broken PNG: {0}")]
    Png(String),
}

/// Reads a picture of any of the formats, by its first bytes.
///
/// # Errors
/// [`ImageError`]; nothing is allocated by a size that the file merely claims beyond the limits.
pub fn decode(bytes: Vec<u8>) -> Result<GrayImage, ImageError> {
    match bytes.as_slice() {
        [b'P', b'2' | b'5', ..] => decode_pgm(bytes),
        [0x89, b'P', b'N', b'G', ..] => decode_png(&bytes),
        _ => Err(ImageError::Format),
    }
}

fn checked_size(width: u64, height: u64) -> Result<usize, ImageError> {
    if width > u64::from(MAX_SIDE) || height > u64::from(MAX_SIDE) || width * height > MAX_CELLS {
        return Err(ImageError::TooLarge { width, height });
    }
    Ok((width * height) as usize)
}

/// Words of a graymap, comments set aside.
struct Words<'b> {
    bytes: &'b [u8],
    at: usize,
    line: usize,
    comments: Vec<String>,
}

impl<'b> Words<'b> {
    fn next(&mut self) -> &'b str {
        while let Some(byte) = self.bytes.get(self.at) {
            if *byte == b'#' {
                let rest = &self.bytes[self.at + 1..];
                let end = rest.iter().position(|byte| *byte == b'\n').unwrap_or(rest.len());
                if self.comments.len() < 64 {
                    self.comments
                        .push(String::from_utf8_lossy(&rest[..end]).trim().to_owned());
                }
                self.at += 1 + end;
            } else if byte.is_ascii_whitespace() {
                self.line += usize::from(*byte == b'\n');
                self.at += 1;
            } else {
                break;
            }
        }
        let rest = &self.bytes[self.at.min(self.bytes.len())..];
        let end = rest
            .iter()
            .position(|byte| byte.is_ascii_whitespace() || *byte == b'#')
            .unwrap_or(rest.len());
        self.at += end;
        std::str::from_utf8(&rest[..end]).unwrap_or("bytes that are not text")
    }

    fn header(&mut self, expected: &'static str) -> Result<u32, ImageError> {
        let word = self.next();
        word.parse().map_err(|_| ImageError::Header {
            expected,
            found: quote(word),
        })
    }
}

fn quote(word: &str) -> String {
    if word.is_empty() {
        "the end of the file".to_owned()
    } else {
        format!("`{}`", word.chars().take(40).collect::<String>())
    }
}

fn decode_pgm(mut bytes: Vec<u8>) -> Result<GrayImage, ImageError> {
    let mut words = Words {
        bytes: &bytes,
        at: 2,
        line: 1,
        comments: Vec::new(),
    };
    let (width, height) = (words.header("the width")?, words.header("the height")?);
    let limit = words.header("the largest value")?;
    if !(1..=65_535).contains(&limit) {
        return Err(ImageError::Header {
            expected: "a largest value from 1 to 65535",
            found: limit.to_string(),
        });
    }
    let count = checked_size(width.into(), height.into())?;
    // Values above the limit count as white.
    let scaled = |value: u32| {
        if limit == 255 {
            value.min(255) as u8
        } else {
            ((value.min(limit) * 255 + limit / 2) / limit) as u8
        }
    };
    let is_binary = bytes[1] == b'5';
    let (gray, comments) = if is_binary {
        // Exactly one white space character ends the header.
        let start = words.at + 1;
        let comments = std::mem::take(&mut words.comments);
        let data = bytes.get(start..).unwrap_or_default();
        let size = if limit > 255 { 2 } else { 1 };
        if data.len() / size < count {
            return Err(ImageError::Truncated {
                expected: count,
                found: data.len() / size,
            });
        }
        if size == 2 {
            let pairs = data.as_chunks::<2>().0.iter().take(count);
            let gray = pairs
                .map(|[high, low]| scaled(u32::from(*high) << 8 | u32::from(*low)))
                .collect();
            (gray, comments)
        } else {
            // In place: the largest maps fill a good part of the memory.
            bytes.drain(..start);
            bytes.truncate(count);
            for value in &mut bytes {
                *value = scaled(u32::from(*value));
            }
            (bytes, comments)
        }
    } else {
        let mut gray = Vec::with_capacity(count.min(bytes.len()));
        while gray.len() < count {
            let word = words.next();
            if word.is_empty() {
                return Err(ImageError::Truncated {
                    expected: count,
                    found: gray.len(),
                });
            }
            let value = word.parse().ok().filter(|value| *value <= limit);
            gray.push(scaled(value.ok_or_else(|| ImageError::Value {
                line: words.line,
                limit,
                found: quote(word),
            })?));
        }
        (gray, words.comments)
    };
    Ok(GrayImage {
        width,
        height,
        gray,
        opacity: None,
        comments,
    })
}

fn decode_png(bytes: &[u8]) -> Result<GrayImage, ImageError> {
    let broken = |error: png::DecodingError| ImageError::Png(error.to_string());
    let mut decoder = png::Decoder::new_with_limits(
        Cursor::new(bytes),
        png::Limits {
            bytes: 4 * MAX_CELLS as usize + (1 << 20),
        },
    );
    decoder.set_transformations(png::Transformations::EXPAND | png::Transformations::STRIP_16);
    let header = decoder.read_header_info().map_err(broken)?;
    let (width, height) = (header.width, header.height);
    let count = checked_size(width.into(), height.into())?;
    let mut reader = decoder.read_info().map_err(broken)?;
    let channels = reader.output_color_type().0.samples();
    let mut row = vec![0_u8; reader.output_buffer_size().unwrap_or_default() / (height.max(1) as usize)];
    let mut gray = Vec::with_capacity(count);
    let mut opacity = if channels % 2 == 0 {
        Some(Vec::with_capacity(count))
    } else {
        None
    };
    let colors = if channels > 2 { 3 } else { 1 };
    let mut take = |pixels: &[u8]| {
        for pixel in pixels.chunks_exact(channels) {
            let sum: u32 = pixel[..colors].iter().map(|value| u32::from(*value)).sum();
            gray.push(((sum + colors as u32 / 2) / colors as u32) as u8);
            if let Some(opacity) = &mut opacity {
                opacity.push(pixel[channels - 1]);
            }
        }
    };
    if reader.info().interlaced {
        let mut all = vec![0_u8; reader.output_buffer_size().unwrap_or_default()];
        reader.next_frame(&mut all).map_err(broken)?;
        take(&all);
    } else {
        for _ in 0..height {
            reader.read_row(&mut row).map_err(broken)?;
            take(&row);
        }
    }
    if gray.len() != count {
        return Err(ImageError::Truncated {
            expected: count,
            found: gray.len(),
        });
    }
    Ok(GrayImage {
        width,
        height,
        gray,
        opacity,
        comments: Vec::new(),
    })
}

/// What stands before the pixels of a binary graymap (P5).
#[must_use]
pub fn pgm_header(width: u32, height: u32, comments: &[String]) -> String {
    let comments: String = comments
        .iter()
        .map(|comment| format!("# {}\n", comment.replace('\n', " ")))
        .collect();
    format!("P5\n{comments}{width} {height}\n255\n")
}

/// A binary graymap (P5) with comments; opacity is lost.
#[must_use]
pub fn encode_pgm(image: &GrayImage) -> Vec<u8> {
    let header = pgm_header(image.width, image.height, &image.comments);
    [header.as_bytes(), &image.gray].concat()
}

/// A PNG, with opacity where the picture has it.
///
/// # Errors
/// [`ImageError::Png`] for a picture without pixels, which PNG cannot hold.
pub fn encode_png(image: &GrayImage) -> Result<Vec<u8>, ImageError> {
    let failed = |error: png::EncodingError| ImageError::Png(error.to_string());
    let mut bytes = Vec::new();
    let mut encoder = png::Encoder::new(&mut bytes, image.width, image.height);
    encoder.set_depth(png::BitDepth::Eight);
    encoder.set_compression(png::Compression::Fast);
    encoder.set_color(if image.opacity.is_some() {
        png::ColorType::GrayscaleAlpha
    } else {
        png::ColorType::Grayscale
    });
    let mut writer = encoder.write_header().map_err(failed)?;
    match &image.opacity {
        None => writer.write_image_data(&image.gray).map_err(failed)?,
        Some(opacity) => {
            let pairs: Vec<u8> = image
                .gray
                .iter()
                .zip(opacity)
                .flat_map(|(gray, opacity)| [*gray, *opacity])
                .collect();
            writer.write_image_data(&pairs).map_err(failed)?;
        }
    }
    writer.finish().map_err(failed)?;
    Ok(bytes)
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "tests")]
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
        fn pictures_come_back_as_they_went(width in 1_u32..40, height in 1_u32..40, seed in any::<u8>(), see_through in any::<bool>()) {
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

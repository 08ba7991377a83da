//! Portable graymaps. Reads and writes PGM files.
//!
//! Written here rather than taken from a crate: readers of the `image` family drop the comments, which carry a map's place and revision
//! (`map_file`), do not give the line of an error, and need far more code.

use super::{GrayImage, ImageError, checked_size};

/// The words of a graymap; comments are collected along the way.
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

/// Where the pixels of a binary graymap begin: after exactly one white-space character (netpbm's `pgm` format). Files with more of it, as the
/// line ends of Windows, and with a comment after the largest value are read where the pixels, `length` bytes, then fit exactly.
fn raster_start(bytes: &[u8], header_end: usize, length: usize) -> usize {
    let mut start = header_end;
    while let Some(byte) = bytes.get(start) {
        start += match byte {
            b'#' => bytes[start..].iter().take_while(|byte| **byte != b'\n').count() + 1,
            byte if byte.is_ascii_whitespace() => 1,
            _ => break,
        };
        if bytes.len().checked_sub(start) == Some(length) {
            return start;
        }
    }
    header_end + 1
}

/// Decodes a graymap, text (P2) or binary (P5).
pub(super) fn decode(mut bytes: Vec<u8>) -> Result<GrayImage, ImageError> {
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
        let size = if limit > 255 { 2 } else { 1 };
        let start = raster_start(&bytes, words.at, size * count);
        let comments = std::mem::take(&mut words.comments);
        let data = bytes.get(start..).unwrap_or_default();
        if data.len() / size < count {
            return Err(ImageError::Truncated {
                expected: count,
                found: data.len() / size,
            });
        }
        if !data[size * count..].iter().all(u8::is_ascii_whitespace) {
            return Err(ImageError::Length {
                expected: size * count,
                found: data.len(),
            });
        }
        if size == 2 {
            let pairs = data.as_chunks::<2>().0.iter().take(count);
            let gray = pairs
                .map(|[high, low]| scaled(u32::from(*high) << 8 | u32::from(*low)))
                .collect();
            (gray, comments)
        } else {
            // In place: the largest maps fill much of the memory.
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

/// The header of a binary graymap (P5).
pub(crate) fn pgm_header(width: u32, height: u32, comments: &[String]) -> String {
    let comments: String = comments
        .iter()
        .map(|comment| format!("# {}\n", comment.replace('\n', " ")))
        .collect();
    format!("P5\n{comments}{width} {height}\n255\n")
}

/// Encodes a binary graymap (P5) with its comments; opacity is lost.
#[must_use]
pub fn encode_pgm(image: &GrayImage) -> Vec<u8> {
    let header = pgm_header(image.width, image.height, &image.comments);
    [header.as_bytes(), &image.gray].concat()
}

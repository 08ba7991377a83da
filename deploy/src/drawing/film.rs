//! Film. Encodes pictures as an animated GIF: one palette for all, and of each picture only the changes since the previous one.

use std::collections::HashMap;

use super::canvas::{Canvas, Color};
use crate::failure::Failure;

/// Colours of the palette besides the transparent one.
const COLORS: usize = 255;
/// Every so many pictures one is sampled for the palette.
const STRIDE: usize = 6;

/// Factor by which the last picture is shown longer.
const LAST: u16 = 20;

/// Encodes `count` pictures of one size, drawn one by one on demand; each is shown for `hundredths` of a second, the last one longer.
///
/// # Errors
/// No pictures, a picture that cannot be drawn, or one of another size.
pub fn encode(
    count: usize,
    hundredths: u16,
    mut draw: impl FnMut(usize) -> Result<Canvas, Failure>,
) -> Result<Vec<u8>, Failure> {
    let failed = |error: gif::EncodingError| Failure::failed(format!("a film: {error}"));
    let last = count
        .checked_sub(1)
        .ok_or_else(|| Failure::failed("a film without pictures"))?;
    let mut palette = Palette::default();
    for index in (0..last).step_by(STRIDE).chain([last]) {
        palette.count(&draw(index)?);
    }
    palette.choose();

    let first = draw(0)?;
    let side = |pixels: u32| u16::try_from(pixels).map_err(|_| Failure::usage("a film's pictures are too large"));
    let (width, height) = (side(first.width())?, side(first.height())?);
    let mut bytes = Vec::new();
    let mut encoder = gif::Encoder::new(&mut bytes, width, height, &palette.bytes()).map_err(failed)?;
    encoder.set_repeat(gif::Repeat::Infinite).map_err(failed)?;
    let mut shown = Vec::new();
    for index in 0..count {
        let canvas = draw(index)?;
        if (canvas.width(), canvas.height()) != (width.into(), height.into()) {
            return Err(Failure::failed("a film needs pictures of one size"));
        }
        let next = palette.indices(&canvas);
        let change = Change::between(&shown, &next, width.into());
        let frame = gif::Frame {
            left: change.left as u16,
            top: change.top as u16,
            dispose: gif::DisposalMethod::Keep,
            delay: if index == last {
                hundredths.saturating_mul(LAST)
            } else {
                hundredths
            },
            ..gif::Frame::from_indexed_pixels(change.width as u16, change.height as u16, change.pixels, Some(0))
        };
        encoder.write_frame(&frame).map_err(failed)?;
        shown = next;
    }
    drop(encoder);
    Ok(bytes)
}

/// The smallest rectangle with all changes; unchanged pixels in it are transparent.
struct Change {
    left: usize,
    top: usize,
    width: usize,
    height: usize,
    pixels: Vec<u8>,
}

impl Change {
    fn between(shown: &[u8], next: &[u8], width: usize) -> Self {
        let changed = || (0..next.len()).filter(|at| shown.get(*at) != next.get(*at));
        let (left, right) = changed()
            .map(|at| at % width)
            .fold((width, 0), |(low, high), x| (low.min(x), high.max(x)));
        let (top, bottom) = (
            changed().next().unwrap_or(0) / width,
            changed().next_back().unwrap_or(0) / width,
        );
        let (left, right) = if left > right { (0, 0) } else { (left, right) };
        let pixels = (top..=bottom)
            .flat_map(|y| (left..=right).map(move |x| y * width + x))
            .map(|at| match (shown.get(at), next.get(at)) {
                (shown, Some(pixel)) if shown != Some(pixel) => *pixel,
                _ => 0,
            })
            .collect();
        Self {
            left,
            top,
            width: right - left + 1,
            height: bottom - top + 1,
            pixels,
        }
    }
}

/// The most frequent colours; index 0 is transparent.
#[derive(Default)]
struct Palette {
    counts: HashMap<Color, u64>,
    colors: Vec<Color>,
    nearest: HashMap<Color, u8>,
}

impl Palette {
    fn count(&mut self, canvas: &Canvas) {
        for color in canvas.rgb().as_chunks::<3>().0 {
            *self.counts.entry(*color).or_default() += 1;
        }
    }

    fn choose(&mut self) {
        let mut colors: Vec<(u64, Color)> = self.counts.drain().map(|(color, count)| (count, color)).collect();
        colors.sort_unstable_by(|a, b| b.cmp(a));
        self.colors = colors.into_iter().take(COLORS).map(|(_, color)| color).collect();
    }

    fn bytes(&self) -> Vec<u8> {
        std::iter::once([0; 3])
            .chain(self.colors.iter().copied())
            .flatten()
            .collect()
    }

    fn indices(&mut self, canvas: &Canvas) -> Vec<u8> {
        let (colors, nearest) = (&self.colors, &mut self.nearest);
        let mut index = |color: Color| {
            *nearest.entry(color).or_insert_with(|| {
                let off = |other: &Color| -> u32 {
                    let pairs = other.iter().zip(color);
                    pairs.map(|(a, b)| u32::from(a.abs_diff(b)).pow(2)).sum()
                };
                let best = colors.iter().enumerate().min_by_key(|(_, other)| off(other));
                best.map_or(0, |(index, _)| index as u8 + 1)
            })
        };
        canvas
            .rgb()
            .as_chunks::<3>()
            .0
            .iter()
            .map(|color| index(*color))
            .collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_picture_of_a_film_is_what_was_drawn() {
        let draw = |index: usize| {
            let mut canvas = Canvas::new(30, 20, [255; 3]).unwrap();
            // The third picture equals the second.
            let x = 3.0 * index.min(2) as f32;
            canvas.fill(
                &[[x, 4.0], [x + 8.0, 4.0], [x + 8.0, 15.0], [x, 15.0]],
                [200, 30, 30],
                255,
            );
            Ok(canvas)
        };
        let bytes = encode(4, 10, draw).unwrap();
        let mut options = gif::DecodeOptions::new();
        options.set_color_output(gif::ColorOutput::RGBA);
        let mut decoder = options.read_info(&bytes[..]).unwrap();
        let mut shown = vec![0; 30 * 20 * 3];
        let mut index = 0;
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            let (left, top, width) = (
                usize::from(frame.left),
                usize::from(frame.top),
                usize::from(frame.width),
            );
            for (at, pixel) in frame.buffer.as_chunks::<4>().0.iter().enumerate() {
                if pixel[3] > 0 {
                    let to = ((top + at / width) * 30 + left + at % width) * 3;
                    shown[to..to + 3].copy_from_slice(&pixel[..3]);
                }
            }
            assert_eq!(shown, draw(index).unwrap().rgb(), "picture {index}");
            index += 1;
        }
        assert_eq!(index, 4);
    }

    #[test]
    fn a_film_needs_a_picture() {
        assert!(encode(0, 100, |_| Canvas::new(1, 1, [0; 3])).is_err());
    }
}

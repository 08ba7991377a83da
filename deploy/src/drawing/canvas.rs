//! Canvas. Draws shapes and text into pixels. Coordinates in pixels from the top left; anything outside is clipped.

use std::sync::OnceLock;

use ab_glyph::{Font as _, FontRef, PxScale, ScaleFont as _, point};
use tiny_skia::{
    FillRule, LineCap, LineJoin, Paint, Path, PathBuilder, Pixmap, PremultipliedColorU8, Stroke, Transform,
};

use crate::failure::Failure;

/// Red, green, blue.
pub type Color = [u8; 3];

/// Text and thin lines.
pub const INK: Color = [24, 28, 34];
/// Secondary text.
pub const GREY: Color = [110, 117, 126];
/// Background.
pub const WHITE: Color = [255, 255, 255];

/// Most pixels of a picture.
const MOST_PIXELS: u64 = 100_000_000;
/// Coordinates beyond this are clamped: the rasteriser's number range is small.
const FAR: f32 = 32_000.0;
/// Line height of a font relative to its size.
const LINE_HEIGHT: f32 = 1.164;

/// A point in pixels.
pub type Pixel = [f32; 2];

/// The end of a text that is at its point.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// Its beginning.
    Start,
    /// Its middle.
    Middle,
    /// Its end.
    End,
}

/// Typeface.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Face {
    /// Plain.
    Regular,
    /// For titles.
    Bold,
}

impl Face {
    fn font(self) -> Option<&'static FontRef<'static>> {
        static FONTS: [OnceLock<Option<FontRef<'static>>>; 2] = [const { OnceLock::new() }; 2];
        let (font, bytes): (_, fn() -> &'static [u8]) = match self {
            Self::Regular => (&FONTS[0], dejavu::sans::regular),
            Self::Bold => (&FONTS[1], dejavu::sans::bold),
        };
        font.get_or_init(|| FontRef::try_from_slice(bytes()).ok()).as_ref()
    }
}

/// Width of a text, px.
#[must_use]
pub fn text_width(text: &str, size: f32, face: Face) -> f32 {
    let Some(font) = face.font() else { return 0.0 };
    let font = font.as_scaled(PxScale::from(size * LINE_HEIGHT));
    text.chars().map(|letter| font.h_advance(font.glyph_id(letter))).sum()
}

/// Pixels, rows from the top.
pub struct Canvas {
    pixmap: Pixmap,
}

impl Canvas {
    /// A canvas filled with one colour.
    ///
    /// # Errors
    /// No pixels, or too many.
    pub fn new(width: u32, height: u32, color: Color) -> Result<Self, Failure> {
        let bad = || Failure::usage(format!("a picture of {width} by {height} pixels cannot be drawn"));
        if u64::from(width) * u64::from(height) > MOST_PIXELS {
            return Err(bad());
        }
        let mut pixmap = Pixmap::new(width, height).ok_or_else(bad)?;
        pixmap.fill(skia(color, 255));
        Ok(Self { pixmap })
    }

    /// Two canvases side by side, as high as the higher one.
    ///
    /// # Errors
    /// Too many pixels.
    pub fn beside(self, right: &Self, color: Color) -> Result<Self, Failure> {
        let height = self.height().max(right.height());
        let mut both = Self::new(self.width() + right.width(), height, color)?;
        for (canvas, left) in [(&self, 0), (right, self.width() as i32)] {
            let (pixels, paint) = (canvas.pixmap.as_ref(), tiny_skia::PixmapPaint::default());
            both.pixmap
                .draw_pixmap(left, 0, pixels, &paint, Transform::identity(), None);
        }
        Ok(both)
    }

    /// Width, px.
    #[must_use]
    pub fn width(&self) -> u32 {
        self.pixmap.width()
    }

    /// Height, px.
    #[must_use]
    pub fn height(&self) -> u32 {
        self.pixmap.height()
    }

    /// Red, green and blue of every pixel, row by row.
    #[must_use]
    pub fn rgb(&self) -> Vec<u8> {
        let pixels = self.pixmap.pixels().iter();
        pixels
            .flat_map(|pixel| [pixel.red(), pixel.green(), pixel.blue()])
            .collect()
    }

    /// One pixel.
    pub fn set(&mut self, x: u32, y: u32, color: Color) {
        if x < self.width() && y < self.height() {
            let at = y as usize * self.width() as usize + x as usize;
            if let (Some(pixel), Some(color)) = (self.pixmap.pixels_mut().get_mut(at), opaque(color)) {
                *pixel = color;
            }
        }
    }

    /// A filled polygon; `opacity` from 0 to 255.
    pub fn fill(&mut self, corners: &[Pixel], color: Color, opacity: u8) {
        if let Some(path) = path(corners, true) {
            self.fill_path(&path, color, opacity);
        }
    }

    fn fill_path(&mut self, path: &Path, color: Color, opacity: u8) {
        let paint = paint(color, opacity);
        self.pixmap
            .fill_path(path, &paint, FillRule::EvenOdd, Transform::identity(), None);
    }

    /// Lines from point to point, and back to the first if `closed`; `width` in pixels.
    pub fn stroke(&mut self, points: &[Pixel], closed: bool, color: Color, width: f32) {
        let Some(path) = path(points, closed) else { return };
        self.stroke_path(&path, color, width);
    }

    /// A curve with horizontal ends.
    pub fn curve(&mut self, from: Pixel, to: Pixel, color: Color, width: f32) {
        let mut path = PathBuilder::new();
        let middle = 0.5 * (from[0] + to[0]);
        path.move_to(from[0], from[1]);
        path.cubic_to(middle, from[1], middle, to[1], to[0], to[1]);
        if let Some(path) = path.finish() {
            self.stroke_path(&path, color, width);
        }
    }

    fn stroke_path(&mut self, path: &Path, color: Color, width: f32) {
        let stroke = Stroke {
            width,
            line_cap: LineCap::Round,
            line_join: LineJoin::Round,
            ..Stroke::default()
        };
        self.pixmap
            .stroke_path(path, &paint(color, 255), &stroke, Transform::identity(), None);
    }

    /// A filled disc.
    pub fn disc(&mut self, [x, y]: Pixel, radius: f32, color: Color) {
        if x.abs() < FAR
            && y.abs() < FAR
            && let Some(path) = PathBuilder::from_circle(x, y, radius)
        {
            self.fill_path(&path, color, 255);
        }
    }

    /// A filled rectangle with round corners.
    pub fn card(&mut self, [left, top]: Pixel, [width, height]: Pixel, corner: f32, color: Color, opacity: u8) {
        let (right, bottom) = (left + width, top + height);
        let mut path = PathBuilder::new();
        path.move_to(left + corner, top);
        path.line_to(right - corner, top);
        path.quad_to(right, top, right, top + corner);
        path.line_to(right, bottom - corner);
        path.quad_to(right, bottom, right - corner, bottom);
        path.line_to(left + corner, bottom);
        path.quad_to(left, bottom, left, bottom - corner);
        path.line_to(left, top + corner);
        path.quad_to(left, top, left + corner, top);
        path.close();
        if let Some(path) = path.finish() {
            self.fill_path(&path, color, opacity);
        }
    }

    /// A line of text with its baseline at a point.
    pub fn text(&mut self, at: Pixel, text: &str, size: f32, color: Color, anchor: Anchor, face: Face) {
        let Some(font) = face.font() else { return };
        let scale = PxScale::from(size * LINE_HEIGHT);
        let scaled = font.as_scaled(scale);
        let width = text_width(text, size, face);
        let mut x = match anchor {
            Anchor::Start => at[0],
            Anchor::Middle => at[0] - 0.5 * width,
            Anchor::End => at[0] - width,
        };
        for letter in text.chars() {
            let id = font.glyph_id(letter);
            if let Some(outline) = font.outline_glyph(id.with_scale_and_position(scale, point(x, at[1]))) {
                let corner = outline.px_bounds().min;
                outline.draw(|column, row, share| {
                    self.blend(corner.x + column as f32, corner.y + row as f32, color, share);
                });
            }
            x += scaled.h_advance(id);
        }
    }

    fn blend(&mut self, x: f32, y: f32, color: Color, share: f32) {
        let inside = x >= 0.0 && y >= 0.0 && x < self.width() as f32 && y < self.height() as f32;
        let at = y as usize * self.width() as usize + x as usize;
        let Some(pixel) = self.pixmap.pixels_mut().get_mut(at).filter(|_| inside) else {
            return;
        };
        let share = share.clamp(0.0, 1.0);
        let mix = |under: u8, over: u8| (f32::from(under) * (1.0 - share) + f32::from(over) * share).round() as u8;
        let mixed = [
            mix(pixel.red(), color[0]),
            mix(pixel.green(), color[1]),
            mix(pixel.blue(), color[2]),
        ];
        if let Some(mixed) = opaque(mixed) {
            *pixel = mixed;
        }
    }

    /// A PNG.
    ///
    /// # Errors
    /// A picture that cannot be encoded.
    pub fn png(&self) -> Result<Vec<u8>, Failure> {
        let failed = |error: png::EncodingError| Failure::failed(format!("a picture: {error}"));
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, self.width(), self.height());
        encoder.set_depth(png::BitDepth::Eight);
        encoder.set_color(png::ColorType::Rgb);
        let mut writer = encoder.write_header().map_err(failed)?;
        writer.write_image_data(&self.rgb()).map_err(failed)?;
        writer.finish().map_err(failed)?;
        Ok(bytes)
    }
}

fn skia([red, green, blue]: Color, opacity: u8) -> tiny_skia::Color {
    tiny_skia::Color::from_rgba8(red, green, blue, opacity)
}

fn opaque([red, green, blue]: Color) -> Option<PremultipliedColorU8> {
    PremultipliedColorU8::from_rgba(red, green, blue, 255)
}

fn paint(color: Color, opacity: u8) -> Paint<'static> {
    let mut paint = Paint {
        anti_alias: true,
        ..Paint::default()
    };
    paint.set_color(skia(color, opacity));
    paint
}

/// `None` if there is nothing to draw. Points that are not numbers are left out.
fn path(points: &[Pixel], closed: bool) -> Option<Path> {
    let mut path = PathBuilder::new();
    let points = points.iter().filter(|[x, y]| !x.is_nan() && !y.is_nan());
    for (index, [x, y]) in points.enumerate() {
        let (x, y) = (x.clamp(-FAR, FAR), y.clamp(-FAR, FAR));
        if index == 0 {
            path.move_to(x, y);
        } else {
            path.line_to(x, y);
        }
    }
    if closed {
        path.close();
    }
    path.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_word_is_as_wide_as_it_is_said_to_be() {
        let width = text_width("Kitchen", 20.0, Face::Regular);
        assert!((60.0..90.0).contains(&width), "{width}");
        let mut canvas = Canvas::new(100, 40, WHITE).unwrap();
        canvas.text([5.0, 30.0], "Kitchen", 20.0, INK, Anchor::Start, Face::Regular);
        let dark = |x: u32| (0..40).any(|y: u32| canvas.rgb()[((y * 100 + x) * 3) as usize] < 100);
        let last = (0..100).rfind(|x| dark(*x)).unwrap() as f32;
        assert!((last - 5.0 - width).abs() < 4.0, "{last} {width}");
        assert!(!dark(2) && dark(7));
    }

    #[test]
    fn what_lies_nowhere_or_far_away_does_no_harm() {
        let mut canvas = Canvas::new(20, 20, WHITE).unwrap();
        let far = [[f32::INFINITY, 0.0], [f32::NAN, 1.0], [-1e30, 1e30], [5.0, 5.0]];
        canvas.stroke(&far, true, INK, 1.0);
        canvas.fill(&far, INK, 255);
        canvas.disc(far[0], 3.0, INK);
        canvas.disc(far[1], 3.0, INK);
        canvas.text([-1e9, 1e9], "a", 12.0, INK, Anchor::Middle, Face::Bold);
        assert!(canvas.png().is_ok());
        assert!(Canvas::new(0, 5, WHITE).is_err() && Canvas::new(60_000, 60_000, WHITE).is_err());
    }
}

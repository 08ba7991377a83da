//! PNG. Reads and writes grey PNG files.

use std::io::Cursor;

use zenav_protocol::grid::MAX_CELLS;

use super::{GrayImage, ImageError, checked_size};

/// Decodes a PNG of any kind; sixteen bits are reduced to eight.
pub(super) fn decode(bytes: &[u8]) -> Result<GrayImage, ImageError> {
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

/// Encodes a PNG, with opacity if the image has it.
///
/// # Errors
/// [`ImageError::Png`] for an image without pixels, which PNG cannot express.
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

//! Height maps as greyscale images: x to the right, y up, white is 1.

use super::{MOST, Map, Placement};
use crate::error::{Error, Result};
use std::io::Cursor;

/// Reads a greyscale image of at most 16 bits; white is 1. The rows of the image run from the top down.
pub(super) fn map(bytes: &[u8], _: &Placement) -> Result<Map> {
    let format = |e: png::DecodingError| Error::Format { message: format!("not a PNG file: {e}") };
    let mut decoder = png::Decoder::new_with_limits(Cursor::new(bytes), png::Limits { bytes: 256 << 20 });
    decoder.set_transformations(png::Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(format)?;
    let (width, height) = (reader.info().width as usize, reader.info().height as usize);
    if width > MOST || height > MOST {
        return Err(Error::invalid("height map", format!("{width} x {height} pixels"), format!("at most {MOST} x {MOST}")));
    }
    let (color, depth) = reader.output_color_type();
    let has_alpha = match color {
        png::ColorType::Grayscale => false,
        png::ColorType::GrayscaleAlpha => true,
        other => {
            let found = format!("an image of type {other:?}");
            return Err(Error::invalid(
                "height map",
                found,
                "greyscale: a height is one number (`convert in.png -colorspace Gray out.png`)",
            ));
        }
    };
    let size =
        reader.output_buffer_size().ok_or_else(|| Error::invalid("height map", "too many pixels", "an image that fits into memory"))?;
    let mut pixels = vec![0; size];
    let frame = reader.next_frame(&mut pixels).map_err(format)?;
    let wide = depth == png::BitDepth::Sixteen;
    let (channels, bytes_each) = (1 + usize::from(has_alpha), 1 + usize::from(wide));
    let value =
        |at: usize| if wide { f64::from(u16::from_be_bytes([pixels[at], pixels[at + 1]])) / 65535. } else { f64::from(pixels[at]) / 255. };
    let pixel = |column: usize, row: usize| {
        let at = row * frame.line_size + column * channels * bytes_each;
        if has_alpha && value(at + bytes_each) == 0. { f64::NAN } else { value(at) }
    };
    Ok(Map::unplaced((0..width).map(|column| (0..height).map(|j| pixel(column, height - 1 - j)).collect()).collect()))
}

//! Conversion of SVG to PNG. The program contains its font, a subset of DejaVu Sans with ASCII and a few signs, so no system font is
//! needed. Other characters, such as those in a robot's name, are not drawn.

use crate::error::{Error, Result};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};

/// PNG pixels per SVG pixel; 2 is sharp in print.
const SCALE: f32 = 2.;

/// Converts a picture to PNG with twice its pixels in each direction.
///
/// # Errors
/// [`Error::Format`] if the text is not an SVG that can be drawn.
pub fn png(svg: &str) -> Result<Vec<u8>> {
    let mut options = Options { font_family: "DejaVu Sans".into(), ..Options::default() };
    let fonts = options.fontdb_mut();
    fonts.load_font_data(include_bytes!("font/DejaVuSans-subset.ttf").to_vec());
    fonts.set_sans_serif_family("DejaVu Sans");
    let failed = |message: String| Error::Format { message: format!("PNG: {message}") };
    let tree = Tree::from_str(svg, &options).map_err(|e| failed(e.to_string()))?;
    let size = tree.size().to_int_size().scale_by(SCALE).ok_or_else(|| failed("no size".into()))?;
    let mut pixels = Pixmap::new(size.width(), size.height()).ok_or_else(|| failed("no size".into()))?;
    resvg::render(&tree, Transform::from_scale(SCALE, SCALE), &mut pixels.as_mut());
    pixels.encode_png().map_err(|e| failed(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::report::svg::{Picture, SMALL};

    #[test]
    fn text_is_drawn_without_system_fonts() {
        let image = |text: &str| {
            let mut picture = Picture::new(60., 20.);
            picture.text(5., 15., "start", SMALL, text);
            png(&picture.finish()).unwrap()
        };
        assert!(image("").starts_with(b"\x89PNG\r\n"));
        for sign in ["x, m", "\u{2212}", "\u{2192}", "\u{b2}"] {
            assert_ne!(image(sign), image(""), "{sign}");
        }
        assert!(png("no picture").is_err());
    }
}

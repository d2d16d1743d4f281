//! SVG as PNG. The font is in the program: a subset of DejaVu Sans with the letters of ASCII and a few signs, so that no font of the system is
//! needed; what other letters a robot's name has are left out.

use crate::error::{Error, Result};
use resvg::tiny_skia::{Pixmap, Transform};
use resvg::usvg::{Options, Tree};

/// Pixels of a picture for one of its own: sharp in print.
const SCALE: f32 = 2.;

/// A picture as PNG, twice as many pixels each way as it says.
///
/// # Errors
/// [`Error::Format`] when it is no SVG that can be drawn.
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
    fn letters_are_drawn_without_fonts_of_the_system() {
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

//! Height maps as terrains: CSV, NPY (numpy) and greyscale PNG.
//!
//! Heights `z[i][j]` of CSV and NPY are at `x = origin[0] + i cell`, `y = origin[1] + j cell`. An image is a map seen from above with x to
//! the right and y up: its lower left pixel is at the origin. NaN and infinite heights, and transparent pixels of an image, mark ground
//! that cannot carry a foot: a pit, [`HOLE`] deeper than the lowest height.

use super::{Grid, Shape, Terrain};
use crate::error::{Error, Result, check_range};
use std::io::Cursor;
use std::path::Path;

/// Depth of holes below the lowest height, m.
pub const HOLE: f64 = 2.;

/// Largest number of samples along an axis.
const MOST: usize = 4096;

/// Parameters that a height map does not contain itself.
#[derive(Debug, Clone, PartialEq)]
pub struct Placement {
    /// Distance between samples, m.
    pub cell: f64,
    /// Position of the first sample (x, y), m.
    pub origin: [f64; 2],
    /// Factor on heights; for an image the height of white, m.
    pub height_scale: f64,
    /// Friction coefficient.
    pub friction: f64,
}

impl Placement {
    fn validate(&self) -> Result<()> {
        check_range("--cell", self.cell, 1e-3, 100.)?;
        check_range("--origin", self.origin[0], -1000., 1000.)?;
        check_range("--origin", self.origin[1], -1000., 1000.)?;
        check_range("--height-scale", self.height_scale, -1000., 1000.)?;
        check_range("--friction", self.friction, 1e-3, 100.)
    }
}

/// Terrain imported from a height map.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// Imported terrain.
    pub terrain: Terrain,
    /// Number of samples that are holes. Holes are the lowest samples.
    pub holes: usize,
}

/// Creates a terrain from the bytes of a height map. The extension of its path selects the format.
///
/// * `name` - name of the terrain; by default the stem of the file name, with `-imported` appended if a built-in terrain of that name has
///   another shape
///
/// # Errors
/// [`Error::Invalid`] or [`Error::Format`] for an unknown format, a malformed file, rows of different length, heights outside the limits of
/// a [`Grid`], or an invalid name.
pub fn terrain_of(path: &Path, bytes: &[u8], placement: &Placement, name: Option<&str>) -> Result<Imported> {
    placement.validate()?;
    let extension = path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default();
    let heights = match extension.as_str() {
        "csv" => of_csv(bytes)?,
        "npy" => of_npy(bytes)?,
        "png" => of_png(bytes)?,
        _ => return Err(Error::invalid("file name", path.display(), "one that ends in .csv, .npy or .png")),
    };
    let of_file = || path.file_stem().map(|stem| stem.to_string_lossy().chars().take(64).collect()).unwrap_or_default();
    let mut imported = terrain_of_heights(name.map_or_else(of_file, str::to_owned), heights, placement)?;
    match name {
        Some(_) => imported.terrain.validate_own()?,
        None if imported.terrain.differs_from_named() => imported.terrain.name += "-imported",
        None => {}
    }
    Ok(imported)
}

/// Creates a terrain from heights, m, `[rows along x][columns along y]`; NaN and infinite heights are holes.
///
/// # Errors
/// [`Error::Invalid`] for rows of different length, or heights outside the limits of a [`Grid`].
pub fn terrain_of_heights(name: String, heights: Vec<Vec<f64>>, placement: &Placement) -> Result<Imported> {
    placement.validate()?;
    let holes = heights.iter().flatten().filter(|h| !h.is_finite()).count();
    let terrain = Terrain { name, friction: placement.friction, shape: Shape::Grid(placed(heights, placement)?) };
    terrain.validate()?;
    Ok(Imported { terrain, holes })
}

/// Creates the grid of the given heights; NaN and infinite heights become holes.
fn placed(mut heights: Vec<Vec<f64>>, placement: &Placement) -> Result<Grid> {
    let (rows, columns) = (heights.len(), heights.first().map_or(0, Vec::len));
    if rows < 2 || columns < 2 || rows > MOST || columns > MOST {
        return Err(Error::invalid("height map", format!("{rows} x {columns} samples"), format!("2 x 2 to {MOST} x {MOST}")));
    }
    heights.iter_mut().flatten().for_each(|h| *h *= placement.height_scale);
    let lowest = heights.iter().flatten().copied().filter(|h| h.is_finite()).fold(f64::INFINITY, f64::min);
    if lowest == f64::INFINITY {
        return Err(Error::invalid("height map", "only holes", "at least one height"));
    }
    heights.iter_mut().flatten().filter(|h| !h.is_finite()).for_each(|h| *h = lowest - HOLE);
    let low = placement.origin;
    Ok(Grid { low, high: [low[0] + rows as f64 * placement.cell, low[1] + columns as f64 * placement.cell], heights })
}

/// Reads numbers separated by commas, semicolons or tabs. An empty field or `nan` is a hole; a first line of words is a header.
fn of_csv(bytes: &[u8]) -> Result<Vec<Vec<f64>>> {
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let first = bytes.split(|&b| b == b'\n').next().unwrap_or_default();
    let separator = [b',', b';', b'\t'].into_iter().max_by_key(|s| (first.iter().filter(|&b| b == s).count(), *s == b',')).unwrap_or(b',');
    let mut reader =
        csv::ReaderBuilder::new().has_headers(false).flexible(true).delimiter(separator).trim(csv::Trim::All).from_reader(bytes);
    let mut rows: Vec<Vec<f64>> = Vec::new();
    let mut record = csv::ByteRecord::new();
    for number in 0.. {
        if !reader.read_byte_record(&mut record).map_err(|e| Error::Format { message: e.to_string() })? {
            break;
        }
        // The reader skips empty lines; the line number must count them.
        let read = &bytes[..bytes.len().min(reader.position().byte() as usize)];
        let line = || 1 + read.strip_suffix(b"\n").unwrap_or(read).iter().filter(|&&b| b == b'\n').count();
        let place = |column: usize| format!("line {}, column {}", line(), column + 1);
        let field = |(column, field): (usize, &[u8])| {
            let text = std::str::from_utf8(field).unwrap_or("?");
            if text.is_empty() {
                return Ok(f64::NAN);
            }
            text.parse::<f64>()
                .map_err(|_| Error::invalid(place(column), format!("`{}`", text.escape_debug()), "a height in m, or nothing"))
        };
        let row: Result<Vec<f64>> = record.iter().enumerate().map(field).collect();
        let row = match row {
            Err(_) if number == 0 && record.iter().all(|f| !f.is_empty() && f[0].is_ascii_alphabetic()) => continue,
            row => row?,
        };
        if let Some(columns) = rows.first().map(Vec::len)
            && columns != row.len()
        {
            return Err(Error::invalid(format!("line {}", line()), format!("{} columns", row.len()), format!("{columns} as in the first")));
        }
        if rows.len() == MOST {
            return Err(Error::invalid("height map", format!("more than {MOST} rows"), format!("at most {MOST}")));
        }
        rows.push(row);
    }
    Ok(rows)
}

/// Reads a matrix of floats or integers.
fn of_npy(bytes: &[u8]) -> Result<Vec<Vec<f64>>> {
    let format = |e: std::io::Error| Error::Format { message: format!("not an NPY file: {e}") };
    let header = npyz::NpyHeader::from_reader(Cursor::new(bytes)).map_err(format)?;
    let &[rows, columns] = header.shape() else {
        return Err(Error::invalid("height map", format!("{} dimensions", header.shape().len()), "2: x and y"));
    };
    if !(2..=MOST as u64).contains(&rows) || !(2..=MOST as u64).contains(&columns) {
        return Err(Error::invalid("height map", format!("{rows} x {columns} samples"), format!("2 x 2 to {MOST} x {MOST}")));
    }
    let by_columns = header.order() == npyz::Order::Fortran;
    let file = || npyz::NpyFile::new(Cursor::new(bytes)).map_err(format);
    let kind = header.dtype().descr();
    type File<'a> = npyz::NpyFile<Cursor<&'a [u8]>>;
    type Values = Option<std::io::Result<Vec<f64>>>;
    fn values<T: npyz::Deserialize + Into<f64>>(file: File) -> Values {
        let data = file.data::<T>().ok()?;
        Some(data.map(|value| value.map(Into::into)).collect())
    }
    let readers: [fn(File) -> Values; 8] =
        [values::<f64>, values::<f32>, values::<i32>, values::<u32>, values::<i16>, values::<u16>, values::<i8>, values::<u8>];
    let mut flat = None;
    for reader in readers {
        flat = reader(file()?);
        if flat.is_some() {
            break;
        }
    }
    let flat =
        flat.ok_or_else(|| Error::invalid("height map", format!("numbers of type {kind}"), "floats, or integers of at most 32 bits"))?;
    let flat = flat.map_err(format)?;
    let (rows, columns) = (rows as usize, columns as usize);
    if flat.len() != rows * columns {
        return Err(Error::invalid("height map", format!("{} numbers", flat.len()), format!("{rows} x {columns}")));
    }
    let at = |i: usize, j: usize| if by_columns { flat[j * rows + i] } else { flat[i * columns + j] };
    Ok((0..rows).map(|i| (0..columns).map(|j| at(i, j)).collect()).collect())
}

/// Reads a greyscale image of at most 16 bits; white is 1. The rows of the image run from the top down.
fn of_png(bytes: &[u8]) -> Result<Vec<Vec<f64>>> {
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
    Ok((0..width).map(|column| (0..height).map(|j| pixel(column, height - 1 - j)).collect()).collect())
}

impl Imported {
    /// Describes size, heights and steepest slope in one line and adds a text picture, seen from above with x up and y to the left, as the
    /// robot sees the ground ahead. Denser characters are higher; holes are blank.
    pub fn about(&self) -> String {
        let Shape::Grid(grid) = &self.terrain.shape else { return String::new() };
        let (rows, columns) = (grid.heights.len(), grid.heights[0].len());
        let lowest = grid.heights.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        let is_hole = |h: f64| self.holes > 0 && h == lowest;
        let solid = || grid.heights.iter().flatten().copied().filter(|&h| !is_hole(h));
        let (low, high) = (solid().fold(f64::INFINITY, f64::min), solid().fold(f64::NEG_INFINITY, f64::max));
        let rise = |a: f64, b: f64| if is_hole(a) || is_hole(b) { 0. } else { (a - b).abs() };
        let mut steepest: f64 = 0.;
        for i in 0..rows {
            for j in 0..columns {
                let here = grid.heights[i][j];
                steepest = steepest.max(rise(here, grid.heights[(i + 1).min(rows - 1)][j]));
                steepest = steepest.max(rise(here, grid.heights[i][(j + 1).min(columns - 1)]));
            }
        }
        let cell = (grid.high[0] - grid.low[0]) / rows as f64;
        let holes = if self.holes > 0 { format!(", {} of {} samples are holes", self.holes, rows * columns) } else { String::new() };
        let mut text = format!(
            "{}: {rows} x {columns} samples, x from {:.3} to {:.3} m, y from {:.3} to {:.3} m, heights {low:.3} to {high:.3} m, steepest {:.0} \
             degrees{holes}\n\n",
            self.terrain.name,
            grid.low[0],
            grid.high[0],
            grid.low[1],
            grid.high[1],
            (steepest / cell).atan().to_degrees(),
        );
        // Samples per character; a character is twice as high as it is wide.
        let across = (columns as f64 / WIDTH).max(rows as f64 / (2. * HEIGHT)).max(0.5);
        let (lines, letters) = ((rows as f64 / (2. * across)).ceil() as usize, (columns as f64 / across).ceil() as usize);
        let place = |number: usize, of: usize, step: f64, last: usize| (((of - 1 - number) as f64 * step) as usize).min(last);
        for line in 0..lines {
            let row = &grid.heights[place(line, lines, 2. * across, rows - 1)];
            let letter = |letter: usize| match row[place(letter, letters, across, columns - 1)] {
                h if is_hole(h) => ' ',
                h => SHADES[((h - low) / (high - low).max(1e-9) * (SHADES.len() - 1) as f64).round() as usize],
            };
            text.extend((0..letters).map(letter));
            text.push('\n');
        }
        text
    }
}

/// Characters of the picture, from low to high.
const SHADES: [char; 9] = ['.', ':', '-', '=', '+', '*', '#', '%', '@'];
/// Largest number of characters per line.
const WIDTH: f64 = 64.;
/// Largest number of lines.
const HEIGHT: f64 = 24.;

#[cfg(test)]
mod tests {
    use super::*;
    use rand::{Rng, RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    fn placement() -> Placement {
        Placement { cell: 0.5, origin: [-1., 0.25], height_scale: 1., friction: 0.7 }
    }

    fn import(name: &str, bytes: &[u8]) -> Result<Imported> {
        terrain_of(Path::new(name), bytes, &placement(), None)
    }

    fn grid(imported: &Imported) -> &Grid {
        let Shape::Grid(grid) = &imported.terrain.shape else { unreachable!() };
        grid
    }

    /// Encodes data as numpy does.
    fn npy(kind: &str, by_columns: bool, shape: &str, data: &[u8]) -> Vec<u8> {
        let order = if by_columns { "True" } else { "False" };
        let mut header = format!("{{'descr': '{kind}', 'fortran_order': {order}, 'shape': {shape}, }}");
        header += &" ".repeat(63 - (10 + header.len()) % 64);
        header.push('\n');
        [b"\x93NUMPY\x01\x00", &(header.len() as u16).to_le_bytes()[..], header.as_bytes(), data].concat()
    }

    fn png(color: png::ColorType, depth: png::BitDepth, size: [u32; 2], data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = png::Encoder::new(&mut bytes, size[0], size[1]);
        encoder.set_color(color);
        encoder.set_depth(depth);
        encoder.write_header().unwrap().write_image_data(data).unwrap();
        bytes
    }

    const CSV: &[u8] = b"0, 0.1, 0.2\n0.3,,0.5\n";

    fn floats() -> Vec<u8> {
        [0., 0.1, 0.2, 0.3, f64::NAN, 0.5].iter().flat_map(|v: &f64| v.to_le_bytes()).collect()
    }

    #[test]
    fn every_format_gives_the_same_heights() {
        let csv = import("hill.csv", CSV).unwrap();
        let expected = [vec![0., 0.1, 0.2], vec![0.3, -2., 0.5]];
        assert_eq!((grid(&csv).heights.as_slice(), csv.holes, &csv.terrain.name[..]), (&expected[..], 1, "hill"));
        assert_eq!((grid(&csv).low, grid(&csv).high, csv.terrain.friction), ([-1., 0.25], [0., 1.75], 0.7));
        assert_eq!(import("stairs.csv", CSV).unwrap().terrain.name, "stairs-imported");
        // The sample of row 1 and column 2 is at its expected position.
        assert!((csv.terrain.height(-0.5, 1.25) - 0.5).abs() < 1e-12);
        assert_eq!(import("hill.npy", &npy("<f8", false, "(2, 3)", &floats())).unwrap(), csv);
        let by_columns: Vec<u8> = [0., 0.3, 0.1, f64::NAN, 0.2, 0.5].iter().flat_map(|v: &f64| v.to_be_bytes()).collect();
        assert_eq!(import("hill.npy", &npy(">f8", true, "(2, 3)", &by_columns)).unwrap(), csv);
        let heading = b"\xef\xbb\xbfa;b;c\r\n0;0.1;0.2\r\n0.3;nan;0.5\r\n";
        assert_eq!(import("hill.csv", heading).unwrap(), csv);
        let about = csv.about();
        assert!(about.contains("2 x 3 samples") && about.contains("1 of 6 samples are holes"), "{about}");
        // Seen from above, x up and y to the left: the hole is in the upper line.
        let picture: Vec<&str> = about.lines().skip(2).collect();
        assert_eq!(picture, ["@@  **", "==--.."].map(|line| line.to_string()), "{about}");
    }

    #[test]
    fn images_have_x_to_the_right_and_y_up() {
        // Three pixels wide, two high; the upper row comes first.
        let grey = png(png::ColorType::Grayscale, png::BitDepth::Eight, [3, 2], &[0, 51, 102, 153, 204, 255]);
        let wide: Vec<u8> = [0u16, 13107, 26214, 39321, 52428, 65535].iter().flat_map(|v| v.to_be_bytes()).collect();
        let sixteen = png(png::ColorType::Grayscale, png::BitDepth::Sixteen, [3, 2], &wide);
        for bytes in [grey, sixteen] {
            let heights = grid(&import("a.png", &bytes).unwrap()).heights.clone();
            let expected = [[0.6, 0.], [0.8, 0.2], [1., 0.4]];
            assert!(heights.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9), "{heights:?}");
        }
        let clear = png(png::ColorType::GrayscaleAlpha, png::BitDepth::Eight, [2, 2], &[10, 255, 20, 0, 30, 255, 40, 255]);
        assert_eq!(import("a.png", &clear).unwrap().holes, 1);
    }

    #[test]
    fn errors_in_height_maps_name_their_place() {
        let rgb = png(png::ColorType::Rgb, png::BitDepth::Eight, [2, 2], &[0; 12]);
        let complex = npy("<c16", false, "(2, 2)", &[0; 64]);
        let cases: [(&str, &[u8], &str); 13] = [
            ("a.csv", b"0,1\n2\n", "line 2: 1 columns, but it must be 2 as in the first"),
            ("a.csv", b"0,1\n2,x7\n", "line 2, column 2: `x7`"),
            ("a.csv", b"0,1\n\n\n2,x7\n", "line 4, column 2: `x7`"),
            ("a.csv", b"0,1\n", "1 x 2 samples"),
            ("a.csv", b"", "0 x 0 samples"),
            ("a.csv", b",\n,\n", "only holes"),
            ("a.csv", b"0,1\n2,300\n", "terrain.grid.heights[1][1]: 300"),
            ("a.npy", b"what", "not an NPY file"),
            ("a.npy", &npy("<f8", false, "(4,)", &[0; 32]), "1 dimensions"),
            ("a.npy", &npy("<f8", false, "(4000000000, 4000000000)", &[0; 32]), "4000000000 x"),
            ("a.npy", &complex, "numbers of type"),
            ("a.png", &rgb, "Rgb"),
            ("a.tif", b"", "a.tif"),
        ];
        for (name, bytes, part) in cases {
            let error = import(name, bytes).unwrap_err().to_string();
            assert!(error.contains(part), "{name}: {error}");
        }
        assert!(import("a.npy", &npy("<f8", false, "(2, 3)", &floats()[..20])).is_err());
        let flat = Placement { cell: 0., ..placement() };
        assert!(terrain_of(Path::new("a.csv"), CSV, &flat, None).unwrap_err().to_string().starts_with("--cell"));
    }

    #[test]
    fn mutated_files_are_read_or_refused() {
        let png = png(png::ColorType::Grayscale, png::BitDepth::Eight, [16, 16], &[7; 256]);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for (name, file) in [("a.csv", CSV.to_vec()), ("a.npy", npy("<f8", false, "(2, 3)", &floats())), ("a.png", png)] {
            for _ in 0..2000 {
                let mut bytes = file.clone();
                for _ in 0..rng.random_range(1..4) {
                    let at = rng.random_range(0..bytes.len());
                    match rng.random_range(0..4) {
                        0 => bytes[at] = rng.next_u32() as u8,
                        1 => bytes[at] ^= 1 << rng.random_range(0..8),
                        2 => bytes.truncate(at.max(1)),
                        _ => bytes.insert(at, b"0123456789,(\n"[rng.random_range(0..13)]),
                    }
                }
                if let Ok(imported) = import(name, &bytes) {
                    imported.terrain.validate().unwrap();
                    assert!(!imported.about().is_empty());
                }
            }
        }
    }
}

//! Maps and meshes as terrains: CSV, NPY (numpy), greyscale PNG, OBJ, PLY and `grid_map` in MCAP. One file per format; `FORMATS` lists
//! them.
//!
//! | format | heights | position |
//! |---|---|---|
//! | CSV, NPY | m, `z[i][j]` at `x = origin[0] + i cell`, `y = origin[1] + j cell` | given |
//! | PNG | map seen from above, x to the right and y up; its lower left pixel is at the origin | given |
//! | OBJ, PLY | m, z up; the highest surface above each sample | of the mesh |
//! | MCAP | layer of a `grid_map_msgs/msg/GridMap`, m | of the message |
//!
//! NaN and infinite heights, transparent pixels of an image, and samples without a surface mark ground that cannot carry a foot: a pit,
//! [`HOLE`] deeper than the lowest height.

mod csv;
#[cfg(feature = "mcap")]
mod grid_map;
mod mesh;
mod npy;
mod obj;
mod ply;
mod png;

use super::{Grid, Shape, Terrain};
use crate::error::{Error, Result, check_range};
use crate::files;
use serde::Deserialize;
use std::path::Path;

/// Depth of holes below the lowest height, m.
pub const HOLE: f64 = 2.;

/// Friction coefficient of an imported terrain by default.
pub const FRICTION: f64 = 0.8;

/// Largest number of samples along an axis.
const MOST: usize = 4096;

/// Reader of a format.
type Read = fn(&[u8], &Placement) -> Result<Map>;

/// File formats, by the extension of the file.
const FORMATS: [(&str, Read); 6] =
    [("csv", csv::map), ("npy", npy::map), ("png", png::map), ("obj", obj::map), ("ply", ply::map), ("mcap", GRID_MAP)];

#[cfg(feature = "mcap")]
const GRID_MAP: Read = grid_map::map;
#[cfg(not(feature = "mcap"))]
const GRID_MAP: Read = |_, _| Err(Error::Missing { message: "this program was built without the feature `mcap`".into() });

/// Heights of a file.
struct Map {
    /// Heights, m, `[rows along x][columns along y]`. NaN and infinite heights are holes.
    heights: Vec<Vec<f64>>,
    /// Position of the first sample (x, y) and distance between samples, m; `None` if the file does not state them.
    place: Option<([f64; 2], f64)>,
    /// Origin of the numbers that the user did not give, as a clause; may be empty.
    note: String,
}

impl Map {
    fn unplaced(heights: Vec<Vec<f64>>) -> Map {
        Map { heights, place: None, note: String::new() }
    }
}

/// Parameters of an import.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Placement {
    /// Distance between samples, m. `None`: that of a grid map, or one chosen for a mesh; other formats need it.
    pub cell: Option<f64>,
    /// Position of the first sample (x, y), which has the smallest x and y, m. `None`: that of the mesh or the grid map; otherwise (0, 0).
    pub origin: Option<[f64; 2]>,
    /// Factor on heights; for an image the height of white, m.
    pub height_scale: f64,
    /// Friction coefficient.
    pub friction: f64,
    /// Layer of a grid map. `None`: `elevation`.
    pub layer: Option<String>,
    /// Topic of a grid map. `None`: the only one in the file.
    pub topic: Option<String>,
}

impl Default for Placement {
    fn default() -> Placement {
        Placement { cell: None, origin: None, height_scale: 1., friction: FRICTION, layer: None, topic: None }
    }
}

impl Placement {
    fn validate(&self) -> Result<()> {
        self.cell.map_or(Ok(()), |cell| check_range("--cell", cell, 1e-3, 100.))?;
        for value in self.origin.iter().flatten() {
            check_range("--origin", *value, -1000., 1000.)?;
        }
        check_range("--height-scale", self.height_scale, -1000., 1000.)?;
        check_range("--friction", self.friction, 1e-3, 100.)
    }
}

/// Imported terrain.
#[derive(Debug, Clone, PartialEq)]
pub struct Imported {
    /// Imported terrain.
    pub terrain: Terrain,
    /// Number of samples that are holes. Holes are the lowest samples.
    pub holes: usize,
    /// Origin of the numbers that were not given, such as the cell size of a mesh, as a clause; may be empty.
    pub note: String,
}

/// Extension of a file in lower case.
fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_lowercase()).unwrap_or_default()
}

/// True if the name of a file has the extension of a map or a mesh.
pub fn is_map(path: &Path) -> bool {
    FORMATS.iter().any(|(known, _)| extension(path) == *known)
}

/// Reads a terrain from a map or a mesh. See [`terrain_of`].
///
/// # Errors
/// [`Error::Io`], and [`Error::InFile`] with the error of [`terrain_of`]. An invalid parameter is an error outside the file.
pub fn read(path: &Path, placement: &Placement, name: Option<&str>) -> Result<Imported> {
    placement.validate()?;
    let bytes = files::read_bytes(path, files::MAX_FILE)?;
    terrain_of(path, &bytes, placement, name).map_err(|e| e.in_file(path, None))
}

/// Creates a terrain from the bytes of a map or a mesh. The extension of its path selects the format.
///
/// * `name` - name of the terrain; by default the stem of the file name, with `-imported` appended if a built-in terrain of that name has
///   another shape
///
/// # Errors
/// [`Error::Invalid`] or [`Error::Format`] for an unknown format, a malformed file, rows of different length, heights outside the limits of
/// a [`Grid`], an invalid name, or a parameter that the format needs or does not have.
pub fn terrain_of(path: &Path, bytes: &[u8], placement: &Placement, name: Option<&str>) -> Result<Imported> {
    placement.validate()?;
    let extension = extension(path);
    let Some((_, read)) = FORMATS.iter().find(|(known, _)| *known == extension) else {
        let known = FORMATS.map(|(known, _)| format!(".{known}")).join(", ");
        return Err(Error::invalid("file name", path.display(), format!("one that ends in {known}")));
    };
    for (option, given) in [("--layer", &placement.layer), ("--topic", &placement.topic)] {
        if let (Some(given), true) = (given, extension != "mcap") {
            return Err(Error::invalid(
                option,
                format!("`{}`", given.escape_debug()),
                "left out: only grid maps (.mcap) have layers and topics",
            ));
        }
    }
    let of_file = || path.file_stem().map(|stem| stem.to_string_lossy().chars().take(64).collect()).unwrap_or_default();
    let mut imported = of_map(name.map_or_else(of_file, str::to_owned), read(bytes, placement)?, placement)?;
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
/// [`Error::Invalid`] for rows of different length, heights outside the limits of a [`Grid`], or a missing `cell`.
pub fn terrain_of_heights(name: String, heights: Vec<Vec<f64>>, placement: &Placement) -> Result<Imported> {
    placement.validate()?;
    of_map(name, Map::unplaced(heights), placement)
}

fn of_map(name: String, map: Map, placement: &Placement) -> Result<Imported> {
    let Map { heights, place, note } = map;
    let holes = heights.iter().flatten().filter(|h| !h.is_finite()).count();
    let (origin, cell) = match (place, placement.cell) {
        (Some(place), _) => place,
        (None, Some(cell)) => ([0.; 2], cell),
        (None, None) => {
            let limit = "given to `terrain import`: the file does not state the distance between its samples";
            return Err(Error::invalid("--cell", "missing", limit));
        }
    };
    let grid = grid_of(heights, placement.origin.unwrap_or(origin), cell, placement.height_scale)?;
    let terrain = Terrain { name, friction: placement.friction, shape: Shape::Grid(grid) };
    terrain.validate()?;
    Ok(Imported { terrain, holes, note })
}

/// Creates the grid of the given heights; NaN and infinite heights become holes.
fn grid_of(mut heights: Vec<Vec<f64>>, low: [f64; 2], cell: f64, scale: f64) -> Result<Grid> {
    let (rows, columns) = (heights.len(), heights.first().map_or(0, Vec::len));
    if rows < 2 || columns < 2 || rows > MOST || columns > MOST {
        return Err(Error::invalid("height map", format!("{rows} x {columns} samples"), format!("2 x 2 to {MOST} x {MOST}")));
    }
    heights.iter_mut().flatten().for_each(|h| *h *= scale);
    let lowest = heights.iter().flatten().copied().filter(|h| h.is_finite()).fold(f64::INFINITY, f64::min);
    if lowest == f64::INFINITY {
        return Err(Error::invalid("height map", "only holes", "at least one height"));
    }
    heights.iter_mut().flatten().filter(|h| !h.is_finite()).for_each(|h| *h = lowest - HOLE);
    Ok(Grid { low, high: [low[0] + rows as f64 * cell, low[1] + columns as f64 * cell], heights })
}

impl Imported {
    /// Size, position, heights, steepest slope, holes and origin of the numbers that were not given, in one line.
    pub fn summary(&self) -> String {
        let Shape::Grid(grid) = &self.terrain.shape else { return String::new() };
        let (rows, columns) = (grid.heights.len(), grid.heights[0].len());
        let Solid { low, high } = self.solid(grid);
        let rise = |a: f64, b: f64| if a < low || b < low { 0. } else { (a - b).abs() };
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
        let note = if self.note.is_empty() { String::new() } else { format!("; {}", self.note) };
        format!(
            "{}: {rows} x {columns} samples every {cell:.4} m, x from {:.3} to {:.3} m, y from {:.3} to {:.3} m, heights {low:.3} to {high:.3} m, \
             steepest {:.0} degrees{holes}{note}",
            self.terrain.name,
            grid.low[0],
            grid.high[0],
            grid.low[1],
            grid.high[1],
            (steepest / cell).atan().to_degrees(),
        )
    }

    /// [`Imported::summary`], and a text picture, seen from above with x up and y to the left, as the robot sees the ground ahead. Denser
    /// characters are higher; holes are blank.
    pub fn about(&self) -> String {
        let Shape::Grid(grid) = &self.terrain.shape else { return String::new() };
        let (rows, columns) = (grid.heights.len(), grid.heights[0].len());
        let Solid { low, high } = self.solid(grid);
        let mut text = self.summary() + "\n\n";
        // Samples per character; a character is twice as high as it is wide.
        let across = (columns as f64 / WIDTH).max(rows as f64 / (2. * HEIGHT)).max(0.5);
        let (lines, letters) = ((rows as f64 / (2. * across)).ceil() as usize, (columns as f64 / across).ceil() as usize);
        let place = |number: usize, of: usize, step: f64, last: usize| (((of - 1 - number) as f64 * step) as usize).min(last);
        for line in 0..lines {
            let row = &grid.heights[place(line, lines, 2. * across, rows - 1)];
            let letter = |letter: usize| match row[place(letter, letters, across, columns - 1)] {
                h if h < low => ' ',
                h => SHADES[((h - low) / (high - low).max(1e-9) * (SHADES.len() - 1) as f64).round() as usize],
            };
            text.extend((0..letters).map(letter));
            text.push('\n');
        }
        text
    }

    /// Lowest and highest height apart from holes.
    fn solid(&self, grid: &Grid) -> Solid {
        let lowest = grid.heights.iter().flatten().copied().fold(f64::INFINITY, f64::min);
        let solid = || grid.heights.iter().flatten().copied().filter(|&h| self.holes == 0 || h != lowest);
        Solid { low: solid().fold(f64::INFINITY, f64::min), high: solid().fold(f64::NEG_INFINITY, f64::max) }
    }
}

/// Range of heights, m.
struct Solid {
    low: f64,
    high: f64,
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
        Placement { cell: Some(0.5), origin: Some([-1., 0.25]), friction: 0.7, ..Placement::default() }
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

    fn png(color: ::png::ColorType, depth: ::png::BitDepth, size: [u32; 2], data: &[u8]) -> Vec<u8> {
        let mut bytes = Vec::new();
        let mut encoder = ::png::Encoder::new(&mut bytes, size[0], size[1]);
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
        let grey = png(::png::ColorType::Grayscale, ::png::BitDepth::Eight, [3, 2], &[0, 51, 102, 153, 204, 255]);
        let wide: Vec<u8> = [0u16, 13107, 26214, 39321, 52428, 65535].iter().flat_map(|v| v.to_be_bytes()).collect();
        let sixteen = png(::png::ColorType::Grayscale, ::png::BitDepth::Sixteen, [3, 2], &wide);
        for bytes in [grey, sixteen] {
            let heights = grid(&import("a.png", &bytes).unwrap()).heights.clone();
            let expected = [[0.6, 0.], [0.8, 0.2], [1., 0.4]];
            assert!(heights.iter().flatten().zip(expected.iter().flatten()).all(|(a, b)| (a - b).abs() < 1e-9), "{heights:?}");
        }
        let clear = png(::png::ColorType::GrayscaleAlpha, ::png::BitDepth::Eight, [2, 2], &[10, 255, 20, 0, 30, 255, 40, 255]);
        assert_eq!(import("a.png", &clear).unwrap().holes, 1);
    }

    #[test]
    fn errors_in_height_maps_name_their_place() {
        let rgb = png(::png::ColorType::Rgb, ::png::BitDepth::Eight, [2, 2], &[0; 12]);
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
        let flat = Placement { cell: Some(0.), ..placement() };
        assert!(terrain_of(Path::new("a.csv"), CSV, &flat, None).unwrap_err().to_string().starts_with("--cell"));
        let none = Placement::default();
        let error = terrain_of(Path::new("a.csv"), CSV, &none, None).unwrap_err().to_string();
        assert!(error.contains("--cell: missing"), "{error}");
        let layer = Placement { layer: Some("elevation".into()), ..placement() };
        let error = terrain_of(Path::new("a.csv"), CSV, &layer, None).unwrap_err().to_string();
        assert!(error.contains("--layer: `elevation`, but it must be left out"), "{error}");
    }

    #[test]
    fn mutated_files_are_read_or_refused() {
        let png = png(::png::ColorType::Grayscale, ::png::BitDepth::Eight, [16, 16], &[7; 256]);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let files = [
            ("a.csv", CSV.to_vec()),
            ("a.npy", npy("<f8", false, "(2, 3)", &floats())),
            ("a.png", png),
            ("a.obj", obj::tests::SLOPE.as_bytes().to_vec()),
            ("a.ply", ply::tests::TEXT.as_bytes().to_vec()),
            ("a.ply", ply::tests::binary(true)),
            #[cfg(feature = "mcap")]
            ("a.mcap", grid_map::tests::file(&[grid_map::tests::message()])),
        ];
        for (name, file) in files {
            // Grid maps state their cell.
            let placement = if name == "a.mcap" { Placement::default() } else { placement() };
            assert!(terrain_of(Path::new(name), &file, &placement, None).is_ok(), "{name}");
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
                if let Ok(imported) = terrain_of(Path::new(name), &bytes, &placement, None) {
                    imported.terrain.validate().unwrap();
                    assert!(!imported.about().is_empty());
                }
            }
        }
    }
}

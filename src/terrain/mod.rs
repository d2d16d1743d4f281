//! Terrain: height, slope and curvature at (x, y), generic over the scalar type so that kernels and checks share one definition.

pub mod grid;
#[cfg(feature = "import")]
pub mod import;
pub mod profile;
mod relief;

pub use grid::Grid;
pub use profile::Profile;

use crate::error::{Error, Result, check_name, check_range};
use crate::files;
use num_traits::Float;
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Names of the built-in terrains.
pub const TERRAINS: [&str; 8] = ["flat", "step", "block", "stairs", "gap", "slope", "chimney", "chimney-lr"];

/// Ground under one point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ground<T> {
    /// Height, m.
    pub height: T,
    /// Derivatives of the height with respect to x and y.
    pub slope: [T; 2],
    /// Derivatives of the slopes, `curvature[i][j] = d slope[i] / d (x, y)[j]`, 1/m.
    pub curvature: [[T; 2]; 2],
}

impl<T: Float> Ground<T> {
    /// Level ground at the given height.
    pub fn level(height: T) -> Self {
        Ground { height, slope: [T::zero(); 2], curvature: [[T::zero(); 2]; 2] }
    }
}

/// Shape of the ground.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(rename_all = "kebab-case")]
pub enum Shape {
    /// Level ground at height 0.
    Flat,
    /// One of the analytic profiles of \[3\].
    Profile(Profile),
    /// Grid of heights.
    Grid(Grid),
}

/// Terrain: its shape and its friction.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
#[serde(deny_unknown_fields)]
pub struct Terrain {
    /// Name, used in results.
    pub name: String,
    /// Friction coefficient, dimensionless.
    pub friction: f64,
    /// Height over (x, y).
    pub shape: Shape,
}

impl Terrain {
    /// Returns a built-in terrain with friction coefficient 1. `step` is the grid of \[4\], the others are those of \[3\].
    ///
    /// # Errors
    /// [`Error::Unknown`] for another name; it lists [`TERRAINS`].
    pub fn named(name: &str) -> Result<Terrain> {
        let shape = match name {
            "flat" => Shape::Flat,
            "step" => Shape::Grid(Grid::step()),
            "block" => Shape::Profile(Profile::Block),
            "stairs" => Shape::Profile(Profile::Stairs),
            "gap" => Shape::Profile(Profile::Gap),
            "slope" => Shape::Profile(Profile::Slope),
            "chimney" => Shape::Profile(Profile::Chimney),
            "chimney-lr" => Shape::Profile(Profile::ChimneyLr),
            _ => return Err(Error::Unknown { what: "terrain", name: name.into(), known: TERRAINS.join(", ") }),
        };
        Ok(Terrain { name: name.into(), friction: 1., shape })
    }

    /// Level ground at height 0 with friction coefficient 1.
    pub fn flat() -> Terrain {
        Terrain { name: "flat".into(), friction: 1., shape: Shape::Flat }
    }

    /// Reads a terrain from JSON text and validates it.
    ///
    /// # Errors
    /// [`Error::Format`] for malformed JSON and for unknown or missing keys; [`Error::Invalid`] for impossible values.
    pub fn from_json(text: &str) -> Result<Terrain> {
        let terrain: Terrain = crate::error::from_json(text)?;
        terrain.validate_own()?;
        Ok(terrain)
    }

    /// Reads a terrain from a file and validates it. The extension selects the format: TOML, a map or mesh that states its cell and position
    /// ([`import`]), or else JSON.
    ///
    /// # Errors
    /// [`Error::Io`], or [`Error::InFile`] with the error of [`Terrain::from_json`] or [`import::terrain_of`].
    pub fn read(path: &Path) -> Result<Terrain> {
        #[cfg(feature = "import")]
        if import::is_map(path) {
            let imported = import::read(path, &import::Placement::default(), None)?;
            tracing::info!("{}", imported.summary());
            return Ok(imported.terrain);
        }
        let terrain: Terrain = files::read_value(path)?;
        terrain.validate_own().map_err(|e| e.in_file(path, None))?;
        Ok(terrain)
    }

    /// Text of a terrain file in the format that [`Terrain::read`] expects for this path.
    ///
    /// # Errors
    /// [`Error::Format`] for a value that TOML cannot represent.
    pub fn file_text(&self, path: &Path) -> Result<String> {
        if files::is_toml(path) { crate::error::to_toml(self) } else { Ok(serde_json::to_string(self)? + "\n") }
    }

    /// Checks friction and, for a grid, its sizes and heights.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first field that is out of its limits.
    pub fn validate(&self) -> Result<()> {
        check_name("terrain.name", &self.name)?;
        check_range("terrain.friction", self.friction, 1e-3, 100.)?;
        match &self.shape {
            Shape::Grid(grid) => grid.validate(),
            _ => Ok(()),
        }
    }

    /// Validates a terrain that is not built in: [`Terrain::validate`], and if its name is that of a built-in terrain, its shape must be
    /// the same. Motions on another shape of that name would be refused.
    ///
    /// # Errors
    /// The errors of [`Terrain::validate`], and [`Error::Invalid`] if a built-in terrain of this name has another shape.
    pub fn validate_own(&self) -> Result<()> {
        self.validate()?;
        if !self.differs_from_named() {
            return Ok(());
        }
        let limit = "a different name: the built-in terrain of this name has another shape";
        Err(Error::invalid("terrain.name", format!("`{}`", self.name), limit))
    }

    /// True if a built-in terrain of the same name has another shape.
    pub(crate) fn differs_from_named(&self) -> bool {
        Terrain::named(&self.name).is_ok_and(|named| named.shape != self.shape)
    }

    /// Height, slope and curvature at (x, y), m. Outside a grid the values at its edge continue.
    pub fn ground<T: Float>(&self, x: T, y: T) -> Ground<T> {
        match &self.shape {
            Shape::Flat => Ground::level(T::zero()),
            Shape::Profile(profile) => profile.ground(x, y),
            Shape::Grid(grid) => grid.ground(x, y),
        }
    }

    /// Ground at (x, y) with the surface direction averaged along each axis from `-radius` to `radius`, m.
    ///
    /// At an edge of a grid the normal jumps, and with it the friction pyramid, so that no small step crosses the edge. The average,
    /// `(h(x + r) - h(x - r)) / 2r`, varies continuously. The height remains exact. Radius 0 gives [`Terrain::ground`].
    pub fn rounded_ground<T: Float>(&self, x: T, y: T, radius: T) -> Ground<T> {
        let exact = self.ground(x, y);
        // Stairs are level everywhere except at their risers, so there is nothing to average.
        if radius == T::zero() || matches!(self.shape, Shape::Flat | Shape::Profile(Profile::Stairs)) {
            return exact;
        }
        let width = radius + radius;
        let [east, west] = [x + radius, x - radius].map(|x| self.ground(x, y));
        let [north, south] = [y + radius, y - radius].map(|y| self.ground(x, y));
        Ground {
            height: exact.height,
            slope: [(east.height - west.height) / width, (north.height - south.height) / width],
            curvature: [
                [(east.slope[0] - west.slope[0]) / width, (east.slope[1] - west.slope[1]) / width],
                [(north.slope[0] - south.slope[0]) / width, (north.slope[1] - south.slope[1]) / width],
            ],
        }
    }

    /// True if the direction of the surface may jump somewhere.
    pub fn has_edges(&self) -> bool {
        self.shape != Shape::Flat
    }

    /// Height at (x, y), m.
    pub fn height(&self, x: f64, y: f64) -> f64 {
        self.ground(x, y).height
    }

    /// True if all ground between two corners (x, y), m, is known to be one plane. Outside a grid nothing is known.
    pub fn is_plane(&self, low: [f64; 2], high: [f64; 2]) -> bool {
        match &self.shape {
            Shape::Flat => true,
            Shape::Profile(profile) => profile.is_plane(low[0], high[0]),
            Shape::Grid(grid) => grid.is_plane(low, high),
        }
    }

    /// Checks that a point lies on the terrain.
    ///
    /// # Errors
    /// [`Error::Invalid`] with the limits of the grid.
    pub fn check_inside(&self, place: &str, x: f64, y: f64) -> Result<()> {
        let (low, high) = match &self.shape {
            Shape::Grid(grid) => (grid.low, grid.high),
            _ => ([-1000.; 2], [1000.; 2]),
        };
        if x >= low[0] && x <= high[0] && y >= low[1] && y <= high[1] {
            return Ok(());
        }
        let limit = format!("on the terrain `{}`: x from {} to {}, y from {} to {} m", self.name, low[0], high[0], low[1], high[1]);
        Err(Error::invalid(place, format!("({x}, {y})"), limit))
    }
}

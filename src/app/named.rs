//! Robots and terrains by name or file.

use crate::error::{Error, Result};
use crate::robot::{ROBOTS, Robot};
use crate::terrain::{TERRAINS, Terrain};
use std::path::Path;
use std::sync::Arc;

/// Robot by the name of a built-in one, or from a JSON or TOML file.
///
/// # Errors
/// [`Error::Unknown`] for an unknown name; errors of [`Robot::read`] for a file.
pub fn robot(name: &str) -> Result<Arc<Robot>> {
    named_or_file(name, &ROBOTS, ["robot", ".json or .toml"], Robot::named, Robot::read).map(Arc::new)
}

/// Terrain by the name of a built-in one, or from a file: see [`Terrain::read`].
///
/// # Errors
/// [`Error::Unknown`] for an unknown name; errors of [`Terrain::read`] for a file.
pub fn terrain(name: &str) -> Result<Arc<Terrain>> {
    named_or_file(name, &TERRAINS, ["terrain", ".json, .toml, .obj, .ply or .mcap"], Terrain::named, Terrain::read).map(Arc::new)
}

/// Built-in names take precedence over files of the same name.
///
/// * `what`, `extensions` - kind of thing, and the extensions of its files
fn named_or_file<T>(
    name: &str,
    known: &[&str],
    [what, extensions]: [&'static str; 2],
    named: impl Fn(&str) -> Result<T>,
    read: impl Fn(&Path) -> Result<T>,
) -> Result<T> {
    let path = Path::new(name);
    if known.contains(&name) {
        named(name)
    } else if path.exists() || path.extension().is_some() || path.components().count() > 1 {
        read(path)
    } else {
        Err(Error::Unknown { what, name: name.into(), known: format!("{}, or a {extensions} file", known.join(", ")) })
    }
}

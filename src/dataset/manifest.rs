//! Manifest of a data set: the file `dataset.json`, which states what the data are and which shards are done.

use super::spec::{DatasetPlan, Spec};
use crate::error::{Error, Result, from_json, to_json};
use crate::files;
use crate::robot::Robot;
use crate::search::evaluate::LowerSettings;
use crate::terrain::Terrain;
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};
use std::path::{Path, PathBuf};

/// Name of the manifest in the folder of a data set.
pub const MANIFEST: &str = "dataset.json";
/// Number of this format.
pub const FORMAT: usize = 1;

/// Hash of a file and the name of the file relative to the folder of the data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct FileHash {
    /// Name, with `/` between folders.
    pub path: String,
    /// SHA-256, hexadecimal.
    pub sha256: String,
}

/// A finished shard.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Shard {
    /// Folder of its robot.
    pub robot: String,
    /// Number of the shard of its robot.
    pub number: usize,
    /// Number of draws.
    pub draws: usize,
    /// Draws that no leg can follow; not solved.
    pub impossible: usize,
    /// Draws that were solved without a certificate.
    pub infeasible: usize,
    /// Certified motions that joints do not attain, or that exceed their limits.
    pub beyond_joints: usize,
    /// Certified motions that are nearly those of an earlier draw.
    pub duplicates: usize,
    /// Motions of this shard.
    pub motions: usize,
    /// Files: frames, motions, gaits.
    pub files: [FileHash; 3],
}

/// Robot of a data set.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RobotEntry {
    /// Folder of its shards.
    pub folder: String,
    /// Number of motions asked for.
    pub count: usize,
    /// Description.
    pub robot: Robot,
}

/// Everything that the data depend on. A run continues a data set only if it is the same.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Origin {
    /// Number of the format.
    pub format: usize,
    /// Version of the program that made it.
    pub version: String,
    /// Licence of the data.
    pub licence: String,
    /// Device and precision of the solves.
    pub device: String,
    /// Specification, with files named by their content.
    pub spec: Spec,
    /// Settings of the lower level.
    pub settings: LowerSettings,
    /// Robots.
    pub robots: Vec<RobotEntry>,
    /// Grounds.
    pub grounds: Vec<Terrain>,
}

/// Content of [`MANIFEST`].
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Manifest {
    /// Everything that the data depend on.
    pub origin: Origin,
    /// True if all motions are there, or all draws have been tried.
    pub complete: bool,
    /// Finished shards, in the order in which they were made.
    pub shards: Vec<Shard>,
}

impl Origin {
    /// Origin of the data of a plan.
    pub fn new(plan: &DatasetPlan, device: String) -> Origin {
        let entry = |subject: &super::spec::Subject| RobotEntry {
            folder: subject.folder.clone(),
            count: subject.count,
            robot: (*subject.robot).clone(),
        };
        Origin {
            format: FORMAT,
            version: env!("CARGO_PKG_VERSION").into(),
            licence: plan.spec.licence.clone(),
            device,
            spec: plan.spec.clone(),
            settings: plan.settings.clone(),
            robots: plan.subjects.iter().map(entry).collect(),
            grounds: plan.grounds.iter().map(|ground| (*ground.terrain).clone()).collect(),
        }
    }
}

impl Manifest {
    /// Reads the manifest of a folder; `None` without a manifest.
    ///
    /// # Errors
    /// [`Error::InFile`] for another file; [`Error::Io`] for one that cannot be read.
    pub fn read(folder: &Path) -> Result<Option<Manifest>> {
        let path = folder.join(MANIFEST);
        if !path.exists() {
            return Ok(None);
        }
        let manifest: Manifest = from_json(&files::read(&path)?).map_err(|e| e.in_file(&path, None))?;
        Ok(Some(manifest))
    }

    /// Checks that a folder without a manifest is empty, and that a manifest has the same origin as a new run.
    ///
    /// # Errors
    /// [`Error::Invalid`] names the first key that differs.
    pub fn check_origin(&self, origin: &Origin, folder: &Path) -> Result<()> {
        let [had, asked] = [serde_json::to_value(&self.origin)?, serde_json::to_value(origin)?];
        let Some((key, value)) = had.as_object().into_iter().flatten().find(|(key, value)| asked.get(key.as_str()) != Some(value)) else {
            return Ok(());
        };
        let short = |value: &serde_json::Value| {
            let text = value.to_string();
            if text.len() > 60 { "another one".into() } else { text }
        };
        let limit = format!("{}, that of the data in this folder, or the folder another one", short(value));
        Err(Error::invalid(key, asked.get(key.as_str()).map_or("absent".into(), short), limit).in_file(&folder.join(MANIFEST), None))
    }

    /// Writes the manifest.
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses.
    pub fn write(&self, folder: &Path) -> Result<()> {
        files::write(&folder.join(MANIFEST), &to_json(self)?)
    }

    /// Number of motions in finished shards.
    pub fn motions(&self) -> usize {
        self.shards.iter().map(|shard| shard.motions).sum()
    }

    /// Number of motions asked for.
    pub fn asked(&self) -> usize {
        self.origin.robots.iter().map(|robot| robot.count).sum()
    }
}

impl FileHash {
    /// Writes a file below the folder of a data set.
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses.
    pub fn write(folder: &Path, path: String, bytes: &[u8]) -> Result<FileHash> {
        let target = folder.join(&path);
        if let Some(parent) = target.parent() {
            let io = |source| Error::Io { action: "make the folder", path: parent.to_owned(), source };
            std::fs::create_dir_all(parent).map_err(io)?;
        }
        files::write_bytes(&target, bytes)?;
        Ok(FileHash { path, sha256: sha256(bytes) })
    }

    /// Path of the file. A name that leads out of the folder is refused.
    ///
    /// # Errors
    /// [`Error::Invalid`] for such a name.
    pub fn path(&self, folder: &Path) -> Result<PathBuf> {
        let inside = Path::new(&self.path).components().all(|part| matches!(part, std::path::Component::Normal(_)));
        if !inside {
            return Err(Error::invalid("path", self.path.escape_debug(), "a file below the folder").in_file(&folder.join(MANIFEST), None));
        }
        Ok(folder.join(&self.path))
    }

    /// Checks that the file is there and has this hash.
    ///
    /// # Errors
    /// [`Error::Io`] if it cannot be read; [`Error::Invalid`] for another content.
    pub fn check(&self, folder: &Path) -> Result<PathBuf> {
        let path = self.path(folder)?;
        let found = sha256(&files::read_bytes(&path, files::MAX_FILE)?);
        if found != self.sha256 {
            return Err(Error::invalid("sha256", found, format!("{}, as in {MANIFEST}", self.sha256)).in_file(&path, None));
        }
        Ok(path)
    }
}

/// SHA-256, hexadecimal.
fn sha256(bytes: &[u8]) -> String {
    Sha256::digest(bytes).iter().map(|byte| format!("{byte:02x}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hashes_are_those_of_the_standard() {
        assert_eq!(sha256(b"abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    }

    #[test]
    fn files_outside_the_folder_are_refused() {
        let file = |path: &str| FileHash { path: path.into(), sha256: String::new() };
        assert!(file("go1/frames/00000.parquet").path(Path::new("data")).is_ok());
        for path in ["../secret", "/etc/passwd", "a/../../b"] {
            assert!(file(path).path(Path::new("data")).unwrap_err().to_string().contains("a file below the folder"));
        }
    }
}

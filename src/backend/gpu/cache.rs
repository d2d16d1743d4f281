//! Cache of compiled pipelines and measurements of adapters, in a folder of the user's caches. The cache is optional: files that cannot be
//! read or are corrupt are recreated, and write errors are ignored.

use crate::backend::locked;
use crate::files;
use etcetera::BaseStrategy;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;
use std::sync::Mutex;
use tracing::debug;

/// Environment variable that names the cache folder. If it is empty, nothing is cached.
pub const VARIABLE: &str = "CREGOPT_CACHE";

/// Largest file that is read, bytes. The file keeps pipelines of earlier versions; one that has grown larger is started again.
const MOST: u64 = 64 << 20;

/// Folder of files that can be recreated at any time; `None` disables the cache.
#[derive(Debug, Clone, Default)]
pub struct Folder(Option<PathBuf>);

impl Folder {
    /// Folder that `CREGOPT_CACHE` names, or `cregopt` in the user's cache folder.
    pub fn of_user() -> Folder {
        match std::env::var_os(VARIABLE) {
            Some(named) if named.is_empty() => Folder::default(),
            Some(named) => Folder::at(named),
            None => Folder(etcetera::choose_base_strategy().ok().map(|user| user.cache_dir().join("cregopt"))),
        }
    }

    /// Folder at a path, which need not exist.
    pub fn at(path: impl Into<PathBuf>) -> Folder {
        Folder(Some(path.into()))
    }

    /// Content of a file; `None` if it cannot be read.
    pub(super) fn read(&self, name: &str) -> Option<Vec<u8>> {
        let path = self.0.as_ref()?.join(name);
        let bytes = path.is_file().then(|| files::read_bytes(&path, MOST))?;
        bytes.inspect_err(|e| debug!("cache file not used: {e}")).ok()
    }

    /// Writes a whole file, or leaves the old one unchanged.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) {
        let Some(folder) = &self.0 else { return };
        let made = std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()));
        let written = made.and_then(|()| files::write_bytes(&folder.join(name), bytes).map_err(|e| e.to_string()));
        if let Err(why) = written {
            debug!("not cached: {why}");
        }
    }
}

/// Compiled pipelines of one adapter and driver. Only Vulkan makes them available.
#[derive(Debug)]
pub struct Pipelines {
    folder: Folder,
    name: String,
    cache: wgpu::PipelineCache,
    /// Checksum of the file's content.
    written: Mutex<u64>,
}

/// Checksum that detects incomplete files. Another version of the standard library may compute another one: then the file is recreated.
fn sum(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    bytes.hash(&mut hasher);
    hasher.finish()
}

/// Bytes preceded by their checksum.
fn sealed(bytes: &[u8]) -> Vec<u8> {
    [&sum(bytes).to_le_bytes(), bytes].concat()
}

/// Bytes that [`sealed`] protected; `None` if the checksum differs.
fn unsealed(bytes: &[u8]) -> Option<&[u8]> {
    let (first, rest) = bytes.split_first_chunk()?;
    (u64::from_le_bytes(*first) == sum(rest)).then_some(rest)
}

impl Pipelines {
    /// Opens the cache of an adapter; `None` if its pipelines cannot be cached.
    ///
    /// * `device` - device of the adapter, with [`wgpu::Features::PIPELINE_CACHE`] if the adapter offers it
    pub fn open(folder: Folder, device: &wgpu::Device, adapter: &wgpu::AdapterInfo) -> Option<Pipelines> {
        folder.0.as_ref()?;
        if !device.features().contains(wgpu::Features::PIPELINE_CACHE) {
            return None;
        }
        let name = wgpu::util::pipeline_cache_key(adapter)?;
        let file = folder.read(&name);
        let data = file.as_deref().and_then(unsealed);
        if file.is_some() && data.is_none() {
            debug!("pipeline cache {name} is corrupt and is not used");
        }
        let made = |data| {
            let refused = device.push_error_scope(wgpu::ErrorFilter::Validation);
            let descriptor = wgpu::PipelineCacheDescriptor { label: Some("cregopt"), data, fallback: true };
            // SAFETY: the data has the checksum that `save` wrote with it, in a folder of the user, and came from `get_data` on an adapter
            // with this key.
            let cache = unsafe { device.create_pipeline_cache(&descriptor) };
            match pollster::block_on(refused.pop()) {
                None => Some(cache),
                Some(why) => {
                    debug!("pipeline cache {name} was refused: {why}");
                    None
                }
            }
        };
        // Data of another adapter is refused, regardless of `fallback`.
        let cache = made(data).or_else(|| made(None))?;
        let written = Mutex::new(data.map_or(0, sum));
        Some(Pipelines { folder, name, cache, written })
    }

    /// Cache for the creation of pipelines.
    pub fn cache(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    /// Writes the compiled pipelines, if they differ from the file.
    pub fn save(&self) {
        let Some(data) = self.cache.get_data() else { return };
        let mut written = locked(&self.written);
        if std::mem::replace(&mut *written, sum(&data)) != sum(&data) {
            self.folder.write(&self.name, &sealed(&data));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_complete_unchanged_bytes_are_unsealed() {
        let bytes = sealed(b"pipelines");
        assert_eq!(unsealed(&bytes), Some(&b"pipelines"[..]));
        assert_eq!(unsealed(&sealed(b"")), Some(&b""[..]));
        for at in 0..bytes.len() {
            assert_eq!(unsealed(&bytes[..at]), None, "cut off at {at}");
            let mut other = bytes.clone();
            other[at] ^= 1;
            assert_eq!(unsealed(&other), None, "byte {at} changed");
        }
        assert_eq!(unsealed(&[bytes, vec![0]].concat()), None);
    }

    #[test]
    fn a_folder_that_cannot_exist_is_not_an_error() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "").unwrap();
        for none in [Folder::default(), Folder::at(file.join("below a file"))] {
            none.write("name", b"bytes");
            assert_eq!(none.read("name"), None);
        }
        let some = Folder::at(folder.path().join("new").join("folder"));
        assert_eq!(some.read("name"), None);
        some.write("name", b"bytes");
        some.write("name", b"others");
        assert_eq!(some.read("name"), Some(b"others".to_vec()));
    }
}

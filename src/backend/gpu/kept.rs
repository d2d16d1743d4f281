//! What is kept of adapters between runs, pipelines and measurements, in a folder of the user's caches. Nothing there is needed: what cannot be read, or is not what
//! it should be, is made anew, and what cannot be written is left.

use crate::backend::locked;
use crate::files;
use etcetera::BaseStrategy;
use std::hash::{DefaultHasher, Hash, Hasher};
use std::path::PathBuf;
use std::sync::Mutex;
use tracing::debug;

/// The environment variable that names the folder; where it is empty nothing is kept.
pub const VARIABLE: &str = "CREGOPT_CACHE";

/// Largest file that is read, bytes. Pipelines of earlier versions stay in theirs; what has grown larger begins anew.
const MOST: u64 = 64 << 20;

/// A folder of files that can be made again at any time, or none.
#[derive(Debug, Clone, Default)]
pub struct Folder(Option<PathBuf>);

impl Folder {
    /// The one that `CREGOPT_CACHE` names, else `cregopt` among the user's caches.
    pub fn of_user() -> Folder {
        match std::env::var_os(VARIABLE) {
            Some(named) if named.is_empty() => Folder::default(),
            Some(named) => Folder::at(named),
            None => Folder(etcetera::choose_base_strategy().ok().map(|user| user.cache_dir().join("cregopt"))),
        }
    }

    /// A folder by its path, which need not exist.
    pub fn at(path: impl Into<PathBuf>) -> Folder {
        Folder(Some(path.into()))
    }

    /// What a file holds.
    pub(super) fn read(&self, name: &str) -> Option<Vec<u8>> {
        let path = self.0.as_ref()?.join(name);
        let bytes = path.is_file().then(|| files::read_bytes(&path, MOST))?;
        bytes.inspect_err(|e| debug!("made anew: {e}")).ok()
    }

    /// Writes a whole file or leaves it as it is.
    pub(super) fn write(&self, name: &str, bytes: &[u8]) {
        let Some(folder) = &self.0 else { return };
        let made = std::fs::create_dir_all(folder).map_err(|e| format!("{}: {e}", folder.display()));
        let written = made.and_then(|()| files::write_bytes(&folder.join(name), bytes).map_err(|e| e.to_string()));
        if let Err(why) = written {
            debug!("not kept: {why}");
        }
    }
}

/// Compiled pipelines of one adapter and driver, where the interface hands them out (Vulkan).
#[derive(Debug)]
pub struct Pipelines {
    folder: Folder,
    name: String,
    cache: wgpu::PipelineCache,
    /// The sum of what the file holds.
    written: Mutex<u64>,
}

/// Tells bytes that were written whole from others. Another version of the standard library may sum otherwise: then they are made anew.
fn sum(bytes: &[u8]) -> u64 {
    let mut hasher = DefaultHasher::new();
    bytes.hash(&mut hasher);
    hasher.finish()
}

/// Bytes behind their sum.
fn sealed(bytes: &[u8]) -> Vec<u8> {
    [&sum(bytes).to_le_bytes(), bytes].concat()
}

/// What was [`sealed`].
fn unsealed(bytes: &[u8]) -> Option<&[u8]> {
    let (first, rest) = bytes.split_first_chunk()?;
    (u64::from_le_bytes(*first) == sum(rest)).then_some(rest)
}

impl Pipelines {
    /// What is kept for an adapter; `None` where nothing can be.
    ///
    /// * `device` - a device of it, with [`wgpu::Features::PIPELINE_CACHE`] where the adapter offers that
    pub fn open(folder: Folder, device: &wgpu::Device, adapter: &wgpu::AdapterInfo) -> Option<Pipelines> {
        folder.0.as_ref()?;
        if !device.features().contains(wgpu::Features::PIPELINE_CACHE) {
            return None;
        }
        let name = wgpu::util::pipeline_cache_key(adapter)?;
        let file = folder.read(&name);
        let data = file.as_deref().and_then(unsealed);
        if file.is_some() && data.is_none() {
            debug!("made anew: {name} is not what was written");
        }
        let made = |data| {
            let refused = device.push_error_scope(wgpu::ErrorFilter::Validation);
            let descriptor = wgpu::PipelineCacheDescriptor { label: Some("cregopt"), data, fallback: true };
            // SAFETY: the data has the sum that `save` wrote with it, in a folder of the user's; it came from `get_data` on an adapter of this key.
            let cache = unsafe { device.create_pipeline_cache(&descriptor) };
            match pollster::block_on(refused.pop()) {
                None => Some(cache),
                Some(why) => {
                    debug!("pipelines in {name}: {why}");
                    None
                }
            }
        };
        // What is another adapter's is refused, whatever `fallback` says.
        let cache = made(data).or_else(|| made(None))?;
        let written = Mutex::new(data.map_or(0, sum));
        Some(Pipelines { folder, name, cache, written })
    }

    /// For the creation of pipelines.
    pub fn cache(&self) -> &wgpu::PipelineCache {
        &self.cache
    }

    /// Keeps what was compiled, if anything was that is not in the file.
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
    fn only_what_was_sealed_whole_is_unsealed() {
        let bytes = sealed(b"pipelines");
        assert_eq!(unsealed(&bytes), Some(&b"pipelines"[..]));
        assert_eq!(unsealed(&sealed(b"")), Some(&b""[..]));
        for at in 0..bytes.len() {
            assert_eq!(unsealed(&bytes[..at]), None, "cut off at {at}");
            let mut other = bytes.clone();
            other[at] ^= 1;
            assert_eq!(unsealed(&other), None, "another byte {at}");
        }
        assert_eq!(unsealed(&[bytes, vec![0]].concat()), None);
    }

    #[test]
    fn a_folder_that_cannot_be_is_no_error() {
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

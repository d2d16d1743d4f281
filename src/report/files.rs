//! Reading and writing files so that errors name the place and nothing is left half-written.

use crate::error::{Error, Result};
use std::fs;
use std::io::Write;
use std::path::Path;

/// Largest input file, bytes.
pub const MAX_FILE: u64 = 1 << 30;

/// Reads a text file.
///
/// # Errors
/// [`Error::Io`] when the system refuses, [`Error::Invalid`] when the file is larger than [`MAX_FILE`].
pub fn read(path: &Path) -> Result<String> {
    let io = |source| Error::Io { action: "read", path: path.to_owned(), source };
    let size = fs::metadata(path).map_err(io)?.len();
    if size > MAX_FILE {
        return Err(Error::invalid("file size", format!("{size} bytes"), format!("at most {MAX_FILE} bytes")).in_file(path, None));
    }
    fs::read_to_string(path).map_err(io)
}

/// Writes a whole file or nothing: to a neighbour first, then renamed over the target. A link is followed; a device or pipe is written
/// directly.
///
/// # Errors
/// [`Error::Io`] when the system refuses.
pub fn write(path: &Path, text: &str) -> Result<()> {
    let io = |source| Error::Io { action: "write", path: path.to_owned(), source };
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if fs::metadata(&target).is_ok_and(|m| !m.is_file()) {
        return fs::OpenOptions::new().write(true).open(&target).and_then(|mut f| f.write_all(text.as_bytes())).map_err(io);
    }
    let mut name = target.file_name().map(|n| n.to_owned()).unwrap_or_default();
    name.push(format!(".{}.part", std::process::id()));
    let part = target.with_file_name(name);
    let written = fs::File::create(&part).and_then(|mut f| f.write_all(text.as_bytes()).and_then(|()| f.sync_all()));
    written.and_then(|()| fs::rename(&part, &target)).map_err(|e| {
        // The part may not exist; the first error is the one to tell.
        let _ = fs::remove_file(&part);
        io(e)
    })
}

/// Makes a folder and checks that files can be written there, before any work is done.
///
/// # Errors
/// [`Error::Io`] when the system refuses.
pub fn make_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|source| Error::Io { action: "make the folder", path: path.to_owned(), source })?;
    check_writable(&path.join("result.json"))
}

/// Checks that a file can be made beside `path`, before any work is done. An existing file is not touched.
///
/// # Errors
/// [`Error::Io`] when the system refuses.
pub fn check_writable(path: &Path) -> Result<()> {
    let io = |source| Error::Io { action: "write", path: path.to_owned(), source };
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    match fs::metadata(&target) {
        Ok(m) if m.is_dir() => return Err(io(std::io::ErrorKind::IsADirectory.into())),
        Ok(m) if !m.is_file() => return Ok(()),
        _ => {}
    }
    let probe = target.with_file_name(format!(".cregopt-{}.probe", std::process::id()));
    fs::File::create(&probe).and_then(|_| fs::remove_file(&probe)).map_err(io)
}

/// Non-empty lines with their one-based numbers.
pub fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, line)| !line.trim().is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_failed_write_names_the_file_and_leaves_nothing() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("missing").join("result.json");
        assert!(write(&target, "{}").unwrap_err().to_string().contains("result.json"));
        let target = folder.path().join("result.json");
        write(&target, "{}").unwrap();
        assert_eq!(read(&target).unwrap(), "{}");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[cfg(unix)]
    #[test]
    fn a_link_stays_a_link_and_a_folder_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        write(&link, "new").unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(read(&real).unwrap(), "new");
        assert!(check_writable(folder.path()).is_err());
        check_writable(Path::new("/dev/null")).unwrap();
    }
}

//! Reading and writing of files. Errors name the file, and no file is left half-written.

use crate::error::{Error, Result};
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Largest input file, bytes.
pub const MAX_FILE: u64 = 1 << 30;

/// Path that represents standard input or standard output.
pub const STREAM: &str = "-";

/// Reads a text file and drops the byte order mark that some editors put first.
///
/// # Errors
/// [`Error::Io`] if the system refuses, [`Error::Invalid`] if the file is larger than [`MAX_FILE`], such as a device that never ends.
pub fn read(path: &Path) -> Result<String> {
    read_at_most(path, MAX_FILE)
}

/// Reads a text file of at most `limit` bytes, for files that are small if they are valid.
///
/// # Errors
/// See [`read`], with `limit` in place of [`MAX_FILE`].
pub fn read_at_most(path: &Path, limit: u64) -> Result<String> {
    let no_text =
        |_| Error::Io { action: "read", path: path.to_owned(), source: io::Error::new(io::ErrorKind::InvalidData, "not UTF-8 text") };
    let text = String::from_utf8(read_bytes(path, limit)?).map_err(no_text)?;
    Ok(text.strip_prefix('\u{feff}').map(String::from).unwrap_or(text))
}

/// True if the file name ends in `.toml`. All other files are JSON.
pub fn is_toml(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

/// Reads a value from a TOML file (name ends in `.toml`) or a JSON file (any other name).
///
/// # Errors
/// See [`read`]; [`Error::InFile`] if the text is not such a value.
pub fn read_value<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let text = read(path)?;
    let value = if is_toml(path) { crate::error::from_toml(&text) } else { crate::error::from_json(&text) };
    value.map_err(|e| e.in_file(path, None))
}

/// Reads a file of any kind of at most `limit` bytes; `-` is standard input.
///
/// # Errors
/// See [`read_at_most`].
pub fn read_bytes(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let io = |source| Error::Io { action: "read", path: path.to_owned(), source };
    let mut bytes = Vec::new();
    if path == Path::new(STREAM) {
        io::stdin().lock().take(limit + 1).read_to_end(&mut bytes).map_err(io)?;
    } else {
        fs::File::open(path).map_err(io)?.take(limit + 1).read_to_end(&mut bytes).map_err(io)?;
    }
    if bytes.len() as u64 > limit {
        return Err(Error::invalid("file size", "more", format!("at most {limit} bytes")).in_file(path, None));
    }
    Ok(bytes)
}

/// Writes a whole file or nothing: to a temporary neighbour first, which is then renamed over the target. A link is followed. A device, a
/// pipe and standard output (`-`) are written directly.
///
/// # Errors
/// [`Error::Io`] if the system refuses.
pub fn write(path: &Path, text: &str) -> Result<()> {
    write_bytes(path, text.as_bytes())
}

/// Writes bytes in the manner of [`write()`].
///
/// # Errors
/// See [`write()`].
pub fn write_bytes(path: &Path, bytes: &[u8]) -> Result<()> {
    let io = |source| Error::Io { action: "write", path: path.to_owned(), source };
    if path == Path::new(STREAM) {
        return stdout(bytes).map_err(io);
    }
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    if fs::metadata(&target).is_ok_and(|m| !m.is_file()) {
        return fs::OpenOptions::new().write(true).open(&target).and_then(|mut f| f.write_all(bytes)).map_err(io);
    }
    let mut name = target.file_name().map(|n| n.to_owned()).unwrap_or_default();
    name.push(format!(".{}.part", std::process::id()));
    let part = target.with_file_name(name);
    let written = fs::File::create_new(&part).and_then(|mut f| f.write_all(bytes).and_then(|()| f.sync_all()));
    written.and_then(|()| fs::rename(&part, &target)).map_err(|e| {
        // The part may not exist. The first error is the one to report.
        let _ = fs::remove_file(&part);
        io(e)
    })
}

/// Writes to standard output. A closed pipe (`| head`) is not an error.
///
/// # Errors
/// The system's error.
pub fn stdout(bytes: &[u8]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(e),
        _ => Ok(()),
    }
}

/// Creates a folder and checks that files can be written there, before any work is done.
///
/// # Errors
/// [`Error::Io`] if the system refuses.
pub fn make_folder(path: &Path) -> Result<()> {
    fs::create_dir_all(path).map_err(|source| Error::Io { action: "make the folder", path: path.to_owned(), source })?;
    check_writable(&path.join("result.json"))
}

/// Checks that a file can be created beside `path`, before any work is done. An existing file is not touched.
///
/// # Errors
/// [`Error::Io`] if the system refuses.
pub fn check_writable(path: &Path) -> Result<()> {
    let io = |source| Error::Io { action: "write", path: path.to_owned(), source };
    let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
    match fs::metadata(&target) {
        Ok(m) if m.is_dir() => return Err(io(std::io::ErrorKind::IsADirectory.into())),
        Ok(m) if !m.is_file() => return Ok(()),
        _ => {}
    }
    let probe = target.with_file_name(format!(".cregopt-{}.probe", std::process::id()));
    fs::File::create_new(&probe).and_then(|_| fs::remove_file(&probe)).map_err(io)
}

/// Opens a file for appending and locks it against other runs; creates it if it does not exist. A link is refused.
///
/// # Errors
/// [`Error::Io`] if the system refuses; [`Error::Invalid`] if another run has locked the file, or if it is a link.
pub fn open_alone(path: &Path) -> Result<fs::File> {
    let io = |source| Error::Io { action: "write", path: path.to_owned(), source };
    if fs::symlink_metadata(path).is_ok_and(|m| !m.is_file()) {
        return Err(Error::invalid("file", "not a regular file", "a regular file that this program created").in_file(path, None));
    }
    let file = fs::OpenOptions::new().create(true).append(true).open(path).map_err(io)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(Error::invalid("file", "in use by another run", "one run at a time").in_file(path, None)),
        // Some file systems do not support locks.
        Err(fs::TryLockError::Error(e)) if e.kind() == std::io::ErrorKind::Unsupported => Ok(file),
        Err(fs::TryLockError::Error(e)) => Err(io(e)),
    }
}

/// A file that is written line by line. Finished lines are stored at once in a neighbour, `.part`, which replaces the target when all are
/// there.
#[derive(Debug)]
pub struct Growing {
    target: PathBuf,
    /// `None` if the target is not a regular file.
    part: Option<(PathBuf, fs::File)>,
    lines: String,
    count: usize,
}

impl Growing {
    /// Starts a file, or resumes one that an earlier run left unfinished.
    ///
    /// * `stamp` - a line that identifies everything the lines depend on; a part with another stamp is discarded
    ///
    /// # Errors
    /// See [`open_alone`].
    pub fn open(target: &Path, stamp: &str) -> Result<Growing> {
        let mut growing = Growing { target: target.to_owned(), part: None, lines: String::new(), count: 0 };
        let real = fs::canonicalize(target).unwrap_or_else(|_| target.to_owned());
        if fs::metadata(&real).is_ok_and(|m| !m.is_file()) {
            return Ok(growing);
        }
        let mut name = real.file_name().map(|n| n.to_owned()).unwrap_or_default();
        name.push(".part");
        let path = real.with_file_name(name);
        let mut file = open_alone(&path)?;
        let io = |source| Error::Io { action: "write", path: path.clone(), source };
        let text = read(&path)?;
        // The last line may have been cut off.
        let whole = &text[..text.rfind('\n').map_or(0, |end| end + 1)];
        match whole.split_once('\n') {
            Some((first, rest)) if first == stamp => {
                (growing.lines, growing.count) = (rest.into(), rest.lines().count());
                file.set_len(whole.len() as u64).map_err(io)?;
            }
            _ => {
                file.set_len(0).and_then(|()| file.write_all(format!("{stamp}\n").as_bytes())).map_err(io)?;
            }
        }
        growing.part = Some((path, file));
        Ok(growing)
    }

    /// Number of lines so far.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Lines so far.
    pub fn text(&self) -> &str {
        &self.lines
    }

    /// Drops all lines but the first `count`.
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses.
    pub fn keep(&mut self, count: usize) -> Result<()> {
        if count < self.count {
            let kept: usize = self.lines.lines().take(count).map(|line| line.len() + 1).sum();
            let lost = self.lines.len() - kept;
            (self.count, self.lines) = (count, self.lines[..kept].into());
            if let Some((path, file)) = &mut self.part {
                let length = file.metadata().and_then(|m| file.set_len(m.len() - lost as u64));
                length.map_err(|source| Error::Io { action: "write", path: path.clone(), source })?;
            }
        }
        Ok(())
    }

    /// Appends whole lines.
    ///
    /// # Errors
    /// [`Error::Io`] if the system refuses.
    pub fn add(&mut self, lines: &str) -> Result<()> {
        if let Some((path, file)) = &mut self.part {
            let written = file.write_all(lines.as_bytes()).and_then(|()| file.sync_data());
            written.map_err(|source| Error::Io { action: "write", path: path.clone(), source })?;
        }
        self.lines += lines;
        self.count += lines.lines().count();
        Ok(())
    }

    /// Writes the lines to the target, replacing an older file, and removes the part.
    ///
    /// # Errors
    /// See [`write`].
    pub fn finish(self) -> Result<()> {
        write(&self.target, &self.lines)?;
        let remove = |(path, _): (PathBuf, fs::File)| {
            fs::remove_file(&path).map_err(|source| Error::Io { action: "remove", path: path.clone(), source })
        };
        self.part.map_or(Ok(()), remove)
    }
}

/// Non-empty lines with their one-based line numbers.
pub fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, line)| !line.trim().is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unfinished_file_is_resumed() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("results.jsonl");
        write(&target, "old\n").unwrap();
        let mut growing = Growing::open(&target, "stamp").unwrap();
        growing.add("one\ntwo\n").unwrap();
        // Another run is refused while this one is open.
        assert!(Growing::open(&target, "stamp").unwrap_err().to_string().contains("in use by another run"));
        drop(growing);
        assert_eq!(read(&target).unwrap(), "old\n");
        // The last line was cut off.
        let part = folder.path().join("results.jsonl.part");
        fs::write(&part, read(&part).unwrap() + "thr").unwrap();
        let mut growing = Growing::open(&target, "stamp").unwrap();
        assert_eq!((growing.count(), growing.text()), (2, "one\ntwo\n"));
        growing.keep(1).unwrap();
        growing.add("2\n").unwrap();
        growing.finish().unwrap();
        assert_eq!(read(&target).unwrap(), "one\n2\n");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
        // Another stamp starts afresh.
        drop(Growing::open(&target, "stamp").map(|mut g| g.add("one\n")).unwrap());
        assert_eq!(Growing::open(&target, "other").unwrap().count(), 0);
    }

    #[test]
    fn a_byte_order_mark_is_dropped() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.json");
        fs::write(&path, "\u{feff}{}").unwrap();
        assert_eq!(read(&path).unwrap(), "{}");
    }

    #[cfg(unix)]
    #[test]
    fn a_part_that_is_a_link_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let (target, other) = (folder.path().join("results.jsonl"), folder.path().join("other"));
        fs::write(&other, "kept").unwrap();
        std::os::unix::fs::symlink(&other, folder.path().join("results.jsonl.part")).unwrap();
        assert!(Growing::open(&target, "stamp").is_err());
        assert_eq!(read(&other).unwrap(), "kept");
    }

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

//! Reading and writing files so that errors name the place and nothing is left half-written.

use crate::error::{Error, Result};
use std::fs;
use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};

/// Largest input file, bytes.
pub const MAX_FILE: u64 = 1 << 30;

/// The path that stands for standard input, and for standard output.
pub const STREAM: &str = "-";

/// Reads a text file, without the byte order mark that some editors put first.
///
/// # Errors
/// [`Error::Io`] when the system refuses, [`Error::Invalid`] when there is more than [`MAX_FILE`], as in a device that never ends.
pub fn read(path: &Path) -> Result<String> {
    read_at_most(path, MAX_FILE)
}

/// As [`read`], of a file that is small when it is what it should be.
///
/// # Errors
/// As [`read`], with `limit` bytes for [`MAX_FILE`].
pub fn read_at_most(path: &Path, limit: u64) -> Result<String> {
    let no_text =
        |_| Error::Io { action: "read", path: path.to_owned(), source: io::Error::new(io::ErrorKind::InvalidData, "no UTF-8 text") };
    let text = String::from_utf8(read_bytes(path, limit)?).map_err(no_text)?;
    Ok(text.strip_prefix('\u{feff}').map(String::from).unwrap_or(text))
}

/// Whether a file is TOML by its name; it is JSON otherwise.
pub fn is_toml(path: &Path) -> bool {
    path.extension().is_some_and(|extension| extension.eq_ignore_ascii_case("toml"))
}

/// Reads a value from a file in JSON or, by its name, in TOML.
///
/// # Errors
/// As [`read`], and [`Error::InFile`] for what is not such a value.
pub fn read_value<T: serde::de::DeserializeOwned>(path: &Path) -> Result<T> {
    let text = read(path)?;
    let value = if is_toml(path) { crate::error::from_toml(&text) } else { crate::error::from_json(&text) };
    value.map_err(|e| e.in_file(path, None))
}

/// Reads a file of any kind of at most `limit` bytes; `-` is standard input.
///
/// # Errors
/// As [`read_at_most`].
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

/// Writes a whole file or nothing: to a neighbour first, then renamed over the target. A link is followed; a device or pipe is written
/// directly, and so is standard output, `-`.
///
/// # Errors
/// [`Error::Io`] when the system refuses.
pub fn write(path: &Path, text: &str) -> Result<()> {
    write_bytes(path, text.as_bytes())
}

/// As [`write()`], of what is no text.
///
/// # Errors
/// As [`write()`].
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
        // The part may not exist; the first error is the one to tell.
        let _ = fs::remove_file(&part);
        io(e)
    })
}

/// Writes to standard output. A closed pipe (`| head`) is no error.
///
/// # Errors
/// What the system says.
pub fn stdout(bytes: &[u8]) -> io::Result<()> {
    let mut out = io::stdout().lock();
    match out.write_all(bytes).and_then(|()| out.flush()) {
        Err(e) if e.kind() != io::ErrorKind::BrokenPipe => Err(e),
        _ => Ok(()),
    }
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
    fs::File::create_new(&probe).and_then(|_| fs::remove_file(&probe)).map_err(io)
}

/// Opens a file to add to, made if it is not there, that no other run adds to at the same time. A link is not followed.
///
/// # Errors
/// [`Error::Io`] when the system refuses; [`Error::Invalid`] when another run holds it, or it is a link.
pub fn open_alone(path: &Path) -> Result<fs::File> {
    let io = |source| Error::Io { action: "write", path: path.to_owned(), source };
    if fs::symlink_metadata(path).is_ok_and(|m| !m.is_file()) {
        return Err(Error::invalid("file", "no plain file", "a plain file, which this program made").in_file(path, None));
    }
    let file = fs::OpenOptions::new().create(true).append(true).open(path).map_err(io)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(fs::TryLockError::WouldBlock) => Err(Error::invalid("file", "in use by another run", "one run at a time").in_file(path, None)),
        // Some file systems cannot lock.
        Err(fs::TryLockError::Error(e)) if e.kind() == std::io::ErrorKind::Unsupported => Ok(file),
        Err(fs::TryLockError::Error(e)) => Err(io(e)),
    }
}

/// Lines of a file in the making: they stand in a neighbour, `.part`, as soon as they are there, and become the file when all are.
#[derive(Debug)]
pub struct Growing {
    target: PathBuf,
    /// None where the target is no plain file.
    part: Option<(PathBuf, fs::File)>,
    lines: String,
    count: usize,
}

impl Growing {
    /// Begins, or goes on with what an ended run has left.
    ///
    /// * `stamp` - a line that says what the lines depend on; what another stamp has left is begun anew
    ///
    /// # Errors
    /// As [`open_alone`].
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
        // A last line may have been cut off.
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

    /// The lines so far.
    pub fn text(&self) -> &str {
        &self.lines
    }

    /// Forgets all lines but the first ones.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses.
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

    /// Adds whole lines.
    ///
    /// # Errors
    /// [`Error::Io`] when the system refuses.
    pub fn add(&mut self, lines: &str) -> Result<()> {
        if let Some((path, file)) = &mut self.part {
            let written = file.write_all(lines.as_bytes()).and_then(|()| file.sync_data());
            written.map_err(|source| Error::Io { action: "write", path: path.clone(), source })?;
        }
        self.lines += lines;
        self.count += lines.lines().count();
        Ok(())
    }

    /// Makes the file of them, in the place of an older one.
    ///
    /// # Errors
    /// As [`write`].
    pub fn finish(self) -> Result<()> {
        write(&self.target, &self.lines)?;
        let remove = |(path, _): (PathBuf, fs::File)| {
            fs::remove_file(&path).map_err(|source| Error::Io { action: "remove", path: path.clone(), source })
        };
        self.part.map_or(Ok(()), remove)
    }
}

/// Non-empty lines with their one-based numbers.
pub fn lines(text: &str) -> impl Iterator<Item = (usize, &str)> {
    text.lines().enumerate().map(|(i, line)| (i + 1, line)).filter(|(_, line)| !line.trim().is_empty())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_file_in_the_making_is_gone_on_with() {
        let folder = tempfile::tempdir().unwrap();
        let target = folder.path().join("results.jsonl");
        write(&target, "old\n").unwrap();
        let mut growing = Growing::open(&target, "stamp").unwrap();
        growing.add("one\ntwo\n").unwrap();
        // Another run is refused while this one lasts.
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
        // Another stamp begins anew.
        drop(Growing::open(&target, "stamp").map(|mut g| g.add("one\n")).unwrap());
        assert_eq!(Growing::open(&target, "other").unwrap().count(), 0);
    }

    #[test]
    fn a_byte_order_mark_is_no_part_of_a_text() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("robot.json");
        fs::write(&path, "\u{feff}{}").unwrap();
        assert_eq!(read(&path).unwrap(), "{}");
    }

    #[cfg(unix)]
    #[test]
    fn a_link_in_the_place_of_a_part_is_refused() {
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

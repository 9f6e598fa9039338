//! Files that appear complete or not at all: written aside, synced, renamed.

use std::ffi::{OsStr, OsString};
use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};
use std::time::Duration;

use crate::ImageError;

/// A file on its way. Dropped before [`Aside::finish`], it leaves nothing behind; what a process leaves that is killed, the next one
/// that makes the same file clears away.
pub(crate) struct Aside {
    path: PathBuf,
    /// Where the bytes go first; `None` for devices and pipes, which are written in place.
    partial: Option<PathBuf>,
    target: PathBuf,
    /// Buffered, and `None` only once finished.
    writer: Option<BufWriter<File>>,
}

/// How the names of files end that are not complete.
const PARTIAL: &str = ".partial";

/// A file that was written to so lately is left alone: it may be about to be locked.
const FRESH: Duration = Duration::from_secs(10);

/// Removes what killed processes have left of a file: their locks are gone.
fn clear_away(folder: &Path, prefix: &OsStr) {
    let Ok(entries) = fs::read_dir(folder) else { return };
    for entry in entries.flatten() {
        let name = entry.file_name();
        let number = name
            .as_encoded_bytes()
            .strip_prefix(prefix.as_encoded_bytes())
            .and_then(|rest| rest.strip_suffix(PARTIAL.as_bytes()));
        if number.is_some_and(|n| !n.is_empty() && n.iter().all(u8::is_ascii_digit))
            && let Ok(file) = File::options().write(true).open(entry.path())
            && file.metadata().is_ok_and(|m| is_old(&m))
            && file.try_lock().is_ok()
        {
            let _ = fs::remove_file(entry.path());
        }
    }
}

/// The folder that a file is in.
fn folder_of(file: &Path) -> &Path {
    file.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

fn is_old(file: &fs::Metadata) -> bool {
    file.modified().is_ok_and(|at| at.elapsed().is_ok_and(|age| age > FRESH))
}

impl Aside {
    pub(crate) fn create(path: &Path) -> Result<Self, ImageError> {
        let fail = |source| ImageError::Create { path: path.to_owned(), source };
        // A link keeps pointing where it points, and /dev/null stays a device.
        let target = fs::canonicalize(path).unwrap_or_else(|_| path.to_owned());
        let kind = fs::metadata(&target).ok().map(|m| m.file_type());
        let partial = match kind {
            Some(kind) if kind.is_dir() => {
                return Err(fail(io::Error::new(
                    io::ErrorKind::IsADirectory,
                    "there is a folder of that name",
                )));
            }
            Some(kind) if !kind.is_file() => None,
            _ => {
                let name = target.file_name().ok_or_else(|| {
                    fail(io::Error::new(io::ErrorKind::InvalidInput, "that is no file name"))
                })?;
                let mut hidden = OsString::from(".");
                hidden.push(name);
                hidden.push(".");
                clear_away(folder_of(&target), &hidden);
                hidden.push(format!("{}{PARTIAL}", std::process::id()));
                Some(target.with_file_name(hidden))
            }
        };
        let file = match &partial {
            Some(partial) => File::create(partial),
            None => File::options().write(true).open(&target),
        };
        if let (Ok(file), Some(_)) = (&file, &partial) {
            // Says that this one is alive. Where files cannot be locked, nothing is ever cleared away.
            let _ = file.try_lock();
        }
        let writer = Some(BufWriter::with_capacity(1 << 16, file.map_err(fail)?));
        Ok(Self { path: path.to_owned(), partial, target, writer })
    }

    /// Makes the file visible under its name.
    pub(crate) fn finish(mut self) -> Result<(), ImageError> {
        self.publish().map_err(|source| ImageError::write(&self.path, source))
    }

    fn publish(&mut self) -> io::Result<()> {
        let Some(writer) = self.writer.take() else { return Ok(()) };
        let file = writer.into_inner().map_err(|e| e.into_error())?;
        let Some(partial) = &self.partial else { return Ok(()) };
        file.sync_all()?;
        drop(file);
        fs::rename(partial, &self.target)?;
        self.partial = None;
        // The rename itself is made durable where folders can be synced.
        if let Ok(folder) = File::open(folder_of(&self.target)) {
            let _ = folder.sync_all();
        }
        Ok(())
    }

    fn inner(&mut self) -> io::Result<&mut BufWriter<File>> {
        self.writer.as_mut().ok_or_else(|| io::Error::other("the file is already finished"))
    }
}

impl Write for Aside {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.inner()?.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.inner()?.flush()
    }
}

impl Seek for Aside {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.inner()?.seek(to)
    }
}

impl Drop for Aside {
    fn drop(&mut self) {
        if let Some(partial) = self.partial.take() {
            // Unflushed bytes are of no use: take the buffer apart without writing them.
            if let Some(writer) = self.writer.take() {
                drop(writer.into_parts());
            }
            let _ = fs::remove_file(partial);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unfinished_file_leaves_the_old_one_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a.png");
        fs::write(&path, "old").unwrap();
        let mut aside = Aside::create(&path).unwrap();
        aside.write_all(b"half").unwrap();
        drop(aside);
        assert_eq!(fs::read(&path).unwrap(), b"old");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1, "nothing is left behind");
        let mut aside = Aside::create(&path).unwrap();
        aside.write_all(b"new").unwrap();
        aside.finish().unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
    }

    #[test]
    fn what_a_killed_process_has_left_is_cleared_away() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let old = std::time::SystemTime::now() - 2 * FRESH;
        let names =
            [".a.png.1.partial", ".a.png.2.partial", ".a.png.x.partial", ".b.png.1.partial"];
        let files = names.map(|name| {
            let mut file = File::create(at(name)).unwrap();
            file.write_all(b"half").unwrap();
            file.set_modified(old).unwrap();
            file
        });
        fs::write(at(".a.png.3.partial"), "half").unwrap();
        // Somebody is at work at the second one.
        files[1].lock().unwrap();
        Aside::create(&at("a.png")).unwrap().finish().unwrap();
        let mut left: Vec<_> =
            fs::read_dir(folder.path()).unwrap().map(|e| e.unwrap().file_name()).collect();
        left.sort();
        let wanted = [names[1], ".a.png.3.partial", names[2], names[3], "a.png"];
        assert_eq!(left, wanted);
    }

    #[cfg(unix)]
    #[test]
    fn devices_and_links_stay_what_they_are() {
        let mut aside = Aside::create(Path::new("/dev/null")).unwrap();
        aside.write_all(b"gone").unwrap();
        aside.finish().unwrap();
        assert!(!fs::metadata("/dev/null").unwrap().is_file());

        let folder = tempfile::tempdir().unwrap();
        let (real, link) = (folder.path().join("real"), folder.path().join("link"));
        fs::write(&real, "old").unwrap();
        std::os::unix::fs::symlink(&real, &link).unwrap();
        let mut aside = Aside::create(&link).unwrap();
        aside.write_all(b"new").unwrap();
        aside.finish().unwrap();
        assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
        assert_eq!(fs::read(&real).unwrap(), b"new");
    }

    #[test]
    fn a_missing_folder_is_named_with_a_remedy() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("missing").join("a.png");
        let error = Aside::create(&path).err().unwrap();
        let text = error.to_string();
        assert!(text.contains("missing") && text.contains("create the folder"), "{text}");
        assert_eq!(error.exit_code(), 5);
        let error = Aside::create(folder.path()).err().unwrap();
        assert!(error.to_string().contains("name a file"), "{error}");
    }
}

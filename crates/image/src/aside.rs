//! Files that appear complete or not at all: written aside, synced, renamed.

use std::fs::{self, File};
use std::io::{self, BufWriter, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use crate::ImageError;

/// A file on its way. Dropped before [`Aside::finish`], it leaves nothing behind.
pub(crate) struct Aside {
    path: PathBuf,
    /// Where the bytes go first; `None` for devices and pipes, which are written in place.
    partial: Option<PathBuf>,
    target: PathBuf,
    /// Buffered, and `None` only once finished.
    writer: Option<BufWriter<File>>,
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
                let mut hidden = std::ffi::OsString::from(".");
                hidden.push(name);
                hidden.push(format!(".{}.partial", std::process::id()));
                Some(target.with_file_name(hidden))
            }
        };
        let file = match &partial {
            Some(partial) => File::create(partial),
            None => File::options().write(true).open(&target),
        };
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
        let folder = self.target.parent().filter(|p| !p.as_os_str().is_empty());
        if let Ok(folder) = File::open(folder.unwrap_or(Path::new("."))) {
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

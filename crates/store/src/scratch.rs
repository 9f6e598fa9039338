//! Scratch space beside a store: a file without a name, for what a stage sorts on disk. The system
//! frees it when it is dropped, and when the process is killed.

use std::fs::File;
use std::io;
use std::os::unix::fs::FileExt;
use std::path::PathBuf;

use crate::{StoreDir, StoreError};

/// Writes are gathered up to so many bytes.
const GATHERED: usize = 256 << 10;

/// An unnamed file in a store's directory. Its bytes mean what the writer says; nobody else sees them.
pub struct ScratchFile {
    store: StoreDir,
    file: File,
    path: PathBuf,
    /// Bytes in the file.
    written: u64,
    /// What follows them, not yet written. Never grows beyond [`ScratchFile::MEMORY_BYTES`].
    gathered: Vec<u8>,
}

impl ScratchFile {
    /// Heap bytes that one holds; reserve them before.
    pub const MEMORY_BYTES: u64 = GATHERED as u64;

    /// Makes an empty one.
    ///
    /// # Errors
    /// [`StoreError::Io`] when the directory takes no file.
    pub fn new(store: &StoreDir) -> Result<Self, StoreError> {
        let path = store.path().to_path_buf();
        let file = tempfile::tempfile_in(&path).map_err(|source| StoreError::Io {
            path: path.clone(),
            action: "make a scratch file in",
            source,
        })?;
        let gathered = Vec::with_capacity(GATHERED);
        Ok(Self { store: store.clone(), file, path, written: 0, gathered })
    }

    /// Bytes appended so far.
    pub fn len(&self) -> u64 {
        self.written + self.gathered.len() as u64
    }

    /// Whether nothing has been appended.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Appends bytes and returns where they begin.
    ///
    /// # Errors
    /// [`StoreError::Io`], a full disk for example.
    pub fn append(&mut self, parts: &[&[u8]]) -> Result<u64, StoreError> {
        let at = self.len();
        for bytes in parts {
            if self.gathered.len() + bytes.len() > GATHERED {
                self.flush()?;
            }
            if bytes.len() > GATHERED {
                self.write(bytes)?;
            } else {
                self.gathered.extend_from_slice(bytes);
            }
        }
        Ok(at)
    }

    /// Hands everything to the system, so that [`ScratchFile::read`] finds it.
    ///
    /// # Errors
    /// [`StoreError::Io`], a full disk for example.
    pub fn flush(&mut self) -> Result<(), StoreError> {
        let mut gathered = std::mem::take(&mut self.gathered);
        let done = self.write(&gathered);
        gathered.clear();
        self.gathered = gathered;
        done
    }

    fn write(&mut self, bytes: &[u8]) -> Result<(), StoreError> {
        self.file.write_all_at(bytes, self.written).map_err(|e| self.error("write", e))?;
        self.written += bytes.len() as u64;
        self.store.stats().written(bytes.len() as u64);
        Ok(())
    }

    /// Reads what was appended and flushed. Threads may read at once.
    ///
    /// # Errors
    /// [`StoreError::Io`], also when there are fewer bytes than `into` has.
    pub fn read(&self, at: u64, into: &mut [u8]) -> Result<(), StoreError> {
        self.file.read_exact_at(into, at).map_err(|e| self.error("read", e))?;
        self.store.stats().read(into.len() as u64);
        Ok(())
    }

    fn error(&self, action: &'static str, source: io::Error) -> StoreError {
        StoreError::Io { path: self.path.join("(scratch file)"), action, source }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_appended_is_read_back() {
        let dir = tempfile::tempdir().unwrap();
        let store = StoreDir::create(dir.path().join("a.enf")).unwrap();
        let mut scratch = ScratchFile::new(&store).unwrap();
        let large = vec![7u8; GATHERED + 5];
        let mut at = Vec::new();
        for i in 0..3000u32 {
            at.push(scratch.append(&[&i.to_le_bytes(), &[i as u8; 1000]]).unwrap());
        }
        let end = scratch.append(&[&large]).unwrap();
        assert_eq!(end, 3000 * 1004);
        scratch.flush().unwrap();
        let mut back = [0; 1004];
        for (i, &at) in at.iter().enumerate().rev() {
            scratch.read(at, &mut back).unwrap();
            assert_eq!(back[..4], (i as u32).to_le_bytes());
            assert!(back[4..].iter().all(|&b| b == i as u8));
        }
        let mut back = vec![0; large.len()];
        scratch.read(end, &mut back).unwrap();
        assert_eq!(back, large);
        assert!(scratch.read(end + 1, &mut back).is_err());
        assert_eq!(store.io().written_bytes, scratch.len());
        // It has no name.
        assert_eq!(std::fs::read_dir(store.path()).unwrap().count(), 0);
    }
}

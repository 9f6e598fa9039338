//! The directory of a store: which stages are in it, and how far they are.

use std::fmt;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use enf_layout::segment::StageKind;

use crate::files::{self, Named, Role};
use crate::replay;
use crate::seal;
use crate::{ExtentReader, Identity, StoreError};

/// A store's directory, `NAME.enf/`, and the counters of what was read from and written to it.
/// Cloning gives another handle to the same counters.
#[derive(Clone)]
pub struct StoreDir(Arc<Inner>);

struct Inner {
    path: PathBuf,
    io: IoStats,
}

/// Counters beside the code that they measure.
#[derive(Default)]
pub(crate) struct IoStats {
    read: AtomicU64,
    written: AtomicU64,
    inflated: AtomicU64,
}

impl IoStats {
    pub(crate) fn read(&self, bytes: u64) {
        self.read.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn written(&self, bytes: u64) {
        self.written.fetch_add(bytes, Ordering::Relaxed);
    }

    pub(crate) fn inflated(&self, bytes: u64) {
        self.inflated.fetch_add(bytes, Ordering::Relaxed);
    }
}

/// Bytes moved through one [`StoreDir`] since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct IoCounters {
    /// Bytes read from files, mapped extents included.
    pub read_bytes: u64,
    /// Bytes written to files.
    pub written_bytes: u64,
    /// Bytes that came out of decompression.
    pub inflated_bytes: u64,
}

/// How far a stage is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StageState {
    /// Nothing of it is committed.
    Absent,
    /// Begun, and resumable.
    Unsealed,
    /// Finished and immutable.
    Sealed,
}

impl StoreDir {
    /// Makes the directory, and its parents, unless it is there.
    ///
    /// # Errors
    /// [`StoreError::Io`] when it cannot be made.
    pub fn create(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        let path = path.as_ref();
        fs::create_dir_all(path).map_err(StoreError::io("create", path))?;
        if let Some(parent) = path.parent().filter(|p| !p.as_os_str().is_empty()) {
            // Best effort: some directories may be written to and not read.
            let _ = files::sync_dir(parent);
        }
        Ok(Self::new(path))
    }

    /// Opens a directory that is there.
    ///
    /// # Errors
    /// [`StoreError::Missing`] when there is none.
    pub fn open(path: impl AsRef<Path>) -> Result<Self, StoreError> {
        let path = path.as_ref();
        let missing =
            |remedy: &str| StoreError::Missing { path: path.into(), remedy: remedy.into() };
        match fs::metadata(path) {
            Ok(meta) if meta.is_dir() => Ok(Self::new(path)),
            Ok(_) => Err(missing("a store is a directory, and this is a file")),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                Err(missing("make the store with enf-partition SCENE -o NAME.enf"))
            }
            Err(e) => Err(StoreError::io("open", path)(e)),
        }
    }

    fn new(path: &Path) -> Self {
        Self(Arc::new(Inner { path: path.to_path_buf(), io: IoStats::default() }))
    }

    /// The directory.
    pub fn path(&self) -> &Path {
        &self.0.path
    }

    /// What was read and written through this handle and its clones so far.
    pub fn io(&self) -> IoCounters {
        let get = |counter: &AtomicU64| counter.load(Ordering::Relaxed);
        let io = &self.0.io;
        IoCounters {
            read_bytes: get(&io.read),
            written_bytes: get(&io.written),
            inflated_bytes: get(&io.inflated),
        }
    }

    pub(crate) fn stats(&self) -> &IoStats {
        &self.0.io
    }

    pub(crate) fn file(&self, stage: StageKind, role: Role) -> PathBuf {
        self.0.path.join(role.name(stage))
    }

    /// The processes that have a journal of this stage here, ascending.
    pub(crate) fn processes(&self, stage: StageKind) -> Result<Vec<u32>, StoreError> {
        let found = files::list(self.path())?.into_iter().filter_map(|(s, role)| match role {
            Role::Journal { process } if s == stage => Some(process),
            _ => None,
        });
        Ok(found.collect())
    }

    /// How far a stage is.
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] when its seal is damaged.
    pub fn stage_state(&self, stage: StageKind) -> Result<StageState, StoreError> {
        if seal::read(self, stage)?.is_some() {
            return Ok(StageState::Sealed);
        }
        for process in self.processes(stage)? {
            if replay::first_extent(self, stage, process)?.is_some() {
                return Ok(StageState::Unsealed);
            }
        }
        Ok(StageState::Absent)
    }

    /// What a stage was made from; `None` when it is [`StageState::Absent`].
    ///
    /// # Errors
    /// [`StoreError::Corrupt`] when the stored identity, or the stage's seal, is damaged.
    pub fn identity(&self, stage: StageKind) -> Result<Option<Identity>, StoreError> {
        let seal = seal::read(self, stage)?;
        for process in self.processes(stage)? {
            if let Some((extent, header)) = replay::first_extent(self, stage, process)? {
                let data = ExtentReader::open(self, stage, process)?;
                return replay::identity(&data, &extent, header.made_from).map(Some);
            }
        }
        match seal {
            None => Ok(None),
            Some(_) => Err(StoreError::corrupt(
                &self.file(stage, Role::Journal { process: 0 }),
                0,
                "the stage is sealed, but its journal holds nothing",
            )),
        }
    }

    /// Deletes this stage and all later ones (`--force`), whatever state they are in. A kill in between leaves
    /// each stage whole or without its seal.
    ///
    /// # Errors
    /// [`StoreError::Busy`] when a live process is writing one of them; nothing is deleted then.
    pub fn discard_from(&self, stage: StageKind) -> Result<(), StoreError> {
        let mut doomed: Vec<_> =
            files::list(self.path())?.into_iter().filter(|f| f.0 >= stage).collect();
        // Later stages first, and of each the seal, the journals, then the data (`Role`'s order).
        doomed.sort_by_key(|&(stage, role)| (std::cmp::Reverse(stage), role));
        let mut locks = Vec::new();
        for &(stage, role) in doomed.iter().filter(|f| matches!(f.1, Role::Journal { .. })) {
            let journal = Named::open_or_create(self.file(stage, role))?;
            journal.lock()?;
            locks.push(journal);
        }
        for &(stage, role) in &doomed {
            let path = self.file(stage, role);
            match fs::remove_file(&path) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => {
                    return Err(StoreError::io("delete", &path)(e));
                }
                _ => {}
            }
        }
        files::sync_dir(self.path())
    }
}

impl fmt::Debug for StoreDir {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "StoreDir({})", self.path().display())
    }
}

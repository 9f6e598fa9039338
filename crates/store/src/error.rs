//! What can go wrong with a store, in words that name the file, the place and the way out.

use std::io;
use std::path::{Path, PathBuf};

use enf_layout::sections::Malformed;
use enf_layout::segment::StageKind;

use crate::budget::BudgetError;

/// Any failure of the store.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The operating system refused.
    #[error("cannot {action} {}: {source}{}", path.display(), hint(source))]
    Io {
        /// File or directory.
        path: PathBuf,
        /// What was tried, as a verb: "read", "write", "sync".
        action: &'static str,
        /// The system's answer.
        source: io::Error,
    },
    /// A file's bytes are not what was written.
    #[error("{} is corrupt at byte {offset}: {detail}", file.display())]
    Corrupt {
        /// The bad file.
        file: PathBuf,
        /// First byte of the part that is bad.
        offset: u64,
        /// What is wrong with it.
        detail: String,
    },
    /// The store, or what a stage left in it, is not there.
    #[error("{} is missing: {remedy}", path.display())]
    Missing {
        /// What was looked for.
        path: PathBuf,
        /// How to get it.
        remedy: String,
    },
    /// A stage has not finished.
    #[error("{stage} in {} is unfinished: {detail}; run enf-{stage} again, it resumes", path.display(), stage = stage.name())]
    Unfinished {
        /// The stage.
        stage: StageKind,
        /// The store.
        path: PathBuf,
        /// What is missing.
        detail: String,
    },
    /// The stage was begun with other inputs or flags.
    #[error("{} holds another {}: {}; --force discards it and what was made from it",
        path.display(), stage.name(), differences.join("; "))]
    Different {
        /// The stage.
        stage: StageKind,
        /// The store.
        path: PathBuf,
        /// One line for each input or flag that differs.
        differences: Vec<String>,
    },
    /// The stage is finished, with the same inputs and flags: there is nothing to write.
    #[error("{} in {} is finished and sealed", stage.name(), path.display())]
    Sealed {
        /// The stage.
        stage: StageKind,
        /// The store.
        path: PathBuf,
    },
    /// Another live process owns the file.
    #[error("{} belongs to another running process; wait for it to end", path.display())]
    Busy {
        /// The journal that is locked.
        path: PathBuf,
    },
    /// The memory budget has no place for it.
    #[error(transparent)]
    Budget(#[from] BudgetError),
    /// Bytes were asked for, or given, in a form that they do not have.
    #[error("malformed data: {0}")]
    Malformed(#[from] Malformed),
}

fn hint(source: &io::Error) -> &'static str {
    match source.kind() {
        io::ErrorKind::StorageFull | io::ErrorKind::QuotaExceeded => {
            " (free some space and run the same command again: it resumes)"
        }
        io::ErrorKind::FileTooLarge => {
            " (raise the limit on file sizes, ulimit -f, and run the same command again: it resumes)"
        }
        _ => "",
    }
}

impl StoreError {
    /// The process exit code for this failure: 2 another run's output in the way, 3 the budget cannot
    /// work, 4 missing or bad input, 5 I/O failed or the file is owned by another live process.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Different { .. } | Self::Sealed { .. } => 2,
            Self::Budget(_) => 3,
            Self::Corrupt { .. }
            | Self::Missing { .. }
            | Self::Unfinished { .. }
            | Self::Malformed(_) => 4,
            Self::Io { .. } | Self::Busy { .. } => 5,
        }
    }

    /// Whether space on the disk is what lacks.
    pub fn is_full(&self) -> bool {
        use io::ErrorKind::{QuotaExceeded, StorageFull};
        matches!(self, Self::Io { source, .. } if matches!(source.kind(), StorageFull | QuotaExceeded))
    }

    /// For `map_err`: an I/O failure while doing `action` to `path`.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(io::Error) -> Self {
        move |source| Self::Io { path: path.to_path_buf(), action, source }
    }

    /// A corruption of `file` at `offset`.
    pub fn corrupt(file: &Path, offset: u64, detail: impl Into<String>) -> Self {
        Self::Corrupt { file: file.to_path_buf(), offset, detail: detail.into() }
    }
}

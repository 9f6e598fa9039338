//! Names, headers, locks and plain reads of the files in a store.

use std::fs::{self, File};
use std::io;
use std::os::unix::fs::{FileExt, MetadataExt};
use std::path::{Path, PathBuf};

use enf_layout::FORMAT_VERSION;
use enf_layout::journal::JournalRecord;
use enf_layout::segment::{
    EXTENT_ALIGNMENT, FileHeader, JOURNAL_MAGIC, SEAL_MAGIC, SEGMENT_MAGIC, StageKind,
};
use rustix::fs::{FlockOperation, flock};
use rustix::io::Errno;
use xxhash_rust::xxh3::{xxh3_64, xxh3_128};
use zerocopy::{FromBytes, IntoBytes};

use crate::StoreError;
use crate::dir::IoStats;
use crate::seal::SealRecord;

/// Bytes of a [`FileHeader`]: where a file's contents begin.
pub(crate) const HEADER: u64 = size_of::<FileHeader>() as u64;

/// Bytes that are read, written or mapped in one go.
pub(crate) const WINDOW: usize = 1 << 20;

/// What a file in the store is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Role {
    /// `trace.seal`
    Seal,
    /// `trace.seal.new`, being written; means nothing.
    NewSeal,
    /// `trace.000.journal`
    Journal {
        /// Process that writes it.
        process: u32,
    },
    /// `trace.000.000.dat`
    Data {
        /// Process that writes it.
        process: u32,
        /// Number among the process's data files; 0, until there is a reason for more.
        segment: u32,
    },
}

impl Role {
    pub(crate) fn name(self, stage: StageKind) -> String {
        let stage = stage.name();
        match self {
            Role::Seal => format!("{stage}.seal"),
            Role::NewSeal => format!("{stage}.seal.new"),
            Role::Journal { process } => format!("{stage}.{process:03}.journal"),
            Role::Data { process, segment } => format!("{stage}.{process:03}.{segment:03}.dat"),
        }
    }

    /// The inverse of [`name`](Self::name); `None` for any other file.
    pub(crate) fn parse(name: &str) -> Option<(StageKind, Role)> {
        let (stage, rest) = name.split_once('.')?;
        let stage = StageKind::ALL.into_iter().find(|s| s.name() == stage)?;
        let parts: Vec<&str> = rest.split('.').collect();
        let role = match parts[..] {
            ["seal"] => Role::Seal,
            ["seal", "new"] => Role::NewSeal,
            [process, "journal"] => Role::Journal { process: process.parse().ok()? },
            [process, segment, "dat"] => {
                Role::Data { process: process.parse().ok()?, segment: segment.parse().ok()? }
            }
            _ => return None,
        };
        (role.name(stage) == name).then_some((stage, role))
    }
}

/// The files of a store that belong to a stage, in order.
pub(crate) fn list(dir: &Path) -> Result<Vec<(StageKind, Role)>, StoreError> {
    let mut found = Vec::new();
    for entry in fs::read_dir(dir).map_err(StoreError::io("list", dir))? {
        let entry = entry.map_err(StoreError::io("list", dir))?;
        found.extend(entry.file_name().to_str().and_then(Role::parse));
    }
    found.sort_unstable();
    Ok(found)
}

/// An open file and its name for messages.
#[derive(Debug)]
pub(crate) struct Named {
    pub(crate) file: File,
    pub(crate) path: PathBuf,
}

impl Named {
    /// Opens for reading; a file that is not there is [`StoreError::Missing`].
    pub(crate) fn open(path: PathBuf, remedy: &str) -> Result<Self, StoreError> {
        match File::open(&path) {
            Ok(file) => Ok(Self { file, path }),
            Err(e) if e.kind() == io::ErrorKind::NotFound => {
                Err(StoreError::Missing { path, remedy: remedy.into() })
            }
            Err(e) => Err(StoreError::io("open", &path)(e)),
        }
    }

    /// Opens for reading and writing, creating it empty when it is not there.
    pub(crate) fn open_or_create(path: PathBuf) -> Result<Self, StoreError> {
        File::options()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(StoreError::io("create", &path))
            .map(|file| Self { file, path })
    }

    /// Opens a file that is there for reading and writing, which a network file system wants of who locks it.
    pub(crate) fn open_to_lock(path: PathBuf) -> Result<Self, StoreError> {
        File::options()
            .read(true)
            .write(true)
            .open(&path)
            .map_err(StoreError::io("open", &path))
            .map(|file| Self { file, path })
    }

    pub(crate) fn len(&self) -> Result<u64, StoreError> {
        Ok(self.file.metadata().map_err(StoreError::io("stat", &self.path))?.len())
    }

    /// Fills `out` from `offset`; a file that ends before is corrupt.
    pub(crate) fn read(&self, offset: u64, out: &mut [u8], io: &IoStats) -> Result<(), StoreError> {
        match self.file.read_exact_at(out, offset) {
            Ok(()) => {
                io.read(out.len() as u64);
                Ok(())
            }
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                let len = self.len()?;
                let wanted = offset.saturating_add(out.len() as u64);
                Err(self.corrupt(len, format!("the file ends here, {wanted} bytes are expected")))
            }
            Err(e) => Err(StoreError::io("read", &self.path)(e)),
        }
    }

    /// Writes all of `bytes` at `offset`.
    pub(crate) fn write(&self, offset: u64, bytes: &[u8], io: &IoStats) -> Result<(), StoreError> {
        self.file.write_all_at(bytes, offset).map_err(StoreError::io("write", &self.path))?;
        io.written(bytes.len() as u64);
        Ok(())
    }

    pub(crate) fn set_len(&self, len: u64) -> Result<(), StoreError> {
        self.file.set_len(len).map_err(StoreError::io("truncate", &self.path))
    }

    pub(crate) fn sync(&self) -> Result<(), StoreError> {
        self.file.sync_data().map_err(StoreError::io("sync", &self.path))
    }

    pub(crate) fn corrupt(&self, offset: u64, detail: impl Into<String>) -> StoreError {
        StoreError::corrupt(&self.path, offset, detail)
    }

    /// Takes the advisory lock that makes this process the file's one writer, until it is closed.
    /// `false`: the file was deleted meanwhile; open it again.
    pub(crate) fn lock(&self) -> Result<bool, StoreError> {
        match flock(&self.file, FlockOperation::NonBlockingLockExclusive) {
            // A file system without locks: there, one process at a time is the user's promise.
            Ok(()) | Err(Errno::NOSYS | Errno::OPNOTSUPP | Errno::NOLCK) => {}
            Err(Errno::AGAIN) => return Err(StoreError::Busy { path: self.path.clone() }),
            Err(e) => return Err(StoreError::io("lock", &self.path)(e.into())),
        }
        let here = self.file.metadata().map_err(StoreError::io("stat", &self.path))?;
        match fs::metadata(&self.path) {
            Ok(there) => Ok((here.dev(), here.ino()) == (there.dev(), there.ino())),
            Err(e) if e.kind() == io::ErrorKind::NotFound => Ok(false),
            Err(e) => Err(StoreError::io("stat", &self.path)(e)),
        }
    }
}

/// Makes the names in a directory durable.
pub(crate) fn sync_dir(dir: &Path) -> Result<(), StoreError> {
    File::open(dir).and_then(|d| d.sync_all()).map_err(StoreError::io("sync", dir))
}

/// XXH3-128 as stored.
pub(crate) fn hash128(bytes: &[u8]) -> [u8; 16] {
    xxh3_128(bytes).to_le_bytes()
}

/// Bytes that an extent takes in its file: a multiple of 64, and never nothing, so that no two
/// extents share an offset.
pub(crate) fn padded(stored_bytes: u64) -> Option<u64> {
    stored_bytes.max(1).checked_next_multiple_of(EXTENT_ALIGNMENT)
}

/// A complete header, checksum included.
pub(crate) fn header(stage: StageKind, role: Role, made_from: [u8; 16]) -> FileHeader {
    let (magic, process, segment, record_size) = match role {
        Role::Seal | Role::NewSeal => (SEAL_MAGIC, 0, 0, size_of::<SealRecord>()),
        Role::Journal { process } => (JOURNAL_MAGIC, process, 0, size_of::<JournalRecord>()),
        Role::Data { process, segment } => (SEGMENT_MAGIC, process, segment, 0),
    };
    let mut header = FileHeader {
        magic,
        version: FORMAT_VERSION,
        stage: stage as u32,
        process,
        segment,
        record_size: record_size as u32,
        reserved: 0,
        made_from,
        reserved2: [0; 8],
        checksum: 0,
    };
    header.checksum = xxh3_64(&header.as_bytes()[..56]);
    header
}

/// Reads and checks a file's header; every field but `made_from` is known beforehand.
pub(crate) fn read_header(
    named: &Named,
    stage: StageKind,
    role: Role,
    io: &IoStats,
) -> Result<FileHeader, StoreError> {
    let mut bytes = [0; HEADER as usize];
    named.read(0, &mut bytes, io)?;
    parse_header(named, &bytes, stage, role)
}

/// Checks a file's header.
pub(crate) fn parse_header(
    named: &Named,
    bytes: &[u8],
    stage: StageKind,
    role: Role,
) -> Result<FileHeader, StoreError> {
    let found = FileHeader::read_from_prefix(bytes)
        .map_err(|_| named.corrupt(bytes.len() as u64, "the file ends within its header"))?
        .0;
    let wanted = header(stage, role, found.made_from);
    if found == wanted {
        return Ok(found);
    }
    Err(if found.magic != wanted.magic {
        named.corrupt(0, "it does not begin like a file of this kind")
    } else if found.checksum != xxh3_64(&found.as_bytes()[..56]) {
        named.corrupt(0, "the header does not match its checksum")
    } else if found.version != wanted.version {
        let (there, here) = (found.version, FORMAT_VERSION);
        named.corrupt(8, format!("format version {there}, this program reads version {here}"))
    } else {
        named.corrupt(12, "the header belongs to another file")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_and_roles_are_one_to_one() {
        let role = Role::Data { process: 7, segment: 0 };
        assert_eq!(role.name(StageKind::Trace), "trace.007.000.dat");
        for stage in StageKind::ALL {
            for process in [0, 7, 999, 1000, u32::MAX] {
                for role in [
                    Role::Seal,
                    Role::NewSeal,
                    Role::Journal { process },
                    Role::Data { process, segment: process },
                ] {
                    let name = role.name(stage);
                    assert!(name.len() <= 40, "a seal record has 40 bytes for '{name}'");
                    assert_eq!(Role::parse(&name), Some((stage, role)));
                }
            }
        }
        for other in ["trace", "trace.0.journal", "trace.+00.journal", "x.seal", "trace.seal.old"] {
            assert_eq!(Role::parse(other), None, "{other}");
        }
    }
}

//! What can go wrong between pixels and a file, and what the user can do about it.

use std::error::Error;
use std::io;
use std::path::{Path, PathBuf};

/// A picture that could not be written, read or compared. Every variant names its file.
#[derive(Debug, thiserror::Error)]
pub enum ImageError {
    /// The file could not be created beside its final place.
    #[error("cannot create {}: {source}; {}", path.display(), remedy(source))]
    Create {
        /// The picture's path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Writing, syncing or renaming failed; no partial picture is left behind.
    #[error("cannot write {}: {source}; {}", path.display(), remedy(source))]
    Write {
        /// The picture's path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// The picture's size does not fit its pixels, or the format.
    #[error(
        "picture for {}: {width} x {height} with {pixels} pixels cannot be written; \
         give a width and a height of at least 1 whose product is the number of pixels",
        path.display()
    )]
    Size {
        /// The picture's path.
        path: PathBuf,
        /// Width, pixels.
        width: u32,
        /// Height, pixels.
        height: u32,
        /// Pixels that there are.
        pixels: usize,
    },
    /// The rows could not be had from their [`crate::Rows`].
    #[error("cannot get rows {first_row}.. of the picture for {}: {source}", path.display())]
    Rows {
        /// The picture's path.
        path: PathBuf,
        /// First row that was asked for.
        first_row: u32,
        /// What the rows' owner said.
        source: Box<dyn Error + Send + Sync>,
    },
    /// The encoder refused.
    #[error("cannot encode {}: {reason}; try another size or format", path.display())]
    Encode {
        /// The picture's path.
        path: PathBuf,
        /// What the encoder said.
        reason: String,
    },
    /// A picture could not be opened or read.
    #[error("cannot read {}: {source}; {}", path.display(), remedy(source))]
    Read {
        /// The picture's path.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// A picture's bytes are not what they should be.
    #[error("{} is no readable picture: {reason}; write it again", path.display())]
    Malformed {
        /// The picture's path.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// Two pictures have no common ground to be compared on.
    #[error("cannot compare {a} with {b}: {reason}")]
    Unlike {
        /// The first picture, by path or by words.
        a: String,
        /// The second.
        b: String,
        /// What differs.
        reason: String,
    },
}

impl ImageError {
    /// The process exit code for this error: 4 for bad input, 5 for failed output.
    pub fn exit_code(&self) -> i32 {
        match self {
            Self::Read { .. } | Self::Malformed { .. } | Self::Unlike { .. } => 4,
            _ => 5,
        }
    }

    pub(crate) fn write(path: &Path, source: io::Error) -> Self {
        Self::Write { path: path.to_owned(), source }
    }
}

/// What to do about a failed system call, in half a sentence.
fn remedy(error: &io::Error) -> &'static str {
    use io::ErrorKind::*;
    match error.kind() {
        NotFound => "create the folder, or check the path",
        PermissionDenied | ReadOnlyFilesystem => "choose a folder that you may write to",
        StorageFull | QuotaExceeded => "free some space, then run the same command again",
        IsADirectory | NotADirectory => "name a file in an existing folder",
        FileTooLarge => "choose a file system that takes larger files",
        _ => "check the disk, then run the same command again",
    }
}

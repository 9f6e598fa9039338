//! What can be wrong with a scene: always a file, a place in it, and what to do.

use std::path::PathBuf;

/// A scene that cannot be used. Every message names the file, the place and a remedy.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A file could not be opened or read.
    #[error("{}: cannot be read: {source}; {remedy}", file.display())]
    Read {
        /// The file.
        file: PathBuf,
        /// What the system said.
        source: std::io::Error,
        /// What to do.
        remedy: String,
    },
    /// A temporary file (see [`crate::Spool`]) could not be made, written or read.
    #[error("{}: a temporary file there failed: {source}; {remedy}", folder.display())]
    Spool {
        /// The folder that was to hold it.
        folder: PathBuf,
        /// What the system said.
        source: std::io::Error,
        /// What to do.
        remedy: String,
    },
    /// A line of an OBJ, MTL, TOML or instance file is wrong.
    #[error("{}:{line}: {what}; {remedy}", file.display())]
    Line {
        /// The file.
        file: PathBuf,
        /// Line, from 1.
        line: usize,
        /// What is wrong there.
        what: String,
        /// What to do.
        remedy: String,
    },
    /// The file as a whole is wrong (or the scene that it describes).
    #[error("{}: {what}; {remedy}", file.display())]
    File {
        /// The file.
        file: PathBuf,
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: String,
    },
}

impl SceneError {
    /// The process exit code of the command-line contract for this error: 4, missing or bad input; 5 for
    /// temporary files that failed.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Spool { .. } => 5,
            Self::Read { .. } | Self::Line { .. } | Self::File { .. } => 4,
        }
    }

    /// The file (or folder of temporary files) that the error is about.
    pub fn file(&self) -> &std::path::Path {
        match self {
            Self::Read { file, .. } | Self::Line { file, .. } | Self::File { file, .. } => file,
            Self::Spool { folder, .. } => folder,
        }
    }

    pub(crate) fn line(
        file: &std::path::Path,
        line: usize,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::Line { file: file.into(), line, what: what.into(), remedy: remedy.into() }
    }

    pub(crate) fn whole(
        file: &std::path::Path,
        what: impl Into<String>,
        remedy: impl Into<String>,
    ) -> Self {
        Self::File { file: file.into(), what: what.into(), remedy: remedy.into() }
    }

    pub(crate) fn read(file: &std::path::Path, source: std::io::Error) -> Self {
        let remedy = match source.kind() {
            std::io::ErrorKind::NotFound => "check the path (files named in a scene file are \
                 looked for relative to it)"
                .into(),
            std::io::ErrorKind::PermissionDenied => "check the file's permissions".into(),
            std::io::ErrorKind::InvalidData | std::io::ErrorKind::UnexpectedEof => {
                "the file is damaged or cut short: fetch or write it again".into()
            }
            _ => "check the file and the disk".to_string(),
        };
        Self::Read { file: file.into(), source, remedy }
    }
}

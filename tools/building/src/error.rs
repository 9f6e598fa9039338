//! What can go wrong when a building is written.

use std::path::PathBuf;

/// Why no building was written.
#[derive(Debug, thiserror::Error)]
pub enum BuildingError {
    /// The number of floors is outside what this kind of building has.
    #[error("a {kind} has 1 to {most} floors, not {floors}; choose another --floors")]
    Floors {
        /// Kind of building.
        kind: &'static str,
        /// Floors asked for.
        floors: u32,
        /// Most floors possible.
        most: u32,
    },
    /// The kind of building is unknown.
    #[error("no building is called `{0}`; there are: l-shape, z-building, octagon, tower")]
    Kind(String),
    /// One OBJ would be too large for anybody to read.
    #[error(
        "{triangles} triangles are too many for one OBJ file (at most {most}); \
         choose fewer --floors, or --format scene, which places meshes instead of copying them"
    )]
    Large {
        /// Triangles of the building.
        triangles: u64,
        /// The most that are written.
        most: u64,
    },
    /// The output path names no file.
    #[error("{0}: not a file name to write a scene to; give one such as scene.toml")]
    Path(PathBuf),
    /// A file or folder could not be written.
    #[error("{path}: {doing} failed: {source}; check the folder's permissions and free space")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// What was being done to it.
        doing: &'static str,
        /// The system's reason.
        source: std::io::Error,
    },
}

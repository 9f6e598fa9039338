//! What can be wrong with a scene that is to be divided into rooms.

use thiserror::Error;

/// The scene cannot be divided into rooms and tiles as asked.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum RoomsError {
    /// Nothing to divide.
    #[error("the scene has no triangles; check that the model's faces were read")]
    Empty,
    /// A vertex is infinite or not a number.
    #[error("triangle {triangle} has a vertex that is not a finite number; repair the model")]
    NotFinite {
        /// Index of the triangle.
        triangle: usize,
    },
    /// Bounds or tolerance are unusable.
    #[error(
        "the scene's {what} cannot be used; bounds must be finite, ordered and hold the triangles"
    )]
    Bounds {
        /// `bounds`, `tolerance` or `hint N`.
        what: String,
    },
    /// More than the on-disk indices can name.
    #[error("{count} {what} are more than a store can number (2^31); divide the model")]
    TooMany {
        /// What is too many.
        what: &'static str,
        /// How many.
        count: usize,
    },
    /// A request that no scene can meet.
    #[error("{0}")]
    Request(&'static str),
    /// Room tiles were asked for that the scene cannot give.
    #[error("room {room} cannot be cut further: {have} of the {wanted} tiles asked for")]
    Tiles {
        /// The room.
        room: u32,
        /// Tiles there are.
        have: u32,
        /// Tiles asked for.
        wanted: u32,
    },
}

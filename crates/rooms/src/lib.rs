//! Rooms of a building.
//!
//! A BSP of the space along the walls gives convex leaves; leaves that see each other through large
//! openings are one room; what is left of a leaf's face when the walls in its plane are taken away
//! is a portal. [`partition()`] does all that; it needs the large triangles only. [`Partition::route`]
//! says which rooms any triangle touches and [`Partition::cut_piece`] cuts big rooms into tiles that
//! fit in memory, so that a scene of any size streams past. [`Partition::tables`] writes the tables of a
//! store, and [`Bsp`] walks a ray through them, leaf by leaf.
#![forbid(unsafe_code)]

mod cells;
mod cluster;
mod clutter;
mod convex;
mod error;
mod hints;
mod merge;
mod openings;
mod partition;
mod pieces;
mod probe;
mod tables;
mod tree;
mod walk;

pub use cells::Cells;
pub use error::RoomsError;
pub use partition::{Partition, partition};
pub use pieces::{Piece, Scratch, Start};
pub use walk::{Bsp, Exit, Malformed};

use enf_layout::bsp::{FaceRecord, LeafRecord, NodeRecord, PlaneRecord};
use enf_layout::room::{PortalPieceRecord, PortalRecord, RoomRecord, TileRecord};

/// How many rooms are wanted (the outside not counted).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum RoomCount {
    /// As many as the walls make.
    #[default]
    Auto,
    /// So many, by merging the largest openings or by virtual walls; 1 puts everything, the outside
    /// included, in one room.
    Exactly(u32),
}

/// What the user calls a room: a footprint, from its floor to its ceiling.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Hint {
    /// Lower corner of its box, m. Of `min` and `max`, only z counts when there is a polygon.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
    /// Its footprint in x and y, m: a simple polygon of at least three corners, either way round, that need not
    /// be convex. Empty: the footprint of the box.
    pub polygon: Vec<[f32; 2]>,
}

/// What [`partition()`] needs to know besides the triangles.
#[derive(Clone, Debug)]
pub struct Options {
    /// The scene's tolerance δ, m.
    pub delta: f32,
    /// Lower corner of the scene's bounds, m. The root box is the bounds, grown by the larger of 1 m
    /// and 2 % of its diagonal.
    pub bounds_min: [f32; 3],
    /// Upper corner.
    pub bounds_max: [f32; 3],
    /// How many rooms.
    pub rooms: RoomCount,
    /// What the user calls rooms; may be empty. Where two overlap, the first one counts.
    pub hints: Vec<Hint>,
}

/// How far rooms are cut into tiles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TileLimit {
    /// Until no tile stores more triangles than this.
    Triangles(u64),
    /// By random oblique planes through the contents, until there are so many tiles (for tests: the
    /// results must not change).
    Random {
        /// Tiles wanted in the whole scene.
        tiles: u32,
        /// Which planes.
        seed: u64,
    },
}

/// The tables of a partition, as a store holds them.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tables {
    /// Planes.
    pub planes: Vec<PlaneRecord>,
    /// Inner nodes of the BSP.
    pub nodes: Vec<NodeRecord>,
    /// Its leaves.
    pub leaves: Vec<LeafRecord>,
    /// Their faces.
    pub faces: Vec<FaceRecord>,
    /// Rooms: by height of their floor, then x, then y; the outside last.
    pub rooms: Vec<RoomRecord>,
    /// Portals, sorted by (room, other).
    pub portals: Vec<PortalRecord>,
    /// Their convex pieces.
    pub pieces: Vec<PortalPieceRecord>,
    /// Tiles, sorted by room. `mesh_bytes`, `first_light` and `light_count` are left zero; see
    /// [`Partition::tables`] for `triangles`.
    pub tiles: Vec<TileRecord>,
    /// Where each tile's triangles start in `tile_triangles`; one entry more than tiles. Only for scenes in
    /// memory: [`Partition::finish`].
    pub tile_offsets: Vec<u64>,
    /// Indices of the triangles of each tile, ascending.
    pub tile_triangles: Vec<u32>,
    /// The outside's room id.
    pub outside: Option<u32>,
}

//! Rooms, portals, tiles and views.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Facts about the whole scene.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct SceneRecord {
    /// What was subtracted from the input's coordinates before rounding to `f32`, m.
    pub origin: [f64; 3],
    /// Lower corner of the box of all triangles and point lights, m. Light escapes at the BSP's root box,
    /// which is this one grown by the larger of 1 m and 2 % of its diagonal.
    pub bounds_min: [f64; 3],
    /// Upper corner.
    pub bounds_max: [f64; 3],
    /// The tolerance delta of the partition and of every intersection, m (see ARCHITECTURE.md).
    pub delta: f32,
    /// Zero.
    pub reserved: u32,
    /// Triangles of the scene, each once.
    pub triangles: u64,
    /// Triangles stored, with the copies in neighbouring tiles.
    pub stored_triangles: u64,
    /// Hash of the scene's triangles: sum modulo 2^128 of a 128-bit hash each (geometry digest).
    pub geometry_digest: [u8; 16],
    /// Rooms, the outside included when there is one.
    pub rooms: u32,
    /// The outside's room id, or [`crate::NONE`].
    pub outside: u32,
    /// Most bytes that one tile needs resident: mesh and estimated grid.
    pub largest_tile_bytes: u64,
}
const _: () = assert!(size_of::<SceneRecord>() == 128);

/// One room.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct RoomRecord {
    /// Lower corner of the union of its leaves, m.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
    /// A point in the room, about 1.6 m above its floor where it has that height, away from walls.
    pub inside: [f32; 3],
    /// Volume of its leaves without solid ones, m³.
    pub volume_m3: f32,
    /// Floor area: area of the room's horizontal cross-section at `inside`, m².
    pub floor_area_m2: f32,
    /// [`crate::bsp::LEAF_OUTSIDE`] for the outside.
    pub flags: u32,
    /// Triangles whose centroid lies in the room (each triangle of the scene in just one).
    pub triangles: u64,
    /// First of its portals in the list of [`PortalRecord`]s sorted by (room, other).
    pub first_portal: u32,
    /// Number of them.
    pub portal_count: u32,
    /// First of its tiles (a room's tiles are consecutive).
    pub first_tile: u32,
    /// Number of them.
    pub tile_count: u32,
}
const _: () = assert!(size_of::<RoomRecord>() == 72);

/// An opening from one room to another: pieces that touch each other. Each opening is listed twice, once
/// from either side; two rooms may share several.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PortalRecord {
    /// Room it leads out of.
    pub room: u32,
    /// Room it leads into.
    pub other: u32,
    /// First of its convex pieces.
    pub first_piece: u32,
    /// Number of pieces.
    pub piece_count: u32,
    /// Open area (leaf faces minus the walls in their plane), m².
    pub area_m2: f32,
    /// Centroid of the open area, m.
    pub centre: [f32; 3],
}
const _: () = assert!(size_of::<PortalRecord>() == 32);

/// Most corners of a portal piece.
pub const PIECE_CORNERS: usize = 8;

/// A convex planar piece of a portal, counter-clockwise seen from inside [`PortalRecord::room`], so that
/// its normal points into that room.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PortalPieceRecord {
    /// Corners, m; only the first `count` are used.
    pub corners: [[f32; 3]; PIECE_CORNERS],
    /// Number of corners, 3 to 8 (a piece with more is cut).
    pub count: u32,
    /// Area, m².
    pub area_m2: f32,
    /// Zero.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<PortalPieceRecord>() == 112);

/// What is resident at once: a room, or a piece of one.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct TileRecord {
    /// Room it is a piece of.
    pub room: u32,
    /// First of the lights that may have a start point in it (`TileLights` extent).
    pub first_light: u32,
    /// Number of them.
    pub light_count: u32,
    /// Zero.
    pub reserved: u32,
    /// Triangles stored for it, copies included.
    pub triangles: u64,
    /// Bytes of its mesh, inflated.
    pub mesh_bytes: u64,
    /// Lower corner of the box of its leaves, m.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
}
const _: () = assert!(size_of::<TileRecord>() == 56);

/// A camera from the scene file.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct ViewRecord {
    /// Eye, m, in store coordinates (scene origin subtracted).
    pub eye: [f32; 3],
    /// Point looked at.
    pub target: [f32; 3],
    /// Up direction.
    pub up: [f32; 3],
    /// Vertical field of view, degrees; of a plan, the height of what it shows, m (0 = all).
    pub fov_degrees: f32,
    /// Picture width, pixels; 0 = default.
    pub width: u32,
    /// Picture height, pixels; 0 = default.
    pub height: u32,
}
const _: () = assert!(size_of::<ViewRecord>() == 48);

//! The BSP of the space: planes, nodes, convex leaves and their faces (Fradin et al. 2005, section 4.1, with
//! automatic cells instead of a modeler's).
//!
//! Half-space convention: a point `p` is in *front* of a plane when `normal·p - offset > 0`; exactly
//! on it counts as front.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// A plane `normal·p = offset`, with a unit normal; metres.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PlaneRecord {
    /// Unit normal.
    pub normal: [f64; 3],
    /// Signed distance of the plane from the origin along the normal, m.
    pub offset: f64,
}

/// Bit that marks a [`NodeRecord`] child as a leaf index.
pub const LEAF: u32 = 1 << 31;

/// An inner node. Children with [`LEAF`] set are leaf indices, others node indices.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct NodeRecord {
    /// Splitting plane.
    pub plane: u32,
    /// Child in front of it.
    pub front: u32,
    /// Child behind it.
    pub back: u32,
    /// 0: splits rooms (the base tree); 1: a tile cut below a leaf of the base tree.
    pub cut: u32,
}

/// The leaf lies inside solid matter (a wall between two sheets); it carries a room's number only so
/// that it is resident with it.
pub const LEAF_SOLID: u32 = 1;
/// The leaf belongs to the outside room.
pub const LEAF_OUTSIDE: u32 = 2;

/// A convex cell.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LeafRecord {
    /// Room that the cell belongs to.
    pub room: u32,
    /// Tile that holds its triangles.
    pub tile: u32,
    /// First of its [`FaceRecord`]s.
    pub first_face: u32,
    /// Number of faces.
    pub face_count: u32,
    /// [`LEAF_SOLID`], [`LEAF_OUTSIDE`].
    pub flags: u32,
    /// Zero.
    pub reserved: u32,
}

/// Bit in [`FaceRecord::plane`]: the leaf lies in front of the plane (its outward normal is the
/// plane's, negated).
pub const FACE_IN_FRONT: u32 = 1 << 31;

/// One bounding half-space of a leaf; redundant ones are left out.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct FaceRecord {
    /// Plane index, with [`FACE_IN_FRONT`].
    pub plane: u32,
    /// What is on the far side: the *child reference* (node index, or leaf index with [`LEAF`]) of the
    /// sibling subtree; [`crate::NONE`] at the scene's bound, where light escapes.
    pub beyond: u32,
}

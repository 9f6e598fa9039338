//! A tile's bounding volume hierarchy, eight children wide: a [`crate::sections`] blob with the sections
//! below, in this order.
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_HEADER`] | [`BvhHeader`] | one |
//! | [`SECTION_NODES`] | [`BvhNode`] | node 0 is the root; a node's inner children follow each other, after it |
//! | [`SECTION_REFERENCES`] | `u32` | triangles of the tile (indices into its mesh), each once, leaf by leaf |
//!
//! Boxes are quantised to eight bits in the frame of their node, outwards (Ylitie, Karras and Laine 2017,
//! *Efficient incoherent ray traversal on GPUs through compressed wide BVHs*): ten bytes a child.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Header.
pub const SECTION_HEADER: usize = 0;
/// Nodes.
pub const SECTION_NODES: usize = 1;
/// References.
pub const SECTION_REFERENCES: usize = 2;
/// Number of sections.
pub const SECTIONS: usize = 3;

/// Children of a node, at most.
pub const WIDTH: usize = 8;
/// Triangles of a leaf, at most.
pub const LEAF_TRIANGLES: usize = 4;
/// Nodes on a way from the root to a leaf, at most.
pub const DEPTH: usize = 64;

/// In [`BvhNode::child`]: an inner node; the low three bits count the inner children before it.
pub const CHILD_INNER: u8 = 0x80;
/// In [`BvhNode::child`]: nothing. Other values without [`CHILD_INNER`] are leaves: bits 5 and 6 hold the number
/// of triangles less one, bits 0 to 4 the first reference, counted from [`BvhNode::references`].
pub const CHILD_NONE: u8 = 0xff;

/// What a hierarchy is made of.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct BvhHeader {
    /// Lower corner of the mesh's box and four tolerances, m.
    pub min: [f32; 3],
    /// Upper corner.
    pub max: [f32; 3],
    /// Tolerance that it was built for, m.
    pub delta: f32,
    /// Triangles of the mesh.
    pub triangles: u32,
}
const _: () = assert!(size_of::<BvhHeader>() == 32);

/// A node and the boxes of its children.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct BvhNode {
    /// Where the quantised coordinates begin, m.
    pub origin: [f32; 3],
    /// A step of the quantised coordinates along each axis is `2^(exponent - 127)` m.
    pub exponent: [u8; 3],
    /// Which of the children are something, a bit each.
    pub used: u8,
    /// The first inner child.
    pub nodes: u32,
    /// The first reference of the leaves among the children.
    pub references: u32,
    /// What each child is: [`CHILD_INNER`], [`CHILD_NONE`], or a leaf.
    pub child: [u8; WIDTH],
    /// Lower corners (rounded down, x, y, z), then upper corners (rounded up) of the children's boxes, each grown by
    /// four tolerances. A child that is nothing has lower above upper.
    pub bounds: [[u8; WIDTH]; 6],
}
const _: () = assert!(size_of::<BvhNode>() == 80);

//! A tile's bounding volume hierarchy, eight children wide: a [`crate::sections`] blob with the sections
//! below, in this order.
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_HEADER`] | [`BvhHeader`] | one |
//! | [`SECTION_NODES`] | [`BvhNode`] | node 0 is the root; a node's inner children follow each other, after it |
//! | [`SECTION_BLOCKS`] | [`LeafBlock`] | one for each leaf |
//!
//! What a mesh can tell is not stored: of nodes only [`BvhNode::child`], of blocks only which triangles of the tile they hold; the
//! rest is zero. Whoever loads a hierarchy walks through it once, and finds corners, boxes and indices again. For this,
//! node 0 is visited first; the inner children of the node that is visited are the next nodes, its leaves the next blocks, in the
//! order of their slots; then its inner children are visited in this order, each with all that is below it.
//!
//! Boxes are quantised to eight bits in the frame of their node, outwards (Ylitie, Karras and Laine 2017,
//! *Efficient incoherent ray traversal on GPUs through compressed wide BVHs*): ten bytes a child.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Header.
pub const SECTION_HEADER: usize = 0;
/// Nodes.
pub const SECTION_NODES: usize = 1;
/// Blocks of triangles.
pub const SECTION_BLOCKS: usize = 2;
/// Number of sections.
pub const SECTIONS: usize = 3;

/// In [`LeafBlock::global`]: a lane that holds nothing.
pub const NO_TRIANGLE: u32 = u32::MAX;

/// Children of a node, at most.
pub const WIDTH: usize = 8;
/// Triangles of a leaf, at most.
pub const LEAF_TRIANGLES: usize = 4;
/// Nodes on a way from the root to a leaf, at most.
pub const DEPTH: usize = 64;

/// In [`BvhNode::child`]: an inner node; the low three bits count the inner children before it.
pub const CHILD_INNER: u8 = 0x80;
/// In [`BvhNode::child`]: nothing. Other values without [`CHILD_INNER`] are leaves: bits 5 and 6 hold the number
/// of triangles less one, bits 0 to 2 the block, counted from [`BvhNode::blocks`].
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

/// A node and the boxes of its children. In a store, everything but [`BvhNode::child`] is zero.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct BvhNode {
    /// Where the quantised coordinates begin, m.
    pub origin: [f32; 3],
    /// Their step along each axis, m: a power of two.
    pub step: [f32; 3],
    /// The first inner child.
    pub nodes: u32,
    /// The first block of the leaves among the children.
    pub blocks: u32,
    /// What each child is: [`CHILD_INNER`], [`CHILD_NONE`], or a leaf. In a store, without the low three bits.
    pub child: [u8; WIDTH],
    /// Along each axis, the lower ends of the children's boxes (rounded down), then their upper ends (rounded up); each box
    /// was grown by four tolerances. A child that is nothing has lower above upper.
    pub bounds: [[u8; 2 * WIDTH]; 3],
    /// Which of the children are something, a bit each.
    pub used: u32,
    /// Zero.
    pub reserved: u32,
}
const _: () = assert!(size_of::<BvhNode>() == 96);

/// Up to [`LEAF_TRIANGLES`] triangles as a vector unit likes them: everything that a ray, and who looks at what it hit,
/// wants to know.
///
/// In a store, only `global` is not zero: the triangle's index in its tile as the difference `d` from the lane before (from 0 in the first
/// lane of all), modulo 2^32, in zigzag: `(d << 1) ^ (d >> 31)`, the second shift arithmetic. Lanes that hold nothing
/// have difference 0.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LeafBlock {
    /// Corner, axis, lane: coordinates, m.
    pub corners: [[[f32; LEAF_TRIANGLES]; 3]; 3],
    /// Index in the scene; [`NO_TRIANGLE`] where a block has fewer triangles.
    pub global: [u32; LEAF_TRIANGLES],
    /// Material.
    pub material: [u32; LEAF_TRIANGLES],
}
const _: () = assert!(size_of::<LeafBlock>() == 176);

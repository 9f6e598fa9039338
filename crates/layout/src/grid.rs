//! A tile's uniform grid, kept in bricks, with finer bricks in its crowded cells: a [`crate::sections`] blob with
//! the sections below, in this order.
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_HEADER`] | [`GridHeader`] | one |
//! | [`SECTION_BRICKS`] | [`BrickRecord`] | bricks, x fastest, then y, then z; then those inside of crowded cells, in the order of these |
//! | [`SECTION_STARTS`] | `u32` | first reference of each occupied cell (bricks in order, cells by bit), then the end |
//! | [`SECTION_REFERENCES`] | `u32` | triangles of the tile (indices into its mesh), ascending in each cell; a crowded cell has [`FINER`] with the brick that divides it, alone |

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Header.
pub const SECTION_HEADER: usize = 0;
/// Bricks.
pub const SECTION_BRICKS: usize = 1;
/// First references.
pub const SECTION_STARTS: usize = 2;
/// References.
pub const SECTION_REFERENCES: usize = 3;
/// Number of sections.
pub const SECTIONS: usize = 4;

/// Cells along an edge of a brick.
pub const BRICK: u32 = 4;
/// Marks a reference to a brick, which divides the cell into 4 x 4 x 4 smaller ones. Those are not divided again.
pub const FINER: u32 = 1 << 31;

/// What a grid is made of.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct GridHeader {
    /// Lower corner of cell (0, 0, 0), m: the mesh's box and four tolerances.
    pub min: [f32; 3],
    /// Upper corner of the mesh's box and four tolerances, m. The last bricks may reach beyond.
    pub max: [f32; 3],
    /// Edge of a cell, m.
    pub cell: f32,
    /// Tolerance that it was built for, m.
    pub delta: f32,
    /// Bricks along x, y and z, those inside of cells not counted.
    pub bricks: [u32; 3],
    /// Triangles of the mesh.
    pub triangles: u32,
    /// Cells with at least one triangle, of all bricks.
    pub cells: u32,
    /// References in all cells.
    pub references: u32,
}
const _: () = assert!(size_of::<GridHeader>() == 56);

/// 4 x 4 x 4 cells.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct BrickRecord {
    /// Which cells have triangles: bit `x + 4 y + 16 z` of the 64, low word first.
    pub mask: [u32; 2],
    /// Number of occupied cells in the bricks before it.
    pub first: u32,
}
const _: () = assert!(size_of::<BrickRecord>() == 12);

impl BrickRecord {
    /// The mask as one word.
    #[inline(always)]
    pub fn mask(self) -> u64 {
        u64::from(self.mask[0]) | u64::from(self.mask[1]) << 32
    }
}

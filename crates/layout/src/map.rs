//! A room's photon map: a [`crate::sections`] blob.
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_HEADER`] | [`MapHeader`] | counts |
//! | [`SECTION_TREE`] | [`crate::photon::PhotonRecord`] | left-balanced kd-tree in heap order (children of `i` at `2i+1`, `2i+2`), halo photons included |

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Header.
pub const SECTION_HEADER: usize = 0;
/// Tree.
pub const SECTION_TREE: usize = 1;
/// Number of sections.
pub const SECTIONS: usize = 2;

/// What the map was built with.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MapHeader {
    /// Photons in the tree.
    pub photons: u64,
    /// How many of them are a neighbour's.
    pub halo: u64,
    /// Halo width = largest gather radius the map is complete for, m.
    pub radius: f32,
    /// Zero.
    pub reserved: u32,
}
const _: () = assert!(size_of::<MapHeader>() == 24);

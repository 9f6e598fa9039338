//! A room's photon map: one [`crate::sections`] blob, or several of them (pieces) where a room has many photons.
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_HEADER`] | [`MapHeader`] | counts |
//! | [`SECTION_BLOCKS`] | [`MapBlock`] | the photons, sixteen neighbours at a time, halo photons included |
//! | [`SECTION_NODES`] | [`MapNode`] | boxes about eight blocks each, then about eight of those each, and so on up to one root |
//!
//! Nothing points anywhere: children of node `i` of a level are `8 i` to `8 i + 7` of the level below, and the lowest
//! level's are blocks.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

use crate::photon::PhotonRecord;

/// Header.
pub const SECTION_HEADER: usize = 0;
/// Blocks.
pub const SECTION_BLOCKS: usize = 1;
/// Nodes, the lowest level first.
pub const SECTION_NODES: usize = 2;
/// Number of sections.
pub const SECTIONS: usize = 3;

/// Photons of a block.
pub const BLOCK_PHOTONS: usize = 16;
/// Children of a node.
pub const NODE_CHILDREN: usize = 8;
/// Most photons of a piece. A room with more has several.
pub const PIECE_PHOTONS: usize = 1 << 19;
/// The coordinate of a place in a block where no photon is: a number that is none.
pub const NO_PHOTON: u32 = 0x7fc0_0000;

/// What the piece was built with.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MapHeader {
    /// Photons in the piece.
    pub photons: u64,
    /// How many of them are a neighbour's.
    pub halo: u64,
    /// Halo width = largest gather radius the map is complete for, m.
    pub radius: f32,
    /// Which piece of the room's map, from 0.
    pub piece: u32,
    /// Pieces of the room's map.
    pub pieces: u32,
    /// Zero.
    pub reserved: u32,
}
const _: () = assert!(size_of::<MapHeader>() == 32);

/// Sixteen photons, field by field. In the last block of a piece some may be missing: [`NO_PHOTON`] is their
/// position, everything else of them is zero.
#[derive(
    Clone, Copy, Debug, Default, PartialEq, Eq, FromBytes, IntoBytes, Immutable, KnownLayout,
)]
#[repr(C)]
pub struct MapBlock {
    /// World positions, m (bits of `f32`): all x, all y, all z.
    pub position_bits: [[u32; BLOCK_PHOTONS]; 3],
    /// Incoming flux, W: [`crate::rgbe`].
    pub flux: [[u8; 4]; BLOCK_PHOTONS],
    /// Direction of travel ([`crate::octahedral`]) in bits 0 to 23, the lower half of the flags above.
    pub direction_flags: [u32; BLOCK_PHOTONS],
    /// Geometric normal on the side that was hit, likewise, and the upper half of the flags above.
    pub normal_flags: [u32; BLOCK_PHOTONS],
}
const _: () = assert!(size_of::<MapBlock>() == BLOCK_PHOTONS * size_of::<PhotonRecord>());

impl MapBlock {
    /// The photon at place `i` as it was stored, halo flag and all.
    ///
    /// # Panics
    /// If `i` is 16 or more.
    pub fn photon(&self, i: usize) -> PhotonRecord {
        let [d0, d1, d2, low] = self.direction_flags[i].to_le_bytes();
        let [n0, n1, n2, high] = self.normal_flags[i].to_le_bytes();
        PhotonRecord {
            position_bits: self.position_bits.map(|axis| axis[i]),
            flux: self.flux[i],
            directions: [d0, d1, d2, n0, n1, n2],
            flags: u16::from_le_bytes([low, high]),
        }
    }

    /// Puts a photon at place `i`.
    ///
    /// # Panics
    /// If `i` is 16 or more.
    #[inline]
    pub fn set(&mut self, i: usize, photon: &PhotonRecord) {
        let [d0, d1, d2, n0, n1, n2] = photon.directions;
        let [low, high] = photon.flags.to_le_bytes();
        let codes = u64::from_le_bytes([d0, d1, d2, n0, n1, n2, low, high]);
        for (axis, &bits) in self.position_bits.iter_mut().zip(&photon.position_bits) {
            axis[i] = bits;
        }
        self.flux[i] = photon.flux;
        let code = |from: u32, flags: u32| {
            (codes >> from) as u32 & 0xff_ffff | (codes >> flags << 24) as u32
        };
        self.direction_flags[i] = code(0, 48);
        self.normal_flags[i] = code(24, 56);
    }
}

/// The boxes about eight children. A child that does not exist, or has no photon at a place that is a number, has
/// the box from `f32::MAX` to `f32::MIN`.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MapNode {
    /// Lower corners, m: all x, all y, all z.
    pub min: [[f32; NODE_CHILDREN]; 3],
    /// Upper corners, m.
    pub max: [[f32; NODE_CHILDREN]; 3],
}
const _: () = assert!(size_of::<MapNode>() == 192);

/// Nodes above so many blocks, level by level: `level` is called with the number of each, the lowest first.
pub fn node_levels(blocks: usize, mut level: impl FnMut(usize)) {
    let mut below = blocks;
    while below > 0 {
        below = below.div_ceil(NODE_CHILDREN);
        level(below);
        if below == 1 {
            break;
        }
    }
}

/// Nodes above so many blocks, all levels together.
pub fn node_count(blocks: usize) -> usize {
    let mut sum = 0;
    node_levels(blocks, |n| sum += n);
    sum
}

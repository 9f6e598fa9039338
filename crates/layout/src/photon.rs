//! A stored photon: one impact on a non-specular surface, 24 bytes (Jensen 2001, section 4.3, with an
//! octahedral direction and the surface's normal instead of angles).

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The photon came straight from its light, or through thin panes only.
pub const PHOTON_DIRECT: u16 = 1 << 2;
/// The photon came from its light over mirrors, gloss, panes or solid glass only, and not through panes alone.
pub const PHOTON_CAUSTIC: u16 = 1 << 3;
/// The impact was on the clockwise (back) side of its triangle.
pub const PHOTON_BACK_SIDE: u16 = 1 << 4;
/// In a map: the photon belongs to a neighbouring room (halo).
pub const PHOTON_HALO: u16 = 1 << 5;

/// One impact.
#[derive(
    Clone,
    Copy,
    Debug,
    Default,
    PartialEq,
    Eq,
    PartialOrd,
    Ord,
    FromBytes,
    IntoBytes,
    Immutable,
    KnownLayout,
)]
#[repr(C)]
pub struct PhotonRecord {
    /// World position, m (bits of `f32`, so that records order and compare bytewise).
    pub position_bits: [u32; 3],
    /// Incoming flux, W: [`crate::rgbe`], rounded stochastically by the photon's own counter. Below a gloss, times
    /// how much of it the gloss lets through, compared with light from all around: the same in even light.
    pub flux: [u8; 4],
    /// Direction of travel ([`crate::octahedral`], 12 + 12 bits), then the geometric normal on the side
    /// that was hit, likewise.
    pub directions: [u8; 6],
    /// `PHOTON_*`.
    pub flags: u16,
}
const _: () = assert!(size_of::<PhotonRecord>() == 24);

impl PhotonRecord {
    /// World position, m.
    pub fn position(&self) -> [f32; 3] {
        self.position_bits.map(f32::from_bits)
    }

    /// Incoming flux, W, linear Rec.709.
    pub fn flux_w(&self) -> [f32; 3] {
        crate::rgbe::decode(self.flux)
    }

    /// Unit direction of travel.
    pub fn direction(&self) -> [f32; 3] {
        let d = &self.directions;
        crate::octahedral::decode(u32::from(d[0]) | u32::from(d[1]) << 8 | u32::from(d[2]) << 16)
    }

    /// Unit geometric normal on the side that was hit.
    pub fn normal(&self) -> [f32; 3] {
        let d = &self.directions;
        crate::octahedral::decode(u32::from(d[3]) | u32::from(d[4]) << 8 | u32::from(d[5]) << 16)
    }

    /// Packs two octahedral codes of 24 bits.
    pub fn pack_directions(direction: u32, normal: u32) -> [u8; 6] {
        let (d, n) = (direction.to_le_bytes(), normal.to_le_bytes());
        [d[0], d[1], d[2], n[0], n[1], n[2]]
    }
}

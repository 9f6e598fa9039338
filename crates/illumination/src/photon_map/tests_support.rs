//! Photons and portals for tests.

use enf_layout::octahedral;
use enf_layout::photon::PhotonRecord;
use enf_layout::rgbe;
use enf_layout::room::{PortalPieceRecord, PortalRecord};
use glam::Vec3;
use proptest::prelude::*;
use zerocopy::FromBytes;

/// A small generator: the tests need no better one.
pub(crate) struct Random(pub(crate) u64);

impl Random {
    pub(crate) fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 40) as f32 / 16_777_216.0
    }
}

/// A photon of `flux` W that fell along `direction` on a surface with `normal`.
pub(crate) fn impact(
    position: Vec3,
    direction: Vec3,
    normal: Vec3,
    flux: [f32; 3],
) -> PhotonRecord {
    let code = |v: Vec3| octahedral::encode(v.normalize().to_array());
    PhotonRecord {
        position_bits: position.to_array().map(f32::to_bits),
        flux: rgbe::encode(flux, [0.5; 3]),
        directions: PhotonRecord::pack_directions(code(direction), code(normal)),
        flags: 0,
    }
}

/// Photons on the inner surfaces of a 4 x 3 x 3 m box.
pub(crate) fn shuffled(n: usize, seed: u64) -> Vec<PhotonRecord> {
    let mut r = Random(seed);
    let size = Vec3::new(4.0, 3.0, 3.0);
    (0..n)
        .map(|_| {
            let mut at = Vec3::new(r.next(), r.next(), r.next());
            let side = (r.next() * 6.0) as usize;
            let (axis, high) = (side % 3, side >= 3);
            at[axis] = if high { 1.0 } else { 0.0 };
            let mut normal = Vec3::ZERO;
            normal[axis] = if high { -1.0 } else { 1.0 };
            let spread = Vec3::new(r.next() - 0.5, r.next() - 0.5, r.next() - 0.5);
            let flux = [0.001 + r.next() * 0.01, r.next() * 0.01, r.next() * 0.02];
            impact(at * size, spread - normal, normal, flux)
        })
        .collect()
}

/// Any 24 bytes.
pub(crate) fn any_photon() -> impl Strategy<Value = PhotonRecord> {
    any::<[u8; 24]>().prop_map(|bytes| PhotonRecord::read_from_bytes(&bytes).unwrap())
}

/// Photons with many equal coordinates, equal records and both zeros.
pub(crate) fn coarse_photon() -> impl Strategy<Value = PhotonRecord> {
    let coordinate = || prop::sample::select(vec![-1.0f32, -0.5, -0.0, 0.0, 0.25, 0.5, 1.0]);
    let fluxes =
        prop::sample::select(vec![[1.0f32, 0.5, 0.25], [1e-6, 1e-5, 1e-4], [3.0, 0.0, 0.0]]);
    let normals = prop::sample::select(vec![Vec3::Z, -Vec3::Z, Vec3::X, Vec3::new(0.2, 0.1, 1.0)]);
    let directions = prop::sample::select(vec![-Vec3::Z, Vec3::new(0.5, 0.1, -0.7), Vec3::Z]);
    (coordinate(), coordinate(), coordinate(), fluxes, normals, directions).prop_map(
        |(x, y, z, flux, normal, direction)| impact(Vec3::new(x, y, z), direction, normal, flux),
    )
}

/// One portal from room 0 to room 1 with one piece.
pub(crate) fn opening(corners: &[[f32; 3]]) -> (Vec<PortalRecord>, Vec<PortalPieceRecord>) {
    let mut piece =
        PortalPieceRecord { corners: [[0.0; 3]; 8], count: 0, area_m2: 0.0, reserved: [0; 2] };
    piece.corners[..corners.len()].copy_from_slice(corners);
    piece.count = corners.len() as u32;
    let portal = PortalRecord {
        room: 0,
        other: 1,
        first_piece: 0,
        piece_count: 1,
        area_m2: 0.0,
        centre: [0.0; 3],
    };
    (vec![portal], vec![piece])
}

/// A door of 1 x 2 m in the plane x = 2: y from 1 to 2, z from 0 to 2.
pub(crate) fn door() -> (Vec<PortalRecord>, Vec<PortalPieceRecord>) {
    opening(&[[2.0, 1.0, 0.0], [2.0, 2.0, 0.0], [2.0, 2.0, 2.0], [2.0, 1.0, 2.0]])
}

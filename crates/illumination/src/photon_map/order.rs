//! The canonical order of photons: their bytes, as they lie in memory.
//!
//! It means nothing in space, and that is the point: it is total, it needs no arithmetic, and equal
//! photons are equal in every bit, so that it never matters which of the two came first.

use std::cmp::Ordering;

use enf_layout::photon::{PHOTON_HALO, PhotonRecord};

/// The record's 24 bytes as three big-endian words, which compare as the bytes do.
#[inline]
fn key(p: &PhotonRecord) -> [u64; 3] {
    let [x, y, z] = p.position_bits.map(|w| u64::from(w.swap_bytes()));
    let [d0, d1, d2, d3, d4, d5] = p.directions;
    let [f0, f1] = p.flags.to_le_bytes();
    [
        x << 32 | y,
        z << 32 | u64::from(u32::from_be_bytes(p.flux)),
        u64::from_be_bytes([d0, d1, d2, d3, d4, d5, f0, f1]),
    ]
}

/// The first eight bytes, of which photons that differ mostly differ in some.
#[inline]
pub(crate) fn canonical_start(p: &PhotonRecord) -> u64 {
    key(p)[0]
}

/// Bytewise comparison of two records.
#[inline]
pub(crate) fn canonical_cmp(a: &PhotonRecord, b: &PhotonRecord) -> Ordering {
    key(a).cmp(&key(b))
}

/// Like [`canonical_cmp`], blind to what a map adds to a record (halo): the order of the
/// photons as they were stored, whichever map they are looked up in.
pub(crate) fn stored_cmp(a: &PhotonRecord, b: &PhotonRecord) -> Ordering {
    let stored = |p: &PhotonRecord| key(&PhotonRecord { flags: p.flags & !PHOTON_HALO, ..*p });
    stored(a).cmp(&stored(b))
}

/// Sorts photons into canonical order: ascending by the bytes of the 24-byte record in memory order.
/// In place, no allocation.
pub fn canonical_sort(photons: &mut [PhotonRecord]) {
    photons.sort_unstable_by(canonical_cmp);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::tests_support::any_photon;
    use proptest::prelude::*;
    use zerocopy::IntoBytes;

    proptest! {
        #[test]
        fn order_is_that_of_the_bytes(a in any_photon(), b in any_photon()) {
            prop_assert_eq!(canonical_cmp(&a, &b), a.as_bytes().cmp(b.as_bytes()));
        }

        #[test]
        fn stored_order_ignores_halo(a in any_photon(), halo: bool) {
            let mut b = a;
            b.flags &= !PHOTON_HALO;
            b.flags |= if halo { PHOTON_HALO } else { 0 };
            prop_assert_eq!(stored_cmp(&a, &b), Ordering::Equal);
        }

        #[test]
        fn sorting_sorts_bytes(mut v in proptest::collection::vec(any_photon(), 0..200)) {
            let mut bytes: Vec<_> = v.iter().map(|p| p.as_bytes().to_vec()).collect();
            bytes.sort();
            canonical_sort(&mut v);
            prop_assert!(v.iter().zip(&bytes).all(|(p, b)| p.as_bytes() == &b[..]));
        }
    }
}

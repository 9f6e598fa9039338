//! A photon map as bytes: a little header, then the tree.

use enf_layout::map::{MapHeader, SECTION_HEADER, SECTION_TREE, SECTIONS};
use enf_layout::photon::{PHOTON_AXIS_MASK, PHOTON_HALO, PhotonRecord};
use enf_layout::sections::{self, Malformed, Transform};
use zerocopy::IntoBytes;

/// The words of a photon, so that a photon predicts its neighbour in the row.
const STRIDE: u32 = (size_of::<PhotonRecord>() / 4) as u32;

/// A room's photon map, read in place from a blob of [`enf_layout::map`].
#[derive(Clone, Copy, Debug)]
pub struct PhotonMap<'a> {
    tree: &'a [PhotonRecord],
    halo: u64,
    radius: f32,
}

impl<'a> PhotonMap<'a> {
    /// Reads a map from its blob. The blob's start is 8-byte aligned in memory, as every extent is.
    ///
    /// Checks the section table and the header's counts, in constant time. The tree itself is covered
    /// by the store's checksums; [`PhotonMap::check`] looks at every photon.
    ///
    /// # Errors
    /// [`Malformed`] says which count or section is wrong.
    pub fn from_blob(blob: &'a [u8]) -> Result<Self, Malformed> {
        let bad = |what: String| Err(Malformed(format!("photon map: {what}")));
        if !blob.as_ptr().cast::<u64>().is_aligned() {
            return bad("its bytes do not start at a multiple of 8 in memory".into());
        }
        let count = sections::table(blob)?.len();
        if count != SECTIONS {
            return bad(format!("{count} sections instead of {SECTIONS}"));
        }
        let headers: &[MapHeader] = sections::section(blob, SECTION_HEADER)?;
        let [header] = headers else {
            return bad(format!("{} headers instead of one", headers.len()));
        };
        let tree: &[PhotonRecord] = sections::section(blob, SECTION_TREE)?;
        if header.photons != tree.len() as u64 {
            return bad(format!(
                "its header counts {} photons, its tree has {}",
                header.photons,
                tree.len()
            ));
        }
        if header.photons > u64::from(u32::MAX) {
            return bad(format!("{} photons are more than {}", header.photons, u32::MAX));
        }
        if header.halo > header.photons {
            return bad(format!("{} halo photons among {}", header.halo, header.photons));
        }
        if header.radius.is_nan() || header.radius <= 0.0 {
            return bad(format!("its halo is {} m wide, not more than 0", header.radius));
        }
        Ok(Self { tree, halo: header.halo, radius: header.radius })
    }

    /// The blob of a tree from [`super::build_tree`] with `halo` photons of neighbours in it, complete
    /// for gathers up to `radius` (m, above 0; infinite for a room without portals).
    pub fn build_blob(tree: &[PhotonRecord], halo: u64, radius: f32) -> Vec<u8> {
        let mut blob = Vec::with_capacity(blob_bytes(tree.len()));
        blob.extend_from_slice(&write_header(tree.len() as u64, halo, radius));
        blob.extend_from_slice(tree.as_bytes());
        blob.resize(blob_bytes(tree.len()), 0);
        blob
    }

    /// Number of photons, halo included.
    pub fn len(&self) -> usize {
        self.tree.len()
    }

    /// Whether there is no photon.
    pub fn is_empty(&self) -> bool {
        self.tree.is_empty()
    }

    /// How many of the photons belong to neighbouring rooms.
    pub fn halo(&self) -> u64 {
        self.halo
    }

    /// Largest gather radius that the map is complete for, m. [`PhotonMap::irradiance`] never looks
    /// farther.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// The photons in heap order.
    pub fn tree(&self) -> &'a [PhotonRecord] {
        self.tree
    }

    /// Looks at every photon: finite positions, the halo's count, and each on its side of every node
    /// above it. Time `n log n`, no memory.
    ///
    /// # Errors
    /// [`Malformed`] names the first photon that is out of place.
    pub fn check(&self) -> Result<(), Malformed> {
        let halo = self.tree.iter().filter(|p| p.flags & PHOTON_HALO != 0).count() as u64;
        if halo != self.halo {
            return Err(Malformed(format!(
                "photon map: {halo} halo photons, its header counts {}",
                self.halo
            )));
        }
        for (i, p) in self.tree.iter().enumerate() {
            let position = p.position();
            if !position.iter().all(|c| c.is_finite()) || axis(p) == 3 {
                return Err(Malformed(format!(
                    "photon map: photon {i} has position {position:?} and axis {}",
                    axis(p)
                )));
            }
            let mut child = i;
            while child > 0 {
                let parent = (child - 1) / 2;
                let node = &self.tree[parent];
                // A parent's own axis was checked before its children's.
                let (at, cut) = (position[axis(node)], node.position()[axis(node)]);
                let left = child == 2 * parent + 1;
                if (left && at > cut) || (!left && at < cut) {
                    return Err(Malformed(format!(
                        "photon map: photon {i} is on the wrong side of photon {parent}"
                    )));
                }
                child = parent;
            }
        }
        Ok(())
    }
}

fn axis(p: &PhotonRecord) -> usize {
    usize::from(p.flags & PHOTON_AXIS_MASK)
}

/// The bytes before the first photon of a map's blob, for writing a big one as a stream: these bytes,
/// then the tree's records, then [`tail_padding`] zeros.
pub fn write_header(photons: u64, halo: u64, radius: f32) -> Vec<u8> {
    let header = MapHeader { photons, halo, radius, reserved: 0 };
    let tree_bytes = photons as usize * size_of::<PhotonRecord>();
    let mut head = vec![0; sections::blob_bytes(&[size_of::<MapHeader>(), 0])];
    let ranges = sections::write_table(
        &mut head,
        &[(size_of::<MapHeader>(), Transform::None, 0), (tree_bytes, Transform::Xor, STRIDE)],
    );
    head[ranges[SECTION_HEADER].clone()].copy_from_slice(header.as_bytes());
    head
}

/// Zero bytes that follow the last of `photons` in a blob.
pub fn tail_padding(photons: usize) -> usize {
    let bytes = photons * size_of::<PhotonRecord>();
    bytes.next_multiple_of(64) - bytes
}

/// Bytes of the blob of a map with this many photons.
pub fn blob_bytes(photons: usize) -> usize {
    sections::blob_bytes(&[size_of::<MapHeader>(), photons * size_of::<PhotonRecord>()])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::build_tree;
    use crate::photon_map::tests_support::shuffled;

    fn tree(n: usize) -> Vec<PhotonRecord> {
        let mut tree = shuffled(n, 3);
        build_tree(&mut tree, &mut vec![PhotonRecord::default(); n], 1);
        tree
    }

    #[test]
    fn blobs_come_back() {
        for n in [0, 1, 7, 8, 1000] {
            let tree = tree(n);
            let blob = PhotonMap::build_blob(&tree, 0, 0.5);
            let map = PhotonMap::from_blob(&blob).unwrap();
            assert_eq!((map.tree(), map.len(), map.halo(), map.radius()), (&tree[..], n, 0, 0.5));
            map.check().unwrap();
            assert_eq!(blob.len() % 64, 0);
            assert_eq!(blob.len(), 128 + n * 24 + tail_padding(n));
            let header = MapHeader { photons: n as u64, halo: 0, radius: 0.5, reserved: 0 };
            let plain = sections::build(&[
                (header.as_bytes(), Transform::None, 0),
                (tree.as_bytes(), Transform::Xor, 6),
            ]);
            assert_eq!(blob, plain);
        }
    }

    #[test]
    fn bad_blobs_are_refused() {
        let tree = tree(10);
        let good = PhotonMap::build_blob(&tree, 3, 0.5);
        assert!(PhotonMap::from_blob(&good).is_ok());
        let refused = |blob: &[u8]| PhotonMap::from_blob(blob).unwrap_err().to_string();
        assert!(PhotonMap::from_blob(&[]).is_err());
        for cut in [4, 40, 100, 130, 200, good.len() - 64] {
            assert!(PhotonMap::from_blob(&good[..cut]).is_err(), "{cut}");
        }
        let with_header = |photons, halo, radius| {
            let mut blob = good.clone();
            let header = MapHeader { photons, halo, radius, reserved: 0 };
            blob[64..88].copy_from_slice(header.as_bytes());
            blob
        };
        assert!(refused(&with_header(11, 0, 0.5)).contains("counts 11 photons"));
        assert!(refused(&with_header(10, 11, 0.5)).contains("11 halo photons"));
        assert!(refused(&with_header(10, 0, 0.0)).contains("0 m wide"));
        assert!(refused(&with_header(10, 0, f32::NAN)).contains("NaN m wide"));
        // Halo flags are counted only by the slow check.
        assert!(PhotonMap::from_blob(&good).unwrap().check().is_err());
    }

    #[test]
    fn check_finds_a_swap() {
        let mut tree = tree(100);
        tree.swap(1, 2);
        let blob = PhotonMap::build_blob(&tree, 0, 1.0);
        let said = PhotonMap::from_blob(&blob).unwrap().check().unwrap_err().to_string();
        assert!(said.contains("wrong side of photon 0"), "{said}");
        tree[40].position_bits[1] = f32::NAN.to_bits();
        let blob = PhotonMap::build_blob(&tree, 0, 1.0);
        assert!(PhotonMap::from_blob(&blob).unwrap().check().is_err());
    }
}

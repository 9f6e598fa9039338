//! The caustic photons of a room's map, in a tree of their own: light that came from its lamp over mirrors, gloss
//! and glass alone.
//!
//! Final gathering asks for them where the eye looks, for no gather ray would find a lamp by chance in a mirror; and alone
//! they are dense where they matter, so that a few of them make a sharp edge (Jensen 2001, section 8.3). Everything else
//! in the map is found by gather rays.

use enf_illumination::photon_map::{self, build_tree};
use enf_illumination::{Gather, GatherScratch, Kernel, PhotonMap, PortalSet};
use enf_layout::photon::{PHOTON_CAUSTIC, PHOTON_HALO, PhotonRecord};
use enf_layout::sections::Malformed;
use enf_store::{Array, Buffer, MemoryBudget, StoreError};
use glam::Vec3;
use zerocopy::FromBytes;

/// Photons that a caustic is estimated from: few, to keep it sharp.
const PHOTONS: u32 = 60;

/// A room's caustic photons.
pub(crate) struct Caustics {
    blob: Buffer,
}

impl Caustics {
    /// Sorts the caustic photons out of a map; `None` where there are none. It needs 24 bytes for each of them, and as many
    /// again for a while.
    pub(crate) fn of(
        map: &PhotonMap<'_>,
        budget: &MemoryBudget,
    ) -> Result<Option<Self>, StoreError> {
        let caustic = |p: &&PhotonRecord| p.flags & PHOTON_CAUSTIC != 0;
        let count = map.tree().iter().filter(caustic).count();
        if count == 0 {
            return Ok(None);
        }
        let photons = || map.tree().iter().filter(caustic);
        let halo = photons().filter(|p| p.flags & PHOTON_HALO != 0).count();
        let header = photon_map::write_header(count as u64, halo as u64, map.radius());
        let mut blob = Buffer::zeroed(budget, photon_map::blob_bytes(count), "caustic photons")?;
        blob[..header.len()].copy_from_slice(&header);
        let bytes = count * size_of::<PhotonRecord>();
        let tree = &mut blob[header.len()..header.len() + bytes];
        let tree = <[PhotonRecord]>::mut_from_bytes(tree)
            .map_err(|e| Malformed(format!("caustic photons: {e}")))?;
        let mut scratch = Array::with_capacity(budget, count, "caustic photons")?;
        for (place, photon) in tree.iter_mut().zip(photons()) {
            *place = *photon;
            // There is room for all of them.
            let _ = scratch.push(*photon);
        }
        build_tree(tree, &mut scratch, 1);
        Ok(Some(Self { blob }))
    }

    /// The map to ask.
    pub(crate) fn map(&self) -> Result<PhotonMap<'_>, Malformed> {
        PhotonMap::from_blob(&self.blob)
    }
}

/// Irradiance of caustics at a point, W/m².
pub(crate) fn irradiance(
    map: &PhotonMap<'_>,
    point: Vec3,
    normal: Vec3,
    radius: f32,
    portals: &PortalSet<'_>,
    scratch: &mut GatherScratch,
) -> Vec3 {
    let gather = Gather { photons: PHOTONS, radius, kernel: Kernel::Cone };
    Vec3::from(map.irradiance(point, normal, &gather, portals, scratch).rgb)
}

//! The caustic photons of a room's map, in a tree of their own: light that came from its lamp over mirrors, gloss
//! and glass alone.
//!
//! Final gathering asks for them where the eye looks, for no gather ray would find a lamp by chance in a mirror; and alone
//! they are dense where they matter, so that a few of them make a sharp edge (Jensen 2001, section 8.3). Everything else
//! in the map is found by gather rays.

use enf_illumination::photon_map::{blob_bytes, build_map};
use enf_illumination::{Gather, GatherScratch, Kernel, PhotonMap, PortalSet};
use enf_layout::photon::{PHOTON_CAUSTIC, PhotonRecord};
use enf_layout::sections::Malformed;
use enf_store::{Array, Buffer, MemoryBudget, StoreError};
use glam::Vec3;

/// Photons that a caustic is estimated from: few, to keep it sharp.
const PHOTONS: u32 = 60;

/// A room's caustic photons.
pub(crate) struct Caustics {
    blob: Buffer,
}

impl Caustics {
    /// Bytes that [`Caustics::of`] reserves for so many photons while it works.
    pub(crate) fn bytes(photons: u64) -> u64 {
        match photons {
            0 => 0,
            n => n * size_of::<PhotonRecord>() as u64 + blob_bytes(n as usize) as u64,
        }
    }

    /// Sorts the caustic photons out of those of a map, which `look` shows one at a time, twice; `None` where there are none.
    /// `radius` is the map's.
    pub(crate) fn of(
        look: impl Fn(&mut dyn FnMut(PhotonRecord)) -> Result<(), StoreError>,
        radius: f32,
        budget: &MemoryBudget,
    ) -> Result<Option<Self>, StoreError> {
        let is_caustic = |p: &PhotonRecord| p.flags & PHOTON_CAUSTIC != 0;
        let mut count = 0;
        look(&mut |photon| count += usize::from(is_caustic(&photon)))?;
        if count == 0 {
            return Ok(None);
        }
        let mut caustics = Array::with_capacity(budget, count, "caustic photons")?;
        look(&mut |photon| {
            if is_caustic(&photon) {
                // There is room for all of them.
                let _ = caustics.push(photon);
            }
        })?;
        let mut blob = Buffer::zeroed(budget, blob_bytes(count), "caustic photons")?;
        build_map(&caustics, &mut blob, radius, [0, 1], 1);
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

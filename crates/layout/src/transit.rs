//! Photons and rays in transit between tiles, 64 bytes, raw (Fradin et al. 2005, section 5.3).

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The ray has met no diffuse surface yet.
pub const TRANSIT_UNSCATTERED: u16 = 1;
/// ... and met a mirror, gloss or solid glass.
pub const TRANSIT_MIRRORED: u16 = 2;
/// A visibility probe from a light towards a portal: carries no flux, marks rooms.
pub const TRANSIT_PROBE: u16 = 4;
/// A camera ray: `light` is the pixel (counted over all views), `photon` the sample; flux is its throughput, `impacts` the
/// bits of the `f32` density (1/sr) with which a gloss drew its direction, 0 if none did.
pub const TRANSIT_CAMERA: u16 = 8;
/// A shadow ray: `light` is the pixel, `photon` the bits of the `f32` distance at which the light sits,
/// `impacts` the global index of the light's triangle ([`crate::NONE`] for a point); flux is the radiance
/// that arrives if nothing is in the way.
pub const TRANSIT_SHADOW: u16 = 16;
/// A photon that was aimed at an opening when another one was reflected outside: it takes flux from that one, and is not
/// counted.
pub const TRANSIT_AIMED: u16 = 32;
/// A gather ray, or a shadow ray of one: a ray that asks how much light a surface gets from another. `light` is the pixel,
/// `photon` counts the pixel's gather rays, flux is what the eye gets of the radiance that it finds.
pub const TRANSIT_GATHER: u16 = 64;
/// Inside solid glass: the light swings across the plane of incidence (s).
pub const TRANSIT_ACROSS: u16 = 1 << 14;
/// Inside solid glass: the light swings along the plane of incidence (p).
pub const TRANSIT_ALONG: u16 = 1 << 15;

/// One ray that waits at the tile of its `leaf`.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct TransitRecord {
    /// Where the ray started, m; never changed while it flies.
    pub origin: [f32; 3],
    /// Unit direction; never changed while it flies.
    pub direction: [f32; 3],
    /// Flux, W, linear Rec.709 (photons).
    pub flux: [f32; 3],
    /// Distance from which the ray is still to be traced, m: hits before it are known not to exist.
    pub t: f32,
    /// Leaf that it enters.
    pub leaf: u32,
    /// Light (photons).
    pub light: u32,
    /// Index among the light's photons.
    pub photon: u32,
    /// Surface interactions so far: the next random numbers' key.
    pub bounce: u16,
    /// `TRANSIT_*`.
    pub flags: u16,
    /// Global index of the triangle that it started on, never met again at once; [`crate::NONE`] if none.
    pub last_triangle: u32,
    /// Impacts stored so far (photons).
    pub impacts: u32,
}
const _: () = assert!(size_of::<TransitRecord>() == 64);

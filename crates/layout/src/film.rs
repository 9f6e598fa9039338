//! Finished pixels.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// One finished pixel; means over its samples.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct PixelRecord {
    /// Radiance that came straight from lights: emitted or once reflected, W/m²/sr.
    pub direct: [f32; 3],
    /// Radiance from the photon maps, W/m²/sr.
    pub indirect: [f32; 3],
    /// Diffuse albedo of what is seen.
    pub albedo: [f32; 3],
    /// Normal of what is seen, not renormalised.
    pub normal: [f32; 3],
    /// Distance to what is seen first, m (0 where nothing is).
    pub depth: f32,
    /// Room of what the pixel's first sample sees, plus 1; 0 where nothing is. With a minus sign (-0 too) where its samples see
    /// several rooms, or one and nothing.
    pub room: f32,
}
const _: () = assert!(size_of::<PixelRecord>() == 56);

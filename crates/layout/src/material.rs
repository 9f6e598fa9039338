//! Materials as the photons see them.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Reflects and emits on both sides when unset; set: emission leaves the counter-clockwise side only.
/// (Emission is always one-sided today; the bit is written for readers.)
pub const MATERIAL_ONE_SIDED_EMITTER: u32 = 1;
/// Never counts as a wall when rooms are sought (glass).
pub const MATERIAL_SEE_THROUGH: u32 = 2;

/// A mixture of a Lambert lobe, a mirror lobe and straight transmission (a see-through sheet). Per channel
/// `diffuse + specular + transmission <= 1`.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MaterialRecord {
    /// Lambert reflectance, both sides.
    pub diffuse: [f32; 3],
    /// Mirror reflectance. Where `transmission` and `index` make a Fresnel sheet, its reflectance is used
    /// instead: see `index`.
    pub specular: [f32; 3],
    /// Share that passes straight through one sheet, Fresnel loss not counted (a tint); 0 for opaque
    /// matter. A see-through sheet is *one* interface: a pane modelled as a thin box has two.
    pub transmission: [f32; 3],
    /// Radiance of the counter-clockwise side, W/m²/sr.
    pub emission: [f32; 3],
    /// Refractive index; above 1 a see-through sheet reflects by Fresnel's equations, as one interface met
    /// from its thinner side.
    pub index: f32,
    /// `MATERIAL_*` bits.
    pub flags: u32,
    /// Zero.
    pub reserved: [u32; 2],
}
const _: () = assert!(size_of::<MaterialRecord>() == 64);

//! Materials as the photons see them.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Reflects and emits on both sides when unset; set: emission leaves the counter-clockwise side only.
/// (Emission is always one-sided today; the bit is written for readers.)
pub const MATERIAL_ONE_SIDED_EMITTER: u32 = 1;
/// Never counts as a wall when rooms are sought (glass).
pub const MATERIAL_SEE_THROUGH: u32 = 2;

/// `specular` is the reflectance of a gloss at normal incidence (Fresnel's, after Schlick; GGX facets of `roughness`), and
/// `diffuse` that of the matter below it, which gets what the gloss leaves. Unset: `specular` is a mirror's at any angle.
pub const MATERIAL_GLOSS: u32 = 4;
/// The inside of a closed surface is glass: light is refracted by `index` and absorbed on its way. Fronts face outwards.
pub const MATERIAL_SOLID: u32 = 8;

/// Smoother gloss (GGX alpha) is a mirror: its lobe is narrower than `f32` directions can say.
pub const SMOOTHEST_GLOSS: f32 = 2e-3;

/// A mixture of a Lambert lobe, a mirror or gloss lobe, and straight transmission (a see-through sheet) or refraction
/// (solid glass). Without gloss, per channel `diffuse + specular + transmission <= 1`; with it, each is at most 1.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct MaterialRecord {
    /// Lambert reflectance, both sides.
    pub diffuse: [f32; 3],
    /// Mirror reflectance, or that of a gloss ([`MATERIAL_GLOSS`]). Where `transmission` and `index` make a Fresnel
    /// sheet, its reflectance is used instead: see `index`.
    pub specular: [f32; 3],
    /// Share that passes straight through one sheet, Fresnel loss not counted (a tint); 0 for opaque
    /// matter. A see-through sheet is *one* interface: a pane modelled as a thin box has two. Of solid glass: the
    /// tint of each crossing.
    pub transmission: [f32; 3],
    /// Radiance of the counter-clockwise side, W/m²/sr.
    pub emission: [f32; 3],
    /// Absorption inside solid glass, 1/m (natural logarithm).
    pub absorption: [f32; 3],
    /// Refractive index; above 1 a see-through sheet reflects by Fresnel's equations, as one interface met
    /// from its thinner side. Of solid glass: that of its inside.
    pub index: f32,
    /// GGX roughness alpha of a gloss, 0 (a mirror) to 1.
    pub roughness: f32,
    /// Mean area of the area lights of this material, m²; 0 without any. It weighs ways to find a light against each
    /// other, no more.
    pub light_area_m2: f32,
    /// `MATERIAL_*` bits.
    pub flags: u32,
    /// Texture that `diffuse` is multiplied by, [`crate::NONE`] without one.
    pub texture: u32,
}
const _: () = assert!(size_of::<MaterialRecord>() == 80);

impl MaterialRecord {
    /// A surface that neither reflects nor emits: what a material does not need stays so.
    pub const BLACK: Self = Self {
        diffuse: [0.0; 3],
        specular: [0.0; 3],
        transmission: [0.0; 3],
        emission: [0.0; 3],
        absorption: [0.0; 3],
        index: 1.0,
        roughness: 0.0,
        light_area_m2: 0.0,
        flags: 0,
        texture: crate::NONE,
    };
}

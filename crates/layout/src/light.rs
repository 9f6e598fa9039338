//! Light sources.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// The emitting triangles of one object with one material; Lambertian from the counter-clockwise side.
pub const LIGHT_AREA: u32 = 0;
/// A point that emits the same intensity everywhere.
pub const LIGHT_POINT: u32 = 1;
/// A point with intensity `I0 cos(theta)` about `axis` (CIE 171, 5.2's source).
pub const LIGHT_POINT_LAMBERT: u32 = 2;
/// A point that shines into a cone about `axis`: full intensity up to the first of its `cone`'s angles, then
/// falling with the square of the cosine's way to the second (glTF's KHR_lights_punctual).
pub const LIGHT_SPOT: u32 = 3;
/// A point whose intensities were measured: see [`crate::profile`].
pub const LIGHT_PROFILE: u32 = 4;

/// Flux per intensity on the axis of a [`LIGHT_SPOT`], sr: 2 pi (1 - ci + (ci - co) / 3).
pub fn cone_steradians(cone: [f32; 2]) -> f64 {
    let [inner, outer] = cone.map(f64::from);
    core::f64::consts::TAU * ((1.0 - inner) + (inner - outer) / 3.0)
}

/// Light of the sky. With emitters: what arrives through one opening to the outside, whose triangles face the room
/// that it enters. Without: all that arrives through none.
pub const LIGHT_SKY: u32 = 5;
/// Light of the sun's disc; emitters as for [`LIGHT_SKY`].
pub const LIGHT_SUN: u32 = 6;

/// One light; photons are counted per light.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct LightRecord {
    /// `LIGHT_*`.
    pub kind: u32,
    /// Material of an area light, else [`crate::NONE`].
    pub material: u32,
    /// First of its [`EmitterRecord`]s (area lights, openings).
    pub first_emitter: u32,
    /// Number of them.
    pub emitter_count: u32,
    /// Total radiant flux, W, linear Rec.709.
    pub flux_w: [f32; 3],
    /// Emitting area, m²; 0 for points.
    pub area_m2: f32,
    /// Position of a point; centre of an area light's box, m.
    pub position: [f32; 3],
    /// Half diagonal of an area light's box, m.
    pub radius: f32,
    /// Unit axis of a point, area-weighted mean normal of an area light (zero if it cancels).
    pub axis: [f32; 3],
    /// Index of the [`crate::profile::ProfileRecord`] of a [`LIGHT_PROFILE`], else [`crate::NONE`].
    pub profile: u32,
    /// Unit vector square to `axis`, from which angles about it are counted; zero where nobody counts them.
    pub tangent: [f32; 3],
    /// Cosines of the angles to `axis` at which a cone begins to fade and is dark; -1 without a cone.
    pub cone: [f32; 2],
    /// Zero.
    pub reserved: [u32; 3],
}
const _: () = assert!(size_of::<LightRecord>() == 96);

impl LightRecord {
    /// A light that is dark, nowhere and of no size: what a kind does not need stays so.
    pub const DARK: Self = Self {
        kind: LIGHT_POINT,
        material: crate::NONE,
        first_emitter: 0,
        emitter_count: 0,
        flux_w: [0.0; 3],
        area_m2: 0.0,
        position: [0.0; 3],
        radius: 0.0,
        axis: [0.0; 3],
        profile: crate::NONE,
        tangent: [0.0; 3],
        cone: [-1.0; 2],
        reserved: [0; 3],
    };
}

/// One emitting triangle.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct EmitterRecord {
    /// Corners, m, counter-clockwise from the emitting side.
    pub corners: [[f32; 3]; 3],
    /// The triangle's global index; [`crate::NONE`] in an opening.
    pub triangle: u32,
    /// Sum of the areas of this light's emitters up to and including this one, divided by the total:
    /// the last one's is 1.
    pub cumulative: f32,
    /// Zero.
    pub reserved: u32,
}
const _: () = assert!(size_of::<EmitterRecord>() == 48);

//! The sky, the sun and the ground beyond the scene.

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// What light arrives from far away, by direction: the sky's pattern is a product of a gradation, which depends on
/// the height above the horizon, and an indicatrix, which depends on the angle to the sun (CIE S 011 / ISO 15469;
/// Perez, Seals and Michalsky 1993).
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct SkyRecord {
    /// Radiance where gradation and indicatrix are both 1, W/m2/sr (scalar).
    pub scale: f64,
    /// `a`, `b`, `g` of the gradation `1 + a exp(b / z) + g z`, `z` being the sine of the height, 0.01 at least.
    pub gradation: [f64; 3],
    /// `k`, `c`, `d`, `e` of the indicatrix `k + c exp(d x) + e cos^2 x`, `x` being the angle to the sun.
    pub indicatrix: [f64; 4],
    /// Unit vector to the sun's centre, store coordinates; zero when nothing depends on it.
    pub sun: [f64; 3],
    /// Angular radius of the sun's disc, radians.
    pub sun_radius: f64,
    /// Irradiance by the sun on a surface square to its rays, W/m2, linear Rec.709; 0 without a sun.
    pub sun_irradiance: [f64; 3],
    /// Colour of the sky, linear Rec.709 of luminance 1.
    pub color: [f64; 3],
    /// Radiance of the ground below the horizon, W/m2/sr, linear Rec.709.
    pub ground: [f64; 3],
}
const _: () = assert!(size_of::<SkyRecord>() == 168);

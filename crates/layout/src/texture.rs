//! Textures: pictures that multiply the reflectance of matter, and where on them a triangle lies.
//!
//! The texels of all textures are one extent: 3 bytes each (sRGB, IEC 61966-2-1), top row first. The coordinates of a
//! tile's triangles are a [`crate::sections`] blob:
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_TEXTURED`] | `u32` | global indices of the triangles that have coordinates, ascending |
//! | [`SECTION_COORDINATES`] | `[[f32; 2]; 3]` | coordinates of the corners, as the model has them, bit-exact in every tile |

use zerocopy::{FromBytes, Immutable, IntoBytes, KnownLayout};

/// Global indices.
pub const SECTION_TEXTURED: usize = 0;
/// Coordinates.
pub const SECTION_COORDINATES: usize = 1;

/// Beyond its left and right border the picture's last column goes on; unset: it begins again.
pub const TEXTURE_CLAMP_X: u32 = 1;
/// The same for its upper and lower border.
pub const TEXTURE_CLAMP_Y: u32 = 2;
/// Beyond its left and right border the picture is mirrored.
pub const TEXTURE_MIRROR_X: u32 = 4;
/// The same for its upper and lower border.
pub const TEXTURE_MIRROR_Y: u32 = 8;

/// One texture.
#[derive(Clone, Copy, Debug, PartialEq, FromBytes, IntoBytes, Immutable, KnownLayout)]
#[repr(C)]
pub struct TextureRecord {
    /// Its first texel among all.
    pub first_texel: u32,
    /// Texels in a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
    /// `TEXTURE_*`.
    pub flags: u32,
    /// Rows of the affine map from texture coordinates (u, v, 1) to places on the picture: right from its left border in
    /// widths, down from its upper border in heights.
    pub place: [[f32; 3]; 2],
    /// Mean of the texels, linear Rec.709: for triangles without coordinates.
    pub mean: [f32; 3],
    /// Zero.
    pub reserved: u32,
}
const _: () = assert!(size_of::<TextureRecord>() == 56);

//! Textures: what colour matter has at a hit.
//!
//! A picture is kept at one size, filtered once when the building was partitioned, and looked up between four texels. So
//! a colour depends on the hit alone.

use std::sync::OnceLock;

use enf_layout::NONE;
use enf_layout::sections::{self, Malformed};
use enf_layout::texture::{
    SECTION_COORDINATES, SECTION_TEXTURED, TEXTURE_CLAMP_X, TEXTURE_CLAMP_Y, TEXTURE_MIRROR_X,
    TEXTURE_MIRROR_Y, TextureRecord,
};
use glam::Vec3;

/// Where a tile's triangles lie on their textures.
#[derive(Clone, Copy, Debug, Default)]
pub struct Coordinates<'a> {
    /// Global indices, ascending.
    triangles: &'a [u32],
    corners: &'a [[[f32; 2]; 3]],
}

impl<'a> Coordinates<'a> {
    /// Reads a blob (4-byte aligned); an empty one has no triangles.
    ///
    /// # Errors
    /// Sections that are missing, or are not equally long.
    pub fn from_blob(blob: &'a [u8]) -> Result<Self, Malformed> {
        if blob.is_empty() {
            return Ok(Self::default());
        }
        let triangles: &[u32] = sections::section(blob, SECTION_TEXTURED)?;
        let corners: &[[[f32; 2]; 3]] = sections::section(blob, SECTION_COORDINATES)?;
        if triangles.len() != corners.len() {
            return Err(Malformed(format!(
                "{} triangles have {} sets of texture coordinates",
                triangles.len(),
                corners.len()
            )));
        }
        Ok(Self { triangles, corners })
    }

    /// Coordinates at barycentric `u` (corner 1) and `v` (corner 2) of the triangle with a global index.
    pub fn at(&self, global: u32, u: f32, v: f32) -> Option<[f32; 2]> {
        let at = self.triangles.binary_search(&global).ok()?;
        let [a, b, c] = self.corners[at];
        let w = 1.0 - u - v;
        Some([0, 1].map(|k| a[k] * w + b[k] * u + c[k] * v))
    }
}

/// All textures of a scene, and the coordinates of one tile. Without either, everything is white.
#[derive(Clone, Copy, Debug, Default)]
pub struct Texturing<'a> {
    /// By texture id; each within `texels`, and not empty.
    pub textures: &'a [TextureRecord],
    /// Texels, sRGB.
    pub texels: &'a [[u8; 3]],
    /// The tile's.
    pub coordinates: Coordinates<'a>,
}

impl Texturing<'_> {
    /// Colour (linear, 0 to 1) of a material's `texture` at a hit: the texture's mean for a triangle without coordinates,
    /// white without a texture.
    pub fn colour(&self, texture: u32, global: u32, u: f32, v: f32) -> Vec3 {
        if texture == NONE {
            return Vec3::ONE;
        }
        let Some(record) = self.textures.get(texture as usize) else { return Vec3::ONE };
        match self.coordinates.at(global, u, v) {
            Some(at) => look_up(record, self.texels, at),
            None => Vec3::from(record.mean),
        }
    }
}

/// The linear value of an sRGB code.
pub fn linear(code: u8) -> f32 {
    static TABLE: OnceLock<[f32; 256]> = OnceLock::new();
    TABLE.get_or_init(|| {
        std::array::from_fn(|i| {
            let c = i as f64 / 255.0;
            let v = if c <= 0.04045 { c / 12.92 } else { libm::pow((c + 0.055) / 1.055, 2.4) };
            v as f32
        })
    })[usize::from(code)]
}

/// Bilinear: four texels about texture coordinates `at`.
fn look_up(record: &TextureRecord, texels: &[[u8; 3]], at: [f32; 2]) -> Vec3 {
    let [x, y] = record.place.map(|row| row[0] * at[0] + row[1] * at[1] + row[2]);
    let clamp = [TEXTURE_CLAMP_X, TEXTURE_CLAMP_Y].map(|bit| record.flags & bit != 0);
    let mirror = [TEXTURE_MIRROR_X, TEXTURE_MIRROR_Y].map(|bit| record.flags & bit != 0);
    let (x, right) = neighbours(x, record.width, clamp[0], mirror[0]);
    let (y, down) = neighbours(y, record.height, clamp[1], mirror[1]);
    let texel = |x: u32, y: u32| {
        let place = record.first_texel as usize + y as usize * record.width as usize + x as usize;
        texels.get(place).map_or(Vec3::ONE, |c| Vec3::from(c.map(linear)))
    };
    let row = |y: u32| texel(x[0], y) * (1.0 - right) + texel(x[1], y) * right;
    row(y[0]) * (1.0 - down) + row(y[1]) * down
}

/// The two texels about a place along an axis (in pictures), and how far it is from the first to the second.
fn neighbours(place: f32, size: u32, clamp: bool, mirror: bool) -> ([u32; 2], f32) {
    // A place that is no number is the border; beyond 2^24 pictures there are no texels left to tell apart.
    let place = if place.is_finite() { place.clamp(-1.6e7, 1.6e7) } else { 0.0 };
    let at = f64::from(place) * f64::from(size) - 0.5;
    let floor = at.floor();
    let wrap = |i: i64| {
        let size = i64::from(size);
        let i = if clamp {
            i.clamp(0, size - 1)
        } else if mirror {
            let i = i.rem_euclid(2 * size);
            i.min(2 * size - 1 - i)
        } else {
            i.rem_euclid(size)
        };
        i as u32
    };
    ([wrap(floor as i64), wrap(floor as i64 + 1)], (at - floor) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;
    use enf_layout::sections::Transform;
    use zerocopy::IntoBytes;

    const PLAIN: [[f32; 3]; 2] = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]];

    fn record(width: u32, height: u32, flags: u32) -> TextureRecord {
        let mean = [0.5; 3];
        TextureRecord { first_texel: 0, width, height, flags, place: PLAIN, mean, reserved: 0 }
    }

    #[test]
    fn srgb_codes() {
        assert_eq!((linear(0), linear(255)), (0.0, 1.0));
        // 0.5 of a signal is 21.4 % of the light.
        assert!((linear(128) - 0.2158605).abs() < 1e-6);
        assert!((linear(10) - 10.0 / 255.0 / 12.92).abs() < 1e-7);
    }

    #[test]
    fn texels_are_hit_in_their_middles_and_mixed_between() {
        let texels = [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 255, 255]];
        let r = record(2, 2, 0);
        let at = |x: f32, y: f32| look_up(&r, &texels, [x, y]).to_array();
        assert_eq!(at(0.25, 0.25), [1.0, 0.0, 0.0]);
        assert_eq!(at(0.75, 0.25), [0.0, 1.0, 0.0]);
        assert_eq!(at(0.25, 0.75), [0.0, 0.0, 1.0]);
        assert_eq!(at(0.5, 0.25), [0.5, 0.5, 0.0]);
        assert_eq!(at(0.5, 0.5), [0.5, 0.5, 0.5]);
        // It begins again; so the border mixes both ends.
        assert_eq!(at(1.25, -0.75), at(0.25, 0.25));
        assert_eq!(at(0.0, 0.25), [0.5, 0.5, 0.0]);
        let r = record(2, 2, TEXTURE_CLAMP_X | TEXTURE_MIRROR_Y);
        let at = |x: f32, y: f32| look_up(&r, &texels, [x, y]).to_array();
        assert_eq!(at(-3.0, 0.25), [1.0, 0.0, 0.0]);
        assert_eq!(at(9.0, 0.25), [0.0, 1.0, 0.0]);
        assert_eq!(at(0.25, 1.25), at(0.25, 0.75));
        assert_eq!(at(0.25, 1.75), at(0.25, 0.25));
        for odd in [f32::NAN, f32::INFINITY, -1e30, 1e30] {
            assert!(look_up(&r, &texels, [odd, odd]).is_finite());
        }
    }

    #[test]
    fn triangles_find_their_coordinates() {
        let triangles = [3u32, 8];
        let corners = [[[0.0f32, 0.0], [1.0, 0.0], [0.0, 1.0]], [[0.5, 0.5]; 3]];
        let blob = sections::build(&[
            (triangles.as_bytes(), Transform::Delta, 1),
            (corners.as_bytes(), Transform::Xor, 6),
        ]);
        let c = Coordinates::from_blob(&blob).unwrap();
        assert_eq!(c.at(3, 0.25, 0.5), Some([0.25, 0.5]));
        assert_eq!(c.at(8, 0.25, 0.5), Some([0.5, 0.5]));
        assert_eq!(c.at(4, 0.25, 0.5), None);
        let texels = [[0, 0, 0], [255, 255, 255]];
        let textures = [record(2, 1, 0)];
        let t = Texturing { textures: &textures, texels: &texels, coordinates: c };
        assert_eq!(t.colour(0, 3, 0.25, 0.0), Vec3::ZERO);
        assert_eq!(t.colour(0, 3, 0.75, 0.0), Vec3::ONE);
        assert_eq!(t.colour(0, 4, 0.75, 0.0), Vec3::splat(0.5));
        assert_eq!(t.colour(NONE, 3, 0.25, 0.0), Vec3::ONE);
    }
}

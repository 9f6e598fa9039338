//! A tile's mesh: a [`crate::sections`] blob with the sections below, in this order.
//!
//! | section | element | meaning |
//! |---|---|---|
//! | [`SECTION_VERTICES`] | `[f32; 3]` | world-space vertices, m, bit-exact in every tile that holds a copy |
//! | [`SECTION_TRIANGLES`] | `[u32; 3]` | vertex indices, counter-clockwise seen from the front |
//! | [`SECTION_GLOBAL`] | `u32` | the triangle's index in the scene, ascending |
//! | [`SECTION_MATERIALS`] | `u32` | material id per triangle |

/// Vertices.
pub const SECTION_VERTICES: usize = 0;
/// Triangles.
pub const SECTION_TRIANGLES: usize = 1;
/// Global triangle indices.
pub const SECTION_GLOBAL: usize = 2;
/// Material ids.
pub const SECTION_MATERIALS: usize = 3;
/// Number of sections.
pub const SECTIONS: usize = 4;

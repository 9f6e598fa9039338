//! Rays against triangles, and two structures that keep most of them apart: the paper's uniform grid and a wide
//! bounding volume hierarchy.
//!
//! Nearly all of a run's time is spent here, so the crate has one idea and sticks to it: *a hit is a
//! fact about one ray and one triangle*. [`intersect`] answers from the ray, the three corners and
//! the scene's tolerance alone: the same bits whichever tile asks, whichever structure found the
//! triangle. On top of that, [`GridView::nearest`] and [`BvhView::nearest`] may be as clever as they like:
//! they have to return what testing every triangle would have returned, and the tests hold them to that.
//!
//! | module | question |
//! |---|---|
//! | [`ray`] | where does this ray meet this triangle? |
//! | [`mesh`] | what is in a tile? |
//! | [`grid`], [`bvh`] | which triangles are worth asking about? |
//! | [`aabb`] | boxes |
//!
//! Everything is slices in, slices out: no paths, no I/O, no `unsafe`, no fused multiply-add, no
//! system libm. Metres throughout; `delta` is the scene's tolerance, `2^-19` of a power of two that is
//! not less than any coordinate nor the diagonal of the scene.
#![forbid(unsafe_code)]

pub mod aabb;
pub mod bvh;
pub mod grid;
pub mod mesh;
mod query;
pub mod ray;
pub mod structure;

pub use aabb::Aabb;
pub use bvh::{
    BvhHeader, BvhView, Instructions, build_bvh, bvh_build_bytes, bvh_bytes_estimate, complete_bvh,
};
pub use enf_layout::{NONE, sections::Malformed};
pub use grid::{GridHeader, GridView, build_grid, grid_build_bytes, grid_bytes_estimate};
pub use mesh::TileMesh;
pub use query::{Query, nearest_by_force};
pub use ray::{Hit, PreparedRay, Ray, intersect};
pub use structure::{Structure, StructureKind, structure_bytes_estimate};

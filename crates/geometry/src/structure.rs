//! Whichever structure a tile has: the one place where grid and hierarchy are told apart.

use enf_layout::sections::Malformed;

use crate::bvh::{self, BvhView};
use crate::grid::{self, GridView};
use crate::mesh::TileMesh;
use crate::ray::{Hit, PreparedRay};

/// The kinds of structures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StructureKind {
    /// The paper's uniform grid, in bricks.
    Grid,
    /// A wide bounding volume hierarchy.
    Bvh,
}

impl StructureKind {
    /// Builds the structure of a mesh for tolerance `delta` (m). The blob depends on the arguments alone.
    pub fn build(self, mesh: &TileMesh, delta: f32) -> Vec<u8> {
        match self {
            Self::Grid => grid::build_grid(mesh, delta),
            Self::Bvh => bvh::build_bvh(mesh, delta),
        }
    }

    /// Upper bound of the bytes that building takes, the result included.
    pub fn build_bytes(self, triangles: u64) -> u64 {
        match self {
            Self::Grid => grid::grid_build_bytes(triangles),
            Self::Bvh => bvh::bvh_build_bytes(triangles),
        }
    }
}

/// Upper bound of the bytes of either structure of so many triangles.
pub fn structure_bytes_estimate(triangles: u64) -> u64 {
    grid::grid_bytes_estimate(triangles).max(bvh::bvh_bytes_estimate(triangles))
}

/// A tile's structure, borrowed from its blob.
#[derive(Clone, Copy, Debug)]
pub enum Structure<'a> {
    /// The paper's uniform grid, in bricks.
    Grid(GridView<'a>),
    /// A wide bounding volume hierarchy.
    Bvh(BvhView<'a>),
}

impl<'a> Structure<'a> {
    /// Reads a blob (4-byte aligned) for a mesh of `triangle_count` triangles, every index in it checked.
    pub fn from_blob(
        kind: StructureKind,
        blob: &'a [u8],
        triangle_count: u32,
    ) -> Result<Self, Malformed> {
        Ok(match kind {
            StructureKind::Grid => Self::Grid(GridView::from_blob(blob, triangle_count)?),
            StructureKind::Bvh => Self::Bvh(BvhView::from_blob(blob, triangle_count)?),
        })
    }

    /// A blob that [`Structure::from_blob`] has accepted before.
    pub fn from_checked_blob(kind: StructureKind, blob: &'a [u8]) -> Result<Self, Malformed> {
        Ok(match kind {
            StructureKind::Grid => Self::Grid(GridView::from_checked_blob(blob)?),
            StructureKind::Bvh => Self::Bvh(BvhView::from_checked_blob(blob)?),
        })
    }

    /// The canonical hit with the smallest `(t, global)` among those with `t_min <= t < t_max` (m) on
    /// triangles other than `exclude`: the same bits from either structure.
    pub fn nearest(
        &self,
        mesh: &TileMesh,
        ray: &PreparedRay,
        t_min: f32,
        t_max: f32,
        exclude: u32,
        delta: f32,
    ) -> Option<Hit> {
        match self {
            Self::Grid(grid) => grid.nearest(mesh, ray, t_min, t_max, exclude, delta),
            Self::Bvh(bvh) => bvh.nearest(mesh, ray, t_min, t_max, exclude, delta),
        }
    }
}

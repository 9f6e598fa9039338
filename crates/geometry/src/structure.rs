//! Whichever structure a tile has: the one place where grid and hierarchy are told apart.

use enf_layout::sections::Malformed;

use glam::Vec3;

use crate::bvh::{self, BvhView, Instructions};
use crate::grid::{self, GridView};
use crate::mesh::TileMesh;
use crate::query::Query;
use crate::ray::Hit;

/// The kinds of structures.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StructureKind {
    /// The paper's uniform grid, in bricks.
    Grid,
    /// A wide bounding volume hierarchy.
    Bvh,
}

impl StructureKind {
    /// Builds the structure of a mesh for tolerance `delta` (m), as it is stored: [`StructureKind::complete`] makes it
    /// ready. The blob depends on the arguments alone.
    pub fn build(self, mesh: &TileMesh, delta: f32) -> Vec<u8> {
        match self {
            Self::Grid => grid::build_grid(mesh, delta),
            Self::Bvh => bvh::build_bvh(mesh, delta),
        }
    }

    /// Fills in what a stored structure leaves to its mesh: once, after building or loading.
    ///
    /// # Errors
    /// When the structure is not one of this mesh.
    pub fn complete(self, blob: &mut [u8], mesh: &TileMesh<'_>) -> Result<(), Malformed> {
        match self {
            Self::Grid => Ok(()),
            Self::Bvh => bvh::complete_bvh(blob, mesh),
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
    /// Reads a blob (4-byte aligned), to be asked about the mesh that it was built for with a tolerance not above the
    /// one that it was built for (m). Every index in it is checked.
    pub fn from_blob(
        kind: StructureKind,
        blob: &'a [u8],
        mesh: TileMesh<'a>,
        delta: f32,
    ) -> Result<Self, Malformed> {
        Ok(match kind {
            StructureKind::Grid => Self::Grid(GridView::from_blob(blob, mesh, delta)?),
            StructureKind::Bvh => Self::Bvh(BvhView::from_blob(blob, &mesh, delta)?),
        })
    }

    /// The canonical hit with the smallest `(t, global)` among those that the query admits: the same bits from
    /// either structure.
    pub fn nearest(&self, query: &Query) -> Option<Hit> {
        match self {
            Self::Grid(grid) => grid.nearest(query),
            Self::Bvh(bvh) => bvh.nearest(query),
        }
    }

    /// Whether the query admits any hit.
    pub fn occluded(&self, query: &Query) -> bool {
        match self {
            Self::Grid(grid) => grid.occluded(query),
            Self::Bvh(bvh) => bvh.occluded(query),
        }
    }

    /// [`Structure::occluded`] of many queries at once, for as many answers: the same, sooner.
    pub fn occluded_batch(&self, queries: &[Query], answers: &mut [bool]) {
        match self {
            Self::Grid(grid) => {
                for (query, answer) in queries.iter().zip(answers) {
                    *answer = grid.occluded(query);
                }
            }
            Self::Bvh(bvh) => bvh.occluded_batch(queries, answers),
        }
    }

    /// [`Structure::nearest`] of many queries at once, for as many answers: the same, sooner.
    pub fn nearest_batch(&self, queries: &[Query], answers: &mut [Option<Hit>]) {
        self.nearest_batch_with(Instructions::best(), queries, answers);
    }

    /// The same, with no more than these instructions.
    pub fn nearest_batch_with(
        &self,
        instructions: Instructions,
        queries: &[Query],
        answers: &mut [Option<Hit>],
    ) {
        match self {
            Self::Grid(grid) => {
                for (query, answer) in queries.iter().zip(answers) {
                    *answer = grid.nearest(query);
                }
            }
            Self::Bvh(bvh) => bvh.nearest_batch_with(instructions, queries, answers),
        }
    }

    /// Corners of the triangle of a hit of this structure, m; by [`Hit::slot`].
    #[inline]
    pub fn corners(&self, slot: u32) -> [Vec3; 3] {
        match self {
            Self::Grid(grid) => grid.corners(slot),
            Self::Bvh(bvh) => bvh.corners(slot),
        }
    }

    /// Its material.
    #[inline]
    pub fn material(&self, slot: u32) -> u32 {
        match self {
            Self::Grid(grid) => grid.material(slot),
            Self::Bvh(bvh) => bvh.material(slot),
        }
    }
}

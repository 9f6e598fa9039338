//! The uniform grid of a tile (Fradin et al. 2005, section 4; Cleary and Wyvill 1988), kept in bricks.
//!
//! Rooms are mostly air, so the grid is fine and sparse: a *brick* is a 64-bit mask of its 4 x 4 x 4 cells,
//! and only cells with a bit own a list of triangles. An empty brick costs twelve bytes and one step. A cell
//! where triangles crowd is divided by a brick of its own, if that is worth it (two levels, as Kalojanov,
//! Billeter and Slusallek 2011).
//!
//! A grid is a [`sections`] blob that is used in place, wherever it was loaded; [`enf_layout::grid`]
//! says what is in it.
//!
//! Why the nearest hit is the true one: a hit's point is within `delta` of its triangle; a cell lists
//! every triangle that touches it when it is inflated by four `delta`; so a hit at `t` is listed in
//! the cell where the ray is at `t`, with three `delta` to spare for rounding. The walk may stop
//! when the best hit lies before the end of the cell, and not a step earlier.

mod build;
mod walk;

pub use build::{build_grid, grid_build_bytes, grid_bytes_estimate};

pub use enf_layout::grid::{BrickRecord, GridHeader};

use enf_layout::grid::{
    BRICK, FINER, SECTION_BRICKS, SECTION_HEADER, SECTION_REFERENCES, SECTION_STARTS,
};
use enf_layout::sections::{self, Malformed};
use glam::Vec3;

use crate::aabb::Aabb;
use crate::mesh::TileMesh;

/// The largest tolerance that cells can be built for, m.
pub(crate) const LARGEST: f32 = 1e36;
/// Most bricks of one grid.
pub(crate) const MAX_BRICKS: u64 = 1 << 24;

/// A grid, borrowed from its blob.
#[derive(Clone, Copy, Debug)]
pub struct GridView<'a> {
    header: &'a GridHeader,
    bricks: &'a [BrickRecord],
    starts: &'a [u32],
    references: &'a [u32],
    mesh: TileMesh<'a>,
    delta: f32,
}

impl<'a> GridView<'a> {
    /// Reads a blob (4-byte aligned), to be asked about the mesh that it was built for with a tolerance not above the
    /// one that it was built for (m). Every index in it is checked, so that a walk never leaves it.
    pub fn from_blob(blob: &'a [u8], mesh: TileMesh<'a>, delta: f32) -> Result<Self, Malformed> {
        let grid = Self::from_checked_blob(blob, mesh, delta)?;
        grid.check().map_err(Malformed)?;
        Ok(grid)
    }

    /// A blob that [`GridView::from_blob`] has accepted before, without checking each index again.
    pub fn from_checked_blob(
        blob: &'a [u8],
        mesh: TileMesh<'a>,
        delta: f32,
    ) -> Result<Self, Malformed> {
        let headers: &[GridHeader] = sections::section(blob, SECTION_HEADER)?;
        let [header] = headers else {
            return Err(Malformed(format!("grid has {} headers", headers.len())));
        };
        if delta > header.delta || delta.is_nan() {
            let built = header.delta;
            return Err(Malformed(format!("grid is for tolerance {built}, not {delta}")));
        }
        Ok(Self {
            header,
            bricks: sections::section(blob, SECTION_BRICKS)?,
            starts: sections::section(blob, SECTION_STARTS)?,
            references: sections::section(blob, SECTION_REFERENCES)?,
            mesh,
            delta,
        })
    }

    fn check(&self) -> Result<(), String> {
        let h = self.header;
        let triangle_count = self.mesh.len();
        if triangle_count >= FINER {
            return Err(format!("no grid has {triangle_count} triangles"));
        }
        if h.triangles != triangle_count {
            return Err(format!("grid is for {} triangles, not {triangle_count}", h.triangles));
        }
        let sane = h.cell.is_finite()
            && h.cell > 0.0
            && h.delta >= 0.0
            && (0..3).all(|i| {
                let reach = f64::from(h.bricks[i]) * f64::from(BRICK) * f64::from(h.cell);
                h.min[i].is_finite()
                    && h.max[i].is_finite()
                    && h.min[i] <= h.max[i]
                    && f64::from(h.min[i]) + reach >= f64::from(h.max[i])
            });
        if !sane {
            return Err(format!("grid geometry makes no sense: {h:?}"));
        }
        let outer: u128 = h.bricks.iter().map(|&b| u128::from(b)).product();
        if outer == 0 || outer > u128::from(MAX_BRICKS) || outer > self.bricks.len() as u128 {
            return Err(format!("grid has {} bricks for {:?}", self.bricks.len(), h.bricks));
        }
        let outer = outer as usize;
        let (mut occupied, mut divided) = (0u32, 0);
        for (i, brick) in self.bricks.iter().enumerate() {
            if brick.first != occupied {
                return Err(format!("grid brick {i} starts at cell {}", brick.first));
            }
            occupied += brick.mask().count_ones();
            if i + 1 == outer {
                divided = occupied;
            }
        }
        if occupied != h.cells || self.starts.len() != occupied as usize + 1 {
            return Err(format!("grid has {occupied} cells and {} lists", self.starts.len()));
        }
        if let Some(i) = self.starts.windows(2).position(|w| w[0] >= w[1]) {
            return Err(format!("grid cell {i} ends before it begins"));
        }
        let ends = (self.starts[0], self.starts[occupied as usize]);
        if ends != (0, h.references) || h.references as usize != self.references.len() {
            return Err(format!("grid has {} references", self.references.len()));
        }
        let mut finer = outer;
        for (cell, range) in self.starts.windows(2).enumerate() {
            let list = &self.references[range[0] as usize..range[1] as usize];
            if let ([first], true) = (list, cell < divided as usize)
                && *first == FINER | finer as u32
            {
                finer += 1;
            } else if let Some(i) = list.iter().position(|&r| r >= triangle_count) {
                return Err(format!("grid reference {i} of cell {cell} is to {}", list[i]));
            }
        }
        if finer != self.bricks.len() {
            return Err(format!("grid has {} bricks and uses {finer}", self.bricks.len()));
        }
        Ok(())
    }

    /// Corners of the triangle of a hit, m.
    pub fn corners(&self, slot: u32) -> [Vec3; 3] {
        self.mesh.corners(slot)
    }

    /// Its material.
    pub fn material(&self, slot: u32) -> u32 {
        self.mesh.materials[slot as usize]
    }

    /// Cell size, resolution and counts.
    pub fn header(&self) -> &'a GridHeader {
        self.header
    }

    /// The mesh's box and four tolerances: outside, there is nothing to hit.
    pub fn bounds(&self) -> Aabb {
        Aabb { min: Vec3::from_array(self.header.min), max: Vec3::from_array(self.header.max) }
    }
}

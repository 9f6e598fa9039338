//! A bounding volume hierarchy of a tile, eight children wide, in 96 bytes a node.
//!
//! A wide node asks eight boxes at once, which is what a vector unit likes (Wald, Benthin and Boulos 2008,
//! *Getting rid of packets*); boxes in eight bits a coordinate keep a room's hierarchy in the second-level cache
//! (Ylitie, Karras and Laine 2017). It is a [`sections`] blob that is used in place, wherever it was loaded;
//! [`enf_layout::bvh`] says what is in it.
//!
//! Why the nearest hit is the true one: a hit's point is within `delta` of its triangle; every box is grown by four
//! `delta`; the slab test in `f32` is off by less than one `delta` for origins within a few scenes; so a box
//! that holds a triangle is entered no later than the triangle is hit. Ties go to the smaller index
//! because a box at the best distance is still opened.

mod batch;
mod build;
mod level;
mod walk;

pub use build::{build_bvh, bvh_build_bytes, bvh_bytes_estimate, complete_bvh};
pub use enf_layout::bvh::{BvhHeader, BvhNode};
pub use level::Instructions;

use enf_layout::bvh::{
    CHILD_INNER, CHILD_NONE, DEPTH, LeafBlock, NO_TRIANGLE, SECTION_BLOCKS, SECTION_HEADER,
    SECTION_NODES, WIDTH,
};
use enf_layout::sections::{self, Malformed};
use glam::Vec3;

use crate::aabb::Aabb;
use crate::mesh::TileMesh;

/// A hierarchy, borrowed from its blob.
#[derive(Clone, Copy, Debug)]
pub struct BvhView<'a> {
    header: &'a BvhHeader,
    nodes: &'a [BvhNode],
    blocks: &'a [LeafBlock],
    delta: f32,
    /// Origins beyond this along any axis are asked by force; all of them, if negative.
    reach: f32,
}

impl<'a> BvhView<'a> {
    /// Reads a blob (4-byte aligned), to be asked about the mesh that it was built for with a tolerance not above the
    /// one that it was built for (m). Every index in it is checked, so that a walk never leaves it.
    pub fn from_blob(blob: &'a [u8], mesh: &TileMesh<'_>, delta: f32) -> Result<Self, Malformed> {
        let bvh = Self::from_checked_blob(blob, delta)?;
        bvh.check(mesh).map_err(Malformed)?;
        Ok(bvh)
    }

    /// A blob that [`BvhView::from_blob`] has accepted before, without checking each index again.
    pub fn from_checked_blob(blob: &'a [u8], delta: f32) -> Result<Self, Malformed> {
        let headers: &[BvhHeader] = sections::section(blob, SECTION_HEADER)?;
        let [header] = headers else {
            return Err(Malformed(format!("hierarchy has {} headers", headers.len())));
        };
        if delta > header.delta || delta.is_nan() {
            let built = header.delta;
            return Err(Malformed(format!("hierarchy is for tolerance {built}, not {delta}")));
        }
        Ok(Self {
            header,
            nodes: sections::section(blob, SECTION_NODES)?,
            blocks: sections::section(blob, SECTION_BLOCKS)?,
            delta,
            reach: walk::reach(header, delta),
        })
    }

    fn check(&self, mesh: &TileMesh<'_>) -> Result<(), String> {
        let h = self.header;
        let triangle_count = mesh.len();
        if triangle_count >= 1 << 29 {
            return Err(format!("hierarchy of {triangle_count} triangles"));
        }
        let lanes = self.blocks.iter().flat_map(|block| block.global);
        let listed = lanes.filter(|&global| global != NO_TRIANGLE).count();
        if h.triangles != triangle_count || listed != triangle_count as usize {
            return Err(format!(
                "hierarchy is for {} triangles and lists {listed}, not {triangle_count}",
                h.triangles,
            ));
        }
        let finite = |p: &[f32; 3]| p.iter().all(|x| x.is_finite());
        if !(finite(&h.min) && finite(&h.max) && h.delta >= 0.0) {
            return Err(format!("hierarchy geometry makes no sense: {h:?}"));
        }
        if self.nodes.is_empty() || self.nodes.len() >= 1 << 28 {
            return Err(format!("hierarchy has {} nodes", self.nodes.len()));
        }
        let mut depth = vec![0u8; self.nodes.len()];
        depth[0] = 1;
        for (i, node) in self.nodes.iter().enumerate() {
            if depth[i] == 0 || depth[i] as usize > DEPTH {
                return Err(format!("hierarchy node {i} is at depth {}", depth[i]));
            }
            let sane = |step: &f32| step.is_normal() && *step > 0.0;
            if !finite(&node.origin) || !node.step.iter().all(sane) || node.used > 255 {
                return Err(format!("hierarchy node {i} has no frame"));
            }
            // Wide enough to be seen from everywhere, and finite on the way: see `walk::reach`.
            let reach = self.reach;
            let seen = |(origin, step): (&f32, &f32)| {
                origin.abs() <= reach && *step <= reach && 255.0 * step >= self.delta
            };
            if reach >= 0.0 && !node.origin.iter().zip(&node.step).all(seen) {
                return Err(format!("hierarchy node {i} has a frame that rays cannot see"));
            }
            let mut inner = 0;
            for (slot, child) in node.child.into_iter().enumerate() {
                if (node.used >> slot & 1 == 0) != (child == CHILD_NONE) {
                    return Err(format!("hierarchy node {i} is not sure about child {slot}"));
                }
                if child == CHILD_NONE {
                    let empty = |b: &[u8; 2 * WIDTH]| (b[slot], b[slot + WIDTH]) == (255, 0);
                    if !node.bounds.iter().all(empty) {
                        return Err(format!("hierarchy node {i} has a box for no child {slot}"));
                    }
                    continue;
                }
                if child & CHILD_INNER != 0 {
                    let at = u64::from(node.nodes) + u64::from(inner);
                    if child & !CHILD_INNER != inner || at <= i as u64 || at >= depth.len() as u64 {
                        return Err(format!("hierarchy node {i} has a child {at}"));
                    }
                    if depth[at as usize] != 0 {
                        return Err(format!("hierarchy node {at} has two parents"));
                    }
                    depth[at as usize] = depth[i] + 1;
                    inner += 1;
                    continue;
                }
                let block = u64::from(node.blocks) + u64::from(child & 7);
                let last = child >> 5;
                let Some(LeafBlock { global: lanes, .. }) = self.blocks.get(block as usize) else {
                    return Err(format!("hierarchy node {i} has a block {block}"));
                };
                if lanes[..=last as usize].contains(&NO_TRIANGLE) {
                    return Err(format!(
                        "hierarchy block {block} has fewer triangles than node {i} says"
                    ));
                }
            }
        }
        let mut seen = vec![false; triangle_count as usize];
        for (i, block) in self.blocks.iter().enumerate() {
            for (lane, &global) in block.global.iter().enumerate() {
                if global == NO_TRIANGLE {
                    continue;
                }
                let same = build::local(mesh, global).is_some_and(|triangle| {
                    let again = std::mem::replace(&mut seen[triangle as usize], true);
                    let corners = build::seen_by_rays(mesh, triangle);
                    let here = |c: usize, x: usize| block.corners[c][x][lane].to_bits();
                    !again
                        && (0..3).all(|c| (0..3).all(|x| corners[c][x].to_bits() == here(c, x)))
                        && mesh.materials[triangle as usize] == block.material[lane]
                });
                if !same {
                    return Err(format!(
                        "hierarchy block {i} is not as triangle {global} of the scene"
                    ));
                }
            }
        }
        Ok(())
    }

    /// Box, tolerance and count.
    pub fn header(&self) -> &'a BvhHeader {
        self.header
    }

    /// Corners of the triangle of a hit, m.
    #[inline]
    pub fn corners(&self, slot: u32) -> [Vec3; 3] {
        let (block, lane) = (&self.blocks[(slot / 4) as usize], (slot % 4) as usize);
        // One by one: to map the array would copy the whole block first.
        let corner = |c: usize| {
            let [x, y, z] = &block.corners[c];
            Vec3::new(x[lane], y[lane], z[lane])
        };
        [corner(0), corner(1), corner(2)]
    }

    /// Its material.
    #[inline]
    pub fn material(&self, slot: u32) -> u32 {
        self.blocks[(slot / 4) as usize].material[(slot % 4) as usize]
    }

    /// Its global index; `None` where a block has none.
    fn global(&self, slot: u32) -> Option<u32> {
        let global = self.blocks[(slot / 4) as usize].global[(slot % 4) as usize];
        (global != NO_TRIANGLE).then_some(global)
    }

    /// Number of blocks.
    pub fn block_count(&self) -> usize {
        self.blocks.len()
    }

    /// Number of nodes.
    pub fn node_count(&self) -> usize {
        self.nodes.len()
    }

    /// The mesh's box and four tolerances: outside, there is nothing to hit.
    pub fn bounds(&self) -> Aabb {
        Aabb { min: Vec3::from_array(self.header.min), max: Vec3::from_array(self.header.max) }
    }
}

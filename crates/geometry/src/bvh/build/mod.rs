//! How a hierarchy comes about.
//!
//! [`binary`] halves the triangles by the surface area heuristic, counted in blocks; [`wide`] makes nodes of eight
//! children out of that. What is stored is hardly more than which triangle lies in which lane: boxes are found again by
//! [`complete`], from the mesh.

mod binary;
mod complete;
mod wide;

use enf_layout::bvh::{
    BvhHeader, BvhNode, LEAF_TRIANGLES, LeafBlock, SECTION_BLOCKS, SECTION_HEADER, SECTION_NODES,
    SECTIONS, WIDTH,
};
use enf_layout::sections::{self, Transform};
use glam::{Vec4, Vec4Swizzles};
use zerocopy::IntoBytes;

pub use complete::complete_bvh;
pub(super) use complete::{local, seen_by_rays};

use crate::mesh::TileMesh;

/// Boxes are grown by so many tolerances.
const GROWN: f64 = 4.0;
/// Of so many triangles, one block more than necessary may come.
const SPARING: usize = 32;

/// A box that grows, m. Its fourth component is of no use.
#[derive(Clone, Copy)]
struct Bounds {
    min: Vec4,
    max: Vec4,
}

impl Bounds {
    const EMPTY: Self = Self { min: Vec4::INFINITY, max: Vec4::NEG_INFINITY };

    #[inline(always)]
    fn add(&mut self, min: Vec4, max: Vec4) {
        self.min = min.min(self.min);
        self.max = max.max(self.max);
    }

    /// Half its surface, if it is a box.
    #[inline(always)]
    fn area(&self) -> f32 {
        let d = self.max - self.min;
        let faces = d * d.yzxw();
        faces.x + faces.y + faces.z
    }
}

/// Blocks that so many triangles need.
fn blocks_needed(triangles: usize) -> usize {
    triangles.div_ceil(LEAF_TRIANGLES)
}

/// Blocks that so many triangles come to, at most.
fn blocks_most(triangles: usize) -> usize {
    blocks_needed(triangles) + triangles / SPARING
}

/// Nodes above so many blocks, at most.
fn nodes_most(blocks: usize) -> usize {
    // Where a node with an inner child has eight children and one without has at least two blocks, which is what
    // `wide` falls back to: i nodes of the first kind, l of the others. There are 8 i + 2 l <= i + l - 1 + blocks
    // children and l <= 7 i + 1, so l <= blocks / 2 and i <= (blocks - 1 - l) / 7.
    blocks * 4 / 7 + 1
}

fn sizes(nodes: usize, blocks: usize) -> [usize; SECTIONS] {
    [size_of::<BvhHeader>(), nodes * size_of::<BvhNode>(), blocks * size_of::<LeafBlock>()]
}

/// Upper bound of the bytes of the blob for a mesh of so many triangles.
pub fn bvh_bytes_estimate(triangles: u64) -> u64 {
    let blocks = blocks_most(triangles as usize);
    sections::blob_bytes(&sizes(nodes_most(blocks), blocks)) as u64
}

/// Upper bound of the bytes that [`build_bvh`] takes, blob included.
pub fn bvh_build_bytes(triangles: u64) -> u64 {
    let [dividing, tree] = binary::bytes(triangles as usize);
    let [widening, wide] = wide::bytes(blocks_most(triangles as usize));
    let writing = wide as u64 + bvh_bytes_estimate(triangles);
    // And what is on the program's own stack.
    writing.max(dividing.max(tree + widening) as u64) + (64 << 10)
}

/// Builds the hierarchy of a mesh for tolerance `delta` (m). The blob depends on the arguments alone, and is complete
/// only after [`complete_bvh`], as after loading it.
pub fn build_bvh(mesh: &TileMesh, delta: f32) -> Vec<u8> {
    let delta = if delta.is_finite() { delta.max(0.0) } else { 0.0 };
    let tree = binary::divide(mesh);
    let (shape, references) = wide::collapse(&tree);
    let bounds = tree.bounds;
    drop(tree);

    let out = GROWN * f64::from(delta);
    let grown = |p: f32, by: f64| ((f64::from(p) + by) as f32).clamp(f32::MIN, f32::MAX);
    let (min, max) = (bounds.min.truncate().to_array(), bounds.max.truncate().to_array());
    let (min, max) = if mesh.is_empty() { ([0.0; 3], [0.0; 3]) } else { (min, max) };
    let header = BvhHeader {
        min: min.map(|p| grown(p.next_down(), -out)),
        max: max.map(|p| grown(p.next_up(), out)),
        delta,
        triangles: mesh.len(),
    };

    let lengths = sizes(shape.len(), references.len());
    let mut blob = vec![0; sections::blob_bytes(&lengths)];
    let words = |record: usize| (record / 4) as u32;
    let places = sections::write_table(
        &mut blob,
        &[
            (lengths[SECTION_HEADER], Transform::None, 0),
            (lengths[SECTION_NODES], Transform::Planes, words(size_of::<BvhNode>())),
            (lengths[SECTION_BLOCKS], Transform::Planes, words(size_of::<LeafBlock>())),
        ],
    );
    blob[places[SECTION_HEADER].clone()].copy_from_slice(header.as_bytes());
    let child = std::mem::offset_of!(BvhNode, child);
    let nodes = blob[places[SECTION_NODES].clone()].chunks_exact_mut(size_of::<BvhNode>());
    for (node, shape) in nodes.zip(&shape) {
        node[child..child + WIDTH].copy_from_slice(shape);
    }
    let global = std::mem::offset_of!(LeafBlock, global);
    let blocks = blob[places[SECTION_BLOCKS].clone()].chunks_exact_mut(size_of::<LeafBlock>());
    let mut before = 0;
    for (block, references) in blocks.zip(&references) {
        let lanes = references.map(|triangle| {
            let d = triangle.wrapping_sub(before) as i32;
            before = triangle;
            ((d << 1) ^ (d >> 31)) as u32
        });
        block[global..global + size_of_val(&lanes)].copy_from_slice(lanes.as_bytes());
    }
    blob
}

#[cfg(test)]
mod tests;

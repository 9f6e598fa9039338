//! How a hierarchy comes about.
//!
//! [`binary`] halves the triangles by the surface area heuristic, counted in blocks; [`wide`] makes nodes of eight
//! children out of that. What is stored is hardly more than which triangle lies in which lane: boxes are found again by
//! [`complete`], from the mesh.

mod binary;
mod complete;
mod wide;

use enf_layout::bvh::{BvhHeader, BvhNode, LEAF_TRIANGLES, LeafBlock, WIDTH};
use enf_layout::sections::{self, Transform};
use zerocopy::IntoBytes;

pub use complete::complete_bvh;
pub(super) use complete::seen_by_rays;

use crate::mesh::TileMesh;

/// Boxes are grown by so many tolerances.
const GROWN: f64 = 4.0;
/// Of so many triangles, one block more than necessary may come.
const SPARING: usize = 32;

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

fn sizes(nodes: usize, blocks: usize) -> [usize; 4] {
    [
        size_of::<BvhHeader>(),
        nodes * size_of::<BvhNode>(),
        blocks * size_of::<LeafBlock>(),
        blocks * size_of::<[u32; LEAF_TRIANGLES]>(),
    ]
}

/// Upper bound of the bytes of the blob for a mesh of so many triangles.
pub fn bvh_bytes_estimate(triangles: u64) -> u64 {
    let blocks = blocks_most(triangles as usize);
    sections::blob_bytes(&sizes(nodes_most(blocks), blocks)) as u64
}

/// Upper bound of the bytes that [`build_bvh`] takes, blob included.
pub fn bvh_build_bytes(triangles: u64) -> u64 {
    let blocks = blocks_most(triangles as usize);
    let dividing = binary::bytes(triangles as usize);
    let widening = wide::bytes(triangles as usize, blocks);
    (dividing + widening) as u64 + bvh_bytes_estimate(triangles)
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
    let [head, nodes, blocks, lanes] = lengths;
    let places = sections::write_table(
        &mut blob,
        &[
            (head, Transform::None, 0),
            (nodes, Transform::Planes, (size_of::<BvhNode>() / 4) as u32),
            (blocks, Transform::None, 0),
            (lanes, Transform::Delta, 1),
        ],
    );
    blob[places[0].clone()].copy_from_slice(header.as_bytes());
    let child = std::mem::offset_of!(BvhNode, child);
    let nodes = blob[places[1].clone()].chunks_exact_mut(size_of::<BvhNode>());
    for (node, shape) in nodes.zip(&shape) {
        node[child..child + WIDTH].copy_from_slice(shape);
    }
    blob[places[3].clone()].copy_from_slice(references.as_bytes());
    blob
}

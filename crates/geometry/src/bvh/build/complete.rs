//! What a stored hierarchy leaves out is found in the mesh: corners of the triangles, boxes, and where nodes and blocks
//! lie.

use enf_layout::bvh::{
    BvhHeader, BvhNode, CHILD_INNER, CHILD_NONE, DEPTH, LEAF_TRIANGLES, LeafBlock, NO_TRIANGLE,
    SECTIONS, WIDTH,
};
use enf_layout::sections::{self, Malformed};
use glam::Vec3;
use zerocopy::{FromBytes, IntoBytes, KnownLayout};

use super::GROWN;
use crate::mesh::TileMesh;
use crate::ray::has_no_area;

/// Fills in what a stored hierarchy leaves to its mesh: once, after building or loading. It takes no memory.
///
/// # Errors
/// When the hierarchy is not one of this mesh.
pub fn complete_bvh(blob: &mut [u8], mesh: &TileMesh<'_>) -> Result<(), Malformed> {
    let [header, nodes, blocks, references] = sections::split_mut::<SECTIONS>(blob)?;
    let [header] = typed::<BvhHeader>(header, "header")? else {
        return Err(Malformed("hierarchy has not one header".into()));
    };
    let nodes = typed::<BvhNode>(nodes, "nodes")?;
    let blocks = typed::<LeafBlock>(blocks, "blocks")?;
    let references = typed::<[u32; LEAF_TRIANGLES]>(references, "references")?;
    if blocks.len() != references.len() {
        let (b, r) = (blocks.len(), references.len());
        return Err(Malformed(format!("hierarchy has {b} blocks and references for {r}")));
    }
    if nodes.is_empty() || nodes.len() >= 1 << 28 || blocks.len() >= 1 << 29 {
        let (n, b) = (nodes.len(), blocks.len());
        return Err(Malformed(format!("hierarchy has {n} nodes and {b} blocks")));
    }
    let grown = GROWN * f64::from(header.delta);
    let mut completing =
        Completing { mesh, grown, nodes, blocks, references, next_node: 1, next_block: 0 };
    completing.node(0, 1)?;
    let Completing { nodes, blocks, next_node, next_block, .. } = completing;
    if next_node != nodes.len() || next_block != blocks.len() {
        let (n, b) = (nodes.len(), blocks.len());
        return Err(Malformed(format!(
            "hierarchy has {n} nodes and {b} blocks, and uses {next_node} and {next_block} of them"
        )));
    }
    Ok(())
}

fn typed<'a, T>(bytes: &'a mut [u8], what: &str) -> Result<&'a mut [T], Malformed>
where
    T: FromBytes + IntoBytes + KnownLayout,
{
    let length = bytes.len();
    <[T]>::mut_from_bytes(bytes)
        .map_err(|_| Malformed(format!("{what} of hierarchy have {length} bytes")))
}

/// The corners of a triangle; not a number if it has no area, as nothing hits that.
pub(in super::super) fn seen_by_rays(mesh: &TileMesh<'_>, triangle: u32) -> [[f32; 3]; 3] {
    let corners = mesh.corner_arrays(triangle);
    if has_no_area(&corners.map(|p| p.map(f64::from))) {
        [[f32::NAN; 3]; 3]
    } else {
        corners.map(|p| *p)
    }
}

/// A box, m.
#[derive(Clone, Copy)]
struct Bounds {
    min: Vec3,
    max: Vec3,
}

impl Bounds {
    const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    #[inline(always)]
    fn add(&mut self, min: Vec3, max: Vec3) {
        self.min = self.min.min(min);
        self.max = self.max.max(max);
    }
}

struct Completing<'a, 'm> {
    mesh: &'a TileMesh<'m>,
    /// How far boxes are grown, m.
    grown: f64,
    nodes: &'a mut [BvhNode],
    blocks: &'a mut [LeafBlock],
    references: &'a mut [[u32; LEAF_TRIANGLES]],
    next_node: usize,
    next_block: usize,
}

impl Completing<'_, '_> {
    /// Completes a node and what is below it, in the order in which they were written; returns its box.
    fn node(&mut self, at: usize, depth: usize) -> Result<Bounds, Malformed> {
        if depth > DEPTH {
            return Err(Malformed(format!("hierarchy node {at} is at depth {depth}")));
        }
        let (first_node, first_block) = (self.next_node, self.next_block);
        let mut boxes = [Bounds::EMPTY; WIDTH];
        let mut used = 0u32;
        let (mut inner, mut leaves) = (0, 0);
        let mut child = self.nodes[at].child;
        for (slot, child) in child.iter_mut().enumerate() {
            if *child == CHILD_NONE {
                continue;
            }
            used |= 1 << slot;
            if *child & CHILD_INNER != 0 {
                *child = CHILD_INNER | inner;
                inner += 1;
            } else {
                let block = first_block + usize::from(leaves);
                boxes[slot] = self.block(at, block, usize::from(*child >> 5 & 3) + 1)?;
                *child = *child & 0x60 | leaves;
                leaves += 1;
            }
        }
        self.next_node += usize::from(inner);
        self.next_block += usize::from(leaves);
        if self.next_node > self.nodes.len() {
            return Err(Malformed(format!("hierarchy node {at} has children that are missing")));
        }
        for slot in 0..WIDTH {
            if used >> slot & 1 != 0 && child[slot] & CHILD_INNER != 0 {
                boxes[slot] = self.node(first_node + usize::from(child[slot] & 7), depth + 1)?;
            }
        }
        let node = &mut self.nodes[at];
        (node.nodes, node.blocks) = (first_node as u32, first_block as u32);
        (node.child, node.used) = (child, used);
        Ok(frame(node, &boxes, self.grown))
    }

    /// Fills a block with its triangles; returns their box.
    fn block(&mut self, node: usize, at: usize, count: usize) -> Result<Bounds, Malformed> {
        let (Some(block), Some(references)) =
            (self.blocks.get_mut(at), self.references.get_mut(at))
        else {
            return Err(Malformed(format!("hierarchy node {node} has a block {at}")));
        };
        let mut bounds = Bounds::EMPTY;
        for (lane, reference) in references.iter_mut().enumerate() {
            if lane >= count {
                *reference = NO_TRIANGLE;
                continue;
            }
            let triangle = *reference;
            if triangle >= self.mesh.len() {
                let n = self.mesh.len();
                return Err(Malformed(format!("hierarchy lists triangle {triangle} of {n}")));
            }
            let [a, b, c] = self.mesh.corners(triangle);
            bounds.add(a.min(b).min(c), a.max(b).max(c));
            for (corner, p) in seen_by_rays(self.mesh, triangle).into_iter().enumerate() {
                for (axis, x) in p.into_iter().enumerate() {
                    block.corners[corner][axis][lane] = x;
                }
            }
            block.global[lane] = self.mesh.global[triangle as usize];
            block.material[lane] = self.mesh.materials[triangle as usize];
        }
        Ok(bounds)
    }
}

/// Writes the children's boxes, grown by so many metres, into a node: in steps of a power of two from a common origin,
/// outwards. Empty boxes come out with their lower ends above their upper ones. Returns the box around all.
fn frame(node: &mut BvhNode, boxes: &[Bounds; WIDTH], grown: f64) -> Bounds {
    let mut whole = Bounds::EMPTY;
    for b in boxes {
        whole.add(b.min, b.max);
    }
    let frame =
        if whole.min.x > whole.max.x { Bounds { min: Vec3::ZERO, max: Vec3::ZERO } } else { whole };
    for axis in 0..3 {
        let (low, high) = (f64::from(frame.min[axis]) - grown, f64::from(frame.max[axis]) + grown);
        let origin = (low as f32).next_down().clamp(f32::MIN, f32::MAX);
        let exponent = exponent((high - f64::from(origin)) / 255.0);
        let per_metre = 1.0 / step(exponent);
        node.origin[axis] = origin;
        node.step[axis] = step(exponent) as f32;
        let origin = f64::from(origin);
        let (lower, upper) = node.bounds[axis].split_at_mut(WIDTH);
        for ((b, lower), upper) in boxes.iter().zip(lower).zip(upper) {
            let from = (f64::from(b.min[axis]) - grown - origin) * per_metre;
            let to = (f64::from(b.max[axis]) + grown - origin) * per_metre;
            // Saturating casts, which cut off what is behind the point.
            *lower = from as u8;
            let cut = to as u8;
            *upper = cut.saturating_add(u8::from(f64::from(cut) < to));
        }
    }
    whole
}

/// The least exponent whose step is not below so many metres.
fn exponent(wanted: f64) -> u8 {
    // 896 is the difference of what both formats add to an exponent.
    let bits = wanted.to_bits();
    let down = (bits >> 52 & 0x7ff) as i32 - 896;
    let exponent = down + i32::from(bits & ((1 << 52) - 1) != 0);
    if wanted > 0.0 { exponent.clamp(1, 254) as u8 } else { 1 }
}

/// The step of an exponent, m.
fn step(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exponents_are_the_least_that_do() {
        let mut samples = vec![0.0, -1.0, f64::INFINITY, 1e300, 1e-300, f64::from(f32::MAX)];
        for e in -140..130 {
            let x = 2f64.powi(e);
            samples.extend([x, x.next_up(), x.next_down(), 1.5 * x]);
        }
        for wanted in samples {
            let mut least = 1;
            while least < 254 && step(least) < wanted {
                least += 1;
            }
            assert_eq!(exponent(wanted), least, "{wanted}");
        }
    }
}

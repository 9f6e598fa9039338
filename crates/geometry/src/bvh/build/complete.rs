//! What a stored hierarchy leaves out is found in the mesh: corners of the triangles, boxes, and where nodes and blocks
//! lie.

use enf_layout::bvh::{
    BvhHeader, BvhNode, CHILD_INNER, CHILD_NONE, DEPTH, LEAF_TRIANGLES, LeafBlock, NO_TRIANGLE,
    SECTIONS, WIDTH,
};
use enf_layout::sections::{self, Malformed};
use glam::{Mat4, Vec3, Vec4, Vec4Swizzles};
use zerocopy::{FromBytes, IntoBytes, KnownLayout};

use super::{Bounds, GROWN};
use crate::mesh::TileMesh;
use crate::ray::has_no_area;

/// Fills in what a stored hierarchy leaves to its mesh: once, after building or loading. It takes no memory. Every index is checked or
/// made anew on the way, so that [`super::BvhView::from_checked_blob`] may follow.
///
/// # Errors
/// When the hierarchy is not one of this mesh.
pub fn complete_bvh(blob: &mut [u8], mesh: &TileMesh<'_>) -> Result<(), Malformed> {
    let [header, nodes, blocks] = sections::split_mut::<SECTIONS>(blob)?;
    let [header] = typed::<BvhHeader>(header, "header")? else {
        return Err(Malformed("hierarchy has not one header".into()));
    };
    if header.triangles != mesh.len() {
        let (h, m) = (header.triangles, mesh.len());
        return Err(Malformed(format!("hierarchy is for {h} triangles, not {m}")));
    }
    let nodes = typed::<BvhNode>(nodes, "nodes")?;
    let blocks = typed::<LeafBlock>(blocks, "blocks")?;
    if nodes.is_empty() || nodes.len() >= 1 << 28 || blocks.len() >= 1 << 29 {
        let (n, b) = (nodes.len(), blocks.len());
        return Err(Malformed(format!("hierarchy has {n} nodes and {b} blocks")));
    }
    let mut completing = Completing {
        mesh,
        grown: GROWN * f64::from(header.delta),
        again: nodes[0].used != 0,
        nodes,
        blocks,
        next_node: 1,
        next_block: 0,
        before: 0,
    };
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

/// The triangle of a mesh that has an index in the scene.
pub(in super::super) fn local(mesh: &TileMesh<'_>, global: u32) -> Option<u32> {
    // Most often, nothing is missing between the first and this one.
    let guess = global.checked_sub(*mesh.global.first()?)? as usize;
    if mesh.global.get(guess) == Some(&global) {
        return Some(guess as u32);
    }
    mesh.global.binary_search(&global).ok().map(|i| i as u32)
}

/// The corners of a triangle; not a number if it has no area, as nothing hits that.
pub(in super::super) fn seen_by_rays(mesh: &TileMesh<'_>, triangle: u32) -> [[f32; 3]; 3] {
    let corners = mesh.corner_arrays(triangle);
    if is_flat(corners) { [[f32::NAN; 3]; 3] } else { corners.map(|p| *p) }
}

/// [`has_no_area`], in a hurry.
#[inline(always)]
fn is_flat(corners: [&[f32; 3]; 3]) -> bool {
    let [a, b, c] = corners.map(|p| Vec3::from_array(*p).extend(0.0));
    let (e, f) = (b - a, c - a);
    let (x, y) = (e.yzxw() * f.zxyw(), e.zxyw() * f.yzxw());
    // Both products are known to a few units in the last of 24 digits; below the last term, digits get lost.
    let doubt = (x.abs() + y.abs()) * (1.0 / (1 << 20) as f32) + Vec4::splat(1e-30);
    !(x - y).abs().cmpgt(doubt).any() && has_no_area(&corners.map(|p| p.map(f64::from)))
}

struct Completing<'a, 'm> {
    mesh: &'a TileMesh<'m>,
    /// How far boxes are grown, m.
    grown: f64,
    nodes: &'a mut [BvhNode],
    blocks: &'a mut [LeafBlock],
    /// Whether blocks are complete already, and hold the scene's indices.
    again: bool,
    next_node: usize,
    next_block: usize,
    /// The triangle in the lane before.
    before: u32,
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
        let Some(block) = self.blocks.get_mut(at) else {
            return Err(Malformed(format!("hierarchy node {node} has a block {at}")));
        };
        let mesh = *self.mesh;
        let mut bounds = Bounds::EMPTY;
        // Corner, lane.
        let mut seen = [[Vec4::ZERO; LEAF_TRIANGLES]; 3];
        let (mut global, mut material) = ([NO_TRIANGLE; LEAF_TRIANGLES], [0; LEAF_TRIANGLES]);
        for (lane, &stored) in block.global.iter().enumerate().take(count) {
            let triangle = if self.again {
                local(&mesh, stored).unwrap_or(NO_TRIANGLE)
            } else {
                self.before.wrapping_add((stored >> 1) ^ (stored & 1).wrapping_neg())
            };
            self.before = triangle;
            let place = triangle as usize;
            let (Some(&g), Some(&m), Some(corners)) =
                (mesh.global.get(place), mesh.materials.get(place), mesh.triangles.get(place))
            else {
                let n = mesh.len();
                return Err(Malformed(format!(
                    "hierarchy block {at} has triangle {triangle} of {n}"
                )));
            };
            (global[lane], material[lane]) = (g, m);
            let corners = corners.map(|v| &mesh.vertices[v as usize]);
            let [a, b, c] = corners.map(|p| Vec3::from_array(*p).extend(0.0));
            bounds.add(a.min(b).min(c), a.max(b).max(c));
            let flat = is_flat(corners);
            for (seen, p) in seen.iter_mut().zip([a, b, c]) {
                seen[lane] = if flat { Vec4::NAN } else { p };
            }
        }
        (block.global, block.material) = (global, material);
        for (corner, [a, b, c, d]) in block.corners.iter_mut().zip(seen) {
            let by_axis = Mat4::from_cols(a, b, c, d).transpose().to_cols_array_2d();
            let [x, y, z, _] = by_axis;
            *corner = [x, y, z];
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
        if whole.min.x > whole.max.x { Bounds { min: Vec4::ZERO, max: Vec4::ZERO } } else { whole };
    let (lowest, highest) = (frame.min.to_array(), frame.max.to_array());
    let ends = boxes.map(|b| (b.min.to_array(), b.max.to_array()));
    for axis in 0..3 {
        let (low, high) = (f64::from(lowest[axis]) - grown, f64::from(highest[axis]) + grown);
        let origin = (low as f32).next_down().clamp(f32::MIN, f32::MAX);
        let exponent = exponent((high - f64::from(origin)) / 255.0);
        node.origin[axis] = origin;
        node.step[axis] = step(exponent) as f32;
        let (per_metre, origin) = (1.0 / step(exponent), f64::from(origin));
        let (lower, upper) = node.bounds[axis].split_at_mut(WIDTH);
        for (((min, max), lower), upper) in ends.iter().zip(lower).zip(upper) {
            let from = (f64::from(min[axis]) - grown - origin) * per_metre;
            let to = (f64::from(max[axis]) + grown - origin) * per_metre;
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

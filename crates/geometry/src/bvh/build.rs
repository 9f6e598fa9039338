//! Building by the surface area heuristic in bins (Wald 2007, *On fast construction of SAH-based bounding
//! volume hierarchies*), then eight children to a node by opening the largest (Wald, Benthin and Boulos 2008).

use arrayvec::ArrayVec;
use enf_layout::bvh::{
    BvhHeader, BvhNode, CHILD_INNER, CHILD_NONE, DEPTH, LEAF_TRIANGLES, LeafBlock, NO_TRIANGLE,
    SECTION_BLOCKS, SECTION_REFERENCES, WIDTH,
};
use enf_layout::sections::{self, Malformed, Transform};
use glam::Vec3;
use zerocopy::IntoBytes;

use crate::mesh::TileMesh;
use crate::ray::has_no_area;

/// Boxes are grown by so many tolerances.
const GROWN: f64 = 4.0;
/// Bins along each axis.
const BINS: usize = 16;
/// Cost of a node's test for one child, in triangle tests.
const NODE_COST: f32 = 1.5;
/// Deeper than this (binary levels), halves are cut by count, which ends soon.
const STEEP: u32 = 30;

/// Upper bound of the bytes of the blob for a mesh of so many triangles.
pub fn bvh_bytes_estimate(triangles: u64) -> u64 {
    // A node with an inner child has eight children, one without holds at least two triangles: of n triangles come
    // 4 n / 7 nodes at most.
    let nodes = triangles * 4 / 7 + 2;
    sections::blob_bytes(&[
        size_of::<BvhHeader>(),
        nodes as usize * size_of::<BvhNode>(),
        triangles as usize * size_of::<LeafBlock>(),
        triangles as usize * 4 * LEAF_TRIANGLES,
    ]) as u64
}

/// Upper bound of the bytes that [`build_bvh`] takes, blob included.
pub fn bvh_build_bytes(triangles: u64) -> u64 {
    let binary = 2 * triangles * size_of::<Binary>() as u64;
    triangles * size_of::<Item>() as u64 + binary + bvh_bytes_estimate(triangles)
}

/// A triangle's box.
#[derive(Clone, Copy)]
struct Item {
    min: Vec3,
    max: Vec3,
    triangle: u32,
}

/// A node of the binary tree.
#[derive(Clone, Copy)]
struct Binary {
    min: Vec3,
    max: Vec3,
    /// Leaf: first item; inner node: the second child (the first follows its parent).
    at: u32,
    /// Triangles of a leaf; 0 = inner node.
    count: u32,
}

fn area(min: Vec3, max: Vec3) -> f32 {
    let d = (max - min).max(Vec3::ZERO);
    d.x * d.y + d.y * d.z + d.z * d.x
}

/// Builds the hierarchy of a mesh for tolerance `delta` (m). The blob depends on the arguments alone, and is complete
/// only after [`complete_bvh`], as after loading it.
pub fn build_bvh(mesh: &TileMesh, delta: f32) -> Vec<u8> {
    let delta = if delta.is_finite() { delta.max(0.0) } else { 0.0 };
    let mut items: Vec<Item> = (0..mesh.len())
        .map(|triangle| {
            let [a, b, c] = mesh.corners(triangle);
            Item { min: a.min(b).min(c), max: a.max(b).max(c), triangle }
        })
        .collect();
    let binary = divide(&mut items);
    let references: Vec<u32> = Vec::with_capacity(items.len());
    let mut wide = Wide {
        binary: &binary,
        items: &items,
        grown: GROWN * f64::from(delta),
        nodes: Vec::new(),
        references,
    };
    wide.collapse();
    let bounds = mesh.bounds();
    let grown = |p: f32, out: f64| ((f64::from(p) + out) as f32).clamp(f32::MIN, f32::MAX);
    let (min, max) = (bounds.min.to_array(), bounds.max.to_array());
    let (min, max) = if mesh.is_empty() { ([0.0; 3], [0.0; 3]) } else { (min, max) };
    let header = BvhHeader {
        min: min.map(|p| grown(p.next_down(), -wide.grown)),
        max: max.map(|p| grown(p.next_up(), wide.grown)),
        delta,
        triangles: mesh.len(),
    };
    sections::build(&[
        (header.as_bytes(), Transform::None, 1),
        (wide.nodes.as_bytes(), Transform::Delta, (size_of::<BvhNode>() / 4) as u32),
        (
            &vec![0; wide.references.len() / LEAF_TRIANGLES * size_of::<LeafBlock>()],
            Transform::None,
            1,
        ),
        (wide.references.as_bytes(), Transform::Delta, 1),
    ])
}

/// Fills in the blocks from the mesh: once, after building or loading.
///
/// # Errors
/// When the hierarchy is not one of this mesh.
pub fn complete_bvh(blob: &mut [u8], mesh: &TileMesh<'_>) -> Result<(), Malformed> {
    let (blocks, references) = sections::section_mut_and::<LeafBlock, [u32; LEAF_TRIANGLES]>(
        blob,
        SECTION_BLOCKS,
        SECTION_REFERENCES,
    )?;
    if blocks.len() != references.len() {
        return Err(Malformed(format!(
            "hierarchy has {} blocks and references for {}",
            blocks.len(),
            references.len()
        )));
    }
    for (block, references) in blocks.iter_mut().zip(references) {
        for (lane, &triangle) in references.iter().enumerate() {
            if triangle == NO_TRIANGLE {
                continue;
            }
            if triangle >= mesh.len() {
                let n = mesh.len();
                return Err(Malformed(format!("hierarchy lists triangle {triangle} of {n}")));
            }
            for (corner, p) in seen_by_rays(mesh, triangle).into_iter().enumerate() {
                for (axis, x) in p.into_iter().enumerate() {
                    block.corners[corner][axis][lane] = x;
                }
            }
            block.global[lane] = mesh.global[triangle as usize];
            block.material[lane] = mesh.materials[triangle as usize];
        }
    }
    Ok(())
}

/// The corners of a triangle; not a number if it has no area, as nothing hits that.
pub(super) fn seen_by_rays(mesh: &TileMesh<'_>, triangle: u32) -> [[f32; 3]; 3] {
    let corners = mesh.corner_arrays(triangle);
    if has_no_area(&corners.map(|p| p.map(f64::from))) {
        [[f32::NAN; 3]; 3]
    } else {
        corners.map(|p| *p)
    }
}

struct Job {
    /// The node to make: its parent if it is a second child.
    second_of: Option<u32>,
    from: usize,
    to: usize,
    depth: u32,
}

/// Sorts the items into a binary tree.
fn divide(items: &mut [Item]) -> Vec<Binary> {
    let mut nodes: Vec<Binary> = Vec::with_capacity(2 * items.len() + 1);
    let mut stack = vec![Job { second_of: None, from: 0, to: items.len(), depth: 0 }];
    while let Some(job) = stack.pop() {
        let at = nodes.len() as u32;
        if let Some(parent) = job.second_of {
            nodes[parent as usize].at = at;
        }
        let mine = &mut items[job.from..job.to];
        let (mut min, mut max) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
        for item in mine.iter() {
            (min, max) = (min.min(item.min), max.max(item.max));
        }
        let middle = split(mine, min, max, job.depth);
        let count = if middle.is_none() { mine.len() as u32 } else { 0 };
        nodes.push(Binary { min, max, at: job.from as u32, count });
        if let Some(middle) = middle {
            let (from, to, depth) = (job.from, job.to, job.depth + 1);
            let middle = from + middle;
            stack.push(Job { second_of: Some(at), from: middle, to, depth });
            stack.push(Job { second_of: None, from, to: middle, depth });
        }
    }
    nodes
}

#[derive(Clone, Copy)]
struct Bin {
    min: Vec3,
    max: Vec3,
    count: u32,
}

const EMPTY: Bin = Bin { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY, count: 0 };

impl Bin {
    fn add(&mut self, other: &Self) {
        self.min = self.min.min(other.min);
        self.max = self.max.max(other.max);
        self.count += other.count;
    }
}

/// Where to part the items, which are then sorted accordingly; `None` for a leaf.
fn split(items: &mut [Item], min: Vec3, max: Vec3, depth: u32) -> Option<usize> {
    let n = items.len();
    if n <= 1 {
        return None;
    }
    // Centres, twice.
    let (mut low, mut high) = (Vec3::INFINITY, Vec3::NEG_INFINITY);
    for item in items.iter() {
        let c = item.min + item.max;
        (low, high) = (low.min(c), high.max(c));
    }
    let size = high - low;
    let spread = size.is_finite() && size.max_element() > 0.0;
    if spread && depth < STEEP {
        let scale = size.to_array().map(|s| if s > 0.0 { BINS as f32 * 0.999_99 / s } else { 0.0 });
        let scale = Vec3::from_array(scale.map(|s| if s.is_finite() { s } else { 0.0 }));
        let mut bins = [[EMPTY; BINS]; 3];
        for item in items.iter() {
            let at = (item.min + item.max - low) * scale;
            let own = Bin { min: item.min, max: item.max, count: 1 };
            bins[0][(at.x as usize).min(BINS - 1)].add(&own);
            bins[1][(at.y as usize).min(BINS - 1)].add(&own);
            bins[2][(at.z as usize).min(BINS - 1)].add(&own);
        }
        // (cost, axis, first bin of the second part)
        let mut best: Option<(f32, usize, usize)> = None;
        for (axis, bins) in bins.iter().enumerate() {
            if scale[axis] == 0.0 {
                continue;
            }
            let mut right = [0.0f32; BINS];
            let mut sum = EMPTY;
            for k in (1..BINS).rev() {
                sum.add(&bins[k]);
                right[k] = area(sum.min, sum.max) * sum.count as f32;
            }
            let mut sum = EMPTY;
            for k in 1..BINS {
                sum.add(&bins[k - 1]);
                if sum.count == 0 || sum.count as usize == n {
                    continue;
                }
                let cost = area(sum.min, sum.max) * sum.count as f32 + right[k];
                if best.is_none_or(|b| cost < b.0) {
                    best = Some((cost, axis, k));
                }
            }
        }
        if let Some((cost, axis, k)) = best {
            let whole = area(min, max);
            if n <= LEAF_TRIANGLES && cost + 2.0 * NODE_COST * whole >= n as f32 * whole {
                return None;
            }
            let front = |item: &Item| {
                let at = (item.min[axis] + item.max[axis] - low[axis]) * scale[axis];
                (at as usize).min(BINS - 1) < k
            };
            let middle = partition(items, front);
            if middle > 0 && middle < n {
                return Some(middle);
            }
        }
    }
    if n <= LEAF_TRIANGLES {
        return None;
    }
    let axis = if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    };
    let centre = |item: &Item| item.min[axis] + item.max[axis];
    items.select_nth_unstable_by(n / 2, |a, b| {
        centre(a).total_cmp(&centre(b)).then(a.triangle.cmp(&b.triangle))
    });
    Some(n / 2)
}

/// Moves items that are `front` before the others; returns how many.
fn partition(items: &mut [Item], front: impl Fn(&Item) -> bool) -> usize {
    let (mut i, mut j) = (0, items.len());
    loop {
        while i < j && front(&items[i]) {
            i += 1;
        }
        while i < j && !front(&items[j - 1]) {
            j -= 1;
        }
        if i >= j {
            return i;
        }
        items.swap(i, j - 1);
    }
}

/// The wide tree while it is made.
struct Wide<'a> {
    binary: &'a [Binary],
    items: &'a [Item],
    grown: f64,
    nodes: Vec<BvhNode>,
    references: Vec<u32>,
}

const NOTHING: BvhNode = BvhNode {
    origin: [0.0; 3],
    step: [1.0; 3],
    nodes: 0,
    blocks: 0,
    child: [CHILD_NONE; WIDTH],
    bounds: [[255, 255, 255, 255, 255, 255, 255, 255, 0, 0, 0, 0, 0, 0, 0, 0]; 3],
    used: 0,
    reserved: 0,
};

impl Wide<'_> {
    fn collapse(&mut self) {
        self.nodes.push(NOTHING);
        if self.items.is_empty() {
            return;
        }
        // (place of the wide node, binary node)
        let mut stack = vec![(0u32, 0u32)];
        while let Some((place, root)) = stack.pop() {
            let mut children = [root; WIDTH];
            let mut n = 1;
            while n < WIDTH {
                let mut largest: Option<(f32, usize)> = None;
                for (i, &child) in children[..n].iter().enumerate() {
                    let b = &self.binary[child as usize];
                    let size = area(b.min, b.max);
                    if b.count == 0 && largest.is_none_or(|l| size > l.0) {
                        largest = Some((size, i));
                    }
                }
                let Some((_, i)) = largest else { break };
                let opened = children[i];
                children[i] = opened + 1;
                children[n] = self.binary[opened as usize].at;
                n += 1;
            }
            let slots = self.slots(&children[..n]);
            let node = self.node(&slots);
            self.nodes[place as usize] = node;
            let present = slots.iter().flatten();
            let inner = present.filter(|&&c| self.binary[c as usize].count == 0);
            for (k, &child) in inner.enumerate() {
                self.nodes.push(NOTHING);
                stack.push((node.nodes + k as u32, child));
            }
        }
    }

    /// Which child goes into which slot. Slot `s` is for the child that lies farthest towards the corner of the box that
    /// has the signs of `s` (bit `a` set: the upper end of axis `a`), so that rays find the children roughly in
    /// order when they take the slots in that of their own signs (Ylitie, Karras and Laine 2017, section 3.1).
    fn slots(&self, children: &[u32]) -> [Option<u32>; WIDTH] {
        let centre = |c: u32| {
            let b = &self.binary[c as usize];
            0.5 * b.min + 0.5 * b.max
        };
        let mut middle = Vec3::ZERO;
        for &c in children {
            middle += centre(c) / children.len() as f32;
        }
        let mut slots = [None; WIDTH];
        let mut left: ArrayVec<u32, WIDTH> = children.iter().copied().collect();
        while !left.is_empty() {
            // (gain, child, slot): the best pair that is still free.
            let mut best =
                (f32::NEG_INFINITY, 0, slots.iter().position(Option::is_none).unwrap_or(0));
            for (i, &c) in left.iter().enumerate() {
                let d = centre(c) - middle;
                for (s, slot) in slots.iter().enumerate() {
                    let towards = |axis: usize| if s >> axis & 1 != 0 { d[axis] } else { -d[axis] };
                    let gain = towards(0) + towards(1) + towards(2);
                    if slot.is_none() && gain > best.0 {
                        best = (gain, i, s);
                    }
                }
            }
            slots[best.2] = Some(left.remove(best.1));
        }
        slots
    }

    /// The record of a node with these children. Its inner children will come at the end of the list.
    fn node(&mut self, children: &[Option<u32>; WIDTH]) -> BvhNode {
        let boxes: ArrayVec<(usize, [f64; 3], [f64; 3]), WIDTH> = children
            .iter()
            .enumerate()
            .filter_map(|(slot, &c)| {
                let b = &self.binary[c? as usize];
                let grow = |p: f32, by: f64| f64::from(p) + by;
                Some((
                    slot,
                    b.min.to_array().map(|p| grow(p, -self.grown)),
                    b.max.to_array().map(|p| grow(p, self.grown)),
                ))
            })
            .collect();
        let mut node = BvhNode {
            nodes: self.nodes.len() as u32,
            blocks: (self.references.len() / LEAF_TRIANGLES) as u32,
            ..NOTHING
        };
        for axis in 0..3 {
            let low = boxes.iter().fold(f64::INFINITY, |m, b| m.min(b.1[axis]));
            let high = boxes.iter().fold(f64::NEG_INFINITY, |m, b| m.max(b.2[axis]));
            let origin = (low as f32).next_down().clamp(f32::MIN, f32::MAX);
            let wanted = (high - f64::from(origin)) / 255.0;
            let mut exponent = 1u8;
            while exponent < 254 && step(exponent) < wanted {
                exponent += 1;
            }
            node.origin[axis] = origin;
            node.step[axis] = step(exponent) as f32;
            for &(i, ref low, ref high) in &boxes {
                let at = |p: f64| (p - f64::from(origin)) / step(exponent);
                // Saturating casts; a huge or infinite box becomes the whole frame.
                node.bounds[axis][i] = at(low[axis]).floor() as u8;
                node.bounds[axis][i + WIDTH] = at(high[axis]).ceil() as u8;
            }
        }
        let mut inner = 0;
        let mut first = 0;
        for (i, &child) in children.iter().enumerate() {
            let Some(child) = child else { continue };
            let b = self.binary[child as usize];
            node.used |= 1 << i;
            if b.count == 0 {
                node.child[i] = CHILD_INNER | inner;
                inner += 1;
                continue;
            }
            node.child[i] = ((b.count as u8 - 1) << 5) | first;
            first += 1;
            let mine = &self.items[b.at as usize..(b.at + b.count) as usize];
            self.references.extend(mine.iter().map(|item| item.triangle));
            self.references
                .resize(self.references.len().next_multiple_of(LEAF_TRIANGLES), NO_TRIANGLE);
        }
        node
    }
}

/// The step of an exponent, m.
fn step(exponent: u8) -> f64 {
    f64::from(f32::from_bits(u32::from(exponent) << 23))
}

// The wide tree is at most as deep as the binary one; halving ends after 29 levels.
const _: () = assert!(LEAF_TRIANGLES * WIDTH <= 32 && STEEP as usize + 30 < DEPTH);

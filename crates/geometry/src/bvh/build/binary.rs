//! Halving a set of triangles again and again, by the surface area heuristic: large sets in bins (Wald 2007, *On fast
//! construction of SAH-based bounding volume hierarchies*), small ones exactly.
//!
//! A leaf costs as much with one triangle as with four, so what is counted is blocks. The number of blocks is kept
//! within bounds by a purse: every block more than a set needs is paid from what the set was given.

use enf_layout::bvh::{DEPTH, LEAF_TRIANGLES};
use glam::{Vec3, Vec4};

use super::{Bounds, SPARING, blocks_most, blocks_needed};
use crate::mesh::TileMesh;

/// Bins along each axis.
const BINS: usize = 16;
/// From so many triangles on, it pays to fill two sets of bins.
const MANY: usize = 256;
/// Sets of so many triangles are divided exactly.
const SMALL: usize = 64;
/// What a further leaf costs by itself, in blocks that are tested.
const SPLIT_COST: f32 = 0.3;
/// Deeper than this, sets are halved by count, which ends soon.
const STEEP: u32 = 30;

// Halving ends after 27 levels, when 2^29 triangles are blocks; the wide tree is at most as deep.
const _: () = assert!(STEEP as usize + 27 + 2 < DEPTH && SMALL <= 64);

/// A triangle's box. The last component of `min` holds its index.
#[derive(Clone, Copy)]
struct Item {
    min: Vec4,
    max: Vec4,
}

/// Makes indices ordinary numbers (from 2 on), so that nothing slow or odd happens where they go through vector
/// instructions.
const ORDINARY: u32 = 0x4000_0000;

impl Item {
    #[inline(always)]
    fn new(mesh: &TileMesh, triangle: u32) -> Self {
        let [a, b, c] = mesh.corner_arrays(triangle).map(|&p| Vec3::from_array(p));
        let min = a.min(b).min(c).extend(f32::from_bits(triangle ^ ORDINARY));
        Self { min, max: a.max(b).max(c).extend(0.0) }
    }

    fn triangle(&self) -> u32 {
        self.min.w.to_bits() ^ ORDINARY
    }

    /// Twice its centre.
    #[inline(always)]
    fn centre(&self) -> Vec4 {
        self.min + self.max
    }
}

/// A node of the binary tree.
#[derive(Clone, Copy)]
pub(super) struct Binary {
    /// Twice the centre of its box.
    pub(super) centre: [f32; 3],
    /// Half the surface of its box; finite.
    pub(super) area: f32,
    /// Leaf: where its triangles begin in [`Tree::order`]; inner node: the second child (the first follows its parent).
    pub(super) at: u32,
    /// Triangles of a leaf; 0 = inner node.
    pub(super) count: u32,
}

/// A binary tree.
pub(super) struct Tree {
    /// The box of all triangles.
    pub(super) bounds: Bounds,
    /// Parents before children; none without triangles.
    pub(super) nodes: Vec<Binary>,
    /// Triangles, leaf by leaf.
    pub(super) order: Vec<u32>,
}

/// Upper bound of the bytes that [`divide`] takes, and of those of its tree.
pub(super) fn bytes(triangles: usize) -> [usize; 2] {
    let tree = 2 * blocks_most(triangles) * size_of::<Binary>() + triangles * size_of::<u32>();
    [triangles * size_of::<Item>() + tree, tree]
}

/// Sorts a mesh's triangles into a tree.
pub(super) fn divide(mesh: &TileMesh) -> Tree {
    let mut items: Vec<Item> = (0..mesh.len()).map(|triangle| Item::new(mesh, triangle)).collect();
    let n = items.len();
    let bounds = of(&items);
    let nodes = Vec::with_capacity(2 * blocks_most(n));
    let mut tree = Tree { bounds, nodes, order: Vec::with_capacity(n) };
    let mut stack = Vec::with_capacity(DEPTH);
    if n > 0 {
        stack.push(Job { second_of: None, from: 0, to: n, bounds, depth: 0, spare: n / SPARING });
    }
    while let Some(job) = stack.pop() {
        let at = tree.nodes.len() as u32;
        if let Some(parent) = job.second_of {
            tree.nodes[parent as usize].at = at;
        }
        let (from, depth) = (job.from, job.depth + 1);
        let mine = &mut items[from..job.to];
        if mine.len() <= SMALL {
            Small::new(mine, &mut tree).divide(0, mine.len(), job.depth, job.spare);
            continue;
        }
        let n = mine.len();
        let (middle, [front, back]) = split(mine, job.depth, job.spare);
        tree.nodes.push(inner(&job.bounds));
        let [first, second] = share(job.spare, middle, n);
        let middle = from + middle;
        stack.push(Job {
            second_of: Some(at),
            from: middle,
            to: job.to,
            bounds: back,
            depth,
            spare: second,
        });
        stack.push(Job { second_of: None, from, to: middle, bounds: front, depth, spare: first });
    }
    tree
}

struct Job {
    /// The parent of a second child.
    second_of: Option<u32>,
    from: usize,
    to: usize,
    bounds: Bounds,
    depth: u32,
    /// Blocks that it may have more than it needs.
    spare: usize,
}

/// The blocks more than needed that come with a division of `n` after `middle`: none or one.
#[inline(always)]
fn extra(middle: usize, n: usize) -> usize {
    blocks_needed(middle) + blocks_needed(n - middle) - blocks_needed(n)
}

/// What is left of a purse after a division of `n`, shared among both parts.
fn share(spare: usize, middle: usize, n: usize) -> [usize; 2] {
    let left = spare.saturating_sub(extra(middle, n));
    let first = (left as u64 * middle as u64 / n as u64) as usize;
    [first, left - first]
}

fn of(items: &[Item]) -> Bounds {
    // Two at a time: each waits for the one before.
    let (mut even, mut odd) = (Bounds::EMPTY, Bounds::EMPTY);
    let (pairs, last) = items.as_chunks::<2>();
    for [a, b] in pairs {
        even.add(a.min, a.max);
        odd.add(b.min, b.max);
    }
    for item in last {
        even.add(item.min, item.max);
    }
    even.add(odd.min, odd.max);
    even
}

/// The box of twice the centres.
fn centres_of(items: &[Item]) -> Bounds {
    let (mut even, mut odd) = (Bounds::EMPTY, Bounds::EMPTY);
    let (pairs, last) = items.as_chunks::<2>();
    for [a, b] in pairs {
        let (a, b) = (a.centre(), b.centre());
        even.add(a, a);
        odd.add(b, b);
    }
    for item in last {
        even.add(item.centre(), item.centre());
    }
    even.add(odd.min, odd.max);
    even
}

fn inner(bounds: &Bounds) -> Binary {
    let centre = (bounds.min + bounds.max).truncate().to_array();
    Binary { centre, area: bounds.area().min(f32::MAX), at: 0, count: 0 }
}

/// The longest axis.
fn longest(size: Vec4) -> usize {
    if size.x >= size.y && size.x >= size.z {
        0
    } else if size.y >= size.z {
        1
    } else {
        2
    }
}

/// Half of `n`, in whole blocks.
fn half(n: usize) -> usize {
    blocks_needed(n) / 2 * LEAF_TRIANGLES
}

/// Where to part a large set, which is then sorted accordingly, and the boxes of the parts.
fn split(items: &mut [Item], depth: u32, spare: usize) -> (usize, [Bounds; 2]) {
    let n = items.len();
    let centres = centres_of(items);
    let low = centres.min;
    let size = centres.max - low;
    let spread = size.truncate().is_finite() && size.truncate().max_element() > 0.0;
    if !spread || depth >= STEEP {
        return part(items, longest(size), half(n));
    }
    let scale = Vec3::from_array(size.truncate().to_array().map(|s| {
        let scale = (BINS - 1) as f32 / s;
        if s > 0.0 && scale.is_finite() { scale } else { 0.0 }
    }));
    let scale = scale.extend(0.0);
    let mut bins = [[Bounds::EMPTY; BINS]; 3];
    let mut counts = [[0u32; BINS]; 3];
    if n < MANY {
        fill(items, low, scale, &mut bins, &mut counts);
    } else {
        // Two at a time, as an item often waits for the one before to leave its bin.
        let mut others = bins;
        let mut other_counts = counts;
        let (pairs, last) = items.as_chunks::<2>();
        for [a, b] in pairs {
            fill(std::slice::from_ref(a), low, scale, &mut bins, &mut counts);
            fill(std::slice::from_ref(b), low, scale, &mut others, &mut other_counts);
        }
        fill(last, low, scale, &mut bins, &mut counts);
        for (bin, other) in bins.as_flattened_mut().iter_mut().zip(others.as_flattened()) {
            bin.add(other.min, other.max);
        }
        for (count, other) in counts.as_flattened_mut().iter_mut().zip(other_counts.as_flattened())
        {
            *count += other;
        }
    }
    // (cost, axis, first bin of the second part, triangles before)
    let mut best = (f32::INFINITY, longest(size), 0, half(n));
    for axis in 0..3 {
        let (bins, counts) = (&bins[axis], &counts[axis]);
        let mut right = [0.0f32; BINS];
        let (mut sum, mut count) = (Bounds::EMPTY, 0);
        for k in (1..BINS).rev() {
            sum.add(bins[k].min, bins[k].max);
            count += counts[k] as usize;
            right[k] = sum.area() * blocks_needed(count) as f32;
        }
        let (mut sum, mut count) = (Bounds::EMPTY, 0);
        for k in 1..BINS {
            sum.add(bins[k - 1].min, bins[k - 1].max);
            count += counts[k - 1] as usize;
            let cost = sum.area() * blocks_needed(count) as f32 + right[k];
            if cost < best.0 {
                best = (cost, axis, k, count);
            }
        }
    }
    let (_, axis, k, count) = best;
    if k == 0 || extra(count, n) > spare {
        // The nearest place that costs no block.
        let whole = (count + 2) / LEAF_TRIANGLES * LEAF_TRIANGLES;
        return part(
            items,
            axis,
            whole.clamp(LEAF_TRIANGLES, (n - 1) / LEAF_TRIANGLES * LEAF_TRIANGLES),
        );
    }
    // Without branches: what belongs to the front is swapped there.
    let mut middle = 0;
    for i in 0..n {
        let (this, other) = (items[i], items[middle]);
        items[i] = other;
        items[middle] = this;
        let at = bin(&this, low, scale);
        middle += usize::from((at[axis] as usize & (BINS - 1)) < k);
    }
    let boxes = [&bins[axis][..k], &bins[axis][k..]].map(|bins| {
        let mut sum = Bounds::EMPTY;
        for bin in bins {
            sum.add(bin.min, bin.max);
        }
        sum
    });
    (middle, boxes)
}

type Bins = [[Bounds; BINS]; 3];
type Counts = [[u32; BINS]; 3];

/// Puts items into the bins of each axis.
#[inline(always)]
fn fill(items: &[Item], low: Vec4, scale: Vec4, bins: &mut Bins, counts: &mut Counts) {
    for item in items {
        let at = bin(item, low, scale);
        for axis in 0..3 {
            let k = at[axis] as usize & (BINS - 1);
            bins[axis][k].add(item.min, item.max);
            counts[axis][k] += 1;
        }
    }
}

/// The bins of an item along each axis, in the low bits.
#[inline(always)]
fn bin(item: &Item, low: Vec4, scale: Vec4) -> [u32; 4] {
    // From 2^23 on, the last bit of a number counts ones.
    let at = (item.centre() - low) * scale + Vec4::splat((1 << 23) as f32);
    at.to_array().map(f32::to_bits)
}

/// Sorts a set so that the first `middle` have the smaller centres.
fn part(items: &mut [Item], axis: usize, middle: usize) -> (usize, [Bounds; 2]) {
    let centre = |item: &Item| item.min[axis] + item.max[axis];
    items.select_nth_unstable_by(middle, |a, b| {
        centre(a).total_cmp(&centre(b)).then(a.triangle().cmp(&b.triangle()))
    });
    (middle, [of(&items[..middle]), of(&items[middle..])])
}

/// A small set: sorted along each axis once, and parted at the best place of all.
struct Small<'a> {
    items: &'a [Item],
    tree: &'a mut Tree,
    /// The items along each axis.
    orders: [[u8; SMALL]; 3],
}

impl<'a> Small<'a> {
    fn new(items: &'a [Item], tree: &'a mut Tree) -> Self {
        let mut orders = [[0; SMALL]; 3];
        let mut keys = [0u64; SMALL];
        let keys = &mut keys[..items.len()];
        for (axis, order) in orders.iter_mut().enumerate() {
            for (i, (key, item)) in keys.iter_mut().zip(items).enumerate() {
                let bits = (item.min[axis] + item.max[axis]).to_bits();
                let ascending = bits ^ ((bits as i32 >> 31) as u32 | 1 << 31);
                *key = u64::from(ascending) << 32 | i as u64;
            }
            keys.sort_unstable();
            for (place, key) in order.iter_mut().zip(keys.iter()) {
                *place = *key as u8;
            }
        }
        Self { items, tree, orders }
    }

    #[inline(always)]
    fn item(&self, axis: usize, place: usize) -> &'a Item {
        &self.items[self.orders[axis][place] as usize]
    }

    fn divide(&mut self, from: usize, to: usize, depth: u32, spare: usize) {
        let n = to - from;
        let mut bounds = Bounds::EMPTY;
        for place in from..to {
            let item = self.item(0, place);
            bounds.add(item.min, item.max);
        }
        let at = self.tree.nodes.len();
        self.tree.nodes.push(inner(&bounds));
        let division = if n <= LEAF_TRIANGLES && (spare == 0 || n == 1) {
            None
        } else {
            self.split(&bounds, from, to, depth, spare)
        };
        let Some((axis, middle)) = division else {
            let first = self.tree.order.len();
            self.tree.nodes[at].at = first as u32;
            self.tree.nodes[at].count = n as u32;
            let (items, places) = (self.items, &self.orders[0][from..to]);
            self.tree.order.extend(places.iter().map(|&i| items[i as usize].triangle()));
            self.tree.order[first..].sort_unstable();
            return;
        };
        self.part(axis, from, middle, to);
        let [first, second] = share(spare, middle, n);
        self.divide(from, from + middle, depth + 1, first);
        self.tree.nodes[at].at = self.tree.nodes.len() as u32;
        self.divide(from + middle, to, depth + 1, second);
    }

    /// The axis, and how many go to the front; `None` for a leaf.
    fn split(
        &self,
        bounds: &Bounds,
        from: usize,
        to: usize,
        depth: u32,
        spare: usize,
    ) -> Option<(usize, usize)> {
        let n = to - from;
        let by_count = (n > LEAF_TRIANGLES).then(|| (longest(bounds.max - bounds.min), half(n)));
        if depth >= STEEP {
            return by_count;
        }
        let most =
            if n > LEAF_TRIANGLES { f32::INFINITY } else { (1.0 - SPLIT_COST) * bounds.area() };
        let mut best = (most, by_count);
        let mut right = [0.0f32; SMALL + 1];
        for axis in 0..3 {
            let mut sum = Bounds::EMPTY;
            for i in (1..n).rev() {
                let item = self.item(axis, from + i);
                sum.add(item.min, item.max);
                if extra(i, n) <= spare {
                    right[i] = sum.area() * blocks_needed(n - i) as f32;
                }
            }
            let mut sum = Bounds::EMPTY;
            for i in 1..n {
                let item = self.item(axis, from + i - 1);
                sum.add(item.min, item.max);
                if extra(i, n) <= spare {
                    let cost = sum.area() * blocks_needed(i) as f32 + right[i];
                    if cost < best.0 {
                        best = (cost, Some((axis, i)));
                    }
                }
            }
        }
        best.1
    }

    /// Sorts the other axes' orders into those that come first along one, and the others.
    fn part(&mut self, axis: usize, from: usize, middle: usize, to: usize) {
        let mut first = 0u64;
        for &i in &self.orders[axis][from..from + middle] {
            first |= 1 << i;
        }
        let mut others = [0; SMALL];
        for order in &mut self.orders {
            let (mut a, mut b) = (from, 0);
            for place in from..to {
                let i = order[place];
                let front = first >> i & 1;
                order[a] = i;
                others[b] = i;
                a += front as usize;
                b += 1 - front as usize;
            }
            order[a..to].copy_from_slice(&others[..b]);
        }
    }
}

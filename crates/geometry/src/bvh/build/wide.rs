//! Eight children to a node: the cheapest of all ways to take a binary tree together (Ylitie, Karras and Laine 2017,
//! *Efficient incoherent ray traversal on GPUs through compressed wide BVHs*, section 3.1).

use arrayvec::ArrayVec;
use enf_layout::bvh::{CHILD_INNER, CHILD_NONE, LEAF_TRIANGLES, WIDTH};
use glam::Vec3;

use super::binary::{Binary, Tree};
use super::nodes_most;

/// Cost of opening a node, in blocks that are tested.
const NODE_COST: f32 = 1.0;

/// What is stored of a node: for each slot [`CHILD_NONE`], [`CHILD_INNER`], or the triangles less one of a leaf, from bit
/// 5 on.
pub(super) type Shape = [u8; WIDTH];

/// The least cost of a subtree under a node that has one, two, ... seven places for it.
type Costs = [f32; WIDTH - 1];

/// Upper bound of the bytes that [`collapse`] takes for so many blocks, and of those that its answer keeps.
pub(super) fn bytes(blocks: usize) -> [usize; 2] {
    // Should it have to be done again: both answers.
    let answer =
        nodes_most(blocks) * size_of::<Shape>() + blocks * size_of::<[u32; LEAF_TRIANGLES]>();
    [2 * blocks * size_of::<Costs>() + 2 * answer, answer]
}

/// The nodes of the wide tree, and the triangles of its blocks; lanes that hold nothing repeat the one before.
///
/// Node 0 is the root. A node's inner children and its blocks follow each other in the order of their slots, and come when
/// it is visited; its inner children are visited in this order, each with all that is below it, before what comes after it.
pub(super) fn collapse(tree: &Tree) -> (Vec<Shape>, Vec<[u32; LEAF_TRIANGLES]>) {
    let blocks = tree.nodes.iter().filter(|b| b.count > 0).count();
    let cheapest = collapse_by(tree, &costs(&tree.nodes), blocks);
    if cheapest.0.len() <= nodes_most(blocks) {
        return cheapest;
    }
    // Not seen yet, but a promise is a promise.
    collapse_by(tree, &[], blocks)
}

/// The same; without costs, the child with the largest surface is opened, always.
pub(super) fn collapse_by(
    tree: &Tree,
    costs: &[Costs],
    blocks: usize,
) -> (Vec<Shape>, Vec<[u32; LEAF_TRIANGLES]>) {
    let mut wide = Wide {
        tree,
        costs,
        shapes: Vec::with_capacity(nodes_most(blocks)),
        references: Vec::with_capacity(blocks),
    };
    wide.shapes.push([CHILD_NONE; WIDTH]);
    if !tree.nodes.is_empty() {
        wide.visit(0, 0);
    }
    (wide.shapes, wide.references)
}

fn costs(nodes: &[Binary]) -> Vec<Costs> {
    let mut costs = vec![[0.0; WIDTH - 1]; nodes.len()];
    for (i, node) in nodes.iter().enumerate().rev() {
        if node.count > 0 {
            costs[i] = [node.area; WIDTH - 1];
            continue;
        }
        let (first, second) = (costs[i + 1], costs[node.at as usize]);
        let mut mine = [0.0; WIDTH - 1];
        mine[0] = node.area * NODE_COST + shared(&first, &second, WIDTH).0;
        for places in 2..WIDTH {
            mine[places - 1] = shared(&first, &second, places).0.min(mine[places - 2]);
        }
        costs[i] = mine;
    }
    costs
}

/// The cheapest way for two subtrees to share places: its cost, and the places of the first.
#[inline(always)]
fn shared(first: &Costs, second: &Costs, places: usize) -> (f32, usize) {
    let mut best = (f32::INFINITY, 1);
    for k in 1..places {
        let cost = first[k - 1] + second[places - k - 1];
        if cost < best.0 {
            best = (cost, k);
        }
    }
    best
}

/// The wide tree while it is made.
struct Wide<'a> {
    tree: &'a Tree,
    /// Empty: the child with the largest surface is opened, always (Wald, Benthin and Boulos 2008, *Getting rid of packets*).
    costs: &'a [Costs],
    shapes: Vec<Shape>,
    references: Vec<[u32; LEAF_TRIANGLES]>,
}

type Children = ArrayVec<u32, WIDTH>;

impl Wide<'_> {
    fn visit(&mut self, place: usize, root: u32) {
        let mut children = Children::new();
        let binary = &self.tree.nodes[root as usize];
        if binary.count > 0 {
            children.push(root);
        } else if self.costs.is_empty() {
            self.open_largest(root, &mut children);
        } else {
            self.open(root, WIDTH, &mut children);
        }
        let slots = slots(&self.tree.nodes, &children);
        let first = self.shapes.len();
        let mut inner = Children::new();
        for (slot, child) in slots.iter().enumerate() {
            let Some(child) = *child else { continue };
            let b = &self.tree.nodes[child as usize];
            if b.count == 0 {
                inner.push(child);
                self.shapes[place][slot] = CHILD_INNER;
                self.shapes.push([CHILD_NONE; WIDTH]);
                continue;
            }
            self.shapes[place][slot] = (b.count as u8 - 1) << 5;
            let mine = &self.tree.order[b.at as usize..(b.at + b.count) as usize];
            self.references.push(std::array::from_fn(|lane| mine[lane.min(mine.len() - 1)]));
        }
        for (k, child) in inner.into_iter().enumerate() {
            self.visit(first + k, child);
        }
    }

    /// Finds what takes so many places of a node.
    fn open(&self, node: u32, places: usize, children: &mut Children) {
        let binary = &self.tree.nodes[node as usize];
        if binary.count > 0 || places == 1 {
            children.push(node);
            return;
        }
        let (first, second) = (node + 1, binary.at);
        let costs = |node: u32| &self.costs[node as usize];
        let (cost, k) = shared(costs(first), costs(second), places);
        if places < WIDTH && cost > costs(node)[places - 2] {
            self.open(node, places - 1, children);
        } else {
            self.open(first, k, children);
            self.open(second, places - k, children);
        }
    }

    fn open_largest(&self, root: u32, children: &mut Children) {
        children.push(root);
        while children.len() < WIDTH {
            let mut largest: Option<(f32, usize)> = None;
            for (i, &child) in children.iter().enumerate() {
                let b = &self.tree.nodes[child as usize];
                if b.count == 0 && largest.is_none_or(|l| b.area > l.0) {
                    largest = Some((b.area, i));
                }
            }
            let Some((_, i)) = largest else { break };
            let opened = children[i];
            children[i] = opened + 1;
            children.push(self.tree.nodes[opened as usize].at);
        }
    }
}

/// Which child goes into which slot. Slot `s` is for the child that lies farthest towards the corner of the box that
/// has the signs of `s` (bit `a` set: the upper end of axis `a`), so that rays find the children roughly in
/// order when they take the slots in that of their own signs (Ylitie, Karras and Laine 2017, section 3.1).
fn slots(nodes: &[Binary], children: &[u32]) -> [Option<u32>; WIDTH] {
    let centre = |c: u32| Vec3::from_array(nodes[c as usize].centre);
    let mut middle = Vec3::ZERO;
    for &c in children {
        middle += centre(c) / children.len() as f32;
    }
    let mut gains = [[0.0f32; WIDTH]; WIDTH];
    for (gains, &c) in gains.iter_mut().zip(children) {
        let d = centre(c) - middle;
        for (s, gain) in gains.iter_mut().enumerate() {
            let towards = |axis: usize| if s >> axis & 1 != 0 { d[axis] } else { -d[axis] };
            *gain = towards(0) + towards(1) + towards(2);
        }
    }
    let best_of = |gains: &[f32; WIDTH], free: u32| {
        let mut best = (f32::NEG_INFINITY, free.trailing_zeros() as usize);
        for (s, &gain) in gains.iter().enumerate() {
            if free >> s & 1 != 0 && gain > best.0 {
                best = (gain, s);
            }
        }
        best
    };
    let mut free = (1u32 << WIDTH) - 1;
    let mut wishes = [(0.0, 0); WIDTH];
    for (wish, gains) in wishes.iter_mut().zip(&gains) {
        *wish = best_of(gains, free);
    }
    let mut slots = [None; WIDTH];
    let mut left = (1u32 << children.len()) - 1;
    while left != 0 {
        // Who gains most of all chooses first.
        let mut first = left.trailing_zeros() as usize;
        for i in 0..children.len() {
            if left >> i & 1 != 0 && wishes[i].0 > wishes[first].0 {
                first = i;
            }
        }
        let slot = wishes[first].1 & (WIDTH - 1);
        slots[slot] = Some(children[first]);
        left &= !(1 << first);
        free &= !(1 << slot);
        for i in 0..children.len() {
            if left >> i & 1 != 0 && wishes[i].1 == slot {
                wishes[i] = best_of(&gains[i], free);
            }
        }
    }
    slots
}

//! From the tree to the tables of a store: faces without redundancy, and which triangles touch
//! which leaf.

use crate::cluster::point;
use crate::convex::{Plane, Polytope, clip_behind};
use crate::tree::{BOUND, LEAF, Tree, range};
use enf_layout::NONE;
use enf_layout::bsp::{FACE_IN_FRONT, FaceRecord, LeafRecord, NodeRecord, PlaneRecord};
use glam::DVec3;

/// Leaves list what touches their half-spaces moved out by so many δ (and a little for rounding).
const LISTED: f64 = 4.01;
/// Faces are dropped if redundant with all half-spaces moved out by so many δ.
const REDUNDANT: f64 = 2.0;

/// The four tables of a BSP.
pub(crate) struct BspTables {
    pub(crate) planes: Vec<PlaneRecord>,
    pub(crate) nodes: Vec<NodeRecord>,
    pub(crate) leaves: Vec<LeafRecord>,
    pub(crate) faces: Vec<FaceRecord>,
}

fn record(plane: &Plane) -> PlaneRecord {
    PlaneRecord { normal: plane.normal.to_array(), offset: plane.offset }
}

/// Writes the tables; leaf `i` of the tree becomes record `number[i]` with room, tile and flags
/// `label(i)`.
pub(crate) fn tables(
    tree: &Tree,
    delta: f64,
    number: &[u32],
    label: impl Fn(u32) -> (u32, u32, u32),
) -> BspTables {
    let root_box = Polytope::from_box(tree.box_min, tree.box_max, BOUND);
    let mut planes: Vec<PlaneRecord> = root_box.faces.iter().map(|f| record(&f.plane)).collect();
    let bounds = planes.len() as u32;
    planes.extend(tree.nodes.iter().map(|n| record(&n.plane)));
    let child = |c: u32| if c & LEAF != 0 { number[(c & !LEAF) as usize] | LEAF } else { c };
    let nodes = tree
        .nodes
        .iter()
        .enumerate()
        .map(|(i, n)| NodeRecord {
            plane: bounds + i as u32,
            front: child(n.front),
            back: child(n.back),
            cut: u32::from(n.cut),
        })
        .collect();
    // Leaves with all half-spaces moved out, by walking down from the root box.
    let mut own: Vec<Vec<FaceRecord>> = vec![Vec::new(); tree.leaves.len()];
    let grown = Polytope::from_box(
        tree.box_min - REDUNDANT * delta,
        tree.box_max + REDUNDANT * delta,
        BOUND,
    );
    let mut stack = vec![(tree.root(), grown)];
    while let Some((at, cell)) = stack.pop() {
        if at & LEAF != 0 {
            own[(at & !LEAF) as usize] = cell
                .faces
                .iter()
                .map(|f| {
                    if f.tag >= BOUND {
                        return FaceRecord { plane: f.tag - BOUND, beyond: NONE };
                    }
                    let node = &tree.nodes[(f.tag >> 1) as usize];
                    let front = f.tag & 1 == 1;
                    FaceRecord {
                        plane: (bounds + (f.tag >> 1)) | if front { FACE_IN_FRONT } else { 0 },
                        beyond: child(if front { node.back } else { node.front }),
                    }
                })
                .collect();
            continue;
        }
        let node = &tree.nodes[at as usize];
        let mut front = cell.clone();
        front.clip(node.plane.flipped().moved(REDUNDANT * delta), at << 1 | 1);
        let mut back = cell;
        back.clip(node.plane.moved(REDUNDANT * delta), at << 1);
        stack.push((node.back, back));
        stack.push((node.front, front));
    }
    let mut order: Vec<u32> = (0..tree.leaves.len() as u32).collect();
    order.sort_by_key(|&i| number[i as usize]);
    let mut leaves = Vec::with_capacity(order.len());
    let mut faces = Vec::new();
    for i in order {
        let (room, tile, flags) = label(i);
        let list = &own[i as usize];
        leaves.push(LeafRecord {
            room,
            tile,
            first_face: faces.len() as u32,
            face_count: list.len() as u32,
            flags,
            reserved: 0,
        });
        faces.extend_from_slice(list);
    }
    BspTables { planes, nodes, leaves, faces }
}

/// Calls `found` with every leaf below `from` whose half-spaces, moved out by 4 δ, a triangle
/// touches. `scratch` is reused from call to call.
pub(crate) fn bin(
    tree: &Tree,
    from: u32,
    delta: f64,
    triangle: &[[f32; 3]; 3],
    scratch: &mut Vec<(u32, Vec<DVec3>)>,
    mut found: impl FnMut(u32),
) {
    let margin = LISTED * delta;
    // Most triangles are small: they go down whole, without a polygon of their own.
    let corners = triangle.map(point);
    let mut at = from;
    while at & LEAF == 0 {
        let node = &tree.nodes[at as usize];
        let [a, b, c] = corners.map(|p| node.plane.distance(p));
        at = if a.min(b).min(c) > margin {
            node.front
        } else if a.max(b).max(c) < -margin {
            node.back
        } else {
            break;
        };
    }
    if at & LEAF != 0 {
        return found(at & !LEAF);
    }
    scratch.clear();
    scratch.push((at, corners.to_vec()));
    while let Some((mut at, mut poly)) = scratch.pop() {
        loop {
            if at & LEAF != 0 {
                found(at & !LEAF);
                break;
            }
            let node = &tree.nodes[at as usize];
            let (lo, hi) = range(&poly, &node.plane);
            if lo > margin {
                at = node.front;
            } else if hi < -margin {
                at = node.back;
            } else {
                // Clip only what sticks out, and never to nothing.
                if lo < -margin {
                    let mut part = Vec::new();
                    clip_behind(&poly, &node.plane.flipped().moved(margin), &mut part);
                    scratch.push((node.front, part));
                } else {
                    scratch.push((node.front, poly.clone()));
                }
                if hi > margin {
                    let mut part = Vec::new();
                    clip_behind(&poly, &node.plane.moved(margin), &mut part);
                    poly = part;
                }
                at = node.back;
            }
            if poly.is_empty() {
                break;
            }
        }
    }
}

/// Lists of triangles, one after the other.
pub(crate) struct Lists {
    pub(crate) offsets: Vec<u64>,
    pub(crate) triangles: Vec<u32>,
}

impl Lists {
    pub(crate) fn of(&self, i: u32) -> &[u32] {
        let i = i as usize;
        &self.triangles[self.offsets[i] as usize..self.offsets[i + 1] as usize]
    }
}

/// Each triangle in the lists `place(leaf)` of all leaves that it touches, once per list; ascending.
pub(crate) fn lists(
    tree: &Tree,
    delta: f64,
    triangles: &[[[f32; 3]; 3]],
    count: usize,
    place: impl Fn(u32) -> u32,
) -> Lists {
    let mut scratch = Vec::new();
    let mut mine: Vec<u32> = Vec::new();
    let mut pairs: Vec<(u32, u32)> = Vec::with_capacity(triangles.len());
    let mut offsets = vec![0u64; count + 1];
    for (i, triangle) in triangles.iter().enumerate() {
        mine.clear();
        bin(tree, tree.root(), delta, triangle, &mut scratch, |leaf| mine.push(place(leaf)));
        mine.sort_unstable();
        mine.dedup();
        for &list in &mine {
            offsets[list as usize + 1] += 1;
            pairs.push((list, i as u32));
        }
    }
    for i in 0..count {
        offsets[i + 1] += offsets[i];
    }
    let mut next = offsets.clone();
    let mut out = vec![0u32; pairs.len()];
    for (list, triangle) in pairs {
        let at = &mut next[list as usize];
        out[*at as usize] = triangle;
        *at += 1;
    }
    Lists { offsets, triangles: out }
}

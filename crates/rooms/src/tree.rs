//! The BSP along the walls.
//!
//! Each cell knows the wall polygons in it. The plane that is covered best by its wall becomes the
//! next splitting plane (Airey, Rohlf and Brooks 1990, "Towards image realism with interactive
//! update rates in complex virtual building environments": occlusion, then balance, then few
//! splits), until no plane is covered well. What lies *in* a splitting plane is taken out of the
//! cells and remembered with the node: it is what closes the faces of the leaves there.

use crate::cluster::{Cluster, point};
use crate::convex::{Plane, Polytope, area, area_vector, box_planes, split};
use crate::hints::Footprint;
use glam::DVec3;

/// Marks a child as a leaf.
pub(crate) const LEAF: u32 = 1 << 31;
/// Face tags at or above this are the root box.
pub(crate) const BOUND: u32 = 0xffff_fff0;
/// A cell between two sheets of a wall is thinner than this, m.
pub(crate) const THIN: f64 = 0.65;

const WELL_COVERED: f64 = 0.3;
const COVERED: f64 = 0.15;
const POORLY_COVERED: f64 = 0.03;
const CANDIDATES: usize = 24;
const MOST_DEPTH: u32 = 160;

/// A wall polygon in a cell.
#[derive(Clone, Debug)]
pub(crate) struct Fragment {
    pub(crate) cluster: u32,
    pub(crate) triangle: u32,
    /// What is left of the triangle; `None` = all of it.
    corners: Option<Box<[DVec3]>>,
}

/// A polygon in a splitting plane.
#[derive(Clone, Debug)]
pub(crate) struct Sheet {
    pub(crate) opaque: bool,
    triangle: u32,
    /// What is left of the triangle; `None` = all of it.
    corners: Option<Box<[DVec3]>>,
}

impl Sheet {
    /// Its corners, with the triangles of the scene.
    pub(crate) fn corners(&self, triangles: &[[[f32; 3]; 3]]) -> Vec<DVec3> {
        match &self.corners {
            Some(corners) => corners.to_vec(),
            None => triangles[self.triangle as usize].map(point).to_vec(),
        }
    }
}

#[derive(Clone, Debug)]
pub(crate) struct Node {
    pub(crate) plane: Plane,
    pub(crate) front: u32,
    pub(crate) back: u32,
    /// Cut of a tile rather than a split of rooms.
    pub(crate) cut: bool,
    pub(crate) sheets: Vec<Sheet>,
}

#[derive(Clone, Debug)]
pub(crate) struct Leaf {
    pub(crate) cell: Polytope,
    pub(crate) fragments: Vec<Fragment>,
    /// The node above; `u32::MAX` for the root.
    pub(crate) parent: u32,
    /// The leaf of the base tree that it was cut from.
    pub(crate) base: u32,
}

#[derive(Clone, Debug)]
pub(crate) struct Tree {
    pub(crate) box_min: DVec3,
    pub(crate) box_max: DVec3,
    /// Horizontal unit vector along which most walls stand.
    pub(crate) north: DVec3,
    pub(crate) nodes: Vec<Node>,
    pub(crate) leaves: Vec<Leaf>,
}

/// Face tag: node, and on which side of it the cell is.
pub(crate) fn tag(node: u32, front: bool) -> u32 {
    node << 1 | u32::from(front)
}

pub(crate) struct Walls<'a> {
    pub(crate) triangles: &'a [[[f32; 3]; 3]],
    pub(crate) opaque: &'a (dyn Fn(usize) -> bool + Sync),
    pub(crate) clusters: Vec<Cluster>,
    /// Horizontal unit vector along which most walls stand.
    pub(crate) north: DVec3,
    /// Polygons this close to a splitting plane lie in it, m.
    pub(crate) tolerance: f64,
    /// Of lengths: 1 for buildings, less for small models.
    pub(crate) scale: f64,
}

impl Walls<'_> {
    pub(crate) fn corners(&self, fragment: &Fragment) -> Vec<DVec3> {
        match &fragment.corners {
            Some(corners) => corners.to_vec(),
            None => self.triangles[fragment.triangle as usize].map(point).to_vec(),
        }
    }

    fn with_corners<R>(&self, fragment: &Fragment, f: impl FnOnce(&[DVec3]) -> R) -> R {
        match &fragment.corners {
            Some(corners) => f(corners),
            None => f(&self.triangles[fragment.triangle as usize].map(point)),
        }
    }

    /// Sorts the fragments of a cell to the sides of a plane; what lies in it becomes sheets.
    pub(crate) fn part(
        &self,
        fragments: Vec<Fragment>,
        plane: &Plane,
        sheets: &mut Vec<Sheet>,
    ) -> [Vec<Fragment>; 2] {
        let (mut front, mut back) = (Vec::new(), Vec::new());
        for fragment in fragments {
            let (lo, hi) = self.with_corners(&fragment, |corners| range(corners, plane));
            if lo >= -self.tolerance && hi <= self.tolerance {
                let opaque = (self.opaque)(fragment.triangle as usize);
                let Fragment { triangle, corners, .. } = fragment;
                sheets.push(Sheet { opaque, triangle, corners });
            } else if lo >= -self.tolerance {
                front.push(fragment);
            } else if hi <= self.tolerance {
                back.push(fragment);
            } else {
                let (f, b) = self.with_corners(&fragment, |corners| split(corners, plane));
                for (side, corners) in [(&mut front, f), (&mut back, b)] {
                    if corners.len() > 2 {
                        side.push(Fragment { corners: Some(corners.into()), ..fragment });
                    }
                }
            }
        }
        front.shrink_to_fit();
        back.shrink_to_fit();
        sheets.shrink_to_fit();
        [front, back]
    }
}

pub(crate) fn range(corners: &[DVec3], plane: &Plane) -> (f64, f64) {
    corners.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), &p| {
        let s = plane.distance(p);
        (lo.min(s), hi.max(s))
    })
}

/// A cluster's share of a cell.
struct Share {
    cluster: u32,
    area: f64,
    min: DVec3,
    max: DVec3,
}

struct Job {
    cell: Polytope,
    fragments: Vec<Fragment>,
    depth: u32,
    parent: u32,
    front: bool,
}

pub(crate) fn build(
    walls: &Walls<'_>,
    of: &[u32],
    box_min: DVec3,
    box_max: DVec3,
    bounds: (DVec3, DVec3),
    hints: &[Footprint],
) -> Tree {
    let mut fragments: Vec<Fragment> = of
        .iter()
        .enumerate()
        .filter(|&(_, &c)| c != u32::MAX)
        .map(|(t, &cluster)| Fragment { cluster, triangle: t as u32, corners: None })
        .collect();
    fragments.sort_by_key(|f| (f.cluster, f.triangle));
    let mut tree =
        Tree { box_min, box_max, north: walls.north, nodes: Vec::new(), leaves: Vec::new() };
    // Enough for any building; a soup of triangles must end somewhere.
    let most_leaves = 4096 + walls.triangles.len() / 4;
    let shell = box_planes(bounds.0, bounds.1);
    let mut stack = vec![Job {
        cell: Polytope::from_box(box_min, box_max, BOUND),
        fragments,
        depth: 0,
        parent: u32::MAX,
        front: false,
    }];
    while let Some(job) = stack.pop() {
        let choice = if job.depth >= MOST_DEPTH || tree.leaves.len() + stack.len() >= most_leaves {
            None
        } else {
            choose(walls, &job, &shell, hints)
        };
        let index = tree.nodes.len() as u32;
        let cells = choice.as_ref().map(|p| job.cell.split(p, tag(index, true), tag(index, false)));
        if let (Some(plane), Some([Some(front), Some(back)])) = (choice, cells) {
            link(&mut tree, job.parent, job.front, index);
            let mut sheets = Vec::new();
            let [f, b] = walls.part(job.fragments, &plane, &mut sheets);
            tree.nodes.push(Node { plane, front: LEAF, back: LEAF, cut: false, sheets });
            let depth = job.depth + 1;
            stack.push(Job { cell: back, fragments: b, depth, parent: index, front: false });
            stack.push(Job { cell: front, fragments: f, depth, parent: index, front: true });
        } else {
            let leaf = tree.leaves.len() as u32;
            link(&mut tree, job.parent, job.front, leaf | LEAF);
            tree.leaves.push(Leaf {
                cell: job.cell.shrunk(),
                fragments: job.fragments,
                parent: job.parent,
                base: leaf,
            });
        }
    }
    tree
}

fn link(tree: &mut Tree, parent: u32, front: bool, child: u32) {
    if let Some(node) = tree.nodes.get_mut(parent as usize) {
        *(if front { &mut node.front } else { &mut node.back }) = child;
    }
}

/// Whether a plane leaves more than a sheet's thickness of the cell on both sides.
fn cuts(cell: &Polytope, plane: &Plane, tolerance: f64) -> bool {
    let (lo, hi) = cell.range(plane);
    lo < -1.25 * tolerance && hi > 1.25 * tolerance
}

fn choose(walls: &Walls<'_>, job: &Job, shell: &[Plane; 6], hints: &[Footprint]) -> Option<Plane> {
    let cell = &job.cell;
    let tolerance = walls.tolerance;
    let unit = walls.scale * walls.scale;
    // The scene's own box first: what is outside of it is outside.
    if let Some(plane) = shell.iter().find(|p| cuts(cell, p, tolerance)) {
        return Some(*plane);
    }
    let (lo, hi) = cell.bounds();
    for hint in hints {
        if let Some(plane) = hint.planes(lo, hi, tolerance).find(|p| cuts(cell, p, tolerance)) {
            return Some(*plane);
        }
    }
    let shares = shares(walls, &job.fragments);
    let width = cell.width();
    let thin = width < THIN * walls.scale;
    let thin_axis = if thin { thin_direction(cell, width) } else { DVec3::ZERO };
    let total: f64 = shares.iter().map(|s| s.area).sum();
    let mut candidates: Vec<(f64, usize)> = Vec::new();
    let mut poor: Option<(f64, usize)> = None;
    for (i, share) in shares.iter().enumerate() {
        let plane = &walls.clusters[share.cluster as usize].plane;
        if share.area < unit * if thin { 0.02 } else { 0.5 } || !cuts(cell, plane, tolerance) {
            continue;
        }
        let section = area(&cell.section(plane));
        if section <= 0.0 {
            continue;
        }
        let covered = (share.area / section).min(1.0);
        let good = (covered >= WELL_COVERED && share.area >= 0.5 * unit)
            || (covered >= COVERED && share.area >= 4.0 * unit)
            || (thin && covered >= 0.5)
            || (thin && covered >= 0.05 && spans(walls, &job.fragments, share, thin_axis, width));
        if good {
            candidates.push((covered, i));
        } else if share.area >= 6.0 * unit && covered >= POORLY_COVERED && total >= 30.0 * unit {
            let better = poor.is_none_or(|p| covered > p.0);
            if better {
                poor = Some((covered, i));
            }
        }
    }
    if candidates.is_empty() {
        if let Some(plane) = peel(&shares, lo, hi, total, walls.scale) {
            return Some(plane).filter(|p| cuts(cell, p, tolerance));
        }
        return poor.map(|(_, i)| walls.clusters[shares[i].cluster as usize].plane);
    }
    candidates.sort_by(|a, b| {
        let area = |c: &(f64, usize)| shares[c.1].area;
        b.0.total_cmp(&a.0).then(area(b).total_cmp(&area(a))).then(a.1.cmp(&b.1))
    });
    candidates.truncate(CANDIDATES);
    let mut best: Option<(f64, usize)> = None;
    for &(covered, i) in &candidates {
        let plane = &walls.clusters[shares[i].cluster as usize].plane;
        let (mut front, mut back, mut torn) = (0.0, 0.0, 0.0);
        for other in &shares {
            let (lo, hi) = box_range(other.min, other.max, plane);
            if lo >= -tolerance && hi <= tolerance {
                continue;
            }
            if lo >= -tolerance {
                front += other.area;
            } else if hi <= tolerance {
                back += other.area;
            } else {
                torn += other.area;
            }
        }
        let all = front + back + torn;
        let balance =
            if front + back > 0.0 { 1.0 - (front - back).abs() / (front + back) } else { 1.0 };
        let whole = if all > 0.0 { 1.0 - torn / all } else { 1.0 };
        let score = 0.5 * covered + 0.3 * balance + 0.2 * whole;
        if best.is_none_or(|b| score > b.0) {
            best = Some((score, i));
        }
    }
    best.map(|(_, i)| walls.clusters[shares[i].cluster as usize].plane)
}

fn box_range(min: DVec3, max: DVec3, plane: &Plane) -> (f64, f64) {
    let s = plane.distance((min + max) * 0.5);
    let r = plane.normal.abs().dot((max - min) * 0.5);
    (s - r, s + r)
}

fn shares(walls: &Walls<'_>, fragments: &[Fragment]) -> Vec<Share> {
    let mut shares: Vec<Share> = Vec::new();
    for fragment in fragments {
        walls.with_corners(fragment, |corners| {
            let a = area(corners);
            let (mut min, mut max) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
            for &p in corners {
                min = min.min(p);
                max = max.max(p);
            }
            match shares.last_mut() {
                Some(s) if s.cluster == fragment.cluster => {
                    s.area += a;
                    s.min = s.min.min(min);
                    s.max = s.max.max(max);
                }
                _ => shares.push(Share { cluster: fragment.cluster, area: a, min, max }),
            }
        });
    }
    shares
}

fn thin_direction(cell: &Polytope, width: f64) -> DVec3 {
    cell.faces
        .iter()
        .find(|f| {
            let across = cell.corners().fold(0.0, |w: f64, p| w.max(-f.plane.distance(p)));
            f.corners.len() > 2 && across <= width + 1e-9
        })
        .map_or(DVec3::ZERO, |f| f.plane.normal)
}

/// Whether a cluster reaches from one sheet of a thin cell to the other, as the jamb of a door does.
fn spans(
    walls: &Walls<'_>,
    fragments: &[Fragment],
    share: &Share,
    axis: DVec3,
    width: f64,
) -> bool {
    let first = fragments.partition_point(|f| f.cluster < share.cluster);
    let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
    for fragment in fragments[first..].iter().take_while(|f| f.cluster == share.cluster) {
        walls.with_corners(fragment, |corners| {
            for &p in corners {
                let s = axis.dot(p);
                lo = lo.min(s);
                hi = hi.max(s);
            }
        });
    }
    hi - lo >= 0.9 * width
}

/// A plane that cuts away the emptiness around or between the walls of a big cell.
fn peel(shares: &[Share], lo: DVec3, hi: DVec3, total: f64, scale: f64) -> Option<Plane> {
    let size = hi - lo;
    if total < 30.0 * scale * scale || size.x * size.y * size.z < 200.0 * scale * scale * scale {
        return None;
    }
    let mut best: Option<(f64, Plane)> = None;
    for (axis, normal) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
        let mut spans: Vec<(f64, f64)> =
            shares.iter().map(|s| (s.min[axis], s.max[axis])).collect();
        spans.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
        let mut reached = lo[axis];
        spans.push((hi[axis], hi[axis]));
        for (min, max) in spans {
            let gap = min - reached;
            if gap >= scale && gap >= 0.25 * size[axis] {
                let share = gap / size[axis];
                // Cut at the end of the gap that is not the cell's own face.
                let at = if reached > lo[axis] { reached } else { min };
                if best.as_ref().is_none_or(|b| share > b.0) {
                    best = Some((share, Plane { normal, offset: at }));
                }
            }
            reached = reached.max(max);
        }
    }
    best.map(|b| b.1)
}

impl Tree {
    /// The child of `node` on which a leaf or node reference hangs is replaced.
    fn replace(&mut self, parent: u32, old: u32, new: u32) {
        if let Some(node) = self.nodes.get_mut(parent as usize) {
            if node.front == old {
                node.front = new;
            } else if node.back == old {
                node.back = new;
            }
        }
    }

    /// Splits one leaf. The leaf keeps its number for the part behind the plane; the part in front
    /// gets a new one, which is returned. `None` when the plane does not cut the leaf.
    pub(crate) fn split_leaf(
        &mut self,
        leaf: u32,
        plane: &Plane,
        cut: bool,
        walls: Option<&Walls<'_>>,
    ) -> Option<u32> {
        let index = self.nodes.len() as u32;
        let new = self.leaves.len() as u32;
        let at = self.leaves.get(leaf as usize)?;
        let [Some(front), Some(back)] = at.cell.split(plane, tag(index, true), tag(index, false))
        else {
            return None;
        };
        let (parent, base) = (at.parent, at.base);
        let mut sheets = Vec::new();
        let mut sides = [Vec::new(), Vec::new()];
        if let Some(walls) = walls {
            let fragments = std::mem::take(&mut self.leaves[leaf as usize].fragments);
            sides = walls.part(fragments, plane, &mut sheets);
        }
        let [f, b] = sides;
        self.replace(parent, leaf | LEAF, index);
        self.nodes.push(Node { plane: *plane, front: new | LEAF, back: leaf | LEAF, cut, sheets });
        self.leaves[leaf as usize] =
            Leaf { cell: back.shrunk(), fragments: b, parent: index, base };
        let base = if cut { base } else { new };
        self.leaves.push(Leaf { cell: front.shrunk(), fragments: f, parent: index, base });
        Some(new)
    }

    pub(crate) fn root(&self) -> u32 {
        if self.nodes.is_empty() { LEAF } else { 0 }
    }

    /// The leaf of a point; on a plane counts as front.
    pub(crate) fn locate(&self, p: DVec3) -> u32 {
        self.locate_below(self.root(), p)
    }

    /// The same, for a point that is known to lie below a node (or in a leaf).
    pub(crate) fn locate_below(&self, mut at: u32, p: DVec3) -> u32 {
        while at & LEAF == 0 {
            let node = &self.nodes[at as usize];
            at = if node.plane.distance(p) >= 0.0 { node.front } else { node.back };
        }
        at & !LEAF
    }
}

/// Whether a polygon is worth keeping as a sheet of a wall.
pub(crate) fn has_area(corners: &[DVec3]) -> bool {
    corners.len() > 2 && area_vector(corners).length_squared() > 1e-14
}

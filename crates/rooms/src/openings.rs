//! Which leaves touch, and how open their common faces are.

use crate::clutter::Clutter;
use crate::convex::{Plane, flat, flat::Poly};
use crate::tree::{BOUND, Sheet, Tree, Walls};
use glam::{DVec2, DVec3};

/// How far around an opening its wall is looked at, m.
const WINDOW: f64 = 1.0;
/// Openings below this are not worth rays, m².
const LEAST_RAYS: f64 = 0.3;
/// Rays start on a grid of so many rows and columns.
const ROWS: u32 = 5;

/// Two leaves with a common part of a face.
#[derive(Clone, Debug)]
pub(crate) struct Link {
    pub(crate) node: u32,
    /// Leaf in front of the node's plane, and leaf behind.
    pub(crate) leaves: [u32; 2],
    /// Area of the common part, m².
    pub(crate) shared: f64,
    /// Of that, what no pane and no wall closes.
    pub(crate) free: f64,
    /// Of that, what no wall closes.
    pub(crate) open: f64,
    /// How free the faces of both leaves are around the opening, 0 to 1: a door in a wall is about
    /// 0.2, a virtual cut through a room 1.
    pub(crate) openness: f64,
    /// How far one gets into the leaves from here before loose surfaces are in the way, 0 to 1: see
    /// [`crate::clutter`].
    pub(crate) reach: f64,
}

struct Frame {
    plane: Plane,
    u: DVec3,
    v: DVec3,
}

impl Frame {
    fn new(plane: &Plane) -> Self {
        let (u, v) = plane.basis();
        Self { plane: *plane, u, v }
    }

    fn flatten(&self, corners: &[DVec3]) -> Poly {
        let mut poly: Poly =
            corners.iter().map(|&p| DVec2::new(self.u.dot(p), self.v.dot(p))).collect();
        if flat::area(&poly) < 0.0 {
            poly.reverse();
        }
        poly
    }

    fn lift(&self, p: DVec2) -> DVec3 {
        self.u * p.x + self.v * p.y + self.plane.normal * self.plane.offset
    }
}

struct Flat {
    leaf: u32,
    poly: Poly,
    bounds: (DVec2, DVec2),
}

impl Flat {
    fn new(leaf: u32, poly: Poly) -> Self {
        let bounds = flat::bounds(&poly);
        Self { leaf, poly, bounds }
    }
}

fn by_left(a: &Flat, b: &Flat) -> std::cmp::Ordering {
    a.bounds.0.x.total_cmp(&b.bounds.0.x).then(a.leaf.cmp(&b.leaf))
}

/// The faces of all leaves, by node and side.
fn faces(tree: &Tree) -> Vec<[Vec<(u32, usize)>; 2]> {
    let mut faces = vec![[Vec::new(), Vec::new()]; tree.nodes.len()];
    for (leaf, at) in tree.leaves.iter().enumerate() {
        for (k, face) in at.cell.faces.iter().enumerate() {
            if face.tag < BOUND && face.corners.len() > 2 {
                // The front cell's face is listed first.
                faces[(face.tag >> 1) as usize][1 - (face.tag & 1) as usize].push((leaf as u32, k));
            }
        }
    }
    faces
}

fn flats(tree: &Tree, frame: &Frame, list: &[(u32, usize)]) -> Vec<Flat> {
    let mut flats: Vec<Flat> = list
        .iter()
        .map(|&(leaf, k)| {
            Flat::new(leaf, frame.flatten(&tree.leaves[leaf as usize].cell.faces[k].corners))
        })
        .collect();
    flats.sort_by(by_left);
    flats
}

fn blockers(frame: &Frame, sheets: &[Sheet]) -> (Vec<Flat>, f64) {
    let mut blockers: Vec<Flat> = sheets
        .iter()
        .filter(|s| crate::tree::has_area(&s.corners))
        .map(|s| Flat::new(u32::from(s.opaque), frame.flatten(&s.corners)))
        .filter(|f| flat::area(&f.poly) > 1e-9)
        .collect();
    blockers.sort_by(by_left);
    let widest = blockers.iter().map(|b| b.bounds.1.x - b.bounds.0.x).fold(0.0, f64::max);
    (blockers, widest)
}

fn overlapping<'a>(
    list: &'a [Flat],
    widest: f64,
    bounds: &'a (DVec2, DVec2),
) -> impl Iterator<Item = &'a Flat> {
    let first = list.partition_point(|b| b.bounds.0.x < bounds.0.x - widest);
    list[first..]
        .iter()
        .take_while(|b| b.bounds.0.x <= bounds.1.x)
        .filter(|b| !flat::apart(&b.bounds, bounds))
}

/// All pairs of leaves that touch in more than a line.
pub(crate) fn links(tree: &Tree, building: &Walls<'_>) -> Vec<Link> {
    let scale = building.scale;
    let clutter = Clutter::new(tree, building);
    let mut links = Vec::new();
    for (node, sides) in faces(tree).iter().enumerate() {
        let frame = Frame::new(&tree.nodes[node].plane);
        let front = flats(tree, &frame, &sides[0]);
        let back = flats(tree, &frame, &sides[1]);
        let (sheets, widest_sheet) = blockers(&frame, &tree.nodes[node].sheets);
        let widest = back.iter().map(|b| b.bounds.1.x - b.bounds.0.x).fold(0.0, f64::max);
        // (face in front, face behind, free pieces)
        let mut found: Vec<(usize, usize, Vec<Poly>)> = Vec::new();
        let first_link = links.len();
        for (i, f) in front.iter().enumerate() {
            for b in overlapping(&back, widest, &f.bounds) {
                let common = flat::intersection(&f.poly, &b.poly);
                let shared = flat::area(&common);
                if shared < 1e-7 {
                    continue;
                }
                let near = flat::bounds(&common);
                let (mut panes, mut walls) = (Vec::new(), Vec::new());
                for s in overlapping(&sheets, widest_sheet, &near) {
                    panes.push(&s.poly);
                    if s.leaf == 1 {
                        walls.push(&s.poly);
                    }
                }
                let mut pieces = Vec::new();
                flat::subtract(&common, &panes, 0, &mut pieces);
                let free: f64 = pieces.iter().map(|p| flat::area(p)).sum();
                let open = if panes.len() == walls.len() {
                    free
                } else {
                    let mut pieces = Vec::new();
                    flat::subtract(&common, &walls, 0, &mut pieces);
                    pieces.iter().map(|p| flat::area(p)).sum()
                };
                let reach = if free < LEAST_RAYS * scale * scale {
                    1.0
                } else {
                    let points = grid(&frame, &pieces);
                    let (n, on) = (frame.plane.normal, building);
                    let reach = |leaf, inward| clutter.reach(tree, on, leaf, inward, free, &points);
                    reach(f.leaf, n).min(reach(b.leaf, -n))
                };
                links.push(Link {
                    node: node as u32,
                    leaves: [f.leaf, b.leaf],
                    shared,
                    free,
                    open,
                    openness: 0.0,
                    reach,
                });
                found.push((i, f.leaf as usize, pieces));
            }
        }
        openness(&mut links[first_link..], &found, &front, &back, WINDOW * scale);
    }
    links
}

/// Points spread evenly over polygons.
fn grid(frame: &Frame, pieces: &[Poly]) -> Vec<DVec3> {
    let mut around = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for piece in pieces {
        let (lo, hi) = flat::bounds(piece);
        around = (around.0.min(lo), around.1.max(hi));
    }
    let step = (around.1 - around.0) / f64::from(ROWS);
    let mut points = Vec::new();
    for i in 0..ROWS * ROWS {
        // Off the middle, where edges of a symmetrical thing are.
        let at = DVec2::new(f64::from(i % ROWS) + 0.47, f64::from(i / ROWS) + 0.53);
        let p = around.0 + step * at;
        if pieces.iter().any(|piece| flat::contains(piece, p)) {
            points.push(frame.lift(p));
        }
    }
    points
}

/// Fills in how open the faces of both leaves are in a window around each opening.
fn openness(
    links: &mut [Link],
    found: &[(usize, usize, Vec<Poly>)],
    front: &[Flat],
    back: &[Flat],
    window: f64,
) {
    // Links by leaf, so that the pieces in a face are found.
    let mut by_leaf: Vec<(u32, usize)> =
        links.iter().enumerate().flat_map(|(k, l)| l.leaves.map(|leaf| (leaf, k))).collect();
    by_leaf.sort_unstable();
    let mut faces: Vec<(u32, &Flat)> = front.iter().chain(back).map(|f| (f.leaf, f)).collect();
    faces.sort_by_key(|f| f.0);
    let values: Vec<f64> = (0..links.len())
        .map(|k| {
            let pieces = &found[k].2;
            if links[k].free < 1e-4 {
                return 0.0;
            }
            let mut around = (DVec2::INFINITY, DVec2::NEG_INFINITY);
            for piece in pieces {
                let (lo, hi) = flat::bounds(piece);
                around = (around.0.min(lo), around.1.max(hi));
            }
            let (lo, hi) = (around.0 - window, around.1 + window);
            let frame = vec![lo, DVec2::new(hi.x, lo.y), hi, DVec2::new(lo.x, hi.y)];
            let bounds = (lo, hi);
            links[k]
                .leaves
                .iter()
                .map(|&leaf| {
                    let clipped = |poly: &Poly, b: &(DVec2, DVec2)| {
                        if flat::apart(b, &bounds) {
                            0.0
                        } else if b.0.cmpge(lo).all() && b.1.cmple(hi).all() {
                            flat::area(poly)
                        } else {
                            flat::area(&flat::intersection(poly, &frame))
                        }
                    };
                    let at = faces.partition_point(|f| f.0 < leaf);
                    let all: f64 = faces[at..]
                        .iter()
                        .take_while(|f| f.0 == leaf)
                        .map(|f| clipped(&f.1.poly, &f.1.bounds))
                        .sum();
                    let at = by_leaf.partition_point(|l| l.0 < leaf);
                    let free: f64 = by_leaf[at..]
                        .iter()
                        .take_while(|l| l.0 == leaf)
                        .flat_map(|l| &found[l.1].2)
                        .map(|p| clipped(p, &flat::bounds(p)))
                        .sum();
                    if all > 0.0 { (free / all).min(1.0) } else { 0.0 }
                })
                .fold(1.0, f64::min)
        })
        .collect();
    for (link, value) in links.iter_mut().zip(values) {
        link.openness = value;
    }
}

/// The open pieces of the links that are asked for (indices into the list of [`links`], which is
/// sorted by node), counter-clockwise around the node's normal: they face the leaf in front.
pub(crate) fn pieces(tree: &Tree, links: &[Link], wanted: &[usize]) -> Vec<(usize, Vec<DVec3>)> {
    let mut out = Vec::new();
    let faces = faces(tree);
    let mut at = 0;
    while at < wanted.len() {
        let node = links[wanted[at]].node as usize;
        let frame = Frame::new(&tree.nodes[node].plane);
        let (sheets, widest) = blockers(&frame, &tree.nodes[node].sheets);
        let opaque: Vec<Flat> = sheets.into_iter().filter(|s| s.leaf == 1).collect();
        while at < wanted.len() && links[wanted[at]].node as usize == node {
            let link = &links[wanted[at]];
            let side = |s: usize| {
                let leaf = link.leaves[s];
                faces[node][s].iter().find(|f| f.0 == leaf).map(|&(leaf, k)| {
                    frame.flatten(&tree.leaves[leaf as usize].cell.faces[k].corners)
                })
            };
            if let (Some(a), Some(b)) = (side(0), side(1)) {
                let common = flat::intersection(&a, &b);
                let near = flat::bounds(&common);
                let walls: Vec<&Poly> =
                    overlapping(&opaque, widest, &near).map(|s| &s.poly).collect();
                let mut found = Vec::new();
                if common.len() > 2 {
                    flat::subtract(&common, &walls, 0, &mut found);
                }
                for piece in found {
                    out.push((wanted[at], piece.iter().map(|&p| frame.lift(p)).collect()));
                }
            }
            at += 1;
        }
    }
    out
}

//! Which leaves touch, and how open their common faces are.

use crate::clutter::Clutter;
use crate::convex::{Plane, flat, flat::Poly};
use crate::tree::{BOUND, Sheet, Tree, Walls};
use glam::{DVec2, DVec3};

/// How far around an opening its wall is looked at, m.
const WINDOW: f64 = 1.0;
/// And this share of the opening's own size, if that is more: a corridor that ends at another one opens a third of a
/// wall of three times its width, and a room around a corner one half.
const AROUND: f64 = 1.0;
/// One walks along a wall from leaf to leaf where this share of the faces between them is free.
const ALONG: f64 = 0.4;
/// An opening this close to the end of the wall reaches it, in windows.
const FLUSH: f64 = 0.4;
/// Parts of one opening are this close to each other, in windows.
const TOUCH: f64 = 0.02;
/// An opening is put together in so many steps at most.
const MOST_GROWTHS: usize = 8;
/// And through so many leaves at most.
const MOST_ALONG: usize = 24;
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
    /// The opening reaches the end of the wall on one side at least: it is no door and no mouth.
    pub(crate) flush: bool,
    /// Middle of what is free, m.
    pub(crate) centre: DVec3,
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
    fn new(plane: &Plane, north: DVec3) -> Self {
        let (u, v) = plane.basis(north);
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

fn blockers(frame: &Frame, sheets: &[Sheet], triangles: &[[[f32; 3]; 3]]) -> (Vec<Flat>, f64) {
    let mut blockers: Vec<Flat> = sheets
        .iter()
        .map(|s| (s.opaque, s.corners(triangles)))
        .filter(|s| crate::tree::has_area(&s.1))
        .map(|s| Flat::new(u32::from(s.0), frame.flatten(&s.1)))
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

/// A free piece of a link: its bounds in the frame of the node, and its area.
struct Part {
    bounds: (DVec2, DVec2),
    area: f64,
}

/// All pairs of leaves that touch in more than a line.
pub(crate) fn links(tree: &Tree, building: &Walls<'_>) -> Vec<Link> {
    let scale = building.scale;
    let clutter = Clutter::new(tree, building);
    let faces = faces(tree);
    let mut links: Vec<Link> = Vec::new();
    // The parts of link i are parts[ends[i - 1]..ends[i]].
    let mut parts: Vec<Part> = Vec::new();
    let mut ends: Vec<usize> = Vec::new();
    for (node, sides) in faces.iter().enumerate() {
        let frame = Frame::new(&tree.nodes[node].plane, tree.north);
        let front = flats(tree, &frame, &sides[0]);
        let back = flats(tree, &frame, &sides[1]);
        let (sheets, widest_sheet) = blockers(&frame, &tree.nodes[node].sheets, building.triangles);
        let widest = back.iter().map(|b| b.bounds.1.x - b.bounds.0.x).fold(0.0, f64::max);
        for f in &front {
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
                    let n = frame.plane.normal;
                    let reach =
                        |leaf, inward| clutter.reach(tree, building, leaf, inward, free, &points);
                    reach(f.leaf, n).min(reach(b.leaf, -n))
                };
                links.push(Link {
                    node: node as u32,
                    leaves: [f.leaf, b.leaf],
                    shared,
                    free,
                    open,
                    openness: 0.0,
                    flush: false,
                    centre: frame.lift(middle(&pieces)),
                    reach,
                });
                parts.extend(
                    pieces.iter().map(|p| Part { bounds: flat::bounds(p), area: flat::area(p) }),
                );
                ends.push(parts.len());
            }
        }
    }
    openness(tree, &mut links, &faces, &parts, &ends, WINDOW * scale);
    links
}

/// Middle of the bounds of polygons.
fn middle(pieces: &[Poly]) -> DVec2 {
    let mut around = (DVec2::INFINITY, DVec2::NEG_INFINITY);
    for piece in pieces {
        let (lo, hi) = flat::bounds(piece);
        around = (around.0.min(lo), around.1.max(hi));
    }
    if pieces.is_empty() { DVec2::ZERO } else { (around.0 + around.1) * 0.5 }
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

/// How much of what lies in a box lies in another one.
fn share(of: &(DVec2, DVec2), window: &(DVec2, DVec2)) -> f64 {
    let size = (of.1 - of.0).max(DVec2::splat(1e-9));
    let common = (of.1.min(window.1) - of.0.max(window.0)).max(DVec2::ZERO);
    (common.x / size.x).min(1.0) * (common.y / size.y).min(1.0)
}

/// Fills in how open the walls on both sides are in a window around each opening. A wall is more than the
/// face of one leaf: the faces beside it count as well, as far as one can walk there along the wall (and not
/// through another hole in it).
fn openness(
    tree: &Tree,
    links: &mut [Link],
    faces: &[[Vec<(u32, usize)>; 2]],
    parts: &[Part],
    ends: &[usize],
    least: f64,
) {
    let parts_of = |k: usize| &parts[if k == 0 { 0 } else { ends[k - 1] }..ends[k]];
    // Leaves that are wide open to each other, and the node between them.
    let mut beside: Vec<(u32, u32, u32)> = Vec::new();
    // (leaf, node, link), so that all of a face is together.
    let mut at_face: Vec<(u32, u32, u32)> = links
        .iter()
        .enumerate()
        .flat_map(|(k, l)| l.leaves.map(|leaf| (leaf, l.node, k as u32)))
        .collect();
    at_face.sort_unstable();
    let mut open_faces = vec![0u8; links.len()];
    for face in at_face.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)) {
        let of = |f: &(u32, u32, u32)| &links[f.2 as usize];
        let shared = face.iter().fold(0.0, |sum, f| sum + of(f).shared);
        let free = face.iter().fold(0.0, |sum, f| sum + of(f).free);
        if free >= ALONG * shared {
            for f in face {
                open_faces[f.2 as usize] += 1;
            }
        }
    }
    drop(at_face);
    for (k, l) in links.iter().enumerate() {
        if open_faces[k] == 2 && l.free >= ALONG * l.shared && l.reach >= 1.0 {
            let [a, b] = l.leaves;
            beside.extend([(a, b, l.node), (b, a, l.node)]);
        }
    }
    drop(open_faces);
    beside.sort_unstable();
    beside.dedup();
    let beside_of = |leaf: u32, normal: DVec3| {
        let first = beside.partition_point(|b| b.0 < leaf);
        beside[first..]
            .iter()
            .take_while(move |b| b.0 == leaf)
            .filter(move |b| tree.nodes[b.2 as usize].plane.normal.dot(normal).abs() < 0.7)
            .map(|b| b.1)
    };
    struct Spot {
        leaf: u32,
        bounds: (DVec2, DVec2),
        area: f64,
    }
    let bound: Vec<bool> =
        tree.leaves.iter().map(|l| l.cell.faces.iter().any(|f| f.tag >= BOUND)).collect();
    // Nodes that have one plane: a wall may have been cut through in several cells of the tree.
    let key = |node: usize| {
        let plane = &tree.nodes[node].plane;
        let n = plane.normal;
        [n.x.to_bits(), n.y.to_bits(), n.z.to_bits(), plane.offset.to_bits()]
    };
    let mut of_node: Vec<(usize, usize)> = Vec::new();
    for k in 0..links.len() {
        if k == 0 || links[k].node != links[k - 1].node {
            of_node.push((links[k].node as usize, k));
        }
    }
    of_node.sort_unstable_by_key(|&(node, _)| (key(node), node));
    for group in of_node.chunk_by(|a, b| key(a.0) == key(b.0)) {
        let frame = Frame::new(&tree.nodes[group[0].0].plane, tree.north);
        let mine: Vec<usize> = group
            .iter()
            .flat_map(|&(node, first)| {
                let count = links[first..].iter().take_while(|l| l.node as usize == node).count();
                first..first + count
            })
            .collect();
        // Faces by leaf, and links by leaf, on both sides.
        let sides: [Vec<Spot>; 2] = [0, 1].map(|s| {
            let mut spots: Vec<Spot> = group
                .iter()
                .flat_map(|&(node, _)| &faces[node][s])
                .map(|&(leaf, k)| {
                    let poly = frame.flatten(&tree.leaves[leaf as usize].cell.faces[k].corners);
                    Spot { leaf, bounds: flat::bounds(&poly), area: flat::area(&poly) }
                })
                .collect();
            spots.sort_by_key(|s| s.leaf);
            spots
        });
        let by_leaf: [Vec<(u32, usize)>; 2] = [0, 1].map(|s| {
            let mut list: Vec<(u32, usize)> =
                mine.iter().map(|&k| (links[k].leaves[s], k)).collect();
            list.sort_unstable();
            list
        });
        for &k in &mine {
            if links[k].free < 1e-4 {
                continue;
            }
            // The scene's own box is no wall.
            if links[k].leaves.iter().any(|&l| bound[l as usize]) {
                links[k].openness = links[k].free / links[k].shared;
                links[k].flush = true;
                continue;
            }
            let (mut lo, mut hi) = (DVec2::INFINITY, DVec2::NEG_INFINITY);
            for part in parts_of(k) {
                (lo, hi) = (lo.min(part.bounds.0), hi.max(part.bounds.1));
            }
            // An opening may go on in the links beside this one: all of it counts.
            let mut free = 0.0;
            let mut window = (lo, hi);
            let mut reached = [Vec::new(), Vec::new()];
            for _ in 0..MOST_GROWTHS {
                let margin = ((hi - lo) * AROUND).max(DVec2::splat(least));
                window = (lo - margin, hi + margin);
                // The leaves along the wall on either side, and what is free between them.
                reached = [0, 1].map(|s| {
                    let mut reached = vec![links[k].leaves[s]];
                    let mut next = 0;
                    while let Some(&leaf) = reached.get(next) {
                        next += 1;
                        for other in beside_of(leaf, frame.plane.normal) {
                            let at = sides[s].partition_point(|f| f.leaf < other);
                            if reached.len() < MOST_ALONG
                                && sides[s].get(at).is_some_and(|f| {
                                    f.leaf == other && !flat::apart(&f.bounds, &window)
                                })
                                && !reached.contains(&other)
                            {
                                reached.push(other);
                            }
                        }
                    }
                    reached
                });
                free = 0.0;
                let touching = (lo - TOUCH * least, hi + TOUCH * least);
                for &leaf in &reached[0] {
                    let at = by_leaf[0].partition_point(|l| l.0 < leaf);
                    for l in by_leaf[0][at..].iter().take_while(|l| l.0 == leaf) {
                        if reached[1].contains(&links[l.1].leaves[1]) {
                            for part in parts_of(l.1) {
                                free += part.area * share(&part.bounds, &window);
                                if !flat::apart(&part.bounds, &touching) {
                                    (lo, hi) = (lo.min(part.bounds.0), hi.max(part.bounds.1));
                                }
                            }
                        }
                    }
                }
                if lo.cmpge(touching.0).all() && hi.cmple(touching.1).all() {
                    break;
                }
            }
            let mut most = 0.0_f64;
            let mut gaps = DVec2::ZERO;
            for s in [0, 1] {
                let mut all = 0.0;
                let (mut left, mut right) = (lo.x, hi.x);
                for &leaf in &reached[s] {
                    let at = sides[s].partition_point(|f| f.leaf < leaf);
                    for spot in sides[s][at..].iter().take_while(|f| f.leaf == leaf) {
                        let inside = share(&spot.bounds, &window);
                        all += spot.area * inside;
                        if inside > 0.0 {
                            left = left.min(spot.bounds.0.x.max(window.0.x));
                            right = right.max(spot.bounds.1.x.min(window.1.x));
                        }
                    }
                }
                most = most.max(all);
                gaps = gaps.max(DVec2::new(lo.x - left, right - hi.x));
            }
            links[k].flush =
                frame.plane.normal.z.abs() > 0.7 || gaps.min_element() <= FLUSH * least;
            links[k].openness = if most > 0.0 { (free / most).min(1.0) } else { 0.0 };
        }
    }
}

/// The open pieces of the links that are asked for (indices into the list of [`links`], which is
/// sorted by node), counter-clockwise around the node's normal: they face the leaf in front.
pub(crate) fn pieces(
    tree: &Tree,
    triangles: &[[[f32; 3]; 3]],
    links: &[Link],
    wanted: &[usize],
) -> Vec<(usize, Vec<DVec3>)> {
    let mut out = Vec::new();
    let faces = faces(tree);
    let mut at = 0;
    while at < wanted.len() {
        let node = links[wanted[at]].node as usize;
        let frame = Frame::new(&tree.nodes[node].plane, tree.north);
        let (sheets, widest) = blockers(&frame, &tree.nodes[node].sheets, triangles);
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

//! From triangles to rooms: tree, regions, portals, descriptions. Tiles are cut in `pieces`.

use crate::cluster::{cluster, north, point};
use crate::convex::{Plane, area, area_vector};
use crate::hints::Footprint;
use crate::merge::{CORNER, LeafFacts, Merged, WIDE, merge};
use crate::openings::{Link, links, pieces};
use crate::probe::{Facing, Probe};
use crate::tables::{lists, tables};
use crate::tree::{LEAF, THIN, Tree, Walls, build};
use crate::walk::Bsp;
use crate::{Options, RoomCount, RoomsError};
use enf_layout::bsp::{LEAF_OUTSIDE, LEAF_SOLID};
use enf_layout::room::{PIECE_CORNERS, PortalPieceRecord, PortalRecord, RoomRecord};
use glam::DVec3;
use std::collections::BTreeMap;

/// Leaves wider than this are not asked whether they are solid, m.
const SOLID_WIDTH: f64 = 1.2;
/// Whether normals are to be trusted is seen from so many cells.
const MOST_LOOKS: usize = 64;
/// Where normals tell nothing, leaves thinner than this may be walls, m.
const WALL: f64 = 0.45;
/// Lengths that tell a door from a room shrink with scenes smaller than this, m: a Cornell box of
/// half a metre has a room as well.
const FULL_SIZE: f64 = 8.0;
/// Smaller pieces are walked through but not listed, m².
const LEAST_PIECE: f64 = 1e-4;
/// Pieces of one portal touch to this, m.
const TOUCH: f64 = 2e-3;
/// Smaller openings are nobody's corner, m².
const LEAST_CORNER: f64 = 0.5;
/// Farther is as far, m.
const FAR: f64 = 100.0;
/// Height of the eyes, m.
const EYES: f64 = 1.6;

/// A scene divided into rooms, and on demand into tiles.
#[derive(Debug)]
pub struct Partition {
    pub(crate) tree: Tree,
    pub(crate) delta: f64,
    /// Room of each leaf of the base tree.
    pub(crate) room: Vec<u32>,
    /// Flags of each leaf of the base tree.
    pub(crate) flags: Vec<u32>,
    pub(crate) rooms: Vec<RoomRecord>,
    pub(crate) portals: Vec<PortalRecord>,
    pub(crate) portal_pieces: Vec<PortalPieceRecord>,
    pub(crate) outside: Option<u32>,
    /// Piece of each leaf, cut ones included.
    pub(crate) piece: Vec<u32>,
    /// Room of each piece.
    pub(crate) piece_rooms: Vec<u32>,
    /// Whether pieces have been cut.
    pub(crate) cut: bool,
    pub(crate) oversized: Vec<u32>,
}

/// Divides a scene into rooms. `opaque(i)` tells whether no light passes straight through triangle
/// `i`; panes of glass divide rooms as walls do, but are open to light.
///
/// Rooms depend on the triangles and the options alone. `RoomRecord::triangles` and the tile fields
/// are filled in by [`Partition::finish`].
///
/// # Errors
/// [`RoomsError`] if there are no triangles, a vertex is not finite or outside of the bounds, or
/// the request cannot be met.
pub fn partition(
    triangles: &[[[f32; 3]; 3]],
    opaque: &(dyn Fn(usize) -> bool + Sync),
    options: &Options,
) -> Result<Partition, RoomsError> {
    let (bounds, delta) = check(triangles, options)?;
    let diagonal = (bounds.1 - bounds.0).length();
    let margin = (0.02 * diagonal).max(1.0);
    let tolerance = (4.0 * delta).max(2e-3_f64.min(1e-4 * diagonal));
    let scale = (diagonal / FULL_SIZE).clamp(1e-3, 1.0);
    let mut hints = Vec::with_capacity(options.hints.len());
    for (i, hint) in options.hints.iter().enumerate() {
        let footprint = Footprint::new(hint);
        hints.push(footprint.ok_or_else(|| RoomsError::Bounds { what: format!("hint {i}") })?);
    }
    let (clusters, of) = cluster(triangles, tolerance * 0.5, scale);
    let north = north(&clusters);
    let walls = Walls { triangles, opaque, clusters, north, tolerance, scale };
    let mut tree = build(&walls, &of, bounds.0 - margin, bounds.1 + margin, bounds, &hints);
    drop(of);
    let mut found = links(&tree, &walls);
    let mut divided = divide(&tree, delta, scale, triangles, opaque, &found, &hints);
    match options.rooms {
        RoomCount::Auto => {}
        RoomCount::Exactly(0) => {
            return Err(RoomsError::Request("0 rooms were asked for; at least 1 is needed"));
        }
        RoomCount::Exactly(1) => {
            divided.region.fill(0);
            divided.regions = 1;
            divided.outside = None;
        }
        RoomCount::Exactly(n) => {
            fewer(&mut divided, &found, n);
            if more(&mut tree, &mut divided, &walls, bounds, n)? {
                found = links(&tree, &walls);
            }
        }
    }
    for leaf in &mut tree.leaves {
        leaf.fragments = Vec::new();
    }
    Ok(describe(tree, delta, scale, triangles, opaque, &found, divided))
}

fn check(
    triangles: &[[[f32; 3]; 3]],
    options: &Options,
) -> Result<((DVec3, DVec3), f64), RoomsError> {
    if triangles.is_empty() {
        return Err(RoomsError::Empty);
    }
    if triangles.len() >= LEAF as usize {
        return Err(RoomsError::TooMany { what: "triangles", count: triangles.len() });
    }
    let (min, max) = (point(options.bounds_min), point(options.bounds_max));
    let delta = f64::from(options.delta);
    if !(min.is_finite() && max.is_finite() && min.cmple(max).all()) {
        return Err(RoomsError::Bounds { what: "bounding box".into() });
    }
    if !(delta.is_finite() && delta > 0.0) {
        return Err(RoomsError::Bounds { what: "tolerance".into() });
    }
    for (i, t) in triangles.iter().enumerate() {
        for &p in t {
            let p = point(p);
            if !p.is_finite() {
                return Err(RoomsError::NotFinite { triangle: i });
            }
            if p.cmplt(min).any() || p.cmpgt(max).any() {
                return Err(RoomsError::Bounds { what: "bounding box".into() });
            }
        }
    }
    Ok(((min, max), delta))
}

/// Numbers for leaves and labels, before there are rooms.
fn with_probe<R>(
    tree: &Tree,
    delta: f64,
    triangles: &[[[f32; 3]; 3]],
    opaque: &(dyn Fn(usize) -> bool + Sync),
    scale: f64,
    known: Option<Facing>,
    f: impl FnOnce(&Probe<'_>) -> R,
) -> R {
    let same: Vec<u32> = (0..tree.leaves.len() as u32).collect();
    let tables = tables(tree, delta, &same, |_| (0, 0, 0));
    let lists = lists(tree, delta, triangles, tree.leaves.len(), |leaf| leaf);
    let bsp = Bsp {
        planes: &tables.planes,
        nodes: &tables.nodes,
        leaves: &tables.leaves,
        faces: &tables.faces,
        delta,
    };
    let mut probe = Probe { bsp, lists: &lists, triangles, opaque, facing: Facing::Front };
    probe.facing = known.unwrap_or_else(|| facing(tree, &probe, scale));
    f(&probe)
}

/// Whether the model shows its fronts, looking around from the largest open cells.
fn facing(tree: &Tree, probe: &Probe<'_>, scale: f64) -> Facing {
    let mut open: Vec<(f64, u32)> = tree
        .leaves
        .iter()
        .enumerate()
        .filter(|(_, l)| !l.cell.faces.iter().any(|f| f.tag >= crate::tree::BOUND))
        .map(|(i, l)| (l.cell.volume(), i as u32))
        .filter(|&(v, _)| v > 1.0 * scale * scale * scale)
        .collect();
    open.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let (mut backs, mut hits) = (0.0, 0.0);
    for &(_, leaf) in open
        .iter()
        .filter(|o| tree.leaves[o.1 as usize].cell.width() > SOLID_WIDTH * scale)
        .take(MOST_LOOKS)
    {
        let sight = probe.look(tree.leaves[leaf as usize].cell.centre(), 8);
        backs += sight.backs;
        hits += sight.hits;
    }
    if hits > 0.0 { Facing::from_backs(backs / hits) } else { Facing::Front }
}

fn divide(
    tree: &Tree,
    delta: f64,
    scale: f64,
    triangles: &[[[f32; 3]; 3]],
    opaque: &(dyn Fn(usize) -> bool + Sync),
    found: &[Link],
    hints: &[Footprint],
) -> Merged {
    with_probe(tree, delta, triangles, opaque, scale, None, |probe| {
        let facts: Vec<LeafFacts> = tree
            .leaves
            .iter()
            .map(|leaf| {
                let (lo, hi) = leaf.cell.bounds();
                let width = leaf.cell.width();
                let centre = leaf.cell.centre();
                let bound = leaf.cell.faces.iter().any(|f| f.tag >= crate::tree::BOUND);
                let hint = hints.iter().position(|h| h.contains(centre));
                LeafFacts {
                    volume: leaf.cell.volume(),
                    width,
                    low: lo.z,
                    high: hi.z,
                    bound,
                    backs: if bound || width > SOLID_WIDTH * scale {
                        0.0
                    } else if probe.facing == Facing::Mixed {
                        // Between two sheets of a wall, unless it turns out to be open.
                        if width < WALL * scale { 1.0 } else { 0.0 }
                    } else {
                        probe.look(centre, 8).backs
                    },
                    hint: hint.map(|h| h as u32),
                }
            })
            .collect();
        let backs = |leaf: u32| probe.look(tree.leaves[leaf as usize].cell.centre(), 14).backs;
        let ahead: Vec<f64> = found.iter().map(|l| ahead(tree, probe, l, scale)).collect();
        merge(&facts, found, &ahead, scale, probe.facing, &backs)
    })
}

/// How far one sees through an opening, m, into the nearer side of it; 0 for openings that are doors or no
/// openings at all.
fn ahead(tree: &Tree, probe: &Probe<'_>, link: &Link, scale: f64) -> f64 {
    let normal = tree.nodes[link.node as usize].plane.normal;
    if link.free < LEAST_CORNER * scale * scale
        || !(CORNER..WIDE).contains(&link.openness)
        || normal.z.abs() > 0.7
    {
        return 0.0;
    }
    // Across most of the opening, so that a door on the other side is not taken for a way on.
    let height = link.leaves.iter().fold(f64::INFINITY, |h: f64, &l| {
        let (lo, hi) = tree.leaves[l as usize].cell.bounds();
        h.min(hi.z - lo.z)
    });
    let along = DVec3::Z.cross(normal) * (0.2 * link.free / height.max(1e-3));
    let far = |d: DVec3| {
        let mut seen = [-2.0, -1.0, 0.0, 1.0, 2.0].map(|k| probe.sight(link.centre + along * k, d));
        seen.sort_by(f64::total_cmp);
        seen[1].min(FAR * scale)
    };
    far(normal).min(far(-normal))
}

/// Volumes and openings of the regions inside.
fn volumes(tree: &Tree, divided: &Merged) -> Vec<f64> {
    let mut volumes = vec![0.0; divided.regions as usize];
    for (leaf, at) in tree.leaves.iter().enumerate() {
        if !divided.solid[leaf] {
            volumes[divided.region[leaf] as usize] += at.cell.volume();
        }
    }
    volumes
}

fn inside_count(divided: &Merged) -> u32 {
    divided.regions - u32::from(divided.outside.is_some())
}

/// Merges rooms through the largest openings until at most `n` are left.
fn fewer(divided: &mut Merged, found: &[Link], n: u32) {
    // Open and shared area per pair of rooms, lower number first.
    let mut between: BTreeMap<(u32, u32), (f64, f64)> = BTreeMap::new();
    for link in found {
        let [a, b] = link.leaves.map(|l| divided.region[l as usize]);
        if a != b && Some(a) != divided.outside && Some(b) != divided.outside {
            let e = between.entry((a.min(b), a.max(b))).or_default();
            let airy = link.leaves.iter().all(|&l| !divided.solid[l as usize]);
            e.0 += if airy { link.open } else { 0.0 };
            e.1 += link.shared;
        }
    }
    let mut into: Vec<u32> = (0..divided.regions).collect();
    let mut left = inside_count(divided);
    while left > n {
        let mut best: Option<((f64, f64), (u32, u32))> = None;
        for (&pair, &areas) in &between {
            if best.is_none_or(|b| areas > b.0) {
                best = Some((areas, pair));
            }
        }
        // Rooms that touch nothing inside: any two.
        let (a, b) = best.map_or_else(
            || {
                let mut inside = (0..divided.regions)
                    .filter(|&r| into[r as usize] == r && Some(r) != divided.outside);
                (inside.next().unwrap_or(0), inside.next().unwrap_or(0))
            },
            |b| b.1,
        );
        if a == b {
            break;
        }
        into[b as usize] = a;
        left -= 1;
        let moved: Vec<((u32, u32), (f64, f64))> = between
            .iter()
            .filter(|(pair, _)| pair.0 == b || pair.1 == b)
            .map(|(&pair, &areas)| (pair, areas))
            .collect();
        for (pair, areas) in moved {
            between.remove(&pair);
            let other = if pair.0 == b { pair.1 } else { pair.0 };
            if other != a {
                let e = between.entry((a.min(other), a.max(other))).or_default();
                e.0 += areas.0;
                e.1 += areas.1;
            }
        }
    }
    // Close the gaps in the numbers. A room is merged into a lower one or into one that is itself
    // merged later; follow to the end.
    let end = |mut r: u32| {
        while into[r as usize] != r {
            r = into[r as usize];
        }
        r
    };
    let mut number = vec![0u32; into.len()];
    let mut count = 0;
    for r in 0..divided.regions {
        if into[r as usize] == r {
            number[r as usize] = count;
            count += 1;
        }
    }
    for r in &mut divided.region {
        *r = number[end(*r) as usize];
    }
    divided.outside = divided.outside.map(|o| number[o as usize]);
    divided.regions = count;
}

/// Cuts the largest rooms by virtual walls until there are `n`.
fn more(
    tree: &mut Tree,
    divided: &mut Merged,
    walls: &Walls<'_>,
    bounds: (DVec3, DVec3),
    n: u32,
) -> Result<bool, RoomsError> {
    if inside_count(divided) >= n {
        return Ok(false);
    }
    if inside_count(divided) == 0 {
        // All is outside: what lies within the scene's own box becomes the room that is cut.
        let mut moved = 0;
        for (leaf, at) in tree.leaves.iter().enumerate() {
            let c = at.cell.centre();
            if c.cmpgt(bounds.0).all() && c.cmplt(bounds.1).all() {
                divided.region[leaf] = divided.regions;
                moved += 1;
            }
        }
        if moved == 0 {
            return Err(RoomsError::Request("a flat scene cannot be cut into rooms"));
        }
        divided.regions += 1;
    }
    let mut volumes = volumes(tree, divided);
    while inside_count(divided) < n {
        let mut largest: Option<(f64, u32)> = None;
        for (r, &v) in volumes.iter().enumerate() {
            if Some(r as u32) != divided.outside && largest.is_none_or(|l| v > l.0) {
                largest = Some((v, r as u32));
            }
        }
        let Some((volume, room)) = largest.filter(|l| l.0 > 0.0) else {
            return Err(RoomsError::Request("the rooms are too small for so many; ask for fewer"));
        };
        let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for (leaf, at) in tree.leaves.iter().enumerate() {
            if divided.region[leaf] == room && !divided.solid[leaf] {
                let (a, b) = at.cell.bounds();
                (lo, hi) = (lo.min(a), hi.max(b));
            }
        }
        let size = hi - lo;
        let mut axes = [(size.x, DVec3::X), (size.y, DVec3::Y), (size.z, DVec3::Z)];
        axes.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut done = false;
        for (_, normal) in axes {
            let plane = Plane { normal, offset: normal.dot((lo + hi) * 0.5) };
            let new = divided.regions;
            let mut front_volume = 0.0;
            for leaf in 0..tree.leaves.len() as u32 {
                let l = leaf as usize;
                if divided.region[l] != room {
                    continue;
                }
                let (s0, s1) = tree.leaves[l].cell.range(&plane);
                let whole_front = s0 >= -walls.tolerance;
                if whole_front {
                    divided.region[l] = new;
                } else if s1 > walls.tolerance
                    && let Some(front) = tree.split_leaf(leaf, &plane, false, Some(walls))
                {
                    divided.region.push(new);
                    divided.solid.push(divided.solid[l]);
                    if !divided.solid[l] {
                        front_volume += tree.leaves[front as usize].cell.volume();
                    }
                }
                if whole_front && !divided.solid[l] {
                    front_volume += tree.leaves[l].cell.volume();
                }
            }
            if front_volume > 0.0 && front_volume < volume * (1.0 - 1e-9) {
                divided.regions += 1;
                volumes[room as usize] -= front_volume;
                volumes.push(front_volume);
                done = true;
                break;
            }
            for r in &mut divided.region {
                if *r == new {
                    *r = room;
                }
            }
        }
        if !done {
            return Err(RoomsError::Request("the rooms are too small for so many; ask for fewer"));
        }
    }
    Ok(true)
}

/// A room before it has its number.
struct Draft {
    region: u32,
    record: RoomRecord,
}

fn describe(
    mut tree: Tree,
    delta: f64,
    scale: f64,
    triangles: &[[[f32; 3]; 3]],
    opaque: &(dyn Fn(usize) -> bool + Sync),
    found: &[Link],
    divided: Merged,
) -> Partition {
    let mut leaves_of: Vec<Vec<u32>> = vec![Vec::new(); divided.regions as usize];
    for (leaf, &region) in divided.region.iter().enumerate() {
        leaves_of[region as usize].push(leaf as u32);
    }
    let mut drafts: Vec<Draft> =
        with_probe(&tree, delta, triangles, opaque, scale, Some(divided.facing), |probe| {
            leaves_of
                .iter()
                .enumerate()
                .map(|(region, leaves)| {
                    let outside = divided.outside == Some(region as u32);
                    let airy: Vec<u32> =
                        leaves.iter().copied().filter(|&l| !divided.solid[l as usize]).collect();
                    let own = if airy.is_empty() { leaves } else { &airy };
                    Draft { region: region as u32, record: draft(&tree, own, outside, probe) }
                })
                .collect()
        });
    // By storey, then x, then y; the outside last. Quantised, so that rounding cannot reorder.
    let quantised = |x: f32, step: f32| (x / step).round() as i64;
    drafts.sort_by_key(|d| {
        let [x, y, z] = d.record.inside;
        (
            d.record.flags & LEAF_OUTSIDE,
            quantised(z, 0.5),
            quantised(x, 1e-3),
            quantised(y, 1e-3),
            quantised(z, 1e-3),
            d.region,
        )
    });
    let mut number = vec![0u32; drafts.len()];
    for (i, d) in drafts.iter().enumerate() {
        number[d.region as usize] = i as u32;
    }
    let room: Vec<u32> = divided.region.iter().map(|&r| number[r as usize]).collect();
    let outside = divided.outside.map(|o| number[o as usize]);
    let flags: Vec<u32> = divided
        .solid
        .iter()
        .zip(&room)
        .map(|(&solid, &room)| {
            (if solid { LEAF_SOLID } else { 0 })
                | (if Some(room) == outside { LEAF_OUTSIDE } else { 0 })
        })
        .collect();
    let mut rooms: Vec<RoomRecord> = drafts.into_iter().map(|d| d.record).collect();
    let (portals, pieces) = portals(&tree, triangles, found, &room, &divided.solid);
    for node in &mut tree.nodes {
        node.sheets = Vec::new();
    }
    for (i, r) in rooms.iter_mut().enumerate() {
        let first = portals.partition_point(|p: &PortalRecord| (p.room as usize) < i);
        let end = portals.partition_point(|p: &PortalRecord| p.room as usize <= i);
        r.first_portal = first as u32;
        r.portal_count = (end - first) as u32;
    }
    // Until it is cut, each room is one piece, with the room's number.
    let (piece, piece_rooms) = (room.clone(), (0..rooms.len() as u32).collect());
    Partition {
        tree,
        delta,
        room,
        flags,
        rooms,
        portals,
        portal_pieces: pieces,
        outside,
        piece,
        piece_rooms,
        cut: false,
        oversized: Vec::new(),
    }
}

fn draft(tree: &Tree, leaves: &[u32], outside: bool, probe: &Probe<'_>) -> RoomRecord {
    let (mut lo, mut hi) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    let mut volume = 0.0;
    let mut by_size: Vec<(f64, u32)> = Vec::with_capacity(leaves.len());
    for &leaf in leaves {
        let cell = &tree.leaves[leaf as usize].cell;
        let (a, b) = cell.bounds();
        (lo, hi) = (lo.min(a), hi.max(b));
        let v = cell.volume();
        volume += v;
        by_size.push((v, leaf));
    }
    by_size.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let storey = hi.z - lo.z < 4.5;
    let mut best: Option<(f64, DVec3)> = None;
    let asked = &by_size[..by_size.len().min(if outside { 1 } else { 5 })];
    let width = |leaf: u32| tree.leaves[leaf as usize].cell.width();
    let widest = asked.iter().map(|&(_, leaf)| width(leaf)).fold(1e-9, f64::max);
    for &(_, leaf) in asked {
        let cell = &tree.leaves[leaf as usize].cell;
        // A sliver before a window sees far, and is no place to stand.
        let wide = (2.0 * width(leaf) / widest).min(1.0);
        let (a, b) = cell.bounds();
        let floor = if storey { lo.z } else { a.z };
        let eyes = floor + EYES;
        let fits = eyes > a.z + 0.1 && eyes < b.z - 0.1;
        let z = if fits { eyes } else { (a.z + b.z) * 0.5 };
        let section = cell.section(&Plane { normal: DVec3::Z, offset: z });
        let middle = centroid(&section).unwrap_or_else(|| cell.centre());
        let mut candidates = vec![middle];
        candidates.extend(section.iter().map(|&c| (c + middle) * 0.5));
        for candidate in candidates.into_iter().take(7) {
            let to_faces =
                cell.faces.iter().map(|f| -f.plane.distance(candidate)).fold(2.0, f64::min);
            let clear = if outside {
                to_faces
            } else {
                let sight = probe.look(candidate, 8);
                let clear = sight.nearest.min(2.0) + 0.05 * to_faces;
                if sight.backs > 0.5 { 0.01 * clear } else { clear }
            };
            let score = clear.max(1e-9) * wide * if fits { 1.0 } else { 0.3 };
            if best.is_none_or(|b| score > b.0 * (1.0 + 1e-9)) {
                best = Some((score, candidate));
            }
        }
    }
    let inside = best.map_or((lo + hi) * 0.5, |b| b.1);
    let level = Plane { normal: DVec3::Z, offset: inside.z };
    let mut floor_area = 0.0;
    for &leaf in leaves {
        let cell = &tree.leaves[leaf as usize].cell;
        let (a, b) = cell.bounds();
        if a.z <= inside.z && inside.z < b.z {
            floor_area += area(&cell.section(&level));
        }
    }
    RoomRecord {
        min: single(lo),
        max: single(hi),
        inside: single(inside),
        volume_m3: volume as f32,
        floor_area_m2: floor_area as f32,
        flags: if outside { LEAF_OUTSIDE } else { 0 },
        triangles: 0,
        first_portal: 0,
        portal_count: 0,
        first_tile: 0,
        tile_count: 0,
    }
}

pub(crate) fn single(p: DVec3) -> [f32; 3] {
    p.to_array().map(|x| x as f32)
}

/// Area centroid of a polygon.
fn centroid(poly: &[DVec3]) -> Option<DVec3> {
    let normal = area_vector(poly);
    let (mut sum, mut all) = (DVec3::ZERO, 0.0);
    for i in 2..poly.len() {
        let a = (poly[i - 1] - poly[0]).cross(poly[i] - poly[0]).dot(normal);
        sum += (poly[0] + poly[i - 1] + poly[i]) * (a / 3.0);
        all += a;
    }
    (all > 0.0).then(|| sum / all)
}

fn portals(
    tree: &Tree,
    triangles: &[[[f32; 3]; 3]],
    found: &[Link],
    room: &[u32],
    solid: &[bool],
) -> (Vec<PortalRecord>, Vec<PortalPieceRecord>) {
    let wanted: Vec<usize> = found
        .iter()
        .enumerate()
        .filter(|(_, l)| {
            let [a, b] = l.leaves.map(|l| l as usize);
            room[a] != room[b] && !solid[a] && !solid[b] && l.open > LEAST_PIECE
        })
        .map(|(i, _)| i)
        .collect();
    // (lower room, higher room) -> pieces facing the lower one.
    let mut between: BTreeMap<(u32, u32), Vec<Vec<DVec3>>> = BTreeMap::new();
    for (link, mut corners) in pieces(tree, triangles, found, &wanted) {
        let [front, back] = found[link].leaves.map(|l| room[l as usize]);
        if front > back {
            corners.reverse();
        }
        let list = between.entry((front.min(back), front.max(back))).or_default();
        while corners.len() > PIECE_CORNERS {
            // Cut off a fan of the first eight corners.
            let rest: Vec<DVec3> =
                corners[..1].iter().chain(&corners[PIECE_CORNERS - 1..]).copied().collect();
            corners.truncate(PIECE_CORNERS);
            list.push(std::mem::replace(&mut corners, rest));
        }
        list.push(corners);
    }
    // Room, other, pieces in the order of their groups.
    let mut all: Vec<(u32, u32, Vec<Vec<DVec3>>)> = Vec::new();
    for ((low, high), mut list) in between {
        list.retain(|p| area(p) >= LEAST_PIECE);
        for group in groups(list) {
            let reversed =
                group.iter().map(|p| p.iter().rev().copied().collect()).collect::<Vec<_>>();
            all.push((low, high, group));
            all.push((high, low, reversed));
        }
    }
    all.sort_by_key(|p| (p.0, p.1));
    let (mut portals, mut records) = (Vec::new(), Vec::new());
    for (room, other, group) in all {
        let (mut sum, mut centre) = (0.0, DVec3::ZERO);
        let first_piece = records.len() as u32;
        for piece in &group {
            let a = area(piece);
            sum += a;
            centre += centroid(piece).unwrap_or(piece[0]) * a;
            let mut corners = [[0.0; 3]; PIECE_CORNERS];
            for (to, &from) in corners.iter_mut().zip(piece) {
                *to = single(from);
            }
            records.push(PortalPieceRecord {
                corners,
                count: piece.len() as u32,
                area_m2: a as f32,
                reserved: [0; 2],
            });
        }
        portals.push(PortalRecord {
            room,
            other,
            first_piece,
            piece_count: group.len() as u32,
            area_m2: sum as f32,
            centre: single(centre / sum),
        });
    }
    (portals, records)
}

/// Connected groups of pieces, in the order of their first piece.
fn groups(list: Vec<Vec<DVec3>>) -> Vec<Vec<Vec<DVec3>>> {
    let boxes: Vec<(DVec3, DVec3)> = list
        .iter()
        .map(|p| {
            p.iter().fold((DVec3::INFINITY, DVec3::NEG_INFINITY), |(lo, hi), &c| {
                (lo.min(c - TOUCH), hi.max(c + TOUCH))
            })
        })
        .collect();
    let mut order: Vec<usize> = (0..list.len()).collect();
    order.sort_by(|&a, &b| boxes[a].0.x.total_cmp(&boxes[b].0.x).then(a.cmp(&b)));
    let mut parent: Vec<usize> = (0..list.len()).collect();
    fn find(parent: &mut [usize], mut i: usize) -> usize {
        while parent[i] != i {
            parent[i] = parent[parent[i]];
            i = parent[i];
        }
        i
    }
    for (k, &a) in order.iter().enumerate() {
        for &b in &order[k + 1..] {
            if boxes[b].0.x > boxes[a].1.x {
                break;
            }
            let apart = boxes[a].0.cmpgt(boxes[b].1).any() || boxes[b].0.cmpgt(boxes[a].1).any();
            if !apart {
                let (x, y) = (find(&mut parent, a), find(&mut parent, b));
                parent[x.max(y)] = x.min(y);
            }
        }
    }
    let mut grouped: BTreeMap<usize, Vec<Vec<DVec3>>> = BTreeMap::new();
    for (i, piece) in list.into_iter().enumerate() {
        let root = find(&mut parent, i);
        grouped.entry(root).or_default().push(piece);
    }
    grouped.into_values().collect()
}

const _: () = assert!(THIN < SOLID_WIDTH);

//! The whole partition: tree, rooms, tiles, tables.

use crate::cluster::{cluster, north, point};
use crate::convex::{Plane, area, area_vector};
use crate::hints::Footprint;
use crate::merge::{CORNER, LeafFacts, Merged, WIDE, merge};
use crate::openings::{Link, links, pieces};
use crate::probe::{Facing, Probe};
use crate::tables::{Lists, lists, tables, touches};
use crate::tree::{LEAF, THIN, Tree, Walls, build};
use crate::walk::Bsp;
use crate::{Options, RoomCount, RoomsError, Tables, TileLimit};
use enf_layout::bsp::{LEAF_OUTSIDE, LEAF_SOLID};
use enf_layout::room::{PIECE_CORNERS, PortalPieceRecord, PortalRecord, RoomRecord, TileRecord};
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
    tree: Tree,
    delta: f64,
    /// Room of each leaf of the base tree.
    room: Vec<u32>,
    /// Flags of each leaf of the base tree.
    flags: Vec<u32>,
    rooms: Vec<RoomRecord>,
    portals: Vec<PortalRecord>,
    pieces: Vec<PortalPieceRecord>,
    outside: Option<u32>,
    /// Tile of each leaf, cut ones included; empty until tiles are cut.
    tile: Vec<u32>,
    tile_rooms: Vec<u32>,
    oversized: Vec<u32>,
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
    tree: Tree,
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
    let (portals, pieces) = portals(&tree, found, &room, &divided.solid);
    for (i, r) in rooms.iter_mut().enumerate() {
        let first = portals.partition_point(|p: &PortalRecord| (p.room as usize) < i);
        let end = portals.partition_point(|p: &PortalRecord| p.room as usize <= i);
        r.first_portal = first as u32;
        r.portal_count = (end - first) as u32;
    }
    Partition {
        tree,
        delta,
        room,
        flags,
        rooms,
        portals,
        pieces,
        outside,
        tile: Vec::new(),
        tile_rooms: Vec::new(),
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
    for &(_, leaf) in by_size.iter().take(if outside { 1 } else { 5 }) {
        let cell = &tree.leaves[leaf as usize].cell;
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
            let score = clear.max(1e-9) * if fits { 1.0 } else { 0.3 };
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

fn single(p: DVec3) -> [f32; 3] {
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
    for (link, mut corners) in pieces(tree, found, &wanted) {
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

/// A tile that is being cut: its leaves, each with its triangles.
struct Piece {
    room: u32,
    leaves: Vec<(u32, Vec<u32>)>,
    /// Different triangles.
    count: u64,
}

impl Piece {
    fn new(room: u32, leaves: Vec<(u32, Vec<u32>)>) -> Self {
        let count = distinct(&leaves).len() as u64;
        Self { room, leaves, count }
    }
}

fn distinct(leaves: &[(u32, Vec<u32>)]) -> Vec<u32> {
    let mut all: Vec<u32> = leaves.iter().flat_map(|l| l.1.iter().copied()).collect();
    all.sort_unstable();
    all.dedup();
    all
}

impl Partition {
    /// Rooms, the outside not counted.
    pub fn room_count_without_outside(&self) -> usize {
        self.rooms.len() - usize::from(self.outside.is_some())
    }

    /// The rooms, without what [`Partition::finish`] fills in.
    pub fn rooms(&self) -> &[RoomRecord] {
        &self.rooms
    }

    /// The portals, sorted by (room, other).
    pub fn portals(&self) -> &[PortalRecord] {
        &self.portals
    }

    /// Convex pieces of the portals.
    pub fn pieces(&self) -> &[PortalPieceRecord] {
        &self.pieces
    }

    /// The outside's room id, when there is an outside.
    pub fn outside(&self) -> Option<u32> {
        self.outside
    }

    /// Rooms with a tile that stores more triangles than [`TileLimit::Triangles`] allowed, because
    /// cutting further would not have helped.
    pub fn oversized(&self) -> &[u32] {
        &self.oversized
    }

    /// Cuts rooms into tiles by planes in free space. `triangles` must be those of the partition.
    /// Rooms do not change. Replaces nothing: call it once.
    ///
    /// # Errors
    /// [`RoomsError::Request`] for a limit of 0 or if tiles have been cut before;
    /// [`RoomsError::Tiles`] if random cuts do not reach their number.
    pub fn cut_tiles(
        &mut self,
        triangles: &[[[f32; 3]; 3]],
        limit: TileLimit,
    ) -> Result<(), RoomsError> {
        if !self.tile.is_empty() {
            return Err(RoomsError::Request("tiles have been cut already"));
        }
        if matches!(limit, TileLimit::Triangles(0) | TileLimit::Random { tiles: 0, .. }) {
            return Err(RoomsError::Request("a tile limit of 0 cannot be met"));
        }
        let lists = lists(&self.tree, self.delta, triangles, self.tree.leaves.len(), |leaf| leaf);
        let mut leaves_of: Vec<Vec<u32>> = vec![Vec::new(); self.rooms.len()];
        for leaf in 0..self.tree.leaves.len() as u32 {
            leaves_of[self.room[leaf as usize] as usize].push(leaf);
        }
        let whole = |room: usize| {
            let leaves =
                leaves_of[room].iter().map(|&l| (l, lists.of(l).to_vec())).collect::<Vec<_>>();
            Piece::new(room as u32, leaves)
        };
        let mut done: Vec<Piece> = Vec::new();
        match limit {
            TileLimit::Triangles(most) => {
                for room in 0..self.rooms.len() {
                    let mut stack = vec![whole(room)];
                    while let Some(piece) = stack.pop() {
                        if piece.count <= most {
                            done.push(piece);
                            continue;
                        }
                        match self.median(&piece, triangles) {
                            Some(plane) => {
                                let [a, b] = self.cut(piece, &plane, triangles);
                                stack.push(b);
                                stack.push(a);
                            }
                            None => {
                                if self.oversized.last() != Some(&piece.room) {
                                    self.oversized.push(piece.room);
                                }
                                done.push(piece);
                            }
                        }
                    }
                }
            }
            TileLimit::Random { tiles, seed } => {
                done.extend((0..self.rooms.len()).map(whole));
                self.cut_at_random(&mut done, tiles, seed, triangles)?;
            }
        }
        // A room's tiles are consecutive.
        done.sort_by_key(|p| p.room);
        self.tile = vec![0; self.tree.leaves.len()];
        for (tile, piece) in done.iter().enumerate() {
            for &(leaf, _) in &piece.leaves {
                self.tile[leaf as usize] = tile as u32;
            }
        }
        self.tile_rooms = done.iter().map(|p| p.room).collect();
        Ok(())
    }

    fn cut_at_random(
        &mut self,
        done: &mut Vec<Piece>,
        tiles: u32,
        seed: u64,
        triangles: &[[[f32; 3]; 3]],
    ) -> Result<(), RoomsError> {
        let mut state = seed;
        let mut random = move || {
            // Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators".
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z ^ (z >> 31)) >> 11
        };
        let mut failures = 0;
        while done.len() < tiles as usize {
            let at = (random() % done.len() as u64) as usize;
            let all = distinct(&done[at].leaves);
            let mut unit = || random() as f64 * (2.0 / 9_007_199_254_740_992.0) - 1.0;
            let mut normal = DVec3::new(unit(), unit(), unit());
            while !(0.01..=1.0).contains(&normal.length_squared()) {
                normal = DVec3::new(unit(), unit(), unit());
            }
            let normal = normal / normal.length();
            let through = if all.is_empty() {
                let leaf = done[at].leaves.first().map_or(0, |l| l.0);
                self.tree.leaves[leaf as usize].cell.centre()
            } else {
                let t = &triangles[all[(random() % all.len() as u64) as usize] as usize];
                (point(t[0]) + point(t[1]) + point(t[2])) / 3.0
            };
            let plane = Plane { normal, offset: normal.dot(through) };
            let piece = done.swap_remove(at);
            let [a, b] = self.cut(piece, &plane, triangles);
            if a.leaves.is_empty() || b.leaves.is_empty() {
                failures += 1;
                done.push(if a.leaves.is_empty() { b } else { a });
            } else {
                done.push(a);
                done.push(b);
            }
            if failures > 1000 + 10 * tiles as usize {
                let room = done.last().map_or(0, |p| p.room);
                let have = done.len() as u32;
                return Err(RoomsError::Tiles { room, have, wanted: tiles });
            }
        }
        Ok(())
    }

    /// The axis-aligned plane that leaves least on its fuller side; `None` when none helps.
    fn median(&self, piece: &Piece, triangles: &[[[f32; 3]; 3]]) -> Option<Plane> {
        let all = distinct(&piece.leaves);
        let margin = 4.01 * self.delta;
        let mut cells = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &(leaf, _) in &piece.leaves {
            let (a, b) = self.tree.leaves[leaf as usize].cell.bounds();
            cells = (cells.0.min(a), cells.1.max(b));
        }
        let mut best: Option<(usize, usize, Plane)> = None;
        for (axis, normal) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
            let (low, high) = (cells.0[axis], cells.1[axis]);
            let mut middles: Vec<f64> = Vec::with_capacity(all.len());
            let mut lows: Vec<f64> = Vec::with_capacity(all.len());
            let mut highs: Vec<f64> = Vec::with_capacity(all.len());
            for &i in &all {
                let t = triangles[i as usize].map(|p| f64::from(p[axis]));
                let (a, b) =
                    (t[0].min(t[1]).min(t[2]).max(low), t[0].max(t[1]).max(t[2]).min(high));
                middles.push((a + b) * 0.5);
                lows.push(a);
                highs.push(b);
            }
            for list in [&mut middles, &mut lows, &mut highs] {
                list.sort_by(f64::total_cmp);
            }
            for k in 1..16 {
                let offset = middles[(middles.len() * k / 16).min(middles.len() - 1)];
                if offset <= low + 16.0 * self.delta || offset >= high - 16.0 * self.delta {
                    continue;
                }
                let back = lows.partition_point(|&x| x <= offset + margin);
                let front = highs.len() - highs.partition_point(|&x| x < offset - margin);
                let (most, sum) = (front.max(back), front + back);
                if best.as_ref().is_none_or(|b| (most, sum) < (b.0, b.1)) {
                    best = Some((most, sum, Plane { normal, offset }));
                }
            }
        }
        let (most, sum, plane) = best?;
        // A cut must take a tenth off, and not copy nearly everything.
        (most * 10 <= all.len() * 9 && sum * 5 <= all.len() * 9).then_some(plane)
    }

    fn cut(&mut self, piece: Piece, plane: &Plane, triangles: &[[[f32; 3]; 3]]) -> [Piece; 2] {
        let (mut front, mut back) = (Vec::new(), Vec::new());
        for (leaf, list) in piece.leaves {
            let (lo, hi) = self.tree.leaves[leaf as usize].cell.range(plane);
            let least = 16.0 * self.delta;
            let new = if lo < -least && hi > least {
                self.tree.split_leaf(leaf, plane, true, None)
            } else {
                None
            };
            match new {
                Some(new) => {
                    for (leaf, side) in [(new, &mut front), (leaf, &mut back)] {
                        let cell = &self.tree.leaves[leaf as usize].cell;
                        let own = list
                            .iter()
                            .copied()
                            .filter(|&i| touches(cell, self.delta, &triangles[i as usize]))
                            .collect();
                        side.push((leaf, own));
                    }
                }
                None if hi > -lo => front.push((leaf, list)),
                None => back.push((leaf, list)),
            }
        }
        [Piece::new(piece.room, front), Piece::new(piece.room, back)]
    }

    /// Writes the tables. `triangles` must be those of the partition. Without
    /// [`Partition::cut_tiles`], each room is one tile.
    pub fn finish(mut self, triangles: &[[[f32; 3]; 3]]) -> Tables {
        let tree = &self.tree;
        if self.tile.is_empty() {
            self.tile.clone_from(&self.room);
            self.tile_rooms = (0..self.rooms.len() as u32).collect();
        }
        let count = tree.leaves.len();
        // Leaves of a tile are consecutive.
        let mut order: Vec<u32> = (0..count as u32).collect();
        order.sort_by_key(|&l| (self.tile[l as usize], l));
        let mut number = vec![0u32; count];
        for (i, &leaf) in order.iter().enumerate() {
            number[leaf as usize] = i as u32;
        }
        let base = |leaf: u32| tree.leaves[leaf as usize].base as usize;
        let bsp = tables(tree, self.delta, &number, |leaf| {
            (self.room[base(leaf)], self.tile[leaf as usize], self.flags[base(leaf)])
        });
        let Lists { offsets, triangles: tile_triangles } =
            lists(tree, self.delta, triangles, self.tile_rooms.len(), |l| self.tile[l as usize]);
        let mut rooms = self.rooms;
        for t in triangles {
            let centroid = (point(t[0]) + point(t[1]) + point(t[2])) / 3.0;
            rooms[self.room[base(tree.locate(centroid))] as usize].triangles += 1;
        }
        let mut tiles: Vec<TileRecord> = self
            .tile_rooms
            .iter()
            .enumerate()
            .map(|(i, &room)| TileRecord {
                room,
                first_light: 0,
                light_count: 0,
                reserved: 0,
                triangles: offsets[i + 1] - offsets[i],
                mesh_bytes: 0,
                min: [f32::INFINITY; 3],
                max: [f32::NEG_INFINITY; 3],
            })
            .collect();
        for (leaf, at) in tree.leaves.iter().enumerate() {
            let (lo, hi) = at.cell.bounds();
            let tile = &mut tiles[self.tile[leaf] as usize];
            for k in 0..3 {
                tile.min[k] = tile.min[k].min(single(lo)[k]);
                tile.max[k] = tile.max[k].max(single(hi)[k]);
            }
        }
        for (i, room) in rooms.iter_mut().enumerate() {
            let first = self.tile_rooms.partition_point(|&r| (r as usize) < i);
            let end = self.tile_rooms.partition_point(|&r| r as usize <= i);
            room.first_tile = first as u32;
            room.tile_count = (end - first) as u32;
        }
        Tables {
            planes: bsp.planes,
            nodes: bsp.nodes,
            leaves: bsp.leaves,
            faces: bsp.faces,
            rooms,
            portals: self.portals,
            pieces: self.pieces,
            tiles,
            tile_offsets: offsets,
            tile_triangles,
            outside: self.outside,
        }
    }
}

const _: () = assert!(THIN < SOLID_WIDTH);

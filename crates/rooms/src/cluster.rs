//! Walls: triangles that lie in one plane, whatever their winding.

use crate::convex::Plane;
use glam::DVec3;
use std::collections::HashMap;

/// Cells per unit of the grid in which normals are alike: about 0.1 degrees.
const NORMALS: f64 = 512.0;
/// Planes of less area than this cut nothing, m².
const LEAST_AREA: f64 = 0.02;

/// Coplanar triangles.
pub(crate) struct Cluster {
    pub(crate) plane: Plane,
    /// Sum of its triangles' areas, m².
    pub(crate) area: f64,
}

/// Groups the triangles in planes. Returns the clusters and, for each triangle, its cluster or
/// `u32::MAX`. Hash maps are only looked up, never iterated: the result depends on the input alone.
pub(crate) fn cluster(
    triangles: &[[[f32; 3]; 3]],
    tolerance: f64,
    scale: f64,
) -> (Vec<Cluster>, Vec<u32>) {
    struct Growing {
        plane: Plane,
        normal_sum: DVec3,
        centre_sum: DVec3,
        area: f64,
    }
    // A first, coarse pass: most triangles are furniture and share their plane with too little to be a wall.
    let promising = promising(triangles, LEAST_AREA * scale * scale * PROMISING_SHARE);
    let mut order: Vec<(f32, u32)> = Vec::new();
    for (i, t) in triangles.iter().enumerate() {
        let area = area_vector(t).length() as f32;
        if area > 1e-7 && promising.binary_search(&coarse_plane(t)).is_ok() {
            order.push((area, i as u32));
        }
    }
    drop(promising);
    order.sort_unstable_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    drop_doubles(triangles, &mut order);

    let mut normals: Vec<DVec3> = Vec::new();
    let mut normal_keys: HashMap<[i32; 3], (u32, bool)> = HashMap::new();
    let mut offsets: HashMap<(u32, i64), Vec<u32>> = HashMap::new();
    let mut clusters: Vec<Growing> = Vec::new();
    let mut of = vec![u32::MAX; triangles.len()];
    let step = tolerance * 2.0;
    for &(_, i) in &order {
        let t = &triangles[i as usize];
        let vector = area_vector(t);
        let area = vector.length();
        let normal = vector / area;
        let key = (normal * NORMALS).round().to_array().map(|x| x as i32);
        let (group, flip) = match normal_keys.get(&key) {
            Some(&known) => known,
            None => {
                let found = near(&normal_keys, &normals, key, normal);
                let (group, flip) = found.unwrap_or_else(|| {
                    normals.push(normal);
                    (normals.len() as u32 - 1, false)
                });
                normal_keys.insert(key, (group, flip));
                if found.is_none() {
                    normal_keys.insert(key.map(|x| -x), (group, !flip));
                }
                (group, flip)
            }
        };
        let corners = t.map(point);
        let centre = centre(t);
        let at = (normals[group as usize].dot(centre) / step).round() as i64;
        let mut best: Option<(f64, u32)> = None;
        for cell in [at, at - 1, at + 1] {
            for &c in offsets.get(&(group, cell)).map_or(&[][..], Vec::as_slice) {
                let plane = &clusters[c as usize].plane;
                let off = corners.iter().fold(0.0, |m: f64, &p| m.max(plane.distance(p).abs()));
                if off <= tolerance && best.is_none_or(|b| (off, c) < b) {
                    best = Some((off, c));
                }
            }
        }
        let c = best.map_or_else(
            || {
                let normal = if flip { -normal } else { normal };
                let plane = Plane { normal, offset: normal.dot(centre) };
                clusters.push(Growing {
                    plane,
                    normal_sum: DVec3::ZERO,
                    centre_sum: DVec3::ZERO,
                    area: 0.0,
                });
                let c = clusters.len() as u32 - 1;
                offsets.entry((group, at)).or_default().push(c);
                c
            },
            |b| b.1,
        );
        let grown = &mut clusters[c as usize];
        let sign = if grown.plane.normal.dot(normal) < 0.0 { -1.0 } else { 1.0 };
        grown.normal_sum += normal * (sign * area);
        grown.centre_sum += centre * area;
        grown.area += area;
        of[i as usize] = c;
    }
    // Keep what is large enough, fit the planes, renumber.
    let mut renumber = vec![u32::MAX; clusters.len()];
    let mut kept = Vec::new();
    for (c, grown) in clusters.iter().enumerate() {
        if grown.area < LEAST_AREA * scale * scale {
            continue;
        }
        renumber[c] = kept.len() as u32;
        kept.push(Cluster {
            area: grown.area,
            plane: fit(&grown.plane, grown.normal_sum, grown.centre_sum / grown.area),
        });
    }
    for c in &mut of {
        if *c != u32::MAX {
            *c = renumber[*c as usize];
        }
    }
    settle(&mut kept, &of, triangles, &order);
    (kept, of)
}

/// Moves each plane to the area-weighted median of its triangles' distances from it: onto the wall that has most area, not
/// between it and the skirting, the frame or the other wall that stands within the tolerance. A mean lies on none of them, and
/// whether a wall is in front of the plane or behind it decides the room that it belongs to.
fn settle(clusters: &mut [Cluster], of: &[u32], triangles: &[[[f32; 3]; 3]], order: &[(f32, u32)]) {
    // Cluster, distance of the centre from its plane, area: the distance is small, and single precision is ample.
    let mut off: Vec<(u32, f32, f32)> = order
        .iter()
        .filter(|&&(_, i)| of[i as usize] != u32::MAX)
        .map(|&(area, i)| {
            let c = of[i as usize];
            (c, clusters[c as usize].plane.distance(centre(&triangles[i as usize])) as f32, area)
        })
        .collect();
    // By area too, so that the result does not depend on the order of triangles.
    off.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.total_cmp(&b.2)));
    for own in off.chunk_by(|a, b| a.0 == b.0) {
        let half = own.iter().map(|o| f64::from(o.2)).sum::<f64>() / 2.0;
        let mut below = 0.0;
        let median = own.iter().find(|o| {
            below += f64::from(o.2);
            below >= half
        });
        if let Some(&(c, distance, _)) = median {
            clusters[c as usize].plane.offset += f64::from(distance);
        }
    }
}

/// Leaves out triangles that lie exactly on an earlier one, whatever their winding: walls that are there twice
/// are no better walls. Equal triangles have equal areas, up to rounding, and are not far from each other.
fn drop_doubles(triangles: &[[[f32; 3]; 3]], order: &mut Vec<(f32, u32)>) {
    let key = |i: u32| {
        let mut corners = triangles[i as usize].map(|p| p.map(|x| (x + 0.0).to_bits()));
        corners.sort_unstable();
        corners
    };
    let mut keys: Vec<(u64, u32)> = order
        .iter()
        .map(|&(_, i)| {
            let words = key(i).into_iter().flatten();
            // Fowler, Noll and Vo's hash: it only brings candidates together.
            let hash = words.fold(0xcbf2_9ce4_8422_2325_u64, |h, w| {
                (h ^ u64::from(w)).wrapping_mul(0x0000_0100_0000_01b3)
            });
            (hash, i)
        })
        .collect();
    keys.sort_unstable();
    let mut doubles: Vec<u32> = Vec::new();
    for run in keys.chunk_by(|a, b| a.0 == b.0).filter(|r| r.len() > 1) {
        for (k, &(_, i)) in run.iter().enumerate() {
            if run[..k].iter().any(|&(_, j)| key(i) == key(j)) {
                doubles.push(i);
            }
        }
    }
    doubles.sort_unstable();
    order.retain(|o| doubles.binary_search(&o.1).is_err());
}

/// A plane whose triangles fall into several coarse cells (at most 2 x 2 x 2 x 2) still has a cell with this share.
const PROMISING_SHARE: f64 = 1.0 / 16.0;
/// Cells per unit of a normal's component, and per metre of offset.
const COARSE_NORMALS: f64 = 64.0;
const COARSE_OFFSETS: f64 = 50.0;

/// The cell of a triangle's plane in a coarse grid over planes; opposite normals share one.
fn coarse_plane(t: &[[f32; 3]; 3]) -> u64 {
    let vector = area_vector(t);
    let normal = vector / vector.length();
    let size = normal.abs();
    let largest = if size.x >= size.y && size.x >= size.z {
        normal.x
    } else if size.y >= size.z {
        normal.y
    } else {
        normal.z
    };
    let normal = if largest < 0.0 { -normal } else { normal };
    let cell = |x: f64, bits: u32| ((x.round() as i64) as u64) & ((1 << bits) - 1);
    let offset = normal.dot(point(t[0]));
    cell(normal.x * COARSE_NORMALS, 8)
        | cell(normal.y * COARSE_NORMALS, 8) << 8
        | cell(normal.z * COARSE_NORMALS, 8) << 16
        | cell(offset * COARSE_OFFSETS, 40) << 24
}

/// The coarse cells that hold at least this area, m², ascending.
fn promising(triangles: &[[[f32; 3]; 3]], least: f64) -> Vec<u64> {
    let mut cells: Vec<(u64, f32)> = triangles
        .iter()
        .map(|t| (coarse_plane(t), area_vector(t).length() as f32))
        .filter(|c| c.1 > 1e-7)
        .collect();
    // By area too: a sum of floats depends on its order.
    cells.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    cells
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|run| run.iter().map(|c| f64::from(c.1)).sum::<f64>() >= least)
        .map(|run| run[0].0)
        .collect()
}

/// The mean plane of a cluster, before [`settle`]; its normal is exactly an axis if it is one to rounding.
fn fit(first: &Plane, normal_sum: DVec3, centre: DVec3) -> Plane {
    let normal = normal_sum / normal_sum.length();
    let snapped =
        DVec3::from_array(normal.to_array().map(|x| if x.abs() < 1e-6 { 0.0 } else { x }));
    let normal = snapped / snapped.length();
    if !normal.is_finite() {
        return *first;
    }
    Plane { normal, offset: normal.dot(centre) }
}

fn near(
    keys: &HashMap<[i32; 3], (u32, bool)>,
    normals: &[DVec3],
    key: [i32; 3],
    normal: DVec3,
) -> Option<(u32, bool)> {
    let mut best: Option<(f64, u32, bool)> = None;
    for k in 0..27 {
        let d = [k % 3 - 1, k / 3 % 3 - 1, k / 9 - 1];
        let at = [key[0] + d[0], key[1] + d[1], key[2] + d[2]];
        if let Some(&(group, _)) = keys.get(&at) {
            let cos = normals[group as usize].dot(normal);
            let off = 1.0 - cos.abs();
            if best.is_none_or(|b| (off, group) < (b.0, b.1)) {
                best = Some((off, group, cos < 0.0));
            }
        }
    }
    // 1 - cos(0.17 degrees)
    best.filter(|b| b.0 < 4.4e-6).map(|b| (b.1, b.2))
}

/// The horizontal unit vector, within 45 degrees of the x axis, along or across which most wall stands. Exactly
/// the x axis if that is it to a thousandth of a degree.
pub(crate) fn north(clusters: &[Cluster]) -> DVec3 {
    // Angles modulo 90 degrees, as directions of four times the angle, in bins of half a degree.
    const BINS: usize = 180;
    let mut bins = vec![(0.0, DVec3::ZERO); BINS];
    for c in clusters {
        let n = c.plane.normal;
        let level = n.truncate().length();
        if level < 0.99 {
            continue;
        }
        let (x, y) = (n.x / level, n.y / level);
        let (x2, y2) = (x * x - y * y, 2.0 * x * y);
        let (x4, y4) = (x2 * x2 - y2 * y2, 2.0 * x2 * y2);
        let turn = libm::atan2(y4, x4) / (2.0 * std::f64::consts::PI) + 1.0;
        let bin = &mut bins[(turn * BINS as f64) as usize % BINS];
        bin.0 += c.area;
        bin.1 += DVec3::new(x4, y4, 0.0) * c.area;
    }
    // Two bins, so that an angle between them is found.
    let mut best = (0.0, DVec3::X);
    for i in 0..BINS {
        let (a, b) = (&bins[i], &bins[(i + 1) % BINS]);
        if a.0 + b.0 > best.0 * (1.0 + 1e-9) {
            best = (a.0 + b.0, a.1 + b.1);
        }
    }
    let angle = libm::atan2(best.1.y, best.1.x) / 4.0;
    if angle.abs() < 2e-5 {
        return DVec3::X;
    }
    DVec3::new(libm::cos(angle), libm::sin(angle), 0.0)
}

pub(crate) fn point(p: [f32; 3]) -> DVec3 {
    DVec3::new(f64::from(p[0]), f64::from(p[1]), f64::from(p[2]))
}

fn centre(t: &[[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = t.map(point);
    (a + b + c) / 3.0
}

pub(crate) fn area_vector(t: &[[f32; 3]; 3]) -> DVec3 {
    let [a, b, c] = t.map(point);
    (b - a).cross(c - a) * 0.5
}

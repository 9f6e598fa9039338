//! Hints of rooms: boxes, footprints and solids, checked and put into store coordinates.

use crate::{
    Frame, InputFile, LoadOptions, RoomHint, SceneError, Up,
    file::{Parsed, SceneFile},
    obj,
    shape::Lookup,
};
use glam::DVec3;
use std::{
    collections::{BTreeMap, BTreeSet},
    path::Path,
};

/// Most corners of a footprint.
const MOST_CORNERS: usize = 4096;
/// Corners of a solid that are this close are one, m.
const WELD: f64 = 1e-4;
/// A solid's floor is what lies within this of its lowest point, m.
const FLOOR: f64 = 0.01;

/// The `[[room]]` tables of a scene file, and the files that they name.
pub(crate) fn build(
    parsed: &Parsed<SceneFile>,
    folder: &Path,
    frame: &Frame,
    warnings: &mut Vec<String>,
) -> Result<(Vec<RoomHint>, Vec<InputFile>), SceneError> {
    let mut out = Vec::with_capacity(parsed.value.room.len());
    let mut inputs = Vec::new();
    for (i, at) in parsed.value.room.iter().enumerate() {
        let table = at.get_ref();
        let name = table.name.clone().unwrap_or_else(|| format!("room-{}", i + 1));
        let fail = |what: &str, remedy: &str| {
            Err(parsed.error(at, format!("room \"{name}\" {what}"), remedy))
        };
        if let Some(file) = &table.file {
            let alone = table.min.is_none()
                && table.max.is_none()
                && table.polygon.is_none()
                && table.z.is_none()
                && table.name.is_none();
            let kind = file.to_ascii_lowercase();
            if !(alone && (kind.ends_with(".obj") || kind.ends_with(".obj.zst"))) {
                return fail(
                    "has a file that is no OBJ, or other keys beside it",
                    "give the file alone: each of its objects is a room",
                );
            }
            let path = folder.join(file);
            let (hints, input) = of_file(&path, frame, warnings)?;
            if hints.is_empty() {
                return fail("names a file without rooms", "its objects must be solids");
            }
            out.extend(hints);
            inputs.push(input);
            continue;
        }
        match (table.min, table.max, &table.polygon, table.z) {
            (Some(min), Some(max), None, None) => {
                let below = (0..3).all(|c| min[c] < max[c]);
                match of_box(&name, min, max, frame) {
                    Some(hint) if below => out.push(hint),
                    _ => return fail("is empty", "min must be below max in x, y and z"),
                }
            }
            (None, None, Some(polygon), Some([low, high])) => {
                match of_polygon(&name, polygon, low, high, frame) {
                    Ok(hint) => out.push(hint),
                    Err(e) => {
                        return fail(e, "give the corners in order, and z = [floor, ceiling]");
                    }
                }
            }
            _ => {
                return fail(
                    "is neither a box nor a footprint",
                    "give min and max, or polygon and z, or file",
                );
            }
        }
    }
    Ok((out, inputs))
}

/// The objects of an OBJ file, each a room.
fn of_file(
    path: &Path,
    frame: &Frame,
    warnings: &mut Vec<String>,
) -> Result<(Vec<RoomHint>, InputFile), SceneError> {
    let (mesh, input) = obj::read(path, &LoadOptions::default())?;
    let mut solids: BTreeMap<u32, Vec<[DVec3; 3]>> = BTreeMap::new();
    let mut lookup = Lookup::<DVec3>::default();
    for part in mesh.shape.parts() {
        let (part, triangles) = part?;
        let solid = solids.entry(part.object).or_default();
        for t in triangles {
            let corners = lookup.triangle(&mesh.shape, t)?;
            let mut points = [DVec3::ZERO; 3];
            for (point, v) in points.iter_mut().zip(corners) {
                *point = lookup.vertex(&mesh.shape, v, DVec3::from_array)?;
            }
            solid.push(points);
        }
    }
    let mut out = Vec::with_capacity(solids.len());
    for (object, solid) in solids {
        let name = match mesh.objects.get(object as usize) {
            Some(Some(name)) => name.clone(),
            _ => format!("room-{}", object + 1),
        };
        match of_solid(&name, &solid, frame) {
            Some(hint) => out.push(hint),
            None => warnings
                .push(format!("{}: the room \"{name}\" has no volume: no hint", path.display())),
        }
    }
    Ok((out, input))
}

/// A solid, given by triangles in the coordinates of the input: the outline of its floor between its
/// lowest and its highest point; or its box, where it is one, or where the floor has no simple outline.
/// `None` if it has no volume.
pub(crate) fn of_solid(name: &str, solid: &[[DVec3; 3]], frame: &Frame) -> Option<RoomHint> {
    let mut triangles = Vec::with_capacity(solid.len());
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for t in solid {
        let corners = t.map(|p| frame.point(p.to_array()));
        if corners.as_flattened().iter().any(|v| !v.is_finite()) {
            continue;
        }
        for p in corners {
            for c in 0..3 {
                (min[c], max[c]) = (min[c].min(p[c]), max[c].max(p[c]));
            }
        }
        triangles.push(corners);
    }
    if (0..3).any(|c| min[c] >= max[c]) {
        return None;
    }
    let outline = floor_outline(&triangles, min[2]).unwrap_or_default();
    let side = |c: usize| f64::from(max[c]) - f64::from(min[c]);
    let square = side(0) * side(1);
    let is_box = outline.is_empty() || (area(&outline) / 2.0 - square).abs() <= 1e-3 * square;
    let polygon = if is_box { Vec::new() } else { outline };
    Some(RoomHint { name: name.into(), min, max, polygon })
}

/// The outline of the horizontal triangles at a height, counter-clockwise; `None` if that is not one
/// ring (rings inside, round columns, are filled).
fn floor_outline(triangles: &[[[f32; 3]; 3]], low: f32) -> Option<Vec<[f32; 2]>> {
    // Places: equal up to the tolerance.
    let mut places: BTreeMap<[i64; 2], u32> = BTreeMap::new();
    let mut points: Vec<[f32; 2]> = Vec::new();
    // Edges that have a triangle on their left only.
    let mut edges: BTreeSet<(u32, u32)> = BTreeSet::new();
    for t in triangles {
        let [a, b, c] = t.map(|p| DVec3::from_array(p.map(f64::from)));
        let n = (b - a).cross(c - a);
        let level = t.iter().all(|p| f64::from(p[2]) < f64::from(low) + FLOOR);
        if !level || n.z.abs() <= 0.999 * n.length() || n.length() < 1e-9 {
            continue;
        }
        let mut corners = t.map(|p| {
            let key = [p[0], p[1]].map(|v| (f64::from(v) / WELD).round() as i64);
            *places.entry(key).or_insert_with(|| {
                points.push([p[0], p[1]]);
                points.len() as u32 - 1
            })
        });
        let at = |k: usize| points[corners[k] as usize];
        let turn = cross(at(0), at(1), at(2));
        if turn < 0.0 {
            corners.swap(1, 2);
        }
        let [i, j, k] = corners;
        if i == j || j == k || k == i || turn == 0.0 {
            continue;
        }
        for (from, to) in [(i, j), (j, k), (k, i)] {
            if !edges.remove(&(to, from)) && !edges.insert((from, to)) {
                return None;
            }
        }
    }
    let mut next: BTreeMap<u32, u32> = BTreeMap::new();
    for (from, to) in edges {
        if next.insert(from, to).is_some() {
            return None;
        }
    }
    let mut outer: Option<Vec<[f32; 2]>> = None;
    while let Some((start, mut at)) = next.pop_first() {
        let mut ring = vec![points[start as usize]];
        while at != start {
            ring.push(points[at as usize]);
            at = next.remove(&at)?;
        }
        if ring.len() >= 3 && area(&ring) > 0.0 && outer.replace(ring).is_some() {
            // Two floors beside each other.
            return None;
        }
    }
    let mut ring = outer?;
    straighten(&mut ring);
    (ring.len() <= MOST_CORNERS && !crosses_itself(&ring)).then_some(ring)
}

/// Removes corners that lie on the line between their neighbours.
fn straighten(ring: &mut Vec<[f32; 2]>) {
    let mut i = 0;
    while ring.len() > 3 && i < ring.len() {
        let n = ring.len();
        let (a, b, c) = (ring[(i + n - 1) % n], ring[i], ring[(i + 1) % n]);
        let side = |k: usize| f64::from(c[k]) - f64::from(a[k]);
        let base = (side(0) * side(0) + side(1) * side(1)).sqrt();
        if cross(a, b, c).abs() <= 1e-3 * base {
            ring.remove(i);
            i = i.saturating_sub(1);
        } else {
            i += 1;
        }
    }
}

/// A box; `None` if it is empty or not finite.
pub(crate) fn of_box(name: &str, min: [f64; 3], max: [f64; 3], frame: &Frame) -> Option<RoomHint> {
    // Turning up may swap the ends of an axis.
    let (a, b) = (frame.point(min), frame.point(max));
    let good = (0..3).all(|c| a[c].is_finite() && b[c].is_finite() && a[c] != b[c]);
    good.then(|| RoomHint {
        name: name.into(),
        min: std::array::from_fn(|c| a[c].min(b[c])),
        max: std::array::from_fn(|c| a[c].max(b[c])),
        polygon: Vec::new(),
    })
}

/// A footprint between two heights. Its coordinates are the horizontal ones of the input: x and y, or,
/// where y is up, x and z.
fn of_polygon(
    name: &str,
    polygon: &[[f64; 2]],
    low: f64,
    high: f64,
    frame: &Frame,
) -> Result<RoomHint, &'static str> {
    let lift = |[u, v]: [f64; 2], h: f64| match frame.up {
        Up::Z => frame.point([u, v, h]),
        Up::Y => frame.point([u, h, v]),
    };
    let mut corners: Vec<[f32; 2]> = Vec::with_capacity(polygon.len());
    for &p in polygon {
        let [x, y, _] = lift(p, low);
        if !(x.is_finite() && y.is_finite()) {
            return Err("has a corner that is not finite");
        }
        if corners.last() != Some(&[x, y]) {
            corners.push([x, y]);
        }
    }
    while corners.len() > 1 && corners.first() == corners.last() {
        corners.pop();
    }
    if corners.len() < 3 {
        return Err("has fewer than three corners");
    }
    if corners.len() > MOST_CORNERS {
        return Err("has more than 4096 corners");
    }
    let (bottom, top) = (lift([0.0; 2], low)[2], lift([0.0; 2], high)[2]);
    if !(bottom < top && bottom.is_finite() && top.is_finite()) {
        return Err("has its ceiling not above its floor");
    }
    let area = area(&corners);
    if area == 0.0 {
        return Err("has no area");
    }
    if crosses_itself(&corners) {
        return Err("has a footprint that crosses itself");
    }
    if area < 0.0 {
        corners.reverse();
    }
    let (mut min, mut max) = ([f32::INFINITY; 2], [f32::NEG_INFINITY; 2]);
    for p in &corners {
        for c in 0..2 {
            min[c] = min[c].min(p[c]);
            max[c] = max[c].max(p[c]);
        }
    }
    Ok(RoomHint {
        name: name.into(),
        min: [min[0], min[1], bottom],
        max: [max[0], max[1], top],
        polygon: corners,
    })
}

fn cross(a: [f32; 2], b: [f32; 2], c: [f32; 2]) -> f64 {
    let d = |p: [f32; 2], q: [f32; 2], i: usize| f64::from(q[i]) - f64::from(p[i]);
    d(a, b, 0) * d(a, c, 1) - d(a, b, 1) * d(a, c, 0)
}

/// Twice the area, positive counter-clockwise.
fn area(corners: &[[f32; 2]]) -> f64 {
    let n = corners.len();
    (1..n - 1).map(|i| cross(corners[0], corners[i], corners[i + 1])).sum()
}

/// Two edges cross in their interiors.
fn crosses_itself(corners: &[[f32; 2]]) -> bool {
    let n = corners.len();
    let edge = |i: usize| (corners[i], corners[(i + 1) % n]);
    (0..n).any(|i| {
        (i + 1..n).any(|j| {
            let ((a, b), (c, d)) = (edge(i), edge(j));
            cross(a, b, c) * cross(a, b, d) < 0.0 && cross(c, d, a) * cross(c, d, b) < 0.0
        })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const L: [[f64; 2]; 6] = [[0., 0.], [4., 0.], [4., 1.], [1., 1.], [1., 3.], [0., 3.]];

    #[test]
    fn a_footprint_becomes_counter_clockwise_in_store_coordinates() {
        let frame = Frame { units: 0.5, up: Up::Z, origin: [1.0, 0.0, 0.0] };
        let mut clockwise = L.to_vec();
        clockwise.reverse();
        clockwise.push(clockwise[0]);
        for corners in [L.to_vec(), clockwise] {
            let hint = of_polygon("L", &corners, 1.0, 6.0, &frame).unwrap();
            assert_eq!((hint.min, hint.max), ([-1., 0., 0.5], [1., 1.5, 3.]));
            assert_eq!(hint.polygon.len(), 6);
            // 4 + 2 squares of a quarter.
            assert_eq!(area(&hint.polygon) / 2.0, 1.5);
        }
        // y up: (x, z) of the input, and z of the input points to where y of the store comes from.
        let frame = Frame { units: 1.0, up: Up::Y, origin: [0.0; 3] };
        let hint = of_polygon("L", &L, 0.0, 2.5, &frame).unwrap();
        assert_eq!((hint.min, hint.max), ([0., -3., 0.], [4., 0., 2.5]));
        assert_eq!(area(&hint.polygon) / 2.0, 6.0);
    }

    /// A prism over a ring of corners, as triangles: floor, ceiling (a fan from the first corner; the
    /// floors here are star-shaped from it) and walls.
    fn prism(ring: &[[f64; 2]], low: f64, high: f64) -> Vec<[DVec3; 3]> {
        let at = |i: usize, z: f64| DVec3::new(ring[i][0], ring[i][1], z);
        let n = ring.len();
        let mut out = Vec::new();
        for i in 1..n - 1 {
            out.push([at(0, low), at(i + 1, low), at(i, low)]);
            out.push([at(0, high), at(i, high), at(i + 1, high)]);
        }
        for i in 0..n {
            let j = (i + 1) % n;
            out.push([at(i, low), at(j, low), at(j, high)]);
            out.push([at(i, low), at(j, high), at(i, high)]);
        }
        out
    }

    #[test]
    fn a_solid_gives_its_floor() {
        let frame = Frame { units: 1.0, up: Up::Z, origin: [0.0; 3] };
        let corner = [[0., 0.], [4., 0.], [4., 1.], [2., 1.], [1., 1.], [1., 3.], [0., 3.]];
        let hint = of_solid("L", &prism(&corner, 0.5, 3.0), &frame).unwrap();
        assert_eq!((hint.min, hint.max), ([0., 0., 0.5], [4., 3., 3.]));
        // The corner in the middle of a side is gone.
        assert_eq!(hint.polygon.len(), 6);
        assert_eq!(area(&hint.polygon) / 2.0, 6.0);
        let square = [[1., 1.], [2., 1.], [2., 3.], [1., 3.]];
        let hint = of_solid("box", &prism(&square, 0.0, 1.0), &frame).unwrap();
        assert_eq!((hint.polygon.len(), hint.min), (0, [1., 1., 0.]));
        // Turned by 45 degrees it is no longer its box.
        let diamond = [[0., -1.], [1., 0.], [0., 1.], [-1., 0.]];
        let hint = of_solid("diamond", &prism(&diamond, 0.0, 1.0), &frame).unwrap();
        assert_eq!(area(&hint.polygon) / 2.0, 2.0);
        // Two floors apart, or none: the box.
        let mut two = prism(&square, 0.0, 1.0);
        two.extend(prism(&[[5., 1.], [6., 1.], [6., 3.], [5., 3.]], 0.0, 1.0));
        let hint = of_solid("two", &two, &frame).unwrap();
        assert_eq!((hint.polygon.len(), hint.max), (0, [6., 3., 1.]));
        assert!(of_solid("flat", &prism(&square, 1.0, 1.0), &frame).is_none());
        assert!(of_solid("nothing", &[], &frame).is_none());
        let nan = [[DVec3::NAN; 3]];
        assert!(of_solid("nan", &nan, &frame).is_none());
        // y up: the floor is where y is least.
        let up = Frame { units: 1.0, up: Up::Y, origin: [0.0; 3] };
        let lying: Vec<[DVec3; 3]> = prism(&corner, 0.0, 2.5)
            .into_iter()
            .map(|t| t.map(|p| DVec3::new(p.x, p.z, p.y)))
            .collect();
        let hint = of_solid("L", &lying, &up).unwrap();
        assert_eq!((hint.min, hint.max), ([0., -3., 0.], [4., 0., 2.5]));
        assert_eq!(area(&hint.polygon) / 2.0, 6.0);
    }

    #[test]
    fn bad_footprints_are_refused() {
        let frame = Frame { units: 1.0, up: Up::Z, origin: [0.0; 3] };
        let bow = [[0., 0.], [1., 1.], [1., 0.], [0., 1.5]];
        for (corners, low, high, word) in [
            (&L[..2], 0.0, 1.0, "three corners"),
            (&[[1., 1.]; 5][..], 0.0, 1.0, "three corners"),
            (&[[0., 0.], [1., 1.], [2., 2.]][..], 0.0, 1.0, "no area"),
            (&bow[..], 0.0, 1.0, "crosses itself"),
            (&L[..], 1.0, 1.0, "ceiling"),
            (&L[..], f64::NAN, 1.0, "not"),
            (&[[f64::NAN, 0.], [1., 0.], [0., 1.]][..], 0.0, 1.0, "finite"),
        ] {
            let e = of_polygon("x", corners, low, high, &frame).unwrap_err();
            assert!(e.contains(word), "{e}");
        }
    }
}

//! Hints of rooms: boxes and footprints, checked and put into store coordinates.

use crate::{
    Frame, RoomHint, SceneError, Up,
    file::{Parsed, SceneFile},
};

/// Most corners of a footprint.
const MOST_CORNERS: usize = 4096;

/// The `[[room]]` tables of a scene file.
pub(crate) fn build(
    parsed: &Parsed<SceneFile>,
    frame: &Frame,
) -> Result<Vec<RoomHint>, SceneError> {
    let mut out = Vec::with_capacity(parsed.value.room.len());
    for (i, at) in parsed.value.room.iter().enumerate() {
        let table = at.get_ref();
        let name = table.name.clone().unwrap_or_else(|| format!("room-{}", i + 1));
        let fail = |what: &str, remedy: &str| {
            Err(parsed.error(at, format!("room \"{name}\" {what}"), remedy))
        };
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
                    "give min and max, or polygon and z",
                );
            }
        }
    }
    Ok(out)
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

//! Rooms that the user drew: footprints with a floor and a ceiling.

use crate::Hint;
use crate::cluster::point;
use crate::convex::{Plane, box_planes};
use glam::{DVec2, DVec3};

/// Edges shorter than this do not cut, m.
const LEAST_EDGE: f64 = 0.01;

impl Hint {
    /// Whether a point (store coordinates, m) is inside; on an edge it may be either.
    pub fn contains(&self, p: [f32; 3]) -> bool {
        Footprint::new(self).is_some_and(|f| f.contains(point(p)))
    }
}

/// A hint, ready to cut and to be asked.
pub(crate) struct Footprint {
    pub(crate) min: DVec3,
    pub(crate) max: DVec3,
    /// Empty: the box.
    corners: Vec<DVec2>,
    /// Planes of its sides, and the segment of each in plan; none for floor and ceiling.
    sides: Vec<(Plane, Option<[DVec2; 2]>)>,
}

impl Footprint {
    /// `None` if the hint is no room: not finite, without height or without area.
    pub(crate) fn new(hint: &Hint) -> Option<Self> {
        let (mut min, mut max) = (point(hint.min), point(hint.max));
        let corners: Vec<DVec2> =
            hint.polygon.iter().map(|p| DVec2::new(f64::from(p[0]), f64::from(p[1]))).collect();
        if !corners.is_empty() {
            if corners.len() < 3 || !corners.iter().all(|c| c.is_finite()) {
                return None;
            }
            let (lo, hi) = crate::convex::flat::bounds(&corners);
            (min, max) = (lo.extend(min.z), hi.extend(max.z));
            if crate::convex::flat::area(&corners).abs() <= 0.0 {
                return None;
            }
        }
        if !(min.is_finite() && max.is_finite() && min.cmplt(max).all()) {
            return None;
        }
        let planes = box_planes(min, max);
        let mut sides: Vec<(Plane, Option<[DVec2; 2]>)> = Vec::new();
        if corners.is_empty() {
            sides.extend(planes.iter().map(|&p| (p, None)));
        } else {
            sides.extend(planes[4..].iter().map(|&p| (p, None)));
            for i in 0..corners.len() {
                let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                let along = b - a;
                if along.length() < LEAST_EDGE {
                    continue;
                }
                let normal = DVec3::new(along.y, -along.x, 0.0) / along.length();
                let offset = normal.dot(a.extend(0.0));
                sides.push((Plane { normal, offset }, Some([a, b])));
            }
        }
        Some(Self { min, max, corners, sides })
    }

    /// Whether a point is inside; on an edge it may be either.
    pub(crate) fn contains(&self, p: DVec3) -> bool {
        if !(p.cmpgt(self.min).all() && p.cmplt(self.max).all()) {
            return false;
        }
        let mut inside = self.corners.is_empty();
        for i in 0..self.corners.len() {
            let (a, b) = (self.corners[i], self.corners[(i + 1) % self.corners.len()]);
            if (a.y > p.y) != (b.y > p.y) && p.x < a.x + (b.x - a.x) * ((p.y - a.y) / (b.y - a.y)) {
                inside = !inside;
            }
        }
        inside
    }

    /// Planes that may cut a cell with these bounds: a side of a polygon cuts only what it passes through.
    pub(crate) fn planes(
        &self,
        lo: DVec3,
        hi: DVec3,
        tolerance: f64,
    ) -> impl Iterator<Item = &Plane> + '_ {
        let apart = self.min.cmpge(hi - tolerance).any() || self.max.cmple(lo + tolerance).any();
        let sides = if apart { &[][..] } else { &self.sides[..] };
        sides
            .iter()
            .filter(move |(_, segment)| {
                segment.is_none_or(|[a, b]| passes(a, b, lo.truncate(), hi.truncate()))
            })
            .map(|s| &s.0)
    }
}

/// Whether a segment meets a rectangle.
fn passes(a: DVec2, b: DVec2, lo: DVec2, hi: DVec2) -> bool {
    // Liang and Barsky 1984, "A new concept and method for line clipping".
    let d = b - a;
    let (mut from, mut to) = (0.0_f64, 1.0_f64);
    for k in 0..2 {
        if d[k] == 0.0 {
            if a[k] < lo[k] || a[k] > hi[k] {
                return false;
            }
            continue;
        }
        let (s, t) = ((lo[k] - a[k]) / d[k], (hi[k] - a[k]) / d[k]);
        from = from.max(s.min(t));
        to = to.min(s.max(t));
    }
    from < to
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_l_has_six_sides_and_a_notch() {
        let polygon = vec![[0.0, 0.0], [4.0, 0.0], [4.0, 2.0], [2.0, 2.0], [2.0, 4.0], [0.0, 4.0]];
        let hint = Hint { min: [0.0, 0.0, 0.0], max: [0.0, 0.0, 3.0], polygon };
        let f = Footprint::new(&hint).unwrap();
        assert!(f.contains(DVec3::new(1.0, 3.0, 1.0)) && f.contains(DVec3::new(3.0, 1.0, 1.0)));
        assert!(!f.contains(DVec3::new(3.0, 3.0, 1.0)) && !f.contains(DVec3::new(1.0, 1.0, 3.5)));
        let cut = |lo: [f64; 3], hi: [f64; 3]| {
            f.planes(DVec3::from_array(lo), DVec3::from_array(hi), 1e-3).count()
        };
        // Floor and ceiling, and the sides that pass through.
        assert_eq!(cut([-1.0, -1.0, -1.0], [5.0, 5.0, 5.0]), 8);
        assert_eq!(cut([2.5, 1.0, 0.5], [3.5, 3.0, 1.0]), 3);
        assert_eq!(cut([5.0, 0.0, 0.0], [6.0, 1.0, 1.0]), 0);
    }

    #[test]
    fn what_is_no_room_is_refused() {
        let box_of = |max: [f32; 3], polygon: Vec<[f32; 2]>| {
            Footprint::new(&Hint { min: [0.0; 3], max, polygon }).is_none()
        };
        assert!(!box_of([1.0; 3], vec![]));
        assert!(box_of([1.0, 1.0, 0.0], vec![]));
        assert!(box_of([1.0; 3], vec![[0.0, 0.0], [1.0, 0.0]]));
        assert!(box_of([1.0; 3], vec![[0.0, 0.0], [1.0, 0.0], [f32::NAN, 1.0]]));
        assert!(box_of([1.0; 3], vec![[0.0, 0.0], [1.0, 1.0], [2.0, 2.0]]));
    }
}

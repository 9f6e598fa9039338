//! Convex polygons and polytopes in `f64`, kept as corner lists.

use glam::{DVec2, DVec3};

/// Corners closer to a plane than this count as on it, m.
const ON: f64 = 1e-8;

/// The plane `normal·p = offset` with a unit normal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Plane {
    pub(crate) normal: DVec3,
    pub(crate) offset: f64,
}

impl Plane {
    pub(crate) fn distance(&self, p: DVec3) -> f64 {
        self.normal.dot(p) - self.offset
    }

    pub(crate) fn flipped(&self) -> Self {
        Self { normal: -self.normal, offset: -self.offset }
    }

    /// The same half-space behind the plane, moved out by `margin`.
    pub(crate) fn moved(&self, margin: f64) -> Self {
        Self { normal: self.normal, offset: self.offset + margin }
    }

    /// Two unit vectors in the plane, right-handed with the normal. The first one is horizontal in a wall,
    /// so that windows stand upright, and points to `north` in a floor.
    pub(crate) fn basis(&self, north: DVec3) -> (DVec3, DVec3) {
        let n = self.normal;
        let u = if n.z.abs() < 0.9 { DVec3::Z.cross(n) } else { north - n * north.dot(n) };
        let u = u / u.length();
        (u, n.cross(u))
    }
}

/// Area vector of a polygon: normal times area.
pub(crate) fn area_vector(poly: &[DVec3]) -> DVec3 {
    let mut sum = DVec3::ZERO;
    for i in 2..poly.len() {
        sum += (poly[i - 1] - poly[0]).cross(poly[i] - poly[0]);
    }
    sum * 0.5
}

pub(crate) fn area(poly: &[DVec3]) -> f64 {
    area_vector(poly).length()
}

/// Keeps the part of `poly` behind the plane (`distance <= 0`), in `out`.
pub(crate) fn clip_behind(poly: &[DVec3], plane: &Plane, out: &mut Vec<DVec3>) {
    out.clear();
    let Some(&last) = poly.last() else { return };
    let (mut a, mut sa) = (last, plane.distance(last));
    for &b in poly {
        let sb = plane.distance(b);
        if (sa < 0.0 && sb > 0.0) || (sa > 0.0 && sb < 0.0) {
            out.push(a + (b - a) * (sa / (sa - sb)));
        }
        if sb <= 0.0 {
            out.push(b);
        }
        (a, sa) = (b, sb);
    }
}

/// Splits `poly` in the part in front of the plane and the part behind it.
pub(crate) fn split(poly: &[DVec3], plane: &Plane) -> (Vec<DVec3>, Vec<DVec3>) {
    let (mut front, mut back) = (Vec::new(), Vec::new());
    let snap = |p: DVec3| {
        let s = plane.distance(p);
        if s.abs() <= ON { 0.0 } else { s }
    };
    let Some(&last) = poly.last() else { return (front, back) };
    let (mut a, mut sa) = (last, snap(last));
    for &b in poly {
        let sb = snap(b);
        if (sa < 0.0 && sb > 0.0) || (sa > 0.0 && sb < 0.0) {
            let p = a + (b - a) * (sa / (sa - sb));
            front.push(p);
            back.push(p);
        }
        if sb >= 0.0 {
            front.push(b);
        }
        if sb <= 0.0 {
            back.push(b);
        }
        (a, sa) = (b, sb);
    }
    for part in [&mut front, &mut back] {
        if part.len() < 3 || area(part) <= 1e-14 {
            part.clear();
        }
    }
    (front, back)
}

/// A face of a [`Polytope`].
#[derive(Clone, Debug)]
pub(crate) struct Face {
    /// Its plane, with the outward normal.
    pub(crate) plane: Plane,
    /// Whose face it is; the meaning is the owner's.
    pub(crate) tag: u32,
    pub(crate) corners: Vec<DVec3>,
}

/// A bounded convex cell.
#[derive(Clone, Debug)]
pub(crate) struct Polytope {
    pub(crate) faces: Vec<Face>,
}

impl Polytope {
    /// A box; its faces get the tags `tag0 ..`, in the order of [`box_planes`].
    pub(crate) fn from_box(min: DVec3, max: DVec3, tag0: u32) -> Self {
        let planes = box_planes(min, max);
        let reach = (max - min).length() + min.length() + max.length() + 1.0;
        let faces = (0..6)
            .map(|i| {
                let mut corners = big_square(&planes[i], (min + max) * 0.5, reach);
                let mut out = Vec::new();
                for (j, plane) in planes.iter().enumerate() {
                    if j != i {
                        clip_behind(&corners, plane, &mut out);
                        std::mem::swap(&mut corners, &mut out);
                    }
                }
                Face { plane: planes[i], tag: tag0 + i as u32, corners }
            })
            .collect();
        Self { faces }
    }

    /// The same in as little memory as possible, for keeping.
    pub(crate) fn shrunk(mut self) -> Self {
        for face in &mut self.faces {
            face.corners.shrink_to_fit();
        }
        self.faces.shrink_to_fit();
        self
    }

    pub(crate) fn corners(&self) -> impl Iterator<Item = DVec3> + '_ {
        self.faces.iter().flat_map(|f| f.corners.iter().copied())
    }

    pub(crate) fn bounds(&self) -> (DVec3, DVec3) {
        let mut lo = DVec3::INFINITY;
        let mut hi = DVec3::NEG_INFINITY;
        for p in self.corners() {
            lo = lo.min(p);
            hi = hi.max(p);
        }
        (lo, hi)
    }

    /// Mean of the corners: a point inside.
    pub(crate) fn centre(&self) -> DVec3 {
        let (mut sum, mut count) = (DVec3::ZERO, 0.0);
        for p in self.corners() {
            sum += p;
            count += 1.0;
        }
        if count > 0.0 { sum / count } else { sum }
    }

    pub(crate) fn volume(&self) -> f64 {
        let c = self.centre();
        self.faces
            .iter()
            .map(|f| -f.plane.distance(c) * area(&f.corners) / 3.0)
            .sum::<f64>()
            .max(0.0)
    }

    /// Smallest extent over the face normals, m.
    pub(crate) fn width(&self) -> f64 {
        self.faces
            .iter()
            .filter(|f| f.corners.len() > 2)
            .map(|f| self.corners().fold(0.0, |w: f64, p| w.max(-f.plane.distance(p))))
            .fold(f64::INFINITY, f64::min)
    }

    /// How far the corners reach behind and in front of a plane.
    pub(crate) fn range(&self, plane: &Plane) -> (f64, f64) {
        self.corners().fold((f64::INFINITY, f64::NEG_INFINITY), |(lo, hi), p| {
            let s = plane.distance(p);
            (lo.min(s), hi.max(s))
        })
    }

    /// The polygon in which a plane cuts the cell, counter-clockwise around the plane's normal.
    pub(crate) fn section(&self, plane: &Plane) -> Vec<DVec3> {
        let (lo, hi) = self.bounds();
        if lo.cmpgt(hi).any() {
            return Vec::new();
        }
        let mut poly = big_square(plane, (lo + hi) * 0.5, (hi - lo).length() + 1.0);
        let mut out = Vec::new();
        for face in &self.faces {
            clip_behind(&poly, &face.plane, &mut out);
            std::mem::swap(&mut poly, &mut out);
            if poly.len() < 3 {
                return Vec::new();
            }
        }
        poly
    }

    /// The two cells in front of and behind a plane; the new faces get the tags given. `None` for a
    /// side on which nothing is left.
    pub(crate) fn split(&self, plane: &Plane, tag_front: u32, tag_back: u32) -> [Option<Self>; 2] {
        let cap = self.section(plane);
        let mut parts = [Vec::new(), Vec::new()];
        for face in &self.faces {
            let (front, back) = split(&face.corners, plane);
            for (part, corners) in parts.iter_mut().zip([front, back]) {
                if corners.len() > 2 {
                    part.push(Face { plane: face.plane, tag: face.tag, corners });
                }
            }
        }
        let [front, back] = parts;
        let side = |mut faces: Vec<Face>, plane: Plane, tag: u32, corners: Vec<DVec3>| {
            if faces.len() < 3 || corners.len() < 3 {
                return None;
            }
            faces.push(Face { plane, tag, corners });
            Some(Self { faces })
        };
        let mut reversed = cap.clone();
        reversed.reverse();
        [side(front, plane.flipped(), tag_front, reversed), side(back, *plane, tag_back, cap)]
    }

    /// Keeps what lies behind `plane`, as a face with `tag`.
    pub(crate) fn clip(&mut self, plane: Plane, tag: u32) {
        let cap = self.section(&plane);
        let mut out = Vec::new();
        for face in &mut self.faces {
            clip_behind(&face.corners, &plane, &mut out);
            std::mem::swap(&mut face.corners, &mut out);
        }
        self.faces.retain(|f| !f.corners.is_empty());
        if !cap.is_empty() {
            self.faces.push(Face { plane, tag, corners: cap });
        }
    }
}

/// Outward planes of a box: +x, -x, +y, -y, +z, -z.
pub(crate) fn box_planes(min: DVec3, max: DVec3) -> [Plane; 6] {
    let plane = |normal, offset| Plane { normal, offset };
    [
        plane(DVec3::X, max.x),
        plane(DVec3::NEG_X, -min.x),
        plane(DVec3::Y, max.y),
        plane(DVec3::NEG_Y, -min.y),
        plane(DVec3::Z, max.z),
        plane(DVec3::NEG_Z, -min.z),
    ]
}

fn big_square(plane: &Plane, near: DVec3, reach: f64) -> Vec<DVec3> {
    let (u, v) = plane.basis(DVec3::X);
    let c = near - plane.normal * plane.distance(near);
    let (u, v) = (u * reach * 2.0, v * reach * 2.0);
    vec![c - u - v, c + u - v, c + u + v, c - u + v]
}

/// Convex polygons in a plane, counter-clockwise.
pub(crate) mod flat {
    use super::DVec2;

    pub(crate) type Poly = Vec<DVec2>;

    pub(crate) fn area(poly: &[DVec2]) -> f64 {
        let mut sum = 0.0;
        for i in 2..poly.len() {
            sum += (poly[i - 1] - poly[0]).perp_dot(poly[i] - poly[0]);
        }
        sum * 0.5
    }

    pub(crate) fn bounds(poly: &[DVec2]) -> (DVec2, DVec2) {
        poly.iter()
            .fold((DVec2::INFINITY, DVec2::NEG_INFINITY), |(lo, hi), &p| (lo.min(p), hi.max(p)))
    }

    pub(crate) fn apart(a: &(DVec2, DVec2), b: &(DVec2, DVec2)) -> bool {
        a.0.cmpgt(b.1).any() || b.0.cmpgt(a.1).any()
    }

    /// Whether a point is in a polygon or on its edge.
    pub(crate) fn contains(poly: &[DVec2], p: DVec2) -> bool {
        edges(poly).all(|(n, d)| n.dot(p) <= d)
    }

    /// The part of `poly` where `sign * (n·p - d) >= 0`.
    pub(crate) fn half(poly: &[DVec2], n: DVec2, d: f64, sign: f64) -> Poly {
        let mut out = Vec::with_capacity(poly.len() + 1);
        let Some(&last) = poly.last() else { return out };
        let (mut a, mut sa) = (last, sign * (n.dot(last) - d));
        for &b in poly {
            let sb = sign * (n.dot(b) - d);
            if (sa < 0.0 && sb > 0.0) || (sa > 0.0 && sb < 0.0) {
                out.push(a + (b - a) * (sa / (sa - sb)));
            }
            if sb >= 0.0 {
                out.push(b);
            }
            (a, sa) = (b, sb);
        }
        out
    }

    pub(crate) fn intersection(a: &[DVec2], b: &[DVec2]) -> Poly {
        let mut out = a.to_vec();
        for (n, d) in edges(b) {
            if out.len() < 3 {
                break;
            }
            out = half(&out, n, d, -1.0);
        }
        if out.len() < 3 { Vec::new() } else { out }
    }

    /// Outward normals (not of unit length) and offsets of the edges.
    fn edges(poly: &[DVec2]) -> impl Iterator<Item = (DVec2, f64)> + '_ {
        (0..poly.len()).filter_map(|i| {
            let (a, b) = (poly[i], poly[(i + 1) % poly.len()]);
            let e = b - a;
            let length = e.length();
            (length > 1e-9).then(|| {
                let n = DVec2::new(e.y, -e.x) / length;
                (n, n.dot(a))
            })
        })
    }

    /// Slivers are gaps between neighbouring triangles, not openings.
    fn sliver(poly: &[DVec2]) -> bool {
        if poly.len() < 3 {
            return true;
        }
        let around: f64 =
            (0..poly.len()).map(|i| (poly[(i + 1) % poly.len()] - poly[i]).length()).sum();
        let area = area(poly);
        area < 1e-6 || area < 1e-3 * around
    }

    /// `region` minus all `blockers`, in convex pieces. Blockers may overlap and may be many: the
    /// region is halved until few are left in each part.
    pub(crate) fn subtract(region: &[DVec2], blockers: &[&Poly], depth: u32, out: &mut Vec<Poly>) {
        let around = bounds(region);
        let mut near: Vec<&Poly> = Vec::new();
        for &b in blockers {
            if apart(&bounds(b), &around) {
                continue;
            }
            let mut meets = true;
            let mut covers = true;
            for (n, d) in edges(b) {
                let (mut lo, mut hi) = (f64::INFINITY, f64::NEG_INFINITY);
                for p in region {
                    let s = n.dot(*p) - d;
                    lo = lo.min(s);
                    hi = hi.max(s);
                }
                meets &= lo < -1e-9;
                covers &= hi < 1e-9;
            }
            if covers {
                return;
            }
            if meets {
                near.push(b);
            }
        }
        if near.is_empty() {
            if !sliver(region) {
                out.push(region.to_vec());
            }
            return;
        }
        let size = around.1 - around.0;
        if near.len() > 12 && depth < 24 && size.max_element() > 0.005 {
            let (n, d) = if size.x >= size.y {
                (DVec2::X, (around.0.x + around.1.x) * 0.5)
            } else {
                (DVec2::Y, (around.0.y + around.1.y) * 0.5)
            };
            for sign in [-1.0, 1.0] {
                let part = half(region, n, d, sign);
                if part.len() > 2 {
                    subtract(&part, &near, depth + 1, out);
                }
            }
            return;
        }
        let mut pieces = vec![region.to_vec()];
        for b in near {
            let mut left = Vec::new();
            for piece in pieces {
                let mut inside = piece;
                for (n, d) in edges(b) {
                    let outside = half(&inside, n, d, 1.0);
                    if !sliver(&outside) {
                        left.push(outside);
                    }
                    inside = half(&inside, n, d, -1.0);
                    if inside.len() < 3 {
                        break;
                    }
                }
            }
            pieces = left;
            if pieces.is_empty() {
                return;
            }
        }
        out.append(&mut pieces);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_box_has_its_volume_and_a_cut_keeps_it() {
        let cell = Polytope::from_box(DVec3::ZERO, DVec3::new(2.0, 3.0, 4.0), 0);
        assert!((cell.volume() - 24.0).abs() < 1e-9);
        assert!((cell.width() - 2.0).abs() < 1e-12);
        let normal = DVec3::new(1.0, 2.0, -0.5).normalize();
        let plane = Plane { normal, offset: normal.dot(DVec3::new(0.9, 1.4, 2.2)) };
        let [Some(a), Some(b)] = cell.split(&plane, 6, 7) else { panic!("both sides are there") };
        assert!((a.volume() + b.volume() - 24.0).abs() < 1e-9);
        assert!(
            (a.section(&plane.moved(1e-12)).len() as i64
                - b.faces.last().unwrap().corners.len() as i64)
                .abs()
                <= 1
        );
    }

    #[test]
    fn subtraction_leaves_the_area_that_is_left() {
        let rect = |x0: f64, y0: f64, x1: f64, y1: f64| {
            vec![DVec2::new(x0, y0), DVec2::new(x1, y0), DVec2::new(x1, y1), DVec2::new(x0, y1)]
        };
        let wall = rect(0.0, 0.0, 10.0, 3.0);
        let tiles: Vec<_> = (0..100)
            .flat_map(|i| (0..30).map(move |j| (i as f64 * 0.1, j as f64 * 0.1)))
            .filter(|&(x, y)| !(4.0 - 1e-9..4.9 - 1e-9).contains(&x) || y > 2.1 - 1e-9)
            .map(|(x, y)| rect(x, y, x + 0.1, y + 0.1))
            .collect();
        let mut left = Vec::new();
        subtract_all(&wall, &tiles, &mut left);
        let sum: f64 = left.iter().map(|p| flat::area(p)).sum();
        assert!((sum - 0.9 * 2.1).abs() < 1e-6, "{sum}");
    }

    fn subtract_all(region: &flat::Poly, tiles: &[flat::Poly], out: &mut Vec<flat::Poly>) {
        flat::subtract(region, &tiles.iter().collect::<Vec<_>>(), 0, out);
    }
}

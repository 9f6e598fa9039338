//! One ray, one triangle, one answer.
//!
//! The edge test is the watertight one of Woop, Benthin and Wald (2013, Watertight Ray/Triangle
//! Intersection): shear space so that the ray becomes an axis, then look at the signs of three 2-D
//! edge functions. Two triangles that share an edge compute the same function with opposite signs, so
//! no ray slips between them.
//!
//! Whether a ray *hits* is decided by those `f32` signs and by nothing else. *Where* it hits is
//! another matter: seen almost edge-on, a triangle's `f32` barycentrics can be metres off. So every
//! hit has to prove itself, **the margin rule**: the point `o + t d` must lie within `delta` of the
//! point of the triangle that the barycentrics name. A hit that fails is computed again in `f64`, and
//! where even that is ill-conditioned (the triangle is a line to the ray), it becomes the point of its
//! outline that comes nearest to the ray. A hit that moves is still a hit: the signs let the neighbour
//! triangle say "not mine", so dropping it would open the very crack that the signs had closed.

use glam::{Vec3, Vec4};

/// A ray in store coordinates. It keeps its origin and direction for its whole flight; `t` grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ray {
    /// Start, m.
    pub origin: Vec3,
    /// Unit direction.
    pub direction: Vec3,
}

impl Ray {
    /// The point at distance `t` m.
    pub fn at(&self, t: f32) -> Vec3 {
        self.origin + t * self.direction
    }
}

/// Where a ray meets a tile's mesh.
#[derive(Clone, Copy, Debug)]
pub struct Hit {
    /// Distance along the ray, m.
    pub t: f32,
    /// Index of the triangle in the scene.
    pub global: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2; corner 0 has `1 - u - v`.
    pub v: f32,
    /// Where the structure that was asked keeps the triangle: for [`crate::Structure::corners`] and
    /// [`crate::Structure::material`], and not part of what makes hits equal.
    pub slot: u32,
}

impl PartialEq for Hit {
    fn eq(&self, other: &Self) -> bool {
        (self.t, self.global, self.u, self.v) == (other.t, other.global, other.u, other.v)
    }
}

/// A ray with what every triangle test needs of it: the shear of Woop et al.
#[derive(Clone, Copy, Debug)]
pub struct PreparedRay {
    /// Axis along which the direction is longest; the first of them on ties.
    pub(crate) axis: usize,
    pub(crate) origin: [f32; 3],
    pub(crate) direction: [f32; 3],
    /// `d[axis + 1] / d[axis]` and `d[axis + 2] / d[axis]`, axes modulo 3.
    pub(crate) shear: [f32; 2],
    /// `1 / d[axis]`.
    pub(crate) inverse: f32,
    /// Origin and direction are finite and the direction is not zero.
    pub(crate) valid: bool,
}

impl PreparedRay {
    /// The axes, turned so that the longest comes last.
    #[inline(always)]
    fn axes(&self) -> (usize, usize, usize) {
        let z = self.axis.min(2);
        (NEXT[z].min(2), NEXT[NEXT[z].min(2)].min(2), z)
    }

    /// Prepares a ray. A ray that is not finite, or has no direction, hits nothing.
    #[inline]
    pub fn new(ray: &Ray) -> Self {
        let d = ray.direction.to_array();
        let m = ray.direction.abs();
        let axis = if m.x >= m.y && m.x >= m.z {
            0
        } else if m.y >= m.z {
            1
        } else {
            2
        };
        Self {
            axis,
            origin: ray.origin.to_array(),
            direction: d,
            shear: [d[(axis + 1) % 3] / d[axis], d[(axis + 2) % 3] / d[axis]],
            inverse: 1.0 / d[axis],
            valid: ray.origin.is_finite() && ray.direction.is_finite() && d[axis] != 0.0,
        }
    }
}

/// The axis after each.
const NEXT: [usize; 3] = [1, 2, 0];

/// The canonical intersection of a ray with a triangle, both sides: `(t, u, v)` with `t` in m
/// (negative behind the origin: intervals are the caller's business), `u` and `v` the barycentric
/// weights of `b` and `c`.
///
/// The answer depends on nothing but the arguments, and `o + t d` is within `delta` m of the point
/// `a + u (b - a) + v (c - a)`. `None` for a miss, for a triangle without area, and for anything that is not
/// finite. Origins may lie a few scene diagonals outside the scene; much farther out, `f32` cannot
/// express a `t` that keeps the margin and the answer may be `None`.
#[inline]
pub fn intersect(
    ray: &PreparedRay,
    a: Vec3,
    b: Vec3,
    c: Vec3,
    delta: f32,
) -> Option<(f32, f32, f32)> {
    intersect_arrays(ray, [&a.to_array(), &b.to_array(), &c.to_array()], delta)
}

/// [`intersect`] with corners as a mesh has them.
#[inline(always)]
pub(crate) fn intersect_arrays(
    ray: &PreparedRay,
    corners: [&[f32; 3]; 3],
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let [a, b, c] = corners;
    let four = four(ray, &[splat(a), splat(b), splat(c)]);
    if (four.hit | four.unsure) & 1 == 0 {
        return None;
    }
    let reach = reach(delta);
    let within = |p: &[f32; 3]| p[0].abs() <= reach && p[1].abs() <= reach && p[2].abs() <= reach;
    let tame = within(&ray.origin) && within(a) && within(b) && within(c);
    if four.kept(if tame { margin(delta) } else { -1.0 }) & 1 == 0 {
        return settle(ray, corners, delta);
    }
    let origin = ray.origin.map(f64::from);
    let relative = corners.map(|c| relative(c, origin));
    (!has_no_area(&relative)).then_some((four.t.x, four.u.x, four.v.x))
}

#[inline(always)]
fn splat(p: &[f32; 3]) -> [[f32; 4]; 3] {
    [[p[0]; 4], [p[1]; 4], [p[2]; 4]]
}

/// A ray and four triangles, in `f32` and in lanes: only lane-wise arithmetic, which is the same on every machine.
pub(crate) struct Four {
    /// Where the ray meets each triangle.
    pub(crate) t: Vec4,
    pub(crate) u: Vec4,
    pub(crate) v: Vec4,
    /// How far `o + t d` is from the point of the triangle along each axis, m. May be NaN.
    off: [Vec4; 3],
    /// No part of the triangle is nearer than this.
    pub(crate) nearest: Vec4,
    /// Triangles whose edge functions have one strict sign, a bit each.
    pub(crate) hit: u32,
    /// Triangles with an edge function that is zero, while the others have one sign.
    pub(crate) unsure: u32,
}

impl Four {
    /// Which of the hits keep the margin.
    #[inline(always)]
    pub(crate) fn kept(&self, margin: f32) -> u32 {
        // Not the other way round: NaN must fail.
        let margin = Vec4::splat(margin);
        let [x, y, z] = self.off;
        self.hit & (x.cmple(margin) & y.cmple(margin) & z.cmple(margin)).bitmask()
    }
}

/// Coordinates that are not larger than this are the scene's, for its tolerance; see [`margin`].
pub(crate) fn reach(delta: f32) -> f32 {
    delta * (1 << 19) as f32
}

/// A hit that `f32` arithmetic finds no farther off than this along any axis does keep the margin of `delta`.
///
/// With `e = 2^-24`, and `S = 2^19 delta = delta / (32 e)` not less than any coordinate of ray and triangle: corners
/// relative to the origin are at most `2 S`, and rounded by `2 e S`; so are products with weights that add up to one, two
/// sums, the third weight and `t d`: 12 e S at most. Off by 6 e S in `f32` is off by less than 18 e S in
/// truth, along three axes less than 31.2 e S, and `delta` is 32 e S.
pub(crate) fn margin(delta: f32) -> f32 {
    delta * (3.0 / 16.0)
}

/// The edge functions of Woop et al. of four triangles (corner, axis, lane), and where the ray meets those that it hits.
/// Axes are turned so that the ray's longest comes last, without the swap of Woop et al.: it flips the three signs
/// together, and both sides count.
#[inline(always)]
pub(crate) fn four(ray: &PreparedRay, corners: &[[[f32; 4]; 3]; 3]) -> Four {
    let (x, y, z) = ray.axes();
    let origin = [ray.origin[x], ray.origin[y], ray.origin[z]];
    let a = seen(&corners[0], (x, y, z), origin);
    let b = seen(&corners[1], (x, y, z), origin);
    let c = seen(&corners[2], (x, y, z), origin);
    let shear = [Vec4::splat(ray.shear[0]), Vec4::splat(ray.shear[1])];
    let (ax, ay) = (a[0] - shear[0] * a[2], a[1] - shear[1] * a[2]);
    let (bx, by) = (b[0] - shear[0] * b[2], b[1] - shear[1] * b[2]);
    let (cx, cy) = (c[0] - shear[0] * c[2], c[1] - shear[1] * c[2]);
    let ea = cx * by - cy * bx;
    let eb = ax * cy - ay * cx;
    let ec = bx * ay - by * ax;
    let zero = Vec4::ZERO;
    let low = ea.cmplt(zero) | eb.cmplt(zero) | ec.cmplt(zero);
    let high = ea.cmpgt(zero) | eb.cmpgt(zero) | ec.cmpgt(zero);
    let none = ea.cmpeq(zero) | eb.cmpeq(zero) | ec.cmpeq(zero);
    let number = ea.cmpeq(ea) & eb.cmpeq(eb) & ec.cmpeq(ec);

    let scale = Vec4::ONE / (ea + eb + ec);
    let (wa, u, v) = (ea * scale, eb * scale, ec * scale);
    let inverse = Vec4::splat(ray.inverse);
    let t = (wa * a[2] + u * b[2] + v * c[2]) * inverse;
    let w = Vec4::ONE - u - v;
    let off_x = (t * Vec4::splat(ray.direction[x]) - (w * a[0] + u * b[0] + v * c[0])).abs();
    let off_y = (t * Vec4::splat(ray.direction[y]) - (w * a[1] + u * b[1] + v * c[1])).abs();
    let off_z = (t * Vec4::splat(ray.direction[z]) - (w * a[2] + u * b[2] + v * c[2])).abs();
    let same = !(low & high) & number;
    Four {
        t,
        u,
        v,
        off: [off_x, off_y, off_z],
        nearest: (a[2] * inverse).min(b[2] * inverse).min(c[2] * inverse),
        hit: (same & !none).bitmask(),
        unsure: (same & none).bitmask(),
    }
}

/// A corner of four triangles relative to the ray's origin, axes turned.
#[inline(always)]
fn seen(corner: &[[f32; 4]; 3], (x, y, z): (usize, usize, usize), origin: [f32; 3]) -> [Vec4; 3] {
    [
        Vec4::from_array(corner[x]) - Vec4::splat(origin[0]),
        Vec4::from_array(corner[y]) - Vec4::splat(origin[1]),
        Vec4::from_array(corner[z]) - Vec4::splat(origin[2]),
    ]
}

/// The test in `f64` for the few triangles that `f32` leaves in doubt: those with an edge function that is zero, and
/// those that would break the margin.
#[cold]
#[inline(never)]
pub(crate) fn settle(
    ray: &PreparedRay,
    corners: [&[f32; 3]; 3],
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let (x, y, z) = ray.axes();
    // The projected corners as f32 has them.
    let projected = corners.map(|p| {
        let q = [p[0] - ray.origin[0], p[1] - ray.origin[1], p[2] - ray.origin[2]];
        [q[x] - ray.shear[0] * q[z], q[y] - ray.shear[1] * q[z]]
    });
    if !ray.valid || !projected.as_flattened().iter().all(|p| p.is_finite()) {
        return None;
    }
    let [a, b, c] = projected;
    let edge = |p: [f32; 2], q: [f32; 2]| q[0] * p[1] - q[1] * p[0];
    let edges = [edge(b, c), edge(c, a), edge(a, b)];
    let weights = if edges.contains(&0.0) {
        // Products of two f32 are exact in f64, so these signs are those of the exact differences.
        edge_functions(projected.map(|p| p.map(f64::from)))
    } else {
        edges.map(f64::from)
    };
    if mixed(weights) || !weights.iter().all(|w| w.is_finite()) {
        return None;
    }
    let origin = ray.origin.map(f64::from);
    let relative = corners.map(|c| relative(c, origin));
    if has_no_area(&relative) || weights == [0.0; 3] {
        return None;
    }
    at_weights(ray, &relative, weights, delta).or_else(|| repair(ray, &relative, delta))
}

/// A corner seen from the ray's origin.
#[inline(always)]
fn relative(corner: &[f32; 3], origin: [f64; 3]) -> [f64; 3] {
    [
        f64::from(corner[0]) - origin[0],
        f64::from(corner[1]) - origin[1],
        f64::from(corner[2]) - origin[2],
    ]
}

#[inline(always)]
fn minus(a: &[f64; 3], b: &[f64; 3]) -> [f64; 3] {
    [a[0] - b[0], a[1] - b[1], a[2] - b[2]]
}

/// Whether a triangle is a line or a point, exactly.
#[inline(always)]
pub(crate) fn has_no_area([a, b, c]: &[[f64; 3]; 3]) -> bool {
    let (e, f) = (minus(b, a), minus(c, a));
    e[1] * f[2] == e[2] * f[1] && e[2] * f[0] == e[0] * f[2] && e[0] * f[1] == e[1] * f[0]
}

/// The hit at unnormalised barycentric weights, if it keeps the margin. Corners are relative to the
/// ray's origin.
#[inline(always)]
fn at_weights(
    ray: &PreparedRay,
    corners: &[[f64; 3]; 3],
    weights: [f64; 3],
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let [a, b, c] = corners;
    let scale = 1.0 / (weights[0] + weights[1] + weights[2]);
    let (u, v) = ((weights[1] * scale) as f32, (weights[2] * scale) as f32);
    let (_, _, z) = ray.axes();
    let depth = (weights[0] * a[z] + weights[1] * b[z] + weights[2] * c[z]) * scale;
    let t = (depth / f64::from(ray.direction[z])) as f32;
    // Checked on the rounded values, as those are what the caller gets.
    let (e, f) = (minus(b, a), minus(c, a));
    let (s, u64, v64) = (f64::from(t), f64::from(u), f64::from(v));
    let off = |i: usize| s * f64::from(ray.direction[i]) - (a[i] + u64 * e[i] + v64 * f[i]);
    let square = off(0) * off(0) + off(1) * off(1) + off(2) * off(2);
    let delta = f64::from(delta);
    // Not the other way round: NaN must fail.
    let kept = square <= delta * delta;
    (kept && t.is_finite()).then_some((t, u, v))
}

/// A hit that broke the margin in `f32`, computed again.
#[cold]
#[inline(never)]
fn repair(ray: &PreparedRay, corners: &[[f64; 3]; 3], delta: f32) -> Option<(f32, f32, f32)> {
    let d = ray.direction.map(f64::from);
    let (x, y, z) = ray.axes();
    let shear = [d[x] / d[z], d[y] / d[z]];
    let projected = corners.map(|p| [p[x] - shear[0] * p[z], p[y] - shear[1] * p[z]]);
    let weights = edge_functions(projected);
    if !mixed(weights)
        && let Some(hit) = at_weights(ray, corners, weights, delta)
    {
        return Some(hit);
    }
    // Seen from the ray, the triangle is a line, or f64 has it on the other side of an edge: take the
    // nearest point of the outline, the first one on ties.
    let mut best = (f64::INFINITY, [0.0; 3]);
    for i in 0..3 {
        let j = (i + 1) % 3;
        let (p, q) = (projected[i], projected[j]);
        let e = [q[0] - p[0], q[1] - p[1]];
        let square = e[0] * e[0] + e[1] * e[1];
        let s = if square > 0.0 { -(p[0] * e[0] + p[1] * e[1]) / square } else { 0.0 };
        let s = s.clamp(0.0, 1.0);
        let n = [p[0] + s * e[0], p[1] + s * e[1]];
        let distance = n[0] * n[0] + n[1] * n[1];
        if distance < best.0 {
            let mut weights = [0.0; 3];
            weights[i] = 1.0 - s;
            weights[j] = s;
            best = (distance, weights);
        }
    }
    if best.0.is_finite() { at_weights(ray, corners, best.1, delta) } else { None }
}

/// The three edge functions of a projected triangle seen from the origin: weights of its corners.
fn edge_functions([a, b, c]: [[f64; 2]; 3]) -> [f64; 3] {
    [c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]]
}

fn mixed(weights: [f64; 3]) -> bool {
    weights.iter().any(|&w| w < 0.0) && weights.iter().any(|&w| w > 0.0)
}

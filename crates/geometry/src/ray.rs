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

use glam::{DVec3, Vec3, Vec4, Vec4Swizzles};

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
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hit {
    /// Distance along the ray, m.
    pub t: f32,
    /// Index of the triangle in its tile.
    pub triangle: u32,
    /// Index of the triangle in the scene.
    pub global: u32,
    /// Barycentric weight of corner 1.
    pub u: f32,
    /// Barycentric weight of corner 2; corner 0 has `1 - u - v`.
    pub v: f32,
}

/// A ray with what every triangle test needs of it: the shear of Woop et al. and `f64` copies.
#[derive(Clone, Copy, Debug)]
pub struct PreparedRay {
    /// Axis along which the direction is longest; the first of them on ties.
    pub(crate) axis: usize,
    pub(crate) origin: [f32; 3],
    /// `d[axis + 1] / d[axis]` and `d[axis + 2] / d[axis]`, axes modulo 3.
    shear: [f32; 2],
    pub(crate) origin64: [f64; 3],
    pub(crate) direction64: [f64; 3],
    /// Origin and direction are finite and the direction is not zero.
    pub(crate) valid: bool,
}

impl PreparedRay {
    /// Prepares a ray. A ray that is not finite, or has no direction, hits nothing.
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
            shear: [d[(axis + 1) % 3] / d[axis], d[(axis + 2) % 3] / d[axis]],
            origin64: ray.origin.to_array().map(f64::from),
            direction64: d.map(f64::from),
            valid: ray.origin.is_finite() && ray.direction.is_finite() && d[axis] != 0.0,
        }
    }

    /// The ray that this was made from.
    pub fn ray(&self) -> Ray {
        let d = self.direction64.map(|x| x as f32);
        Ray { origin: Vec3::from_array(self.origin), direction: Vec3::from_array(d) }
    }
}

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
    let (a, b, c) = (a.to_array(), b.to_array(), c.to_array());
    match ray.axis {
        0 => intersect_along::<0>(ray, [&a, &b, &c], delta),
        1 => intersect_along::<1>(ray, [&a, &b, &c], delta),
        _ => intersect_along::<2>(ray, [&a, &b, &c], delta),
    }
}

/// [`intersect`] for rays whose longest axis is `Z`. Axes are `(Z + 1, Z + 2, Z)` modulo 3 without
/// the swap of Woop et al.: it flips the three signs together, and both sides count here.
#[inline(always)]
pub(crate) fn intersect_along<const Z: usize>(
    ray: &PreparedRay,
    corners: [&[f32; 3]; 3],
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let (x, y) = ((Z + 1) % 3, (Z + 2) % 3);
    // One lane per corner. Only lane-wise arithmetic, which is the same on every machine.
    let [a, b, c] = corners;
    let lanes =
        |axis: usize| Vec4::new(a[axis], b[axis], c[axis], 0.0) - Vec4::splat(ray.origin[axis]);
    let z = lanes(Z);
    let px = lanes(x) - Vec4::splat(ray.shear[0]) * z;
    let py = lanes(y) - Vec4::splat(ray.shear[1]) * z;
    let edges = px.zxyw() * py.yzxw() - py.zxyw() * px.yzxw();
    let negative = edges.cmplt(Vec4::ZERO).bitmask() & 7;
    let positive = edges.cmpgt(Vec4::ZERO).bitmask() & 7;
    if negative != 0 && positive != 0 {
        return None;
    }
    settle::<Z>(ray, corners, [px, py], edges, delta)
}

/// The rest of the test for the few triangles whose `f32` edge functions have no two strict signs.
#[inline(never)]
fn settle<const Z: usize>(
    ray: &PreparedRay,
    corners: [&[f32; 3]; 3],
    projected: [Vec4; 2],
    edges: Vec4,
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let edges = [edges.x, edges.y, edges.z];
    // NaN has no sign and ends up here.
    if !ray.valid || !edges.iter().all(|e| e.is_finite()) {
        return None;
    }
    let mut weights = edges.map(f64::from);
    if edges.contains(&0.0) {
        // Products of two f32 are exact in f64, so these signs are those of the exact differences.
        let [px, py] = projected;
        let corner = |i: usize| [f64::from(px[i]), f64::from(py[i])];
        weights = edge_functions([corner(0), corner(1), corner(2)]);
        if mixed(weights) {
            return None;
        }
    }
    let [a, b, c] = corners.map(|p| DVec3::from_array(p.map(f64::from)));
    if (b - a).cross(c - a) == DVec3::ZERO {
        return None;
    }
    let origin = DVec3::from_array(ray.origin64);
    let relative = [a - origin, b - origin, c - origin];
    if weights == [0.0; 3] {
        return None;
    }
    at_weights::<Z>(ray, &relative, weights, delta).or_else(|| repair::<Z>(ray, &relative, delta))
}

/// The hit at unnormalised barycentric weights, if it keeps the margin. Corners are relative to the
/// ray's origin.
fn at_weights<const Z: usize>(
    ray: &PreparedRay,
    corners: &[DVec3; 3],
    weights: [f64; 3],
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let det = weights[0] + weights[1] + weights[2];
    let scale = 1.0 / det;
    let (u, v) = ((weights[1] * scale) as f32, (weights[2] * scale) as f32);
    let [a, b, c] = corners;
    let depth = (weights[0] * a[Z] + weights[1] * b[Z] + weights[2] * c[Z]) * scale;
    let t = (depth / ray.direction64[Z]) as f32;
    // Checked on the rounded values, as those are what the caller gets.
    let on_triangle = *a + f64::from(u) * (*b - *a) + f64::from(v) * (*c - *a);
    let on_ray = f64::from(t) * DVec3::from_array(ray.direction64);
    let delta = f64::from(delta);
    // Not the other way round: NaN must fail.
    let kept = (on_ray - on_triangle).length_squared() <= delta * delta;
    (kept && t.is_finite()).then_some((t, u, v))
}

/// A hit that broke the margin in `f32`, computed again.
#[cold]
#[inline(never)]
fn repair<const Z: usize>(
    ray: &PreparedRay,
    corners: &[DVec3; 3],
    delta: f32,
) -> Option<(f32, f32, f32)> {
    let d = ray.direction64;
    let (x, y) = ((Z + 1) % 3, (Z + 2) % 3);
    let shear = [d[x] / d[Z], d[y] / d[Z]];
    let projected = corners.map(|p| [p[x] - shear[0] * p[Z], p[y] - shear[1] * p[Z]]);
    let weights = edge_functions(projected);
    if !mixed(weights)
        && let Some(hit) = at_weights::<Z>(ray, corners, weights, delta)
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
    if best.0.is_finite() { at_weights::<Z>(ray, corners, best.1, delta) } else { None }
}

/// The three edge functions of a projected triangle seen from the origin: weights of its corners.
fn edge_functions([a, b, c]: [[f64; 2]; 3]) -> [f64; 3] {
    [c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]]
}

fn mixed(weights: [f64; 3]) -> bool {
    weights.iter().any(|&w| w < 0.0) && weights.iter().any(|&w| w > 0.0)
}

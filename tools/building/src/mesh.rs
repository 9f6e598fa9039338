//! The workbench: triangle meshes and the few shapes all furniture is made of.
//!
//! Space is metres, z up. Triangles are counter-clockwise seen from outside. Shapes are closed
//! solids unless their name says *sheet*. A paint is the name of a material of
//! [`crate::palette`].

use glam::{DVec2, DVec3};
use std::f64::consts::{PI, TAU};

/// The name of a material, see [`crate::palette`].
pub type Paint = &'static str;

/// Degrees to radians.
pub fn radians(degrees: f64) -> f64 {
    degrees * (PI / 180.0)
}

/// Sine and cosine of an angle in radians, the same bits on every machine.
pub fn sin_cos(angle: f64) -> (f64, f64) {
    (libm::sin(angle), libm::cos(angle))
}

/// Whole powers by multiplication, the same bits on every machine.
pub trait Raised {
    /// `self` to the power `n`.
    fn raised(self, n: u32) -> Self;
}

impl Raised for f64 {
    fn raised(self, n: u32) -> Self {
        (0..n).fold(1.0, |product, _| product * self)
    }
}

/// A vector.
pub const fn v(x: f64, y: f64, z: f64) -> DVec3 {
    DVec3::new(x, y, z)
}

/// Three corners, counter-clockwise from outside, and their paint.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Triangle {
    /// Indices into [`Mesh::points`].
    pub corners: [u32; 3],
    /// Material name.
    pub paint: Paint,
    /// Index into [`Mesh::objects`].
    pub object: u32,
}

/// An indexed triangle mesh with named objects.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Corners in metres.
    pub points: Vec<DVec3>,
    /// Triangles in file order.
    pub triangles: Vec<Triangle>,
    /// Object names; triangle `object` 0 of a mesh without names belongs to the file.
    pub objects: Vec<String>,
}

impl Mesh {
    /// An empty mesh.
    pub fn new() -> Self {
        Self::default()
    }

    /// Adds a point and returns its index.
    pub fn point(&mut self, point: DVec3) -> u32 {
        self.points.push(point);
        (self.points.len() - 1) as u32
    }

    /// Adds a triangle.
    pub fn triangle(&mut self, a: u32, b: u32, c: u32, paint: Paint) {
        self.triangles.push(Triangle { corners: [a, b, c], paint, object: 0 });
    }

    /// Adds a quadrilateral as two triangles, cut along its shorter diagonal.
    pub fn quad(&mut self, corners: [u32; 4], paint: Paint) {
        let [a, b, c, d] = corners;
        let at = |i: u32| self.points[i as usize];
        if at(a).distance_squared(at(c)) <= at(b).distance_squared(at(d)) + 1e-12 {
            self.triangle(a, b, c, paint);
            self.triangle(a, c, d, paint);
        } else {
            self.triangle(a, b, d, paint);
            self.triangle(b, c, d, paint);
        }
    }

    /// Adds all of `other`.
    pub fn add(&mut self, other: Self) -> &mut Self {
        let (points, objects) = (self.points.len() as u32, self.objects.len() as u32);
        self.points.extend(other.points);
        self.objects.extend(other.objects);
        self.triangles.extend(other.triangles.into_iter().map(|t| Triangle {
            corners: t.corners.map(|c| c + points),
            paint: t.paint,
            object: t.object + objects,
        }));
        self
    }

    /// Makes the whole mesh one object called `name`.
    pub fn named(mut self, name: impl Into<String>) -> Self {
        self.objects = vec![name.into()];
        for t in &mut self.triangles {
            t.object = 0;
        }
        self
    }

    /// Every point moved by `f`, which must keep the orientation of space.
    pub fn map(mut self, f: impl Fn(DVec3) -> DVec3) -> Self {
        for p in &mut self.points {
            *p = f(*p);
        }
        self
    }

    /// Moved by `(x, y, z)`.
    pub fn at(self, x: f64, y: f64, z: f64) -> Self {
        self.map(|p| p + v(x, y, z))
    }

    /// Scaled about the origin by positive factors.
    pub fn scaled(self, x: f64, y: f64, z: f64) -> Self {
        self.map(|p| v(p.x * x, p.y * y, p.z * z))
    }

    /// Turned about the z axis, x towards y, by degrees.
    pub fn turned(self, degrees: f64) -> Self {
        let (s, c) = sin_cos(radians(degrees));
        self.map(|p| v(c * p.x - s * p.y, s * p.x + c * p.y, p.z))
    }

    /// Turned about the x axis, y towards z, by degrees.
    pub fn tipped(self, degrees: f64) -> Self {
        let (s, c) = sin_cos(radians(degrees));
        self.map(|p| v(p.x, c * p.y - s * p.z, s * p.y + c * p.z))
    }

    /// Turned about the y axis, z towards x, by degrees.
    pub fn rolled(self, degrees: f64) -> Self {
        let (s, c) = sin_cos(radians(degrees));
        self.map(|p| v(c * p.x + s * p.z, p.y, c * p.z - s * p.x))
    }

    /// The mirror image in the plane x = 0, still outward.
    pub fn mirrored(self) -> Self {
        let mut m = self.map(|p| v(-p.x, p.y, p.z));
        for t in &mut m.triangles {
            t.corners.swap(1, 2);
        }
        m
    }

    /// Least and greatest corner; zeros for an empty mesh.
    pub fn bounds(&self) -> (DVec3, DVec3) {
        let mut points = self.points.iter().copied();
        let Some(first) = points.next() else { return (DVec3::ZERO, DVec3::ZERO) };
        points.fold((first, first), |(low, high), p| (low.min(p), high.max(p)))
    }

    /// The corners of triangle `index` in metres.
    pub fn corners(&self, index: usize) -> [DVec3; 3] {
        self.triangles[index].corners.map(|c| self.points[c as usize])
    }

    /// Enclosed volume in cubic metres; positive when a closed mesh is outward.
    pub fn volume(&self) -> f64 {
        (0..self.triangles.len())
            .map(|i| {
                let [a, b, c] = self.corners(i);
                a.dot(b.cross(c)) / 6.0
            })
            .sum()
    }
}

/// Puts several meshes together.
pub fn all(parts: impl IntoIterator<Item = Mesh>) -> Mesh {
    let mut mesh = Mesh::new();
    for part in parts {
        mesh.add(part);
    }
    mesh
}

/// A `(nu + 1) x (nv + 1)` sheet (or a band, tube or torus where `wrap` says so) with
/// `f(u, v)`, u and v in 0..=1; outward is du x dv.
pub fn sheet(
    paint: Paint,
    (nu, nv): (usize, usize),
    (wrap_u, wrap_v): (bool, bool),
    f: impl Fn(f64, f64) -> DVec3,
) -> Mesh {
    let mut m = Mesh::new();
    let (cu, cv) = (nu + usize::from(!wrap_u), nv + usize::from(!wrap_v));
    for j in 0..cv {
        for i in 0..cu {
            m.point(f(i as f64 / nu as f64, j as f64 / nv as f64));
        }
    }
    let at = |i: usize, j: usize| ((j % cv) * cu + i % cu) as u32;
    for j in 0..nv {
        for i in 0..nu {
            m.quad([at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)], paint);
        }
    }
    m
}

/// A closed plate: the sheet `f`, and its copy moved by `-thickness` along its normals.
pub fn plate(
    paint: Paint,
    (nu, nv): (usize, usize),
    thickness: f64,
    f: impl Fn(f64, f64) -> DVec3,
) -> Mesh {
    let mut m = Mesh::new();
    let h = 1e-4;
    let normal = |a: f64, b: f64| {
        let du = f((a + h).min(1.0), b) - f((a - h).max(0.0), b);
        let dv = f(a, (b + h).min(1.0)) - f(a, (b - h).max(0.0));
        du.cross(dv).normalize_or_zero()
    };
    for side in [0.0, 1.0] {
        for j in 0..=nv {
            for i in 0..=nu {
                let (a, b) = (i as f64 / nu as f64, j as f64 / nv as f64);
                m.point(f(a, b) - normal(a, b) * (thickness * side));
            }
        }
    }
    let half = ((nu + 1) * (nv + 1)) as u32;
    let top = |i: usize, j: usize| (j * (nu + 1) + i) as u32;
    for j in 0..nv {
        for i in 0..nu {
            let q = [top(i, j), top(i + 1, j), top(i + 1, j + 1), top(i, j + 1)];
            m.quad(q, paint);
            m.quad([q[3] + half, q[2] + half, q[1] + half, q[0] + half], paint);
        }
    }
    let mut rim = |a: u32, b: u32| m.quad([a, a + half, b + half, b], paint);
    for i in 0..nu {
        rim(top(i, 0), top(i + 1, 0));
        rim(top(i + 1, nv), top(i, nv));
    }
    for j in 0..nv {
        rim(top(0, j + 1), top(0, j));
        rim(top(nu, j), top(nu, j + 1));
    }
    m
}

/// An axis-aligned box from corner `low` to corner `high`.
pub fn cuboid(paint: Paint, low: DVec3, high: DVec3) -> Mesh {
    let mut m = Mesh::new();
    for i in 0..8 {
        let pick = |bit: usize, a: f64, b: f64| if i >> bit & 1 == 1 { b } else { a };
        m.point(v(pick(0, low.x, high.x), pick(1, low.y, high.y), pick(2, low.z, high.z)));
    }
    for q in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
        m.quad(q, paint);
    }
    m
}

/// A box of `size` centred on x = y = 0 that stands on z = 0.
pub fn block(paint: Paint, x: f64, y: f64, z: f64) -> Mesh {
    cuboid(paint, v(-x / 2.0, -y / 2.0, 0.0), v(x / 2.0, y / 2.0, z))
}

/// The box from `low` to `high` with bevelled edges: 44 triangles.
pub fn bevelled(paint: Paint, low: DVec3, high: DVec3, bevel: f64) -> Mesh {
    let centre = (low + high) / 2.0;
    let half = (high - low) / 2.0;
    let inner = half - DVec3::splat(bevel.min(half.min_element() * 0.8));
    let mut m = Mesh::new();
    // Corner (x, y, z) has three points, one on each face that meets there.
    for corner in 0..8 {
        let sign = [0, 1, 2].map(|k| if corner >> k & 1 == 1 { 1.0 } else { -1.0 });
        for axis in 0..3 {
            let mut p = DVec3::ZERO;
            for k in 0..3 {
                p[k] = sign[k] * if k == axis { half[k] } else { inner[k] };
            }
            m.point(centre + p);
        }
    }
    let at =
        |bits: [usize; 3], axis: usize| ((bits[0] | bits[1] << 1 | bits[2] << 2) * 3 + axis) as u32;
    for axis in 0..3 {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        for side in 0..2 {
            let corner = |i: usize, j: usize| {
                let mut bits = [0; 3];
                (bits[axis], bits[b], bits[c]) = (side, i, j);
                at(bits, axis)
            };
            let q = [corner(0, 0), corner(1, 0), corner(1, 1), corner(0, 1)];
            m.quad(if side == 1 { q } else { [q[3], q[2], q[1], q[0]] }, paint);
        }
        // The four bevels along this axis, between the faces b and c.
        for (i, j) in [(0, 0), (1, 0), (1, 1), (0, 1)] {
            let point = |k: usize, face: usize| {
                let mut bits = [0; 3];
                (bits[axis], bits[b], bits[c]) = (k, i, j);
                at(bits, face)
            };
            let q = [point(0, b), point(0, c), point(1, c), point(1, b)];
            m.quad(if i == j { q } else { [q[3], q[2], q[1], q[0]] }, paint);
        }
    }
    for corner in 0..8usize {
        let k = corner as u32 * 3;
        if corner.count_ones() % 2 == 1 {
            m.triangle(k, k + 1, k + 2, paint);
        } else {
            m.triangle(k, k + 2, k + 1, paint);
        }
    }
    m
}

/// The box from `low` to `high` with edges rounded to `radius` by about `n` steps each: a bevel
/// of 44 triangles for 1, 108 triangles for 2 and 3, 300 for 4 and 5, and so on.
pub fn rounded(paint: Paint, low: DVec3, high: DVec3, radius: f64, n: usize) -> Mesh {
    if n < 2 {
        bevelled(paint, low, high, radius)
    } else {
        padded(paint, low, high, radius, n / 2, 1)
    }
}

/// The box from `low` to `high` with edges rounded to `radius` by `2 n` steps, and its flat parts
/// cut into `flat` pieces: `12 (2 n + flat)^2` triangles. `n` is at least 1.
pub fn padded(paint: Paint, low: DVec3, high: DVec3, radius: f64, n: usize, flat: usize) -> Mesh {
    let centre = (low + high) / 2.0;
    let half = (high - low) / 2.0;
    let r = radius.min(half.min_element() * 0.95);
    let inner = half - DVec3::splat(r);
    let side = 2 * n + flat;
    // Where a step lies along an axis: in the lower fillet, the flat part or the upper fillet.
    // Fillet steps are tangents of equal angles, which spaces them evenly on the sphere.
    let step = |i: usize, axis: usize| -> (f64, f64) {
        let edge = |k: usize| {
            let (s, c) = sin_cos(PI / 4.0 * k as f64 / n as f64);
            s / c
        };
        if i < n {
            (-inner[axis], -edge(n - i))
        } else if i > n + flat {
            (inner[axis], edge(i - n - flat))
        } else {
            (inner[axis] * (2.0 * (i - n) as f64 / flat as f64 - 1.0), 0.0)
        }
    };
    let mut m = Mesh::new();
    let mut index = std::collections::BTreeMap::new();
    for (axis, sign) in [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)] {
        let (b, c) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut corner = |i: usize, j: usize| {
            let mut key = [0usize; 3];
            key[axis] = if sign > 0 { side } else { 0 };
            key[b] = i;
            key[c] = j;
            *index.entry(key).or_insert_with(|| {
                let mut base = DVec3::ZERO;
                let mut out = DVec3::ZERO;
                for k in 0..3 {
                    (base[k], out[k]) = step(key[k], k);
                }
                m.points.push(centre + base + out.normalize() * r);
                (m.points.len() - 1) as u32
            })
        };
        let mut quads = Vec::new();
        for j in 0..side {
            for i in 0..side {
                let q = [corner(i, j), corner(i + 1, j), corner(i + 1, j + 1), corner(i, j + 1)];
                quads.push(if sign > 0 { q } else { [q[3], q[2], q[1], q[0]] });
            }
        }
        for q in quads {
            m.quad(q, paint);
        }
    }
    m
}

/// A rounded box of `size` centred on x = y = 0 that stands on z = 0, with `n` fillet steps.
pub fn soft(paint: Paint, x: f64, y: f64, z: f64, radius: f64, n: usize) -> Mesh {
    rounded(paint, v(-x / 2.0, -y / 2.0, 0.0), v(x / 2.0, y / 2.0, z), radius, n)
}

/// A cushion: a rounded box whose faces swell by `swell` metres in the middle.
pub fn cushion(paint: Paint, size: DVec3, radius: f64, swell: f64, n: usize, flat: usize) -> Mesh {
    let h = size / 2.0;
    padded(paint, v(-h.x, -h.y, 0.0), v(h.x, h.y, size.z), radius, n, flat).map(|p| {
        let bell = |a: f64| (1.0 - a * a).max(0.0);
        let (a, b, c) = (p.x / h.x, p.y / h.y, (p.z - h.z) / h.z);
        p + v(
            a * bell(b) * bell(c) * swell * 0.5,
            b * bell(a) * bell(c) * swell * 0.5,
            c * bell(a) * bell(b) * swell,
        )
    })
}

/// A solid of revolution about the z axis. `profile` is (radius, z) from bottom to top with the
/// inside on its left; it must begin and end on the axis.
pub fn lathe(paint: Paint, profile: &[(f64, f64)], segments: usize) -> Mesh {
    let mut m = Mesh::new();
    let rings: Vec<Vec<u32>> = profile
        .iter()
        .map(|&(r, z)| {
            if r <= 0.0 {
                vec![m.point(v(0.0, 0.0, z))]
            } else {
                (0..segments)
                    .map(|i| {
                        let (s, c) = sin_cos(TAU * i as f64 / segments as f64);
                        m.point(v(r * c, r * s, z))
                    })
                    .collect()
            }
        })
        .collect();
    for pair in rings.windows(2) {
        bridge(&mut m, &pair[0], &pair[1], paint);
    }
    m
}

/// Joins two rings (or a ring and a pole) by a band.
fn bridge(m: &mut Mesh, low: &[u32], high: &[u32], paint: Paint) {
    let n = low.len().max(high.len());
    for i in 0..n {
        let k = (i + 1) % n;
        match (low.len(), high.len()) {
            (1, 1) => {}
            (1, _) => m.triangle(low[0], high[k], high[i], paint),
            (_, 1) => m.triangle(low[i], low[k], high[0], paint),
            _ => m.quad([low[i], low[k], high[k], high[i]], paint),
        }
    }
}

/// An upright cylinder from z = 0 to `height`, its edges bevelled.
pub fn cylinder(paint: Paint, radius: f64, height: f64, segments: usize) -> Mesh {
    let b = (radius * 0.12).min(height * 0.12);
    let profile = [
        (0.0, 0.0),
        (radius - b, 0.0),
        (radius, b),
        (radius, height - b),
        (radius - b, height),
        (0.0, height),
    ];
    lathe(paint, &profile, segments)
}

/// A ball around the origin.
pub fn ball(paint: Paint, radius: f64, segments: usize) -> Mesh {
    let rows = segments / 2;
    let profile: Vec<_> = (0..=rows)
        .map(|j| {
            let (s, c) = sin_cos(PI * j as f64 / rows as f64);
            (if j == 0 || j == rows { 0.0 } else { radius * s }, -radius * c)
        })
        .collect();
    lathe(paint, &profile, segments)
}

/// A solid rod along `path`, with `radius(s)` for s in 0..=1 along it, closed by flat caps.
pub fn rod(paint: Paint, path: &[DVec3], radius: impl Fn(f64) -> f64, segments: usize) -> Mesh {
    let mut m = Mesh::new();
    let last = path.len() - 1;
    let mut side = DVec3::ZERO;
    let mut rings: Vec<Vec<u32>> = vec![vec![m.point(path[0])]];
    for (i, &p) in path.iter().enumerate() {
        let ahead = (path[(i + 1).min(last)] - path[i.saturating_sub(1)]).normalize();
        side = if i == 0 {
            ahead.any_orthonormal_vector()
        } else {
            (side - ahead * side.dot(ahead)).normalize_or(ahead.any_orthonormal_vector())
        };
        // Bends are cut at half the angle, so that the rod keeps its width.
        let before = (p - path[i.saturating_sub(1)]).normalize_or(ahead);
        let widen = 1.0 / before.dot(ahead).max(0.5);
        let other = ahead.cross(side);
        let bend = (before - ahead * before.dot(ahead)).normalize_or_zero();
        let r = radius(i as f64 / last as f64);
        let ring = (0..segments)
            .map(|k| {
                let (s, c) = sin_cos(TAU * k as f64 / segments as f64);
                let d = side * c + other * s;
                m.points.push(p + (d + bend * (d.dot(bend) * (widen - 1.0))) * r);
                (m.points.len() - 1) as u32
            })
            .collect();
        rings.push(ring);
    }
    rings.push(vec![m.point(path[last])]);
    for pair in rings.windows(2) {
        bridge(&mut m, &pair[0], &pair[1], paint);
    }
    m
}

/// A rod of constant radius.
pub fn tube(paint: Paint, path: &[DVec3], radius: f64, segments: usize) -> Mesh {
    rod(paint, path, |_| radius, segments)
}

/// A smooth curve through `points` (Catmull-Rom) in `steps` pieces per span.
pub fn curve(points: &[DVec3], steps: usize) -> Vec<DVec3> {
    let n = points.len();
    let mut out = vec![points[0]];
    for i in 0..n - 1 {
        let (p1, p2) = (points[i], points[i + 1]);
        let p0 = if i > 0 { points[i - 1] } else { p1 * 2.0 - p2 };
        let p3 = if i + 2 < n { points[i + 2] } else { p2 * 2.0 - p1 };
        for k in 1..=steps {
            let t = k as f64 / steps as f64;
            let (t2, t3) = (t * t, t * t * t);
            out.push(
                (p1 * 2.0
                    + (p2 - p0) * t
                    + (p0 * 2.0 - p1 * 5.0 + p2 * 4.0 - p3) * t2
                    + (p1 * 3.0 - p0 - p2 * 3.0 + p3) * t3)
                    * 0.5,
            );
        }
    }
    out
}

/// A ring (torus) of radius `major` about the z axis and thickness `minor`.
pub fn ring(paint: Paint, major: f64, minor: f64, around: usize, across: usize) -> Mesh {
    sheet(paint, (around, across), (true, true), |a, b| {
        let (s, c) = sin_cos(TAU * a);
        let (t, d) = sin_cos(TAU * b);
        v((major + minor * d) * c, (major + minor * d) * s, minor * t)
    })
}

/// A prism over a counter-clockwise outline that is star-shaped from its centroid.
pub fn prism(paint: Paint, outline: &[DVec2], z0: f64, z1: f64) -> Mesh {
    let mut m = Mesh::new();
    let mid = outline.iter().copied().sum::<DVec2>() / outline.len() as f64;
    let mut level = |z: f64| -> Vec<u32> {
        outline.iter().map(|p| m.point(v(p.x, p.y, z))).collect::<Vec<_>>()
    };
    let (low, high) = (level(z0), level(z1));
    let (bottom, top) = (m.point(v(mid.x, mid.y, z0)), m.point(v(mid.x, mid.y, z1)));
    bridge(&mut m, &[bottom], &low, paint);
    bridge(&mut m, &low, &high, paint);
    bridge(&mut m, &high, &[top], paint);
    m
}

/// An ellipse-like outline with corner exponent `power` (2 is an ellipse, 4 a soft rectangle).
pub fn superellipse(x: f64, y: f64, power: f64, segments: usize) -> Vec<DVec2> {
    let bend = |c: f64| {
        let p = libm::pow(c.abs(), 2.0 / power);
        if c < 0.0 { -p } else { p }
    };
    (0..segments)
        .map(|i| {
            let (s, c) = sin_cos(TAU * (i as f64 + 0.5) / segments as f64);
            DVec2::new(x * bend(c), y * bend(s))
        })
        .collect()
}

/// Bands around copies of `outline`, scaled and lifted by `profile` (scale, z), the inside on the
/// left of the profile; a scale of 0 is a point. With `closed` the last band joins the first, as
/// in a ring.
pub fn bands(paint: Paint, outline: &[DVec2], profile: &[(f64, f64)], closed: bool) -> Mesh {
    let mut m = Mesh::new();
    let rings: Vec<Vec<u32>> = profile
        .iter()
        .map(|&(f, z)| {
            if f <= 0.0 {
                vec![m.point(v(0.0, 0.0, z))]
            } else {
                outline.iter().map(|p| m.point(v(p.x * f, p.y * f, z))).collect()
            }
        })
        .collect();
    for pair in rings.windows(2) {
        bridge(&mut m, &pair[0], &pair[1], paint);
    }
    if closed {
        bridge(&mut m, &rings[rings.len() - 1], &rings[0], paint);
    }
    m
}

/// A table or counter top: a prism with a soft edge on both rims.
pub fn top(paint: Paint, outline: &[DVec2], z0: f64, z1: f64) -> Mesh {
    let b = (z1 - z0) * 0.3;
    let mid = outline.iter().copied().sum::<DVec2>() / outline.len() as f64;
    let mut m = Mesh::new();
    let mut rings = vec![vec![m.point(v(mid.x, mid.y, z0))]];
    for (inset, z) in [
        (b, z0),
        (b * 0.3, z0 + b * 0.3),
        (0.0, z0 + b),
        (0.0, z1 - b),
        (b * 0.3, z1 - b * 0.3),
        (b, z1),
    ] {
        rings.push(
            outline
                .iter()
                .map(|&p| {
                    let q = p - (p - mid).normalize_or_zero() * inset;
                    m.point(v(q.x, q.y, z))
                })
                .collect(),
        );
    }
    rings.push(vec![m.point(v(mid.x, mid.y, z1))]);
    for pair in rings.windows(2) {
        bridge(&mut m, &pair[0], &pair[1], paint);
    }
    m
}

/// Whether every directed edge has its opposite, points being the same to a hundredth of a
/// millimetre. Meshes of closed solids pass; open sheets do not.
pub fn is_closed(mesh: &Mesh) -> bool {
    let key = |p: DVec3| [p.x, p.y, p.z].map(|c| libm::round(c * 1e5) as i64);
    let mut edges = std::collections::BTreeMap::new();
    for i in 0..mesh.triangles.len() {
        let k = mesh.corners(i).map(key);
        for e in 0..3 {
            *edges.entry((k[e], k[(e + 1) % 3])).or_insert(0i32) += 1;
        }
    }
    edges.iter().all(|(&(a, b), &n)| a == b || edges.get(&(b, a)) == Some(&n))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn solid(m: &Mesh, volume: f64, tolerance: f64) {
        assert!(is_closed(m), "open");
        let got = m.volume();
        assert!((got - volume).abs() <= tolerance * volume, "volume {got}, expected {volume}");
    }

    #[test]
    fn solids_are_closed_and_outward() {
        solid(&cuboid("a", v(1.0, 2.0, 3.0), v(2.0, 4.0, 6.0)), 6.0, 1e-12);
        solid(&soft("a", 1.0, 2.0, 3.0, 0.0001, 2), 6.0, 1e-3);
        solid(&bevelled("a", v(1.0, 1.0, 1.0), v(2.0, 3.0, 4.0), 0.0001), 6.0, 1e-3);
        assert_eq!(soft("a", 1.0, 1.0, 1.0, 0.1, 1).triangles.len(), 44);
        solid(&soft("a", 2.0, 2.0, 2.0, 1.0, 16), 4.0 / 3.0 * PI, 0.08);
        solid(&cylinder("a", 1.0, 50.0, 64), 50.0 * PI, 0.01);
        solid(&ball("a", 2.0, 48), 32.0 / 3.0 * PI, 0.01);
        solid(&tube("a", &[v(0.0, 0.0, 0.0), v(0.0, 3.0, 0.0)], 0.5, 32), 0.75 * PI, 0.01);
        solid(&ring("a", 2.0, 0.5, 48, 24), PI * PI, 0.03);
        let round = superellipse(1.0, 1.0, 2.0, 64);
        solid(&prism("a", &round, 0.0, 2.0), 2.0 * PI, 0.01);
        solid(&top("a", &round, 0.0, 0.02), 0.02 * PI, 0.02);
        solid(&plate("a", (4, 5), 0.1, |a, b| v(a * 2.0, b * 3.0, 0.0)), 0.6, 1e-9);
        let pillow = cushion("a", v(1.0, 1.0, 0.3), 0.1, 0.05, 3, 3);
        assert!(is_closed(&pillow) && pillow.volume() > 0.25);
    }

    #[test]
    fn transforms_keep_volume_and_outside() {
        let m = cuboid("a", v(0.1, 0.2, 0.3), v(1.0, 2.0, 3.0));
        let volume = m.volume();
        for t in [
            m.clone().turned(33.0),
            m.clone().tipped(71.0),
            m.clone().rolled(-20.0),
            m.clone().mirrored(),
            m.clone().at(5.0, -7.0, 2.0),
        ] {
            solid(&t, volume, 1e-9);
        }
        let q = m.turned(90.0).bounds();
        assert!((q.0 - v(-2.0, 0.1, 0.3)).length() < 1e-12);
    }

    #[test]
    fn a_bent_rod_stays_closed() {
        let path = curve(&[v(0.0, 0.0, 0.0), v(1.0, 0.0, 0.0), v(1.0, 1.0, 0.5)], 6);
        assert_eq!(path.len(), 13);
        let m = rod("a", &path, |s| 0.1 - 0.05 * s, 10);
        assert!(is_closed(&m) && m.volume() > 0.0);
    }
}

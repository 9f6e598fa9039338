//! Closed surfaces, and rays inside that want to get out.

use std::collections::BTreeMap;

use enf_geometry::Ray;
use glam::{IVec3, Vec3};

use super::{Corners, Random};

/// A closed surface.
pub struct Closed {
    pub name: &'static str,
    pub triangles: Vec<Corners>,
    /// The scene's tolerance, m.
    pub delta: f32,
    /// Points from `centre - half` to `centre + half` are inside.
    pub centre: Vec3,
    pub half: Vec3,
}

/// The ways of aiming, in the order of [`Closed::ray`].
pub const AIMS: usize = 7;

impl Closed {
    fn new(name: &'static str, triangles: Vec<Corners>, centre: Vec3, half: Vec3) -> Self {
        let corners = || triangles.iter().flatten().copied();
        let (low, high) = corners()
            .fold((Vec3::INFINITY, Vec3::NEG_INFINITY), |(low, high), p| (low.min(p), high.max(p)));
        let reach = low.abs().max(high.abs()).max_element().max((high - low).length());
        let mut m = f32::MIN_POSITIVE;
        while m < reach {
            m *= 2.0;
        }
        Self { name, triangles, delta: m / (1 << 19) as f32, centre, half }
    }

    /// A ray from inside: anywhere, at a vertex, at an edge, or through either of them along an axis or a diagonal, which
    /// makes its edge functions exactly zero.
    pub fn ray(&self, random: &mut Random) -> Ray {
        let origin = self.centre + self.half * random.cube();
        let triangle = self.triangles[random.below(self.triangles.len())];
        let k = random.below(3);
        let (a, b) = (triangle[k], triangle[(k + 1) % 3]);
        let edge = a + random.unit() * (b - a);
        let toward = |p: Vec3| Ray {
            origin,
            direction: ((p - origin) / self.half.max_element()).normalize(),
        };
        let sign = |random: &mut Random| if random.below(2) == 0 { 1.0 } else { -1.0 };
        match random.below(AIMS) {
            0 => Ray { origin, direction: random.direction() },
            1 => toward(a),
            2 => toward(edge),
            3 => toward(0.5 * (a + b)),
            // Along an axis: the origin takes over as many coordinates as it may.
            aim @ (4 | 5) => {
                let axis = random.below(3);
                let target = if aim == 4 { a } else { edge };
                let mut origin = origin;
                for i in (0..3).filter(|&i| i != axis) {
                    if (target[i] - self.centre[i]).abs() <= self.half[i] {
                        origin[i] = target[i];
                    }
                }
                let mut direction = Vec3::ZERO;
                direction[axis] = sign(random);
                Ray { origin, direction }
            }
            // Along a diagonal of two or three axes, from a point that sees a vertex there.
            _ => {
                let mut way = Vec3::new(sign(random), sign(random), sign(random));
                if random.below(2) == 0 {
                    way[random.below(3)] = 0.0;
                }
                let from = a - random.unit() * 2.0 * self.half.min_element() * way;
                let inside = (from - self.centre).abs().cmple(self.half).all();
                let origin = if inside { from } else { origin };
                Ray { origin, direction: way.normalize() }
            }
        }
    }

    /// Each edge has two triangles, which see it from opposite ends; none of them is a line.
    pub fn assert_closed(&self) {
        let key = |p: Vec3| p.to_array().map(|x| (x + 0.0).to_bits());
        let mut edges = BTreeMap::new();
        for triangle in &self.triangles {
            let [a, b, c] = triangle.map(|p| p.as_dvec3());
            assert!((b - a).cross(c - a).length() > 0.0, "{}: no area", self.name);
            for k in 0..3 {
                let edge = (key(triangle[k]), key(triangle[(k + 1) % 3]));
                assert!(edges.insert(edge, ()).is_none(), "{}: an edge seen twice", self.name);
            }
        }
        for &(p, q) in edges.keys() {
            assert!(edges.contains_key(&(q, p)), "{}: an open edge", self.name);
        }
    }
}

/// A number in `[0, 1)` for each vertex.
fn noise(seed: u64, key: [u32; 3], what: u64) -> f32 {
    let mix = |h: u64, x: u32| Random(h ^ u64::from(x)).bits();
    Random(key.into_iter().fold(seed ^ what.wrapping_mul(0xD6E8_FEB8_6659_FD93), mix)).unit()
}

/// An octahedron, subdivided `level` times, on the unit sphere: eight times four to the `level` triangles.
pub fn octahedron(level: u32) -> Vec<Corners> {
    let (x, y, z) = (Vec3::X, Vec3::Y, Vec3::Z);
    let mut out = Vec::new();
    for i in [1.0, -1.0] {
        for j in [1.0, -1.0] {
            for k in [1.0, -1.0] {
                let [a, b, c] = [i * x, j * y, k * z];
                out.push(if i * j * k > 0.0 { [a, b, c] } else { [a, c, b] });
            }
        }
    }
    for _ in 0..level {
        out = out
            .into_iter()
            .flat_map(|[a, b, c]| {
                // (a + b) is (b + a) to the bit: neighbours share their midpoints.
                let [p, q, r] = [a + b, b + c, c + a].map(|m| m.normalize());
                [[a, p, r], [p, b, q], [r, q, c], [p, q, r]]
            })
            .collect();
    }
    out
}

/// A ball with an uneven surface: radii from 1 to `1 + shake`, then scaled.
fn ball(level: u32, shake: f32, scale: Vec3, seed: u64) -> Vec<Corners> {
    let shaken = |p: Vec3| {
        let key = p.to_array().map(|x| (x + 0.0).to_bits());
        p * (1.0 + shake * noise(seed, key, 0)) * scale
    };
    octahedron(level).into_iter().map(|t| t.map(shaken)).collect()
}

/// The walls of a box of `size`, of `n` by `n` quads each, whose vertices are off by up to `jitter` quads along their wall
/// and by up to `bump` quads across it. Diagonals go either way.
fn room(n: i32, size: Vec3, jitter: f32, bump: f32, seed: u64) -> Vec<Corners> {
    let vertex = |at: IVec3| {
        let key = at.to_array().map(|i| i as u32);
        let mut p = at.as_vec3() / n as f32 - 0.5;
        for axis in 0..3 {
            let wall = at[axis] == 0 || at[axis] == n;
            let by = if wall { bump } else { jitter };
            p[axis] += by / n as f32 * (2.0 * noise(seed, key, 1 + axis as u64) - 1.0);
        }
        p * size
    };
    let mut out = Vec::new();
    for side in 0..6 {
        let (axis, far) = (side / 2, side % 2 == 1);
        for i in 0..n {
            for j in 0..n {
                let at = |di: i32, dj: i32| {
                    let mut at = IVec3::ZERO;
                    at[axis] = if far { n } else { 0 };
                    at[(axis + 1) % 3] = i + di;
                    at[(axis + 2) % 3] = j + dj;
                    at
                };
                let corners = [at(0, 0), at(1, 0), at(1, 1), at(0, 1)];
                let key = corners[0].to_array().map(|i| i as u32);
                let k = usize::from(noise(seed, key, 7 + side as u64) < 0.5);
                let [a, b, c, d] = std::array::from_fn(|m| vertex(corners[(m + k) % 4]));
                for [p, q, r] in [[a, b, c], [a, c, d]] {
                    out.push(if far { [p, q, r] } else { [p, r, q] });
                }
            }
        }
    }
    out
}

fn moved(triangles: Vec<Corners>, by: Vec3) -> Vec<Corners> {
    triangles.into_iter().map(|t| t.map(|p| p + by)).collect()
}

/// Smooth, uneven and flat, tiny and huge, here and far away.
pub fn surfaces() -> Vec<Closed> {
    let (o, half) = (Vec3::ZERO, Vec3::splat(0.5));
    let hall = Vec3::new(12.0, 3.0, 8.0);
    let here = Vec3::new(711.3, -245.7, 505.1);
    let flat = Vec3::new(20.0, 0.02, 20.0);
    vec![
        Closed::new("sphere", ball(4, 0.0, Vec3::splat(10.0), 1), o, 10.0 * half),
        Closed::new("uneven ball", ball(3, 0.3, Vec3::splat(7.0), 2), o, 7.0 * half),
        Closed::new("flat ball", ball(3, 0.3, flat, 3), o, flat * half),
        Closed::new(
            "box on a lattice",
            room(16, Vec3::splat(16.0), 0.0, 0.0, 4),
            o,
            16.0 * 0.8 * half,
        ),
        Closed::new("box, irregular", room(20, hall, 0.3, 0.0, 5), o, hall * 0.8 * half),
        Closed::new("room with uneven walls", room(24, hall, 0.3, 0.3, 6), o, hall * 0.8 * half),
        Closed::new(
            "room far away",
            moved(room(16, hall, 0.3, 0.2, 7), here),
            here,
            hall * 0.8 * half,
        ),
        Closed::new(
            "tiny room",
            room(12, hall * 2f32.powi(-30), 0.3, 0.2, 8),
            o,
            hall * 2f32.powi(-30) * 0.8 * half,
        ),
        Closed::new(
            "huge room",
            room(12, hall * 2f32.powi(20), 0.3, 0.2, 9),
            o,
            hall * 2f32.powi(20) * 0.8 * half,
        ),
        Closed::new("octahedron", ball(0, 0.0, Vec3::splat(4.0), 10), o, 4.0 * Vec3::splat(0.3)),
    ]
}

//! One ray, one triangle, and little hope.

use enf_geometry::Ray;
use glam::Vec3;

use super::{Corners, Random};

/// What is hard about a triangle and its ray.
pub const KINDS: [&str; 10] = [
    "ordinary",
    "grazing",
    "needle",
    "through the origin",
    "grazing, through the origin",
    "at the bound",
    "tiny, a diagonal away",
    "lattice",
    "along an axis",
    "nearly a line",
];

/// A point with coordinates up to `s`, which are attained.
pub fn anywhere(random: &mut Random, s: f32) -> Vec3 {
    let mut p = s * random.cube();
    for i in 0..3 {
        match random.below(12) {
            0 => p[i] = s,
            1 => p[i] = -s,
            2 => p[i] = (s - 1e-6 * random.unit() * s).min(s),
            _ => {}
        }
    }
    p
}

/// A ray and a triangle with coordinates up to `s`, and which of [`KINDS`] they are.
pub fn hard(random: &mut Random, s: f32) -> (usize, Ray, Corners) {
    let inside = |p: Vec3| p.clamp(Vec3::splat(-s), Vec3::splat(s));
    let toward = |p: Vec3, o: Vec3| (p - o).try_normalize().unwrap_or(Vec3::Z);
    let small = |random: &mut Random, digits: f32| libm::exp2f(-digits * random.unit());
    let kind = random.below(KINDS.len());
    let mut t = [anywhere(random, s), anywhere(random, s), anywhere(random, s)];
    let mut origin = anywhere(random, s);
    let mix = |random: &mut Random, t: &Corners| {
        let (mut u, mut v) = (random.unit(), random.unit());
        if u + v > 1.0 {
            (u, v) = (1.0 - u, 1.0 - v);
        }
        match random.below(4) {
            0 => t[0],
            1 => t[0] + u * (t[1] - t[0]),
            _ => t[0] + u * (t[1] - t[0]) + v * (t[2] - t[0]),
        }
    };
    let mut direction = None;
    match kind {
        1 => {
            let (p, q) = (mix(random, &t), mix(random, &t));
            let tilt = small(random, 26.0);
            origin = inside(p + 2.0 * (p - q) + tilt * s * random.cube());
        }
        2 => {
            let width = small(random, 26.0);
            t[2] = inside(t[0] + random.unit() * (t[1] - t[0]) + width * s * random.cube());
        }
        3 => origin = inside(mix(random, &t)),
        4 => {
            origin = inside(mix(random, &t));
            let width = small(random, 24.0);
            t[2] = inside(t[0] + random.unit() * (t[1] - t[0]) + width * s * random.cube());
        }
        5 => {
            let bound = |p: Vec3| p.map(|x| if x < 0.0 { -s } else { s });
            let axis = random.below(3);
            for p in &mut t {
                let free = p[axis];
                *p = bound(*p);
                if random.below(3) > 0 {
                    p[axis] = free;
                }
            }
            if random.below(2) == 0 {
                origin = bound(origin);
            }
        }
        6 => {
            let far = random.cube().map(|x| if x < 0.0 { -s } else { s });
            let size = small(random, 22.0) * s;
            t = [0, 1, 2]
                .map(|_| inside(far - size * far / s * random.unit() + size * random.cube()));
            origin = -far;
        }
        7 => {
            let n = [4, 64, 1024][random.below(3)];
            let snap = |p: Vec3| (p * (n as f32 / s)).round() * (s / n as f32);
            t = t.map(snap);
            origin = snap(origin);
            direction = Some(toward(snap(mix(random, &t)), origin));
        }
        8 => {
            let target = mix(random, &t);
            let axis = random.below(3);
            let mut d = Vec3::ZERO;
            d[axis] = if random.below(2) == 0 { 1.0 } else { -1.0 };
            for i in (0..3).filter(|&i| i != axis) {
                origin[i] = target[i].clamp(-s, s);
                d[i] = [0.0, -0.0, 1e-38, -1e-20, 1e-9][random.below(5)];
            }
            direction = Some(d);
        }
        9 => {
            let (p, q) = (mix(random, &t), mix(random, &t));
            let step = small(random, 20.0);
            t = [p, inside(p + step * (q - p)), inside(p + 0.5 * step * (q - p))];
            let k = random.below(3);
            t[random.below(3)][k] = t[0][k].next_up().clamp(-s, s);
        }
        _ => {}
    }
    let target = mix(random, &t);
    let direction = direction.unwrap_or_else(|| toward(target, origin));
    (kind, Ray { origin, direction }, t)
}

//! The canonical intersection: right, watertight, within its margin.

mod common;

use common::closed::octahedron;
use common::{Random, delta};
use enf_geometry::{PreparedRay, Ray, intersect};
use glam::{DVec3, Vec3};
use proptest::prelude::*;

fn hit(ray: &Ray, t: [Vec3; 3], delta: f32) -> Option<(f32, f32, f32)> {
    intersect(&PreparedRay::new(ray), t[0], t[1], t[2], delta)
}

/// How far the reported point of the ray is from the reported point of the triangle.
fn gap(ray: &Ray, [a, b, c]: [Vec3; 3], (t, u, v): (f32, f32, f32)) -> f64 {
    let [a, b, c] = [a, b, c].map(|p| p.as_dvec3());
    let on_ray = ray.origin.as_dvec3() + f64::from(t) * ray.direction.as_dvec3();
    (on_ray - (a + f64::from(u) * (b - a) + f64::from(v) * (c - a))).length()
}

/// Moeller and Trumbore in f64: `(t, u, v)` and how far inside the weights are.
fn reference(ray: &Ray, [a, b, c]: [Vec3; 3]) -> (f64, f64, f64, f64) {
    let [a, b, c, o, d] = [a, b, c, ray.origin, ray.direction].map(|p| p.as_dvec3());
    let (e1, e2) = (b - a, c - a);
    let p: DVec3 = d.cross(e2);
    let scale = 1.0 / e1.dot(p);
    let s = o - a;
    let u = s.dot(p) * scale;
    let q = s.cross(e1);
    let v = d.dot(q) * scale;
    (e2.dot(q) * scale, u, v, u.min(v).min(1.0 - u - v))
}

const UNIT: [Vec3; 3] = [Vec3::ZERO, Vec3::X, Vec3::Y];

#[test]
fn a_unit_triangle_from_both_sides() {
    for (z, direction) in [(2.0, Vec3::NEG_Z), (-2.0, Vec3::Z)] {
        let ray = Ray { origin: Vec3::new(0.25, 0.5, z), direction };
        assert_eq!(hit(&ray, UNIT, 1e-5), Some((2.0, 0.25, 0.5)));
    }
}

#[test]
fn behind_the_origin_t_is_negative() {
    let ray = Ray { origin: Vec3::new(0.25, 0.25, 2.0), direction: Vec3::Z };
    assert_eq!(hit(&ray, UNIT, 1e-5), Some((-2.0, 0.25, 0.25)));
}

#[test]
fn corners_and_edges_belong_to_the_triangle() {
    for (x, y) in [(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (0.0, 0.5), (0.5, 0.0)] {
        let ray = Ray { origin: Vec3::new(x, y, 1.0), direction: Vec3::NEG_Z };
        assert_eq!(hit(&ray, UNIT, 1e-5), Some((1.0, x, y)));
    }
}

#[test]
fn nothing_without_area_is_hit() {
    let ray = Ray { origin: Vec3::new(0.5, 0.0, 1.0), direction: Vec3::NEG_Z };
    for c in [Vec3::ZERO, Vec3::X, 0.5 * Vec3::X, 2.0 * Vec3::X] {
        assert_eq!(hit(&ray, [Vec3::ZERO, Vec3::X, c], 1e-5), None);
    }
    // Collinear, but not after f32 has projected it.
    let mut random = Random(1);
    for _ in 0..20_000 {
        let k = Vec3::new(3.0, 5.0, 7.0) * (1.0 / 64.0);
        let line = [k, 2.0 * k, 4.0 * k];
        let origin = random.cube();
        let direction = (3.0 * random.unit() * k - origin).normalize();
        assert_eq!(hit(&Ray { origin, direction }, line, 1e-5), None);
    }
}

#[test]
fn numbers_that_are_none_hit_nothing() {
    let bad = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, -3e38];
    for x in bad {
        let good = Ray { origin: Vec3::new(0.2, 0.2, 1.0), direction: Vec3::NEG_Z };
        for i in 0..3 {
            for axis in 0..3 {
                let mut triangle = UNIT;
                triangle[i][axis] = x;
                if let Some(found) = hit(&good, triangle, 1e-5) {
                    assert!(gap(&good, triangle, found) <= 1.0001e-5);
                }
                let mut ray = good;
                ray.origin[axis] = x;
                if let Some(found) = hit(&ray, UNIT, 1e-5) {
                    assert!(gap(&ray, UNIT, found) <= 1.0001e-5);
                }
                let mut ray = good;
                ray.direction[axis] = x;
                if !x.is_finite() {
                    assert_eq!(hit(&ray, UNIT, 1e-5), None);
                }
            }
        }
        if x.is_nan() {
            assert_eq!(hit(&good, UNIT, x), None);
        }
    }
    let still = Ray { origin: Vec3::new(0.2, 0.2, 0.0), direction: Vec3::ZERO };
    assert_eq!(hit(&still, UNIT, 1.0), None);
}

#[test]
fn clear_hits_and_misses_agree_with_f64() {
    let mut random = Random(2);
    let (mut hits, mut misses) = (0, 0);
    for _ in 0..200_000 {
        let triangle = [10.0 * random.cube(), 10.0 * random.cube(), 10.0 * random.cube()];
        let ray = Ray { origin: 10.0 * random.cube(), direction: random.direction() };
        let (t, u, v, inside) = reference(&ray, triangle);
        let found = hit(&ray, triangle, delta(10.0));
        if inside > 1e-3 {
            let (ft, fu, fv) = found.expect("a clear hit");
            let steep = 1e-3;
            assert!((f64::from(ft) - t).abs() < steep * t.abs().max(1.0), "{ft} {t}");
            assert!((f64::from(fu) - u).abs() < steep && (f64::from(fv) - v).abs() < steep);
            hits += 1;
        } else if inside < -1e-3 {
            assert_eq!(found, None);
            misses += 1;
        }
    }
    assert!(hits > 5_000 && misses > 50_000, "{hits} {misses}");
}

/// A closed surface of triangles around the origin: a subdivided, shaken octahedron.
fn closed(random: &mut Random, level: u32, squash: Vec3) -> Vec<[Vec3; 3]> {
    let seed = random.bits();
    let shaken = |p: Vec3| {
        let key = p
            .to_array()
            .iter()
            .fold(seed, |h, x| Random(h ^ u64::from((x + 0.0).to_bits())).bits());
        p * (1.0 + 0.3 * Random(key).unit()) * squash
    };
    octahedron(level).into_iter().map(|t| t.map(shaken)).collect()
}

#[test]
fn no_ray_leaves_a_closed_mesh() {
    let mut random = Random(3);
    for round in 0..60 {
        let flat = 10f32.powi(-(round % 4));
        let squash = 20.0 * Vec3::new(1.0, flat, 1.0);
        let shift = if round % 2 == 0 { Vec3::ZERO } else { Vec3::new(11.3, 7.7, -5.1) };
        let mesh: Vec<_> =
            closed(&mut random, 2, squash).into_iter().map(|t| t.map(|p| p + shift)).collect();
        let tolerance = delta(40.0);
        for i in 0..mesh.len() {
            let [a, b, _] = mesh[i];
            let middle = Vec3::new(1.0, flat, 1.0) * random.cube();
            for target in [a, b, 0.5 * (a + b), a + random.unit() * (b - a)] {
                let origin = shift + middle;
                let ray = Ray { origin, direction: (target - origin).normalize() };
                let prepared = PreparedRay::new(&ray);
                let escaped = !mesh.iter().any(|&t| {
                    intersect(&prepared, t[0], t[1], t[2], tolerance).is_some_and(|h| {
                        assert!(gap(&ray, t, h) <= f64::from(tolerance) * 1.000_001);
                        h.0 > 0.0
                    })
                });
                assert!(!escaped, "round {round}: {ray:?}");
            }
        }
    }
}

/// Needles and grazing triangles, for which a plain f32 test is metres off (design: the margin rule).
#[test]
fn every_hit_keeps_the_margin_and_plain_f32_does_not() {
    let mut random = Random(4);
    let (mut hits, mut plain_off) = (0, 0);
    let tolerance = delta(20.0);
    for _ in 0..400_000 {
        let a = 20.0 * random.cube();
        let along = 10.0 * random.direction();
        let width = 10f32.powf(-7.0 * random.unit());
        let triangle = [a, a + along, a + random.unit() * along + width * random.cube()];
        let target = a + random.unit() * along;
        let tilt = 10f32.powf(-4.0 * random.unit());
        let origin = target - 15.0 * (along.normalize() + tilt * random.cube()).normalize();
        let ray = Ray { origin, direction: (target - origin).normalize() };
        if let Some(found) = hit(&ray, triangle, tolerance) {
            hits += 1;
            assert!(gap(&ray, triangle, found) <= f64::from(tolerance) * 1.000_001);
            assert!(found.1 >= 0.0 && found.2 >= 0.0 && found.1 + found.2 <= 1.000_001);
        }
        if let Some(found) = plain(&ray, triangle) {
            plain_off += usize::from(gap(&ray, triangle, found) > 0.01);
        }
    }
    assert!(hits > 10_000 && plain_off > 10, "{hits} hits, {plain_off} bad ones in plain f32");
}

/// Woop, Benthin and Wald as published, for comparison (ray along its longest axis).
fn plain(ray: &Ray, t: [Vec3; 3]) -> Option<(f32, f32, f32)> {
    let d = ray.direction;
    let z = (0..3).max_by(|&i, &j| d[i].abs().total_cmp(&d[j].abs()))?;
    let (x, y) = ((z + 1) % 3, (z + 2) % 3);
    let (sx, sy, sz) = (d[x] / d[z], d[y] / d[z], 1.0 / d[z]);
    let [a, b, c] = t.map(|p| {
        let p = p - ray.origin;
        [p[x] - sx * p[z], p[y] - sy * p[z], sz * p[z]]
    });
    let u = c[0] * b[1] - c[1] * b[0];
    let v = a[0] * c[1] - a[1] * c[0];
    let w = b[0] * a[1] - b[1] * a[0];
    if (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0) || u + v + w == 0.0 {
        return None;
    }
    let det = u + v + w;
    Some(((u * a[2] + v * b[2] + w * c[2]) / det, v / det, w / det))
}

proptest! {
    /// The corners' order changes weights, never the verdict.
    #[test]
    fn the_verdict_does_not_depend_on_winding(seed in any::<u64>()) {
        let mut random = Random(seed);
        let zoo = common::zoo(&mut random, 20, 30.0);
        let tolerance = delta(30.0);
        for &[a, b, c] in &zoo {
            let ray = common::ray(&mut random, &zoo, 30.0);
            let first = hit(&ray, [a, b, c], tolerance);
            for other in [[b, c, a], [c, a, b], [b, a, c], [a, c, b], [c, b, a]] {
                prop_assert_eq!(hit(&ray, other, tolerance).is_some(), first.is_some());
            }
            if let Some(found) = first {
                prop_assert!(gap(&ray, [a, b, c], found) <= f64::from(tolerance) * 1.000_001);
            }
        }
    }
}

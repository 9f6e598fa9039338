//! The margin rule, and which triangles are hit at all, against exact arithmetic.
//!
//! Products of two `f32` are exact in `f64`, so the signs of the edge functions of the projected corners can be had
//! exactly: that is the whole verdict. How far a hit is off is a sum of a few such products, which `f64`
//! knows to better than [`SLACK`] of the tolerance.

mod common;

use common::hard::{KINDS, hard};
use common::{Corners, Random};
use enf_geometry::{PreparedRay, Ray, intersect};
use glam::Vec3;

/// What `f64` may be wrong by when it measures a gap, in tolerances. With coordinates up to `S = 2^19 delta`, every
/// intermediate result is below `8 S`, rounded by `2^-53` of that at most; there are fewer than 16 on the way to each
/// coordinate: `2^7 2^-53 S = 2^-27 delta`, and less than twice that along three axes.
const SLACK: f64 = 1.0 / (1u64 << 26) as f64;

/// How far the reported point of the ray is from the reported point of the triangle, m.
fn gap(ray: &Ray, [a, b, c]: Corners, (t, u, v): (f32, f32, f32)) -> f64 {
    let o = ray.origin.as_dvec3();
    let [a, b, c] = [a, b, c].map(|p| p.as_dvec3() - o);
    let on_ray = f64::from(t) * ray.direction.as_dvec3();
    (on_ray - (a + f64::from(u) * (b - a) + f64::from(v) * (c - a))).length()
}

/// Whether a ray hits, by the exact signs of the edge functions (Woop, Benthin and Wald 2013, section 3) of the
/// corners as `f32` projects them. Both sides count, and so do edges.
fn is_hit(ray: &Ray, corners: Corners) -> bool {
    let d = ray.direction;
    let longest = d.abs().max_element();
    let z = (0..3).find(|&i| d[i].abs() == longest).unwrap();
    let (x, y) = ((z + 1) % 3, (z + 2) % 3);
    let (sx, sy) = (d[x] / d[z], d[y] / d[z]);
    let projected = corners.map(|p| {
        let p = p - ray.origin;
        [p[x] - sx * p[z], p[y] - sy * p[z]].map(f64::from)
    });
    // Compared rather than subtracted: exact.
    let side = |p: [f64; 2], q: [f64; 2]| (q[0] * p[1]).total_cmp_zero(q[1] * p[0]);
    let [a, b, c] = projected;
    let sides = [side(b, c), side(c, a), side(a, b)];
    let (low, high) = (sides.contains(&-1), sides.contains(&1));
    low != high && !is_flat(corners)
}

trait CompareZero {
    /// -1, 0 or 1; zeros are equal.
    fn total_cmp_zero(self, other: Self) -> i32;
}

impl CompareZero for f64 {
    fn total_cmp_zero(self, other: Self) -> i32 {
        i32::from(self > other) - i32::from(self < other)
    }
}

fn is_flat([a, b, c]: Corners) -> bool {
    let [a, b, c] = [a, b, c].map(|p| p.as_dvec3());
    let (e, f) = (b - a, c - a);
    e.y * f.z == e.z * f.y && e.z * f.x == e.x * f.z && e.x * f.y == e.y * f.x
}

/// As published, in `f32` throughout: for showing that the cases are hard.
fn plain(ray: &Ray, corners: Corners) -> Option<(f32, f32, f32)> {
    let d = ray.direction;
    let longest = d.abs().max_element();
    let z = (0..3).find(|&i| d[i].abs() == longest)?;
    let (x, y) = ((z + 1) % 3, (z + 2) % 3);
    let (sx, sy, sz) = (d[x] / d[z], d[y] / d[z], 1.0 / d[z]);
    let [a, b, c] = corners.map(|p| {
        let p = p - ray.origin;
        [p[x] - sx * p[z], p[y] - sy * p[z], sz * p[z]]
    });
    let (u, v, w) =
        (c[0] * b[1] - c[1] * b[0], a[0] * c[1] - a[1] * c[0], b[0] * a[1] - b[1] * a[0]);
    let sum = u + v + w;
    let mixed = (u < 0.0 || v < 0.0 || w < 0.0) && (u > 0.0 || v > 0.0 || w > 0.0);
    (!mixed && sum != 0.0).then(|| ((u * a[2] + v * b[2] + w * c[2]) / sum, v / sum, w / sum))
}

#[test]
fn every_hit_within_the_bound_keeps_the_margin_and_no_other_triangle_is_hit() {
    let mut random = Random(0xE1);
    let mut hits = [0; KINDS.len()];
    let mut cases = [0; KINDS.len()];
    let (mut widest, mut plain_off) = ([0.0f64; KINDS.len()], 0);
    for i in 0..1_000_000 {
        let s = libm::exp2f([6.0, 0.0, -11.0, 13.0, 30.0][i % 5]);
        let delta = s / (1 << 19) as f32;
        let (kind, ray, t) = hard(&mut random, s);
        assert!(t.iter().chain([&ray.origin]).all(|p| p.abs().max_element() <= s), "{ray:?} {t:?}");
        cases[kind] += 1;
        let found = intersect(&PreparedRay::new(&ray), t[0], t[1], t[2], delta);
        let case = || format!("case {i}, {}: {ray:?} {t:?} {found:?}", KINDS[kind]);
        assert_eq!(found.is_some(), is_hit(&ray, t), "{}", case());
        if let Some((distance, u, v)) = found {
            hits[kind] += 1;
            let off = gap(&ray, t, (distance, u, v)) / f64::from(delta);
            assert!(off <= 1.0 + SLACK, "off by {off}: {}", case());
            assert!(u >= 0.0 && v >= 0.0 && u + v <= 1.0 + 2f32.powi(-22), "{}", case());
            widest[kind] = widest[kind].max(off);
        }
        if let Some(found) = plain(&ray, t) {
            plain_off += usize::from(gap(&ray, t, found) > 100.0 * f64::from(delta));
        }
    }
    println!(
        "{KINDS:?}\ncases {cases:?}\nhits {hits:?}\noff by, at most {widest:?}\nplain f32 far off: {plain_off}"
    );
    for (kind, &n) in hits.iter().enumerate() {
        assert!(n > 20_000, "{}: {n} hits of {}", KINDS[kind], cases[kind]);
    }
    assert!(plain_off > 1000, "{plain_off}");
}

/// Origins far away: hits may be given up, but what is reported keeps the margin.
#[test]
fn beyond_the_bound_hits_keep_the_margin_too() {
    let mut random = Random(0xE2);
    let (mut hits, mut given_up) = (0, 0);
    for i in 0..300_000 {
        let s = 64.0;
        let delta = s / (1 << 19) as f32;
        let (_, ray, t) = hard(&mut random, s);
        let far = libm::exp2f((i % 40) as f32 * 0.5);
        let origin = ray.origin - far * s * ray.direction;
        let ray = Ray { origin, direction: ray.direction };
        let slack = SLACK * f64::from(far + 1.0);
        match intersect(&PreparedRay::new(&ray), t[0], t[1], t[2], delta) {
            Some(found) => {
                hits += 1;
                let off = gap(&ray, t, found) / f64::from(delta);
                assert!(off <= 1.0 + slack, "off by {off}: {ray:?} {t:?} {found:?}");
            }
            None => given_up += usize::from(is_hit(&ray, t)),
        }
    }
    println!("{hits} hits, {given_up} given up");
    assert!(hits > 50_000 && given_up > 0);
}

/// Triangles that are larger than their tolerance says, too.
#[test]
fn triangles_beyond_the_bound_keep_the_margin_too() {
    let mut random = Random(0xE3);
    let mut hits = 0;
    for i in 0..300_000 {
        let s = 64.0;
        let delta = s * libm::exp2f(-19.0 - (i % 12) as f32);
        let (_, ray, t) = hard(&mut random, s);
        if let Some(found) = intersect(&PreparedRay::new(&ray), t[0], t[1], t[2], delta) {
            hits += 1;
            let off = gap(&ray, t, found) / f64::from(delta);
            assert!(
                off <= 1.0 + SLACK * 2f64.powi(i % 12),
                "off by {off}: {ray:?} {t:?} {found:?}"
            );
        }
    }
    assert!(hits > 50_000, "{hits}");
}

/// The tilted wall of a closed answer: `t` by hand, on both sides of the bound.
#[test]
fn a_wall_at_the_bound_is_hit_where_it_is() {
    for exponent in [-20, 0, 6, 20] {
        let s = 2f32.powi(exponent);
        let delta = s / (1 << 19) as f32;
        let wall = [Vec3::new(s, -s, -s), Vec3::new(s, s, -s), Vec3::new(s, 0.0, s)];
        for (origin, far) in [(-s, 2.0), (0.0, 1.0), (s, 0.0), (-0.5 * s, 1.5)] {
            let ray = Ray { origin: Vec3::new(origin, 0.0, 0.0), direction: Vec3::X };
            let [a, b, c] = wall;
            let found = intersect(&PreparedRay::new(&ray), a, b, c, delta);
            assert_eq!(found, Some((far * s, 0.25, 0.5)));
        }
        // A tolerance that is too small for these coordinates changes nothing here: f64 answers the same.
        let ray = Ray { origin: Vec3::ZERO, direction: Vec3::X };
        let [a, b, c] = wall;
        let tight = intersect(&PreparedRay::new(&ray), a, b, c, 0.25 * delta);
        assert_eq!(tight, Some((s, 0.25, 0.5)));
    }
}

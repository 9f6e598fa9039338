//! Frames and directions. Sines come from the `libm` crate: the system's differ in the last bit.

use glam::{DVec3, Vec3};

/// Two unit vectors that make a right-handed frame with the unit vector `n` (Duff et al. 2017, JCGT 6(1)).
#[inline(always)]
pub fn frame(n: Vec3) -> (Vec3, Vec3) {
    let sign = if n.z >= 0.0 { 1.0f32 } else { -1.0 };
    let a = -1.0 / (sign + n.z);
    let b = n.x * n.y * a;
    (
        Vec3::new(1.0 + sign * n.x * n.x * a, sign * b, -sign * n.x),
        Vec3::new(b, sign + n.y * n.y * a, -n.y),
    )
}

/// A direction about `n` with density cos(theta)/pi, from two uniform numbers.
#[inline]
pub fn cosine(n: Vec3, u1: f32, u2: f32) -> Vec3 {
    cosine_by(n, u1, libm::sincosf(core::f32::consts::TAU * u2))
}

/// [`cosine`], when sine and cosine of its second number's angle are known.
#[inline(always)]
pub(crate) fn cosine_by(n: Vec3, u1: f32, (sin, cos): (f32, f32)) -> Vec3 {
    let radius = u1.sqrt();
    let (t, b) = frame(n);
    // max: a direction in the surface itself would never leave it.
    let height = (1.0 - u1).max(1e-8).sqrt();
    (t * (radius * cos) + b * (radius * sin) + n * height).normalize()
}

/// Sine and cosine of `u` turns, for `u` in `[0, 1)`: the bits of `libm::sincosf(TAU * u)`, without a branch. The quarters,
/// the polynomials and their coefficients are those of FreeBSD's `s_sinf.c`, `k_sinf.c` and `k_cosf.c`.
#[inline(always)]
pub(crate) fn around(u: f32) -> (f32, f32) {
    use core::f64::consts::FRAC_PI_2;
    let x = core::f32::consts::TAU * u;
    // Where pi/4, 3 pi/4, 5 pi/4 and 7 pi/4 end.
    let beyond = |bits: u32| x.to_bits() > bits;
    let [second, third, fourth, fifth] =
        [beyond(0x3f49_0fda), beyond(0x4016_cbe3), beyond(0x407b_53d1), beyond(0x40af_eddf)];
    let (odd, wide) = ((second & !third) | (fourth & !fifth), f64::from(x));
    let mut y = wide;
    y = if second { FRAC_PI_2 - wide } else { y };
    y = if third { wide - 2.0 * FRAC_PI_2 } else { y };
    y = if fourth { wide - 3.0 * FRAC_PI_2 } else { y };
    y = if fifth { wide - 4.0 * FRAC_PI_2 } else { y };

    let z = y * y;
    let w = z * z;
    let r = -0.000_198_393_348_360_966_32 + z * 0.000_002_718_311_493_989_822;
    let s = z * y;
    let sin = (y + s * (-0.166_666_666_416_265_24 + z * 0.008_333_329_385_889_463)) + s * w * r;
    let r = -0.001_388_676_377_460_993 + z * 0.000_024_390_448_796_277_41;
    let cos = ((1.0 + z * -0.499_999_997_251_031) + w * 0.041_666_623_323_739_06) + (w * z) * r;
    let (sin, cos) = (sin as f32, cos as f32);

    let (a, b) = if odd { (cos, sin) } else { (sin, cos) };
    let a = if third & !fifth { -a } else { a };
    let b = if third & !fourth { -b } else { b };
    (a, b)
}

/// A uniform direction on the sphere, from two uniform numbers.
pub fn sphere(u1: f32, u2: f32) -> Vec3 {
    let z = 1.0 - 2.0 * u1;
    let radius = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = libm::sincosf(core::f32::consts::TAU * u2);
    Vec3::new(radius * cos, radius * sin, z).normalize()
}

/// Barycentric coordinates of the corners 1 and 2 of a uniform point on a triangle (Turk 1990).
pub fn triangle(u1: f32, u2: f32) -> (f32, f32) {
    let root = u1.sqrt();
    (root * (1.0 - u2), root * u2)
}

/// The point of a triangle with barycentric coordinates `u` and `v` of the corners 1 and 2, but not nearer to an edge than
/// `margin`, m, so that rounding cannot put it beyond a surface that meets this one there. A triangle that is too
/// narrow is kept clear as far as it goes; a point is never moved by more than two margins,
/// so that it lies in no other room than what met it, but for delta.
#[inline]
pub fn off_edges([a, b, c]: [DVec3; 3], u: f64, v: f64, margin: f64) -> DVec3 {
    let (ab, bc, ca) = (b - a, c - b, a - c);
    let point = a * (1.0 - u - v) + b * u + c * v;
    // The distance from an edge is twice the area over the edge's length, times the weight of the corner across.
    let squares = [bc, ca, ab].map(|edge| edge.length_squared());
    let longest = squares[0].max(squares[1]).max(squares[2]);
    let least = (1.0 - u - v).min(u).min(v).max(0.0);
    let twice = ab.cross(ca);
    if least * least * twice.length_squared() >= margin * margin * longest {
        return point;
    }
    clear_of_edges([a, b, c], twice.length(), squares.map(f64::sqrt), point, margin)
}

/// The point nearest to `point` in the triangle whose edges are drawn in by `margin`: a smaller one about the same centre.
#[cold]
fn clear_of_edges(
    corners: [DVec3; 3],
    twice: f64,
    lengths: [f64; 3],
    point: DVec3,
    margin: f64,
) -> DVec3 {
    let around = lengths[0] + lengths[1] + lengths[2];
    let (radius, centre) = (
        twice / around,
        (corners[0] * lengths[0] + corners[1] * lengths[1] + corners[2] * lengths[2]) / around,
    );
    if radius.is_nan() || radius <= 0.0 {
        return point;
    }
    let inner = corners.map(|p| centre + (p - centre) * (1.0 - margin / radius).max(0.5));
    let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
    let (mut nearest, mut inside) = (point, true);
    let mut best = f64::INFINITY;
    for i in 0..3 {
        let (from, edge) = (inner[i], inner[(i + 1) % 3] - inner[i]);
        inside &= normal.cross(edge).dot(point - from) >= 0.0;
        let along = ((point - from).dot(edge) / edge.length_squared()).clamp(0.0, 1.0);
        let candidate = from + edge * along;
        let square = candidate.distance_squared(point);
        if square < best {
            (best, nearest) = (square, candidate);
        }
    }
    if inside { point } else { point + (nearest - point).clamp_length_max(2.0 * margin) }
}

/// The top 24 bits of a 32-bit fraction as a number in `[0, 1)`.
pub fn fraction(bits: u32) -> f32 {
    crate::rng::unit(bits)
}

/// Luminous weight of linear Rec.709: 0.2126 R + 0.7152 G + 0.0722 B.
#[inline]
pub fn luminance(rgb: Vec3) -> f32 {
    0.2126 * rgb.x + 0.7152 * rgb.y + 0.0722 * rgb.z
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Distances of a point in a triangle's plane from its edges, positive inside.
    fn distances(corners: [DVec3; 3], point: DVec3) -> [f64; 3] {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        [0, 1, 2].map(|i| {
            let edge = corners[(i + 1) % 3] - corners[i];
            normal.cross(edge).normalize().dot(point - corners[i])
        })
    }

    fn number() -> impl Strategy<Value = f64> {
        -50.0..50.0
    }

    /// A weight that is often nothing, or next to it.
    fn weight() -> impl Strategy<Value = f64> {
        prop_oneof![Just(0.0), 0.0..1e-6, 0.0..1.0f64]
    }

    proptest! {
        #[test]
        fn starts_stay_off_edges(
            c in [[number(), number(), number()], [number(), number(), number()], [number(), number(), number()]],
            w in [weight(), weight(), weight()],
        ) {
            let corners = c.map(DVec3::from_array);
            let sum: f64 = w.iter().sum();
            let w = if sum > 0.0 { w.map(|w| w / sum) } else { [1.0, 0.0, 0.0] };
            let margin = 3e-5;
            let before = corners[0] * w[0] + corners[1] * w[1] + corners[2] * w[2];
            let after = off_edges(corners, w[1], w[2], margin);
            let moved = after.distance(before);
            prop_assert!(moved <= 2.0 * margin + 1e-9, "moved by {moved}");
            let kept = distances(corners, before).iter().all(|&d| d >= margin);
            prop_assert!(!kept || moved < 1e-9, "it was clear already");
            let sides = [0, 1, 2].map(|i| corners[(i + 1) % 3] - corners[i]);
            let least = (0..3).map(|i| sides[i].angle_between(-sides[(i + 2) % 3])).fold(4.0, f64::min);
            let distances = distances(corners, after);
            // From the tip of a sharp corner it would have to go farther to be quite clear.
            let part = (2.0 * (0.5 * least).sin()).min(1.0);
            let needed = if least > 0.15 { part * margin * 0.999 } else { -1e-9 };
            prop_assert!(distances.iter().all(|&d| d >= needed), "{distances:?}, angle {least}");
        }

        #[test]
        fn frames_are_orthonormal(u in 0.0f32..1.0, v in 0.0f32..1.0) {
            let n = sphere(u, v);
            let (t, b) = frame(n);
            for d in [t.dot(b), t.dot(n), b.dot(n), t.length() - 1.0, b.length() - 1.0] {
                prop_assert!(d.abs() < 1e-5);
            }
        }
    }

    /// Every number that [`fraction`] makes.
    #[test]
    fn turns_are_those_of_libm() {
        for i in 0..1u32 << 24 {
            let u = fraction(i << 8);
            let (sin, cos) = libm::sincosf(core::f32::consts::TAU * u);
            let ours = around(u);
            assert_eq!((ours.0.to_bits(), ours.1.to_bits()), (sin.to_bits(), cos.to_bits()), "{u}");
        }
    }

    /// The mean of cos(theta) under the density cos/pi is 2/3, that of cos^2 is 1/2.
    #[test]
    fn cosine_moments() {
        let n = Vec3::new(0.36, -0.48, 0.8);
        let (mut m1, mut m2, side) = (0.0f64, 0.0f64, 400);
        for i in 0..side {
            for j in 0..side {
                let d = cosine(n, (i as f32 + 0.5) / side as f32, (j as f32 + 0.5) / side as f32);
                let c = f64::from(d.dot(n));
                m1 += c;
                m2 += c * c;
            }
        }
        let count = f64::from(side * side);
        assert!((m1 / count - 2.0 / 3.0).abs() < 1e-4);
        assert!((m2 / count - 0.5).abs() < 1e-4);
    }
}

//! Frames and directions. Sines come from the `libm` crate: the system's differ in the last bit.

use glam::Vec3;

/// Two unit vectors that make a right-handed frame with the unit vector `n` (Duff et al. 2017, JCGT 6(1)).
#[inline]
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
    let radius = u1.sqrt();
    let (sin, cos) = libm::sincosf(core::f32::consts::TAU * u2);
    let (t, b) = frame(n);
    // max: a direction in the surface itself would never leave it.
    let height = (1.0 - u1).max(1e-8).sqrt();
    (t * (radius * cos) + b * (radius * sin) + n * height).normalize()
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

    proptest! {
        #[test]
        fn frames_are_orthonormal(u in 0.0f32..1.0, v in 0.0f32..1.0) {
            let n = sphere(u, v);
            let (t, b) = frame(n);
            for d in [t.dot(b), t.dot(n), b.dot(n), t.length() - 1.0, b.length() - 1.0] {
                prop_assert!(d.abs() < 1e-5);
            }
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

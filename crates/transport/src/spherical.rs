//! Directions to a triangle, each as likely as any other (Arvo 1995, "Stratified sampling of spherical triangles").

use core::f64::consts::PI;

use glam::DVec3;

/// A triangle as seen from the origin.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Triangle {
    /// Unit vectors to the corners.
    corners: [DVec3; 3],
    /// Angle at the first corner, and the cosine of the side between the first and the second.
    alpha: f64,
    cos_c: f64,
    solid_angle: f64,
}

impl Triangle {
    /// From its corners, relative to the point from which it is seen.
    pub fn new(corners: [DVec3; 3]) -> Self {
        let [a, b, c] = corners.map(DVec3::normalize_or_zero);
        // Van Oosterom and Strackee 1983.
        let volume = a.dot(b.cross(c)).abs();
        let around = 1.0 + a.dot(b) + b.dot(c) + c.dot(a);
        let solid_angle = 2.0 * libm::atan2(volume, around);
        let solid_angle = if solid_angle < 0.0 { solid_angle + 2.0 * PI } else { solid_angle };
        // Between the planes of the sides that meet in the first corner.
        let (ab, ac) = (a.cross(b), a.cross(c));
        let alpha = libm::atan2(ab.cross(ac).length(), ab.dot(ac));
        Self { corners: [a, b, c], alpha, cos_c: a.dot(b), solid_angle }
    }

    /// Its solid angle, sr.
    pub fn solid_angle(&self) -> f64 {
        self.solid_angle
    }

    /// A unit vector to it from two uniform numbers; its density is one over the solid angle.
    pub fn sample(&self, u: f64, v: f64) -> DVec3 {
        let [a, b, c] = self.corners;
        let (sin_alpha, cos_alpha) = libm::sincos(self.alpha);
        // The side opposite to the first corner is cut where what is on the first's side has its share of the area.
        let (s, t) = libm::sincos(u * self.solid_angle - self.alpha);
        let x = t - cos_alpha;
        let y = s + sin_alpha * self.cos_c;
        let q = ((y * t - x * s) * cos_alpha - y) / ((y * s + x * t) * sin_alpha);
        let q = if q.is_finite() { q.clamp(-1.0, 1.0) } else { 1.0 };
        let across = (c - a * c.dot(a)).normalize_or_zero();
        // And a point on the arc from the second corner to that cut.
        let on_side = a * q + across * libm::sqrt((1.0 - q * q).max(0.0));
        let z = 1.0 - v * (1.0 - on_side.dot(b));
        let towards = (on_side - b * on_side.dot(b)).normalize_or_zero();
        (b * z + towards * libm::sqrt((1.0 - z * z).max(0.0))).normalize_or_zero()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    /// Over an octant every coordinate is uniform from 0 to 1.
    #[test]
    fn an_octant() {
        let octant = Triangle::new([DVec3::X * 2.0, DVec3::Y, DVec3::Z * 0.1]);
        assert!((octant.solid_angle() - PI / 2.0).abs() < 1e-12);
        let steps = 200;
        let (mut mean, mut squares) = (DVec3::ZERO, DVec3::ZERO);
        for i in 0..steps * steps {
            let at = |k: i32| (f64::from(k) + 0.5) / f64::from(steps);
            let d = octant.sample(at(i % steps), at(i / steps));
            assert!((d.length() - 1.0).abs() < 1e-9 && d.min_element() > -1e-9);
            (mean, squares) = (mean + d, squares + d * d);
        }
        let n = f64::from(steps * steps);
        assert!((mean / n - 0.5).abs().max_element() < 1e-4, "{}", mean / n);
        assert!((squares / n - 1.0 / 3.0).abs().max_element() < 1e-4, "{}", squares / n);
    }

    /// Directions meet the triangle, and their mean cosine times the solid angle is the vector irradiance (Lambert's
    /// contour sum), also for a triangle that is close, or long and thin.
    #[test]
    fn vector_irradiance() {
        for corners in [
            [Vec3::new(1.0, 0.0, 1.0), Vec3::new(2.0, 1.5, 1.0), Vec3::new(0.0, 1.0, 2.0)],
            [Vec3::new(-5.0, -5.0, 0.1), Vec3::new(5.0, -5.0, 0.1), Vec3::new(0.0, 7.0, 0.1)],
            [Vec3::new(-9.0, 0.0, 1.0), Vec3::new(9.0, 0.0, 1.0), Vec3::new(9.0, 0.1, 1.0)],
        ] {
            let corners = corners.map(Vec3::as_dvec3);
            let triangle = Triangle::new(corners);
            let steps = 300;
            let mut mean = DVec3::ZERO;
            for i in 0..steps * steps {
                let at = |k: i32| (f64::from(k) + 0.5) / f64::from(steps);
                mean += triangle.sample(at(i % steps), at(i / steps));
            }
            mean *= triangle.solid_angle() / f64::from(steps * steps);
            let mut contour = DVec3::ZERO;
            for i in 0..3 {
                let (p, q) = (corners[i].normalize(), corners[(i + 1) % 3].normalize());
                contour += p.cross(q).normalize() * p.dot(q).acos() / 2.0;
            }
            let contour = contour * contour.dot(mean).signum();
            assert!((mean - contour).length() < 2e-3 * contour.length(), "{mean} for {contour}");
        }
    }
}

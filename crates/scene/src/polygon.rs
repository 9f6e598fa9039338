//! Polygons into triangles: a fan where the polygon is convex, ear clipping where it is not, so that a
//! wall drawn as one concave outline round a doorway does not close the doorway.

use glam::{DVec2, DVec3};

/// More corners than this are fanned without a look at their shape.
pub(crate) const EAR_LIMIT: usize = 1024;

fn cross(a: DVec2, b: DVec2, c: DVec2) -> f64 {
    (b.x - a.x) * (c.y - a.y) - (b.y - a.y) * (c.x - a.x)
}

/// Appends `n - 2` triangles (as corner numbers) that keep the polygon's orientation.
pub(crate) fn triangulate(points: &[DVec3], out: &mut Vec<[usize; 3]>) {
    let n = points.len();
    let fan = |out: &mut Vec<[usize; 3]>| out.extend((1..n - 1).map(|i| [0, i, i + 1]));
    if !(4..=EAR_LIMIT).contains(&n) {
        return fan(out);
    }
    // Newell's normal, then drop its largest component.
    let mut normal = DVec3::ZERO;
    for i in 0..n {
        let (p, q) = (points[i] - points[0], points[(i + 1) % n] - points[0]);
        normal += p.cross(q);
    }
    let a = normal.abs();
    let flat: Vec<DVec2> = points
        .iter()
        .map(|&p| {
            if a.z >= a.x && a.z >= a.y {
                DVec2::new(p.x * normal.z.signum(), p.y)
            } else if a.y >= a.x {
                DVec2::new(p.z * normal.y.signum(), p.x)
            } else {
                DVec2::new(p.y * normal.x.signum(), p.z)
            }
        })
        .collect();
    if a.max_element() == 0.0 || !a.is_finite() {
        return fan(out);
    }
    if (0..n).all(|i| cross(flat[i], flat[(i + 1) % n], flat[(i + 2) % n]) > 0.0) {
        return fan(out);
    }
    let mut left: Vec<usize> = (0..n).collect();
    while left.len() > 3 {
        let m = left.len();
        let corner = |i: usize| [left[(i + m - 1) % m], left[i], left[(i + 1) % m]];
        let is_ear = |i: usize| {
            let [a, b, c] = corner(i).map(|k| flat[k]);
            cross(a, b, c) > 0.0
                && left.iter().map(|&k| flat[k]).all(|p| {
                    p == a
                        || p == b
                        || p == c
                        || cross(a, b, p) < 0.0
                        || cross(b, c, p) < 0.0
                        || cross(c, a, p) < 0.0
                })
        };
        // No ear: the outline crosses itself or is flat; take off the most convex corner.
        let i = (0..m).find(|&i| is_ear(i)).unwrap_or_else(|| {
            let turn = |i: usize| {
                let [a, b, c] = corner(i).map(|k| flat[k]);
                cross(a, b, c)
            };
            (0..m).max_by(|&i, &j| turn(i).total_cmp(&turn(j))).unwrap_or(0)
        });
        out.push(corner(i));
        left.remove(i);
    }
    out.push([left[0], left[1], left[2]]);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn area_and_count(points: &[DVec3], normal: DVec3) -> (f64, usize) {
        let mut out = Vec::new();
        triangulate(points, &mut out);
        let areas: Vec<f64> = out
            .iter()
            .map(|&[a, b, c]| {
                0.5 * (points[b] - points[a]).cross(points[c] - points[a]).dot(normal)
            })
            .collect();
        assert!(areas.iter().all(|&a| a >= 0.0), "a triangle is turned over: {areas:?}");
        (areas.iter().sum(), out.len())
    }

    #[test]
    fn a_wall_outline_round_a_doorway_keeps_the_doorway_open() {
        // 4 x 3 m, doorway 1 x 2 m, in the planes x = 0, y = 0 and z = 0, both ways round.
        let outline =
            [(0., 0.), (1.5, 0.), (1.5, 2.), (2.5, 2.), (2.5, 0.), (4., 0.), (4., 3.), (0., 3.)];
        for axis in 0..3 {
            let lift = |(u, v): (f64, f64)| match axis {
                0 => DVec3::new(0., u, v),
                1 => DVec3::new(v, 0., u),
                _ => DVec3::new(u, v, 0.),
            };
            let mut points: Vec<_> = outline.into_iter().map(lift).collect();
            for start in 0..points.len() {
                points.rotate_left(1);
                let (area, n) = area_and_count(&points, DVec3::AXES[axis]);
                assert!((area - 10.0).abs() < 1e-12, "axis {axis} start {start}: {area}");
                assert_eq!(n, 6);
            }
            points.reverse();
            assert!((area_and_count(&points, -DVec3::AXES[axis]).0 - 10.0).abs() < 1e-12);
        }
    }

    #[test]
    fn collinear_corners_and_a_keyhole_are_cut_without_loss() {
        let square = [(0., 0.), (1., 0.), (2., 0.), (2., 2.), (1., 2.), (0., 2.), (0., 1.)];
        let points: Vec<_> = square.iter().map(|&(x, y)| DVec3::new(x, y, 5.)).collect();
        assert_eq!(area_and_count(&points, DVec3::Z), (4.0, 5));
        // A 4 x 4 square with a 2 x 2 hole, joined by a bridge that is walked twice.
        let ring = [
            (0., 0.),
            (4., 0.),
            (4., 4.),
            (0., 4.),
            (0., 0.),
            (1., 1.),
            (1., 3.),
            (3., 3.),
            (3., 1.),
            (1., 1.),
        ];
        let points: Vec<_> = ring.iter().map(|&(x, y)| DVec3::new(x, y, 0.)).collect();
        assert_eq!(area_and_count(&points, DVec3::Z), (12.0, 8));
    }

    #[test]
    fn nonsense_still_gives_triangles() {
        for points in [
            vec![DVec3::ZERO; 6],
            vec![DVec3::NAN; 5],
            vec![DVec3::X, DVec3::ZERO, DVec3::X, DVec3::ZERO, DVec3::Y],
            vec![DVec3::ZERO, DVec3::ONE, DVec3::X, DVec3::new(0., 1., 1.)],
        ] {
            let mut out = Vec::new();
            triangulate(&points, &mut out);
            assert_eq!(out.len(), points.len() - 2);
        }
    }
}

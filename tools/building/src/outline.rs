//! Geometry in plan for walls at any angle: convex pieces, frames, and where two pieces touch.
//!
//! Metres, x to the east, y to the north; outlines are counter-clockwise.

use crate::mesh::{radians, sin_cos};
use glam::DVec2;

/// Lengths below this are the same point, metres.
pub const SAME: f64 = 1e-6;

/// A point in plan.
pub const fn at(x: f64, y: f64) -> DVec2 {
    DVec2::new(x, y)
}

/// A convex counter-clockwise outline.
#[derive(Clone, Debug, PartialEq)]
pub struct Convex(pub Vec<DVec2>);

impl Convex {
    /// The sides, each from one corner to the next; the inside is on their left.
    pub fn sides(&self) -> impl Iterator<Item = (DVec2, DVec2)> + '_ {
        let n = self.0.len();
        (0..n).map(move |i| (self.0[i], self.0[(i + 1) % n]))
    }

    /// Square metres.
    pub fn area(&self) -> f64 {
        self.sides().map(|(p, q)| p.perp_dot(q)).sum::<f64>() / 2.0
    }

    /// The mean of the corners: inside.
    pub fn middle(&self) -> DVec2 {
        self.0.iter().copied().sum::<DVec2>() / self.0.len() as f64
    }

    /// Whether the point is inside, or at most `slack` metres outside each side.
    pub fn holds(&self, point: DVec2, slack: f64) -> bool {
        self.sides().all(|(p, q)| (q - p).perp_dot(point - p) >= -slack * (q - p).length())
    }

    /// Least and greatest corner.
    pub fn bounds(&self) -> (DVec2, DVec2) {
        let first = self.0[0];
        self.0.iter().fold((first, first), |(low, high), &p| (low.min(p), high.max(p)))
    }
}

/// A place and a direction to draw in: local x and y, turned, then moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Where local (0, 0) is.
    pub origin: DVec2,
    /// Turn from x towards y, degrees.
    pub turn: f64,
}

impl Frame {
    /// The plan's own frame.
    pub const PLAN: Self = Self { origin: at(0.0, 0.0), turn: 0.0 };

    /// A frame turned about the plan's origin.
    pub const fn turned(turn: f64) -> Self {
        Self { origin: at(0.0, 0.0), turn }
    }

    /// The local axes in the plan. Quarter turns are exact.
    pub fn axes(&self) -> (DVec2, DVec2) {
        let x = direction(self.turn);
        (x, at(-x.y, x.x))
    }

    /// A local point in the plan.
    pub fn point(&self, x: f64, y: f64) -> DVec2 {
        let (a, b) = self.axes();
        self.origin + a * x + b * y
    }

    /// The local rectangle `x0..x1` by `y0..y1`.
    pub fn rect(&self, x0: f64, y0: f64, x1: f64, y1: f64) -> Convex {
        Convex([(x0, y0), (x1, y0), (x1, y1), (x0, y1)].map(|(x, y)| self.point(x, y)).to_vec())
    }

    /// The outline through local points.
    pub fn outline(&self, points: &[(f64, f64)]) -> Convex {
        Convex(points.iter().map(|&(x, y)| self.point(x, y)).collect())
    }

    /// A plan point in local coordinates.
    pub fn local(&self, point: DVec2) -> DVec2 {
        let (a, b) = self.axes();
        let d = point - self.origin;
        at(d.dot(a), d.dot(b))
    }
}

/// The unit vector at `turn` degrees from x towards y. Quarter turns are exact.
pub fn direction(turn: f64) -> DVec2 {
    let quarters = turn / 90.0;
    if quarters == libm::floor(quarters) {
        return match (quarters as i64).rem_euclid(4) {
            0 => at(1.0, 0.0),
            1 => at(0.0, 1.0),
            2 => at(-1.0, 0.0),
            _ => at(0.0, -1.0),
        };
    }
    let (s, c) = sin_cos(radians(turn));
    at(c, s)
}

/// The turn of a direction, degrees.
pub fn turn_of(d: DVec2) -> f64 {
    libm::atan2(d.y, d.x).to_degrees()
}

/// The part of side `a` that side `b` covers from the other side: a range of distances from `a.0`.
pub fn shared(a: (DVec2, DVec2), b: (DVec2, DVec2)) -> Option<(f64, f64)> {
    let length = (a.1 - a.0).length();
    let d = (a.1 - a.0) / length;
    if d.dot(b.1 - b.0) > 0.0 || [b.0, b.1].iter().any(|&p| d.perp_dot(p - a.0).abs() > SAME) {
        return None;
    }
    let low = d.dot(b.1 - a.0).max(0.0);
    let high = d.dot(b.0 - a.0).min(length);
    (high - low > SAME).then_some((low, high))
}

/// The sides of a union of pieces that are not shared by two of them, those that follow each other
/// in a straight line joined. The inside is on the left.
pub fn boundary(pieces: &[Convex]) -> Vec<(DVec2, DVec2)> {
    let mut sides: Vec<(DVec2, DVec2)> = Vec::new();
    for (i, piece) in pieces.iter().enumerate() {
        for side in piece.sides() {
            let d = (side.1 - side.0).normalize();
            let mut inner: Vec<(f64, f64)> = pieces
                .iter()
                .enumerate()
                .filter(|&(j, _)| j != i)
                .flat_map(|(_, other)| other.sides().filter_map(|s| shared(side, s)))
                .collect();
            inner.sort_by(|a, b| a.0.total_cmp(&b.0));
            let length = (side.1 - side.0).length();
            let mut from = 0.0;
            for (low, high) in inner.into_iter().chain([(length, length)]) {
                if low - from > SAME {
                    sides.push((side.0 + d * from, side.0 + d * low));
                }
                from = f64::max(from, high);
            }
        }
    }
    // Join what goes straight on.
    let mut k = 0;
    while k < sides.len() {
        let (p, q) = sides[k];
        let next = sides.iter().position(|&(a, b)| {
            a.distance(q) < SAME && (q - p).normalize().perp_dot((b - a).normalize()).abs() < SAME
        });
        match next {
            Some(n) if n != k => {
                sides[k].1 = sides[n].1;
                sides.remove(n);
                k = k.saturating_sub(usize::from(n < k));
            }
            _ => k += 1,
        }
    }
    sides
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_l_of_two_rectangles_has_six_sides() {
        let f = Frame { origin: at(3.0, -2.0), turn: 45.0 };
        let l = [f.rect(0.0, 0.0, 4.0, 2.0), f.rect(0.0, 2.0, 2.0, 5.0)];
        let sides = boundary(&l);
        assert_eq!(sides.len(), 6, "{sides:?}");
        let around: f64 = sides.iter().map(|(p, q)| p.distance(*q)).sum();
        assert!((around - 18.0).abs() < 1e-9);
        let area: f64 = sides.iter().map(|(p, q)| p.perp_dot(*q)).sum::<f64>() / 2.0;
        assert!((area - 14.0).abs() < 1e-9);
    }

    #[test]
    fn a_ring_keeps_its_hole() {
        let f = Frame::PLAN;
        let ring = [
            f.rect(0.0, 0.0, 6.0, 1.0),
            f.rect(5.0, 1.0, 6.0, 5.0),
            f.rect(0.0, 5.0, 6.0, 6.0),
            f.rect(0.0, 1.0, 1.0, 5.0),
        ];
        let sides = boundary(&ring);
        assert_eq!(sides.len(), 8);
        let area: f64 = sides.iter().map(|(p, q)| p.perp_dot(*q)).sum::<f64>() / 2.0;
        assert!((area - 20.0).abs() < 1e-9);
    }

    #[test]
    fn frames_turn_and_return() {
        let f = Frame { origin: at(1.0, 2.0), turn: 33.0 };
        let p = f.point(0.4, -7.0);
        assert!(f.local(p).distance(at(0.4, -7.0)) < 1e-12);
        assert_eq!(direction(-90.0), at(0.0, -1.0));
        assert!((f.rect(0.0, 0.0, 2.0, 3.0).area() - 6.0).abs() < 1e-12);
        assert!(f.rect(0.0, 0.0, 2.0, 3.0).holds(f.point(1.0, 2.9), 0.0));
        assert!(!f.rect(0.0, 0.0, 2.0, 3.0).holds(f.point(1.0, 3.1), 0.05));
    }
}

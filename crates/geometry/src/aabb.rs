//! Axis-aligned boxes.

use glam::Vec3;

/// A closed axis-aligned box, m. Empty when a `min` exceeds its `max`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Aabb {
    /// Lower corner.
    pub min: Vec3,
    /// Upper corner.
    pub max: Vec3,
}

impl Default for Aabb {
    fn default() -> Self {
        Self::EMPTY
    }
}

impl Aabb {
    /// The box of nothing: the neutral element of [`Aabb::union`].
    pub const EMPTY: Self = Self { min: Vec3::INFINITY, max: Vec3::NEG_INFINITY };

    /// The smallest box around some points.
    pub fn of(points: impl IntoIterator<Item = Vec3>) -> Self {
        points.into_iter().fold(Self::EMPTY, Self::grow)
    }

    /// This box stretched to hold a point.
    #[must_use]
    pub fn grow(self, p: Vec3) -> Self {
        Self { min: self.min.min(p), max: self.max.max(p) }
    }

    /// The smallest box around both.
    #[must_use]
    pub fn union(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    /// What both have in common; may be empty.
    #[must_use]
    pub fn intersection(self, other: Self) -> Self {
        Self { min: self.min.max(other.min), max: self.max.min(other.max) }
    }

    /// The box with every face moved out by `margin` m.
    #[must_use]
    pub fn inflate(self, margin: f32) -> Self {
        Self { min: self.min - Vec3::splat(margin), max: self.max + Vec3::splat(margin) }
    }

    /// Whether no point is inside.
    pub fn is_empty(self) -> bool {
        !self.min.cmple(self.max).all()
    }

    /// Whether a point is inside or on the boundary.
    pub fn contains(self, p: Vec3) -> bool {
        self.min.cmple(p).all() && p.cmple(self.max).all()
    }

    /// Whether the boxes share a point.
    pub fn overlaps(self, other: Self) -> bool {
        !self.intersection(other).is_empty()
    }

    /// Edge lengths, m; zero where empty.
    pub fn extent(self) -> Vec3 {
        (self.max - self.min).max(Vec3::ZERO)
    }

    /// Midpoint (meaningless when empty).
    pub fn center(self) -> Vec3 {
        self.min + 0.5 * (self.max - self.min)
    }

    /// Length of the diagonal, m; 0 when empty.
    pub fn diagonal(self) -> f32 {
        if self.is_empty() { 0.0 } else { self.extent().length() }
    }

    /// Distance from a point to the box, m; 0 inside.
    pub fn distance(self, p: Vec3) -> f32 {
        (self.min - p).max(p - self.max).max(Vec3::ZERO).length()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn boxes_do_what_boxes_do() {
        let b = Aabb::of([Vec3::new(1.0, 2.0, 3.0), Vec3::new(-1.0, 5.0, 3.0)]);
        assert_eq!((b.min, b.max), (Vec3::new(-1.0, 2.0, 3.0), Vec3::new(1.0, 5.0, 3.0)));
        assert!(!b.is_empty() && Aabb::EMPTY.is_empty());
        assert!(b.contains(Vec3::new(0.0, 2.0, 3.0)) && !b.contains(Vec3::new(0.0, 2.0, 3.1)));
        assert_eq!(Aabb::EMPTY.union(b), b);
        assert!(b.overlaps(Aabb::of([b.max])) && !b.overlaps(Aabb::EMPTY));
        assert_eq!(b.inflate(1.0).extent(), Vec3::new(4.0, 5.0, 2.0));
        assert_eq!(b.distance(Vec3::new(4.0, 5.0, 7.0)), 5.0);
        assert_eq!(b.diagonal(), 13f32.sqrt());
        assert_eq!(b.center(), Vec3::new(0.0, 3.5, 3.0));
    }
}

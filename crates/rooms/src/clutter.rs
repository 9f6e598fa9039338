//! What stands in a leaf and lies in no splitting plane: vaults, curved walls, furniture.
//!
//! Most of it divides nothing. A vault does: who looks up from its hall sees a third of the leaf that the vault is in,
//! who looks down from the sky the rest, and nobody sees through. The hall gets the leaf.

use crate::convex::Plane;
use crate::tree::{Leaf, Tree, Walls};
use glam::DVec3;

/// Fragments of a leaf that rays are tested with at most, the largest ones.
const MOST: usize = 4096;
/// A leaf divides those around it if fewer rays than this share get through.
const THROUGH: f64 = 0.1;
/// Less surface than this share of an opening does not close it.
const LEAST: f64 = 0.6;

/// A leaf's loose surfaces.
pub(crate) struct Clutter {
    /// Sum of the areas seen along each axis, m2.
    seen: Vec<DVec3>,
}

impl Clutter {
    pub(crate) fn new(tree: &Tree, walls: &Walls<'_>) -> Self {
        let of = |leaf: &Leaf| {
            leaf.fragments
                .iter()
                .map(|f| crate::convex::area_vector(&walls.corners(f)).abs())
                .fold(DVec3::ZERO, |a, b| a + b)
        };
        Self { seen: tree.leaves.iter().map(of).collect() }
    }

    /// How far one gets, on average, into a leaf from points of one of its faces, along `inward`: a
    /// share of the way through it. 1 if more than a few get through.
    pub(crate) fn reach(
        &self,
        tree: &Tree,
        walls: &Walls<'_>,
        leaf: u32,
        inward: DVec3,
        area: f64,
        points: &[DVec3],
    ) -> f64 {
        if points.is_empty() || self.seen[leaf as usize].dot(inward.abs()) < LEAST * area {
            return 1.0;
        }
        let at = &tree.leaves[leaf as usize];
        let mut surfaces: Vec<(f64, Vec<DVec3>)> = at
            .fragments
            .iter()
            .map(|f| {
                let corners = walls.corners(f);
                (crate::convex::area_vector(&corners).dot(inward).abs(), corners)
            })
            .filter(|s| s.0 > 1e-6)
            .collect();
        if surfaces.len() > MOST {
            surfaces.sort_by(|a, b| b.0.total_cmp(&a.0));
            surfaces.truncate(MOST);
        }
        let (mut sum, mut through) = (0.0, 0usize);
        for &p in points {
            let end = at
                .cell
                .faces
                .iter()
                .filter_map(|f| leaves_at(&f.plane, p, inward))
                .fold(f64::INFINITY, f64::min);
            if !end.is_finite() || end <= 0.0 {
                through += 1;
                sum += 1.0;
                continue;
            }
            let mut t = end;
            for (_, corners) in &surfaces {
                if let Some(s) = meets(corners, p, inward) {
                    t = t.min(s);
                }
            }
            through += usize::from(t >= end);
            sum += t / end;
        }
        let count = points.len() as f64;
        if through as f64 > THROUGH * count { 1.0 } else { sum / count }
    }
}

/// Where a ray from inside a half-space leaves it.
fn leaves_at(plane: &Plane, p: DVec3, d: DVec3) -> Option<f64> {
    let speed = plane.normal.dot(d);
    (speed > 1e-9).then(|| -plane.distance(p) / speed)
}

/// Where a ray meets a convex polygon, if it does.
fn meets(corners: &[DVec3], p: DVec3, d: DVec3) -> Option<f64> {
    let mut sign = 0.0;
    for i in 0..corners.len() {
        let (a, b) = (corners[i] - p, corners[(i + 1) % corners.len()] - p);
        let side = d.dot(a.cross(b));
        if side * sign < 0.0 {
            return None;
        }
        if side != 0.0 {
            sign = side;
        }
    }
    let normal = crate::convex::area_vector(corners);
    let speed = normal.dot(d);
    if speed == 0.0 || sign == 0.0 {
        return None;
    }
    let t = normal.dot(corners[0] - p) / speed;
    (t > 0.0).then_some(t)
}

//! Looking around from a point: is it in solid matter, is it close to a wall?

use crate::cluster::point;
use crate::tables::Lists;
use crate::walk::Bsp;
use glam::DVec3;

/// Rays in all directions, none along an axis.
const DIRECTIONS: [[f64; 3]; 14] = [
    [0.96, 0.21, 0.17],
    [-0.96, 0.19, -0.21],
    [0.18, 0.96, -0.22],
    [-0.21, -0.95, 0.2],
    [0.17, -0.2, 0.96],
    [0.2, 0.16, -0.97],
    [0.6, 0.55, 0.58],
    [-0.57, 0.6, 0.55],
    [0.55, -0.58, 0.6],
    [0.58, 0.57, -0.58],
    [-0.61, -0.54, 0.58],
    [-0.55, 0.59, -0.6],
    [0.59, -0.57, -0.57],
    [-0.58, -0.58, -0.57],
];
/// Leaves a probing ray crosses at most.
const FAR: usize = 200;
/// Triangles it tests at most.
const WORK: usize = 200_000;

pub(crate) struct Probe<'a> {
    pub(crate) bsp: Bsp<'a>,
    pub(crate) lists: &'a Lists,
    pub(crate) triangles: &'a [[[f32; 3]; 3]],
    pub(crate) opaque: &'a (dyn Fn(usize) -> bool + Sync),
    pub(crate) facing: Facing,
}

/// Which side of the triangles is the outer one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Facing {
    /// The front: who stands in a room sees fronts.
    Front,
    /// The back: the whole model is inside out.
    Back,
    /// Now this, now that: backs tell nothing.
    Mixed,
}

impl Facing {
    /// From the share of backs among what is seen from open space.
    pub(crate) fn from_backs(share: f64) -> Self {
        if share <= 0.3 {
            Self::Front
        } else if share >= 0.7 {
            Self::Back
        } else {
            Self::Mixed
        }
    }
}

/// What is seen around a point.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Sight {
    /// Share of the directions in which the nearest surface is seen from its inner side.
    pub(crate) backs: f64,
    /// Share of the directions in which there is a surface at all.
    pub(crate) hits: f64,
    /// Distance to the nearest surface seen, m; infinite if there is none.
    pub(crate) nearest: f64,
}

impl Probe<'_> {
    pub(crate) fn look(&self, from: DVec3, rays: usize) -> Sight {
        let mut sight = Sight { backs: 0.0, hits: 0.0, nearest: f64::INFINITY };
        let rays = rays.clamp(1, DIRECTIONS.len());
        for d in &DIRECTIONS[..rays] {
            if let Some((t, back)) = self.shoot(from, DVec3::from_array(*d)) {
                sight.nearest = sight.nearest.min(t);
                let inner = match self.facing {
                    Facing::Front => back,
                    Facing::Back => !back,
                    Facing::Mixed => false,
                };
                sight.backs += if inner { 1.0 / rays as f64 } else { 0.0 };
                sight.hits += 1.0 / rays as f64;
            }
        }
        sight
    }

    /// Distance to the nearest surface in one direction, m; infinite if there is none.
    pub(crate) fn sight(&self, from: DVec3, direction: DVec3) -> f64 {
        self.shoot(from, direction).map_or(f64::INFINITY, |hit| hit.0)
    }

    /// Nearest opaque surface: distance and whether it is seen from behind.
    fn shoot(&self, origin: DVec3, direction: DVec3) -> Option<(f64, bool)> {
        let mut leaf = self.bsp.locate_towards(origin, direction);
        let mut t_in = 0.0;
        let mut work = 0;
        for _ in 0..FAR {
            let exit = self.bsp.exit(leaf, origin, direction, t_in);
            let mut best: Option<(f64, bool)> = None;
            let list = self.lists.of(leaf);
            work += list.len();
            if work > WORK {
                return None;
            }
            for &i in list {
                if let Some((t, back)) = meet(&self.triangles[i as usize], origin, direction)
                    && t < f64::from(exit.t_accept)
                    && best.is_none_or(|b| t < b.0)
                    && (self.opaque)(i as usize)
                {
                    best = Some((t, back));
                }
            }
            if best.is_some() {
                return best;
            }
            leaf = self.bsp.cross(exit.face, origin, direction, exit.t_exit)?;
            t_in = exit.t_exit;
        }
        None
    }
}

/// Moeller and Trumbore 1997, two-sided; the flag tells the back.
fn meet(t: &[[f32; 3]; 3], origin: DVec3, direction: DVec3) -> Option<(f64, bool)> {
    let [a, b, c] = t.map(point);
    let (e1, e2) = (b - a, c - a);
    let p = direction.cross(e2);
    let det = e1.dot(p);
    if det == 0.0 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(p) / det;
    let q = s.cross(e1);
    let v = direction.dot(q) / det;
    let t = e2.dot(q) / det;
    (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some((t, det < 0.0))
}

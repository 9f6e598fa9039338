//! One question: the nearest canonical hit in an interval, or whether there is one.

use enf_layout::bvh::LeafBlock;
use glam::Vec4;

use crate::mesh::TileMesh;
use crate::ray::{Hit, PreparedRay, Ray, four, intersect_along, margin, reach, settle};

/// A ray, and which part of it is meant.
///
/// The interval is half open: hits with `t_min <= t < t_max` count. Nothing behind the origin is ever hit: a
/// negative `t_min` means 0. NaN bounds admit no hit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Query {
    /// The ray; its direction has length 1.
    pub ray: Ray,
    /// Hits before this distance do not count, m.
    pub t_min: f32,
    /// Nor hits from this distance on, m.
    pub t_max: f32,
    /// Hits on this triangle do not count either (global index, or [`crate::NONE`]): the one that the ray starts on.
    pub exclude: u32,
}

/// The state of one query: narrows as hits are found.
#[derive(Clone, Copy)]
pub(crate) struct Search {
    pub(crate) ray: PreparedRay,
    pub(crate) delta: f32,
    /// How far off hits may be in `f32`; negative where that cannot be relied on.
    pub(crate) margin: f32,
    pub(crate) exclude: u32,
    pub(crate) t_min: f32,
    pub(crate) best: Hit,
    pub(crate) found: bool,
}

impl Search {
    #[inline(always)]
    pub(crate) fn new(delta: f32, query: &Query) -> Self {
        let (reach, [x, y, z]) = (reach(delta), query.ray.origin.to_array());
        let tame = x.abs() <= reach && y.abs() <= reach && z.abs() <= reach;
        Self {
            ray: PreparedRay::new(&query.ray),
            delta,
            margin: if tame { margin(delta) } else { -1.0 },
            exclude: query.exclude,
            // NaN stays: no comparison with it holds. So does -0, unless it becomes 0.
            t_min: if query.t_min <= 0.0 { 0.0 } else { query.t_min },
            best: Hit { t: query.t_max, global: 0, u: 0.0, v: 0.0, slot: 0 },
            found: false,
        }
    }

    /// Whether there is anything to look for.
    #[inline(always)]
    pub(crate) fn is_sane(&self) -> bool {
        self.ray.valid && self.t_min < self.best.t
    }

    /// Tests one triangle.
    #[inline(always)]
    pub(crate) fn test<const Z: usize>(&mut self, corners: [&[f32; 3]; 3], global: u32, slot: u32) {
        if let Some((t, u, v)) = intersect_along::<Z>(&self.ray, corners, self.delta) {
            self.offer(Hit { t, global, u, v, slot });
        }
    }

    fn offer(&mut self, hit: Hit) {
        let Hit { t, global, .. } = hit;
        let nearer =
            t < self.best.t || (self.found && t == self.best.t && global < self.best.global);
        if nearer && t >= self.t_min && global != self.exclude {
            self.best = hit;
            self.found = true;
        }
    }

    /// Tests the first `count` triangles of a block.
    #[inline(always)]
    pub(crate) fn test_block<const Z: usize>(&mut self, block: &LeafBlock, count: u32, slot: u32) {
        let four = four::<Z>(&self.ray, &block.corners);
        let kept = four.kept(self.margin);
        let here = (1 << count) - 1;
        let (from, to) = (Vec4::splat(self.t_min), Vec4::splat(self.best.t));
        let mut lanes = kept & here & (four.t.cmpge(from) & four.t.cmple(to)).bitmask();
        while lanes != 0 {
            let lane = (lanes.trailing_zeros() & 3) as usize;
            lanes &= lanes - 1;
            let (t, u, v) = (four.t.to_array(), four.u.to_array(), four.v.to_array());
            let (t, u, v, global) = (t[lane], u[lane], v[lane], block.global[lane]);
            self.offer(Hit { t, global, u, v, slot: slot + lane as u32 });
        }
        // What is in doubt, and not beyond the best hit by more than rounding.
        let before = (four.nearest * NEARLY_ONE).cmpgt(Vec4::splat(self.best.t.max(LEAST)));
        let doubts = (four.hit & !kept | four.unsure) & here & !before.bitmask();
        if doubts != 0 {
            self.settle::<Z>(block, doubts, slot);
        }
    }

    #[cold]
    #[inline(never)]
    fn settle<const Z: usize>(&mut self, block: &LeafBlock, mut lanes: u32, slot: u32) {
        CNT.fetch_add(1, std::sync::atomic::Ordering::Relaxed);
        while lanes != 0 {
            let lane = (lanes.trailing_zeros() & 3) as usize;
            lanes &= lanes - 1;
            let corners = block.corners.map(|c| [c[0][lane], c[1][lane], c[2][lane]]);
            let global = block.global[lane];
            let [a, b, c] = &corners;
            if let Some((t, u, v)) = settle::<Z>(&self.ray, [a, b, c], self.delta) {
                self.offer(Hit { t, global, u, v, slot: slot + lane as u32 });
            }
        }
    }

    pub(crate) fn answer(&self) -> Option<Hit> {
        self.found.then_some(self.best)
    }

    /// Tests every triangle of a mesh.
    #[cold]
    #[inline(never)]
    pub(crate) fn by_force(&mut self, mesh: &TileMesh<'_>) {
        for i in 0..mesh.len() {
            let (corners, global) = (mesh.corner_arrays(i), mesh.global[i as usize]);
            match self.ray.axis {
                0 => self.test::<0>(corners, global, i),
                1 => self.test::<1>(corners, global, i),
                _ => self.test::<2>(corners, global, i),
            }
        }
    }
}

/// Less than one by more than four roundings.
const NEARLY_ONE: f32 = 1.0 - 1.0 / (1 << 20) as f32;
/// Distances below this have lost digits.
const LEAST: f32 = 1e-30;

/// The nearest hit, by testing all triangles of the mesh for tolerance `delta` (m); ties go to the smaller global
/// index. What every structure must agree with.
pub fn nearest_by_force(mesh: &TileMesh<'_>, delta: f32, query: &Query) -> Option<Hit> {
    let mut search = Search::new(delta, query);
    search.by_force(mesh);
    search.answer()
}
pub static CNT: std::sync::atomic::AtomicU64 = std::sync::atomic::AtomicU64::new(0);

//! One question: the nearest canonical hit in an interval, or whether there is one.

use std::hint::select_unpredictable;

use enf_layout::bvh::LeafBlock;
use glam::Vec4;

use crate::mesh::TileMesh;
use crate::ray::{Four, Hit, PreparedRay, Ray, four, intersect_arrays, margin, reach, settle};

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
    pub(crate) fn test(&mut self, corners: [&[f32; 3]; 3], global: u32, slot: u32) {
        if let Some((t, u, v)) = intersect_arrays(&self.ray, corners, self.delta) {
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
    pub(crate) fn test_block(&mut self, block: &LeafBlock, count: u32, slot: u32) {
        let four = four(&self.ray, &block.corners);
        let here = ((1 << count) - 1) & !lanes_of(&block.global, self.exclude);
        let kept = four.kept(self.margin);
        let (from, to) = (Vec4::splat(self.t_min), Vec4::splat(self.best.t));
        let inside = four.t.cmpge(from) & four.t.cmple(to);
        let good = kept & here & inside.bitmask();
        // What is in doubt, and not beyond the best hit by more than rounding.
        let beyond = (four.nearest * NEARLY_ONE).cmpgt(Vec4::splat(self.best.t.max(LEAST)));
        let doubts = (four.hit & !kept | four.unsure) & here & !beyond.bitmask();

        // The nearest of the good ones. Whether there is one cannot be foretold: no branch. NaN is not inside.
        let t = Vec4::select(inside, four.t, Vec4::splat(f32::INFINITY));
        let t = t.max(Vec4::from_array(OTHERS[good as usize & 15]));
        let first = t.min_element();
        let same = good & t.cmpeq(Vec4::splat(first)).bitmask();
        if same & same.wrapping_sub(1) != 0 {
            return self.one_by_one(block, &four, good, doubts, slot);
        }
        let lane = (same.trailing_zeros() & 3) as usize;
        let (u, v) = (four.u.to_array()[lane], four.v.to_array()[lane]);
        let (global, best) = (block.global[lane], self.best);
        let tie = self.found & (first == best.t) & (global < best.global);
        let nearer = ((first < best.t) | tie) & (good != 0);
        self.best = Hit {
            t: select_unpredictable(nearer, first, best.t),
            global: select_unpredictable(nearer, global, best.global),
            u: select_unpredictable(nearer, u, best.u),
            v: select_unpredictable(nearer, v, best.v),
            slot: select_unpredictable(nearer, slot + lane as u32, best.slot),
        };
        self.found |= nearer;
        if doubts != 0 {
            self.one_by_one(block, &four, 0, doubts, slot);
        }
    }

    /// The rare ones: hits at the same distance, and triangles that `f32` leaves in doubt.
    #[cold]
    #[inline(never)]
    fn one_by_one(&mut self, block: &LeafBlock, four: &Four, good: u32, doubts: u32, slot: u32) {
        for lane in 0..4 {
            let (global, slot) = (block.global[lane], slot + lane as u32);
            if good >> lane & 1 != 0 {
                let (t, u, v) = (four.t[lane], four.u[lane], four.v[lane]);
                self.offer(Hit { t, global, u, v, slot });
            } else if doubts >> lane & 1 != 0 {
                let corners = block.corners.map(|c| [c[0][lane], c[1][lane], c[2][lane]]);
                let [a, b, c] = &corners;
                if let Some((t, u, v)) = settle(&self.ray, [a, b, c], self.delta) {
                    self.offer(Hit { t, global, u, v, slot });
                }
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
            self.test(corners, global, i);
        }
    }
}

/// Which lanes hold a number, a bit each.
#[inline(always)]
fn lanes_of(numbers: &[u32; 4], number: u32) -> u32 {
    let mut bits = [1u32, 2, 4, 8];
    for (bit, n) in bits.iter_mut().zip(numbers) {
        *bit &= u32::from(*n == number).wrapping_neg();
    }
    (bits[0] | bits[1]) | (bits[2] | bits[3])
}

/// For each set of lanes: minus infinity in them, infinity in the others.
static OTHERS: [[f32; 4]; 16] = {
    let mut table = [[f32::INFINITY; 4]; 16];
    let mut bits = 0;
    while bits < 16 {
        let mut lane = 0;
        while lane < 4 {
            if bits >> lane & 1 != 0 {
                table[bits][lane] = f32::NEG_INFINITY;
            }
            lane += 1;
        }
        bits += 1;
    }
    table
};

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

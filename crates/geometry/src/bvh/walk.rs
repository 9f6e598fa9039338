//! A ray through the hierarchy, nearest box first.

use pulp::NullaryFnOnce;
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};

use super::level::{INNER, Level, NOTHING, Portable, Stack};
use super::{BvhHeader, BvhView};
use crate::query::{Query, Search};
use crate::ray::Hit;

struct Walk<'q, L> {
    level: L,
    bvh: &'q BvhView<'q>,
    search: &'q mut Search,
}

impl<L: Level> Walk<'_, L> {
    #[inline(always)]
    fn along(self) {
        let Self { level, bvh, search } = self;
        let boxes = level.boxes(&search.ray);
        let mut stack = Stack::new();
        let mut at = INNER;
        loop {
            if at & INNER != 0 {
                if at == NOTHING {
                    return;
                }
                let node = &bvh.nodes[(at ^ INNER) as usize];
                at = level.open(node, &boxes, search.t_min, search.best.t, &mut stack);
                if at != NOTHING {
                    continue;
                }
            } else {
                let block = at & 0x1fff_ffff;
                let count = (at >> 29) + 1;
                search.test_block(&bvh.blocks[block as usize], count, 4 * block);
            }
            // What begins at the best distance may hold a smaller index.
            at = level.pop(&mut stack, search.best.t);
        }
    }
}

impl<L: Level> NullaryFnOnce for Walk<'_, L> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        self.along();
    }
}

impl BvhView<'_> {
    /// The canonical hit with the smallest `(t, global)` among those that the query admits: exactly what testing
    /// every triangle finds, on every machine.
    pub fn nearest(&self, query: &Query) -> Option<Hit> {
        let mut search = Search::new(self.delta, query);
        if self.is_plain(&mut search) {
            best_walk(self, &mut search);
        }
        search.answer()
    }

    /// [`BvhView::nearest`] without vector instructions beyond the machine's least: for tests, as it must
    /// agree with every other way.
    pub fn nearest_portable(&self, query: &Query) -> Option<Hit> {
        let mut search = Search::new(self.delta, query);
        if self.is_plain(&mut search) {
            Walk { level: Portable, bvh: self, search: &mut search }.call();
        }
        search.answer()
    }

    #[cold]
    #[inline(never)]
    fn by_force(&self, search: &mut Search) {
        for slot in 0..4 * self.blocks.len() as u32 {
            if let Some(global) = self.global(slot) {
                let corners = self.corners(slot).map(|p| p.to_array());
                let [a, b, c] = &corners;
                search.test([a, b, c], global, slot);
            }
        }
    }

    /// Whether there is anything to walk for. Where boxes cannot be trusted, every triangle is tested here.
    /// One search to its end.
    #[cold]
    #[inline(never)]
    pub(super) fn alone<L: Level>(&self, level: L, search: &mut Search) {
        Walk { level, bvh: self, search }.call();
    }

    #[inline(always)]
    pub(super) fn is_plain(&self, search: &mut Search) -> bool {
        if !search.is_sane() {
            return false;
        }
        let [x, y, z] = search.ray.origin;
        let near = x.abs() <= self.reach && y.abs() <= self.reach && z.abs() <= self.reach;
        if !near {
            self.by_force(search);
        }
        near
    }
}

/// Larger scenes than this are beyond what the boxes' arithmetic can express, m.
const LARGEST: f32 = 1e9;

/// Origins may have coordinates up to this, four scenes. None may, where the mesh itself is larger than its tolerance
/// says.
///
/// Within it, nothing that the slab test computes is infinite or NaN; and as boxes are grown by four tolerances, a
/// node's frame is wide enough to be seen from everywhere: a child that is nothing, whose ends are exchanged, is
/// never entered.
pub(super) fn reach(header: &BvhHeader, delta: f32) -> f32 {
    let scene = crate::ray::reach(delta);
    let within = scene <= LARGEST && header.min.iter().chain(&header.max).all(|x| x.abs() <= scene);
    if within && delta > 0.0 { 4.0 * scene } else { -1.0 }
}

/// Walks with the best instructions that the machine has.
#[cfg(target_arch = "x86_64")]
fn best_walk(bvh: &BvhView<'_>, search: &mut Search) {
    if let Some(level) = V4::try_new() {
        level.vectorize(Walk { level, bvh, search });
    } else if let Some(level) = V3::try_new() {
        level.vectorize(Walk { level, bvh, search });
    } else {
        Walk { level: Portable, bvh, search }.call();
    }
}

/// Walks with the best instructions that the machine has.
#[cfg(not(target_arch = "x86_64"))]
fn best_walk(bvh: &BvhView<'_>, search: &mut Search) {
    Walk { level: Portable, bvh, search }.call();
}

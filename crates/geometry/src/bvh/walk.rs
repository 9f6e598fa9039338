//! A ray through the hierarchy, nearest box first.

use pulp::NullaryFnOnce;

use super::level::{BLOCK, COUNT_SHIFT, INNER, Instructions, Level, NOTHING, Stack, Token};
use super::{BvhHeader, BvhView};
use crate::query::{Query, Search};
use crate::ray::Hit;

/// One ray's walk; to any hit, or to the nearest.
struct Walk<'q, L, const ANY: bool> {
    level: L,
    bvh: &'q BvhView<'q>,
    search: &'q mut Search,
}

impl<L: Level, const ANY: bool> NullaryFnOnce for Walk<'_, L, ANY> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
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
                let block = at & BLOCK;
                let count = (at >> COUNT_SHIFT) + 1;
                search.test_block(&bvh.blocks[block as usize], count, 4 * block);
                if ANY && search.found {
                    return;
                }
            }
            // What begins at the best distance may hold a smaller index.
            at = level.pop(&mut stack, search.best.t);
        }
    }
}

impl BvhView<'_> {
    /// The canonical hit with the smallest `(t, global)` among those that the query admits: exactly what testing
    /// every triangle finds, on every machine.
    pub fn nearest(&self, query: &Query) -> Option<Hit> {
        self.nearest_with(Instructions::best(), query)
    }

    /// [`BvhView::nearest`] by certain instructions: for tests, as all agree.
    pub fn nearest_with(&self, instructions: Instructions, query: &Query) -> Option<Hit> {
        let mut search = Search::new(self.delta, query);
        if self.needs_walk(&mut search) {
            self.walk::<false>(instructions, &mut search);
        }
        search.answer()
    }

    /// Whether the query admits any hit.
    pub fn occluded(&self, query: &Query) -> bool {
        self.occluded_with(Instructions::best(), query)
    }

    /// [`BvhView::occluded`] by certain instructions: for tests, as all agree.
    pub fn occluded_with(&self, instructions: Instructions, query: &Query) -> bool {
        let mut search = Search::new(self.delta, query);
        if self.needs_walk(&mut search) {
            self.walk::<true>(instructions, &mut search);
        }
        search.found
    }

    #[inline(always)]
    fn walk<const ANY: bool>(&self, instructions: Instructions, search: &mut Search) {
        let bvh = self;
        match instructions.token() {
            #[cfg(target_arch = "x86_64")]
            Token::Avx512(level) => level.vectorize(Walk::<_, ANY> { level, bvh, search }),
            #[cfg(target_arch = "x86_64")]
            Token::Avx2(level) => level.vectorize(Walk::<_, ANY> { level, bvh, search }),
            Token::Portable(level) => Walk::<_, ANY> { level, bvh, search }.call(),
        }
    }

    /// One search to its end, by itself.
    #[cold]
    #[inline(never)]
    pub(super) fn alone<L: Level, const ANY: bool>(&self, level: L, search: &mut Search) {
        Walk::<_, ANY> { level, bvh: self, search }.call();
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
    #[inline(always)]
    pub(super) fn needs_walk(&self, search: &mut Search) -> bool {
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

//! Many rays at once: while one waits for memory, or for the end of a chain of instructions, others go on.

use pulp::NullaryFnOnce;
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};

use super::BvhView;
use super::level::{INNER, Level, NOTHING, Portable, Stack};
use crate::query::{Query, Search};
use crate::ray::Hit;

/// Rays that are on their way at a time.
const FLIGHT: usize = 16;

struct Traveller<R> {
    boxes: R,
    search: Search,
    stack: Stack,
    at: u32,
    index: usize,
}

struct Flights<'q, L> {
    level: L,
    bvh: &'q BvhView<'q>,
    queries: &'q [Query],
    answers: &'q mut [Option<Hit>],
}

impl<L: Level> NullaryFnOnce for Flights<'_, L> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { level, bvh, queries, answers } = self;
        let mut next = 0;
        let mut flights: Vec<Traveller<L::Ray>> = Vec::with_capacity(FLIGHT);
        while flights.len() < FLIGHT && next < queries.len() {
            let search = Search::new(bvh.delta, &queries[next]);
            flights.push(Traveller {
                boxes: level.boxes(&search.ray),
                search,
                stack: Stack::new(),
                at: INNER,
                index: next,
            });
            next += 1;
        }
        let mut active = flights.len();
        let mut order: [usize; FLIGHT] = std::array::from_fn(|i| i);
        while active > 0 {
            let mut k = 0;
            while k < active {
                let f = &mut flights[order[k]];
                let at = f.at;
                if at & INNER != 0 {
                    if at == NOTHING {
                        answers[f.index] = f.search.answer();
                        if next < queries.len() {
                            f.search = Search::new(bvh.delta, &queries[next]);
                            f.boxes = level.boxes(&f.search.ray);
                            f.stack.reset();
                            f.at = INNER;
                            f.index = next;
                            next += 1;
                        } else {
                            active -= 1;
                            order.swap(k, active);
                        }
                        continue;
                    }
                    let node = &bvh.nodes[(at ^ INNER) as usize];
                    let s = &f.search;
                    f.at = level.open(node, &f.boxes, s.t_min, s.best.t, &mut f.stack);
                    if f.at == NOTHING {
                        f.at = level.pop(&mut f.stack, s.best.t);
                    }
                } else {
                    let block = at & 0x1fff_ffff;
                    let count = (at >> 29) + 1;
                    let b = &bvh.blocks[block as usize];
                    match f.search.ray.axis {
                        0 => f.search.test_block::<0>(b, count, 4 * block),
                        1 => f.search.test_block::<1>(b, count, 4 * block),
                        _ => f.search.test_block::<2>(b, count, 4 * block),
                    }
                    f.at = level.pop(&mut f.stack, f.search.best.t);
                }
                k += 1;
            }
        }
    }
}

impl BvhView<'_> {
    /// [`BvhView::nearest`] of many queries.
    pub fn nearest_batch(&self, queries: &[Query], answers: &mut [Option<Hit>]) {
        let bvh = self;
        if let Some(level) = V4::try_new() {
            level.vectorize(Flights { level, bvh, queries, answers });
        } else if let Some(level) = V3::try_new() {
            level.vectorize(Flights { level, bvh, queries, answers });
        } else {
            Flights { level: Portable, bvh, queries, answers }.call();
        }
    }
}

struct Micro<'q, L> {
    level: L,
    bvh: &'q BvhView<'q>,
    queries: &'q [Query],
    what: u32,
}

impl<L: Level> NullaryFnOnce for Micro<'_, L> {
    type Output = f64;

    #[inline(always)]
    fn call(self) -> f64 {
        let Self { level, bvh, queries, what } = self;
        let mut sum = 0u64;
        let mut stack = Stack::new();
        let first = queries.iter().find(|q| Search::new(bvh.delta, q).ray.axis == 0).unwrap();
        let search = Search::new(bvh.delta, first);
        let boxes = level.boxes(&search.ray);
        let mut search2 = search;
        for (i, q) in queries.iter().enumerate() {
            match what {
                0 => {
                    let search = Search::new(bvh.delta, q);
                    sum += search.ray.shear[0].to_bits() as u64;
                }
                1 => {
                    let search = Search::new(bvh.delta, q);
                    let boxes = level.boxes(&search.ray);
                    sum += level.open(&bvh.nodes[0], &boxes, 0.0, 1e9, &mut stack) as u64;
                    stack.reset();
                }
                2 => {
                    sum += level.open(&bvh.nodes[i % 256], &boxes, 0.0, 1e9, &mut stack) as u64;
                    stack.reset();
                }
                3 => {
                    let n = level.open(&bvh.nodes[(sum & 255) as usize], &boxes, 0.0, 1e9, &mut stack);
                    sum = sum.wrapping_mul(3).wrapping_add(n as u64);
                    stack.reset();
                }
                4 => {
                    search2.test_block::<0>(&bvh.blocks[i % 256], 4, 4 * i as u32);
                    search2.best.t = 1e9;
                    sum += search2.best.t as u64;
                }
                5 => {
                    let mut s = Search::new(bvh.delta, q);
                    s.test_block::<0>(&bvh.blocks[i % 256], 4, 4 * i as u32);
                    sum += s.best.t as u64;
                }
                _ => {
                    stack.reset();
                    sum += level.pop(&mut stack, 1.0) as u64;
                }
            }
        }
        sum as f64
    }
}

impl BvhView<'_> {
    /// x
    pub fn micro(&self, queries: &[Query], what: u32) -> f64 {
        let level = V4::try_new().unwrap();
        level.vectorize(Micro { level, bvh: self, queries, what })
    }
}

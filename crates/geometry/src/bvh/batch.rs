//! Many rays at once, in passes that do not branch on what they find.
//!
//! A ray alone spends most of its time on waiting: for the memory that holds the next node, for the end of
//! a chain of instructions, and after each branch that went the other way, which no one can foretell in a
//! tree. So some dozens are under way together. Each round takes an entry from the stack of each
//! ray and sorts the rays by what it is; then all that are at a node open it; then all that are at a
//! block test it. Within a pass nothing depends on anything but its own ray, and what differs
//! between rays is computed and masked instead of branched on.

use enf_layout::bvh::WIDTH;
use pulp::NullaryFnOnce;
#[cfg(target_arch = "x86_64")]
use pulp::x86::{V3, V4};

use super::BvhView;
use super::level::{INNER, Level, NOTHING, Portable};
use crate::query::{Query, Search};
use crate::ray::Hit;

/// Rays that are under way at a time.
const FLIGHT: usize = 32;
/// Entries that each of them has room for; the few that need more go alone.
const ENTRIES: usize = 120;

/// A ray under way.
struct Traveller<R> {
    boxes: R,
    search: Search,
    /// The entry that was taken last.
    at: u32,
    /// Entries above the bottom.
    len: u32,
    /// Which query this is.
    index: u32,
    /// Where entries begin, and what they are: as a [`super::level::Stack`].
    enter: [f32; ENTRIES],
    what: [u32; ENTRIES],
}

struct Flights<'q, L> {
    level: L,
    bvh: &'q BvhView<'q>,
    queries: &'q [Query],
    answers: &'q mut [Option<Hit>],
}

impl<L: Level> Flights<'_, L> {
    /// The next query that has something to walk for, as a traveller at the root; answers those before it.
    #[inline(always)]
    fn board(&mut self, next: &mut usize, traveller: &mut Traveller<L::Ray>) -> bool {
        while let Some(query) = self.queries.get(*next) {
            let index = *next;
            *next += 1;
            traveller.search = Search::new(self.bvh.delta, query);
            if self.bvh.is_plain(&mut traveller.search) {
                traveller.boxes = self.level.boxes(&traveller.search.ray);
                traveller.index = index as u32;
                traveller.enter[..WIDTH].copy_from_slice(&[f32::INFINITY; WIDTH]);
                traveller.enter[WIDTH - 1] = f32::NEG_INFINITY;
                traveller.what[WIDTH - 1] = NOTHING;
                traveller.enter[WIDTH] = f32::NEG_INFINITY;
                traveller.what[WIDTH] = INNER;
                traveller.len = WIDTH as u32 + 1;
                return true;
            }
            self.answers[index] = traveller.search.answer();
        }
        false
    }
}

impl<L: Level> NullaryFnOnce for Flights<'_, L> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        let (level, bvh) = (self.level, self.bvh);
        let mut next = 0;
        let mut flights: Vec<Traveller<L::Ray>> = Vec::with_capacity(FLIGHT);
        let Some(first) = self.queries.first() else { return };
        let idle = Search::new(bvh.delta, first);
        while flights.len() < FLIGHT {
            let mut traveller = Traveller {
                boxes: level.boxes(&idle.ray),
                search: idle,
                at: NOTHING,
                len: 0,
                index: 0,
                enter: [0.0; ENTRIES],
                what: [0; ENTRIES],
            };
            if !self.board(&mut next, &mut traveller) {
                break;
            }
            flights.push(traveller);
        }
        let mut active = [0u32; FLIGHT];
        let mut count = flights.len();
        for (i, a) in active.iter_mut().enumerate() {
            *a = i as u32;
        }
        let (mut nodes, mut blocks, mut ended) = ([0u32; FLIGHT], [0u32; FLIGHT], [0u32; FLIGHT]);
        while count > 0 {
            let (mut at_node, mut at_block, mut at_end) = (0, 0, 0);
            for &i in &active[..count] {
                let f = &mut flights[i as usize];
                let mut len = f.len as usize;
                loop {
                    let Some(top) = f.enter[..len].last_chunk::<WIDTH>() else { break };
                    let open = level.begun(top, f.search.best.t);
                    // The topmost is the highest bit; without any, all eight go.
                    len -= (open << 24 | 0x80_0000).leading_zeros() as usize;
                    if open != 0 {
                        break;
                    }
                }
                let at = f.what[len - 1];
                f.len = len as u32 - 1;
                f.at = at;
                nodes[at_node] = i;
                blocks[at_block] = i;
                ended[at_end] = i;
                at_node += usize::from(at & INNER != 0 && at != NOTHING);
                at_block += usize::from(at & INNER == 0);
                at_end += usize::from(at == NOTHING);
            }
            for &i in &nodes[..at_node] {
                let f = &mut flights[i as usize];
                let node = &bvh.nodes[(f.at ^ INNER) as usize];
                let len = f.len as usize;
                let (from, to) = (f.search.t_min, f.search.best.t);
                let (enter, what, n) = level.open_all(node, &f.boxes, from, to);
                if let (Some(e), Some(w)) =
                    (f.enter[len..].first_chunk_mut(), f.what[len..].first_chunk_mut())
                {
                    (*e, *w) = (enter, what);
                    f.len += n;
                } else {
                    // No room: alone, from the start.
                    f.search = Search::new(bvh.delta, &self.queries[f.index as usize]);
                    bvh.alone(level, &mut f.search);
                    f.len = WIDTH as u32;
                }
            }
            for &i in &blocks[..at_block] {
                let f = &mut flights[i as usize];
                let block = f.at & 0x1fff_ffff;
                let triangles = (f.at >> 29) + 1;
                f.search.test_block(&bvh.blocks[block as usize], triangles, 4 * block);
            }
            for &i in &ended[..at_end] {
                let f = &mut flights[i as usize];
                self.answers[f.index as usize] = f.search.answer();
                if !self.board(&mut next, f) {
                    let gone = active[..count].iter().position(|&a| a == i).unwrap_or(0);
                    count -= 1;
                    active.swap(gone, count);
                }
            }
        }
    }
}

impl BvhView<'_> {
    /// [`BvhView::nearest`] of many queries; as many answers.
    pub fn nearest_batch(&self, queries: &[Query], answers: &mut [Option<Hit>]) {
        assert_eq!(queries.len(), answers.len(), "as many answers as queries");
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

//! Many rays at once, in passes that do not branch on what they find.
//!
//! A ray alone spends most of its time on waiting: for the memory that holds the next node, for the end of
//! a chain of instructions, and after each branch that went the other way, which no one can foretell in a
//! tree. So some dozens are under way together. In each round, those that have none take an entry from their stack; then
//! all that are at a node open it, and the first of its children is where they are next; then all that are at a
//! block test it. Within a pass nothing depends on anything but its own ray, and what differs
//! between rays is computed and masked instead of branched on.

use enf_layout::bvh::WIDTH;
use glam::Vec3;
use pulp::NullaryFnOnce;

use super::BvhView;
use super::level::{BLOCK, COUNT_SHIFT, INNER, Instructions, Level, NOTHING, Token};
use crate::query::{Query, Search};
use crate::ray::Hit;

/// Rays that are under way at a time.
const FLIGHT: usize = 32;
/// Entries that each of them has room for; the few that need more go alone.
const ENTRIES: usize = 120;
/// Rays are taken in chunks of so many, which leave room in the caches.
const CHUNK: usize = 8192;
/// From so many rays on, they are sorted first, if the hierarchy is one that the caches do not hold.
const SORTED_FROM: usize = 2048;
/// Bytes of such a hierarchy. Measured: at 3 MB sorting costs what it saves, at 23 MB it saves a quarter of the time.
const SORTED_ABOVE: usize = 4 << 20;
/// Cells along each axis for that.
const CELLS: usize = 8;
const MASK: usize = FLIGHT - 1;
const _: () = assert!(FLIGHT.is_power_of_two());

/// The rays under way: what the passes ask of each lies side by side. Indices into it are kept below [`FLIGHT`] by
/// masks, which cost less than asking.
struct Flight<R> {
    /// The entry that was taken last.
    at: [u32; FLIGHT],
    /// Entries on the stack, those at its bottom included.
    len: [u32; FLIGHT],
    /// Which query this is.
    index: [u32; FLIGHT],
    boxes: [R; FLIGHT],
    search: [Search; FLIGHT],
    /// Where entries begin, and what they are: as a [`super::level::Stack`].
    enter: [[f32; ENTRIES]; FLIGHT],
    what: [[u32; ENTRIES]; FLIGHT],
}

struct Flights<'q, L, A, const ANY: bool> {
    level: L,
    bvh: &'q BvhView<'q>,
    queries: &'q [Query],
    /// In which order they are asked; as they come, if empty.
    order: &'q [u32],
    answers: &'q mut [A],
}

impl<L: Level, A: Answer, const ANY: bool> Flights<'_, L, A, ANY> {
    /// The next query that has something to walk for takes a place at the root; those before it are answered.
    #[inline(always)]
    fn board(&mut self, next: &mut usize, flight: &mut Flight<L::Ray>, place: usize) -> bool {
        while *next < self.queries.len() {
            let index = self.order.get(*next).map_or(*next, |&i| i as usize);
            let query = &self.queries[index];
            *next += 1;
            let search = &mut flight.search[place & MASK];
            *search = Search::new(self.bvh.delta, query);
            if self.bvh.needs_walk(search) {
                flight.boxes[place & MASK] = self.level.boxes(&search.ray);
                flight.index[place & MASK] = index as u32;
                flight.at[place & MASK] = INNER;
                flight.len[place & MASK] = WIDTH as u32;
                return true;
            }
            self.answers[index] = A::of(search);
        }
        false
    }
}

impl<L: Level, A: Answer, const ANY: bool> NullaryFnOnce for Flights<'_, L, A, ANY> {
    type Output = ();

    #[inline(always)]
    fn call(mut self) {
        let (level, bvh) = (self.level, self.bvh);
        let mut next = 0;
        let Some(first) = self.queries.first() else { return };
        let idle = Search::new(bvh.delta, first);
        let mut flight = Box::new(Flight {
            at: [NOTHING; FLIGHT],
            len: [0; FLIGHT],
            index: [0; FLIGHT],
            boxes: [level.boxes(&idle.ray); FLIGHT],
            search: [idle; FLIGHT],
            enter: [[f32::INFINITY; ENTRIES]; FLIGHT],
            what: [[NOTHING; ENTRIES]; FLIGHT],
        });
        let mut count = 0;
        // Who is at a node, who is at a block, who has to take an entry first, who has come to an end; and how many.
        let (mut nodes, mut blocks) = ([0u32; FLIGHT], [0u32; FLIGHT]);
        let (mut takers, mut ended) = ([0u32; FLIGHT], [0u32; FLIGHT]);
        while count < FLIGHT && self.board(&mut next, &mut flight, count) {
            flight.enter[count][WIDTH - 1] = f32::NEG_INFINITY;
            nodes[count] = count as u32;
            count += 1;
        }
        let (mut at_node, mut at_block, mut taking) = (count, 0usize, 0usize);
        while count > 0 {
            let flight = &mut *flight;
            let mut at_end = 0usize;
            for &place in &takers[..taking.min(FLIGHT)] {
                let i = place as usize & MASK;
                let enter = &flight.enter[i];
                let to = flight.search[i].best.t;
                let mut len = flight.len[i] as usize;
                loop {
                    let last = (len - WIDTH).min(ENTRIES - WIDTH);
                    let Some(top) = enter[last..].first_chunk() else { break };
                    let open = level.begun(top, to);
                    // The topmost is the highest bit; without any, all eight go.
                    len -= (open << 24 | 0x80_0000).leading_zeros() as usize;
                    if open != 0 {
                        break;
                    }
                }
                let top = (len - 1).min(ENTRIES - 1);
                let at = flight.what[i][top];
                flight.len[i] = top as u32;
                flight.at[i] = at;
                nodes[at_node & MASK] = place;
                blocks[at_block & MASK] = place;
                ended[at_end & MASK] = place;
                let (inner, end) = ((at >> 31) as usize, usize::from(at == NOTHING));
                at_node += inner - end;
                at_block += 1 - inner;
                at_end += end;
            }
            // Lists are written anew for the next round while they are read.
            let (now_nodes, now_blocks) = (nodes, blocks);
            let now_nodes = &now_nodes[..at_node.min(FLIGHT)];
            let now_blocks = &now_blocks[..at_block.min(FLIGHT)];
            (at_node, at_block, taking) = (0, 0, 0);

            // Asks for what the passes below will want, all at once: memory answers many as fast as one.
            let mut touched = 0;
            for &place in now_nodes {
                let node = &bvh.nodes[(flight.at[place as usize & MASK] ^ INNER) as usize];
                touched ^= node.origin[0].to_bits() ^ node.used;
            }
            for &place in now_blocks {
                let block = flight.at[place as usize & MASK] & BLOCK;
                let block = &bvh.blocks[block as usize];
                touched ^= block.corners[0][0][0].to_bits() ^ block.corners[1][1][0].to_bits();
                touched ^= block.corners[2][2][0].to_bits() ^ block.material[3];
            }
            std::hint::black_box(touched);

            for &place in now_nodes {
                let i = place as usize & MASK;
                let node = &bvh.nodes[(flight.at[i] ^ INNER) as usize];
                let len = flight.len[i] as usize;
                let search = &flight.search[i];
                let (from, to) = (search.t_min, search.best.t);
                let (enter, what, n) = level.open_all(node, &flight.boxes[i], from, to);
                if len > ENTRIES - WIDTH {
                    // No room: alone, from the start.
                    let query = &self.queries[flight.index[i] as usize];
                    flight.search[i] = Search::new(bvh.delta, query);
                    bvh.alone::<_, ANY>(level, &mut flight.search[i]);
                    flight.len[i] = WIDTH as u32;
                    takers[taking & MASK] = place;
                    taking += 1;
                    continue;
                }
                flight.enter[i][len..len + WIDTH].copy_from_slice(&enter);
                flight.what[i][len..len + WIDTH].copy_from_slice(&what);
                // The first child is next, without a turn over the stack.
                let some = u32::from(n != 0);
                let at = what[(n.wrapping_sub(some)) as usize & (WIDTH - 1)];
                flight.at[i] = at;
                flight.len[i] = len as u32 + n - some;
                nodes[at_node & MASK] = place;
                blocks[at_block & MASK] = place;
                takers[taking & MASK] = place;
                let inner = some & at >> 31;
                at_node += inner as usize;
                at_block += (some - inner) as usize;
                taking += 1 - some as usize;
            }
            for &place in now_blocks {
                let i = place as usize & MASK;
                let at = flight.at[i];
                let block = at & BLOCK;
                let triangles = (at >> COUNT_SHIFT) + 1;
                flight.search[i].test_block(&bvh.blocks[block as usize], triangles, 4 * block);
                if ANY {
                    let rest = if flight.search[i].found { WIDTH as u32 } else { u32::MAX };
                    flight.len[i] = flight.len[i].min(rest);
                }
                takers[taking & MASK] = place;
                taking += 1;
            }
            for &place in &ended[..at_end] {
                let i = place as usize & MASK;
                self.answers[flight.index[i] as usize] = A::of(&flight.search[i]);
                if self.board(&mut next, flight, i) {
                    nodes[at_node & MASK] = place;
                    at_node += 1;
                } else {
                    count -= 1;
                }
            }
        }
    }
}

/// What is wanted of a search.
trait Answer {
    fn of(search: &Search) -> Self;
}

impl Answer for Option<Hit> {
    #[inline(always)]
    fn of(search: &Search) -> Self {
        search.answer()
    }
}

impl Answer for bool {
    #[inline(always)]
    fn of(search: &Search) -> Self {
        search.found
    }
}

impl BvhView<'_> {
    /// [`BvhView::nearest`] of many queries; as many answers.
    pub fn nearest_batch(&self, queries: &[Query], answers: &mut [Option<Hit>]) {
        self.nearest_batch_with(Instructions::best(), queries, answers);
    }

    /// [`BvhView::nearest_batch`] by certain instructions: for tests, as all agree.
    pub fn nearest_batch_with(
        &self,
        instructions: Instructions,
        queries: &[Query],
        answers: &mut [Option<Hit>],
    ) {
        self.batch::<_, false>(instructions, queries, answers);
    }

    /// [`BvhView::occluded`] of many queries; as many answers.
    pub fn occluded_batch(&self, queries: &[Query], answers: &mut [bool]) {
        self.occluded_batch_with(Instructions::best(), queries, answers);
    }

    /// [`BvhView::occluded_batch`] by certain instructions: for tests, as all agree.
    pub fn occluded_batch_with(
        &self,
        instructions: Instructions,
        queries: &[Query],
        answers: &mut [bool],
    ) {
        self.batch::<_, true>(instructions, queries, answers);
    }

    fn batch<A: Answer, const ANY: bool>(
        &self,
        instructions: Instructions,
        queries: &[Query],
        answers: &mut [A],
    ) {
        let bvh = self;
        // As many as there are of both.
        let n = queries.len().min(answers.len());
        let (queries, answers) = (&queries[..n], &mut answers[..n]);
        for (queries, answers) in queries.chunks(CHUNK).zip(answers.chunks_mut(CHUNK)) {
            let order = self.order(queries);
            let order = &order[..];
            match instructions.token() {
                #[cfg(target_arch = "x86_64")]
                Token::Avx512(level) => {
                    level.vectorize(Flights::<_, A, ANY> { level, bvh, queries, order, answers });
                }
                #[cfg(target_arch = "x86_64")]
                Token::Avx2(level) => {
                    level.vectorize(Flights::<_, A, ANY> { level, bvh, queries, order, answers });
                }
                Token::Portable(level) => {
                    Flights::<_, A, ANY> { level, bvh, queries, order, answers }.call();
                }
            }
        }
    }

    /// An order in which rays that begin near each other in like directions follow each other: their nodes are
    /// still in the caches then. A counting sort by cell of the origin and signs of the direction, which costs next to
    /// nothing; empty where it would not pay.
    fn order(&self, queries: &[Query]) -> Vec<u32> {
        let bytes = size_of_val(self.nodes) + size_of_val(self.blocks);
        if queries.len() < SORTED_FROM || bytes < SORTED_ABOVE {
            return Vec::new();
        }
        let (low, high) = (Vec3::from(self.header.min), Vec3::from(self.header.max));
        let scale = Vec3::splat(CELLS as f32) / (high - low).max(Vec3::splat(f32::MIN_POSITIVE));
        let bin = |query: &Query| {
            // Saturating casts; anything goes.
            let cell = (query.ray.origin - low) * scale;
            let at = |x: f32| (x as usize).min(CELLS - 1);
            let signs = query.ray.direction.to_array().map(|d| usize::from(d < 0.0));
            let octant = signs[0] | signs[1] << 1 | signs[2] << 2;
            ((at(cell.z) * CELLS + at(cell.y)) * CELLS + at(cell.x)) << 3 | octant
        };
        let mut ends = vec![0u32; CELLS * CELLS * CELLS * 8];
        let bins: Vec<u16> = queries
            .iter()
            .map(|query| {
                let bin = bin(query);
                ends[bin] += 1;
                bin as u16
            })
            .collect();
        let mut sum = 0;
        for end in &mut ends {
            sum += *end;
            *end = sum;
        }
        let mut order = vec![0; queries.len()];
        for (i, &bin) in bins.iter().enumerate().rev() {
            let end = &mut ends[usize::from(bin)];
            *end -= 1;
            order[*end as usize] = i as u32;
        }
        order
    }
}

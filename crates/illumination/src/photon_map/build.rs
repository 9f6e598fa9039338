//! Building: a set of photons becomes blocks of neighbours with boxes about them, always the same ones.
//!
//! Large sets are first spread over a grid of cells, in one pass, and the cells are cut into chunks that fit into the
//! processor's nearest memory; there a kd-tree's medians do the rest. A photon's place is decided by coordinates, then
//! by canonical order, and that order is total up to identical records: where it lies is a property of the
//! multiset, and has nothing to do with the order of arrival or with threads.
#![expect(clippy::needless_range_loop, reason = "several arrays, axis by axis")]

use std::cmp::Ordering;
use std::sync::{Mutex, PoisonError};

use enf_layout::map::*;
use enf_layout::photon::{PHOTON_HALO, PhotonRecord};
use zerocopy::{FromBytes, IntoBytes};

use super::chunk::{Bench, CHUNK, CHUNK_BLOCKS, CHUNK_NODES, Chunk};
use super::lanes::{Instructions, Level, Task};
use super::map::open_blob;
use super::order::canonical_cmp;

/// Times that the box about all is halved: the cells are 2 to this power.
const HALVINGS: u32 = 12;

/// Lower and upper corner.
type Bounds = [[f32; 3]; 2];

/// Blocks of so many photons.
pub(super) fn count_blocks(photons: usize) -> usize {
    photons.div_ceil(BLOCK_PHOTONS)
}

/// Makes a piece of a map: writes all of `blob`, which is zeroed and [`super::blob_bytes`] long.
///
/// `radius` is the halo's width, m; `[piece, pieces]` says which of how many pieces it is. The bytes depend only on
/// these and on the multiset of records: not on their order, not on `threads`.
///
/// # Panics
/// If `blob` has another length, or is not aligned to 4 bytes.
pub fn build_map(
    photons: &[PhotonRecord],
    blob: &mut [u8],
    radius: f32,
    piece: [u32; 2],
    threads: usize,
) {
    build_with(photons, blob, radius, piece, threads, Instructions::default());
}

/// [`build_map`], with no more than these instructions.
fn build_with(
    photons: &[PhotonRecord],
    blob: &mut [u8],
    radius: f32,
    [piece, pieces]: [u32; 2],
    threads: usize,
    instructions: Instructions,
) {
    assert_eq!(blob.len(), super::blob_bytes(photons.len()), "a blob of another length");
    let halo = photons.iter().filter(|p| p.flags & PHOTON_HALO != 0).count();
    let header = MapHeader {
        photons: photons.len() as u64,
        halo: halo as u64,
        radius,
        piece,
        pieces,
        reserved: 0,
    };
    let opened = open_blob(blob, header);
    let (blocks, nodes) = opened.expect("the blob was just laid out, aligned as its records are");
    let records = <[PhotonRecord]>::mut_from_bytes(blocks.as_mut_bytes());
    let records = records.expect("a block has the size of its photons");
    spread(photons, &mut records[..photons.len()], instructions);
    let lowest = blocks.len().div_ceil(NODE_CHILDREN);
    let (lowest, upper) = nodes.split_at_mut(lowest);
    finish_chunks(blocks, lowest, photons.len(), threads, instructions);
    let mut below: &[MapNode] = lowest;
    let mut rest = upper;
    while below.len() > 1 {
        let (level, higher) = rest.split_at_mut(below.len().div_ceil(NODE_CHILDREN));
        let boxes = below.chunks(NODE_CHILDREN);
        for (node, children) in level.iter_mut().zip(boxes) {
            *node = node_about(children.iter().map(about));
        }
        (below, rest) = (level, higher);
    }
}

/// Copies photons so that those of each chunk lie together.
fn spread(photons: &[PhotonRecord], out: &mut [PhotonRecord], instructions: Instructions) {
    if photons.len() <= CHUNK {
        out.copy_from_slice(photons);
        return;
    }
    let grid = Grid::new(instructions.run(BoundsOf(photons)));
    let mut ends = vec![0u32; 1 << HALVINGS];
    instructions.run(Spread { photons, grid: &grid, ends: &mut ends, out });
    let mut start = 0;
    for &end in &ends {
        let end = end as usize;
        cut(&mut out[start..end], start, instructions);
        start = end;
    }
}

/// Copies photons to their cells.
struct Spread<'a> {
    photons: &'a [PhotonRecord],
    grid: &'a Grid,
    /// Zero; afterwards where each cell ends.
    ends: &'a mut [u32],
    out: &'a mut [PhotonRecord],
}

impl Task for Spread<'_> {
    type Output = ();

    #[inline(always)]
    fn with<L: Level>(self, _: L) {
        let Self { photons, grid, ends, out } = self;
        let (sixteens, rest) = photons.as_chunks::<BLOCK_PHOTONS>();
        for photons in sixteens {
            for cell in grid.cells(photons) {
                ends[cell] += 1;
            }
        }
        for p in rest {
            ends[grid.cells(&[*p; BLOCK_PHOTONS])[0]] += 1;
        }
        let mut sum = 0;
        for end in &mut *ends {
            (*end, sum) = (sum, sum + *end);
        }
        // Now where each cell begins.
        let mut put = |p: &PhotonRecord, cell: usize| {
            out[ends[cell] as usize] = *p;
            ends[cell] += 1;
        };
        for photons in sixteens {
            for (p, cell) in photons.iter().zip(grid.cells(photons)) {
                put(p, cell);
            }
        }
        for p in rest {
            put(p, grid.cells(&[*p; BLOCK_PHOTONS])[0]);
        }
    }
}

/// Orders a cell's photons, the first of which is number `first`, so that no photon is on the wrong side of the end of a chunk.
fn cut(photons: &mut [PhotonRecord], first: usize, instructions: Instructions) {
    let end = first + photons.len();
    // The ends of chunks within.
    let (low, high) = (first / CHUNK + 1, end.div_ceil(CHUNK));
    if low >= high {
        return;
    }
    let middle = (low + high) / 2 * CHUNK - first;
    let bounds = instructions.run(BoundsOf(photons));
    let axis = longest(&bounds);
    photons.select_nth_unstable_by(middle, |a, b| {
        match ordered(a.position_bits[axis]).cmp(&ordered(b.position_bits[axis])) {
            Ordering::Equal => canonical_cmp(a, b),
            order => order,
        }
    });
    let (before, after) = photons.split_at_mut(middle);
    cut(before, first, instructions);
    cut(after, first + middle, instructions);
}

/// The bits of an `f32` as an integer that orders as the numbers do (`-0 < +0`; NaNs at the ends).
#[inline(always)]
pub(super) fn ordered(bits: u32) -> i32 {
    bits as i32 ^ ((bits as i32 >> 31) as u32 >> 1) as i32
}

/// Undoes [`ordered`].
#[inline(always)]
pub(super) fn unordered(key: i32) -> f32 {
    f32::from_bits(ordered(key as u32) as u32)
}

/// The box about nothing.
pub(super) fn nothing() -> Bounds {
    [[f32::MAX; 3], [f32::MIN; 3]]
}

/// The box about two boxes.
#[inline(always)]
pub(super) fn union(mut a: Bounds, b: Bounds) -> Bounds {
    for axis in 0..3 {
        a[0][axis] = if b[0][axis] < a[0][axis] { b[0][axis] } else { a[0][axis] };
        a[1][axis] = if b[1][axis] > a[1][axis] { b[1][axis] } else { a[1][axis] };
    }
    a
}

/// The box about the photons of a block: no zero is negative, and what is no number is left out.
#[inline(always)]
pub(super) fn box_of(block: &MapBlock) -> Bounds {
    let mut bounds = nothing();
    for axis in 0..3 {
        for &bits in &block.position_bits[axis] {
            let at = f32::from_bits(bits);
            bounds[0][axis] = if at < bounds[0][axis] { at } else { bounds[0][axis] };
            bounds[1][axis] = if at > bounds[1][axis] { at } else { bounds[1][axis] };
        }
        bounds[0][axis] += 0.0;
        bounds[1][axis] += 0.0;
    }
    bounds
}

/// The box about a node's children.
fn about(node: &MapNode) -> Bounds {
    let mut bounds = nothing();
    for i in 0..NODE_CHILDREN {
        bounds = union(bounds, [node.min.map(|a| a[i]), node.max.map(|a| a[i])]);
    }
    bounds
}

/// The node of up to eight boxes.
pub(super) fn node_about(boxes: impl Iterator<Item = Bounds>) -> MapNode {
    let [min, max] = nothing().map(|corner| corner.map(|c| [c; NODE_CHILDREN]));
    let mut node = MapNode { min, max };
    for (i, bounds) in boxes.take(NODE_CHILDREN).enumerate() {
        for axis in 0..3 {
            node.min[axis][i] = bounds[0][axis];
            node.max[axis][i] = bounds[1][axis];
        }
    }
    node
}

/// Appends all levels of nodes about boxes, the lowest first.
pub(super) fn raise(boxes: &[Bounds], nodes: &mut Vec<MapNode>) {
    let mut first = nodes.len();
    nodes.extend(boxes.chunks(NODE_CHILDREN).map(|c| node_about(c.iter().copied())));
    while nodes.len() - first > 1 {
        let level = nodes.len();
        for i in (first..level).step_by(NODE_CHILDREN) {
            let children = &nodes[i..level.min(i + NODE_CHILDREN)];
            let node = node_about(children.iter().map(about));
            nodes.push(node);
        }
        first = level;
    }
}

/// The longest side of a box, the lowest axis among equals.
#[inline(always)]
pub(super) fn longest(bounds: &Bounds) -> usize {
    let side = |axis: usize| bounds[1][axis] - bounds[0][axis];
    let mut axis = 0;
    for i in 1..3 {
        if side(i) > side(axis) {
            axis = i;
        }
    }
    axis
}

/// The box about photons.
struct BoundsOf<'a>(&'a [PhotonRecord]);

impl Task for BoundsOf<'_> {
    type Output = Bounds;

    #[inline(always)]
    fn with<L: Level>(self, _: L) -> Bounds {
        // Sixteen boxes at a time.
        let (mut min, mut max) = ([[f32::MAX; 16]; 3], [[f32::MIN; 16]; 3]);
        let (sixteens, rest) = self.0.as_chunks::<16>();
        for photons in sixteens {
            for axis in 0..3 {
                for i in 0..16 {
                    let at = f32::from_bits(photons[i].position_bits[axis]);
                    let (low, high) = (&mut min[axis][i], &mut max[axis][i]);
                    *low = if at < *low { at } else { *low };
                    *high = if at > *high { at } else { *high };
                }
            }
        }
        let mut bounds = nothing();
        for i in 0..16 {
            bounds = union(bounds, [min.map(|axis| axis[i]), max.map(|axis| axis[i])]);
        }
        for p in rest {
            let at = p.position_bits.map(f32::from_bits);
            bounds = union(bounds, [at, at]);
        }
        bounds
    }
}

/// Cells of a box that is halved again and again.
struct Grid {
    min: [f32; 3],
    scale: [f32; 3],
    /// The greatest step along each axis.
    last: [f32; 3],
    /// Bits of a cell's number by the step along each axis.
    bits: Box<[[u16; 1 << HALVINGS]; 3]>,
}

impl Grid {
    fn new([min, max]: Bounds) -> Self {
        let size = [0, 1, 2].map(|axis| (max[axis] - min[axis]).max(0.0));
        let mut side = size;
        let mut halvings = [0u32; 3];
        let mut order = Vec::new();
        for _ in 0..HALVINGS {
            let axis = longest(&[[0.0; 3], side]);
            side[axis] *= 0.5;
            halvings[axis] += 1;
            order.push(axis);
        }
        let mut bits = Box::new([[0; 1 << HALVINGS]; 3]);
        for axis in 0..3 {
            for (step, number) in bits[axis][..1 << halvings[axis]].iter_mut().enumerate() {
                let mut left = halvings[axis];
                for &halved in &order {
                    *number <<= 1;
                    if halved == axis {
                        left -= 1;
                        *number |= (step >> left & 1) as u16;
                    }
                }
            }
        }
        let steps = halvings.map(|halvings| (1u32 << halvings) as f32);
        let scale = [0, 1, 2].map(|axis| {
            let scale = steps[axis] / size[axis];
            if scale.is_finite() { scale } else { 0.0 }
        });
        Self { min, scale, last: steps.map(|steps| steps - 1.0), bits }
    }

    /// The cells of sixteen photons.
    #[inline(always)]
    fn cells(&self, photons: &[PhotonRecord; BLOCK_PHOTONS]) -> [usize; BLOCK_PHOTONS] {
        /// Where numbers have no digits after the point.
        const WHOLE: f32 = 8_388_608.0;
        let mut cells = [0; BLOCK_PHOTONS];
        for axis in 0..3 {
            let (min, scale, last) = (self.min[axis], self.scale[axis], self.last[axis]);
            let mut steps = [0; BLOCK_PHOTONS];
            for i in 0..BLOCK_PHOTONS {
                let at = (f32::from_bits(photons[i].position_bits[axis]) - min) * scale;
                // What is no number is in the first.
                let at = if at > 0.0 { at } else { 0.0 };
                let at = if at < last { at } else { last };
                let near = (at + WHOLE) - WHOLE;
                let below = if near > at { near - 1.0 } else { near };
                steps[i] = (below + WHOLE).to_bits();
            }
            for i in 0..BLOCK_PHOTONS {
                cells[i] |= self.bits[axis][steps[i] as usize & ((1 << HALVINGS) - 1)];
            }
        }
        cells.map(|cell| usize::from(cell) & ((1 << HALVINGS) - 1))
    }
}

fn finish_chunks(
    blocks: &mut [MapBlock],
    nodes: &mut [MapNode],
    photons: usize,
    threads: usize,
    instructions: Instructions,
) {
    let chunks = blocks.chunks_mut(CHUNK_BLOCKS).zip(nodes.chunks_mut(CHUNK_NODES)).enumerate();
    let chunks = chunks.map(|(i, (blocks, nodes))| Chunk {
        blocks,
        nodes,
        photons: (photons - i * CHUNK).min(CHUNK),
    });
    let threads = threads.min(photons.div_ceil(CHUNK));
    if threads <= 1 {
        let mut bench = Bench::default();
        chunks.for_each(|chunk| bench.finish(chunk, instructions));
        return;
    }
    let chunks = Mutex::new(chunks);
    std::thread::scope(|scope| {
        for _ in 0..threads {
            scope.spawn(|| {
                let mut bench = Bench::default();
                loop {
                    // A thread that panicked took its own chunk only; the scope passes the panic on.
                    let chunk = chunks.lock().unwrap_or_else(PoisonError::into_inner).next();
                    match chunk {
                        Some(chunk) => bench.finish(chunk, instructions),
                        None => break,
                    }
                }
            });
        }
    });
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::tests_support::{any_photon, coarse_photon, shuffled};
    use crate::photon_map::{PhotonMap, blob_bytes};
    use proptest::prelude::*;

    fn built(photons: &[PhotonRecord], threads: usize) -> Vec<u8> {
        let mut blob = vec![0; blob_bytes(photons.len())];
        build_map(photons, &mut blob, 1.0, [0, 1], threads);
        blob
    }

    fn order(photons: &[PhotonRecord]) -> Vec<PhotonRecord> {
        let blob = built(photons, 1);
        PhotonMap::from_blob(&blob).unwrap().photons().map(|(_, p)| p).collect()
    }

    fn shuffle(photons: &mut [PhotonRecord], seed: u64) {
        let mut state = seed | 1;
        for i in (1..photons.len()).rev() {
            state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            photons.swap(i, (state >> 33) as usize % (i + 1));
        }
    }

    /// The definition of a chunk, written as a definition: sort it, and take as many as fit into half of the blocks.
    fn reference(mut photons: Vec<PhotonRecord>) -> Vec<PhotonRecord> {
        let side = |axis: usize| {
            let of = photons.iter().map(|p| p.position()[axis]);
            of.clone().fold(f32::MIN, f32::max) - of.fold(f32::MAX, f32::min)
        };
        let mut axis = 0;
        for i in 1..3 {
            if side(i) > side(axis) {
                axis = i;
            }
        }
        photons.sort_by(|a, b| {
            a.position()[axis]
                .total_cmp(&b.position()[axis])
                .then_with(|| a.as_bytes().cmp(b.as_bytes()))
        });
        if photons.len() > 16 {
            let mut left = 16;
            while left * 2 < photons.len() {
                left *= 2;
            }
            let after = reference(photons.split_off(left));
            photons = reference(photons);
            photons.extend(after);
        }
        photons
    }

    #[test]
    fn ordered_keys_order_and_come_back() {
        let values = [f32::NEG_INFINITY, -3.5, -1e-40, -0.0, 0.0, 1e-40, 2.0, 7.5e9, f32::INFINITY];
        for pair in values.windows(2) {
            assert!(ordered(pair[0].to_bits()) < ordered(pair[1].to_bits()), "{pair:?}");
        }
        for bits in [0, 1, 0x7fc0_0001, 0x8000_0000, 0xffff_ffff, 0x3f80_0000] {
            assert_eq!(unordered(ordered(bits)).to_bits(), bits);
        }
    }

    #[test]
    fn order_of_arrival_and_threads_do_not_show() {
        // In the second, half of all photons lie in one spot or on a line: cells with several chunks' ends in them.
        let mut spot = shuffled(60_000, 8);
        for (i, p) in spot.iter_mut().enumerate() {
            match i % 4 {
                0 => p.position_bits = [1.0f32, 1.5, 0.0].map(f32::to_bits),
                1 => p.position_bits = [1.0f32, 1.5, (i % 7) as f32 * 0.0].map(f32::to_bits),
                _ => {}
            }
        }
        for mut photons in [shuffled(100_000, 7), spot, shuffled(2049, 1), shuffled(2048, 1)] {
            let one = built(&photons, 1);
            PhotonMap::from_blob(&one).unwrap().check().unwrap();
            for threads in [2, 3, 8] {
                assert!(built(&photons, threads) == one, "{threads} threads");
            }
            shuffle(&mut photons, 3);
            assert!(built(&photons, 1) == one, "another order of {} photons", photons.len());
        }
    }

    /// Ties, halves of chunks and places that are empty, with each set of instructions that there is.
    #[test]
    fn instructions_do_not_show() {
        let mut shelf = shuffled(5_000, 4);
        for (i, p) in shelf.iter_mut().enumerate() {
            p.position_bits[i % 2] = ((i % 5) as f32 * 0.5).to_bits();
        }
        let mut numberless = shuffled(3_000, 6);
        for (i, p) in numberless.iter_mut().enumerate() {
            p.position_bits[i % 3] =
                [f32::NAN, -f32::NAN, f32::INFINITY, -0.0, 1.0][i % 5].to_bits();
        }
        for photons in [shuffled(30_000, 7), shuffled(1_000, 1), shuffled(33, 2), shelf, numberless]
        {
            let with = |instructions| {
                let mut blob = vec![0; blob_bytes(photons.len())];
                build_with(&photons, &mut blob, 1.0, [0, 1], 1, instructions);
                blob
            };
            let [portable, others @ ..] = Instructions::ALL.map(with);
            assert!(others.iter().all(|blob| *blob == portable), "{} photons", photons.len());
        }
    }

    /// Every photon once, and chunks as the format's document has them.
    #[test]
    fn photons_go_by_their_cells() {
        let photons = shuffled(30_000, 5);
        let placed = order(&photons);
        let (mut a, mut b) = (photons.clone(), placed.clone());
        crate::canonical_sort(&mut a);
        crate::canonical_sort(&mut b);
        assert!(a == b);
        // 4 x 3 x 3 m: halved along x, y, z (in any order, but x first) four times each.
        let cell = |p: &PhotonRecord| {
            let [x, y, z] = p.position();
            let step = |at: f32, size: f32| ((at / size * 16.0) as u32).min(15);
            let (x, y, z) = (step(x, 4.0), step(y, 3.0), step(z, 3.0));
            (0..4).rev().fold(0, |n, bit| {
                n << 3 | (x >> bit & 1) << 2 | (y >> bit & 1) << 1 | (z >> bit & 1)
            })
        };
        // The box is the photons', a little smaller than the room: the walls are in the first and last cells anyway.
        for (i, chunks) in placed.chunks(CHUNK).collect::<Vec<_>>().windows(2).enumerate() {
            let last = chunks[0].iter().map(cell).max().unwrap();
            let first = chunks[1].iter().map(cell).min().unwrap();
            assert!(last <= first, "chunk {i}: {last} {first}");
        }
        for chunk in placed.chunks(CHUNK) {
            assert!(reference(chunk.to_vec()) == chunk);
        }
    }

    proptest! {
        #[test]
        fn a_chunk_is_the_defined_one_for_any_permutation(
            photons in proptest::collection::vec(coarse_photon(), 0..150), seed: u64,
        ) {
            let expected = reference(photons.clone());
            prop_assert_eq!(&order(&photons), &expected);
            let mut other = photons;
            shuffle(&mut other, seed);
            prop_assert_eq!(&order(&other), &expected);
        }

        #[test]
        fn any_bits_build(photons in proptest::collection::vec(any_photon(), 0..80)) {
            let blob = built(&photons, 1);
            let back: Vec<_> = photons.iter().rev().copied().collect();
            prop_assert_eq!(&built(&back, 2), &blob);
            let map = PhotonMap::from_blob(&blob).unwrap();
            prop_assert_eq!(map.photons().count(), photons.len());
        }
    }
}

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

use super::lanes::{Instructions, Level, Task};
use super::map::open_blob;
use super::order::canonical_cmp;

/// Photons of a chunk.
const CHUNK: usize = 1024;
/// Blocks of a chunk.
const CHUNK_BLOCKS: usize = CHUNK / BLOCK_PHOTONS;
/// Nodes about the blocks of a chunk.
const CHUNK_NODES: usize = CHUNK_BLOCKS / NODE_CHILDREN;
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
    [piece, pieces]: [u32; 2],
    threads: usize,
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
    spread(photons, &mut records[..photons.len()]);
    let lowest = blocks.len().div_ceil(NODE_CHILDREN);
    let (lowest, upper) = nodes.split_at_mut(lowest);
    finish_chunks(blocks, lowest, photons.len(), threads);
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
fn spread(photons: &[PhotonRecord], out: &mut [PhotonRecord]) {
    if photons.len() <= CHUNK {
        out.copy_from_slice(photons);
        return;
    }
    let grid = Grid::new(Instructions::default().run(BoundsOf(photons)));
    let mut ends = vec![0u32; 1 << HALVINGS];
    for p in photons {
        ends[grid.cell(p)] += 1;
    }
    let mut sum = 0;
    for end in &mut ends {
        (*end, sum) = (sum, sum + *end);
    }
    // Now where each cell begins; afterwards where it ends.
    for p in photons {
        let cell = grid.cell(p);
        out[ends[cell] as usize] = *p;
        ends[cell] += 1;
    }
    let mut start = 0;
    for &end in &ends {
        let end = end as usize;
        cut(&mut out[start..end], start);
        start = end;
    }
}

/// Orders a cell's photons, the first of which is number `first`, so that no photon is on the wrong side of the end of a chunk.
fn cut(photons: &mut [PhotonRecord], first: usize) {
    let end = first + photons.len();
    // The ends of chunks within.
    let (low, high) = (first / CHUNK + 1, end.div_ceil(CHUNK));
    if low >= high {
        return;
    }
    let middle = (low + high) / 2 * CHUNK - first;
    let bounds = Instructions::default().run(BoundsOf(photons));
    let axis = longest(&bounds);
    photons.select_nth_unstable_by(middle, |a, b| {
        match ordered(a.position_bits[axis]).cmp(&ordered(b.position_bits[axis])) {
            Ordering::Equal => canonical_cmp(a, b),
            order => order,
        }
    });
    let (before, after) = photons.split_at_mut(middle);
    cut(before, first);
    cut(after, first + middle);
}

/// The bits of an `f32` as an integer that orders as the numbers do (`-0 < +0`; NaNs at the ends).
#[inline(always)]
fn ordered(bits: u32) -> u32 {
    bits ^ ((bits as i32 >> 31) as u32 | 1 << 31)
}

/// Undoes [`ordered`].
#[inline(always)]
fn unordered(key: u32) -> u32 {
    key ^ (!(key as i32 >> 31) as u32 | 1 << 31)
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
fn node_about(boxes: impl Iterator<Item = Bounds>) -> MapNode {
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
fn longest(bounds: &Bounds) -> usize {
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
        let mut bounds = nothing();
        for p in self.0 {
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
    /// Bits of a cell's number by the step along each axis.
    bits: [Vec<u16>; 3],
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
        let bits = [0, 1, 2].map(|axis| {
            let steps = 1u32 << halvings[axis];
            let number = |step: u32| {
                let mut left = halvings[axis];
                let mut number = 0u32;
                for &halved in &order {
                    number <<= 1;
                    if halved == axis {
                        left -= 1;
                        number |= step >> left & 1;
                    }
                }
                number as u16
            };
            (0..steps).map(number).collect()
        });
        let scale = [0, 1, 2].map(|axis| {
            let scale = (1u32 << halvings[axis]) as f32 / size[axis];
            if scale.is_finite() { scale } else { 0.0 }
        });
        Self { min, scale, bits }
    }

    #[inline(always)]
    fn cell(&self, p: &PhotonRecord) -> usize {
        let mut cell = 0;
        for axis in 0..3 {
            let step = (f32::from_bits(p.position_bits[axis]) - self.min[axis]) * self.scale[axis];
            // What is no number is in the first.
            let step = (step as usize).min(self.bits[axis].len() - 1);
            cell |= self.bits[axis][step];
        }
        usize::from(cell) & ((1 << HALVINGS) - 1)
    }
}

/// A chunk to be finished: its blocks hold its photons as records; the nodes about them are to be written.
struct Chunk<'a> {
    blocks: &'a mut [MapBlock],
    nodes: &'a mut [MapNode],
    photons: usize,
}

fn finish_chunks(blocks: &mut [MapBlock], nodes: &mut [MapNode], photons: usize, threads: usize) {
    let chunks = blocks.chunks_mut(CHUNK_BLOCKS).zip(nodes.chunks_mut(CHUNK_NODES)).enumerate();
    let chunks = chunks.map(|(i, (blocks, nodes))| Chunk {
        blocks,
        nodes,
        photons: (photons - i * CHUNK).min(CHUNK),
    });
    let threads = threads.min(photons.div_ceil(CHUNK));
    if threads <= 1 {
        let mut bench = Bench::default();
        chunks.for_each(|chunk| bench.finish(chunk));
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
                        Some(chunk) => bench.finish(chunk),
                        None => break,
                    }
                }
            });
        }
    });
}

/// A photon on its way to its block: its coordinates as [`ordered`] bits, and its number in the chunk.
type Point = [u32; 4];

/// One thread's working memory.
#[derive(Default)]
struct Bench {
    records: Vec<PhotonRecord>,
    points: Vec<Point>,
}

impl Bench {
    fn finish(&mut self, chunk: Chunk<'_>) {
        Instructions::default().run(Finish { bench: self, chunk });
    }
}

struct Finish<'a> {
    bench: &'a mut Bench,
    chunk: Chunk<'a>,
}

impl Task for Finish<'_> {
    type Output = ();

    #[inline(always)]
    fn with<L: Level>(self, _: L) {
        let Self { bench: Bench { records, points }, chunk } = self;
        records.clear();
        points.clear();
        if let Ok(stored) = <[PhotonRecord]>::ref_from_bytes(chunk.blocks.as_bytes()) {
            records.extend_from_slice(&stored[..chunk.photons]);
        }
        points.extend(records.iter().enumerate().map(|(i, p)| {
            let [x, y, z] = p.position_bits;
            [ordered(x), ordered(y), ordered(z), i as u32]
        }));
        divide(points, records);
        for (i, (block, points)) in
            chunk.blocks.iter_mut().zip(points.chunks(BLOCK_PHOTONS)).enumerate()
        {
            *block =
                MapBlock { position_bits: [[NO_PHOTON; BLOCK_PHOTONS]; 3], ..MapBlock::default() };
            for (at, point) in points.iter().enumerate() {
                block.set(at, &records[point[3] as usize]);
            }
            let node = &mut chunk.nodes[i / NODE_CHILDREN];
            if i % NODE_CHILDREN == 0 {
                *node = node_about(std::iter::empty());
            }
            let bounds = box_of(block);
            for axis in 0..3 {
                node.min[axis][i % NODE_CHILDREN] = bounds[0][axis];
                node.max[axis][i % NODE_CHILDREN] = bounds[1][axis];
            }
        }
    }
}

/// Least and greatest of each coordinate.
#[inline(always)]
fn extent(points: &[Point]) -> [Point; 2] {
    let (mut min, mut max) = ([u32::MAX; 4], [0; 4]);
    for p in points {
        for i in 0..4 {
            min[i] = min[i].min(p[i]);
            max[i] = max[i].max(p[i]);
        }
    }
    [min, max]
}

#[inline(always)]
fn longest_of(extent: &[Point; 2]) -> usize {
    let [min, max] = extent.map(|p| [0, 1, 2].map(|i| f32::from_bits(unordered(p[i]))));
    longest(&[min, max])
}

#[inline(always)]
fn key(point: &Point, axis: usize) -> u64 {
    u64::from(point[axis & 3]) << 32 | u64::from(point[3])
}

/// Orders points block by block.
#[inline(always)]
fn divide(points: &mut [Point], records: &[PhotonRecord]) {
    // Ranges that wait, with the extent of their points: 6 halvings of a chunk leave a block.
    let mut waiting = [(0usize, 0usize, [[0; 4]; 2]); 12];
    let mut depth = 0;
    let (mut first, mut end, mut about) = (0, points.len(), extent(points));
    loop {
        let part = &mut points[first..end];
        let axis = longest_of(&about);
        if part.len() <= BLOCK_PHOTONS {
            order_block(part, axis, records);
            if depth == 0 {
                return;
            }
            depth -= 1;
            (first, end, about) = waiting[depth];
            continue;
        }
        let left = count_blocks(part.len()).next_power_of_two() / 2 * BLOCK_PHOTONS;
        part.select_nth_unstable_by_key(left, |p| key(p, axis));
        let median = part[left][axis];
        about = extent(&part[..left]);
        if about[1][axis] == median {
            settle(part, left, axis, records);
            about = extent(&part[..left]);
        }
        waiting[depth] = (first + left, end, extent(&part[left..]));
        depth += 1;
        end = first + left;
    }
}

/// Points that have the median's coordinate go to the left part in the canonical order of their photons.
#[cold]
#[inline(never)]
fn settle(points: &mut [Point], left: usize, axis: usize, records: &[PhotonRecord]) {
    let median = points[left][axis];
    let tied: Vec<usize> = (0..points.len()).filter(|&i| points[i][axis] == median).collect();
    let mut sorted: Vec<Point> = tied.iter().map(|&i| points[i]).collect();
    sorted.sort_unstable_by(|a, b| canonical_cmp(&records[a[3] as usize], &records[b[3] as usize]));
    for (i, point) in tied.into_iter().zip(sorted) {
        points[i] = point;
    }
}

/// Sorts the points of a block along an axis.
#[inline(always)]
fn order_block(points: &mut [Point], axis: usize, records: &[PhotonRecord]) {
    // Each point's place is the number of points before it.
    let n = points.len();
    let mut keys = [u32::MAX; BLOCK_PHOTONS];
    for (key, p) in keys.iter_mut().zip(points.iter()) {
        *key = p[axis & 3];
    }
    let mut places = [0u32; BLOCK_PHOTONS];
    let mut equal = [0u32; BLOCK_PHOTONS];
    for j in 0..BLOCK_PHOTONS {
        let key = keys[j];
        for i in 0..BLOCK_PHOTONS {
            places[i] += u32::from(key < keys[i]);
            equal[i] += u32::from(key == keys[i]);
        }
    }
    let mut sum = 0;
    for count in &equal[..n] {
        sum += count;
    }
    if sum as usize != n {
        points.sort_unstable_by(|a, b| {
            a[axis]
                .cmp(&b[axis])
                .then_with(|| canonical_cmp(&records[a[3] as usize], &records[b[3] as usize]))
        });
        return;
    }
    let mut out = [[0; 4]; BLOCK_PHOTONS];
    for (p, &place) in points.iter().zip(&places) {
        out[place as usize & (BLOCK_PHOTONS - 1)] = *p;
    }
    points.copy_from_slice(&out[..n]);
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
            assert_eq!(unordered(ordered(bits)), bits);
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

//! Finishing a chunk: photons that fit into the processor's nearest memory are halved until they are blocks.
//!
//! A part is halved along the longest side of the box about it. Where, is found by counting how many are within a distance, as in
//! a search; then both halves are moved, sixteen photons at a time, in rounds from one copy to another and back. Nothing
//! waits for a comparison of two photons, but where many have one coordinate.
#![expect(clippy::needless_range_loop, reason = "several arrays, axis by axis")]

use std::cmp::Ordering;
use std::ops::Range;

use enf_layout::map::*;
use enf_layout::photon::PhotonRecord;
use zerocopy::{FromBytes, IntoBytes};

use super::build::{box_of, longest, node_about, nothing, ordered, unordered};
use super::lanes::{Instructions, Level, Task};
use super::order::{canonical_cmp, canonical_start};

/// Photons of a chunk.
pub(super) const CHUNK: usize = 1024;
/// Blocks of a chunk.
pub(super) const CHUNK_BLOCKS: usize = CHUNK / BLOCK_PHOTONS;
/// Nodes about the blocks of a chunk.
pub(super) const CHUNK_NODES: usize = CHUNK_BLOCKS / NODE_CHILDREN;

/// A chunk to be finished: its blocks hold its photons as records; the nodes about them are to be written.
pub(super) struct Chunk<'a> {
    pub(super) blocks: &'a mut [MapBlock],
    pub(super) nodes: &'a mut [MapNode],
    pub(super) photons: usize,
}

/// As many as a chunk has photons, and as many more as a vector may reach beyond the end.
type Column = [u32; CHUNK + BLOCK_PHOTONS];

/// Photons on their way to their blocks.
#[derive(Clone)]
struct Points {
    /// Coordinates along each axis as [`ordered`] numbers.
    keys: [Column; 3],
    /// Numbers in the chunk.
    number: Column,
}

/// One thread's working memory.
pub(super) struct Bench {
    records: Vec<PhotonRecord>,
    /// Before a round of halvings, and after it.
    points: [Points; 2],
}

impl Default for Bench {
    fn default() -> Self {
        let none = [0; CHUNK + BLOCK_PHOTONS];
        let points = Points { keys: [none; 3], number: none };
        Self { records: Vec::with_capacity(CHUNK), points: [points.clone(), points] }
    }
}

impl Bench {
    pub(super) fn finish(&mut self, chunk: Chunk<'_>, instructions: Instructions) {
        instructions.run(Finish { bench: self, chunk });
    }
}

struct Finish<'a> {
    bench: &'a mut Bench,
    chunk: Chunk<'a>,
}

impl Task for Finish<'_> {
    type Output = ();

    #[inline(always)]
    fn with<L: Level>(self, level: L) {
        let Self { bench: Bench { records, points: [points, other] }, chunk } = self;
        records.clear();
        if let Ok(stored) = <[PhotonRecord]>::ref_from_bytes(chunk.blocks.as_bytes()) {
            records.extend_from_slice(&stored[..chunk.photons.min(CHUNK)]);
        }
        for (i, p) in records.iter().enumerate() {
            for axis in 0..3 {
                points.keys[axis][i] = ordered(p.position_bits[axis]) as u32;
            }
            points.number[i] = i as u32;
        }
        let (mut from, mut to) = (points, other);
        let n = records.len();
        let mut size = n.next_power_of_two();
        while size > BLOCK_PHOTONS {
            for first in (0..n).step_by(size) {
                halve(level, from, to, first..n.min(first + size), size / 2, records);
            }
            (from, to) = (to, from);
            size /= 2;
        }
        for (i, block) in chunk.blocks.iter_mut().enumerate() {
            let part = i * BLOCK_PHOTONS..n.min((i + 1) * BLOCK_PHOTONS);
            if part.len() < BLOCK_PHOTONS {
                let position_bits = [[NO_PHOTON; BLOCK_PHOTONS]; 3];
                *block = MapBlock { position_bits, ..MapBlock::default() };
            }
            let (axis, _) = longest_of(&from.keys, part.clone());
            let keys = sixteen(&from.keys[axis], part.start);
            let (mut places, tied) = places(&keys, part.len());
            let numbers = &from.number[part];
            if tied {
                part_tied(&mut places, numbers, records);
            }
            for (&place, &number) in places.iter().zip(numbers) {
                let place = place as usize & (BLOCK_PHOTONS - 1);
                block.set(place, &records[number as usize]);
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

/// Sixteen of a column.
#[inline(always)]
fn sixteen(column: &Column, at: usize) -> [u32; BLOCK_PHOTONS] {
    let mut out = [0; BLOCK_PHOTONS];
    out.copy_from_slice(&column[at..at + BLOCK_PHOTONS]);
    out
}

/// The longest side of the box about a part, and the least and the greatest key along it.
#[inline(always)]
fn longest_of(keys: &[Column; 3], part: Range<usize>) -> (usize, [i32; 2]) {
    let mut ends = [[0; 2]; 3];
    let mut bounds = nothing();
    for axis in 0..3 {
        let (mut least, mut greatest) = (i32::MAX, i32::MIN);
        for &key in &keys[axis][part.clone()] {
            let key = key as i32;
            least = least.min(key);
            greatest = greatest.max(key);
        }
        ends[axis] = [least, greatest];
        bounds[0][axis] = unordered(least);
        bounds[1][axis] = unordered(greatest);
    }
    let axis = longest(&bounds);
    (axis, ends[axis])
}

/// For each sixteen photons of a part, those that go to its left half: a bit each.
type Masks = [u32; CHUNK_BLOCKS];

/// Moves a part, its first `left` points along the longest side of its box before the others. If they are no more, they only move.
#[inline(always)]
fn halve<L: Level>(
    level: L,
    from: &Points,
    to: &mut Points,
    part: Range<usize>,
    left: usize,
    records: &[PhotonRecord],
) {
    let mut masks = [u32::MAX; CHUNK_BLOCKS];
    if part.len() > left {
        let (axis, ends) = longest_of(&from.keys, part.clone());
        let keys = &from.keys[axis];
        let (most, within) = match part.len() <= 2 * BLOCK_PHOTONS {
            true => middle_of(keys, part.clone()),
            false => separator(&keys[part.clone()], ends, left),
        };
        for (mask, first) in masks.iter_mut().zip(part.clone().step_by(BLOCK_PHOTONS)) {
            *mask = not_above(level, &sixteen(keys, first), most);
        }
        if within != left {
            choose_tied(&mut masks, from, axis, part.clone(), left, most, records);
        }
    }
    // What is written beyond the left half's end is written over by the right one's, and beyond that by the next part's.
    for (right, start) in [(0, part.start), (u32::MAX, part.start + left)] {
        let mut at = start;
        for (mask, first) in masks.iter().zip(part.clone().step_by(BLOCK_PHOTONS)) {
            let there = u32::MAX >> (u32::BITS as usize - (part.end - first).min(BLOCK_PHOTONS));
            let mask = (mask ^ right) & there;
            for axis in 0..3 {
                let moved = level.front(&sixteen(&from.keys[axis], first), mask);
                to.keys[axis][at..at + BLOCK_PHOTONS].copy_from_slice(&moved);
            }
            let moved = level.front(&sixteen(&from.number, first), mask);
            to.number[at..at + BLOCK_PHOTONS].copy_from_slice(&moved);
            at += mask.count_ones() as usize;
        }
        if part.len() <= left {
            break;
        }
    }
}

/// Which of sixteen keys are not above another, a bit each.
#[inline(always)]
fn not_above<L: Level>(level: L, keys: &[u32; BLOCK_PHOTONS], most: i32) -> u32 {
    let mut is = [0; BLOCK_PHOTONS];
    for i in 0..BLOCK_PHOTONS {
        is[i] = if keys[i] as i32 <= most { u32::MAX } else { 0 };
    }
    level.nonzero16(&is)
}

/// A number that exactly `left` of the keys are not above, if there is one, else the key that is in the way; and how many
/// are not above that. There are more than `left` keys, from the least to the greatest of `ends`.
#[inline(always)]
fn separator(keys: &[u32], ends: [i32; 2], left: usize) -> (i32, usize) {
    // Fewer are not above `low`, as many or more are not above `high`.
    let (mut low, mut high) = (i64::from(ends[0]) - 1, ends[1]);
    let (mut below, mut within) = (0, keys.len());
    let mut round = 0;
    while within != left && i64::from(high) - low > 1 {
        round += 1;
        let first = (low + 1) as i32;
        // As if they were spread evenly, but every fourth time.
        let (start, end) = (unordered(first), unordered(high));
        let share = ((left - below) as f32 + 0.5) / ((within - below) as f32 + 1.0);
        let middle = match round % 4 {
            0 => ((i64::from(first) + i64::from(high)) >> 1) as i32,
            _ => ordered((start + (end - start) * share).to_bits()),
        };
        let middle = middle.clamp(first, high - 1);
        let mut count = 0i32;
        for &key in keys {
            count += i32::from(key as i32 <= middle);
        }
        let count = count as usize;
        // Nearly there, or in the way of many that are equal: on to the next key.
        let closer = round % 4 == 0;
        if count >= left {
            let mut last = if closer { i32::MIN } else { middle };
            if closer {
                for &key in keys {
                    last = last.max(if key as i32 <= middle { key as i32 } else { i32::MIN });
                }
            }
            (high, within) = (last, count);
        } else {
            let mut next = if closer { i32::MAX } else { middle + 1 };
            if closer {
                for &key in keys {
                    next = next.min(if key as i32 <= middle { i32::MAX } else { key as i32 });
                }
            }
            (low, below) = (i64::from(next) - 1, count);
        }
    }
    (high, within)
}

/// The same for one block and less than another: counts how many keys are below each.
#[inline(always)]
fn middle_of(keys: &Column, part: Range<usize>) -> (i32, usize) {
    let mut here = [i32::MAX; 2 * BLOCK_PHOTONS];
    for (here, &key) in here.iter_mut().zip(&keys[part.clone()]) {
        *here = key as i32;
    }
    let mut below = [0i32; 2 * BLOCK_PHOTONS];
    for j in 0..2 * BLOCK_PHOTONS {
        let key = here[j];
        for i in 0..2 * BLOCK_PHOTONS {
            below[i] += i32::from(key < here[i]);
        }
    }
    let mut most = i32::MIN;
    for i in 0..2 * BLOCK_PHOTONS {
        most = most.max(if below[i] < BLOCK_PHOTONS as i32 { here[i] } else { i32::MIN });
    }
    let mut within = 0i32;
    for i in 0..2 * BLOCK_PHOTONS {
        within += i32::from(here[i] <= most);
    }
    // Places that are empty may be among them, if a key is as great as any.
    (most, (within as usize).min(part.len()))
}

/// Of those whose key is `tied`, as many go to the left as are missing there, in the canonical order of their photons.
#[cold]
#[inline(never)]
fn choose_tied(
    masks: &mut Masks,
    points: &Points,
    axis: usize,
    part: Range<usize>,
    left: usize,
    tied: i32,
    records: &[PhotonRecord],
) {
    let record = |i: u16| &records[points.number[part.start + usize::from(i)] as usize];
    let mut equal = Vec::with_capacity(part.len());
    let mut before = 0;
    for (i, &key) in points.keys[axis][part.clone()].iter().enumerate() {
        before += usize::from((key as i32) < tied);
        if key as i32 == tied {
            masks[i / BLOCK_PHOTONS] &= !(1 << (i % BLOCK_PHOTONS));
            equal.push((canonical_start(record(i as u16)), i as u16));
        }
    }
    let wanted = left - before;
    if wanted < equal.len() {
        equal.select_nth_unstable_by(wanted, |a, b| {
            a.0.cmp(&b.0).then_with(|| canonical_cmp(record(a.1), record(b.1)))
        });
    }
    for &(_, i) in equal.iter().take(wanted) {
        let i = usize::from(i);
        masks[i / BLOCK_PHOTONS] |= 1 << (i % BLOCK_PHOTONS);
    }
}

/// Where each of the first `n` of sixteen keys comes in their order, and whether some of them are the same and have one place.
#[inline(always)]
fn places(keys: &[u32; BLOCK_PHOTONS], n: usize) -> ([i32; BLOCK_PHOTONS], bool) {
    let mut here = [i32::MAX; BLOCK_PHOTONS];
    for i in 0..BLOCK_PHOTONS {
        here[i] = if i < n { keys[i] as i32 } else { i32::MAX };
    }
    let mut places = [0i32; BLOCK_PHOTONS];
    let mut equal = [0i32; BLOCK_PHOTONS];
    for j in 0..BLOCK_PHOTONS {
        let key = here[j];
        for i in 0..BLOCK_PHOTONS {
            places[i] += i32::from(key < here[i]);
            equal[i] += i32::from(key == here[i]);
        }
    }
    let mut sum = 0;
    for &equal in &equal[..n] {
        sum += equal;
    }
    (places, sum as usize != n)
}

/// Makes one place after the other of one that several photons have, in canonical order.
#[cold]
#[inline(never)]
fn part_tied(places: &mut [i32; BLOCK_PHOTONS], numbers: &[u32], records: &[PhotonRecord]) {
    let shared = *places;
    let record = |i: usize| &records[numbers[i] as usize];
    for i in 0..numbers.len() {
        for j in 0..i {
            if shared[i] == shared[j] {
                match canonical_cmp(record(j), record(i)) {
                    Ordering::Greater => places[j] += 1,
                    _ => places[i] += 1,
                }
            }
        }
    }
}

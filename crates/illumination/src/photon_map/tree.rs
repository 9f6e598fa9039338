//! Balancing: a multiset of photons becomes one left-balanced kd-tree, always the same one.
//!
//! The tree has no pointers: the children of `i` are `2i+1` and `2i+2` (Jensen 2001, section 5.2.2). A
//! node is the left-balanced median of its subtree along the longest side of the subtree's bounding
//! box. "Median" is by coordinate, then by canonical order, and that order is total up to identical
//! records: which photon is a node, and which ones lie on either side, is a property of the multiset.
//! Hence sorting first would change nothing but the time, and nobody does.

use std::cmp::Ordering;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use enf_layout::photon::{PHOTON_AXIS_MASK, PhotonRecord};

use super::order::canonical_cmp;

/// Subtrees below this many photons are not worth another thread.
const LEAST_TASK: usize = 16_384;

/// Balances photons into a left-balanced kd-tree, in place.
///
/// Heap order: the children of `i` are `2i+1` and `2i+2`. The splitting axis is the longest side of the
/// subtree's bounding box (the lowest axis among equals) and goes to bits 0 and 1 of `flags`, whatever
/// was there before. Equal coordinates go by canonical order. The resulting bytes depend only on the
/// multiset of records: not on their order, not on `threads`.
///
/// `scratch` is as long as `photons`; its contents are irrelevant before and unspecified after.
///
/// # Panics
/// If `scratch` has another length than `photons`.
pub fn build_tree(photons: &mut [PhotonRecord], scratch: &mut [PhotonRecord], threads: usize) {
    assert_eq!(photons.len(), scratch.len(), "scratch must be as long as the photons");
    for p in photons.iter_mut() {
        p.flags &= !PHOTON_AXIS_MASK;
        p.position_bits = p.position_bits.map(ordered);
    }
    let root = Subtree { rows: rows(scratch), photons };
    let least = LEAST_TASK.max(root.photons.len() / (threads.max(1) * 8));
    if threads <= 1 || root.photons.len() <= least {
        root.build();
    } else {
        build_in_parallel(root, threads, least);
    }
    photons.copy_from_slice(scratch);
}

/// The bits of an `f32` as an integer that orders as the numbers do (`-0 < +0`; NaNs at the ends).
#[inline]
fn ordered(bits: u32) -> u32 {
    bits ^ ((bits as i32 >> 31) as u32 | 1 << 31)
}

/// Undoes [`ordered`].
#[inline]
fn unordered(key: u32) -> u32 {
    key ^ (!(key as i32 >> 31) as u32 | 1 << 31)
}

#[inline]
fn restored(p: &PhotonRecord) -> PhotonRecord {
    PhotonRecord { position_bits: p.position_bits.map(unordered), ..*p }
}

#[cold]
#[inline(never)]
fn tie(a: &PhotonRecord, b: &PhotonRecord) -> Ordering {
    canonical_cmp(&restored(a), &restored(b))
}

/// Photons of the left subtree of a left-balanced tree of `n > 0`.
fn left_count(n: usize) -> usize {
    let full = 1usize << n.ilog2();
    let bottom = n - (full - 1);
    (full - 1) / 2 + bottom.min(full / 2)
}

/// Cuts a heap into its levels. A subtree's photons lie side by side in each of them, which is what
/// lets threads share the output without sharing memory.
fn rows(mut heap: &mut [PhotonRecord]) -> Vec<&mut [PhotonRecord]> {
    let mut rows = Vec::with_capacity(heap.len().checked_ilog2().map_or(0, |l| l as usize + 1));
    let mut width = 1;
    while !heap.is_empty() {
        let (row, rest) = heap.split_at_mut(width.min(heap.len()));
        rows.push(row);
        heap = rest;
        width *= 2;
    }
    rows
}

/// Longest side of the bounding box.
fn longest_axis(photons: &[PhotonRecord]) -> usize {
    let (mut min, mut max) = ([u32::MAX; 3], [0u32; 3]);
    for p in photons {
        for i in 0..3 {
            min[i] = min[i].min(p.position_bits[i]);
            max[i] = max[i].max(p.position_bits[i]);
        }
    }
    let side = |i: usize| f32::from_bits(unordered(max[i])) - f32::from_bits(unordered(min[i]));
    let mut axis = 0;
    for i in 1..3 {
        if side(i) > side(axis) {
            axis = i;
        }
    }
    axis
}

/// Partitions about the median; returns it, finished, and how many photons lie before it.
fn split(photons: &mut [PhotonRecord]) -> (PhotonRecord, usize) {
    let axis = longest_axis(photons);
    let left = left_count(photons.len());
    let by_axis = |a: &PhotonRecord, b: &PhotonRecord| match a.position_bits[axis]
        .cmp(&b.position_bits[axis])
    {
        Ordering::Equal => tie(a, b),
        order => order,
    };
    let (_, median, _) = photons.select_nth_unstable_by(left, by_axis);
    let mut node = restored(median);
    node.flags |= axis as u16;
    (node, left)
}

/// A subtree to be built: its photons, and its place in every level of the output.
struct Subtree<'a> {
    photons: &'a mut [PhotonRecord],
    rows: Vec<&'a mut [PhotonRecord]>,
}

impl<'a> Subtree<'a> {
    fn build(mut self) {
        build_below(self.photons, &mut self.rows, 0);
    }

    /// Writes the root; returns what is left to do.
    fn fork(self) -> (Self, Self) {
        let (node, left) = split(self.photons);
        let (before, rest) = self.photons.split_at_mut(left);
        let (_, after) = rest.split_at_mut(1);
        let mut width = 1;
        let (mut left_rows, mut right_rows) = (Vec::new(), Vec::new());
        for (level, row) in self.rows.into_iter().enumerate() {
            if level == 0 {
                row[0] = node;
                continue;
            }
            let (l, r) = row.split_at_mut(width.min(row.len()));
            left_rows.push(l);
            right_rows.push(r);
            width *= 2;
        }
        (Self { photons: before, rows: left_rows }, Self { photons: after, rows: right_rows })
    }
}

/// Builds a subtree whose root is number `at` of the first row.
fn build_below(photons: &mut [PhotonRecord], rows: &mut [&mut [PhotonRecord]], at: usize) {
    let Some((row, below)) = rows.split_first_mut().filter(|_| !photons.is_empty()) else {
        return;
    };
    if let [photon] = photons {
        row[at] = restored(photon);
        return;
    }
    let (node, left) = split(photons);
    row[at] = node;
    build_below(&mut photons[..left], below, 2 * at);
    build_below(&mut photons[left + 1..], below, 2 * at + 1);
}

/// What the threads share: subtrees that wait, and how many are not finished.
struct Queue<'a> {
    waiting: Vec<Subtree<'a>>,
    unfinished: usize,
}

fn build_in_parallel(root: Subtree, threads: usize, least: usize) {
    let queue = Mutex::new(Queue { waiting: vec![root], unfinished: 1 });
    let changed = Condvar::new();
    std::thread::scope(|scope| {
        for _ in 1..threads {
            scope.spawn(|| work(&queue, &changed, least));
        }
        work(&queue, &changed, least);
    });
}

fn work(queue: &Mutex<Queue>, changed: &Condvar, least: usize) {
    let lock = || -> MutexGuard<Queue> { queue.lock().unwrap_or_else(PoisonError::into_inner) };
    loop {
        let mut q = lock();
        let mut task = loop {
            if q.unfinished == 0 {
                return;
            }
            match q.waiting.pop() {
                Some(task) => break task,
                None => q = changed.wait(q).unwrap_or_else(PoisonError::into_inner),
            }
        };
        drop(q);
        while task.photons.len() > least {
            let (left, right) = task.fork();
            let mut q = lock();
            q.waiting.push(right);
            q.unfinished += 1;
            drop(q);
            changed.notify_one();
            task = left;
        }
        task.build();
        let mut q = lock();
        q.unfinished -= 1;
        if q.unfinished == 0 {
            changed.notify_all();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::tests_support::{any_photon, coarse_photon, shuffled};
    use proptest::prelude::*;
    use zerocopy::IntoBytes;

    fn built(photons: &[PhotonRecord], threads: usize) -> Vec<PhotonRecord> {
        let mut tree = photons.to_vec();
        let mut scratch = vec![PhotonRecord::default(); tree.len()];
        build_tree(&mut tree, &mut scratch, threads);
        tree
    }

    /// The definition, written as a definition: sort the subtree, take the median.
    fn reference(mut photons: Vec<PhotonRecord>, out: &mut [PhotonRecord], at: usize) {
        if photons.is_empty() {
            return;
        }
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
        let n = photons.len();
        // Fill a heap of n places and count those below the left child.
        let below_left = (0..n).filter(|&i| {
            let mut i = i;
            while i > 2 {
                i = (i - 1) / 2;
            }
            i == 1
        });
        let left = below_left.count();
        out[at] = photons[left];
        out[at].flags |= axis as u16;
        reference(photons[left + 1..].to_vec(), out, 2 * at + 2);
        photons.truncate(left);
        reference(photons, out, 2 * at + 1);
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
    fn left_counts() {
        for (n, left) in [(1, 0), (2, 1), (3, 1), (4, 2), (5, 3), (6, 3), (7, 3), (8, 4), (12, 7)] {
            assert_eq!(left_count(n), left, "{n}");
        }
    }

    #[test]
    fn threads_do_not_show() {
        let photons = shuffled(100_000, 7);
        let one = built(&photons, 1);
        for threads in [2, 3, 8] {
            assert!(built(&photons, threads) == one, "{threads} threads");
        }
    }

    proptest! {
        #[test]
        fn tree_is_the_defined_one_for_any_permutation(
            photons in proptest::collection::vec(coarse_photon(), 0..150), seed: u64, threads in 1usize..4,
        ) {
            let mut expected = vec![PhotonRecord::default(); photons.len()];
            reference(photons.clone(), &mut expected, 0);
            prop_assert_eq!(&built(&photons, threads), &expected);
            let mut other = photons;
            let mut state = seed | 1;
            for i in (1..other.len()).rev() {
                state = state.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                other.swap(i, (state >> 33) as usize % (i + 1));
            }
            prop_assert_eq!(&built(&other, threads), &expected);
            // Building a tree from a tree gives the same tree.
            prop_assert_eq!(&built(&expected, threads), &expected);
        }

        #[test]
        fn any_bits_build(photons in proptest::collection::vec(any_photon(), 0..80)) {
            let tree = built(&photons, 1);
            let mut back: Vec<_> = photons.iter().rev().copied().collect();
            back = built(&back, 2);
            prop_assert_eq!(tree.as_bytes(), back.as_bytes());
        }
    }
}

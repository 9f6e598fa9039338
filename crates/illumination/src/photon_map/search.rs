//! The nearest photons that pass a test: boxes nearest first, and whatever is near enough is noted down. When there are
//! too many notes the farthest are struck out, by counting how many are within a distance, which vectors do
//! sixteen at a time; there is no heap.

use std::cmp::Ordering;

use enf_layout::map::{BLOCK_PHOTONS, MapBlock, NODE_CHILDREN};
use enf_layout::photon::PhotonRecord;

use super::lanes::{Level, Task, box_distances, photon_distances};
use super::map::PhotonMap;
use super::order::stored_cmp;

/// Deepest stack: 10 levels of a piece of 2^32 photons, and as many above the pieces.
const STACK: usize = 20 * NODE_CHILDREN;

/// What photons must be to be noted down.
pub(super) trait Filter {
    /// Clears the bits of photons that do not count. `d2` are the squared distances, m².
    fn pass<L: Level>(
        &mut self,
        level: L,
        block: &MapBlock,
        d2: &[f32; BLOCK_PHOTONS],
        mask: u32,
    ) -> u32;
}

/// Any photon will do.
pub(super) struct Anything;

impl Filter for Anything {
    #[inline(always)]
    fn pass<L: Level>(&mut self, _: L, _: &MapBlock, _: &[f32; BLOCK_PHOTONS], mask: u32) -> u32 {
        mask
    }
}

/// Photons noted down: squared distances as bits, which order as the numbers do, and which photons they are.
#[derive(Clone, Debug, Default)]
pub(super) struct Notes {
    d2: Vec<u32>,
    photon: Vec<u32>,
    len: usize,
    k: usize,
    full: usize,
    /// A piece that a search has come to and that is not in memory; stays until it is asked for.
    missing: Option<u32>,
}

impl Notes {
    /// Room for the nearest `k`.
    pub(super) fn with_capacity(k: usize) -> Self {
        let mut notes = Self::default();
        notes.begin(k.min(1 << 20), usize::MAX);
        notes
    }

    pub(super) fn bytes(&self) -> usize {
        (self.d2.capacity() + self.photon.capacity()) * size_of::<u32>()
    }

    /// Strikes everything out; `all` is how many photons there are to be noted at most.
    fn begin(&mut self, k: usize, all: usize) {
        self.k = k;
        self.len = 0;
        self.full = k.saturating_add((k / 2).max(48)).min(all.saturating_add(1));
        let room = self.full + 2 * BLOCK_PHOTONS;
        if self.d2.len() < room {
            self.d2.resize(room, 0);
            self.photon.resize(room, 0);
        }
    }

    pub(super) fn photons(&self) -> &[u32] {
        &self.photon[..self.len]
    }

    /// Squared distances as bits.
    pub(super) fn distances2(&self) -> &[u32] {
        &self.d2[..self.len]
    }

    #[inline(always)]
    fn note<L: Level>(&mut self, level: L, first: u32, d2: &[f32; BLOCK_PHOTONS], mask: u32) {
        let (mut bits, mut which) = ([0; BLOCK_PHOTONS], [0; BLOCK_PHOTONS]);
        for i in 0..BLOCK_PHOTONS {
            bits[i] = d2[i].to_bits();
            which[i] = first + i as u32;
        }
        let to = self.len..self.len + BLOCK_PHOTONS;
        self.d2[to.clone()].copy_from_slice(&level.front(&bits, mask));
        self.photon[to].copy_from_slice(&level.front(&which, mask));
        self.len += mask.count_ones() as usize;
    }

    /// Strikes out all but the nearest `k` and `slack` more at most, except for some at the farthest distance that
    /// is kept; returns that distance, squared.
    #[inline(always)]
    fn strike<L: Level>(&mut self, level: L, slack: usize) -> f32 {
        let (bound, _) = threshold(&self.d2[..self.len], self.k, slack);
        let limit = f32::from_bits(bound);
        let mut kept = 0;
        for first in (0..self.len).step_by(BLOCK_PHOTONS) {
            let (mut d2, mut which) = ([0; BLOCK_PHOTONS], [0; BLOCK_PHOTONS]);
            d2.copy_from_slice(&self.d2[first..first + BLOCK_PHOTONS]);
            which.copy_from_slice(&self.photon[first..first + BLOCK_PHOTONS]);
            let mut distances = [0.0; BLOCK_PHOTONS];
            for i in 0..BLOCK_PHOTONS {
                distances[i] = f32::from_bits(d2[i]);
            }
            let there = u32::MAX >> (32 - (self.len - first).min(BLOCK_PHOTONS));
            let mask = level.within16(&distances, limit) & there;
            self.d2[kept..kept + BLOCK_PHOTONS].copy_from_slice(&level.front(&d2, mask));
            self.photon[kept..kept + BLOCK_PHOTONS].copy_from_slice(&level.front(&which, mask));
            kept += mask.count_ones() as usize;
        }
        self.len = kept;
        limit
    }

    /// A piece that searches since the last call lacked: what they found is not all.
    pub(super) fn take_missing(&mut self) -> Option<u32> {
        self.missing.take()
    }

    /// Whether a search since then has lacked one.
    pub(super) fn is_missing(&self) -> bool {
        self.missing.is_some()
    }

    /// Whether `k` were found.
    pub(super) fn is_full(&self) -> bool {
        self.k > 0 && self.len == self.k
    }

    /// With more than `k` left, at equal distance, those at the farthest that come first in the order of
    /// the photons' bytes stay; the farthest of all is put first.
    fn settle(&mut self, photon: impl Fn(u32) -> PhotonRecord) {
        let k = self.k.min(self.len);
        if k == 0 {
            return;
        }
        let farthest = self.d2[..self.len].iter().copied().max().unwrap_or(0);
        let tied = self.d2[..self.len].iter().filter(|&&d| d == farthest).count();
        if tied > 1 {
            let mut last: Vec<u32> = Vec::with_capacity(tied);
            let mut kept = 0;
            for i in 0..self.len {
                if self.d2[i] == farthest {
                    last.push(self.photon[i]);
                } else {
                    (self.d2[kept], self.photon[kept]) = (self.d2[i], self.photon[i]);
                    kept += 1;
                }
            }
            last.sort_by(|&a, &b| match stored_cmp(&photon(a), &photon(b)) {
                Ordering::Equal => a.cmp(&b),
                order => order,
            });
            for &which in &last[..k - kept] {
                (self.d2[kept], self.photon[kept]) = (farthest, which);
                kept += 1;
            }
            self.len = k;
            self.d2.swap(0, k - 1);
            self.photon.swap(0, k - 1);
        } else if let Some(at) = self.d2[..self.len].iter().position(|&d| d == farthest) {
            self.d2.swap(0, at);
            self.photon.swap(0, at);
        }
    }
}

/// A number that at least `k` are not above, and at most `k + slack`, unless many are equal to it; and how many. There
/// are at least `k` of them. All are bits of numbers that are not negative.
#[inline(always)]
fn threshold(of: &[u32], k: usize, slack: usize) -> (u32, usize) {
    let mut most = 0;
    for &x in of {
        most = if x as i32 > most { x as i32 } else { most };
    }
    let (mut low, mut high) = (-1i32, most);
    let (mut below, mut within) = (0, of.len());
    let mut round = 0;
    while within > k + slack && high - low > 1 {
        round += 1;
        let middle = if round % 4 == 0 {
            low + (high - low) / 2
        } else {
            // On a surface as many photons are in each ring of equal area: squared distances are spread evenly.
            let (from, to) = (f32::from_bits(low.max(0) as u32), f32::from_bits(high as u32));
            let part = (k + slack / 2 - below) as f32 + 0.5;
            (from + (to - from) * (part / (within - below) as f32)).to_bits() as i32
        };
        let middle = middle.clamp(low + 1, high - 1);
        let mut count = 0i32;
        for &x in of {
            count += i32::from(x as i32 <= middle);
        }
        let count = count as usize;
        if count >= k {
            (high, within) = (middle, count);
        } else {
            (low, below) = (middle, count);
        }
    }
    (high as u32, within)
}

/// A box that waits to be opened.
#[derive(Clone, Copy, Debug, Default)]
struct Waiting {
    d2: f32,
    /// [`ABOVE`] for the levels above the pieces.
    piece: u32,
    /// 0 is a block.
    level: u32,
    index: u32,
}

const ABOVE: u32 = u32::MAX;

/// In place of the level of a piece that is not in memory.
pub(super) const ABSENT: u32 = u32::MAX;

/// Boxes that wait, the nearest last.
#[derive(Clone, Debug)]
pub(super) struct Stack {
    waiting: [Waiting; STACK],
}

impl Default for Stack {
    fn default() -> Self {
        Self { waiting: [Waiting::default(); STACK] }
    }
}

/// One search.
pub(super) struct Search<'a, F> {
    pub(super) map: &'a PhotonMap<'a>,
    pub(super) point: [f32; 3],
    /// Photons farther than this (squared) do not count.
    pub(super) radius2: f32,
    /// Photons farther than this (squared) probably do not matter; any number is right.
    pub(super) guess2: f32,
    pub(super) k: usize,
    pub(super) notes: &'a mut Notes,
    pub(super) stack: &'a mut Stack,
    pub(super) filter: F,
}

impl<F: Filter> Task for Search<'_, F> {
    type Output = ();

    #[inline(always)]
    fn with<L: Level>(mut self, level: L) {
        let radius2 = self.radius2.min(f32::MAX);
        let mut bound = radius2.min(self.guess2);
        loop {
            self.notes.begin(self.k, self.map.places());
            if self.k == 0 {
                return;
            }
            self.look(level, bound);
            if self.notes.len >= self.k || bound >= radius2 {
                break;
            }
            bound = radius2;
        }
        if self.notes.len >= self.k {
            self.notes.strike(level, 0);
        }
        let map = self.map;
        self.notes.settle(|i| map.photon(i));
    }
}

impl<F: Filter> Search<'_, F> {
    /// Notes down what is within the bound, which shrinks.
    #[inline(always)]
    fn look<L: Level>(&mut self, level: L, mut bound: f32) {
        let Some(root) = self.map.root() else { return };
        let mut next = Waiting { d2: 0.0, piece: root.piece, level: root.level, index: 0 };
        let mut depth = 0;
        let stack = &mut self.stack.waiting;
        loop {
            if next.level == 0 && next.piece != ABOVE {
                let (block, first) = self.map.block(next.piece, next.index);
                let d2 = photon_distances(block, &self.point);
                let mut mask = level.within16(&d2, bound);
                if mask != 0 {
                    mask = self.filter.pass(level, block, &d2, mask);
                    self.notes.note(level, first, &d2, mask);
                    if self.notes.len >= self.notes.full {
                        let near = self.notes.strike(level, self.k / 8);
                        bound = if near < bound { near } else { bound };
                    }
                }
            } else if next.level == ABSENT {
                self.notes.missing.get_or_insert(next.piece);
                return;
            } else {
                let node = self.map.node(next.piece, next.level, next.index);
                let d2 = box_distances(node, &self.point);
                let mut mask = level.within8(&d2, bound);
                let base = depth;
                while mask != 0 {
                    let i = mask.trailing_zeros();
                    mask &= mask - 1;
                    let child = if next.piece == ABOVE {
                        self.map.below(next.level, next.index * NODE_CHILDREN as u32 + i)
                    } else {
                        let index = next.index * NODE_CHILDREN as u32 + i;
                        (next.piece, next.level - 1, index)
                    };
                    let d2 = d2[i as usize & (NODE_CHILDREN - 1)];
                    let new = Waiting { d2, piece: child.0, level: child.1, index: child.2 };
                    let mut at = depth;
                    while at > base && stack[at - 1].d2 < d2 {
                        stack[at] = stack[at - 1];
                        at -= 1;
                    }
                    stack[at] = new;
                    depth += 1;
                }
            }
            loop {
                if depth == 0 {
                    return;
                }
                depth -= 1;
                next = stack[depth];
                if next.d2 <= bound {
                    break;
                }
            }
        }
    }
}

/// Where a search begins.
#[derive(Clone, Copy, Debug)]
pub(super) struct Root {
    pub(super) piece: u32,
    pub(super) level: u32,
}

/// The level above the pieces, as a root.
pub(super) fn above(level: u32) -> Root {
    Root { piece: ABOVE, level }
}

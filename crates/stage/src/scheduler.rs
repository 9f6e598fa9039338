//! Which tile to visit next.
//!
//! The paper takes the room with the most photons waiting (Fradin et al. 2005, section 5.2). That
//! is good when every visit costs a load; but a tile that is still resident costs none, and the
//! paper's own outlook asks for just that. So the default takes what is resident as long as anything
//! waits there: what is left behind has to be loaded again for the sake of a few photons, which takes
//! longer than to trace thousands. When a tile has to be loaded, it is a neighbour of those that were
//! visited last, if enough waits there, so that light goes to and fro among tiles that are in memory
//! together; only then the tile with the most work.
//!
//! Purely a matter of time: which tile comes first changes no photon.

use clap::ValueEnum;

use crate::neighbours::Neighbours;

/// A neighbour is worth loading before its time if it has this part of the work of the busiest tile.
const WORTH_LOADING: u64 = 100;

/// How the next tile is chosen (`--schedule`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Schedule {
    /// The tile with the most work, as in the paper.
    MostWork,
    /// The resident tile with the most work; else a neighbour of the last ones; else the tile with the most work.
    #[default]
    ResidentFirst,
}

/// How much is waiting where. Equal work goes to the lowest tile, so the order is reproducible.
///
/// A tournament tree over the tiles: adding costs the logarithm of their number, and who has the
/// most is known at any time.
#[derive(Clone, Debug)]
pub struct Scheduler {
    schedule: Schedule,
    /// Number of leaves of `most`, a power of two.
    width: usize,
    /// Complete binary tree from index 1: each node is the most work among its leaves.
    most: Vec<u64>,
    /// Of each tile's work, how much is on disk.
    on_disk: Vec<u64>,
    total: u64,
}

impl Scheduler {
    /// A scheduler over tiles `0..tiles` with nothing to do.
    pub fn new(schedule: Schedule, tiles: u32) -> Self {
        let width = (tiles.max(1) as usize).next_power_of_two();
        Self { schedule, width, most: vec![0; 2 * width], on_disk: vec![0; width], total: 0 }
    }

    /// The bytes that a scheduler of this many tiles holds.
    pub fn memory_bytes(tiles: u32) -> u64 {
        u64::from(tiles.max(1)).next_power_of_two() * 24
    }

    /// `n` more records wait in memory for `tile`. Tiles are dense; one beyond the number given at
    /// the start makes the table grow.
    pub fn add(&mut self, tile: u32, n: u64) {
        self.change(tile, |work| work.saturating_add(n));
    }

    /// `n` more records wait on disk for `tile`: what a resumed run finds there.
    pub fn add_on_disk(&mut self, tile: u32, n: u64) {
        self.add(tile, n);
        self.on_disk[tile as usize] += n;
    }

    /// `n` of the records that waited in memory for `tile` were written out.
    pub fn spilled(&mut self, tile: u32, n: u64) {
        let work = self.pending(tile);
        if let Some(on_disk) = self.on_disk.get_mut(tile as usize) {
            *on_disk = on_disk.saturating_add(n).min(work);
        }
    }

    /// Takes all the work of `tile`, and says how much that was.
    pub fn take(&mut self, tile: u32) -> u64 {
        let work = self.pending(tile);
        if work > 0 {
            self.on_disk[tile as usize] = 0;
            self.change(tile, |_| 0);
        }
        work
    }

    /// Records that wait for `tile`, in memory and on disk.
    pub fn pending(&self, tile: u32) -> u64 {
        match tile as usize {
            tile if tile < self.width => self.most[self.width + tile],
            _ => 0,
        }
    }

    /// Records that wait for `tile` on disk.
    pub fn pending_on_disk(&self, tile: u32) -> u64 {
        self.on_disk.get(tile as usize).copied().unwrap_or(0)
    }

    /// Records that wait for `tile` in memory.
    pub fn pending_in_memory(&self, tile: u32) -> u64 {
        self.pending(tile) - self.pending_on_disk(tile)
    }

    /// Records that wait anywhere; 0 means that the work is done.
    pub fn total(&self) -> u64 {
        self.total
    }

    /// The tile to visit next, or `None` if nothing waits anywhere. `resident` says whether a tile
    /// is loaded; it is asked for tiles with work only. See [`Self::next_among`] if the resident
    /// tiles are at hand as a list.
    pub fn next(&self, resident: &dyn Fn(u32) -> bool) -> Option<u32> {
        let global = self.busiest()?;
        if self.schedule == Schedule::MostWork {
            return Some(global);
        }
        let works = &self.most[self.width..];
        let (mut best, mut best_work) = (None, 0);
        for (tile, &work) in works.iter().enumerate() {
            let tile = tile as u32;
            if work > best_work && resident(tile) {
                (best, best_work) = (Some(tile), work);
            }
        }
        best.or(Some(global))
    }

    /// [`Self::next`] with the resident tiles as a list in any order: cheaper, since they are few.
    pub fn next_among(&self, resident: &[u32]) -> Option<u32> {
        let global = self.busiest()?;
        if self.schedule == Schedule::MostWork {
            return Some(global);
        }
        let best = resident
            .iter()
            .map(|&tile| (self.pending(tile), tile))
            .filter(|&(work, _)| work > 0)
            .max_by(|a, b| a.0.cmp(&b.0).then(b.1.cmp(&a.1)));
        Some(best.map_or(global, |(_, tile)| tile))
    }

    /// Whether what is resident comes before what is not.
    pub fn prefers_residents(&self) -> bool {
        self.schedule == Schedule::ResidentFirst
    }

    /// The tile to visit next among those that are not `busy`, if that one is resident: `residents` are those that are, in any order.
    pub fn next_visit(
        &self,
        residents: impl IntoIterator<Item = u32>,
        busy: &dyn Fn(u32) -> bool,
    ) -> Option<u32> {
        let idle = residents.into_iter().filter(|&tile| self.pending(tile) > 0 && !busy(tile));
        match self.schedule {
            Schedule::MostWork => {
                let busiest = self.busiest_except(busy)?;
                idle.into_iter().find(|&tile| tile == busiest)
            }
            Schedule::ResidentFirst => {
                idle.max_by(|&a, &b| self.pending(a).cmp(&self.pending(b)).then(b.cmp(&a)))
            }
        }
    }

    /// The tile to load next among those that are not `excluded` (resident, or being loaded). `recent` are the
    /// resident tiles, the last used first.
    pub fn next_load(
        &self,
        recent: impl IntoIterator<Item = u32>,
        neighbours: &Neighbours,
        excluded: &dyn Fn(u32) -> bool,
    ) -> Option<u32> {
        let busiest = self.busiest_except(excluded)?;
        if self.schedule == Schedule::MostWork {
            return Some(busiest);
        }
        let least = (self.pending(busiest) / WORTH_LOADING).max(1);
        let near = recent.into_iter().find_map(|tile| {
            let near = neighbours.of(tile).iter().copied();
            near.filter(|&t| self.pending(t) >= least && !excluded(t))
                .max_by(|&a, &b| self.pending(a).cmp(&self.pending(b)).then(b.cmp(&a)))
        });
        Some(near.unwrap_or(busiest))
    }

    /// The tile with the most work that is not excluded, the lowest of equals.
    fn busiest_except(&self, excluded: &dyn Fn(u32) -> bool) -> Option<u32> {
        // Depth first, the busier branch first; a branch without more than what was found is left out.
        let (mut best, mut most) = (None, 0);
        let mut nodes = vec![1];
        while let Some(node) = nodes.pop() {
            if self.most[node] < most || self.most[node] == 0 {
                continue;
            }
            if node >= self.width {
                let tile = (node - self.width) as u32;
                let better = self.most[node] > most || best.is_some_and(|b| tile < b);
                if better && !excluded(tile) {
                    (best, most) = (Some(tile), self.most[node]);
                }
                continue;
            }
            let (left, right) = (2 * node, 2 * node + 1);
            match self.most[left] >= self.most[right] {
                true => nodes.extend([right, left]),
                false => nodes.extend([left, right]),
            }
        }
        best
    }

    /// The tile with the most work, the lowest of equals.
    fn busiest(&self) -> Option<u32> {
        let most = self.most[1];
        if most == 0 {
            return None;
        }
        let mut node = 1;
        while node < self.width {
            node *= 2;
            if self.most[node] != most {
                node += 1;
            }
        }
        u32::try_from(node - self.width).ok()
    }

    fn change(&mut self, tile: u32, to: impl FnOnce(u64) -> u64) {
        let tile = tile as usize;
        if tile >= self.width {
            self.grow(tile + 1);
        }
        let mut node = self.width + tile;
        let (before, after) = (self.most[node], to(self.most[node]));
        self.total = self.total.saturating_sub(before).saturating_add(after);
        self.most[node] = after;
        while node > 1 {
            node /= 2;
            let most = self.most[2 * node].max(self.most[2 * node + 1]);
            if self.most[node] == most {
                break;
            }
            self.most[node] = most;
        }
    }

    fn grow(&mut self, tiles: usize) {
        let width = tiles.next_power_of_two();
        let mut most = vec![0; 2 * width];
        most[width..width + self.width].copy_from_slice(&self.most[self.width..]);
        for node in (1..width).rev() {
            most[node] = most[2 * node].max(most[2 * node + 1]);
        }
        (self.width, self.most) = (width, most);
        self.on_disk.resize(width, 0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn most_work_first_lowest_of_equals() {
        let mut s = Scheduler::new(Schedule::MostWork, 5);
        assert_eq!(s.next(&|_| true), None);
        s.add(4, 7);
        s.add(1, 7);
        s.add(2, 3);
        assert_eq!(s.next(&|tile| tile == 4), Some(1));
        assert_eq!((s.take(1), s.next_among(&[2]), s.total()), (7, Some(4), 10));
        assert_eq!((s.take(4), s.take(2), s.take(0)), (7, 3, 0));
        assert_eq!((s.next(&|_| true), s.total()), (None, 0));
    }

    #[test]
    fn residents_first() {
        let mut s = Scheduler::new(Schedule::ResidentFirst, 4);
        s.add(0, 1_000_000);
        assert_eq!(s.next(&|tile| tile == 3), Some(0), "nothing waits at 3");
        s.add(3, 1);
        assert_eq!(s.next(&|tile| tile == 3), Some(3));
        assert_eq!(s.next(&|_| false), Some(0));
        s.add(2, 1);
        assert_eq!(s.next(&|tile| tile >= 2), Some(2), "the lowest of equals");
        assert_eq!(s.next_among(&[3, 2]), Some(2));
    }

    #[test]
    fn memory_and_disk_are_told_apart() {
        let mut s = Scheduler::new(Schedule::default(), 3);
        s.add(1, 30);
        s.spilled(1, 20);
        assert_eq!((s.pending(1), s.pending_on_disk(1), s.pending_in_memory(1)), (30, 20, 10));
        s.add_on_disk(1, 5);
        assert_eq!((s.pending_on_disk(1), s.pending_in_memory(1)), (25, 10));
        assert_eq!((s.take(1), s.pending_on_disk(1), s.pending_in_memory(1)), (35, 0, 0));
        s.spilled(1, 9);
        s.spilled(77, 9);
        assert_eq!((s.pending_on_disk(1), s.pending(77)), (0, 0));
        s.add_on_disk(77, 6);
        assert_eq!((s.pending(77), s.total(), s.next(&|_| false)), (6, 6, Some(77)));
    }

    proptest! {
        #[test]
        fn it_is_a_linear_scan(
            resident_first: bool,
            tiles in 1u32..40,
            steps in prop::collection::vec((0u32..40, 0u64..200, 0u8..4), 1..60),
            resident in prop::collection::vec(any::<bool>(), 40),
        ) {
            let schedule =
                if resident_first { Schedule::ResidentFirst } else { Schedule::MostWork };
            let mut s = Scheduler::new(schedule, tiles);
            let mut work = vec![0u64; 40];
            let list: Vec<u32> = (0..40).rev().filter(|&t| resident[t as usize]).collect();
            for (tile, n, what) in steps {
                match what {
                    0 => {
                        prop_assert_eq!(s.take(tile), work[tile as usize]);
                        work[tile as usize] = 0;
                    }
                    1 => { s.add_on_disk(tile, n); work[tile as usize] += n; }
                    2 => s.spilled(tile, n),
                    _ => { s.add(tile, n); work[tile as usize] += n; }
                }
                let first = |ok: &dyn Fn(usize) -> bool| {
                    (0..40).filter(|&t| work[t] > 0 && ok(t))
                        .max_by_key(|&t| (work[t], std::cmp::Reverse(t)))
                        .map(|t| t as u32)
                };
                let worth = |t: usize| resident_first && resident[t];
                let expected = first(&worth).or_else(|| first(&|_| true));
                prop_assert_eq!(s.next(&|t| resident[t as usize]), expected);
                prop_assert_eq!(s.next_among(&list), expected);
                prop_assert_eq!(s.total(), work.iter().sum::<u64>());
                prop_assert!(s.pending_on_disk(tile) <= s.pending(tile));
            }
        }
    }
}

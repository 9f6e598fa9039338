//! Which tile to visit next.
//!
//! The paper takes the room with the most photons waiting (Fradin et al. 2005, section 5.2). That
//! is good when every visit costs a load; but a tile that is still resident costs none, and the
//! paper's own outlook asks for just that. So the default takes what is resident as long as anything
//! waits there: what is left behind has to be loaded again for the sake of a few photons, which takes
//! longer than to trace thousands.
//!
//! When a tile has to be loaded, photons sweep through the building ([`Sweep`]): the first tile in an order that keeps what belongs
//! together together, where enough waits. So the sweep stays where it is until all is quiet there, goes on, and comes back to what is behind
//! it only for as many photons as are worth a load; few tiles have to come twice. Where only a handful of tiles is in memory that does not pay; and
//! rays of pictures begin at the eye and do not go everywhere. There the next tile is a neighbour of those that were visited last, if enough waits there, and only then the tile with
//! the most work.
//!
//! Purely a matter of time: which tile comes first changes no photon.

use clap::ValueEnum;

use crate::neighbours::Neighbours;
use crate::sweep::Sweep;

/// A neighbour is worth loading before its time if it has this part of the work of the busiest tile, where many tiles are in memory.
/// Where `n` are it takes `1/n²`, for what few tiles send to and fro is soon driven out again: the only one is always the busiest.
const WORTH_LOADING: u64 = 100;
/// A tile of a sweep is passed over if it has less than this part of the work of the busiest tile.
const WORTH_SWEEPING: u64 = 1000;

/// How the next tile is chosen (`--schedule`).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Schedule {
    /// The tile with the most work, as in the paper.
    MostWork,
    /// The resident tile with the most work; else the next in an order that keeps neighbours together, if enough waits there.
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
    total: u64,
}

impl Scheduler {
    /// A scheduler over tiles `0..tiles` with nothing to do.
    pub fn new(schedule: Schedule, tiles: u32) -> Self {
        let width = (tiles.max(1) as usize).next_power_of_two();
        Self { schedule, width, most: vec![0; 2 * width], total: 0 }
    }

    /// The bytes that a scheduler of this many tiles holds.
    pub fn memory_bytes(tiles: u32) -> u64 {
        u64::from(tiles.max(1)).next_power_of_two() * 16
    }

    /// `n` more records wait for `tile`. Tiles are dense; one beyond the number given at
    /// the start makes the table grow.
    pub fn add(&mut self, tile: u32, n: u64) {
        self.change(tile, |work| work.saturating_add(n));
    }

    /// Takes all the work of `tile`, and says how much that was.
    pub fn take(&mut self, tile: u32) -> u64 {
        let work = self.pending(tile);
        if work > 0 {
            self.change(tile, |_| 0);
        }
        work
    }

    /// Records that wait for `tile`.
    pub fn pending(&self, tile: u32) -> u64 {
        match tile as usize {
            tile if tile < self.width => self.most[self.width + tile],
            _ => 0,
        }
    }

    /// Records that wait anywhere; 0 means that the work is done.
    pub fn total(&self) -> u64 {
        self.total
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

    /// Whether nothing is to be loaded because the tile whose turn it is, of those that are not `under_way`, is resident. Only the
    /// paper's schedule knows whose turn it is; a tile loaded before its turn would drive out one that comes before it.
    pub fn waits_for_resident(
        &self,
        resident: &dyn Fn(u32) -> bool,
        under_way: &dyn Fn(u32) -> bool,
    ) -> bool {
        self.schedule == Schedule::MostWork && self.busiest_except(under_way).is_some_and(resident)
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
        let recent: Vec<u32> = recent.into_iter().collect();
        let part = (recent.len() as u64).saturating_pow(2).clamp(1, WORTH_LOADING);
        let least = (self.pending(busiest) / part).max(1);
        let near = recent.into_iter().find_map(|tile| {
            let near = neighbours.of(tile).iter().copied();
            near.filter(|&t| self.pending(t) >= least && !excluded(t))
                .max_by(|&a, &b| self.pending(a).cmp(&self.pending(b)).then(b.cmp(&a)))
        });
        Some(near.unwrap_or(busiest))
    }

    /// The tile to load next among those that are not `excluded`, where light sweeps through a whole building.
    pub fn next_of_sweep(&self, sweep: &Sweep, excluded: &dyn Fn(u32) -> bool) -> Option<u32> {
        let busiest = self.busiest_except(excluded)?;
        if self.schedule == Schedule::MostWork {
            return Some(busiest);
        }
        let least = (self.pending(busiest) / WORTH_SWEEPING).max(1);
        let worth = |&&tile: &&u32| self.pending(tile) >= least && !excluded(tile);
        sweep.tiles().iter().find(worth).copied().or(Some(busiest))
    }

    /// The tile with the most work that is not excluded, the lowest of equals.
    fn busiest_except(&self, excluded: &dyn Fn(u32) -> bool) -> Option<u32> {
        let (mut best, mut most) = (None, 0);
        // Depth first, the busier branch first, the left one of equals.
        let mut nodes = vec![1usize];
        while let Some(node) = nodes.pop() {
            let first = (node << (self.width.ilog2() - node.ilog2())) - self.width;
            let worth = self.most[node] > most
                || self.most[node] == most && best.is_some_and(|b| first < b as usize);
            if !worth {
                continue;
            }
            if node >= self.width {
                if !excluded(first as u32) {
                    (best, most) = (Some(first as u32), self.most[node]);
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
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn most_work_first_lowest_of_equals() {
        let mut s = Scheduler::new(Schedule::MostWork, 5);
        assert_eq!(s.next_visit(0..5, &|_| false), None);
        s.add(4, 7);
        s.add(1, 7);
        s.add(2, 3);
        assert_eq!(s.next_visit(0..5, &|_| false), Some(1));
        assert_eq!((s.take(1), s.next_visit(0..5, &|_| false), s.total()), (7, Some(4), 10));
        assert_eq!((s.take(4), s.take(2), s.take(0)), (7, 3, 0));
        assert_eq!((s.next_visit(0..5, &|_| false), s.total()), (None, 0));
    }

    #[test]
    fn residents_first() {
        let mut s = Scheduler::new(Schedule::ResidentFirst, 4);
        s.add(0, 1_000_000);
        assert_eq!(s.next_visit([3], &|_| false), None, "nothing waits at 3");
        s.add(3, 1);
        assert_eq!(s.next_visit([3], &|_| false), Some(3), "however much waits at 0");
        s.add(2, 1);
        assert_eq!(s.next_visit([3, 2], &|_| false), Some(2), "the lowest of equals");
        assert_eq!(s.next_visit([3, 2], &|tile| tile == 2), Some(3), "2 is being visited");
        assert_eq!(s.next_visit([1], &|_| false), None, "nothing waits at 1");
    }

    #[test]
    fn the_paper_visits_the_busiest_or_waits_for_it() {
        let mut s = Scheduler::new(Schedule::MostWork, 4);
        s.add(1, 5);
        s.add(2, 9);
        assert_eq!(s.next_visit([1], &|_| false), None, "2 has to be loaded");
        assert_eq!(s.next_visit([1, 2], &|_| false), Some(2));
        assert_eq!(s.next_visit([1, 2], &|tile| tile == 2), Some(1));
        let none = |_: u32| false;
        assert!(!s.waits_for_resident(&|tile| tile == 1, &none), "2 is to be loaded");
        assert!(s.waits_for_resident(&|tile| tile == 2, &none), "and has its turn before 1 is");
        assert!(
            !s.waits_for_resident(&|tile| tile == 2, &|tile| tile == 2),
            "1 while 2 is visited"
        );
        let s = Scheduler { schedule: Schedule::ResidentFirst, ..s };
        assert!(!s.waits_for_resident(&|_| true, &none), "loaded ahead all the same");
    }

    #[test]
    fn neighbours_of_the_last_ones_are_loaded_first() {
        // A suite of rooms, 0 to 4, a large one and others apart.
        let doors = (0..4).flat_map(|t| [(t, t + 1), (t + 1, t)]).collect();
        let n = Neighbours::from_pairs(16, doors);
        let mut s = Scheduler::new(Schedule::ResidentFirst, 16);
        for (tile, work) in [(0, 3), (2, 10), (3, 40), (4, 40), (5, 900)] {
            s.add(tile, work);
        }
        // These, and eight that have no doors: then a hundredth of 900 is worth a load.
        let load = |s: &Scheduler, recent: &[u32]| {
            let all = recent.iter().copied().chain(8..16);
            s.next_load(all, &n, &|tile| recent.contains(&tile))
        };
        assert_eq!(load(&s, &[]), Some(5));
        assert_eq!(
            load(&s, &[0, 1]),
            Some(2),
            "nothing waits next to 0 that is not here; 3 at tile 0 would be too few"
        );
        assert_eq!(load(&s, &[3, 1, 8]), Some(4), "of the last one's neighbours the busiest");
        assert_eq!(load(&s, &[0, 8]), Some(5), "nothing waits next door");
        s.take(5);
        assert_eq!(load(&s, &[1, 8]), Some(2));

        // The only tile makes way for the busiest; two for a neighbour with a quarter of that.
        s.add(5, 60);
        let few =
            |recent: &[u32]| s.next_load(recent.iter().copied(), &n, &|t| recent.contains(&t));
        assert_eq!((few(&[1]), few(&[1, 8]), few(&[3, 8])), (Some(5), Some(5), Some(4)));
        assert_eq!(few(&[1, 8, 9]), Some(2));

        let mut s = Scheduler::new(Schedule::MostWork, 16);
        s.add(2, 10);
        s.add(5, 900);
        assert_eq!(load(&s, &[1]), Some(5));
    }

    /// A tower: each storey has a corridor with rooms that have a bath each, and the storeys are joined by their corridors. Numbers of
    /// tiles say nothing about where they are.
    struct Tower {
        centres: Vec<[f32; 3]>,
        neighbours: Neighbours,
    }

    impl Tower {
        fn new(storeys: u32, rooms: u32) -> Self {
            let storey = 1 + 2 * rooms;
            let tiles = storeys * storey;
            let id = |t: u32| t * 7919 % tiles;
            let (mut doors, mut centres) = (vec![], vec![[0.0; 3]; tiles as usize]);
            for t in 0..tiles {
                let (s, place) = (t / storey, t % storey);
                centres[id(t) as usize] = [place.div_ceil(2) as f32, (place % 2) as f32, s as f32];
                match place {
                    0 if s == 0 => {}
                    0 => doors.push((id(t - storey), id(t))),
                    odd if odd % 2 == 1 => doors.push((id(s * storey), id(t))),
                    _ => doors.push((id(t - 1), id(t))),
                }
            }
            let both = doors.into_iter().flat_map(|(a, b)| [(a, b), (b, a)]).collect();
            Self { centres, neighbours: Neighbours::from_pairs(tiles as usize, both) }
        }

        /// Loads of a tile, mean and most. 10,000 photons start in each tile, and of those that come to one an eighth goes on, to
        /// each neighbour as many but for one. The tiles used last are in memory.
        fn loads(
            &self,
            resident: usize,
            next: impl Fn(&Scheduler, &[u32]) -> Option<u32>,
        ) -> (f64, u32) {
            let tiles = self.centres.len() as u32;
            let mut s = Scheduler::new(Schedule::ResidentFirst, tiles);
            (0..tiles).for_each(|t| s.add(t, 10_000));
            let (mut recent, mut turn) = (Vec::<u32>::new(), 0);
            let mut loads = vec![0; tiles as usize];
            while s.total() > 0 {
                let ready = s.next_visit(recent.iter().copied(), &|_| false);
                let tile = ready.unwrap_or_else(|| {
                    recent.truncate(resident - 1);
                    next(&s, &recent).unwrap()
                });
                loads[tile as usize] += u32::from(ready.is_none());
                recent.retain(|&t| t != tile);
                recent.insert(0, tile);
                let (near, leaving) = (self.neighbours.of(tile), s.take(tile) as usize / 8);
                for (i, &to) in near.iter().enumerate() {
                    let one = usize::from((i + turn) % near.len() < leaving % near.len());
                    s.add(to, (leaving / near.len() + one) as u64);
                }
                turn += 1;
            }
            let mean = loads.iter().sum::<u32>() as f64 / f64::from(tiles);
            (mean, loads.into_iter().max().unwrap_or(0))
        }
    }

    #[test]
    fn a_sweep_loads_few_tiles_twice() {
        let tower = Tower::new(20, 12);
        let order = Sweep::of_points(tower.centres.clone(), &tower.neighbours);
        let sweep = |resident| {
            tower.loads(resident, |s, recent| s.next_of_sweep(&order, &|t| recent.contains(&t)))
        };
        let near = |resident| {
            tower.loads(resident, |s, recent| {
                let to_load = |t| recent.contains(&t);
                s.next_load(recent.iter().copied(), &tower.neighbours, &to_load)
            })
        };
        let busiest = |resident| {
            tower.loads(resident, |s, recent| s.busiest_except(&|t| recent.contains(&t)))
        };
        // A storey has 25 tiles; of those, these many are in memory.
        let (mean, most) = sweep(20);
        assert!(mean < 1.1 && most <= 2, "{mean} loads of a tile, {most} at most");
        let (mean, most) = sweep(12);
        assert!(mean < 1.6 && most <= 4, "{mean} loads of a tile, {most} at most");
        for resident in [12, 20] {
            let (sweep, near, busiest) = (sweep(resident).0, near(resident).0, busiest(resident).0);
            assert!(sweep < 0.9 * near && sweep <= busiest, "{sweep}, {near}, {busiest}");
        }
        // With next to nothing in memory it is better to stay with the neighbours.
        assert!(near(6).0 < sweep(6).0);
    }

    proptest! {
        #[test]
        fn it_is_a_linear_scan(
            resident_first: bool,
            tiles in 1u32..40,
            steps in prop::collection::vec((0u32..40, 0u64..8, any::<bool>()), 1..60),
            resident in prop::collection::vec(any::<bool>(), 40),
        ) {
            let schedule =
                if resident_first { Schedule::ResidentFirst } else { Schedule::MostWork };
            let mut s = Scheduler::new(schedule, tiles);
            let mut work = vec![0u64; 40];
            for (tile, n, what) in steps {
                if what {
                    prop_assert_eq!(s.take(tile), work[tile as usize]);
                    work[tile as usize] = 0;
                } else {
                    s.add(tile, n);
                    work[tile as usize] += n;
                }
                let first = |ok: &dyn Fn(usize) -> bool| {
                    (0..40).filter(|&t| work[t] > 0 && ok(t))
                        .max_by_key(|&t| (work[t], std::cmp::Reverse(t)))
                        .map(|t| t as u32)
                };
                let expected = match resident_first {
                    true => first(&|t| resident[t]),
                    false => first(&|_| true).filter(|&t| resident[t as usize]),
                };
                let here = (0..40).filter(|&t| resident[t as usize]);
                prop_assert_eq!(s.next_visit(here, &|_| false), expected);
                let excluded = |t: u32| resident[t as usize];
                prop_assert_eq!(s.busiest_except(&excluded), first(&|t| !resident[t]));
                prop_assert_eq!(s.total(), work.iter().sum::<u64>());
            }
        }
    }
}

//! An order of a building's tiles in which neighbours are close to each other.
//!
//! Light passes from tile to tile and back. If tiles are worked at in an order in which each part of the building, a storey, a wing, a
//! corridor with its rooms, comes as a whole, the tiles of one part are in memory together, light goes to and fro among them, and little is
//! left for a time when they are gone.
//!
//! So the building is cut in two, across x, y or z, where few doors are cut for two parts of such sizes: the *ratio cut* (Wei and Cheng 1989,
//! "Towards efficient hierarchical designs by ratio cut partitioning") is the doors over the product of the sizes. Each part is cut
//! again until single tiles are left. Their order is that of the cuts, the lower part first.

use crate::neighbours::Neighbours;
use crate::tables::Tables;

/// No part gets fewer than one of so many tiles of what is cut, so that it takes few cuts to get to the last.
const LEAST_SHARE: usize = 16;

/// The order; see the module.
#[derive(Clone, Debug)]
pub struct Sweep(Vec<u32>);

impl Sweep {
    /// The order of a building's tiles.
    pub fn new(tables: &Tables, neighbours: &Neighbours) -> Self {
        let twice = |k: usize| move |t: &enf_layout::room::TileRecord| t.min[k] + t.max[k];
        let centres = tables.tiles().iter().map(|t| [0, 1, 2].map(|k| twice(k)(t))).collect();
        Self::of_points(centres, neighbours)
    }

    /// The order of tiles with these centres (in any unit).
    pub(crate) fn of_points(centres: Vec<[f32; 3]>, neighbours: &Neighbours) -> Self {
        let mut order: Vec<u32> = (0..centres.len() as u32).collect();
        // On which side of the cut that is tried last a tile is: numbers that are new for each axis of each set.
        let mut side = vec![0u32; centres.len()];
        let mut sets: Vec<_> = std::iter::once(0..order.len()).collect();
        let mut mark = 0u32;
        while let Some(set) = sets.pop() {
            let tiles = &mut order[set.clone()];
            if tiles.len() < 2 {
                continue;
            }
            let least = (tiles.len() / LEAST_SHARE).max(1);
            let along = |axis: usize| {
                let centres = &centres;
                move |a: &u32, b: &u32| {
                    let at = |t: &u32| centres[*t as usize][axis];
                    at(a).total_cmp(&at(b)).then(a.cmp(b))
                }
            };
            // The doors that are cut, the product of the sizes, the axis, and how many are below.
            let mut best = (1u128, 0u128, 2, least);
            for axis in [2, 1, 0] {
                tiles.sort_unstable_by(along(axis));
                mark += 2;
                let (upper, lower) = (mark, mark + 1);
                tiles.iter().for_each(|&t| side[t as usize] = upper);
                let mut cut = 0i64;
                for (i, &tile) in tiles.iter().enumerate().take(tiles.len() - least) {
                    for &other in neighbours.of(tile) {
                        // Who has no list is next to nobody in particular.
                        let counts = !neighbours.of(other).is_empty();
                        cut += match side[other as usize] {
                            s if s == upper && counts => 1,
                            s if s == lower && counts => -1,
                            _ => 0,
                        };
                    }
                    side[tile as usize] = lower;
                    let below = i + 1;
                    if below < least {
                        continue;
                    }
                    // Half a door more, so that among cuts through no door at all the one into equal parts is taken.
                    let doors = 2 * u128::from(cut.unsigned_abs()) + 1;
                    let product = below as u128 * (tiles.len() - below) as u128;
                    if doors * best.1 < best.0 * product || best.1 == 0 {
                        best = (doors, product, axis, below);
                    }
                }
            }
            let (_, _, axis, below) = best;
            tiles.sort_unstable_by(along(axis));
            sets.extend([set.start + below..set.end, set.start..set.start + below]);
        }
        Self(order)
    }

    /// The tiles in this order.
    pub fn tiles(&self) -> &[u32] {
        &self.0
    }

    /// Bytes that it holds at most while it is made.
    pub fn bytes(tables: &Tables) -> u64 {
        tables.tiles().len() as u64 * 24
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn both(pairs: impl IntoIterator<Item = (u32, u32)>) -> Vec<(u32, u32)> {
        pairs.into_iter().flat_map(|(a, b)| [(a, b), (b, a)]).collect()
    }

    #[test]
    fn every_tile_is_there_once() {
        for n in [0u32, 1, 2, 3, 50, 333] {
            let ring = Neighbours::from_pairs(n as usize, both((1..n).map(|t| (t - 1, t))));
            // All at one place, too.
            for spread in [0.0, 1.0] {
                let centres =
                    (0..n).map(|t| [spread * (t * 7 % 5) as f32, 0.0, spread * (t % 3) as f32]);
                let mut tiles = Sweep::of_points(centres.collect(), &ring).tiles().to_vec();
                tiles.sort_unstable();
                assert!(tiles.into_iter().eq(0..n));
            }
        }
    }

    #[test]
    fn two_suites_come_one_after_the_other() {
        // Rooms lie crosswise along one axis, and belong to one or the other of two suites by the other.
        let (rooms, centre) = (16u32, |t: u32| [(t / 2) as f32, (t % 2) as f32 * 0.1, 0.0]);
        let doors = (2..rooms).map(|t| (t - 2, t)).chain([(14, 15)]);
        let n = Neighbours::from_pairs(rooms as usize, both(doors));
        let sweep = Sweep::of_points((0..rooms).map(centre).collect(), &n);
        let (first, second) = sweep.tiles().split_at(8);
        assert!(first.iter().all(|t| t % 2 == 0) && second.iter().all(|t| t % 2 == 1));
    }

    #[test]
    fn storeys_stay_together_though_a_shaft_joins_them() {
        // Ten storeys of a corridor with nine rooms; the outside (tile 100) borders on all.
        let centre = |t: u32| [(t % 10) as f32, 0.0, 3.0 * (t / 10) as f32];
        let storeys = (0..10u32).flat_map(|s| (1..10).map(move |r| (10 * s, 10 * s + r)));
        let shaft = (1..10u32).map(|s| (10 * s - 10, 10 * s));
        let windows = (0..100u32).map(|t| (t, 100));
        let pairs: Vec<_> = both(storeys.chain(shaft)).into_iter().chain(windows).collect();
        let n = Neighbours::from_pairs(101, pairs);
        let centres = (0..100).map(centre).chain([[5.0, 0.0, 14.0]]).collect();
        let sweep = Sweep::of_points(centres, &n);
        let storeys: Vec<u32> =
            sweep.tiles().iter().filter(|&&t| t != 100).map(|t| t / 10).collect();
        assert!(storeys.is_sorted(), "{storeys:?}");
    }
}

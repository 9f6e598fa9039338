//! Which tiles light can pass between without entering a third one.

use enf_layout::room::{PIECE_CORNERS, PortalPieceRecord, RoomRecord};

use crate::tables::Tables;

/// A tile with more neighbours than this is given none: the outside borders on every window, a corridor of a hotel on every
/// room, and who is next to it is next to nobody in particular.
const MOST_NEIGHBOURS: usize = 128;

/// The neighbours of each tile, in order of their ids.
pub struct Neighbours {
    /// Where the neighbours of each tile begin in `of`; one more at the end.
    first: Vec<u32>,
    of: Vec<u32>,
}

impl Neighbours {
    /// Finds the tiles on both sides of every portal, and those pieces of one room whose bounds touch. A portal says which rooms it
    /// joins; of a room in pieces, those count whose bounds the portal touches.
    pub fn new(tables: &Tables) -> Self {
        let tiles = tables.tiles();
        let slack = tables.scene.delta;
        let mut pairs = Pairs::default();
        let of = |room: &RoomRecord| room.first_tile..room.first_tile + room.tile_count;
        for (a, room) in (0u32..).zip(tables.rooms()) {
            for portal in tables.portals_of(a) {
                let Some(other) = tables.rooms().get(portal.other as usize) else { continue };
                if room.tile_count == 1 && other.tile_count == 1 {
                    pairs.add(room.first_tile, other.first_tile);
                    continue;
                }
                let pieces = portal.first_piece..portal.first_piece + portal.piece_count;
                let pieces = tables.pieces().get(pieces.start as usize..pieces.end as usize);
                for (min, max) in pieces.unwrap_or(&[]).iter().filter_map(bounds) {
                    let at = |tile: &u32| {
                        let tile = &tiles[*tile as usize];
                        (0..3)
                            .all(|k| min[k] <= tile.max[k] + slack && tile.min[k] <= max[k] + slack)
                    };
                    for a in of(room).filter(at) {
                        of(other).filter(at).for_each(|b| pairs.add(a, b));
                    }
                }
            }
        }
        let touch = |a: u32, b: u32| {
            let (a, b) = (&tiles[a as usize], &tiles[b as usize]);
            (0..3).all(|k| a.min[k] <= b.max[k] + slack && b.min[k] <= a.max[k] + slack)
        };
        for room in tables.rooms() {
            let mut from_left: Vec<u32> = of(room).collect();
            let left = |tile: &u32| tiles[*tile as usize].min[0];
            from_left.sort_by(|a, b| left(a).total_cmp(&left(b)));
            for (i, &a) in from_left.iter().enumerate() {
                let end = tiles[a as usize].max[0] + slack;
                let near = from_left[i + 1..].iter().take_while(|b| left(b) <= end);
                near.filter(|&&b| touch(a, b)).for_each(|&b| pairs.add(a, b));
            }
        }
        Self::from_pairs(tiles.len(), pairs.list)
    }

    pub(crate) fn from_pairs(tiles: usize, mut pairs: Vec<(u32, u32)>) -> Self {
        pairs.sort_unstable();
        pairs.dedup();
        let mut neighbours = Self { first: vec![0], of: Vec::new() };
        for tile in 0..tiles as u32 {
            let begin = pairs.partition_point(|p| p.0 < tile);
            let end = pairs.partition_point(|p| p.0 <= tile);
            if end - begin <= MOST_NEIGHBOURS {
                neighbours.of.extend(pairs[begin..end].iter().map(|p| p.1));
            }
            neighbours.first.push(neighbours.of.len() as u32);
        }
        neighbours
    }

    /// The neighbours of a tile; none for one that has too many to mean anything.
    pub fn of(&self, tile: u32) -> &[u32] {
        let tile = tile as usize;
        match self.first.get(tile..tile + 2) {
            Some(&[first, end]) => &self.of[first as usize..end as usize],
            _ => &[],
        }
    }

    /// Bytes that the lists hold at most while they are made, for so many portal pieces and tiles.
    pub fn bytes(tables: &Tables) -> u64 {
        // Two pairs a piece, and as many again among the tiles of one room; then the lists.
        let pairs = 2 * tables.pieces().len() as u64 + 32 * tables.tiles().len() as u64;
        pairs * 12 + tables.tiles().len() as u64 * 4
    }
}

/// Pairs of tiles, both ways round; what is there more than once is thrown out now and then.
#[derive(Default)]
struct Pairs {
    list: Vec<(u32, u32)>,
    /// When the list is this long, it is looked through again.
    full: usize,
}

impl Pairs {
    fn add(&mut self, a: u32, b: u32) {
        if a == b {
            return;
        }
        self.list.extend([(a, b), (b, a)]);
        if self.list.len() >= self.full {
            self.list.sort_unstable();
            self.list.dedup();
            self.full = (2 * self.list.len()).max(4096);
        }
    }
}

/// The box around a piece of a portal.
fn bounds(piece: &PortalPieceRecord) -> Option<([f32; 3], [f32; 3])> {
    let corners = &piece.corners[..(piece.count as usize).min(PIECE_CORNERS)];
    let first = *corners.first()?;
    Some(corners.iter().fold((first, first), |(min, max), corner| {
        let (lower, upper) = (|k: usize| min[k].min(corner[k]), |k: usize| max[k].max(corner[k]));
        ([0, 1, 2].map(lower), [0, 1, 2].map(upper))
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lists_are_sorted_and_each_neighbour_is_there_once() {
        let n = Neighbours::from_pairs(4, vec![(2, 1), (0, 2), (2, 0), (1, 2), (2, 0)]);
        assert_eq!(
            (n.of(0), n.of(1), n.of(2), n.of(3)),
            (&[2][..], &[2][..], &[0, 1][..], &[][..])
        );
        assert!(n.of(4).is_empty());
    }

    #[test]
    fn a_hub_is_next_to_nobody() {
        let spokes = MOST_NEIGHBOURS as u32 + 1;
        let pairs = (1..=spokes).flat_map(|t| [(0, t), (t, 0)]).collect();
        let n = Neighbours::from_pairs(spokes as usize + 1, pairs);
        assert!(n.of(0).is_empty());
        assert_eq!(n.of(spokes), [0]);
    }
}

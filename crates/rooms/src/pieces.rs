//! From rooms to tiles, one triangle at a time.
//!
//! A [`Piece`] is a set of leaves of one room that will be a tile, unless it is cut further. The caller
//! holds the triangles, in memory or on disk; the partition only says which pieces a triangle touches
//! ([`Partition::route`]), whose room it counts for ([`Partition::owner`]), and where a piece is cut
//! best ([`Partition::cut_piece`], from a sample). So a room of any size is divided in a few passes over its
//! triangles. [`Partition::cut_tiles`] and [`Partition::finish`] do it all for scenes in memory.

use crate::cluster::point;
use crate::convex::{Face, Plane};
use crate::partition::{Partition, single};
use crate::tables::{bin, lists, tables};
use crate::tree::{LEAF, Leaf, Node};
use crate::{RoomsError, Tables, TileLimit};
use enf_layout::room::{PortalPieceRecord, PortalRecord, RoomRecord, TileRecord};
use glam::DVec3;

/// Fewer samples of a piece tell nothing about where to cut it.
const LEAST_SAMPLE: usize = 24;

/// Leaves of one room that are to be resident at once.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Piece {
    number: u32,
    room: u32,
    leaves: Vec<u32>,
}

impl Piece {
    /// What [`Partition::route`] calls it.
    pub fn number(&self) -> u32 {
        self.number
    }

    /// Its room.
    pub fn room(&self) -> u32 {
        self.room
    }
}

/// A node of the BSP below which a group of neighbouring triangles lies whole: where
/// [`Partition::route`] may start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Start(u32);

/// What [`Partition::route`] reuses from call to call.
#[derive(Debug, Default)]
pub struct Scratch {
    parts: Vec<(u32, Vec<DVec3>)>,
    pieces: Vec<u32>,
}

impl Partition {
    /// Rooms, the outside not counted.
    pub fn room_count_without_outside(&self) -> usize {
        self.rooms.len() - usize::from(self.outside.is_some())
    }

    /// The rooms, without triangles and tiles.
    pub fn rooms(&self) -> &[RoomRecord] {
        &self.rooms
    }

    /// The portals, sorted by (room, other).
    pub fn portals(&self) -> &[PortalRecord] {
        &self.portals
    }

    /// Convex pieces of the portals.
    pub fn portal_pieces(&self) -> &[PortalPieceRecord] {
        &self.portal_pieces
    }

    /// The outside's room id, when there is an outside.
    pub fn outside(&self) -> Option<u32> {
        self.outside
    }

    /// Rooms with a piece that is above its limit, because cutting further would not have helped.
    pub fn oversized(&self) -> &[u32] {
        &self.oversized
    }

    /// Heap bytes of the tree and its cells, about.
    pub fn resident_bytes(&self) -> u64 {
        let tree = &self.tree;
        let faces: usize = tree.leaves.iter().map(|l| l.cell.faces.len()).sum();
        let corners: usize =
            tree.leaves.iter().flat_map(|l| &l.cell.faces).map(|f| f.corners.len()).sum();
        (tree.leaves.len() * (size_of::<Leaf>() + 16)
            + faces * (size_of::<Face>() + 16)
            + corners * size_of::<DVec3>()
            + tree.nodes.len() * size_of::<Node>()
            + self.portal_pieces.len() * size_of::<PortalPieceRecord>()) as u64
    }

    /// All pieces, by room. Before anything is cut, piece `i` is room `i`.
    pub fn pieces(&self) -> Vec<Piece> {
        let mut pieces: Vec<Piece> = self
            .piece_rooms
            .iter()
            .enumerate()
            .map(|(i, &room)| Piece { number: i as u32, room, leaves: Vec::new() })
            .collect();
        for (leaf, &piece) in self.piece.iter().enumerate() {
            pieces[piece as usize].leaves.push(leaf as u32);
        }
        pieces.sort_by_key(|p| p.room);
        pieces
    }

    /// Where [`Partition::route`] may start for triangles within a box (store coordinates, m).
    pub fn start(&self, min: [f32; 3], max: [f32; 3]) -> Start {
        let (min, max) = (point(min), point(max));
        let (centre, half) = ((min + max) * 0.5, (max - min) * 0.5);
        let mut at = self.tree.root();
        while at & LEAF == 0 {
            let node = &self.tree.nodes[at as usize];
            // As much again as `route` grows a leaf by.
            let reach = node.plane.normal.abs().dot(half) + 16.0 * self.delta;
            let s = node.plane.distance(centre);
            if s > reach {
                at = node.front;
            } else if s < -reach {
                at = node.back;
            } else {
                break;
            }
        }
        Start(at)
    }

    /// Calls `found` once with the number of each piece that must list a triangle: it touches a leaf
    /// of the piece, moved out by 4 δ. Ascending. `from` is [`Partition::start`] of a box around it.
    pub fn route(
        &self,
        from: Start,
        triangle: &[[f32; 3]; 3],
        scratch: &mut Scratch,
        mut found: impl FnMut(u32),
    ) {
        if from.0 & LEAF != 0 {
            return found(self.piece[(from.0 & !LEAF) as usize]);
        }
        let Scratch { parts, pieces } = scratch;
        pieces.clear();
        bin(&self.tree, from.0, self.delta, triangle, parts, |leaf| {
            let piece = self.piece[leaf as usize];
            if pieces.last() != Some(&piece) {
                pieces.push(piece);
            }
        });
        if pieces.len() > 1 {
            pieces.sort_unstable();
            pieces.dedup();
        }
        pieces.iter().copied().for_each(found);
    }

    /// The room that a triangle counts for: that of its centroid.
    pub fn owner(&self, from: Start, triangle: &[[f32; 3]; 3]) -> u32 {
        let centroid = (point(triangle[0]) + point(triangle[1]) + point(triangle[2])) / 3.0;
        let leaf = self.tree.locate_below(from.0, centroid);
        self.room[self.tree.leaves[leaf as usize].base as usize]
    }

    /// Cuts a piece by planes in free space until each part has, by the sample, at most `limit`
    /// triangles. `sample` holds evenly drawn triangles of the piece, each standing for `weight` of
    /// them; all of them with weight 1 make it exact. The parts keep to the order of the cuts; the
    /// last plane that would have helped little is not made, and [`Partition::oversized`] tells.
    pub fn cut_piece(
        &mut self,
        piece: Piece,
        sample: &[[[f32; 3]; 3]],
        weight: f64,
        limit: u64,
    ) -> Vec<Piece> {
        self.cut = true;
        let all: Vec<u32> = (0..sample.len() as u32).collect();
        let mut stack = vec![(piece, all)];
        let mut done = Vec::new();
        let mut scratch = Scratch::default();
        while let Some((piece, mine)) = stack.pop() {
            if mine.len() as f64 * weight <= limit as f64 {
                done.push(piece);
                continue;
            }
            let plane = (mine.len() >= LEAST_SAMPLE || weight <= 1.0)
                .then(|| self.median(&piece, sample, &mine))
                .flatten();
            let Some(plane) = plane else {
                if self.oversized.last() != Some(&piece.room) {
                    self.oversized.push(piece.room);
                }
                done.push(piece);
                continue;
            };
            let [front, back] = self.cut(piece, &plane);
            let (mut in_front, mut behind) = (Vec::new(), Vec::new());
            for i in mine {
                self.route(Start(self.tree.root()), &sample[i as usize], &mut scratch, |n| {
                    if n == front.number {
                        in_front.push(i);
                    } else if n == back.number {
                        behind.push(i);
                    }
                });
            }
            stack.push((back, behind));
            stack.push((front, in_front));
        }
        done
    }

    /// Cuts the whole scene by random oblique planes through the contents until there are so many
    /// pieces. For tests: no result may depend on it.
    ///
    /// # Errors
    /// [`RoomsError::Tiles`] if that is not to be reached.
    pub fn cut_at_random(
        &mut self,
        triangles: &[[[f32; 3]; 3]],
        wanted: u32,
        seed: u64,
    ) -> Result<(), RoomsError> {
        self.cut = true;
        let mut pieces = self.pieces();
        // By number; a room's piece has the room's number.
        pieces.sort_by_key(|p| p.number);
        let mut state = seed;
        let mut random = move || {
            // Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators".
            state = state.wrapping_add(0x9e37_79b9_7f4a_7c15);
            let mut z = state;
            z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
            z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
            (z ^ (z >> 31)) >> 11
        };
        let mut failures = 0;
        while pieces.len() < wanted as usize {
            let mut unit = || random() as f64 * (2.0 / 9_007_199_254_740_992.0) - 1.0;
            let mut normal = DVec3::new(unit(), unit(), unit());
            while !(0.01..=1.0).contains(&normal.length_squared()) {
                normal = DVec3::new(unit(), unit(), unit());
            }
            let normal = normal / normal.length();
            // Every other time a piece, else a triangle: the empty ones are cut as well.
            let at = (random() % pieces.len() as u64) as usize;
            let (at, through) = if failures % 2 == 1 || triangles.is_empty() {
                let leaves = &pieces[at].leaves;
                let leaf = leaves[(random() % leaves.len().max(1) as u64) as usize];
                (at, self.tree.leaves[leaf as usize].cell.centre())
            } else {
                let t = &triangles[(random() % triangles.len() as u64) as usize];
                let centroid = (point(t[0]) + point(t[1]) + point(t[2])) / 3.0;
                (self.piece[self.tree.locate(centroid) as usize] as usize, centroid)
            };
            let plane = Plane { normal, offset: normal.dot(through) };
            let room = pieces[at].room;
            let piece = std::mem::replace(
                &mut pieces[at],
                Piece { number: at as u32, room, leaves: Vec::new() },
            );
            let cuts = piece.leaves.iter().any(|&leaf| self.cuts(leaf, &plane));
            if cuts {
                let [front, back] = self.cut(piece, &plane);
                pieces[at] = back;
                pieces.push(front);
            } else {
                pieces[at] = piece;
                failures += 1;
            }
            if failures > 1000 + 10 * wanted as usize {
                return Err(RoomsError::Tiles { room, have: pieces.len() as u32, wanted });
            }
        }
        Ok(())
    }

    /// The axis-aligned plane that leaves least on its fuller side; `None` when none helps.
    fn median(&self, piece: &Piece, sample: &[[[f32; 3]; 3]], mine: &[u32]) -> Option<Plane> {
        let margin = 4.01 * self.delta;
        let mut cells = (DVec3::INFINITY, DVec3::NEG_INFINITY);
        for &leaf in &piece.leaves {
            let (a, b) = self.tree.leaves[leaf as usize].cell.bounds();
            cells = (cells.0.min(a), cells.1.max(b));
        }
        let mut best: Option<(usize, usize, Plane)> = None;
        let mut middles: Vec<f64> = Vec::with_capacity(mine.len());
        let mut lows: Vec<f64> = Vec::with_capacity(mine.len());
        let mut highs: Vec<f64> = Vec::with_capacity(mine.len());
        for (axis, normal) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().enumerate() {
            let (low, high) = (cells.0[axis], cells.1[axis]);
            for list in [&mut middles, &mut lows, &mut highs] {
                list.clear();
            }
            for &i in mine {
                let t = sample[i as usize].map(|p| f64::from(p[axis]));
                let (a, b) =
                    (t[0].min(t[1]).min(t[2]).max(low), t[0].max(t[1]).max(t[2]).min(high));
                middles.push((a + b) * 0.5);
                lows.push(a);
                highs.push(b);
            }
            for list in [&mut middles, &mut lows, &mut highs] {
                list.sort_by(f64::total_cmp);
            }
            for k in 1..16 {
                let offset = middles[(middles.len() * k / 16).min(middles.len() - 1)];
                if offset <= low + 16.0 * self.delta || offset >= high - 16.0 * self.delta {
                    continue;
                }
                let back = lows.partition_point(|&x| x <= offset + margin);
                let front = highs.len() - highs.partition_point(|&x| x < offset - margin);
                let (most, sum) = (front.max(back), front + back);
                if best.as_ref().is_none_or(|b| (most, sum) < (b.0, b.1)) {
                    best = Some((most, sum, Plane { normal, offset }));
                }
            }
        }
        let (most, sum, plane) = best?;
        // A cut must take a tenth off, and not copy nearly everything.
        (most * 10 <= mine.len() * 9 && sum * 5 <= mine.len() * 9).then_some(plane)
    }

    /// Whether a plane cuts a leaf into two parts worth having.
    fn cuts(&self, leaf: u32, plane: &Plane) -> bool {
        let (lo, hi) = self.tree.leaves[leaf as usize].cell.range(plane);
        let least = 16.0 * self.delta;
        lo < -least && hi > least
    }

    /// The part in front gets a new number, the part behind keeps the piece's.
    fn cut(&mut self, piece: Piece, plane: &Plane) -> [Piece; 2] {
        let (mut front, mut back) = (Vec::new(), Vec::new());
        let number = self.piece_rooms.len() as u32;
        self.piece_rooms.push(piece.room);
        for leaf in piece.leaves {
            let new = self
                .cuts(leaf, plane)
                .then(|| self.tree.split_leaf(leaf, plane, true, None))
                .flatten();
            if let Some(new) = new {
                self.piece.push(number);
                front.push(new);
                back.push(leaf);
                continue;
            }
            let (lo, hi) = self.tree.leaves[leaf as usize].cell.range(plane);
            if hi > -lo {
                self.piece[leaf as usize] = number;
                front.push(leaf);
            } else {
                back.push(leaf);
            }
        }
        [
            Piece { number, room: piece.room, leaves: front },
            Piece { number: piece.number, room: piece.room, leaves: back },
        ]
    }

    /// Writes the tables; `tiles` lists the numbers of all pieces in the order in which they become
    /// tiles, a room's one after the other, rooms ascending. Numbers that are not listed must have no leaves.
    /// Triangle counts (of rooms and tiles) are left zero, and so are the lists of the tiles' triangles.
    pub fn tables(self, order: &[u32]) -> Tables {
        let tree = &self.tree;
        let count = tree.leaves.len();
        let mut tile_of = vec![0u32; self.piece_rooms.len()];
        for (tile, &piece) in order.iter().enumerate() {
            tile_of[piece as usize] = tile as u32;
        }
        let tile_of_leaf = |leaf: u32| tile_of[self.piece[leaf as usize] as usize];
        // Leaves of a tile are consecutive.
        let mut by_tile: Vec<u32> = (0..count as u32).collect();
        by_tile.sort_by_key(|&l| (tile_of_leaf(l), l));
        let mut number = vec![0u32; count];
        for (i, &leaf) in by_tile.iter().enumerate() {
            number[leaf as usize] = i as u32;
        }
        drop(by_tile);
        let base = |leaf: u32| tree.leaves[leaf as usize].base as usize;
        let bsp = tables(tree, self.delta, &number, |leaf| {
            (self.room[base(leaf)], tile_of_leaf(leaf), self.flags[base(leaf)])
        });
        let mut tiles: Vec<TileRecord> = order
            .iter()
            .map(|&piece| TileRecord {
                room: self.piece_rooms[piece as usize],
                first_light: 0,
                light_count: 0,
                reserved: 0,
                triangles: 0,
                mesh_bytes: 0,
                min: [f32::INFINITY; 3],
                max: [f32::NEG_INFINITY; 3],
            })
            .collect();
        for (leaf, at) in tree.leaves.iter().enumerate() {
            let (lo, hi) = at.cell.bounds();
            let tile = &mut tiles[tile_of_leaf(leaf as u32) as usize];
            for k in 0..3 {
                tile.min[k] = tile.min[k].min(single(lo)[k]);
                tile.max[k] = tile.max[k].max(single(hi)[k]);
            }
        }
        let mut rooms = self.rooms;
        for (i, room) in rooms.iter_mut().enumerate() {
            let first = tiles.partition_point(|t| (t.room as usize) < i);
            let end = tiles.partition_point(|t| t.room as usize <= i);
            room.first_tile = first as u32;
            room.tile_count = (end - first) as u32;
        }
        Tables {
            planes: bsp.planes,
            nodes: bsp.nodes,
            leaves: bsp.leaves,
            faces: bsp.faces,
            rooms,
            portals: self.portals,
            pieces: self.portal_pieces,
            tiles,
            tile_offsets: Vec::new(),
            tile_triangles: Vec::new(),
            outside: self.outside,
        }
    }

    /// Cuts rooms into tiles by planes in free space, for a scene that is in memory whole: `triangles`
    /// must be all of the partition's. Rooms do not change. Replaces nothing: call it once.
    ///
    /// # Errors
    /// [`RoomsError::Request`] for a limit of 0 or if tiles have been cut before;
    /// [`RoomsError::Tiles`] if random cuts do not reach their number.
    pub fn cut_tiles(
        &mut self,
        triangles: &[[[f32; 3]; 3]],
        limit: TileLimit,
    ) -> Result<(), RoomsError> {
        if self.cut {
            return Err(RoomsError::Request("tiles have been cut already"));
        }
        match limit {
            TileLimit::Triangles(0) | TileLimit::Random { tiles: 0, .. } => {
                Err(RoomsError::Request("a tile limit of 0 cannot be met"))
            }
            TileLimit::Random { tiles, seed } => self.cut_at_random(triangles, tiles, seed),
            TileLimit::Triangles(most) => {
                let pieces = self.pieces();
                let lists = lists(&self.tree, self.delta, triangles, pieces.len(), |l| {
                    self.piece[l as usize]
                });
                for piece in pieces {
                    let own: Vec<_> =
                        lists.of(piece.number).iter().map(|&i| triangles[i as usize]).collect();
                    self.cut_piece(piece, &own, 1.0, most);
                }
                Ok(())
            }
        }
    }

    /// Writes the tables of a scene that is in memory whole, lists and counts included. Without
    /// [`Partition::cut_tiles`], each room is one tile.
    pub fn finish(self, triangles: &[[[f32; 3]; 3]]) -> Tables {
        let order: Vec<u32> = self.pieces().iter().map(Piece::number).collect();
        let mut tile_of = vec![0u32; order.len()];
        for (tile, &piece) in order.iter().enumerate() {
            tile_of[piece as usize] = tile as u32;
        }
        let lists = lists(&self.tree, self.delta, triangles, order.len(), |l| {
            tile_of[self.piece[l as usize] as usize]
        });
        let mut owned = vec![0u64; self.rooms.len()];
        let root = Start(self.tree.root());
        for t in triangles {
            owned[self.owner(root, t) as usize] += 1;
        }
        let mut tables = self.tables(&order);
        for (room, triangles) in tables.rooms.iter_mut().zip(owned) {
            room.triangles = triangles;
        }
        for (tile, ends) in tables.tiles.iter_mut().zip(lists.offsets.windows(2)) {
            tile.triangles = ends[1] - ends[0];
        }
        tables.tile_offsets = lists.offsets;
        tables.tile_triangles = lists.triangles;
        tables
    }
}

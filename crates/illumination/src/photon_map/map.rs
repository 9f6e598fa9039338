//! A photon map as bytes: pieces of a header, blocks of photons and boxes about them.

use enf_layout::map::*;
use enf_layout::photon::{PHOTON_HALO, PhotonRecord};
use enf_layout::sections::{self, Malformed, Transform};
use zerocopy::{FromBytes, IntoBytes};

use super::build::{box_of, build_map, count_blocks, nothing, union};
use super::search::{ABSENT, Root, above};

/// Levels of a piece's tree at most.
const LEVELS: usize = 12;

/// A room's photon map, read in place from blobs of [`enf_layout::map`].
#[derive(Clone, Debug)]
pub struct PhotonMap<'a> {
    pieces: Vec<Piece<'a>>,
    /// Boxes about the pieces, where there are several.
    above: Tree<Vec<MapNode>>,
    photons: usize,
    halo: u64,
    radius: f32,
}

/// Nodes, and where their levels begin.
#[derive(Clone, Debug, Default)]
struct Tree<N> {
    nodes: N,
    levels: [u32; LEVELS],
    height: u32,
}

impl<N: AsRef<[MapNode]>> Tree<N> {
    /// `None` if the number of nodes does not fit the number of blocks.
    fn new(nodes: N, blocks: usize) -> Option<Self> {
        let (mut levels, mut height, mut sum) = ([0; LEVELS], 0, 0);
        node_levels(blocks, |n| {
            if let Some(level) = levels.get_mut(height) {
                *level = sum as u32;
            }
            height += 1;
            sum += n;
        });
        let fits = sum == nodes.as_ref().len() && height <= LEVELS;
        fits.then_some(Self { nodes, levels, height: height as u32 })
    }

    /// Node `index` of level 1, 2, ...
    #[inline(always)]
    fn node(&self, level: u32, index: u32) -> &MapNode {
        let first = self.levels.get(level.wrapping_sub(1) as usize).copied().unwrap_or(u32::MAX);
        self.nodes.as_ref().get(first.saturating_add(index) as usize).unwrap_or(&EMPTY_NODE)
    }
}

/// What boxes lead to that are not as [`PhotonMap::check`] wants them.
static EMPTY_NODE: MapNode =
    MapNode { min: [[f32::MAX; NODE_CHILDREN]; 3], max: [[f32::MIN; NODE_CHILDREN]; 3] };
static EMPTY_BLOCK: MapBlock = MapBlock {
    position_bits: [[NO_PHOTON; BLOCK_PHOTONS]; 3],
    flux: [[0; 4]; BLOCK_PHOTONS],
    direction_flags: [0; BLOCK_PHOTONS],
    normal_flags: [0; BLOCK_PHOTONS],
};

/// A part of a map with its own tree.
#[derive(Clone, Debug)]
pub(super) struct Piece<'a> {
    pub(super) blocks: &'a [MapBlock],
    /// Number of its first photon in the whole map: blocks count as full.
    pub(super) first: u32,
    /// Blocks that it has; there are none in `blocks` as long as it is not in memory.
    count: usize,
    photons: usize,
    tree: Tree<&'a [MapNode]>,
}

/// What has to be known about a piece that is not in memory, so that a search sees when it would need it.
#[derive(Clone, Copy, Debug)]
pub struct Outline {
    header: MapHeader,
    blocks: usize,
    bounds: [[f32; 3]; 2],
}

impl Outline {
    /// Of a piece's blob; checks what [`PhotonMap::from_blob`] checks.
    ///
    /// # Errors
    /// [`Malformed`] says which count or section is wrong.
    pub fn of(blob: &[u8]) -> Result<Self, Malformed> {
        let (header, piece) = Piece::from_blob(blob)?;
        Ok(Self { header, blocks: piece.blocks.len(), bounds: piece.bounds() })
    }

    /// Photons of the piece.
    pub fn photons(&self) -> usize {
        self.header.photons as usize
    }
}

fn bad<T>(what: String) -> Result<T, Malformed> {
    Err(Malformed(format!("photon map: {what}")))
}

impl<'a> PhotonMap<'a> {
    /// Reads a map that is one piece. The blob's start is 8-byte aligned in memory, as every extent is.
    ///
    /// Checks the section table and the header's counts, in constant time. The photons are covered
    /// by the store's checksums; [`PhotonMap::check`] looks at each.
    ///
    /// # Errors
    /// [`Malformed`] says which count or section is wrong.
    pub fn from_blob(blob: &'a [u8]) -> Result<Self, Malformed> {
        Self::from_pieces([blob])
    }

    /// Reads a map from all its pieces, in their order. As [`PhotonMap::from_blob`] otherwise.
    ///
    /// # Errors
    /// [`Malformed`] says which count or section is wrong.
    pub fn from_pieces(blobs: impl IntoIterator<Item = &'a [u8]>) -> Result<Self, Malformed> {
        let blobs: Vec<&[u8]> = blobs.into_iter().collect();
        let outlines = blobs.iter().map(|b| Outline::of(b)).collect::<Result<Vec<_>, _>>()?;
        let mut map = Self::from_outlines(&outlines)?;
        for (piece, blob) in (0..).zip(blobs) {
            map.bring(piece, blob)?;
        }
        Ok(map)
    }

    /// A map of which no piece is in memory, from the outlines of all, in their order. A search that comes to a piece that is not
    /// there ends, and says so ([`GatherScratch::missing`](super::GatherScratch::missing)).
    ///
    /// # Errors
    /// [`Malformed`] if these are not the pieces of one map.
    pub fn from_outlines(outlines: &[Outline]) -> Result<Self, Malformed> {
        let mut map = Self {
            pieces: Vec::with_capacity(outlines.len()),
            above: Tree::default(),
            photons: 0,
            halo: 0,
            radius: f32::INFINITY,
        };
        let (mut blocks, mut wanted) = (0u64, 0);
        for outline in outlines {
            let Outline { header, blocks: count, .. } = outline;
            if header.piece as usize != map.pieces.len()
                || (header.piece > 0 && (header.pieces, header.radius) != (wanted, map.radius))
            {
                return bad(format!(
                    "piece {} of {} with a halo of {} m is not the one that comes next",
                    header.piece, header.pieces, header.radius
                ));
            }
            let first = (blocks * BLOCK_PHOTONS as u64) as u32;
            blocks += *count as u64;
            if blocks * BLOCK_PHOTONS as u64 > u64::from(u32::MAX) {
                return bad(format!("{blocks} blocks of photons are too many"));
            }
            wanted = header.pieces;
            let photons = header.photons as usize;
            map.photons += photons;
            map.halo += header.halo;
            map.radius = header.radius;
            map.pieces.push(Piece {
                blocks: &[],
                first,
                count: *count,
                photons,
                tree: Tree::default(),
            });
        }
        if map.pieces.len() != wanted as usize || map.pieces.is_empty() {
            return bad(format!("{} of its {wanted} pieces are there", map.pieces.len()));
        }
        if map.pieces.len() > 1 {
            let boxes: Vec<_> = outlines.iter().map(|outline| outline.bounds).collect();
            let mut nodes = Vec::with_capacity(node_count(boxes.len()));
            super::build::raise(&boxes, &mut nodes);
            match Tree::new(nodes, boxes.len()) {
                Some(tree) => map.above = tree,
                None => return bad("too many pieces".into()),
            }
        }
        Ok(map)
    }

    /// Brings a piece into the map.
    ///
    /// # Errors
    /// [`Malformed`] if it is not the one that its outline was made of.
    pub fn bring(&mut self, number: u32, blob: &'a [u8]) -> Result<(), Malformed> {
        let (header, brought) = Piece::from_blob(blob)?;
        match self.pieces.get_mut(number as usize) {
            Some(piece)
                if header.piece == number
                    && (brought.count, brought.photons) == (piece.count, piece.photons) =>
            {
                *piece = Piece { first: piece.first, ..brought };
                Ok(())
            }
            _ => bad(format!("piece {} is not the one that was asked for", header.piece)),
        }
    }

    /// The blob of a map of these photons, in any order, complete for gathers up to `radius` (m, above 0;
    /// infinite for a room without portals).
    pub fn build_blob(photons: &[PhotonRecord], radius: f32) -> Vec<u8> {
        let mut blob = vec![0; blob_bytes(photons.len())];
        build_map(photons, &mut blob, radius, [0, 1], 1);
        blob
    }

    /// Number of photons, halo included.
    pub fn len(&self) -> usize {
        self.photons
    }

    /// Whether there is no photon.
    pub fn is_empty(&self) -> bool {
        self.photons == 0
    }

    /// How many of the photons belong to neighbouring rooms.
    pub fn halo(&self) -> u64 {
        self.halo
    }

    /// Largest gather radius that the map is complete for, m. [`PhotonMap::irradiance`] never looks
    /// farther.
    pub fn radius(&self) -> f32 {
        self.radius
    }

    /// Numbers of photons are below this. Not every number has its photon: the last block of a piece may have
    /// empty places.
    pub fn places(&self) -> usize {
        self.pieces.last().map_or(0, |p| p.first as usize + p.count * BLOCK_PHOTONS)
    }

    /// The photon of a number below [`PhotonMap::places`], as it was stored; for an empty place, or a number
    /// beyond, one at a place that is no number.
    pub fn photon(&self, number: u32) -> PhotonRecord {
        let (block, i) = self.place(number);
        block.photon(i)
    }

    /// The block of a photon, and its place there.
    #[inline]
    pub(super) fn place(&self, number: u32) -> (&MapBlock, usize) {
        let piece = match &self.pieces[..] {
            [one] => Some(one),
            many => many.get(many.partition_point(|p| p.first <= number).saturating_sub(1)),
        };
        let found = piece.and_then(|piece| {
            let number = number.wrapping_sub(piece.first) as usize;
            Some((piece.blocks.get(number / BLOCK_PHOTONS)?, number % BLOCK_PHOTONS))
        });
        found.unwrap_or((&EMPTY_BLOCK, 0))
    }

    /// All photons of the pieces that are in memory with their numbers, in the order of these.
    pub fn photons(&self) -> impl Iterator<Item = (u32, PhotonRecord)> {
        self.pieces.iter().flat_map(|piece| {
            let here = piece.photons.min(piece.blocks.len() * BLOCK_PHOTONS);
            (0..here).map(|i| {
                let photon = piece.blocks[i / BLOCK_PHOTONS].photon(i % BLOCK_PHOTONS);
                (piece.first + i as u32, photon)
            })
        })
    }

    /// A block of a piece, and the number of its first photon.
    #[inline(always)]
    pub(super) fn block(&self, piece: u32, index: u32) -> (&MapBlock, u32) {
        let found = self.pieces.get(piece as usize).and_then(|piece| {
            let first = piece.first.wrapping_add(index.wrapping_mul(BLOCK_PHOTONS as u32));
            Some((piece.blocks.get(index as usize)?, first))
        });
        found.unwrap_or((&EMPTY_BLOCK, 0))
    }

    /// Where a search begins, if there is anything to be found.
    #[inline(always)]
    pub(super) fn root(&self) -> Option<Root> {
        match &self.pieces[..] {
            _ if self.photons == 0 => None,
            [one] => Some(Root { piece: 0, level: one.root() }),
            _ => Some(above(self.above.height)),
        }
    }

    /// A node of a piece, or of what is above the pieces.
    #[inline(always)]
    pub(super) fn node(&self, piece: u32, level: u32, index: u32) -> &MapNode {
        match self.pieces.get(piece as usize) {
            Some(piece) => piece.tree.node(level, index),
            None => self.above.node(level, index),
        }
    }

    /// What child `index` is of a level above the pieces: piece, level and index.
    #[inline(always)]
    pub(super) fn below(&self, level: u32, index: u32) -> (u32, u32, u32) {
        match level {
            1 => (index, self.pieces.get(index as usize).map_or(0, Piece::root), 0),
            _ => (u32::MAX, level - 1, index),
        }
    }

    /// Looks at every photon: finite positions, the halo's count, empty places at the end, and every box as large
    /// as it has to be. Linear time, no memory.
    ///
    /// # Errors
    /// [`Malformed`] names the first photon or box that is not as it should be.
    pub fn check(&self) -> Result<(), Malformed> {
        let halo = self.photons().filter(|(_, p)| p.flags & PHOTON_HALO != 0).count() as u64;
        if halo != self.halo {
            return bad(format!("{halo} halo photons, its header counts {}", self.halo));
        }
        for (i, p) in self.photons() {
            if !p.position().iter().all(|c| c.is_finite()) {
                return bad(format!("photon {i} has position {:?}", p.position()));
            }
        }
        self.pieces.iter().enumerate().try_for_each(|(n, piece)| piece.check(n))
    }
}

impl<'a> Piece<'a> {
    fn from_blob(blob: &'a [u8]) -> Result<(MapHeader, Self), Malformed> {
        if !blob.as_ptr().cast::<u64>().is_aligned() {
            return bad("its bytes do not start at a multiple of 8 in memory".into());
        }
        let count = sections::table(blob)?.len();
        if count != SECTIONS {
            return bad(format!("{count} sections instead of {SECTIONS}"));
        }
        let headers: &[MapHeader] = sections::section(blob, SECTION_HEADER)?;
        let [header] = headers else {
            return bad(format!("{} headers instead of one", headers.len()));
        };
        let blocks: &[MapBlock] = sections::section(blob, SECTION_BLOCKS)?;
        let nodes: &[MapNode] = sections::section(blob, SECTION_NODES)?;
        if header.photons.div_ceil(BLOCK_PHOTONS as u64) != blocks.len() as u64 {
            return bad(format!(
                "its header counts {} photons, it has {} blocks",
                header.photons,
                blocks.len()
            ));
        }
        if header.photons > u64::from(u32::MAX) - BLOCK_PHOTONS as u64 {
            return bad(format!("{} photons are more than {}", header.photons, u32::MAX));
        }
        let Some(tree) = Tree::new(nodes, blocks.len()) else {
            return bad(format!("{} nodes about {} blocks", nodes.len(), blocks.len()));
        };
        if header.halo > header.photons {
            return bad(format!("{} halo photons among {}", header.halo, header.photons));
        }
        if header.radius.is_nan() || header.radius <= 0.0 {
            return bad(format!("its halo is {} m wide, not more than 0", header.radius));
        }
        let (count, photons) = (blocks.len(), header.photons as usize);
        Ok((*header, Self { blocks, first: 0, count, photons, tree }))
    }

    /// The level where a search of it begins.
    #[inline(always)]
    fn root(&self) -> u32 {
        match self.blocks.len() == self.count {
            true => self.tree.height,
            false => ABSENT,
        }
    }

    /// The box about everything.
    fn bounds(&self) -> [[f32; 3]; 2] {
        let Some(root) = self.tree.nodes.last() else { return nothing() };
        (0..NODE_CHILDREN).fold(nothing(), |all, i| union(all, child_box(root, i)))
    }

    fn check(&self, number: usize) -> Result<(), Malformed> {
        for i in self.photons..self.blocks.len() * BLOCK_PHOTONS {
            let empty = PhotonRecord { position_bits: [NO_PHOTON; 3], ..PhotonRecord::default() };
            if self.blocks[i / BLOCK_PHOTONS].photon(i % BLOCK_PHOTONS) != empty {
                return bad(format!("place {i} of piece {number} is not empty"));
            }
        }
        let mut below: usize = self.blocks.len();
        for level in 1..=self.tree.height {
            for i in 0..below.next_multiple_of(NODE_CHILDREN) {
                let node = self.tree.node(level, (i / NODE_CHILDREN) as u32);
                let is = child_box(node, i % NODE_CHILDREN);
                let should = match level {
                    _ if i >= below => nothing(),
                    1 => box_of(&self.blocks[i]),
                    _ => {
                        let child = self.tree.node(level - 1, i as u32);
                        (0..NODE_CHILDREN).fold(nothing(), |all, c| union(all, child_box(child, c)))
                    }
                };
                if is != should {
                    return bad(format!(
                        "box {i} of level {level} of piece {number} is {is:?}, not {should:?}"
                    ));
                }
            }
            below = below.div_ceil(NODE_CHILDREN);
        }
        Ok(())
    }
}

/// The box about a child: lower and upper corner.
fn child_box(node: &MapNode, i: usize) -> [[f32; 3]; 2] {
    [node.min.map(|axis| axis[i]), node.max.map(|axis| axis[i])]
}

/// Bytes of the blob of a piece with this many photons.
pub fn blob_bytes(photons: usize) -> usize {
    sections::blob_bytes(&lengths(photons))
}

fn lengths(photons: usize) -> [usize; SECTIONS] {
    let blocks = count_blocks(photons);
    [
        size_of::<MapHeader>(),
        blocks * size_of::<MapBlock>(),
        node_count(blocks) * size_of::<MapNode>(),
    ]
}

/// Writes table and header into a zeroed blob; returns its blocks and nodes.
pub(super) fn open_blob(
    blob: &mut [u8],
    header: MapHeader,
) -> Option<(&mut [MapBlock], &mut [MapNode])> {
    let [a, b, c] = lengths(header.photons as usize);
    let none = Transform::None;
    sections::write_table(blob, &[(a, none, 0), (b, none, 0), (c, none, 0)]);
    let [at, blocks, nodes] = sections::split_mut::<SECTIONS>(blob).ok()?;
    at.copy_from_slice(header.as_bytes());
    let blocks = <[MapBlock]>::mut_from_bytes(blocks).ok()?;
    let nodes = <[MapNode]>::mut_from_bytes(nodes).ok()?;
    Some((blocks, nodes))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::photon_map::tests_support::shuffled;

    #[test]
    fn blobs_come_back() {
        for n in [0, 1, 15, 16, 17, 128, 129, 1000, 5000] {
            let photons = shuffled(n, 3);
            let blob = PhotonMap::build_blob(&photons, 0.5);
            let map = PhotonMap::from_blob(&blob).unwrap();
            assert_eq!((map.len(), map.is_empty(), map.halo(), map.radius()), (n, n == 0, 0, 0.5));
            map.check().unwrap();
            assert_eq!(blob.len() % 64, 0);
            assert_eq!(blob.len(), blob_bytes(n));
            assert_eq!(map.places(), n.next_multiple_of(16));
            let mut back: Vec<_> = map.photons().map(|(_, p)| p).collect();
            assert!(map.photons().all(|(i, p)| map.photon(i) == p));
            let mut all = photons;
            crate::canonical_sort(&mut all);
            crate::canonical_sort(&mut back);
            assert!(all == back);
        }
    }

    #[test]
    fn bad_blobs_are_refused() {
        let mut photons = shuffled(40, 3);
        photons[7].flags |= PHOTON_HALO;
        let good = PhotonMap::build_blob(&photons, 0.5);
        assert!(PhotonMap::from_blob(&good).is_ok());
        let refused = |blob: &[u8]| PhotonMap::from_blob(blob).unwrap_err().to_string();
        assert!(PhotonMap::from_blob(&[]).is_err());
        for cut in [4, 40, 100, 130, 200, good.len() - 64] {
            assert!(PhotonMap::from_blob(&good[..cut]).is_err(), "{cut}");
        }
        let sound =
            MapHeader { photons: 40, halo: 1, radius: 0.5, piece: 0, pieces: 1, reserved: 0 };
        let with_header = |header: MapHeader| {
            let mut blob = good.clone();
            blob[128..160].copy_from_slice(header.as_bytes());
            blob
        };
        assert_eq!(with_header(sound), good);
        assert!(refused(&with_header(MapHeader { photons: 49, ..sound })).contains("49 photons"));
        assert!(refused(&with_header(MapHeader { halo: 41, ..sound })).contains("41 halo photons"));
        assert!(refused(&with_header(MapHeader { radius: 0.0, ..sound })).contains("0 m wide"));
        assert!(refused(&with_header(MapHeader { radius: f32::NAN, ..sound })).contains("NaN m"));
        assert!(
            refused(&with_header(MapHeader { piece: 1, pieces: 2, ..sound }))
                .contains("piece 1 of 2")
        );
        assert!(
            refused(&with_header(MapHeader { pieces: 2, ..sound })).contains("1 of its 2 pieces")
        );
        assert!(PhotonMap::from_pieces([]).is_err());
        assert!(PhotonMap::from_pieces([&good[..], &good[..]]).is_err());
        // Halo flags, empty places and boxes are only looked at by the slow check.
        let slow =
            |blob: &[u8]| PhotonMap::from_blob(blob).unwrap().check().unwrap_err().to_string();
        let said = slow(&with_header(MapHeader { halo: 0, ..sound }));
        assert!(said.contains("1 halo photons"), "{said}");
        let said = slow(&with_header(MapHeader { photons: 35, ..sound }));
        assert!(said.contains("halo") || said.contains("is not empty"), "{said}");
        let mut blob = good.clone();
        blob[192 + 4 * 3..][..4].copy_from_slice(&f32::NAN.to_bits().to_le_bytes());
        assert!(slow(&blob).contains("photon 3"), "{}", slow(&blob));
        let at = blob.len() - 192;
        let mut blob = good.clone();
        blob[at..at + 4].copy_from_slice(&9.0f32.to_le_bytes());
        assert!(slow(&blob).contains("box 0 of level 1"), "{}", slow(&blob));
    }
}

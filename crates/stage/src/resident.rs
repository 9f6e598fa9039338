//! Tiles in memory: a loader thread that fetches ahead, and a cache that keeps what the budget allows (the
//! paper's section 9 names this cache as future work).

use std::collections::BTreeMap;
use std::sync::Arc;

use crossbeam::channel::{Receiver, Sender, bounded};
use enf_geometry::{BvhView, GridView, Structure, StructureKind, TileMesh};
use enf_layout::sections::Malformed;
use enf_layout::segment::ExtentKind;
use enf_store::{Buffer, Extent, MemoryBudget, StageReader, StoreError};

use crate::failure::{Failure, Result};
use crate::timeline::Timeline;

/// The kinds of extents that hold the structure of a tile; each tile has one of them.
pub const STRUCTURES: [ExtentKind; 2] = [ExtentKind::Bvh, ExtentKind::Grid];

/// One tile's structure, inflated, completed from its mesh, checked once.
pub struct TileData {
    /// Tile id.
    pub tile: u32,
    /// Kept for a structure that holds no triangles of its own.
    mesh: Option<Buffer>,
    structure: Buffer,
    /// Texture coordinates, where some triangle has any.
    coordinates: Option<Buffer>,
    delta: f32,
}

impl TileData {
    /// The structure, which answers rays and knows what they hit.
    ///
    /// # Errors
    /// When the blob is malformed; it was checked when it was loaded.
    pub fn structure(&self) -> std::result::Result<Structure<'_>, Malformed> {
        let (blob, delta) = (&self.structure[..], self.delta);
        Ok(match &self.mesh {
            Some(mesh) => {
                let mesh = TileMesh::from_checked_blob(mesh)?;
                Structure::Grid(GridView::from_checked_blob(blob, mesh, delta)?)
            }
            None => Structure::Bvh(BvhView::from_checked_blob(blob, delta)?),
        })
    }

    /// Texture coordinates of the tile's triangles, a blob of [`enf_layout::texture`]; empty if there are none.
    pub fn coordinates(&self) -> &[u8] {
        self.coordinates.as_ref().map_or(&[], |c| &c[..])
    }

    /// Bytes held.
    pub fn bytes(&self) -> u64 {
        let optional = |b: &Option<Buffer>| b.as_ref().map_or(0, |b| b.len());
        (optional(&self.mesh) + self.structure.len() + optional(&self.coordinates)) as u64
    }
}

/// Reads tiles.
pub struct TileReader<'a> {
    /// The partition stage, for meshes.
    pub partition: &'a StageReader,
    /// The grid stage.
    pub grid: &'a StageReader,
    /// Where the bytes come from.
    pub budget: &'a MemoryBudget,
    /// The scene's tolerance, m.
    pub delta: f32,
}

impl TileReader<'_> {
    fn structure(&self, tile: u32) -> std::result::Result<(StructureKind, &Extent), StoreError> {
        if self.grid.find(ExtentKind::Bvh, tile).is_empty() {
            return Ok((StructureKind::Grid, self.grid.single(ExtentKind::Grid, tile)?));
        }
        Ok((StructureKind::Bvh, self.grid.single(ExtentKind::Bvh, tile)?))
    }

    /// Bytes that the tile needs while it is loaded; it may need less then.
    ///
    /// # Errors
    /// When the store does not have it.
    pub fn bytes(&self, tile: u32) -> Result<u64> {
        let coordinates = self.partition.find(ExtentKind::Coordinates, tile);
        Ok(self.partition.single(ExtentKind::Geometry, tile)?.raw_bytes
            + self.structure(tile)?.1.raw_bytes
            + coordinates.iter().map(|c| c.raw_bytes).sum::<u64>())
    }

    /// Reads, verifies and inflates a tile.
    ///
    /// # Errors
    /// Corrupt or missing extents; a budget that has no room.
    pub fn load(&self, tile: u32) -> std::result::Result<TileData, StoreError> {
        let geometry = self.partition.single(ExtentKind::Geometry, tile)?;
        let mesh = self.partition.read(geometry, self.budget, "mesh of a tile")?;
        let (kind, extent) = self.structure(tile)?;
        let mut structure = self.grid.read(extent, self.budget, "structure of a tile")?;
        let view = TileMesh::from_blob(&mesh)?;
        // What is completed is checked on the way.
        kind.complete(&mut structure, &view)?;
        match kind {
            StructureKind::Grid => drop(GridView::from_blob(&structure, view, self.delta)?),
            StructureKind::Bvh => drop(BvhView::from_checked_blob(&structure, self.delta)?),
        }
        let mesh = (kind == StructureKind::Grid).then_some(mesh);
        let coordinates = match self.partition.find(ExtentKind::Coordinates, tile) {
            [] => None,
            _ => {
                let extent = self.partition.single(ExtentKind::Coordinates, tile)?;
                Some(self.partition.read(extent, self.budget, "texture coordinates of a tile")?)
            }
        };
        Ok(TileData { tile, mesh, structure, coordinates, delta: self.delta })
    }
}

/// The cache of resident tiles. Owned by the stage's main thread; the loader runs beside it.
pub struct TileCache {
    requests: Sender<u32>,
    replies: Receiver<(u32, std::result::Result<TileData, StoreError>)>,
    /// What was asked for and has not arrived.
    in_flight: Option<u32>,
    resident: BTreeMap<u32, (u64, Arc<TileData>)>,
    clock: u64,
    most: usize,
    budget: MemoryBudget,
    /// Bytes that the cache leaves to others: blocks of records that are read back.
    margin: u64,
    loads: BTreeMap<u32, u32>,
    evicted: u64,
}

impl TileCache {
    /// A cache of at most `most` tiles (0: as many as the budget holds beside `margin` bytes), and the loop that the
    /// loader thread runs.
    pub fn new<'a>(
        reader: TileReader<'a>,
        most: usize,
        margin: u64,
        timeline: &'a Timeline,
    ) -> (Self, impl FnOnce() + Send + 'a) {
        let budget = reader.budget.clone();
        let (requests, incoming) = bounded::<u32>(1);
        let (outgoing, replies) = bounded(1);
        let lane = move || {
            let handle = timeline.lane("loader");
            for tile in incoming {
                let span = handle.io("load", tile);
                let loaded = reader.load(tile);
                drop(span);
                if outgoing.send((tile, loaded)).is_err() {
                    break;
                }
            }
        };
        let cache = Self {
            requests,
            replies,
            in_flight: None,
            resident: BTreeMap::new(),
            clock: 0,
            most,
            budget,
            margin,
            loads: BTreeMap::new(),
            evicted: 0,
        };
        (cache, lane)
    }

    /// Whether the tile is in memory.
    pub fn is_resident(&self, tile: u32) -> bool {
        self.resident.contains_key(&tile)
    }

    /// Asks for a tile ahead of its use, where that evicts nothing that is in use.
    ///
    /// # Errors
    /// A tile that arrived in the meantime and could not be read.
    pub fn prefetch(&mut self, tile: u32) -> Result<()> {
        if self.in_flight.is_some() || self.most == 1 || self.is_resident(tile) {
            return Ok(());
        }
        self.keep_margin();
        self.make_room(1);
        self.request(tile)
    }

    fn request(&mut self, tile: u32) -> Result<()> {
        self.requests.send(tile).map_err(|_| Failure::io("the loader thread has stopped"))?;
        self.in_flight = Some(tile);
        Ok(())
    }

    /// Evicts least recently used tiles that nobody holds until the margin is free.
    fn keep_margin(&mut self) {
        while self.budget.available() < self.margin {
            if !self.evict_one() {
                break;
            }
        }
    }

    /// Evicts least recently used tiles until at most `most` less `coming` stay.
    fn make_room(&mut self, coming: usize) {
        while self.most > 0 && self.resident.len() + coming > self.most {
            if !self.evict_one() {
                break;
            }
        }
    }

    fn evict_one(&mut self) -> bool {
        // A tile that someone holds is in use; dropping it from the cache would free nothing.
        let oldest = self
            .resident
            .iter()
            .filter(|(_, (_, data))| Arc::strong_count(data) == 1)
            .min_by_key(|(_, (used, _))| *used)
            .map(|(&tile, _)| tile);
        match oldest {
            Some(tile) => {
                self.resident.remove(&tile);
                self.evicted += 1;
                true
            }
            None => false,
        }
    }

    /// The tile, loaded now if it must be. Tiles that nobody holds make way until the budget has room.
    ///
    /// # Errors
    /// Exit 3 when it does not fit even alone, naming the tile's need; exit 4 when it is damaged.
    pub fn get(&mut self, tile: u32) -> Result<Arc<TileData>> {
        self.clock += 1;
        loop {
            if let Some((used, data)) = self.resident.get_mut(&tile) {
                *used = self.clock;
                let data = Arc::clone(data);
                self.keep_margin();
                return Ok(data);
            }
            if self.in_flight.is_none() {
                self.make_room(1);
                self.request(tile)?;
            }
            let (arrived, loaded) =
                self.replies.recv().map_err(|_| Failure::io("the loader thread has stopped"))?;
            self.in_flight = None;
            match loaded {
                Ok(data) => {
                    *self.loads.entry(arrived).or_default() += 1;
                    if arrived != tile {
                        self.make_room(2);
                    }
                    self.resident.insert(arrived, (self.clock, Arc::new(data)));
                }
                Err(StoreError::Budget(_)) if self.evict_one() => {}
                // A prefetch that found no room is no error, only no use.
                Err(StoreError::Budget(_)) if arrived != tile => {}
                Err(error) => return Err(error.into()),
            }
        }
    }

    /// Frees a tile that nobody holds, or one that was fetched ahead; false when there is none.
    ///
    /// # Errors
    /// The tile that was fetched ahead could not be read.
    pub fn make_way(&mut self) -> Result<bool> {
        if self.evict_one() {
            return Ok(true);
        }
        if self.in_flight.is_none() {
            return Ok(false);
        }
        let (_, loaded) =
            self.replies.recv().map_err(|_| Failure::io("the loader thread has stopped"))?;
        self.in_flight = None;
        match loaded {
            Ok(_) | Err(StoreError::Budget(_)) => Ok(true),
            Err(error) => Err(error.into()),
        }
    }

    /// Loads so far, by tile.
    pub fn loads(&self) -> &BTreeMap<u32, u32> {
        &self.loads
    }
}

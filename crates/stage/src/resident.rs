//! Tiles in memory: a loader thread that fetches ahead, and a cache that keeps what the budget allows (the
//! paper's section 9 names this cache as future work).

use std::collections::BTreeMap;
use std::sync::Arc;

use crossbeam::channel::{Receiver, Sender, unbounded};
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
#[derive(Clone, Copy)]
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

    /// Bytes that loading the tile reserves at any moment, at most.
    ///
    /// # Errors
    /// When the store does not have it.
    pub fn peak_bytes(&self, tile: u32) -> Result<u64> {
        let mesh = self.partition.single(ExtentKind::Geometry, tile)?;
        let structure = self.structure(tile)?.1;
        let coordinates = self.partition.find(ExtentKind::Coordinates, tile).first();
        let both = mesh.raw_bytes + structure.raw_bytes;
        let last = coordinates.map_or(0, |c| both + c.read_peak_bytes());
        Ok(mesh.read_peak_bytes().max(mesh.raw_bytes + structure.read_peak_bytes()).max(last))
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

/// A tile that was asked for, or why it could not be had.
pub struct Arrival {
    tile: u32,
    loaded: std::result::Result<TileData, StoreError>,
}

/// The cache of resident tiles. Owned by the stage's main thread; loaders run beside it.
pub struct TileCache<'a> {
    reader: TileReader<'a>,
    requests: Sender<u32>,
    arrivals: Receiver<Arrival>,
    /// What was asked for and has not arrived, and what it may come to reserve.
    in_flight: BTreeMap<u32, u64>,
    resident: BTreeMap<u32, (u64, Arc<TileData>)>,
    clock: u64,
    most: usize,
    /// Bytes that the cache leaves to others: blocks of records that are read back.
    margin: u64,
    loads: BTreeMap<u32, u32>,
}

impl<'a> TileCache<'a> {
    /// A cache of at most `most` tiles (0: as many as the budget holds beside `margin` bytes), and the loop that a
    /// loader thread runs; any number of threads may run it.
    pub fn new(
        reader: TileReader<'a>,
        most: usize,
        margin: u64,
        timeline: &'a Timeline,
    ) -> (Self, impl FnOnce() + Clone + Send + 'a) {
        let (requests, incoming) = unbounded::<u32>();
        let (outgoing, arrivals) = unbounded();
        let lane = move || {
            let handle = timeline.lane("loader");
            for tile in incoming {
                let span = handle.io("load", tile);
                let loaded = reader.load(tile);
                drop(span);
                if outgoing.send(Arrival { tile, loaded }).is_err() {
                    break;
                }
            }
        };
        let cache = Self {
            reader,
            requests,
            arrivals,
            in_flight: BTreeMap::new(),
            resident: BTreeMap::new(),
            clock: 0,
            most,
            margin,
            loads: BTreeMap::new(),
        };
        (cache, lane)
    }

    /// Whether the tile is in memory.
    pub fn is_resident(&self, tile: u32) -> bool {
        self.resident.contains_key(&tile)
    }

    /// Whether the tile was asked for and has not arrived.
    pub fn is_in_flight(&self, tile: u32) -> bool {
        self.in_flight.contains_key(&tile)
    }

    /// Tiles that were asked for and have not arrived.
    pub fn in_flight(&self) -> usize {
        self.in_flight.len()
    }

    /// The resident tiles, in order of their ids.
    pub fn residents(&self) -> impl Iterator<Item = u32> + '_ {
        self.resident.keys().copied()
    }

    /// The resident tiles, the last used first.
    pub fn recent(&self) -> Vec<u32> {
        let mut tiles: Vec<(u64, u32)> =
            self.resident.iter().map(|(&tile, &(used, _))| (used, tile)).collect();
        tiles.sort_unstable_by(|a, b| b.cmp(a));
        tiles.into_iter().map(|(_, tile)| tile).collect()
    }

    /// The tile, if it is in memory; it counts as used now.
    pub fn resident(&mut self, tile: u32) -> Option<Arc<TileData>> {
        self.clock += 1;
        let (used, data) = self.resident.get_mut(&tile)?;
        *used = self.clock;
        Some(Arc::clone(data))
    }

    /// Asks for a tile ahead of its use, where that evicts nothing that is in use: to be told of in [`Self::arrivals`].
    ///
    /// # Errors
    /// The loaders have stopped.
    pub fn prefetch(&mut self, tile: u32) -> Result<()> {
        self.ask(tile, &|_| true).map(|_| ())
    }

    /// Asks for a tile if it fits beside all that is in use, in flight, or not `idle`; whether it does.
    ///
    /// # Errors
    /// The loaders have stopped; a tile that the store does not have.
    pub fn ask(&mut self, tile: u32, idle: &dyn Fn(u32) -> bool) -> Result<bool> {
        if self.is_in_flight(tile) || self.is_resident(tile) {
            return Ok(true);
        }
        let needs = self.reader.peak_bytes(tile)?;
        let coming = self.in_flight.values().sum::<u64>() + needs + self.margin;
        loop {
            let count = self.resident.len() + self.in_flight.len() + 1;
            if self.reader.budget.available() >= coming && (self.most == 0 || count <= self.most) {
                break;
            }
            if !self.evict(idle) {
                return Ok(false);
            }
        }
        self.request(tile, needs)?;
        Ok(true)
    }

    fn request(&mut self, tile: u32, needs: u64) -> Result<()> {
        self.requests.send(tile).map_err(|_| stopped())?;
        self.in_flight.insert(tile, needs);
        Ok(())
    }

    /// Where tiles arrive; each arrival goes to [`Self::arrived`].
    pub fn arrivals(&self) -> &Receiver<Arrival> {
        &self.arrivals
    }

    /// Takes in what has arrived. A tile that found no room is not there then.
    ///
    /// # Errors
    /// Exit 4 when it is damaged, exit 5 when it cannot be read.
    pub fn arrived(&mut self, arrival: Arrival) -> Result<()> {
        let Arrival { tile, loaded } = arrival;
        self.in_flight.remove(&tile);
        match loaded {
            Ok(data) => {
                self.clock += 1;
                *self.loads.entry(tile).or_default() += 1;
                self.resident.insert(tile, (self.clock, Arc::new(data)));
                Ok(())
            }
            Err(StoreError::Budget(_)) => Ok(()),
            Err(error) => Err(error.into()),
        }
    }

    fn receive(&self) -> Result<Arrival> {
        self.arrivals.recv().map_err(|_| stopped())
    }

    /// Evicts least recently used tiles that nobody holds until the margin is free.
    pub fn keep_margin(&mut self) {
        while self.reader.budget.available() < self.margin {
            if !self.evict(&|_| true) {
                break;
            }
        }
    }

    /// Evicts the tile that was used longest ago among those that are idle and that nobody holds; dropping one that someone
    /// holds would free nothing.
    fn evict(&mut self, idle: &dyn Fn(u32) -> bool) -> bool {
        let oldest = self
            .resident
            .iter()
            .filter(|&(&tile, (_, data))| Arc::strong_count(data) == 1 && idle(tile))
            .min_by_key(|(_, (used, _))| *used)
            .map(|(&tile, _)| tile);
        let Some(tile) = oldest else { return false };
        self.resident.remove(&tile);
        true
    }

    /// The tile, loaded now if it must be. Tiles that nobody holds make way until the budget has room.
    ///
    /// # Errors
    /// Exit 3 when it does not fit even alone, naming the tile's need; exit 4 when it is damaged.
    pub fn get(&mut self, tile: u32) -> Result<Arc<TileData>> {
        loop {
            if let Some(data) = self.resident(tile) {
                self.keep_margin();
                return Ok(data);
            }
            if !self.is_in_flight(tile) {
                while self.most > 0
                    && self.resident.len() + self.in_flight.len() + 1 > self.most
                    && self.evict(&|_| true)
                {}
                self.request(tile, self.reader.peak_bytes(tile)?)?;
            }
            let arrival = self.receive()?;
            match &arrival.loaded {
                // What nobody holds makes way, and what is in flight may have to be let go again.
                Err(StoreError::Budget(error)) if arrival.tile == tile => {
                    let error = error.clone();
                    self.in_flight.remove(&tile);
                    if !self.evict(&|_| true) && self.in_flight.is_empty() {
                        return Err(StoreError::Budget(error).into());
                    }
                }
                _ => self.arrived(arrival)?,
            }
        }
    }

    /// Frees a tile that nobody holds, or one that was fetched ahead; false when there is none.
    ///
    /// # Errors
    /// The tile that was fetched ahead could not be read.
    pub fn make_way(&mut self) -> Result<bool> {
        if self.evict(&|_| true) {
            return Ok(true);
        }
        if self.in_flight.is_empty() {
            return Ok(false);
        }
        let Arrival { tile, loaded } = self.receive()?;
        self.in_flight.remove(&tile);
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

fn stopped() -> Failure {
    Failure::io("the loader thread has stopped")
}

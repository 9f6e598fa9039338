//! Tiles in memory: loader threads that fetch ahead, and a cache that keeps what the budget allows (the
//! paper's section 9 names this cache as future work). Whatever else is loaded by its number is kept in the same way.

use std::cell::Cell;
use std::collections::BTreeMap;
use std::rc::Rc;
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

/// How a [`Cache`] gets what it keeps.
pub trait Load: Copy + Send {
    /// What is kept.
    type Item: Send + Sync;
    /// What the timeline calls a load.
    const SPAN: &'static str;
    /// Where the bytes come from.
    fn budget(&self) -> &MemoryBudget;
    /// Bytes that a load reserves at any moment, at most, as far as they are known before it.
    ///
    /// # Errors
    /// When the store does not have it.
    fn peak_bytes(&self, id: u32) -> Result<u64>;
    /// Loads it.
    ///
    /// # Errors
    /// Corrupt or missing extents; a budget that has no room.
    fn load(&self, id: u32) -> std::result::Result<Self::Item, StoreError>;
}

impl Load for TileReader<'_> {
    type Item = TileData;
    const SPAN: &'static str = "load";

    fn budget(&self) -> &MemoryBudget {
        self.budget
    }

    fn peak_bytes(&self, tile: u32) -> Result<u64> {
        TileReader::peak_bytes(self, tile)
    }

    fn load(&self, tile: u32) -> std::result::Result<TileData, StoreError> {
        TileReader::load(self, tile)
    }
}

/// The cache of resident tiles.
pub type TileCache<'a> = Cache<TileReader<'a>>;

/// A tile that was asked for, or why it could not be had.
pub struct Arrival<T> {
    tile: u32,
    loaded: std::result::Result<T, StoreError>,
}

/// What is resident, by number: tiles, as they are called below, or anything else. Owned by the stage's main thread; loaders run
/// beside it.
pub struct Cache<L: Load> {
    reader: L,
    requests: Sender<u32>,
    arrivals: Receiver<Arrival<L::Item>>,
    /// What was asked for and has not arrived, and what it may come to reserve.
    in_flight: BTreeMap<u32, u64>,
    resident: BTreeMap<u32, (u64, Arc<L::Item>)>,
    /// Ticks with every use.
    clock: Rc<Cell<u64>>,
    most: usize,
    /// Bytes that the cache leaves to others: blocks of records that are read back.
    margin: u64,
    loads: BTreeMap<u32, u32>,
}

impl<L: Load> Cache<L> {
    /// A cache of at most `most` tiles (0: as many as the budget holds beside `margin` bytes), and the loop that a
    /// loader thread runs; any number of threads may run it.
    pub fn new(
        reader: L,
        most: usize,
        margin: u64,
        timeline: &Timeline,
    ) -> (Self, impl FnOnce() + Clone + Send + use<'_, L>) {
        let (requests, incoming) = unbounded::<u32>();
        let (outgoing, arrivals) = unbounded();
        let lane = move || {
            let handle = timeline.lane("loader");
            for tile in incoming {
                let span = handle.io(L::SPAN, tile);
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
            clock: Rc::default(),
            most,
            margin,
            loads: BTreeMap::new(),
        };
        (cache, lane)
    }

    /// Uses the clock of another cache, so that what is in both can be told apart by age ([`Self::oldest`]). To be called before
    /// anything is loaded.
    pub fn beside<M: Load>(mut self, other: &Cache<M>) -> Self {
        self.clock = Rc::clone(&other.clock);
        self
    }

    fn now(&self) -> u64 {
        self.clock.set(self.clock.get() + 1);
        self.clock.get()
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

    /// Bytes that what was asked for may come to reserve.
    pub fn coming(&self) -> u64 {
        self.in_flight.values().sum()
    }

    /// When what would go next was used last, if anything can go: see [`Self::evict`].
    pub fn oldest(&self, idle: &dyn Fn(u32) -> bool) -> Option<u64> {
        self.next_to_go(idle).map(|(used, _)| used)
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
    pub fn resident(&mut self, tile: u32) -> Option<Arc<L::Item>> {
        let now = self.now();
        let (used, data) = self.resident.get_mut(&tile)?;
        *used = now;
        Some(Arc::clone(data))
    }

    /// Bytes that a load reserves at most.
    ///
    /// # Errors
    /// A tile that the store does not have.
    pub fn needs(&self, tile: u32) -> Result<u64> {
        self.reader.peak_bytes(tile)
    }

    /// Asks for a tile ahead of its use, to be told of in [`Self::arrivals`], if it fits beside all that is in use, in flight, or not `idle`; whether it does.
    ///
    /// # Errors
    /// The loaders have stopped; a tile that the store does not have.
    pub fn ask(&mut self, tile: u32, idle: &dyn Fn(u32) -> bool) -> Result<bool> {
        if self.is_in_flight(tile) || self.is_resident(tile) {
            return Ok(true);
        }
        let needs = self.reader.peak_bytes(tile)?;
        let coming = self.coming() + needs + self.margin;
        loop {
            let count = self.resident.len() + self.in_flight.len() + 1;
            if self.reader.budget().available() >= coming && (self.most == 0 || count <= self.most)
            {
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
    pub fn arrivals(&self) -> &Receiver<Arrival<L::Item>> {
        &self.arrivals
    }

    /// Takes in what has arrived; whether it is there. A tile that found no room in the budget is not.
    ///
    /// # Errors
    /// Exit 4 when it is damaged, exit 5 when it cannot be read.
    pub fn arrived(&mut self, arrival: Arrival<L::Item>) -> Result<bool> {
        let Arrival { tile, loaded } = arrival;
        self.in_flight.remove(&tile);
        match loaded {
            Ok(data) => {
                let now = self.now();
                *self.loads.entry(tile).or_default() += 1;
                self.resident.insert(tile, (now, Arc::new(data)));
                Ok(true)
            }
            Err(StoreError::Budget(_)) => Ok(false),
            Err(error) => Err(error.into()),
        }
    }

    fn receive(&self) -> Result<Arrival<L::Item>> {
        self.arrivals.recv().map_err(|_| stopped())
    }

    /// Evicts least recently used tiles that nobody holds until the margin is free.
    pub fn keep_margin(&mut self) {
        while self.reader.budget().available() < self.margin {
            if !self.evict(&|_| true) {
                break;
            }
        }
    }

    /// Evicts the tile that was used longest ago among those that are idle and that nobody holds; dropping one that someone
    /// holds would free nothing.
    pub fn evict(&mut self, idle: &dyn Fn(u32) -> bool) -> bool {
        let Some((_, tile)) = self.next_to_go(idle) else { return false };
        self.resident.remove(&tile);
        true
    }

    fn next_to_go(&self, idle: &dyn Fn(u32) -> bool) -> Option<(u64, u32)> {
        let free = self
            .resident
            .iter()
            .filter(|&(&tile, (_, data))| Arc::strong_count(data) == 1 && idle(tile));
        free.map(|(&tile, &(used, _))| (used, tile)).min()
    }

    /// The tile, loaded now if it must be. Tiles that nobody holds make way until the budget has room.
    ///
    /// # Errors
    /// Exit 3 when it does not fit even alone, naming the tile's need; exit 4 when it is damaged.
    pub fn get(&mut self, tile: u32) -> Result<Arc<L::Item>> {
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
                _ => drop(self.arrived(arrival)?),
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

//! `enf-kdtree`: every room's photons become a photon map, halo included (the paper, sections 3 and 8).
#![forbid(unsafe_code)]

use std::collections::BTreeSet;
use std::path::PathBuf;

use clap::Args;
use enf_illumination::photon_map::{
    Cube, DIVIDE_BYTES, Halo, PieceRange, PortalSet, blob_bytes, build_map, divide,
};
use enf_layout::map::PIECE_PHOTONS;
use enf_layout::photon::{PHOTON_CAUSTIC, PHOTON_DIRECT, PHOTON_HALO, PhotonRecord};
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_stage::ordered::{Continue, ordered};
use enf_stage::session::{self, Announcer, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{
    CommonArgs, Failure, IdSink, IdSource, Progress, Result, Selection, interrupt, say,
};
use enf_store::{Array, Buffer, MemoryBudget, StageReader, StageWriter, StoreDir};
use serde_json::Value;

/// What decides about the maps.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Photon map options")]
pub struct KdtreeArgs {
    /// Largest radius that irradiance will be gathered from, and width of the halo, m
    #[arg(long, value_name = "METRES", default_value_t = 0.6, value_parser = parse_radius)]
    pub gather_radius: f32,
    /// Leave the neighbours' photons out, as the paper did: to see the seams that doorways have then
    #[arg(long)]
    pub no_halo: bool,
    /// Photons of a map's piece at most. For tests: another number makes other bytes, and the same light
    #[arg(long, value_name = "N", default_value_t = PIECE_PHOTONS as u32, hide = true,
        value_parser = clap::value_parser!(u32).range(1..=PIECE_PHOTONS as i64))]
    pub piece_photons: u32,
}

impl KdtreeArgs {
    fn most(&self) -> usize {
        self.piece_photons as usize
    }
}

fn parse_radius(text: &str) -> std::result::Result<f32, String> {
    match text.parse::<f32>() {
        Ok(r) if r.is_finite() && r > 0.0 => Ok(r),
        _ => Err("a positive number of metres".into()),
    }
}

/// `enf-kdtree`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(name = "enf-kdtree", version, about = "Build the photon map of every room")]
pub struct Cli {
    /// The store
    #[arg(value_name = "NAME.enf")]
    pub store: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub kdtree: KdtreeArgs,
    /// Do not read ids from standard input: all rooms
    #[arg(long)]
    pub all_rooms: bool,
    /// Discard another run's maps, and what was made with them
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}

/// Runs the stage for the rooms that are asked for. When the last room is done the stage is sealed.
///
/// # Errors
/// As in the table of exit codes; rooms that were announced stay done.
pub fn run(cli: &Cli, ids: IdSource, out: &IdSink) -> Result<Option<Value>> {
    let common = &cli.common;
    let selection = ids.into_selection()?;
    if selection == Selection::Ids(Vec::new()) {
        return Ok(None);
    }
    let store = StoreDir::open(&cli.store)?;
    let mut session = Session::open(common)?;
    let tables = Tables::open(&store, &session.budget)?;
    let photons = StageReader::open(&store, StageKind::Trace)?.with_budget(&session.budget)?;
    let rooms = session::rooms_of(&selection, tables.rooms().len())?;

    let mut identity = session::inherit(&store, StageKind::Trace)?;
    identity.push("gather-radius", cli.kdtree.gather_radius);
    if cli.kdtree.no_halo {
        identity.push("halo", "none");
    }
    if cli.kdtree.most() != PIECE_PHOTONS {
        identity.push("piece-photons", cli.kdtree.piece_photons);
    }
    match session::begin(&store, StageKind::Kdtree, common.process, &identity, cli.force)? {
        Begin::Finished => {
            say(common, "nothing to do, every map is there already");
            for &room in &rooms {
                out.print(room)?;
            }
        }
        Begin::Work(writer) => build(cli, &mut session, &tables, &photons, *writer, &rooms, out)?,
    }
    session.stats.set("rooms", tables.rooms_without_outside());
    Ok(Some(session.finish(common, "kdtree", &store)?))
}

/// Photons that a room's extents hold.
fn stored(photons: &StageReader, room: u32) -> u64 {
    photons.find(ExtentKind::Photons, room).iter().map(|e| e.count).sum()
}

fn build(
    cli: &Cli,
    session: &mut Session,
    tables: &Tables,
    photons: &StageReader,
    mut writer: StageWriter,
    rooms: &[u32],
    out: &IdSink,
) -> Result<()> {
    let (common, budget) = (&cli.common, session.budget.clone());
    let made: BTreeSet<u32> =
        writer.extents().filter(|e| e.kind == ExtentKind::Map).map(|e| e.id).collect();
    let todo: Vec<u32> = rooms.iter().copied().filter(|r| !made.contains(r)).collect();
    // The gathered list, and the blob that is built from it.
    let most = cli.kdtree.most();
    let needs = |room: u32| stored(photons, room).min(most as u64) * 50 + (1 << 20);
    let largest = todo.iter().copied().map(needs).max().unwrap_or(0);
    // Two rooms at once where both fit with room for their halos, else all threads on one tree.
    let at_once = if largest * 5 / 2 < budget.available() / common.threads as u64 {
        common.threads
    } else {
        1
    };
    let threads_each = common.threads / at_once;

    let radius = cli.kdtree.gather_radius;
    let total: u64 = todo.iter().map(|&r| stored(photons, r)).sum();
    let progress = Progress::new(common, "photon maps", Some(total), "photons");
    let names: Vec<_> = (0..at_once).map(|t| format!("kdtree {t}")).collect();
    let timeline = &session.timeline;
    let halo = !cli.kdtree.no_halo;
    let source = Source { tables, photons, budget: &budget, radius, halo, most };
    let mut announcer = Announcer::new(rooms, out);
    let (mut sum, mut halo_sum, mut done) = (0, 0, 0);
    let mut finished = made;
    let mut large = Vec::new();
    ordered(
        at_once,
        todo.len(),
        |worker, i| {
            let lane = timeline.lane(&names[worker]);
            let _span = lane.span("build map", todo[i]);
            source.map_of(todo[i], threads_each)
        },
        |i, map| {
            if let Some(map) = map {
                writer.append(ExtentKind::Map, todo[i], map.photons, &map.blob, Codec::Raw)?;
                note_caustics(&mut writer, todo[i], map.caustics);
                sum += map.photons;
                halo_sum += map.halo;
                done += stored(photons, todo[i]);
                finished.insert(todo[i]);
            } else {
                large.push(todo[i]);
            }
            progress.set(done);
            announcer.step(&mut writer, &|room| finished.contains(&room))
        },
    )?;
    for room in large {
        let lane = timeline.lane(&names[0]);
        let _span = lane.span("build map", room);
        let mut caustics = 0;
        source.pieces_of(room, common.threads, &mut |map| {
            caustics += map.caustics;
            writer.append(ExtentKind::Map, room, map.photons, &map.blob, Codec::Raw)?;
            sum += map.photons;
            halo_sum += map.halo;
            Ok(())
        })?;
        note_caustics(&mut writer, room, caustics);
        done += stored(photons, room);
        progress.set(done);
        finished.insert(room);
        if announcer.step(&mut writer, &|room| finished.contains(&room))? == Continue::No {
            break;
        }
    }
    announcer.end(&mut writer, &|room| finished.contains(&room))?;
    progress.finish();
    session.stats.set("map_photons", sum);
    session.stats.set("map_halo_photons", halo_sum);
    if finished.len() == tables.rooms().len() {
        writer.seal()?;
        say(common, format!("{sum} indirect photons in the maps, {halo_sum} of them halo"));
    }
    Ok(())
}

/// Says how many caustic photons a room's map has, for who makes a map of them; nothing where it has none.
fn note_caustics(writer: &mut StageWriter, room: u32, caustics: u64) {
    if caustics > 0 {
        writer.cursor(ExtentKind::Map, room, caustics);
    }
}

struct Map {
    blob: Buffer,
    photons: u64,
    halo: u64,
    caustics: u64,
}

/// Where photons come from.
struct Source<'a> {
    tables: &'a Tables,
    photons: &'a StageReader,
    budget: &'a MemoryBudget,
    /// Width of the halo, m.
    radius: f32,
    /// Whether there is one.
    halo: bool,
    /// Photons of a piece.
    most: usize,
}

impl Source<'_> {
    /// Every photon of a room's map: its own indirect ones, and its neighbours' within reach of a shared portal.
    fn each(&self, room: u32, each: &mut dyn FnMut(&PhotonRecord) -> Result<()>) -> Result<()> {
        collect(self.photons, self.budget, room, each)?;
        let portals = if self.halo { self.tables.portals_of(room) } else { &[] };
        for group in portals.chunk_by(|a, b| a.other == b.other) {
            let halo = Halo::new(&PortalSet::new(group, self.tables.pieces()), self.radius);
            collect(self.photons, self.budget, group[0].other, &mut |photon| {
                if halo.wants(photon) {
                    let mut photon = *photon;
                    photon.flags |= PHOTON_HALO;
                    each(&photon)?;
                }
                Ok(())
            })?;
        }
        Ok(())
    }

    fn too_small(&self, room: u32, photons: u64) -> Failure {
        let budget = self.budget;
        Failure::budget(format!(
            "room {room} needs {} MiB for the map of {photons} photons, {} of {} MiB are free",
            (photons * 50).div_ceil(1 << 20),
            budget.available() >> 20,
            budget.limit() >> 20
        ))
        .with_hint(format!(
            "--memory {}M would do",
            ((photons * 66 + budget.reserved()) >> 20) + 16
        ))
    }

    /// The map of a room whose photons fit into one piece; nothing if there are more.
    fn map_of(&self, room: u32, threads: usize) -> Result<Option<Map>> {
        let own = stored(self.photons, room).min(self.most as u64);
        let too_small = |_| self.too_small(room, own);
        let mut list: Array<PhotonRecord> =
            Array::with_capacity(self.budget, own as usize, "photons of a room")
                .map_err(too_small)?;
        let mut count = 0usize;
        self.each(room, &mut |photon| {
            count += 1;
            if count <= self.most {
                add(&mut list, *photon, self.most).map_err(too_small)
            } else {
                Ok(())
            }
        })?;
        if count > self.most {
            return Ok(None);
        }
        self.piece(room, &list, [0, 1], threads).map(Some)
    }

    fn piece(
        &self,
        room: u32,
        list: &[PhotonRecord],
        number: [u32; 2],
        threads: usize,
    ) -> Result<Map> {
        let bytes = blob_bytes(list.len());
        let mut blob = Buffer::zeroed(self.budget, bytes, "map of a room")
            .map_err(|_| self.too_small(room, list.len() as u64))?;
        build_map(list, &mut blob, self.radius, number, threads);
        let with = |flag| list.iter().filter(|p| p.flags & flag != 0).count() as u64;
        let (halo, caustics) = (with(PHOTON_HALO), with(PHOTON_CAUSTIC));
        Ok(Map { blob, photons: list.len() as u64, halo, caustics })
    }

    /// The map of a room with more photons than a piece may have, piece by piece: photons are looked at until it is known
    /// where to cut, then the pieces are filled, as many at once as fit.
    fn pieces_of(
        &self,
        room: u32,
        threads: usize,
        each: &mut dyn FnMut(Map) -> Result<()>,
    ) -> Result<()> {
        let mut cube = Cube::default();
        self.each(room, &mut |photon| {
            cube.add(photon);
            Ok(())
        })?;
        let ranges = {
            let _counts = self
                .budget
                .reserve(DIVIDE_BYTES, "cuts between photons")
                .map_err(|_| self.too_small(room, stored(self.photons, room)))?;
            divide(self.most as u64, |see| {
                self.each(room, &mut |photon| {
                    see(cube.number(photon));
                    Ok(())
                })
            })?
        };
        let record = size_of::<PhotonRecord>() as u64;
        let neighbours = self.tables.portals_of(room).iter().map(|p| p.other);
        let block = neighbours
            .chain([room])
            .flat_map(|room| self.photons.find(ExtentKind::Photons, room))
            .map(|extent| extent.read_peak_bytes())
            .max()
            .unwrap_or(0);
        let mut first = 0;
        while first < ranges.len() {
            interrupt::check()?;
            // The lists, and then one blob beside them; while they are filled, a block of photons.
            let free = self.budget.available().saturating_sub(block.max(1 << 20));
            let (mut end, mut bytes, mut largest) = (first, 0, 0);
            while let Some(PieceRange { photons, .. }) = ranges.get(end) {
                largest = largest.max(blob_bytes(*photons as usize) as u64);
                bytes += photons * record;
                if end > first && bytes + largest > free {
                    break;
                }
                end += 1;
            }
            let mut lists = Vec::with_capacity(end - first);
            for range in &ranges[first..end] {
                let list: Array<PhotonRecord> =
                    Array::with_capacity(self.budget, range.photons as usize, "photons of a room")
                        .map_err(|_| self.too_small(room, range.photons))?;
                lists.push(list);
            }
            let now = &ranges[first..end];
            self.each(room, &mut |photon| {
                let number = cube.number(photon);
                let at = now.partition_point(|range| *range.numbers.end() < number);
                if now.get(at).is_some_and(|range| range.numbers.contains(&number)) {
                    lists[at]
                        .push(*photon)
                        .map_err(|_| Failure::internal("photons changed while they were read"))?;
                }
                Ok(())
            })?;
            for (i, list) in lists.into_iter().enumerate() {
                let number = [(first + i) as u32, ranges.len() as u32];
                each(self.piece(room, &list, number, threads)?)?;
            }
            first = end;
        }
        Ok(())
    }
}

/// Appends, growing by a quarter when the halo is more than was thought.
fn add(
    list: &mut Array<PhotonRecord>,
    photon: PhotonRecord,
    most: usize,
) -> std::result::Result<(), enf_store::BudgetError> {
    if let Err(photon) = list.push(photon) {
        let more = list.capacity() + list.capacity() / 4 + 1024;
        list.resize_capacity(more.min(most.max(list.capacity() + 1)))?;
        // There is room now.
        let _ = list.push(photon);
    }
    Ok(())
}

/// Every indirect photon of a room. Direct light is computed with shadow rays; its photons stay in the log.
fn collect(
    photons: &StageReader,
    budget: &MemoryBudget,
    room: u32,
    each: &mut dyn FnMut(&PhotonRecord) -> Result<()>,
) -> Result<()> {
    for extent in photons.find(ExtentKind::Photons, room) {
        let block = photons.read(extent, budget, "block of photons")?;
        let records = block.as_slice_of::<PhotonRecord>().map_err(enf_store::StoreError::from)?;
        for photon in records.iter().filter(|p| p.flags & PHOTON_DIRECT == 0) {
            each(photon)?;
        }
    }
    Ok(())
}

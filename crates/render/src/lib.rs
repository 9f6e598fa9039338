//! `enf-render`: pictures from the store (the paper, section 6).
//!
//! Rays travel like photons: parked at portals, tile by tile. Several views are taken in one pass, in bands of
//! pixels; a finished band is committed, so that a run that was killed goes on with the next.
#![forbid(unsafe_code)]

mod camera;
mod daylight;
mod film;
mod shade;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use clap::{Args, ValueEnum};
use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use enf_illumination::{Gather, IrradianceCache, Kernel, PhotonMap};
use enf_image::Film;
use enf_layout::film::PixelRecord;
use enf_layout::journal::LightPairRecord;
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_layout::transit::TransitRecord;
use enf_stage::resident::{STRUCTURES, TileCache, TileData, TileReader};
use enf_stage::session::{self, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{
    CommonArgs, Failure, IdSink, IdSource, IoContext, Progress, Result, RowTable, Scheduler,
    Selection, interrupt, parse_count, say,
};
use enf_store::{
    Buffer, Extent, Identity, MemoryBudget, Reservation, StageReader, StageState, StageWriter,
    StoreDir, StoreError,
};
use enf_trace::{QueueArgs, queue_shape};
use serde_json::Value;
use zerocopy::IntoBytes;

pub use camera::{Camera, View};
use shade::{Context, Job, Products, RoomLight, RoomMap, Scratch, Waiting, Work};

/// Pixels that are finished together. Part of the format of an unfinished render, hence no flag.
const BAND_PIXELS: u32 = 1 << 15;
/// Rays of one job.
const JOB_RAYS: u64 = 2048;
/// Rays of one visit.
const VISIT_RAYS: u64 = 1 << 20;

/// Where indirect light comes from.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum Indirect {
    /// The photon maps, directly.
    #[default]
    PhotonMap,
    /// Nowhere: direct light alone.
    None,
}

/// How a photon's weight falls with its distance ([`Kernel`]).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum)]
pub enum KernelArg {
    /// Not at all, as in the paper: least noise.
    #[default]
    Constant,
    /// In a straight line: sharpest.
    Cone,
    /// As a parabola.
    Epanechnikov,
}

impl KernelArg {
    fn kernel(self) -> (Kernel, &'static str) {
        match self {
            Self::Constant => (Kernel::Constant, "constant"),
            Self::Cone => (Kernel::Cone, "cone"),
            Self::Epanechnikov => (Kernel::Epanechnikov, "epanechnikov"),
        }
    }
}

/// What decides about the pictures.
#[derive(Args, Clone, Debug)]
#[command(next_help_heading = "Picture options")]
pub struct RenderArgs {
    /// A view by name, room:ID (stand there), auto (three viewpoints are found) or all (the scene's own); repeatable
    #[arg(long, value_name = "VIEW")]
    pub view: Vec<String>,
    /// More views: a file with [[view]] tables; without --view, all of them
    #[arg(long, value_name = "FILE")]
    pub views: Option<PathBuf>,
    /// Picture width, pixels [default: the view's, else 960]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub width: Option<u32>,
    /// Picture height, pixels [default: the view's, else 600]
    #[arg(long, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub height: Option<u32>,
    /// Camera rays per pixel
    #[arg(long, value_name = "N", default_value_t = 8, value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub samples: u32,
    /// Shadow rays per shading point
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub light_samples: u32,
    /// Photons that irradiance is estimated from (k of the k nearest)
    #[arg(long, value_name = "N", default_value = "120", value_parser = parse_count)]
    pub gather_photons: u64,
    /// How their weights fall with distance
    #[arg(long, value_enum, default_value_t)]
    pub kernel: KernelArg,
    /// Where indirect light comes from
    #[arg(long, value_enum, default_value_t)]
    pub indirect: Indirect,
    /// Exposure of PNG pictures: what linear radiance is multiplied with [default: found per picture]
    #[arg(long, value_name = "FACTOR")]
    pub exposure: Option<f32>,
}

/// `enf-render`: the command line.
#[derive(clap::Parser, Clone, Debug)]
#[command(name = "enf-render", version, about = "Render pictures from a store, room by room")]
pub struct Cli {
    /// The store
    #[arg(value_name = "NAME.enf")]
    pub store: PathBuf,
    /// The picture (.exr, .png or .hdr), or a folder for VIEW.png and VIEW.exr of each view [default: .]
    #[arg(short, long, value_name = "FILE|DIR", default_value = ".")]
    pub output: PathBuf,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub render: RenderArgs,
    /// Flags of the queue.
    #[command(flatten)]
    pub queue: QueueArgs,
    /// Do not read ids from standard input: start at once
    #[arg(long)]
    pub all_rooms: bool,
    /// Overwrite another run's pictures
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    #[allow(missing_docs)]
    pub common: CommonArgs,
}

/// Runs the stage; prints the paths of the pictures on standard output.
///
/// # Errors
/// As in the table of exit codes; finished bands are kept, and the same command goes on.
pub fn run(cli: &Cli, ids: IdSource, out: &IdSink) -> Result<Option<Value>> {
    let (common, args) = (&cli.common, &cli.render);
    let selection = ids.into_selection()?;
    if selection == Selection::Ids(Vec::new()) {
        return Ok(None);
    }
    let store = StoreDir::open(&cli.store)?;
    let mut session = Session::open(common)?;
    let budget = session.budget.clone();
    let tables = Tables::open(&store, &budget)?;
    session::rooms_of(&selection, tables.rooms().len())?;
    let grid = session::complete(&store, StageKind::Grid, &tables, &STRUCTURES, |room| {
        session::tiles_of(&tables, room)
    })?;
    let trace = StageReader::open(&store, StageKind::Trace)?;
    let maps = session::complete(&store, StageKind::Kdtree, &tables, &[ExtentKind::Map], |room| {
        room..room + 1
    })?;
    let reader = TileReader {
        partition: &tables.partition,
        grid: &grid,
        budget: &budget,
        delta: tables.scene.delta,
    };
    let views = camera::views(args, &tables, &reader, &maps)?;
    let pictures = outputs(&cli.output, &views)?;

    if session::may_work(&store, StageKind::Render, cli.force) {
        refuse_if_hopeless(cli, &tables, &reader, &maps, &budget, &views)?;
    }
    let identity = identity(&store, cli, &views)?;
    yield_to_another_picture(&store, &identity, &pictures, cli.force)?;
    let mut shown = Shown::default();
    match session::begin(&store, StageKind::Render, common.process, &identity, cli.force)? {
        Begin::Finished => say(common, "nothing to do, the film is developed already"),
        Begin::Work(writer) => {
            let readers = Readers { tables: &tables, grid: &grid, trace: &trace, maps: &maps };
            shown = render(cli, &mut session, &readers, &views, *writer)?;
        }
    }
    film::develop(&store, &budget, &views, &pictures, args.exposure)?;
    let stats = &mut session.stats;
    stats.set("rays_camera", shown.camera);
    stats.set("rays_shadow", shown.shadow);
    stats.set("rays_gather", shown.gathers);
    let visible: Vec<u64> = (0..tables.rooms().len() as u32)
        .map(|r| trace.find(ExtentKind::LightSet, r).iter().map(|e| e.count).sum())
        .collect();
    let rooms = visible.len().max(1) as f64;
    stats.set("lights_visible_mean", visible.iter().sum::<u64>() as f64 / rooms);
    stats.set("lights_visible_max", visible.iter().max().copied().unwrap_or(0));
    stats.set("table.evictions", shown.evictions);
    stats.set("table.spilled_blocks", shown.spilled_blocks);
    stats.set("io.spilled_records", shown.spilled_records);
    let pictures: Vec<&PathBuf> = pictures.iter().flatten().collect();
    let names: Vec<Value> = pictures.iter().map(|p| p.to_string_lossy().into()).collect();
    stats.set("pictures", names);
    let stats = session.finish(common, "render", &store)?;
    for picture in pictures {
        out.print(picture.display())?;
    }
    Ok(Some(stats))
}

/// Refuses a budget in which some room could not be shaded, before anything is begun.
fn refuse_if_hopeless(
    cli: &Cli,
    tables: &Tables,
    reader: &TileReader<'_>,
    maps: &StageReader,
    budget: &MemoryBudget,
    views: &[View],
) -> Result<()> {
    let common = &cli.common;
    let (rows, block) = queue_shape(&cli.queue, common.memory, size_of::<TransitRecord>());
    let together = Scratch::ray_bytes(cli.render.light_samples) * common.threads as u64;
    let rays =
        RowTable::<TransitRecord>::memory_bytes(rows, block) + bytes_in_flight(common) + together;
    let pixels: u32 = views.iter().map(|v| v.camera.pixels()).sum();
    let film = film_bytes(pixels.min(BAND_PIXELS));
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    for (id, room) in tables.rooms().iter().enumerate() {
        let mut mesh = 0;
        for tile in room.first_tile..room.first_tile + room.tile_count {
            mesh = mesh.max(reader.bytes(tile)?);
        }
        let map = match cli.render.indirect {
            Indirect::None => 0,
            Indirect::PhotonMap => maps
                .find(ExtentKind::Map, id as u32)
                .iter()
                .map(|e| e.raw_bytes + IrradianceCache::bytes(e.count as usize))
                .sum(),
        };
        let needs = rays + film + mesh + map;
        if needs > budget.available() {
            return Err(Failure::budget(format!(
                "room {id} needs {} MiB of {}: mesh and grid {}, photon map {}, film {}, rays {}, tables and program {}",
                mib(needs + budget.reserved()),
                common.memory >> 20,
                mib(mesh),
                mib(map),
                mib(film),
                mib(rays),
                mib(budget.reserved())
            ))
            .with_hint(format!(
                "--memory {}M would do, or cut it into smaller tiles: enf-partition --memory {}M",
                mib((needs + budget.reserved()) * 5 / 4),
                common.memory >> 20
            )));
        }
    }
    Ok(())
}

/// Products of the jobs under way.
fn bytes_in_flight(common: &CommonArgs) -> u64 {
    JOB_RAYS * 4 * size_of::<TransitRecord>() as u64 * (common.threads as u64 + 4)
}

/// A band of film and its developed pixels.
fn film_bytes(pixels: u32) -> u64 {
    (Film::bytes_per_pixel() + size_of::<PixelRecord>()) as u64 * u64::from(pixels)
}

/// The files of each view.
fn outputs(output: &Path, views: &[View]) -> Result<Vec<Vec<PathBuf>>> {
    let extension = output.extension().and_then(|e| e.to_str()).unwrap_or("");
    if ["exr", "png", "hdr"].contains(&extension) && !output.is_dir() {
        if views.len() > 1 {
            return Err(Failure::usage(format!(
                "{} is one picture, but there are {} views",
                output.display(),
                views.len()
            ))
            .with_hint("with several views -o is a folder"));
        }
        if let Some(parent) = output.parent().filter(|p| !p.as_os_str().is_empty()) {
            std::fs::create_dir_all(parent).at("create", parent)?;
        }
        return Ok(vec![vec![output.to_path_buf()]]);
    }
    std::fs::create_dir_all(output).at("create", output)?;
    Ok(views
        .iter()
        .map(|view| {
            let name: String = view
                .name
                .chars()
                .map(|c| if c.is_alphanumeric() || "-_. ".contains(c) { c } else { '-' })
                .collect();
            vec![output.join(format!("{name}.png")), output.join(format!("{name}.exr"))]
        })
        .collect())
}

fn identity(store: &StoreDir, cli: &Cli, views: &[View]) -> Result<Identity> {
    let args = &cli.render;
    let mut identity = session::inherit(store, StageKind::Kdtree)?;
    identity.push("seed", cli.common.seed);
    identity.push("samples", args.samples);
    identity.push("light-samples", args.light_samples);
    identity.push("gather-photons", args.gather_photons);
    identity.push("kernel", args.kernel.kernel().1);
    identity.push("indirect", if args.indirect == Indirect::None { "none" } else { "photon-map" });
    for view in views {
        identity.push(format!("view {}", view.name), format!("{:?}", view.camera));
    }
    Ok(identity)
}

/// The film of an earlier, finished run has done its duty once its pictures are written: it makes way for other
/// views, unless the same picture file would change under the user's hands.
fn yield_to_another_picture(
    store: &StoreDir,
    identity: &Identity,
    pictures: &[Vec<PathBuf>],
    force: bool,
) -> Result<()> {
    let found = store.stage_state(StageKind::Render).and_then(|state| {
        Ok(if state == StageState::Sealed { store.identity(StageKind::Render)? } else { None })
    });
    let found = match found {
        Ok(Some(found)) => found,
        Ok(None) => return Ok(()),
        // Film that cannot be read is made again.
        Err(StoreError::Corrupt { .. }) if force => {
            return Ok(store.discard_from(StageKind::Render)?);
        }
        Err(error) => return Err(error.into()),
    };
    let in_the_way = pictures.iter().flatten().any(|p| p.exists());
    if found != *identity && (force || !in_the_way) {
        store.discard_from(StageKind::Render)?;
    }
    Ok(())
}

struct Readers<'a> {
    tables: &'a Tables,
    grid: &'a StageReader,
    trace: &'a StageReader,
    maps: &'a StageReader,
}

/// Counts for the report.
#[derive(Default)]
struct Shown {
    camera: u64,
    shadow: u64,
    gathers: u64,
    evictions: u64,
    spilled_blocks: u64,
    spilled_records: u64,
}

fn render(
    cli: &Cli,
    session: &mut Session,
    readers: &Readers<'_>,
    views: &[View],
    writer: StageWriter,
) -> Result<Shown> {
    let (common, args) = (&cli.common, &cli.render);
    let budget = session.budget.clone();
    let tables = readers.tables;
    let (rows, block) = queue_shape(&cli.queue, common.memory, size_of::<TransitRecord>());
    let _queue = budget
        .reserve(RowTable::<TransitRecord>::memory_bytes(rows, block), "table of incoming rays")?;
    let together = Scratch::ray_bytes(args.light_samples) * common.threads as u64;
    let _jobs = budget.reserve(bytes_in_flight(common) + together, "rays in flight")?;

    let mut first_pixels = vec![0u32];
    for view in views {
        first_pixels.push(first_pixels[first_pixels.len() - 1] + view.camera.pixels());
    }
    let (daylight, _daylight) = enf_trace::daylight(tables, &budget)?;
    let power = daylight::power(tables.lights());
    let context = Context {
        tables,
        bsp: tables.bsp()?,
        views,
        first_pixels: &first_pixels,
        seed: common.seed,
        samples: args.samples,
        light_samples: args.light_samples,
        gather: Gather {
            photons: args.gather_photons.clamp(2, 1 << 20) as u32,
            radius: f32::INFINITY,
            kernel: args.kernel.kernel().0,
        },
        indirect: args.indirect != Indirect::None,
        power: &power,
        daylight: daylight.as_ref(),
    };
    let reader = TileReader {
        partition: &tables.partition,
        grid: readers.grid,
        budget: &budget,
        delta: tables.scene.delta,
    };

    let (jobs, take_job) = bounded::<Job>(common.threads * 2);
    let (done, finished) = unbounded::<Result<Products>>();
    let timeline = &session.timeline;
    let margin = (block * size_of::<TransitRecord>() * 2) as u64 + (1 << 20);
    let (cache, load) = TileCache::new(reader, cli.queue.resident_rooms.0, margin, timeline);
    let (shown, loads) = std::thread::scope(|scope| {
        let loader = scope.spawn(load);
        for thread in 0..common.threads {
            let (take_job, done) = (take_job.clone(), done.clone());
            let context = &context;
            scope.spawn(move || {
                let lane = timeline.lane(&format!("renderer {thread}"));
                let mut scratch = Scratch::new(context.gather.photons);
                for job in take_job {
                    let span = lane.span("render", job.tile.tile);
                    let ran = std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| {
                        context.run(&job, &mut scratch)
                    }));
                    drop(span);
                    drop(job);
                    let result = match ran {
                        Ok(products) => products.map_err(|e| StoreError::from(e).into()),
                        Err(_) => Err(Failure::internal("a rendering thread failed")),
                    };
                    if done.send(result).is_err() {
                        break;
                    }
                }
            });
        }
        drop((take_job, done));
        let mut driver = Driver {
            common,
            context: &context,
            readers,
            budget: budget.clone(),
            cache,
            lights: BTreeMap::new(),
            clock: 0,
            jobs,
            finished,
            writer,
            rows: RowTable::new(rows, block),
            waiting: BTreeMap::new(),
            scheduler: Scheduler::new(cli.queue.schedule, tables.tiles().len() as u32),
            shown: Shown::default(),
        };
        let driven = driver.drive();
        let Driver { jobs, cache, writer, shown, .. } = driver;
        drop(jobs);
        let loads = cache.loads().clone();
        drop(cache);
        let _ = loader.join();
        driven.and_then(|()| Ok(writer.seal()?)).map(|()| (shown, loads))
    })?;
    enf_trace::record_loads(session, tables, &loads);
    Ok(shown)
}

/// The main thread: chooses tiles, hands out jobs, owns the table of incoming rays.
struct Driver<'a> {
    common: &'a CommonArgs,
    context: &'a Context<'a>,
    readers: &'a Readers<'a>,
    budget: MemoryBudget,
    cache: TileCache,
    /// Maps and light sets of rooms, with when they were last used.
    lights: BTreeMap<u32, (u64, Arc<RoomLight>)>,
    clock: u64,
    jobs: Sender<Job>,
    finished: Receiver<Result<Products>>,
    writer: StageWriter,
    rows: RowTable<TransitRecord>,
    waiting: BTreeMap<u32, Vec<Extent>>,
    scheduler: Scheduler,
    shown: Shown,
}

/// One band at work.
struct Band {
    film: Arc<Film>,
    _reservation: Reservation,
    first_pixel: u32,
    pixels: u32,
    /// Samples that tiles with an eye in them have still to send off.
    unsent: BTreeMap<u32, u64>,
}

impl Driver<'_> {
    fn drive(&mut self) -> Result<()> {
        let total = *self.context.first_pixels.last().unwrap_or(&0);
        let bands = total.div_ceil(BAND_PIXELS);
        let done: Vec<u32> =
            self.writer.extents().filter(|e| e.kind == ExtentKind::Film).map(|e| e.id).collect();
        let rays = u64::from(total) * u64::from(self.context.samples);
        let progress = Progress::new(self.common, "render", Some(rays), "rays");
        for band in (0..bands).filter(|b| !done.contains(b)) {
            let first_pixel = band * BAND_PIXELS;
            let pixels = BAND_PIXELS.min(total - first_pixel);
            let reservation = loop {
                match self.budget.reserve(film_bytes(pixels), "film") {
                    Err(_) if self.make_way()? => {}
                    other => break other?,
                }
            };
            let mut band_at_work = Band {
                film: Arc::new(Film::new(pixels as usize)),
                _reservation: reservation,
                first_pixel,
                pixels,
                unsent: BTreeMap::new(),
            };
            self.band(&mut band_at_work, &progress)?;
            let mut records = vec![PixelRecord::default(); pixels as usize];
            band_at_work.film.resolve(self.context.samples, &mut records);
            self.writer.append(
                ExtentKind::Film,
                band,
                u64::from(pixels),
                records.as_bytes(),
                Codec::Raw,
            )?;
            self.writer.commit()?;
        }
        self.shown.evictions = self.rows.evictions();
        progress.finish();
        Ok(())
    }

    fn band(&mut self, band: &mut Band, progress: &Progress) -> Result<()> {
        let samples = u64::from(self.context.samples);
        let all = u64::from(band.pixels) * samples;
        // An eye in a plane sends rays to both of its sides: the tiles about each eye look at all samples.
        for (i, view) in self.context.views.iter().enumerate() {
            let (first, end) = (self.context.first_pixels[i], self.context.first_pixels[i + 1]);
            if end <= band.first_pixel || first >= band.first_pixel + band.pixels {
                continue;
            }
            for corner in 0..8u32 {
                let sign = |bit: u32| if corner & bit == 0 { 1.0 } else { -1.0 };
                let towards = glam::DVec3::new(sign(1), sign(2), sign(4));
                let leaf = self.context.bsp.locate_towards(view.camera.eye.as_dvec3(), towards);
                band.unsent.insert(self.context.bsp.leaves[leaf as usize].tile, 0);
            }
        }
        for &tile in band.unsent.keys() {
            self.scheduler.add(tile, all);
        }
        let mut sent = 0;
        loop {
            let cache = &self.cache;
            let Some(tile) = self.scheduler.next(&|t| cache.is_resident(t)) else { break };
            interrupt::check()?;
            self.scheduler.take(tile);
            let data = self.tile(tile)?;
            let light = self.room_light(self.context.tables.tiles()[tile as usize].room)?;
            let cache = &self.cache;
            if let Some(next) = self.scheduler.next(&|t| cache.is_resident(t)) {
                self.cache.prefetch(next)?;
            }
            let left = self.visit(tile, &data, &light, band, all)?;
            if left > 0 {
                self.scheduler.add(tile, left);
            }
            sent = sent.max(band.unsent.values().copied().min().unwrap_or(all));
            progress.set(u64::from(band.first_pixel) * samples + sent);
            progress.message(&format!("room {}", self.context.tables.tiles()[tile as usize].room));
        }
        Ok(())
    }

    /// The tile; maps of rooms that are not in use make way if the budget has no room.
    fn tile(&mut self, tile: u32) -> Result<Arc<TileData>> {
        loop {
            match self.cache.get(tile) {
                Err(error) if error.code == enf_stage::ExitStatus::Budget && self.evict_light() => {
                }
                other => return other,
            }
        }
    }

    fn evict_light(&mut self) -> bool {
        let oldest = self
            .lights
            .iter()
            .filter(|(_, (_, light))| Arc::strong_count(light) == 1)
            .min_by_key(|(_, (used, _))| *used)
            .map(|(&room, _)| room);
        oldest.is_some_and(|room| self.lights.remove(&room).is_some())
    }

    fn room_light(&mut self, room: u32) -> Result<Arc<RoomLight>> {
        self.clock += 1;
        if let Some((used, light)) = self.lights.get_mut(&room) {
            *used = self.clock;
            return Ok(Arc::clone(light));
        }
        let mut lights = Vec::new();
        for extent in self.readers.trace.find(ExtentKind::LightSet, room) {
            let set = self.readers.trace.read(extent, &self.budget, "light set")?;
            let set = set.as_slice_of::<LightPairRecord>().map_err(StoreError::from)?;
            // Of all that the light emits: lights may emit different numbers.
            let part = |p: &LightPairRecord| p.photons as f32 / p.emitted.max(1) as f32;
            let most = set.iter().map(part).fold(f32::MIN_POSITIVE, f32::max);
            // A light of which much arrives has its full importance; one that shines in through a door counts
            // less, for it is hidden from most of the room, but never less than a tenth.
            lights.extend(set.iter().map(|p| {
                let share = (10.0 * part(p) / most).min(1.0);
                (p.light, 0.1 + 0.9 * share)
            }));
        }
        if lights.iter().any(|l| l.0 as usize >= self.context.tables.lights().len()) {
            return Err(Failure::input(format!("the light set of room {room} is damaged")));
        }
        let sun = daylight::adapt(&mut lights, self.context.tables, room);
        let map = if self.context.indirect {
            let extents = self.readers.maps.find(ExtentKind::Map, room);
            let photons = extents.iter().map(|e| e.count as usize).sum();
            loop {
                let attempt = || -> std::result::Result<RoomMap, StoreError> {
                    let bytes = IrradianceCache::bytes(photons);
                    let reservation = self.budget.reserve(bytes, "irradiance at photons")?;
                    let map: Vec<_> = extents
                        .iter()
                        .map(|e| self.readers.maps.map(e, &self.budget, "photon map"))
                        .collect::<std::result::Result<_, _>>()?;
                    let pieces = map.iter().map(|m| &m[..]);
                    let cache = IrradianceCache::new(&PhotonMap::from_pieces(pieces)?);
                    Ok(RoomMap { map, cache, _reservation: reservation })
                };
                match attempt() {
                    Ok(map) => break Some(map),
                    Err(StoreError::Budget(_)) if self.make_way()? => {}
                    Err(error) => return Err(error.into()),
                }
            }
        } else {
            None
        };
        let light = Arc::new(RoomLight { map, lights, sun });
        self.lights.insert(room, (self.clock, Arc::clone(&light)));
        Ok(light)
    }

    /// Frees a map or a tile that is not in use; false when there is none.
    fn make_way(&mut self) -> Result<bool> {
        Ok(self.evict_light() || self.cache.make_way()?)
    }

    /// Rays from the log. Maps and tiles that nobody needs make way for them, and then the jobs that are under way.
    fn read_back(&mut self, extent: &Extent, flying: &mut u64) -> Result<Buffer> {
        loop {
            match self.writer.read(extent, &self.budget, "incoming rays") {
                Err(StoreError::Budget(_)) if self.make_way()? => {}
                Err(StoreError::Budget(_)) if *flying > 0 => self.receive(flying)?,
                other => return Ok(other?),
            }
        }
    }

    fn visit(
        &mut self,
        tile: u32,
        data: &Arc<TileData>,
        light: &Arc<RoomLight>,
        band: &mut Band,
        all: u64,
    ) -> Result<u64> {
        let memory: Vec<TransitRecord> = self.rows.take(tile).collect();
        let mut flying = 0;
        let mut handed = memory.len() as u64;
        let job = |work| Job {
            tile: Arc::clone(data),
            light: Arc::clone(light),
            film: Arc::clone(&band.film),
            first_pixel: band.first_pixel,
            work,
        };
        let mut outcome = Ok(());
        let mut batches = Vec::new();
        if !memory.is_empty() {
            batches.push(Arc::new(Waiting::Memory(memory)));
        }
        let mut extents = self.waiting.remove(&tile).unwrap_or_default().into_iter();
        while outcome.is_ok() {
            let batch = match batches.pop() {
                Some(batch) => batch,
                None if handed < VISIT_RAYS => {
                    let Some(extent) = extents.next() else { break };
                    handed += extent.count;
                    self.writer.consume(&extent);
                    match self.read_back(&extent, &mut flying) {
                        Ok(buffer) => Arc::new(Waiting::Log(buffer)),
                        Err(error) => {
                            outcome = Err(error);
                            break;
                        }
                    }
                }
                None => break,
            };
            let count = batch.records().len();
            for first in (0..count).step_by(JOB_RAYS as usize) {
                let range = first..(first + JOB_RAYS as usize).min(count);
                let work = Work::Waiting { records: Arc::clone(&batch), range };
                outcome = outcome.and(self.send(job(work), &mut flying));
            }
        }
        let mut left: u64 = 0;
        let rest: Vec<Extent> = extents.collect();
        if !rest.is_empty() {
            left += rest.iter().map(|e| e.count).sum::<u64>();
            self.waiting.entry(tile).or_default().extend(rest);
        }
        let mut cursor = band.unsent.get(&tile).copied().unwrap_or(all);
        while outcome.is_ok() && cursor < all && handed < VISIT_RAYS {
            let end = (cursor + JOB_RAYS).min(all);
            let work = Work::Camera { indices: cursor..end };
            outcome = self.send(job(work), &mut flying);
            handed += end - cursor;
            cursor = end;
        }
        if let Some(unsent) = band.unsent.get_mut(&tile) {
            *unsent = cursor;
            left += all - cursor;
        }
        while flying > 0 {
            outcome = outcome.and(self.receive(&mut flying));
        }
        outcome.map(|()| left)
    }

    /// Sends a job, and takes in what has come back meanwhile.
    fn send(&mut self, job: Job, flying: &mut u64) -> Result<()> {
        while *flying > self.common.threads as u64 * 2 {
            self.receive(flying)?;
        }
        self.jobs.send(job).map_err(|_| Failure::internal("the rendering threads have stopped"))?;
        *flying += 1;
        Ok(())
    }

    fn receive(&mut self, flying: &mut u64) -> Result<()> {
        let products = self
            .finished
            .recv()
            .unwrap_or_else(|_| Err(Failure::internal("the rendering threads have stopped")));
        *flying -= 1;
        let products = products?;
        self.shown.camera += products.camera;
        self.shown.shadow += products.shadow;
        self.shown.gathers += products.gathers;
        let Self { rows, writer, waiting, shown, .. } = self;
        for (tile, block) in &products.parked {
            self.scheduler.add(*tile, block.len() as u64);
            rows.push(*tile, block, &mut |tile, records: &[TransitRecord]| {
                shown.spilled_blocks += 1;
                shown.spilled_records += records.len() as u64;
                let count = records.len() as u64;
                let extent = writer.append(
                    ExtentKind::Transit,
                    tile,
                    count,
                    records.as_bytes(),
                    Codec::Raw,
                )?;
                waiting.entry(tile).or_default().push(extent);
                Ok::<(), StoreError>(())
            })?;
        }
        Ok(())
    }
}

//! `enf-render`: pictures from the store (the paper, section 6).
//!
//! Rays travel like photons: parked at portals, tile by tile. Several views are taken in one pass, in bands of
//! pixels; a finished band is committed, so that a run that was killed goes on with the next.
#![forbid(unsafe_code)]

mod adaptive;
mod args;
mod camera;
mod caustics;
mod daylight;
mod film;
mod gather;
mod shade;
mod smooth;

use std::collections::BTreeMap;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use crossbeam::channel::{Receiver, Sender, bounded, unbounded};
use enf_illumination::{Gather, IrradianceCache, PhotonMap};
use enf_image::{Film, Gathered};
use enf_layout::film::PixelRecord;
use enf_layout::journal::LightPairRecord;
use enf_layout::segment::{Codec, ExtentKind, StageKind};
use enf_layout::transit::TransitRecord;
use enf_stage::resident::{STRUCTURES, TileCache, TileData, TileReader};
use enf_stage::session::{self, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{
    CommonArgs, Failure, IdSink, IdSource, IoContext, Progress, Result, RowTable, Scheduler,
    Selection, interrupt, say,
};
use enf_store::{
    Buffer, Extent, Identity, MemoryBudget, Reservation, StageReader, StageState, StageWriter,
    StoreDir, StoreError,
};
use enf_trace::queue_shape;
use serde_json::Value;
use zerocopy::IntoBytes;

use caustics::Caustics;

pub use args::{Cli, Exposure, Format, Indirect, ProjectionArg, RenderArgs, ToneArg};
pub use camera::{Camera, View};
use shade::{Context, Job, Pass, Products, RoomLight, RoomMap, Scratch, Waiting, Work};

/// Pixels that are finished together. Part of the format of an unfinished render, hence no flag.
const BAND_PIXELS: u32 = 1 << 15;
/// Rays of one visit.
const VISIT_RAYS: u64 = 1 << 20;

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
    let pictures = outputs(&cli.output, &args.formats, &views)?;

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
    film::develop(&store, &budget, &views, &pictures, args)?;
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
    let pictures: Vec<&PathBuf> = pictures.iter().flatten().map(|p| &p.path).collect();
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
    let together = Scratch::ray_bytes(cli.render.asking()) * common.threads as u64;
    let rays = RowTable::<TransitRecord>::memory_bytes(rows, block)
        + bytes_in_flight(common, &cli.render)
        + together;
    let pixels: u32 = views.iter().map(|v| v.camera.pixels()).sum();
    let widest = views.iter().map(|v| v.camera.width).max().unwrap_or(0);
    let film = film_bytes(pixels.min(BAND_PIXELS))
        + if cli.render.smooths() { smooth::bytes(pixels.min(BAND_PIXELS), widest) } else { 0 };
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    for (id, room) in tables.rooms().iter().enumerate() {
        let mut mesh = 0;
        for tile in room.first_tile..room.first_tile + room.tile_count {
            mesh = mesh.max(reader.bytes(tile)?);
        }
        let map = match cli.render.indirect {
            Indirect::None => 0,
            Indirect::PhotonMap | Indirect::FinalGather => maps
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
fn bytes_in_flight(common: &CommonArgs, args: &RenderArgs) -> u64 {
    let products = args.job_rays() * u64::from(args.asking() + 1);
    products * size_of::<TransitRecord>() as u64 * (common.threads as u64 + 4)
}

/// A band of film and its developed pixels.
fn film_bytes(pixels: u32) -> u64 {
    let each = Film::bytes_per_pixel() + size_of::<PixelRecord>() + adaptive::BYTES_PER_PIXEL;
    each as u64 * u64::from(pixels)
}

/// A picture's file.
#[derive(Clone, Debug)]
struct Output {
    path: PathBuf,
    format: Format,
}

/// The files of each view.
fn outputs(output: &Path, formats: &[Format], views: &[View]) -> Result<Vec<Vec<Output>>> {
    let name = output.file_name().and_then(|n| n.to_str()).unwrap_or("");
    if let Some(format) = Format::of(name)
        && !output.is_dir()
    {
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
        return Ok(vec![vec![Output { path: output.to_path_buf(), format }]]);
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
            let mut files: Vec<Output> = Vec::new();
            for &format in formats {
                if !files.iter().any(|f| f.format == format) {
                    files.push(Output { path: output.join(format.file(&name)), format });
                }
            }
            files
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
    let indirect = match args.indirect {
        Indirect::PhotonMap => "photon-map",
        Indirect::FinalGather => "final-gather",
        Indirect::None => "none",
    };
    identity.push("indirect", indirect);
    if args.indirect == Indirect::FinalGather {
        identity.push("gather-rays", args.gather_rays);
        identity.push("gather-smoothing", args.gather_smoothing);
    }
    if args.more_samples() > 0 {
        identity.push("max-samples", args.samples + args.more_samples());
        identity.push("noise", args.noise);
    }
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
    pictures: &[Vec<Output>],
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
    let in_the_way = pictures.iter().flatten().any(|p| p.path.exists());
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
    let together = Scratch::ray_bytes(args.asking()) * common.threads as u64;
    let _jobs = budget.reserve(bytes_in_flight(common, args) + together, "rays in flight")?;

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
        job_rays: args.job_rays(),
        gather: Gather {
            photons: args.gather_photons.clamp(2, 1 << 20) as u32,
            radius: f32::INFINITY,
            kernel: args.kernel.kernel().0,
        },
        indirect: args.indirect,
        gather_rays: args.gather_rays,
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
            args,
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
    args: &'a RenderArgs,
    context: &'a Context<'a>,
    readers: &'a Readers<'a>,
    budget: MemoryBudget,
    cache: TileCache<'a>,
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
    pass: Pass,
    /// Camera rays of the pass that have still to be sent off.
    launches: Vec<Launch>,
}

/// Where a view's camera rays start from: the tile of its eye. Those of an eye in a doorway, or of a plan, are
/// parked from there at the tiles that they start in.
struct Launch {
    tile: u32,
    /// Rays of the pass, all of one view.
    left: Range<u64>,
}

impl Driver<'_> {
    fn drive(&mut self) -> Result<()> {
        let total = *self.context.first_pixels.last().unwrap_or(&0);
        let bands = total.div_ceil(BAND_PIXELS);
        let done: Vec<u32> =
            self.writer.extents().filter(|e| e.kind == ExtentKind::Film).map(|e| e.id).collect();
        let rays = u64::from(total) * u64::from(self.context.samples);
        let progress = Progress::new(self.common, "render", Some(rays), "rays");
        let share = done.len() as f64 / f64::from(bands.max(1));
        progress.resume((share * rays as f64) as u64, share);
        let smoothed = self.args.smooths();
        let widest = self.context.views.iter().map(|v| v.camera.width).max().unwrap_or(0);
        // Two bands wait for their neighbours, or for being one.
        let _reservation = match smoothed {
            true => Some(self.reserve(smooth::bytes(total.min(BAND_PIXELS), widest), "film")?),
            false => None,
        };
        let mut window = smooth::Window::new(widest);
        for band in 0..bands {
            let write = !done.contains(&band);
            // What comes after a band is smoothed across its edge: the same samples make the same bits once more.
            let before = smoothed && band + 1 < bands && !done.contains(&(band + 1));
            if !(write || before) {
                continue;
            }
            let (records, gathered) = self.expose(band, total, &progress)?;
            if !smoothed {
                self.put(band, &records)?;
                continue;
            }
            let ready = window.push(smooth::Exposed { band, write, records, gathered });
            if let Some((band, records)) = ready.and_then(|_| window.take(self.context, self.args))
            {
                self.put(band, &records)?;
            }
        }
        if let Some((band, records)) = window.take(self.context, self.args) {
            self.put(band, &records)?;
        }
        self.shown.evictions = self.rows.evictions();
        progress.finish();
        Ok(())
    }

    /// Reserves memory; maps and tiles that are not in use make way.
    fn reserve(&mut self, bytes: u64, what: &'static str) -> Result<Reservation> {
        loop {
            match self.budget.reserve(bytes, what) {
                Err(_) if self.make_way()? => {}
                other => return Ok(other?),
            }
        }
    }

    /// Writes a band.
    fn put(&mut self, band: u32, records: &[PixelRecord]) -> Result<()> {
        let count = records.len() as u64;
        self.writer.append(ExtentKind::Film, band, count, records.as_bytes(), Codec::Raw)?;
        self.writer.commit()?;
        // Rays that were parked have come home.
        self.writer.release_consumed()?;
        Ok(())
    }

    /// Makes a band: its pixels, and what gather rays say about them.
    fn expose(
        &mut self,
        band: u32,
        total: u32,
        progress: &Progress,
    ) -> Result<(Vec<PixelRecord>, Vec<Gathered>)> {
        let first_pixel = band * BAND_PIXELS;
        let pixels = BAND_PIXELS.min(total - first_pixel);
        let reservation = self.reserve(film_bytes(pixels), "film")?;
        let mut work = Band {
            film: Arc::new(Film::new(pixels as usize)),
            _reservation: reservation,
            first_pixel,
            pixels,
            pass: Pass::All,
            launches: Vec::new(),
        };
        self.band(&mut work, progress)?;
        let mut samples = vec![self.context.samples; pixels as usize];
        if self.args.more_samples() > 0 {
            let more = adaptive::more(&work.film, self.context, first_pixel, self.args);
            let mut before = Vec::with_capacity(more.len() + 1);
            before.push(0);
            for (samples, &more) in samples.iter_mut().zip(&more) {
                *samples += more;
                before.push(before[before.len() - 1] + u64::from(more));
            }
            if before[before.len() - 1] > 0 {
                work.pass = Pass::More(Arc::new(before));
                self.band(&mut work, progress)?;
            }
        }
        let mut records = vec![PixelRecord::default(); pixels as usize];
        let gathering = self.context.samples;
        work.film.resolve_each(0, |pixel| samples[pixel], gathering, &mut records);
        let gathered = match self.args.smooths() {
            true => (0..pixels as usize).map(|p| work.film.gathered(p, gathering)).collect(),
            false => Vec::new(),
        };
        Ok((records, gathered))
    }

    /// One pass over a band.
    fn band(&mut self, band: &mut Band, progress: &Progress) -> Result<()> {
        let samples = u64::from(self.context.samples);
        let before = |pixel: u32| match &band.pass {
            Pass::All => u64::from(pixel) * samples,
            Pass::More(before) => before[pixel as usize],
        };
        let mut launches = Vec::new();
        for (i, view) in self.context.views.iter().enumerate() {
            let (first, end) = (self.context.first_pixels[i], self.context.first_pixels[i + 1]);
            let first = first.max(band.first_pixel);
            let end = end.min(band.first_pixel + band.pixels);
            if first >= end {
                continue;
            }
            let left = before(first - band.first_pixel)..before(end - band.first_pixel);
            if left.is_empty() {
                continue;
            }
            let leaf = self.context.bsp.locate(view.camera.eye.as_dvec3());
            let tile = self.context.bsp.leaves[leaf as usize].tile;
            self.scheduler.add(tile, left.end - left.start);
            launches.push(Launch { tile, left });
        }
        let all: u64 = launches.iter().map(|l| l.left.end - l.left.start).sum();
        band.launches = launches;
        let shown = |unsent: u64| {
            let done = u64::from(band.pixels) * samples;
            u64::from(band.first_pixel) * samples
                + if matches!(band.pass, Pass::All) { done.min(all - unsent) } else { done }
        };
        let shown = [shown(all), shown(0)];
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
            let left = self.visit(tile, &data, &light, band)?;
            if left > 0 {
                self.scheduler.add(tile, left);
            }
            let unsent: u64 = band.launches.iter().map(|l| l.left.end - l.left.start).sum();
            progress.set(shown[1].saturating_sub(unsent).max(shown[0]));
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
            // less, for it is hidden from most of the room, but never less than a quarter: where it does shine it would be a
            // grain otherwise.
            lights.extend(set.iter().map(|p| {
                let share = (10.0 * part(p) / most).min(1.0);
                (p.light, 0.25 + 0.75 * share)
            }));
        }
        if lights.iter().any(|l| l.0 as usize >= self.context.tables.lights().len()) {
            return Err(Failure::input(format!("the light set of room {room} is damaged")));
        }
        let sun = daylight::adapt(&mut lights, self.context.tables, room);
        let map = if self.context.indirect != Indirect::None {
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
                    let photons = PhotonMap::from_pieces(map.iter().map(|m| &m[..]))?;
                    let cache = IrradianceCache::new(&photons);
                    let caustics = match self.context.indirect {
                        Indirect::FinalGather => Caustics::of(&photons, &self.budget)?,
                        _ => None,
                    };
                    Ok(RoomMap { map, cache, caustics, _reservation: reservation })
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
    ) -> Result<u64> {
        let job_rays = self.context.job_rays;
        let mut launches = std::mem::take(&mut band.launches);
        let memory: Vec<TransitRecord> = self.rows.take(tile).collect();
        let mut flying = 0;
        let mut handed = memory.len() as u64;
        let job = |work| Job {
            tile: Arc::clone(data),
            light: Arc::clone(light),
            film: Arc::clone(&band.film),
            first_pixel: band.first_pixel,
            pass: band.pass.clone(),
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
            for first in (0..count).step_by(job_rays as usize) {
                let range = first..(first + job_rays as usize).min(count);
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
        for launch in launches.iter_mut().filter(|l| l.tile == tile) {
            let left_to_send = &mut launch.left;
            while outcome.is_ok() && !left_to_send.is_empty() && handed < VISIT_RAYS {
                let stop = (left_to_send.start + job_rays).min(left_to_send.end);
                let work = Work::Camera { indices: left_to_send.start..stop };
                outcome = self.send(job(work), &mut flying);
                handed += stop - left_to_send.start;
                left_to_send.start = stop;
            }
            left += left_to_send.end - left_to_send.start;
        }
        band.launches = launches;
        while flying > 0 {
            outcome = outcome.and(self.receive(&mut flying));
        }
        outcome.map(|()| left)
    }

    /// Sends a job, and takes in what has come back meanwhile.
    fn send(&mut self, job: Job, flying: &mut u64) -> Result<()> {
        // A band that is interrupted is begun again: nothing is gained by coming to the end of the visit.
        interrupt::check()?;
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

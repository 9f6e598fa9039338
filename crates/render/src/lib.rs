//! `enf-render`: pictures from the store (the paper, section 6).
//!
//! Rays travel like photons: parked at portals, tile by tile. Several views are taken in one pass, in bands of
//! pixels; a finished band is committed, so that a run that was killed goes on with the next.
#![forbid(unsafe_code)]

mod adaptive;
mod args;
mod bands;
mod camera;
mod caustics;
mod choice;
mod daylight;
mod driver;
mod film;
mod gather;
mod pages;
mod rooms;
mod shade;
mod sight;
mod smooth;

use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU64, Ordering};
use std::time::Instant;

use crossbeam::channel::{bounded, unbounded};
use enf_illumination::Gather;
use enf_layout::segment::{ExtentKind, StageKind};
use enf_layout::transit::TransitRecord;
use enf_stage::resident::{Cache, STRUCTURES, TileCache, TileReader};
use enf_stage::session::{self, Begin, Session};
use enf_stage::tables::Tables;
use enf_stage::{
    CommonArgs, Failure, IdSink, IdSource, IoContext, Neighbours, Result, RowTable, Scheduler,
    Selection, say, warn,
};
use enf_store::{
    Identity, MemoryBudget, StageReader, StageState, StageWriter, StoreDir, StoreError,
};
use enf_trace::{jobs_at_once, queue_shape};
use serde_json::Value;

use args::DEFAULT_FORMATS;
pub use args::{Cli, Exposure, Format, Indirect, ProjectionArg, RenderArgs, ToneArg};
pub use camera::{Camera, View};
use driver::{Channels, Done, Driver, Manner, Shown, Task};
use rooms::RoomReader;
use shade::{Context, Scratch};

/// Pixels that are finished together. Part of the format of an unfinished render, hence no flag.
const BAND_PIXELS: u32 = 1 << 15;
/// Bands under way at most, if there is memory for their films.
const BANDS: u64 = 16;

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
    let grid = session::complete(&store, StageKind::Grid, &budget, &tables, &STRUCTURES, |room| {
        session::tiles_of(&tables, room)
    })?;
    let trace = StageReader::open(&store, StageKind::Trace)?.with_budget(&budget)?;
    let maps = session::complete(
        &store,
        StageKind::Kdtree,
        &budget,
        &tables,
        &[ExtentKind::Map],
        |room| room..room + 1,
    )?;
    let reader = TileReader {
        partition: &tables.partition,
        grid: &grid,
        budget: &budget,
        delta: tables.scene.delta,
    };
    let views = camera::views(args, &tables, &reader, &maps)?;
    let fixed = Fixed::new(cli, &tables, &views);
    let mut mesh = 0;
    for tile in 0..tables.tiles().len() as u32 {
        mesh = mesh.max(reader.peak_bytes(tile)?);
    }
    let bsp = tables.bsp()?;
    let caustics = maps.cursors().filter(|c| c.0 == ExtentKind::Map);
    let caustics = caustics.map(|(_, room, photons)| (room, photons)).collect();
    let rooms = RoomReader {
        tables: &tables,
        bsp: &bsp,
        trace: &trace,
        maps: &maps,
        budget: &budget,
        indirect: args.indirect,
        most: budget
            .available()
            .saturating_sub(fixed.all() + fixed.margin + mesh)
            .min(args.map_memory.unwrap_or(u64::MAX)),
        parts: choice::most_parts(tables.lights()),
        caustics: &caustics,
        threads: common.threads as u64,
    };
    let pictures = outputs(&cli.output, &args.formats, &views)?;

    let identity = identity(&store, cli, &views)?;
    // A finished film of something else makes way for this one: what that needs is refused before.
    if session::may_work(&store, StageKind::Render, cli.force)
        || store.identity(StageKind::Render)?.as_ref() != Some(&identity)
    {
        let most = hungriest(&tables, &reader, |room| rooms.least_bytes(room))?;
        refuse_if_hopeless(cli, &fixed, most, &budget)?;
    }
    yield_to_another_picture(&store, &identity, &pictures, cli.force)?;
    let mut shown = Shown::default();
    match session::begin(&store, StageKind::Render, common.process, &identity, cli.force)? {
        Begin::Finished => say(common, "nothing to do, the film is developed already"),
        Begin::Work(writer) => {
            shown = render(cli, &mut session, reader, rooms, &views, &fixed, *writer)?;
        }
    }
    film::develop(&store, &budget, &views, &pictures, args)?;
    let stats = &mut session.stats;
    stats.set("rays_camera", shown.camera);
    stats.set("rays_shadow", shown.shadow);
    stats.set("rays_gather", shown.gathers);
    stats.set("maps_loaded", shown.room_loads);
    stats.set("maps_in_part", shown.rooms_in_part);
    stats.set("light_outside_sets_share", shown.found.share());
    stats.set("contributions_not_finite", shown.not_finite);
    if shown.not_finite > 0 {
        warn(
            common,
            format!(
                "{} contributions of light were not finite, and are missing from the picture: please report this",
                shown.not_finite
            ),
        );
    }
    if shown.found.all > 0 {
        let percent = 100.0 * shown.found.share();
        say(
            common,
            format!(
                "{percent:.2} % of the light that shadow rays found is of lights outside their rooms' sets"
            ),
        );
    }
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

/// What a picture needs beside the rooms; all but the table's shape in bytes.
struct Fixed {
    /// Rows of the table of incoming rays, and rays in a row.
    rows: usize,
    block: usize,
    /// Table of incoming rays, and those in flight.
    rays: u64,
    /// One band's film.
    band: u64,
    /// What smoothing takes.
    smoothing: u64,
    /// Which tiles are neighbours.
    neighbours: u64,
    /// The sky and its openings.
    daylight: u64,
    /// What is kept free for rays that are read back, as long as that is possible.
    margin: u64,
    /// What the writers of pictures take, when all else is done.
    writers: u64,
}

impl Fixed {
    fn new(cli: &Cli, tables: &Tables, views: &[View]) -> Self {
        let (common, args) = (&cli.common, &cli.render);
        let (rows, block) = queue_shape(&cli.queue, common, size_of::<TransitRecord>());
        let pixels: u32 = views.iter().map(|v| v.camera.pixels()).sum();
        let widest = views.iter().map(|v| v.camera.width).max().unwrap_or(0);
        let pixels = pixels.min(BAND_PIXELS);
        Self {
            rows,
            block,
            rays: RowTable::<TransitRecord>::memory_bytes(rows, block)
                + bytes_in_flight(common, args, block),
            band: bands::bytes(pixels),
            smoothing: if args.smooths() { smooth::bytes(pixels, widest) } else { 0 },
            neighbours: Neighbours::bytes(tables)
                + Scheduler::memory_bytes(tables.tiles().len() as u32),
            daylight: enf_trace::daylight_bytes(tables),
            margin: (block * size_of::<TransitRecord>() * 2) as u64 + (1 << 20),
            writers: film::writer_bytes(widest),
        }
    }

    /// All that is needed at a time, without the margin.
    fn all(&self) -> u64 {
        self.rays + self.band + self.smoothing + self.neighbours + self.daylight
    }
}

/// The room that needs the most memory while it is shaded: its id, and the bytes of its largest tile and of what it answers with.
fn hungriest(
    tables: &Tables,
    reader: &TileReader<'_>,
    bytes: impl Fn(u32) -> u64,
) -> Result<Option<(u32, u64, u64)>> {
    let mut most: Option<(u32, u64, u64)> = None;
    for (id, room) in tables.rooms().iter().enumerate() {
        let mut mesh = 0;
        for tile in room.first_tile..room.first_tile + room.tile_count {
            mesh = mesh.max(reader.peak_bytes(tile)?);
        }
        let map = bytes(id as u32);
        if most.is_none_or(|m| mesh + map > m.1 + m.2) {
            most = Some((id as u32, mesh, map));
        }
    }
    Ok(most)
}

/// Refuses a budget in which some room could not be shaded, before anything is begun.
fn refuse_if_hopeless(
    cli: &Cli,
    fixed: &Fixed,
    most: Option<(u32, u64, u64)>,
    budget: &MemoryBudget,
) -> Result<()> {
    let common = &cli.common;
    let mib = |bytes: u64| bytes.div_ceil(1 << 20);
    if fixed.writers > budget.available() {
        return Err(Failure::budget(format!(
            "writing pictures needs {} MiB of {}: tables and program {}, rows and their encoded form {}",
            mib(fixed.writers + budget.reserved()),
            common.memory >> 20,
            mib(budget.reserved()),
            mib(fixed.writers),
        ))
        .with_hint(format!(
            "--memory {}M would do, or a smaller --width",
            mib(fixed.writers + budget.reserved()) + 4
        )));
    }
    let Some((room, mesh, map)) = most else { return Ok(()) };
    let film = fixed.band + fixed.smoothing;
    let needs = fixed.all() + mesh + map;
    if needs <= budget.available() {
        return Ok(());
    }
    Err(Failure::budget(format!(
        "room {room} needs {} MiB of {}: mesh and grid {}, photon map {}, film {}, rays {}, tables and program {}",
        mib(needs + budget.reserved()),
        common.memory >> 20,
        mib(mesh),
        mib(map),
        mib(film),
        mib(fixed.rays + fixed.neighbours + fixed.daylight),
        mib(budget.reserved())
    ))
    .with_hint({
        let enough = format!("--memory {}M would do", mib((needs + budget.reserved()) * 5 / 4));
        match mesh > map {
            true => format!(
                "{enough}, or cut it into smaller tiles: enf-partition --memory {}M",
                common.memory >> 20
            ),
            false => format!("{enough}, or --indirect none, which needs no map"),
        }
    }))
}

/// Rays and products of the jobs under way.
fn bytes_in_flight(common: &CommonArgs, args: &RenderArgs, block: usize) -> u64 {
    let jobs = jobs_at_once(common) as u64;
    let ray = size_of::<TransitRecord>() as u64;
    let products = args.job_rays() * u64::from(args.asking() + 1) * ray;
    // What a job has left may be of several rows of the table.
    let taken = block as u64 * ray * (jobs + 1);
    let scratch = Scratch::bytes(args.asking(), args.estimate_photons());
    products * (jobs + 1) + taken + scratch * common.threads as u64
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
        if !formats.contains(&format) && formats != DEFAULT_FORMATS {
            return Err(Failure::usage(format!(
                "{} is a picture in a format that is not among --formats",
                output.display()
            ))
            .with_hint("-o NAME.falsecolour.png, .png, .exr or .hdr says which by itself; for --formats it is a folder"));
        }
        if let Some(parent) = output.parent().filter(|p| !p.as_os_str().is_empty()) {
            std::fs::create_dir_all(parent).at("create", parent)?;
        }
        return Ok(vec![vec![Output { path: output.to_path_buf(), format }]]);
    }
    std::fs::create_dir_all(output).at("create", output)?;
    let mut names: Vec<String> = Vec::new();
    Ok(views
        .iter()
        .map(|view| {
            let name: String = view
                .name
                .chars()
                .map(|c| if c.is_alphanumeric() || "-_. ".contains(c) { c } else { '-' })
                .collect();
            let name = camera::unused(&name, |name| names.iter().any(|n| n == name));
            names.push(name.clone());
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
/// views, unless the same picture file would change under the user's hands. With `force` it makes way for the same views as well.
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
    if force || (found != *identity && !in_the_way) {
        store.discard_from(StageKind::Render)?;
    }
    Ok(())
}

fn render(
    cli: &Cli,
    session: &mut Session,
    reader: TileReader<'_>,
    room_reader: RoomReader<'_>,
    views: &[View],
    fixed: &Fixed,
    writer: StageWriter,
) -> Result<Shown> {
    let (common, args) = (&cli.common, &cli.render);
    let budget = session.budget.clone();
    let tables = room_reader.tables;
    let &Fixed { rows, block, .. } = fixed;
    let _rays = budget.reserve(fixed.rays, "rays in transit and in flight")?;
    let _neighbours = budget.reserve(fixed.neighbours, "neighbours of tiles")?;

    let mut first_pixels = vec![0u32];
    for view in views {
        first_pixels.push(first_pixels[first_pixels.len() - 1] + view.camera.pixels());
    }
    let (daylight, _daylight) = enf_trace::daylight(tables, &budget)?;
    let power = daylight::power(tables.lights());
    let context = Context {
        tables,
        maps: room_reader.maps,
        bsp: *room_reader.bsp,
        views,
        first_pixels: &first_pixels,
        seed: common.seed,
        samples: args.samples,
        light_samples: args.light_samples,
        job_rays: args.job_rays(),
        gather: Gather {
            photons: args.estimate_photons(),
            radius: f32::INFINITY,
            kernel: args.kernel.kernel().0,
        },
        indirect: args.indirect,
        gather_rays: args.gather_rays,
        power: &power,
        daylight: daylight.as_ref(),
    };
    // Films of several bands at most where the hungriest room still finds its place, and a quarter of what is free.
    let most = hungriest(tables, &reader, |room| room_reader.bytes(room))?;
    let (mesh, map) = most.map_or((0, 0), |m| (m.1, m.2));
    let free = budget.available().saturating_sub(fixed.smoothing);
    let films = (free / 4).min(free.saturating_sub(mesh + map));
    let bands = (films / fixed.band.max(1)).clamp(1, BANDS) as u32;

    let at_once = jobs_at_once(common);
    let (tasks, take_task) = bounded::<Task>(at_once + 1);
    let (done, finished) = unbounded::<Result<Done>>();
    let timeline = &session.timeline;
    let margin = fixed.margin;
    let (tiles, load_tiles) = TileCache::new(reader, cli.queue.resident_rooms.0, margin, timeline);
    let (rooms, load_rooms) = Cache::new(room_reader, 0, margin, timeline);
    let rooms = rooms.beside(&tiles);
    let (waited, began) = (AtomicU64::new(0), Instant::now());
    let (shown, loads) = std::thread::scope(|scope| {
        let mut loaders = Vec::new();
        for _ in 0..common.threads {
            loaders.push(scope.spawn(load_tiles.clone()));
            loaders.push(scope.spawn(load_rooms.clone()));
        }
        drop((load_tiles, load_rooms));
        for thread in 0..common.threads {
            let (take_task, done) = (take_task.clone(), done.clone());
            let (context, waited) = (&context, &waited);
            scope.spawn(move || {
                let lane = timeline.lane(&format!("renderer {thread}"));
                let mut scratch = Scratch::new(context.gather.photons);
                let wait = || {
                    let (_span, since) = (lane.io("wait for work", 0u32), Instant::now());
                    let task = take_task.recv();
                    waited.fetch_add(since.elapsed().as_nanos() as u64, Ordering::Relaxed);
                    task
                };
                while let Ok(task) = wait() {
                    let span = match &task {
                        Task::Rays(job) => lane.span("render", job.tile.tile),
                        Task::Smooth(_) => lane.span("smooth", 0u32),
                    };
                    let ran =
                        std::panic::catch_unwind(std::panic::AssertUnwindSafe(|| match task {
                            Task::Rays(job) => context.run(&job, &mut scratch).map(Done::Rays),
                            Task::Smooth(smoothing) => Ok(Done::Smoothed(smoothing.run(context))),
                        }));
                    drop(span);
                    let result = match ran {
                        Ok(products) => products.map_err(StoreError::into),
                        Err(_) => Err(Failure::internal("a rendering thread failed")),
                    };
                    if done.send(result).is_err() {
                        break;
                    }
                }
            });
        }
        drop((take_task, done));
        let mut driver = Driver {
            common,
            args,
            context: &context,
            budget: budget.clone(),
            tiles,
            rooms,
            channels: Channels { tasks, finished },
            manner: Manner { jobs: at_once as u64, ahead: common.threads + 1, bands, margin },
            writer,
            rows: RowTable::new(rows, block),
            capacity: rows as u64 * block as u64,
            scheduler: Scheduler::new(cli.queue.schedule, tables.tiles().len() as u32),
            neighbours: Neighbours::new(tables),
            lane: timeline.lane("schedule"),
            state: Default::default(),
        };
        let driven = driver.drive();
        let Driver { channels, tiles, rooms, writer, state, .. } = driver;
        drop(channels);
        let loads = tiles.loads().clone();
        let mut shown = state.shown;
        shown.room_loads = rooms.loads().values().map(|&n| u64::from(n)).sum();
        let in_part = rooms.loads().keys().filter(|&&room| room_reader.is_in_part(room));
        shown.rooms_in_part = in_part.count() as u64;
        drop((tiles, rooms));
        loaders.into_iter().for_each(|loader| drop(loader.join()));
        driven.and_then(|()| Ok(writer.seal()?)).map(|()| (shown, loads))
    })?;
    let threads_s = began.elapsed().as_secs_f64() * common.threads as f64;
    let waited_s = waited.into_inner() as f64 / 1e9;
    session.stats.set("renderers_waited_s", waited_s);
    let share = waited_s / threads_s.max(f64::MIN_POSITIVE);
    session.stats.set("renderers_waited_share", share);
    enf_trace::record_loads(session, tables, &loads);
    Ok(shown)
}
